"""Which pairs of the machine's solids and convex cells may come near on the way to rest; compiled."""

from typing import Any

import numpy as np

from workgauge.machine.arm import place
from workgauge.values.compiled import njit


@njit(cache=True)
def placed(T: Any, postures: Any, widths: Any, packed: Any) -> Any:
    """Return the arm along a way, as `sweep` wants it."""
    steps, joint_axes, prismatic, boxes, halves, links, stretch, levers = packed
    count, n, solids = postures.shape[0], postures.shape[1], len(links)
    axes, origins = np.empty((count, n, 3)), np.empty((count, n, 3))
    rotations, corners = np.empty((count, solids, 3, 3)), np.empty((count, solids, 8, 3))
    place(T, postures, steps, joint_axes, prismatic, boxes, halves, links, stretch, axes, origins, rotations, corners)
    spread = np.zeros((count, solids))
    for p in range(count):
        whole = 0.0
        for j in range(n):
            whole += widths[p, j]
        if whole > 0.0:
            for s in range(solids):
                first = 0.0
                for j in range(n):
                    first += levers[s, j] * widths[p, j]
                spread[p, s] = first * (1.0 + whole)
    return axes, origins, rotations, corners, prismatic, links, stretch, levers, widths, spread


@njit(cache=True)
def near_way(
    T: Any,
    q: Any,
    postures: Any,
    widths: Any,
    packed: Any,
    facts: Any,
    approach: Any,
    stop: float,
    margin: float,
    largest: float,
    bands: Any,
) -> Any:
    """Return the arm on its way, how far a corner moves at most, what each clearance needs, which may come near, and
    the boxes (low, high) (S, 3) around the solids' ways. facts: see `gather`."""
    distances, stop_distances, solids, others = facts[0], facts[1], facts[2], facts[3]
    arm = placed(T, postures, widths, packed)
    corners, stretch, levers, spread = arm[3], arm[6], arm[7], arm[9]
    count, boxes = postures.shape[0], levers.shape[0]
    far, farthest, stretched = np.zeros(boxes), 0.0, 0.0
    for j in range(postures.shape[1]):
        moved = 0.0
        for p in range(count):
            moved = max(moved, abs(postures[p, j] - q[j]) + widths[p, j])
        for s in range(boxes):
            far[s] += levers[s, j] * moved
            if stretch[s, 0] == j:
                stretched = max(stretched, moved + bands[s])
    low, high = np.empty((boxes, 3)), np.empty((boxes, 3))
    for s in range(boxes):
        farthest = max(farthest, far[s])
        for c in range(3):
            low[s, c], high[s, c] = np.inf, -np.inf
            for p in range(count):
                for k in range(8):
                    low[s, c] = min(low[s, c], corners[p, s, k, c] - spread[p, s])
                    high[s, c] = max(high[s, c], corners[p, s, k, c] + spread[p, s])
    total = len(distances)
    need, near, found = np.empty(total), np.empty(total, np.int64), 0
    for r in range(total):
        need[r] = (stop if np.isnan(stop_distances[r]) else stop_distances[r]) + margin
        room = need[r] + largest + bands[solids[r]] + (approach[r] if len(approach) > 0 else 0.0)
        if others[r] >= 0:  # what carries both links moves neither to the other; the other's own stretch does
            room += stretched
        if distances[r] < room + far[solids[r]]:
            near[found] = r
            found += 1
    return arm, farthest, need, near[:found], low, high


@njit(cache=True)
def _nearer_row(r: int, near: Any, facts: Any) -> bool:
    """Return whether another clearance stands for the same solid and link: a link may have several boxes."""
    distances, solids, others = facts[0], facts[2], facts[3]
    for k in near:
        same = solids[k] == solids[r] and others[k] == others[r]
        if same and (distances[k] < distances[r] or (distances[k] == distances[r] and k < r)):
            return True
    return False


