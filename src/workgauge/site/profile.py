"""The vertical alignment: straight grades, parabolas and circular arcs through points of vertical intersection."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from workgauge.values.arrays import Floats, freeze

#: A profile is carried on by this much beyond its ends, for files that round stations and lengths differently [m].
END_SLACK_M = 0.01
#: Neighbouring vertical curves may overlap by this much from rounding [m].
OVERLAP_SLACK_M = 0.05


class VerticalCurve(StrEnum):
    """What rounds off a point of vertical intersection."""

    NONE = "none"
    CIRCLE = "circle"
    PARABOLA = "parabola"


@dataclass(frozen=True, slots=True)
class VerticalPoint:
    """A point of vertical intersection.

    Attributes:
        distance: along the alignment [m]. height: [m].
        radius: of the circle [m], unsigned: the grades say whether it is a crest or a sag; None: from the lengths.
        length_in, length_out: of the curve before and after the point, in plan [m].
        line: line in the file.
    """

    distance: float
    height: float
    curve: VerticalCurve = VerticalCurve.NONE
    radius: float | None = None
    length_in: float = 0.0
    length_out: float = 0.0
    line: int | None = None


class ProfileError(ValueError):
    """Points of vertical intersection that make no profile; `point` is the place in the list, counted from 0."""

    def __init__(self, message: str, point: int) -> None:
        super().__init__(message)
        self.point = point


@dataclass(frozen=True, slots=True)
class _Piece:
    """From `begin` on: height z0, gradient g0, then a parabola (z'' = bend) or a circle (d sin(angle)/ds = bend)."""

    begin: float
    z0: float
    g0: float
    bend: float = 0.0
    circle: bool = False


class Profile:
    """Height and gradient over the distance, vectorised. Build it with `build_profile`."""

    def __init__(self, pieces: Sequence[_Piece], end: float) -> None:
        self.start, self.end = pieces[0].begin, end
        self._begin = np.array([p.begin for p in pieces])
        self._rows = np.array([[p.z0, p.g0, p.bend] for p in pieces])
        self._circle = np.array([p.circle for p in pieces])
        #: distances where a grade or a vertical curve begins or ends [m].
        self.breaks: Floats = np.append(self._begin, end)
        for array in (self._begin, self._rows, self._circle, self.breaks):
            freeze(array)

    def at(self, distances: Floats) -> tuple[Floats, Floats]:
        """Return height [m] and gradient [m/m] at distances (k,) [m]; NaN outside the profile."""
        index = np.clip(np.searchsorted(self._begin, distances, side="right") - 1, 0, len(self._begin) - 1)
        z0, g0, bend = self._rows[index].T
        s = distances - self._begin[index]
        height = z0 + g0 * s + bend / 2 * s**2
        gradient = g0 + bend * s
        round_ = self._circle[index]
        if round_.any():
            sin0 = g0[round_] / np.hypot(1.0, g0[round_])
            cos0 = 1 / np.hypot(1.0, g0[round_])
            sin1 = np.clip(sin0 + bend[round_] * s[round_], -1.0, 1.0)
            cos1 = np.sqrt(1 - sin1**2)
            # R (cos0 - cos1) without cancellation: R (cos0^2 - cos1^2)/(cos0 + cos1) = s (sin0 + sin1)/(cos0 + cos1)
            height[round_] = z0[round_] + s[round_] * (sin0 + sin1) / (cos0 + cos1)
            gradient[round_] = sin1 / cos1
        outside = (distances < self.start - END_SLACK_M) | (distances > self.end + END_SLACK_M)
        height[outside] = np.nan
        gradient[outside] = np.nan
        return height, gradient


def build_profile(points: Sequence[VerticalPoint]) -> Profile:
    """Return the profile through at least two points of vertical intersection.

    Raises:
        ProfileError: fewer than two points, distances that do not increase, curves that overlap or leave the profile.
    """
    if len(points) < 2:
        raise ProfileError("a profile needs at least two points of vertical intersection", 0)
    grades = []
    for i, (a, b) in enumerate(itertools.pairwise(points)):
        if not b.distance > a.distance:
            raise ProfileError("stations of a profile must increase", i + 1)
        grades.append((b.height - a.height) / (b.distance - a.distance))
    pieces: list[_Piece] = []
    at, height = points[0].distance, points[0].height
    for i, point in enumerate(points[1:-1], start=1):
        curve = _curve(point, grades[i - 1], grades[i])
        if curve is None:
            begin = end = point.distance
        else:
            begin, end = point.distance - curve.before, point.distance + curve.after
        if begin < at - OVERLAP_SLACK_M:
            raise ProfileError(f"a vertical curve begins {at - begin:.3f} m before the one before it ends", i)
        if begin > at:
            pieces.append(_Piece(at, height, grades[i - 1]))
        begin = max(begin, at)
        if curve is not None:
            pieces.extend(curve.pieces(begin, point, grades[i - 1]))
        at = end
        height = point.height + grades[i] * (end - point.distance)
    last = points[-1].distance
    if at > last + OVERLAP_SLACK_M:
        raise ProfileError(f"a vertical curve ends {at - last:.3f} m after the profile", len(points) - 1)
    if at < last:
        pieces.append(_Piece(at, height, grades[-1]))
    return Profile(pieces, last)


@dataclass(frozen=True, slots=True)
class _Curve:
    """A vertical curve: plan lengths before and after its point, and what it consists of (bend, length)."""

    before: float
    after: float
    parts: tuple[tuple[float, float], ...]
    circle: bool

    def pieces(self, begin: float, point: VerticalPoint, grade: float) -> list[_Piece]:
        out: list[_Piece] = []
        z, g, s = point.height + grade * (begin - point.distance), grade, begin
        for bend, length in self.parts:
            out.append(_Piece(s, z, g, bend, self.circle))
            z, g, s = z + g * length + bend / 2 * length**2, g + bend * length, s + length
        return out


def _curve(point: VerticalPoint, g1: float, g2: float) -> _Curve | None:
    """Return the curve at a point between the grades g1 and g2, or None where nothing is to be rounded."""
    if point.curve is VerticalCurve.NONE or abs(g2 - g1) < 1e-12:
        return None
    if point.curve is VerticalCurve.PARABOLA:
        a, b = point.length_in, point.length_out
        if a <= 0 or b <= 0:
            return None
        middle = (a * g1 + b * g2) / (a + b)
        if math.isclose(a, b):
            return _Curve(a, b, (((g2 - g1) / (a + b), a + b),), False)
        return _Curve(a, b, (((middle - g1) / a, a), ((g2 - middle) / b, b)), False)
    angle1, angle2 = math.atan(g1), math.atan(g2)
    turn = angle2 - angle1
    radius = point.radius if point.radius else (point.length_in + point.length_out) / abs(turn)
    if radius <= 0:
        return None
    tangent = radius * math.tan(abs(turn) / 2)
    before, after = tangent * math.cos(angle1), tangent * math.cos(angle2)
    return _Curve(before, after, ((math.copysign(1 / radius, turn), before + after),), True)
