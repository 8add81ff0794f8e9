"""The way out of limits one is inside, and the proof where there is none."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from workgauge.guard.exit import FAR_OFF, WORSENS_M_S, Pinned, WayOut, exit_velocity, room, way_out

HORIZON_S = 1.0
LEAST = 1e-4
KINDS = ("free", "two opposed", "three opposed", "planar", "one line")


def situation(kind: str, seed: int) -> tuple[Any, Any, Any, Any]:
    """Rows, slack and box of a random arm, some joints at their ends; limits oppose each other by `kind`."""
    rng = np.random.default_rng(seed)
    n, k = int(rng.integers(2, 8)), int(rng.integers(1, 9))
    rank = {"planar": 2, "one line": 1}.get(kind)
    rows = rng.normal(size=(k, n)) if rank is None else rng.normal(size=(k, rank)) @ rng.normal(size=(rank, n))
    rows *= rng.choice([0.3, 3.0, 8.0], size=n)
    if kind == "two opposed" and k > 1:
        rows[1] = -rows[0] * rng.uniform(0.3, 2.0)
    if kind == "three opposed" and k > 2:
        rows[2] = -rows[0] * rng.uniform(0.3, 2.0) - rows[1] * rng.uniform(0.3, 2.0)
    if rng.random() < 0.2:
        rows[rng.integers(k)] = 0.0
    low, high = -rng.uniform(0.1, 1.0, n), rng.uniform(0.1, 1.0, n)
    low[rng.random(n) < 0.2] = 0.0
    high[rng.random(n) < 0.2] = 0.0
    beside = rng.choice([0.0, 1e-3, 0.3, np.inf], size=k)
    return rows, np.where(rng.random(k) < 0.7, -rng.uniform(0.01, 0.5, k), beside), low, high


def floors(slack: Any) -> Any:
    return -np.minimum(np.maximum(slack, 0.0) / HORIZON_S, 1e6)


def best(wish: Any, rows: Any, least: Any, low: Any, high: Any) -> float:
    """The linear programme, by another solver."""
    exact = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
    box = np.stack((low, high), axis=1)
    found = linprog(-wish, A_ub=-rows, b_ub=-least, bounds=box, method="highs", options=exact)
    return float(-found.fun)


def search(rows: Any, low: Any, high: Any, seed: int, count: int = 20_000) -> Any:
    """Joint velocities all over the box, on its faces, and along what leaves some of the rows as they are."""
    rng = np.random.default_rng(seed)
    found = rng.uniform(low, high, size=(count, len(low)))
    faces = rng.random(found.shape) < 0.4
    found = np.where(faces, np.where(rng.random(found.shape) < 0.5, low, high), found)
    found = np.where(rng.random(found.shape) < 0.3, 0.0, found)
    half = found[: count // 2]
    for chosen in np.array_split(np.arange(len(half)), 50):
        some = rows[rng.random(len(rows)) < 0.4]
        if len(some):
            half[chosen] -= half[chosen] @ (np.linalg.pinv(some) @ some)
    with np.errstate(divide="ignore", invalid="ignore"):
        over = np.where(found > 0.0, high / found, np.where(found < 0.0, low / found, np.inf)).min(axis=1)
    return found * np.minimum(over, 1.0)[:, None]


CASES = st.tuples(st.sampled_from(KINDS), st.integers(0, 2**32 - 1))


@settings(max_examples=250, deadline=None)
@given(CASES)
def test_a_way_out_worsens_nothing_and_pinned_is_proved(case: Any) -> None:
    rows, slack, low, high = situation(*case)
    violated = slack < 0.0
    found = way_out(rows, slack, low, high, horizon_s=HORIZON_S, least_m_s=LEAST)
    least = floors(slack)
    together = best(rows[violated].sum(axis=0), rows, least, low, high) if violated.any() else 0.0
    if isinstance(found, WayOut):
        change = rows @ found.velocity
        assert (change >= least - WORSENS_M_S).all()
        assert (found.velocity >= low - 1e-12).all() and (found.velocity <= high + 1e-12).all()
        if violated.any():
            assert violated[found.row] and change[found.row] > LEAST / len(rows)
            assert change[int(np.argmin(slack))] == pytest.approx(found.gain, abs=1e-9)
            assert together > 0.5 * LEAST
        else:
            assert not found.velocity.any()
    else:
        assert found.first == int(np.argmin(slack))
        assert together <= found.most + 1e-6 and found.most <= 3.0 * LEAST


@settings(max_examples=100, deadline=None)
@given(CASES)
def test_the_worst_gains_as_much_as_it_can(case: Any) -> None:
    rows, slack, low, high = situation(*case)
    if not (slack < 0.0).any():
        return
    worst = int(np.argmin(slack))
    found = way_out(rows, slack, low, high, horizon_s=HORIZON_S, least_m_s=LEAST, grip=0.0)
    most = best(rows[worst], rows, floors(slack), low, high)
    short = len(low) / (2.0 * FAR_OFF) * np.linalg.norm(rows[worst] * np.maximum(high, -low))
    assert (found.gain if isinstance(found, WayOut) else 0.0) >= most - short - LEAST


@settings(max_examples=60, deadline=None)
@given(CASES)
def test_no_search_finds_a_way_where_two_pin(case: Any) -> None:
    rows, slack, low, high = situation(*case)
    found = way_out(rows, slack, low, high, horizon_s=HORIZON_S, least_m_s=LEAST)
    if isinstance(found, WayOut):
        return
    tried = search(rows, low, high, case[1])
    change = tried @ rows.T
    harmless = (change >= floors(slack) - WORSENS_M_S).all(axis=1)
    assert change[harmless][:, slack < 0.0].sum(axis=1, initial=0.0).max(initial=0.0) <= found.most + 1e-6
    if found.alone:  # the two named, no other row looked at
        pair = [found.first] if found.second < 0 else [found.first, found.second]
        spared = (change[:, pair[1:]] >= floors(slack)[pair[1:]] - WORSENS_M_S).all(axis=1)
        assert change[spared, found.first].max(initial=0.0) <= 3.0 * LEAST
        assert best(rows[found.first], rows[pair], floors(slack)[pair], low, high) <= 3.0 * LEAST
        assert found.more == 0
    else:
        pair = [found.first, found.second]
        assert best(rows[found.first], rows[pair], floors(slack)[pair], low, high) > 0.5 * LEAST


def test_between_two_walls_both_are_named() -> None:
    rows = np.array([[0.0, 3.0, 1.0], [0.0, -6.0, -2.0], [1.0, 0.0, 0.0]])
    low, high = -np.ones(3), np.ones(3)
    found = way_out(rows, np.array([-0.2, -0.1, 0.5]), low, high)
    assert isinstance(found, Pinned)
    assert (found.first, found.second, found.alone, found.more, found.joints) == (0, 1, True, 0, ())
    assert found.most == pytest.approx(0.0, abs=1e-9)
    free = way_out(rows[[0, 2]], np.array([-0.2, 0.5]), low, high)
    assert isinstance(free, WayOut) and free.gain == pytest.approx(4.0, abs=1e-3) and free.row == 0
    np.testing.assert_allclose(free.velocity, [0.0, 1.0, 1.0], atol=1e-3)


def test_three_walls_are_said_to_be_more_than_two() -> None:
    angles = np.radians([90.0, 200.0, 330.0])
    rows = np.stack((np.cos(angles), np.sin(angles)), axis=1) * np.array([[1.0], [2.0], [1.0]])
    found = way_out(rows, np.array([-0.3, -0.1, -0.1]), -np.ones(2), np.ones(2))
    assert isinstance(found, Pinned)
    assert (found.first, found.second) == (0, 2)  # it bears 1.085 times as much as the other
    assert not found.alone and found.more == 1


def test_a_joint_at_its_end_is_named() -> None:
    rows = np.array([[2.0, 0.0], [-1.0, 1.0]])
    found = way_out(rows, np.array([-0.2, 0.3]), np.array([-1.0, -1.0]), np.array([0.0, 1.0]))
    assert isinstance(found, Pinned)
    assert (found.first, found.second, found.alone, found.joints) == (0, -1, True, (0,))
    nothing_moves_it = way_out(np.zeros((1, 2)), np.array([-0.2]), -np.ones(2), np.ones(2))
    assert isinstance(nothing_moves_it, Pinned)
    assert (nothing_moves_it.second, nothing_moves_it.joints) == (-1, ())


def test_what_no_joint_moves_does_not_pin_the_rest() -> None:
    rows = np.array([[0.0, 0.0], [1.0, 0.5]])
    found = way_out(rows, np.array([-0.5, -0.1]), -np.ones(2), np.ones(2))
    assert isinstance(found, WayOut)
    assert found.gain == 0.0 and found.row == 1 and rows[1] @ found.velocity == pytest.approx(1.5, abs=1e-3)


def test_all_that_is_violated_grows_where_it_can() -> None:
    rows = np.array([[1.0, 0.5], [-1.0, 2.0]])
    found = way_out(rows, np.array([-0.2, -0.1]), -np.ones(2), np.ones(2), grip=0.9)
    assert isinstance(found, WayOut)
    first, second = rows @ found.velocity
    assert second >= 0.9 * first - 1e-9 and first == found.gain > 1.0
    steep = way_out(rows, np.array([-0.2, -0.1]), -np.ones(2), np.array([1.0, 0.6]), grip=0.9)
    loose = way_out(rows, np.array([-0.2, -0.1]), -np.ones(2), np.array([1.0, 0.6]), grip=0.0)
    assert isinstance(steep, WayOut) and isinstance(loose, WayOut)
    assert (rows @ steep.velocity)[1] == pytest.approx(0.9 * steep.gain, abs=1e-6)
    assert loose.gain > steep.gain + 0.1


def test_the_others_keep_their_slack() -> None:
    rows = np.array([[1.0, 0.0], [-1.0, 0.1]])
    found = way_out(rows, np.array([-0.5, 0.2]), np.array([-1.0, 0.0]), np.array([1.0, 0.0]))
    assert isinstance(found, WayOut)
    assert found.velocity[0] == pytest.approx(0.2, abs=1e-3)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_nobody_can_judge_move_nothing(bad: float) -> None:
    rows, slack, low, high = np.array([[1.0, bad]]), np.array([-0.1]), -np.ones(2), np.ones(2)
    velocity, found = exit_velocity(rows, slack, low, high, 0.5)
    assert isinstance(found, Pinned) and found.first == -1 and not velocity.any()
    velocity, found = exit_velocity(np.ones((1, 2)), np.array([np.nan]), low, high, 0.5)
    assert isinstance(found, Pinned) and not velocity.any()
    velocity, found = exit_velocity(np.ones((1, 2)), slack, low, np.array([1.0, bad]), 0.5)
    assert isinstance(found, Pinned) and not velocity.any()


def test_room_leaves_no_way_into_an_end() -> None:
    q, ends = np.array([0.0, 1.0, -1.2, 0.9]), (np.full(4, -1.0), np.full(4, 1.0))
    low, high = room(q, *ends, np.full(4, 0.5), np.full(4, 0.4), 0.5)
    np.testing.assert_allclose(low, [-0.4, -0.4, 0.0, -0.4])
    np.testing.assert_allclose(high, [0.5, 0.0, 0.5, 0.2])
    low, high = room(q, -np.full(4, np.inf), np.full(4, np.inf), np.full(4, 0.5), np.full(4, 0.4), 0.5)
    assert (low == -0.4).all() and (high == 0.5).all()


class PlanarArm:
    """Three links in a plane among discs and walls: distances and rows by hand."""

    lengths = np.array([5.0, 3.0, 1.5])

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.q = self.rng.uniform([-1.0, -2.0, -1.5], [1.0, 2.0, 1.5])
        tips, _ = self.tips(self.q)
        self.walls = []
        for _ in range(int(self.rng.integers(1, 3))):  # each entered by one of the tips
            tip, angle = int(self.rng.integers(1, 3)), self.rng.uniform(0.0, 2.0 * np.pi)
            normal = np.array([np.cos(angle), np.sin(angle)])
            self.walls.append((tip, normal, float(normal @ tips[tip]) + self.rng.uniform(0.02, 0.3)))

    def tips(self, q: Any) -> tuple[Any, Any]:
        angles = np.cumsum(q)
        steps = self.lengths[:, None] * np.stack((np.cos(angles), np.sin(angles)), axis=1)
        tips = np.cumsum(steps, axis=0)
        base = np.concatenate((np.zeros((1, 2)), tips[:-1]))
        arms = tips[:, None, :] - base[None, :, :]
        jacobians = np.stack((-arms[..., 1], arms[..., 0]), axis=1) * np.tri(3)[:, None, :]
        return tips, jacobians

    def look(self, q: Any) -> tuple[Any, Any]:
        tips, jacobians = self.tips(q)
        rows = np.array([normal @ jacobians[tip] for tip, normal, _ in self.walls])
        return rows, np.array([normal @ tips[tip] - offset for tip, normal, offset in self.walls])


@pytest.mark.parametrize("seed", range(40))
def test_it_drives_out_and_worsens_nothing_on_the_way(seed: int) -> None:
    arm = PlanarArm(seed)
    q, dt = arm.q, 0.02
    ends, speed = (np.array([-2.0, -2.5, -2.0]), np.array([2.0, 2.5, 2.0])), np.full(3, 0.4)
    _, slack = arm.look(q)
    assert (slack < 0.0).any()
    for _ in range(9000):
        rows, slack = arm.look(q)
        low, high = room(q, *ends, speed, speed, 0.1)
        velocity, found = exit_velocity(rows, slack, low, high, 0.1)
        if (slack >= 0.0).all():
            assert not velocity.any()
            return
        if isinstance(found, Pinned):
            change = search(rows, low, high, seed) @ rows.T
            harmless = (change >= floors(slack) - WORSENS_M_S).all(axis=1)
            assert change[harmless][:, slack < 0.0].sum(axis=1).max(initial=0.0) <= found.most + 1e-6
            return
        q = q + dt * velocity
        after = arm.look(q)[1]
        inside = slack < 0.0
        assert (after[inside] >= slack[inside] - 1e-5).all()  # curvature within one tick, nothing else
        assert (after[~inside] >= -1e-5).all()
    raise AssertionError("neither out nor pinned")
