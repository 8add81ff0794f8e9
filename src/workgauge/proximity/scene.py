"""All limits of a site around one machine, asked for clearances once per tick."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from workgauge.machine.model import Kinematics, MachineModel
from workgauge.proximity.cells import OrientedBoxes, cut
from workgauge.proximity.chain import penetrate
from workgauge.proximity.overlap import box_polyhedron, signed_distance
from workgauge.proximity.pairs import box_gaps, oriented_gaps
from workgauge.proximity.shapes import TOUCHING_M, Placed, measure, new_result, placed_boxes
from workgauge.proximity.store import CellShapes
from workgauge.proximity.surface import SurfaceIndex
from workgauge.values.arrays import Floats, Ints, frozen, frozen_ints
from workgauge.values.clearances import Clearances
from workgauge.values.limits import Activity, Limit
from workgauge.values.solids import Surface, Tube

_ALWAYS = Activity()
#: Lower bounds may be this much too large by rounding [m].
_SLACK_M = 1e-9
#: (solid, limit, cell), distance, way out, point of the machine, point of the limit.
_Row = tuple[tuple[int, int, int], float, Floats, Floats, Floats]


class _Rows:
    """The clearances found so far, one per list entry."""

    def __init__(self) -> None:
        self.keys: list[tuple[int, int, int, int]] = []  # solid, limit, cell or other solid, other link
        self.distances: list[float] = []
        self.normals: list[Floats] = []
        self.points_machine: list[Floats] = []
        self.points_limit: list[Floats] = []

    def add(self, key: tuple[int, int, int, int], distance: float, u: Floats, machine: Floats, limit: Floats) -> None:
        self.keys.append(key)
        self.distances.append(distance)
        self.normals.append(u)
        self.points_machine.append(machine)
        self.points_limit.append(limit)


class Scene:
    """Clearances between one machine and the limits of a site; a pure function of what it is asked.

    Nothing found is kept between calls, and no distance starts from an earlier one; only collision shapes are built
    when first needed. The cost of a query grows with the limits near the machine, not with those of the site.

    Args:
        machine: its solids and self-collision pairs are checked.
        limits: in the site's local frame [m].
        sigmas: how many standard deviations of a limit's tolerance count as its protection level.
    """

    def __init__(self, machine: MachineModel, limits: Sequence[Limit], *, sigmas: float = 1.0) -> None:
        self.machine = machine
        self.limits = tuple(limits)
        self.limit_ids = (*(limit.id for limit in self.limits), *(f"self:{name}" for name in machine.link_names))
        self._cells = cut(self.limits)
        self._shapes = CellShapes(self.limits, self._cells)
        self._radii = [limit.solid.radius if isinstance(limit.solid, Tube) else 0.0 for limit in self.limits]
        self._surfaces = [
            (i, SurfaceIndex(limit.solid)) for i, limit in enumerate(self.limits) if isinstance(limit.solid, Surface)
        ]
        self._links = [solid.link for solid in machine.solids]
        names = [machine.link_names[link] for link in self._links]
        patterns = {limit.exempt_links for limit in self.limits}
        self._exempt = {links: np.array([name in links for name in names], dtype=np.bool_) for links in patterns}
        self._exempting = np.array([bool(self._exempt[limit.exempt_links].any()) for limit in self.limits], np.bool_)
        self._conditional = np.array([limit.activity != _ALWAYS for limit in self.limits], dtype=np.bool_)
        self._protections = frozen(
            [*(sigmas * limit.tolerance_m for limit in self.limits), *(0.0 for _ in machine.link_names)]
        )
        stops = (math.nan if limit.stop_distance_m is None else limit.stop_distance_m for limit in self.limits)
        self._stop_distances = frozen([*stops, *(math.nan for _ in machine.link_names)])
        # of two links, the one farther out is the one that moves, the other its limit
        pairs = [(j, i) if self._links[j] > self._links[i] else (i, j) for i, j in machine.self_pairs]
        self._movers = frozen_ints([pair[0] for pair in pairs])
        self._others = frozen_ints([pair[1] for pair in pairs])

    def query(
        self,
        kin: Kinematics,
        T_site_machine: Floats,
        radius_m: float,
        now_ns: int = 0,
        off_states: frozenset[str] = frozenset(),
    ) -> Clearances:
        """Return one clearance for every link solid and limit nearer than `radius_m` (Mäkinen 2.1, 2.2).

        Of a chain or surface, the nearest cell or triangle counts. Distances are signed: inside a box, convex solid
        or another link they are minus the least translation that leads out; inside a chain see `chain`; below a
        surface see `surface`. Order: link solid, limit, cell; pairs of links come after the limits.

        Args:
            kin: the posture, from `machine.forward`.
            T_site_machine: (4, 4) pose of the undercarriage in the site's local frame.
            radius_m: search radius [m], above 0.
            now_ns: the tick's clock, for limits with a window of activity.
            off_states: work states known to be off.

        Raises:
            ValueError: if the pose or the posture is not finite: no answer is never read as free.
        """
        poses, halves = self.machine.solid_poses(kin)
        boxes = OrientedBoxes.of_poses(T_site_machine @ poses, halves)
        reach = boxes.reach()
        lows, highs = boxes.centres - reach, boxes.centres + reach
        low, high = lows.min(axis=0) - radius_m, highs.max(axis=0) + radius_m
        if not (math.isfinite(low.sum()) and math.isfinite(high.sum()) and radius_m > 0.0):
            raise ValueError("proximity needs a finite posture and pose, and a radius above 0")
        placed = placed_boxes(boxes)
        result = new_result()
        rows = _Rows()
        near = self._near_cells(lows, highs, low, high, radius_m, now_ns, off_states)
        self._measure_cells(rows, boxes, placed, *near, radius_m, result)
        self._measure_surfaces(rows, boxes, placed, radius_m, now_ns, off_states, result)
        self._measure_links(rows, boxes, placed, radius_m, result)
        return self._clearances(rows, radius_m)

    def _near_cells(
        self,
        lows: Floats,
        highs: Floats,
        low: Floats,
        high: Floats,
        radius_m: float,
        now_ns: int,
        off_states: frozenset[str],
    ) -> tuple[Ints, Ints]:
        """Return (solid, cell) pairs whose axis-parallel boxes are near, without inactive and exempt ones."""
        cells = self._cells.near_plan(low, high)
        limits = self._cells.limits.take(cells)
        conditional = self._conditional.take(limits)
        if conditional.any():
            active = {i: self.limits[i].activity.active(now_ns, off_states) for i in limits[conditional].tolist()}
            kept = np.array([active.get(i, True) for i in limits.tolist()], dtype=np.bool_)
            cells, limits = cells[kept], limits[kept]
        gaps = box_gaps(lows, highs, self._cells.lows.take(cells, axis=0), self._cells.highs.take(cells, axis=0))
        close = gaps < radius_m + _SLACK_M
        for k in np.flatnonzero(self._exempting.take(limits)).tolist():
            close[self._exempt[self.limits[limits[k]].exempt_links], k] = False
        solids, which = close.nonzero()
        return solids, cells.take(which)

    def _measure_cells(
        self,
        rows: _Rows,
        boxes: OrientedBoxes,
        placed: list[Placed],
        solids: Ints,
        cells: Ints,
        radius_m: float,
        result: Any,
    ) -> None:
        """Measure pairs from the nearest bound on, until no cell of the same limit can be nearer."""
        bounds = oriented_gaps(boxes, solids, self._cells.boxes, cells)
        limits = self._cells.limits.take(cells)
        order = np.lexsort((cells, bounds, limits, solids))
        order = order[bounds.take(order) < radius_m + _SLACK_M]
        pairs = zip(
            solids.take(order).tolist(),
            limits.take(order).tolist(),
            cells.take(order).tolist(),
            bounds.take(order).tolist(),
            strict=True,
        )
        solid = limit = -1
        touching_m, best = 0.0, radius_m
        touched: list[int] = []
        row: _Row | None = None
        for s, i, cell, bound in pairs:
            if s != solid or i != limit:
                self._finish(rows, boxes, row, touched)
                solid, limit, row, touched = s, i, None, []
                touching_m, best = TOUCHING_M - self._radii[i], radius_m
            if bound >= best + _SLACK_M and bound > _SLACK_M:
                continue
            distance, u, on_limit, on_machine = measure(self._shapes.placed(cell), placed[s], result)
            if distance <= touching_m:
                touched.append(cell)
            if distance < best:
                best = distance
                row = (s, i, cell), distance, u, on_machine, on_limit
        self._finish(rows, boxes, row, touched)

    def _finish(self, rows: _Rows, boxes: OrientedBoxes, row: _Row | None, touched: list[int]) -> None:
        """Add what was found for one solid and limit; if they touch, measured anew by other means."""
        if row is None:
            return
        (s, i, cell), distance, u, on_machine, on_limit = row
        index = int(self._cells.cells[cell])
        if touched:
            index, distance, u, on_machine, on_limit = self._overlap(boxes, s, i, sorted(touched))
        rows.add((s, i, index, -1), distance, u, on_machine, on_limit)

    def _overlap(
        self, boxes: OrientedBoxes, s: int, i: int, touched: list[int]
    ) -> tuple[int, float, Floats, Floats, Floats]:
        """Return cell index, distance, way out and points of a solid that touches cells of one limit."""
        indices = [int(self._cells.cells[cell]) for cell in touched]
        if indices[0] >= 0:
            found = penetrate(self._shapes.chain(i), indices, boxes.axes[s], boxes.centres[s], boxes.halves[s])
            if found is not None:
                return found.cell, -found.depth, found.normal, found.point_machine, found.point_limit
        solid = box_polyhedron(boxes, s)
        measured = [signed_distance(self._shapes.polyhedron(cell), solid) for cell in touched]
        nearest = min(range(len(touched)), key=lambda k: measured[k][0])
        distance, u, on_machine = measured[nearest]
        distance -= self._radii[i]
        return indices[nearest], distance, u, on_machine, on_machine - distance * u

    def _measure_surfaces(
        self,
        rows: _Rows,
        boxes: OrientedBoxes,
        placed: list[Placed],
        radius_m: float,
        now_ns: int,
        off_states: frozenset[str],
        result: Any,
    ) -> None:
        for i, surface in self._surfaces:
            limit = self.limits[i]
            if not limit.activity.active(now_ns, off_states):
                continue
            exempt = self._exempt[limit.exempt_links]
            for s in np.flatnonzero(~exempt).tolist():
                found = surface.clearance(
                    placed[s], boxes.axes[s], boxes.centres[s], boxes.halves[s], radius_m, result
                )
                if found is not None:
                    rows.add(
                        (s, i, found.triangle, -1),
                        found.distance,
                        found.normal,
                        found.point_machine,
                        found.point_limit,
                    )

    def _measure_links(
        self, rows: _Rows, boxes: OrientedBoxes, placed: list[Placed], radius_m: float, result: Any
    ) -> None:
        movers, others = self._movers, self._others
        bounds = oriented_gaps(boxes, movers, boxes, others)
        for k in np.flatnonzero(bounds < radius_m + _SLACK_M).tolist():
            mover, other = int(movers[k]), int(others[k])
            distance, u, on_other, on_mover = measure(placed[other], placed[mover], result)
            if distance <= TOUCHING_M:
                distance, u, on_mover = signed_distance(box_polyhedron(boxes, other), box_polyhedron(boxes, mover))
                on_other = on_mover - distance * u
            if distance < radius_m:
                link = self._links[other]
                rows.add((mover, len(self.limits) + link, other, link), distance, u, on_mover, on_other)

    def _clearances(self, rows: _Rows, radius_m: float) -> Clearances:
        order = sorted(range(len(rows.keys)), key=rows.keys.__getitem__)
        keys = np.array(rows.keys, dtype=np.int64).reshape(-1, 4)[order]
        limits, cells, others = keys[:, 1], keys[:, 2], keys[:, 3]
        vectors = np.array((rows.normals, rows.points_machine, rows.points_limit)).reshape(3, -1, 3)[:, order]
        distances = np.array(rows.distances)[order]
        links = np.array(self._links, dtype=np.int64)[keys[:, 0]]
        cells = np.where(others >= 0, -1, cells)
        protections, stops = self._protections[limits], self._stop_distances[limits]
        for array in (distances, vectors, links, others, limits, cells, protections, stops):
            array.setflags(write=False)
        return Clearances(
            distances,
            vectors[0],
            vectors[1],
            vectors[2],
            links,
            others,
            limits,
            cells,
            protections,
            stops,
            self.machine.link_names,
            self.limit_ids,
            radius_m,
        )
