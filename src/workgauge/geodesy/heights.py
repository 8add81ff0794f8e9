"""Height of the site from a satellite fix: by the sentence's geoid separation, a constant one, or a geoid grid."""

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
import pyproj
from numpy.typing import ArrayLike
from pyproj.exceptions import ProjError

from workgauge.values.arrays import Floats
from workgauge.values.errors import GeodesyError
from workgauge.values.navigation import GnssFix

HeightKind = Literal["sentence", "constant", "grid"]

#: Characters in a grid's name that PROJ would read as something else than a file's name.
NO_FILE = ('"', ",", "\n", "\x00")


@dataclass(frozen=True, slots=True)
class HeightModel:
    """How a receiver's height becomes the site's; made by `from_sentence`, `constant`, `from_grid` or `of`.

    `sentence`: the height above mean sea level as the receiver sends it, or ellipsoidal minus separation where it
    sends those; the receiver's own coarse geoid model counts. `constant` and `grid`: the ellipsoidal height (sent, or
    sent height plus sent separation, which undoes the receiver's own model) minus the geoid's height above the
    ellipsoid. What cannot be known is NaN: a missing separation, a place outside the grid.

    Attributes:
        kind: which of the three. geoid_separation_m: of `constant`. grid: the file of `grid`, absolute.
    """

    kind: HeightKind = "sentence"
    geoid_separation_m: float | None = None
    grid: str | None = None

    @classmethod
    def of(
        cls, kind: HeightKind = "sentence", geoid_separation_m: float | None = None, geoid_grid: str | None = None
    ) -> "HeightModel":
        """Return the model a machine file's `positioning:` section asks for (its keys of the same names).

        Raises:
            GeodesyError: what the kind needs is missing, or the grid cannot be used.
        """
        if kind == "sentence":
            return cls.from_sentence()
        if kind == "constant":
            return cls.constant(math.nan if geoid_separation_m is None else geoid_separation_m)
        if not geoid_grid:
            raise GeodesyError("a grid's height needs the grid", element="geoid_grid", allowed="a file")
        return cls.from_grid(geoid_grid)

    @classmethod
    def from_sentence(cls) -> "HeightModel":
        """Return the model that trusts the receiver's own geoid separation."""
        return cls()

    @classmethod
    def constant(cls, geoid_separation_m: float) -> "HeightModel":
        """Return the model with one geoid separation for the whole site [m].

        Raises:
            GeodesyError: if it is no number, or beyond any the earth has.
        """
        if not abs(geoid_separation_m) <= 150.0:
            raise GeodesyError(
                "no such geoid separation",
                element="geoid_separation_m",
                value=geoid_separation_m,
                allowed="-150 to 150 m",
            )
        return cls("constant", float(geoid_separation_m))

    @classmethod
    def from_grid(cls, grid: str | Path) -> "HeightModel":
        """Return the model of a geoid grid in a format of PROJ's (GeoTIFF, GTX).

        Args:
            grid: a path, or the name of a file in PROJ's data directories. Nothing is fetched from anywhere.

        Raises:
            GeodesyError: if there is no such file, or it is no grid.
        """
        path = str(_grid_file(str(grid)))
        _separations(path)
        return cls("grid", grid=path)

    @property
    def words(self) -> str:
        """The choice in words, as every output states it."""
        if self.kind == "constant":
            return f"ellipsoidal minus a constant geoid separation of {self.geoid_separation_m:g} m"
        if self.kind == "grid":
            return f"ellipsoidal minus the geoid of the grid {self.grid}"
        return "above mean sea level as the receiver sends it, by the receiver's own geoid separation"

    def height(self, fix: GnssFix) -> float:
        """Return the site's height of an antenna [m]; NaN if it is unknown."""
        return float(
            self.heights(
                [fix.latitude],
                [fix.longitude],
                [fix.height_msl_m],
                [fix.height_ellipsoid_m],
                [fix.geoid_separation_m],
            )[0]
        )

    def heights(
        self,
        latitude: ArrayLike,
        longitude: ArrayLike,
        height_msl_m: ArrayLike,
        height_ellipsoid_m: ArrayLike,
        separation_m: ArrayLike,
    ) -> Floats:
        """Return the site's heights (n,) [m] of n antennas, NaN where unknown.

        Args:
            latitude, longitude: (n,) [rad]. height_msl_m, height_ellipsoid_m, separation_m: (n,) as sent, NaN where
            not sent [m].
        """
        msl, ellipsoid, sent = (
            np.asarray(one, dtype=np.float64) for one in (height_msl_m, height_ellipsoid_m, separation_m)
        )
        if self.kind == "sentence":
            return np.where(np.isfinite(msl), msl, ellipsoid - sent)
        ellipsoid = np.where(np.isfinite(ellipsoid), ellipsoid, msl + sent)
        return np.asarray(ellipsoid - self.separation(latitude, longitude), dtype=np.float64)

    def separation(self, latitude: ArrayLike, longitude: ArrayLike) -> Floats:
        """Return the geoid's height above the ellipsoid (n,) [m] at places [rad]; NaN where this model has none.

        `sentence` has none of its own anywhere.
        """
        lat, lon = np.asarray(latitude, dtype=np.float64), np.asarray(longitude, dtype=np.float64)
        if self.kind == "grid" and self.grid is not None:
            with np.errstate(all="ignore"):
                _, _, up = _separations(self.grid).transform(np.degrees(lon), np.degrees(lat), np.zeros_like(lat))
            return np.where(np.isfinite(up), up, np.nan)
        value = math.nan if self.geoid_separation_m is None else self.geoid_separation_m
        return np.where(np.isfinite(lat) & np.isfinite(lon), value, np.nan)


def _grid_file(grid: str) -> Path:
    """Return the file of a grid: the path itself, or in PROJ's data directories.

    PROJ's own search is not used: it takes `@name` and `null` for "no shift, silently", and may go to the network.
    """
    if not grid or any(character in grid for character in NO_FILE):
        raise GeodesyError("not the name of a geoid grid", element="geoid_grid", value=grid, allowed="one file")
    folders = [pyproj.datadir.get_data_dir(), pyproj.datadir.get_user_data_dir()]  # type: ignore[attr-defined]
    for place in (Path(grid), *(Path(folder) / grid for folder in folders if not Path(grid).is_absolute())):
        if place.is_file():
            return place.resolve()
    raise GeodesyError(
        "no such geoid grid",
        file=grid,
        allowed="a path, or a file in " + " or ".join(folders),
    )


@lru_cache(maxsize=8)
def _separations(path: str) -> pyproj.Transformer:
    """Return what gives (lon, lat [degree], 0) the grid's height in the third place; infinite outside the grid."""
    pipeline = (
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
        f'+step +proj=vgridshift +grids="{path}" +multiplier=1 '
        "+step +proj=unitconvert +xy_in=rad +xy_out=deg"
    )
    try:
        return pyproj.Transformer.from_pipeline(pipeline)
    except ProjError as error:
        raise GeodesyError(
            "not a geoid grid that can be read", file=path, allowed="a vertical grid of PROJ's: GeoTIFF or GTX"
        ) from error
