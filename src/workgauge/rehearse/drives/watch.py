"""The truth of a drive: the real machine's smallest clearances, looked for wherever they could be smaller."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.proximity.scene import Scene
from workgauge.values.arrays import Floats

#: What a clearance to the machine's own links counts as.
OWN = "self"
#: Within this of a limit, every tick is looked at [m].
NEAR_M = 1.0
#: It sees so much farther than where it looks at every tick, so as to know how long it need not look again [m].
_BEYOND_M = 0.4
#: A closer look between two ticks is worth it for a clearance smaller by more than this [m].
_SAME_M = 1e-6


@dataclass(frozen=True, slots=True)
class Nearest:
    """The smallest true clearance of one link to one kind of limit.

    Attributes:
        kind: a `LimitKind`'s value, or `self`. link: name. limit: id.
        clearance_m: signed. less_stop_m: the smallest clearance less the stop distance that applies; not always of
            the same limit.
    """

    kind: str
    link: str
    limit: str
    clearance_m: float
    less_stop_m: float


def reaches_m(machine: MachineModel) -> Floats:
    """Return an upper bound (n,) of how fast any point of the machine moves per unit speed of each joint [m/rad, 1].

    The sum of all lengths from the joint's axis to the farthest corner of anything it carries, whatever the posture.
    """
    reaches = np.zeros(machine.n)
    for solid in machine.solids:
        farthest = float(np.linalg.norm(solid.T_link_box[:3, 3]) + np.linalg.norm(solid.half_extents))
        if solid.stretch is not None:
            farthest += float(np.abs([machine.q_min[solid.stretch.joint], machine.q_max[solid.stretch.joint]]).max())
        for j in range(solid.link - 1, -1, -1):
            joint = machine.chain[j]
            farthest += float(np.linalg.norm(joint.T_joint_link[:3, 3]))
            if joint.prismatic:
                farthest += float(np.abs([machine.q_min[j], machine.q_max[j]]).max())
            reaches[j] = max(reaches[j], 1.0 if joint.prismatic else farthest)
            farthest += float(np.linalg.norm(joint.T_parent_joint[:3, 3]))
        if solid.stretch is not None:
            reaches[solid.stretch.joint] = max(reaches[solid.stretch.joint], 1.0)
    return reaches


class _Tick(NamedTuple):
    """A tick's way between two looks: postures within it, and lower bounds of what a look in between would find."""

    between: tuple[Floats, ...]
    nearest_m: float
    less_stop_m: float


