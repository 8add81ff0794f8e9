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
        return np.asarray(np.clip(np.searchsorted(self.s, s, side="right") - 1, 0, len(self.s) - 2), dtype=np.int64)

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
