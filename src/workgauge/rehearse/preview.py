"""Jobs of automatic motion run ahead of time: the real tick on copied joints, as fast as it computes."""

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from workgauge.loop.config import TickConfig
from workgauge.loop.inputs import TickInputs
from workgauge.loop.memory import TickMemory, first_memory
from workgauge.loop.tick import Trace, tick
from workgauge.motion.job import Job, JobState
from workgauge.proximity.scene import Scene
from workgauge.sim.joints import Joints
from workgauge.values.arrays import Floats, frozen
from workgauge.values.clearances import Clearances
from workgauge.values.measurements import DriveMode, Intent, Levers, MachinePose, Posture, Stamp
from workgauge.values.reasons import ReasonCode

#: No preview lasts longer than this [s], simulated.
LONGEST_S = 900.0
#: After its last job the machine is given this long to come to rest [s], and slower than this it has [rad/s, m/s].
REST_S, RESTS = 2.0, 1e-3
#: Ticks the gate is given to open.
OPENING = 5
_SOURCE = "preview"
#: Prefix of the ids of pairs of the machine's own links.
_OWN = "self:"


class Nearest(NamedTuple):
    """Where a motion comes nearest to one limit: signed clearance [m], the link, time since the beginning [s]."""

    clearance_m: float
    link: str
    at_s: float


@dataclass(frozen=True, slots=True, eq=False)
class After:
    """The simulated machine where a preview ended, for another to go on from.

    Attributes:
        q: (n,) joints [rad, m]. memory: of the tick. joints: what moves them. now_ns: the clock [ns].
    """

    q: Floats
    memory: TickMemory
    joints: Joints
    now_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class Preview:
    """What would become of jobs. Arrays have one row per tick, the first and the last posture among them.

    Attributes:
        completed: whether every job is done. state: of the last one begun. why: what kept it from being done, empty
            if nothing did.
        duration_s: until the last job is done, or ended otherwise. planned_s: of the jobs' trajectories.
        least: id of everything that came within sight to where it came nearest; pairs of links begin with `self:`.
        against: ids of the limits that held or bent a job, the one that did longest first.
        t: (k,) [s]. q: (k, n) joints [rad, m]. tool: (k, 3) in the site's local frame [m].
        after: where it ended; the machine at rest if all was done.
    """

    completed: bool
    state: JobState
    why: str
    duration_s: float
    planned_s: float
    least: Mapping[str, Nearest]
    against: tuple[str, ...]
    t: Floats
    q: Floats
    tool: Floats
    after: After

    @property
    def nearest(self) -> tuple[str, Nearest] | None:
        """The limit come nearest to, the machine's own links aside; None if none is in sight."""
        others = [(name, one) for name, one in self.least.items() if not name.startswith(_OWN)]
        return min(others, key=lambda one: one[1].clearance_m, default=None)

    def then(self, other: "Preview") -> "Preview":
        """Return this one and another that went on from where it ended, as one."""
        end_s = float(self.t[-1])
        least = dict(self.least)
        for name, one in other.least.items():
            if name not in least or one.clearance_m < least[name].clearance_m:
                least[name] = one._replace(at_s=one.at_s + end_s)
        return replace(
            other,
            duration_s=end_s + other.duration_s,
            planned_s=self.planned_s + other.planned_s,
            least=MappingProxyType(least),
            against=tuple(dict.fromkeys((*self.against, *other.against))),
            t=frozen(np.concatenate([self.t, end_s + other.t[1:]])),
            q=frozen(np.concatenate([self.q, other.q[1:]])),
            tool=frozen(np.concatenate([self.tool, other.tool[1:]])),
        )


def preview(
    config: TickConfig,
    scene: Scene,
    q: Floats,
    T_site_machine: Floats,
    jobs: Sequence[Job],
    joints: Joints,
    *,
    off_states: frozenset[str] = frozenset(),
    let_off: frozenset[str] = frozenset(),
    now_ns: int = 0,
    pace: float = 1.0,
    at_most_s: float = LONGEST_S,
    memory: TickMemory | None = None,
    progress: Callable[[float], None] | None = None,
) -> Preview:
    """Return what would become of jobs, one after the other, were they begun now.

    `loop.tick` itself decides, with the same guard, limits and period; posture and pose are exact and fresh. If the
    gate is closed, it is opened first, the machine standing still. The undercarriage does not travel.

    Args:
        config: of the tick. scene: what stands around. q: (n,) joints now. T_site_machine: (4, 4).
        joints: what moves them, as they are now; they are copied and stay so.
        off_states, let_off, now_ns: as of `TickInputs`.
        pace: of the operator, 0 to 1. at_most_s: it ends here if not before.
        memory: of the last real tick, left out for a first one. progress: called with the simulated time [s].
    """
    world = _World(config, scene, q, T_site_machine, joints, off_states, let_off, now_ns, memory)
    closed = world.opened()
    if closed:
        return world.told(jobs, JobState.NONE, closed, 0.0)
    state, levers = JobState.DONE, Levers(right_y=pace)
    for job in jobs:
        state = JobState.MOVING
        while state in (JobState.MOVING, JobState.HELD):
            if world.t_s >= at_most_s - 1e-9:
                return world.told(jobs, state, f"{job.id} is not done within {at_most_s:g} s", world.t_s)
            trace = world.ticked(levers, job)
            if progress is not None:
                progress(world.t_s)
            if trace.job is None:
                return world.told(jobs, JobState.NONE, _said(trace), world.t_s)
            state = trace.job.state
        if state is JobState.STUCK:
            return world.told(jobs, state, _said(trace), world.t_s)
    duration_s = world.t_s
    while jobs and world.moving and world.t_s < duration_s + REST_S:
        world.ticked(levers, jobs[-1])
    return world.told(jobs, state, "", duration_s)


