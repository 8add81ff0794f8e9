"""What is driven along a plan keeps what the plan does: by a dense search, at narrow corners, near what stops it."""

import itertools
import math
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.motion.looking_ahead import Surroundings
from workgauge.motion.paths.timing import timed_joints
from workgauge.motion.paths.trajectory import Trajectory
from workgauge.motion.plan.global_plan import GlobalPlan, plan_global
from workgauge.motion.plan.rounding import GIVE_M, passable, roundable
from workgauge.motion.plan.validity import PROOF_M
from workgauge.motion.planning import Pace, plan_waypoints
from workgauge.motion.way_round import groupwise, straightened
from workgauge.proximity.scene import Scene
from workgauge.rehearse.cluttered import cluttered
from workgauge.values.arrays import Floats, frozen
from workgauge.values.limits import Limit, LimitKind, Source
from workgauge.values.solids import Box

STOP_M, CLEARANCE_M = 0.2, 0.05
SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


@cache
def machine(name: str = "rre20") -> MachineModel:
    return load_machine(name)


def corners(model: MachineModel, q: Floats) -> Floats:
    poses, halves = model.solid_poses(model.forward(q))
    placed: Floats = SIGNS * halves[:, None, :] @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3]
    return placed


def surplus(around: Surroundings, q: Floats) -> float:
    found = around.scene.query(around.scene.machine.forward(q), around.T_site_machine, 0.8)
    stops = np.where(np.isnan(found.stop_distances), STOP_M, found.stop_distances)
    return float((found.distances - stops).min(initial=np.inf))


def least(around: Surroundings, motion: Callable[[Floats], Floats], spacing_m: float) -> float:
    """What the least clearance has above its stop distance, no corner moving farther than this between two looks."""
    model, count = around.scene.machine, 20
    while True:
        postures = motion(np.linspace(0.0, 1.0, count))
        step = np.linalg.norm(np.diff([corners(model, q) for q in postures], axis=0), axis=-1).max()
        if step <= spacing_m:
            return min(surplus(around, q) for q in postures)
        count = 1 + math.ceil(1.05 * step / spacing_m * (count - 1))


def driven(motion: Trajectory) -> Callable[[Floats], Floats]:
    """The motion by its share of the time."""
    return lambda shares: motion.many(shares * motion.duration_s)[0]


def along(q: Floats) -> Callable[[Floats], Floats]:
    """Straight lines by the share of their number."""
    places = np.arange(len(q)) / (len(q) - 1)
    return lambda shares: np.column_stack([np.interp(shares, places, column) for column in q.T])


@pytest.mark.parametrize(("name", "seed"), [("rre20", 1), ("rre20", 15), ("brokk5", 4)])
def test_what_is_driven_keeps_what_the_plan_does_and_hardly_stops(name: str, seed: int) -> None:
    pytest.importorskip("ompl", reason="the extra `plan` is not installed")
    task = cluttered(machine(name), seed, stop_distance_m=STOP_M)
    around = Surroundings(task.scene, task.T_site_machine, STOP_M)
    plan = plan_global(
        *(task.scene, machine(name), task.T_site_machine, task.q_start, task.q_goal),
        clearance_m=CLEARANCE_M,
        stop_distance_m=STOP_M,
        seed=seed,
        seconds=300.0,
    )
    assert isinstance(plan, GlobalPlan) and len(plan.waypoints) > 2
    motions = plan_waypoints(machine(name), plan.waypoints, Pace(), words="w", kept=roundable(around, CLEARANCE_M))
    ends = [(motion.trajectory.q[0], motion.trajectory.q[-1]) for motion in motions]
    joined = [(plan.waypoints[0],) * 2, *ends, (plan.waypoints[-1],) * 2]
    assert all(one[1] == pytest.approx(other[0], abs=1e-12) for one, other in itertools.pairwise(joined))
    for motion in motions:
        assert least(around, driven(motion.trajectory), 0.005) >= CLEARANCE_M
        moved = np.ptp(motion.trajectory.q, axis=0) > 0.0
        assert sum(bool(moved[list(group)].any()) for group in machine(name).exclusive_groups) <= 1
    sharp = sum(one.trajectory.duration_s for one in plan_waypoints(machine(name), plan.waypoints, Pace(), words="w"))
    assert sum(motion.trajectory.duration_s for motion in motions) < (0.6 if name == "rre20" else 1.0) * sharp


