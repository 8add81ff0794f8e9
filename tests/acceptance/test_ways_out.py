"""Out of limits one is inside of: from random starts in one or two of them, driven by the tick, judged from outside.

The judge uses nothing of the guard: clearances are those of `Scene.query`, a way is sought by linear programmes over
their rows, and believed only if the arm, put a little along it, is better off by `Scene.query` too.
"""

import copy
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from workgauge.guard.exit import Pinned
from workgauge.guard.registry import guard_named
from workgauge.loop.config import search_radius_m, tick_config
from workgauge.loop.inputs import TickInputs
from workgauge.loop.memory import first_memory
from workgauge.loop.tick import tick
from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.proximity.scene import Scene
from workgauge.rehearse.drives.dynamics import IDEAL, Dynamics, believed_machine, true_hydraulics
from workgauge.sim.joints import HydraulicJoints
from workgauge.values.arrays import Floats, frozen, frozen_ints
from workgauge.values.limits import Activity, Limit, LimitKind, Source
from workgauge.values.measurements import DriveMode, Intent, Levers, MachinePose, Posture, Stamp
from workgauge.values.solids import Box, Convex, PrismChain, Solid, Tube
from workgauge.values.transforms import rpy

DT_S = 0.04
STOP_M = 0.2
#: A drive out ends after this time, or when nothing has moved for this time [s].
LONGEST_S, STILL_S = 40.0, 1.5
#: A violated clearance may fall by so much from tick to tick, and in all: rounding, valves in whole steps [m].
PER_TICK_M, IN_ALL_M = 1e-4, 2e-3
#: The guard keeps 8 mm besides the stop distance, where this judge keeps none: what is nearer may not come nearer
#: for the guard either, and 1 mm more it approaches ever more slowly. With 6, ways through its margin count [m].
IN_THE_WAY_M = 0.009
#: A way that gains less than this, all violated clearances together, is none [m/s].
LEAST_GAIN_M_S = 2e-3
#: A way that leads no farther than this is none: where two corners are about as deep, a turn helps one so far [m].
FAR_ENOUGH_M = 5e-3
MACHINES = ("rre20", "brokk5", "sun-a")
#: Share of starts at whose end the machine stands still though the search finds a way, or without being said pinned:
#: measured, 1 of 200 (a way beside a limit nearer than the guard's margin), so none in a run of 40.
UNRESOLVED_SHARE = 0.01
#: A moving start is driven about for so long with its limits off [s].
ABOUT_S = 0.6
#: A joint nearer than this to its end is at it [rad, m].
AT_END = 5e-3
LATE = Dynamics(dead_time_s=0.3, lag_s=0.2, stop_s=0.6)


@dataclass(frozen=True)
class Start:
    """A machine at rest, and limits that come to count around its arm."""

    seed: int
    machine: MachineModel
    T: Floats
    q: Floats
    limits: tuple[Limit, ...]
    hydraulics: Any
    kinds: tuple[str, ...]
    moving: bool = False

    def scene(self) -> Scene:
        return Scene(self.machine, self.limits)


def hull(points: Floats) -> Convex:
    found = ConvexHull(points)
    kept = np.unique(found.simplices)
    faces, vertices = np.searchsorted(kept, found.simplices), points[kept]
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), found.equations[:, :3]) < 0.0
    return Convex(frozen(vertices), frozen_ints(np.where(inwards[:, None], faces[:, ::-1], faces)))


