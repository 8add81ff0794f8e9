"""The height of the topmost of several triangulated surfaces at points in plan."""

from collections.abc import Sequence

import numpy as np
import shapely

from workgauge.site.model import SurfaceModel
from workgauge.values.arrays import Floats

#: A point counts as on a triangle if it lies outside by less than this share of the triangle.
EDGE_SLACK = 1e-9


class Topmost:
    """Triangles of surfaces, indexed in plan; triangles without plan area are none."""

    def __init__(self, surfaces: Sequence[SurfaceModel]) -> None:
        parts = [surface.vertices[surface.faces] for surface in surfaces if len(surface.faces)]
        corners: Floats = np.concatenate(parts) if parts else np.empty((0, 3, 3))
        u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
        there = (np.abs(area) > 1e-12) & np.isfinite(corners).all(axis=(1, 2))
        self._foot, self._u, self._v, self._area = corners[there, 0], u[there], v[there], area[there]
        low, high = corners[there, :, :2].min(axis=1), corners[there, :, :2].max(axis=1)
        self._tree = shapely.STRtree(shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1]))

    def heights(self, en: Floats) -> Floats:
        """Return the topmost height (k,) [m] at absolute plan points (k, 2), NaN where no surface lies."""
        out = np.full(len(en), -np.inf)
        point, face = self._tree.query(shapely.points(en))
        gap = en[point] - self._foot[face, :2]
        u, v, area = self._u[face], self._v[face], self._area[face]
        s = (gap[:, 0] * v[:, 1] - gap[:, 1] * v[:, 0]) / area
        t = (u[:, 0] * gap[:, 1] - u[:, 1] * gap[:, 0]) / area
        on = (s >= -EDGE_SLACK) & (t >= -EDGE_SLACK) & (s + t <= 1 + EDGE_SLACK)
        z = self._foot[face, 2] + s * u[:, 2] + t * v[:, 2]
        np.maximum.at(out, point[on], z[on])
        return np.where(np.isfinite(out), out, np.nan)
