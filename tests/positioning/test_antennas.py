"""Two antennas or a moving base and an inclinometer: exact without noise, honest with it."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.positioning.antennas import PoseSolution, baseline, moving_base_pose, two_antenna_pose
from workgauge.positioning.attitude import up_seen, up_sides
from workgauge.values.arrays import Floats

from .kit import Exact, pose_error, random_machine, random_pose, random_q

SEEDS = st.integers(0, 2**32 - 1)


def azimuth_of(exact: Exact) -> float:
    way = exact.antenna("ant 2").position - exact.antenna("ant 1").position
    return math.atan2(way[1], way[0])


def base_of(exact: Exact, q: Floats | None = None) -> tuple[Floats, Floats]:
    kin = exact.kin if q is None else exact.machine.forward(q)
    one, two = (exact.sensors[name] for name in ("ant 1", "ant 2"))
    return baseline(exact.machine, kin, (one.link, one.T_link_sensor[:3, 3]), (two.link, two.T_link_sensor[:3, 3]))


@settings(max_examples=80, deadline=None)
@given(SEEDS, st.integers(0, 1), st.integers(0, 2))
def test_the_pose_comes_back_exactly(seed: int, tilt_link: int, antenna_link: int) -> None:
    rng = np.random.default_rng(seed)
    machine = random_machine(rng, tilt_link, antenna_link)
    exact = Exact(machine, random_pose(rng), random_q(rng, machine))
    way = exact.antenna("ant 2").position - exact.antenna("ant 1").position
    if math.hypot(way[0], way[1]) < 0.3:
        return
    A, B = rng.normal(size=(2, 3, 3))
    Q = np.zeros((machine.n, machine.n))
    two = two_antenna_pose(
        machine, exact.kin, exact.antenna("ant 1", A @ A.T), exact.antenna("ant 2", B @ B.T), exact.tilt(), Q
    )
    one = moving_base_pose(
        machine, exact.kin, exact.antenna("ant 1"), azimuth_of(exact), 1e-3, base_of(exact), exact.tilt(), Q
    )
    for solution in (two, one):
        assert solution is not None
        np.testing.assert_allclose(solution.T_site_machine, exact.T, atol=1e-9)
        np.testing.assert_allclose(
            solution.T_site_machine[:3, :3] @ solution.T_site_machine[:3, :3].T, np.eye(3), atol=1e-12
        )


def solve(kind: str, exact: Exact, e: Floats, S: Floats) -> PoseSolution:
    """The pose with errors e of (first place, second place or azimuth, roll and pitch, joints), covariance S."""
    machine, places = exact.machine, 6 if kind == "two" else 4
    q = exact.q + e[places + 2 :]
    kin = machine.forward(q)
    Q = S[places + 2 :, places + 2 :]
    sigma = math.sqrt(S[places, places])
    tilt = exact.tilt(sigma=sigma, error=(e[places], e[places + 1]))
    first = exact.antenna("ant 1", S[:3, :3], e[:3])
    if kind == "two":
        second = exact.antenna("ant 2", S[3:6, 3:6], e[3:6])
        found = two_antenna_pose(machine, kin, first, second, tilt, Q)
    else:
        azimuth, sigma_azimuth = azimuth_of(exact) + e[3], math.sqrt(S[3, 3])
        found = moving_base_pose(machine, kin, first, azimuth, sigma_azimuth, base_of(exact, q), tilt, Q)
    assert found is not None
    return found


def spread(kind: str, rng: np.random.Generator, n: int, scale: float) -> Floats:
    """A covariance of the errors."""
    places = [np.diag(rng.uniform(0.5, 2, 3) ** 2) for _ in range(2)]
    A = rng.normal(size=(n, n))
    middle = [places[1]] if kind == "two" else [np.array([[0.3**2]])]
    blocks = [places[0], *middle, np.eye(2) * rng.uniform(0.05, 0.3) ** 2, 0.02 * A @ A.T]
    size = sum(len(block) for block in blocks)
    S, at = np.zeros((size, size)), 0
    for block in blocks:
        S[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return S * scale**2


@settings(max_examples=30, deadline=None)
@given(SEEDS, st.sampled_from(["two", "one"]), st.integers(0, 1))
def test_covariance_against_finite_differences(seed: int, kind: str, tilt_link: int) -> None:
    rng = np.random.default_rng(seed)
    machine = random_machine(rng, tilt_link)
    exact = Exact(machine, random_pose(rng), random_q(rng, machine))
    base = exact.antenna("ant 2").position - exact.antenna("ant 1").position
    if math.hypot(base[0], base[1]) < 0.5 or abs(abs(exact.inclination("tilt")[1]) - math.pi / 2) < 0.05:
        return
    S = spread(kind, rng, machine.n, 1e-3)
    zero = np.zeros(len(S))
    at, h = solve(kind, exact, zero, S), 1e-6
    G = np.empty((6, len(S)))
    for k in range(len(S)):
        step = np.eye(len(S))[k] * h
        up, down = (solve(kind, exact, sign * step, S).T_site_machine for sign in (1.0, -1.0))
        G[:, k] = (pose_error(exact.T, up) - pose_error(exact.T, down)) / (2 * h)
    scale = np.sqrt(np.trace(G @ S @ G.T))
    np.testing.assert_allclose(at.covariance, G @ S @ G.T, atol=2e-6 * scale**2)
    # true less measured of the joints is minus their error
    places = 8 if kind == "two" else 6
    np.testing.assert_allclose(at.cross, -(G @ S)[:, places:], atol=2e-6 * scale**2)
    assert np.linalg.eigvalsh(at.covariance).min() > -1e-12 * scale**2


@pytest.mark.parametrize("kind", ["two", "one"])
@pytest.mark.parametrize("tilt_link", [0, 1])
def test_covariance_against_chance(kind: str, tilt_link: int) -> None:
    rng = np.random.default_rng(5)
    machine = random_machine(rng, tilt_link)
    exact = Exact(machine, random_pose(rng, 0.1), random_q(rng, machine))
    S = spread(kind, rng, machine.n, 2e-3)
    at = solve(kind, exact, np.zeros(len(S)), S)
    draws = rng.multivariate_normal(np.zeros(len(S)), S, size=2000)
    xi = np.array([pose_error(exact.T, solve(kind, exact, e, S).T_site_machine) for e in draws])
    squared = np.einsum("ki,ij,kj->k", xi, np.linalg.inv(at.covariance), xi)
    assert abs(squared.mean() - 6.0) < 5 * math.sqrt(12 / len(draws))  # chi squared of six
    for k in (1.0, 2.0, 3.0):
        share = np.mean(np.abs(xi) > k * np.sqrt(np.diag(at.covariance)), axis=0)
        tail = math.erfc(k / math.sqrt(2))
        assert (abs(share - tail) < 5 * math.sqrt(tail * (1 - tail) / len(draws))).all()


def test_a_point_on_the_cab_owes_nothing_to_the_swing_angle() -> None:
    """With antennas and inclinometer on the cab, an error of swing turns the undercarriage and nothing else."""
    rng = np.random.default_rng(3)
    machine = random_machine(rng, 1)
    exact = Exact(machine, random_pose(rng), random_q(rng, machine))
    Q = np.zeros((machine.n, machine.n))
    Q[0, 0] = math.radians(1.0) ** 2
    nothing = np.zeros((3, 3))
    solution = two_antenna_pose(
        machine,
        exact.kin,
        exact.antenna("ant 1", nothing),
        exact.antenna("ant 2", nothing),
        exact.tilt(sigma=0.0),
        Q,
    )
    assert solution is not None
    T, covariance, cross = solution
    assert covariance[5, 5] > 0.9 * Q[0, 0]
    for link in range(1, machine.n + 1):
        p = exact.kin.T_machine_links[link][:3, 3] + rng.normal(size=3)
        arm = T[:3, :3] @ p
        x, y, z = arm
        by_pose = np.hstack([np.eye(3), np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]])])
        by_joints = T[:3, :3] @ machine.point_jacobians(exact.kin, [link], p[None])[0]
        whole = np.block([[covariance, cross], [cross.T, Q]])
        rows = np.hstack([by_pose, by_joints])
        assert np.abs(rows @ whole @ rows.T).max() < 1e-12 * Q[0, 0] * (1 + arm @ arm)
        # taken as independent the two errors add up: sure enough, twice too cautious in the variance
        apart = rows @ np.block([[covariance, 0 * cross], [0 * cross.T, Q]]) @ rows.T
        assert np.trace(apart) >= np.trace(by_joints @ Q @ by_joints.T)


def test_errors_the_two_antennas_share_turn_nothing() -> None:
    rng = np.random.default_rng(8)
    machine = random_machine(rng, 0)
    exact = Exact(machine, random_pose(rng), random_q(rng, machine))
    Q = np.zeros((machine.n, machine.n))
    C = np.diag([0.02, 0.03, 0.05]) ** 2
    apart, shared, whole = (
        two_antenna_pose(
            machine,
            exact.kin,
            exact.antenna("ant 1", C),
            exact.antenna("ant 2", C),
            exact.tilt(sigma=0.0),
            Q,
            common_share=share,
        )
        for share in (0.0, 0.5, 1.0)
    )
    assert apart is not None and shared is not None and whole is not None
    assert shared.covariance[5, 5] == pytest.approx(0.5 * apart.covariance[5, 5])
    assert whole.covariance[5, 5] == pytest.approx(0.0, abs=1e-15)
    np.testing.assert_allclose(whole.covariance[:3, :3], C, atol=1e-12)
    careful = two_antenna_pose(
        machine,
        exact.kin,
        exact.antenna("ant 1", C),
        exact.antenna("ant 2", C),
        exact.tilt(sigma=0.0),
        Q,
        common_share=0.5,
        cautious=True,
    )
    assert careful is not None  # no surer than with any share up to the half, in any direction
    for one in (apart, shared):
        assert np.linalg.eigvalsh(careful.covariance - one.covariance).min() > -1e-12


def test_an_upright_baseline_gives_no_heading() -> None:
    machine = load_machine("rre20")
    exact = Exact(machine, np.eye(4), machine.home)
    first = exact.antenna("antenna left")
    above = type(first)(
        first.link,
        first.position_link + np.array([0, 1.0, 0]),
        first.position + np.array([0, 0, 1.0]),
        first.covariance,
    )
    tilt = exact.tilt("undercarriage tilt")
    assert two_antenna_pose(machine, exact.kin, first, above, tilt, np.zeros((6, 6))) is None


def test_a_machine_upside_down_is_levelled_too() -> None:
    for roll, pitch in ((math.pi, 0.0), (math.pi - 1e-7, 1e-7), (3.0, 0.1)):
        machine: MachineModel = load_machine("rre20")
        from workgauge.values.transforms import rpy

        exact = Exact(machine, rpy(roll, pitch, 0.7), machine.home)
        solution = two_antenna_pose(
            machine,
            exact.kin,
            exact.antenna("antenna left"),
            exact.antenna("antenna right"),
            exact.tilt("undercarriage tilt"),
            np.zeros((6, 6)),
        )
        assert solution is not None
        np.testing.assert_allclose(solution.T_site_machine, exact.T, atol=1e-9)


@settings(max_examples=100, deadline=None)
@given(st.floats(-3, 3), st.floats(-1.5, 1.5))
def test_the_sides_of_up_lead_to_more_roll_and_more_pitch(roll: float, pitch: float) -> None:
    h, up, sides = 1e-6, np.array(up_seen(roll, pitch)), np.array(up_sides(roll, pitch))
    np.testing.assert_allclose(np.vstack([up, sides]) @ np.vstack([up, sides]).T, np.eye(3), atol=1e-12)
    for side, (dr, dp), length in zip(sides, ((h, 0.0), (0.0, h)), (math.cos(pitch), 1.0), strict=True):
        slope = (np.array(up_seen(roll + dr, pitch + dp)) - np.array(up_seen(roll - dr, pitch - dp))) / (2 * h)
        np.testing.assert_allclose(length * side, slope, atol=1e-9)
