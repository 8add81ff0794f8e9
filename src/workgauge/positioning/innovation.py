"""How far one solution lies from another for its own uncertainty, in sigmas that mean what they say.

A distance in several dimensions is exceeded by chance more often than in one: three-dimensional differences of
honest noise pass `sqrt(chi2) = 5` once in 65,000, one-dimensional ones once in 1.7 million. So chi2 is turned into
the sigmas of one Gaussian with the same two-sided tail: a limit of 5 has one false alarm rate whatever is compared.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import erfcx, ndtri_exp

from workgauge.values.arrays import Floats


def sigmas(difference: Floats, covariance: Floats) -> float:
    """Return by how many sigmas a difference (d,) stands out of its covariance (d, d).

    The covariance is that of the difference: the sum of both sides' if their errors are independent. Directions
    without variance count with a micrometre (microradian). NaN anywhere, or a covariance with a variance below zero,
    gives infinity: what cannot be compared does not agree.
    """
    d = np.asarray(difference, dtype=np.float64)
    S = np.asarray(covariance, dtype=np.float64)
    if not (np.isfinite(d).all() and np.isfinite(S).all()):
        return math.inf
    variances, axes = np.linalg.eigh(0.5 * (S + S.T))
    if variances[0] < -1e-9 * max(1.0, float(variances[-1])):
        return math.inf
    along = axes.T @ d
    return equivalent_sigmas(float(np.sum(along**2 / np.maximum(variances, 1e-12))), len(d))


def equivalent_sigmas(chi2: float, dimensions: int) -> float:
    """Return the sigmas of one Gaussian whose two-sided tail is that of `chi2` in so many dimensions.

    Raises:
        ValueError: for fewer than one dimension.
    """
    if dimensions < 1:
        raise ValueError("at least one dimension")
    if not chi2 > 0.0:
        return 0.0 if chi2 == 0.0 else math.inf
    if dimensions == 1 or math.isinf(chi2):
        return math.sqrt(chi2)
    if chi2 > 1e9:
        return math.sqrt(chi2)  # the dimensions no longer matter
    return max(0.0, -float(ndtri_exp(log_tail(chi2, dimensions) - math.log(2.0))))


def log_tail(chi2: float, dimensions: int) -> float:
    """Return the logarithm of the chi-squared tail probability Q(d/2, chi2/2), exact by its finite sums.

    Even: `exp(-t) sum t^i / i!`; odd: `erfc(sqrt t) + exp(-t) sum t^(i+1/2) / Gamma(i+3/2)`, with t = chi2 / 2
    (Abramowitz and Stegun 26.4.4, 26.4.5).
    """
    t = 0.5 * chi2
    if t == 0.0:
        return 0.0  # also what is too small to be halved
    if dimensions % 2:
        total = float(erfcx(math.sqrt(t)))
        powers = [(i + 0.5) for i in range(dimensions // 2)]
    else:
        total = 0.0
        powers = [float(i) for i in range(dimensions // 2)]
    total += sum(math.exp(p * math.log(t) - math.lgamma(p + 1.0)) for p in powers)
    return math.log(total) - t


@dataclass(frozen=True, slots=True)
class Candidate:
    """A refused solution, kept to see whether the next one agrees with it; plain values only.

    Attributes:
        epoch_ns: its time [ns]. position: east, north, up [m].
        covariance: its 3 x 3 covariance, row by row [m^2].
    """

    epoch_ns: int
    position: tuple[float, float, float]
    covariance: tuple[float, ...]

    @classmethod
    def of(cls, epoch_ns: int, position: Floats, covariance: Floats) -> "Candidate":
        """Return the candidate of a solution: position (3,), covariance (3, 3)."""
        e, n, u = (float(value) for value in position)
        return cls(epoch_ns, (e, n, u), tuple(float(value) for value in np.asarray(covariance).ravel()))


def agreement(last: Candidate | None, new: Candidate, velocity: Floats, velocity_sigma_m_s: float) -> float:
    """Return how many sigmas a refused solution lies from the refused one before it, carried on by a velocity.

    Args:
        last: the refused solution before, or None: then NaN.
        velocity: (3,) of the antenna or the machine over ground [m/s]; NaN counts as standing.
        velocity_sigma_m_s: 1-sigma of each of its components.
    """
    if last is None:
        return math.nan
    dt = (new.epoch_ns - last.epoch_ns) * 1e-9
    moved = np.nan_to_num(np.asarray(velocity, dtype=np.float64)) * dt
    S = np.reshape(np.array(last.covariance) + np.array(new.covariance), (3, 3))
    S = S + np.eye(3) * (velocity_sigma_m_s * dt) ** 2
    return sigmas(np.array(new.position) - np.array(last.position) - moved, S)
