"""Geometric truth: the real clearance of the real posture at every substep, whatever the program believes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.proximity.scene import Scene
from workgauge.rehearse.result import Entry, Snapshot
from workgauge.values.arrays import Floats
from workgauge.values.clearances import Clearance, Clearances
from workgauge.values.errors import ScenarioError
from workgauge.values.limits import Limit


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """The truth at one moment.

    Attributes:
        t_s: when [s].
        limit: the nearest limit; own: the machine's own nearest pair; None if none was in sight.
        by_limit: smallest signed clearance to each limit in sight [m].
        found: all clearances in sight.
    """

    t_s: float
    limit: Clearance | None
    own: Clearance | None
    by_limit: Mapping[str, float]
    found: Clearances


@dataclass(slots=True)
class _Inside:
    """An interval below zero that is still open."""

    link: str
    start_s: float
    end_s: float
    depth_m: float
    own_motion: bool


class GeometricTruth:
    """Keeps watch over the true clearances of a run.

    An entry is a contiguous interval of true signed clearance below zero caused by own motion: the limit counted
    already at the check before, and the machine was not inside it then.

    Args:
        machine: the machine. limits: all limits that count for it.
        radius_m: how far it looks; nothing is said of what is farther away.
    """

    def __init__(self, machine: MachineModel, limits: Sequence[Limit], radius_m: float) -> None:
        self.machine = machine
        self.radius_m = radius_m
        self._scene = Scene(machine, limits)
        self._limits = {limit.id: limit for limit in limits}
        self._open: dict[str, _Inside] = {}
        self._closed: list[tuple[str, _Inside]] = []
        self._checked_ns: int | None = None
        self._checked_off: frozenset[str] = frozenset()
        self._checked_let_off: frozenset[str] = frozenset()
        self.nearest: Reading | None = None
        self.nearest_own: Reading | None = None
        self.nearest_snapshot: Snapshot | None = None

    def look(
        self,
        now_ns: int,
        q: Floats,
        T_site_machine: Floats,
        off_states: frozenset[str] = frozenset(),
        let_off: frozenset[str] = frozenset(),
    ) -> Reading:
        """Return the truth at a posture without keeping anything."""
        kin = self.machine.forward(q)
        found = self._scene.query(kin, T_site_machine, self.radius_m, now_ns, off_states, let_off)
        return _reading(now_ns, found)[0]

    def check(
        self,
        now_ns: int,
        q: Floats,
        T_site_machine: Floats,
        off_states: frozenset[str] = frozenset(),
        let_off: frozenset[str] = frozenset(),
    ) -> Reading:
        """Take in the truth at `now_ns`, with the work states off and the tracks let off then, and return it."""
        kin = self.machine.forward(q)
        found = self._scene.query(kin, T_site_machine, self.radius_m, now_ns, off_states, let_off)
        reading, inside = _reading(now_ns, found)
        self._follow(now_ns, inside)
        if reading.limit is not None and (
            self.nearest is None
            or self.nearest.limit is None
            or reading.limit.distance_m < self.nearest.limit.distance_m
        ):
            self.nearest = reading
            self.nearest_snapshot = snapshot(self.machine, reading, q, T_site_machine)
        if reading.own is not None and (
            self.nearest_own is None
            or self.nearest_own.own is None
            or reading.own.distance_m < self.nearest_own.own.distance_m
        ):
            self.nearest_own = reading
        self._checked_ns, self._checked_off, self._checked_let_off = now_ns, off_states, let_off
        return reading

    def _follow(self, now_ns: int, inside: dict[str, Clearance]) -> None:
        """Open, deepen and close the intervals below zero."""
        t_s = now_ns * 1e-9
        for limit in [limit for limit in self._open if limit not in inside]:
            self._closed.append((limit, self._open.pop(limit)))
        for limit, clearance in inside.items():
            depth, current = -clearance.distance_m, self._open.get(limit)
            if current is None:
                before = self._checked_ns
                known = self._limits.get(limit)
                own = before is not None and (
                    known is None or known.counts(before, self._checked_off, self._checked_let_off)
                )
                self._open[limit] = _Inside(clearance.link, t_s, t_s, depth, own)
            else:
                current.end_s = t_s
                if depth > current.depth_m:
                    current.depth_m, current.link = depth, clearance.link

    def entries(self) -> tuple[Entry, ...]:
        """Return all entries so far, into limits and into own links, by their beginning."""
        found = [
            Entry(limit, one.link, one.start_s, one.end_s, one.depth_m)
            for limit, one in (*self._closed, *self._open.items())
            if one.own_motion
        ]
        return tuple(sorted(found, key=lambda entry: (entry.start_s, entry.limit)))


def _reading(now_ns: int, found: Clearances) -> tuple[Reading, dict[str, Clearance]]:
    """Return the nearest of both kinds, and the deepest clearance of every limit the machine is inside of."""
    outer, own = found.other_links < 0, found.other_links >= 0
    by_limit: dict[str, float] = {}
    for k, distance in zip(found.limits[outer].tolist(), found.distances[outer].tolist(), strict=True):
        limit = found.limit_ids[k]
        by_limit[limit] = min(distance, by_limit.get(limit, distance))
    inside: dict[str, Clearance] = {}
    for i in np.flatnonzero(found.distances < 0):
        clearance = found[int(i)]
        known = inside.get(clearance.limit)
        if known is None or clearance.distance_m < known.distance_m:
            inside[clearance.limit] = clearance

    def least(which: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> Clearance | None:
        rows = np.flatnonzero(which)
        return found[int(rows[np.argmin(found.distances[rows])])] if len(rows) else None

    return Reading(now_ns * 1e-9, least(outer), least(own), by_limit, found), inside


def refuse_inside(reading: Reading, name_of: Callable[[str], str], words: str) -> None:
    """Refuse a start inside a limit or with links in each other.

    Args:
        reading: the truth at the start. name_of: what people call a limit. words: where the machine stands.

    Raises:
        ScenarioError: if it is one.
    """
    for found in (reading.limit, reading.own):
        if found is not None and found.distance_m < 0:
            own = found.limit.startswith("self:")
            name = f"its own {found.limit.removeprefix('self:')}" if own else name_of(found.limit)
            raise ScenarioError(
                f"the machine starts inside {name} ({found.limit}): its {found.link} is "
                f"{-found.distance_m:.3f} m deep",
                element="start",
                value=words,
                allowed="a place and posture outside every limit",
            )


def snapshot(machine: MachineModel, reading: Reading, q: Floats, T_site_machine: Floats) -> Snapshot:
    """Return the machine's boxes and closest pair in the site's local frame."""
    kin = machine.forward(q)
    poses, halves = machine.solid_poses(kin)
    near = reading.limit
    return Snapshot(
        t_s=reading.t_s,
        T_site_boxes=T_site_machine @ poses,
        half_extents=halves,
        names=tuple(solid.name for solid in machine.solids),
        tool=(T_site_machine @ machine.tool_pose(kin))[:3, 3],
        point_machine=None if near is None else near.point_machine,
        point_limit=None if near is None else near.point_limit,
        clearance_m=None if near is None else near.distance_m,
        limit=None if near is None else near.limit,
    )
