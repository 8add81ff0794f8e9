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
_LISTS = ("PntList2D", "PntList3D")


def read_plan_features(document: Document, units: FileUnits, places: PlaceReader) -> list[LineFeature]:
    """Return the plan features of a file as polylines.

    Raises:
        SiteError: coordinates that cannot be read.
    """
    lines: list[LineFeature] = []
    for element in descendants(document.root, "PlanFeature"):
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
            points = _part_points(document, units, places, part)
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


def _part_points(document: Document, units: FileUnits, places: PlaceReader, part: Element) -> Floats | None:
    name = local(part)
    if name in ("Line", "Curve", "Spiral"):
        return _chords(document, read_element(document, units, places, part))
    if name in ("IrregularLine", "Chain"):
        lists = [places.polyline(found) for found in children(part, *_LISTS)]
        if lists:
            return lists[0]
        ends = [places.child_place(part, which) for which in ("Start", "End")]
        return np.array([end for end in ends if end is not None]) if None not in ends else None
    return None


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
                points = places.polyline(found)
                if len(points) >= 2:
                    lines += _line(document, element, kind, points)
    return lines


def read_pipes(document: Document, units: FileUnits, places: PlaceReader) -> list[LineFeature]:
    """Return the pipes and cables of all networks; a pipe's axis runs half its diameter above its inverts.

    Raises:
        SiteError: coordinates that cannot be read, a diameter that is not positive.
    """
    lines: list[LineFeature] = []
    for network in descendants(document.root, "PipeNetwork"):
        structures = {
            s.get("name") or "": s for group in children(network, "Structs") for s in children(group, "Struct")
        }
        for pipe in (p for group in children(network, "Pipes") for p in children(group, "Pipe")):
            diameter = _diameter(document, units, pipe)
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


def _diameter(document: Document, units: FileUnits, pipe: Element) -> float | None:
    shape = child(pipe, "CircPipe")
    value = None if shape is None else document.number(shape, "diameter")
    if shape is not None and value is not None and value <= 0:
        raise document.error("a diameter must be positive", pipe, value=value)
    return None if value is None else value * units.diameter


def _pipe_end(
    document: Document, units: FileUnits, structure: Element, place: Floats, pipe: Element, diameter: float | None
) -> Floats:
    """Return the end of a pipe's axis: its invert at the structure plus half its diameter, if the file has one."""
    for invert in children(structure, "Invert"):
        elevation = document.number(invert, "elev")
        if invert.get("refPipe") == pipe.get("name") and elevation is not None:
            return np.array([place[0], place[1], elevation * units.elevation + (diameter or 0.0) / 2])
    return place
