"""Line features: plan features, polyline alignments, pipes and cables, break lines and boundaries of surfaces."""

import math

import numpy as np

from workgauge.site.landxml.blocks import line_of
from workgauge.site.landxml.document import Document, Element, child, children, descendants, label, local
from workgauge.site.landxml.elements import PlaceReader, StatedElement, read_element
from workgauge.site.landxml.features import code_of, feature_codes, feature_names
from workgauge.site.landxml.plan import GAP_LIMIT_M, PlanBuilder
from workgauge.site.landxml.units import FileUnits
from workgauge.site.model import LineFeature
from workgauge.values.arrays import Floats, frozen
from workgauge.values.limits import Source

#: Curves of line features are cut so that no chord is farther from its arc than this [m].
CHORD_ERROR_M = 0.005
#: No pipe or cable is thicker or thinner; above the second a warning is given [m].
LARGEST_DIAMETER_M, DIAMETER_WARN_M, SMALLEST_DIAMETER_M = 20.0, 5.0, 0.001
_LISTS = ("PntList2D", "PntList3D")


def read_plan_features(document: Document, units: FileUnits, places: PlaceReader) -> list[LineFeature]:
    """Return the plan features of a file as polylines; those that are mere locations are points, no lines.

    Raises:
        SiteError: coordinates that cannot be read.
    """
    lines: list[LineFeature] = []
    for element in descendants(document.root, "PlanFeature"):
        if child(element, "CoordGeom") is None and child(element, "Location") is not None:
            continue
        cable = any("cable" in name.lower() for name in feature_names(element))
        lines += coordinate_lines(document, units, places, element, "cable" if cable else "plan_feature")
    return lines


def coordinate_lines(
    document: Document, units: FileUnits, places: PlaceReader, element: Element, kind: str
) -> list[LineFeature]:
    """Return an element's geometry as polylines, curves cut into chords; parts that do not meet are lines apart."""
    lines: list[LineFeature] = []
    for geometry in children(element, "CoordGeom"):
        chain: list[Floats] = []
        for part in geometry:
            points = _part_points(document, units, places, part, label(element))
            if points is None:
                continue
            if chain and float(np.hypot(*(points[0] - chain[-1][-1])[:2])) > GAP_LIMIT_M:
                document.warn("has a gap and is read as two lines", label(element), line_of(part))
                lines += _line(document, element, kind, np.concatenate(chain))
                chain = []
            chain.append(points)
        if chain:
            lines += _line(document, element, kind, np.concatenate(chain))
    if not lines:
        document.warn("has no geometry and is left out", label(element), line_of(element))
    return lines


def _part_points(
    document: Document, units: FileUnits, places: PlaceReader, part: Element, owner: str
) -> Floats | None:
    name = local(part)
    if name in ("Line", "Curve", "Spiral"):
        return _chords(document, read_element(document, units, places, part))
    if name in ("IrregularLine", "Chain"):
        points = _listed(places, part)
        if len(points):
            return points
        document.warn("has no points and is left out", f"{owner}: {label(part)}", line_of(part))
    return None


def _listed(places: PlaceReader, part: Element) -> Floats:
    """Return the places (n, 3) of a polyline: its list, and its start and end where the list does not repeat them."""
    lists = [places.polyline(found) for found in children(part, *_LISTS)]
    rows = list(lists[0]) if lists else []
    if local(part) == "Chain" and not lists:
        rows = list(places.chain(part))
    start, end = (places.child_place(part, which) for which in ("Start", "End"))
    if start is not None and not (rows and _apart(start, rows[0]) <= GAP_LIMIT_M):
        rows.insert(0, start)
    if end is not None and not (len(rows) > 1 and _apart(end, rows[-1]) <= GAP_LIMIT_M):
        rows.append(end)
    return np.array(rows).reshape(-1, 3)


def _apart(a: Floats, b: Floats) -> float:
    return float(np.hypot(*(a - b)[:2]))


def _chords(document: Document, stated: StatedElement) -> Floats:
    """Return points (n, 3) along an element, heights in proportion to the distance."""
    if stated.kind == "line" or float(np.hypot(*(stated.end - stated.start)[:2])) < 1e-6:
        return np.array([stated.start, stated.end])
    plan = PlanBuilder(document, "line feature").build([stated])
    tightest = max(abs(e.k0) if e.k0 else 0.0 for e in plan.elements)
    tightest = max(tightest, *(abs(e.k1) for e in plan.elements))
    step = math.sqrt(8 * CHORD_ERROR_M / tightest) if tightest else plan.length
    count = max(2, math.ceil(plan.length / step) + 1)
    share = np.linspace(0.0, 1.0, count)
    state = plan.at(share * plan.length)
    height = stated.start[2] + share * (stated.end[2] - stated.start[2])
    return np.column_stack([state.e + plan.origin[0], state.n + plan.origin[1], height])


