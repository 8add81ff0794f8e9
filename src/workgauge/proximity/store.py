"""Shapes of a site's cells, each built when first needed. They are constants: keeping them keeps no result."""

from collections.abc import Sequence

import numpy as np

from workgauge.proximity.cells import Cells
from workgauge.proximity.chain import Chain, prepare
from workgauge.proximity.overlap import Polyhedron, polyhedron, segment_polyhedron
from workgauge.proximity.shapes import Placed, placed_cell, prism_faces
from workgauge.values.arrays import Floats
from workgauge.values.limits import Limit
from workgauge.values.solids import Box, Convex, PrismChain, Surface, Tube

#: How far a cell is drawn out beyond the faces it shares [m].
BEYOND_M = 20.0
#: Outward triangles of a box, by the order of `Box.vertices`.
_BOX_FACES = [
    (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
    (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
]  # fmt: skip


class CellShapes:
    """Collision shapes, polyhedra and chains of the cells of a site."""

    def __init__(self, limits: Sequence[Limit], cells: Cells) -> None:
        self._limits = limits
        self._cells = cells
        self._placed: dict[int, Placed] = {}
        self._polyhedra: dict[int, Polyhedron] = {}
        self._chains: dict[int, Chain] = {}

    def placed(self, cell: int) -> Placed:
        """Return the collision shape of a cell, by its number among all cells, and its pose."""
        shape = self._placed.get(cell)
        if shape is None:
            limit = self._limits[self._cells.limits[cell]]
            shape = self._placed[cell] = placed_cell(limit, int(self._cells.cells[cell]))
        return shape

    def polyhedron(self, cell: int) -> Polyhedron:
        """Return the vertices, normals and edges of a cell, by its number among all cells; of a tube its axis."""
        found = self._polyhedra.get(cell)
        if found is None:
            limit = self._limits[self._cells.limits[cell]]
            found = self._polyhedra[cell] = _polyhedron_of(limit, int(self._cells.cells[cell]))
        return found

    def lengthened(self, cell: int) -> Floats:
        """Return the cell's corners, in the order of `polyhedron`, drawn out by `BEYOND_M` at faces it shares.

        Through a shared face leads no way out: of the cell drawn out, what lies along the chain is never the least.
        """
        limit, index = self._limits[self._cells.limits[cell]], int(self._cells.cells[cell])
        corners, solid = self.polyhedron(cell).vertices, limit.solid
        match solid:
            case PrismChain():
                shared, along = solid.neighbours[index], solid.ends[index] - solid.starts[index]
            case Tube():
                shared = np.array([index > 0, index + 2 < len(solid.axis)])
                along = solid.axis[index + 1] - solid.axis[index]
                straight = self.chain(self._cells.limits[cell]).straight_on
                shared &= np.array([index > 0 and straight[index - 1], straight[index]])
            case _:
                return corners
        length, half = float(np.linalg.norm(along)), len(corners) // 2
        if length == 0.0 or not shared.any():
            return corners
        drawn = corners.copy()
        drawn[:half] -= shared[0] * (BEYOND_M / length) * along
        drawn[half:] += shared[1] * (BEYOND_M / length) * along
        return drawn

    def chain(self, limit: int) -> Chain:
        """Return a limit's chain, ready for penetration."""
        chain = self._chains.get(limit)
        if chain is None:
            solid = self._limits[limit].solid
            if not isinstance(solid, PrismChain | Tube):
                raise TypeError("not a chain")
            chain = self._chains[limit] = prepare(solid)
        return chain


def _polyhedron_of(limit: Limit, cell: int) -> Polyhedron:
    solid = limit.solid
    match solid:
        case Box():
            return polyhedron(solid.vertices, np.array(_BOX_FACES))
        case Convex():
            return polyhedron(solid.vertices, solid.faces)
        case PrismChain():
            return polyhedron(solid.cell_vertices(cell), prism_faces(solid.sections.shape[1]))
        case Tube():
            return segment_polyhedron(solid.axis[cell], solid.axis[cell + 1])
        case Surface():
            raise TypeError("a surface has no cells")
