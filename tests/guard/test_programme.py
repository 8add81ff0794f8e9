"""The guard's convex programme: certified against every row, and the best there is."""

from itertools import combinations
from typing import Any

import daqp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from workgauge.guard import programme
from workgauge.guard.programme import MOST_ROWS, SHORT, Solved, share
from workgauge.guard.projection import project

#: Changes of slack in one tick: none, or some millimetres; noise is tested by itself.
ENTRIES = st.one_of(st.just(0.0), st.floats(-0.05, 0.05).map(lambda x: round(x, 6)))
SLACKS = st.one_of(st.just(0.0), st.just(-0.1), st.floats(-0.2, 2.0).map(lambda x: round(x, 6)))


@st.composite
def programmes(draw: Any, most_joints: int = 6, most_rows: int = 14) -> tuple[Any, Any, float]:
    n, k = draw(st.integers(1, most_joints)), draw(st.integers(0, most_rows))
    return (
        draw(arrays(float, (k, n), elements=ENTRIES)),
        draw(arrays(float, k, elements=SLACKS)),
        draw(st.sampled_from((0.05, 0.2, 1.0))),
    )


def bounds(slack: Any, alpha: float) -> Any:
    return -alpha * np.maximum(slack, 0.0)


def away(s: Any) -> float:
    return float(np.sum((1.0 - s) ** 2))


def judge(solved: Solved, rows: Any, slack: Any, alpha: float) -> None:
    assert solved.ok, solved.why
    assert (solved.s >= 0.0).all() and (solved.s <= 1.0).all()
    assert (rows @ solved.s >= bounds(slack, alpha) - SHORT).all()
    assert not solved.s.flags.writeable


def enumerated(rows: Any, least: Any, top: Any) -> Any:
    """The optimum by trying every set of rows that could be active: slow, and like neither solver."""
    n = len(top)
    normals = np.concatenate((rows, np.eye(n), -np.eye(n)))
    offsets = np.concatenate((least, np.zeros(n), -top))
    best = np.zeros(n)
    for size in range(n + 1):
        for chosen in combinations(range(len(offsets)), size):
            some = list(chosen)
            missing = offsets[some] - normals[some].sum(axis=1)
            s = np.ones(n) + np.linalg.pinv(normals[some]) @ missing if size else np.ones(n)
            if (normals @ s >= offsets - 1e-10).all() and away(s) < away(best):
                best = s
    return best


@settings(max_examples=300, deadline=None)
@given(programmes())
def test_every_row_is_met(case: Any) -> None:
    judge(share(*case), *case)
    judge(share(*case, keep_direction=True), *case)


@settings(max_examples=150, deadline=None)
@given(programmes(most_joints=3, most_rows=4), st.booleans(), st.data())
def test_it_is_the_best(case: Any, with_ends: bool, data: st.DataObject) -> None:
    rows, slack, alpha = case
    n = rows.shape[1]
    ends = data.draw(arrays(float, n, elements=st.sampled_from((0.0, 0.3, 1.0)))) if with_ends else None
    solved = share(rows, slack, alpha, ends=ends)
    top = np.ones(n) if ends is None else ends
    assert away(solved.s) == pytest.approx(away(enumerated(rows, bounds(slack, alpha), top)), abs=1e-6)
    assert (solved.s <= top).all()
    assert solved.why == ""


@settings(max_examples=150, deadline=None)
@given(programmes())
def test_what_shrinks_nothing_passes_unchanged(case: Any) -> None:
    rows, slack, alpha = case
    opened = np.abs(rows.sum(axis=1)) - rows.sum(axis=1)
    rows = rows + opened[:, None]  # every row is nonnegative at s = 1, single entries need not be
    for keep_direction in (False, True):
        solved = share(rows, slack, alpha, keep_direction=keep_direction)
        assert (solved.s >= 1.0 - 1e-9).all()
        assert solved.active == ()


@settings(max_examples=100, deadline=None)
@given(programmes(), st.data())
def test_more_slack_never_leaves_less(case: Any, data: st.DataObject) -> None:
    rows, slack, alpha = case
    more = slack + data.draw(arrays(float, len(slack), elements=st.floats(0.0, 0.5)))
    for keep_direction in (False, True):
        before = share(rows, slack, alpha, keep_direction=keep_direction)
        after = share(rows, more, alpha, keep_direction=keep_direction)
        assert away(after.s) <= away(before.s) + 1e-6


@settings(max_examples=150, deadline=None)
@given(programmes(), st.integers(0, 2**32 - 1), st.floats(-15.0, -4.0), st.booleans())
def test_near_twins_are_no_contradiction(case: Any, seed: int, exponent: float, closed: bool) -> None:
    rows, slack, alpha = case
    slack = np.zeros(len(slack)) if closed else slack
    noise = 10.0**exponent * np.random.default_rng(seed).normal(size=(2, *rows.shape))
    both = np.concatenate((rows, rows + noise[0], rows + noise[1]))
    slacks = np.tile(slack, 3)
    solved = share(both, slacks, alpha)
    judge(solved, both, slacks, alpha)
    assert away(solved.s) <= away(share(both, slacks, alpha, keep_direction=True).s) + 1e-6


def test_daqp_alone_takes_nearly_dependent_rows_for_a_contradiction(monkeypatch: pytest.MonkeyPatch) -> None:
    flags = []
    plain = daqp.solve

    def watched(*args: Any, **settings: Any) -> Any:
        answer = plain(*args, **settings)
        flags.append(answer[2])
        return answer

    monkeypatch.setattr(programme.daqp, "solve", watched)
    rng = np.random.default_rng(1)
    for rank, noise in ((1, 0.0), (1, 1e-12), (2, 1e-10), (2, 1e-9), (3, 1e-9)):
        for _ in range(50):
            rows = 0.02 * rng.normal(size=(40, rank)) @ rng.normal(size=(rank, 6)) + noise * rng.normal(size=(40, 6))
            solved = share(rows, np.zeros(40), 0.2)
            judge(solved, rows, np.zeros(40), 0.2)
            assert solved.why == ""
    assert 0 < flags.count(1) < len(flags)  # else the exact projection is not needed any more


