"""What of a site is near a machine's boxes, and how near: one compiled call for all that do not touch."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from workgauge.proximity.cells import Cells
from workgauge.proximity.closest import closest
from workgauge.proximity.tree import inside
from workgauge.values.arrays import Floats, Ints, freeze, frozen_ints
from workgauge.values.compiled import njit
from workgauge.values.limits import Limit

#: Lower bounds may be this much too large by rounding [m].
SLACK_M = 1e-9
#: At and below this distance nothing is measured here: `overlap` and `chain` decide [m].
NEARLY_M = 3e-5
_FIRST, _LAST = -(2**63), 2**63 - 1


class Rules:
    """Which limits count when, and for which solids, packed.

    Attributes:
        limits: (m, 5), of each limit its work state and its track (numbers in `off`, -1: none), when it begins and
            ends to count [ns], and its row in `exempt`. exempt: (patterns, S), solids a limit does not apply to.
    """

    def __init__(self, limits: Sequence[Limit], links: Sequence[str]) -> None:
        self._states = sorted({limit.activity.state for limit in limits if limit.activity.state is not None})
        self._tracks = sorted({limit.own_track_of for limit in limits if limit.own_track_of is not None})
        state_of = {name: i for i, name in enumerate(self._states)}
        track_of = {name: len(state_of) + i for i, name in enumerate(self._tracks)}
        patterns = sorted({limit.exempt_links for limit in limits}, key=sorted)
        pattern_of = {pattern: i for i, pattern in enumerate(patterns)}
        packed = [
            (
                -1 if limit.activity.state is None else state_of[limit.activity.state],
                -1 if limit.own_track_of is None else track_of[limit.own_track_of],
                _instant(limit.activity.not_before_ns, _FIRST),
                _instant(limit.activity.not_after_ns, _LAST),
                pattern_of[limit.exempt_links],
            )
            for limit in limits
        ]
        self.limits: Ints = frozen_ints(np.reshape(packed, (-1, 5)))
        self.exempt = np.array([[name in one for name in links] for one in patterns], np.bool_)
        self.exempt = self.exempt.reshape(len(patterns), len(links))
        self._none_off = np.zeros(len(self._states) + len(self._tracks), np.bool_)
        freeze(self.exempt)
        freeze(self._none_off)

    def off(self, off_states: frozenset[str], let_off: frozenset[str]) -> np.ndarray:
        """Return which states are off and which tracks are let off."""
        if not (off_states or let_off):
            return self._none_off
        states, tracks = ([name in off_states for name in self._states], [name in let_off for name in self._tracks])
        off = np.array(states + tracks, np.bool_)
        freeze(off)
        return off


def _instant(at_ns: int | None, default: int) -> int:
    """Return an instant as compiled code can hold it [ns]."""
    return default if at_ns is None else min(max(at_ns, _FIRST), _LAST)


def packed_cells(cells: Cells) -> tuple[Floats, Ints]:
    """Return the boxes around cells (m, 15: centre, half extents, axes by rows), their limits and cells (m, 2)."""
    boxes, count = cells.boxes, len(cells)
    shapes = np.concatenate([boxes.centres, boxes.halves, boxes.axes.reshape(count, 9)], axis=1)
    owners = np.stack([cells.limits, cells.cells], axis=1)
    freeze(shapes)
    freeze(owners)
    return shapes, owners


@njit(cache=True)
def placed(T: Any, poses: Any, halves: Any) -> Any:
    """Return the boxes (S, 15: centre, half extents, axes by rows), corners (S, 8, 3), lows and highs (S, 3)."""
    count = len(poses)
    boxes, corners = np.empty((count, 15)), np.empty((count, 8, 3))
    lows, highs = np.empty((count, 3)), np.empty((count, 3))
    for s in range(count):
        for i in range(3):
            total = 0.0
            for j in range(3):
                total += T[i, j] * poses[s, j, 3]
            boxes[s, i], boxes[s, 3 + i] = total + T[i, 3], halves[s, i]
            for k in range(3):
                total = 0.0
                for j in range(3):
                    total += T[i, j] * poses[s, j, k]
                boxes[s, 6 + 3 * i + k] = total
            x, y = boxes[s, 6 + 3 * i] * halves[s, 0], boxes[s, 7 + 3 * i] * halves[s, 1]
            z = boxes[s, 8 + 3 * i] * halves[s, 2]
            for k in range(8):
                total = boxes[s, i] + (x if k & 4 else -x)
                corners[s, k, i] = total + (y if k & 2 else -y) + (z if k & 1 else -z)
            reach = abs(x) + abs(y) + abs(z)
            lows[s, i], highs[s, i] = boxes[s, i] - reach, boxes[s, i] + reach
    return boxes, corners, lows, highs


@njit(cache=True)
def _apart(low: Any, high: Any, other_low: Any, other_high: Any) -> float:
    """Return the distance of two axis-parallel boxes."""
    square = 0.0
    for c in range(3):
        gap = max(other_low[c] - high[c], low[c] - other_high[c], 0.0)
        square += gap * gap
    return math.sqrt(square)


@njit(cache=True)
def _bound(a: Any, b: Any) -> float:
    """Return a lower bound of the distance of two boxes (15,): that from each to the box parallel to it round the
    other, whichever is larger."""
    first, second = 0.0, 0.0
    for i in range(3):
        along, other = 0.0, 0.0
        wide, wide_other = a[3 + i], b[3 + i]
        for c in range(3):
            apart = b[c] - a[c]
            along += a[6 + 3 * c + i] * apart
            other += b[6 + 3 * c + i] * apart
        for k in range(3):
            turned, back = 0.0, 0.0
            for c in range(3):
                turned += a[6 + 3 * c + i] * b[6 + 3 * c + k]
                back += b[6 + 3 * c + i] * a[6 + 3 * c + k]
            wide += abs(turned) * b[3 + k]
            wide_other += abs(back) * a[3 + k]
        first += max(abs(along) - wide, 0.0) ** 2
        second += max(abs(other) - wide_other, 0.0) ** 2
    return math.sqrt(max(first, second))


@njit(cache=True)
def _counts(rule: Any, now: int, off: Any) -> bool:
    """Return whether a limit counts now, as `Limit.counts` does."""
    if (rule[0] >= 0 and off[rule[0]]) or (rule[1] >= 0 and off[rule[1]]):
        return False
    return bool(rule[2] <= now <= rule[3])


@njit(cache=True)
def _pairs(
    boxes: Any,
    lows: Any,
    highs: Any,
    radius: float,
    near: Any,
    cell_lows: Any,
    cell_highs: Any,
    shapes: Any,
    owners: Any,
    when: Any,
) -> Any:
    """Return which solids and cells (p, 2) may be nearer than the radius, by solid and cell, and bounds (p,)."""
    rules, exempt, off, now = when
    size, count = len(boxes) * len(near), 0
    pairs, bounds = np.empty((size, 2), np.int64), np.empty(size)
    counting = np.empty(len(near), np.bool_)
    for k in range(len(near)):
        counting[k] = _counts(rules[owners[near[k], 0]], now, off)
    for s in range(len(boxes)):
        for k in range(len(near)):
            cell = near[k]
            if not counting[k] or exempt[rules[owners[cell, 0], 4], s]:
                continue
            if _apart(lows[s], highs[s], cell_lows[cell], cell_highs[cell]) >= radius + SLACK_M:
                continue
            bound = _bound(boxes[s], shapes[cell])
            if bound < radius + SLACK_M:
                pairs[count, 0], pairs[count, 1], bounds[count] = s, cell, bound
                count += 1
    return pairs[:count], bounds[:count]


@njit(cache=True)
def _measure(
    first: int, last: int, radius: float, pairs: Any, bounds: Any, boxes: Any, corners: Any, shapes: Any, hulls: Any
) -> Any:
    """Return the nearest of the pairs first to last, all of one solid and one limit, with its distance, normal and
    point (7,); -1 for none within the radius, -2 if one touches."""
    hull_of, points, starts, radii = hulls
    best, chosen, found = radius, -1, np.empty(7)
    out, left = np.empty(6), bounds[first:last].copy()
    for _ in range(first, last):
        i = int(np.argmin(left))
        if left[i] >= best + SLACK_M and left[i] > SLACK_M:
            break
        left[i] = np.inf
        s, cell = pairs[first + i, 0], pairs[first + i, 1]
        hull = hull_of[cell]
        body, other = boxes[s], shapes[cell]
        x, y, z = body[0] - other[0], body[1] - other[1], body[2] - other[2]
        apart = closest(corners[s], points[starts[hull] : starts[hull + 1]], x, y, z, out)
        if apart <= NEARLY_M:
            return -2, found
        if apart - radii[hull] < best:
            best, chosen = apart - radii[hull], first + i
            found[0] = best
            found[1:] = out
    return chosen, found


@njit(cache=True)
def _put(r: int, found: Any, link: int, other: int, limit: int, cell: int, s: int, stops: Any, rows: Any) -> None:
    """Fill row r with what was found (7,): distance, normal and point on the machine."""
    scalars, vectors, indices = rows
    scalars[0, r], scalars[2, r] = found[0], stops[limit]
    for c in range(3):
        vectors[0, r, c], vectors[1, r, c] = found[1 + c], found[4 + c]
        vectors[2, r, c] = found[4 + c] - found[0] * found[1 + c]
    indices[0, r], indices[1, r], indices[2, r], indices[3, r], indices[4, r] = link, other, limit, cell, s


@njit(cache=True)
def _between(s: int, other: int, radius: float, placed: Any, found: Any) -> float:
    """Fill found (7,) for two of the machine's own boxes and return their distance, infinite beyond the radius."""
    boxes, corners, lows, highs = placed
    if _apart(lows[s], highs[s], lows[other], highs[other]) >= radius + SLACK_M:
        return math.inf
    a, b = boxes[s], boxes[other]
    found[0] = closest(corners[s], corners[other], a[0] - b[0], a[1] - b[1], a[2] - b[2], found[1:])
    return math.inf if found[0] >= radius else found[0]


