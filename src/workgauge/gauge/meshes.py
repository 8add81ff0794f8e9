"""Triangle meshes of limits: every convex cell a closed, outward-wound component of its own; surfaces in tiles."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from workgauge.gauge.solids import prism_faces
from workgauge.values.arrays import Floats, Ints
from workgauge.values.solids import Box, Convex, PrismChain, Solid, Surface, Tube

#: Chains and tubes are cut into parts, and surfaces into tiles, about this long [m].
PART_LENGTH = 200.0
#: Sides of the prism that stands for a capsule; it contains the capsule.
TUBE_SIDES = 12


@dataclass(frozen=True, slots=True, eq=False)
class MeshPart:
    """Triangles of a part of a limit: vertices (n, 3) in the site frame, faces (m, 3), chainage of a chain's part."""

    vertices: Floats
    faces: Ints
    chainage: tuple[float, float] | None = None


def mesh_parts(solid: Solid) -> Iterator[MeshPart]:
    """Yield the parts of a solid's mesh, each small enough for single precision about its own middle."""
    if isinstance(solid, Box):
        corners = solid.vertices[[0, 4, 6, 2, 1, 5, 7, 3]]
        yield MeshPart(corners, np.array(prism_faces(4)))
    elif isinstance(solid, Convex):
        yield MeshPart(solid.vertices, solid.faces)
    elif isinstance(solid, PrismChain):
        yield from _chain_parts(solid)
    elif isinstance(solid, Tube):
        yield from _tube_parts(solid)
    else:
        yield from _surface_parts(solid)


def _groups(lengths: Floats) -> Iterator[slice]:
    """Yield runs of consecutive cells of about PART_LENGTH together, at least one each."""
    part = np.floor(np.cumsum(lengths) / PART_LENGTH)
    edges = np.flatnonzero(np.diff(part)) + 1
    for first, stop in zip([0, *edges], [*edges, len(lengths)], strict=True):
        yield slice(int(first), int(stop))


def _cells(rings: Floats) -> tuple[Floats, Ints]:
    """Return vertices and faces of prisms given as (c, 2 k, 3) start and end rings."""
    count, size = rings.shape[:2]
    faces = np.array(prism_faces(size // 2))
    return rings.reshape(-1, 3), (np.arange(count)[:, None, None] * size + faces).reshape(-1, 3)


def _chain_parts(chain: PrismChain) -> Iterator[MeshPart]:
    up = np.array([0.0, 0.0, 1.0])
    for part in _groups(np.linalg.norm(chain.ends - chain.starts, axis=1)):
        offsets = chain.sections[part, :, :1] * chain.laterals[part, None] + chain.sections[part, :, 1:] * up
        rings = np.concatenate([chain.starts[part, None] + offsets, chain.ends[part, None] + offsets], axis=1)
        chainage = (float(chain.chainages[part][0, 0]), float(chain.chainages[part][-1, 1]))
        yield MeshPart(*_cells(rings), chainage)


def _tube_parts(tube: Tube) -> Iterator[MeshPart]:
    """Yield a prism per capsule: round it, and past its ends by the radius."""
    a, b = tube.axis[:-1], tube.axis[1:]
    length = np.linalg.norm(b - a, axis=1)
    forward = (b - a) / length[:, None]
    steep = np.abs(forward[:, 2]) > 0.9
    aside = np.cross(np.where(steep[:, None], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]), forward)
    aside /= np.linalg.norm(aside, axis=1)[:, None]
    other = np.cross(forward, aside)
    turn = 2 * math.pi * np.arange(TUBE_SIDES) / TUBE_SIDES
    around = tube.radius / math.cos(math.pi / TUBE_SIDES)
    ring = around * (np.cos(turn)[:, None] * aside[:, None] + np.sin(turn)[:, None] * other[:, None])
    reach = tube.radius * forward
    rings = np.concatenate([(a - reach)[:, None] + ring, (b + reach)[:, None] + ring], axis=1)
    for part in _groups(length):
        yield MeshPart(*_cells(rings[part]))


def _surface_parts(surface: Surface) -> Iterator[MeshPart]:
    """Yield a surface's triangles by tiles of their middles in plan."""
    if not len(surface.faces):
        return
    middle = surface.vertices[surface.faces].mean(axis=1)[:, :2]
    tile = np.floor(middle / PART_LENGTH).astype(np.int64)
    _, owner = np.unique(tile, axis=0, return_inverse=True)
    order = np.argsort(owner, kind="stable")
    edges = np.flatnonzero(np.diff(owner[order])) + 1
    for faces in np.split(surface.faces[order], edges):
        used, local = np.unique(faces, return_inverse=True)
        yield MeshPart(surface.vertices[used], local.reshape(-1, 3))
