"""A bucket's cutting edge: its frame on a surface, and its points."""

import math
from dataclasses import dataclass

import numpy as np

from workgauge.site.surface.tin import Tin
from workgauge.values.arrays import Floats
from workgauge.values.errors import InputError
from workgauge.values.transforms import rotation_x

#: Points across an edge are no farther apart than this [m].
ACROSS_M = 0.025


@dataclass(frozen=True, slots=True)
class Bucket:
    """What of a bucket meets the ground. The tool frame is in the middle of its edge.

    Its x axis runs along the edge, z points away from the wrist; drawn towards the machine, y points away from it.

    Attributes:
        width_m: of the edge. cutting_rad: how far the wrist leans over the way ahead, from square above the surface;
            negative leans it back [rad].
    """

    width_m: float = 1.0
    cutting_rad: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.width_m <= 20.0:
            raise InputError(
                "not a bucket", element="bucket width", value=f"{self.width_m:.6g}", allowed="above 0, at most 20 m"
            )
        if not abs(self.cutting_rad) <= math.radians(80.0):
            value = f"{math.degrees(self.cutting_rad):.6g}"
            raise InputError("not a cutting angle", element="cutting_deg", value=value, allowed="-80 to 80")


def edge_frames(normals: Floats, directions: Floats, cutting_rad: float = 0.0) -> Floats:
    """Return the tool's rotations (k, 3, 3) in the site (Makkonen 19 to 21).

    `z = -w`, `y` against the way, `x = y × z`, then turned about x by the cutting angle. The printed tool offset (15)
    would put the wrist below the ground with z pointing down: here it is on the side of -z, above.

    Args:
        normals: (k, 3) of the surface, unit, upwards. directions: (k, 3) of the way, not along the normals.
    """
    z = -normals
    x = np.cross(-directions, z)
    x /= np.linalg.norm(x, axis=1)[:, None]
    R = np.stack([x, np.cross(z, x), z], axis=-1)
    turned: Floats = R @ rotation_x(-cutting_rad)[:3, :3]
    return turned


def edge_points(T: Floats, width_m: float, spacing_m: float = ACROSS_M) -> Floats:
    """Return the points (N, k, 3) across the edge at tool poses (N, 4, 4), the corners first and last."""
    k = max(math.ceil(width_m / spacing_m) + 1, 3)
    across = np.linspace(-0.5 * width_m, 0.5 * width_m, k)
    return np.asarray(T[:, None, :3, 3] + across[None, :, None] * T[:, None, :3, 0], dtype=np.float64)


def above(tin: Tin, points: Floats, origin: Floats) -> Floats:
    """Return how far points (..., 3), less an origin (3,), are above a surface, upright [m]; NaN where none is."""
    flat = points.reshape(-1, 3)
    gap: Floats = flat[:, 2] + origin[2] - tin.heights(flat[:, :2] + origin[:2])
    return gap.reshape(points.shape[:-1])
