"""Global plans: valid by a dense search, the same for a seed, round what is in the way, or a true why."""

import itertools
import math
import sys
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest

from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.motion.plan import global_plan
from workgauge.motion.plan.global_plan import GlobalPlan, NoPlan, NoPlanReason, plan_global
from workgauge.motion.plan.shortening import duration_s
from workgauge.proximity.scene import Scene
from workgauge.rehearse.cluttered import Cluttered, cluttered
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import InputError
from workgauge.values.limits import Limit, LimitKind, Source
from workgauge.values.solids import Box

pytest.importorskip("ompl", reason="the extra `plan` is not installed")

STOP_M, CLEARANCE_M = 0.2, 0.05
SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


def drawn(name: str, seed: int) -> Cluttered:
    return cluttered(machine(name), seed, stop_distance_m=STOP_M)


@cache
def machine(name: str) -> MachineModel:
    return load_machine(name)


def planned(task: Cluttered, **more: Any) -> GlobalPlan | NoPlan:
    given: dict[str, Any] = {"clearance_m": CLEARANCE_M, "stop_distance_m": STOP_M, "seconds": 300.0} | more
    return plan_global(task.scene, task.scene.machine, task.T_site_machine, task.q_start, task.q_goal, **given)


def corners(model: MachineModel, q: Floats) -> Floats:
    """Every corner of the machine's boxes, straight from its kinematics."""
    poses, halves = model.solid_poses(model.forward(q))
    placed: Floats = SIGNS * halves[:, None, :] @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3]
    return placed


def least_surplus(scene: Scene, T: Floats, lines: Floats, spacing_m: float) -> float:
    """What the least clearance has above its stop distance, at postures no corner is farther apart in than this."""
    model, least = scene.machine, np.inf
    for a, b in itertools.pairwise(lines):
        shares = [0.0, 1.0]
        while True:
            places = np.array([corners(model, a + share * (b - a)) for share in shares])
            step = float(np.linalg.norm(np.diff(places, axis=0), axis=-1).max())
            if step <= spacing_m:
                break
            shares = np.linspace(0.0, 1.0, 1 + math.ceil(1.05 * step / spacing_m * (len(shares) - 1))).tolist()
        for share in shares:
            found = scene.query(model.forward(a + share * (b - a)), T, 0.6)
            stops = np.where(np.isnan(found.stop_distances), STOP_M, found.stop_distances)
            least = min(least, float((found.distances - stops).min(initial=np.inf)))
    return least


def check(task: Cluttered, plan: GlobalPlan, spacing_m: float) -> None:
    """A plan ends where it should, keeps joint limits and clearances, and moves one group of joints at a time."""
    model, lines = task.scene.machine, plan.waypoints
    assert np.array_equal(lines[0], task.q_start)
    off = lines[-1] - task.q_goal
    assert np.abs(np.where(model.continuous, np.sin(off / 2.0), off)).max() < 1e-12
    assert (lines >= model.q_min).all() and (lines <= model.q_max).all()
    for leg in np.diff(lines, axis=0):
        assert sum(bool(leg[list(group)].any()) for group in model.exclusive_groups) <= 1
    middle = lines[plan.leaving : len(lines) - plan.arriving]
    assert least_surplus(task.scene, task.T_site_machine, middle, spacing_m) >= CLEARANCE_M
    assert plan.duration_s == duration_s(model, list(lines))
    for limit, smallest in plan.smallest.items():
        found = task.scene.query(model.forward(lines[0]), task.T_site_machine, 3.0)
        at_start = found.distances[[found.limit_ids[i] == limit for i in found.limits.tolist()]]
        assert smallest <= at_start.min(initial=np.inf) + 1e-12


@pytest.mark.parametrize(("name", "seed"), [("rre20", 1), ("brokk5", 4)])
def test_plans_are_valid_under_a_dense_search_and_the_same_for_a_seed(name: str, seed: int) -> None:
    task = drawn(name, seed)
    plan, again = planned(task), planned(task)
    assert isinstance(plan, GlobalPlan) and isinstance(again, GlobalPlan) and not plan.hurried
    check(task, plan, 0.02)
    assert plan.waypoints.tobytes() == again.waypoints.tobytes()
    assert (plan.smallest, plan.looks) == (again.smallest, again.looks)


@pytest.mark.prove
@pytest.mark.parametrize("name", ["rre20", "brokk5"])
def test_every_plan_of_many_scenes_is_valid_under_a_dense_search(name: str) -> None:
    found = 0
    for seed in range(60):
        task = drawn(name, seed)
        plan = planned(task)
        if isinstance(plan, GlobalPlan):
            found += 1
            check(task, plan, 0.001)
    assert found >= 50


