"""Mäkinen 3.13 to 3.16 as built: the field, what gives way to it, and what holds besides."""

import functools
import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from workgauge.guard.api import GuardInput
from workgauge.guard.giving_way import Variant
from workgauge.guard.hold import held
from workgauge.guard.potential import MAX_REASONS, Points, PotentialGuard
from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.proximity.protection import Integrity
from workgauge.proximity.scene import Scene
from workgauge.proximity.surroundings import Surroundings
from workgauge.proximity.uncertainty import MachineUncertainty
from workgauge.values import transforms as tf
from workgauge.values.arrays import Floats, frozen, frozen_ints
from workgauge.values.clearances import Clearances
from workgauge.values.errors import InputError
from workgauge.values.limits import Limit, LimitKind, Source
from workgauge.values.reasons import ReasonCode
from workgauge.values.solids import Box

DT = 0.02
PRINTED = PotentialGuard(hold=False)
HELD = PotentialGuard()
seeds = st.integers(0, 2**32 - 1)


def situation(desired: Any, distances: Any, rows: Any, **more: Any) -> GuardInput:
    """Clearances of one link to as many limits, joints far from their ends and as quick as one likes."""
    desired = frozen(desired)
    k, n = len(distances), len(desired)
    clearances = Clearances(
        distances=np.array(distances, dtype=float),
        normals=np.zeros((k, 3)),
        points_machine=np.zeros((k, 3)),
        points_limit=np.zeros((k, 3)),
        links=frozen_ints(more.pop("links", np.zeros(k))),
        other_links=frozen_ints(more.pop("other_links", np.full(k, -1))),
        limits=frozen_ints(more.pop("limits", np.arange(k))),
        cells=frozen_ints([-1] * k),
        solids=frozen_ints(np.zeros(k)),
        protections=np.broadcast_to(np.asarray(more.pop("protections", 0.0)), (k,)),
        stop_distances=np.broadcast_to(np.asarray(more.pop("stops", math.nan)), (k,)),
        link_names=("boom", "stick"),
        limit_ids=tuple(f"limit-{i}" for i in range(k)),
        searched_m=10.0,
    )
    values: dict[str, Any] = {
        "desired": desired,
        "q": frozen(np.zeros(n)),
        "q_min": frozen(np.full(n, -np.inf)),
        "q_max": frozen(np.full(n, np.inf)),
        "speed_positive": frozen(np.full(n, 500.0)),
        "speed_negative": frozen(np.full(n, 500.0)),
        "clearances": clearances,
        "rows": np.array(rows, dtype=float).reshape(k, n),
        "dt_s": DT,
        "joint_names": tuple("abcdefg"[:n]),
        "exclusive_groups": (),
        **more,
    }
    return GuardInput(**values)


def added(guard: PotentialGuard, case: GuardInput) -> Floats:
    """What the guard adds to the wish."""
    return guard.allow(case, guard.start())[0].allowed - case.desired


WISH = np.array([0.1, 0.0, 0.0])
ROW = np.array([[4.0, 2.0, 0.5]])


# The field


@settings(max_examples=300, deadline=None)
@given(p=st.floats(-1.0, 3.0), mu=st.floats(0.001, 0.1), reach=st.floats(0.3, 2.0), cap=st.floats(0.1, 5.0))
def test_the_field_is_the_equation_s_up_to_its_cap_and_nothing_beyond_its_reach(
    p: float, mu: float, reach: float, cap: float
) -> None:
    guard = PotentialGuard(mu=mu, slow_distance_m=reach, cap_m_s=cap)
    (speed,) = guard.speed(np.array([p])).tolist()
    if p > reach:
        assert speed == 0.0
    elif p <= 1e-3:
        assert speed == cap
    else:
        assert speed == pytest.approx(min(mu * (1 / p - 1 / reach) * (1 / p**2), cap), rel=1e-9, abs=1e-12)


