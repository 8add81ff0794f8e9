"""The horizontal alignment: a chain of lines, arcs and transitions, evaluated at any distance."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from workgauge.site.transitions import Course, Law, constant_course, transition_course
from workgauge.values.arrays import Floats, freeze


@dataclass(frozen=True, slots=True)
class PlanElement:
    """One element, its position relative to the plan's origin.

    Attributes:
        kind: `line`, `curve` or `spiral`, as the file calls it.
        start: (east, north) [m]. yaw: first tangent, counter-clockwise from east [rad].
        length: arc length [m], > 0. k0, k1: curvature at start and end, positive left [1/m].
        correction: (east, north) [m] added in proportion to the distance, so that the element ends where it should.
    """

    kind: str
    law: Law
    start: tuple[float, float]
    yaw: float
    length: float
    k0: float
    k1: float
    correction: tuple[float, float] = (0.0, 0.0)

    def course(self, s: Floats) -> Course:
        """Return the element's own course at arc lengths `s`, without correction."""
        ones = np.ones_like(s)
        if self.law is Law.CONSTANT:
            return constant_course(s, self.k0 * ones)
        return transition_course(self.law, s, self.length * ones, self.k0 * ones, self.k1 * ones)

    def end(self) -> tuple[float, float]:
        """Return the end point (east, north) by the element's law, without correction [m]."""
        course = self.course(np.array([self.length], dtype=np.float64))
        x, y = float(course.x[0]), float(course.y[0])
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return self.start[0] + c * x - s * y, self.start[1] + s * x + c * y

    def end_yaw(self) -> float:
        """Return the last tangent, counter-clockwise from east [rad]."""
        return self.yaw + float(self.course(np.array([self.length], dtype=np.float64)).turn[0])


@dataclass(frozen=True, slots=True)
class PlanState:
    """Plan position at k distances, arrays (k,).

    Attributes:
        e, n: relative to the plan's origin [m].
        yaw: counter-clockwise from east, not wrapped [rad].
        curvature: positive left [1/m].
    """

    e: Floats
    n: Floats
    yaw: Floats
    curvature: Floats


class PlanGeometry:
    """A chain of elements with a common local origin, so that large eastings keep full precision.

    Args:
        origin: absolute (east, north) [m] that element positions are relative to.
        elements: at least one, in order.
    """

    def __init__(self, origin: tuple[float, float], elements: Sequence[PlanElement]) -> None:
        self.origin = origin
        self.elements = tuple(elements)
        self._law = np.array([e.law for e in elements], dtype=np.int64)
        self._length = np.array([e.length for e in elements], dtype=np.float64)
        #: (m + 1,) distances of the element boundaries [m], from 0 to the length.
        self.boundaries: Floats = np.concatenate([[0.0], np.cumsum(self._length)])
        self._rows = np.array([[*e.start, e.yaw, e.k0, e.k1, *e.correction] for e in elements], dtype=np.float64)
        for array in (self._law, self._length, self.boundaries, self._rows):
            freeze(array)

    @property
    def length(self) -> float:
        """Summed length of the elements [m]."""
        return float(self.boundaries[-1])

    def at(self, distances: Floats) -> PlanState:
        """Evaluate at distances (k,) [m], which are clipped to [0, length]."""
        d = np.clip(distances, 0.0, self.length)
        index = np.clip(np.searchsorted(self.boundaries, d, side="right") - 1, 0, len(self.elements) - 1)
        return self._evaluate(index, d - self.boundaries[index])

    def at_in(self, index: np.ndarray[tuple[int], np.dtype[np.int64]], distances: Floats) -> PlanState:
        """Evaluate at distances (k,) [m] that belong to the elements `index` (k,), ends included."""
        return self._evaluate(index, np.clip(distances - self.boundaries[index], 0.0, self._length[index]))

    def _evaluate(self, index: np.ndarray[tuple[int], np.dtype[np.int64]], s: Floats) -> PlanState:
        e0, n0, yaw0, k0, k1, ce, cn = self._rows[index].T
        length = self._length[index]
        x, y, turn, curvature = (np.empty_like(s) for _ in range(4))
        laws = self._law[index]
        for code in np.unique(laws):
            here = laws == code
            law = Law(int(code))
            if law is Law.CONSTANT:
                course = constant_course(s[here], k0[here])
            else:
                course = transition_course(law, s[here], length[here], k0[here], k1[here])
            x[here], y[here], turn[here], curvature[here] = course.x, course.y, course.turn, course.curvature
        share = s / length
        c, sn = np.cos(yaw0), np.sin(yaw0)
        return PlanState(e0 + c * x - sn * y + share * ce, n0 + sn * x + c * y + share * cn, yaw0 + turn, curvature)
