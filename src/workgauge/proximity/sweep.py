"""Lower bounds of every clearance at many postures of the arm at once, each proven by a separating plane; compiled.

For a solid of the machine, a convex cell of a limit and a unit vector u, every corner x of the solid has the slack

    u . x - max u . y - sum_j |g_j(x)| w_j - second order - approach - protection level(x) - stop distance

with y the cell's corners, g_j(x) = d(u . x)/dq_j, w_j half the width of the interval in which joint j may be at that
moment; the least over the corners bounds the pair from below, whatever u is. On the way from one posture to the next
u turns from that of the one to that of the other. At a share t of the way, (1 - t) u0 + t u1 is no longer than 1, so
what is left along it is at least the share in between of what is left at both ends, less t (1 - t) (u1 - u0) . (x1 -
x0): a quarter of that at most, see `_turning`. That much less is counted at both ends.
"""

import math
from typing import Any

import numpy as np

from workgauge.proximity.aim import CLOSE_M, widest
from workgauge.proximity.contact import MOST, TIED_M, patch, settled
from workgauge.proximity.corners import along_axis, approach, corner_slacks, needed, turned
from workgauge.proximity.hulls import GROUND, SHARED
from workgauge.proximity.separation import lowest, separating
from workgauge.values.compiled import njit

#: The way out already taken is kept unless another is shorter by this [m].
KEPT_M = 0.01
#: A pair is inside if it falls short by more than this: more than a verified command may ever come to [m].
INSIDE_M = 0.0025
#: What `_better` finds.
OVERLAPPING, APART, DRAWN = 0, 1, 2


