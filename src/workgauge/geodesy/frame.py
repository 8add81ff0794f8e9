"""The site's local frame: absolute coordinates minus an origin near the work, so that float64 keeps micrometres."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from workgauge.geodesy.crs import ProjectedCrs
from workgauge.values.arrays import Floats, frozen


@dataclass(frozen=True, slots=True, eq=False)
class SiteFrame:
    """East, north, up with a local origin; the axes are the grid's.

    Attributes:
        crs: the coordinate system, or None if the site does not say.
        origin: (3,) absolute easting, northing, height of the origin [m].
    """

    crs: ProjectedCrs | None
    origin: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "origin", frozen(self.origin, (3,)))

    def to_local(self, points: ArrayLike) -> Floats:
        """Return absolute points (..., 3) [m] in the local frame."""
        out: Floats = np.asarray(points, dtype=np.float64) - self.origin
        return out

    def to_absolute(self, points: ArrayLike) -> Floats:
        """Return local points (..., 3) [m] in absolute coordinates."""
        out: Floats = np.asarray(points, dtype=np.float64) + self.origin
        return out