def box(name: str, middle: list[float], half: list[float]) -> Limit:
    T = np.eye(4)
    T[:3, 3] = middle
    return Limit(name, LimitKind.POINT, name.title(), Box(frozen(T), frozen(half)), "t", Source("t", name))


def posture(**degrees: float) -> Floats:
    model = machine("rre20")
    q = np.array(model.home)
    for name, value in degrees.items():
        q[model.joint_names.index(name)] = math.radians(value)
    return frozen(q)


def task_of(limits: list[Limit], q_start: Floats, q_goal: Floats) -> Cluttered:
    return Cluttered(0, Scene(machine("rre20"), limits), np.eye(4), q_start, q_goal, np.eye(4))


def pole(reach: float = 5.5) -> Limit:
    return box("pole", [reach, 0.0, 3.0], [0.15, 0.15, 5.0])


@pytest.mark.parametrize("turns", [0, 3])
def test_it_goes_round_a_pole_between_start_and_goal_by_the_shorter_way(turns: int) -> None:
    start, goal = posture(swing=-50.0), posture(swing=50.0 + 360.0 * turns)
    task = task_of([pole()], start, goal)
    straight = least_surplus(task.scene, np.eye(4), np.array([start, posture(swing=50.0)]), 0.05)
    assert straight < 0.0
    plan = planned(task)
    assert isinstance(plan, GlobalPlan)
    check(task, plan, 0.02)
    assert np.ptp(plan.waypoints[:, 0]) < 2.0 * math.pi
    free = planned(task_of([], start, goal))
    assert isinstance(free, GlobalPlan) and len(free.waypoints) == 2
    assert free.duration_s < plan.duration_s < 4.0 * free.duration_s


def test_of_several_goals_the_nearest_that_can_be_reached_is_taken() -> None:
    near, far, never = posture(swing=20.0), posture(swing=50.0), posture(swing=0.0)
    beyond = posture(swing=10.0, boom=89.0)
    task = task_of([pole()], posture(swing=40.0), near)
    more = {"clearance_m": CLEARANCE_M, "stop_distance_m": STOP_M}
    goals = [never, beyond, far, near]
    plan = plan_global(task.scene, task.scene.machine, np.eye(4), posture(swing=48.0), goals, **more)
    assert isinstance(plan, GlobalPlan) and plan.goal == 2


def test_inside_at_the_start_or_the_goal_says_of_what_which_link_and_how_near() -> None:
    clear, inside = posture(swing=60.0), posture(swing=0.0)
    for task, reason in (
        (task_of([pole()], inside, clear), NoPlanReason.START_INSIDE),
        (task_of([pole()], clear, inside), NoPlanReason.GOAL_INSIDE),
    ):
        found = planned(task)
        assert isinstance(found, NoPlan) and found.reason is reason and found.limit == "pole"
        clearances = task.scene.query(machine("rre20").forward(inside), np.eye(4), 1.0)
        worst = int(np.argmin(clearances.distances))
        assert found.distance_m == clearances.distances[worst]
        assert found.link == machine("rre20").link_names[clearances.links[worst]]
        assert found.link in found.why and "Pole" in found.why and f"{found.distance_m:.3f} m" in found.why


def test_no_goal_within_the_joint_limits() -> None:
    found = planned(task_of([], posture(swing=0.0), posture(boom=80.0)))
    assert isinstance(found, NoPlan) and found.reason is NoPlanReason.NO_GOAL


def near_pole(left: float) -> Floats:
    """A posture that leaves so much above the stop distance of the pole, on its left."""
    scene = Scene(machine("rre20"), [pole()])
    low, high = 5.0, 60.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        found = scene.query(machine("rre20").forward(posture(swing=middle)), np.eye(4), 10.0)
        distance = float(found.distances[found.limits == 0].min())
        low, high = (middle, high) if distance - STOP_M < left else (low, middle)
    return posture(swing=high)


@pytest.mark.parametrize("ends", ["start", "goal", "both"])
def test_what_a_guard_stopped_at_its_stop_distance_is_left_without_coming_nearer(ends: str) -> None:
    at, clear = near_pole(0.002), posture(swing=-70.0)
    start, goal = (at if ends in ("start", "both") else clear), (at if ends in ("goal", "both") else clear)
    if ends == "both":
        goal = near_pole(0.03)
    task = task_of([pole()], start, goal)
    plan = planned(task)
    assert isinstance(plan, GlobalPlan)
    assert (plan.leaving > 0, plan.arriving > 0) == (ends != "goal", ends != "start")
    check(task, plan, 0.02)
    leaving, arriving = plan.waypoints[: plan.leaving + 1], plan.waypoints[len(plan.waypoints) - 1 - plan.arriving :]
    for part in (leaving, arriving):
        if len(part) > 1:
            assert least_surplus(task.scene, np.eye(4), part, 0.0005) >= 0.002 - 0.001
    surplus = [least_surplus(task.scene, np.eye(4), np.array([q, q]), 1.0) for q in leaving]
    assert all(later > before for before, later in itertools.pairwise(surplus))