@dataclass(slots=True, eq=False)
class _World:
    """A machine that does what the tick says, and what has been seen of it."""

    config: TickConfig
    scene: Scene
    q: Floats
    T_site_machine: Floats
    joints: Joints
    off_states: frozenset[str]
    let_off: frozenset[str]
    now_ns: int
    memory: TickMemory | None
    begun_ns: int = 0
    swept: list[Floats] = field(default_factory=list)
    least: dict[str, Nearest] = field(default_factory=dict)
    held: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.config = replace(self.config, ranges=False)
        self.memory = self.memory or first_memory(self.config)
        self.joints = copy.deepcopy(self.joints)
        self.q, self.T_site_machine = frozen(self.q), frozen(self.T_site_machine, (4, 4))
        self.begun_ns = self.now_ns
        self.swept = [self.q]

    @property
    def t_s(self) -> float:
        """Time since the jobs began [s]."""
        return (self.now_ns - self.begun_ns) * 1e-9

    @property
    def moving(self) -> bool:
        return bool((np.abs(self.joints.velocity) > RESTS).any()) or any(self.memory.valves if self.memory else ())

    def opened(self) -> str:
        """Open the gate if it is closed; return why it cannot be, empty if it is open."""
        assert self.memory is not None
        said = ""
        for tried in count():
            if self.memory.gate.open or tried == OPENING:
                break
            said = _said(self.ticked(Levers(), None, enable=tried > 0))
        self.begun_ns, self.swept = self.now_ns, [self.q]
        self.least.clear()
        return "" if self.memory.gate.open else said

    def ticked(self, levers: Levers, job: Job | None, *, enable: bool = True) -> Trace:
        """Let one tick pass, and the joints follow it."""
        assert self.memory is not None
        now, config = self.now_ns, self.config
        stamp = Stamp(config.machine_id, now, _SOURCE, now)
        inputs = TickInputs(
            now,
            Posture.exact(stamp, self.q),
            MachinePose.exact(stamp, self.T_site_machine),
            Intent(stamp, DriveMode.AUTO if job is not None else DriveMode.JOINT, levers, enable),
            self.scene,
            self.off_states,
            self.let_off,
            job=job,
        )
        _, self.memory, trace = tick(inputs, self.memory, config)
        if trace.clearances is not None:
            self._take(trace.clearances)
        facts = trace.job
        if facts is not None and facts.against is not None and facts.state is not JobState.MOVING:
            self.held[facts.against] = self.held.get(facts.against, 0) + 1
        self.joints.set_valves(trace.valves)
        self.q = frozen(self.joints.advance(config.dt_s, self.q))
        self.now_ns = now + round(config.dt_s * 1e9)
        self.swept.append(self.q)
        return trace

    def _take(self, seen: Clearances) -> None:
        least, t_s = self.least, self.t_s
        for limit, link, metres in zip(
            seen.limits.tolist(), seen.links.tolist(), seen.distances.tolist(), strict=True
        ):
            name = seen.limit_ids[limit]
            before = least.get(name)
            if before is None or metres < before.clearance_m:
                least[name] = Nearest(metres, seen.link_names[link], t_s)

    def told(self, jobs: Sequence[Job], state: JobState, why: str, duration_s: float) -> Preview:
        """Return what has been seen."""
        assert self.memory is not None
        machine, scene = self.config.machine, self.scene
        last = machine.forward(self.q)
        self._take(
            scene.query(
                *(last, self.T_site_machine, self.config.radius_m, self.now_ns, self.off_states, self.let_off)
            )
        )
        swept = np.array(self.swept)
        tools = np.array([machine.tool_pose(machine.forward(one))[:3, 3] for one in swept])
        planned_s = sum(job.trajectory.duration_s for job in jobs if job.trajectory is not None)
        T = self.T_site_machine
        return Preview(
            *(state is JobState.DONE and not why, state, why, duration_s, float(planned_s)),
            MappingProxyType(dict(self.least)),
            tuple(sorted(self.held, key=lambda name: (-self.held[name], name))),
            frozen(np.arange(len(swept)) * self.config.dt_s),
            *(frozen(swept), frozen(tools @ T[:3, :3].T + T[:3, 3])),
            After(self.q, self.memory, self.joints, self.now_ns),
        )


def _said(trace: Trace) -> str:
    """Return what a tick says of a job that goes no further: that it is stuck, or the gravest of its reasons."""
    stuck = [one for one in trace.reasons if one.code is ReasonCode.STUCK]
    found = min(stuck or trace.reasons, key=lambda one: math.inf if one.scale is None else one.scale, default=None)
    return "it goes no further" if found is None else found.text
