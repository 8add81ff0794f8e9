"""The kinematic envelope's section: half-widths, widening by radius, quasi-static part, rotation by cant.

Section coordinates here are (y, h): y towards the inside (low) rail, h above the top of rail, before the cant turns
the section. All functions are pure and vectorised; metres and radians. The numbers come from a rule book, which
names the source of each.
"""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from workgauge.values.arrays import Floats

#: By how much a curve's radius may come out of the arithmetic below the smallest one, relative, and still count.
RADIUS_SLACK = 1e-6


@dataclass(frozen=True, slots=True)
class Branch:
    """One branch of a widening formula, S = a/R + b from radius `from_radius` [m] upwards; a in m², b in m."""

    from_radius: float
    inside_a: float
    inside_b: float
    outside_a: float
    outside_b: float


@dataclass(frozen=True, slots=True)
class FormulaWidening:
    """Widening by formula, S = a/R + b, in branches ordered by rising radius; straight track has 1/R = 0."""

    branches: tuple[Branch, ...]

    @property
    def smallest_radius(self) -> float:
        """The radius below which there is no answer [m]."""
        return self.branches[0].from_radius

    def at(self, curvature: ArrayLike) -> tuple[Floats, Floats]:
        """Return (inside, outside) widening [m] at unsigned curvatures [1/m]; NaN below the smallest radius."""
        k = _settled(curvature, self.smallest_radius)
        inside, outside = np.full(k.shape, np.nan), np.full(k.shape, np.nan)
        for branch in self.branches:
            here = k * branch.from_radius <= 1.0
            inside = np.where(here, branch.inside_a * k + branch.inside_b, inside)
            outside = np.where(here, branch.outside_a * k + branch.outside_b, outside)
        return np.maximum(inside, 0.0), np.maximum(outside, 0.0)


@dataclass(frozen=True, slots=True)
class TableWidening:
    """Widening from a table by rising radius [m], linear in the radius between rows, the last row's beyond it."""

    radii: tuple[float, ...]
    inside: tuple[float, ...]
    outside: tuple[float, ...]

    @property
    def smallest_radius(self) -> float:
        """The radius below which there is no answer [m]."""
        return self.radii[0]

    def at(self, curvature: ArrayLike) -> tuple[Floats, Floats]:
        """Return (inside, outside) widening [m] at unsigned curvatures [1/m]; NaN below the smallest radius."""
        k = _settled(curvature, self.smallest_radius)
        radius = 1.0 / np.maximum(k, 1e-12)
        refused = k * self.smallest_radius > 1.0
        inside = np.where(refused, np.nan, np.interp(radius, self.radii, self.inside))
        outside = np.where(refused, np.nan, np.interp(radius, self.radii, self.outside))
        return inside, outside


Widening: TypeAlias = FormulaWidening | TableWidening


def _settled(curvature: ArrayLike, smallest_radius: float) -> Floats:
    """Return unsigned curvatures, those within rounding of the smallest radius set to it exactly."""
    k = np.abs(np.asarray(curvature, dtype=np.float64))
    limit = 1.0 / smallest_radius
    return np.where((k > limit) & (k <= limit * (1 + RADIUS_SLACK)), np.nextafter(limit, 0.0), k)


@dataclass(frozen=True, slots=True)
class QuasiStatic:
    """Quasi-static lean, `qs = s0/L · max(x − x0, 0) · max(h − h0, 0)`, x being cant D or cant deficiency I [m].

    Attributes:
        s0: flexibility coefficient. base: L [m]. threshold: x0 [m]. height: h0, the roll centre [m].
        deficiency: cant deficiency assumed in curves [m].
        full_below_radius: from straight track down to this radius [m] the assumed deficiency rises in proportion
            to the curvature; at smaller radii it counts in full.
    """

    s0: float
    base: float
    threshold: float
    height: float
    deficiency: float
    full_below_radius: float

    def slope(self, x: ArrayLike) -> Floats:
        """Return the lean per metre of height above the roll centre for x = D or I [m]."""
        return self.s0 / self.base * np.maximum(np.abs(np.asarray(x, dtype=np.float64)) - self.threshold, 0.0)

    def lean(self, x: ArrayLike, h: ArrayLike) -> Floats:
        """Return qs [m] for x = D or I [m] at height h [m] above the top of rail."""
        return self.slope(x) * np.maximum(np.asarray(h, dtype=np.float64) - self.height, 0.0)

    def assumed_deficiency(self, curvature: ArrayLike) -> Floats:
        """Return the cant deficiency I [m] assumed at curvatures [1/m] of either sign."""
        k = np.abs(np.asarray(curvature, dtype=np.float64))
        return self.deficiency * np.minimum(k * self.full_below_radius, 1.0)


def required_half_width(reference: ArrayLike, widening: ArrayLike, lean: ArrayLike, margin: ArrayLike) -> Floats:
    """Return b_req = b_ref + S + qs + the rule book's own margin [m]."""
    b, s, qs, own = (np.asarray(part, dtype=np.float64) for part in (reference, widening, lean, margin))
    return b + s + qs + own


def cant_angle(cant: ArrayLike, base: float) -> Floats:
    """Return φ = asin(D/b) [rad] for cant D [m] over the base b between the rails' contact points [m]."""
    return np.arcsin(np.asarray(cant, dtype=np.float64) / base)


def rotate(y: ArrayLike, h: ArrayLike, angle: ArrayLike, pivot: ArrayLike) -> tuple[Floats, Floats]:
    """Turn section points by the cant angle φ about the point (pivot, 0).

    `y' = y0 + (y − y0) cos φ + h sin φ;  z' = −(y − y0) sin φ + h cos φ`, y > 0 towards the low rail. The pivot y0 is
    0 about the track's centre, b/2 about the low rail.

    Returns:
        (y', z') [m], broadcast from the arguments.
    """
    y, h = np.asarray(y, dtype=np.float64), np.asarray(h, dtype=np.float64)
    turn, y0 = np.asarray(angle, dtype=np.float64), np.asarray(pivot, dtype=np.float64)
    c, s = np.cos(turn), np.sin(turn)
    arm = y - y0
    return y0 + arm * c + h * s, -arm * s + h * c