def _line(
    document: Document,
    element: Element,
    kind: str,
    points: Floats,
    diameter_m: float | None = None,
) -> list[LineFeature]:
    """Return one line feature without repeated points, or nothing if fewer than two points are left."""
    if len(points) < 2:
        document.warn("has fewer than two points and is left out", label(element), line_of(element))
        return []
    with np.errstate(invalid="ignore"):
        moved = np.abs(np.diff(points[:, :2], axis=0)).max(axis=1, initial=0.0) > 1e-9
        moved |= np.abs(np.nan_to_num(np.diff(points[:, 2]))) > 1e-9
    kept = points[np.concatenate([[True], moved])]
    if len(kept) < 2:
        document.warn("has fewer than two different points and is left out", label(element), line_of(element))
        return []
    properties = feature_codes(element)
    name = (element.get("name") or "").strip()
    return [
        LineFeature(
            name=name,
            code=code_of(element, properties),
            desc=element.get("desc") or None,
            kind=kind,
            points=frozen(kept),
            diameter_m=diameter_m,
            properties=properties,
            source=Source(document.path.name, name or label(element), line_of(element)),
        )
    ]


def read_surface_lines(document: Document, places: PlaceReader) -> list[LineFeature]:
    """Return break lines and boundaries of all surfaces."""
    lines: list[LineFeature] = []
    for tag, kind in (("Breakline", "breakline"), ("Boundary", "boundary")):
        for element in descendants(document.root, tag):
            for found in children(element, *_LISTS):
                lines += _line(document, element, kind, places.polyline(found))
    return lines


def structs(network: Element) -> list[Element]:
    """Return the structures (wells, manholes) of a pipe network."""
    return [s for group in children(network, "Structs") for s in children(group, "Struct")]


def read_pipes(document: Document, units: FileUnits, places: PlaceReader) -> list[LineFeature]:
    """Return the pipes and cables of all networks; a pipe's axis runs half its diameter above its inverts.

    Raises:
        SiteError: coordinates that cannot be read, a diameter that is not positive or in another unit.
    """
    lines: list[LineFeature] = []
    for network in descendants(document.root, "PipeNetwork"):
        structures = {s.get("name") or "": s for s in structs(network)}
        for pipe in (p for group in children(network, "Pipes") for p in children(group, "Pipe")):
            diameter = diameter_of(document, units, pipe, "CircPipe")
            ends = []
            for key in ("refStart", "refEnd"):
                structure = structures.get(pipe.get(key) or "")
                place = None if structure is None else places.child_place(structure, "Center")
                if structure is None or place is None:
                    document.warn(f"has no {key} with a place and is left out", label(pipe), line_of(pipe))
                    break
                ends.append(_pipe_end(document, units, structure, place, pipe, diameter))
            else:
                names = [*feature_names(pipe), *feature_names(network), network.get("pipeNetType") or ""]
                cable = any("cable" in name.lower() for name in names)
                if child(pipe, "Center") is not None:
                    document.warn("is curved; read as straight", label(pipe), line_of(pipe))
                lines += _line(document, pipe, "cable" if cable else "pipe", np.array(ends), diameter)
    return lines


def diameter_of(document: Document, units: FileUnits, owner: Element, shape_name: str) -> float | None:
    """Return the diameter [m] of a pipe's or structure's round shape, or None.

    Raises:
        SiteError: it is not positive, or so large or small that it is in another unit.
    """
    shape = child(owner, shape_name)
    value = None if shape is None else document.number(shape, "diameter")
    if value is None:
        return None
    if value <= 0:
        raise document.error("a diameter must be positive", owner, value=value)
    unit = units.names.get("diameter", units.names["linear"])
    diameter = value * units.diameter
    if not SMALLEST_DIAMETER_M <= diameter <= LARGEST_DIAMETER_M:
        raise document.error(
            f"a diameter of {value:g} {unit} is a unit error",
            owner,
            value=value,
            allowed=f"{SMALLEST_DIAMETER_M / units.diameter:.3g} to {LARGEST_DIAMETER_M / units.diameter:.3g} {unit}",
        )
    if diameter > DIAMETER_WARN_M:
        document.warn(f"has a diameter of {diameter:.3g} m", label(owner), line_of(owner))
    return diameter


def _pipe_end(
    document: Document, units: FileUnits, structure: Element, place: Floats, pipe: Element, diameter: float | None
) -> Floats:
    """Return the end of a pipe's axis: its invert at the structure plus half its diameter, if the file has one."""
    for invert in children(structure, "Invert"):
        elevation = document.number(invert, "elev")
        if invert.get("refPipe") == pipe.get("name") and elevation is not None:
            return np.array([place[0], place[1], elevation * units.elevation + (diameter or 0.0) / 2])
    return place
