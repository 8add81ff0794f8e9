"""Limits cut for drawing: their outline in plan, and their cross-section with a vertical plane."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from shapely import MultiLineString, MultiPoint, box, unary_union
from shapely.geometry.base import BaseGeometry

from workgauge.values.arrays import Floats
from workgauge.values.solids import Box, Convex, PrismChain, Solid, Surface, Tube

#: Unit directions that stand for a sphere when a tube is drawn: three rings and two poles, 3 % off at most.
_RING = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
SPHERE = np.concatenate(
    [
        np.stack([np.cos(e) * np.cos(_RING), np.cos(e) * np.sin(_RING), np.full(16, np.sin(e))], axis=1)
        for e in (-np.pi / 4, 0.0, np.pi / 4)
    ]
    + [np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])]
)


def convex_cells(solid: Solid, centre: Floats, radius_m: float) -> Iterator[Floats]:
    """Yield the corners (k, 3) of each convex piece of a solid near `centre` (3,); surfaces have none."""
    if isinstance(solid, Box | Convex):
        yield solid.vertices
    elif isinstance(solid, PrismChain):
        for cell in _near_segments(solid.starts, solid.ends, centre, radius_m + float(np.abs(solid.sections).max())):
            yield solid.cell_vertices(int(cell))
    elif isinstance(solid, Tube):
        for i in _near_segments(solid.axis[:-1], solid.axis[1:], centre, radius_m + solid.radius):
            yield np.concatenate([solid.axis[i] + solid.radius * SPHERE, solid.axis[i + 1] + solid.radius * SPHERE])


def _near_segments(starts: Floats, ends: Floats, centre: Floats, radius_m: float) -> NDArray[np.intp]:
    """Return the indices of the segments whose plan distance to `centre` is at most `radius_m`."""
    a, along = starts[:, :2] - centre[:2], (ends - starts)[:, :2]
    share = np.clip(-np.sum(a * along, axis=1) / np.maximum(np.sum(along * along, axis=1), 1e-12), 0.0, 1.0)
    return np.flatnonzero(np.linalg.norm(a + share[:, None] * along, axis=1) <= radius_m)


def plan_outline(solid: Solid, centre: Floats, radius_m: float) -> BaseGeometry:
    """Return what a solid covers in plan within a square of half-width `radius_m`; a surface covers nothing."""
    window = box(centre[0] - radius_m, centre[1] - radius_m, centre[0] + radius_m, centre[1] + radius_m)
    pieces = [MultiPoint(cell[:, :2]).convex_hull for cell in convex_cells(solid, centre, 1.5 * radius_m)]
    outline: BaseGeometry = unary_union(pieces).intersection(window)
    return outline


def vertical_section(solid: Solid, centre: Floats, direction: Floats, radius_m: float) -> BaseGeometry:
    """Return a solid's cut with the vertical plane through `centre` along the unit plan `direction` (2,).

    Coordinates of the answer are (distance along `direction` from `centre`, height in the site frame) [m].
    """
    window = box(-radius_m, centre[2] - radius_m, radius_m, centre[2] + radius_m)
    if isinstance(solid, Surface):
        return _surface_section(solid, centre, direction, radius_m).intersection(window)
    cuts = (_cut(cell, centre, direction) for cell in convex_cells(solid, centre, 1.5 * radius_m))
    return unary_union([cut for cut in cuts if cut is not None]).intersection(window)


def _cut(corners: Floats, centre: Floats, direction: Floats) -> BaseGeometry | None:
    """Cut one convex piece: the hull of all crossings between corners on either side of the plane."""
    relative = corners[:, :2] - centre[:2]
    along = relative @ direction
    across = relative @ np.array([-direction[1], direction[0]])
    above, below = np.flatnonzero(across >= 0), np.flatnonzero(across < 0)
    if not len(above) or not len(below):
        return None
    i, j = (index.ravel() for index in np.meshgrid(above, below))
    share = across[i] / (across[i] - across[j])
    points = np.stack([along, corners[:, 2]], axis=1)
    return MultiPoint(points[i] + share[:, None] * (points[j] - points[i])).convex_hull


def _surface_section(surface: Surface, centre: Floats, direction: Floats, radius_m: float) -> BaseGeometry:
    """Cut a triangle mesh: one line piece per triangle that crosses the plane."""
    corners = surface.vertices[surface.faces]
    relative = corners[:, :, :2] - centre[:2]
    near = np.abs(relative).max(axis=2).min(axis=1) <= 1.5 * radius_m
    corners, relative = corners[near], relative[near]
    along = relative @ direction
    across = relative @ np.array([-direction[1], direction[0]])
    pieces = []
    for s, w, z in zip(along, across, corners[:, :, 2], strict=True):
        crossing = [
            (s[a] + f * (s[b] - s[a]), z[a] + f * (z[b] - z[a]))
            for a, b in ((0, 1), (1, 2), (2, 0))
            if (w[a] >= 0) != (w[b] >= 0)
            for f in (w[a] / (w[a] - w[b]),)
        ]
        if len(crossing) == 2:
            pieces.append(crossing)
    return MultiLineString(pieces)
