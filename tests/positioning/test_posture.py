"""Posture from link sensors: exact whatever tilt and swing, covariance as it comes out by trying."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import PchipInterpolator

from workgauge.machine.load import load_machine, machine_from
from workgauge.machine.positioning import WireCalibration
from workgauge.positioning.posture import PostureSolver, Reading, WireCurve, posture_of
from workgauge.values.arrays import Floats

from .kit import Exact, random_machine, random_pose, random_q, tipped

SEEDS = st.integers(0, 2**32 - 1)


def turns(q: Floats, expected: Floats) -> Floats:
    """Differences of joint positions round the circle."""
    return np.asarray(np.remainder(q - expected + np.pi, 2 * np.pi) - np.pi)


def steep(solver: PostureSolver, readings: list[Reading]) -> bool:
    """Whether a joint's axis stands so nearly upright that rounding shows."""
    return bool((solver.solve(readings).sigma > math.radians(10)).any() or np.isnan(solver.solve(readings).q).any())


@settings(max_examples=80, deadline=None)
@given(SEEDS)
def test_the_posture_comes_back_exactly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    machine = random_machine(rng)
    exact = Exact(machine, random_pose(rng), random_q(rng, machine))
    solver, readings = PostureSolver(machine), exact.readings()
    if steep(solver, readings):
        return
    q, sigma = posture_of(solver, readings)
    np.testing.assert_allclose(turns(q, exact.q), 0.0, atol=1e-9)
    assert (sigma > 0).all()
    inside = (q >= machine.sample_min - 1e-9) & (q <= machine.sample_max + 1e-9)
    assert inside[1:].all()


def test_the_shipped_machine_at_any_posture() -> None:
    machine, rng = load_machine("rre20"), np.random.default_rng(1)
    solver = PostureSolver(machine)
    for _ in range(200):
        exact = Exact(machine, random_pose(rng, 0.2), random_q(rng, machine))
        q, sigma = posture_of(solver, exact.readings())
        np.testing.assert_allclose(q, exact.q, atol=1e-9)
        assert (sigma < math.radians(0.3)).all()


@settings(max_examples=40, deadline=None)
@given(SEEDS)
def test_covariance_against_finite_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    machine = random_machine(rng)
    exact = Exact(machine, random_pose(rng), random_q(rng, machine))
    solver, readings = PostureSolver(machine), exact.readings()
    if steep(solver, readings):
        return
    found = solver.solve(readings)
    h, columns, tilt = 1e-6, [], []
    for i, channel in enumerate(solver.channels):
        for part in range(2 if channel.tilting else 1):
            moved = []
            for sign in (1.0, -1.0):
                changed, one = list(readings), readings[i]
                changed[i] = (
                    tipped(one, part, sign * h) if channel.tilting else one._replace(first=one.first + sign * h)
                )
                moved.append((solver.solve(changed).q, np.array(solver.up(0, changed[0]))))
            columns.append(turns(moved[0][0], moved[1][0]) / (2 * h) * channel.sigma)
            tilt.append((moved[0][1] - moved[1][1]) / (2 * h) * channel.sigma)
    H, U = np.array(columns).T, np.array(tilt).T
    scale = np.trace(H @ H.T)
    np.testing.assert_allclose(found.covariance, H @ H.T, atol=1e-5 * scale)
    np.testing.assert_allclose(found.tilt_cross, U @ H.T, atol=1e-5 * scale)
    np.testing.assert_allclose(solver.up_covariance(0, readings[0]), U @ U.T, atol=1e-9)


def test_joints_that_share_an_inclinometer_err_against_each_other() -> None:
    machine = load_machine("rre20")
    exact = Exact(machine, np.eye(4), machine.home)
    found = PostureSolver(machine).solve(exact.readings())
    imu, tilt = math.radians(0.1), math.radians(0.05)
    assert found.sigma[1] == pytest.approx(math.hypot(imu, tilt), rel=1e-6)
    assert found.sigma[2] == pytest.approx(math.hypot(imu, imu), rel=1e-6)
    assert found.covariance[1, 2] == pytest.approx(-(imu**2), rel=1e-6)