@njit(cache=True)
def _better(p: int, i: int, start: Any, arm: Any, pairs: Any, hulls: Any, out: Any) -> int:
    """Fill out (3,) with the direction that separates pair i best at posture p; of overlapping ones, a way out.

    Returns whether the two are `OVERLAPPING`, `APART`, or apart from the cell `DRAWN` out.

    Of a chain's cell that is nearer than it may be, directions are judged on the cell drawn out at its shared faces:
    the way to the next cell is none. start and out: fixed to the other link, if the pair is two links.
    """
    rotations, corners = arm[2], arm[3]
    solids, others, own, given, need = pairs[0], pairs[1], pairs[2], pairs[3], pairs[4]
    points, starts, normals, faces, radii, drawn, kinds = hulls
    s, o = solids[i], others[i]
    body, R = corners[p, s], rotations[p, o if own[i] else s]
    first, trial = np.empty(3), np.empty(3)
    for a in range(3):
        first[a] = turned(R, start, a) if own[i] else start[a]
    other = corners[p, o] if own[i] else points[starts[o] : starts[o + 1]]
    apart = separating(body, other, first, out)
    judged, found = other, APART
    if not own[i] and kinds[o] == SHARED and apart - radii[o] < need[i]:
        judged, found = drawn[starts[o] : starts[o + 1]], DRAWN
        apart = separating(body, judged, first, out)
    if apart <= 1e-6:
        best, found = -math.inf, OVERLAPPING
        total = 14 if own[i] else 8 + 2 * (faces[o + 1] - faces[o])
        for c in range(total):
            if not own[i] and kinds[o] == GROUND and 2 <= c < 8:
                continue
            for a in range(3):
                sign = 1.0 if c % 2 else -1.0
                if c == 0:
                    trial[a] = first[a]
                elif c == 1:
                    trial[a] = turned(R, given[i], a) if own[i] else given[i, a]
                elif c < 8:
                    trial[a] = rotations[p, s, a, (c - 2) // 2] * sign
                elif own[i]:
                    trial[a] = rotations[p, o, a, (c - 8) // 2] * sign
                else:
                    trial[a] = normals[faces[o] + (c - 8) // 2, a] * sign
            x, y = lowest(body, trial[0], trial[1], trial[2]), lowest(judged, -trial[0], -trial[1], -trial[2])
            gap = 0.0
            for a in range(3):
                gap += trial[a] * (body[x, a] - judged[y, a])
            if gap > best + (KEPT_M if c > 1 else 0.0):
                best = gap
                out[0], out[1], out[2] = trial[0], trial[1], trial[2]
        settled(body, judged, out, trial)
        out[0], out[1], out[2] = trial[0], trial[1], trial[2]
    if own[i]:
        x0, y0, z0 = out[0], out[1], out[2]
        for a in range(3):
            out[a] = along_axis(R, a, x0, y0, z0)
    return found


@njit(cache=True)
def _ahead(x: Any, y: Any, u: Any) -> float:
    """Return how much farther along u point x lies than y."""
    return float((x[0] - y[0]) * u[0] + (x[1] - y[1]) * u[1] + (x[2] - y[2]) * u[2])


@njit(cache=True)
def _inside(p: int, values: Any, rows: Any, widths: Any) -> bool:
    """Return whether the middle posture itself falls short, from the corners' slacks (values) and their rows."""
    least = math.inf
    for c in range(8):
        value = values[c]
        for j in range(rows.shape[1]):
            value += abs(rows[c, j]) * widths[p, j]
        least = min(least, value)
    return least < -INSIDE_M


@njit(cache=True)
def _apart(p: int, i: int, u: Any, arm: Any, pairs: Any, hulls: Any, times: Any) -> float:
    """Return how far pair i, of no own link, is apart along u at the middle posture p, below 0 if it overlaps [m]."""
    s, o = pairs[0][i], pairs[1][i]
    body, other = arm[3][p, s], hulls[0][hulls[1][o] : hulls[1][o + 1]]
    x, y = lowest(body, u[0], u[1], u[2]), lowest(other, -u[0], -u[1], -u[2])
    moved = approach(i, u, other, pairs[7], pairs[8]) * times[p] if pairs[9][i] else 0.0
    return _ahead(body[x], other[y], u) - moved


@njit(cache=True)
def _aimed(p: int, i: int, found: int, arm: Any, pairs: Any, hulls: Any, turns: Any, u: Any) -> bool:
    """Turn u (3,), found by `_better`, to where pair i has most slack at posture p; return whether it was turned."""
    s, o = pairs[0][i], pairs[1][i]
    if pairs[2][i] or found == OVERLAPPING or arm[9][p, s] <= CLOSE_M:
        return False
    points = hulls[5] if found == DRAWN else hulls[0]
    widest(p, s, points[hulls[1][o] : hulls[1][o + 1]], u.copy(), arm, turns, u)
    return True


@njit(cache=True)
def _turning(p: int, i: int, first: Any, last: Any, arm: Any, pairs: Any, hulls: Any, times: Any) -> float:
    """Return what pair i's slack may lack between postures p - 1 and p, as u turns from first to last (3,) [m].

    A quarter of the most any two points of the two bodies come apart along `last - first`, widths and a limit's own
    motion counted. Infinite for directions too far apart to be turned into each other.
    """
    x, y, z = last[0] - first[0], last[1] - first[1], last[2] - first[2]
    if x == 0.0 and y == 0.0 and z == 0.0:
        return 0.0
    if first[0] * last[0] + first[1] * last[1] + first[2] * last[2] <= 0.0:
        return math.inf
    s, o, own = pairs[0][i], pairs[1][i], pairs[2][i]
    corners, spread = arm[3], arm[9]
    wider = abs(spread[p, s] - spread[p - 1, s])
    moved, other = -math.inf, 0.0
    ax, ay, az, bx, by, bz = x, y, z, x, y, z
    back, ahead = 0.0, 0.0
    if own:  # u is fixed to the other link, and so is what is measured along it
        R, S, turn = arm[2][p - 1, o], arm[2][p, o], np.array((x, y, z))
        ax, ay, az = turned(R, turn, 0), turned(R, turn, 1), turned(R, turn, 2)
        bx, by, bz = turned(S, turn, 0), turned(S, turn, 1), turned(S, turn, 2)
        a, b = corners[p - 1, o, 0], corners[p, o, 0]
        back, ahead = a[0] * ax + a[1] * ay + a[2] * az, b[0] * bx + b[1] * by + b[2] * bz
        wider += abs(spread[p, o] - spread[p - 1, o])
        for c in range(8):
            a, b = corners[p - 1, o, c], corners[p, o, c]
            there = b[0] * bx + b[1] * by + b[2] * bz - ahead
            other = max(other, a[0] * ax + a[1] * ay + a[2] * az - back - there)
    for c in range(8):
        a, b = corners[p - 1, s, c], corners[p, s, c]
        there = b[0] * bx + b[1] * by + b[2] * bz - ahead
        moved = max(moved, there - (a[0] * ax + a[1] * ay + a[2] * az - back))
    most = max(moved + other, 0.0) + math.sqrt(x * x + y * y + z * z) * wider
    if pairs[9][i]:
        points = hulls[0][hulls[1][o] : hulls[1][o + 1]]
        faster = approach(i, last, points, pairs[7], pairs[8]) - approach(i, first, points, pairs[7], pairs[8])
        most += abs(faster * (times[p] - times[p - 1]))
    return float(0.25 * most)


@njit(cache=True)
def _bound(
    i: int, arm: Any, pairs: Any, hulls: Any, doubt: Any, reach: Any, slack: Any, ways: Any, depths: Any, losses: Any
) -> None:
    """Fill the rows of pair i, see `bounds`."""
    n, count = arm[0].shape[1], arm[0].shape[0]
    values, rows, u, other = np.empty(8), np.empty((8, n)), np.empty(3), np.empty(3)
    u[:] = pairs[3][i]
    before = math.inf
    for p in range(count):
        here, tight = corner_slacks(p, i, u, arm, pairs, hulls, doubt, reach, values, rows)
        lost = 0.0
        depths[p], losses[p] = -math.inf, 0.0
        if tight < 0.0:
            found = _better(p, i, u, arm, pairs, hulls, other)
            there, narrow = corner_slacks(p, i, other, arm, pairs, hulls, doubt, reach, values, rows)
            if narrow < 0.0 and not pairs[2][i] and _inside(p, values, rows, arm[8]):
                depths[p] = _apart(p, i, other, arm, pairs, hulls, doubt[6])
                here, tight, u[:] = there, narrow, other
            else:
                if _aimed(p, i, found, arm, pairs, hulls, reach[2], other):
                    there, narrow = corner_slacks(p, i, other, arm, pairs, hulls, doubt, reach, values, rows)
                turning = _turning(p, i, u, other, arm, pairs, hulls, doubt[6]) if p > 0 else 0.0
                # what turning costs is lost behind as well
                behind = before - losses[p - 1] if p > 0 and depths[p - 1] == -math.inf else math.inf
                turned_behind = before - max(losses[p - 1], turning) if behind < math.inf else math.inf
                if min(there - turning, turned_behind) > min(here, behind):
                    here, tight, lost, u[:] = there, narrow, turning, other
        ways[p], slack[p], losses[p] = u, here, lost
        if tight >= 0.0 and lost == 0.0:
            slack[p] = math.inf
        if p > 0 and lost > 0.0 and depths[p - 1] == -math.inf:
            losses[p - 1] = max(losses[p - 1], lost)
            slack[p - 1] = before
        before = here
    for p in range(count):
        slack[p] -= losses[p]


@njit(cache=True)
def bounds(
    arm: Any,
    pairs: Any,
    hulls: Any,
    doubt: Any,
    reach: Any,
    slack: Any,
    ways: Any,
    depths: Any,
    losses: Any,
    clearances: Any,
) -> None:
    """Fill slack (m, P) with the least slack of each pair at and next to each posture, and ways (m, P, 3) with its u.

    The slack is infinite where no corner's is below `|row| . reach` for any of reach: what one tick may change cannot
    matter there. Where it may, the direction is sought anew. losses (m, P) has what is taken off for its turning on
    the way. Where the middle posture itself is inside, only the postures are looked at, and depths (m, P) has how far
    the deepest pair of its clearance (m,) is apart there; elsewhere it is -inf.
    """
    count = arm[0].shape[0]
    for i in range(slack.shape[0]):
        _bound(i, arm, pairs, hulls, doubt, reach, slack[i], ways[i], depths[i], losses[i])
    first = 0
    for i in range(1, len(clearances) + 1):
        if i == len(clearances) or clearances[i] != clearances[first]:
            for p in range(count):
                deepest = math.inf
                for k in range(first, i):
                    if depths[k, p] > -math.inf:
                        deepest = min(deepest, depths[k, p])
                for k in range(first, i):
                    if depths[k, p] > -math.inf:
                        depths[k, p] = deepest
            first = i


@njit(cache=True)
def _touching(p: int, i: int, u: Any, arm: Any, pairs: Any, hulls: Any, turns: Any, rows: Any) -> int:
    """Fill rows (MOST, n) with how the corners of the patch move along u where pair i, of no own link, would touch.

    turns (n, 8): g_j of a point x is `turns[j, :3] . x + turns[j, 3]`. Returns how many there are.
    """
    s, o = pairs[0][i], pairs[1][i]
    begin, end = hulls[1][o], hulls[1][o + 1]
    body = arm[3][p, s]
    points = np.empty((MOST, 3))
    count = patch(body, hulls[5][begin:end] if hulls[6][o] == SHARED else hulls[0][begin:end], u, points)
    joint, axis, side = arm[6][s, 0], arm[6][s, 1], arm[6][s, 2]
    for c in range(count):
        for j in range(rows.shape[1]):
            rows[c, j] = turns[j, 3]
            for a in range(3):
                rows[c, j] += turns[j, a] * points[c, a]
        if joint >= 0:  # of a box that stretches, what lies between its ends moves with its share
            share, length = 0.0, 0.0
            for a in range(3):
                along = body[7, a] - body[7 - (4 >> axis), a]
                share += (points[c, a] - body[7 - (4 >> axis), a]) * along
                length += along * along
            share = min(max(share / length, 0.0), 1.0)
            R = arm[2][p, s]
            rows[c, joint] += (share if side > 0 else 1.0 - share) * side * along_axis(R, axis, u[0], u[1], u[2])
    return count


@njit(cache=True)
def _turned_by(p: int, i: int, ways: Any, depths: Any, arm: Any, pairs: Any, hulls: Any, times: Any) -> float:
    """Return what the turning of pair i's direction costs between postures p - 1 and p; see `_bound` [m]."""
    if depths[p] > -math.inf:
        return 0.0
    return _turning(p, i, ways[p - 1], ways[p], arm, pairs, hulls, times)


@njit(cache=True)
def emit(
    arm: Any,
    pairs: Any,
    hulls: Any,
    doubt: Any,
    reach: Any,
    slack: Any,
    ways: Any,
    depths: Any,
    losses: Any,
    out: Any,
    room: Any,
    rows: Any,
    which: Any,
    inside: Any,
) -> int:
    """Fill out (r,), rows (r, n), which (r, 2: pair, posture) with every corner with `slack < |row| . reach`.

    Of a pair that is inside (r,), the corners of the patch where the two would touch stand for those of the solid
    that are deepest; see `contact`. room (r,): what of its slack a corner may lose; if the pair has less than none,
    what it has more than the pair's least, inside more than its clearance's deepest. slack, ways, depths, losses: of
    `bounds`. Returns how many there are; if more than there is room for, the rest is left out.
    """
    n = rows.shape[1]
    values, gradients, touched, body = np.empty(8), np.empty((8, n)), np.empty((MOST, n)), np.empty((8, 3))
    count = 0
    for i in range(slack.shape[0]):
        for p in range(slack.shape[1]):
            if slack[i, p] == math.inf:
                continue
            least, tight = corner_slacks(p, i, ways[i, p], arm, pairs, hulls, doubt, reach, values, gradients)
            if tight >= 0.0:
                continue
            deep = depths[i, p] > -math.inf
            touching, deepest, more = 0, 0, 0.0
            if deep:
                touching = _touching(p, i, ways[i, p], arm, pairs, hulls, reach[2], touched)
                more = _apart(p, i, ways[i, p], arm, pairs, hulls, doubt[6]) - depths[i, p]
                body[:] = arm[3][p, pairs[0][i]]
                deepest = lowest(body, ways[i, p, 0], ways[i, p, 1], ways[i, p, 2])
            for c in range(touching):
                if count < out.shape[0]:
                    out[count], room[count] = least, more
                    rows[count] = touched[c]
                    which[count, 0], which[count, 1], inside[count] = i, p, True
                count += 1
            for c in range(8):
                ahead = _ahead(body[c], body[deepest], ways[i, p]) if deep else 0.0
                if touching and ahead < TIED_M:
                    continue
                value = values[c] - losses[i, p]
                if value <= 0.0 or value < needed(gradients[c], reach[0]):
                    if count < out.shape[0]:
                        out[count], room[count] = value, value - min(slack[i, p], 0.0)
                        rows[count] = gradients[c]
                        which[count, 0], which[count, 1] = i, p
                        inside[count] = deep
                        if deep:
                            room[count] = more + ahead
                    count += 1
    return count


@njit(cache=True)
def shortfall(
    arm: Any, pairs: Any, hulls: Any, doubt: Any, reach: Any, slack: Any, ways: Any, depths: Any, least: float
) -> float:
    """Return by how much any pair that may matter has less slack than it had or needs, at most [m].

    arm: other postures, as many. slack, ways, depths: of `bounds`. What had less than `least` may not have less; what
    had more may come down to it; what is inside may not come deeper than its clearance is. Not above 0: every stop
    that was verified still is one.
    """
    values, rows, other = np.empty(8), np.empty((8, arm[0].shape[1])), np.empty(3)
    worst = -math.inf
    for i in range(slack.shape[0]):
        for p in range(slack.shape[1]):
            if slack[i, p] == math.inf:
                continue
            now, _ = corner_slacks(p, i, ways[i, p], arm, pairs, hulls, doubt, reach, values, rows)
            if depths[i, p] == -math.inf:
                lost = 0.0
                if p > 0:
                    lost = _turned_by(p, i, ways[i], depths[i], arm, pairs, hulls, doubt[6])
                if p + 1 < slack.shape[1]:
                    lost = max(lost, _turned_by(p + 1, i, ways[i], depths[i], arm, pairs, hulls, doubt[6]))
                now -= lost
            short = min(slack[i, p], least) - now
            if short > 0.0 and depths[i, p] > -math.inf:  # the way out turns with the machine
                _better(p, i, ways[i, p], arm, pairs, hulls, other)
                short = min(short, depths[i, p] - _apart(p, i, other, arm, pairs, hulls, doubt[6]))
            worst = max(worst, short)
    return worst
