"""The contract of every registered guard, run by each of them."""

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from workgauge.guard.api import Guard, GuardInput
from workgauge.guard.registry import GUARDS, guard_named
from workgauge.values.arrays import frozen, frozen_ints
from workgauge.values.clearances import Clearances
from workgauge.values.errors import InputError
from workgauge.values.reasons import ReasonCode

N = 4
NAMES = ("swing", "boom", "stick", "bucket")
SPEEDS = np.array([0.9, 0.4, 0.6, 1.0])
Q_MIN = np.array([-np.inf, -0.8, -2.6, -2.6])
Q_MAX = np.array([np.inf, 1.1, -0.5, 0.7])
MIDDLE = np.array([0.0, 0.15, -1.5, -1.0])


def situation(desired: Any, distances: Any = (), rows: Any = None, **changes: Any) -> GuardInput:
    """A guard's input with the given clearances, joints in the middle of their ranges."""
    k = len(distances)
    clearances = Clearances(
        distances=np.array(distances, dtype=float),
        normals=np.zeros((k, 3)),
        points_machine=np.zeros((k, 3)),
        points_limit=np.zeros((k, 3)),
        links=frozen_ints(np.arange(k) % N),
        other_links=frozen_ints([-1] * k),
        limits=frozen_ints(np.arange(k)),
        cells=frozen_ints([-1] * k),
        solids=frozen_ints(np.arange(k) % N),
        protections=np.array(changes.pop("protections", np.zeros(k)), dtype=float),
        stop_distances=np.array(changes.pop("stop_distances", np.full(k, np.nan)), dtype=float),
        link_names=NAMES,
        limit_ids=tuple(f"limit-{i}" for i in range(k)),
        searched_m=changes.pop("searched_m", 50.0),
    )
    values: dict[str, Any] = {
        "desired": frozen(desired),
        "q": frozen(MIDDLE),
        "q_min": frozen(Q_MIN),
        "q_max": frozen(Q_MAX),
        "speed_positive": frozen(SPEEDS),
        "speed_negative": frozen(SPEEDS),
        "clearances": clearances,
        "rows": np.zeros((k, N)) if rows is None else np.array(rows, dtype=float).reshape(k, N),
        "dt_s": 0.02,
        "joint_names": NAMES,
        "exclusive_groups": (),
        **changes,
    }
    return GuardInput(**values)


@st.composite
def situations(draw: st.DrawFn, *, anything: bool = False) -> GuardInput:
    """Any number of clearances at any distance, any posture, any wish."""
    k = draw(st.integers(0, 5))
    number = st.floats(width=64) if anything else st.floats(-20, 20)
    q = draw(arrays(float, N, elements=st.floats(-3, 3)))
    wish = draw(arrays(float, N, elements=st.floats(-2, 2)))
    return situation(
        wish,
        draw(arrays(float, k, elements=st.floats(width=64) if anything else st.floats(-2, 5))),
        draw(arrays(float, (k, N), elements=number)),
        q=frozen(q),
        protections=draw(arrays(float, k, elements=st.floats(width=64) if anything else st.floats(0, 0.5))),
        stop_distances=draw(arrays(float, k, elements=st.sampled_from([np.nan, np.nan, 0.0, 0.3, 2.0]))),
        exclusive_groups=draw(st.sampled_from([(), ((0,), (1, 2)), ((0, 1), (2,), (3,))])),
        keep_direction=draw(st.booleans()),
        dt_s=draw(st.sampled_from([0.001, 0.02, 0.1])),
    )


@pytest.fixture(params=sorted(GUARDS), scope="module")
def guard(request: pytest.FixtureRequest) -> Guard:
    return guard_named(request.param)


@pytest.fixture(params=sorted(set(GUARDS) - {"none"}), scope="module")
def keeping(request: pytest.FixtureRequest) -> Guard:
    """A guard that keeps the machine out of something; `none` looks at no clearance."""
    return guard_named(request.param)


@pytest.fixture(params=["linear"], scope="module")
def present(request: pytest.FixtureRequest) -> Guard:
    """A guard that judges the present's clearances alone; the others' laws hold in scenes, see test_barrier."""
    return guard_named(request.param)


@pytest.fixture(params=sorted(set(GUARDS) - {"potential"}), scope="module")
def slowing(request: pytest.FixtureRequest) -> Guard:
    """A guard that only takes off; one that pushes may be faster than asked, though never faster than joints are."""
    return guard_named(request.param)


def share_of_speed(velocity: np.ndarray) -> float:
    """The largest joint speed as a share of what the joint can do."""
    return float(np.max(np.abs(velocity) / SPEEDS))


def test_it_is_registered_under_its_own_name(guard: Guard) -> None:
    assert GUARDS[guard.name]().name == guard.name
    assert guard.reach_m >= 0.0


@pytest.mark.filterwarnings("error")
@settings(max_examples=300, deadline=None)
@given(case=situations(anything=True))
def test_it_never_returns_anything_but_numbers(guard: Guard, case: GuardInput) -> None:
    result, memory = guard.allow(case, guard.start())
    assert np.isfinite(result.allowed).all() and result.allowed.shape == (N,)
    assert 0.0 <= result.scale <= 1.0
    assert not result.allowed.flags.writeable
    assert json.loads(json.dumps(memory)) == memory


@settings(max_examples=200, deadline=None)
@given(case=situations())
def test_zero_in_gives_zero_out(present: Guard, case: GuardInput) -> None:
    clearances = case.clearances
    still = situation(
        np.zeros(N),
        clearances.distances,
        case.rows,
        q=case.q,
        protections=clearances.protections,
        stop_distances=clearances.stop_distances,
    )
    result, _ = present.allow(still, present.start())
    assert not result.allowed.any() and result.reasons == ()


