"""The pose carried on to now: right for steady motion, and never surer than it is."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.positioning.motion import (
    Motion,
    Past,
    carried,
    largest_horizontal_sigma,
    remembered,
    settled,
    slope,
)
from workgauge.values.navigation import FixQuality
from workgauge.values.transforms import rotation_z

from .kit import moved, random_pose

S = 1_000_000_000


def history(
    poses: list[tuple[float, float, float, float]], rate_hz: float = 20.0, var: float = 1e-4
) -> tuple[Past, ...]:
    out: tuple[Past, ...] = ()
    for i, (x, y, z, yaw) in enumerate(poses):
        out = remembered(out, Past(round(i / rate_hz * S), FixQuality.FIXED, x, y, z, yaw, var, var / 4))
    return out


@settings(max_examples=100, deadline=None)
@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(-3, 3), st.floats(-0.3, 0.3), st.integers(5, 40))
def test_a_steady_motion_is_found_exactly(vx: float, vy: float, vz: float, w: float, count: int) -> None:
    poses = [
        (vx * i / 20, vy * i / 20, vz * i / 20, math.remainder(3.0 + w * i / 20, 2 * math.pi)) for i in range(count)
    ]
    found = slope(history(poses))
    assert found is not None
    np.testing.assert_allclose([*found[0], found[1]], [vx, vy, vz, w], atol=1e-9)
    assert found[4] <= 0.6 + 1e-9
    assert slope(history(poses[:3])) is None


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.floats(-3, 3), st.floats(-0.5, 0.5), st.floats(0, 2))
def test_an_arc_is_followed(seed: int, speed: float, w: float, dt: float) -> None:
    """A machine driving at constant speed and turn, straight ahead at the start, in small steps."""
    T = random_pose(np.random.default_rng(seed), 0.0)
    motion = Motion((speed * T[0, 0], speed * T[1, 0], 0.0), w, 0.01, 0.01, math.inf, False)
    out, covariance, _ = carried(T, np.eye(6) * 1e-4, motion, dt)
    exact, steps = np.array(T), 400
    for _ in range(steps):
        half = rotation_z(0.5 * w * dt / steps)[:3, :3]
        exact[:3, 3] += half @ exact[:3, 0] * speed * dt / steps
        exact[:3, :3] = half @ half @ exact[:3, :3]
    # the chord of an arc is shorter than the arc by (w dt)^2 / 24
    bound = abs(speed) * dt * (w * dt) ** 2 / 20 + 1e-5 * abs(w) * dt + 1e-9
    assert np.abs(out - exact).max() < bound
    assert np.linalg.eigvalsh(covariance).min() >= 1e-4 - 1e-12


@settings(max_examples=100, deadline=None)
@given(st.floats(0, 2), st.floats(0, 2), st.booleans(), st.floats(0.2, 0.6))
def test_it_is_never_surer_later(first: float, second: float, standing: bool, over: float) -> None:
    velocity, over = ((0.0, 0.0, 0.0), math.inf) if standing else ((1.0, 0.0, 0.0), over)
    motion = Motion(velocity, 0.0, 0.05, 0.01, over, standing)
    early, late = (carried(np.eye(4), np.eye(6) * 1e-4, motion, dt)[1] for dt in sorted((first, second)))
    assert np.linalg.eigvalsh(late - early).min() > -1e-15
    assert largest_horizontal_sigma(late) >= largest_horizontal_sigma(early) >= 0.01 - 1e-12


def test_what_stands_stays() -> None:
    T = random_pose(np.random.default_rng(1))
    motion = settled(Motion((0.02, -0.03, 0.0), 0.001, 0.02, 0.01, 0.6, False), 0.05, 0.75)
    assert motion.standing and motion.speed_m_s == 0.0
    np.testing.assert_array_equal(carried(T, np.eye(6), motion, 2.0)[0], T)
    assert math.isnan(settled(Motion((0.02, 0, 0), 0, 0.4, 0.01, 0.6, False), 0.05, 0.75).speed_m_s)
    assert not settled(Motion((0.5, 0, 0), 0, 0.02, 0.01, 0.6, False), 0.05, 0.75).standing


@pytest.mark.parametrize("correlated", [0.0, 0.6, 1.0])
def test_the_growth_covers_white_and_correlated_noise(correlated: float) -> None:
    """Poses found with noise on a moving machine, carried on: the claimed variance against the tried one."""
    rng, sigma, draws = np.random.default_rng(4), 0.015, 3000
    decay = math.exp(-0.05 / 10.0)
    for dt in (0.05, 0.1, 0.5):
        errors, claimed = [], math.nan
        for _ in range(draws):
            slow = rng.normal(size=13)
            for i in range(1, 13):
                slow[i] = decay * slow[i - 1] + math.sqrt(1 - decay**2) * slow[i]
            noise = sigma * (math.sqrt(1 - correlated) * rng.normal(size=13) + math.sqrt(correlated) * slow)
            past = history([(2.0 * i / 20 + float(noise[i]), 0, 0, 0) for i in range(13)], var=sigma**2)
            found = slope(past)
            assert found is not None
            velocity, _, sigma_v, yaw_sigma, over = found
            motion = Motion((float(velocity[0]), 0, 0), 0.0, sigma_v, yaw_sigma, over, False)
            T = moved(np.eye(4), np.array([past[-1].x, 0, 0, 0, 0, 0]))
            out, covariance, _ = carried(T, np.eye(6) * sigma**2, motion, dt)
            errors.append(out[0, 3] - 2.0 * (12 / 20 + dt))
            claimed = float(covariance[0, 0])
        assert np.mean(np.square(errors)) < claimed * 1.02
