"""Limits drawn at random round a machine: boxes, bodies, wires, pipes, track envelopes, a floor."""

import math
from collections.abc import Callable

import numpy as np
from scipy.spatial import ConvexHull

from workgauge.machine.model import MachineModel
from workgauge.values.arrays import Floats, frozen, frozen_ints
from workgauge.values.limits import Limit, LimitKind, Source
from workgauge.values.solids import Box, Convex, PrismChain, Solid, Surface, Tube
from workgauge.values.transforms import rpy

#: Shares of random places with a track envelope, with a wire, and with a floor.
WITH_ENVELOPE, WITH_WIRE, WITH_FLOOR = 0.7, 0.6, 0.4
#: Share of limits with a stop distance of their own, and from where to where that lies [m].
WITH_OWN_STOP, OWN_STOP_M = 0.25, (0.05, 0.4)
#: The arm's reach of the machine for which sizes are as on a railway [m].
PLAIN_REACH_M = 8.0

_Rng = np.random.Generator
#: Left half of a track envelope (left, up) [m], from below.
_HALF_SECTION = np.array([[1.6, 0.1], [1.9, 0.6], [1.9, 3.6], [1.0, 4.6]])


def arm_reach_m(machine: MachineModel) -> float:
    """Return how far from its origin in plan the tool gets, over a fixed sample of postures [m]."""
    postures = np.random.default_rng(0).uniform(machine.sample_min, machine.sample_max, (200, machine.n))
    tools = [machine.tool_pose(machine.forward(q))[:3, 3] for q in postures]
    return max(math.hypot(float(x), float(y)) for x, y, _ in tools)


def clutter(rng: _Rng, machine: MachineModel) -> tuple[Limit, ...]:
    """Return random limits round a machine that stands in the frame's origin, sized to its reach.

    None is checked for being clear of the machine.
    """
    reach = arm_reach_m(machine)
    size = reach / PLAIN_REACH_M
    made: list[tuple[LimitKind, Solid]] = []
    if rng.random() < WITH_ENVELOPE:
        made.append((LimitKind.TRACK, envelope(rng, reach, size)))
    if rng.random() < WITH_WIRE:
        made.append((LimitKind.OVERHEAD_LINE, _wire(rng, reach, size)))
    if rng.random() < WITH_FLOOR:
        made.append((LimitKind.SURFACE, _floor(rng, reach)))
    kinds: tuple[tuple[LimitKind, Callable[[_Rng, float, float], Solid]], ...] = (
        (LimitKind.ZONE, _box),
        (LimitKind.POINT, pole),
        (LimitKind.ZONE, _body),
        (LimitKind.LINE, _pipe),
    )
    for _ in range(int(rng.integers(3, 9))):
        kind, make = kinds[int(rng.integers(len(kinds)))]
        made.append((kind, make(rng, reach, size)))
    return tuple(_limit(rng, i, kind, solid, machine) for i, (kind, solid) in enumerate(made))


def _limit(rng: _Rng, i: int, kind: LimitKind, solid: Solid, machine: MachineModel) -> Limit:
    own = float(rng.uniform(*OWN_STOP_M)) if rng.random() < WITH_OWN_STOP else None
    exempt = frozenset({machine.link_names[0]}) if kind is LimitKind.SURFACE else frozenset[str]()
    name = f"{kind.value} {i}"
    source = Source("drawn at random", name)
    return Limit(name, kind, name, solid, "random", source, stop_distance_m=own, exempt_links=exempt)


def _somewhere(rng: _Rng, reach: float, low: float, high: float) -> Floats:
    """Return a point (3,) round the machine, its height between two shares of the reach [m]."""
    angle, away = rng.uniform(-math.pi, math.pi), reach * rng.uniform(0.35, 1.15)
    return np.array([away * math.cos(angle), away * math.sin(angle), reach * rng.uniform(low, high)])


def _box(rng: _Rng, reach: float, size: float) -> Solid:
    roll, pitch, yaw = rng.uniform(-math.pi, math.pi, 3).tolist()
    T = rpy(roll, pitch, yaw)
    T[:3, 3] = _somewhere(rng, reach, 0.0, 0.7)
    return Box(frozen(T), frozen(size * rng.uniform(0.1, 1.0, 3)))


