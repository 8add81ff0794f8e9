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
    distances: Any,
    stop_distances: Any,
    solids: Any,
    others: Any,
    approach: Any,
    stop: float,
    margin: float,
    largest: float,
    bands: Any,
) -> Any:
    """Return the arm on its way, how far a corner moves at most, what each clearance needs, which may come near, and
    the boxes (low, high) (S, 3) around the solids' ways."""
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
def _nearer_row(r: int, near: Any, columns: Any, distances: Any) -> bool:
    """Return whether another clearance stands for the same solid and link: a link may have several boxes."""
    solids, others, _ = columns
    for k in near:
        same = solids[k] == solids[r] and others[k] == others[r]
        if same and (distances[k] < distances[r] or (distances[k] == distances[r] and k < r)):
            return True
    return False


@njit(cache=True)
def gather(
    near: Any,
    distances: Any,
    low: Any,
    high: Any,
    room: Any,
    columns: Any,
    normals: Any,
    variance: Any,
    extra: Any,
    speed: Any,
    places: Any,
    moving: Any,
    ranges: Any,
    hull_of: Any,
    cell_lows: Any,
    cell_highs: Any,
    ground_rows: Any,
    ground_hulls: Any,
    own_pairs: Any,
    solid_links: Any,
) -> Any:
    """Return the pairs of solid and hull (or other solid) that may come near, as `sweep` wants them, their rows; and
    the cells that have no hull yet: while there are any, the pairs are not complete."""
    solids, others, limits = columns
    need, more, approach = room
    size, count, lacking = 64, 0, 0
    rows, mates = np.empty(size, np.int64), np.empty(size, np.int64)
    missing = np.empty(len(hull_of) if len(hull_of) < 4096 else 4096, np.int64)
    for r in near:
        s = solids[r]
        own = others[r] >= 0
        if own and _nearer_row(r, near, columns, distances):
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
    which, own_of, given = np.empty(total, np.int64), np.empty(total, np.bool_), np.empty((total, 3))
    needs, variances, extras = np.empty(total), np.empty(total), np.empty(total)
    speeds, about, moves = np.zeros((total, 6)), np.zeros((total, 3)), np.zeros(total, np.bool_)
    for i in range(total):
        r = of[i]
        which[i], own_of[i] = solids[r], others[r] >= 0
        needs[i], variances[i], extras[i] = need[r], variance[r], extra[r]
        for c in range(3):
            given[i, c] = normals[r, c]
        if len(moving) > 0 and moving[r]:
            moves[i] = True
            speeds[i], about[i] = speed[r], places[r]
    return (which, other, own_of, given, needs, variances, extras, speeds, about, moves, of), missing[:lacking]
