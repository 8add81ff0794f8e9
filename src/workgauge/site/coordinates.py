"""The coordinate system of a site: what the file says, whether the coordinates fit, what the caller asked for."""

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from workgauge.geodesy.crs import ProjectedCrs
from workgauge.site.model import SiteModel
from workgauge.site.units import LINEAR_UNITS
from workgauge.values.arrays import Floats
from workgauge.values.errors import GeodesyError


@dataclass(frozen=True, slots=True)
class ResolvedCrs:
    """A file's coordinate system, or None, and what is to be said about it."""

    crs: ProjectedCrs | None
    warnings: tuple[str, ...]


def resolve_crs(model: SiteModel, file: str, short: str, epsg: int | None = None) -> ResolvedCrs:
    """Return the coordinate system of one file's model.

    Args:
        file: the file's path, for errors. short: what to call it in warnings.
        epsg: the caller's choice, which goes before what the file says.

    Raises:
        GeodesyError: the number is unknown or not projected, or coordinates lie outside the system's area; except
            where the file's own name for its system denotes another one that they fit, which is a warning.
    """
    warnings: list[str] = []
    declared = _declared(model.crs_declared, file, short, warnings) if epsg is None else None
    if epsg is not None:
        crs = ProjectedCrs.from_epsg(epsg)
        said = _declared_number(model.crs_declared)
        if said != epsg:
            warnings.append(f"{short}: read as EPSG:{epsg} as asked; the file says {_said(model.crs_declared)}")
    elif declared is None:
        warnings.append(f"{short}: names no coordinate system; headings from true north cannot be converted")
        return ResolvedCrs(None, tuple(warnings))
    else:
        crs = declared
    unit = LINEAR_UNITS.get(model.units.get("linear", "meter"), 1.0)
    if abs(crs.metres_per_unit / unit - 1) > 1e-9:
        warnings.append(
            f"{short}: coordinates are in {model.units['linear']}, but the unit of {crs.name} is "
            f"{crs.metres_per_unit:.9g} m; the file's unit counts"
        )
    outside = _outside(model, crs)
    if outside is not None:
        feature, place = outside
        other = _by_name(model.crs_declared) if epsg is None else None
        if other is None or other.epsg == crs.epsg or _outside(model, other) is not None:
            raise GeodesyError(
                f"coordinates of {feature} lie outside the area of the coordinate system",
                file=file,
                value=f"E {place[0]:.3f}, N {place[1]:.3f}",
                allowed=_called(crs),
            )
        warnings.append(
            f"{short}: the code says {_called(crs)}, but the coordinates lie outside its area; the name "
            f"{model.crs_declared.get('name', '')!r} is {_called(other)}, which they fit; the code is kept"
        )
    return ResolvedCrs(crs, tuple(warnings))


def _called(crs: ProjectedCrs) -> str:
    return crs.name if crs.epsg is None else f"EPSG:{crs.epsg} ({crs.name})"


def _said(declared: Mapping[str, str]) -> str:
    number = _declared_number(declared)
    return f"EPSG:{number}" if number is not None else repr(declared.get("name") or "nothing")


def _declared_number(declared: Mapping[str, str]) -> int | None:
    """Return the EPSG number a file states as its code or as its datum (`EPSG:3878`)."""
    for key in ("epsgCode", "horizontalDatum", "horizontalCoordinateSystemName"):
        match = re.fullmatch(r"(?:EPSG\s*:+\s*)?(\d{1,7})", declared.get(key, "").strip(), re.IGNORECASE)
        if match:
            return int(match[1])
    return None


def _by_name(declared: Mapping[str, str]) -> ProjectedCrs | None:
    for key in ("name", "horizontalCoordinateSystemName", "horizontalDatum", "desc"):
        found = ProjectedCrs.from_name(declared.get(key, "")) if declared.get(key) else None
        if found is not None:
            return found
    return None


def _declared(declared: Mapping[str, str], file: str, short: str, warnings: list[str]) -> ProjectedCrs | None:
    try:
        number = _declared_number(declared)
        if number is not None:
            return ProjectedCrs.from_epsg(number)
        if declared.get("epsgCode"):
            raise GeodesyError("epsgCode is no number", value=declared["epsgCode"], allowed="an EPSG number")
        if declared.get("ogcWktCode"):
            return ProjectedCrs.from_wkt(declared["ogcWktCode"])
    except GeodesyError as error:
        raise GeodesyError(
            error.message, file=file, element="CoordinateSystem", value=error.value, allowed=error.allowed
        ) from error
    named = _by_name(declared)
    if named is not None:
        warnings.append(f"{short}: states no EPSG number; its name {_said(declared)} is taken as {_called(named)}")
    elif declared:
        warnings.append(f"{short}: the coordinate system {_said(declared)} is not known")
    return named


def _outside(model: SiteModel, crs: ProjectedCrs) -> tuple[str, Floats] | None:
    """Return a feature and one of its places outside the system's area, or None."""
    named: list[tuple[str, Floats]] = []
    for a in model.alignments:
        state = a.at(a.plan.boundaries)
        named.append((f"alignment {a.name!r}", _corners(np.column_stack([state.e, state.n]))))
    named += [(f"surface {s.name!r}", _corners(s.vertices)) for s in model.surfaces]
    named += [(f"line {line.name!r}", _corners(line.points)) for line in model.lines]
    if model.points:
        places = np.array([p.position[:2] for p in model.points])
        named += [(f"point {p.name!r}", place[None]) for p, place in zip(model.points, places, strict=True)]
    places = np.concatenate([corners for _, corners in named])
    owner = np.repeat(np.arange(len(named)), [len(corners) for _, corners in named])
    bad = np.flatnonzero(~crs.contains(places[:, 0], places[:, 1]))
    if not len(bad):
        return None
    return named[owner[bad[0]]][0], places[bad[0]]


def _corners(points: Floats) -> Floats:
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    return np.array([low, high, [low[0], high[1]], [high[0], low[1]]])