def test_an_upright_axis_says_nothing_of_its_joint() -> None:
    machine = load_machine("rre20")
    tipped = np.eye(4)
    tipped[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # on its side: the boom's axis is upright
    found = PostureSolver(machine).solve(Exact(machine, tipped, machine.home).readings())
    assert np.isnan(found.q[1:4]).all() and np.isfinite(found.q[[0, 4, 5]]).all()


def test_a_larger_error_that_the_sensor_states_counts() -> None:
    machine = load_machine("rre20")
    exact = Exact(machine, np.eye(4), machine.home)
    solver, readings = PostureSolver(machine), exact.readings()
    i = [channel.name for channel in solver.channels].index("swing encoder")
    for stated, counts in ((0.5, 0.5), (0.001, 0.05), (math.nan, 0.05)):
        readings[i] = readings[i]._replace(sigma=math.radians(stated))
        assert solver.solve(readings).sigma[0] == pytest.approx(math.radians(counts))


@settings(max_examples=80, deadline=None)
@given(SEEDS)
def test_a_wire_runs_through_its_points_and_never_back(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 9))
    strokes = np.cumsum(rng.uniform(0.01, 0.4, count))
    degrees = np.cumsum(rng.uniform(0.1, 40, count)) * rng.choice([-1, 1])
    curve = WireCurve(WireCalibration(stroke_m=tuple(strokes.tolist()), position_deg=tuple(degrees.tolist())))
    oracle = PchipInterpolator(strokes, np.radians(degrees))
    dense = np.linspace(strokes[0], strokes[-1], 101)
    values = np.array([curve.at(float(stroke)) for stroke in dense])
    np.testing.assert_allclose(values[:, 0], oracle(dense), atol=1e-12)
    np.testing.assert_allclose(values[:, 1], oracle(dense, 1), atol=1e-9)
    np.testing.assert_allclose([curve.at(float(s))[0] for s in strokes], np.radians(degrees), atol=1e-12)
    assert (np.diff(values[:, 0]) * np.sign(degrees[-1] - degrees[0]) > -1e-12).all()
    margin = 0.02 * (strokes[-1] - strokes[0])
    assert math.isnan(curve.at(float(strokes[0] - margin))[0]) and math.isnan(
        curve.at(float(strokes[-1] + margin))[0]
    )
    assert math.isfinite(curve.at(float(strokes[-1] + margin / 4))[0])


def test_sliding_joints_between_inclinometers_and_wires() -> None:
    """A swing, a boom by gravity, a telescope by a wire, a tip by gravity again."""

    def joint(name: str, alpha: float, **more: object) -> dict[str, object]:
        turning = {"lower_deg": -80, "upper_deg": 80, "home_deg": 0}
        speed = {"speed_positive_deg_s": 20, "speed_negative_deg_s": 20}
        dh = {"a_m": 1.0, "alpha_deg": alpha, "d_m": 0.5}
        return {"name": name, "type": "revolute", "dh": dh, **turning, **speed, **more}

    slide = {"lower_m": 0, "upper_m": 2, "home_m": 0.5, "speed_positive_m_s": 1, "speed_negative_m_s": 1}
    strokes = [0.1, 0.5, 0.9, 1.3]
    machine = machine_from(
        {
            "title": "telescope",
            "undercarriage": {"kind": "tracks", "gauge_m": 2},
            "joints": [
                joint("swing", 90),
                joint("boom", 90),
                {"name": "reach", "type": "prismatic", "dh": {"a_m": 0, "alpha_deg": -90, "d_m": 1}, **slide},
                joint("tip", 0),
            ],
            "solids": [{"name": "box", "link": "undercarriage", "centre_m": [0, 0, 0], "size_m": [1, 1, 1]}],
            "attachments": [{"name": "hook", "tool": {}, "tolerance_m": 0.01}],
            "sensors": [
                {"name": "a", "kind": "gnss_antenna", "link": "swing", "position_m": [0, 0, 1]},
                {"name": "b", "kind": "gnss_antenna", "link": "swing", "position_m": [0, 0, -1]},
                {"name": "tilt", "kind": "imu", "link": "swing", "position_m": [0, 0, 0], "rpy_deg": [5, 9, 3]},
                {"name": "dial", "kind": "encoder", "link": "swing", "position_m": [0, 0, 0]},
                {"name": "boom imu", "kind": "imu", "link": "boom", "position_m": [0, 0, 0]},
                {"name": "wire", "kind": "wire_encoder", "link": "reach", "position_m": [0, 0, 0]},
                {"name": "tip imu", "kind": "imu", "link": "tip", "position_m": [0, 0, 0], "rpy_deg": [0, 40, 0]},
            ],
            "positioning": {
                "receivers": [{"name": "r", "antenna": "a"}],
                "heading": {"kind": "moving_base", "master": "a", "rover": "b"},
                "tilt": {"sensor": "tilt"},
                "joints": [
                    {"joint": "swing", "kind": "encoder", "sensor": "dial"},
                    {"joint": "boom", "kind": "inclination", "sensor": "boom imu"},
                    {
                        "joint": "reach",
                        "kind": "wire_encoder",
                        "sensor": "wire",
                        "sign": -1,
                        "sigma_m": 0.002,
                        "calibration": {
                            "stroke_m": [-s for s in reversed(strokes)],
                            "position_m": [0, 0.6, 1.4, 2.0],
                        },
                    },
                    {"joint": "tip", "kind": "inclination", "sensor": "tip imu", "before": "boom imu"},
                ],
            },
        }
    )
    solver, rng = PostureSolver(machine), np.random.default_rng(6)
    for stroke in (0.1, 0.5, 0.9, 1.3):
        q = random_q(rng, machine)
        q[2] = dict(zip(strokes, (2.0, 1.4, 0.6, 0.0), strict=True))[stroke]
        exact = Exact(machine, random_pose(rng, 0.2), q)
        readings = [
            Reading(*exact.inclination(channel.name))
            if channel.tilting
            else Reading(stroke if channel.name == "wire" else float(q[0]))
            for channel in solver.channels
        ]
        found = solver.solve(readings)
        np.testing.assert_allclose(found.q, q, atol=1e-9)
        assert 0.001 < found.sigma[2] < 0.008 and found.covariance[2, 3] == pytest.approx(0.0, abs=1e-18)