def pole(rng: _Rng, reach: float, size: float) -> Solid:
    """Return a pole somewhere round a machine of that reach [m]; size: beside the plain one."""
    roll, pitch, yaw = (rng.uniform(-1.0, 1.0, 3) * (0.05, 0.05, math.pi)).tolist()
    T = rpy(roll, pitch, yaw)
    T[:3, 3] = _somewhere(rng, reach, 0.3, 0.5)
    return Box(frozen(T), frozen(np.array([*(size * rng.uniform(0.1, 0.3, 2)), reach])))


def _body(rng: _Rng, reach: float, size: float) -> Solid:
    points = _somewhere(rng, reach, 0.0, 0.7) + size * rng.uniform(0.3, 1.2) * rng.normal(size=(14, 3))
    hull = ConvexHull(points)
    kept = np.unique(hull.simplices)
    faces = np.searchsorted(kept, hull.simplices)
    vertices = points[kept]
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    return Convex(frozen(vertices), frozen_ints(np.where(inwards[:, None], faces[:, ::-1], faces)))


def _pipe(rng: _Rng, reach: float, size: float) -> Solid:
    start = _somewhere(rng, reach, -0.05, 0.5)
    steps = size * rng.normal(scale=(2.0, 2.0, 0.5), size=(int(rng.integers(1, 5)), 3))
    return Tube(
        frozen(np.concatenate([[start], start + np.cumsum(steps, axis=0)])), float(size * rng.uniform(0.05, 0.4))
    )


def _wire(rng: _Rng, reach: float, size: float) -> Solid:
    along = np.linspace(-2.0, 2.0, 5) * reach
    x, y = _beside(rng, reach, along, 0.0, 0.6)
    height = reach * rng.uniform(0.65, 1.0) + 0.004 * along * along / size
    return Tube(frozen(np.column_stack([x, y, height])), float(size * rng.uniform(0.02, 0.3)))


def envelope(rng: _Rng, reach: float, size: float) -> Solid:
    """Return a track envelope past a machine of that reach [m], in cells; size: beside the plain one."""
    nodes = np.linspace(-2.5, 2.5, 13) * reach
    x, y = _beside(rng, reach, nodes, 0.45, 0.8)
    axis = np.column_stack([x, y, rng.uniform(-0.02, 0.02) * nodes])
    starts, ends = axis[:-1], axis[1:]
    run = ends - starts
    laterals = np.column_stack([-run[:, 1], run[:, 0], np.zeros(len(run))])
    laterals /= np.linalg.norm(laterals, axis=1)[:, None]
    half = size * _HALF_SECTION * rng.uniform(0.8, 1.1)
    section = np.concatenate([half * [-1.0, 1.0], half[::-1]])
    if _area(section) < 0.0:
        section = section[::-1]
    neighbours = np.ones((len(starts), 2), dtype=np.bool_)
    neighbours[0, 0] = neighbours[-1, 1] = False
    sections = frozen(np.repeat(section[None], len(starts), axis=0))
    chainages = frozen(np.column_stack([nodes[:-1], nodes[1:]]) - nodes[0])
    return PrismChain(frozen(starts), frozen(ends), frozen(laterals), sections, chainages, neighbours)


def _floor(rng: _Rng, reach: float) -> Solid:
    across = 3.0 * reach * np.linspace(-1.0, 1.0, 7)
    x, y = np.meshgrid(across, across)
    z = -reach * rng.uniform(0.05, 0.2) + rng.uniform(-0.04, 0.04) * x + rng.uniform(-0.04, 0.04) * y
    z = z + 0.01 * reach * rng.normal(size=z.shape)
    corner = np.arange(36) // 6 * 7 + np.arange(36) % 6
    faces = np.concatenate(
        [np.column_stack([corner, corner + 1, corner + 8]), np.column_stack([corner, corner + 8, corner + 7])]
    )
    return Surface(frozen(np.column_stack([x.ravel(), y.ravel(), z.ravel()])), frozen_ints(faces))


def _beside(rng: _Rng, reach: float, along: Floats, nearest: float, farthest: float) -> tuple[Floats, Floats]:
    """Return points (x, y) of a line in plan that passes the machine, straight in half of the cases, else bent."""
    angle, aside = rng.uniform(-math.pi, math.pi), reach * rng.uniform(nearest, farthest)
    bend = 0.0 if rng.random() < 0.5 else rng.uniform(-1.0, 1.0) / (30.0 * reach)
    across = aside + bend * along * along
    return along * math.cos(angle) - across * math.sin(angle), along * math.sin(angle) + across * math.cos(angle)


def _area(ring: Floats) -> float:
    following = np.roll(ring, -1, axis=0)
    return float(np.sum(ring[:, 0] * following[:, 1] - ring[:, 1] * following[:, 0]))
