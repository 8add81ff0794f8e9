"""The shapes limits and links are made of. Coordinates are metres in the frame named by the owner."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from workgauge.values.arrays import Floats, Ints


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """A box with centre frame `T_frame_box` (4, 4) and `half_extents` (3,) along its own axes."""

    T_frame_box: Floats
    half_extents: Floats

    @property
    def vertices(self) -> Floats:
        """The eight corners (8, 3)."""
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
        return signs * self.half_extents @ self.T_frame_box[:3, :3].T + self.T_frame_box[:3, 3]


@dataclass(frozen=True, slots=True, eq=False)
class Convex:
    """A convex polyhedron: `vertices` (n, 3) and outward-wound triangles `faces` (m, 3), indices into vertices."""

    vertices: Floats
    faces: Ints


@dataclass(frozen=True, slots=True, eq=False)
class PrismChain:
    """A chain of convex prisms along a curve, one solid: inside it, only its cross-section is a way out.

    Cell i has two congruent end polygons in vertical planes: vertex j of its start polygon lies at
    `starts[i] + sections[i, j, 0] * laterals[i] + sections[i, j, 1] * up`, and likewise at `ends[i]`.

    Attributes:
        starts: (n, 3) and ends: (n, 3), the axis of each cell.
        laterals: (n, 3), horizontal unit vectors to the left of the cell's direction.
        sections: (n, k, 2), convex polygons (left, up) [m], counter-clockwise about the direction of travel
            (left x up = forward).
        chainages: (n, 2), distance along the source alignment at start and end [m].
        neighbours: (n, 2) bool, whether the start (end) face is shared with the chain's next cell and is no way out.
    """

    starts: Floats
    ends: Floats
    laterals: Floats
    sections: Floats
    chainages: Floats
    neighbours: np.ndarray[tuple[int, int], np.dtype[np.bool_]]

    def __len__(self) -> int:
        return len(self.starts)

    def cell_vertices(self, cell: int) -> Floats:
        """Return the 2k vertices of one cell, start polygon first."""
        section = self.sections[cell]
        offsets = section[:, :1] * self.laterals[cell] + section[:, 1:] * np.array([0.0, 0.0, 1.0])
        return np.concatenate([self.starts[cell] + offsets, self.ends[cell] + offsets])


@dataclass(frozen=True, slots=True, eq=False)
class Tube:
    """A chain of capsules: every point within `radius` of the polyline `axis` (n, 3), n >= 2. One solid."""

    axis: Floats
    radius: float


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A one-sided triangle mesh. The allowed side is above (`keep_above`) or below it, judged in plan.

    Attributes:
        vertices: (n, 3). faces: (m, 3), wound so that the normals point up.
        keep_above: True for terrain and design surfaces, False for a ceiling.
    """

    vertices: Floats
    faces: Ints
    keep_above: bool = True


Solid: TypeAlias = Box | Convex | PrismChain | Tube | Surface
