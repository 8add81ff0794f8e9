"""Upright solids, tubes and one-sided surfaces in the local site frame; each contains what it stands for."""

import math

import numpy as np

from workgauge.gauge.chain import LEAST_PAD
from workgauge.site.model import SurfaceModel
from workgauge.values.arrays import Floats, freeze, frozen, frozen_ints
from workgauge.values.solids import Box, Convex, PrismChain, Surface, Tube

#: Sides of the prism round a cylinder; it stands out by r (1/cos(π/n) − 1), 0.9 % of the radius.
CYLINDER_SIDES = 24


def cylinder(foot: Floats, radius: float, height: float) -> Convex:
    """Return the upright prism round a cylinder of `radius` and `height` [m] on `foot` (3,)."""
    turn = 2 * math.pi * (np.arange(CYLINDER_SIDES) + 0.5) / CYLINDER_SIDES
    around = (radius + LEAST_PAD) / math.cos(math.pi / CYLINDER_SIDES)
    ring = foot[:2] + around * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    return prism(ring, float(foot[2]) - LEAST_PAD, float(foot[2]) + height + LEAST_PAD)


def prism(ring: Floats, bottom: float, top: float) -> Convex:
    """Return the upright prism over a convex ring (k, 2), in either sense, between two heights [m]."""
    following = np.roll(ring, -1, axis=0)
    if float(np.sum(ring[:, 0] * following[:, 1] - ring[:, 1] * following[:, 0])) < 0:
        ring = ring[::-1]
    k = len(ring)
    vertices = np.concatenate([np.column_stack([ring, np.full(k, z)]) for z in (bottom, top)])
    return Convex(frozen(vertices), frozen_ints(prism_faces(k)))


def prism_faces(k: int) -> list[list[int]]:
    """Return outward triangles of a prism whose first k vertices are the counter-clockwise bottom ring."""
    faces = []
    for i in range(k):
        j = (i + 1) % k
        faces += [[i, j, k + j], [i, k + j, k + i]]
    for i in range(1, k - 1):
        faces += [[0, i + 1, i], [k, k + i, k + i + 1]]
    return faces


def upright_box(centre: Floats, length: float, width: float, height: float, heading: float) -> Box:
    """Return an upright box; `length` along the heading (clockwise from grid north [rad]), centre (3,)."""
    s, c = math.sin(heading), math.cos(heading)
    T = np.eye(4)
    T[:3, 0], T[:3, 1], T[:3, 3] = (s, c, 0.0), (-c, s, 0.0), centre
    half = np.array([length, width, height]) / 2
    return Box(frozen(T), frozen(half))


def tube(axis: Floats, radius: float) -> Tube:
    """Return the capsules of `radius` [m] round a polyline (n, 3)."""
    return Tube(frozen(distinct(axis)), radius)


def distinct(points: Floats, apart: float = 1e-6) -> Floats:
    """Return a polyline (n, 3) without points repeated in a row; n >= 2 always."""
    keep = np.concatenate([[True], np.linalg.norm(np.diff(points, axis=0), axis=1) > apart])
    kept = points[keep]
    return kept if len(kept) > 1 else np.stack([points[0], points[0] + np.array([0.0, 0.0, 10 * apart])])


def one_sided(surface: SurfaceModel, origin: Floats, keep_above: bool) -> Surface:
    """Return a site surface in the local frame, wound so that the normals point up; faces without plan area go."""
    vertices = surface.vertices - origin
    a, b, c = (vertices[surface.faces[:, i], :2] for i in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    faces = np.where((area < 0)[:, None], surface.faces[:, ::-1], surface.faces)[area != 0]
    return Surface(frozen(vertices), frozen_ints(faces), keep_above)


def wire_chain(axis: Floats, below: float, side: float, above: float) -> PrismChain:
    """Return the no-go region round a wire: `below`, `above` it and `side` to each side in plan [m].

    One upright prism per span of the polyline `axis` (n, 3), sheared by the span's slope. At a bend and at the ends
    the prisms reach on far enough to hold every point within `side` of the wire in plan; a cell reaches lower and
    higher by its slope times that reach. Spans without length in plan are joined to the next.
    """
    points = distinct(axis)
    plan = np.concatenate([[True], np.hypot(*np.diff(points[:, :2], axis=0).T) > 1e-4])
    low, high = _column_heights(points, plan)
    points = points[plan]
    if len(points) < 2:
        points = np.stack([points[0], points[0] + np.array([1e-3, 0.0, 0.0])])
        low, high = np.repeat(low[:1], 2), np.repeat(high[:1], 2)
    span = np.diff(points, axis=0)
    length = np.hypot(span[:, 0], span[:, 1])
    forward = span / length[:, None]
    bend = np.abs(np.arctan2(_cross(forward[:-1], forward[1:]), np.sum(forward[:-1, :2] * forward[1:, :2], axis=1)))
    joint = side * np.tan(np.minimum(bend, math.pi / 2) / 2)
    reach = np.concatenate([[side], joint, [side]]) + LEAST_PAD
    starts, ends = points[:-1] - forward * reach[:-1, None], points[1:] + forward * reach[1:, None]
    tilt = np.abs(forward[:, 2]) * np.maximum(reach[:-1], reach[1:]) + LEAST_PAD
    bottom = -below - tilt - np.maximum(low[:-1], low[1:])
    top = above + tilt + np.maximum(high[:-1], high[1:])
    wide = np.full(len(length), side + LEAST_PAD)
    corners = [[-wide, bottom], [wide, bottom], [wide, top], [-wide, top]]
    sections = np.stack([np.stack(corner, axis=-1) for corner in corners], axis=1)
    laterals = np.stack([-forward[:, 1], forward[:, 0], np.zeros(len(length))], axis=-1)
    along = np.concatenate([[0.0], np.cumsum(length)])
    neighbours = np.ones((len(length), 2), dtype=np.bool_)
    neighbours[0, 0] = neighbours[-1, 1] = False
    chainages = np.stack([along[:-1], along[1:]], axis=-1)
    for array in (starts, ends, laterals, sections, chainages, neighbours):
        freeze(array)
    return PrismChain(starts, ends, laterals, sections, chainages, neighbours)


def _cross(a: Floats, b: Floats) -> Floats:
    """Return the up component of a × b for horizontal parts."""
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _column_heights(points: Floats, kept: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> tuple[Floats, Floats]:
    """Return how far below and above each kept point the points dropped after it lie [m]."""
    owner = np.cumsum(kept) - 1
    gap = points[:, 2] - points[kept][owner, 2]
    low, high = np.zeros(int(kept.sum())), np.zeros(int(kept.sum()))
    np.maximum.at(low, owner, -gap)
    np.maximum.at(high, owner, gap)
    return low, high