@settings(max_examples=300, deadline=None)
@given(p=st.floats(-0.5, 1.5), step=st.floats(0.0, 0.01))
def test_the_field_is_continuous_and_falls_with_the_clearance(p: float, step: float) -> None:
    near, far = HELD.speed(np.array([p, p + step])).tolist()
    steepest = 20.0  # where the cap of 1 m/s sets in, at 0.197 m, mu (3 / p^4 - 2 / (p_u p^3)) is 17 1/s
    assert -1e-12 <= near - far <= steepest * step + 1e-12


@settings(max_examples=200, deadline=None)
@given(
    rows=arrays(float, (1, 3), elements=st.floats(-9, 9)),
    p=st.floats(0.05, 1.2),
    wish=arrays(float, 3, elements=st.floats(-1, 1)),
)
def test_a_point_is_driven_along_the_way_out_at_the_field_s_speed(rows: Floats, p: float, wish: Floats) -> None:
    assume(wish.any() and np.linalg.norm(rows) > 0.5)
    push = added(PotentialGuard(hold=False, damping=1e-3), situation(wish, [p], rows))
    assert float(rows[0] @ push) == pytest.approx(float(HELD.speed(np.array([p]))[0]), rel=1e-5, abs=1e-9)
    assert np.linalg.norm(np.cross(push, rows[0])) == pytest.approx(0.0, abs=1e-9)


def test_it_takes_off_what_is_unsure_and_what_a_limit_s_own_stop_distance_says() -> None:
    plain = added(PRINTED, situation(WISH, [0.3], ROW))
    assert plain.any()
    assert added(PRINTED, situation(WISH, [0.4], ROW, protections=0.1)) == pytest.approx(plain)
    assert added(PRINTED, situation(WISH, [0.15], ROW, stops=0.05)) == pytest.approx(plain)
    assert added(PRINTED, situation(WISH, [2.1], ROW, stops=2.0)) == pytest.approx(plain)


def test_own_links_push_like_limits_and_those_of_a_small_machine_in_proportion() -> None:
    plain = added(PRINTED, situation(WISH, [0.3], ROW))
    assert added(PRINTED, situation(WISH, [0.3], ROW, other_links=[1])) == pytest.approx(plain)
    # A quarter of the stop distance: a quarter of the field's reach and speed.
    small = added(PRINTED, situation(WISH, [0.075], ROW, other_links=[1], stops=0.05))
    assert small == pytest.approx(plain / 4)
    assert not added(PRINTED, situation(WISH, [0.201], ROW, other_links=[1], stops=0.05)).any()


def test_one_closest_point_per_link_forgets_the_other_limit() -> None:
    rows = np.array([[4.0, 0.0, 0.0], [0.0, 4.0, 0.0]])
    one, each = PotentialGuard(points=Points.PER_LINK), PotentialGuard()
    near = situation(WISH, [0.30, 0.31], rows)
    assert added(one, near)[1] == 0.0 < added(each, near)[1]
    assert added(one, situation(WISH, [0.30, 0.31], rows, links=[0, 1]))[1] > 0.0
    assert added(one, situation(WISH, [0.31, 0.30], rows))[0] == 0.0


def test_it_leaves_a_machine_alone_that_nobody_moves_and_one_that_is_far() -> None:
    result, memory = HELD.allow(situation(np.zeros(3), [0.1], ROW), HELD.start())
    assert not result.allowed.any() and result.reasons == () and result.scale == 1.0
    assert json.loads(json.dumps(memory)) == memory
    result, _ = HELD.allow(situation(WISH, [0.81], -ROW), HELD.start())
    assert result.allowed.tolist() == WISH.tolist() and result.reasons == () and result.scale == 1.0


# What gives way


@functools.cache
def machine_of(name: str) -> MachineModel:
    return load_machine(name)


def around(scene: Scene) -> Surroundings:
    """Surroundings where everything is known exactly."""
    machine = scene.machine
    unsure = MachineUncertainty.of(np.zeros((6, 6)), np.zeros(machine.n))
    return Surroundings(scene, np.eye(4), unsure, Integrity(5.33), 0.0)