def test_pinned_between_two_walls_nothing_makes_room() -> None:
    walls = [box(name, [6.0, y, 3.0], [6.0, 0.1, 12.0]) for name, y in (("left", 1.75), ("right", -1.75))]
    model = machine("rre20")
    found = Scene(model, walls).query(model.forward(posture(swing=0.0)), np.eye(4), 5.0)
    room = float(found.distances[found.other_links < 0].min())
    assert room > 0.0
    wide = task_of(walls, posture(swing=0.0), posture(swing=120.0))
    found_plan = planned(wide, stop_distance_m=room - 0.01, clearance_m=0.4)
    assert isinstance(found_plan, NoPlan) and found_plan.reason is NoPlanReason.START_PINNED
    assert found_plan.distance_m == pytest.approx(room) and "no small motion" in found_plan.why


def boxed_in(monkeypatch: pytest.MonkeyPatch) -> Cluttered:
    """Walls beside the machine that leave no way round, and few looks to find none."""
    monkeypatch.setattr(global_plan, "LOOKS", 1500)
    walls = [box(name, [0.0, y, 3.0], [30.0, 0.1, 12.0]) for name, y in (("left", 3.0), ("right", -3.0))]
    return task_of(walls, posture(swing=0.0, boom=40.0), posture(swing=180.0, boom=40.0))


def test_not_found_is_said_to_be_no_proof(monkeypatch: pytest.MonkeyPatch) -> None:
    task = boxed_in(monkeypatch)
    found, again = planned(task), planned(task)
    assert isinstance(found, NoPlan) and found.reason is NoPlanReason.NOT_FOUND and found == again
    assert "no proof" in found.why and 1500 <= found.looks < 1700
    late = planned(task, seconds=1e-3)
    assert isinstance(late, NoPlan) and late.reason is NoPlanReason.NOT_FOUND and "0.001 s" in late.why


def test_progress_is_told_and_a_cancel_obeyed(monkeypatch: pytest.MonkeyPatch) -> None:
    task, told = boxed_in(monkeypatch), list[tuple[float, str]]()
    found = planned(task, progress=lambda share, words: told.append((share, words)), cancelled=lambda: len(told) >= 3)
    assert isinstance(found, NoPlan) and found.reason is NoPlanReason.CANCELLED and len(told) == 3
    shares = [share for share, _ in told]
    assert shares == sorted(shares) and shares[0] >= 0.0 and shares[-1] <= 1.0 and all(words for _, words in told)
    with pytest.raises(ZeroDivisionError):
        planned(task, progress=lambda share, words: told.append((1 / 0, words)))


BAD: list[tuple[str, Callable[[Floats], dict[str, Any]]]] = [
    ("q_start", lambda q: {"q_start": q * np.nan}),
    ("q_start", lambda q: {"q_start": q[:-1]}),
    ("goals", lambda q: {"goals": [q, q + np.inf]}),
    ("goals", lambda q: {"goals": np.empty((0, 6))}),
    ("clearance_m", lambda q: {"clearance_m": -0.1}),
    ("stop_distance_m", lambda q: {"stop_distance_m": math.nan}),
    ("seconds", lambda q: {"seconds": 0.0}),
]


@pytest.mark.parametrize(("element", "wrong"), BAD)
def test_bad_input_is_refused(element: str, wrong: Callable[[Floats], dict[str, Any]]) -> None:
    q, model = posture(swing=0.0), machine("rre20")
    given: dict[str, Any] = {"q_start": q, "goals": [q], "clearance_m": 0.05, "stop_distance_m": 0.2, "seconds": 5.0}
    with pytest.raises(InputError) as refused:
        plan_global(Scene(model, []), model, np.eye(4), **(given | wrong(q)))
    assert refused.value.element == element


def test_without_ompl_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ompl", None)
    with pytest.raises(InputError, match=r"workgauge\[plan\]"):
        planned(task_of([], posture(swing=0.0), posture(swing=10.0)))


def test_moving_corners_off_comes_to_an_end_where_each_brings_new_ones() -> None:
    """Of joints that cannot move together a corner that is moved needs others beside it."""
    plan = planned(drawn("brokk5", 16), seed=16)
    assert isinstance(plan, GlobalPlan) and not plan.hurried
    assert len(plan.waypoints) < 200 and plan.looks < 30_000