def solid_at(rng: Any, kind: str, place: Floats, size: float) -> Solid:
    """Return a solid of a kind, its middle somewhere near a place."""
    if kind == "box":
        T = rpy(*rng.uniform(-math.pi, math.pi, 3).tolist())
        T[:3, 3] = place
        return Box(frozen(T), frozen(size * rng.uniform(0.1, 1.2, 3)))
    if kind == "body":
        return hull(place + size * rng.uniform(0.3, 0.9) * rng.normal(size=(14, 3)))
    if kind == "tube":
        steps = size * rng.normal(scale=(2.0, 2.0, 0.6), size=(int(rng.integers(1, 4)), 3))
        axis = np.concatenate([[np.zeros(3)], np.cumsum(steps, axis=0)])
        return Tube(frozen(axis - axis[len(axis) // 2] + place), float(size * rng.uniform(0.05, 0.5)))
    cells, angle = int(rng.integers(2, 9)), rng.uniform(-math.pi, math.pi)
    along = np.linspace(-1.0, 1.0, cells + 1) * size * 1.25 * cells
    across = 0.5 * rng.uniform(-1.0, 1.0) / (60.0 * size) * along * along
    c, s = math.cos(angle), math.sin(angle)
    axis = place + np.column_stack([along * c - across * s, along * s + across * c, rng.uniform(-0.03, 0.03) * along])
    run = np.diff(axis, axis=0)
    laterals = np.column_stack([-run[:, 1], run[:, 0], np.zeros(cells)])
    laterals /= np.linalg.norm(laterals, axis=1)[:, None]
    half = size * rng.uniform(0.5, 1.2) * np.array([[0.8, -1.0], [1.0, -0.6], [1.0, 0.6], [0.5, 1.2]])
    section = np.concatenate([half, half[::-1] * [-1.0, 1.0]])
    joined = np.ones((cells, 2), dtype=np.bool_)
    joined[0, 0] = joined[-1, 1] = False
    sections = frozen(np.repeat(section[None], cells, axis=0))
    chainages = frozen(np.column_stack([along[:-1], along[1:]]) - along[0])
    return PrismChain(frozen(axis[:-1]), frozen(axis[1:]), frozen(laterals), sections, chainages, joined)


def moved(solid: Solid, way: Floats) -> Solid:
    match solid:
        case Box():
            T = np.array(solid.T_frame_box)
            T[:3, 3] += way
            return replace(solid, T_frame_box=frozen(T))
        case Convex():
            return replace(solid, vertices=frozen(solid.vertices + way))
        case Tube():
            return replace(solid, axis=frozen(solid.axis + way))
        case PrismChain():
            return replace(solid, starts=frozen(solid.starts + way), ends=frozen(solid.ends + way))
    raise AssertionError


def limit_of(i: int, kind: str, solid: Solid, stop: float | None) -> Limit:
    name = f"{kind} {i}"
    of = LimitKind.TRACK if kind == "chain" else LimitKind.ZONE
    source = Source("test", name)
    return Limit(name, of, name, solid, "test", source, stop_distance_m=stop, activity=Activity(state=f"s{i}"))


def nearest(machine: MachineModel, T: Floats, q: Floats, limit: Limit) -> float:
    """Return the smallest clearance of one limit alone [m]."""
    found = Scene(machine, (limit,)).query(machine.forward(q), T, 30.0)
    of_limit = found.distances[found.other_links < 0]
    return float(of_limit.min(initial=30.0))


def around_at(
    rng: Any, machine: MachineModel, T: Floats, q: Floats, i: int, kind: str, clearance: float, stop: float | None
) -> Limit | None:
    """Return a limit put so that its smallest clearance is as wanted, moved away from somewhere on the arm."""
    size = 0.5 * float(np.clip(np.ptp(machine.tool_pose(machine.forward(q))[:3, 3]), 0.6, 2.0))
    poses, halves = machine.solid_poses(machine.forward(q))
    links = np.array([solid.link for solid in machine.solids])
    s = int(rng.choice(np.flatnonzero(links > 0)))
    inside = poses[s][:3, :3] @ (halves[s] * rng.uniform(-1.0, 1.0, 3)) + poses[s][:3, 3]
    place = T[:3, :3] @ inside + T[:3, 3]
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    solid = solid_at(rng, kind, place, size)
    low, high = 0.0, 40.0
    if nearest(machine, T, q, limit_of(i, kind, solid, stop)) > clearance:
        return None
    for _ in range(24):
        middle = 0.5 * (low + high)
        one = limit_of(i, kind, moved(solid, middle * direction), stop)
        if nearest(machine, T, q, one) < clearance:
            low = middle
        else:
            high = middle
    one = limit_of(i, kind, moved(solid, high * direction), stop)
    return one if abs(nearest(machine, T, q, one) - clearance) < 0.01 else None


def start(seed: int) -> Start:
    """Return a start inside one or two limits, none of them touched by the undercarriage, its own links apart."""
    rng = np.random.default_rng(seed)
    plain = load_machine(MACHINES[seed % 3])
    late = rng.random() < 0.3
    machine = believed_machine(plain, LATE if late else IDEAL, rng)
    spec = true_hydraulics(machine, LATE if late else IDEAL, rng)
    while True:
        T = rpy(*(rng.uniform(-1.0, 1.0, 3) * (0.05, 0.05, math.pi)).tolist())
        T[:3, 3] = rng.uniform(-5.0, 5.0, 3)
        q = frozen(rng.uniform(machine.sample_min, machine.sample_max))
        if (slacks(Scene(machine, ()), machine, T, q)[1] < 0.02).any():
            continue
        wanted, limits = int(rng.integers(1, 3)), []
        for i in range(wanted + int(rng.integers(0, 4))):
            kind = str(rng.choice(["box", "body", "tube", "chain"]))
            stop = float(rng.uniform(0.05, 0.4)) if rng.random() < 0.25 else None
            own = STOP_M if stop is None else stop
            if i >= wanted:
                clearance = own + rng.uniform(0.02, 1.0)
            elif rng.random() < 0.5:
                clearance = own - rng.uniform(0.01, own)
            else:
                clearance = -rng.uniform(0.0, 0.15) if rng.random() < 0.5 else -rng.uniform(0.0, 0.8)
            limits.append(around_at(rng, machine, T, q, i, kind, clearance, stop))
        if any(one is None for one in limits):
            continue
        scene = Scene(machine, limits)
        found, slack = slacks(scene, machine, T, q)
        if len(set(found.limits[slack < 0.0].tolist())) != wanted:
            continue
        if (found.links[slack < 0.0] == 0).any():
            continue
        kinds = tuple(limit.id.split()[0] for limit in limits[:wanted])
        return Start(seed, machine, frozen(T), q, tuple(limits), spec, kinds)


def slacks(scene: Scene, machine: MachineModel, T: Floats, q: Floats, reach_m: float = 3.0) -> tuple[Any, Floats]:
    found = scene.query(machine.forward(q), T, reach_m)
    return found, found.distances - np.where(np.isnan(found.stop_distances), STOP_M, found.stop_distances)


def keyed(found: Any, slack: Floats) -> dict[tuple[int, int], float]:
    """Return slack by (solid, limit or own link); of two own links, the smallest."""
    by: dict[tuple[int, int], float] = {}
    for solid, limit, left in zip(found.solids.tolist(), found.limits.tolist(), slack.tolist(), strict=True):
        by[solid, limit] = min(by.get((solid, limit), math.inf), left)
    return by


def searched(scene: Scene, machine: MachineModel, T: Floats, q: Floats) -> tuple[Floats, float] | None:
    """Return a joint direction (n,) that worsens no violated clearance and improves one, and its gain, or None.

    The programme: the largest growth of all violated together, none shrinking, what is not violated keeping its stop
    distance for a second. Its answer is tried, 5 mm far, with `Scene.query`; where another clearance, corner
    or direction takes over there, that one's row joins the programme.
    """
    for group in machine.exclusive_groups or (tuple(range(machine.n)),):
        shared = [j for j in range(machine.n) if all(j not in one for one in machine.exclusive_groups)]
        free = np.isin(np.arange(machine.n), [*group, *shared])
        high = np.where(free & (q < machine.q_max - AT_END), machine.speed_positive, 0.0)
        low = np.where(free & (q > machine.q_min + AT_END), -machine.speed_negative, 0.0)
        way = _search_in(scene, machine, T, q, low, high)
        if way is not None:
            return way
    return None


def _search_in(
    scene: Scene, machine: MachineModel, T: Floats, q: Floats, low: Floats, high: Floats
) -> tuple[Floats, float] | None:
    found, slack = slacks(scene, machine, T, q)
    at_start = keyed(found, slack)
    rows, floors = machine.distance_rows(machine.forward(q), T, found), floor_of(slack)
    wish = rows[slack < 0.0].sum(axis=0)
    for _ in range(12):
        solved = linprog(-wish, A_ub=-rows, b_ub=-floors, bounds=np.stack([low, high], axis=1), method="highs")
        if solved.status != 0 or -solved.fun < LEAST_GAIN_M_S:
            return None
        step = min(0.05, FAR_ENOUGH_M / max(float(np.abs(rows @ solved.x).max()), 1e-3))
        there = q + step * solved.x
        after, left = slacks(scene, machine, T, there)
        now = keyed(after, left)
        gained = sum(now.get(pair, 3.0) - before for pair, before in at_start.items() if before < 0.0)
        spoilt = [
            pair
            for pair, value in now.items()
            if value < min(at_start.get(pair, 3.0), 0.0) - PER_TICK_M
            or (0.0 <= at_start.get(pair, 3.0) < IN_THE_WAY_M and value < at_start[pair] - PER_TICK_M)
        ]
        if not spoilt and gained > 0.25 * LEAST_GAIN_M_S * step and gained > 2.0 * PER_TICK_M:
            return solved.x, float(-solved.fun)
        again = np.array([(s, i) in set(spoilt) for s, i in zip(after.solids, after.limits, strict=True)], dtype=bool)
        if not again.any():
            return None
        rows = np.concatenate([rows, machine.distance_rows(machine.forward(there), T, after)[again]])
        floors = np.concatenate([floors, floor_of(left[again])])
    return None


def floor_of(slack: Floats) -> Floats:
    return -np.where(slack < 0.0, 0.0, np.maximum(slack - IN_THE_WAY_M, 0.0))


@dataclass
class Outcome:
    """What became of a start."""

    seed: int
    kinds: tuple[str, ...]
    machine: str
    way_at_start: bool
    out: bool = False
    way_at_end: bool = False
    pinned: Pinned | None = None
    texts: list[str] = field(default_factory=list)
    worst_tick_m: float = 0.0
    worst_all_m: float = 0.0
    where: str = ""
    end_s: float = 0.0
    left_m: float = 0.0
    q: Any = None
    moving: bool = False

    @property
    def verdict(self) -> str:
        if (self.worst_tick_m > PER_TICK_M and not self.moving) or self.worst_all_m > IN_ALL_M:
            return "worsened"
        if self.out:
            return "out"
        if self.way_at_end:
            return "stuck"
        return "pinned" if self.pinned is not None else "silent"


def coasted(plant: HydraulicJoints, q: Floats, given: Start, scene: Scene) -> dict[tuple[int, int], float]:
    """Return the least slack of every pair on the way to rest if nothing is commanded from now on."""
    plant, lowest = copy.deepcopy(plant), keyed(*slacks(scene, given.machine, given.T, q))
    plant.set_valves([0] * given.machine.n)
    for _ in range(round(2.0 / DT_S)):
        for _ in range(4):
            q = plant.advance(DT_S / 4, q)
        for pair, left in keyed(*slacks(scene, given.machine, given.T, q)).items():
            lowest[pair] = min(lowest.get(pair, math.inf), left)
    return lowest


def driven_out(given: Start, share: float = 1.0) -> Outcome:
    """Drive out by the exit lever through the tick, and watch every clearance.

    A start that is moving drives about first, all joints at once, its limits off; what flies when they are switched
    on may still lead deeper, by so much as it does if nothing is commanded any more.
    """
    machine, scene, T = given.machine, given.scene(), given.T
    guard = guard_named("barrier")
    config = tick_config(
        machine,
        guard,
        machine_id="m",
        dt_s=DT_S,
        radius_m=max(4.0, search_radius_m(guard, given.limits)),
        tool_sigma_m=0.0,
    )
    memory, plant, q = first_memory(config), HydraulicJoints(machine, given.hydraulics), np.array(given.q)
    outcome = Outcome(given.seed, given.kinds, machine.name, searched(scene, machine, T, q) is not None)
    outcome.moving = given.moving
    off = frozenset(limit.activity.state for limit in given.limits)
    best: dict[tuple[int, int], float] = {}
    before: dict[tuple[int, int], float] = {}
    still_s, on = 0.0, 2 + (round(ABOUT_S / DT_S) if given.moving else 0)
    about = np.random.default_rng(given.seed + 10_000).uniform(-1.0, 1.0, 6)
    for k in range(round(LONGEST_S / DT_S)):
        if k == on and given.moving:
            best = coasted(plant, q, given, scene)
            before = dict(best)
        now = round(k * DT_S * 1e9)
        stamp = Stamp("m", now, "test", now)
        intent = Intent(stamp, DriveMode.EXIT, Levers(right_y=share if k >= on else 0.0), k > 0)
        if 1 < k < on:
            intent = Intent(stamp, DriveMode.JOINT, Levers(*about.tolist()), enable=True)
        inputs = TickInputs(
            now, Posture.exact(stamp, q), MachinePose.exact(stamp, T), intent, scene, off if k < on else frozenset()
        )
        _, memory, trace = tick(inputs, memory, config)
        plant.set_valves(memory.valves)
        for _ in range(4):
            q = plant.advance(DT_S / 4, q)
        found, slack = slacks(scene, machine, T, q)
        if k < on and given.moving:
            continue
        by = keyed(found, slack)
        for pair, left in by.items():
            fell, fell_all = min(before.get(pair, left), 0.0) - left, min(best.get(pair, left), 0.0) - left
            if fell > outcome.worst_tick_m:
                outcome.worst_tick_m, outcome.where = (
                    fell,
                    f"{machine.solids[pair[0]].name} {found.limit_ids[pair[1]]} t={k * DT_S:.2f}",
                )
            outcome.worst_all_m = max(outcome.worst_all_m, fell_all)
            if not given.moving:
                best[pair] = max(best.get(pair, -math.inf), left)
        before = before if given.moving else by
        still_s = 0.0 if any(memory.valves) or np.abs(plant.velocity).max() > 1e-4 else still_s + DT_S
        outcome.left_m = float(slack.min(initial=1.0))
        if still_s > STILL_S or (outcome.left_m >= 0.0 and still_s > 0.2):
            break
    outcome.end_s, outcome.q = k * DT_S, q
    outcome.out = outcome.left_m >= 0.0
    outcome.texts = [f"{one.code}: {one.text}" for one in trace.reasons]
    outcome.pinned = trace.exit if isinstance(trace.exit, Pinned) else None
    outcome.way_at_end = not outcome.out and searched(scene, machine, T, q) is not None
    return outcome


def judged(outcomes: list[Outcome]) -> Counter[str]:
    """Return how many came out, were pinned, stood still without a way or with one, or worsened."""
    for one in outcomes:
        if one.verdict in ("worsened", "stuck"):
            where = f"{one.worst_all_m * 1e3:.2f} mm at {one.where}" if one.verdict == "worsened" else one.texts
            print(one.seed, one.machine, one.kinds, one.verdict, f"{one.left_m:.3f} m", where)
    return Counter(one.verdict for one in outcomes)


def moving(seed: int) -> Start:
    """Return a start with joints that stop late, and that move when its limits come to count."""
    found = start(seed)
    rng = np.random.default_rng(seed)
    machine = believed_machine(load_machine(MACHINES[seed % 3]), LATE, rng)
    return replace(found, machine=machine, hydraulics=true_hydraulics(machine, LATE, rng), moving=True)


def check(seeds: range, starting: Callable[[int], Start] = start) -> None:
    outcomes = [driven_out(starting(seed)) for seed in seeds]
    tally = judged(outcomes)
    print(dict(tally))
    for one in outcomes:
        assert one.verdict != "worsened", (one.seed, one.where)
        if not one.out:
            assert any(text.startswith(("pinned", "way_out")) for text in one.texts), one
        if one.verdict == "pinned":
            assert one.pinned is not None
            named = [limit for limit in start(one.seed).limits if any(limit.id in text for text in one.texts)]
            assert named
    assert tally["stuck"] + tally["silent"] <= UNRESOLVED_SHARE * len(seeds), tally
    assert tally["out"] >= 0.5 * len(seeds)


def test_out_of_one_or_two_limits_without_any_of_them_worsening() -> None:
    check(range(12))


def test_what_flies_when_a_limit_is_switched_on_leads_no_deeper_than_it_must() -> None:
    check(range(200, 204), moving)


@pytest.mark.prove
def test_out_of_one_or_two_limits_without_any_of_them_worsening_a_thousand_times() -> None:
    check(range(1000))


@pytest.mark.prove
def test_what_flies_when_a_limit_is_switched_on_leads_no_deeper_than_it_must_three_hundred_times() -> None:
    check(range(200, 500), moving)
