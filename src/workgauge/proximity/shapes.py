"""The one importer of coal: collision shapes built when first needed, and exact signed distances between them."""

from collections.abc import Sequence
from typing import Any

import coal
import numpy as np

from workgauge.proximity.cells import frames_along
from workgauge.values.arrays import Floats, Ints
from workgauge.values.limits import Limit
from workgauge.values.solids import Box, Convex, PrismChain, Surface, Tube

#: A shape and its pose in the site frame, as coal holds them.
Placed = tuple[Any, Any]


def distance_request() -> Any:
    """Return coal's settings: errors below 1e-6 m even for touching, nearly parallel faces; no warm start."""
    request = coal.DistanceRequest()
    request.gjk_tolerance = request.epa_tolerance = 1e-12
    request.gjk_max_iterations = request.epa_max_iterations = 256
    request.gjk_initial_guess = coal.GJKInitialGuess.DefaultGuess
    return request


REQUEST = distance_request()


def transform(R: Floats, position: Floats) -> Any:
    """Return coal's form of a pose."""
    return coal.Transform3s(R, position)


def box_shapes(halves: Floats) -> list[Any]:
    """Return a coal box for every row of half extents (m, 3)."""
    return [coal.Box(*size) for size in (2.0 * halves).tolist()]


def placed_cell(limit: Limit, cell: int) -> Placed:
    """Return the coal shape of one cell of a limit; its own origin is near its middle."""
    solid = limit.solid
    match solid:
        case Box():
            T = solid.T_frame_box
            return coal.Box(*(2.0 * solid.half_extents).tolist()), coal.Transform3s(T[:3, :3], T[:3, 3])
        case Convex():
            return _placed_convex(solid.vertices, solid.faces)
        case PrismChain():
            return _placed_convex(solid.cell_vertices(cell), prism_faces(solid.sections.shape[1]))
        case Tube():
            start, end = solid.axis[cell], solid.axis[cell + 1]
            frame = frames_along((end - start)[None])[0]
            R = frame[:, [1, 2, 0]]  # a capsule lies along its z axis
            shape = coal.Capsule(solid.radius, float(np.linalg.norm(end - start)))
            return shape, coal.Transform3s(R, 0.5 * (start + end))
        case Surface():
            raise TypeError("a surface has no cells")


def prism_faces(sides: int) -> Ints:
    """Return outward triangles of a prism whose vertices are its start polygon, then its end polygon.

    The polygons run counter-clockwise about the direction from start to end.
    """
    fan = np.arange(1, sides - 1)
    zero = np.zeros_like(fan)
    here = np.arange(sides)
    following = (here + 1) % sides
    return np.concatenate(
        [
            np.stack([zero, fan + 1, fan], axis=1),
            np.stack([zero, fan, fan + 1], axis=1) + sides,
            np.stack([here, following, following + sides], axis=1),
            np.stack([here, following + sides, here + sides], axis=1),
        ]
    )


def _placed_convex(vertices: Floats, faces: Ints) -> Placed:
    middle = vertices.mean(axis=0)
    points = coal.StdVec_Vec3s()
    points.extend(list(vertices - middle))
    triangles = coal.StdVec_Triangle()
    triangles.extend([coal.Triangle(*face) for face in np.asarray(faces).tolist()])
    return coal.Convex(points, triangles), coal.Transform3s(np.eye(3), middle)


def placed_mesh(vertices: Floats, faces: Ints) -> Placed:
    """Return a triangle mesh with its bounding-volume hierarchy."""
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(faces), len(vertices))
    mesh.addVertices(np.ascontiguousarray(vertices))
    mesh.addTriangles(np.ascontiguousarray(faces, dtype=np.int64))
    mesh.endModel()
    return mesh, coal.Transform3s(np.eye(3), np.zeros(3))


#: At and below this distance coal is less sure of solids with faces, and `overlap` decides [m].
TOUCHING_M = 2e-5


def measure(first: Placed, second: Placed, result: Any) -> float:
    """Return the distance of two convex shapes, to be believed only above `TOUCHING_M`.

    For a capsule that bound is meant for its axis: its radius is taken off afterwards.
    """
    result.clear()
    distance: float = coal.distance(first[0], first[1], second[0], second[1], REQUEST, result)
    return distance


def direction_and_point(result: Any) -> tuple[Floats, Floats]:
    """Return the unit normal from the first to the second shape measured last, and the second's nearest point."""
    return result.normal.copy(), result.getNearestPoint2()  # coal hands out a view of the first, a copy of the other


def measure_mesh(
    mesh: Placed, convex: Placed, within: float, result: Any
) -> tuple[float, Floats, Floats, int] | None:
    """Return the distance from a mesh to a convex shape, the points on both, and the triangle.

    None if nothing lies nearer than `within` [m], which spares the search of anything farther away.
    """
    result.clear()
    result.min_distance = within
    distance = coal.distance(mesh[0], mesh[1], convex[0], convex[1], REQUEST, result)
    if result.b1 < 0 or distance >= within:
        return None
    return distance, result.getNearestPoint1(), result.getNearestPoint2(), result.b1


def point_shape(points: Sequence[float] | Floats) -> Placed:
    """Return a single point as a shape."""
    return coal.Sphere(0.0), coal.Transform3s(np.eye(3), np.asarray(points, dtype=np.float64))


def new_result() -> Any:
    """Return a result to be filled by `measure`; made anew for each query, so that nothing is carried over."""
    return coal.DistanceResult()
