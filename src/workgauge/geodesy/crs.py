"""Projected coordinate systems by EPSG number or WKT, with grid convergence, point scale and area of use."""

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
import pyproj
from numpy.typing import ArrayLike, NDArray
from pyproj.exceptions import CRSError, ProjError

from workgauge.values.arrays import Floats
from workgauge.values.errors import GeodesyError

#: Systems are used this far beyond the area they are published for [degree].
AREA_MARGIN_DEG = 1.0


@dataclass(frozen=True, slots=True)
class ProjectedCrs:
    """A projected coordinate system; coordinates go in and out in metres, whatever unit the system itself uses.

    Attributes:
        epsg: its EPSG number, or None if it was given as text without one.
        name: as the EPSG register or the text calls it.
        metres_per_unit: length of the system's own unit [m].
    """

    epsg: int | None
    name: str
    metres_per_unit: float
    _wkt: str = field(repr=False)

    @classmethod
    def from_epsg(cls, epsg: int) -> "ProjectedCrs":
        """Return the system with this EPSG number.

        Raises:
            GeodesyError: the number is unknown, or is no projected system.
        """
        return _from_epsg(int(epsg))

    @classmethod
    def from_wkt(cls, wkt: str) -> "ProjectedCrs":
        """Return the system described by well-known text.

        Raises:
            GeodesyError: the text cannot be read, or describes no projected system.
        """
        try:
            crs = pyproj.CRS.from_wkt(wkt)
        except (CRSError, ValueError) as error:
            raise GeodesyError("coordinate system text that cannot be read", value=wkt, allowed="WKT") from error
        return _checked(crs, wkt)

    @classmethod
    def from_name(cls, name: str) -> "ProjectedCrs | None":
        """Return the EPSG system with this very name, or None.

        Case, spaces and punctuation do not matter. The short Finnish names of Inframodel files (`GK21`,
        `ETRS-TM35FIN`) are understood as `ETRS89 / GK21FIN` and `ETRS89 / TM35FIN(E,N)`.
        """
        epsg = _names().get(_plain(name))
        return None if epsg is None else _from_epsg(epsg)

    def convergence(self, e: ArrayLike, n: ArrayLike) -> Floats:
        """Return the grid convergence [rad] at easting and northing [m], arrays of one shape.

        It is the angle from true north to grid north, clockwise: grid heading = true heading - convergence. On a
        transverse Mercator grid in the northern hemisphere it is positive east of the central meridian. NaN where the
        projection has no inverse. Source: PROJ's factors.
        """
        out: Floats = np.radians(self._factors(e, n).meridian_convergence)
        return out

    def grid_heading(self, true_heading: ArrayLike, e: ArrayLike, n: ArrayLike) -> Floats:
        """Return headings from grid north, clockwise, in [0, 2 pi) [rad], of headings from true north [rad].

        Args:
            true_heading: as receivers give it. e, n: where [m].

        NaN where the projection has no inverse.
        """
        heading = np.mod(np.asarray(true_heading, dtype=np.float64) - _finite(self.convergence(e, n)), 2 * np.pi)
        return np.where(heading >= 2 * np.pi, 0.0, heading)  # a tiny negative angle rounds up to a full turn

    def point_scale(self, e: ArrayLike, n: ArrayLike) -> Floats:
        """Return grid length over ellipsoidal length at easting and northing [m]; NaN where there is no inverse.

        The root of the area scale: on conformal grids, as all of engineering's are, the same in every direction.
        """
        out: Floats = np.sqrt(np.asarray(self._factors(e, n).areal_scale, dtype=np.float64))
        return out

    def contains(self, e: ArrayLike, n: ArrayLike, margin_deg: float = AREA_MARGIN_DEG) -> NDArray[np.bool_]:
        """Return whether points [m] lie in the system's area of use, widened by `margin_deg`.

        A point that does not come back when projected there and back lies outside. A system without a stated area
        (most texts) contains every point that comes back.
        """
        e, n = np.broadcast_arrays(np.asarray(e, dtype=np.float64), np.asarray(n, dtype=np.float64))
        lat, lon = self.to_geodetic(e, n)
        finite = np.isfinite(lat) & np.isfinite(lon)
        back_e, back_n = self.from_geodetic(np.where(finite, lat, 0.0), np.where(finite, lon, 0.0))
        with np.errstate(invalid="ignore"):
            inside: NDArray[np.bool_] = finite & (np.hypot(back_e - e, back_n - n) < 1.0)
        area = _crs(self._wkt).area_of_use
        if area is None:
            return inside
        lat_deg, lon_deg = np.degrees(lat), np.degrees(lon)
        with np.errstate(invalid="ignore"):
            east_of_west = np.mod(lon_deg - (area.west - margin_deg), 360.0)
            width = min(np.mod(area.east - area.west, 360.0) + 2 * margin_deg, 360.0)
            inside &= (lat_deg >= area.south - margin_deg) & (lat_deg <= area.north + margin_deg)
            inside &= east_of_west <= width
        return inside

    def to_geodetic(self, e: ArrayLike, n: ArrayLike) -> tuple[Floats, Floats]:
        """Return (latitude, longitude) [rad] on the system's own datum; NaN where there is none."""
        with np.errstate(all="ignore"):
            lon, lat = _transformer(self._wkt).transform(
                np.asarray(e, dtype=np.float64) / self.metres_per_unit,
                np.asarray(n, dtype=np.float64) / self.metres_per_unit,
            )
        return _finite(np.radians(lat)), _finite(np.radians(lon))

    def from_geodetic(self, lat: ArrayLike, lon: ArrayLike) -> tuple[Floats, Floats]:
        """Return (easting, northing) [m] of latitude and longitude [rad] on the system's own datum; NaN if none."""
        with np.errstate(all="ignore"):
            e, n = _transformer(self._wkt).transform(np.degrees(lon), np.degrees(lat), direction="INVERSE")
        return _finite(np.asarray(e) * self.metres_per_unit), _finite(np.asarray(n) * self.metres_per_unit)

    def datum_shift_m(self, lat: float, lon: float) -> float:
        """Return how far a place's coordinates move on the ground from WGS 84 to this system's own datum [m].

        What receivers deliver is WGS 84 or the correction service's own datum (in Europe ETRS89, here 0 m off), and
        `from_geodetic` shifts nothing: a large value means that this system needs a shift first. NaN where PROJ knows
        no shift without a grid that is not there.

        Args:
            lat, lon: [rad].
        """
        shift = _from_wgs84(self._wkt)
        geodetic = _crs(self._wkt).geodetic_crs
        if shift is None or geodetic is None:
            return math.nan
        with np.errstate(all="ignore"):
            moved_lon, moved_lat = shift.transform(math.degrees(lon), math.degrees(lat))
        if not (math.isfinite(moved_lon) and math.isfinite(moved_lat)):
            return math.nan
        geod = geodetic.get_geod()
        if geod is None:
            return math.nan
        return float(geod.inv(math.degrees(lon), math.degrees(lat), moved_lon, moved_lat)[2])

    def _factors(self, e: ArrayLike, n: ArrayLike) -> Any:
        lat, lon = self.to_geodetic(e, n)
        try:
            return _proj(self._wkt).get_factors(np.degrees(lon), np.degrees(lat))
        except ProjError as error:
            raise GeodesyError("no projection factors here", element=self.name, value=(e, n)) from error


