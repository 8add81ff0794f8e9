"""What swings a vertical plane about, and the arm that moves in it: two links by angles, and recognising both."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from workgauge.motion.ik.screws import Line
from workgauge.values.arrays import Floats, frozen

#: Joints as far from parallel, or lengths as short, as this are taken to be parallel or nothing [rad, m].
LOOSE = 1e-3
#: Below this a length, a sine or a cosine is nothing: the angle that depends on it is free.
NOTHING = 1e-11
#: Share by which a square may be negative and still be a rounded zero.
ROUNDING = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A swing and the joints of an arm in the plane it turns about, at q = 0.

    Attributes:
        swing: line of the first joint.
        normal: the direction (3,) all joints of the arm turn about, as a line through the first of them.
        signs: (m,) 1 where a joint turns about `normal`, -1 where about its opposite.
        points: (m, 3) on the joints.
        links: (m - 1,) complex, from joint to joint in the plane.
        e1, e2: (3,) axes of the plane; `e1 x e2 = normal`.
        skewness: by how much the joints miss being parallel [rad].
    """

    swing: Line
    normal: Line
    signs: Floats
    points: Floats
    links: Floats
    e1: Floats
    e2: Floats
    skewness: float

    @classmethod
    def of(cls, swing: Line, arm: tuple[Line, ...]) -> Self | None:
        """Return the plane of an arm whose joints are parallel, apart, and not parallel to the swing; else None."""
        first = arm[0].direction
        signs = np.array([np.sign(line.direction @ first) for line in arm])
        mean = (signs[:, None] * np.array([line.direction for line in arm])).sum(0)
        normal = Line(frozen(mean / np.linalg.norm(mean)), arm[0].point)
        skewness = max(float(np.linalg.norm(normal.across(line.direction))) for line in arm)
        if skewness > LOOSE or np.linalg.norm(normal.across(swing.direction)) < LOOSE:
            return None
        e1 = normal.across(swing.direction)
        e1 /= -np.linalg.norm(e1)
        e2 = normal.across(e1)
        points = np.array([line.point for line in arm])
        links = (points[1:] - points[:-1]) @ (e1 + 1j * e2)
        if np.abs(links).min() < LOOSE:
            return None
        return cls(swing, normal, frozen(signs), frozen(points), links, frozen(e1), frozen(e2), skewness)

    def flat(self, v: Floats) -> Floats:
        """Return vectors (..., 3) in the plane as complex numbers (...)."""
        return v @ self.e1 + 1j * (v @ self.e2)

    def swings(self, goals: Floats, side: float) -> tuple[Floats, NDArray[np.bool_]]:
        """Return the swings (N, 2) that bring goals (N, 3) to where the plane has them, and where any does, (N,).

        Args:
            goals: points in the machine frame [m].
            side: how far along the normal the arm carries such a point [m].
        """
        c0, c, s = self.swing.level(self.normal.direction, goals - self.swing.point)
        e = side - self.swing.point @ self.normal.direction - c0
        r2 = c * c + s * s
        root = np.sqrt(kept(r2 - e * e, r2))
        middle = np.arctan2(-s, c)
        off = np.arctan2(root, e)
        any_does = (r2 < NOTHING**2) & (np.abs(e) < NOTHING)
        return np.stack([middle + off, middle - off], axis=-1), any_does


def kept(square: Floats, scale: Floats | float) -> Floats:
    """Return a square, 0 where rounding made it negative and NaN where it truly is."""
    return np.where(square >= 0.0, square, np.where(square >= -ROUNDING * scale, 0.0, np.nan))


def two_links(u: Floats, a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """Return the angles (..., 2) of both joints of a planar arm: `u = e^(i first) (a + e^(i second) b)`.

    By the law of cosines; the elbow one way, then the other. NaN where u is out of reach. Complex u, a, b (...).
    """
    length_a, length_b, r2 = np.abs(a), np.abs(b), np.abs(u) ** 2
    longest, shortest = (length_a + length_b) ** 2, (length_a - length_b) ** 2
    square = kept((longest - r2) * (r2 - shortest), longest * longest)
    bend = np.arctan2(np.sqrt(square), r2 - length_a * length_a - length_b * length_b)
    second = np.stack([bend, -bend], axis=-1) - np.angle(b * np.conj(a))[..., None]
    first = np.angle(u[..., None] * np.conj(a[..., None] + np.exp(1j * second) * b[..., None]))
    return first, second


def beyond_ring(u: Floats, a: Floats, b: Floats, lower: float, upper: float) -> Floats:
    """Return how far u (...) is from what two links reach while the second joint stays within its limits [m].

    Positive outside, negative where u is too close, 0 within. The first joint is free.
    """
    fold = np.angle(b * np.conj(a))
    cosines = [np.cos(lower + fold), np.cos(upper + fold)]
    most, least = np.maximum(*cosines), np.minimum(*cosines)
    for turn, extreme in ((0.0, 1.0), (np.pi, -1.0)):
        passes = np.ceil((lower + fold - turn) / (2 * np.pi)) * 2 * np.pi + turn <= upper + fold
        most, least = (
            np.where(passes, np.maximum(most, extreme), most),
            np.where(passes, np.minimum(least, extreme), least),
        )
    squares, product = np.abs(a) ** 2 + np.abs(b) ** 2, 2.0 * np.abs(a) * np.abs(b)
    outer, inner = np.sqrt(squares + product * most), np.sqrt(np.maximum(squares + product * least, 0.0))
    r = np.abs(u)
    return np.where(r > outer, r - outer, np.where(r < inner, r - inner, 0.0))
