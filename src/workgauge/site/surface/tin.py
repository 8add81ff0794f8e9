"""A triangulated surface to be asked: height, normal and triangle at any point in plan, vectorised."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from workgauge.site.model import SurfaceModel
from workgauge.site.surface.findings import Findings, findings
from workgauge.site.surface.grid import PlanGrid
from workgauge.site.surface.kernel import topmost
from workgauge.site.surface.winding import SLIVER_M
from workgauge.values.arrays import Floats, Ints, freeze
from workgauge.values.errors import SiteError

#: A point lies on a triangle that it is outside of by no more than this [m]: between neighbours there is no crack.
EDGE_M = 1e-7
#: Origins are whole multiples of this [m].
_ORIGIN_STEP_M = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class OnSurface:
    """A surface at points in plan.

    Attributes:
        z: (k,) height [m]. normal: (k, 3) unit, upwards. Both NaN where there is no surface.
        face: (k,) triangle, -1 for none.
    """

    z: Floats
    normal: Floats
    face: Ints


class Tin:
    """Triangles in plan with an index. Immutable; coordinates are absolute east, north, height [m].

    Where triangles lie above each other the topmost counts; where they touch, the one of lowest index. Vertical
    triangles have no height and are none here; `findings` counts them.

    Attributes:
        name: what it is called. origin: (3,) that `local` and heights inside are less of.
        vertices: (n, 3) absolute. faces: (m, 3), counter-clockwise in plan.
        normals: (m, 3) unit, upwards (Makkonen 1-3); of vertical ones level.
        level: (m,) bool, whether a triangle has an area in plan.
    """

    def __init__(self, vertices: ArrayLike, faces: ArrayLike, name: str = "surface") -> None:
        self.name = name
        self.vertices: Floats = np.array(vertices, dtype=np.float64).reshape(-1, 3)
        self.faces: Ints = np.array(faces, dtype=np.int64).reshape(-1, 3)
        if not len(self.faces):
            raise SiteError("has no triangles", element=f"surface {name!r}", allowed="one or more")
        if not np.isfinite(self.vertices[self.faces]).all():
            raise SiteError("has triangles with coordinates that are no numbers", element=f"surface {name!r}")
        self.origin: Floats = np.floor(self.vertices[self.faces[0, 0]] / _ORIGIN_STEP_M) * _ORIGIN_STEP_M
        local = self.vertices - self.origin
        corners = local[self.faces]
        self.local: Floats = local
        u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        normal = np.cross(u, v)
        size = np.linalg.norm(normal, axis=1)
        if not size.all():
            raise SiteError("has triangles without area", element=f"surface {name!r}")
        normal /= np.where(normal[:, 2] < 0.0, -size, size)[:, None]
        self.normals: Floats = normal
        sides = np.stack([u, v, v - u])[..., :2]
        longest = np.sqrt((sides**2).sum(axis=2).max(axis=0))
        area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
        self.level = np.abs(area) > SLIVER_M * longest
        self._packed = _packed(corners, u, v, np.where(self.level, area, np.nan), longest)
        for array in (self.vertices, self.faces, self.origin, self.local, self.normals, self.level):
            freeze(array)

    @classmethod
    def of(cls, surface: SurfaceModel) -> "Tin":
        """Return a site's surface to be asked."""
        return cls(surface.vertices, surface.faces, surface.name)

    @classmethod
    def of_all(cls, surfaces: Sequence[SurfaceModel]) -> "Tin":
        """Return several surfaces as one; where they lie above each other the topmost counts.

        Raises:
            SiteError: there is none.
        """
        if not surfaces:
            raise SiteError("no surface given", allowed="a file with triangles or points")
        if len(surfaces) == 1:
            return cls.of(surfaces[0])
        firsts = np.cumsum([0, *(len(s.vertices) for s in surfaces[:-1])])
        faces = np.concatenate([s.faces + first for s, first in zip(surfaces, firsts, strict=True)])
        name = " + ".join(dict.fromkeys(s.name for s in surfaces))
        return cls(np.concatenate([s.vertices for s in surfaces]), faces, name)

    def __len__(self) -> int:
        return len(self.faces)

    @cached_property
    def grid(self) -> PlanGrid:
        """The triangles by place in plan, less `origin`; vertical ones have boxes too."""
        corners = self.local[self.faces][..., :2]
        return PlanGrid.of(np.concatenate([corners.min(axis=1), corners.max(axis=1)], axis=1))

    @cached_property
    def findings(self) -> Findings:
        """What is to be known of it: holes, overlaps, vertical triangles."""
        return findings(self.local[:, :2], self.faces, self.level, self.origin[:2])

    def at(self, en: ArrayLike) -> OnSurface:
        """Return height, normal and triangle at absolute plan points (k, 2) east, north [m].

        Heights are those of the triangle's plane, `z = -(w_x x + w_y y - w·N1)/w_z` (Makkonen 13, 14), on the edge
        itself where a point is a hair outside.
        """
        points = np.ascontiguousarray(np.asarray(en, dtype=np.float64).reshape(-1, 2) - self.origin[:2])
        z, face = np.empty(len(points)), np.empty(len(points), dtype=np.int64)
        grid = self.grid
        topmost(points, grid.low, grid.cell, *grid.shape, grid.starts, grid.entries, self._packed, z, face)
        found = face >= 0
        normal = np.full((len(points), 3), np.nan)
        normal[found] = self.normals[face[found]]
        z += self.origin[2]
        for array in (z, normal, face):
            freeze(array)
        return OnSurface(z, normal, face)

    def heights(self, en: ArrayLike) -> Floats:
        """Return the heights (k,) alone."""
        return self.at(en).z


def _packed(corners: Floats, u: Floats, v: Floats, area: Floats, longest: Floats) -> Floats:
    """Return what the search needs of each triangle (m, 10), see `kernel.topmost`.

    A share is the distance from a side over the height above it: a point `EDGE_M` outside any side still is on the
    triangle.
    """
    slack = np.where(np.isnan(area), np.inf, -EDGE_M * longest / np.abs(area))
    with np.errstate(invalid="ignore"):
        shares = [v[:, 1] / area, -v[:, 0] / area, -u[:, 1] / area, u[:, 0] / area]
    rows = np.column_stack([corners[:, 0], *shares, u[:, 2], v[:, 2], slack])
    return np.ascontiguousarray(np.where(np.isnan(rows), 0.0, rows))