@functools.cache
def empty(name: str) -> Surroundings:
    return around(Scene(machine_of(name), []))


def drawn(seed: int, name: str = "rre20", count: int = 3) -> tuple[GuardInput, Floats]:
    """A machine in a random posture that moves its tool, points of its arm near something; and its Jacobian."""
    machine, rng = machine_of(name), np.random.default_rng(seed)
    q = rng.uniform(machine.sample_min, machine.sample_max)
    kin = machine.forward(q)
    J = machine.tool_jacobian(kin)
    poses, halves = machine.solid_poses(kin)
    solids = rng.choice([i for i, one in enumerate(machine.solids) if one.link >= 2], count)
    places = np.einsum("kij,kj->ki", poses[solids, :3, :3], halves[solids] * rng.uniform(-1, 1, (count, 3)))
    links = [machine.solids[i].link for i in solids]
    ways = rng.normal(size=(count, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    points = machine.point_jacobians(kin, links, places + poses[solids, :3, 3])
    twist = np.append(rng.normal(size=3) * 0.2, rng.normal(size=3) * 0.2)
    case = situation(
        J.T @ np.linalg.solve(J @ J.T + 0.01 * np.eye(6), twist),
        rng.uniform(0.21, 0.7, count),
        np.einsum("ki,kij->kj", ways, points),
        q=frozen(q),
        keep_direction=True,
        around=empty(name),
    )
    return case, J


def far_from_singular(J: Floats) -> bool:
    return bool(np.linalg.svd(J, compute_uv=False)[-1] > 0.1)


@settings(max_examples=200, deadline=None)
@given(seed=seeds, hold=st.booleans())
def test_a_whole_pose_on_six_joints_gives_way_in_position_and_keeps_its_orientation(seed: int, hold: bool) -> None:
    case, J = drawn(seed)
    assume(far_from_singular(J[3:]))
    push = added(PotentialGuard(hold=hold), case)
    assert np.abs(J[3:] @ push).max() < 1e-6
    assert np.linalg.norm(J[:3] @ push) > 1e-6


@settings(max_examples=100, deadline=None)
@given(seed=seeds)
def test_what_the_hold_takes_off_keeps_the_orientation_too(seed: int) -> None:
    """Far stronger than the field, straight at one point's limit: the tool gives way, and is not turned."""
    case, J = drawn(seed, count=1)
    assume(far_from_singular(J))
    N = np.eye(6) - np.linalg.pinv(J[3:]) @ J[3:]
    assume(np.linalg.norm(N @ case.rows[0]) > 0.3)
    wish = -N @ case.rows[0] + np.linalg.pinv(J[3:]) @ [0.1, 0.0, 0.0]
    assume(case.rows[0] @ wish < -1.0)
    case = replace(case, desired=wish, clearances=replace(case.clearances, distances=np.array([0.2])))
    result, _ = PotentialGuard(mu=0.0).allow(case, HELD.start())
    assert float(case.rows[0] @ result.allowed) == pytest.approx(0.0, abs=1e-6)
    assert np.abs(J[3:] @ (result.allowed - wish)).max() < 1e-6
    assert np.linalg.norm(result.allowed) > 1e-3


@settings(max_examples=200, deadline=None)
@given(seed=seeds)
def test_each_point_is_driven_out_as_fast_as_keeping_the_orientation_lets_it(seed: int) -> None:
    """The equation told slowly: `N (u^T J_O N)^+ v` with pseudo-inverses as they are defined."""
    case, J = drawn(seed, count=1)
    assume(far_from_singular(J[3:]))
    guard = PotentialGuard(hold=False, damping=1e-3)
    N = np.eye(6) - np.linalg.pinv(J[3:]) @ J[3:]
    row = case.rows[0] @ N
    assume(np.linalg.norm(row) > 0.3)
    expected = N @ np.linalg.pinv(row[None])[:, 0] * float(guard.speed(case.clearances.distances)[0])
    assert added(guard, case) == pytest.approx(expected, abs=1e-4)
    assert float(case.rows[0] @ added(guard, case)) > 0.0


@settings(max_examples=200, deadline=None)
@given(seed=seeds, count=st.sampled_from([3, 4, 5]), hold=st.booleans())
def test_a_redundant_task_is_left_unchanged(seed: int, count: int, hold: bool) -> None:
    case, J = drawn(seed)
    case = replace(case, task=J[:count], clearances=replace(case.clearances, distances=np.full(3, 0.35)))
    assume(not hold or (case.rows @ case.desired >= -0.15 / DT).all())
    push = added(PotentialGuard(hold=hold), case)
    assert np.abs(J[:count] @ push).max() < 1e-6


def test_as_printed_a_whole_pose_would_avoid_nothing() -> None:
    """Why it is built otherwise: the projector of a square Jacobian is zero."""
    _, J = drawn(3)
    assert far_from_singular(J)
    assert np.abs(np.eye(6) - np.linalg.pinv(J) @ J).max() < 1e-9


@settings(max_examples=100, deadline=None)
@given(seed=seeds)
def test_a_task_that_needs_all_joints_keeps_the_rows_that_turn_the_tool(seed: int) -> None:
    """Position and one angle of a machine of four joints."""
    case, J = drawn(seed, "sun-a")
    turning = J[3:][np.abs(J[3:]).sum(axis=1).argmax()]
    assert np.linalg.norm(turning) > 0.5
    push = added(PRINTED, replace(case, task=np.vstack([J[:3], turning])))
    assert abs(float(turning @ push)) < 1e-6
    assert np.linalg.norm(J[:3] @ push) > 1e-6


@pytest.mark.parametrize("name", ["brokk5", "sun-a"])
def test_fewer_than_six_joints_without_a_task_give_way_as_joints_do(name: str) -> None:
    case, _ = drawn(5, name)
    one_by_one = replace(case, keep_direction=False, around=None)
    assert added(PRINTED, case).any()
    assert np.array_equal(added(PRINTED, case), added(PRINTED, one_by_one))


def test_nobody_who_knows_the_machine_means_that_every_joint_gives_way() -> None:
    case, _ = drawn(5)
    blind = replace(case, around=None)
    assert np.array_equal(added(PRINTED, blind), added(PRINTED, replace(blind, keep_direction=False)))
    assert not np.allclose(added(PRINTED, blind), added(PRINTED, case))


def test_the_document_s_own_variant_turns_the_tool_by_some_four_degrees_a_second() -> None:
    """Points of the tool in random postures, pushed at 0.3 m/s in random directions: a median of 3.8 deg/s."""
    machine, rng = machine_of("rre20"), np.random.default_rng(0)
    guard = PotentialGuard(hold=False, variant=Variant.FIRST_THREE, cap_m_s=0.3, mu=1.0, damping=1e-3)
    kept = replace(guard, variant=Variant.KEEP_ORIENTATION)
    turns = []
    for _ in range(800):
        q = rng.uniform(machine.sample_min, machine.sample_max)
        kin = machine.forward(q)
        J, way = machine.tool_jacobian(kin), rng.normal(size=3)
        row = (way / np.linalg.norm(way)) @ J[:3]
        case = situation(np.full(6, 1e-9), [0.25], row, q=frozen(q), keep_direction=True, around=empty("rre20"))
        push = added(guard, case)
        assert not push[3:].any()
        assert float(row @ push) == pytest.approx(0.3, rel=1e-3)
        turns.append(math.degrees(float(np.linalg.norm(J[3:] @ push))))
        assert math.degrees(float(np.linalg.norm(J[3:] @ added(kept, case)))) < 1e-4
    assert np.median(turns) == pytest.approx(3.8, abs=0.4)


@pytest.mark.parametrize(
    "task", [np.zeros((2, 6)), np.zeros((7, 6)), np.zeros((6, 5)), np.zeros(6), np.full((6, 6), np.nan)]
)
def test_a_task_nobody_can_judge_stops_everything(task: Floats) -> None:
    result, _ = HELD.allow(replace(drawn(1)[0], task=task), HELD.start())
    assert not result.allowed.any() and [one.code for one in result.reasons] == [ReasonCode.INVALID_VALUE]


def test_joints_of_another_group_do_not_give_way() -> None:
    rows = np.array([[4.0, 0.0, 4.0]])
    case = situation([0.0, 0.5, 0.1], [0.3], rows, exclusive_groups=((0,), (1, 2)))
    result, memory = HELD.allow(case, HELD.start())
    assert result.allowed[0] == 0.0 and result.allowed[2] > 0.1
    assert memory == {"group": 1}
    assert ReasonCode.EXCLUSIVE_GROUP not in {one.code for one in result.reasons}


# The hold


@st.composite
def cases(draw: st.DrawFn) -> GuardInput:
    k = draw(st.integers(1, 6))
    return situation(
        draw(arrays(float, 4, elements=st.floats(-1, 1))),
        draw(arrays(float, k, elements=st.floats(-1, 1.5))),
        draw(arrays(float, (k, 4), elements=st.floats(-9, 9))),
        speed_positive=frozen([1.0, 0.4, 0.6, 1.0]),
        speed_negative=frozen([1.0, 0.8, 0.3, 1.0]),
        stops=draw(arrays(float, k, elements=st.sampled_from([np.nan, 0.0, 0.3, 1.5]))),
        keep_direction=draw(st.booleans()),
        dt_s=draw(st.sampled_from([0.005, 0.02, 0.2])),
    )


@settings(max_examples=300, deadline=None)
@given(cases())
def test_no_clearance_loses_in_a_tick_more_than_it_has_above_its_stop_distance(case: GuardInput) -> None:
    result, _ = HELD.allow(case, HELD.start())
    own = case.clearances.stop_distances
    slack = case.clearances.distances - np.where(np.isnan(own), 0.2, own)
    assert (case.rows @ result.allowed * case.dt_s >= -np.maximum(slack, 0.0) - 1e-6).all()


def test_as_printed_a_wish_stronger_than_the_field_goes_on_in() -> None:
    wish = situation([-1.0, 0.0, 0.0], [0.19], ROW)
    assert float(ROW[0] @ PRINTED.allow(wish, PRINTED.start())[0].allowed) < -1.0
    result, _ = HELD.allow(wish, HELD.start())
    assert float(ROW[0] @ result.allowed) == pytest.approx(0.0, abs=1e-7)
    assert [one.code for one in result.reasons] == [ReasonCode.LIMIT_REACHED]


@settings(max_examples=200, deadline=None)
@given(seed=seeds)
def test_the_hold_takes_off_no_more_than_it_must(seed: int) -> None:
    """Of all velocities that hold it is the nearest: the variational inequality, against random ones that hold."""
    rng = np.random.default_rng(seed)
    n, k = int(rng.integers(2, 7)), int(rng.integers(1, 6))
    rows, floors = rng.normal(size=(k, n)), -np.maximum(rng.normal(size=k), 0.0)
    low, high = -rng.uniform(0.0, 2.0, n), rng.uniform(0.0, 2.0, n)
    velocity = rng.uniform(low, high)
    found = held(velocity, rows, floors, low, high, np.eye(n))
    assert (rows @ found >= floors - 1e-6).all() and (found >= low).all() and (found <= high).all()
    for _ in range(50):
        other = rng.uniform(low, high)
        change = rows @ other
        over = change < floors
        other = other * (np.min(floors[over] / change[over]) if over.any() else 1.0)
        assert float((velocity - found) @ (other - found)) <= 1e-6


# On a scene


POLE = Box(frozen(tf.translation(5.0, 2.0, 2.0)), frozen([0.15, 0.15, 4.0]))


def limit(name: str, box: Box) -> Limit:
    return Limit(name, LimitKind.ZONE, name, box, "test", Source("test", name))


def driven(guard: PotentialGuard, scene: Scene, q: Floats, wish: Any, seconds: float) -> tuple[float, Floats]:
    """The smallest clearance on joints that obey at once, and where it ends."""
    machine, memory, least, here = scene.machine, guard.start(), math.inf, around(scene)
    for tick in range(round(seconds / DT)):
        kin = machine.forward(q)
        found = scene.query(kin, np.eye(4), 2.5)
        if len(found):
            least = min(least, float(found.distances.min()))
        desired, keep = wish(tick, kin)
        case = replace(
            situation(desired, [], np.empty((0, machine.n))),
            q=frozen(q),
            q_min=machine.q_min,
            q_max=machine.q_max,
            speed_positive=machine.speed_positive,
            speed_negative=machine.speed_negative,
            clearances=found,
            rows=machine.distance_rows(kin, np.eye(4), found),
            joint_names=machine.joint_names,
            exclusive_groups=machine.exclusive_groups,
            keep_direction=keep,
            around=here,
        )
        result, memory = guard.allow(case, memory)
        q = q + result.allowed * DT
    return least, q


def start_before_the_pole() -> tuple[Scene, Floats]:
    machine = machine_of("rre20")
    q = np.array(machine.home)
    q[:] = np.clip(np.radians([-12.0, 20.0, -104.0, -77.0, 0.0, 0.0]), machine.sample_min, machine.sample_max)
    return Scene(machine, [limit("pole", POLE)]), q


@pytest.mark.parametrize("points", list(Points))
@pytest.mark.parametrize("variant", list(Variant))
def test_the_tool_driven_straight_at_a_pole_never_enters_it(points: Points, variant: Variant) -> None:
    scene, q = start_before_the_pole()
    machine = scene.machine

    def straight(_: int, kin: Any) -> tuple[Floats, bool]:
        towards = np.array([5.0, 2.0, 0.0]) - machine.tool_pose(kin)[:3, 3]
        towards[2] = 0.0
        twist = np.append(0.5 * towards / max(float(np.linalg.norm(towards)), 0.5), np.zeros(3))
        J = machine.tool_jacobian(kin)
        return J.T @ np.linalg.solve(J @ J.T + 1e-4 * np.eye(6), twist), True

    guard = PotentialGuard(points=points, variant=variant)
    R = machine.tool_pose(machine.forward(q))[:3, :3]
    least, after = driven(guard, scene, q, straight, 8.0)
    assert 0.19 < least < 0.6
    turned = R.T @ machine.tool_pose(machine.forward(after))[:3, :3]
    angle = math.degrees(math.acos(min((np.trace(turned) - 1.0) / 2.0, 1.0)))
    assert angle < 0.5 or variant is Variant.FIRST_THREE


@pytest.mark.parametrize("seed", range(4))
def test_full_levers_among_boxes_never_enter_on_joints_that_obey_at_once(seed: int) -> None:
    rng = np.random.default_rng(seed)
    machine = machine_of("rre20")
    while True:
        q = rng.uniform(machine.sample_min, machine.sample_max)
        poses, _ = machine.solid_poses(machine.forward(q))
        places = poses[rng.integers(2, len(poses), 3), :3, 3] + rng.normal(size=(3, 3)) * 1.5
        boxes = [Box(frozen(tf.translation(*place)), frozen(rng.uniform(0.2, 1.0, 3))) for place in places]
        scene = Scene(machine, [limit(f"l{i}", one) for i, one in enumerate(boxes)])
        found = scene.query(machine.forward(q), np.eye(4), 2.5)
        if len(found) and 0.25 < found.distances.min() < 1.5:
            break
    shares = rng.uniform(-1, 1, (20, machine.n)) * rng.choice([0.0, 1.0, 1.0], (20, machine.n))

    def levers(tick: int, kin: Any) -> tuple[Floats, bool]:
        share = shares[(tick // 25) % 20]
        return np.where(share > 0.0, share * machine.speed_positive, share * machine.speed_negative), False

    least, _ = driven(HELD, scene, q, levers, 6.0)
    assert 0.15 < least < 1.0


# Reasons and settings


def test_it_says_that_it_pushes_what_from_what_and_how_far() -> None:
    case = situation([0.3, 0.0, 0.0], [0.50], ROW, protections=0.1)
    (reason,) = HELD.allow(case, HELD.start())[0].reasons
    speed = float(HELD.speed(np.array([0.4]))[0])
    text = f"boom is 0.50 m from limit-0 (0.10 m of it unsure, stops at 0.20 m), pushed away at {speed:.2f} m/s"
    assert (reason.code, reason.text) == (ReasonCode.PUSHED_AWAY, text)
    assert (reason.link, reason.limit, reason.clearance_m) == ("boom", "limit-0", 0.5)
    assert (reason.protection_m, reason.stop_distance_m, reason.scale) == (0.1, 0.2, 1.0)


def test_what_it_takes_from_the_wish_is_its_scale() -> None:
    row = [[1.0, 0.0, 0.0]]
    result, _ = PRINTED.allow(situation([-1.0, 0.0, 0.0], [0.30], row), PRINTED.start())
    assert result.scale == pytest.approx(1.0 - float(HELD.speed(np.array([0.3]))[0]), abs=1e-2)
    assert result.reasons[0].scale == result.scale
    result, _ = PRINTED.allow(situation([1.0, 0.0, 0.0], [0.30], row), PRINTED.start())
    assert result.scale == 1.0 and result.allowed[0] > 1.0


def test_inside_it_says_so_and_leads_out() -> None:
    result, _ = HELD.allow(situation([0.01, 0.0, 0.0], [-0.1], ROW), HELD.start())
    (reason,) = result.reasons
    assert (reason.code, reason.text) == (
        ReasonCode.INSIDE_LIMIT,
        "boom is 0.10 m inside limit-0, pushed away at 1.00 m/s",
    )
    assert float(ROW[0] @ result.allowed) > 0.9


def test_reasons_come_gravest_first_once_per_link_and_limit_and_not_too_many() -> None:
    case = situation(WISH, [0.5, 0.3, 0.4, 0.35], np.repeat(ROW, 4, 0), limits=[0, 1, 2, 1])
    result, _ = HELD.allow(case, HELD.start())
    assert [(one.limit, one.clearance_m) for one in result.reasons] == [
        *(("limit-1", 0.3), ("limit-2", 0.4), ("limit-0", 0.5))
    ]
    many = situation(WISH, [0.5] * 40, np.repeat(ROW, 40, 0))
    assert len(HELD.allow(many, HELD.start())[0].reasons) == MAX_REASONS


@pytest.mark.parametrize(
    "changes",
    [
        {"slow_distance_m": 0.2},
        {"slow_distance_m": math.nan},
        {"stop_distance_m": -0.1},
        {"stop_distance_m": math.nan},
        {"mu": -0.01},
        {"mu": math.inf},
        {"cap_m_s": -1.0},
        {"damping": 0.0},
        {"cushion_s": 0.0},
        {"points": "all"},
        {"variant": 3.0},
        {"hold": 0.5},
        {"hold": math.nan},
    ],
)
def test_settings_that_make_no_sense_are_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(InputError) as refused:
        PotentialGuard(**changes)
    assert refused.value.element in {next(iter(changes)), "slow_distance_m"}


def test_settings_may_come_as_files_have_them() -> None:
    guard = replace(HELD, points="per_link", variant="first_three", hold=0.0)  # type: ignore[arg-type]
    assert guard == PotentialGuard(points=Points.PER_LINK, variant=Variant.FIRST_THREE, hold=False)
    assert guard.hold is False
