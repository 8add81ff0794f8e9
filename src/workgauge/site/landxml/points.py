"""Survey points: `CgPoint` elements, nested in groups that carry codes and descriptions."""

from workgauge.site.landxml.blocks import line_of
from workgauge.site.landxml.document import Document, Element, descendants, label, local
from workgauge.site.landxml.elements import PlaceReader
from workgauge.site.landxml.features import code_of, feature_codes
from workgauge.site.landxml.units import FileUnits
from workgauge.site.model import PointFeature
from workgauge.values.arrays import Floats, frozen
from workgauge.values.limits import Source


def named_places(document: Document, units: FileUnits) -> dict[str, Floats]:
    """Return the positions of all points that have a name and coordinates, for elements that refer to them.

    Raises:
        SiteError: coordinates that are missing or not finite.
    """
    places = PlaceReader(document, units, {})
    named: dict[str, Floats] = {}
    for element in descendants(document.root, "CgPoint"):
        name = element.get("name")
        if name and (element.text or "").strip() and name not in named:
            named[name] = places.place(element)
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
        enclosing = groups[parent]
        properties = feature_codes(element)
        for group in enclosing:
            for key, value in feature_codes(group).items():
                properties.setdefault(key, value)
        name = (element.get("name") or "").strip()
        names = [v for group in reversed(enclosing) for key in ("name", "code", "desc") if (v := group.get(key))]
        points.append(
            PointFeature(
                name=name,
                code=next((c for e in (element, *enclosing) if (c := code_of(e, {}))), None)
                or code_of(element, properties),
                desc=next((d for e in (element, *enclosing) if (d := (e.get("desc") or "").strip())), None),
                position=frozen(places.place(element)),
                groups=tuple(names),
                source=Source(document.path.name, name or label(element), line_of(element)),
                properties=properties,
            )
        )
    return points
