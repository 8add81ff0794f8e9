"""The plane beyond which a solid has most slack, all postures within its joints' intervals counted; compiled.

Slack along u is `min over the corners (u . x - sum_j |g_j(x)| w_j) - max u . y` less what hardly depends on u, see
`sweep`; and `u . x - sum_j |g_j(x)| w_j` is the least of `u . z` over all `z = x + sum_j ±w_j dx/dq_j`. So the u with
most slack separates the cell from the hull of all those z, at both ends of a step at once. It moves steadily with the
postures and the intervals, and the slack with it, where the plane apart from the middle postures alone would cost now
more and now less, as the moments looked at shift.
"""

import math
from typing import Any

import numpy as np

from workgauge.proximity.corners import along_axis
from workgauge.proximity.separation import lowest, nearest_on
from workgauge.values.compiled import njit

#: The slack is sought to within this [m].
CLOSE_M = 2e-5
_ITERATIONS = 16


@njit(cache=True)
def widest(p: int, s: int, other: Any, start: Any, arm: Any, turns: Any, out: Any) -> None:
    """Fill out (3,) with the unit direction along which solid s at posture p has most slack from corners (k, 3).

    To within `CLOSE_M`, widths counted; by the algorithm of Gilbert, Johnson and Keerthi from direction `start` (3,),
    which stays if the two cannot be told apart. turns (n, 8): room.
    """
    simplex, z = np.empty((4, 3)), np.empty(3)
    best, count = -math.inf, 0
    x, y, w = start[0], start[1], start[2]
    out[0], out[1], out[2] = x, y, w
    for _ in range(_ITERATIONS):
        length = math.sqrt(x * x + y * y + w * w)
        ux, uy, uz = x / length, y / length, w / length
        _farthest_back(p, s, ux, uy, uz, arm, turns, z)
        b = lowest(other, -ux, -uy, -uz)
        for a in range(3):
            z[a] -= other[b, a]
        proven = ux * z[0] + uy * z[1] + uz * z[2]
        if proven > best:
            best = proven
            out[0], out[1], out[2] = ux, uy, uz
        if count > 0 and length - best <= CLOSE_M:
            return
        for i in range(count):
            if simplex[i, 0] == z[0] and simplex[i, 1] == z[1] and simplex[i, 2] == z[2]:
                return
        simplex[count] = z
        count, x, y, w = nearest_on(simplex, count + 1)
        if x * x + y * y + w * w < 1e-16 or count == 4:
            out[0], out[1], out[2] = start[0], start[1], start[2]
            return


@njit(cache=True)
def _farthest_back(p: int, s: int, ux: float, uy: float, uz: float, arm: Any, turns: Any, out: Any) -> None:
    """Fill out (3,) with the point of solid s, anywhere in its intervals at posture p, that is least far along u."""
    axes, origins, rotations, corners, prismatic, links, stretch, _, width, _ = arm
    top, js, face, side = links[s], stretch[s, 0], stretch[s, 1], stretch[s, 2]
    body, best, least = corners[p, s], 0, math.inf
    joints = max(top, js + 1)
    for j in range(joints):
        ax, ay, az = axes[p, j, 0], axes[p, j, 1], axes[p, j, 2]
        turns[j, :] = 0.0
        if j >= top:
            continue
        if prismatic[j]:
            turns[j, 3] = ax * ux + ay * uy + az * uz
            continue
        mx, my, mz = uy * az - uz * ay, uz * ax - ux * az, ux * ay - uy * ax
        turns[j, 0], turns[j, 1], turns[j, 2] = mx, my, mz
        turns[j, 3] = -(mx * origins[p, j, 0] + my * origins[p, j, 1] + mz * origins[p, j, 2])
    grown = side * along_axis(rotations[p, s], face, ux, uy, uz) if js >= 0 else 0.0
    for c in range(8):
        value = ux * body[c, 0] + uy * body[c, 1] + uz * body[c, 2]
        for j in range(joints):
            g = turns[j, 0] * body[c, 0] + turns[j, 1] * body[c, 1] + turns[j, 2] * body[c, 2] + turns[j, 3]
            if j == js and _moves(c, face, side):
                g += grown
            value -= abs(g) * width[p, j]
        if value < least:
            least, best = value, c
    cx, cy, cz = body[best, 0], body[best, 1], body[best, 2]
    out[0], out[1], out[2] = cx, cy, cz
    for j in range(joints):
        g = turns[j, 0] * cx + turns[j, 1] * cy + turns[j, 2] * cz + turns[j, 3]
        stretched = j == js and _moves(best, face, side)
        if stretched:
            g += grown
        by = -width[p, j] if g > 0.0 else width[p, j]
        if stretched:
            for a in range(3):
                out[a] += by * side * rotations[p, s, a, face]
        ax, ay, az = axes[p, j, 0], axes[p, j, 1], axes[p, j, 2]
        if j < top and prismatic[j]:
            out[0], out[1], out[2] = out[0] + by * ax, out[1] + by * ay, out[2] + by * az
        elif j < top:
            rx, ry, rz = cx - origins[p, j, 0], cy - origins[p, j, 1], cz - origins[p, j, 2]
            out[0] += by * (ay * rz - az * ry)
            out[1] += by * (az * rx - ax * rz)
            out[2] += by * (ax * ry - ay * rx)


@njit(cache=True)
def _moves(c: int, face: int, side: int) -> bool:
    """Return whether corner c of a box that stretches is on the face that moves."""
    return bool((((c >> (2 - face)) & 1) == 1) == (side > 0))
