"""Lower bounds of every clearance at many postures of the arm at once, each proven by a separating plane; compiled.

For a solid of the machine, a convex cell of a limit and a unit vector u, every corner x of the solid has the slack

    u . x - max u . y - sum_j |g_j(x)| w_j - second order - approach - protection level(x) - stop distance

with y the cell's corners, g_j(x) = d(u . x)/dq_j, w_j half the width of the interval in which joint j may be at that
moment; the least over the corners bounds the pair from below, whatever u is. Along the way from one posture to the
next, the same u is used at both ends: what lies beyond a plane at both ends lies beyond it in between.
"""

import math
from typing import Any

import numpy as np
from numba import njit

from workgauge.proximity.separation import lowest, separating

#: Slacks are computed corner by corner where a coarser bound is below the band by more than this [m].
_NOTHING = 1e-12


@njit(cache=True)
def _corner_slacks(
    p: int, i: int, u: Any, arm: Any, pairs: Any, hulls: Any, doubt: Any, out: Any, rows: Any, band: float
) -> float:
    """Fill out (8,) with the slack of each corner of pair i's solid at posture p and rows (8, n); return the least.

    If a coarser bound already exceeds `band`, that is returned and nothing is filled.
    """
    axes, origins, rotations, corners, prismatic, links, stretch, levers, width, spread = arm
    solids, others, own, _, need, variance, extra, speed, place, moving = pairs
    points, starts, _, _, radii = hulls
    exact, covariance, k, bias, largest, place_machine, times = doubt
    n = axes.shape[1]
    s, o = solids[i], others[i]
    ux, uy, uz = u[0], u[1], u[2]
    body = corners[p, s]
    other = corners[p, o] if own[i] else points[starts[o] : starts[o + 1]]
    y = lowest(other, -ux, -uy, -uz)
    yx, yy, yz = other[y, 0], other[y, 1], other[y, 2]
    plane = ux * yx + uy * yy + uz * yz + need[i]
    if not own[i]:
        plane += radii[o]
    if moving[i]:
        plane += _approach(i, u, other, speed, place) * times[p]
    x = lowest(body, ux, uy, uz)
    nearest = body[x, 0] * ux + body[x, 1] * uy + body[x, 2] * uz - plane
    loose = spread[p, s] + largest + bias
    if own[i]:
        loose += spread[p, o]
    if nearest - loose >= band:
        return float(nearest - loose)
    base, top = (links[o] if own[i] else 0), links[s]
    js, face, side = stretch[s, 0], stretch[s, 1], stretch[s, 2]
    grown = 0.0
    if js >= 0:
        for c in range(3):
            grown += rotations[p, s, c, face] * u[c]
        grown *= side
    jo, shrunk = -1, 0.0
    if own[i] and stretch[o, 0] >= 0:
        jo = stretch[o, 0]
        bit = (y >> (2 - stretch[o, 1])) & 1
        if (bit == 1) == (stretch[o, 2] > 0):
            for c in range(3):
                shrunk += rotations[p, o, c, stretch[o, 1]] * u[c]
            shrunk *= stretch[o, 2]
    least = math.inf
    for c in range(8):
        cx, cy, cz = body[c, 0], body[c, 1], body[c, 2]
        value = ux * cx + uy * cy + uz * cz - plane
        for j in range(n):
            g = 0.0
            if j < top:
                ax, ay, az = axes[p, j, 0], axes[p, j, 1], axes[p, j, 2]
                if prismatic[j]:
                    g = 0.0 if j < base else ax * ux + ay * uy + az * uz
                else:
                    # u . (a x (x - o)) = (u x a) . (x - o)
                    mx, my, mz = uy * az - uz * ay, uz * ax - ux * az, ux * ay - uy * ax
                    if j < base:
                        g = mx * (cx - yx) + my * (cy - yy) + mz * (cz - yz)
                    else:
                        g = mx * (cx - origins[p, j, 0]) + my * (cy - origins[p, j, 1]) + mz * (cz - origins[p, j, 2])
            if j == js and (((c >> (2 - face)) & 1) == 1) == (side > 0):
                g += grown
            if j == jo:
                g -= shrunk
            rows[c, j] = g
            value -= abs(g) * width[p, j]
        value -= _second_order(p, s, levers, width)
        if own[i]:
            value -= _second_order(p, o, levers, width)
        value -= bias + extra[i]
        if exact:
            if variance[i] > 0.0:
                value -= k * math.sqrt(variance[i])
        else:
            value -= k * math.sqrt(
                variance[i]
                + _variance(
                    own[i],
                    u,
                    cx - place_machine[0],
                    cy - place_machine[1],
                    cz - place_machine[2],
                    rows[c],
                    covariance,
                )
            )
        out[c] = value
        least = min(least, value)
    return least


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
def _variance(own: Any, u: Any, rx: float, ry: float, rz: float, row: Any, covariance: Any) -> float:
    """Return the variance of `u . x` for errors of pose and joints; of two own links only the joints count [m^2]."""
    n = row.shape[0]
    g = np.empty(6 + n)
    if own:
        g[:6] = 0.0
    else:
        g[0], g[1], g[2] = u[0], u[1], u[2]
        g[3], g[4], g[5] = ry * u[2] - rz * u[1], rz * u[0] - rx * u[2], rx * u[1] - ry * u[0]
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
def _approach(i: int, u: Any, other: Any, speed: Any, place: Any) -> float:
    """Return how fast a moving limit comes nearer along u, at most; 0 if it recedes [m/s]."""
    most = 0.0
    for y in range(other.shape[0]):
        rx, ry, rz = other[y, 0] - place[i, 0], other[y, 1] - place[i, 1], other[y, 2] - place[i, 2]
        vx = speed[i, 0] + speed[i, 4] * rz - speed[i, 5] * ry
        vy = speed[i, 1] + speed[i, 5] * rx - speed[i, 3] * rz
        vz = speed[i, 2] + speed[i, 3] * ry - speed[i, 4] * rx
        most = max(most, vx * u[0] + vy * u[1] + vz * u[2])
    return most


