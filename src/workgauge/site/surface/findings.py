"""What is wrong with a triangulated surface, or must be known of it: holes, overlaps, vertical triangles."""

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from workgauge.site.surface.joined import joined
from workgauge.values.arrays import Floats, Ints

#: Triangles overlap that reach into each other by more than this in plan [m].
OVERLAP_M = 1e-4
#: Points nearer to each other in plan than this are one [m].
SAME_M = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """What is to be known of a surface. Places are absolute east, north [m].

    Attributes:
        vertical: number of vertical triangles. overlaps: (k, 2) pairs of triangles above each other.
        holes: (h) loops (k, 2) round what has no triangles though triangles are all round it.
        outlines: (o) loops (k, 2) round separate pieces.
        overlap_at: (2,) the middle of one triangle that overlaps, None without.
    """

    vertical: int
    overlaps: Ints
    holes: tuple[Floats, ...]
    outlines: tuple[Floats, ...]
    overlap_at: Floats | None

    def words(self, name: str) -> tuple[str, ...]:
        """Return one sentence for each kind of trouble."""
        said = []
        if self.vertical:
            said.append(f"{name}: {self.vertical} vertical triangles have no height of their own")
        if len(self.overlaps):
            e, n = (self.overlap_at if self.overlap_at is not None else np.zeros(2)).tolist()
            said.append(
                f"{name}: {len(self.overlaps)} pairs of triangles lie above each other, the topmost counts; "
                f"one at E {e:.2f}, N {n:.2f}"
            )
        if self.holes:
            areas = [abs(_area(loop)) for loop in self.holes]
            largest = self.holes[int(np.argmax(areas))].mean(axis=0)
            said.append(
                f"{name}: {len(self.holes)} holes, {sum(areas):.1f} m2 in all, the largest {max(areas):.1f} m2 "
                f"at E {largest[0]:.2f}, N {largest[1]:.2f}"
            )
        if len(self.outlines) > 1:
            said.append(f"{name}: {len(self.outlines)} separate pieces")
        return tuple(said)


def findings(plan: Floats, faces: Ints, level: NDArray[np.bool_], origin: Floats) -> Findings:
    """Return what is to be known of faces (m, 3), wound up, of places (n, 2) [m] less an origin (2,).

    Points of different index at one place count as one.
    """
    first, same = joined(plan, SAME_M)
    overlaps = _overlaps(plan, faces, np.flatnonzero(level))
    loops = [plan[where] + origin for where in _loops(same[faces][level], first)]
    areas = [_area(loop) for loop in loops]
    middle = None if not len(overlaps) else plan[faces[overlaps[0, 0]]].mean(axis=0) + origin
    return Findings(
        int((~level).sum()),
        overlaps,
        tuple(loop for loop, area in zip(loops, areas, strict=True) if area < 0.0),
        tuple(loop for loop, area in zip(loops, areas, strict=True) if area > 0.0),
        middle,
    )


def _area(loop: Floats) -> float:
    """Return the signed area of a loop (k, 2), positive counter-clockwise [m2]."""
    gap = loop - loop[0]
    return 0.5 * float((gap[:-1, 0] * gap[1:, 1] - gap[:-1, 1] * gap[1:, 0]).sum())


def _overlaps(plan: Floats, faces: Ints, level: Ints) -> Ints:
    """Return pairs (k, 2) of triangles that reach into each other by more than `OVERLAP_M`.

    Two triangles are apart if one of their six sides has all of the other on its far side.
    """
    corners = plan[faces[level]]
    low, high = corners.min(axis=1) + OVERLAP_M, corners.max(axis=1) - OVERLAP_M
    tree = shapely.STRtree(shapely.box(*np.minimum(low, high).T, *np.maximum(low, high).T))
    one, other = tree.query(tree.geometries)
    pair = one < other
    one, other = one[pair], other[pair]
    apart = np.zeros(len(one), dtype=bool)
    for a, b in ((one, other), (other, one)):
        for k in range(3):
            open_ = np.flatnonzero(~apart)
            foot, side = corners[a[open_], k], corners[a[open_], (k + 1) % 3] - corners[a[open_], k]
            side /= np.linalg.norm(side, axis=1)[:, None]
            gap = corners[b[open_]] - foot[:, None]
            inside = side[:, None, 0] * gap[..., 1] - side[:, None, 1] * gap[..., 0]
            apart[open_] = inside.max(axis=1) <= OVERLAP_M
    found = np.stack([level[one[~apart]], level[other[~apart]]], axis=1)
    return np.asarray(found, dtype=np.int64)


def _loops(faces: Ints, first: Ints) -> list[Ints]:
    """Return the borders of faces (m, 3), as closed loops of points, inside on their left."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    size = int(faces.max()) + 1 if len(faces) else 1
    code, back = edges[:, 0] * size + edges[:, 1], edges[:, 1] * size + edges[:, 0]
    border = edges[~np.isin(code, back)]
    following: dict[int, list[int]] = {}
    for a, b in border.tolist():
        following.setdefault(a, []).append(b)
    loops = []
    while following:
        start = next(iter(following))
        loop, at = [start], start
        while at in following:
            nexts = following[at]
            at = nexts.pop()
            if not nexts:
                del following[loop[-1]]
            loop.append(at)
            if at == start:
                break
        loops.append(first[np.array(loop)])
    return loops
