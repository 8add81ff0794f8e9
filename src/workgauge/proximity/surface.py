"""One-sided triangle surfaces: signed clearance of a box over its whole footprint.

A surface is a height over the plan: for each point of it, everything below (above, for a ceiling) is forbidden. Over
the part of the plan it does not cover it forbids nothing; there a box is only kept off the mesh itself.

If no part of the box is below the surface, the clearance is the Euclidean distance of box and mesh. Otherwise it is
minus the largest Euclidean distance to the mesh among the box's points below it, taken over the points where vertical
depth can be extreme: corners of the box, mesh vertices under the footprint's lower side, and crossings of box edges
with mesh edges in plan. The vertical depth decides the sign, exactly; the Euclidean distance is the depth, because it
is continuous through zero and at every edge of the mesh, and because behind a steep face (a trench wall, a platform
edge) a point 5 cm in is 5 cm deep and its way out is sideways, where the vertical depth says 2 m up.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely

from workgauge.proximity.cells import BOX_EDGES, CORNER_SIGNS, UP
from workgauge.proximity.shapes import Placed, measure_mesh, placed_mesh, point_shape
from workgauge.values.arrays import Floats, Ints
from workgauge.values.solids import Surface

#: Vertical depth below which a point counts as on the surface [m].
_ON_SURFACE_M = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceClearance:
    """Signed distance, unit way out (3,), closest points (3,) and the triangle."""

    distance: float
    normal: Floats
    point_machine: Floats
    point_limit: Floats
    triangle: int


class SurfaceIndex:
    """A surface with its plan index and bounding-volume hierarchy. Immutable; one per surface limit.

    A ceiling is held upside down: it and every box are mirrored at z = 0, and what is found is mirrored back.
    """

    def __init__(self, surface: Surface) -> None:
        self._flip = np.array([1.0, 1.0, 1.0 if surface.keep_above else -1.0])
        vertices = surface.vertices * self._flip
        faces = np.asarray(surface.faces, dtype=np.int64)
        corners = vertices[faces]
        self._corners: Floats = corners
        self._low: Floats = corners.min(axis=1)
        self._high: Floats = corners.max(axis=1)
        self._mesh: Placed = placed_mesh(vertices, faces if surface.keep_above else faces[:, ::-1])
        low, high = self._low, self._high
        self._tree = shapely.STRtree(shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1]))
        self._top = float(high[:, 2].max())
        self._bounds = (low[:, :2].min(axis=0), high[:, :2].max(axis=0))
        self._tree.query(shapely.box(0.0, 0.0, 0.0, 0.0))  # built on first use: not in the first tick
        self._planes, self._plan_areas = _planes(corners)

    @property
    def count(self) -> int:
        """Number of triangles."""
        return len(self._corners)

    def triangle(self, triangle: int) -> tuple[Floats, Floats, Floats]:
        """Return a triangle's corners (3, 3), its normal and up or down, towards the allowed side."""
        return self._corners[triangle] * self._flip, self._planes[triangle] * self._flip, UP * self._flip

    def triangles_near(self, low: Floats, high: Floats) -> Ints:
        """Return the triangles, ascending, whose boxes meet the box from low to high (3,), or lie under (over) it."""
        if self._flip[2] < 0.0:
            low, high = np.array([low[0], low[1], -high[2]]), np.array([high[0], high[1], -low[2]])
        if low[2] > self._top or (low[:2] > self._bounds[1]).any() or (high[:2] < self._bounds[0]).any():
            return np.empty(0, np.int64)
        found: Ints = self._tree.query(shapely.box(low[0], low[1], high[0], high[1]))
        found = found[self._high[found, 2] >= low[2]]
        found.sort()
        return found

    def clearance(
        self, box: Placed, R: Floats, centre: Floats, half: Floats, within: float, result: Any
    ) -> SurfaceClearance | None:
        """Return the signed clearance of a box, None if it is `within` [m] or more away.

        Args:
            box: its shape and pose. R: (3, 3) its axes as columns. centre, half: (3,), site frame [m].
            within: search radius.
            result: where coal puts its answers.
        """
        mirrored = self._flip[2] < 0.0
        if mirrored:
            R = R * self._flip[:, None] * (1.0, 1.0, -1.0)  # still a right-handed frame; a box has no handedness
            centre = centre * self._flip
            box = (box[0], type(box[1])(R, centre))
        reach = np.abs(R) @ half
        low, high = centre - reach, centre + reach
        if (
            low[2] - within >= self._top
            or (low[:2] - within > self._bounds[1]).any()
            or (high[:2] + within < self._bounds[0]).any()
        ):
            return None
        found = self._below(R, centre, half, low, high, result) or self._above(box, within, result)
        if found is None or not mirrored:
            return found
        flip = self._flip
        return SurfaceClearance(
            found.distance, found.normal * flip, found.point_machine * flip, found.point_limit * flip, found.triangle
        )

    def _above(self, box: Placed, within: float, result: Any) -> SurfaceClearance | None:
        found = measure_mesh(self._mesh, box, within, result)
        if found is None:
            return None
        distance, on_mesh, on_box, triangle = found
        apart = on_box - on_mesh
        length = float(np.sqrt(apart @ apart))
        normal = apart / length if distance > 1e-7 and length > 1e-7 else self._planes[triangle]
        return SurfaceClearance(max(distance, 0.0), normal, on_box, on_mesh, triangle)

    def _below(
        self, R: Floats, centre: Floats, half: Floats, low: Floats, high: Floats, result: Any
    ) -> SurfaceClearance | None:
        """Return the clearance if part of the box is below the surface."""
        triangles: Ints = self._tree.query(shapely.box(low[0], low[1], high[0], high[1]))
        triangles = triangles[self._high[triangles, 2] > low[2]]
        if triangles.size == 0:
            return None
        triangles.sort()
        box_corners = CORNER_SIGNS * half @ R.T + centre
        points, depths = self._extremes(triangles, box_corners, R, centre, half)
        below = depths > _ON_SURFACE_M
        if not below.any():
            return None
        order = np.argsort(-depths[below], kind="stable")
        best: SurfaceClearance | None = None
        for point, depth in zip(points[below][order], depths[below][order], strict=True):
            if best is not None and depth <= -best.distance:
                break
            found = measure_mesh(self._mesh, point_shape(point), float(depth) + 1e-3, result)
            if found is None or (best is not None and found[0] <= -best.distance):
                continue
            distance, on_mesh, _, triangle = found
            apart = on_mesh - point
            normal = apart / distance if distance > 1e-7 else self._planes[triangle]
            best = SurfaceClearance(-distance, normal, point, on_mesh, triangle)
        return best or self._straight_up(points[below][order[0]], float(depths[below][order[0]]), int(triangles[0]))

    @staticmethod
    def _straight_up(point: Floats, depth: float, triangle: int) -> SurfaceClearance:
        """Return the vertical depth, for the case that no distance to the mesh could be had."""
        return SurfaceClearance(-depth, UP, point, point + depth * UP, triangle)

    def _extremes(
        self, triangles: Ints, box_corners: Floats, R: Floats, centre: Floats, half: Floats
    ) -> tuple[Floats, Floats]:
        """Return points of the box (k, 3) where its vertical depth below the triangles can be extreme, and depths."""
        corners = self._corners[triangles]
        sloped = self._plan_areas[triangles] > 1e-12
        found = (
            _corners_below(box_corners, corners[sloped], self._planes[triangles[sloped]]),
            _vertices_above(np.unique(corners.reshape(-1, 3), axis=0), R, centre, half),
            _crossings(box_corners, corners),
        )
        return np.concatenate([points for points, _ in found]), np.concatenate([depths for _, depths in found])