class Watch:
    """Follows one drive's real machine.

    No point of it moves farther than `reaches_m` says, so a look is needed only where a clearance could have become
    smaller than `near_m` or than the smallest so far. Between the ends of a tick it looks last of all, and only where
    something smaller than all the rest could be.

    Args:
        scene: a scene of its own, asked by nobody else. T_site_machine: true pose (4, 4).
        stop_distance_m: for limits without one of their own, and for the machine's own links.
        q: (n,) at the start. near_m: see above.

    Attributes:
        worst_m: smallest clearance seen. worst_less_stop_m: smallest clearance less the stop distance that applies.
        entered: ids of the limits entered, and `self:<link>`. looks: how often it looked.
    """

    def __init__(
        self, scene: Scene, T_site_machine: Floats, stop_distance_m: float, q: Floats, near_m: float = NEAR_M
    ) -> None:
        self._scene, self._T, self._stop_m = scene, T_site_machine, stop_distance_m
        self._largest_stop_m = max(scene.largest_stop_m, stop_distance_m)
        self._margin_m = near_m + self._largest_stop_m
        self._radius_m = max(self._margin_m + _BEYOND_M, NEAR_M)
        self._reaches = reaches_m(scene.machine)
        self._kinds = [*(limit.kind.value for limit in scene.limits)]
        self._nearest: dict[tuple[str, str], Nearest] = {}
        self._ticks: list[_Tick] = []
        self.entered: set[str] = set()
        self.worst_m, self.worst_less_stop_m = math.inf, math.inf
        self.looks = 0
        self._clear_m, self._way_m = self._look(q), 0.0
        self._q = q

    def moved(self, path: Sequence[Floats]) -> None:
        """Take in a tick's way: the postures (n,) at equal times within it, the last one its end."""
        steps = np.diff([self._q, *path], axis=0)
        ways = np.abs(steps) @ self._reaches
        way = float(ways.sum())
        before = self._clear_m[0] - self._way_m, self._clear_m[1] - self._way_m
        self._q = path[-1]
        self._way_m += way
        nearest, less = before[0] - way, before[1] - way
        far = nearest >= self._margin_m and nearest >= min(self.worst_m, NEAR_M)
        if far and less >= min(self.worst_less_stop_m, NEAR_M - self._largest_stop_m):
            return
        self._clear_m, self._way_m = self._look(self._q), 0.0
        if way > 0.0 and len(path) > 1:
            # In between a clearance is at least what is left if the way uses up both ends' room, and at least the
            # smaller end less what an accelerated point sags below the straight line.
            sag = self._sag_m(steps, ways)
            ends = zip(before, self._clear_m, strict=True)
            bounds = [max(0.5 * (a + b - way), min(a, b) - sag) for a, b in ends]
            self._ticks.append(_Tick(tuple(path[:-1]), *bounds))

    def finish(self) -> None:
        """Look between the ends of those ticks where something smaller could be found than so far."""
        ticks, self._ticks = self._ticks, []
        for one in sorted(ticks, key=lambda one: (one.less_stop_m, one.nearest_m)):
            new = one.nearest_m < self.worst_m - _SAME_M
            if new or one.less_stop_m < self.worst_less_stop_m - _SAME_M:
                for q in one.between:
                    self._look(q)

    def _sag_m(self, steps: Floats, ways: Floats) -> float:
        """Return a bound of acceleration times time squared over eight, for steps (s, n) at equal times."""
        turning = float(ways.max()) * float(np.abs(steps).sum(axis=1).max())
        changing = float((np.abs(np.diff(steps, axis=0)) @ self._reaches).max(initial=0.0))
        return len(steps) ** 2 * (turning + changing) / 8.0

    def found(self) -> tuple[Nearest, ...]:
        """Return the smallest clearances in sight, per kind of limit and link, in a fixed order."""
        return tuple(self._nearest[key] for key in sorted(self._nearest))

    def _look(self, q: Floats) -> tuple[float, float]:
        """Look at a posture; return lower bounds of all clearances and of all clearances less their stop distance."""
        self.looks += 1
        radius = self._radius_m
        found = self._scene.query(self._scene.machine.forward(q), self._T, radius)
        if not len(found):
            return radius, radius - self._largest_stop_m
        own = found.stop_distances
        left = found.distances - np.where(np.isnan(own), self._stop_m, own)
        self.worst_less_stop_m = min(self.worst_less_stop_m, float(left.min()))
        self.worst_m = min(self.worst_m, float(found.distances.min()))
        count = len(self._kinds)
        for i in np.flatnonzero(found.distances < self._margin_m).tolist():
            limit, distance, less = int(found.limits[i]), float(found.distances[i]), float(left[i])
            kind = self._kinds[limit] if limit < count else OWN
            link = found.link_names[int(found.links[i])]
            known = self._nearest.get((kind, link))
            if known is None or distance < known.clearance_m or less < known.less_stop_m:
                nearer = known is None or distance < known.clearance_m
                self._nearest[kind, link] = Nearest(
                    kind,
                    link,
                    found.limit_ids[limit] if nearer or known is None else known.limit,
                    distance if known is None else min(distance, known.clearance_m),
                    less if known is None else min(less, known.less_stop_m),
                )
            if distance < 0.0:
                self.entered.add(found.limit_ids[limit])
        nearest, least = float(found.distances.min()), float(left.min())
        return min(nearest, radius), min(least, radius - self._largest_stop_m)
