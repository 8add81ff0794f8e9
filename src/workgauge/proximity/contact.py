"""Where two convex bodies would touch if they were moved along a direction until they do: the corners of that patch.

While a body moves, the direction that separates it best from another turns with it. The signed distance then changes
as fast as the patch's points move along the direction, whatever the body's other corners do: at a post beside the
middle of a wall only the middle counts, although, seen along the fixed direction, any turn brings one end of the wall
nearer. Compiled.
"""

import math
from typing import Any

import numpy as np

from workgauge.proximity.separation import lowest, separating
from workgauge.values.compiled import njit

#: Corners that lie no farther than this behind the foremost one touch as well [m].
TIED_M = 0.002
#: A patch has at most so many corners; more are left out.
MOST = 32
#: Bodies are moved apart to this distance to seek the direction anew [m].
_APART_M = 0.05
_ROUNDS = 6
_ON_EDGE_M = 1e-6


@njit(cache=True)
def settled(body: Any, other: Any, start: Any, out: Any) -> float:
    """Fill out (3,) with the direction near `start` (3,) in which no turn of it lessens how deep two bodies overlap.

    body (m, 3), other (k, 3): corners. Returns `min out . body - max out . other` [m]. Where a round does not lessen
    the depth, the direction stays.
    """
    out[0], out[1], out[2] = start[0], start[1], start[2]
    gap = _gap(body, other, out)
    moved, trial = np.empty_like(other), np.empty(3)
    for _ in range(_ROUNDS):
        for i in range(other.shape[0]):
            for a in range(3):
                moved[i, a] = other[i, a] - out[a] * (_APART_M - gap)
        if separating(body, moved, out, trial) <= 0.0:
            break
        found = _gap(body, other, trial)
        if found <= gap + 1e-9:
            break
        gap = found
        out[0], out[1], out[2] = trial[0], trial[1], trial[2]
    return gap


@njit(cache=True)
def _gap(body: Any, other: Any, u: Any) -> float:
    x, y = lowest(body, u[0], u[1], u[2]), lowest(other, -u[0], -u[1], -u[2])
    return float(
        u[0] * (body[x, 0] - other[y, 0]) + u[1] * (body[x, 1] - other[y, 1]) + u[2] * (body[x, 2] - other[y, 2])
    )


@njit(cache=True)
def patch(body: Any, other: Any, u: Any, points: Any) -> int:
    """Fill points (MOST, 3) with the corners of where two bodies would touch along u (3,), on the body's side.

    body (m, 3), other (k, 3): corners; u: unit vector from other to body. Returns how many; 0 if the bodies would not
    touch face to face along u: another direction separates them better.
    """
    first, second = np.empty(3), np.empty(3)
    _across(u, first, second)
    a, height = _foremost(body, u, first, second)
    b, _ = _foremost(other, -u, first, second)
    count = 0
    for i in range(len(a)):
        if _covers(b, a[i, 0], a[i, 1]):
            count = _add(a[i, 0], a[i, 1], height, u, first, second, points, count)
    for i in range(len(b)):
        if _covers(a, b[i, 0], b[i, 1]):
            count = _add(b[i, 0], b[i, 1], height, u, first, second, points, count)
    for i in range(len(a)):
        for j in range(i):
            for k in range(len(b)):
                for m in range(k):
                    share = _crossing(a[i], a[j], b[k], b[m])
                    if share >= 0.0:
                        x = a[i, 0] + share * (a[j, 0] - a[i, 0])
                        y = a[i, 1] + share * (a[j, 1] - a[i, 1])
                        count = _add(x, y, height, u, first, second, points, count)
    return count


