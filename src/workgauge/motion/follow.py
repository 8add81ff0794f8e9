"""Doing a job, tick by tick: along a trajectory or to a goal, bent before limits, waiting for what falls behind."""

import math
from dataclasses import dataclass, replace

import numpy as np

from workgauge.machine.model import Kinematics, MachineModel
from workgauge.motion.along import along
from workgauge.motion.ik.task import task_error
from workgauge.motion.job import Job, JobFacts, JobMemory, JobState
from workgauge.motion.predict import InFlight, lateness
from workgauge.motion.slide import Slid, Surround, slid
from workgauge.motion.towards import towards
from workgauge.motion.wish import FollowSettings, sizes
from workgauge.values.arrays import Floats, freeze
from workgauge.values.reasons import Reason, ReasonCode
from workgauge.values.tasks import Orientation
from workgauge.values.transforms import inverse

#: The tool is held by limits where they leave less than this share of what is wanted, and free again from `FREE` on.
HELD, FREE = 0.9, 0.98
#: Nearer to its end than this at full speed, a joint is slowed.
SETTLE_S = 0.3


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
        wish = along(job, job.trajectory, share, kin, machine, memory, flight, settings, late, sent, dt_s)
    else:
        wish = towards(job, share, kin, machine, T_site_machine, memory, flight, settings, late, dt_s)
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
    error_m, error_rad = sizes(task_error(kin, machine, wanted, orientation))
    facts = JobFacts(job.id, state, memory.clock_s, duration_s, 0.0, way_m, error_m, error_rad, 1.0, None)
    said: tuple[Reason, ...] = ()
    if state is JobState.STUCK:
        said = (Reason(ReasonCode.STUCK, f"{job.id} came no nearer, {error_m:.2f} m off", scale=0.0),)
    still = np.zeros(machine.n)
    freeze(still)
    return Followed(still, said, replace(memory, rate=0.0), facts)
