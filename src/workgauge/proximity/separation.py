"""Planes between convex bodies, in compiled code: every direction gives a lower bound of their signed distance.

For convex bodies A (the machine's) and B (the limit's) and any unit vector u, `min u.a - max u.b` is at most their
signed distance, and equal to it for one u: outside the one along their closest points, inside the one along the least
way out. So a direction found by iteration is a certificate whatever the iteration did; a bad one only costs room.
"""

import math
from typing import Any

import numpy as np

from workgauge.values.compiled import njit

#: Closest points are sought until the distance is known to this share.
_RELATIVE = 1e-7
_ITERATIONS = 24


@njit(cache=True)
def lowest(points: Any, x: float, y: float, z: float) -> int:
    """Return which of the points (m, 3) lies least far along (x, y, z)."""
    best, at = math.inf, 0
    for i in range(points.shape[0]):
        far = points[i, 0] * x + points[i, 1] * y + points[i, 2] * z
        if far < best:
            best, at = far, i
    return at


@njit(cache=True)
def separating(first: Any, second: Any, start: Any, out: Any) -> float:
    """Fill out (3,) with the unit direction that separates two bodies best; return the distance it proves [m].

    The algorithm of Gilbert, Johnson and Keerthi on the corners first (m, 3) and second (k, 3), from direction
    `start` (3,). A distance of 0 or less says that they touch or overlap; out is then the start.
    """
    simplex = np.empty((4, 3))
    out[0], out[1], out[2] = start[0], start[1], start[2]
    best = -math.inf
    x, y, z = start[0], start[1], start[2]
    count = 0
    for _ in range(_ITERATIONS):
        a, b = lowest(first, x, y, z), lowest(second, -x, -y, -z)
        wx, wy, wz = first[a, 0] - second[b, 0], first[a, 1] - second[b, 1], first[a, 2] - second[b, 2]
        length = math.sqrt(x * x + y * y + z * z)
        proven = (x * wx + y * wy + z * wz) / length
        if proven > best:
            best = proven
            out[0], out[1], out[2] = x / length, y / length, z / length
        if count > 0 and length - proven <= _RELATIVE * length:
            return best
        for i in range(count):
            if simplex[i, 0] == wx and simplex[i, 1] == wy and simplex[i, 2] == wz:
                return best
        if count == 4:
            return best
        simplex[count, 0], simplex[count, 1], simplex[count, 2] = wx, wy, wz
        count, x, y, z = nearest_on(simplex, count + 1)
        if x * x + y * y + z * z < 1e-16 or count == 4:
            return min(best, 0.0)
    return best


