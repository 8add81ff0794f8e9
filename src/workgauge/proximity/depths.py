"""The least distance of each of the machine's solids to each limit, and nothing else, in one compiled call.

The same measure as that of `Scene.query`, without directions and points: `overlap` and `chain` say what it is where
solids touch. For whoever compares many postures.
"""

import math
from typing import Any

import numpy as np

from workgauge.proximity.closest import closest
from workgauge.proximity.search import NEARLY_M, placed
from workgauge.proximity.separation import lowest, separating
from workgauge.values.compiled import njit

#: Edges nearer to parallel than this give no direction of their own.
_PARALLEL = 1e-9
#: Corners of an outline nearer than this are one [m].
_SAME_M = 1e-9


@njit(cache=True)
def least_distances(
    T: Any, poses: Any, halves: Any, found: Any, owners: Any, hulls: Any, chains: Any, links: Any, limits: int
) -> Any:
    """Return (S, limits + L) least distances, infinite where nothing is near [m].

    Args:
        T, poses, halves: as for `search`. found: what that returned. owners: of `packed_cells`. hulls: the hull of
            each cell, and `Hulls`' corners, starts, radii, normals, faces, edges, edge starts. chains: of
            `Chains`. links: (S,). limits: how many there are; the links of the machine are numbered after them.
    """
    boxes, corners, _, _ = placed(T, poses, halves)
    scalars, _, indices, touching, _ = found
    least = np.full((len(poses), limits + int(links.max()) + 1), math.inf)
    for r in range(scalars.shape[1]):
        s, i = indices[4, r], indices[2, r]
        least[s, i] = min(least[s, i], scalars[0, r])
    out, first = np.empty(6), 0
    while first < len(touching):
        s, cell, other = touching[first]
        if cell < 0:
            apart = _boxes_apart(boxes[s], boxes[other], corners[s], corners[other], out)
            i = limits + links[other]
            least[s, i] = min(least[s, i], apart)
            first += 1
            continue
        i, last = owners[cell, 0], first + 1
        while last < len(touching) and touching[last, 0] == s and touching[last, 1] >= 0:
            if owners[touching[last, 1], 0] != i:
                break
            last += 1
        least[s, i] = _to_limit(first, last, touching, boxes[s], corners[s], owners, hulls, chains, i, out)
        first = last
    return least


@njit(cache=True)
def _to_limit(
    first: int, last: int, touching: Any, box: Any, body: Any, owners: Any, hulls: Any, chains: Any, i: int, out: Any
) -> float:
    """Return the distance of a box to a limit of which it touches one of the cells `touching` names."""
    hull_of, points, starts, radii = hulls[0], hulls[1], hulls[2], hulls[3]
    count, nearest, deepest = 0, math.inf, math.inf
    cells, towards = np.empty(last - first, np.int64), np.empty(3)
    for t in range(first, last):
        hull = hull_of[touching[t, 1]]
        other = points[starts[hull] : starts[hull + 1]]
        x, y, z = box[0] - other[0, 0], box[1] - other[0, 1], box[2] - other[0, 2]
        apart = closest(body, other, x, y, z, out)
        if apart > NEARLY_M:
            nearest = min(nearest, apart - radii[hull])
            continue
        apart = max(_hull_apart(box, body, hull, hulls), apart if apart >= 0.0 else -math.inf)
        if apart > NEARLY_M:  # apart, though nearly flat where they are nearest
            towards[0], towards[1], towards[2] = x, y, z
            apart = max(separating(body, other, towards, out), apart)
            nearest = min(nearest, apart - radii[hull])
            continue
        deepest = min(deepest, apart - radii[hull])
        cells[count] = owners[touching[t, 1], 1]
        count += 1
    if count == 0:
        return nearest
    if chains[0][i] >= 0:
        depth = _chain_depth(np.sort(cells[:count]), chains[0][i], chains, body)
        if depth > 0.0:
            return -depth
    return deepest


