"""Along a trajectory in one tick: its speed when a command of now acts, its error before it, and when it waits."""

import math

import numpy as np

from workgauge.machine.model import Kinematics, MachineModel
from workgauge.motion.job import Job, JobMemory
from workgauge.motion.paths.timing import default_acceleration
from workgauge.motion.paths.trajectory import Trajectory
from workgauge.motion.predict import InFlight, Lateness, steadiest_1_s
from workgauge.motion.wish import FollowSettings, Wish, within_speeds
from workgauge.values.arrays import Floats
from workgauge.values.transforms import rotation_vector

#: A trajectory slower than this, in shares of full speed squared or in m/s of the tool, stands.
STILL = 1e-9


def along(
    job: Job,
    trajectory: Trajectory,
    share: float,
    kin: Kinematics,
    machine: MachineModel,
    memory: JobMemory,
    flight: InFlight,
    settings: FollowSettings,
    late: Lateness,
    sent: Floats,
    dt_s: float,
) -> Wish:
    """Return the wish of a trajectory: its speed in the tick in which a command of now acts, and its error before it.

    Its time runs as planned while the tool keeps up. Held back, it runs as fast as the tool still gets on, half of
    `lag_m` behind at most, or of `deviation_m` where limits pushed it off; the farther the tool will be beside its
    path, the slower, and it stands at all of that. It is decided as much ahead as commands are late.
    """
    q_now, _, way_m = trajectory.at(memory.clock_s)
    q_now = _turned(q_now, kin.q, machine)
    wanted, is_at = machine.tool_pose(machine.forward(q_now)), machine.tool_pose(kin)
    away = wanted[:3, 3] - is_at[:3, 3]
    error_m, error_rad = math.hypot(*away.tolist()), _angle(is_at, wanted)
    most_m = job.deviation_m if memory.pushed else job.lag_m
    ticks = late.ticks.astype(np.int64) if settings.compensate else np.zeros(machine.n, dtype=np.int64)
    ahead = _decided(memory, int(ticks.max(initial=0)))
    q, lag, gain = kin.q, np.zeros(machine.n), np.full(machine.n, settings.gain_1_s)
    if settings.compensate:
        q, lag, gain = flight.ahead(kin.q, late)[0], late.lag_s, np.minimum(gain, steadiest_1_s(machine, dt_s))
    begin = ahead[ticks]
    soon = min(ahead[-1] + memory.rate * dt_s, trajectory.duration_s)
    last = np.append(ahead[1:], soon)[ticks] - begin
    reference, slope = trajectory.each(begin, begin + (0.5 + lag / dt_s) * last)
    behind = _turned(reference, q, machine) - q
    keeps, aside_m = _kept_up(sent, memory.rate, slope, behind, kin, machine, 0.5 * most_m, float(gain.min()))
    slowest = memory.rate - dt_s * _slows_1_s(slope, machine)
    pace = max(2.0 - 2.0 * aside_m / most_m, slowest, 0.0)
    rate = min(share, keeps, pace, memory.rate + dt_s / settings.ramp_s)
    clocks = np.append(ahead, min(ahead[-1] + rate * dt_s, trajectory.duration_s))
    velocity = gain * behind
    if settings.feed_forward:
        velocity = velocity + (clocks[ticks + 1] - begin) / dt_s * slope
    there = memory.clock_s >= trajectory.duration_s and error_m <= job.tolerance_m and error_rad <= job.tolerance_rad
    if there:
        comes_to = machine.tool_pose(machine.forward(q))
        off_m = math.hypot(*(wanted[:3, 3] - comes_to[:3, 3]).tolist())
        there = off_m <= job.tolerance_m and _angle(comes_to, wanted) <= job.tolerance_rad
    to_go = trajectory.duration_s - memory.clock_s + error_m + error_rad
    return Wish(
        *(within_speeds(velocity, machine), away, error_m, error_rad, way_m if job.on_path else math.nan),
        *(float(clocks[1]), rate, there, to_go, tuple(clocks[2:].tolist())),
    )


def _decided(memory: JobMemory, ticks: int) -> Floats:
    """Return times (ticks + 1,) on a trajectory: now, and at so many ticks to come.

    What is decided now is what happens once the dead time is over; what lies before it has been commanded, and is not
    taken back.
    """
    ahead = memory.clocks if len(memory.clocks) == ticks else (memory.clock_s,) * ticks
    return np.array([memory.clock_s, *ahead])


def _slows_1_s(slope: Floats, machine: MachineModel) -> float:
    """Return how fast a trajectory's time may slow down [1/s] that joints, at slopes (n,), can slow down with it."""
    return float((default_acceleration(machine) / np.maximum(np.abs(slope), STILL)).min())


def _kept_up(
    sent: Floats,
    rate: float,
    slope: Floats,
    behind: Floats,
    kin: Kinematics,
    machine: MachineModel,
    most_m: float,
    gain_1_s: float,
) -> tuple[float, float]:
    """Return how fast a trajectory's time may run for held-back joints to keep up, and how far the tool is aside [m].

    As fast as what was sent last goes along it, what makes up for falling behind not counted, and so much more as
    brings the tool to `most_m` behind, by when what is in flight has arrived, at a rate of `gain_1_s`. Nothing waits
    for dead time here, so nothing swings. 1 is as planned.

    Args:
        sent: (n,) velocities sent last, for a trajectory's time at `rate`.
        slope: (n,) the trajectory's velocities, as planned.
        behind: (n,) from where the joints will be to where they are to be.
    """
    J = machine.tool_jacobian(kin)[:3]
    tool, off = J @ slope, J @ behind
    speed = math.hypot(*tool.tolist())
    weighed = slope / machine.speed_positive**2
    size = float(weighed @ slope)
    if size < STILL or speed < STILL:
        return 1.0, math.hypot(*off.tolist())
    behind_m = float(tool @ off) / speed
    aside_m = math.hypot(*(off - behind_m / speed * tool).tolist())
    return max(min(float(weighed @ sent) / size, rate) + gain_1_s * (most_m - behind_m) / speed, 0.0), aside_m


def _angle(T: Floats, S: Floats) -> float:
    """Return the angle between two frames (4, 4) [rad]."""
    return math.hypot(*rotation_vector(T[:3, :3].T @ S[:3, :3]).tolist())


def _turned(q: Floats, near: Floats, machine: MachineModel) -> Floats:
    """Return joint positions (n,) with endless joints in the turn nearest to another posture's."""
    turns = np.rint((near - q) / (2.0 * np.pi)) * machine.continuous
    return q + 2.0 * np.pi * turns if turns.any() else q
