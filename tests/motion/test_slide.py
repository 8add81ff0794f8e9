"""Velocities bent before limits: rows and box kept, nearest as the tool feels it, and the way round in the plane."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from workgauge.machine.load import load_machine
from workgauge.motion.slide import SlideSettings, Surround, slid

MACHINE = load_machine("rre20")
HOW = SlideSettings()
LATE_S = 0.3
NONE = np.zeros(3)
seeds = st.integers(0, 10**6)


def unit(draw: np.random.Generator) -> np.ndarray:
    v = draw.normal(size=3)
    return v / np.linalg.norm(v)


def surround(normals: np.ndarray, rows: np.ndarray, room: np.ndarray) -> Surround:
    names = tuple(f"limit {k}" for k in range(len(room)))
    return Surround(rows, room, normals, names, ("bucket",) * len(room))


class Case:
    """A posture, a wish and limits of the tool point, seeded."""

    def __init__(self, seed: int, limits: int) -> None:
        draw = np.random.default_rng(seed)
        q = draw.uniform(MACHINE.sample_min, MACHINE.sample_max)
        self.J = MACHINE.tool_jacobian(MACHINE.forward(q))
        self.low, self.high = -MACHINE.speed_negative, np.array(MACHINE.speed_positive)
        stopped = draw.random(MACHINE.n) < 0.15  # at an end
        self.high = np.where(stopped, 0.0, self.high)
        self.wish = draw.uniform(1.2 * self.low, 1.2 * self.high)
        normals = np.array([unit(draw) for _ in range(limits)]).reshape(-1, 3)
        room = np.where(draw.random(limits) < 0.3, -0.1, draw.uniform(0.0, 1.0, limits))
        self.around = surround(normals, normals @ self.J[:3], room)
        self.goal = unit(draw)

    @property
    def floors(self) -> np.ndarray:
        return -np.maximum(self.around.room - HOW.keep_m, 0.0) / (HOW.ahead_s + LATE_S)

    def slid(self, around: np.ndarray | None = None):
        return slid(
            *(self.wish, self.J, self.low, self.high, self.around, HOW), late_s=LATE_S, goal=self.goal, around=around
        )

    def far(self, v: np.ndarray) -> float:
        """How far a velocity is from the wish: as the tool feels it, and a little of every joint's own."""
        felt = np.concatenate([self.J[:3], HOW.turn_m * self.J[3:]])
        reach = np.linalg.norm(felt, axis=0).max()
        off = v - self.wish
        return float(np.sum((felt @ off) ** 2) + (0.05 * reach) ** 2 * np.sum(off**2))


@settings(max_examples=150, deadline=None)
@given(seed=seeds, limits=st.integers(0, 6), rounds=st.booleans())
def test_every_row_and_the_box_are_kept(seed, limits, rounds):
    case = Case(seed, limits)
    found = case.slid(NONE if rounds else None)
    assert np.isfinite(found.velocity).all() and 0.0 <= found.left <= 1.0
    assert (case.low <= found.velocity).all() and (found.velocity <= case.high).all()
    approach = -case.around.rows @ found.velocity  # towards the limit [m/s]
    room = np.maximum(case.around.room - HOW.keep_m, 0.0)
    assert (approach <= room / (HOW.ahead_s + LATE_S) + 1e-6).all()


@settings(max_examples=60, deadline=None)
@given(seed=seeds)
def test_nothing_near_leaves_the_wish_alone(seed):
    case = Case(seed, 4)
    case.around = surround(case.around.normals, case.around.rows, np.full(4, 100.0))
    case.wish = np.clip(case.wish, case.low, case.high)
    for around in (None, NONE):
        found = case.slid(around)
        assert np.array_equal(found.velocity, case.wish)
        assert found.left == 1.0 and found.against == -1 and not found.around.any()


@settings(max_examples=40, deadline=None)
@given(seed=seeds, limits=st.integers(1, 4))
def test_no_velocity_that_keeps_them_is_nearer(seed, limits):
    case = Case(seed, limits)
    found = case.slid().velocity
    J, floors, rows = case.J, case.floors, case.around.rows
    felt = np.concatenate([J[:3], HOW.turn_m * J[3:]])
    weight = felt.T @ felt + (0.05 * np.linalg.norm(felt, axis=0).max()) ** 2 * np.eye(MACHINE.n)
    best = minimize(
        case.far,
        np.zeros(MACHINE.n),
        jac=lambda v: 2.0 * weight @ (v - case.wish),
        bounds=list(zip(case.low, case.high, strict=True)),
        constraints={"type": "ineq", "fun": lambda v: rows @ v - floors, "jac": lambda v: rows},
        method="SLSQP",
        options={"maxiter": 300, "ftol": 1e-12},
    )
    assume(best.success and (rows @ best.x >= floors - 1e-7).all())
    assert case.far(found) <= case.far(best.x) * (1.0 + 1e-5) + 1e-7


@settings(max_examples=40, deadline=None)
@given(seed=seeds)
def test_what_already_keeps_everything_stays(seed):
    case = Case(seed, 5)
    case.wish = case.slid().velocity
    assert case.slid().velocity == pytest.approx(case.wish, abs=1e-6)


def blocked(seed: int) -> tuple[Case, np.ndarray]:
    """The tool wants straight into one limit it already touches."""
    case = Case(seed, 1)
    normal = case.around.normals[0]
    case.high = np.array(MACHINE.speed_positive)
    wish = np.linalg.lstsq(case.J, np.concatenate([-0.2 * normal, np.zeros(3)]), rcond=None)[0]
    case.wish, case.goal = np.clip(wish, case.low, case.high), -normal
    case.around = surround(case.around.normals, case.around.rows, np.array([HOW.keep_m]))
    return case, normal


@settings(max_examples=80, deadline=None)
@given(seed=seeds)
def test_the_way_round_lies_in_the_limits_plane(seed):
    case, normal = blocked(seed)
    found = case.slid(NONE)
    if found.around.any():
        assert found.left < HOW.blocked and found.against == 0
        assert np.linalg.norm(found.around) == pytest.approx(1.0)
        assert abs(float(found.around @ normal)) < 1e-9
        assert float(normal @ case.J[:3] @ found.velocity) >= -1e-6


@settings(max_examples=80, deadline=None)
@given(seed=seeds, tilt=st.floats(-0.4, 0.4))
def test_a_way_round_once_begun_is_kept_and_turns_with_the_plane(seed, tilt):
    case, normal = blocked(seed)
    first = case.slid(NONE).around
    assume(first.any())
    side = np.cross(normal, first)
    turned = np.cos(tilt) * normal + np.sin(tilt) * (first if seed % 2 else side)
    case.around = surround(turned[None], turned[None] @ case.J[:3], np.array([HOW.keep_m]))
    case.goal = -turned
    case.wish = np.clip(
        np.linalg.lstsq(case.J, np.concatenate([-0.2 * turned, np.zeros(3)]), rcond=None)[0], case.low, case.high
    )
    again = case.slid(first)
    assume(again.left < HOW.free)
    if again.around.any():
        assert abs(float(again.around @ turned)) < 1e-9
        assert float(again.around @ first) >= 0.9


def test_most_blocked_tools_find_a_way_round():
    ways = [case.slid(NONE) for case, _ in map(blocked, range(60))]
    assert sum(found.around.any() for found in ways) >= 45
    assert not any(case.slid(None).around.any() for case, _ in map(blocked, range(20)))
