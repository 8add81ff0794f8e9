"""All limits of a site around one machine, asked for clearances once per tick."""

import math
import operator
from collections.abc import Sequence
from typing import Any

import numpy as np

from workgauge.machine.arm import Arm, arm_of
from workgauge.machine.model import Kinematics, MachineModel
from workgauge.proximity.cells import OrientedBoxes, cut
from workgauge.proximity.chain import penetrate
from workgauge.proximity.chains import Chains
from workgauge.proximity.depths import least_distances
from workgauge.proximity.hulls import Hulls
from workgauge.proximity.overlap import box_polyhedron, signed_distance
from workgauge.proximity.search import SLACK_M, Rules, packed_cells, search
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
from workgauge.proximity.tree import Tree
from workgauge.proximity.uncertainty import LimitUncertainty
from workgauge.values.arrays import Floats, Ints, freeze, frozen, frozen_ints
from workgauge.values.clearances import Clearances
from workgauge.values.limits import Limit
from workgauge.values.solids import Surface, Tube

#: Solid, limit, cell (of two links: the other solid), other link or -1, distance, way out, point of the machine.
_Row = tuple[int, int, int, int, float, Floats, Floats]
#: What decides whether a limit counts: the tick's clock [ns], the work states that are off, the tracks let off.
_When = tuple[int, frozenset[str], frozenset[str]]


