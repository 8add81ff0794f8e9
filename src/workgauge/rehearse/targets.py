"""What a step of the drive is aimed at: a named or nearest limit, coordinates, or a direction."""

from collections.abc import Callable, Sequence

import numpy as np

from workgauge.geodesy.frame import SiteFrame
from workgauge.rehearse.scenario import Target
from workgauge.values.arrays import Floats
from workgauge.values.errors import ScenarioError
from workgauge.values.limits import Limit, LimitKind
from workgauge.values.solids import Box, Convex, PrismChain, Solid, Surface, Tube

#: The tool is aimed at least this far below the top and above the bottom of an upright thing [m]; solids of poles
#: begin below the ground.
BELOW_TOP_M, ABOVE_BOTTOM_M = 0.3, 2.0


def solid_points(solid: Solid) -> Floats:
    """Return points (n, 3) that span a solid: corners, or the ends of its axis."""
    if isinstance(solid, Box | Convex | Surface):
        return solid.vertices
    if isinstance(solid, Tube):
        return solid.axis
    assert isinstance(solid, PrismChain)
    return np.concatenate([solid.starts, solid.ends[-1:]])


def middle(limit: Limit, height: float) -> Floats:
    """Return the middle (3,) of a limit in plan, at this height if the limit is as high, site frame [m]."""
    points = solid_points(limit.solid)
    low, high = points.min(axis=0), points.max(axis=0)
    z = min(max(height, float(low[2]) + ABOVE_BOTTOM_M), max(float(high[2]) - BELOW_TOP_M, float(low[2])))
    return np.array([*(0.5 * (low + high))[:2], z])


def nearest_point(limits: Sequence[Limit], place: Floats, height: float | None = None) -> Floats | None:
    """Return the middle (3,) of the pole or other point limit nearest to `place` (3,) in plan, None if there is none.

    Its height is `height` where the limit is as high; without one, that of `place`.
    """
    points = [limit for limit in limits if limit.kind is LimitKind.POINT]
    if not points:
        return None
    z = float(place[2]) if height is None else height
    middles = [middle(limit, z) for limit in points]
    return min(middles, key=lambda point: float(np.linalg.norm(point[:2] - place[:2])))


class Targets:
    """Finds and remembers what the drive's targets mean.

    Args:
        limits: the limits that count. frame: the site's local frame.
        nearest_of_all: returns the closest point of the nearest limit now, site frame, or None.
    """

    def __init__(
        self, limits: Sequence[Limit], frame: SiteFrame, nearest_of_all: Callable[[], Floats | None]
    ) -> None:
        self._limits = limits
        self._frame = frame
        self._nearest_of_all = nearest_of_all
        self._known: dict[Target, Floats] = {}

    def point(self, target: Target, T_site_machine: Floats, tool: Floats) -> Floats:
        """Return the point (3,) aimed at, site frame; it is chosen once and stays.

        Heights that nothing fixes are the tool's own.

        Raises:
            ScenarioError: if there is no such limit, or none at all.
        """
        if target not in self._known:
            self._known[target] = self._find(target, T_site_machine, tool)
        return self._known[target]

    def _find(self, target: Target, T_site_machine: Floats, tool: Floats) -> Floats:
        if target.direction is not None:
            direction = np.asarray(target.direction) / np.linalg.norm(target.direction)
            return np.asarray(tool + 1000.0 * T_site_machine[:3, :3] @ direction, dtype=np.float64)
        if target.east_m is not None:
            z = 0.0 if target.height_m is None else target.height_m
            local = self._frame.to_local(np.array([target.east_m, target.north_m, z], dtype=np.float64))
            return np.asarray(
                local if target.height_m is not None else [local[0], local[1], tool[2]], dtype=np.float64
            )
        if target.limit is not None:
            return middle(self._named(target.limit), tool[2])
        if target.nearest == "point":
            point = nearest_point(self._limits, T_site_machine[:3, 3], tool[2])
            if point is None:
                raise ScenarioError("there is no pole or other point limit to drive at", element="target.nearest")
            return point
        nearest = self._nearest_of_all()
        if nearest is None:
            raise ScenarioError("there is no limit near the machine to drive at", element="target.nearest")
        return nearest

    def _named(self, name: str) -> Limit:
        wanted = name.strip()
        found = [limit for limit in self._limits if wanted in (limit.id, limit.name.strip())]
        if len(found) != 1:
            known = ", ".join(sorted({limit.name for limit in self._limits})[:12]) or "none"
            message = "no such limit" if not found else "several limits of that name; use the id"
            raise ScenarioError(message, element="target.limit", value=name, allowed=known)
        return found[0]
