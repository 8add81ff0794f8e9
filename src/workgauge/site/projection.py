"""Projection of points onto a plan: the exact nearest point, its distance and offset."""

import math

import numpy as np
from scipy.spatial import cKDTree

from workgauge.site.plan import PlanGeometry
from workgauge.values.arrays import Floats, Ints, freeze

#: A span of the search is at most this long and turns by at most this much.
_SPAN_M = 10.0
_SPAN_TURN = 0.1
_CHUNK = 20_000


class Projector:
    """Finds the nearest point of a plan.

    The plan is cut into short spans. A point's nearest span mid-point bounds its distance from above; every span that
    could be nearer is then searched for the foot of the perpendicular by a safeguarded Newton iteration, and the
    nearest of all feet and span ends wins.
    """

    def __init__(self, plan: PlanGeometry) -> None:
        self._plan = plan
        element: list[int] = []
        begins: list[Floats] = []
        ends: list[Floats] = []
        for i, item in enumerate(plan.elements):
            turn = item.length * max(abs(item.k0), abs(item.k1))
            count = max(1, math.ceil(max(item.length / _SPAN_M, turn / _SPAN_TURN)))
            knots = np.linspace(plan.boundaries[i], plan.boundaries[i + 1], count + 1)
            element += [i] * count
            begins.append(knots[:-1])
            ends.append(knots[1:])
        self._element: Ints = np.array(element, dtype=np.int64)
        self._begin: Floats = np.concatenate(begins)
        self._end: Floats = np.concatenate(ends)
        middle = plan.at_in(self._element, (self._begin + self._end) / 2)
        # Spread misclosures stretch a span by up to a few millimetres; the reach allows for that.
        self._reach = float(np.max(self._end - self._begin)) / 2 + 0.05
        self._tree = cKDTree(np.column_stack([middle.e, middle.n]))
        for array in (self._element, self._begin, self._end):
            freeze(array)

    def project(self, points: Floats) -> tuple[Floats, Floats]:
        """Return (distance (k,), offset (k,)) [m] of points (k, 2) east, north relative to the plan's origin.

        The offset is positive to the left of the direction of travel. Beyond the ends of the plan the distance is
        that of the end and the offset the whole way to it, signed by the side.
        """
        distance = np.empty(len(points))
        offset = np.empty(len(points))
        for first in range(0, len(points), _CHUNK):
            part = slice(first, first + _CHUNK)
            distance[part], offset[part] = self._project(points[part])
        return distance, offset

    def _project(self, points: Floats) -> tuple[Floats, Floats]:
        nearest, _ = self._tree.query(points)
        spans = self._tree.query_ball_point(points, nearest + self._reach, return_sorted=True)
        lists = [np.asarray(s, dtype=np.int64) for s in spans]
        counts = np.array([len(s) for s in lists])
        span = np.concatenate(lists)
        owner = np.repeat(np.arange(len(points)), counts)
        target = points[owner]
        foot = self._feet(span, target)
        candidates = np.column_stack([self._begin[span], foot, self._end[span]])
        squared = np.empty_like(candidates)
        for column in range(3):
            state = self._plan.at_in(self._element[span], candidates[:, column])
            squared[:, column] = (state.e - target[:, 0]) ** 2 + (state.n - target[:, 1]) ** 2
        choice = np.argmin(squared, axis=1)
        rows = np.arange(len(span))
        best, where = squared[rows, choice], candidates[rows, choice]
        order = np.lexsort((where, best, owner))
        winner = order[np.concatenate([[0], np.cumsum(counts)[:-1]])]
        distance = where[winner]
        state = self._plan.at_in(self._element[span[winner]], distance)
        side = np.cos(state.yaw) * (points[:, 1] - state.n) - np.sin(state.yaw) * (points[:, 0] - state.e)
        return distance, np.copysign(np.sqrt(best[winner]), side)

    def _feet(self, span: Ints, target: Floats) -> Floats:
        """Return within each span the distance where the tangent is perpendicular to the way to the target."""
        low, high = self._begin[span].copy(), self._end[span].copy()
        element = self._element[span]
        at = (low + high) / 2
        for _ in range(60):
            state = self._plan.at_in(element, at)
            de, dn = state.e - target[:, 0], state.n - target[:, 1]
            c, s = np.cos(state.yaw), np.sin(state.yaw)
            along = de * c + dn * s
            slope = 1 + state.curvature * (dn * c - de * s)
            high = np.where(along > 0, at, high)
            low = np.where(along <= 0, at, low)
            newton = np.clip(at - along / np.where(slope > 0.1, slope, 1.0), low, high)
            step = np.where(slope > 0.1, newton, (low + high) / 2)
            moved = np.max(np.abs(step - at), initial=0.0)
            at = step
            if moved < 1e-10:
                break
        return at