def swung(*degrees: tuple[float, float]) -> Floats:
    """Postures by swing and boom."""
    found = np.tile(machine().home, (len(degrees), 1))
    found[:, :2] = np.radians(degrees)
    return found


def tools(postures: Floats) -> Floats:
    return np.array([machine().tool_pose(machine().forward(q))[:3, 3] for q in postures])


def beside(lines: Floats, curve: Callable[[Floats], Floats], spare_m: float) -> Surroundings:
    """Return a block on that side of the lines to which a curve leaves them most, so near that they just keep it."""
    shares = np.linspace(0.0, 1.0, 400)
    there, here = tools(curve(shares)), tools(along(lines)(shares))
    apart = np.linalg.norm(there[:, None] - here, axis=2)
    most = int(apart.min(axis=1).argmax())
    foot = here[apart[most].argmin()]
    return block(lines, foot, there[most] - foot, spare_m)


def block(lines: Floats, foot: Floats, way: Floats, spare_m: float) -> Surroundings:
    """Return a block that way from a point, so near that lines just keep this much more than they have to."""

    def scene(away: float) -> Surroundings:
        T = np.eye(4)
        T[:3, 3] = foot + away * way / np.linalg.norm(way)
        limit = Limit("b", LimitKind.POINT, "b", Box(frozen(T), frozen([0.03] * 3)), "t", Source("t", "b"))
        return Surroundings(Scene(machine(), [limit]), np.eye(4), STOP_M)

    low, high = 0.2, 3.0
    while high - low > 1e-4:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if least(scene(middle), along(lines), 0.05) > spare_m else (middle, high)
    return scene(high)


def once(q: Floats) -> Callable[[Floats], Floats]:
    """The monotone cubic through postures, by shares of their way in seconds."""
    steps = np.diff(q, axis=0)
    legs = np.maximum(steps / machine().speed_positive, -steps / machine().speed_negative).max(axis=1)
    s = np.concatenate([[0.0], np.cumsum(legs)])
    curve = PchipInterpolator(s, q)
    return lambda shares: np.asarray(curve(shares * s[-1]))


NARROW = swung((-50.0, 20.0), (-10.0, 22.0), (0.0, 45.0))
DOWN = swung((-50.0, 47.0), (-10.0, 45.0), (0.0, 20.0))


@pytest.mark.parametrize("curve", ["through the corner", "round the whole corner"])
def test_a_narrow_corner_is_rounded_no_farther_than_there_is_room(curve: str) -> None:
    spare_m = CLEARANCE_M + PROOF_M + 0.003
    lines = NARROW if curve == "through the corner" else DOWN
    whole = timed_joints(lines, machine(), kept=lambda a, corner, b: True)
    if curve == "through the corner":
        wild = once(lines)
        around = beside(lines, wild, spare_m)
    else:
        wild, inside = driven(whole), np.array([0.0, -1.0, -1.0])
        around = block(lines, tools(lines[1:2])[0], inside, spare_m)
    assert least(around, along(lines), 0.005) > CLEARANCE_M + PROOF_M
    assert least(around, wild, 0.005) < CLEARANCE_M - 0.01
    motion = timed_joints(lines, machine(), kept=roundable(around, CLEARANCE_M))
    assert least(around, driven(motion), 0.005) >= CLEARANCE_M
    sharp = timed_joints(lines, machine())
    assert whole.duration_s <= motion.duration_s <= sharp.duration_s
    assert (motion.duration_s > 1.001 * whole.duration_s) == (curve == "round the whole corner")


def test_a_corner_with_no_room_to_either_side_is_stopped_at() -> None:
    asked = []

    def never(a: Floats, corner: Floats, b: Floats) -> bool:
        asked.append((a, corner, b))
        return False

    motion = timed_joints(NARROW, machine(), kept=never)
    q, qdot, _ = motion.at(motion.time_of(float(motion.curve.s[1])))
    assert q == pytest.approx(NARROW[1], abs=1e-9) and np.abs(qdot).max() < 1e-6
    reached = [np.abs(a - corner).max() for a, corner, _ in asked]
    assert len(reached) > 3 and reached == sorted(reached, reverse=True)
    assert all(np.array_equal(corner, NARROW[1]) for _, corner, _ in asked)


