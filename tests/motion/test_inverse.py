"""Inverse kinematics, Mäkinen 3.5-3.10: the formula, the projector's laws, and real machines."""

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from workgauge.machine.load import load_machine
from workgauge.motion.inverse import (
    Damping,
    damped_inverse,
    filtered_inverse,
    null_projector,
    resolved,
    tool_motion,
)

machine_named = functools.cache(load_machine)

DAMPING = Damping()
entries = st.floats(-3, 3).map(lambda x: round(x, 3))
wide = arrays(float, (3, 5), elements=entries)


def lambda_squared(J: np.ndarray) -> float:
    smallest = np.sqrt(max(np.linalg.eigvalsh(J @ J.T).min(), 0.0))
    return DAMPING.largest**2 * max(1.0 - (smallest / DAMPING.threshold) ** 2, 0.0)


@settings(max_examples=200, deadline=None)
@given(wide)
def test_the_damped_inverse_is_the_printed_formula(J: np.ndarray) -> None:
    squared = lambda_squared(J)
    if squared == 0.0 or squared > 1e-5:
        expected = J.T @ np.linalg.inv(J @ J.T + squared * np.eye(3))
        assert np.allclose(damped_inverse(J, DAMPING), expected, atol=1e-6)


@settings(max_examples=200, deadline=None)
@given(wide)
def test_away_from_singularities_it_is_the_pseudo_inverse(J: np.ndarray) -> None:
    if np.linalg.svd(J, compute_uv=False)[-1] > DAMPING.threshold:
        assert np.allclose(damped_inverse(J, DAMPING), np.linalg.pinv(J), atol=1e-9)
        assert np.allclose(filtered_inverse(J, DAMPING), np.linalg.pinv(J), atol=1e-9)


@settings(max_examples=200, deadline=None)
@given(wide, arrays(float, 3, elements=entries))
def test_no_twist_makes_the_joints_run_away(J: np.ndarray, twist: np.ndarray) -> None:
    """A damped inverse gains at most 1 / (2 lambda), whatever the singularity."""
    for inverse in (damped_inverse(J, DAMPING), filtered_inverse(J, DAMPING)):
        assert np.linalg.norm(inverse, 2) <= 1.0 / DAMPING.largest + 1e-9


def test_what_cannot_be_reached_does_not_dampen_what_can() -> None:
    J = np.diag([2.0, 1.0, 0.0])
    assert np.allclose(filtered_inverse(J, DAMPING), np.diag([0.5, 1.0, 0.0]))
    assert filtered_inverse(np.zeros((3, 3)), DAMPING).tolist() == np.zeros((3, 3)).tolist()


@settings(max_examples=200, deadline=None)
@given(wide)
def test_the_projector_is_one_and_does_not_leak(J: np.ndarray) -> None:
    N = null_projector(J)
    assert np.allclose(N @ N, N, atol=1e-9) and np.allclose(N, N.T, atol=1e-12)
    assert np.allclose(J @ N, 0.0, atol=1e-4)
    assert round(float(np.trace(N))) == 5 - np.linalg.matrix_rank(J, rtol=1e-6)


def test_damping_leaks_into_the_task_and_the_projector_does_not() -> None:
    J = np.array([[1.0, 0.0, 0.0], [1.0, 0.05, 0.0]])
    leak = np.eye(3) - damped_inverse(J, DAMPING) @ J
    assert np.abs(J @ leak).max() > 1e-3
    assert np.abs(J @ null_projector(J)).max() < 1e-12


def test_a_null_space_motion_leaves_the_task_alone() -> None:
    rng = np.random.default_rng(5)
    J, twist, z = rng.normal(size=(3, 5)), rng.normal(size=3), rng.normal(size=5)
    assert np.allclose(J @ resolved(J, twist, DAMPING, z), twist)
    assert not np.allclose(resolved(J, twist, DAMPING, z), resolved(J, twist, DAMPING))


def posture(machine, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(machine.sample_min, machine.sample_max)


@pytest.mark.parametrize("seed", range(20))
def test_six_joints_do_the_whole_twist(seed: int) -> None:
    machine = machine_named("rre20")
    J = machine.tool_jacobian(machine.forward(posture(machine, seed)))
    twist = np.random.default_rng(seed + 100).normal(size=6)
    solution = tool_motion(J, twist, range(6), DAMPING)
    assert np.allclose(J @ solution.qdot, twist, atol=1e-9)
    assert solution.missed == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("name", ["sun-a", "brokk5"])
@pytest.mark.parametrize("seed", range(20))
def test_with_fewer_joints_the_position_comes_first(name: str, seed: int) -> None:
    machine = machine_named(name)
    J = machine.tool_jacobian(machine.forward(posture(machine, seed)))
    twist = np.random.default_rng(seed + 100).normal(size=6)
    solution = tool_motion(J, twist, range(machine.n), DAMPING)
    if np.linalg.svd(J[:3], compute_uv=False)[-1] > DAMPING.threshold:
        assert np.allclose(J[:3] @ solution.qdot, twist[:3], atol=1e-9)
        assert solution.missed == pytest.approx(0.0, abs=1e-9)


def test_with_fewer_joints_the_orientation_gets_what_is_left() -> None:
    """A planar arm with swing can pitch its tool in place, and cannot roll it."""
    machine = machine_named("sun-a")
    J = machine.tool_jacobian(machine.forward(machine.home))
    pitch = tool_motion(J, np.array([0, 0, 0, 0, 0.2, 0.0]), range(4), DAMPING)
    assert np.allclose(J @ pitch.qdot, [0, 0, 0, 0, 0.2, 0], atol=1e-9)
    roll = tool_motion(J, np.array([0, 0, 0, 0.2, 0.0, 0.0]), range(4), DAMPING)
    assert np.allclose(roll.qdot, 0.0, atol=1e-9)


def test_only_the_joints_that_may_move_do() -> None:
    machine = machine_named("brokk5")
    J = machine.tool_jacobian(machine.forward(machine.home))
    twist = np.array([0.2, 0.1, 0.1, 0.0, 0.0, 0.0])
    solution = tool_motion(J, twist, [0, 2, 3, 4], DAMPING)
    assert solution.qdot[1] == 0.0 and np.allclose(J[:3] @ solution.qdot, twist[:3], atol=1e-9)
    alone = tool_motion(J, twist, [1], DAMPING)
    assert np.flatnonzero(alone.qdot).tolist() == [1] and 0.1 < alone.missed <= 1.0 + 1e-9


def test_what_a_singular_arm_misses_is_told() -> None:
    J = np.zeros((6, 6))
    J[:5, :5] = np.eye(5)
    assert tool_motion(J, np.array([1.0, 0, 0, 0, 0, 0]), range(6), DAMPING).missed < 0.05
    assert tool_motion(J, np.array([0, 0, 0, 0, 0, 1.0]), range(6), DAMPING).missed == pytest.approx(1.0)
    assert tool_motion(J, np.zeros(6), range(6), DAMPING).missed == 0.0
