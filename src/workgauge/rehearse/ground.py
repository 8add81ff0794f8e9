"""Where the ground is: the height of the site's topmost surface under points, and the plane a machine stands on."""

import math

import numpy as np

from workgauge.site.model import SiteModel, SurfaceModel
from workgauge.values.arrays import Floats

#: Points per side of the grid under the undercarriage at which the ground is felt.
FEET = 5


def surface_heights(surface: SurfaceModel, points: Floats) -> Floats:
    """Return the surface's height (k,) at absolute plan points (k, 2), NaN outside it; the topmost of any folds."""
    plan = surface.vertices[:, :2]
    corners = plan[surface.faces]
    low, high = points.min(axis=0), points.max(axis=0)
    near = np.flatnonzero(((corners.min(axis=1) <= high) & (corners.max(axis=1) >= low)).all(axis=1))
    out = np.full(len(points), np.nan)
    if not len(near):
        return out
    a, b, c = (corners[near, i] for i in range(3))
    heights = surface.vertices[surface.faces[near], 2]
    u, v = b - a, c - a
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    area = np.where(np.abs(area) < 1e-12, np.nan, area)
    for i, point in enumerate(points):
        w = point - a
        s = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / area
        t = (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / area
        inside = (s >= -1e-9) & (t >= -1e-9) & (s + t <= 1 + 1e-9)
        if inside.any():
            z = heights[:, 0] + s * (heights[:, 1] - heights[:, 0]) + t * (heights[:, 2] - heights[:, 0])
            out[i] = z[inside].max()
    return out


def ground_heights(site: SiteModel, points: Floats) -> Floats:
    """Return the height (k,) of the topmost surface at absolute plan points (k, 2), NaN where there is none."""
    out = np.full(len(points), np.nan)
    for surface in site.surfaces:
        out = np.fmax(out, surface_heights(surface, points))
    return out


def footprint_grid(half_length: float, half_width: float, e: float, n: float, heading: float) -> Floats:
    """Return absolute plan points (FEET², 2) under a machine at (e, n) with this heading clockwise from north."""
    x, y = np.meshgrid(np.linspace(-half_length, half_length, FEET), np.linspace(-half_width, half_width, FEET))
    s, c = math.sin(heading), math.cos(heading)
    return np.stack([e + x.ravel() * s - y.ravel() * c, n + x.ravel() * c + y.ravel() * s], axis=1)


def plane_under(site: SiteModel, e: float, n: float, feet: Floats) -> tuple[float, float, float] | None:
    """Return (height at (e, n), slope to the east, slope to the north) of the least-squares plane under the feet.

    None if there is no ground under at least three feet that span a plane.
    """
    z = ground_heights(site, feet)
    on = np.isfinite(z)
    if on.sum() < 3:
        return None
    design = np.column_stack([np.ones(on.sum()), feet[on] - np.array([e, n])])
    solution, _, rank, _ = np.linalg.lstsq(design, z[on], rcond=None)
    return None if rank < 3 else (float(solution[0]), float(solution[1]), float(solution[2]))
