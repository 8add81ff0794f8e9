"""How deep a box is inside a chain of cells, and the way out of the union, never through a shared face.

Inside one cell the depth is the least distance across the chain that frees the part of the box lying between the
cell's end planes: both are projected along the cell's axis, and two convex polygons are freed along the normal of one
of their edges. At a free end of the chain the way out may also lead along it, over the whole way to that end. The
chain's depth is that of the worst cell. Because the part of a box in a cell it has just reached is contained in the
part in the cell it came from, the depth is continuous where cells meet.
"""

from dataclasses import dataclass

import numpy as np

from workgauge.proximity.cells import BOX_EDGES, CORNER_SIGNS, UP, frames_along
from workgauge.values.arrays import Floats
from workgauge.values.solids import PrismChain, Tube


@dataclass(frozen=True, slots=True, eq=False)
class Penetration:
    """How deep, which way out (3,), the box's point and the chain's point (3,) [m], and in which cell."""

    depth: float
    normal: Floats
    point_machine: Floats
    point_limit: Floats
    cell: int


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """A chain ready for penetration: m cells swept along their axes.

    Attributes:
        starts: (m, 3), axis start of each cell.
        frames: (m, 3, 3), columns: unit axis and two unit vectors across it.
        ends_out: (m, 3), horizontal for prisms: unit normal of the end planes, forwards.
        lengths: (m,), distance between the two end planes.
        sections: (m, k, 2), each cell's cross-section across its axis.
        radius: what the section is widened by all around; the tube's radius.
        back, ahead: (m,), way along the chain from the cell's start (end) plane to the free end behind (ahead),
            infinite where there is none.
    """

    starts: Floats
    frames: Floats
    ends_out: Floats
    lengths: Floats
    sections: Floats
    radius: float
    back: Floats
    ahead: Floats


def prepare(solid: PrismChain | Tube) -> Chain:
    """Return the chain of a solid."""
    if isinstance(solid, Tube):
        along = np.diff(solid.axis, axis=0)
        frames = frames_along(along)
        lengths = np.linalg.norm(along, axis=1)
        joined = np.ones((len(along), 2), dtype=np.bool_)
        joined[0, 0] = joined[-1, 1] = False
        back, ahead = _ways_out(lengths, joined)
        sections = np.zeros((len(along), 1, 2))
        return Chain(solid.axis[:-1], frames, frames[:, :, 0], lengths, sections, solid.radius, back, ahead)
    along = solid.ends - solid.starts
    frames = frames_along(along, solid.laterals)
    ends_out = np.cross(solid.laterals, UP)
    lengths = np.vecdot(along, ends_out)
    offsets = solid.sections[..., :1] * solid.laterals[:, None] + solid.sections[..., 1:] * UP
    back, ahead = _ways_out(lengths, solid.neighbours)
    return Chain(solid.starts, frames, ends_out, lengths, offsets @ frames[:, :, 1:], 0.0, back, ahead)


def _ways_out(lengths: Floats, joined: np.ndarray[tuple[int, int], np.dtype[np.bool_]]) -> tuple[Floats, Floats]:
    back, ahead = np.empty(len(lengths)), np.empty(len(lengths))
    way = np.inf
    for i in range(len(lengths)):
        way = way if joined[i, 0] else 0.0
        back[i] = way
        way += lengths[i]
    way = np.inf
    for i in reversed(range(len(lengths))):
        way = way if joined[i, 1] else 0.0
        ahead[i] = way
        way += lengths[i]
    return back, ahead


def penetrate(chain: Chain, cells: list[int], R: Floats, centre: Floats, half: Floats) -> Penetration | None:
    """Return how deep a box is inside the union of the chain's `cells`, None if it is outside all of them.

    Args:
        chain: the chain.
        cells: those the box may touch.
        R: (3, 3) axes of the box as columns. centre, half: (3,) its middle and half extents [m], site frame.
    """
    worst: Penetration | None = None
    corners = CORNER_SIGNS * half @ R.T + centre
    for cell in cells:
        found = _penetrate_cell(chain, cell, corners, R)
        if found is not None and (worst is None or found.depth > worst.depth):
            worst = found
    return worst


def _penetrate_cell(chain: Chain, cell: int, corners: Floats, R: Floats) -> Penetration | None:
    start, frame, out = chain.starts[cell], chain.frames[cell], chain.ends_out[cell]
    length, section = float(chain.lengths[cell]), chain.sections[cell]
    along = (corners - start) @ out
    points, along = _clip(corners, along, length)
    if len(points) == 0:
        return None
    flat = (points - start) @ frame[:, 1:]
    normals = _normals(section, R, frame, out)
    depths = (section @ normals.T).max(axis=0) - (flat @ normals.T).min(axis=0)
    best = int(np.argmin(depths))
    if depths[best] <= 0.0:
        return None
    depth = float(depths[best]) + chain.radius
    normal = frame[:, 1:] @ normals[best]
    deepest = int(np.argmin(flat @ normals[best]))
    backwards = float(along.max() + chain.back[cell]) + chain.radius
    if backwards < depth:
        depth, normal, deepest = backwards, -out, int(np.argmax(along))
    forwards = float(length - along.min() + chain.ahead[cell]) + chain.radius
    if forwards < depth:
        depth, normal, deepest = forwards, out, int(np.argmin(along))
    return Penetration(depth, normal, points[deepest], points[deepest] + depth * normal, cell)


def _clip(corners: Floats, along: Floats, length: float) -> tuple[Floats, Floats]:
    """Return the vertices of a box cut to 0 <= along <= length, and their `along`."""
    first, second = BOX_EDGES[:, 0], BOX_EDGES[:, 1]
    a, b = along[first], along[second]
    kept = (along >= 0.0) & (along <= length)
    points, places = [corners[kept]], [along[kept]]
    for plane in (0.0, length):
        crossed = ((a < plane) & (b > plane)) | ((a > plane) & (b < plane))
        if crossed.any():
            share = ((plane - a[crossed]) / (b[crossed] - a[crossed]))[:, None]
            start = corners[first[crossed]]
            points.append(start + share * (corners[second[crossed]] - start))
            places.append(np.full(len(share), plane))
    return np.concatenate(points), np.concatenate(places)


def _normals(section: Floats, R: Floats, frame: Floats, out: Floats) -> Floats:
    """Return unit vectors (m, 2) across the chain that include the edge normals of both projected polygons.

    The clipped box's outline consists of box edges and of cuts of box faces with the end planes.
    """
    edges = np.concatenate([R.T, np.cross(R.T, out)]) @ frame[:, 1:]
    if len(section) > 1:
        edges = np.concatenate([edges, np.roll(section, -1, axis=0) - section])
    lengths = np.sqrt(np.vecdot(edges, edges))
    kept = lengths > 1e-9
    turned = edges[kept][:, ::-1] * (1.0, -1.0) / lengths[kept][:, None]
    return np.concatenate([turned, -turned])
