"""The slack of each corner of one of the machine's solids against one convex cell, along one direction; compiled.

See `sweep` for what slack is.
"""

import math
from typing import Any

import numpy as np

from workgauge.proximity.separation import lowest
from workgauge.values.compiled import njit


@njit(cache=True)
def corner_slacks(
    p: int, i: int, u: Any, arm: Any, pairs: Any, hulls: Any, doubt: Any, reach: Any, out: Any, rows: Any
) -> tuple[float, float]:
    """Fill out (8,) with the slack of each corner of pair i's solid at posture p and rows (8, n).

    Returns the least slack, and the least of `slack - |row| . reach` over the corners and all of reach, or 0 if it is
    more. If a coarser bound shows that it is, the slack is that bound and nothing is filled. reach: of `reached`.
    """
    axes, origins, rotations, corners, prismatic, links, stretch, levers, width, spread = arm
    solids, others, own, _, need, variance, extra, _, _, moving = pairs
    exact, covariance, k, bias, largest, origin, times = doubt
    n = axes.shape[1]
    s, o = solids[i], others[i]
    ux, uy, uz = u[0], u[1], u[2]
    if own[i]:  # u is fixed to the other link
        R = rotations[p, o]
        ux, uy, uz = turned(R, u, 0), turned(R, u, 1), turned(R, u, 2)
    body = corners[p, s]
    other = corners[p, o] if own[i] else hulls[0][hulls[1][o] : hulls[1][o + 1]]
    y = lowest(other, -ux, -uy, -uz)
    yx, yy, yz = other[y, 0], other[y, 1], other[y, 2]
    plane = ux * yx + uy * yy + uz * yz + need[i]
    loose = spread[p, s] + largest + bias
    if own[i]:
        loose += spread[p, o]
    else:
        plane += hulls[4][o]
    if moving[i]:
        plane += approach(i, u, other, pairs[7], pairs[8]) * times[p]
    x = lowest(body, ux, uy, uz)
    coarse = body[x, 0] * ux + body[x, 1] * uy + body[x, 2] * uz - plane - loose
    changes, bands, turns = reach
    band = bands[s] + bands[o] if own[i] else bands[s]
    if coarse >= band:
        return coarse, 0.0
    base, top = (links[o] if own[i] else 0), links[s]
    # g_j = u . (a_j x (x - o_j)) = (u x a_j) . x - (u x a_j) . o_j, or u . a_j of a sliding joint; joints that carry
    # both links change nothing between them
    turns[:] = 0.0
    wide = spread[p, s] > 0.0
    for j in range(base, top):
        ax, ay, az = axes[p, j, 0], axes[p, j, 1], axes[p, j, 2]
        if prismatic[j]:
            turns[j, 3] = ax * ux + ay * uy + az * uz
            continue
        if wide:  # and d^2(u . x)/dq_j^2 = -(u less its part along a_j) . (x - o_j)
            along, half = ax * ux + ay * uy + az * uz, 0.5 * width[p, j] * width[p, j]
            bx, by, bz = half * (ux - along * ax), half * (uy - along * ay), half * (uz - along * az)
            turns[j, 4], turns[j, 5], turns[j, 6] = bx, by, bz
            turns[j, 7] = -(bx * origins[p, j, 0] + by * origins[p, j, 1] + bz * origins[p, j, 2])
        mx, my, mz = uy * az - uz * ay, uz * ax - ux * az, ux * ay - uy * ax
        turns[j, 0], turns[j, 1], turns[j, 2] = mx, my, mz
        turns[j, 3] = -(mx * origins[p, j, 0] + my * origins[p, j, 1] + mz * origins[p, j, 2])
    js, face, side = stretch[s, 0], stretch[s, 1], stretch[s, 2]
    grown = side * along_axis(rotations[p, s], face, ux, uy, uz) if js >= 0 else 0.0
    jo = stretch[o, 0] if own[i] else -1
    shrunk = 0.0
    if jo >= 0 and (((y >> (2 - stretch[o, 1])) & 1) == 1) == (stretch[o, 2] > 0):
        shrunk = stretch[o, 2] * along_axis(rotations[p, o], stretch[o, 1], ux, uy, uz)
    lost = bias + extra[i]
    if wide:
        lost += _together(p, s, levers, width)
    if own[i] and spread[p, o] > 0.0:
        lost += _second_order(p, o, levers, width)
    if exact:
        lost += k * math.sqrt(variance[i])
    least, tightest = math.inf, 0.0
    for c in range(8):
        cx, cy, cz = body[c, 0], body[c, 1], body[c, 2]
        value = ux * cx + uy * cy + uz * cz - plane - lost
        for j in range(n):
            g = turns[j, 0] * cx + turns[j, 1] * cy + turns[j, 2] * cz + turns[j, 3]
            if j == js and (((c >> (2 - face)) & 1) == 1) == (side > 0):
                g += grown
            if j == jo:
                g -= shrunk
            rows[c, j] = g
            value -= abs(g) * width[p, j]
            if wide:
                value -= max(turns[j, 4] * cx + turns[j, 5] * cy + turns[j, 6] * cz + turns[j, 7], 0.0)
        if not exact:
            rx, ry, rz = cx - origin[0], cy - origin[1], cz - origin[2]
            value -= k * math.sqrt(variance[i] + _variance(own[i], ux, uy, uz, rx, ry, rz, rows[c], covariance))
        out[c] = value
        least = min(least, value)
        if value < band:
            tightest = min(tightest, value - needed(rows[c], changes))
    return least, tightest