def _finite(values: ArrayLike) -> Floats:
    array = np.asarray(values, dtype=np.float64)
    return np.where(np.isfinite(array), array, np.nan)


@lru_cache(maxsize=64)
def _from_epsg(epsg: int) -> ProjectedCrs:
    try:
        crs = pyproj.CRS.from_epsg(epsg)
    except (CRSError, ValueError, OverflowError) as error:
        raise GeodesyError(
            "unknown EPSG number", value=epsg, allowed="the number of a projected coordinate system"
        ) from error
    return _checked(crs, epsg)


def _checked(crs: pyproj.CRS, value: object) -> ProjectedCrs:
    """Return the projected (horizontal) part of a system."""
    if crs.is_compound and crs.sub_crs_list:
        crs = crs.sub_crs_list[0]
    if crs.is_bound and crs.source_crs is not None:
        crs = crs.source_crs
    if not crs.is_projected or not crs.axis_info or crs.geodetic_crs is None:
        raise GeodesyError(
            f"not a projected coordinate system but {crs.type_name}", value=value, allowed="a projected system"
        )
    if any(axis.direction == "west" for axis in crs.axis_info):  # turned or mirrored: left, right, every heading
        raise GeodesyError(
            f"a coordinate system that counts westwards ({crs.name})",
            value=value,
            allowed="a projected system with easting and northing",
        )
    return ProjectedCrs(crs.to_epsg(), crs.name, float(crs.axis_info[0].unit_conversion_factor), crs.to_wkt())


@lru_cache(maxsize=64)
def _crs(wkt: str) -> pyproj.CRS:
    return pyproj.CRS.from_wkt(wkt)


@lru_cache(maxsize=64)
def _transformer(wkt: str) -> pyproj.Transformer:
    crs = _crs(wkt)
    try:
        return pyproj.Transformer.from_crs(crs, crs.geodetic_crs, always_xy=True)
    except (CRSError, ProjError) as error:
        raise GeodesyError("coordinate system that cannot be computed", value=crs.name) from error


@lru_cache(maxsize=64)
def _from_wgs84(wkt: str) -> pyproj.Transformer | None:
    try:
        geodetic = _crs(wkt).geodetic_crs
        return pyproj.Transformer.from_crs("EPSG:4326", geodetic, always_xy=True, allow_ballpark=False)
    except (CRSError, ProjError):
        return None


@lru_cache(maxsize=64)
def _proj(wkt: str) -> pyproj.Proj:
    return pyproj.Proj(_crs(wkt))


def _plain(name: str) -> str:
    return "".join(c for c in name.casefold() if c.isalnum())


@lru_cache(maxsize=1)
def _names() -> dict[str, int]:
    """Return the numbers of all projected EPSG systems by plain name; names that are not unique are left out."""
    known: dict[str, int] = {}
    twice: set[str] = set()
    infos = pyproj.database.query_crs_info(auth_name="EPSG", pj_types=pyproj.enums.PJType.PROJECTED_CRS)
    for info in infos:
        plain = _plain(info.name)
        if plain in known:
            twice.add(plain)
        known[plain] = int(info.code)
    for plain in twice:
        del known[plain]
    for zone in range(19, 32):
        official = known.get(_plain(f"ETRS89 / GK{zone}FIN"))
        if official is not None:
            for short in (f"GK{zone}", f"GK{zone}FIN", f"ETRS-GK{zone}", f"ETRS-GK{zone}FIN", f"ETRS89 / GK{zone}"):
                known.setdefault(_plain(short), official)
    known.setdefault(_plain("ETRS-TM35FIN"), 3067)
    known.setdefault(_plain("TM35FIN"), 3067)
    return known
