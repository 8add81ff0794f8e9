"""All limits of a site around one machine, asked for clearances once per tick."""

import math
import operator
from collections.abc import Sequence
from typing import Any

import numpy as np

from workgauge.machine.arm import arm_of
from workgauge.machine.model import Kinematics, MachineModel
from workgauge.proximity.cells import OrientedBoxes, cut
from workgauge.proximity.chain import penetrate
from workgauge.proximity.hulls import Hulls
from workgauge.proximity.overlap import box_polyhedron, signed_distance
from workgauge.proximity.pairs import box_gaps, oriented_gaps
from workgauge.proximity.shapes import (
    TOUCHING_M,
    Placed,
    box_shapes,
    direction_and_point,
    measure,
    new_result,
    transform,
)
from workgauge.proximity.store import CellShapes
from workgauge.proximity.surface import SurfaceIndex
from workgauge.proximity.uncertainty import LimitUncertainty
from workgauge.values.arrays import Floats, Ints, frozen, frozen_ints
from workgauge.values.clearances import Clearances
from workgauge.values.limits import Activity, Limit
from workgauge.values.solids import Surface, Tube

_ALWAYS = Activity()
#: Lower bounds may be this much too large by rounding [m].
_SLACK_M = 1e-9
#: Solid, limit, cell (of two links: the other solid), other link or -1, distance, way out, point of the machine.
_Row = tuple[int, int, int, int, float, Floats, Floats]
#: What decides whether a limit counts: the tick's clock [ns], the work states that are off, the tracks let off.
_When = tuple[int, frozenset[str], frozenset[str]]
_ORDER = operator.itemgetter(0, 1, 2)
#: So many pairs are worth a closer bound before they are measured.
_MANY_PAIRS = 48


