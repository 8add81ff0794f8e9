"""Triangles between bare points: Delaunay's, with break lines as edges where there are some."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import ArrayLike
from scipy.spatial import Delaunay, QhullError

from workgauge.site.surface.flips import Mesh
from workgauge.site.surface.joined import joined
from workgauge.values.arrays import Floats, Ints, freeze
from workgauge.values.errors import SiteError

#: Points nearer to each other in plan than this are one; to a break line, lie on it [m].
SAME_M = 1e-4
#: Where heights of one place differ by no more than this, nothing is said [m].
SAME_HEIGHT_M = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Triangulated:
    """Triangles of points.

    Attributes:
        vertices: (n, 3) absolute [m]. faces: (m, 3), counter-clockwise in plan.
        warnings: what was doubled, crossed or left out.
    """

    vertices: Floats
    faces: Ints
    warnings: tuple[str, ...]


def triangulated(
    points: ArrayLike, breaklines: Sequence[ArrayLike] = (), *, longest_m: float | None = None
) -> Triangulated:
    """Return Delaunay's triangles of points, with every break line along edges.

    Points at one place in plan count once, with the highest of their heights. Break lines are cut where they cross
    and where points lie on them; where two cross at different heights, the first given has it. Edges of break lines
    are brought in by flipping (Sloan 1993), the other edges then flipped to Delaunay's condition again.

    Args:
        points: (k, 3) absolute east, north, height [m].
        breaklines: (p, 3) each, the same; their points are points of the surface.
        longest_m: triangles with a longer side in plan are left out, break lines aside: those that only close the
            hull. None keeps all.

    Raises:
        SiteError: fewer than three different points, all in one line, or what is no number.
    """
    given = [np.asarray(points, dtype=np.float64).reshape(-1, 3)]
    given += [np.asarray(line, dtype=np.float64).reshape(-1, 3) for line in breaklines]
    every = np.concatenate(given)
    if not np.isfinite(every).all():
        raise SiteError("points to be triangulated must be numbers", element="points")
    if not len(every):
        raise SiteError("no points to be triangulated", allowed="three or more that are not in one line")
    origin = np.append(np.floor(every[:, :2].mean(axis=0)), 0.0)
    warnings: list[str] = []
    nodes, chains = _noded([part - origin for part in given], warnings)
    plan = nodes[:, :2]
    if len(plan) < 3:
        value = f"{len(plan)} different in plan"
        raise SiteError("too few points for a surface", element="points", value=value, allowed="three or more")
    spread = plan - plan.mean(axis=0)
    if np.linalg.svd(spread, compute_uv=False)[1] < SAME_M:
        raise SiteError("all points lie in one line", element="points", value=f"{len(plan)} points")
    try:
        faces = Delaunay(spread).simplices.astype(np.int64)
    except QhullError as error:
        raise SiteError("the points cannot be triangulated", element="points", value=str(error)[:80]) from error
    u, v = spread[faces[:, 1]] - spread[faces[:, 0]], spread[faces[:, 2]] - spread[faces[:, 0]]
    faces = np.where((u[:, 0] * v[:, 1] < u[:, 1] * v[:, 0])[:, None], faces[:, [0, 2, 1]], faces)
    kept = {(min(a, b), max(a, b)) for a, b in chains}
    if kept:
        faces = Mesh(spread, faces).with_edges(kept)
    faces = _cut(spread, faces, kept, longest_m, warnings)
    vertices = nodes + origin
    for array in (vertices, faces):
        freeze(array)
    return Triangulated(vertices, faces, tuple(warnings))


def _cut(plan: Floats, faces: Ints, kept: set[tuple[int, int]], longest_m: float | None, warnings: list[str]) -> Ints:
    """Return faces (m, 3) without those of no area, and those with a side longer than allowed."""
    corners = plan[faces]
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    sides = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    good = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] > 1e-6 * sides.max(axis=1)
    if longest_m is not None:
        ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1), axis=-1)
        long = sides > longest_m
        for at in np.argwhere(long):
            long[tuple(at)] = tuple(ends[tuple(at)].tolist()) not in kept
        good &= ~long.any(axis=1)
        if (~good).any():
            warnings.append(f"{int((~good).sum())} triangles with sides longer than {longest_m:g} m are left out")
    if not good.any():
        raise SiteError("no triangle is left", element="points", allowed="points closer together")
    left: Ints = faces[good]
    return left


def _noded(parts: list[Floats], warnings: list[str]) -> tuple[Floats, list[tuple[int, int]]]:
    """Return different points (n, 3), and the edges of break lines between them, cut at all points on them.

    Args:
        parts: the bare points, then each break line, less the origin.
    """
    lines = [part for part in parts[1:] if len(part) > 1]
    crossings = _crossings(lines, warnings)
    every = np.concatenate([*parts, crossings])
    first, of = joined(every[:, :2], SAME_M)
    top = np.full(len(first), -np.inf)
    np.maximum.at(top, of, every[:, 2])
    low = np.full(len(first), np.inf)
    np.minimum.at(low, of, every[:, 2])
    if (top - low > SAME_HEIGHT_M).any():
        many = int((top - low > SAME_HEIGHT_M).sum())
        most = (top - low).max()
        warnings.append(
            f"{many} places have points of different heights, up to {most:.3f} m apart; the highest count"
        )
    doubled = len(parts[0]) - len(np.unique(of[: len(parts[0])]))
    if doubled:
        warnings.append(f"{doubled} points repeat others in plan and count once")
    nodes = np.column_stack([every[first, :2], top])
    tree = shapely.STRtree([shapely.Point(*place) for place in nodes[:, :2].tolist()])
    edges: list[tuple[int, int]] = []
    begin = len(parts[0])
    for part in parts[1:]:
        ids = of[begin : begin + len(part)]
        begin += len(part)
        for a, b in zip(ids[:-1].tolist(), ids[1:].tolist(), strict=True):
            if a != b:
                edges += _threaded(nodes, tree, a, b)
    return nodes, edges


def _threaded(nodes: Floats, tree: shapely.STRtree, a: int, b: int) -> list[tuple[int, int]]:
    """Return the edge from one node to another, cut at the nodes that lie on it."""
    start, end = nodes[a, :2], nodes[b, :2]
    on = tree.query(shapely.LineString([start, end]), predicate="dwithin", distance=SAME_M)
    d = end - start
    order = np.argsort((nodes[on, :2] - start) @ d, kind="stable")
    inner = [int(k) for k in on[order] if k not in (a, b)]
    chain = [a, *inner, b]
    return list(pairwise(chain))


def _crossings(lines: list[Floats], warnings: list[str]) -> Floats:
    """Return the points (k, 3) where break lines cross, at the height of the first one of each two."""
    starts = np.concatenate([np.empty((0, 3)), *(line[:-1] for line in lines)])
    ends = np.concatenate([np.empty((0, 3)), *(line[1:] for line in lines)])
    if not len(starts):
        return np.empty((0, 3))
    tree = shapely.STRtree([shapely.LineString(leg) for leg in np.stack([starts[:, :2], ends[:, :2]], axis=1)])
    one, other = tree.query(tree.geometries)
    one, other = one[one < other], other[one < other]
    d, f, gap = ends[one] - starts[one], ends[other] - starts[other], starts[other] - starts[one]
    turn = d[:, 0] * f[:, 1] - d[:, 1] * f[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        s = (gap[:, 0] * f[:, 1] - gap[:, 1] * f[:, 0]) / turn
        t = (gap[:, 0] * d[:, 1] - gap[:, 1] * d[:, 0]) / turn
    cut = np.isfinite(s) & (s > 0.0) & (s < 1.0) & (t > 0.0) & (t < 1.0)
    found = starts[one[cut]] + s[cut, None] * d[cut]
    beside = starts[other[cut], 2] + t[cut] * f[cut, 2]
    apart = np.abs(found[:, 2] - beside)
    if len(found) and apart.max() > SAME_HEIGHT_M:
        many = int((apart > SAME_HEIGHT_M).sum())
        most = apart.max()
        warnings.append(
            f"break lines cross at different heights at {many} places, up to {most:.3f} m; the first counts"
        )
    return np.asarray(found, dtype=np.float64)
