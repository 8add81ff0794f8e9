"""Which pairs of link solid and cell may be near: vectorised lower bounds of their distance."""

import numpy as np

from workgauge.proximity.cells import OrientedBoxes
from workgauge.values.arrays import Floats, Ints


def box_gaps(lows: Floats, highs: Floats, other_lows: Floats, other_highs: Floats) -> Floats:
    """Return the distances (s, c) between s and c axis-parallel boxes, each given by (·, 3) lows and highs."""
    gaps = np.maximum(other_lows - highs[:, None], lows[:, None] - other_highs)
    np.maximum(gaps, 0.0, out=gaps)
    found: Floats = np.sqrt(np.vecdot(gaps, gaps))
    return found


def oriented_gaps(first: OrientedBoxes, i: Ints, second: OrientedBoxes, j: Ints) -> Floats:
    """Return lower bounds (p,) of the distances between boxes first[i] and second[j].

    Each is the larger of two exact distances: from either box to the box parallel to it around the other.
    """
    A, B = first.axes.take(i, axis=0), second.axes.take(j, axis=0)
    half_a, half_b = first.halves.take(i, axis=0), second.halves.take(j, axis=0)
    apart = second.centres.take(j, axis=0) - first.centres.take(i, axis=0)
    A_t = A.transpose(0, 2, 1)
    turned = np.abs(A_t @ B)
    gaps = np.empty((2, len(i), 3))
    np.abs(np.matvec(A_t, apart), out=gaps[0])
    np.abs(np.vecmat(apart, B), out=gaps[1])
    gaps[0] -= half_a
    gaps[0] -= np.matvec(turned, half_b)
    gaps[1] -= half_b
    gaps[1] -= np.vecmat(half_a, turned)
    np.maximum(gaps, 0.0, out=gaps)
    found: Floats = np.sqrt(np.vecdot(gaps, gaps).max(axis=0))
    return found
