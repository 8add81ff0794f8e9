"""Corners of a scene's convex cells and ground triangles, packed for compiled code. Packed when first near.

A triangle of a one-sided surface stands for the ground under it (the sky over it, for a ceiling): the prism down (up)
from it. Where the surface is a height over the plan, distances from above are those to the triangle.
"""

from collections.abc import Sequence

import numpy as np

from workgauge.proximity.store import CellShapes
from workgauge.proximity.surface import SurfaceIndex
from workgauge.values.arrays import Floats, Ints

#: How far the prism under a triangle reaches [m].
DEPTH_M = 20.0
_FIRST = 256
_NO_EDGES: Floats = np.empty((0, 3))
#: What a hull is: a convex body, a cell of a chain, the ground under a triangle.
WHOLE, SHARED, GROUND = range(3)


class Hulls:
    """Corners and face normals of hulls by number; a hull is added when its cell or triangle is asked for.

    Attributes:
        corners: (v, 3), of hull h those from starts[h] to starts[h + 1]. drawn: (v, 3), the same of the cell drawn
            out at faces it shares with its chain's next. normals: (f, 3), ways out, likewise by faces[h].
        edges: (e, 3), directions of the edges of a cell, likewise by edge_starts[h]; none of a triangle's.
        kinds: (h) see `WHOLE`, `SHARED`, `GROUND`.
        of_cell: (cells,) the hull of each cell of the scene, -1 while it has none.
        radii: (h) by which a hull is thicker than its corners [m].
    """

    def __init__(self, shapes: CellShapes, radii: Floats, limits: Ints, surfaces: Sequence[SurfaceIndex]) -> None:
        self._shapes = shapes
        self._cell_radii = radii.take(limits) if len(limits) else np.empty(0)
        self._surfaces = surfaces
        self.of_cell: Ints = np.full(len(limits), -1)
        self._of_triangle = [np.full(one.count, -1) for one in surfaces]
        self.corners, self.drawn = np.empty((8 * _FIRST, 3)), np.empty((8 * _FIRST, 3))
        self.normals, self.kinds = np.empty((8 * _FIRST, 3)), np.zeros(_FIRST, np.int64)
        self.starts, self.faces = np.zeros(_FIRST + 1, np.int64), np.zeros(_FIRST + 1, np.int64)
        self.radii = np.zeros(_FIRST)
        self.edges, self.edge_starts = np.empty((16 * _FIRST, 3)), np.zeros(_FIRST + 1, np.int64)
        self._count = 0

    def add_cells(self, cells: Ints) -> None:
        """Pack the cells of these numbers among all cells of the scene, if they are not yet."""
        for cell in cells.tolist():
            if self.of_cell[cell] < 0:
                solid, drawn = self._shapes.polyhedron(cell), self._shapes.lengthened(cell)
                kind = WHOLE if drawn is solid.vertices else SHARED
                radius = float(self._cell_radii[cell])
                self.of_cell[cell] = self._add(solid.vertices, drawn, solid.normals, radius, kind, solid.edges)

    def of_triangles(self, surface: int, triangles: Ints) -> Ints:
        """Return the hulls of triangles of one of the scene's surfaces."""
        known = self._of_triangle[surface]
        found: Ints = known.take(triangles)
        for i in np.flatnonzero(found < 0).tolist():
            triangle = int(triangles[i])
            if known[triangle] < 0:
                corners, normal, away = self._surfaces[surface].triangle(triangle)
                prism = np.concatenate([corners, corners - DEPTH_M * away])
                known[triangle] = self._add(prism, prism, np.stack([normal, away]), 0.0, GROUND)
            found[i] = known[triangle]
        return found

    def packed(self) -> tuple[Floats, Ints, Floats, Ints, Floats, Floats, Ints]:
        """Return everything as `sweep` takes it."""
        return self.corners, self.starts, self.normals, self.faces, self.radii, self.drawn, self.kinds

    def with_edges(self) -> tuple[Ints, Floats, Ints, Floats, Floats, Ints, Floats, Ints]:
        """Return everything as `depths` takes it."""
        return (
            *(self.of_cell, self.corners, self.starts, self.radii),
            *(self.normals, self.faces, self.edges, self.edge_starts),
        )

    def _add(
        self, corners: Floats, drawn: Floats, normals: Floats, radius: float, kind: int, edges: Floats = _NO_EDGES
    ) -> int:
        hull = self._count
        if hull + 1 > len(self.radii):
            self.starts, self.faces = _twice(self.starts), _twice(self.faces)
            self.radii, self.kinds = _twice(self.radii), _twice(self.kinds)
            self.edge_starts = _twice(self.edge_starts)
        begin, first = int(self.starts[hull]), int(self.faces[hull])
        while begin + len(corners) > len(self.corners):
            self.corners, self.drawn = _twice(self.corners), _twice(self.drawn)
        while first + len(normals) > len(self.normals):
            self.normals = _twice(self.normals)
        edge = int(self.edge_starts[hull])
        while edge + len(edges) > len(self.edges):
            self.edges = _twice(self.edges)
        self.edges[edge : edge + len(edges)], self.edge_starts[hull + 1] = edges, edge + len(edges)
        self.corners[begin : begin + len(corners)] = corners
        self.drawn[begin : begin + len(corners)] = drawn
        self.normals[first : first + len(normals)] = normals
        self.starts[hull + 1], self.faces[hull + 1] = begin + len(corners), first + len(normals)
        self.radii[hull], self.kinds[hull] = radius, kind
        self._count = hull + 1
        return hull


def _twice(array: np.ndarray) -> np.ndarray:
    """Return the array with room for twice as much."""
    return np.concatenate([array, np.zeros_like(array)])
