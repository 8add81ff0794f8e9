"""All joints as a smooth function of one path variable: cubic pieces with given slopes."""

from dataclasses import dataclass

import numpy as np

from workgauge.values.arrays import Floats, Ints, frozen


@dataclass(frozen=True, slots=True, eq=False)
class JointCurve:
    """Joint positions by a path variable s, cubic between knots (Hermite). All arrays are read-only.

    Attributes:
        s: (m + 1,) growing. q: (m + 1, n) there [rad, m].
        leaving, arriving: (m, n) dq/ds at the beginning and at the end of each piece. They differ at a knot where the
            path has a corner.
    """

    s: Floats
    q: Floats
    leaving: Floats
    arriving: Floats

    @classmethod
    def of(cls, s: Floats, q: Floats, leaving: Floats, arriving: Floats) -> "JointCurve":
        """Return the curve with arrays of its own."""
        return cls(frozen(s), frozen(q), frozen(leaving), frozen(arriving))

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    def piece(self, s: Floats) -> Ints:
        """Return which piece (N,) each s (N,) lies on; a knot belongs to the piece that begins there."""
        found = np.minimum(np.maximum(self.s.searchsorted(s, side="right") - 1, 0), len(self.s) - 2)
        return np.asarray(found, dtype=np.int64)

    def at(self, s: Floats, piece: Ints | None = None) -> tuple[Floats, Floats, Floats]:
        """Return q, dq/ds and d2q/ds2 (N, n each) at s (N,), on the pieces (N,) given or those they lie on."""
        k = self.piece(s) if piece is None else piece
        width = (self.s[k + 1] - self.s[k])[:, None]
        x = (s[:, None] - self.s[k][:, None]) / width
        rise, out, into = self.q[k + 1] - self.q[k], width * self.leaving[k], width * self.arriving[k]
        square, cube = 3.0 * rise - 2.0 * out - into, out + into - 2.0 * rise
        q = self.q[k] + x * (out + x * (square + x * cube))
        first = (out + x * (2.0 * square + 3.0 * x * cube)) / width
        second = (2.0 * square + 6.0 * x * cube) / width**2
        return q, first, second

    def at_one(self, s: float, on: float) -> tuple[Floats, Floats]:
        """Return q and dq/ds (n,) at one s, on the piece that `on` lies on."""
        k = min(max(int(self.s.searchsorted(on, side="right")) - 1, 0), len(self.s) - 2)
        begin, end = self.s[k : k + 2].tolist()
        return _hermite(
            (s - begin) / (end - begin), end - begin, self.q[k], self.q[k + 1], self.leaving[k], self.arriving[k]
        )

    def at_joints(self, s: Floats, piece: Ints, joint: Ints) -> tuple[Floats, Floats]:
        """Return q and dq/ds (N,) of joints (N,), each at its own s (N,), on the pieces (N,) given."""
        begin, begins = self.s[piece], (piece, joint)
        width = self.s[piece + 1] - begin
        ends = self.q[begins], self.q[piece + 1, joint]
        return _hermite((s - begin) / width, width, *ends, self.leaving[begins], self.arriving[begins])


def _hermite(
    x: float | Floats, width: float | Floats, begin: Floats, end: Floats, leaving: Floats, arriving: Floats
) -> tuple[Floats, Floats]:
    """Return value and slope at a share x of a cubic piece, from its ends' values and slopes."""
    rise, out, into = end - begin, width * leaving, width * arriving
    square, cube = 3.0 * rise - 2.0 * out - into, out + into - 2.0 * rise
    return begin + x * (out + x * (square + x * cube)), (out + x * (2.0 * square + 3.0 * x * cube)) / width
