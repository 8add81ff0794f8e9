"""Joint speeds, exclusive groups and the end cushion."""

import math

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from workgauge.guard.cushion import WIDEST_SHARE, cushioned
from workgauge.guard.joints import HYSTERESIS, one_group, within_speed
from workgauge.values.reasons import ReasonCode

NAMES = ("swing", "boom", "stick")
POSITIVE, NEGATIVE = [0.9, 0.4, 0.6], [0.9, 0.3, 0.6]
LOWER, UPPER = [-math.inf, -0.8, -2.6], [math.inf, 1.1, -0.5]
DT, CUSHION = 0.02, 0.3

velocities = st.lists(st.floats(-3, 3), min_size=3, max_size=3)


@settings(max_examples=200, deadline=None)
@given(velocities)
def test_speed_is_clamped_as_a_whole(velocity: list[float]) -> None:
    out, reasons = within_speed(velocity, POSITIVE, NEGATIVE, NAMES)
    shares = [v / (p if v > 0 else n) for v, p, n in zip(velocity, POSITIVE, NEGATIVE, strict=True)]
    worst = max(map(abs, shares))
    if worst <= 1.0:
        assert out == velocity and not reasons
        return
    assert out == pytest.approx([v / worst for v in velocity])
    if worst > 1.001:
        (reason,) = reasons
        assert reason.code is ReasonCode.JOINT_SPEED and reason.scale == pytest.approx(1 / worst)
        assert reason.joint == NAMES[[abs(s) for s in shares].index(worst)]


def test_the_faster_side_of_a_joint_has_its_own_speed() -> None:
    assert within_speed([0.0, 0.4, 0.0], POSITIVE, NEGATIVE, NAMES) == ([0.0, 0.4, 0.0], [])
    assert within_speed([0.0, -0.4, 0.0], POSITIVE, NEGATIVE, NAMES)[0] == pytest.approx([0.0, -0.3, 0.0])


GROUPS = ((0,), (1, 2))


def test_the_group_wanted_most_moves() -> None:
    out, group, reasons = one_group([0.9, 0.1, -0.1], POSITIVE, NEGATIVE, GROUPS, NAMES, -1)
    assert (out, group) == ([0.9, 0.0, 0.0], 0)
    assert [(r.code, r.joint) for r in reasons] == [(ReasonCode.EXCLUSIVE_GROUP, j) for j in ("boom", "stick")]
    assert reasons[0].text == "boom cannot move together with swing"


def test_a_single_group_moves_without_a_word() -> None:
    assert one_group([0.0, 0.1, -0.1], POSITIVE, NEGATIVE, GROUPS, NAMES, 0) == ([0.0, 0.1, -0.1], 1, [])
    assert one_group([0.0, 0.0, 0.0], POSITIVE, NEGATIVE, GROUPS, NAMES, 0) == ([0.0, 0.0, 0.0], -1, [])
    assert one_group([0.1, 0.1, 0.1], POSITIVE, NEGATIVE, (), NAMES, -1) == ([0.1, 0.1, 0.1], -1, [])


def test_the_moving_group_keeps_moving_until_another_is_wanted_much_more() -> None:
    slightly_more, much_more = 0.9 * 0.5 * 1.1, 0.9 * 0.5 * HYSTERESIS * 1.01
    assert one_group([slightly_more, 0.2, 0.0], POSITIVE, NEGATIVE, GROUPS, NAMES, 1)[1] == 1
    assert one_group([slightly_more, 0.2, 0.0], POSITIVE, NEGATIVE, GROUPS, NAMES, -1)[1] == 0
    assert one_group([much_more, 0.2, 0.0], POSITIVE, NEGATIVE, GROUPS, NAMES, 1)[1] == 0
    assert one_group([slightly_more, 0.0, 0.0], POSITIVE, NEGATIVE, GROUPS, NAMES, 1)[1] == 0
    assert one_group([slightly_more, 0.2, 0.0], POSITIVE, NEGATIVE, GROUPS, NAMES, 7)[1] == 0


