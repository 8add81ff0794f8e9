"""Closed-form inverse of a swing, three parallel joints, tilt and rotate: all six joints from the tool's pose.

With E_j the turn about joint j's line at q = 0, the pose wanted is `G = T T0^-1 = E1 E2 E3 E4 E5 E6`. The three turns
about the arm's normal h change neither a height along h nor an angle to h: two equations hold swing and tilt alone.

    h . E1^-1 G c = h . E5 c           c a point on the rotate axis
    h . R1' G z   = h . R5 z           z along the rotate axis

Where tilt and rotate axes cross, c is the crossing and the first has no tilt in it: two swings, two tilts each. Else
they are the four crossings of a circle and an ellipse (a quartic). Turning back gives the arm's whole pitch and the
rotator, and what is left is a planar arm of two links (Makkonen: solved in closed form; the tiltrotator's equations
as the three-parallel-axes case of Pieper).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workgauge.motion.ik.branches import Candidates
from workgauge.motion.ik.circles import crossings
from workgauge.motion.ik.planar import LOOSE, NOTHING, Plane, beyond_ring, kept, two_links
from workgauge.motion.ik.screws import Line, common_normal
from workgauge.values.arrays import Floats, frozen
from workgauge.values.transforms import inverse

#: Tilt and rotate axes nearer than this cross [m].
CROSSING = 1e-6
SWING, BOOM, TILT, ROTATE = 0, 1, 4, 5


@dataclass(frozen=True, slots=True, eq=False)
class Tiltrotator:
    """The six-joint chain, limits aside.

    Attributes:
        tilt, rotate: lines through the feet of their common normal.
        plane: swing and boom, stick, bucket. T_zero_inverse: (4, 4) of the tool's pose at q = 0.
        offset: (3,) from the tilt axis to the rotate axis, square to both [m]; 0 where they cross.
        square: (3,) a direction square to the rotate axis.
        missed: by how much the chain misses this structure [rad, m].
        q_min, q_max: (6,).
    """

    plane: Plane
    tilt: Line
    rotate: Line
    offset: Floats
    square: Floats
    T_zero_inverse: Floats
    missed: float
    q_min: Floats
    q_max: Floats

    def solve(self, T: Floats) -> Candidates:
        """Return the up to 8 (16 slots where the axes do not cross) postures for poses T (N, 4, 4), limits aside."""
        G = T @ self.T_zero_inverse
        q1, q5, swing_free = self._pairs(G)
        return self._arm(G, q1, q5, np.broadcast_to(swing_free[:, None], q1.shape))

    def family(self, T: Floats, free: int, values: Floats) -> Floats:
        """Return the postures (K, B, 6) for a pose T (4, 4) with the free joint held.

        Args:
            T: the pose. free: `SWING`, `BOOM`, or `ROTATE`: the arm's whole pitch is held, and the rotator follows.
            values: (K,) the angle held [rad].
        """
        G = np.broadcast_to(T @ self.T_zero_inverse, (len(values), 4, 4))
        _, axes = self._wrist(G)
        held = values[:, None]
        if free == SWING:
            q1, q5 = np.repeat(held, 2, axis=-1), self._tilts(axes, values)
            aside = np.abs(self._reached(G, q1, q5)[1]) < NOTHING
            return self._arm(G, np.where(aside, q1, np.nan), q5).q
        q1, q5, _ = self._pairs(G)
        u, _, _, _, one = self._reached(G, q1, q5)
        if free == BOOM:
            folded = np.where(np.abs(u) < NOTHING, q1, np.nan)
            return self._arm(G, folded, q5, boom=held * self.plane.signs[0]).q
        return self._arm(G, np.where(one, q1, np.nan), q5, pitch=held).q

    def gap(self, T: Floats, q1: Floats) -> Floats:
        """Return how far (K, 2) the pose T (4, 4) is from what is reached with swings q1 (K,), orientation kept [m].

        Negative where the goal is too close. One column for each tilt; NaN where the tilt is beyond its limits.
        """
        G = np.broadcast_to(T @ self.T_zero_inverse, (len(q1), 4, 4))
        _, axes = self._wrist(G)
        q5 = self._tilts(axes, q1)
        u, aside = self._reached(G, np.repeat(q1[:, None], 2, -1), q5)[:2]
        a, b = self.plane.links
        limits = sorted(self.plane.signs[1] * np.array([self.q_min[2], self.q_max[2]]))
        ring = beyond_ring(u, a, b, *limits)
        gap = np.copysign(np.hypot(ring, aside), np.where(ring == 0.0, 1.0, ring))
        turns = 2 * np.pi
        low = self.q_min[TILT] if np.isfinite(self.q_min[TILT]) else -np.inf
        tilted = q5 if low == -np.inf else low - 1e-9 + np.remainder(q5 - low + 1e-9, turns)
        return np.where(tilted <= self.q_max[TILT] + 1e-9, gap, np.nan)

    def _pairs(self, G: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Return the swings and tilts (N, P) that solve the two equations, and where any swing does (N,)."""
        goals, axes = self._wrist(G)
        if self.offset.any():
            q1, q5 = crossings(*self._position_row(goals), *self._axis_row(axes))
            return q1, q5, np.isnan(q1).all(-1) & (np.hypot(*self._position_row(goals)[0].T) < NOTHING)
        swings, swing_free = self.plane.swings(goals, float(self.plane.normal.direction @ self.tilt.point))
        q1 = np.repeat(swings, 2, axis=-1)
        return q1, self._tilts(axes[:, None], swings).reshape(q1.shape), swing_free

    def _wrist(self, G: Floats) -> tuple[Floats, Floats]:
        """Return where the rotate axis is to be: a point on it (N, 3) and its direction (N, 3)."""
        return G[:, :3, :3] @ self.rotate.point + G[:, :3, 3], G[:, :3, :3] @ self.rotate.direction

    def _position_row(self, goals: Floats) -> tuple[Floats, Floats, Floats]:
        """Return A (N, 2), B (2,), e (N,): `A . (cos, sin)(swing) = B . (cos, sin)(tilt) + e`, heights along h."""
        h, swing = self.plane.normal.direction, self.plane.swing
        c0, c, s = swing.level(h, goals - swing.point)
        b0, bc, bs = self.tilt.level(h, self.offset)
        e = h @ (self.tilt.point - swing.point) + b0 - c0
        return np.stack([c, -s], axis=-1), np.array([bc, bs]), e

    def _axis_row(self, axes: Floats) -> tuple[Floats, Floats, Floats]:
        """Return C (N, 2), D (2,), f (N,): the same for the angle of the rotate axis to h."""
        h = self.plane.normal.direction
        c0, c, s = self.plane.swing.level(h, axes)
        d0, dc, ds = self.tilt.level(h, self.rotate.direction)
        return np.stack([c, -s], axis=-1), np.array([dc, ds]), d0 - c0

    def _tilts(self, axes: Floats, swings: Floats) -> Floats:
        """Return both tilts (..., 2) that give the rotate axis (..., 3) its angle to the arm at swings (...).

        The root is that of a Gram determinant, written so that it stays exact where both tilts meet.
        """
        h, tilt = self.plane.normal.direction, self.tilt
        back = self.plane.swing.turn(-swings, axes)
        to_tilt, between = float(h @ tilt.direction), float(tilt.direction @ self.rotate.direction)
        leans = back @ h
        sines2 = (self.plane.normal.across(back) ** 2).sum(-1)
        square = kept((1.0 - to_tilt**2) * sines2 - (between - to_tilt * leans) ** 2, 1.0)
        _, dc, ds = tilt.level(h, self.rotate.direction)
        off = np.arctan2(np.sqrt(square), leans - to_tilt * between)
        tilts: Floats = np.arctan2(ds, dc) + np.stack([off, -off], axis=-1)
        return tilts

    def _reached(self, G: Floats, q1: Floats, q5: Floats, pitch: Floats | None = None) -> tuple[Floats, ...]:
        """Return, for swings and tilts (N, P), what boom and stick must span, and the rotator.

        Returns: u (N, P) complex in the plane [m], the miss along the normal (N, P) [m], the arm's whole pitch,
            the rotator (N, P) [rad], and where pitch and rotator are one turn (N, P).
        """
        plane, normal = self.plane, self.plane.normal
        carried = np.array([self.rotate.point, self.rotate.direction, self.square]) @ G[:, :3, :3].swapaxes(-1, -2)
        carried[:, 0] += G[:, :3, 3] - plane.swing.point
        turned = plane.swing.turn(-q1[..., None], carried[:, None])
        to_wrist = turned[..., 0, :] + (plane.swing.point - plane.points[0])
        axis = self.tilt.turn(q5, self.rotate.direction)
        one = (normal.across(axis) ** 2).sum(-1) < NOTHING**2
        if pitch is None:
            pitch = normal.angle(axis, turned[..., 1, :])
        from_bucket = self.tilt.point - plane.points[2]
        if self.offset.any():
            from_bucket = from_bucket + self.tilt.turn(q5, self.offset)
        u = plane.flat(to_wrist) - np.exp(1j * pitch) * plane.flat(from_bucket)
        aside = to_wrist @ normal.direction - (from_bucket + plane.points[2] - plane.points[0]) @ normal.direction
        back = self.tilt.turn(-q5, normal.turn(-pitch + 0.0 * q5, turned[..., 2, :]))
        rotate = np.arctan2(back @ self.rotate.across(self.square), back @ self.square)
        return u, aside, pitch, rotate, one

    def _arm(
        self,
        G: Floats,
        q1: Floats,
        q5: Floats,
        swing_free: NDArray[np.bool_] | None = None,
        *,
        pitch: Floats | None = None,
        boom: Floats | None = None,
    ) -> Candidates:
        """Return the postures (N, 2 P) for swings and tilts (N, P), the elbow both ways."""
        plane = self.plane
        u, _, pitch, rotate, one = self._reached(G, q1, q5, pitch)
        first, second = two_links(u, plane.links[:1], plane.links[1:])
        if boom is not None:
            first = boom[..., None]
        q = np.empty((*second.shape, 6))
        for j, angle in ((SWING, q1), (TILT, q5), (ROTATE, rotate)):
            q[..., j] = angle[..., None]
        s1, s2, s3 = plane.signs
        q[..., 1], q[..., 2], q[..., 3] = s1 * first, s2 * second, s3 * (pitch[..., None] - first - second)
        free = np.where(one, ROTATE, np.where(np.abs(u) < NOTHING, BOOM, -1))
        if swing_free is not None:
            free = np.where(swing_free, SWING, free)
        return Candidates(q.reshape(len(G), -1, 6), np.repeat(free, 2, axis=-1))