@njit(cache=True)
def _along(body: Any, x: float, y: float, z: float) -> tuple[float, float]:
    """Return how far the corners of a body reach back and forth along a direction."""
    a, b = lowest(body, x, y, z), lowest(body, -x, -y, -z)
    return body[a, 0] * x + body[a, 1] * y + body[a, 2] * z, body[b, 0] * x + body[b, 1] * y + body[b, 2] * z


@njit(cache=True)
def _hull_apart(box: Any, body: Any, hull: int, hulls: Any) -> float:
    """Return the signed distance of a box from a hull, as `overlap.signed_distance` does."""
    _, points, starts, _, normals, faces, edges, edge_starts = hulls
    other, best = points[starts[hull] : starts[hull + 1]], -math.inf
    for f in range(faces[hull], faces[hull + 1]):
        x, y, z = normals[f, 0], normals[f, 1], normals[f, 2]
        best = max(best, _along(body, x, y, z)[0] - _along(other, x, y, z)[1])
    for k in range(3):
        ax, ay, az = box[6 + k], box[9 + k], box[12 + k]
        low, high = _along(body, ax, ay, az)
        back, forth = _along(other, ax, ay, az)
        best = max(best, low - forth, back - high)
        for e in range(edge_starts[hull], edge_starts[hull + 1]):
            bx, by, bz = edges[e, 0], edges[e, 1], edges[e, 2]
            x, y, z = by * az - bz * ay, bz * ax - bx * az, bx * ay - by * ax
            length = math.sqrt(x * x + y * y + z * z)
            if length > _PARALLEL:
                x, y, z = x / length, y / length, z / length
                low, high = _along(body, x, y, z)
                back, forth = _along(other, x, y, z)
                best = max(best, low - forth, back - high)
    return best


@njit(cache=True)
def _boxes_apart(first: Any, second: Any, body: Any, other: Any, out: Any) -> float:
    """Return the signed distance of two boxes (15,) that touch or overlap, their corners body and other (8, 3)."""
    x, y, z = first[0] - second[0], first[1] - second[1], first[2] - second[2]
    best = closest(body, other, x, y, z, out)
    if best < 0.0:
        best = separating(body, other, np.array([x, y, z]), out)
        best = best if best > 0.0 else -math.inf
    for k in range(15):
        if k < 6:
            box, a = (first, k) if k < 3 else (second, k - 3)
            x, y, z = box[6 + a], box[9 + a], box[12 + a]
        else:
            a, b = (k - 6) // 3, (k - 6) % 3
            ax, ay, az = first[6 + a], first[9 + a], first[12 + a]
            bx, by, bz = second[6 + b], second[9 + b], second[12 + b]
            x, y, z = by * az - bz * ay, bz * ax - bx * az, bx * ay - by * ax
            length = math.sqrt(x * x + y * y + z * z)
            if length <= _PARALLEL:
                continue
            x, y, z = x / length, y / length, z / length
        low, high = _along(body, x, y, z)
        back, forth = _along(other, x, y, z)
        best = max(best, low - forth, back - high)
    return best


@njit(cache=True)
def _chain_depth(cells: Any, base: int, chains: Any, body: Any) -> float:
    """Return how deep a box is inside the union of a chain's cells, as `chain.penetrate` does; below 0 if it is not.

    cells: those it may be inside, ascending. base: the first row of the chain.
    """
    straight_on = chains[5]
    worst, done = -math.inf, -1
    points, along = np.empty((32, 3)), np.empty(32)
    for c in cells:
        if c <= done:
            continue
        if _part(base + c, chains, body, points, along) == 0:
            continue
        begin, end = c, c
        while begin > 0 and straight_on[base + begin - 1]:
            if _part(base + begin - 1, chains, body, points, along) == 0:
                break
            begin -= 1
        while straight_on[base + end]:
            if _part(base + end + 1, chains, body, points, along) == 0:
                break
            end += 1
        done = end
        worst = max(worst, _parts_depth(base + begin, base + end, chains, body, points, along))
    return worst


