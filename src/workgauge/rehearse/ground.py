"""The plane a machine stands on: fitted to the ground under its undercarriage, by the heights its limits have."""

import math

import numpy as np

from workgauge.gauge.heights import ORIGINS, Origin, SiteHeights
from workgauge.values.arrays import Floats

#: Points per side of the grid under the undercarriage at which the ground is felt.
FEET = 5


def footprint_grid(half_length: float, half_width: float, e: float, n: float, heading: float) -> Floats:
    """Return absolute plan points (FEET², 2) under a machine at (e, n) with this heading clockwise from north."""
    x, y = np.meshgrid(np.linspace(-half_length, half_length, FEET), np.linspace(-half_width, half_width, FEET))
    s, c = math.sin(heading), math.cos(heading)
    return np.stack([e + x.ravel() * s - y.ravel() * c, n + x.ravel() * c + y.ravel() * s], axis=1)


def plane_under(heights: SiteHeights, e: float, n: float, feet: Floats) -> tuple[float, float, float] | None:
    """Return (height at (e, n), slope to the east, slope to the north) of the least-squares plane under the feet.

    None if there is no surface under at least three feet that span a plane.
    """
    z, origin = heights.at(feet)
    on = origin == ORIGINS.index(Origin.SURFACE)
    if on.sum() < 3:
        return None
    design = np.column_stack([np.ones(on.sum()), feet[on] - np.array([e, n])])
    solution, _, rank, _ = np.linalg.lstsq(design, z[on], rcond=None)
    return None if rank < 3 else (float(solution[0]), float(solution[1]), float(solution[2]))