@njit(cache=True)
def _all(
    radius: float,
    pairs: Any,
    bounds: Any,
    placed: Any,
    cells: Any,
    hulls: Any,
    own_pairs: Any,
    links: Any,
    stops: Any,
    limits: int,
) -> Any:
    """Measure pairs (p, 2) and the machine's own; return all from scalars to bounds as `search` does.

    limits: how many there are; the links of the machine are numbered after them.
    """
    shapes, owners = cells
    boxes, corners, _, _ = placed
    size = len(pairs) + len(own_pairs)
    scalars, vectors, indices = np.zeros((3, size)), np.empty((3, size, 3)), np.empty((5, size), np.int64)
    rows = scalars, vectors, indices
    touching, touching_bounds = np.empty((size, 3), np.int64), np.empty(size)
    count, touched, first, own, between = 0, 0, 0, 0, np.empty(7)
    for s in range(len(boxes)):
        while first < len(pairs) and pairs[first, 0] == s:
            limit, last = owners[pairs[first, 1], 0], first + 1
            while last < len(pairs) and pairs[last, 0] == s and owners[pairs[last, 1], 0] == limit:
                last += 1
            chosen, found = _measure(first, last, radius, pairs, bounds, boxes, corners, shapes, hulls)
            if chosen >= 0:
                _put(count, found, links[s], -1, limit, owners[pairs[chosen, 1], 1], s, stops, rows)
                count += 1
            for i in range(first, last if chosen == -2 else first):
                touching[touched, 0], touching[touched, 1], touching[touched, 2] = s, pairs[i, 1], -1
                touching_bounds[touched] = bounds[i]
                touched += 1
            first = last
        while own < len(own_pairs) and own_pairs[own, 0] == s:
            other = own_pairs[own, 1]
            own += 1
            apart = _between(s, other, radius, placed, between)
            if apart <= NEARLY_M:
                touching[touched, 0], touching[touched, 1], touching[touched, 2] = s, -1, other
                touching_bounds[touched] = 0.0
                touched += 1
            elif apart < radius:
                _put(count, between, links[s], links[other], limits + links[other], -1, s, stops, rows)
                count += 1
    scalars, vectors, indices = scalars[:, :count].copy(), vectors[:, :count].copy(), indices[:, :count].copy()
    return scalars, vectors, indices, touching[:touched], touching_bounds[:touched]