@njit(cache=True)
def _better(p: int, i: int, start: Any, arm: Any, pairs: Any, hulls: Any, out: Any) -> None:
    """Fill out (3,) with the direction that separates pair i best at posture p; of overlapping ones, a way out."""
    rotations, corners = arm[2], arm[3]
    solids, others, own, given = pairs[0], pairs[1], pairs[2], pairs[3]
    points, starts, normals, faces, _ = hulls
    s, o = solids[i], others[i]
    body = corners[p, s]
    other = corners[p, o] if own[i] else points[starts[o] : starts[o + 1]]
    if separating(body, other, start, out) > 1e-6:
        return
    best = -math.inf
    trial = np.empty(3)
    out[0], out[1], out[2] = start[0], start[1], start[2]
    faces_other = 3 if own[i] else faces[o + 1] - faces[o]
    for c in range(8 + 2 * faces_other):
        for a in range(3):
            if c == 0:
                trial[a] = start[a]
            elif c == 1:
                trial[a] = given[i, a]
            elif c < 8:
                trial[a] = rotations[p, s, a, (c - 2) // 2] * (1.0 if c % 2 else -1.0)
            elif own[i]:
                trial[a] = rotations[p, o, a, (c - 8) // 2] * (1.0 if c % 2 else -1.0)
            else:
                trial[a] = normals[faces[o] + (c - 8) // 2, a] * (1.0 if c % 2 else -1.0)
        x, y = lowest(body, trial[0], trial[1], trial[2]), lowest(other, -trial[0], -trial[1], -trial[2])
        gap = 0.0
        for a in range(3):
            gap += trial[a] * (body[x, a] - other[y, a])
        if gap > best + (0.01 if c > 1 else 0.0):  # the way out already taken is kept unless another is shorter
            best = gap
            out[0], out[1], out[2] = trial[0], trial[1], trial[2]


@njit(cache=True)
def bounds(arm: Any, pairs: Any, hulls: Any, doubt: Any, band: float, slack: Any, ways: Any) -> None:
    """Fill slack (m, P) with the least slack of each pair on the way to each posture, and ways (m, P, 3) with its u.

    Where a slack is below `band` the direction is sought anew; elsewhere the slack is a coarser bound.
    """
    n, count = arm[0].shape[1], arm[0].shape[0]
    values, rows = np.empty(8), np.empty((8, n))
    u, other = np.empty(3), np.empty(3)
    for i in range(slack.shape[0]):
        u[:] = pairs[3][i]
        before = math.inf
        for p in range(count):
            here = _corner_slacks(p, i, u, arm, pairs, hulls, doubt, values, rows, band)
            on_way = min(here, before)
            ways[i, p] = u
            if here < band:
                _better(p, i, u, arm, pairs, hulls, other)
                there = _corner_slacks(p, i, other, arm, pairs, hulls, doubt, values, rows, band)
                past = math.inf
                if p > 0:
                    past = _corner_slacks(p - 1, i, other, arm, pairs, hulls, doubt, values, rows, band)
                if min(there, past) > on_way:
                    on_way = min(there, past)
                    ways[i, p] = other
                if there > here:
                    here = there
                    u[:] = other
            slack[i, p] = on_way
            before = here


@njit(cache=True)
def emit(
    arm: Any,
    pairs: Any,
    hulls: Any,
    doubt: Any,
    band: float,
    reach: Any,
    slack: Any,
    ways: Any,
    out: Any,
    rows: Any,
    which: Any,
) -> int:
    """Fill out (r,), rows (r, n), which (r, 2: pair, posture) with every corner whose slack may be used up.

    That is: `slack < |row| . reach`, with reach (n,) so large that nothing beyond `band` is. Returns how many there
    are; if more than there is room for, the rest is left out.
    """
    n = rows.shape[1]
    values, gradients = np.empty(8), np.empty((8, n))
    count = 0
    for i in range(slack.shape[0]):
        for p in range(slack.shape[1]):
            if slack[i, p] >= band:
                continue
            for back in range(2):
                at = p - back
                if at < 0:
                    continue
                if back == 1:  # the former end has been seen by this direction already
                    same = True
                    for c in range(3):
                        same = same and ways[i, p, c] == ways[i, at, c]
                    if same and slack[i, at] < band:
                        continue
                if _corner_slacks(at, i, ways[i, p], arm, pairs, hulls, doubt, values, gradients, band) >= band:
                    continue
                for c in range(8):
                    needed = 0.0
                    for j in range(n):
                        needed += abs(gradients[c, j]) * reach[j]
                    if values[c] <= 0.0 or values[c] < needed:
                        if count < out.shape[0]:
                            out[count] = values[c]
                            rows[count] = gradients[c]
                            which[count, 0], which[count, 1] = i, at
                        count += 1
    return count


@njit(cache=True)
def shortfall(arm: Any, pairs: Any, hulls: Any, doubt: Any, band: float, slack: Any, ways: Any) -> float:
    """Return by how much any pair that was below `band` has less slack than it had or needs, at most [m].

    arm: other postures, as many. slack, ways: of `bounds`. What had less than 0 may not have less; what had more may
    come down to 0. Not above 0: every stop that was verified still is one.
    """
    values, rows = np.empty(8), np.empty((8, arm[0].shape[1]))
    worst = -math.inf
    for i in range(slack.shape[0]):
        for p in range(slack.shape[1]):
            if slack[i, p] >= band:
                continue
            now = _corner_slacks(p, i, ways[i, p], arm, pairs, hulls, doubt, values, rows, band)
            if p > 0:
                past = _corner_slacks(p - 1, i, ways[i, p], arm, pairs, hulls, doubt, values, rows, band)
                now = min(now, past)
            worst = max(worst, min(slack[i, p], 0.0) - now)
    return worst


@njit(cache=True)
def cells_near(
    low: Any, high: Any, rows: Any, solids: Any, first: Any, last: Any, lows: Any, highs: Any, room: Any, out: Any
) -> int:
    """Fill out (r, 2) with (row, cell) of all cells first[r] to last[r] within room[r] of the box around a solid.

    low, high (S, 3): axis-parallel boxes around the solids' ways; lows, highs (cells, 3) around the cells.
    """
    count = 0
    for r in rows:
        s = solids[r]
        for cell in range(first[r], last[r]):
            gap = 0.0
            for c in range(3):
                apart = max(lows[cell, c] - high[s, c], low[s, c] - highs[cell, c])
                if apart > 0.0:
                    gap += apart * apart
            if gap < room[r] * room[r]:
                if count < out.shape[0]:
                    out[count, 0], out[count, 1] = r, cell
                count += 1
    return count
