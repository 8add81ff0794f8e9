"""Closest points of convex bodies, in compiled code: the distance, the way out and where it starts.

The algorithm of Gilbert, Johnson and Keerthi as in `separation`, driven to the rounding of its numbers. Every answer
comes with its own certificate: how far the planes across the direction found are from proving the whole distance.
"""

import math
from typing import Any

import numpy as np

from workgauge.proximity.separation import lowest, nearest_on
from workgauge.values.compiled import njit

#: Sought until this much of the distance is unproven at most: a share of it, and the rounding of coordinates [m].
_RELATIVE, _ROUNDING_M = 1e-13, 1e-14
_ITERATIONS = 40
#: Unproven by more than this, an answer is none [m].
PROVEN_M = 1e-9


@njit(cache=True)
def closest(first: Any, second: Any, x: float, y: float, z: float, out: Any) -> float:
    """Fill out (6,) with the unit direction from the second body to the first, and the first's closest point.

    Args:
        first, second: corners (m, 3) and (k, 3). x, y, z: where to look first, from the second to the first.

    Returns:
        the distance [m], exact to `PROVEN_M`. Below zero if there is no such answer, as with bodies that touch,
        overlap or are too nearly parallel; out then means nothing.
    """
    simplex, seen, which = np.empty((4, 3)), np.empty((_ITERATIONS, 3)), np.empty(_ITERATIONS, np.int64)
    if x * x + y * y + z * z == 0.0:
        x = 1.0
    count, used, gap = 0, 0, math.inf
    while used < _ITERATIONS:
        a, b = lowest(first, x, y, z), lowest(second, -x, -y, -z)
        wx, wy, wz = first[a, 0] - second[b, 0], first[a, 1] - second[b, 1], first[a, 2] - second[b, 2]
        if count > 0:
            length = math.sqrt(x * x + y * y + z * z)
            gap = length - (x * wx + y * wy + z * wz) / length
            again = gap <= _RELATIVE * length + _ROUNDING_M
            for i in range(count):
                again = again or (simplex[i, 0] == wx and simplex[i, 1] == wy and simplex[i, 2] == wz)
            if again:
                break
        seen[used, 0], seen[used, 1], seen[used, 2], which[used] = wx, wy, wz, a
        used += 1
        simplex[count, 0], simplex[count, 1], simplex[count, 2] = wx, wy, wz
        count, x, y, z = nearest_on(simplex, count + 1)
        if count == 4 or x * x + y * y + z * z < 1e-16:
            return -1.0
    if used == _ITERATIONS:  # what was proven was the direction before the last
        a, b = lowest(first, x, y, z), lowest(second, -x, -y, -z)
        wx, wy, wz = first[a, 0] - second[b, 0], first[a, 1] - second[b, 1], first[a, 2] - second[b, 2]
        length = math.sqrt(x * x + y * y + z * z)
        gap = length - (x * wx + y * wy + z * wz) / length
    if gap > PROVEN_M:
        return -1.0
    found = _answer(first, simplex, count, seen, which, used, out)
    # of a simplex that is nearly flat, what is composed from its corners may not be what was proven
    return found if abs(found - math.sqrt(x * x + y * y + z * z)) <= PROVEN_M else -1.0


@njit(cache=True)
def _answer(first: Any, s: Any, count: int, seen: Any, which: Any, used: int, out: Any) -> float:
    """Fill out from the simplex s whose first corners span the point nearest to the origin; return the distance."""
    first_share, second_share = 0.0, 0.0
    if count == 2:
        ex, ey, ez = s[1, 0] - s[0, 0], s[1, 1] - s[0, 1], s[1, 2] - s[0, 2]
        first_share = -(s[0, 0] * ex + s[0, 1] * ey + s[0, 2] * ez) / (ex * ex + ey * ey + ez * ez)
    elif count == 3:
        ax, ay, az = s[1, 0] - s[0, 0], s[1, 1] - s[0, 1], s[1, 2] - s[0, 2]
        bx, by, bz = s[2, 0] - s[0, 0], s[2, 1] - s[0, 1], s[2, 2] - s[0, 2]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        square = nx * nx + ny * ny + nz * nz
        px, py, pz = -s[0, 0], -s[0, 1], -s[0, 2]
        first_share = ((py * bz - pz * by) * nx + (pz * bx - px * bz) * ny + (px * by - py * bx) * nz) / square
        second_share = ((ay * pz - az * py) * nx + (az * px - ax * pz) * ny + (ax * py - ay * px) * nz) / square
    for c in range(6):
        out[c] = 0.0
    for i in range(count):
        share = first_share if i == 1 else second_share if i == 2 else 1.0 - first_share - second_share
        k = 0
        while k < used - 1 and not (seen[k, 0] == s[i, 0] and seen[k, 1] == s[i, 1] and seen[k, 2] == s[i, 2]):
            k += 1
        for c in range(3):
            out[c] += share * s[i, c]
            out[3 + c] += share * first[which[k], c]
    length = math.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
    for c in range(3):
        out[c] /= length
    return length
