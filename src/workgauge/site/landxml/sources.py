"""What a surface without faces is made of: its points, `DataPoints`, `Breaklines`, `Contours` and `Boundaries`."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import cast

import numpy as np

from workgauge.site.landxml.blocks import line_of
from workgauge.site.landxml.document import Document, Element, child, children, descendants, label
from workgauge.site.landxml.elements import PlaceReader
from workgauge.site.landxml.units import FileUnits
from workgauge.site.surface.bounded import Boundary, BoundaryKind
from workgauge.values.arrays import Floats

LISTS = ("PntList3D", "PntList2D")
#: `bndType` of boundaries that say where the surface is; others hold textures and the like.
_BOUNDARIES = ("outer", "void", "island")


@dataclass
class Sources:
    """What a surface is made of; absolute east, north, height [m].

    Attributes:
        points: (k, 3) each. breaklines: (p, 3) each, contours among them. boundaries: where the surface is.
    """

    points: list[Floats] = field(default_factory=list)
    breaklines: list[Floats] = field(default_factory=list)
    boundaries: list[Boundary] = field(default_factory=list)

    @property
    def heights(self) -> Floats:
        """(n,) of points and break lines."""
        found: Floats = np.concatenate([np.empty(0), *(part[:, 2] for part in (*self.points, *self.breaklines))])
        return found

    def words(self) -> str:
        """Return in words what there is."""
        counts = {
            "points": sum(len(part) for part in self.points),
            "break lines and contours": len(self.breaklines),
            "boundaries": len(self.boundaries),
        }
        return ", ".join(f"{count} {name}" for name, count in counts.items() if count)


def sources_of(document: Document, units: FileUnits, places: PlaceReader, surface: Element) -> Sources:
    """Return what a `Surface` element holds beside faces. What has no heights is left out, with a warning.

    Raises:
        SiteError: coordinates that cannot be read.
    """
    found = Sources()
    scale = np.array([units.linear, units.linear, units.elevation])
    for block in (document.points[p] for p in descendants(surface, "Pnts") if p in document.points):
        found.points.append(block.values[:, [1, 0, 2]] * scale)
    data = child(surface, "SourceData")
    if data is None:
        return found
    for kind, group, name in (("points", None, "DataPoints"), ("breaklines", "Breaklines", "Breakline")):
        for element in _of(data, group, name):
            for places_found in (places.polyline(one) for one in children(element, *LISTS)):
                if np.isfinite(places_found[:, 2]).all():
                    getattr(found, kind).append(places_found)
                else:
                    document.warn("has no heights and is left out of the surface", label(element), line_of(element))
    for element in _of(data, "Contours", "Contour"):
        found.breaklines += _contour(document, units, places, element)
    for element in _of(data, "Boundaries", "Boundary"):
        kind = (element.get("bndType") or "outer").strip()
        if kind in _BOUNDARIES:
            for one in children(element, *LISTS):
                name = f"boundary at line {line_of(element) or 0} ({kind})"
                found.boundaries.append(Boundary(cast(BoundaryKind, kind), places.polyline(one), name))
    return found


def _of(data: Element, group: str | None, name: str) -> Iterator[Element]:
    """Yield the elements of a name, of those in groups of theirs."""
    for parent in [data] if group is None else children(data, group):
        yield from children(parent, name)


def _contour(document: Document, units: FileUnits, places: PlaceReader, element: Element) -> list[Floats]:
    """Return a contour's lines (p, 3), at its height where they have none of their own."""
    height = document.number(element, "elev")
    lines = []
    for one in children(element, *LISTS):
        line = np.array(places.polyline(one))
        if not np.isfinite(line[:, 2]).all():
            if height is None:
                document.warn("has no height and is left out of the surface", label(element), line_of(element))
                continue
            line[:, 2] = height * units.elevation
        lines.append(line)
    return lines