@njit(cache=True)
def search(
    T: Any,
    poses: Any,
    halves: Any,
    radius: float,
    tree: Any,
    cells: Any,
    when: Any,
    hulls: Any,
    own_pairs: Any,
    links: Any,
    stops: Any,
) -> Any:
    """Return every clearance below the radius that does not touch, in order, and what else has to be looked at.

    Args:
        T: (4, 4) site from machine. poses, halves: of the solids, machine frame. tree: over the cells.
        cells: lows, highs, and `packed_cells`. when: what `Rules` has, off, and the clock. hulls: the hull of each
            cell, and `Hulls`' corners, starts, radii. own_pairs: (p, 2) solid that moves, other solid, by the first,
            the other's link, the other. links: (S,). stops: stop distances of limits, then of all links.

    Returns:
        finite: whether the machine is somewhere at all. lacking: cells without a hull; while there are any, nothing
        else is said. scalars: (3, k) distance, protection (0), stop distance. vectors: (3, k, 3) normal, point on the
        machine, on the limit. indices: (5, k) link, other link, limit, cell, solid. touching: (t, 3) solid, cell or
        -1, other solid or -1: all pairs of a solid and a limit if one touches. bounds: (t,) theirs.
    """
    cell_lows, cell_highs, shapes, owners = cells
    machine = placed(T, poses, halves)
    boxes, _, lows, highs = machine
    low, high, sound = np.empty(3), np.empty(3), 0.0
    for c in range(3):
        low[c], high[c] = lows[:, c].min() - radius, highs[:, c].max() + radius
        sound += lows[:, c].sum() + highs[:, c].sum()
    finite = math.isfinite(sound) and radius > 0.0
    pairs, bounds = np.empty((0, 2), np.int64), np.empty(0)
    if finite and len(cell_lows) > 0:
        near = inside(tree[0], tree[1], tree[2], cell_lows, cell_highs, low, high)
        pairs, bounds = _pairs(boxes, lows, highs, radius, near, cell_lows, cell_highs, shapes, owners, when)
    lacking = _lacking(pairs, hulls[0])
    if not finite or len(lacking) > 0:
        pairs, own_pairs = pairs[:0], own_pairs[:0]
    found = _all(
        *(radius, pairs, bounds, machine, (shapes, owners), hulls, own_pairs, links, stops, len(when[0])),
    )
    return finite, lacking, found


@njit(cache=True)
def _lacking(pairs: Any, hull_of: Any) -> Any:
    """Return the cells among pairs (p, 2) that have no hull."""
    found, count = np.empty(len(pairs), np.int64), 0
    for i in range(len(pairs)):
        if hull_of[pairs[i, 1]] < 0:
            found[count] = pairs[i, 1]
            count += 1
    return found[:count]