@njit(cache=True)
def gather(near: Any, low: Any, high: Any, room: Any, facts: Any, cells: Any, triangles: Any) -> Any:
    """Return the pairs that may come near, as rows of the clearances and hulls (or other solids); and the cells that
    have no hull yet: while there are any, the pairs are not complete.

    Args:
        near: (r) which clearances may. low, high: (S, 3) boxes around the solids' ways. room: what each clearance
            needs, what may be used up of each solid's slack, how far limits may come nearer.
        facts: distances, stop distances, solids, other links, limits, links, normals of the clearances.
        cells: ranges of the limits' cells, their hulls, lows and highs; pairs of own solids, links of solids.
        triangles: rows and hulls of the ground.
    """
    solids, others, limits = facts[2], facts[3], facts[4]
    ranges, hull_of, cell_lows, cell_highs, own_pairs, solid_links = cells
    ground_rows, ground_hulls = triangles
    need, more, approach = room
    size, count, lacking = 64, 0, 0
    rows, mates = np.empty(size, np.int64), np.empty(size, np.int64)
    missing = np.empty(len(hull_of) if len(hull_of) < 4096 else 4096, np.int64)
    for r in near:
        s = solids[r]
        own = others[r] >= 0
        if own and _nearer_row(r, near, facts):
            continue
        first, last = 0, len(own_pairs)
        if not own:
            first, last = ranges[limits[r]], ranges[limits[r] + 1]
        wide = need[r] + more[s] + (approach[r] if len(approach) > 0 else 0.0)
        for cell in range(first, last):
            if own:
                if own_pairs[cell, 0] != s or solid_links[own_pairs[cell, 1]] != others[r]:
                    continue
                mate = own_pairs[cell, 1]
            else:
                gap = 0.0
                for c in range(3):
                    apart = max(cell_lows[cell, c] - high[s, c], low[s, c] - cell_highs[cell, c])
                    if apart > 0.0:
                        gap += apart * apart
                if gap >= wide * wide:
                    continue
                mate = hull_of[cell]
                if mate < 0:
                    if lacking < len(missing):
                        missing[lacking] = cell
                        lacking += 1
                    continue
            if count == size:
                rows, mates = np.concatenate((rows, rows)), np.concatenate((mates, mates))
                size *= 2
            rows[count], mates[count] = r, mate
            count += 1
    total = count + len(ground_rows)
    of, other = np.empty(total, np.int64), np.empty(total, np.int64)
    of[:count], other[:count] = rows[:count], mates[:count]
    of[count:], other[count:] = ground_rows, ground_hulls
    return of, other, missing[:lacking]


@njit(cache=True)
def paired(of: Any, other: Any, facts: Any, stop: float, margin: float, unsure: Any, motion: Any) -> Any:
    """Return the pairs of `gather` as `sweep` wants them.

    Args:
        stop, margin: stop distance of limits that have none of their own, and what is kept besides [m].
        unsure: variance of each limit and link [m^2], the link and the variance of the attachment, and of each
            clearance what adds to it and the second order of turning; empty where that is nothing.
        motion: twist, place and whether it moves of each clearance's limit; empty if none does.
    """
    _, stop_distances, solids, others, limits, links, normals = facts
    variances, tool_link, tool_variance, more, extra = unsure
    speed, places, moving = motion
    total = len(of)
    which, own, given = np.empty(total, np.int64), np.empty(total, np.bool_), np.empty((total, 3))
    needs, variance, extras = np.empty(total), np.empty(total), np.zeros(total)
    speeds, about, moves = np.zeros((total, 6)), np.zeros((total, 3)), np.zeros(total, np.bool_)
    for i in range(total):
        r = of[i]
        which[i], own[i] = solids[r], others[r] >= 0
        needs[i] = (stop if np.isnan(stop_distances[r]) else stop_distances[r]) + margin
        variance[i] = variances[limits[r]]
        if links[r] == tool_link or others[r] == tool_link:
            variance[i] += tool_variance
        if len(more) > 0:
            variance[i] += more[r]
            extras[i] = extra[r]
        for c in range(3):
            given[i, c] = normals[r, c]
        if len(moving) > 0 and moving[r]:
            moves[i] = True
            speeds[i], about[i] = speed[r], places[r]
    return which, other, own, given, needs, variance, extras, speeds, about, moves
