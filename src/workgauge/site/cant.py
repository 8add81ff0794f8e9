"""Cant along an alignment, signed: positive where the low rail is on the left, as on a left-hand curve."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from workgauge.site.transitions import Law, shape
from workgauge.values.arrays import Floats, freeze


@dataclass(frozen=True, slots=True)
class CantPoint:
    """A place where the cant is given.

    Attributes:
        distance: along the alignment [m].
        cant: signed [m], positive with the low rail on the left.
        law: how the cant runs from here to the next point.
    """

    distance: float
    cant: float
    law: Law = Law.CLOTHOID


class CantTable:
    """Signed cant over the distance, vectorised.

    Args:
        points: at least one, distances not decreasing (two at one distance are a step).
        gauge_m: track gauge, or the base the cant refers to, as the file gives it [m].
        rotation_point: what the file says the track is turned about, if it says.
    """

    def __init__(self, points: Sequence[CantPoint], gauge_m: float | None, rotation_point: str | None) -> None:
        self.points = tuple(points)
        self.gauge_m = gauge_m
        self.rotation_point = rotation_point
        self._distance = np.array([p.distance for p in points])
        self._cant = np.array([p.cant for p in points])
        self._law = np.array([p.law for p in points], dtype=np.int64)
        for array in (self._distance, self._cant, self._law):
            freeze(array)

    @property
    def breaks(self) -> Floats:
        """Distances of the given places [m]."""
        return self._distance

    def at(self, distances: Floats) -> Floats:
        """Return the signed cant [m] at distances (k,) [m], constant before the first and after the last place."""
        last = len(self._distance) - 1
        index = np.searchsorted(self._distance, distances, side="right") - 1
        cant: Floats = self._cant[np.clip(index, 0, last)].copy()
        inside = (index >= 0) & (index < last)
        i = index[inside]
        span = self._distance[i + 1] - self._distance[i]
        u = (distances[inside] - self._distance[i]) / span
        share = np.empty_like(u)
        for code in np.unique(self._law[i]):
            here = self._law[i] == code
            share[here] = shape(Law(int(code)), u[here])
        cant[inside] += share * (self._cant[i + 1] - self._cant[i])
        return cant
