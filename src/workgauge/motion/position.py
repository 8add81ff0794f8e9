"""The damped inverse of the tool's position alone, in compiled code."""

import math
from typing import Any

import numpy as np

from workgauge.values.compiled import njit

#: Below this share of the largest, what is divided by is lost in rounding.
_SMALLEST = 1e-8
_SWEEPS = 12


@njit(cache=True)
def position_rates(frames: Any, T_link_tool: Any, spatial: Any, threshold: float, largest: float) -> Any:
    """Return the joint velocities (3, n) that move the tool at 1 m/s along each axis, and whether they are sure.

    The transpose of `damped_inverse` of the tool's position Jacobian J, by the eigenvectors of J J^T: the squares of
    the singular values of J are its eigenvalues.

    Args:
        frames: (n + 1, 4, 4) of the links, n >= 3. T_link_tool: (4, 4). spatial: (6, n), of `Kinematics`.
        threshold, largest: of `Damping`.
    """
    n, last = spatial.shape[1], frames[-1]
    tool, J = np.empty(3), np.empty((3, n))
    for i in range(3):
        tool[i] = last[i, 3]
        for k in range(3):
            tool[i] += last[i, k] * T_link_tool[k, 3]
    for j in range(n):
        J[0, j] = spatial[0, j] + spatial[4, j] * tool[2] - spatial[5, j] * tool[1]
        J[1, j] = spatial[1, j] + spatial[5, j] * tool[0] - spatial[3, j] * tool[2]
        J[2, j] = spatial[2, j] + spatial[3, j] * tool[1] - spatial[4, j] * tool[0]
    A, V = np.zeros((3, 3)), np.zeros((3, 3))
    for i in range(3):
        V[i, i] = 1.0
        for k in range(3):
            for j in range(n):
                A[i, k] += J[i, j] * J[k, j]
    _diagonal(A, V)
    smallest, most = max(min(A[0, 0], A[1, 1], A[2, 2]), 0.0), max(A[0, 0], A[1, 1], A[2, 2])
    squared = 0.0
    if math.sqrt(smallest) < threshold:
        squared = largest * largest * (1.0 - smallest / (threshold * threshold))
    rates = np.zeros((3, n))
    sure = math.isfinite(most) and smallest + squared > _SMALLEST * most
    for e in range(3 if sure else 0):
        share = 1.0 / (A[e, e] + squared)
        for j in range(n):
            along = share * (V[0, e] * J[0, j] + V[1, e] * J[1, j] + V[2, e] * J[2, j])
            for i in range(3):
                rates[i, j] += V[i, e] * along
    return rates, sure


@njit(cache=True)
def _diagonal(A: Any, V: Any) -> None:
    """Turn the symmetric A (3, 3) until it is diagonal, and the columns of V with it (Jacobi)."""
    for _ in range(_SWEEPS):
        off = abs(A[0, 1]) + abs(A[0, 2]) + abs(A[1, 2])
        if not off > 1e-300 + 1e-17 * (abs(A[0, 0]) + abs(A[1, 1]) + abs(A[2, 2])):
            return
        for p in range(2):
            for q in range(p + 1, 3):
                if A[p, q] == 0.0:
                    continue
                theta = 0.5 * (A[q, q] - A[p, p]) / A[p, q]
                t = math.copysign(1.0, theta) / (abs(theta) + math.sqrt(theta * theta + 1.0))
                c = 1.0 / math.sqrt(t * t + 1.0)
                s = t * c
                for k in range(3):
                    A[k, p], A[k, q] = c * A[k, p] - s * A[k, q], s * A[k, p] + c * A[k, q]
                for k in range(3):
                    A[p, k], A[q, k] = c * A[p, k] - s * A[q, k], s * A[p, k] + c * A[q, k]
                for k in range(3):
                    V[k, p], V[k, q] = c * V[k, p] - s * V[k, q], s * V[k, p] + c * V[k, q]
