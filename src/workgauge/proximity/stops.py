"""Every clearance along a predicted stop: which pairs may matter, and how much slack each has at each posture."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workgauge.proximity.corners import reached
from workgauge.proximity.nearby import gather, near_way, paired, placed
from workgauge.proximity.protection import link_turns, second_order
from workgauge.proximity.surroundings import Surroundings
from workgauge.proximity.sweep import bounds, emit, shortfall
from workgauge.proximity.uncertainty import own_place
from workgauge.values.arrays import Floats, Ints
from workgauge.values.clearances import Clearances
from workgauge.values.compiled import njit

#: Twists, places and whether they move, of limits of which none does.
_STILL = np.empty((0, 6)), np.empty((0, 3)), np.empty(0, np.bool_)
#: Where there is nothing to add.
_NOTHING = np.empty(0)


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """Postures on the way to rest, and how surely they are known.

    Attributes:
        postures: (P, n) middles of where the joints may be. widths: (P, n) half of how far those intervals reach.
        times: (P,) from now [s].
    """

    postures: Floats
    widths: Floats
    times: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Corners of the machine's solids that have little slack somewhere on the way.

    Attributes:
        slack: (r,) what is left above the stop distance [m]. room: (r,) what of it may be lost: all, or what a corner
            has more than the deepest of its solid, if that has less than none. rows: (r, n), d(slack)/d(joint) of the
            middle posture.
        postures: (r,) which of the way's. clearances: (r,) which clearance of the present they belong to.
        inside: (r,) whether the middle posture itself is nearer than may be.
    """

    slack: Floats
    room: Floats
    rows: Floats
    postures: Ints
    clearances: Ints
    inside: NDArray[np.bool_]


