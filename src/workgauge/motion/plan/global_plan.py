"""A plan through joint space from a posture to a goal, round every limit and the machine itself."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from workgauge.machine.model import MachineModel
from workgauge.motion.plan.exploring import explore, ompl_modules
from workgauge.motion.plan.leaving import leave
from workgauge.motion.plan.shortening import duration_s, joined, proven, shorten, smooth, widen
from workgauge.motion.plan.validity import Need, Validity
from workgauge.proximity.scene import Scene
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import InputError

#: Postures looked at in all, and for shortening each of the ways found: the bound, whatever the clock says.
LOOKS, SHORTENING_LOOKS = 150_000, 6_000
#: Ways looked for; the quickest is kept. Others than the first may cost as many looks as the first did, and so many.
WAYS, OTHER_LOOKS = 3, 3_000
#: A start or goal may be nearer than its stop distance by this: a guard that holds it there leaves as much [m].
INSIDE_M = 0.01
#: The smallest clearances are taken at postures no point of the machine is farther apart in than this [m].
SAMPLED_M = 0.02
#: Progress is told after so many looks.
_TOLD = 250


class NoPlanReason(StrEnum):
    """Why there is no plan."""

    START_INSIDE = "start inside"  #: nearer to something than its stop distance
    GOAL_INSIDE = "goal inside"  #: every goal posture is
    START_PINNED = "start pinned"  #: nearer than a plan keeps, and no small motion makes room
    GOAL_PINNED = "goal pinned"  #: so is every goal posture
    NO_GOAL = "no goal"  #: no goal posture within the joint limits
    NOT_FOUND = "not found"  #: within the looks or the seconds allowed
    CANCELLED = "cancelled"


@dataclass(frozen=True, slots=True)
class NoPlan:
    """There is no plan.

    Attributes:
        reason: why. why: in words. limit: id of what start or goal is too near to, `self:<link>` for a link. link:
            which link of the machine is. distance_m: how near. looks: postures looked at.
    """

    reason: NoPlanReason
    why: str
    limit: str | None = None
    link: str | None = None
    distance_m: float | None = None
    looks: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class GlobalPlan:
    """A way through joint space, proven to keep every clearance all along its straight lines.

    Attributes:
        waypoints: (k, n) postures from the start to a goal [rad, m]; joints without end count on. Of joints that
            cannot move together each line moves one group.
        goal: which of the goals given it ends at.
        duration_s: at each line's slowest joint's full speed, without stops.
        leaving, arriving: how many of the first and of the last lines only make (give up) room, because the start
            (the goal) is nearer to something than the plan keeps; there, no clearance is less than at that end, by
            more than a millimetre.
        smallest: limit id (`self:<link>` for a link) to the smallest clearance on the way, of those ever seen [m];
            taken every `SAMPLED_M` of motion.
        looks: postures looked at. hurried: whether the seconds ended the shortening: then the same seed may give
            another plan next time.
    """

    waypoints: Floats
    goal: int
    duration_s: float
    leaving: int
    arriving: int
    smallest: dict[str, float]
    looks: int
    hurried: bool


class _Stopped:
    """When to end: enough looks, out of time, or cancelled; tells the progress."""

    def __init__(
        self,
        validity: Validity,
        late: Callable[[], bool],
        cancelled: Callable[[], bool],
        progress: Callable[[float, str], None] | None,
    ) -> None:
        self._validity, self._late, self._cancelled, self._progress = validity, late, cancelled, progress
        self._told = -_TOLD
        self.words, self.until = "looking for a way", LOOKS
        self.cancelled = self.late = False

    def within(self, looks: int, words: str) -> "_Stopped":
        """Allow so many looks more, for what the words say."""
        self.words, self.until = words, self._validity.looks + looks
        return self

    def __call__(self) -> bool:
        looks = self._validity.looks
        if self._progress is not None and looks - self._told >= _TOLD:
            self._told = looks
            self._progress(min(looks / LOOKS, 1.0), self.words)
        self.cancelled = self.cancelled or self._cancelled()
        self.late = self.late or self._late()
        return self.cancelled or self.late or looks >= self.until


def plan_global(
    scene: Scene,
    machine: MachineModel,
    T_site_machine: Floats,
    q_start: ArrayLike,
    goals: ArrayLike,
    *,
    clearance_m: float,
    stop_distance_m: float,
    seed: int = 0,
    seconds: float = 30.0,
    off_states: frozenset[str] = frozenset(),
    let_off: frozenset[str] = frozenset(),
    now_ns: int = 0,
    progress: Callable[[float, str], None] | None = None,
    cancelled: Callable[[], bool] = lambda: False,
) -> GlobalPlan | NoPlan:
    """Return a way from the start to one of the goals that keeps every clearance, or why there is none.

    The straight joint line is taken if it is free; else OMPL's RRT-Connect looks for ways in seconds at full joint
    speed, the ways are shortened, kept off what is near where that is cheap, their corners cut, and every line is
    proven once more (`Validity`). A start or goal nearer than the plan keeps, but not inside, is left (reached) by
    small steps that make room. The limits stand where they are at `now_ns`. The same seed gives the same plan, bit
    for bit, unless the seconds ran out (`hurried`).

    Args:
        scene: the limits, of this machine. T_site_machine: (4, 4), the undercarriage stands still.
        q_start: (n,). goals: (k, n) postures, any of which will do [rad, m].
        clearance_m: kept above every stop distance. stop_distance_m: of limits without one of their own.
        seed: of what is random. seconds: at most, by OMPL's clock.
        off_states, let_off, now_ns: as of `Scene.query`.
        progress: told now and then the share of the looks used, and what is being done.
        cancelled: asked often; True ends the planning.

    Raises:
        InputError: if OMPL is not installed, a number is not finite, or a shape or amount is wrong.
    """
    q_start, goals = _checked(machine, q_start, goals)
    for name, value, fine in (
        ("clearance_m", clearance_m, np.isfinite(clearance_m) and clearance_m >= 0.0),
        ("stop_distance_m", stop_distance_m, np.isfinite(stop_distance_m) and stop_distance_m >= 0.0),
        ("seconds", seconds, np.isfinite(seconds) and seconds > 0.0),
    ):
        if not fine:
            raise InputError("out of range", element=name, value=value, allowed="a finite number, not below 0")
    base = ompl_modules()[0]
    need = Need(clearance_m, stop_distance_m, now_ns, off_states, let_off)
    validity = Validity(scene, T_site_machine, need)
    stop = _Stopped(validity, base.timedPlannerTerminationCondition(float(seconds)), cancelled, progress)
    inside = (goals >= machine.q_min).all(axis=1) & (goals <= machine.q_max).all(axis=1)
    if not inside.any():
        return NoPlan(NoPlanReason.NO_GOAL, "no goal posture is within the joint limits")
    leaving = _clear(validity, q_start, stop, "start")
    if isinstance(leaving, NoPlan):
        return leaving
    arrivals: dict[int, list[Floats]] = {}
    refused: NoPlan | None = None
    for g in np.flatnonzero(inside).tolist():
        arriving = _clear(validity, goals[g], stop, "goal")
        if isinstance(arriving, NoPlan):
            refused = refused or arriving
        else:
            arrivals[g] = arriving[::-1]
    if not arrivals:
        assert refused is not None
        return refused
    way = _way(validity, leaving[-1], arrivals, seed, stop)
    if way is None:
        return _not_found(validity, stop, seconds)
    g, middle = way
    arriving = arrivals[g]
    turned = middle[-1] - arriving[0]  # whole turns of joints without end
    waypoints = np.array([*leaving[:-1], *middle, *(q + turned for q in arriving[1:])])
    return GlobalPlan(
        frozen(waypoints),
        g,
        duration_s(machine, list(waypoints)),
        len(leaving) - 1,
        len(arriving) - 1,
        _smallest(validity, waypoints),
        validity.looks,
        stop.late,
    )


def _checked(machine: MachineModel, q_start: ArrayLike, goals: ArrayLike) -> tuple[Floats, Floats]:
    start, ends = frozen(q_start), frozen(goals)
    ends = ends[None] if ends.ndim == 1 else ends
    for name, value, shape in (("q_start", start, (machine.n,)), ("goals", ends, (len(ends), machine.n))):
        if value.shape != shape or not len(value):
            raise InputError("wrong shape", element=name, value=value.shape, allowed=f"{machine.n} joint positions")
        if not np.isfinite(value).all():
            raise InputError("not finite", element=name, value=value.tolist(), allowed="finite joint positions")
    return start, ends


def _clear(validity: Validity, q: Floats, stop: _Stopped, which: str) -> list[Floats] | NoPlan:
    """Return the way from a start or goal to where a plan may begin, mostly that posture alone."""
    machine, start = validity.machine, which == "start"
    if validity.keeps(q) and (q >= machine.q_min).all() and (q <= machine.q_max).all():
        return [q]
    found = validity.clearances(q)
    surplus = validity.surplus(found) + validity.need.clearance_m
    worst = int(np.argmin(surplus)) if len(found) else -1
    way: list[Floats] | None = None
    if worst < 0 or surplus[worst] >= -INSIDE_M:
        way = leave(validity, q, stop.within(LOOKS, f"making room at the {which}"))
        if way is not None or worst < 0:
            return way or [q]
    limit, link = found.limit_ids[found.limits[worst]], found.link_names[found.links[worst]]
    distance = float(found.distances[worst])
    wanted = distance - float(surplus[worst])
    near = f"{link} is {distance:.3f} m from {_name(validity.scene, limit)}"
    if surplus[worst] < -INSIDE_M:
        reason = NoPlanReason.START_INSIDE if start else NoPlanReason.GOAL_INSIDE
        why = f"the {which} is inside: {near}, whose stop distance is {wanted:.3f} m"
    else:
        reason = NoPlanReason.START_PINNED if start else NoPlanReason.GOAL_PINNED
        kept = wanted + validity.need.clearance_m
        why = f"at the {which}, {near}; a plan keeps {kept:.3f} m, and no small motion makes that room"
    return NoPlan(reason, why, limit, link, distance, validity.looks)


def _name(scene: Scene, limit: str) -> str:
    if limit.startswith("self:"):
        return f"its own {limit.removeprefix('self:')}"
    return next((one.name for one in scene.limits if one.id == limit), limit)


def _way(
    validity: Validity, start: Floats, arrivals: dict[int, list[Floats]], seed: int, stop: _Stopped
) -> tuple[int, list[Floats]] | None:
    """Return the quickest way found from the start to the first posture of one of the arrivals, and which."""
    machine = validity.machine
    ends = {g: _unwound(machine, arrival[0], start) for g, arrival in arrivals.items()}
    for g in sorted(ends, key=lambda g: duration_s(machine, [start, ends[g]])):
        direct = validity.motion(start, ends[g])
        if direct is not None:
            return g, list(direct)
    best: tuple[float, int, list[Floats]] | None = None
    looks = LOOKS
    for turn in range(WAYS):
        before = validity.looks
        stop.within(looks, "looking for a way" if best is None else "looking for a quicker way")
        found = explore(validity, start, list(ends.values()), seed * WAYS + turn, stop)
        if found is None and best is None:
            return None
        if found is not None and not (best is not None and stop()):
            looks = min(validity.looks - before + OTHER_LOOKS, looks)
            way = _polished(validity, found, np.random.default_rng((seed, turn)), stop)
            if way is not None and (best is None or duration_s(machine, way) < best[0]):
                g = min(ends, key=lambda g: float(np.abs(_unwound(machine, ends[g], way[-1]) - way[-1]).max()))
                best = duration_s(machine, way), g, way
        if stop.late or stop.cancelled:
            break
    return None if best is None or stop.cancelled else best[1:]


def _polished(
    validity: Validity, found: Sequence[Floats], rng: np.random.Generator, stop: _Stopped
) -> list[Floats] | None:
    """Return the way shortened, kept off what is near, and smooth, or as much of that as is proven; or None."""
    raw = joined(validity, found)
    if raw is None:
        return None
    way = shorten(validity, raw, rng, stop.within(SHORTENING_LOOKS, "shortening the way"))
    way = widen(validity, way, stop.within(SHORTENING_LOOKS, "keeping off what is near"))
    smoothed = smooth(validity, way, stop.within(SHORTENING_LOOKS, "smoothing the way"))
    return next((one for one in (smoothed, way, raw) if proven(validity, one)), None)


def _unwound(machine: MachineModel, q: Floats, near: Floats) -> Floats:
    """Return posture q with joints without end by whole turns as near to another posture as can be."""
    turns = np.where(machine.continuous, np.round((near - q) / (2.0 * np.pi)), 0.0)
    return np.asarray(q + 2.0 * np.pi * turns)


def _not_found(validity: Validity, stop: _Stopped, seconds: float) -> NoPlan:
    looks = validity.looks
    if stop.cancelled:
        return NoPlan(NoPlanReason.CANCELLED, "cancelled", looks=looks)
    within = f"{seconds:g} s" if stop.late else f"{looks} postures looked at"
    why = f"no way found within {within}; that is no proof that there is none"
    return NoPlan(NoPlanReason.NOT_FOUND, why, looks=looks)


def _smallest(validity: Validity, waypoints: Floats) -> dict[str, float]:
    """Return the smallest clearance to each limit and link at postures all along the way."""
    smallest: dict[str, float] = {}
    farthest = validity.scene.arm.farthest
    for a, b in itertools.pairwise(waypoints):
        count = int(np.ceil(float(farthest @ np.abs(b - a)) / SAMPLED_M)) + 1
        for share in np.linspace(0.0, 1.0, count):
            found = validity.clearances(a + share * (b - a))
            for limit, distance in zip(found.limits.tolist(), found.distances.tolist(), strict=True):
                name = found.limit_ids[limit]
                smallest[name] = min(smallest.get(name, np.inf), distance)
    return smallest
