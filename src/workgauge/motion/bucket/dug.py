"""What a bucket's edge has swept, cell by cell in plan, against the surface it was to follow."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from workgauge.motion.bucket.edge import above, edge_points
from workgauge.site.surface.tin import Tin
from workgauge.values.arrays import Floats, freeze

#: Side of a cell [m].
CELL_M = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class DugMap:
    """How far the lowest the edge came is above the design, by cells in plan. All arrays are read-only.

    Attributes:
        low: (2,) corner of the first cell, absolute east, north [m]. cell_m: side of a cell.
        left_m: (columns, rows) above the design, upright, negative below it; NaN where the edge did not come.
        deepest_m: how far the edge was below the design anywhere at any pose, 0 for nowhere.
        allowed_m: how far it was allowed to be, None if that was not asked. Of several designs with depths of their
            own, both are those of the one that has the least left.
    """

    low: Floats
    cell_m: float
    left_m: Floats
    deepest_m: float
    allowed_m: float | None = None

    @property
    def rms_m(self) -> float:
        """Of all cells swept [m]."""
        return float(np.sqrt(np.nanmean(self.left_m**2)))

    @property
    def mean_m(self) -> float:
        """Of all cells swept [m]."""
        return float(np.nanmean(self.left_m))

    @property
    def area_m2(self) -> float:
        """Of the cells swept [m2]."""
        return float(np.isfinite(self.left_m).sum()) * self.cell_m**2

    @property
    def over_dug(self) -> bool:
        """Whether the edge was deeper than allowed anywhere."""
        return self.allowed_m is not None and self.deepest_m > self.allowed_m

    def as_json(self) -> dict[str, Any]:
        """Return its numbers."""
        known = self.left_m[np.isfinite(self.left_m)]
        return {
            "rms_m": round(self.rms_m, 5),
            "mean_m": round(self.mean_m, 5),
            "highest_m": round(float(known.max()), 5),
            "lowest_m": round(float(known.min()), 5),
            "deepest_m": round(self.deepest_m, 5),
            "allowed_m": self.allowed_m,
            "area_m2": round(self.area_m2, 3),
            "cell_m": self.cell_m,
        }


def dug_map(
    tin: Tin,
    cuts: list[Floats],
    width_m: float,
    origin: Floats,
    *,
    allowed_m: float | None = None,
    cell_m: float = CELL_M,
    beside: Sequence[Floats] = (),
) -> DugMap | None:
    """Return what an edge swept, None if it was nowhere over the surface.

    Between poses the edge is taken to move evenly; the steps are no longer than half a cell.

    Args:
        cuts: of each the tool's poses (N, 4, 4) less an origin (3,), in order.
        beside: poses (N, 4, 4) of its ways there and back, whose depth counts, not their sweep.
    """
    places: list[Floats] = []
    deepest = 0.0
    for T in (*cuts, *beside):
        at_ticks = above(tin, edge_points(T, width_m), origin)
        deepest = max(deepest, -float(np.nanmin(at_ticks, initial=0.0)))
    for T in cuts:
        across = edge_points(T, width_m, 0.5 * cell_m)
        moves = np.linalg.norm(np.diff(across[:, [0, -1]], axis=0), axis=2).max(axis=1, initial=0.0)
        for k in range(len(T) - 1):
            parts = max(1, math.ceil(float(moves[k]) / (0.5 * cell_m)))
            share = (np.arange(parts) / parts)[:, None, None]
            places.append(((1.0 - share) * across[k] + share * across[k + 1]).reshape(-1, 3))
        places.append(across[-1])
    if not places:
        return None
    every = np.concatenate(places)
    gaps_found = above(tin, every, origin)
    known = np.isfinite(gaps_found)
    if not known.any():
        return None
    every, gaps = every[known, :2] + origin[:2], gaps_found[known]
    low = np.floor(every.min(axis=0) / cell_m) * cell_m
    index = ((every - low) / cell_m).astype(np.int64)
    shape = index.max(axis=0) + 1
    left = np.full(tuple(shape.tolist()), np.inf)
    np.minimum.at(left, (index[:, 0], index[:, 1]), gaps)
    left = np.where(np.isfinite(left), left, np.nan)
    freeze(left)
    return DugMap(low, cell_m, left, deepest, allowed_m)


def merged(maps: Sequence[DugMap]) -> DugMap:
    """Return one map of several with cells of one size, each against its own design; the lowest of each cell."""
    cell = maps[0].cell_m
    firsts = np.array([np.rint(one.low / cell) for one in maps]).astype(np.int64)
    origin = firsts.min(axis=0)
    ends = np.array([first + one.left_m.shape for first, one in zip(firsts, maps, strict=True)])
    left = np.full(tuple((ends.max(axis=0) - origin).tolist()), np.nan)
    for first, one in zip(firsts - origin, maps, strict=True):
        part = tuple(slice(int(a), int(a) + n) for a, n in zip(first, one.left_m.shape, strict=True))
        left[part] = np.fmin(left[part], one.left_m)
    freeze(left)
    worst = max(maps, key=lambda one: one.deepest_m - (math.inf if one.allowed_m is None else one.allowed_m))
    return DugMap(origin * cell, cell, left, worst.deepest_m, worst.allowed_m)
