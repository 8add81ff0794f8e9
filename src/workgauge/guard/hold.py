"""The last word of a guard that judges the present: what still approaches where nothing may, is taken off."""

import numpy as np

from workgauge.guard.projection import project
from workgauge.values.arrays import Floats

#: A row of length 1 may fall short by this much [m/s].
SHORT_M_S = 1e-8
#: Rows shorter than this move nothing [m/rad].
MOVES_M = 1e-9


def short(velocity: Floats, rows: Floats, floors: Floats) -> np.ndarray:
    """Return which rows (k,) shrink faster at a joint velocity (n,) than their floors (k,) [m/s] let them."""
    lengths = np.sqrt((rows * rows).sum(axis=1))
    found: np.ndarray = rows @ velocity < floors - SHORT_M_S * np.maximum(lengths, 1.0)
    return found


def held(velocity: Floats, rows: Floats, floors: Floats, low: Floats, high: Floats, freedom: Floats) -> Floats:
    """Return the joint velocity (n,) nearest to the given one with `rows @ v >= floors` and `low <= v <= high`.

    First what is added is sought among the motions of `freedom` alone, so that the tool's task keeps what is to be
    kept; where they do not suffice, among all. Rest always qualifies; if rounding spoils the nearest, so much of it
    is left as does.

    Args:
        velocity: (n,) within low and high [rad/s, m/s]. rows: (k, n) `d(distance)/dt = row @ v` [m/rad, m/m].
        floors: (k,) at most 0 [m/s]. low, high: (n,), low at most 0, high at least 0.
        freedom: (n, d) orthonormal columns.
    """
    if not short(velocity, rows, floors).any():
        return velocity
    n = len(velocity)
    for basis in (freedom, np.eye(n)):
        found = _added(velocity, rows, floors, low, high, basis)
        if not short(found, rows, floors).any():
            return found
    change = rows @ found
    over = change < floors
    return found * max(float(np.min(floors[over] / change[over])), 0.0)


def _added(velocity: Floats, rows: Floats, floors: Floats, low: Floats, high: Floats, basis: Floats) -> Floats:
    """Return the velocity with the least of a basis (n, d) added that meets the rows, as far as it can."""
    n, d = basis.shape
    within = rows @ basis
    lengths = np.sqrt((within * within).sum(axis=1))
    moves = lengths > MOVES_M
    normals = np.concatenate((within[moves] / lengths[moves, None], basis, -basis))
    missing = (floors - rows @ velocity)[moves] / lengths[moves]
    offsets = np.concatenate((missing, low - velocity, velocity - high))
    count = int(moves.sum())
    point, _, _ = project(np.zeros(d), normals, offsets, np.full(count + 2 * n, 1e-10))
    bounded: Floats = np.minimum(np.maximum(velocity + basis @ point, low), high)
    return bounded