class Scene:
    """Clearances between one machine and the limits of a site; a pure function of what it is asked.

    Nothing found is kept between calls, and no distance starts from an earlier one; only collision shapes are built
    when first needed. The cost of a query grows with the limits near the machine, not with those of the site.

    Args:
        machine: its solids and self-collision pairs are checked.
        limits: in the site's local frame [m].

    Attributes:
        uncertainty: what is not sure about the limits.
        largest_stop_m: largest stop distance of a limit's own, or of the machine's links' own [m].
        arm: the machine's, packed. hulls: the limits' cells, packed.
        cell_ranges: (limits + 1,), limit i has the cells from [i] to [i + 1]. cell_boxes: lows and highs (cells, 3).
        surfaces: index of a limit to the number of its surface. no_triangles: two empty columns.
        moving: limits with a velocity.
        pairs: (p, 2) solids of different links to be kept apart, first the one that moves.
    """

    def __init__(self, machine: MachineModel, limits: Sequence[Limit]) -> None:
        self.machine = machine
        self.limits = tuple(limits)
        self.limit_ids = (*(limit.id for limit in self.limits), *(f"self:{name}" for name in machine.link_names))
        self._cells = cut(self.limits)
        self._shapes = CellShapes(self.limits, self._cells)
        self._radii = [limit.solid.radius if isinstance(limit.solid, Tube) else 0.0 for limit in self.limits]
        self._surfaces = [
            (i, SurfaceIndex(limit.solid)) for i, limit in enumerate(self.limits) if isinstance(limit.solid, Surface)
        ]
        self._indices: list[int] = self._cells.cells.tolist()
        self._links = [solid.link for solid in machine.solids]
        self._link_of = frozen_ints(self._links)
        self._stretching = any(solid.stretch is not None for solid in machine.solids)
        self._rest_shapes = box_shapes(frozen([solid.half_extents for solid in machine.solids]))
        names = [machine.link_names[link] for link in self._links]
        patterns = {limit.exempt_links for limit in self.limits}
        self._exempt = {links: np.array([name in links for name in names], dtype=np.bool_) for links in patterns}
        self._exempting = np.array([bool(self._exempt[limit.exempt_links].any()) for limit in self.limits], np.bool_)
        self._conditional = np.array(
            [limit.activity != _ALWAYS or limit.own_track_of is not None for limit in self.limits], dtype=np.bool_
        )
        self._some_exempting, self._some_conditional = bool(self._exempting.any()), bool(self._conditional.any())
        self.uncertainty = LimitUncertainty.of(self.limits, len(machine.link_names))
        own = [*(limit.stop_distance_m for limit in self.limits), *(machine.self_stop_distance_m,) * (machine.n + 1)]
        self.largest_stop_m = max(stop or 0.0 for stop in own)
        self._stop_distances = frozen([math.nan if stop is None else stop for stop in own])
        self.cell_ranges = frozen_ints(np.searchsorted(self._cells.limits, np.arange(len(self.limits) + 1)))
        self.cell_boxes = self._cells.lows, self._cells.highs
        self.surfaces = {i: number for number, (i, _) in enumerate(self._surfaces)}
        ground = [surface for _, surface in self._surfaces]
        self.hulls = Hulls(self._shapes, np.array(self._radii), self._cells.limits, ground)
        self.arm = arm_of(machine)
        self.no_triangles = frozen_ints([]), frozen_ints([])
        self.moving = tuple(i for i, limit in enumerate(self.limits) if limit.velocity.any())
        # of two links, the one farther out is the one that moves, the other its limit
        pairs = [(j, i) if self._links[j] > self._links[i] else (i, j) for i, j in machine.self_pairs]
        self._pairs = tuple(pairs)
        self.pairs = frozen_ints(np.reshape(pairs, (-1, 2)))

    def triangles_near(self, surface: int, low: Floats, high: Floats) -> Ints:
        """Return the triangles of a surface whose boxes meet the box from low to high (3,), see `SurfaceIndex`."""
        return self._surfaces[surface][1].triangles_near(low, high)

    def query(
        self,
        kin: Kinematics,
        T_site_machine: Floats,
        radius_m: float,
        now_ns: int = 0,
        off_states: frozenset[str] = frozenset(),
        let_off: frozenset[str] = frozenset(),
    ) -> Clearances:
        """Return one clearance for every link solid and limit nearer than `radius_m` (Mäkinen 2.1, 2.2).

        Of a chain or surface, the nearest cell or triangle counts. Distances are signed: inside a box, convex solid
        or another link they are minus the least translation that leads out; inside a chain see `chain`; below a
        surface see `surface`. Order: link solid, limit, cell; pairs of links come after the limits. Protection levels
        are zero until `protection.with_protection` puts them in.

        Args:
            kin: the posture, from `machine.forward`.
            T_site_machine: (4, 4) pose of the undercarriage in the site's local frame.
            radius_m: search radius [m], above 0.
            now_ns: the tick's clock, for limits with a window of activity.
            off_states: work states known to be off.
            let_off: tracks the undercarriage stands on, whose envelopes do not count for it (`own_track_of`).

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
        placed = self._placed(boxes)
        result = new_result()
        rows: list[_Row] = []
        when = now_ns, off_states, let_off
        near = self._near_cells(lows, highs, low, high, radius_m, when)
        self._measure_cells(rows, boxes, placed, *near, radius_m, result)
        self._measure_surfaces(rows, boxes, placed, radius_m, when, result)
        self._measure_links(rows, boxes, placed, radius_m, result)
        return self._clearances(rows, radius_m)

    def _placed(self, boxes: OrientedBoxes) -> list[Placed]:
        """Return the machine's solids at their poses; only boxes that stretch need a shape of their own."""
        shapes = box_shapes(boxes.halves) if self._stretching else self._rest_shapes
        return [(shape, transform(R, t)) for shape, R, t in zip(shapes, boxes.axes, boxes.centres, strict=True)]

    def _near_cells(
        self,
        lows: Floats,
        highs: Floats,
        low: Floats,
        high: Floats,
        radius_m: float,
        when: _When,
    ) -> tuple[Ints, Ints, Floats]:
        """Return (solid, cell) pairs that may be near and lower bounds, without inactive and exempt ones."""
        cells = self._cells.near_plan(low, high)
        limits = self._cells.limits.take(cells)
        if self._some_conditional and (conditional := self._conditional.take(limits)).any():
            active = {i: self.limits[i].counts(*when) for i in limits[conditional].tolist()}
            kept = np.array([active.get(i, True) for i in limits.tolist()], dtype=np.bool_)
            cells, limits = cells[kept], limits[kept]
        gaps = box_gaps(lows, highs, self._cells.lows.take(cells, axis=0), self._cells.highs.take(cells, axis=0))
        close = gaps < radius_m + _SLACK_M
        for k in np.flatnonzero(self._exempting.take(limits)).tolist() if self._some_exempting else ():
            close[self._exempt[self.limits[limits[k]].exempt_links], k] = False
        solids, which = close.nonzero()
        return solids, cells.take(which), gaps[solids, which]

    def _measure_cells(
        self,
        rows: list[_Row],
        boxes: OrientedBoxes,
        placed: list[Placed],
        solids: Ints,
        cells: Ints,
        bounds: Floats,
        radius_m: float,
        result: Any,
    ) -> None:
        """Measure pairs; if there are many, from the nearest bound on, until no cell of the limit can be nearer."""
        limits = self._cells.limits.take(cells)
        if len(cells) > _MANY_PAIRS:
            bounds = oriented_gaps(boxes, solids, self._cells.boxes, cells)
            order = np.lexsort((cells, bounds, limits, solids))
            order = order[bounds.take(order) < radius_m + _SLACK_M]
            solids, limits, cells = solids.take(order), limits.take(order), cells.take(order)
            bounds = bounds.take(order)
        pairs = zip(solids.tolist(), limits.tolist(), cells.tolist(), bounds.tolist(), strict=True)
        solid = limit = -1
        touching_m, best = 0.0, radius_m
        touched: list[tuple[int, Floats]] = []
        row: _Row | None = None
        for s, i, cell, bound in pairs:
            if s != solid or i != limit:
                if row is not None:
                    rows.append(self._overlap(boxes, solid, limit, touched) if touched else row)
                solid, limit, row, touched = s, i, None, []
                touching_m, best = TOUCHING_M - self._radii[i], radius_m
            if bound >= best + _SLACK_M and bound > _SLACK_M:
                continue
            distance = measure(self._shapes.placed(cell), placed[s], result)
            if distance <= touching_m:
                touched.append((cell, direction_and_point(result)[0]))
            if distance < best:
                best = distance
                row = s, i, self._indices[cell], -1, distance, *direction_and_point(result)
        if row is not None:
            rows.append(self._overlap(boxes, solid, limit, touched) if touched else row)

    def _overlap(self, boxes: OrientedBoxes, s: int, i: int, touched: list[tuple[int, Floats]]) -> _Row:
        """Measure anew, by other means, a solid that touches cells of one limit, in directions coal suggests."""
        touched = sorted(touched, key=operator.itemgetter(0))
        indices = [self._indices[cell] for cell, _ in touched]
        if indices[0] >= 0:
            found = penetrate(self._shapes.chain(i), indices, boxes.axes[s], boxes.centres[s], boxes.halves[s])
            if found is not None:
                return s, i, found.cell, -1, -found.depth, found.normal, found.point_machine
        solid = box_polyhedron(boxes, s)
        measured = [signed_distance(self._shapes.polyhedron(cell), solid, u) for cell, u in touched]
        nearest = min(range(len(touched)), key=lambda k: measured[k][0])
        distance, u, on_machine = measured[nearest]
        return s, i, indices[nearest], -1, distance - self._radii[i], u, on_machine

    def _measure_surfaces(
        self,
        rows: list[_Row],
        boxes: OrientedBoxes,
        placed: list[Placed],
        radius_m: float,
        when: _When,
        result: Any,
    ) -> None:
        for i, surface in self._surfaces:
            limit = self.limits[i]
            if not limit.counts(*when):
                continue
            exempt = self._exempt[limit.exempt_links]
            for s in np.flatnonzero(~exempt).tolist():
                found = surface.clearance(
                    placed[s], boxes.axes[s], boxes.centres[s], boxes.halves[s], radius_m, result
                )
                if found is not None:
                    rows.append((s, i, found.triangle, -1, found.distance, found.normal, found.point_machine))

    def _measure_links(
        self, rows: list[_Row], boxes: OrientedBoxes, placed: list[Placed], radius_m: float, result: Any
    ) -> None:
        for mover, other in self._pairs:
            distance = measure(placed[other], placed[mover], result)
            if distance >= radius_m:
                continue
            u, point = direction_and_point(result)
            if distance <= TOUCHING_M:
                distance, u, point = signed_distance(box_polyhedron(boxes, other), box_polyhedron(boxes, mover), u)
            link = self._links[other]
            rows.append((mover, len(self.limits) + link, other, link, distance, u, point))

    def _clearances(self, rows: list[_Row], radius_m: float) -> Clearances:
        rows.sort(key=_ORDER)
        if not rows:
            return self._nothing(radius_m)
        solid_column, limit_column, cell_column, other_column, distance_column, *vector_columns = zip(
            *rows, strict=True
        )
        solids, limits, cells, others = np.array((solid_column, limit_column, cell_column, other_column))
        distances = np.array(distance_column)
        normals, points_machine = np.concatenate([*vector_columns[0], *vector_columns[1]]).reshape(2, -1, 3)
        points_limit = points_machine - distances[:, None] * normals
        links = self._link_of.take(solids)
        cells[others >= 0] = -1
        protections, stops = np.zeros(len(rows)), self._stop_distances.take(limits)
        vectors, indices = (normals, points_machine, points_limit), (links, others, limits, cells, solids)
        columns = (distances, *vectors, *indices, protections, stops)
        for column in columns:
            column.setflags(write=False)
        return Clearances(*columns, self.machine.link_names, self.limit_ids, radius_m)

    def _nothing(self, radius_m: float) -> Clearances:
        none, no_vectors, no_indices = frozen([]), frozen(np.empty((0, 3))), frozen_ints([])
        vectors, indices = (no_vectors,) * 3, (no_indices,) * 5
        return Clearances(none, *vectors, *indices, none, none, self.machine.link_names, self.limit_ids, radius_m)
