"""A grid of square cells in plan: which triangles may lie at a point, or along a straight line."""

from dataclasses import dataclass

import numpy as np

from workgauge.values.arrays import Floats, Ints

#: No more entries than this for each triangle; else cells are made larger.
_ENTRIES = 12
#: No more cells than this for each triangle.
_CELLS = 16
_ROUND_M = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class PlanGrid:
    """Triangles by the cells their boxes in plan touch, as rows of a sparse table.

    Attributes:
        low: (2,) corner of the first cell [m]. cell: side of a cell [m]. shape: cells (columns, rows).
        starts: (cells + 1,) where each cell's triangles begin in `entries`, ascending within a cell.
    """

    low: Floats
    cell: float
    shape: tuple[int, int]
    starts: Ints
    entries: Ints

    @classmethod
    def of(cls, boxes: Floats) -> "PlanGrid":
        """Return the grid of boxes (m, 4): lowest x, lowest y, highest x, highest y [m]."""
        if not len(boxes):
            return cls(np.zeros(2), 1.0, (1, 1), np.zeros(2, dtype=np.int64), np.zeros(0, dtype=np.int64))
        low = boxes[:, :2].min(axis=0) - _ROUND_M
        size = boxes[:, 2:].max(axis=0) + _ROUND_M - low
        sides = np.sqrt(np.maximum((boxes[:, 2:] - boxes[:, :2]).prod(axis=1), _ROUND_M**2))
        # as large as triangles are in the middle: most of a box may be empty, and triangles small in one part of it
        cell = max(0.5 * float(np.median(sides)), float(np.sqrt(size.prod() / (_CELLS * len(boxes) + 1000))))
        while True:
            first = ((boxes[:, :2] - _ROUND_M - low) // cell).astype(np.int64)
            last = ((boxes[:, 2:] + _ROUND_M - low) // cell).astype(np.int64)
            wide = last - first + 1
            count = wide.prod(axis=1)
            if count.sum() <= _ENTRIES * len(boxes) or len(boxes) < 3:
                break
            cell *= 1.5
        columns, rows = (int(most) + 1 for most in last.max(axis=0))
        face = np.repeat(np.arange(len(boxes)), count)
        within = _counted(count)
        x = first[face, 0] + within % wide[face, 0]
        y = first[face, 1] + within // wide[face, 0]
        flat = x * rows + y
        order = np.argsort(flat, kind="stable")
        starts = np.zeros(columns * rows + 1, dtype=np.int64)
        np.cumsum(np.bincount(flat, minlength=columns * rows), out=starts[1:])
        return cls(low, cell, (columns, rows), starts, face[order])

    def near_line(self, start: Floats, end: Floats) -> Ints:
        """Return the triangles (k,), ascending, whose boxes may touch the straight line between two points (2,)."""
        a, b = sorted(((start - self.low) / self.cell, (end - self.low) / self.cell), key=lambda place: place[0])
        slack = 2.0 * _ROUND_M / self.cell
        columns, rows = self.shape
        x0, x1 = max(int(np.floor(a[0] - slack)), 0), min(int(np.floor(b[0] + slack)), columns - 1)
        if x1 < x0:
            return np.zeros(0, dtype=np.int64)
        x = np.arange(x0, x1 + 1)
        run = b[0] - a[0]
        slope = (b[1] - a[1]) / run if run > slack else 0.0
        if run > slack:
            left = a[1] + slope * (np.clip(x - slack, a[0], b[0]) - a[0])
            right = a[1] + slope * (np.clip(x + 1 + slack, a[0], b[0]) - a[0])
        else:
            left, right = np.full(len(x), a[1]), np.full(len(x), b[1])
        y0 = np.clip(np.floor(np.minimum(left, right) - slack), 0, rows).astype(np.int64)
        y1 = np.clip(np.floor(np.maximum(left, right) + slack), -1, rows - 1).astype(np.int64)
        count = np.maximum(y1 - y0 + 1, 0)
        column = np.repeat(x, count)
        row = np.repeat(y0, count) + _counted(count)
        return np.unique(self._listed(column * rows + row))

    def _listed(self, cells: Ints) -> Ints:
        """Return the triangles of cells (k,), those of several as often."""
        count = self.starts[cells + 1] - self.starts[cells]
        found: Ints = self.entries[np.repeat(self.starts[cells], count) + _counted(count)]
        return found


def _counted(count: Ints) -> Ints:
    """Return 0, 1, ... for each of the counts (k,), one after the other."""
    ends = np.cumsum(count)
    total = int(ends[-1]) if len(ends) else 0
    return np.arange(total) - np.repeat(ends - count, count)