@njit(cache=True)
def reached(changes: Any, levers: Any) -> Any:
    """Return changes (c, n) [rad, m] with the slack that any of them may use up on each solid (S,), and room."""
    bands = np.zeros(levers.shape[0])
    for s in range(levers.shape[0]):
        for a in range(changes.shape[0]):
            total = 0.0
            for j in range(changes.shape[1]):
                total += levers[s, j] * changes[a, j]
            bands[s] = max(bands[s], total)
    return changes, bands, np.zeros((changes.shape[1], 8))


@njit(cache=True)
def needed(row: Any, changes: Any) -> float:
    """Return the largest `|row| . change` over all of changes (c, n)."""
    most = 0.0
    for a in range(changes.shape[0]):
        total = 0.0
        for j in range(row.shape[0]):
            total += abs(row[j]) * changes[a, j]
        most = max(most, total)
    return most


@njit(cache=True)
def turned(R: Any, u: Any, i: int) -> float:
    """Return component i of u (3,) turned by R (3, 3)."""
    return float(R[i, 0] * u[0] + R[i, 1] * u[1] + R[i, 2] * u[2])


@njit(cache=True)
def along_axis(R: Any, axis: int, ux: float, uy: float, uz: float) -> float:
    """Return the component along one axis of R (3, 3) of (ux, uy, uz)."""
    return float(R[0, axis] * ux + R[1, axis] * uy + R[2, axis] * uz)


@njit(cache=True)
def _together(p: int, s: int, levers: Any, width: Any) -> float:
    """Return what turns within the intervals may take off a point of solid s beyond first order, but for each joint's
    own second order: the mixed second order, and all of the third [m]."""
    total, before, farthest = 0.0, 0.0, 0.0
    for j in range(width.shape[1]):
        if levers[s, j] > 0.0:
            total += before * width[p, j] * levers[s, j]
            before += width[p, j]
            farthest = max(farthest, levers[s, j])
    return total + before * before * before * farthest / 6.0


@njit(cache=True)
def _second_order(p: int, s: int, levers: Any, width: Any) -> float:
    """Return what the turns within the intervals add to the way of any point of solid s beyond first order [m]."""
    total, before = 0.0, 0.0
    for j in range(width.shape[1]):
        if levers[s, j] > 0.0:
            total += (before + 0.5 * width[p, j]) * width[p, j] * levers[s, j]
            before += width[p, j]
    return total


@njit(cache=True)
def _variance(
    own: Any, ux: float, uy: float, uz: float, rx: float, ry: float, rz: float, row: Any, covariance: Any
) -> float:
    """Return the variance of `u . x` for errors of pose and joints; of two own links only the joints count [m^2]."""
    n = row.shape[0]
    g = np.empty(6 + n)
    if own:
        g[:6] = 0.0
    else:
        g[0], g[1], g[2] = ux, uy, uz
        g[3], g[4], g[5] = ry * uz - rz * uy, rz * ux - rx * uz, rx * uy - ry * ux
    g[6:] = row
    total = 0.0
    for a in range(6 + n):
        if g[a] != 0.0:
            part = 0.0
            for b in range(6 + n):
                part += covariance[a, b] * g[b]
            total += g[a] * part
    return max(total, 0.0)


@njit(cache=True)
def approach(i: int, u: Any, other: Any, speed: Any, place: Any) -> float:
    """Return how fast a moving limit comes nearer along u, at most; 0 if it recedes [m/s]."""
    most = 0.0
    for y in range(other.shape[0]):
        rx, ry, rz = other[y, 0] - place[i, 0], other[y, 1] - place[i, 1], other[y, 2] - place[i, 2]
        vx = speed[i, 0] + speed[i, 4] * rz - speed[i, 5] * ry
        vy = speed[i, 1] + speed[i, 5] * rx - speed[i, 3] * rz
        vz = speed[i, 2] + speed[i, 3] * ry - speed[i, 4] * rx
        most = max(most, vx * u[0] + vy * u[1] + vz * u[2])
    return most
