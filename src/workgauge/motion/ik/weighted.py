"""The weighted, damped inverse that keeps off joint limits and singularities, Lee 6-9, corrected."""

import numpy as np
from numpy.typing import NDArray

from workgauge.values.arrays import Floats

#: Nearer to a limit than this share of the range, a joint counts as this near: beyond it, the weight would invert.
_INSIDE = 1e-3
_LOST = 1e-7  # singular values below this share of the largest are rounding
_SIGNS = 8


def limit_gradient(q: Floats, q_min: Floats, q_max: Floats) -> Floats:
    """Return `dH/dq = (u - l)^2 (2q - u - l) / (4 (u - q)^2 (q - l)^2)` (n,) [1/rad, 1/m], Lee 7.

    Positive in the upper half of the range, negative in the lower, zero in the middle and for endless joints. q is
    clamped into the range first, a thousandth of it from either end.
    """
    finite = np.isfinite(q_min) & np.isfinite(q_max)
    low, high = np.where(finite, q_min, -1.0), np.where(finite, q_max, 1.0)
    span = high - low
    inside = np.clip(np.where(finite, q, 0.0), low + _INSIDE * span, high - _INSIDE * span)
    gradient: Floats = span**2 * (2.0 * inside - high - low) / (4.0 * ((high - inside) * (inside - low)) ** 2)
    return gradient


def joint_weights(gradient: Floats, towards: NDArray[np.bool_]) -> Floats:
    """Return `w = 1 + |dH/dq|` (n,) of the joints whose |dH/dq| grows or stays, 1 of the others, Lee 8.

    Args:
        gradient: (n,) of `limit_gradient`.
        towards: (n,) the joints that move towards their nearer limit, or stand: those whose |dH/dq| does not fall.
    """
    weights: Floats = np.where(towards, 1.0 + np.abs(gradient), 1.0)
    return weights


def manipulability(J: Floats, gradient: Floats, rank: int) -> float:
    """Return `m = sqrt(det(J W^-1 J^T))` of J (m, n), every joint that could near a limit weighted (Lee 9).

    The product of the singular values up to `rank`, so that it means something where joints are fewer than rows. With
    the weights of both directions it changes smoothly with the posture, and sees singularities the weights create.
    """
    sigma = np.linalg.svd(J / np.sqrt(1.0 + np.abs(gradient)), compute_uv=False)
    return float(np.prod(sigma[:rank]))


def least_velocity(J: Floats, wanted: Floats, gradient: Floats, damping: float) -> Floats:
    """Return `qdot = W^-1 J^T (J W^-1 J^T + lambda^2 I)^-1 wanted` (n,) of J (m, n), Lee 6 with W inverted.

    Whether a joint moves towards its limit, Lee 8's condition, is asked of the solution itself and not of the last
    tick: the cost `sum w_j qdot_j^2` with a weight of its own for either direction is convex, so that weights and
    motion agree and the velocity does not jump as a joint turns round.

    Args:
        wanted: (m,) task velocity. gradient: (n,) of `limit_gradient`. damping: lambda.
    """
    if J.shape[1] == 0:
        return np.zeros(0)
    towards = np.ones(J.shape[1], dtype=np.bool_)
    for _ in range(_SIGNS):
        root = np.sqrt(joint_weights(gradient, towards))
        U, sigma, Vt = np.linalg.svd(J / root, full_matrices=False)
        kept = sigma > _LOST * sigma[0]
        inverse = np.where(kept, sigma / np.where(kept, sigma * sigma + damping * damping, 1.0), 0.0)
        qdot: Floats = ((Vt.T * inverse) @ (U.T @ wanted)) / root
        now: NDArray[np.bool_] = qdot * gradient >= 0.0
        if np.array_equal(now, towards):
            break
        towards = now
    return qdot
