"""Piecewise polynomial curves by distance."""

from dataclasses import dataclass

import numpy as np

from workgauge.motion.paths.orientations import DEGREE, bernstein
from workgauge.values.arrays import Floats, Ints, frozen

_PARTS = 16
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)
_NEWTON_STEPS = 6
_SAME_PLACE_M = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class PiecewiseCurve:
    """Bézier curves of degree 5, end to end, with their lengths by Gauss-Legendre quadrature (ten nodes on each
    sixteenth of a piece).

    Attributes:
        controls: (m, 6, 3) [m].
        lengths: (16 m + 1,) distance at which each sixteenth begins, and the whole length [m].
    """

    controls: Floats
    lengths: Floats

    @classmethod
    def of(cls, controls: Floats) -> "PiecewiseCurve":
        """Return the curve of control points (m, 6, 3) [m], each piece beginning where the last ended."""
        m = len(controls)
        piece = np.repeat(np.arange(m), _PARTS)
        start = np.tile(np.arange(_PARTS) / _PARTS, m)
        parts = _part_lengths(controls, piece, start, start + 1.0 / _PARTS)
        return cls(frozen(controls), frozen(np.concatenate([[0.0], np.cumsum(parts)])))

    @property
    def length(self) -> float:
        """Of the whole [m]."""
        return float(self.lengths[-1])

    @property
    def starts(self) -> Floats:
        """(m + 1,) distances at which the pieces begin, and the end [m]."""
        return self.lengths[::_PARTS]

    @property
    def middles(self) -> Floats:
        """(m,) distances at t = 1/2 of each piece [m]."""
        return self.lengths[_PARTS // 2 :: _PARTS]

    def locate(self, s: Floats, arriving: bool = False) -> tuple[Ints, Floats]:
        """Return the pieces (N,) that distances s (N,) in [0, length] lie on, and the places t (N,) on them.

        Args:
            s: [m]. arriving: where one piece ends and another begins, the one that ends.
        """
        seen = s - _SAME_PLACE_M if arriving else s + _SAME_PLACE_M
        part = np.clip(np.searchsorted(self.lengths, seen, side="right") - 1, 0, len(self.lengths) - 2)
        piece, start = part // _PARTS, (part % _PARTS) / _PARTS
        along = s - self.lengths[part]
        t = start + np.maximum(along, 0.0) / (self.lengths[part + 1] - self.lengths[part]) / _PARTS
        for _ in range(_NEWTON_STEPS):
            beyond = _part_lengths(self.controls, piece, start, t) - along
            speed = np.linalg.norm(_velocities(self.controls[piece], t), axis=-1)
            t = np.clip(t - beyond / speed, start, start + 1.0 / _PARTS)
        return np.asarray(piece, dtype=np.int64), np.asarray(t, dtype=np.float64)

    def at(self, piece: Ints, t: Floats) -> tuple[Floats, Floats]:
        """Return positions (N, 3) [m] and velocities (N, 3) per t [m] at places t (N,) of pieces (N,)."""
        controls = self.controls[piece]
        return np.einsum("nj,njk->nk", bernstein(t, DEGREE), controls), _velocities(controls, t)

    def curvature(self, piece: Ints, t: Floats) -> Floats:
        """Return the curvature (N,) [1/m] at places t (N,) of pieces (N,): `|p' x p''| / |p'|^3`."""
        controls = self.controls[piece]
        second = np.diff(controls, n=2, axis=1)
        bend = DEGREE * (DEGREE - 1) * np.einsum("nj,njk->nk", bernstein(t, DEGREE - 2), second)
        velocity = _velocities(controls, t)
        across = np.linalg.norm(np.cross(velocity, bend), axis=-1)
        return np.asarray(across / np.linalg.norm(velocity, axis=-1) ** 3, dtype=np.float64)

    def slowest(self, samples: int = 65) -> Floats:
        """Return the smallest speed per t (m,) [m] of each piece: near zero where it turns back on itself."""
        m, t = len(self.controls), np.linspace(0.0, 1.0, samples)
        speeds = np.linalg.norm(_velocities(np.repeat(self.controls, samples, axis=0), np.tile(t, m)), axis=-1)
        return np.asarray(speeds.reshape(m, samples).min(axis=1), dtype=np.float64)


def elevated(cubic: Floats) -> Floats:
    """Return the control points (m, 6, 3) of degree 5 of cubic curves (m, 4, 3): the same curves."""
    points = cubic
    for degree in (4, 5):
        share = (np.arange(degree + 1) / degree)[:, None]
        padded = np.concatenate([points[:, :1], points, points[:, -1:]], axis=1)
        points = share * padded[:, :-1] + (1.0 - share) * padded[:, 1:]
    return points


def _velocities(controls: Floats, t: Floats) -> Floats:
    """Return dp/dt (N, 3) of curves with controls (N, 6, 3) at t (N,)."""
    velocity: Floats = DEGREE * np.einsum("nj,njk->nk", bernstein(t, DEGREE - 1), np.diff(controls, axis=1))
    return velocity


def _part_lengths(controls: Floats, piece: Ints, start: Floats, end: Floats) -> Floats:
    """Return the lengths (N,) [m] from places start to end (N,) of pieces (N,)."""
    half = 0.5 * (end - start)
    t = (start + half)[:, None] + half[:, None] * _NODES
    differences = np.diff(controls, axis=1)[piece]
    velocity = DEGREE * np.einsum("nqj,njk->nqk", bernstein(t, DEGREE - 1), differences)
    lengths: Floats = half * (np.linalg.norm(velocity, axis=-1) @ _WEIGHTS)
    return lengths
