"""A start posture for a machine put down anywhere: arm folded so far that it can turn to what it is driven at."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from workgauge.machine.model import Kinematics, MachineModel
from workgauge.proximity.scene import Scene
from workgauge.values.arrays import Floats, frozen
from workgauge.values.clearances import Clearances

#: How clear of every limit the arm should be when it points at the target, best first [m].
CLEAR_M = (1.2, 0.85, 0.4)

#: How clear of limits and of the machine itself the arm should be anywhere on its way there [m]: not slowed yet.
WAY_CLEAR_M = 0.85

#: Places looked at on the cab's way to the target.
ON_THE_WAY = 6

#: Postures tried.
TRIED = 512

#: One prime for each varied joint.
PRIMES = (2, 3, 5)

#: Arm joints that are varied: those after the first, as many as this.
VARIED = len(PRIMES)

#: Starting turned away from the target by this gives the cab something to turn [rad].
TURNED = (math.radians(50.0), math.radians(-50.0))

#: Where a target is too near to be pointed at, the arm starts turned away from it by one of these [rad].
TURNED_AWAY = tuple(math.radians(angle) for angle in (60.0, -60.0, 90.0, -90.0, 135.0, -135.0, 180.0))


class Asked(Protocol):
    """What is asked for clearances: a scene, or one with tracks let off."""

    @property
    def machine(self) -> MachineModel:
        """The machine among the limits."""
        ...

    def query(self, kin: Kinematics, T_site_machine: Floats, radius_m: float, /) -> Clearances:
        """Return its clearances."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class LetOff:
    """A scene as it is for a machine that is let off some tracks."""

    scene: Scene
    tracks: frozenset[str]

    @property
    def machine(self) -> MachineModel:
        """The machine among the limits."""
        return self.scene.machine

    def query(self, kin: Kinematics, T_site_machine: Floats, radius_m: float, /) -> Clearances:
        """Return its clearances without those tracks."""
        return self.scene.query(kin, T_site_machine, radius_m, let_off=self.tracks)


def clearances(scene: Asked, q: Floats, T_site_machine: Floats, radius_m: float) -> tuple[float, float]:
    """Return the smallest clearance to a limit and between own links [m], `radius_m` if none is nearer."""
    found = scene.query(scene.machine.forward(q), T_site_machine, radius_m)
    outer = found.other_links < 0
    return (
        float(found.distances[outer].min(initial=radius_m)),
        float(found.distances[~outer].min(initial=radius_m)),
    )


def start_posture(scene: Asked, T_site_machine: Floats, target: Floats | None) -> Floats:
    """Return home if the machine is clear there and towards the target, else a posture as like home as may be.

    Args:
        scene: the machine and its limits. T_site_machine: where it stands.
        target: (3,) what it is to be driven at, site frame, or None.

    Returns:
        joint positions (n,); where nothing is clear enough, the clearest of those tried.
    """
    machine, looked = scene.machine, _Looked(scene, T_site_machine)
    home = np.array(machine.home)
    bearing = _bearing(machine, T_site_machine, target)
    arms = _arms(machine)
    for clear in CLEAR_M:
        for arm in arms:
            facing = _turned(machine, arm, bearing)
            if not _reaches(machine, facing, target, T_site_machine) or not looked.clear(facing, clear):
                continue
            for swing in (home[0], *(bearing + turned for turned in TURNED), bearing):
                way = [_turned(machine, arm, s) for s in np.linspace(swing, bearing, 1 + ON_THE_WAY)]
                if all(looked.clear(q, min(clear, WAY_CLEAR_M)) for q in way[:-1]):
                    return frozen(way[0])
    return _clearest(looked, machine, arms, [home[0], *(bearing + turned for turned in TURNED_AWAY)])


