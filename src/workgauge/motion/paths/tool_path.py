"""A path for the tool by distance: a polyline with rounded corners, or a smooth curve through given points."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from workgauge.motion.paths.arc_length import PiecewiseCurve, elevated
from workgauge.motion.paths.orientations import (
    DEGREE,
    BlendedTurning,
    SplineTurning,
    Turning,
    Unturned,
    angles,
    rotation_vectors,
    rotations,
)
from workgauge.values.arrays import Floats, Ints, frozen
from workgauge.values.errors import InputError
from workgauge.values.tasks import Orientation

#: Points closer together than this are the same [m].
SAME_POINT_M = 1e-6
#: A polyline turning by more than this is not rounded: the tool stops there [rad].
LARGEST_ROUNDED_TURN = np.radians(170.0)
#: A rotation of more than this between two points has no shorter way round [rad].
_LARGEST_TURN = np.radians(179.9)
_STRAIGHT = 1e-6
#: Control points of a rounded corner, in shares of how far from the corner it begins.
_CORNER = np.array([1.0, 2.0 / 3.0, 1.0 / 3.0])
#: How near the corner its curve passes, in shares of the same, per length of the difference of the directions.
_CORNER_PASS = float(_CORNER @ [1.0, 5.0, 10.0]) / 32.0
_CUSP = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class ToolPath:
    """A path of the tool frame in the site's local frame, by distance. Made by `polyline` or `spline`.

    Attributes:
        points: (k, 3) as given [m]. orientations: (k, 3, 3) site from tool as given, or None.
        orientation: how much of the orientation counts.
        kind: `polyline` or `spline`.
        point_distances_m: (k,) the distance at which the path is nearest to each given point.
        deviations_m, deviations_rad: (k,) how far it passes from it and from its orientation there.
        stops_m: (c,) distances of sharp corners, where the tool must stand still to turn.
        breaks_m: distances at which its pieces begin and end.
    """

    points: Floats
    orientations: Floats | None
    orientation: Orientation
    kind: str
    point_distances_m: Floats
    deviations_m: Floats
    deviations_rad: Floats
    stops_m: Floats
    breaks_m: Floats
    _curve: PiecewiseCurve
    _turning: Turning

    @classmethod
    def polyline(
        cls,
        points: ArrayLike,
        orientations: ArrayLike | None = None,
        *,
        orientation: Orientation | None = None,
        blend_m: float = 0.0,
    ) -> "ToolPath":
        """Return straight lines between points, the orientation by slerp, corners rounded.

        A corner begins and ends at the same distance from its point, at most half a leg, and is a curve of degree 5
        that joins the lines without a step in direction, curvature or rate of turning. Not rounded, and so a stop,
        are all corners with `blend_m` 0 and those that turn back by more than `LARGEST_ROUNDED_TURN`. A change of
        the rate of turning alone is a corner as well.

        Args:
            points: (k, 3) site frame [m], k >= 2.
            orientations: (k, 3, 3) site from tool, or (3, 3) for all points, or None where they do not count.
            orientation: how much of them counts; all of it by default where they are given, else none.
            blend_m: how far a rounded corner may pass from its point [m].

        Raises:
            InputError: for one point, repeated points, what is not finite, no rotation, half a turn between points.
        """
        P, R, counts = _checked(points, orientations, orientation)
        if not (np.isfinite(blend_m) and blend_m >= 0.0):
            raise InputError("a corner cannot be rounded so", element="blend_m", value=blend_m, allowed="0 or more")
        legs = _Legs.of(P, R)
        sharp, reach = legs.corners(blend_m)
        controls, control_rotations, corner_piece = legs.pieces(reach)
        curve = PiecewiseCurve.of(controls)
        turning: Turning = Unturned() if R is None else BlendedTurning.through(control_rotations)
        distances = np.zeros(len(P))
        for i in range(1, len(P)):
            piece = int(corner_piece[i])
            distances[i] = curve.middles[piece] if reach[i] > 0.0 else curve.starts[piece]
        stops = distances[1:-1][sharp[1:-1]]
        return _path(P, R, counts, "polyline", distances, stops, curve, turning)

    @classmethod
    def spline(
        cls,
        points: ArrayLike,
        orientations: ArrayLike | None = None,
        *,
        orientation: Orientation | None = None,
    ) -> "ToolPath":
        """Return a smooth curve through all points: a natural cubic spline, centripetal, by distance.

        Direction and curvature are continuous, and so are the rate of turning and its derivative. Arguments and
        errors as for `polyline`.

        Raises:
            InputError: also where the curve turns back on itself, which no constant speed could follow.
        """
        P, R, counts = _checked(points, orientations, orientation)
        u = np.concatenate([[0.0], np.cumsum(np.sqrt(np.linalg.norm(np.diff(P, axis=0), axis=1)))])
        velocity = CubicSpline(u, P, bc_type="natural")(u, 1)
        third = (np.diff(u) / 3.0)[:, None]
        cubic = np.stack([P[:-1], P[:-1] + third * velocity[:-1], P[1:] - third * velocity[1:], P[1:]], axis=1)
        curve = PiecewiseCurve.of(elevated(cubic))
        slow = curve.slowest() / np.diff(curve.starts)
        if slow.min() < _CUSP:
            raise InputError(
                "the path turns back on itself here: no smooth curve goes through these points",
                element=f"point {int(slow.argmin()) + 1} of {len(P)}",
                allowed="a polyline, or a point beside the turn",
            )
        turning: Turning = Unturned() if R is None else SplineTurning.through(curve.starts, R)
        return _path(P, R, counts, "spline", np.array(curve.starts), np.zeros(0), curve, turning)

    @property
    def length_m(self) -> float:
        """Of the path [m]."""
        return self._curve.length

    def at(self, s: ArrayLike, *, arriving: bool = False) -> tuple[Floats, Floats]:
        """Return tool poses (..., 4, 4) in the site and tangents (..., 6) at distances s (...) [m].

        A tangent is the change of the pose per metre: the direction (a unit vector), then the rate of turning
        [rad/m], both in the site's axes. Distances are true to 1e-6 of the length.

        Args:
            s: 0 to `length_m`; a nanometre beyond counts as the end. Orientations of a path without are identities.
            arriving: at a sharp corner, the tangent before it instead of the one behind it.

        Raises:
            InputError: if a distance is beyond the path, or no number.
        """
        wanted = np.asarray(s, dtype=np.float64)
        flat = self._held(wanted)
        piece, t = self._curve.locate(flat, arriving)
        position, velocity = self._curve.at(piece, t)
        speed = np.linalg.norm(velocity, axis=-1)
        R, omega = self._turning.at(flat, piece, t, 1.0 / speed)
        T = np.zeros((len(flat), 4, 4))
        T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = R, position, 1.0
        tangent = np.concatenate([velocity / speed[:, None], omega], axis=1)
        return T.reshape(*wanted.shape, 4, 4), tangent.reshape(*wanted.shape, 6)

    def curvature(self, s: ArrayLike, *, arriving: bool = False) -> Floats:
        """Return the curvature (...) [1/m] at distances s (...) [m]; at a sharp corner that of the line behind it."""
        wanted = np.asarray(s, dtype=np.float64)
        places = self._curve.locate(self._held(wanted), arriving)
        return self._curve.curvature(*places).reshape(wanted.shape)

    def _held(self, s: Floats) -> Floats:
        """Return distances (N,) on the path, or refuse."""
        flat = s.ravel()
        wrong = flat[~((flat >= -1e-9) & (flat <= self.length_m + 1e-9))]
        if len(wrong):
            allowed = f"0 to {self.length_m:.3f} m"
            raise InputError("not a distance on the path", element="distance", value=float(wrong[0]), allowed=allowed)
        return np.clip(flat, 0.0, self.length_m)


@dataclass(frozen=True, slots=True, eq=False)
class _Legs:
    """The straight lines of a polyline: points, rotations, directions, lengths, turning per metre in tool axes."""

    P: Floats
    R: Floats
    direction: Floats
    length: Floats
    rate: Floats

    @classmethod
    def of(cls, P: Floats, R: Floats | None) -> "_Legs":
        rotated = np.tile(np.eye(3), (len(P), 1, 1)) if R is None else R
        steps = np.diff(P, axis=0)
        length = np.linalg.norm(steps, axis=1)
        rate = rotation_vectors(np.swapaxes(rotated[:-1], -1, -2) @ rotated[1:]) / length[:, None]
        return cls(P, rotated, steps / length[:, None], length, rate)

    def corners(self, blend_m: float) -> tuple[Floats, Floats]:
        """Return which points (k,) are sharp corners, and from how far (k,) the others are rounded [m], 0 for not."""
        k = len(self.P)
        sharp, reach = np.zeros(k, dtype=bool), np.zeros(k)
        for i in range(1, k - 1):
            before, after = self.direction[i - 1], self.direction[i]
            bend = float(np.linalg.norm(after - before))
            change = float(np.linalg.norm(self.rate[i] - self.rate[i - 1]))
            if bend < _STRAIGHT and change < _STRAIGHT:
                continue
            if blend_m > 0.0 and bend < 2.0 * np.sin(LARGEST_ROUNDED_TURN / 2.0):
                most = 0.5 * min(self.length[i - 1], self.length[i])
                reach[i] = min(most, blend_m / (_CORNER_PASS * max(bend, 0.5)))
            else:
                sharp[i] = True
        return sharp, reach

    def pieces(self, reach: Floats) -> tuple[Floats, Floats, Ints]:
        """Return control points (m, 6, 3), control rotations (m, 6, 3, 3), and the piece (k,) of each point.

        That of a rounded corner is its own curve; of a sharp one and of the last point the line behind it.
        """
        even = np.arange(DEGREE + 1) / DEGREE
        places: list[tuple[list[int], Floats]] = []
        of_point = np.zeros(len(self.P), dtype=np.int64)
        for leg, length in enumerate(self.length):
            start, end = float(reach[leg]), float(length - reach[leg + 1])
            if end - start > SAME_POINT_M * 1e-3:
                places.append(([leg] * 6, start + even * (end - start)))
            of_point[leg + 1] = len(places)
            if reach[leg + 1] > 0.0:
                outwards = reach[leg + 1] * _CORNER
                places.append(([leg] * 3 + [leg + 1] * 3, np.concatenate([length - outwards, outwards[::-1]])))
        legs = np.array([which for which, _ in places])
        along = np.array([distance for _, distance in places])[..., None]
        turned = self.R[legs] @ rotations(self.rate[legs] * along)
        return self.P[legs] + self.direction[legs] * along, turned, of_point


def _path(
    P: Floats,
    R: Floats | None,
    counts: Orientation,
    kind: str,
    distances: Floats,
    stops: Floats,
    curve: PiecewiseCurve,
    turning: Turning,
) -> ToolPath:
    """Return the path, with how far it passes from each given point worked out on the path itself."""
    distances[-1] = curve.length
    given = (frozen(P), None if R is None else frozen(R), counts, kind, frozen(distances))
    rest = (frozen(stops), frozen(curve.starts), curve, turning)
    T, _ = ToolPath(*given, np.zeros(0), np.zeros(0), *rest).at(distances)
    off = np.linalg.norm(T[:, :3, 3] - P, axis=1)
    turned = np.zeros(len(P)) if R is None else angles(np.swapaxes(R, -1, -2) @ T[:, :3, :3])
    return ToolPath(*given, frozen(off), frozen(turned), *rest)


def _checked(
    points: ArrayLike, orientations: ArrayLike | None, orientation: Orientation | None
) -> tuple[Floats, Floats | None, Orientation]:
    """Return points (k, 3), rotations (k, 3, 3) or None, and how much of them counts, or refuse."""
    P = _numbers(points, "points")
    if P.ndim != 2 or P.shape[1] != 3 or len(P) < 2:
        raise InputError("not a path", element="points", value=f"shape {P.shape}", allowed="(k, 3) with 2 or more")
    _finite(P, "point")
    steps = np.linalg.norm(np.diff(P, axis=0), axis=1)
    if steps.min() < SAME_POINT_M:
        again = int(steps.argmin()) + 1
        allowed = "points at different places; to turn on the spot, give a goal pose"
        raise InputError("repeats the point before it", element=f"point {again}", value=P[again], allowed=allowed)
    if orientations is None:
        if orientation not in (None, Orientation.FREE):
            raise InputError("counts but is not given", element="orientations", allowed="one rotation per point")
        return P, None, Orientation.FREE
    R = _numbers(orientations, "orientations")
    if R.shape == (3, 3):
        R = np.tile(R, (len(P), 1, 1))
    if R.shape != (len(P), 3, 3):
        shape = f"shape {R.shape}"
        raise InputError("not one per point", element="orientations", value=shape, allowed=f"({len(P)}, 3, 3)")
    _finite(R.reshape(len(P), 9), "orientation")
    off = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(axis=(1, 2)) + (np.linalg.det(R) < 0.0)
    if off.max() > 1e-6:
        worst = int(off.argmax())
        raise InputError("not a rotation", element=f"orientation {worst}", value=R[worst].tolist())
    turns = angles(np.swapaxes(R[:-1], -1, -2) @ R[1:])
    if turns.max() > _LARGEST_TURN:
        worst = int(turns.argmax())
        element = f"orientations {worst} and {worst + 1}"
        raise InputError("half a turn apart: either way round is as short", element=element, allowed="one between")
    return P, R, orientation or Orientation.FULL


def _numbers(values: ArrayLike, element: str) -> Floats:
    try:
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("not numbers in rows of equal length", element=element) from error


def _finite(rows: Floats, element: str) -> None:
    wrong = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if len(wrong):
        which = int(wrong[0])
        raise InputError("not finite", element=f"{element} {which}", value=rows[which].tolist(), allowed="numbers")