@njit(cache=True)
def nearest_on(s: Any, count: int) -> tuple[int, float, float, float]:
    """Cut the simplex s to the corners that span its point nearest to the origin; return their number and the point.

    Four corners stay only if the origin lies inside.
    """
    if count == 1:
        return 1, s[0, 0], s[0, 1], s[0, 2]
    if count == 2:
        return _on_segment(s, 0, 1)
    if count == 3:
        mask, x, y, z = _on_triangle(s, 0, 1, 2)
        return _keep(s, mask, x, y, z)
    best, chosen = math.inf, 0
    bx, by, bz = 0.0, 0.0, 0.0
    outside = False
    for skipped in range(4):
        i, j, k = (skipped + 1) % 4, (skipped + 2) % 4, (skipped + 3) % 4
        ux, uy, uz = s[j, 0] - s[i, 0], s[j, 1] - s[i, 1], s[j, 2] - s[i, 2]
        vx, vy, vz = s[k, 0] - s[i, 0], s[k, 1] - s[i, 1], s[k, 2] - s[i, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        side = nx * (s[skipped, 0] - s[i, 0]) + ny * (s[skipped, 1] - s[i, 1]) + nz * (s[skipped, 2] - s[i, 2])
        origin = -(nx * s[i, 0] + ny * s[i, 1] + nz * s[i, 2])
        if side * origin > 0.0:
            continue
        outside = True
        mask, x, y, z = _on_triangle(s, i, j, k)
        square = x * x + y * y + z * z
        if square < best:
            best, chosen, bx, by, bz = square, mask, x, y, z
    if not outside:
        return 4, 0.0, 0.0, 0.0
    return _keep(s, chosen, bx, by, bz)


@njit(cache=True)
def _keep(s: Any, mask: int, x: float, y: float, z: float) -> tuple[int, float, float, float]:
    """Move the corners of the mask to the front; return their number and the point."""
    count = 0
    for i in range(4):
        if mask & (1 << i):
            if count != i:
                s[count, 0], s[count, 1], s[count, 2] = s[i, 0], s[i, 1], s[i, 2]
            count += 1
    return count, x, y, z


@njit(cache=True)
def _on_segment(s: Any, i: int, j: int) -> tuple[int, float, float, float]:
    """Cut the simplex to the corners of segment i, j nearest to the origin; return their number and that point."""
    ex, ey, ez = s[j, 0] - s[i, 0], s[j, 1] - s[i, 1], s[j, 2] - s[i, 2]
    square = ex * ex + ey * ey + ez * ez
    t = -(s[i, 0] * ex + s[i, 1] * ey + s[i, 2] * ez) / square if square > 0.0 else 0.0
    if t <= 0.0:
        return _keep(s, 1 << i, s[i, 0], s[i, 1], s[i, 2])
    if t >= 1.0:
        return _keep(s, 1 << j, s[j, 0], s[j, 1], s[j, 2])
    return _keep(s, (1 << i) | (1 << j), s[i, 0] + t * ex, s[i, 1] + t * ey, s[i, 2] + t * ez)


@njit(cache=True)
def _on_triangle(s: Any, i: int, j: int, k: int) -> tuple[int, float, float, float]:
    """Return the corners of triangle i, j, k that span its point nearest to the origin, as bits, and that point."""
    abx, aby, abz = s[j, 0] - s[i, 0], s[j, 1] - s[i, 1], s[j, 2] - s[i, 2]
    acx, acy, acz = s[k, 0] - s[i, 0], s[k, 1] - s[i, 1], s[k, 2] - s[i, 2]
    d1 = -(abx * s[i, 0] + aby * s[i, 1] + abz * s[i, 2])
    d2 = -(acx * s[i, 0] + acy * s[i, 1] + acz * s[i, 2])
    if d1 <= 0.0 and d2 <= 0.0:
        return 1 << i, s[i, 0], s[i, 1], s[i, 2]
    d3 = -(abx * s[j, 0] + aby * s[j, 1] + abz * s[j, 2])
    d4 = -(acx * s[j, 0] + acy * s[j, 1] + acz * s[j, 2])
    if d3 >= 0.0 and d4 <= d3:
        return 1 << j, s[j, 0], s[j, 1], s[j, 2]
    d5 = -(abx * s[k, 0] + aby * s[k, 1] + abz * s[k, 2])
    d6 = -(acx * s[k, 0] + acy * s[k, 1] + acz * s[k, 2])
    if d6 >= 0.0 and d5 <= d6:
        return 1 << k, s[k, 0], s[k, 1], s[k, 2]
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0 and d1 > d3:
        t = d1 / (d1 - d3)
        return (1 << i) | (1 << j), s[i, 0] + t * abx, s[i, 1] + t * aby, s[i, 2] + t * abz
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0 and d2 > d6:
        t = d2 / (d2 - d6)
        return (1 << i) | (1 << k), s[i, 0] + t * acx, s[i, 1] + t * acy, s[i, 2] + t * acz
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0 and (d4 - d3) + (d5 - d6) > 0.0:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return (
            (1 << j) | (1 << k),
            s[j, 0] + t * (s[k, 0] - s[j, 0]),
            s[j, 1] + t * (s[k, 1] - s[j, 1]),
            s[j, 2] + t * (s[k, 2] - s[j, 2]),
        )
    whole = va + vb + vc
    if whole == 0.0:
        return 1 << i, s[i, 0], s[i, 1], s[i, 2]
    v, w = vb / whole, vc / whole
    return (
        (1 << i) | (1 << j) | (1 << k),
        s[i, 0] + v * abx + w * acx,
        s[i, 1] + v * aby + w * acy,
        s[i, 2] + v * abz + w * acz,
    )