@njit(cache=True)
def _part(row: int, chains: Any, body: Any, points: Any, along: Any) -> int:
    """Fill points (32, 3) and along (32,) with the box's vertices cut to a cell's end planes; return how many."""
    start, out, length, count = chains[1][row], chains[3][row], chains[4][row], 0
    heights = np.empty(8)
    for v in range(8):
        heights[v] = 0.0
        for a in range(3):
            heights[v] += (body[v, a] - start[a]) * out[a]
        if 0.0 <= heights[v] <= length:
            points[count], along[count] = body[v], heights[v]
            count += 1
    for v in range(8):
        for bit in (1, 2, 4):
            w = v | bit
            if w == v:
                continue
            for end in range(2):
                plane = length if end else 0.0
                a, b = heights[v], heights[w]
                if (a < plane and b > plane) or (a > plane and b < plane):
                    share = (plane - a) / (b - a)
                    for c in range(3):
                        points[count, c] = body[v, c] + share * (body[w, c] - body[v, c])
                    along[count] = plane
                    count += 1
    return count


@njit(cache=True)
def _parts_depth(first: int, last: int, chains: Any, body: Any, points: Any, along: Any) -> float:
    """Return the least way that frees the parts of a box in the cells of rows first to last, all at once."""
    _, starts, frames, _, lengths, _, back, ahead, radii, sections, section_starts = chains
    size = 0
    for row in range(first, last + 1):
        size += 32 * (section_starts[row + 1] - section_starts[row])
    differences, total = np.empty((size, 2)), 0
    backwards = forwards = 0.0
    for row in range(first, last + 1):
        count = _part(row, chains, body, points, along)
        for p in range(count):
            across, up = 0.0, 0.0
            for a in range(3):
                across += (points[p, a] - starts[row, a]) * frames[row, a, 1]
                up += (points[p, a] - starts[row, a]) * frames[row, a, 2]
            for k in range(section_starts[row], section_starts[row + 1]):
                differences[total, 0], differences[total, 1] = sections[k, 0] - across, sections[k, 1] - up
                total += 1
        if row == last:
            backwards = along[:count].max() + back[row]
        if row == first:
            forwards = lengths[row] - along[:count].min() + ahead[row]
    depth = _depth_in_outline(differences[:total])
    if depth <= 0.0:
        return -math.inf
    least: float = min(depth, backwards, forwards) + radii[first]
    return least


@njit(cache=True)
def _depth_in_outline(points: Any) -> float:
    """Return how deep the origin lies inside the convex outline of points (p, 2), below 0 if it does not."""
    start = 0
    for i in range(1, len(points)):
        lower = points[i, 1] < points[start, 1]
        if lower or (points[i, 1] == points[start, 1] and points[i, 0] < points[start, 0]):
            start = i
    least, at = math.inf, start
    for _ in range(len(points)):
        to, x, y = -1, 0.0, 0.0
        for i in range(len(points)):
            dx, dy = points[i, 0] - points[at, 0], points[i, 1] - points[at, 1]
            square = dx * dx + dy * dy
            if square <= _SAME_M * _SAME_M:
                continue
            turn = x * dy - y * dx
            if to < 0 or turn < 0.0 or (turn == 0.0 and square > x * x + y * y):
                to, x, y = i, dx, dy
        if to < 0:  # all in one place
            return -math.inf
        size = math.sqrt(x * x + y * y)
        # outwards lies to the right of an edge of an outline that runs to the left
        least = min(least, (points[at, 0] * y - points[at, 1] * x) / size)
        at = to
        dx, dy = points[at, 0] - points[start, 0], points[at, 1] - points[start, 1]
        if dx * dx + dy * dy <= _SAME_M * _SAME_M:
            break
    return least
