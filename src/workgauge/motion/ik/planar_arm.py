"""Closed-form inverse of a swing and three or four joints in its plane: all joints from position and pitch.

The pitch is the sum of the joints in the plane: the angle of the tool's z axis (x where z lies across the plane) in
the plane that the goal's own orientation belongs to, turned back about the swing. Where that plane is not the one the
goal's position lies in, position and pitch are met and the rest is not. The last of three joints is the wrist of a
two-link arm; of four, one is held at a given angle, which turns two neighbouring links into one.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from workgauge.motion.ik.branches import Candidates
from workgauge.motion.ik.planar import NOTHING, Plane, beyond_ring, two_links
from workgauge.motion.ik.screws import Line
from workgauge.values.arrays import Floats, frozen

SWING, BOOM = 0, 1
_ACROSS = 0.95  # a tool axis that has more of its length across the plane is not measured in it


@dataclass(frozen=True, slots=True, eq=False)
class PlanarArm:
    """The chain, limits aside.

    Attributes:
        plane: swing and the joints of the arm.
        tip, axis: (3,) tool position and the tool axis the pitch is taken from, at q = 0.
        column: which of the tool's axes that is. across: (3,) the plane's normal in the tool frame.
        redundant: index of the joint that is held, or None if there is none too many.
        held: its angle [rad], () or (N,), one per pose.
        missed: by how much the chain misses this structure [rad].
        q_min, q_max: (n,).
    """

    plane: Plane
    tip: Floats
    axis: Floats
    column: int
    across: Floats
    redundant: int | None
    held: Floats
    missed: float
    q_min: Floats
    q_max: Floats

    def holding(self, held: Floats) -> Self:
        """Return the arm with its redundant joint at `held` [rad], () or (N,)."""
        return replace(self, held=held)

    def solve(self, T: Floats) -> Candidates:
        """Return the up to 4 postures for poses T (N, 4, 4), joint limits aside."""
        swings, any_does = self.plane.swings(T[:, :3, 3], float(self.plane.normal.direction @ self.tip))
        found = self._arm(T, swings)
        return Candidates(found.q, np.where(any_does[:, None], SWING, found.free))

    def family(self, T: Floats, free: int, values: Floats) -> Floats:
        """Return the postures (K, B, n) for a pose T (4, 4) with `SWING` or `BOOM` held at values (K,) [rad]."""
        poses = np.broadcast_to(T, (len(values), 4, 4))
        if free == SWING:
            return self._arm(poses, values[:, None]).q
        swings, _ = self.plane.swings(poses[:, :3, 3], float(self.plane.normal.direction @ self.tip))
        folded = np.abs(self._reached(poses, swings)[0]) < NOTHING
        return self._arm(poses, np.where(folded, swings, np.nan), values[:, None]).q

    def gap(self, T: Floats, q1: Floats) -> Floats:
        """Return how far (K, 1) the pose T (4, 4) is from what is reached with swings q1 (K,), pitch kept [m].

        Negative where the goal is too close.
        """
        u, a, b, aside, _, _ = self._reached(np.broadcast_to(T, (len(q1), 4, 4)), q1[:, None])
        elbow = self._elbow
        limits = sorted(self.plane.signs[elbow - 1] * np.array([self.q_min[elbow], self.q_max[elbow]]))
        ring = beyond_ring(u, a, b, *limits)
        return np.copysign(np.hypot(ring, aside), np.where(ring == 0.0, 1.0, ring))

    def pitch(self, T: Floats) -> Floats:
        """Return the pitch (N,) of poses T (N, 4, 4) [rad], NaN where it has none: see the module."""
        plane = self.plane
        R = T[:, :3, :3]
        across = R @ self.across
        turned = plane.swing.angle(np.broadcast_to(plane.normal.direction, across.shape), across)
        wanted = plane.swing.turn(-turned, R[:, :, self.column])
        pitch = plane.normal.angle(self.axis, wanted)
        level = np.linalg.norm(plane.swing.across(across), axis=-1) < NOTHING
        sideways = np.linalg.norm(plane.normal.across(wanted), axis=-1) < NOTHING
        return np.where(level | sideways, np.nan, pitch)

    @property
    def _elbow(self) -> int:
        """Index of the joint between the two links that are left."""
        return 3 if self.redundant in (1, 2) else 2

    def _reached(self, T: Floats, q1: Floats) -> tuple[Floats, ...]:
        """Return, for swings (N, P), what two links must span, these links, and the miss along the normal.

        Returns: u, a, b (N, P) in the plane [m], the miss (N, P) [m], the arm's whole pitch (N, P) [rad], NaN where
            the goal has none, and the held joint's turn about the normal (N, P).
        """
        plane, swing = self.plane, self.plane.swing
        goals = swing.turn(-q1, (T[:, :3, 3] - swing.point)[:, None]) + swing.point
        pitch = self.pitch(T)[:, None] + 0.0 * q1
        u = plane.flat(goals - plane.points[0]) - np.exp(1j * pitch) * plane.flat(self.tip - plane.points[-1])
        aside = (goals - self.tip) @ plane.normal.direction
        links = [np.broadcast_to(link, u.shape) for link in plane.links]
        turn = np.zeros(u.shape)
        if self.redundant is not None:
            turn = plane.signs[self.redundant - 1] * self.held.reshape(-1, 1) + turn
            links, u = self._merged(links, u, turn, pitch)
        return u, links[0], links[1], aside, pitch, turn

    def _merged(self, links: list[Floats], u: Floats, turn: Floats, pitch: Floats) -> tuple[list[Floats], Floats]:
        """Return the two links left of three when one joint's turn is known, and what they must span."""
        first, second, third = links
        step = np.exp(1j * turn)
        if self.redundant == 1:
            return [second * step, third * step], u - step * first
        if self.redundant == 2:
            return [first + step * second, step * third], u
        if self.redundant == 3:
            return [first, second + step * third], u
        return [first, second], u - np.exp(1j * (pitch - turn)) * third

    def _arm(self, T: Floats, q1: Floats, boom: Floats | None = None) -> Candidates:
        """Return the postures (N, 2 P) for swings (N, P), the elbow both ways."""
        plane, redundant = self.plane, self.redundant
        u, a, b, _, pitch, turn = self._reached(T, q1)
        first, second = two_links(u, a, b)
        free_joint = 2 if redundant == BOOM else BOOM
        if boom is not None:
            first = np.broadcast_to((plane.signs[free_joint - 1] * boom)[..., None], first.shape)
        turns = [first, second, pitch[..., None] - first - second - turn[..., None]]
        if redundant is not None:
            turns.insert(redundant - 1, np.broadcast_to(turn[..., None], first.shape))
        swing = np.broadcast_to((q1 + 0.0 * u.real)[..., None], first.shape)
        arm = [sign * turned for sign, turned in zip(plane.signs, turns, strict=True)]
        q = np.stack([swing, *arm], axis=-1)
        q = np.where(np.isfinite(q).all(-1, keepdims=True), q, np.nan)
        free = np.where(np.abs(u) < NOTHING, free_joint, -1)
        return Candidates(q.reshape(len(T), -1, q.shape[-1]), np.repeat(free, 2, axis=-1))


def planar_arm(
    lines: tuple[Line, ...],
    T_zero: Floats,
    q_min: Floats,
    q_max: Floats,
    exclusive_groups: tuple[tuple[int, ...], ...],
    home: Floats,
) -> PlanarArm | None:
    """Return the structure of four or five joints' lines at q = 0, or None: see `closed_form` for what is asked.

    Of four joints in the plane the one is held that cannot move together with any other, or else the first.
    """
    n = len(lines)
    plane = Plane.of(lines[0], lines[1:]) if n in (4, 5) else None
    if plane is None:
        return None
    alone = [group[0] for group in exclusive_groups if len(group) == 1 and group[0] > 0]
    redundant = None if n == 4 else (alone or [1])[0]
    across = plane.normal.direction @ T_zero[:3, :3]
    column = 2 if abs(across[2]) < _ACROSS else 0
    return PlanarArm(
        plane=plane,
        tip=frozen(T_zero[:3, 3]),
        axis=frozen(T_zero[:3, column]),
        column=column,
        across=frozen(across),
        redundant=redundant,
        held=frozen(0.0 if redundant is None else home[redundant]),
        missed=plane.skewness,
        q_min=q_min,
        q_max=q_max,
    )