def tiltrotator(lines: tuple[Line, ...], T_zero: Floats, q_min: Floats, q_max: Floats) -> Tiltrotator | None:
    """Return the structure of six joints' lines at q = 0, or None: see `closed_form` for what is asked."""
    if len(lines) != 6:
        return None
    plane = Plane.of(lines[0], lines[1:4])
    if plane is None:
        return None
    tilt, rotate = lines[4], lines[5]
    apart = min(np.linalg.norm(plane.normal.across(tilt.direction)), np.linalg.norm(tilt.across(rotate.direction)))
    if apart < LOOSE:
        return None
    on_tilt, on_rotate = common_normal(tilt, rotate)
    offset, missed = on_rotate - on_tilt, plane.skewness
    if np.linalg.norm(offset) < CROSSING:
        missed = max(missed, float(np.linalg.norm(offset)))
        on_tilt, offset = on_rotate, np.zeros(3)
    square = np.cross(rotate.direction, np.eye(3)[np.abs(rotate.direction).argmin()])
    return Tiltrotator(
        plane=plane,
        tilt=Line(tilt.direction, frozen(on_tilt)),
        rotate=Line(rotate.direction, frozen(on_rotate)),
        offset=frozen(offset),
        square=frozen(square / np.linalg.norm(square)),
        T_zero_inverse=frozen(inverse(T_zero)),
        missed=missed,
        q_min=q_min,
        q_max=q_max,
    )
