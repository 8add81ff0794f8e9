"""What each lever alone may still do."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from workgauge.guard.programme import SHORT, share
from workgauge.guard.ranges import lever_ranges

ENTRIES = st.one_of(st.just(0.0), st.floats(-0.05, 0.05).map(lambda x: round(x, 6)))
SLACKS = st.one_of(st.just(0.0), st.just(-0.1), st.floats(-0.2, 2.0).map(lambda x: round(x, 6)))
SPEEDS = st.floats(0.05, 1.5)
RATES = st.one_of(st.just(0.0), st.floats(-2.0, 2.0).map(lambda x: round(x, 4)))
SHARES = st.one_of(st.just(1.0), st.just(0.0), st.floats(0.01, 1.0))


@st.composite
def cases(draw: Any) -> dict[str, Any]:
    n, k = draw(st.integers(1, 6)), draw(st.integers(0, 10))
    return {
        "rows_positive": draw(arrays(float, (k, n), elements=ENTRIES)),
        "rows_negative": draw(arrays(float, (k, n), elements=ENTRIES)),
        "slack": draw(arrays(float, k, elements=SLACKS)),
        "alpha": draw(st.sampled_from((0.05, 0.2, 1.0))),
        "speed_positive": draw(arrays(float, n, elements=SPEEDS)),
        "speed_negative": draw(arrays(float, n, elements=SPEEDS)),
        "tool_rates": draw(arrays(float, (3, n), elements=RATES)),
        "ends_positive": draw(arrays(float, n, elements=SHARES)),
        "ends_negative": draw(arrays(float, n, elements=SHARES)),
    }


def allowed(case: dict[str, Any], velocity: Any, slop: float) -> bool:
    """Whether this joint velocity keeps rows, speeds and ends, told joint by joint; slop [m]."""
    change = np.zeros(len(case["slack"]))
    for j, v in enumerate(velocity):
        side = "positive" if v > 0.0 else "negative"
        part = abs(v) / case[f"speed_{side}"][j]
        if part > case[f"ends_{side}"][j] * (1.0 + 1e-9):
            return False
        change += part * case[f"rows_{side}"][:, j]
    return bool((change >= -case["alpha"] * np.maximum(case["slack"], 0.0) - slop).all())


@settings(max_examples=200, deadline=None)
@given(cases())
def test_a_joint_may_go_to_the_end_of_its_range_and_no_further(case: Any) -> None:
    found = lever_ranges(**case)
    for high, values, by in (
        (True, found.joints_high, found.joints_high_by),
        (False, found.joints_low, found.joints_low_by),
    ):
        assert (values >= 0.0).all() if high else (values <= 0.0).all()
        for j, value in enumerate(values):
            unit = np.eye(len(values))[j] * (1.0 if high else -1.0)
            assert allowed(case, abs(value) * unit, 1.001 * SHORT)
            assert not allowed(case, (abs(value) * 1.01 + 1e-3) * unit, 0.0) or by[j] == -1
            if by[j] >= 0:  # only this row, and it is broken a little further on
                assert abs(value) < case["speed_positive" if high else "speed_negative"][j]
                alone = {**case, "slack": np.where(np.arange(len(case["slack"])) == by[j], case["slack"], np.inf)}
                assert not allowed(alone, (abs(value) * 1.01 + 1e-3) * unit, 0.0)
            else:  # only its own end or speed
                side = "positive" if high else "negative"
                assert abs(value) == pytest.approx(case[f"speed_{side}"][j] * case[f"ends_{side}"][j])


@settings(max_examples=200, deadline=None)
@given(cases())
def test_the_tool_may_go_to_the_end_of_its_range_and_no_further(case: Any) -> None:
    found = lever_ranges(**case)
    for values, sign in ((found.tool_high, 1.0), (found.tool_low, -1.0)):
        for axis, value in enumerate(values):
            assert value * sign >= 0.0
            rates = case["tool_rates"][axis]
            if not rates.any():
                assert value == 0.0
                continue
            assert allowed(case, value * rates, 1.01 * SHORT)
            assert not allowed(case, sign * (abs(value) * 1.01 + 1e-2) * rates, -1e-12) or abs(value) < 1e-6


@settings(max_examples=100, deadline=None)
@given(cases(), st.integers(0, 5))
def test_a_range_is_what_the_programme_leaves_a_joint_alone(case: Any, j: int) -> None:
    j %= len(case["speed_positive"])
    case = {**case, "ends_positive": None}
    found = lever_ranges(**case)
    alone = np.zeros_like(case["rows_positive"])
    alone[:, j] = case["rows_positive"][:, j]
    solved = share(alone, case["slack"], case["alpha"], keep_direction=True)
    assert found.joints_high[j] == pytest.approx(solved.s[j] * case["speed_positive"][j])


@settings(max_examples=60, deadline=None)
@given(cases(), st.data())
def test_more_slack_never_narrows(case: Any, data: st.DataObject) -> None:
    more = case["slack"] + data.draw(arrays(float, len(case["slack"]), elements=st.floats(0.0, 0.5)))
    before, after = lever_ranges(**case), lever_ranges(**{**case, "slack": more})
    for name in ("joints", "tool"):
        assert (getattr(after, f"{name}_high") >= getattr(before, f"{name}_high") - 1e-6).all()
        assert (getattr(after, f"{name}_low") <= getattr(before, f"{name}_low") + 1e-6).all()


def plain(**changed: Any) -> dict[str, Any]:
    case = {
        "rows_positive": np.array([[-0.01, 0.0], [0.02, -0.02]]),
        "rows_negative": np.array([[0.01, 0.0], [-0.04, 0.02]]),
        "slack": np.array([0.05, 0.1]),
        "alpha": 0.1,
        "speed_positive": np.array([1.0, 2.0]),
        "speed_negative": np.array([0.5, 2.0]),
        "tool_rates": np.array([[1.0, 0.0], [0.0, 1.0], [np.nan, np.nan]]),
    }
    return {**case, **changed}


def test_numbers_by_hand() -> None:
    found = lever_ranges(**plain())
    np.testing.assert_allclose(found.joints_high, [0.5, 1.0])
    np.testing.assert_allclose(found.joints_low, [-0.125, -2.0])
    np.testing.assert_allclose(found.tool_high, [0.5, 1.0, 0.0])
    np.testing.assert_allclose(found.tool_low, [-0.125, -2.0, 0.0])
    assert found.joints_high_by.tolist() == [0, 1]
    assert found.joints_low_by.tolist() == [1, -1]
    assert found.tool_high_by.tolist() == [0, 1, -1]
    assert found.tool_low_by.tolist() == [1, -1, -1]
    assert lever_ranges(**plain(clearance_of=np.array([7, 4]))).joints_high_by.tolist() == [7, 4]
    assert not found.joints_low.flags.writeable and not found.tool_low_by.flags.writeable


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_numbers_nobody_can_judge_leave_nothing(bad: float) -> None:
    rows = plain()["rows_positive"].copy()
    rows[1, 0] = bad
    found = lever_ranges(**plain(rows_positive=rows))
    assert found.joints_high[0] == 0.0 and found.tool_high[0] == 0.0
    assert found.joints_high[1] == pytest.approx(1.0)
    assert np.isfinite(found.tool_low).all()
    slack = np.array([bad, 0.1])
    found = lever_ranges(**plain(slack=slack))
    assert np.isfinite(found.joints_high).all() and np.isfinite(found.tool_high).all()
    assert found.joints_high[0] == (1.0 if bad == np.inf else 0.0)
    found = lever_ranges(**plain(tool_rates=np.full((3, 2), bad)))
    assert not found.tool_high.any() and not found.tool_low.any()


def test_nothing_near_leaves_full_speed() -> None:
    none = np.zeros((0, 2))
    found = lever_ranges(**plain(rows_positive=none, rows_negative=none, slack=np.zeros(0)))
    assert found.joints_high.tolist() == [1.0, 2.0] and found.joints_low.tolist() == [-0.5, -2.0]
    np.testing.assert_allclose(found.tool_low, [-0.5, -2.0, 0.0])
