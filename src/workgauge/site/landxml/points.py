"""Points: `CgPoint` elements in their groups, plan features that are mere locations, structures of pipe networks."""

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from workgauge.site.landxml.blocks import line_of
from workgauge.site.landxml.document import Document, Element, children, descendants, label, local
from workgauge.site.landxml.elements import PlaceReader
from workgauge.site.landxml.features import code_of, feature_codes
from workgauge.site.landxml.lines import diameter_of, structs
from workgauge.site.landxml.units import FileUnits
from workgauge.site.model import PointFeature
from workgauge.values.arrays import Floats, frozen
from workgauge.values.limits import Source


def named_points(document: Document) -> dict[str, list[Element]]:
    """Return the `CgPoint` elements that have a name, for elements that refer to them."""
    named: dict[str, list[Element]] = {}
    for element in descendants(document.root, "CgPoint"):
        name = (element.get("name") or "").strip()
        if name:
            named.setdefault(name, []).append(element)
    return named


def read_points(document: Document, places: PlaceReader) -> list[PointFeature]:
    """Return the survey points; a point that only repeats another by reference keeps its own name and code.

    Raises:
        SiteError: coordinates that are missing or not finite.
    """
    points: list[PointFeature] = []
    groups: dict[Element, list[Element]] = {}
    for element in descendants(document.root, "CgPoint"):
        parent = element.getparent()
        if parent is None:
            continue
        if parent not in groups:
            groups[parent] = [a for a in (parent, *parent.iterancestors()) if local(a) == "CgPoints"]
        points.append(_point(document, [element], groups[parent], places.place(element)))
    return points


def read_locations(document: Document, places: PlaceReader) -> list[PointFeature]:
    """Return the plan features that are locations (footings, signs, poles); one of several locations is as many.

    Raises:
        SiteError: coordinates that are missing or not finite.
    """
    points: list[PointFeature] = []
    for element in descendants(document.root, "PlanFeature"):
        enclosing = [a for a in element.iterancestors() if local(a) in ("PlanFeatures", "Roadway")]
        points += [
            _point(document, [location, element], enclosing, places.place(location))
            for location in children(element, "Location")
        ]
    return points


def read_structures(document: Document, units: FileUnits, places: PlaceReader) -> list[PointFeature]:
    """Return the wells and manholes of pipe networks, at the height of their rim where the centre has none.

    A round one has its diameter as the property `diameter_m`.

    Raises:
        SiteError: coordinates that are not finite, a diameter in another unit.
    """
    points: list[PointFeature] = []
    for network in descendants(document.root, "PipeNetwork"):
        for element in structs(network):
            place = places.child_place(element, "Center")
            if place is None:
                document.warn("has no Center and is left out", label(element), line_of(element))
                continue
            rim = document.number(element, "elevRim")
            if math.isnan(place[2]) and rim is not None:
                place[2] = rim * units.elevation
            diameter = diameter_of(document, units, element, "CircStruct")
            more = {} if diameter is None else {"diameter_m": repr(diameter)}
            points.append(_point(document, [element], [network], place, more))
    return points


def _point(
    document: Document,
    own: Sequence[Element],
    enclosing: Sequence[Element],
    position: Floats,
    more: Mapping[str, str] = MappingProxyType({}),
) -> PointFeature:
    """Return a point; of `own` (the point itself) and `enclosing` (its groups) the innermost stand first."""
    everyone = (*own, *enclosing)
    properties = dict(more)
    for element in everyone:
        for key, value in feature_codes(element).items():
            properties.setdefault(key, value)
    name = next((n for e in own if (n := (e.get("name") or "").strip())), "")
    keys = ("name", "code", "desc", "pipeNetType")
    return PointFeature(
        name=name,
        code=next((c for e in everyone if (c := code_of(e, {}))), None) or code_of(own[0], properties),
        desc=next((d for e in everyone if (d := (e.get("desc") or "").strip())), None),
        position=frozen(position),
        groups=tuple(v for group in reversed(enclosing) for key in keys if (v := group.get(key))),
        source=Source(document.path.name, name or label(own[-1]), line_of(own[0])),
        properties=properties,
    )