class _Looked:
    """Clearances of postures at one place, each looked at once however often it is asked for.

    Args:
        scene: the machine and its limits. T_site_machine: where it stands.
    """

    def __init__(self, scene: Asked, T_site_machine: Floats) -> None:
        self._scene, self._T = scene, T_site_machine
        self._known: dict[bytes, tuple[float, float]] = {}

    def at(self, q: Floats) -> tuple[float, float]:
        """Return the smallest clearance to a limit and between own links at a posture (n,), 1.5 m at most [m]."""
        key = q.tobytes()
        if key not in self._known:
            self._known[key] = clearances(self._scene, q, self._T, 1.5)
        return self._known[key]

    def clear(self, q: Floats, clear: float) -> bool:
        """Return whether a posture is that clear of every limit, and of the machine itself as far as it need be."""
        limit, own = self.at(q)
        return limit >= clear and own >= min(clear, WAY_CLEAR_M)


def _clearest(looked: _Looked, machine: MachineModel, arms: Floats, swings: list[float]) -> Floats:
    """Return the first posture that is clear where it stands, whatever lies on its way, or the clearest of all."""
    best, least = arms[0], -math.inf
    for arm in arms:
        for swing in swings:
            q = _turned(machine, arm, swing)
            left = min(looked.at(q))
            if left > least:
                best, least = q, left
            if left >= WAY_CLEAR_M:
                return frozen(q)
    return frozen(best)


def _arms(machine: MachineModel) -> Floats:
    """Return postures (k, n), home first, then evenly spread arms by their likeness to home."""
    home = np.array(machine.home)
    varied = np.arange(1, min(machine.n, 1 + VARIED))
    if not len(varied):
        return home[None]
    low, high = machine.sample_min[varied], machine.sample_max[varied]
    drawn = spread_evenly(TRIED, len(varied))
    arms = np.tile(home, (TRIED, 1))
    arms[:, varied] = low + (0.05 + 0.9 * drawn) * (high - low)
    unlike = np.linalg.norm((arms[:, varied] - home[varied]) / (high - low), axis=1)
    tools = np.array([machine.tool_pose(machine.forward(q))[2, 3] for q in arms])
    unlike += np.abs(tools - tools_at_work(machine)) / 2.0
    return np.concatenate([home[None], arms[np.argsort(unlike, kind="stable")]])


def spread_evenly(count: int, dimensions: int) -> Floats:
    """Return the first points (count, dimensions) of Halton's sequence in the unit cube, without the origin."""
    out = np.zeros((count, dimensions))
    for j, base in enumerate(PRIMES[:dimensions]):
        left, weight = np.arange(1, count + 1), 1.0 / base
        while left.any():
            out[:, j] += weight * (left % base)
            left, weight = left // base, weight / base
    return out


def tools_at_work(machine: MachineModel) -> float:
    """Return a handy height of the tool centre point above the machine frame [m]: about knee height of a person."""
    return 1.2 - machine.undercarriage.height_m


def _bearing(machine: MachineModel, T_site_machine: Floats, target: Floats | None) -> float:
    """Return the first joint's position at which the tool points at the target, seen from above."""
    if target is None:
        return float(machine.home[0])
    tool = machine.tool_pose(machine.forward(machine.home))[:3, 3]
    aim = T_site_machine[:3, :3].T @ (target - T_site_machine[:3, 3])
    turn = math.atan2(aim[1], aim[0]) - math.atan2(tool[1], tool[0])
    return float(machine.home[0]) + math.atan2(math.sin(turn), math.cos(turn))


def _turned(machine: MachineModel, arm: Floats, swing: float) -> Floats:
    q = np.array(arm)
    q[0] = min(max(swing, machine.q_min[0]), machine.q_max[0])
    return q


def _reaches(machine: MachineModel, q: Floats, target: Floats | None, T_site_machine: Floats) -> bool:
    """Return whether the tool is nearer to the machine than the target, in plan, with room to be driven at it."""
    if target is None:
        return True
    tool = machine.tool_pose(machine.forward(q))[:2, 3]
    aim = (T_site_machine[:3, :3].T @ (target - T_site_machine[:3, 3]))[:2]
    return float(np.linalg.norm(tool)) < float(np.linalg.norm(aim)) - 0.5
