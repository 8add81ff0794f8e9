"""Triangles between bare points inside boundaries: what a survey is made of where a file has no triangles."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import shapely

from workgauge.site.surface.delaunay import SAME_M, Triangulated, triangulated
from workgauge.site.surface.laid import laid
from workgauge.site.surface.tin import Tin
from workgauge.values.arrays import Floats, Ints, freeze
from workgauge.values.errors import SiteError

#: A boundary's ends nearer than this are one [m].
CLOSED_M = 1e-6
BoundaryKind = Literal["outer", "void", "island"]


@dataclass(frozen=True, slots=True, eq=False)
class Boundary:
    """One boundary of a surface.

    Attributes:
        kind: outside an outer one there is no surface, inside a void one neither, but for islands in it.
        points: (p, 3) absolute [m], closed or not; with heights, or all of them NaN: then it lies on the surface.
        name: what to call it.
    """

    kind: BoundaryKind
    points: Floats
    name: str


def bounded(points: Floats, breaklines: Sequence[Floats], boundaries: Sequence[Boundary]) -> Triangulated:
    """Return Delaunay's triangles of points, break lines as edges, inside boundaries, whose sides are edges too.

    Args:
        points: (k, 3) absolute east, north, height [m]. breaklines: (p, 3) each, the same.

    Raises:
        SiteError: as `triangulated`, or the boundaries leave nothing.
    """
    rings: list[tuple[Boundary, Floats, shapely.Polygon]] = []
    warnings: list[str] = []
    for boundary in boundaries:
        ring = _closed(boundary.points)
        origin = ring[0, :2]
        polygon = shapely.Polygon(ring[:, :2] - origin) if len(ring) > 3 else shapely.Polygon()
        if polygon.is_empty or not polygon.is_valid or not polygon.area > SAME_M**2:
            why = "has no area" if polygon.is_empty or polygon.is_valid else "crosses itself"
            warnings.append(f"{boundary.name} {why} and is left out")
            continue
        rings.append((boundary, ring, polygon))
    lines = [*breaklines, *(ring for _, ring, _ in rings if np.isfinite(ring[:, 2]).all())]
    flat = [ring for _, ring, _ in rings if not np.isfinite(ring[:, 2]).all()]
    made = triangulated(points, lines)
    if flat:
        tin = Tin(made.vertices, made.faces)
        lines += [part.points for ring in flat for part in laid(tin, ring[:, :2]).parts]
        made = triangulated(points, lines)
    faces = made.faces[_kept(made, rings)] if rings else made.faces
    if not len(faces):
        raise SiteError("its boundaries leave no triangle", element="boundaries", value=len(rings))
    freeze(faces)
    return Triangulated(made.vertices, faces, (*made.warnings, *warnings))


def _kept(made: Triangulated, rings: Sequence[tuple[Boundary, Floats, shapely.Polygon]]) -> Ints:
    """Return the triangles (k,) whose middles lie inside an outer boundary, if there is one, and in no void."""
    middles = made.vertices[made.faces][..., :2].mean(axis=1)
    inside = {kind: np.zeros(len(middles), dtype=bool) for kind in ("outer", "void", "island")}
    for boundary, ring, polygon in rings:
        inside[boundary.kind] |= shapely.contains_xy(polygon, middles - ring[0, :2])
    outer = any(boundary.kind == "outer" for boundary, _, _ in rings)
    kept = (inside["outer"] if outer else True) & (~inside["void"] | inside["island"])
    return np.flatnonzero(kept)


def _closed(points: Floats) -> Floats:
    """Return a ring (p, 3) whose last point is its first."""
    if len(points) and np.abs(points[0, :2] - points[-1, :2]).max() > CLOSED_M:
        return np.concatenate([points, points[:1]])
    return points