class Scene:
    """Clearances between one machine and the limits of a site; a pure function of what it is asked.

    Nothing found is kept between calls, and no distance starts from an earlier one; only collision shapes are built
    when first needed. The cost of a query grows with the limits near the machine, not with those of the site.

    Args:
        machine: its solids and self-collision pairs are checked.
        limits: in the site's local frame [m].

    Attributes:
        uncertainty: what is not sure about the limits.
        stop_distances: (limits + L,) each limit's own, then each own link's, NaN without [m].
        largest_stop_m: largest stop distance of a limit's own, or of the machine's links' own [m].
        hulls: the limits' cells, packed.
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
        self._rules = Rules(self.limits, names)
        self._when = self._rules.limits, self._rules.exempt
        self._tree = tuple(Tree.over(self._cells.lows, self._cells.highs))
        self._packed = (self._cells.lows, self._cells.highs, *packed_cells(self._cells))
        self.uncertainty = LimitUncertainty.of(self.limits, len(machine.link_names))
        own = [
            *(limit.stop_distance_m for limit in self.limits),
            *(machine.self_stop_distance_m,) * len(machine.link_names),
        ]
        self.largest_stop_m = max(stop or 0.0 for stop in own)
        self.stop_distances = frozen([math.nan if stop is None else stop for stop in own])
        self.cell_ranges = frozen_ints(np.searchsorted(self._cells.limits, np.arange(len(self.limits) + 1)))
        self.cell_boxes = self._cells.lows, self._cells.highs
        self.surfaces = {i: number for number, (i, _) in enumerate(self._surfaces)}
        ground = [surface for _, surface in self._surfaces]
        self.hulls = Hulls(self._shapes, np.array(self._radii), self._cells.limits, ground)
        self._chains = Chains(self._shapes, len(self.limits))
        self.no_triangles: tuple[Ints, Ints] = np.empty(0, np.int64), np.empty(0, np.int64)
        self.moving = tuple(i for i, limit in enumerate(self.limits) if limit.velocity.any())
        # of two links, the one farther out is the one that moves, the other its limit
        pairs = [(j, i) if self._links[j] > self._links[i] else (i, j) for i, j in machine.self_pairs]
        self.pairs = frozen_ints(np.reshape(pairs, (-1, 2)))
        pairs.sort(key=lambda pair: (pair[0], self._links[pair[1]], pair[1]))
        self._own_pairs = frozen_ints(np.reshape(pairs, (-1, 2)))

    @property
    def arm(self) -> Arm:
        """The machine's chain and boxes, packed."""
        return arm_of(self.machine)

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
        found = self._found(kin, T_site_machine, radius_m, (now_ns, off_states, let_off), give_up=False)
        assert found is not None
        return found

    def query_apart(
        self,
        kin: Kinematics,
        T_site_machine: Floats,
        radius_m: float,
        now_ns: int = 0,
        off_states: frozenset[str] = frozenset(),
        let_off: frozenset[str] = frozenset(),
    ) -> Clearances | None:
        """Return what `query` does, or None as soon as a solid touches a limit or another link.

        What lies below a surface is no touching. That it is inside is sooner said than how deep.
        """
        return self._found(kin, T_site_machine, radius_m, (now_ns, off_states, let_off), give_up=True)

    def _found(
        self, kin: Kinematics, T_site_machine: Floats, radius_m: float, at: _When, give_up: bool
    ) -> Clearances | None:
        now_ns, off_states, let_off = at
        poses, halves = self.machine.solid_poses(kin)
        T = np.array(T_site_machine, dtype=np.float64, order="C")
        scalars, vectors, indices, touching, bounds = self._searched(
            T, poses, halves, radius_m, now_ns, off_states, let_off
        )
        if len(touching) or self._surfaces:
            boxes = OrientedBoxes.of_poses(T @ poses, halves)
            if give_up and self._touch(boxes, touching, bounds):
                return None
            rows = self._others(boxes, touching, bounds, radius_m, at)
            if rows:
                scalars, vectors, indices = self._merged(scalars, vectors, indices, rows)
        for array in (scalars, vectors, indices):
            freeze(array)
        return Clearances(
            *(scalars[0], vectors[0], vectors[1], vectors[2]),
            *(indices[0], indices[1], indices[2], indices[3], indices[4], scalars[1], scalars[2]),
            *(self.machine.link_names, self.limit_ids, radius_m),
        )

    def _touch(self, boxes: OrientedBoxes, touching: Ints, bounds: Floats) -> bool:
        """Return whether any of what `search` leaves as touching does touch."""
        shapes = box_shapes(boxes.halves) if self._stretching else self._rest_shapes
        result = new_result()
        for solid, cell, other in touching[np.argsort(bounds, kind="stable")].tolist():
            body = shapes[solid], transform(boxes.axes[solid], boxes.centres[solid])
            if cell >= 0:
                near, least = self._shapes.placed(cell), TOUCHING_M - self._radii[self._cells.limits[cell]]
            else:
                near, least = (shapes[other], transform(boxes.axes[other], boxes.centres[other])), TOUCHING_M
            if measure(near, body, result) <= least:
                return True
        return False

    def least(
        self,
        kin: Kinematics,
        T_site_machine: Floats,
        radius_m: float,
        now_ns: int = 0,
        off_states: frozenset[str] = frozenset(),
        let_off: frozenset[str] = frozenset(),
    ) -> Floats:
        """Return the least distance of each solid to each limit, then to each own link (S, L), infinite beyond the
        radius [m]: the distances of `query`, which see, and nothing else."""
        poses, halves = self.machine.solid_poses(kin)
        T = np.array(T_site_machine, dtype=np.float64, order="C")
        found = self._searched(T, poses, halves, radius_m, now_ns, off_states, let_off)
        for cell in found[3][:, 1].tolist():
            if cell >= 0:
                self._chains.add(int(self._cells.limits[cell]), self._indices[cell])
        least: Floats = least_distances(
            *(T, poses, halves, found, self._packed[3], self.hulls.with_edges(), self._chains.packed()),
            *(self._link_of, len(self.limits)),
        )
        least[least >= radius_m] = np.inf
        if self._surfaces:
            rows: list[_Row] = []
            boxes = OrientedBoxes.of_poses(T @ poses, halves)
            shapes = box_shapes(boxes.halves) if self._stretching else self._rest_shapes
            placed = [(shape, transform(R, t)) for shape, R, t in zip(shapes, boxes.axes, boxes.centres, strict=True)]
            self._measure_surfaces(rows, boxes, placed, radius_m, (now_ns, off_states, let_off), new_result())
            for row in rows:
                least[row[0], row[1]] = min(least[row[0], row[1]], row[4])
        return least

    def _searched(
        self,
        T: Floats,
        poses: Floats,
        halves: Floats,
        radius_m: float,
        now_ns: int,
        off_states: frozenset[str],
        let_off: frozenset[str],
    ) -> tuple[Floats, Floats, Ints, Ints, Floats]:
        """Return what is near, from scalars to bounds as `search` does."""
        hulls, when = self.hulls, (*self._when, self._rules.off(off_states, let_off), now_ns)
        while True:
            packed = (hulls.of_cell, hulls.corners, hulls.starts, hulls.radii)
            finite, lacking, found = search(
                *(T, poses, halves, float(radius_m), self._tree, self._packed, when, packed),
                *(self._own_pairs, self._link_of, self.stop_distances),
            )
            if not finite:
                raise ValueError("proximity needs a finite posture and pose, and a radius above 0")
            if not len(lacking):
                return found  # type: ignore[no-any-return]
            hulls.add_cells(lacking)

    def _others(
        self, boxes: OrientedBoxes, touching: Ints, bounds: Floats, radius_m: float, when: _When
    ) -> list[_Row]:
        """Return what `search` leaves: solids that touch a limit or each other, and surfaces."""
        shapes = box_shapes(boxes.halves) if self._stretching else self._rest_shapes
        placed = [(shape, transform(R, t)) for shape, R, t in zip(shapes, boxes.axes, boxes.centres, strict=True)]
        rows: list[_Row] = []
        result = new_result()
        cells = touching[:, 1] >= 0
        found, near = touching[cells], bounds[cells]
        order = np.lexsort((found[:, 1], near, self._cells.limits.take(found[:, 1]), found[:, 0]))
        solids, which = found[order, 0], found[order, 1]
        self._measure_cells(rows, boxes, placed, solids, which, near[order], radius_m, result)
        for mover, other in touching[~cells][:, [0, 2]].tolist():
            self._measure_links(rows, boxes, placed, mover, other, radius_m, result)
        self._measure_surfaces(rows, boxes, placed, radius_m, when, result)
        return rows

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
        """Measure pairs, sorted by solid, limit, bound and cell, until no cell of the limit can be nearer."""
        limits = self._cells.limits.take(cells)
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
            if bound >= best + SLACK_M and bound > SLACK_M:
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
            exempt = self._rules.exempt[self._rules.limits[i, 4]]
            for s in np.flatnonzero(~exempt).tolist():
                found = surface.clearance(
                    placed[s], boxes.axes[s], boxes.centres[s], boxes.halves[s], radius_m, result
                )
                if found is not None:
                    rows.append((s, i, found.triangle, -1, found.distance, found.normal, found.point_machine))

    def _measure_links(
        self,
        rows: list[_Row],
        boxes: OrientedBoxes,
        placed: list[Placed],
        mover: int,
        other: int,
        radius_m: float,
        result: Any,
    ) -> None:
        distance = measure(placed[other], placed[mover], result)
        if distance >= radius_m:
            return
        u, point = direction_and_point(result)
        if distance <= TOUCHING_M:
            distance, u, point = signed_distance(box_polyhedron(boxes, other), box_polyhedron(boxes, mover), u)
        link = self._links[other]
        rows.append((mover, len(self.limits) + link, other, link, distance, u, point))

    def _merged(
        self, scalars: Floats, vectors: Floats, indices: Ints, rows: list[_Row]
    ) -> tuple[Floats, Floats, Ints]:
        """Return what `search` found with rows of others among it, in order: by solid, limit, cell."""
        solids, limits, cells, others, distances, normals, points = zip(*rows, strict=True)
        count, own = len(rows), np.array(others) >= 0
        more, arrows, names = np.zeros((3, count)), np.empty((3, count, 3)), np.empty((5, count), np.int64)
        more[0], more[2] = distances, self.stop_distances.take(limits)
        arrows[0], arrows[1] = normals, points
        arrows[2] = arrows[1] - more[0][:, None] * arrows[0]
        names[:] = self._link_of.take(solids), others, limits, np.where(own, -1, cells), solids
        scalars, vectors = np.concatenate([scalars, more], axis=1), np.concatenate([vectors, arrows], axis=1)
        indices = np.concatenate([indices, names], axis=1)
        order = np.lexsort((indices[3], indices[2], indices[4]))
        return scalars.take(order, axis=1), vectors.take(order, axis=1), indices.take(order, axis=1)
