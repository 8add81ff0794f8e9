"""Every clearance along a predicted stop: which pairs may matter, and how much slack each has at each posture."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from workgauge.proximity.protection import link_turns, second_order
from workgauge.proximity.surroundings import Surroundings
from workgauge.proximity.sweep import bounds, cells_near, emit, shortfall
from workgauge.proximity.uncertainty import own_place
from workgauge.values.arrays import Floats, Ints
from workgauge.values.clearances import Clearances

_ROOM = 512


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
        slack: (r,) what is left above the stop distance [m]. rows: (r, n), d(slack)/d(joint) of the middle posture.
        postures: (r,) which of the way's. clearances: (r,) which clearance of the present they belong to.
    """

    slack: Floats
    rows: Floats
    postures: Ints
    clearances: Ints


class Stop:
    """The pairs that may matter on one way to rest, and what slack they have.

    Slack is what a clearance has above its stop distance and protection level; it is a proven lower bound, see
    `sweep`. Pairs left out have at least `band_m` everywhere on the way.

    Args:
        around: the surroundings. clearances: of the present posture q (n,), complete to `reach_m`.
        way: postures to look at. stop_distance_m: for limits that have none of their own.
        margin_m: kept besides. band_m: slack up to here is looked at closely.

    Attributes:
        reach_m: how far clearances had to be known. clearances: those given.
        slack: (m, P) least slack of each pair on the way to each posture [m].
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
        band_m: float,
    ) -> None:
        scene = around.scene
        self._around, self._band, self.clearances = around, band_m, clearances
        self._arm = self._packed(way)
        stops = np.where(np.isnan(clearances.stop_distances), stop_distance_m, clearances.stop_distances)
        need = stops + margin_m
        moved = (np.abs(way.postures - q) + way.widths).max(axis=0)
        far = scene.arm.levers @ moved
        approach = _approach(around, clearances, float(way.times[-1]))
        # how near a pair may come: its own way, all protection, what moves towards it
        room = need + around.largest_m + band_m + approach
        near = np.flatnonzero(clearances.distances < room + far.take(clearances.solids))
        self.reach_m = float(far.max(initial=0.0)) + around.largest_m + band_m + margin_m
        self.reach_m += max(stop_distance_m, scene.largest_stop_m) + float(approach.max(initial=0.0))
        self._pairs = self._paired(clearances, near, need, room, way)
        self._doubt = self._doubted(way)
        hulls = scene.hulls
        self._hulls = (hulls.corners, hulls.starts, hulls.normals, hulls.faces, hulls.radii)
        count = len(self._pairs[0])
        self.slack = np.empty((count, len(way.postures)))
        self._ways = np.empty((count, len(way.postures), 3))
        if count:
            bounds(self._arm, self._pairs, self._hulls, self._doubt, band_m, self.slack, self._ways)

    def rows(self, reach: Floats) -> Rows:
        """Return every corner with `slack < |row| . reach`, reach (n,) [rad, m] being such that the band covers it."""
        n, room = self._arm[0].shape[1], _ROOM
        while True:
            slack, rows, which = np.empty(room), np.empty((room, n)), np.empty((room, 2), np.int64)
            count = 0
            if len(self.slack):
                count = emit(
                    *(self._arm, self._pairs, self._hulls, self._doubt, self._band, reach),
                    *(self.slack, self._ways, slack, rows, which),
                )
            if count <= room:
                break
            room = count
        pairs, postures = which[:count, 0], which[:count, 1]
        return Rows(slack[:count], rows[:count], postures, self._rows_of.take(pairs))

    def shortfall(self, way: Way) -> float:
        """Return by how much another way, as many postures, would fall short of this one's slack or of none [m]."""
        if not len(self.slack):
            return -np.inf
        arm = self._packed(way)
        found: float = shortfall(arm, self._pairs, self._hulls, self._doubt, self._band, self.slack, self._ways)
        return found

    def _packed(self, way: Way) -> tuple[Any, ...]:
        arm = self._around.scene.arm
        at = arm.at(self._around.T_site_machine, way.postures)
        spread = way.widths @ arm.levers.T
        spread = spread + 0.5 * spread * way.widths.sum(axis=1)[:, None]
        return (
            *(at.axes, at.origins, at.rotations, at.corners),
            *(arm.prismatic, arm.links, arm.stretch, arm.levers, way.widths, spread),
        )

    def _paired(self, clearances: Clearances, near: Ints, need: Floats, room: Floats, way: Way) -> tuple[Any, ...]:
        """Return the pairs as `sweep` wants them: which solid, which hull or other solid, and what each needs."""
        scene = self._around.scene
        corners = self._arm[3]
        spread = self._arm[9].max(axis=0)[:, None]
        low, high = corners.min(axis=(0, 2)) - spread, corners.max(axis=(0, 2)) + spread
        own = clearances.other_links.take(near) >= 0
        rows, others, kinds = [], [], []
        outside = near[~own]
        if outside.size:
            for found, hulls in self._hulls_near(clearances, outside, low, high, room):
                rows.append(found)
                others.append(hulls)
                kinds.append(np.zeros(len(found), np.bool_))
        for row in near[own].tolist():
            both = scene.pairs[scene.pairs[:, 0] == clearances.solids[row]]
            match = both[scene.arm.links.take(both[:, 1]) == clearances.other_links[row], 1]
            rows.append(np.full(len(match), row))
            others.append(match)
            kinds.append(np.ones(len(match), np.bool_))
        none = np.empty(0, np.int64)
        which = np.concatenate([none, *rows])
        self._rows_of = which
        variance, extra = self._unsure(clearances, which)
        speed, place, moving = _motion(self._around, clearances, which)
        return (
            clearances.solids.take(which),
            np.concatenate([none, *others]),
            np.concatenate([np.empty(0, np.bool_), *kinds]),
            np.ascontiguousarray(clearances.normals.take(which, axis=0)),
            need.take(which),
            *(variance, extra, speed, place, moving),
        )

    def _hulls_near(
        self, clearances: Clearances, near: Ints, low: Floats, high: Floats, room: Floats
    ) -> list[tuple[Ints, Ints]]:
        """Return (rows, hulls) of the limits' cells and triangles near the solids' ways."""
        scene = self._around.scene
        limits = clearances.limits.take(near)
        found: list[tuple[Ints, Ints]] = []
        ground = np.isin(limits, list(scene.surfaces)) if scene.surfaces else np.zeros(len(near), np.bool_)
        for row in near[ground].tolist():
            s, surface = int(clearances.solids[row]), scene.surfaces[int(clearances.limits[row])]
            triangles = scene.triangles_near(surface, low[s] - room[row], high[s] + room[row])
            found.append((np.full(len(triangles), row), scene.hulls.of_triangles(surface, triangles)))
        cells = near[~ground]
        if cells.size:
            ranges = scene.cell_ranges
            first, last = ranges.take(clearances.limits, mode="clip"), ranges.take(clearances.limits + 1, mode="clip")
            size = _ROOM
            while True:
                out = np.empty((size, 2), np.int64)
                args = (cells, clearances.solids, first, last, *scene.cell_boxes, room, out)
                count = cells_near(low, high, *args)
                if count <= size:
                    break
                size = count
            found.append((out[:count, 0], scene.hulls.of_cells(out[:count, 1])))
        return found

    def _doubted(self, way: Way) -> tuple[Any, ...]:
        around = self._around
        unsure, integrity = around.unsure, around.integrity
        largest = max(around.largest_m - integrity.bias_m, 0.0)
        return (
            *(unsure.exact, unsure.covariance, float(integrity.k), float(integrity.bias_m), largest),
            *(np.ascontiguousarray(around.T_site_machine[:3, 3]), way.times),
        )

    def _unsure(self, clearances: Clearances, which: Ints) -> tuple[Floats, Floats]:
        """Return, for each pair, the variance that has no direction [m^2] and the second order of turning [m]."""
        around, scene = self._around, self._around.scene
        machine, limits, k = scene.machine, scene.uncertainty, around.integrity.k
        links, others = clearances.links.take(which), clearances.other_links.take(which)
        of = clearances.limits.take(which)
        variance = limits.variances.take(of)
        if around.unsure.tool_sigma_m:
            tool = (links == machine.tool_link) | (others == machine.tool_link)
            variance = variance + tool * around.unsure.tool_sigma_m**2
        if around.unsure.exact and not len(limits.places):
            return variance, np.zeros(len(which))
        turns, own_turn, slide = link_turns(around.unsure, machine.prismatic.tolist())
        turn = np.where(others < 0, turns.take(links), own_turn)
        arm: float | Floats = scene.arm.reach_m
        if len(limits.places):
            poses = limits.poses.take(of)
            places, covariances = limits.places[poses], limits.covariances[poses]
            far = np.linalg.norm(clearances.points_machine.take(which, axis=0) - places, axis=1) + arm
            shift = np.sqrt(np.trace(covariances[:, :3, :3], axis1=1, axis2=2))
            own = np.sqrt(np.trace(covariances[:, 3:, 3:], axis1=1, axis2=2))
            moves = poses >= 0
            variance = variance + moves * (shift + far * own) ** 2
            turn = turn + moves * own
            arm = arm + moves * far
        return variance, second_order(k, turn, arm, slide)


