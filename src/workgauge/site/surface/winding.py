"""Triangles put in order: without degenerate ones, counter-clockwise in plan."""

from typing import NamedTuple

import numpy as np

from workgauge.values.arrays import Floats, Ints

#: Triangles whose height over their longest side is less are no triangles; in plan, they are vertical [m].
SLIVER_M = 1e-6
_BLOCK = 1 << 17


class Wound(NamedTuple):
    """Faces in order.

    Attributes:
        faces: (k, 3) those with an area, counter-clockwise in plan. plan_area_m2: their area in plan.
        degenerate: how many had no area and are gone. vertical: how many of `faces` are vertical.
    """

    faces: Ints
    plan_area_m2: float
    degenerate: int
    vertical: int


def wound_up(vertices: Floats, faces: Ints) -> Wound:
    """Return faces (m, 3) of vertices (n, 3) [m], the order of those that stay unchanged."""
    origin = vertices.mean(axis=0) if len(vertices) else np.zeros(3)
    kept: list[Ints] = [np.empty((0, 3), dtype=np.int64)]
    area = 0.0
    degenerate = vertical = 0
    for first in range(0, len(faces), _BLOCK):
        part = faces[first : first + _BLOCK]
        a, b, c = (vertices[part[:, k]] - origin for k in range(3))
        normal = np.cross(b - a, c - a)
        longest = np.sqrt(np.max([np.sum((p - q) ** 2, axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0))
        good = np.sqrt(np.sum(normal**2, axis=1)) > SLIVER_M * longest
        up = normal[:, 2] / 2
        turned = np.where((up < 0)[:, None], part[:, [0, 2, 1]], part)
        kept.append(turned[good])
        area += float(np.abs(up[good]).sum())
        degenerate += int((~good).sum())
        vertical += int((good & (np.abs(up) < SLIVER_M * longest)).sum())
    return Wound(np.concatenate(kept), area, degenerate, vertical)
