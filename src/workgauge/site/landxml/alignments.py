"""The `Alignment` elements of a file: plan, profile, cant and stations put together."""

import math

import numpy as np

from workgauge.site.alignment import Alignment
from workgauge.site.landxml.blocks import line_of
from workgauge.site.landxml.cant import read_cant
from workgauge.site.landxml.census import NOT_OF_THE_SITE
from workgauge.site.landxml.document import Document, Element, children, descendants, label, local
from workgauge.site.landxml.elements import PlaceReader, read_element
from workgauge.site.landxml.features import feature_codes
from workgauge.site.landxml.lines import coordinate_lines
from workgauge.site.landxml.plan import LENGTH_WARN_M, PlanBuilder
from workgauge.site.landxml.profile import read_profile
from workgauge.site.landxml.units import FileUnits
from workgauge.site.model import LineFeature
from workgauge.site.stationing import StationEquation, Stationing
from workgauge.values.limits import Source

_ELEMENTS = ("Line", "Curve", "Spiral")
_POLYLINES = ("IrregularLine", "Chain")


def read_alignments(
    document: Document, units: FileUnits, places: PlaceReader
) -> tuple[list[Alignment], list[LineFeature], list[str]]:
    """Return the alignments, those that are mere polylines as line features, and the units of their cant.

    Raises:
        SiteError: an alignment that contradicts itself.
    """
    alignments: list[Alignment] = []
    lines: list[LineFeature] = []
    cant_units: list[str] = []
    for count, element in enumerate(descendants(document.root, "Alignment"), start=1):
        parts = _parts(document, element)
        if not parts:
            document.warn("has no geometry and is left out", label(element), line_of(element))
        elif any(local(part) in _POLYLINES for part in parts):
            document.warn("is a polyline, no alignment; it is read as a line", label(element), line_of(element))
            lines += coordinate_lines(document, units, places, element, "string_line")
        else:
            alignment, cant_unit = _alignment(document, units, places, element, parts, f"alignment {count}")
            alignments.append(alignment)
            if cant_unit is not None:
                cant_units.append(cant_unit)
    return alignments, lines, cant_units


def _parts(document: Document, alignment: Element) -> list[Element]:
    """Return the elements an alignment is made of, of its first geometry that has any.

    Raises:
        SiteError: among them is one that is not read, so that the alignment would end too early or somewhere else.
    """
    filled = [
        g for g in children(alignment, "CoordGeom") if next(children(g, *_ELEMENTS, *_POLYLINES), None) is not None
    ]
    if len(filled) > 1:
        document.warn(f"has {len(filled)} geometries; the first is used", label(alignment), line_of(alignment))
    if not filled:
        return []
    for part in filled[0]:
        if local(part) not in (*_ELEMENTS, *_POLYLINES, *NOT_OF_THE_SITE):
            raise document.error(
                f"{label(alignment)} has an element that is not read",
                part,
                allowed=", ".join((*_ELEMENTS, *_POLYLINES)),
            )
    return list(children(filled[0], *_ELEMENTS, *_POLYLINES))


def _alignment(
    document: Document,
    units: FileUnits,
    places: PlaceReader,
    element: Element,
    parts: list[Element],
    default_name: str,
) -> tuple[Alignment, str | None]:
    owner = label(element)
    name = (element.get("name") or "").strip()
    if not name:
        name = default_name
        document.warn(f"has no name; called {name!r}", owner, line_of(element))
    plan = PlanBuilder(document, owner).build([read_element(document, units, places, part) for part in parts])
    start = document.number(element, "staStart")
    if start is None:
        document.warn("has no staStart; stations begin at 0", owner, line_of(element))
    start = (start or 0.0) * units.linear
    declared = document.number(element, "length")
    declared = None if declared is None else declared * units.linear
    # Element lengths are rounded one by one, so the allowance grows with their number.
    if declared is not None and abs(declared - plan.length) > LENGTH_WARN_M + 1e-4 * len(parts):
        document.warn(
            f"length {declared:.3f} m declared, {plan.length:.3f} m by its elements, which count",
            owner,
            line_of(element),
        )
    profile = read_profile(document, units, element, owner, start, plan.length)
    cant, cant_unit = read_cant(document, units, element, owner, start, plan)
    alignment = Alignment(
        name=name,
        desc=element.get("desc") or None,
        codes=feature_codes(element),
        source=Source(document.path.name, name, line_of(element)),
        plan=plan,
        profile=profile,
        cant=cant,
        stationing=_stationing(document, units, element, owner, start),
        declared_length=declared,
    )
    return alignment, cant_unit


def _equation_number(document: Document, element: Element, key: str) -> float | None:
    """Return an attribute as a number; `NaN`, as Finnish files write it, counts as absent."""
    if (element.get(key) or "").strip().lower() in ("nan", ""):
        return None
    return document.number(element, key)


def _stationing(document: Document, units: FileUnits, alignment: Element, owner: str, start: float) -> Stationing:
    """Return the station equations; where only the station behind is given, the run so far places them."""
    equations: list[StationEquation] = []
    ruling = (start, start, 1.0)
    for element in children(alignment, "StaEquation"):
        ahead = _equation_number(document, element, "staAhead")
        back = _equation_number(document, element, "staBack")
        internal = _equation_number(document, element, "staInternal")
        if ahead is None:
            raise document.error(
                "a station equation needs staAhead", element, value=element.get("staAhead") or "none"
            )
        ahead *= units.linear
        if internal is not None:
            internal *= units.linear
        elif back is not None:
            internal = ruling[0] + ruling[2] * (back * units.linear - ruling[1])
        else:
            document.warn("a station equation without a place is left out", owner, line_of(element))
            continue
        increasing = (element.get("staIncrease") or "increasing").strip().lower() != "decreasing"
        ruling = (internal, ahead, 1.0 if increasing else -1.0)
        equations.append(
            StationEquation(internal, ahead, increasing, element.get("desc") or element.get("name") or "")
        )
    places = np.array([e.internal for e in equations])
    if len(places) and (np.diff(places) < 0).any():
        document.warn("station equations are not in order; sorted", owner)
        equations.sort(key=lambda e: e.internal)
    real = [e for e in equations if not e.is_post]
    if real:
        jumps = ", ".join(f"{e.internal - start:.3f} m" for e in real[:3]) + (" ..." if len(real) > 3 else "")
        document.warn(f"stations jump at {len(real)} places (distance {jumps})", owner)
    assert all(math.isfinite(e.internal) for e in equations)
    return Stationing(start, equations)
