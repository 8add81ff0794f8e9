"""A track as a machine stands on it: the pose of its rails along an alignment, and the place nearest to a point."""

import math
from functools import lru_cache

import numpy as np

from workgauge.gauge.heights import SiteHeights
from workgauge.gauge.match import rule_for
from workgauge.gauge.rules import RuleBook, TrackBlock
from workgauge.gauge.sections import CantRotation
from workgauge.gauge.trackline import FilledLine, filled_line
from workgauge.gauge.tracks import cant_rotation
from workgauge.site.alignment import Alignment
from workgauge.site.model import SiteModel
from workgauge.values.arrays import Floats

#: How cant turns a track that the rule book says nothing of: about its middle, rails 1.5 m apart.
PLAIN_ROTATION = CantRotation(1.5, "centre")
#: Knots of the quick curve stand this far apart [m], so many in one block.
_KNOT_M, _BLOCK = 1.0, 64
_NEWTON_STEPS = 12


class RailTrack:
    """The rails of an alignment: along its tangent, tilted by gradient and cant; immutable but for a cache of knots.

    Attributes:
        alignment: its axis. rotation: how cant turns it.

    Args:
        alignment: with a profile, or `filled` says how high the rails are.
        height_m: of the machine frame's origin above top of rail.
    """

    def __init__(
        self,
        alignment: Alignment,
        rotation: CantRotation = PLAIN_ROTATION,
        *,
        height_m: float = 0.0,
        filled: FilledLine | None = None,
    ) -> None:
        self.alignment = alignment
        self.rotation = rotation
        self.height_m = height_m
        self._filled = filled
        self._blocks = lru_cache(maxsize=64)(self._block)

    @classmethod
    def of(cls, site: SiteModel, rules: RuleBook, alignment: Alignment, height_m: float = 0.0) -> "RailTrack":
        """Return a site's track, turned by cant and raised where it has no heights as the rule book's limits are."""
        rotation = PLAIN_ROTATION
        rule = rule_for(rules, alignment)
        for block in () if rule is None else rule.limits:
            if isinstance(block, TrackBlock):
                rotation = cant_rotation(block.cant, alignment) or PLAIN_ROTATION
                break
        filled = None
        if np.isnan(alignment.at(alignment.breaks).z).any():
            above = float(rules.rail_above_surface_m)
            filled = filled_line(alignment, SiteHeights(site, rules), np.zeros(3), above)
        return cls(alignment, rotation, height_m=height_m, filled=filled)

    @property
    def profiled(self) -> bool:
        """Whether its heights are the alignment's own everywhere."""
        return self._filled is None

    @property
    def length(self) -> float:
        """Length of the alignment [m]."""
        return self.alignment.length

    def poses(self, distances: Floats, forward: bool = True) -> tuple[Floats, Floats, Floats]:
        """Return (T_absolute_machine (k, 4, 4), of a machine facing that way, curvature (k,) [1/m], cant (k,) [m]).

        Heights are NaN where nothing says how high the rails are.

        Raises:
            SiteError: a distance beyond the alignment.
        """
        state = self.alignment.at(distances)
        z, gradient = state.z, state.gradient
        if self._filled is not None:
            z, gradient = self._heights(state.distance, z, gradient)
        sine, cosine = np.sin(state.heading), np.cos(state.heading)
        flat = np.zeros_like(sine)
        slope = 1.0 / np.sqrt(1.0 + gradient * gradient)
        direction = np.stack([sine, cosine, gradient]) * slope
        level = np.stack([-cosine, sine, flat])
        up = np.stack([-gradient * sine, -gradient * cosine, flat + 1.0]) * slope  # direction x level
        # The middle of the track and a point 1 m to its left, as the track's cant turns them.
        points = np.broadcast_to(np.array([0.0, 1.0]), (len(sine), 2))
        ys, zs = self.rotation.turn(points, np.zeros((len(sine), 2)), state.cant)
        aside, raised = ys[:, 1] - ys[:, 0], zs[:, 1] - zs[:, 0]
        above = up * aside - level * raised  # direction x left
        way = 1.0 if forward else -1.0
        T = np.zeros((len(sine), 4, 4))
        T[:, :3, 0] = way * direction.T
        T[:, :3, 1] = way * (level * aside + up * raised).T
        T[:, :3, 2] = above.T
        place = np.stack([state.e, state.n, z]) + level * ys[:, 0] + up * zs[:, 0]
        T[:, :3, 3] = (place + self.height_m * above).T
        T[:, 3, 3] = 1.0
        return T, state.curvature, state.cant

    def _heights(self, distance: Floats, z: Floats, gradient: Floats) -> tuple[Floats, Floats]:
        """Return heights and gradients with what the alignment lacks filled in, NaN where nothing is known."""
        assert self._filled is not None
        line = self._filled.line.at(distance)
        missing = np.isnan(z)
        for first, last in self._filled.unknown:
            missing &= (distance < first) | (distance > last)
        return np.where(missing, line.points[:, 2], z), np.where(missing, line.gradient, gradient)

    def nearest(self, e: float, n: float, hint: float = math.nan) -> float:
        """Return the distance along the track nearest to an absolute place [m].

        Args:
            hint: a distance near by; without one the whole alignment is searched.
        """
        if not math.isfinite(hint):
            return float(self.alignment.project([[e, n]])[0][0])
        s = min(max(hint, 0.0), self.length)
        for _ in range(_NEWTON_STEPS):
            x, y, dx, dy = self._curve(s)
            step = ((e - x) * dx + (n - y) * dy) / (dx * dx + dy * dy)
            moved = min(max(s + step, 0.0), self.length)
            if abs(moved - s) < 1e-7:
                return moved
            s = moved
        return float(self.alignment.project([[e, n]])[0][0])

    def yaw(self, distance: float) -> float:
        """Return the direction of growing distances, counter-clockwise from grid east [rad]."""
        _, _, dx, dy = self._curve(min(max(distance, 0.0), self.length))
        return math.atan2(dy, dx)

    def _curve(self, s: float) -> tuple[float, float, float, float]:
        """Return east, north and their slopes at a distance, between exact knots by Hermite's cubic."""
        index = int(s / _KNOT_M)
        rows = self._blocks(index // _BLOCK)
        i = index % _BLOCK
        (s0, x0, y0, dx0, dy0), (s1, x1, y1, dx1, dy1) = rows[i], rows[i + 1]
        h = s1 - s0
        if h <= 0.0:
            return x0, y0, dx0, dy0
        u = (s - s0) / h
        a, b = (1.0 + 2.0 * u) * (1.0 - u) ** 2, u * (1.0 - u) ** 2 * h
        c, d = u * u * (3.0 - 2.0 * u), u * u * (u - 1.0) * h
        da, db = 6.0 * u * (u - 1.0) / h, (1.0 - u) * (1.0 - 3.0 * u)
        dd = u * (3.0 * u - 2.0)
        return (
            a * x0 + b * dx0 + c * x1 + d * dx1,
            a * y0 + b * dy0 + c * y1 + d * dy1,
            da * (x0 - x1) + db * dx0 + dd * dx1,
            da * (y0 - y1) + db * dy0 + dd * dy1,
        )

    def _block(self, block: int) -> list[tuple[float, ...]]:
        """Return (distance, east, north, slopes) of the knots of one block."""
        s = np.minimum((np.arange(_BLOCK + 1) + block * _BLOCK) * _KNOT_M, self.length)
        state = self.alignment.at(s)
        columns = (s, state.e, state.n, np.sin(state.heading), np.cos(state.heading))
        return list(zip(*(column.tolist() for column in columns), strict=True))