def test_where_there_is_less_room_than_a_plan_keeps_what_there_is_is_kept() -> None:
    curve = driven(timed_joints(NARROW, machine(), kept=lambda a, corner, b: True))
    around = beside(NARROW, curve, 0.01)
    there = min(surplus(around, q) for q in along(NARROW)(np.linspace(0.0, 1.0, 400)))
    assert there < CLEARANCE_M
    motion = timed_joints(NARROW, machine(), kept=roundable(around, CLEARANCE_M))
    assert least(around, driven(motion), 0.005) >= there - PROOF_M - GIVE_M - 1e-6
    line = passable(around, CLEARANCE_M)
    for a, b in itertools.pairwise(along(NARROW)(np.linspace(0.0, 1.0, 9))):
        if line(a, b):
            ends = min(surplus(around, a), surplus(around, b), CLEARANCE_M)
            assert least(around, along(np.array([a, b])), 0.005) >= ends - PROOF_M - GIVE_M - 1e-6


def test_the_way_back_leaves_out_what_a_proven_line_goes_past_and_nothing_else() -> None:
    postures = along(NARROW)(np.linspace(0.0, 1.0, 41))
    free = straightened(machine(), postures, lambda a, b: True)
    assert np.array_equal(free[[0, -1]], postures[[0, -1]]) and len(free) <= 4
    assert np.array_equal(straightened(machine(), postures, lambda a, b: False), postures)
    around = beside(NARROW, lambda shares: along(NARROW[[0, 2]])(shares), 0.02)
    kept = passable(around, CLEARANCE_M)
    out = straightened(machine(), postures, kept)
    assert 2 < len(out) < len(postures)
    there = min(surplus(around, q) for q in postures)
    assert least(around, along(out), 0.005) >= there - PROOF_M - GIVE_M - 1e-6
    groups = machine("brokk5").exclusive_groups
    q = np.tile(machine("brokk5").home, (3, 1))
    q[1:, groups[0][0]] += 0.1
    q[2, groups[1][0]] += 0.1
    assert len(straightened(machine("brokk5"), q, lambda a, b: True)) == 3


@pytest.mark.parametrize("name", ["rre20", "brokk5"])
@pytest.mark.parametrize("aside", [0.0, 1e-12, 1e-3])
def test_a_way_that_turns_back_stops_where_it_does(name: str, aside: float) -> None:
    machine = load_machine(name)
    q = np.array([machine.home] * 4)
    q[1:, 1] += 0.1
    q[2:, 1] += 0.05  # straight on
    q[3, 1] -= 0.26
    q[3, 2 if name == "rre20" else 1] += aside
    found = timed_joints(q, machine, kept=lambda *_: True)
    slowest = min(float(np.abs(found.at(t)[1]).max()) for t in np.linspace(0.1, found.duration_s - 0.1, 400))
    turn = min(np.linspace(0.0, found.duration_s, 4000), key=lambda t: -found.at(t)[0][1])
    assert found.at(turn)[0][1] == pytest.approx(q[2, 1], abs=1e-4) and slowest < 0.05
    assert found.at(found.duration_s)[0] == pytest.approx(q[3], abs=1e-9)


def test_what_hardly_moved_is_no_motion_of_a_group() -> None:
    machine = load_machine("brokk5")
    group, other = (list(one) for one in machine.exclusive_groups)
    q = np.array([machine.home] * 4)
    q[1:, group[0]] += 0.1
    q[1:, other[0]] += 1e-9  # what a simulated joint creeps
    q[2] = q[1] + 1e-10
    q[3, group[0]] += 0.2
    found = groupwise(machine, q)
    moves = np.abs(np.diff(found, axis=0)) > 0.0
    assert len(found) == 3 and not moves[:, other].any() and moves[:, group].any(axis=1).all()
    assert found[-1] == pytest.approx(q[-1], abs=1e-6)
    q[3, other[0]] += 0.05
    assert len(groupwise(machine, q)) == 4
