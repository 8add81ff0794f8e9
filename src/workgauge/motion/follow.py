"""Doing a job, tick by tick: along a trajectory or to a goal, bent before limits, waiting for what falls behind."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from workgauge.machine.model import Kinematics, MachineModel
from workgauge.motion.ik.clik import ClikFacts, ClikGains, ClikMemory, clik_velocity, speed_share
from workgauge.motion.ik.task import task_error
from workgauge.motion.job import Job, JobFacts, JobMemory, JobState
from workgauge.motion.paths.trajectory import Trajectory
from workgauge.motion.predict import InFlight, Lateness, lateness, steadiest_1_s
from workgauge.motion.slide import Slid, SlideSettings, Surround, slid
from workgauge.values.arrays import Floats, freeze
from workgauge.values.reasons import Reason, ReasonCode
from workgauge.values.tasks import Orientation
from workgauge.values.transforms import inverse, rotation_vector

#: The tool is held by limits where they leave less than this share of what is wanted, and free again from `FREE` on.
HELD, FREE = 0.9, 0.98
#: Share of the motion towards a goal that may be missed before it is said.
MISSED = 0.1
#: Nearer to its end than this at full speed, a joint is slowed.
SETTLE_S = 0.3


@dataclass(frozen=True, slots=True)
class FollowSettings:
    """How closely jobs are followed.

    Attributes:
        gain_1_s: how fast a joint is drawn back to its trajectory, and lateness made up for, no faster than it bears.
        ramp_s: from standing to the full pace of a trajectory, and back.
        stuck_s: a job that comes no nearer for so long is stuck. nearer: less than this is no nearer [m, rad, s].
        feed_forward: whether the trajectory's own speed is commanded, not only what corrects its error.
        compensate: whether dead time and lag are made up for by commanding so much earlier.
        bend: whether motion bends before limits, not for a guard that does; slide: how.
        clik: gains of the inverse kinematics towards goals.
    """

    gain_1_s: float = 2.5
    ramp_s: float = 0.5
    stuck_s: float = 8.0
    nearer: float = 0.005
    feed_forward: bool = True
    compensate: bool = True
    bend: bool = True
    slide: SlideSettings = field(default_factory=SlideSettings)
    clik: ClikGains = field(default_factory=ClikGains)


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """What a job asks for now.

    Attributes:
        velocity: (n,) joint velocities [rad/s, m/s]. reasons: what hinders it.
        memory: for the next tick. facts: how far it is.
    """

    velocity: Floats
    reasons: tuple[Reason, ...]
    memory: JobMemory
    facts: JobFacts


@dataclass(frozen=True, slots=True, eq=False)
class Wish:
    """What a job would ask for if nothing stood around.

    Attributes:
        velocity: (n,). goal: (3,) where the tool wants to go from where it is, machine frame [m].
        error_m, error_rad: see `JobFacts`. way_m, rate: likewise. clock_s, clocks: see `JobMemory`, of the next tick.
        there: whether the job is done.
        to_go: a number that falls as long as the job gets on. group: see `JobMemory`.
        reasons: what hinders it by itself.
    """

    velocity: Floats
    goal: Floats
    error_m: float
    error_rad: float
    way_m: float
    clock_s: float
    rate: float
    there: bool
    to_go: float
    clocks: tuple[float, ...] = ()
    group: int = -1
    reasons: tuple[Reason, ...] = ()


def followed(
    job: Job,
    share: float,
    kin: Kinematics,
    machine: MachineModel,
    T_site_machine: Floats,
    surround: Surround,
    memory: JobMemory,
    settings: FollowSettings,
    *,
    sent: Floats,
    dt_s: float,
) -> Followed:
    """Return what a job asks for in this tick.

    Args:
        job: what to do. share: pace, 0 to 1 of its own; 0 holds it where it is.
        kin: the measured posture. surround: what stands around.
        memory: of the last tick. sent: (n,) joint velocities that the valves ask for since then.
        dt_s: the tick's period [s].
    """
    late = lateness(machine, dt_s)
    if memory.job != job.id:
        memory = JobMemory(job=job.id, flight=memory.flight)
    flight = memory.flight.after(sent, late)
    state = JobState(memory.state)
    if state in (JobState.DONE, JobState.STUCK):
        return _stood(job, kin, machine, T_site_machine, replace(memory, flight=flight))
    if job.trajectory is not None:
        wish = _along(job, job.trajectory, share, kin, machine, memory, flight, settings, late, dt_s)
    else:
        wish = _towards(job, share, kin, machine, T_site_machine, memory, flight, settings, late, dt_s)
    low, high = _box(machine, kin.q, wish.velocity)
    bent = Slid(np.minimum(np.maximum(wish.velocity, low), high), 1.0, -1, np.zeros(3))
    if settings.bend:
        bent = slid(
            *(wish.velocity, machine.tool_jacobian(kin), low, high, surround, settings.slide),
            late_s=float((late.dead_s + late.lag_s).max(initial=0.0)),
            goal=wish.goal,
            around=np.array(memory.around) if job.around else None,
        )
    left = min(bent.left, memory.allowed)
    nearer = wish.to_go < memory.least - settings.nearer
    idle_s = 0.0 if nearer or share <= 0.0 else memory.idle_s + dt_s
    pushed = left < HELD or (memory.pushed and (left < FREE or wish.error_m > 0.5 * job.lag_m))
    if wish.there:
        state = JobState.DONE
    elif idle_s > settings.stuck_s:
        state = JobState.STUCK
    else:
        state = JobState.HELD if left < HELD else JobState.MOVING
    moving = state in (JobState.MOVING, JobState.HELD)
    velocity = np.array(bent.velocity) if moving else np.zeros(machine.n)
    freeze(velocity)
    after = JobMemory(
        job=job.id,
        state=state.value,
        clock_s=wish.clock_s,
        clocks=wish.clocks,
        rate=wish.rate,
        pushed=pushed,
        flight=flight,
        around=tuple(bent.around.tolist()),
        least=wish.to_go if nearer else memory.least,
        idle_s=idle_s,
        allowed=memory.allowed,
        group=wish.group,
    )
    against = surround.names[bent.against] if bent.against >= 0 else None
    duration_s = 0.0 if job.trajectory is None else job.trajectory.duration_s
    facts = JobFacts(
        *(job.id, state, memory.clock_s, duration_s, wish.rate, wish.way_m, wish.error_m, wish.error_rad),
        *(bent.left, against),
    )
    return Followed(velocity, (*wish.reasons, *_said(job, facts, bent, surround)), after, facts)


def released(memory: JobMemory) -> JobMemory:
    """Return the memory of a job nobody asks for now; it goes on from where it is once somebody does."""
    clock_s = memory.clocks[-1] if memory.clocks else memory.clock_s  # where commands in flight take the joints
    return replace(memory, clock_s=clock_s, clocks=(), rate=0.0, flight=InFlight(), idle_s=0.0, allowed=1.0)


def _along(
    job: Job,
    trajectory: Trajectory,
    share: float,
    kin: Kinematics,
    machine: MachineModel,
    memory: JobMemory,
    flight: InFlight,
    settings: FollowSettings,
    late: Lateness,
    dt_s: float,
) -> Wish:
    """Return the wish of a trajectory: its speed in the tick in which a command of now acts, and its error before it.

    Its time runs as planned while the tool is where it is to be, slower the farther it is off, and stands at
    `lag_m`, or at `deviation_m` where limits pushed it off. It is decided as much ahead as commands are late.
    """
    q_now, _, way_m = trajectory.at(memory.clock_s)
    q_now = _turned(q_now, kin.q, machine)
    wanted, is_at = machine.tool_pose(machine.forward(q_now)), machine.tool_pose(kin)
    away = wanted[:3, 3] - is_at[:3, 3]
    error_m, error_rad = math.hypot(*away.tolist()), _angle(is_at, wanted)
    most_m = job.deviation_m if memory.pushed else job.lag_m
    pace = share * min(max(2.0 - 2.0 * error_m / most_m, 0.0), 1.0)
    rate = min(pace, memory.rate + dt_s / settings.ramp_s)
    ticks = late.ticks.astype(np.int64) if settings.compensate else np.zeros(machine.n, dtype=np.int64)
    clocks = _clocks(memory, int(ticks.max(initial=0)), rate * dt_s, trajectory.duration_s)
    q, lag, gain = kin.q, np.zeros(machine.n), np.full(machine.n, settings.gain_1_s)
    if settings.compensate:
        q, lag, gain = flight.ahead(kin.q, late)[0], late.lag_s, np.minimum(gain, steadiest_1_s(machine, dt_s))
    begin, end = clocks[ticks], clocks[ticks + 1]
    rates = (end - begin) / dt_s
    reference, slope = trajectory.each(begin, 0.5 * (begin + end) + rates * lag)
    velocity = gain * (_turned(reference, q, machine) - q)
    if settings.feed_forward:
        velocity = velocity + rates * slope
    there = memory.clock_s >= trajectory.duration_s and error_m <= job.tolerance_m and error_rad <= job.tolerance_rad
    if there:
        comes_to = machine.tool_pose(machine.forward(q))
        off_m = math.hypot(*(wanted[:3, 3] - comes_to[:3, 3]).tolist())
        there = off_m <= job.tolerance_m and _angle(comes_to, wanted) <= job.tolerance_rad
    to_go = trajectory.duration_s - memory.clock_s + error_m + error_rad
    return Wish(
        *(_within(velocity, machine), away, error_m, error_rad, way_m if job.on_path else math.nan),
        *(float(clocks[1]), rate, there, to_go, tuple(clocks[2:].tolist())),
    )


def _clocks(memory: JobMemory, ticks: int, step_s: float, duration_s: float) -> Floats:
    """Return times (ticks + 2,) on a trajectory: now, at so many ticks to come, and one more, `step_s` after those.

    What is decided now is what happens once the dead time is over; what lies before it has been commanded, and is not
    taken back.
    """
    ahead = memory.clocks if len(memory.clocks) == ticks else (memory.clock_s,) * ticks
    last = ahead[-1] if ahead else memory.clock_s
    return np.array([memory.clock_s, *ahead, min(last + step_s, duration_s)])


def _towards(
    job: Job,
    share: float,
    kin: Kinematics,
    machine: MachineModel,
    T_site_machine: Floats,
    memory: JobMemory,
    flight: InFlight,
    settings: FollowSettings,
    late: Lateness,
    dt_s: float,
) -> Wish:
    """Return the wish of a goal: closed-loop inverse kinematics from where a command of now begins to act (Lee 5)."""
    goal = job.goal
    assert goal is not None
    T_machine_goal = inverse(T_site_machine) @ goal.T_site_tool
    error_m, error_rad = _sizes(task_error(kin, machine, T_machine_goal, goal.orientation))
    ahead = machine.forward(flight.ahead(kin.q, late)[0]) if settings.compensate else kin
    error = task_error(ahead, machine, T_machine_goal, goal.orientation)
    left_m, left_rad = _sizes(error)
    rate = min(share, memory.rate + dt_s / settings.ramp_s)
    gains = settings.clik
    if settings.compensate:
        most = float(steadiest_1_s(machine, dt_s).min())
        gains = replace(gains, linear_1_s=min(gains.linear_1_s, most), angular_1_s=min(gains.angular_1_s, most))
    pace = min(
        1.0,
        rate * job.tool_speed_m_s / max(gains.linear_1_s * left_m, 1e-12),
        rate * job.tool_turn_rad_s / max(gains.angular_1_s * left_rad, 1e-12),
    )
    velocity, clik, facts = clik_velocity(
        *(machine, ahead, pace * error, np.zeros(len(error)), ClikMemory(memory.group), gains, goal.orientation),
        dt_s=dt_s,
    )
    return Wish(
        velocity,
        T_machine_goal[:3, 3] - machine.tool_pose(kin)[:3, 3],
        *(error_m, error_rad, math.nan, 0.0, rate),
        there=max(error_m, left_m) <= job.tolerance_m and max(error_rad, left_rad) <= job.tolerance_rad,
        to_go=error_m + error_rad,
        group=clik.group,
        reasons=_hindered(facts, machine),
    )


def _hindered(facts: ClikFacts, machine: MachineModel) -> tuple[Reason, ...]:
    """Return why the joints cannot do what a goal asks of them."""
    if facts.missed <= MISSED:
        return ()
    left = max(1.0 - facts.missed, 0.0)
    if facts.held:
        names = ", ".join(machine.joint_names[j] for j in facts.held)
        text = f"{names} at the end of the way to the goal: {100.0 * facts.missed:.0f} % of the motion is missing"
        return (Reason(ReasonCode.JOINT_END, text, joint=machine.joint_names[facts.held[0]], scale=left),)
    text = f"the tool cannot go that way from here, {100.0 * facts.missed:.0f} % of the motion is missing"
    return (Reason(ReasonCode.SINGULAR, text, scale=left),)


def _said(job: Job, facts: JobFacts, bent: Slid, surround: Surround) -> tuple[Reason, ...]:
    """Return what is said of a job that limits hold, or that is stuck."""
    if facts.state is JobState.STUCK:
        where = f"{facts.error_m:.2f} m off" if math.isnan(facts.way_m) else f"at {facts.way_m:.2f} m of its path"
        cause = "" if facts.against is None else f", {surround.links[bent.against]} before {facts.against}"
        text = f"{job.id} comes no nearer, {where}{cause}"
    elif facts.state is JobState.HELD and facts.against is not None:
        text = f"{job.id} gives way, {surround.links[bent.against]} before {facts.against}"
    else:
        return ()
    if bent.against < 0:
        return (Reason(ReasonCode.STUCK, text, scale=0.0),)
    stuck = facts.state is JobState.STUCK
    return (
        Reason(
            ReasonCode.STUCK if stuck else ReasonCode.GIVES_WAY,
            text,
            link=surround.links[bent.against],
            limit=facts.against,
            scale=0.0 if stuck else bent.left,
        ),
    )


def _sizes(error: Floats) -> tuple[float, float]:
    """Return the lengths of an error's position and orientation [m, rad]."""
    return math.hypot(*error[:3].tolist()), math.hypot(*error[3:].tolist())


