"""What a motion would come near to, before it is made."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from workgauge.motion.paths.trajectory import Trajectory
from workgauge.proximity.scene import Scene
from workgauge.values.arrays import Floats

#: No corner of the machine moves farther between two postures looked at [m].
STEP_M = 0.05
#: Clearances are looked for so far beyond their stop distances [m].
BEYOND_M = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """What stands around the machine, and how near it may come.

    Attributes:
        scene: the limits. T_site_machine: (4, 4). stop_distance_m: of limits without one of their own.
        now_ns, off_states, let_off: as of `Scene.query`.
    """

    scene: Scene
    T_site_machine: Floats
    stop_distance_m: float
    now_ns: int = 0
    off_states: frozenset[str] = frozenset()
    let_off: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Ahead:
    """Where a motion comes nearest to what it may.

    Attributes:
        worst_m: smallest clearance less its stop distance, infinite if nothing is near [m].
        distance_m, stop_m: that clearance, signed, and its stop distance [m]. limit, link: of what to what, or None.
        at: since the motions' beginning [s], NaN for a posture.
        least: limit id to its smallest clearance [m], of what comes within sight; read-only.
    """

    worst_m: float
    distance_m: float
    stop_m: float
    limit: str | None
    link: str | None
    at: float
    least: Mapping[str, float]


def looked_ahead(around: Surroundings, trajectories: Sequence[Trajectory], postures: Sequence[Floats] = ()) -> Ahead:
    """Return where motions, one after the other, and further postures (n,) come nearest to what they may.

    Motions are looked at where no corner has moved by more than `STEP_M` since; what lies in between may be that
    much nearer. Protection levels are not counted.
    """
    worst = Ahead(math.inf, math.inf, math.nan, None, None, math.nan, MappingProxyType({}))
    begun = 0.0
    for trajectory in trajectories:
        times = _moments(trajectory, around.scene.arm.farthest)
        for at, q in zip(times.tolist(), trajectory.many(times)[0], strict=True):
            worst = _nearer(around, q, begun + at, worst)
        begun += trajectory.duration_s
    for q in postures:
        worst = _nearer(around, q, math.nan, worst)
    return worst


def _nearer(around: Surroundings, q: Floats, at: float, worst: Ahead) -> Ahead:
    """Return what is nearest once a posture q (n,) is looked at as well."""
    scene = around.scene
    radius = max(around.stop_distance_m, scene.largest_stop_m) + BEYOND_M
    kin = scene.machine.forward(q)
    found = scene.query(kin, around.T_site_machine, radius, around.now_ns, around.off_states, around.let_off)
    if not len(found):
        return worst
    stops = np.where(np.isnan(found.stop_distances), around.stop_distance_m, found.stop_distances)
    nearest = dict(worst.least)
    for limit, distance in zip(found.limits.tolist(), found.distances.tolist(), strict=True):
        name = found.limit_ids[limit]
        nearest[name] = min(distance, nearest.get(name, math.inf))
    least = MappingProxyType(nearest)
    slack = found.distances - stops
    i = int(np.argmin(slack))
    if slack[i] >= worst.worst_m:
        return replace(worst, least=least)
    return Ahead(
        *(float(slack[i]), float(found.distances[i]), float(stops[i]), found.limit_ids[int(found.limits[i])]),
        *(found.link_names[int(found.links[i])], at, least),
    )


def _moments(trajectory: Trajectory, farthest: Floats) -> Floats:
    """Return times (k,) [s], first and last among them, between which no corner moves by more than `STEP_M`."""
    fine = np.linspace(0.0, trajectory.duration_s, max(int(trajectory.duration_s * 50.0), 2) + 1)
    moved = np.abs(np.diff(trajectory.many(fine)[0], axis=0)) @ farthest
    way = np.concatenate([[0.0], np.cumsum(moved)])
    count = max(math.ceil(float(way[-1]) / STEP_M), 1)
    moments: Floats = np.interp(np.linspace(0.0, float(way[-1]), count + 1), way, fine)
    return moments