def _planes(corners: Floats) -> tuple[Floats, Floats]:
    """Return upward unit normals (m, 3) of triangles (m, 3, 3), and twice their plan areas (m,)."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.abs(normals[:, 2])
    normals *= np.where(normals[:, 2:] < 0.0, -1.0, 1.0)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(lengths > 0.0, normals / np.where(lengths > 0.0, lengths, 1.0), (0.0, 0.0, 1.0)), areas


def _corners_below(box_corners: Floats, triangles: Floats, normals: Floats) -> tuple[Floats, Floats]:
    """Return the box corners with a triangle above or below them in plan, and how deep they are under it."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    first, second = b - a, c - a
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    x = box_corners[:, None, 0] - a[:, 0]
    y = box_corners[:, None, 1] - a[:, 1]
    v = (x * second[:, 1] - y * second[:, 0]) / area
    w = (first[:, 0] * y - first[:, 1] * x) / area
    inside = (v >= -1e-12) & (w >= -1e-12) & (v + w <= 1.0 + 1e-12)
    which, over = np.nonzero(inside)
    heights = a[over, 2] + v[inside] * first[over, 2] + w[inside] * second[over, 2]
    points = box_corners[which]
    return points, heights - points[:, 2]


def _vertices_above(vertices: Floats, R: Floats, centre: Floats, half: Floats) -> tuple[Floats, Floats]:
    """Return the lower ends of the box's verticals through mesh vertices, and how deep they are under those."""
    local = (vertices - centre) @ R
    direction = np.where(np.abs(R[2]) < 1e-12, 1e-12, R[2])
    first, second = (-half - local) / direction, (half - local) / direction
    lower = np.minimum(first, second).max(axis=1)
    upper = np.maximum(first, second).min(axis=1)
    hit = lower <= upper
    points = vertices[hit].copy()
    points[:, 2] += lower[hit]
    return points, -lower[hit]


def _crossings(box_corners: Floats, triangles: Floats) -> tuple[Floats, Floats]:
    """Return the points of box edges that cross triangle edges in plan, and how deep they are under those."""
    p, r = box_corners[BOX_EDGES[:, 0]], box_corners[BOX_EDGES[:, 1]]
    r = r - p
    q = triangles.reshape(-1, 3)
    s = np.roll(triangles, -1, axis=1).reshape(-1, 3) - q
    apart_x = q[:, 0] - p[:, None, 0]
    apart_y = q[:, 1] - p[:, None, 1]
    cross = r[:, None, 0] * s[:, 1] - r[:, None, 1] * s[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (apart_x * s[:, 1] - apart_y * s[:, 0]) / cross
        u = (apart_x * r[:, None, 1] - apart_y * r[:, None, 0]) / cross
        hit = (t >= 0.0) & (t <= 1.0) & (u >= 0.0) & (u <= 1.0)
    edge, side = np.nonzero(hit)
    points = p[edge] + t[hit][:, None] * r[edge]
    return points, q[side, 2] + u[hit] * s[side, 2] - points[:, 2]
