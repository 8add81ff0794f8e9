"""Chains of cells, packed for compiled code; a limit's chain is packed when it is first touched."""

import numpy as np

from workgauge.proximity.store import CellShapes
from workgauge.values.arrays import Floats, Ints

_FIRST = 64


class Chains:
    """The columns of `chain.Chain` of the limits touched so far, cell by cell, one limit after the other."""

    def __init__(self, shapes: CellShapes, limits: int) -> None:
        self._shapes, self._count = shapes, 0
        self._of_limit: Ints = np.full(limits, -1)
        self._starts, self._frames, self._ends_out = (
            np.empty((_FIRST, 3)),
            np.empty((_FIRST, 3, 3)),
            np.empty((_FIRST, 3)),
        )
        self._lengths, self._straight_on = np.empty(_FIRST), np.zeros(_FIRST, np.bool_)
        self._back, self._ahead, self._radii = np.empty(_FIRST), np.empty(_FIRST), np.empty(_FIRST)
        self._sections, self._section_starts = np.empty((8 * _FIRST, 2)), np.zeros(_FIRST + 1, np.int64)

    def add(self, limit: int, cell: int) -> None:
        """Pack the chain of a limit, one of whose cells is touched; nothing if it is none (cell below 0) or known."""
        if cell < 0 or self._of_limit[limit] >= 0:
            return
        chain, first = self._shapes.chain(limit), self._count
        count = first + len(chain.starts)
        while count > len(self._lengths):
            self._grow()
        corners, begin = chain.sections.shape[1], int(self._section_starts[first])
        while begin + corners * len(chain.starts) > len(self._sections):
            self._sections = _twice(self._sections)
        rows = slice(first, count)
        self._starts[rows], self._frames[rows], self._ends_out[rows] = chain.starts, chain.frames, chain.ends_out
        self._lengths[rows], self._straight_on[rows] = chain.lengths, chain.straight_on
        self._back[rows], self._ahead[rows], self._radii[rows] = chain.back, chain.ahead, chain.radius
        self._sections[begin : begin + corners * len(chain.starts)] = chain.sections.reshape(-1, 2)
        self._section_starts[first + 1 : count + 1] = begin + corners * np.arange(1, len(chain.starts) + 1)
        self._of_limit[limit], self._count = first, count

    def packed(self) -> tuple[Ints, Floats, Floats, Floats, Floats, np.ndarray, Floats, Floats, Floats, Floats, Ints]:
        """Return everything as `depths` takes it: the first row of each limit's chain or -1, and the columns."""
        return (
            *(self._of_limit, self._starts, self._frames, self._ends_out, self._lengths, self._straight_on),
            *(self._back, self._ahead, self._radii, self._sections, self._section_starts),
        )

    def _grow(self) -> None:
        self._starts, self._frames, self._ends_out = (
            _twice(self._starts),
            _twice(self._frames),
            _twice(self._ends_out),
        )
        self._lengths, self._straight_on = _twice(self._lengths), _twice(self._straight_on)
        self._back, self._ahead, self._radii = _twice(self._back), _twice(self._ahead), _twice(self._radii)
        self._section_starts = _twice(self._section_starts)


def _twice(array: np.ndarray) -> np.ndarray:
    return np.concatenate([array, np.zeros_like(array)])
