"""A tree of boxes over a site's cells, searched in compiled code; its cost grows with what is near."""

from typing import Any, NamedTuple

import numpy as np

from workgauge.values.arrays import Floats, Ints, freeze
from workgauge.values.compiled import njit

#: A leaf has at most so many cells.
_LEAF = 4
#: Halving so often leaves leaves of any number that fits a computer.
DEPTH = 64


class Tree(NamedTuple):
    """m axis-parallel boxes halved again and again, across their longest side.

    Attributes:
        order: (m,) numbers of the boxes, those of a node side by side. spans: (nodes, 6), low and high of what is
            in each node. nodes: (nodes, 3), its first and past its last place in `order`, and the first of its two
            children, which follow each other, or -1.
    """

    order: Ints
    spans: Floats
    nodes: Ints

    @classmethod
    def over(cls, lows: Floats, highs: Floats) -> "Tree":
        """Return the tree over boxes from lows to highs, (m, 3) each."""
        tree = cls(*_built(np.ascontiguousarray(lows), np.ascontiguousarray(highs)))
        for array in tree:
            freeze(array)
        return tree


@njit(cache=True)
def _built(lows: Any, highs: Any) -> Any:
    count = len(lows)
    order = np.arange(count)
    spans, nodes = np.empty((2 * count + 1, 6)), np.empty((2 * count + 1, 3), np.int64)
    nodes[0, 0], nodes[0, 1] = 0, count
    used, node = 1, 0
    while node < used:
        first, last = nodes[node, 0], nodes[node, 1]
        middle_low, middle_high = np.full(3, np.inf), np.full(3, -np.inf)
        for c in range(3):
            spans[node, c], spans[node, 3 + c] = np.inf, -np.inf
            for i in range(first, last):
                low, high = lows[order[i], c], highs[order[i], c]
                spans[node, c] = min(spans[node, c], low)
                spans[node, 3 + c] = max(spans[node, 3 + c], high)
                middle_low[c] = min(middle_low[c], low + high)
                middle_high[c] = max(middle_high[c], low + high)
        nodes[node, 2] = -1
        if last - first > _LEAF:
            axis = np.argmax(middle_high - middle_low)
            inside = order[first:last].copy()
            keys = np.empty(last - first)
            for i in range(last - first):
                keys[i] = lows[inside[i], axis] + highs[inside[i], axis]
            order[first:last] = inside[np.argsort(keys, kind="mergesort")]
            half = (first + last) // 2
            nodes[node, 2] = used
            nodes[used, 0], nodes[used, 1] = first, half
            nodes[used + 1, 0], nodes[used + 1, 1] = half, last
            used += 2
        node += 1
    return order, spans[:used].copy(), nodes[:used].copy()


@njit(cache=True)
def inside(order: Any, spans: Any, nodes: Any, lows: Any, highs: Any, low: Any, high: Any) -> Any:
    """Return which boxes from lows to highs (m, 3) meet the one from low to high (3,), ascending."""
    found, count = np.empty(64, np.int64), 0
    waiting, depth = np.empty(DEPTH, np.int64), 1
    waiting[0] = 0
    while depth > 0:
        depth -= 1
        node = waiting[depth]
        if not _meet(spans[node, :3], spans[node, 3:], low, high):
            continue
        child = nodes[node, 2]
        if child >= 0:
            waiting[depth], waiting[depth + 1] = child, child + 1
            depth += 2
            continue
        for i in range(nodes[node, 0], nodes[node, 1]):
            box = order[i]
            if _meet(lows[box], highs[box], low, high):
                if count == len(found):
                    found = np.concatenate((found, found))
                found[count] = box
                count += 1
    return np.sort(found[:count])


@njit(cache=True)
def _meet(low: Any, high: Any, other_low: Any, other_high: Any) -> bool:
    met = True
    for c in range(3):
        met = met and low[c] <= other_high[c] and high[c] >= other_low[c]
    return met
