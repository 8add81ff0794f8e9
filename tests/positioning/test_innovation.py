"""Sigmas mean what they say: the same tail whatever is compared, and no false alarm from honest noise."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import stats

from workgauge.machine.positioning import Thresholds
from workgauge.positioning.evidence import HealthMemory, HealthSeen
from workgauge.positioning.health import judge
from workgauge.positioning.innovation import Candidate, agreement, equivalent_sigmas, log_tail, sigmas
from workgauge.values.health import HealthState
from workgauge.values.navigation import FixQuality

EPOCHS = 100_000
SIGMA_M = 0.015


@pytest.mark.parametrize("dimensions", [1, 2, 3, 4, 5, 6])
@pytest.mark.parametrize("chi2", [1e-6, 0.3, 1.0, 9.0, 25.0, 400.0, 900.0])
def test_the_tail_is_that_of_the_distribution(chi2: float, dimensions: int) -> None:
    assert log_tail(chi2, dimensions) == pytest.approx(stats.chi2.logsf(chi2, dimensions), rel=1e-9, abs=1e-12)
    z = equivalent_sigmas(chi2, dimensions)
    if z < 30:
        assert 2 * stats.norm.sf(z) == pytest.approx(stats.chi2.sf(chi2, dimensions), rel=1e-6)


@example(5e-324, 0.0, 1)
@given(st.floats(0, 1e12), st.floats(0, 1e12), st.integers(1, 6))
def test_farther_is_more_sigmas_and_more_dimensions_are_fewer(one: float, other: float, dimensions: int) -> None:
    near, far = sorted((equivalent_sigmas(one, dimensions), equivalent_sigmas(other, dimensions)))
    assert (near <= far) and (equivalent_sigmas(max(one, other), dimensions) == far)
    assert 0.0 <= equivalent_sigmas(one, dimensions + 1) <= equivalent_sigmas(one, dimensions) + 1e-9


def test_what_cannot_be_compared_does_not_agree() -> None:
    assert sigmas(np.array([math.nan, 0.0]), np.eye(2)) == math.inf
    assert sigmas(np.zeros(2), np.diag([1.0, math.inf])) == math.inf
    assert sigmas(np.zeros(2), np.diag([1.0, -1.0])) == math.inf
    assert equivalent_sigmas(math.nan, 2) == math.inf
    with pytest.raises(ValueError, match="dimension"):
        equivalent_sigmas(1.0, 0)


def test_a_direction_without_variance_counts_with_a_micrometre() -> None:
    assert sigmas(np.array([0.0, 1e-5]), np.diag([1.0, 0.0])) > 9.0
    assert sigmas(np.array([0.0, 0.0]), np.zeros((2, 2))) == 0.0


@settings(max_examples=50)
@given(st.integers(0, 2**31))
def test_the_frame_does_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, d = rng.normal(size=(3, 3)), rng.normal(size=3)
    S, (Q, _) = A @ A.T + 0.01 * np.eye(3), np.linalg.qr(rng.normal(size=(3, 3)))
    assert sigmas(Q @ d, Q @ S @ Q.T) == pytest.approx(sigmas(d, S), rel=1e-9)


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_three_sigmas_are_passed_as_often_as_they_should_be(dimensions: int) -> None:
    """100,000 honest differences: the rate beyond 3 sigma lies in the binomial 99.9 % interval round 0.27 %."""
    rng = np.random.default_rng(dimensions)
    chi2 = (rng.standard_normal((EPOCHS, dimensions)) ** 2).sum(axis=1)
    beyond = sum(equivalent_sigmas(float(value), dimensions) > 3.0 for value in chi2)
    low, high = stats.binom.interval(0.999, EPOCHS, 2 * stats.norm.sf(3.0))
    assert low <= beyond <= high


def gauss_markov(seed: int, epochs: int, tau_s: float, dt_s: float) -> np.ndarray:
    """Return (epochs, 3) of noise with sigma 1: white if tau is 0."""
    rng = np.random.default_rng(seed)
    white = rng.standard_normal((epochs, 3))
    keep = math.exp(-dt_s / tau_s) if tau_s > 0 else 0.0
    out, now = np.empty_like(white), white[0]
    for k in range(epochs):
        now = keep * now + math.sqrt(1 - keep * keep) * white[k]
        out[k] = now
    return out


@pytest.mark.parametrize("tau_s", [pytest.param(0.0, marks=pytest.mark.prove), 60.0])
def test_no_false_alarm_in_a_hundred_thousand_honest_fixes(tau_s: float) -> None:
    """Each fix against the one before it, with the covariance of two independent ones; noise white and correlated.

    The expected number beyond 5 sigma is 0.06 for white noise and less for correlated. Baseline and heading of two
    antennas 2.2 m apart ride along. Not one leaves `fixed`.
    """
    limits = Thresholds()
    left, right = (SIGMA_M * gauss_markov(seed, EPOCHS, tau_s, 0.1) for seed in (11, 12))
    chi2 = (np.diff(left, axis=0, prepend=left[:1]) ** 2).sum(axis=1) / (2 * SIGMA_M**2)
    innovations = [equivalent_sigmas(float(value), 3) for value in chi2]
    apart = right[:, :2] - left[:, :2]
    lengths, turns = (np.hypot(2.2 + apart[:, 0], apart[:, 1]) - 2.2).tolist(), (apart[:, 1] / 2.2).tolist()
    sigma = math.sqrt(2) * SIGMA_M
    memory, worst, left_fixed, bare = HealthMemory(), max(innovations), 0, 0
    for k in range(EPOCHS):
        seen = HealthSeen(
            now_ns=k * 100_000_000,
            fix_age_s=0.12 if k else math.inf,
            quality=FixQuality.FIXED,
            sigma_m=SIGMA_M,
            correction_age_s=1.0,
            innovation=innovations[k],
            baseline_error_m=lengths[k],
            baseline_sigma_m=sigma,
            heading_difference=turns[k],
            heading_sigma=sigma / 2.2,
            speed_m_s=0.0,
            new_age_s=0.02,
        )
        health, _, memory = judge(seen, memory, limits)
        left_fixed += k >= 20 and health.state is not HealthState.FIXED
        bare += abs(lengths[k]) > limits.baseline_m
    assert left_fixed == 0 and worst < 5.0
    assert bare > 0.003 * EPOCHS  # without the noise taken into account, the baseline alone would cry wolf


@pytest.mark.parametrize(("jump_m", "found"), [(0.02, False), (0.2, True), (1.0, True)])
def test_a_jump_is_found_once_it_stands_out(jump_m: float, found: bool) -> None:
    difference = np.array([jump_m, 0.0, 0.0])
    assert (sigmas(difference, 2 * SIGMA_M**2 * np.eye(3)) > Thresholds().innovation_sigmas) == found


def test_fixes_at_the_new_place_agree_with_each_other_also_on_the_move() -> None:
    R = SIGMA_M**2 * np.eye(3)
    first = Candidate.of(0, np.array([0.0, 0.0, 0.0]), R)
    second = Candidate.of(100_000_000, np.array([0.2, 0.0, 0.01]), R)
    assert math.isnan(agreement(None, first, np.zeros(3), 0.0))
    assert agreement(first, second, np.array([2.0, 0.0, 0.0]), 0.02) < 2.0
    assert agreement(first, second, np.array([math.nan] * 3), 0.02) > 5.0