def test_a_joint_of_no_group_moves_with_any() -> None:
    out, _, reasons = one_group([0.9, 0.1, 0.5], POSITIVE, NEGATIVE, ((0,), (1,)), NAMES, -1)
    assert out == [0.9, 0.0, 0.5] and [r.joint for r in reasons] == ["boom"]


def slow(velocity: list[float], q: list[float], **changes: object) -> tuple[list[float], list[str]]:
    given_ = {"dt_s": DT, "cushion_s": CUSHION, **changes}
    out, reasons = cushioned(velocity, q, (LOWER, UPPER), (POSITIVE, NEGATIVE), NAMES, **given_)  # type: ignore[arg-type]
    assert all(reason.code is ReasonCode.JOINT_END for reason in reasons)
    return out, [reason.text for reason in reasons]


def test_the_speed_falls_in_proportion_within_the_cushion() -> None:
    width = CUSHION * 0.4
    for share in (0.75, 0.5, 0.25):
        out, said = slow([0.9, 0.4, 0.0], [0.0, 1.1 - share * width, -1.5])
        assert out == pytest.approx([0.9, 0.4 * share, 0.0])
        assert said == ["boom is near its upper end"]
    assert slow([0.9, 0.4, 0.0], [0.0, 1.1 - 1.01 * width, -1.5]) == ([0.9, 0.4, 0.0], [])


def test_each_side_has_its_own_cushion() -> None:
    out, said = slow([0.0, -0.3, 0.0], [0.0, -0.8 + 0.5 * CUSHION * 0.3, -1.5])
    assert out == pytest.approx([0.0, -0.15, 0.0]) and said == ["boom is near its lower end"]


def test_at_and_beyond_the_end_only_the_way_back_is_free() -> None:
    for q in (1.1, 1.2, math.nan):
        out, said = slow([0.0, 0.4, 0.0], [0.0, q, -1.5])
        assert out == [0.0, 0.0, 0.0] and said == ["boom is at its upper end"]
    assert slow([0.0, -0.3, 0.0], [0.0, 1.2, -1.5]) == ([0.0, -0.3, 0.0], [])


def test_a_slow_motion_within_the_cushion_is_left_alone() -> None:
    assert slow([0.0, 0.1, 0.0], [0.0, 1.1 - 0.5 * CUSHION * 0.4, -1.5]) == ([0.0, 0.1, 0.0], [])


def test_on_a_path_the_slowed_joint_slows_all() -> None:
    out, _ = slow([0.8, 0.4, -0.2], [0.0, 1.1 - 0.5 * CUSHION * 0.4, -1.5], keep_direction=True)
    assert out == pytest.approx([0.4, 0.2, -0.1])


def test_a_short_joint_has_a_short_cushion() -> None:
    ends = ([0.0], [0.1])
    out, _ = cushioned([1.0], [0.08], ends, ([1.0], [1.0]), ("extend",), dt_s=DT, cushion_s=CUSHION)
    assert out == pytest.approx([0.02 / (WIDEST_SHARE * 0.1)])


@settings(max_examples=200, deadline=None)
@given(st.floats(-0.8, 1.1), st.floats(-0.4, 0.4), st.sampled_from([0.001, 0.02, 0.5, 5.0]))
def test_the_end_is_never_passed_whatever_the_tick(q: float, v: float, dt_s: float) -> None:
    for _ in range(50):
        (_, speed, _), _ = slow([0.0, v, 0.0], [0.0, q, -1.5], dt_s=dt_s)
        assert abs(speed) <= abs(v) and speed * v >= 0.0
        q += speed * dt_s
        assert -0.8 - 1e-12 <= q <= 1.1 + 1e-12


@settings(max_examples=200, deadline=None)
@given(velocities, st.floats(-0.8, 1.1), st.floats(-2.6, -0.5))
def test_each_joint_is_slowed_by_its_own_end_alone(velocity: list[float], boom: float, stick: float) -> None:
    assume(all(velocity))
    out, _ = slow(velocity, [0.0, boom, stick])
    alone, _ = slow([0.0, velocity[1], 0.0], [0.0, boom, stick])
    assert out[0] == velocity[0] and out[1] == alone[1]