def _approach(around: Surroundings, clearances: Clearances, until_s: float) -> Floats:
    """Return how far each clearance's limit may move in a time, whichever way (k,) [m]."""
    scene, way = around.scene, np.zeros(len(clearances))
    for i in scene.moving:
        limit, cells = scene.limits[i], slice(*scene.cell_ranges[i : i + 2])
        lows, highs = scene.cell_boxes
        place = own_place(limit.solid)
        apart = np.maximum(np.abs(lows[cells] - place), np.abs(highs[cells] - place))
        size = float(np.sqrt((apart * apart).sum(axis=1)).max(initial=0.0))
        speed = np.linalg.norm(limit.velocity[:3]) + size * np.linalg.norm(limit.velocity[3:])
        way[(clearances.limits == i) & (clearances.other_links < 0)] = float(speed) * until_s
    return way


def _motion(around: Surroundings, clearances: Clearances, which: Ints) -> tuple[Floats, Floats, Any]:
    """Return the twist (m, 6) of each pair's limit, the place (m, 3) it turns about, and whether it moves (m,)."""
    speed, place = np.zeros((len(which), 6)), np.zeros((len(which), 3))
    moving = np.zeros(len(which), np.bool_)
    for i in around.scene.moving:
        rows = (clearances.limits.take(which) == i) & (clearances.other_links.take(which) < 0)
        limit = around.scene.limits[i]
        speed[rows], place[rows] = limit.velocity, own_place(limit.solid)
        moving |= rows
    return speed, place, moving