@settings(max_examples=300, deadline=None)
@given(case=situations())
def test_it_never_speeds_up(slowing: Guard, case: GuardInput) -> None:
    result, _ = slowing.allow(case, slowing.start())
    assert share_of_speed(result.allowed) <= share_of_speed(case.desired) * (1 + 1e-12)


@settings(max_examples=300, deadline=None)
@given(case=situations())
def test_no_joint_is_faster_than_it_can_be(guard: Guard, case: GuardInput) -> None:
    result, _ = guard.allow(case, guard.start())
    assert share_of_speed(result.allowed) <= 1 + 1e-6


@settings(max_examples=300, deadline=None)
@given(case=situations())
def test_a_change_is_never_without_a_reason(guard: Guard, case: GuardInput) -> None:
    result, _ = guard.allow(case, guard.start())
    if not np.array_equal(result.allowed, case.desired):
        assert result.reasons
    if result.scale < 1.0:
        assert any(reason.scale is not None and reason.scale < 1.0 for reason in result.reasons)


@settings(max_examples=300, deadline=None)
@given(case=situations())
def test_inside_a_limit_nothing_makes_it_worse(keeping: Guard, case: GuardInput) -> None:
    result, _ = keeping.allow(case, keeping.start())
    safe = case.clearances.distances - case.clearances.protections
    assert (case.rows @ result.allowed)[safe < 0.0].min(initial=0.0) >= -1e-6


@settings(max_examples=300, deadline=None)
@given(case=situations(), side=st.sampled_from([-1.0, 1.0]))
def test_backing_away_from_everything_is_free(present: Guard, case: GuardInput, side: float) -> None:
    wish = side * SPEEDS * np.array([0.9, 0.0, 0.5, 0.2])
    rows = np.where((case.rows @ wish < 0.0)[:, None], -case.rows, case.rows)
    case = situation(wish, case.clearances.distances, rows, protections=case.clearances.protections)
    result, _ = present.allow(case, present.start())
    assert np.array_equal(result.allowed, wish)
    assert result.reasons == () and result.scale == 1.0


@settings(max_examples=200, deadline=None)
@given(case=situations())
def test_joints_that_cannot_move_together_do_not(guard: Guard, case: GuardInput) -> None:
    result, _ = guard.allow(case, guard.start())
    moving = [group for group in case.exclusive_groups if any(result.allowed[list(group)])]
    assert len(moving) <= 1


@settings(max_examples=200, deadline=None)
@given(case=situations())
def test_no_joint_passes_its_end_within_a_tick(guard: Guard, case: GuardInput) -> None:
    result, _ = guard.allow(case, guard.start())
    after = case.q + result.allowed * case.dt_s
    inside = (case.q >= Q_MIN) & (case.q <= Q_MAX)
    assert (after[inside] <= Q_MAX[inside] + 1e-12).all() and (after[inside] >= Q_MIN[inside] - 1e-12).all()
    assert (result.allowed[case.q > Q_MAX] <= 0.0).all() and (result.allowed[case.q < Q_MIN] >= 0.0).all()


@settings(max_examples=100, deadline=None)
@given(case=situations())
def test_the_same_input_gives_the_same_output_bit_for_bit(guard: Guard, case: GuardInput) -> None:
    first, memory = guard.allow(case, guard.start())
    second, again = guard_named(guard.name).allow(case, json.loads(json.dumps(guard.start())))
    assert first.allowed.tobytes() == second.allowed.tobytes()
    assert first.reasons == second.reasons and memory == again


WISH = [0.1, 0.1, 0.1, 0.1]
ROW = [[1.0, 0.0, 0.0, 0.0]]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
@pytest.mark.parametrize("where", ["desired", "q", "distances", "rows", "protections", "dt_s"])
def test_numbers_nobody_can_judge_stop_everything(guard: Guard, where: str, bad: float) -> None:
    if where == "dt_s" and bad == 1e300:
        bad = -1.0
    case = {
        "desired": lambda: situation([0.1, bad, 0.1, 0.1]),
        "q": lambda: situation(WISH, q=frozen([0.0, bad, 0.0, 0.0])),
        "distances": lambda: situation(WISH, [5.0, bad], ROW * 2),
        "rows": lambda: situation(WISH, [5.0], [[0.0, bad, 0.0, 0.0]]),
        "protections": lambda: situation(WISH, [5.0], ROW, protections=[bad]),
        "dt_s": lambda: situation(WISH, dt_s=bad),
    }[where]()
    result, _ = guard.allow(case, guard.start())
    assert not result.allowed.any() and result.scale == 0.0
    assert [reason.code for reason in result.reasons] == [ReasonCode.INVALID_VALUE]


@pytest.mark.parametrize(
    "case",
    [
        situation(WISH[:3]),
        situation(WISH, q=frozen([0.0] * 5)),
        situation(WISH, [5.0, 5.0], np.zeros((2, N)), protections=[0.0]),
        situation(WISH, [5.0, 5.0], np.zeros((2, N)), stop_distances=[0.0]),
        situation(WISH, [5.0], ROW, protections=[-0.1]),
        situation(WISH, [5.0], ROW, stop_distances=[np.inf]),
        situation(WISH, searched_m=0.1),
        situation(WISH, searched_m=np.nan),
        situation(WISH, dt_s=0.0),
    ],
)
def test_shapes_and_ranges_that_make_no_sense_stop_everything(keeping: Guard, case: GuardInput) -> None:
    result, _ = keeping.allow(case, keeping.start())
    assert not result.allowed.any()
    assert [reason.code for reason in result.reasons] == [ReasonCode.INVALID_VALUE]


def test_an_unknown_guard_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"unknown guard.*somebody.*linear"):
        guard_named("somebody")