@njit(cache=True)
def _across(u: Any, first: Any, second: Any) -> None:
    """Fill in two unit vectors across u and each other."""
    at = 0
    for c in range(1, 3):
        if abs(u[c]) < abs(u[at]):
            at = c
    x, y, z = (1.0 if at == 0 else 0.0), (1.0 if at == 1 else 0.0), (1.0 if at == 2 else 0.0)
    first[0], first[1], first[2] = u[1] * z - u[2] * y, u[2] * x - u[0] * z, u[0] * y - u[1] * x
    length = math.sqrt(first[0] ** 2 + first[1] ** 2 + first[2] ** 2)
    for c in range(3):
        first[c] /= length
    second[0] = u[1] * first[2] - u[2] * first[1]
    second[1] = u[2] * first[0] - u[0] * first[2]
    second[2] = u[0] * first[1] - u[1] * first[0]


@njit(cache=True)
def _foremost(points: Any, u: Any, first: Any, second: Any) -> Any:
    """Return (f, 2), across u, the points that lie least far along u or within `TIED_M` of it, and how far."""
    x = lowest(points, u[0], u[1], u[2])
    height = points[x, 0] * u[0] + points[x, 1] * u[1] + points[x, 2] * u[2]
    found, count = np.empty((points.shape[0], 2)), 0
    for i in range(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        if px * u[0] + py * u[1] + pz * u[2] <= height + TIED_M:
            found[count, 0] = px * first[0] + py * first[1] + pz * first[2]
            found[count, 1] = px * second[0] + py * second[1] + pz * second[2]
            count += 1
    return found[:count], height


@njit(cache=True)
def _add(x: float, y: float, height: float, u: Any, first: Any, second: Any, points: Any, count: int) -> int:
    if count < points.shape[0]:
        for c in range(3):
            points[count, c] = x * first[c] + y * second[c] + height * u[c]
        return count + 1
    return count


@njit(cache=True)
def _covers(corners: Any, x: float, y: float) -> bool:
    """Return whether a point of the plane lies in the hull of corners (f, 2), its edge included."""
    count = len(corners)
    for i in range(count):
        if (corners[i, 0] - x) ** 2 + (corners[i, 1] - y) ** 2 <= _ON_EDGE_M**2:
            return True
    for i in range(count):
        for j in range(i):
            ex, ey = corners[j, 0] - corners[i, 0], corners[j, 1] - corners[i, 1]
            square = ex * ex + ey * ey
            if square <= 0.0:
                continue
            share = ((x - corners[i, 0]) * ex + (y - corners[i, 1]) * ey) / square
            off = (x - corners[i, 0]) * ey - (y - corners[i, 1]) * ex
            if 0.0 <= share <= 1.0 and off * off <= _ON_EDGE_M**2 * square:
                return True
            for k in range(j):
                if _in_triangle(corners[i], corners[j], corners[k], x, y):
                    return True
    return False


@njit(cache=True)
def _in_triangle(a: Any, b: Any, c: Any, x: float, y: float) -> bool:
    one = (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])
    two = (c[0] - b[0]) * (y - b[1]) - (c[1] - b[1]) * (x - b[0])
    three = (a[0] - c[0]) * (y - c[1]) - (a[1] - c[1]) * (x - c[0])
    return bool((one > 0.0 and two > 0.0 and three > 0.0) or (one < 0.0 and two < 0.0 and three < 0.0))


@njit(cache=True)
def _crossing(a: Any, b: Any, c: Any, d: Any) -> float:
    """Return where on the way from a to b (2,) it crosses the one from c to d, 0 to 1; -1 if it does not."""
    ex, ey, fx, fy = b[0] - a[0], b[1] - a[1], d[0] - c[0], d[1] - c[1]
    area = ex * fy - ey * fx
    if abs(area) < 1e-12:
        return -1.0
    on_first = ((c[0] - a[0]) * fy - (c[1] - a[1]) * fx) / area
    on_second = ((c[0] - a[0]) * ey - (c[1] - a[1]) * ex) / area
    if 0.0 <= on_first <= 1.0 and 0.0 <= on_second <= 1.0:
        return float(on_first)
    return -1.0
