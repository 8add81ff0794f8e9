"""One LandXML file to one site model; the coordinate system is named here and resolved by `site.coordinates`."""

from pathlib import Path

import numpy as np

from workgauge.site.landxml.alignments import read_alignments
from workgauge.site.landxml.blocks import line_of
from workgauge.site.landxml.census import count_unread
from workgauge.site.landxml.document import Document, child, label, open_document
from workgauge.site.landxml.elements import PlaceReader
from workgauge.site.landxml.heights import doubt_heights
from workgauge.site.landxml.lines import read_pipes, read_plan_features, read_surface_lines
from workgauge.site.landxml.points import named_points, read_locations, read_points, read_structures
from workgauge.site.landxml.surfaces import read_surfaces
from workgauge.site.landxml.units import FileUnits, read_units
from workgauge.site.model import LineFeature, PointFeature, SiteModel
from workgauge.values.errors import SiteError

_CRS_KEYS = (
    "epsgCode",
    "name",
    "desc",
    "horizontalDatum",
    "horizontalCoordinateSystemName",
    "ogcWktCode",
    "verticalDatum",
    "verticalCoordinateSystemName",
    "rotationAngle",
)


def looks_like_landxml(path: Path, head: bytes) -> bool:
    """Return whether a file is to be read as LandXML: by its suffix, or because it starts like XML."""
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    return path.suffix.lower() in (".xml", ".landxml") or text.startswith((b"<", b"\xff\xfe<", b"\xfe\xff\x00<"))


def read_landxml(path: Path) -> SiteModel:
    """Return what a LandXML or Inframodel file holds, its coordinate system not yet resolved.

    Raises:
        SiteError: the file cannot be read, contradicts itself, or holds nothing.
    """
    document = open_document(path)
    units = read_units(document)
    places = PlaceReader(document, units, named_points(document))
    alignments, string_lines, cant_units = read_alignments(document, units, places)
    surfaces = read_surfaces(document, units, places)
    points = [
        *read_points(document, places),
        *read_locations(document, places),
        *read_structures(document, units, places),
    ]
    lines = [
        *string_lines,
        *read_plan_features(document, units, places),
        *read_pipes(document, units, places),
        *read_surface_lines(document, places),
    ]
    _doubt_points_and_lines(document, units, points, lines)
    unread = count_unread(document)
    if not (alignments or surfaces or points or lines):
        found = ", ".join(f"{count} {name}" for name, count in unread.items())
        raise SiteError("holds no alignments, surfaces, points or lines", file=path, value=found or None)
    names = dict(units.names)
    if cant_units:
        names["cant"] = ", ".join(sorted(set(cant_units)))
    return SiteModel(
        crs=None,
        crs_declared=_declared(document),
        units=names,
        alignments=tuple(alignments),
        surfaces=tuple(surfaces),
        points=tuple(points),
        lines=tuple(lines),
        warnings=tuple(document.warnings),
        files=(str(path),),
    )


def _doubt_points_and_lines(
    document: Document, units: FileUnits, points: list[PointFeature], lines: list[LineFeature]
) -> None:
    if points:
        heights = np.array([p.position[2] for p in points])
        doubt_heights(document, units, heights, "points", name=lambda i: points[i].source.feature)
    if lines:
        heights = np.concatenate([line.points[:, 2] for line in lines])
        owner = np.repeat(np.arange(len(lines)), [len(line.points) for line in lines])
        doubt_heights(document, units, heights, "lines", name=lambda i: lines[owner[i]].source.feature)


def _declared(document: Document) -> dict[str, str]:
    """Return what the file says of its coordinate system, verbatim."""
    element = child(document.root, "CoordinateSystem")
    if element is None:
        return {}
    declared = {key: value.strip() for key in _CRS_KEYS if (value := element.get(key)) and value.strip()}
    angle = document.number(element, "rotationAngle")
    if angle:
        document.warn(f"rotationAngle {angle:g} is not applied", label(element), line_of(element))
    return declared
