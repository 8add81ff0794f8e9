"""Free-floating boxes in place of a machine, makers of limits, and a slow independent distance."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from workgauge.proximity.scene import Scene
from workgauge.values.arrays import frozen
from workgauge.values.limits import Limit, LimitKind, Source
from workgauge.values.solids import Box, Convex, PrismChain, Surface


@dataclass(frozen=True)
class FreeBoxes:
    """The part of a machine that proximity sees, each solid on a link of its own; `kin` is (poses, half extents)."""

    count: int
    self_pairs: tuple = ()
    self_stop_distance_m: float | None = None
    link_names: tuple = field(init=False)
    solids: tuple = field(init=False)

    def __post_init__(self):
        object.__setattr__(self, "link_names", tuple(f"link{i}" for i in range(self.count)))
        solids = (
            SimpleNamespace(link=i, name=f"s{i}", half_extents=(1, 1, 1), stretch=True) for i in range(self.count)
        )
        object.__setattr__(self, "solids", tuple(solids))

    def solid_poses(self, kin):
        return kin


def pose(rotation_vector, position):
    """Pose from a rotation vector and a position."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rotation_vector).as_matrix()
    T[:3, 3] = position
    return T


def box(rotation_vector, position, half):
    return Box(frozen(pose(rotation_vector, position)), frozen(half))


def limit(name, solid, **facts):
    return Limit(name, LimitKind.ZONE, name, solid, "rule", Source("test", name), **facts)


def hull(points):
    """Convex solid around points, wound outwards."""
    points = np.asarray(points, dtype=np.float64)
    found = ConvexHull(points)
    faces = []
    for (i, j, k), equation in zip(found.simplices, found.equations, strict=True):
        outward = np.cross(points[j] - points[i], points[k] - points[i]) @ equation[:3] > 0
        faces.append((i, j, k) if outward else (i, k, j))
    used = np.unique(faces)
    renumber = np.full(len(points), -1)
    renumber[used] = np.arange(len(used))
    return Convex(frozen(points[used]), renumber[np.array(faces)])


def chain_along(path, section, neighbours=None):
    """Chain of prisms with one section along a horizontal or sloping path (n, 3)."""
    path = np.asarray(path, dtype=np.float64)
    along = np.diff(path, axis=0)
    laterals = np.cross([0.0, 0.0, 1.0], along)
    laterals /= np.linalg.norm(laterals, axis=1, keepdims=True)
    count = len(along)
    if neighbours is None:
        neighbours = np.ones((count, 2), dtype=bool)
        neighbours[0, 0] = neighbours[-1, 1] = False
    sections = np.broadcast_to(np.asarray(section, dtype=np.float64), (count, len(section), 2))
    where = np.r_[0.0, np.cumsum(np.linalg.norm(along, axis=1))]
    return PrismChain(
        path[:-1], path[1:], laterals, np.array(sections), np.stack([where[:-1], where[1:]], axis=1), neighbours
    )


def grid_surface(heights, step=1.0, origin=(0.0, 0.0), keep_above=True):
    """Surface over a regular grid of heights (nx, ny)."""
    nx, ny = heights.shape
    x, y = np.meshgrid(origin[0] + step * np.arange(nx), origin[1] + step * np.arange(ny), indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), heights.ravel()], axis=1)
    i = np.arange(nx * ny).reshape(nx, ny)
    a, b, c, d = (
        i[s, t].ravel()
        for s, t in (
            (slice(None, -1), slice(None, -1)),
            (slice(1, None), slice(None, -1)),
            (slice(1, None), slice(1, None)),
            (slice(None, -1), slice(1, None)),
        )
    )
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return Surface(frozen(vertices), faces, keep_above)


def point_triangles(point, triangles):
    """Distances of one point from triangles (m, 3, 3): from the plane where the foot is inside, else the edges."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    best = np.full(len(triangles), np.inf)
    for p, q in ((a, b), (b, c), (c, a)):
        along = q - p
        share = np.clip(np.vecdot(point - p, along) / np.maximum(np.vecdot(along, along), 1e-300), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(p + share[:, None] * along - point, axis=1))
    normal = np.cross(b - a, c - a)
    size = np.vecdot(normal, normal)
    with np.errstate(divide="ignore", invalid="ignore"):
        w = np.vecdot(np.cross(b - a, point - a), normal) / size
        v = np.vecdot(np.cross(point - a, c - a), normal) / size
        height = np.abs(np.vecdot(point - a, normal)) / np.sqrt(size)
    inside = (size > 1e-18) & (v >= 0) & (w >= 0) & (v + w <= 1)
    return np.where(inside, np.minimum(best, height), best)


def signed_distance(first, second):
    """Signed distance of two convex vertex sets: of the origin from the hull of their Minkowski difference."""
    difference = (np.asarray(first)[:, None] - np.asarray(second)[None]).reshape(-1, 3)
    found = ConvexHull(difference)
    if found.equations[:, 3].max() <= 0.0:
        return float(found.equations[:, 3].max())
    return float(point_triangles(np.zeros(3), difference[found.simplices]).min())


def ask(limits, boxes, radius=1e6, self_pairs=(), **facts):
    """Clearances of free boxes from limits (made from bare solids where needed)."""
    limits = [entry if isinstance(entry, Limit) else limit(f"l{i}", entry) for i, entry in enumerate(limits)]
    scene = Scene(FreeBoxes(len(boxes), self_pairs), limits)
    return scene.query(kin_of(boxes), np.eye(4), radius, **facts)


def kin_of(boxes):
    return np.array([b.T_frame_box for b in boxes]), np.array([b.half_extents for b in boxes])


@pytest.fixture(scope="session")
def make():
    """The makers and the oracle of this file."""
    return SimpleNamespace(
        FreeBoxes=FreeBoxes, pose=pose, box=box, limit=limit, hull=hull, chain_along=chain_along,
        grid_surface=grid_surface, point_triangles=point_triangles, signed_distance=signed_distance, ask=ask,
        kin_of=kin_of,
    )  # fmt: skip