def _angle(T: Floats, S: Floats) -> float:
    """Return the angle between two frames (4, 4) [rad]."""
    return math.hypot(*rotation_vector(T[:3, :3].T @ S[:3, :3]).tolist())


def _turned(q: Floats, near: Floats, machine: MachineModel) -> Floats:
    """Return joint positions (n,) with endless joints in the turn nearest to another posture's."""
    turns = np.rint((near - q) / (2.0 * np.pi)) * machine.continuous
    return q + 2.0 * np.pi * turns if turns.any() else q


def _within(velocity: Floats, machine: MachineModel) -> Floats:
    """Return a velocity (n,) shortened so that no joint is to run faster than it can."""
    shortened: Floats = velocity * speed_share(velocity, machine)
    return shortened


def _box(machine: MachineModel, q: Floats, wish: Floats) -> tuple[Floats, Floats]:
    """Return the velocities (n,) that may be asked for: joints' speeds, their ends, and the group that moves."""
    low = np.maximum(-machine.speed_negative, np.minimum((machine.q_min - q) / SETTLE_S, 0.0))
    high = np.minimum(machine.speed_positive, np.maximum((machine.q_max - q) / SETTLE_S, 0.0))
    for group in machine.exclusive_groups:
        if not wish[list(group)].any():
            low[list(group)] = high[list(group)] = 0.0
    return low, high


def _stood(job: Job, kin: Kinematics, machine: MachineModel, T_site_machine: Floats, memory: JobMemory) -> Followed:
    """Return the rest of a job that is done or stuck."""
    state, way_m, duration_s = JobState(memory.state), math.nan, 0.0
    if job.trajectory is not None:
        reference, _, at_m = job.trajectory.at(memory.clock_s)
        way_m = at_m if job.on_path else math.nan
        wanted, duration_s = machine.tool_pose(machine.forward(reference)), job.trajectory.duration_s
        orientation = Orientation.FULL
    else:
        assert job.goal is not None
        wanted, orientation = inverse(T_site_machine) @ job.goal.T_site_tool, job.goal.orientation
    error_m, error_rad = _sizes(task_error(kin, machine, wanted, orientation))
    facts = JobFacts(job.id, state, memory.clock_s, duration_s, 0.0, way_m, error_m, error_rad, 1.0, None)
    said: tuple[Reason, ...] = ()
    if state is JobState.STUCK:
        said = (Reason(ReasonCode.STUCK, f"{job.id} came no nearer, {error_m:.2f} m off", scale=0.0),)
    still = np.zeros(machine.n)
    freeze(still)
    return Followed(still, said, replace(memory, rate=0.0), facts)
