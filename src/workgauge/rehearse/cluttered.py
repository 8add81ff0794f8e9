"""Random cluttered scenes with something to do in them: poles, a track envelope, a wagon; from here to there."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.proximity.scene import Scene
from workgauge.rehearse.drives.clutter import PLAIN_REACH_M, arm_reach_m, envelope, pole
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import ScenarioError
from workgauge.values.limits import Limit, LimitKind, Source
from workgauge.values.solids import Box, Solid
from workgauge.values.transforms import rpy

#: Poles in a scene, least and most.
POLES = (2, 5)
#: Half length, width and height of the wagon's body, and the height of its floor, for a machine of plain reach [m].
WAGON_HALF_M, WAGON_FLOOR_M = (4.0, 1.4, 0.6), 1.1
#: The wagon's middle is this share of the reach away, sideways and along its own track.
WAGON_ASIDE, WAGON_ALONG = (0.45, 0.75), (-0.5, 0.5)
#: The tool begins and ends between these heights, in shares of the reach, and that far apart.
TOOL_HEIGHT, TOOL_TRAVEL = (-0.1, 0.55), 0.5
#: Start and goal have this much room beyond the stop distance; links among themselves less [m].
ROOM_M, OWN_ROOM_M = 0.25, 0.1
_SCENES, _DRAWS, _POSTURES = 40, 40, 200


@dataclass(frozen=True, eq=False)
class Cluttered:
    """A machine among limits, where it begins and where it is to end.

    Attributes:
        seed: what it was drawn as. scene: the limits. T_site_machine: (4, 4).
        q_start: (n,). q_goal: (n,) a posture clear of everything that has the tool where it is wanted.
        T_site_tool: (4, 4) the tool's pose there.
    """

    seed: int
    scene: Scene
    T_site_machine: Floats
    q_start: Floats
    q_goal: Floats
    T_site_tool: Floats


def cluttered(machine: MachineModel, seed: int, *, stop_distance_m: float) -> Cluttered:
    """Return the cluttered scene of a seed, sized to the machine's reach.

    Start and goal are clear of every limit and of the machine itself; whether a way leads from one to the other is
    not known.

    Args:
        machine: what stands there. seed: settles everything. stop_distance_m: of limits without one of their own.

    Raises:
        ScenarioError: if no scene with room for a start and a goal is found.
    """
    rng = np.random.default_rng((seed, machine.n))
    reach = arm_reach_m(machine)
    for _ in range(_SCENES):
        T = rpy(*(rng.uniform(-1.0, 1.0, 3) * (0.05, 0.05, math.pi)).tolist())
        scene = Scene(machine, _limits(rng, machine, T, reach, stop_distance_m))
        ends = _ends(rng, scene, T, reach, stop_distance_m)
        if ends is not None:
            q_start, q_goal = ends
            tool = T @ machine.tool_pose(machine.forward(q_goal))
            return Cluttered(seed, scene, frozen(T), frozen(q_start), frozen(q_goal), frozen(tool))
    raise ScenarioError("no room for a start and a goal", element="cluttered scene", value=f"{_SCENES} scenes tried")


def _limits(
    rng: np.random.Generator, machine: MachineModel, T: Floats, reach: float, stop_distance_m: float
) -> list[Limit]:
    """Return limits none of which the undercarriage is too near to."""
    size = reach / PLAIN_REACH_M
    makes: list[tuple[LimitKind, str, Callable[[np.random.Generator, float, float], Solid]]] = [
        (LimitKind.TRACK, "track", envelope),
        (LimitKind.ZONE, "wagon", _wagon),
    ]
    makes += [(LimitKind.POINT, f"pole {i}", pole) for i in range(int(rng.integers(POLES[0], POLES[1] + 1)))]
    limits = []
    for kind, name, make in makes:
        for _ in range(_DRAWS):
            limit = Limit(name, kind, name, make(rng, reach, size), "random", Source("drawn at random", name))
            found = Scene(machine, [limit]).query(machine.forward(machine.home), T, stop_distance_m + ROOM_M)
            if not ((found.links == 0) & (found.other_links < 0)).any():
                limits.append(limit)
                break
    return limits


def _wagon(rng: np.random.Generator, reach: float, size: float) -> Solid:
    angle, aside, along = rng.uniform(-math.pi, math.pi), rng.uniform(*WAGON_ASIDE), rng.uniform(*WAGON_ALONG)
    half = size * np.array(WAGON_HALF_M)
    T = rpy(0.0, 0.0, float(angle))
    T[:3, 3] = reach * (along * T[:3, 0] + aside * T[:3, 1])
    T[2, 3] = size * WAGON_FLOOR_M + half[2]
    return Box(frozen(T), frozen(half))


def _ends(
    rng: np.random.Generator, scene: Scene, T: Floats, reach: float, stop_distance_m: float
) -> tuple[Floats, Floats] | None:
    """Return two clear postures whose tools are well apart, or None if there are none among the postures tried."""
    machine = scene.machine
    start: tuple[Floats, Floats] | None = None
    for _ in range(_POSTURES):
        q = rng.uniform(machine.sample_min, machine.sample_max)
        kin = machine.forward(q)
        tool = (T @ machine.tool_pose(kin))[:3, 3]
        if not TOOL_HEIGHT[0] * reach <= tool[2] <= TOOL_HEIGHT[1] * reach:
            continue
        if start is not None and float(np.linalg.norm(tool - start[1])) < TOOL_TRAVEL * reach:
            continue
        found = scene.query(kin, T, stop_distance_m + ROOM_M)
        own = found.other_links >= 0
        stops = np.where(np.isnan(found.stop_distances), stop_distance_m, found.stop_distances)
        if (found.distances < stops + np.where(own, OWN_ROOM_M, ROOM_M)).any():
            continue
        if start is not None:
            return start[0], q
        start = q, tool
    return None
