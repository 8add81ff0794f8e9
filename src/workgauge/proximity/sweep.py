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

from workgauge.proximity.separation import lowest, separating
from workgauge.values.compiled import njit


@njit(cache=True)
def _corner_slacks(
    p: int, i: int, u: Any, arm: Any, pairs: Any, hulls: Any, doubt: Any, reach: Any, out: Any, rows: Any
) -> tuple[float, float]:
    """Fill out (8,) with the slack of each corner of pair i's solid at posture p and rows (8, n).

    Returns the least slack, and the least of `slack - |row| . reach` over the corners and all of reach (c, n). If a
    coarser bound shows that the latter is not below zero, nothing is filled and both are that bound.
    """
    axes, origins, rotations, corners, prismatic, links, stretch, levers, width, spread = arm
    solids, others, own, _, need, variance, extra, _, _, moving = pairs
    exact, covariance, k, bias, largest, origin, times = doubt
    n = axes.shape[1]
    s, o = solids[i], others[i]
    ux, uy, uz = u[0], u[1], u[2]
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
        plane += _approach(i, u, other, pairs[7], pairs[8]) * times[p]
    x = lowest(body, ux, uy, uz)
    coarse = body[x, 0] * ux + body[x, 1] * uy + body[x, 2] * uz - plane - loose
    band = 0.0
    for a in range(reach.shape[0]):
        total = 0.0
        for j in range(n):
            total += levers[s, j] * reach[a, j]
        band = max(band, total)
    if coarse >= band:
        return coarse, coarse - band
    base, top = (links[o] if own[i] else 0), links[s]
    # g_j = u . (a_j x (x - o_j)) = (u x a_j) . x - (u x a_j) . o_j, or u . a_j of a sliding joint
    turns = np.zeros((n, 4))
    for j in range(top):
        ax, ay, az = axes[p, j, 0], axes[p, j, 1], axes[p, j, 2]
        if prismatic[j]:
            turns[j, 3] = 0.0 if j < base else ax * ux + ay * uy + az * uz
            continue
        mx, my, mz = uy * az - uz * ay, uz * ax - ux * az, ux * ay - uy * ax
        turns[j, 0], turns[j, 1], turns[j, 2] = mx, my, mz
        if j < base:
            turns[j, 3] = -(mx * yx + my * yy + mz * yz)
        else:
            turns[j, 3] = -(mx * origins[p, j, 0] + my * origins[p, j, 1] + mz * origins[p, j, 2])
    js, face, side = stretch[s, 0], stretch[s, 1], stretch[s, 2]
    grown = _grown(p, s, side, face, rotations, u) if js >= 0 else 0.0
    jo = stretch[o, 0] if own[i] else -1
    shrunk = 0.0
    if jo >= 0 and (((y >> (2 - stretch[o, 1])) & 1) == 1) == (stretch[o, 2] > 0):
        shrunk = _grown(p, o, stretch[o, 2], stretch[o, 1], rotations, u)
    lost = bias + extra[i] + _second_order(p, s, levers, width)
    if own[i]:
        lost += _second_order(p, o, levers, width)
    if exact:
        lost += k * math.sqrt(variance[i])
    least, tightest = math.inf, math.inf
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
        if not exact:
            rx, ry, rz = cx - origin[0], cy - origin[1], cz - origin[2]
            value -= k * math.sqrt(variance[i] + _variance(own[i], u, rx, ry, rz, rows[c], covariance))
        out[c] = value
        least = min(least, value)
        tightest = min(tightest, value - needed(rows[c], reach))
    return least, tightest


@njit(cache=True)
def needed(row: Any, reach: Any) -> float:
    """Return the largest `|row| . reach` over all of reach (c, n)."""
    most = 0.0
    for a in range(reach.shape[0]):
        total = 0.0
        for j in range(row.shape[0]):
            total += abs(row[j]) * reach[a, j]
        most = max(most, total)
    return most