class Stop:
    """The pairs that may matter on one way to rest, and what slack they have.

    Slack is what a clearance has above its stop distance and protection level; it is a proven lower bound, see
    `sweep`. Pairs left out have more than one tick can use up.

    Args:
        around: the surroundings. clearances: of the present posture q (n,), complete to `reach_m`.
        way: postures to look at. stop_distance_m: for limits that have none of their own.
        margin_m: kept besides. reach: (c, n) [rad, m] slacks below `|row| . reach` of any are looked at closely.
        known_m: how far the clearances are known; if that is too little, only `reach_m` is found.

    Attributes:
        reach_m: how far clearances had to be known. clearances: those given.
        slack: (m, P) least slack of each pair at each posture [m], infinite where it cannot matter; between two of
            them it is no less than at both.
        rows: every corner with less slack than `|row| . reach` for some reach. free: whether nothing can matter.
        least: the least slack of the rows, infinite without any [m].
    """

    def __init__(
        self,
        around: Surroundings,
        clearances: Clearances,
        q: Floats,
        way: Way,
        *,
        stop_distance_m: float,
        margin_m: float,
        reach: Floats,
        known_m: float = np.inf,
    ) -> None:
        scene, arm, unsure, integrity = around.scene, around.scene.arm, around.unsure, around.integrity
        self._around, self.clearances = around, clearances
        self._packed, self._reach = arm.packed, np.ascontiguousarray(reach)
        approach = _approach(around, clearances, float(way.times[-1])) if scene.moving else _NOTHING
        self._facts = (
            *(clearances.distances, clearances.stop_distances, clearances.solids, clearances.other_links),
            *(clearances.limits, clearances.links, clearances.normals),
        )
        self._need = stop_distance_m, margin_m
        self._doubt = (
            *(unsure.exact, unsure.covariance, float(integrity.k), float(integrity.bias_m)),
            *(max(around.largest_m - integrity.bias_m, 0.0), around.T_site_machine[:3, 3].copy(), way.times),
        )
        self._unsure = (
            *(scene.uncertainty.variances, scene.machine.tool_link, unsure.tool_sigma_m**2),
            *self._turned(),
        )
        self._motion = self._moving() if scene.moving else _STILL
        going = around.T_site_machine, q, way.postures, way.widths, arm.packed
        room = self._facts, approach, stop_distance_m, margin_m, around.largest_m
        triangles = self._triangles(going, room) if scene.surfaces else scene.no_triangles
        hulls = scene.hulls
        cells = scene.cell_ranges, hulls.of_cell, *scene.cell_boxes, scene.pairs, arm.links
        while True:
            self._hulls = hulls.packed()
            self.reach_m, missing, self._of, self._other, *found = _look(
                *(going, room, cells, triangles, self._hulls, self._doubt, self._unsure, self._motion),
                *(self._reach, scene.largest_stop_m, known_m),
            )
            if not len(missing):
                break
            hulls.add_cells(missing)
        self.slack, self._ways, self._depths, self.free, self.least, *rows = found
        self.rows = Rows(*rows)

    def shortfall(self, way: Way, floor_m: float, apart_from: NDArray[np.bool_] | None = None) -> float:
        """Return by how much another way, as many postures, falls short of this one's slack or of -floor_m [m].

        apart_from: (k,) clearances of the present that do not count; None if all do.
        """
        if not len(self.slack):
            return -np.inf
        slack = self.slack if apart_from is None else np.where(apart_from[self._of][:, None], np.inf, self.slack)
        found: float = _shortfall(
            *(self._around.T_site_machine, way.postures, way.widths, self._packed, self._of, self._other),
            *(self._facts, self._need, self._hulls, self._doubt, self._unsure, self._motion, self._reach),
            *((slack, self._ways, self._depths), -floor_m),
        )
        return found

    def _triangles(self, going: Any, room: Any) -> tuple[Ints, Ints]:
        """Return (rows, hulls) of the ground near the ways of the solids that may come near it."""
        scene, clearances, approach = self._around.scene, self.clearances, room[1]
        bands = reached(self._reach, scene.arm.levers)[1]
        (T, q, postures, widths, packed), (facts, _, stop_m, margin_m, largest_m) = going, room
        _, _, need, near, low, high = near_way(
            T, q, postures, widths, packed, facts, approach, stop_m, margin_m, largest_m, bands
        )
        more = self._around.largest_m + bands
        rows, hulls = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
        for row in near.tolist():
            surface = scene.surfaces.get(int(clearances.limits[row]))
            if surface is None or clearances.other_links[row] >= 0:
                continue
            s = int(clearances.solids[row])
            wide = float(need[row] + more[s]) + (float(approach[row]) if len(approach) else 0.0)
            found = scene.triangles_near(surface, low[s] - wide, high[s] + wide)
            rows.append(np.full(len(found), row))
            hulls.append(scene.hulls.of_triangles(surface, found))
        return np.concatenate(rows), np.concatenate(hulls)

    def _turned(self) -> tuple[Floats, Floats]:
        """Return what pose errors of limits add to each clearance's variance [m^2], and the second order of turning
        [m]; both empty where that is nothing."""
        around, scene, clearances = self._around, self._around.scene, self.clearances
        machine, limits, k = scene.machine, scene.uncertainty, around.integrity.k
        if around.unsure.exact and not len(limits.places):
            return _NOTHING, _NOTHING
        links, others, of = clearances.links, clearances.other_links, clearances.limits
        turns, own_turn, slide = link_turns(around.unsure, machine.prismatic.tolist())
        turn = np.where(others < 0, turns.take(links), own_turn)
        arm: float | Floats = scene.arm.reach_m
        more = np.zeros(len(of))
        if len(limits.places):
            poses = limits.poses.take(of)
            places, covariances = limits.places[poses], limits.covariances[poses]
            far = np.linalg.norm(clearances.points_machine - places, axis=1) + arm
            shift = np.sqrt(np.trace(covariances[:, :3, :3], axis1=1, axis2=2))
            own = np.sqrt(np.trace(covariances[:, 3:, 3:], axis1=1, axis2=2))
            moves = poses >= 0
            more = moves * (shift + far * own) ** 2
            turn = turn + moves * own
            arm = arm + moves * far
        return more, second_order(k, turn, arm, slide)

    def _moving(self) -> tuple[Floats, Floats, Any]:
        """Return the twist (k, 6) of each clearance's limit, the place (k, 3) it turns about, if it moves (k,)."""
        clearances, scene = self.clearances, self._around.scene
        speed, place_ = np.zeros((len(clearances), 6)), np.zeros((len(clearances), 3))
        moving = np.zeros(len(clearances), np.bool_)
        for i in scene.moving:
            rows = (clearances.limits == i) & (clearances.other_links < 0)
            speed[rows], place_[rows] = scene.limits[i].velocity, own_place(scene.limits[i].solid)
            moving |= rows
        return speed, place_, moving