@pytest.mark.parametrize("answer", ["unsolved", "far too much", "not a number", "timid"])
def test_a_solver_that_lies_is_found_out(answer: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rows, slack = np.array([[-0.02, -0.01], [-0.01, 0.0]]), np.array([0.05, 0.3])
    honest = share(rows, slack, 0.2)

    def solve(*args: Any, **settings: Any) -> Any:
        s = {"far too much": np.ones(2), "not a number": np.full(2, np.nan)}.get(answer, np.zeros(2))
        return s, 0.0, -1 if answer == "unsolved" else 1, {"lam": np.zeros(len(args[3]))}

    monkeypatch.setattr(programme.daqp, "solve", solve)
    found = share(rows, slack, 0.2)
    np.testing.assert_allclose(found.s, honest.s, atol=1e-9)
    assert found.active == honest.active == (0,)


def test_the_row_that_holds_is_named_and_the_others_are_not() -> None:
    rows = np.array([[-0.02, 0.0, 0.0], [0.0, -0.02, 0.0], [0.01, 0.0, 0.0]])
    solved = share(rows, np.array([0.05, 0.08, -1.0]), 0.1)
    np.testing.assert_allclose(solved.s, [0.25, 0.4, 1.0], atol=1e-12)
    assert solved.active == (0, 1)  # the first costs more
    together = share(rows, np.array([0.05, 0.08, -1.0]), 0.1, keep_direction=True)
    np.testing.assert_allclose(together.s, 0.25, atol=1e-12)
    assert together.active == (0,)


def test_the_pump_is_shared_and_ends_are_kept() -> None:
    none, nothing = np.zeros((0, 3)), np.zeros(0)
    flow = np.array([[0.5, 0.5, 0.5]])
    solved = share(none, nothing, 0.1, flow_rows=flow, flow_most=np.array([1.2]))
    np.testing.assert_allclose(solved.s, 0.8, atol=1e-9)
    assert solved.active == (0,)
    solved = share(none, nothing, 0.1, flow_rows=flow, flow_most=np.array([1.2]), ends=np.array([1.0, 1.0, 0.2]))
    np.testing.assert_allclose(solved.s, [1.0, 1.0, 0.2], atol=1e-9)
    solved = share(none, nothing, 0.1, flow_rows=flow, flow_most=np.array([1.2]), ends=np.array([1.0, 1.0, 0.5]))
    np.testing.assert_allclose(solved.s, [0.95, 0.95, 0.5], atol=1e-9)
    solved = share(none, nothing, 0.1, keep_direction=True, ends=np.array([1.0, 0.3, 1.0]))
    np.testing.assert_allclose(solved.s, 0.3)
    assert share(none, nothing, 0.1, flow_rows=flow, flow_most=np.array([-1.0])).s.max() <= 1e-8


def test_rows_beyond_the_cap_are_kept_too(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = daqp.solve

    def watched(*args: Any, **settings: Any) -> Any:
        assert len(args[2]) <= MOST_ROWS
        return plain(*args, **settings)

    monkeypatch.setattr(programme.daqp, "solve", watched)
    rng = np.random.default_rng(2)
    rows = -0.02 * rng.random((3 * MOST_ROWS, 6)) + 0.005
    slack = 0.2 * rng.random(len(rows))
    judge(share(rows, slack, 0.1), rows, slack, 0.1)
    assert share(rows, slack, 0.1).why == ""


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("keep_direction", [False, True])
def test_numbers_nobody_can_judge_stop(bad: float, keep_direction: bool) -> None:
    rows, slack = np.array([[-0.02, -0.01], [0.01, 0.02]]), np.array([0.05, 0.3])
    broken = rows.copy()
    broken[1, 0] = bad
    lost = slack.copy()
    lost[1] = bad
    cases = [(broken, slack, np.ones(2)), (broken, slack, np.zeros(2))]
    cases += [(rows, slack, np.array([1.0, bad]))] if np.isnan(bad) else []
    cases += [(rows, lost, np.ones(2))] if np.isnan(bad) else []
    for rows_, slack_, ends in cases:
        solved = share(rows_, slack_, 0.2, keep_direction=keep_direction, ends=ends)
        assert not solved.ok and solved.why and not solved.s.any()
    if bad == np.inf:  # a limit that is nowhere holds nothing
        assert (share(rows, np.array([bad, bad]), 0.2).s == 1.0).all()
    if bad == -np.inf:  # and one entered without end only ever grows
        judge(share(rows, np.array([bad, bad]), 0.2), rows, np.array([bad, bad]), 0.2)


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 6), st.integers(0, 10), st.integers(0, 2**32 - 1))
def test_the_projection_meets_kkt(n: int, m: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(m, n))
    assume(m == 0 or np.linalg.norm(normals, axis=1).min() > 0.1)
    offsets = -rng.random(m)
    target = 2.0 * rng.normal(size=n)
    point, multipliers, finished = project(target, normals, offsets, np.full(m, 1e-12))
    assert finished
    assert (normals @ point >= offsets - 1e-9).all()
    assert (multipliers >= 0.0).all()
    np.testing.assert_allclose(point, target + multipliers @ normals, atol=1e-8)
    np.testing.assert_allclose(multipliers * (normals @ point - offsets), 0.0, atol=1e-8)