@njit(cache=True)
def _grown(p: int, s: int, side: int, face: int, rotations: Any, u: Any) -> float:
    """Return how fast the moving face of a box that stretches moves along u."""
    total = 0.0
    for c in range(3):
        total += rotations[p, s, c, face] * u[c]
    return total * side


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
def bounds(arm: Any, pairs: Any, hulls: Any, doubt: Any, reach: Any, slack: Any, ways: Any) -> None:
    """Fill slack (m, P) with the least slack of each pair on the way to each posture, and ways (m, P, 3) with its u.

    The slack is infinite where no corner's is below `|row| . reach` for any of reach (c, n): what one tick may change
    cannot matter there. Where it may, the direction is sought anew.
    """
    n, count = arm[0].shape[1], arm[0].shape[0]
    values, rows = np.empty(8), np.empty((8, n))
    u, other = np.empty(3), np.empty(3)
    for i in range(slack.shape[0]):
        u[:] = pairs[3][i]
        before = math.inf
        for p in range(count):
            here, tight = _corner_slacks(p, i, u, arm, pairs, hulls, doubt, reach, values, rows)
            ways[i, p] = u
            on_way = min(here, before)
            if tight < 0.0:
                _better(p, i, u, arm, pairs, hulls, other)
                there, tight = _corner_slacks(p, i, other, arm, pairs, hulls, doubt, reach, values, rows)
                past = math.inf
                if p > 0:
                    past, _ = _corner_slacks(p - 1, i, other, arm, pairs, hulls, doubt, reach, values, rows)
                if min(there, past) > on_way:
                    on_way = min(there, past)
                    ways[i, p] = other
                if there > here:
                    here = there
                    u[:] = other
            free = tight >= 0.0 and (p == 0 or slack[i, p - 1] == math.inf)
            slack[i, p] = math.inf if free else on_way
            before = here


@njit(cache=True)
def emit(
    arm: Any, pairs: Any, hulls: Any, doubt: Any, reach: Any, slack: Any, ways: Any, out: Any, rows: Any, which: Any
) -> int:
    """Fill out (r,), rows (r, n), which (r, 2: pair, posture) with every corner with `slack < |row| . reach`.

    slack, ways: of `bounds`. Returns how many there are; if more than there is room for, the rest is left out.
    """
    n = rows.shape[1]
    values, gradients = np.empty(8), np.empty((8, n))
    count = 0
    for i in range(slack.shape[0]):
        for p in range(slack.shape[1]):
            if slack[i, p] == math.inf:
                continue
            for back in range(2):
                at = p - back
                if at < 0:
                    continue
                if back == 1:  # the former end has been seen by this direction already
                    same = slack[i, at] < math.inf
                    for c in range(3):
                        same = same and ways[i, p, c] == ways[i, at, c]
                    if same:
                        continue
                _, tight = _corner_slacks(at, i, ways[i, p], arm, pairs, hulls, doubt, reach, values, gradients)
                if tight >= 0.0:
                    continue
                for c in range(8):
                    if values[c] <= 0.0 or values[c] < needed(gradients[c], reach):
                        if count < out.shape[0]:
                            out[count] = values[c]
                            rows[count] = gradients[c]
                            which[count, 0], which[count, 1] = i, at
                        count += 1
    return count


@njit(cache=True)
def shortfall(arm: Any, pairs: Any, hulls: Any, doubt: Any, reach: Any, slack: Any, ways: Any) -> float:
    """Return by how much any pair that may matter has less slack than it had or needs, at most [m].

    arm: other postures, as many. slack, ways: of `bounds`. What had less than 0 may not have less; what had more may
    come down to 0. Not above 0: every stop that was verified still is one.
    """
    values, rows = np.empty(8), np.empty((8, arm[0].shape[1]))
    worst = -math.inf
    for i in range(slack.shape[0]):
        for p in range(slack.shape[1]):
            if slack[i, p] == math.inf:
                continue
            now, _ = _corner_slacks(p, i, ways[i, p], arm, pairs, hulls, doubt, reach, values, rows)
            if p > 0:
                past, _ = _corner_slacks(p - 1, i, ways[i, p], arm, pairs, hulls, doubt, reach, values, rows)
                now = min(now, past)
            worst = max(worst, min(slack[i, p], 0.0) - now)
    return worst
