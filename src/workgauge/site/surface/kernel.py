"""The search for the topmost triangle at points in plan, compiled."""

import numpy as np

from workgauge.values.arrays import Floats, Ints
from workgauge.values.compiled import njit


@njit(cache=True)
def topmost(
    points: Floats,
    low: Floats,
    cell: float,
    columns: int,
    rows: int,
    starts: Ints,
    entries: Ints,
    packed: Floats,
    z: Floats,
    face: Ints,
) -> None:
    """Write heights (k,) and triangles (k,) at points (k, 2); NaN and -1 where there is none.

    Args:
        low, cell, columns, rows, starts, entries: see `PlanGrid`.
        packed: (m, 10) of each triangle its first corner, what its two shares grow by along x and y, the heights of
            the other corners above the first, and how far below 0 a share may be; infinitely above for none.
    """
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        z[i], face[i] = np.nan, -1
        column, row = (x - low[0]) / cell, (y - low[1]) / cell
        if not (0.0 <= column < columns and 0.0 <= row < rows):
            continue
        at = int(column) * rows + int(row)
        for entry in range(starts[at], starts[at + 1]):
            k = entries[entry]
            dx, dy = x - packed[k, 0], y - packed[k, 1]
            s = dx * packed[k, 3] + dy * packed[k, 4]
            t = dx * packed[k, 5] + dy * packed[k, 6]
            slack = packed[k, 9]
            r = 1.0 - s - t
            if s < slack or t < slack or r < slack:
                continue
            if s < 0.0 or t < 0.0 or r < 0.0:
                s, t, r = max(s, 0.0), max(t, 0.0), max(r, 0.0)
                whole = s + t + r
                s, t = s / whole, t / whole
            height = packed[k, 2] + s * packed[k, 7] + t * packed[k, 8]
            if face[i] < 0 or height > z[i]:
                z[i], face[i] = height, k