def _approach(around: Surroundings, clearances: Clearances, until_s: float) -> Floats:
    """Return how far each clearance's limit may move in a time, whichever way (k,) [m]."""
    scene, way = around.scene, np.zeros(len(clearances))
    for i in scene.moving:
        limit, cells = scene.limits[i], slice(*scene.cell_ranges[i : i + 2])
        lows, highs = scene.cell_boxes
        middle = own_place(limit.solid)
        apart = np.maximum(np.abs(lows[cells] - middle), np.abs(highs[cells] - middle))
        size = float(np.sqrt((apart * apart).sum(axis=1)).max(initial=0.0))
        speed = np.linalg.norm(limit.velocity[:3]) + size * np.linalg.norm(limit.velocity[3:])
        way[(clearances.limits == i) & (clearances.other_links < 0)] = float(speed) * until_s
    return way


@njit(cache=True)
def _look(
    going: Any,
    room: Any,
    cells: Any,
    triangles: Any,
    hulls: Any,
    doubt: Any,
    unsure: Any,
    motion: Any,
    changes: Any,
    largest_stop: float,
    known: float,
) -> Any:
    """Return `Stop.reach_m`, cells without a hull, the pairs, and what `_examine` finds; see there.

    While there are cells without a hull, and where clearances are not known as far as they have to be, nothing is
    examined. going, room: what `near_way` takes but the bands. cells, triangles: see `gather`. hulls: of
    `Hulls.packed`. doubt: see `sweep`. unsure, motion: see `paired`. changes: `reach` of `Stop`.
    """
    T, q, postures, widths, packed = going
    facts, approach, stop, margin, largest = room
    reach = reached(changes, packed[7])
    arm, far, need, near, low, high = near_way(
        T, q, postures, widths, packed, facts, approach, stop, margin, largest, reach[1]
    )
    band, nearer = 0.0, 0.0
    for more in reach[1]:
        band = max(band, more)
    for more in approach:
        nearer = max(nearer, more)
    reach_m = far + largest + band + margin
    reach_m += max(stop, largest_stop) + nearer
    of, other, missing = gather(near, low, high, (need, reach[1] + largest, approach), facts, cells, triangles)
    if reach_m > known:
        missing = missing[:0]
    if reach_m > known or len(missing) > 0:
        of, other = of[:0], other[:0]
    pairs = paired(of, other, facts, stop, margin, unsure, motion)
    return (reach_m, missing, of, other) + _examine(arm, pairs, hulls, doubt, reach, of)  # noqa: RUF005


@njit(cache=True)
def _examine(arm: Any, pairs: Any, hulls: Any, doubt: Any, reach: Any, of: Any) -> Any:
    """Return the slack, ways and depths of `bounds`, whether nothing can matter, the least slack of the rows, and
    the columns of `Rows`."""
    total, count, n = len(of), arm[0].shape[0], arm[0].shape[1]
    slack, depths, losses = np.empty((total, count)), np.empty((total, count)), np.empty((total, count))
    ways = np.empty((total, count, 3))
    bounds(arm, pairs, hulls, doubt, reach, slack, ways, depths, losses, of)
    size = 64
    while True:
        left, room, rows, which = np.empty(size), np.empty(size), np.empty((size, n)), np.empty((size, 2), np.int64)
        inside = np.zeros(size, np.bool_)
        found = emit(arm, pairs, hulls, doubt, reach, slack, ways, depths, losses, left, room, rows, which, inside)
        if found <= size:
            break
        size = found
    postures, clearances = np.empty(found, np.int64), np.empty(found, np.int64)
    for i in range(found):
        postures[i], clearances[i] = which[i, 1], of[which[i, 0]]
    free, least = True, np.inf
    for i in range(total):
        for p in range(count):
            free = free and slack[i, p] == np.inf
    for i in range(found):
        if left[i] < least:
            least = left[i]
    columns = left[:found], room[:found], rows[:found], postures, clearances, inside[:found]
    return (slack, ways, depths, free, least) + columns  # noqa: RUF005 - what can be compiled


@njit(cache=True)
def _shortfall(
    T: Any,
    postures: Any,
    widths: Any,
    packed: Any,
    of: Any,
    other: Any,
    facts: Any,
    need: Any,
    hulls: Any,
    doubt: Any,
    unsure: Any,
    motion: Any,
    changes: Any,
    had: Any,
    least: float,
) -> Any:
    """Return `sweep.shortfall` of another way, see `_look`; had: slack, ways and depths of `bounds`."""
    slack, ways, depths = had
    arm, reach = placed(T, postures, widths, packed), reached(changes, packed[7])
    pairs = paired(of, other, facts, need[0], need[1], unsure, motion)
    return shortfall(arm, pairs, hulls, doubt, reach, slack, ways, depths, least)
