"""Surfaces: `Definition` with `Pnts` and `Faces`, checked and wound upwards; without faces, what they are made of."""

from typing import NamedTuple

import numpy as np

from workgauge.site.landxml.blocks import NumberBlock, line_of
from workgauge.site.landxml.document import Document, Element, child, children, descendants, label
from workgauge.site.landxml.elements import PlaceReader, beyond_any_map, map_limit
from workgauge.site.landxml.features import code_of, feature_codes
from workgauge.site.landxml.heights import doubt_heights
from workgauge.site.landxml.sources import sources_of
from workgauge.site.landxml.units import FileUnits
from workgauge.site.model import SurfaceModel
from workgauge.site.surface.bounded import bounded
from workgauge.site.surface.winding import wound_up
from workgauge.values.arrays import Floats, Ints, freeze
from workgauge.values.errors import SiteError
from workgauge.values.limits import Source


class _Triangles(NamedTuple):
    """What a surface is, whatever the file made it of: vertices (n, 3), faces (m, 3) wound up, their plan area."""

    vertices: Floats
    faces: Ints
    area: float


def read_surfaces(document: Document, units: FileUnits, places: PlaceReader) -> list[SurfaceModel]:
    """Return the surfaces of a file: their own triangles, or Delaunay's where there are none.

    Raises:
        SiteError: faces that name missing points, points with one id in two places.
    """
    surfaces: list[SurfaceModel] = []
    for element in descendants(document.root, "Surface"):
        if sum(1 for _ in children(element, "Definition")) > 1:
            document.warn("has several definitions; the first is used", label(element), line_of(element))
        if _has_faces(document, element):
            found = _of_faces(document, units, element)
        else:
            found = _of_sources(document, units, places, element)
        if found is not None:
            surfaces.append(_surface(document, element, found))
    return surfaces


def _face_blocks(document: Document, element: Element) -> list[NumberBlock]:
    definition = child(element, "Definition")
    faces = [] if definition is None else children(definition, "Faces")
    return [document.faces[f] for f in faces if f in document.faces]


def _has_faces(document: Document, element: Element) -> bool:
    """Return whether a surface has triangles of its own, be they all invisible."""
    return any(len(block.values) or block.invisible for block in _face_blocks(document, element))


def _of_faces(document: Document, units: FileUnits, element: Element) -> _Triangles | None:
    """Return the surface of the file's own faces."""
    owner, definition = label(element), child(element, "Definition")
    assert definition is not None
    face_blocks = _face_blocks(document, element)
    points = [document.points[p] for p in children(definition, "Pnts") if p in document.points]
    empty = np.empty((0, 3), dtype=np.int64)
    named: Ints = np.concatenate([empty, *(b.values for b in face_blocks)])
    lines: Ints = np.concatenate([empty[:, 0], *(b.lines for b in face_blocks)])
    if not points or not len(named):
        why = "has faces but no points" if not points else "has no visible face"
        document.warn(f"{why} and is left out", owner, line_of(element))
        return None
    ids = np.concatenate([b.ids for b in points])
    rows: Floats = np.concatenate([b.values for b in points])
    rows_lines: Ints = np.concatenate([b.lines for b in points])
    _check_size(document, units, owner, ids, rows, rows_lines)
    vertices = rows[:, [1, 0, 2]] * np.array([units.linear, units.linear, units.elevation])
    _check_ids(document, owner, ids, vertices, rows_lines)
    faces = _indices(document, owner, ids, named, lines)
    quads = sum(b.quads for b in face_blocks)
    if quads:
        document.warn(f"{quads} faces of four points are split in two", owner, line_of(element))
    faces, area = _upwards(document, owner, vertices, faces, line_of(element))
    if not len(faces):
        document.warn("has no face with an area and is left out", owner, line_of(element))
        return None
    used = np.unique(faces)
    doubt_heights(document, units, vertices[used, 2], owner, line_of(element), lambda i: f"P id {ids[used[i]]}")
    stated = document.number(definition, "area2DSurf")
    invisible = sum(b.invisible for b in face_blocks)
    # The declared area is in the file's area unit, which is mostly but not always the square of its linear unit.
    if stated and not invisible and units.linear == 1.0 and abs(stated - area) > max(0.01, 1e-6 * area):
        document.warn(f"plan area {stated:.2f} m2 declared, {area:.2f} m2 by its faces, which count", owner)
    return _Triangles(vertices, faces, area)


def _of_sources(document: Document, units: FileUnits, places: PlaceReader, element: Element) -> _Triangles | None:
    """Return Delaunay's triangles of what a surface without faces is made of; it is always said."""
    owner, line = label(element), line_of(element)
    for block in (document.points[p] for p in descendants(element, "Pnts") if p in document.points):
        _check_size(document, units, owner, block.ids, block.values, block.lines)
    sources = sources_of(document, units, places, element)
    if not len(sources.heights):
        document.warn("has no triangles and no points, and is left out", owner, line)
        return None
    doubt_heights(document, units, sources.heights, owner, line)
    points = np.concatenate([np.empty((0, 3)), *sources.points])
    try:
        made = bounded(points, sources.breaklines, sources.boundaries)
    except SiteError as error:
        value = "" if error.value is None else f" ({error.value})"
        document.warn(f"has no faces, and {error.message}{value}; it is left out", owner, line)
        return None
    for text in made.warnings:
        document.warn(text, owner, line)
    outer = any(boundary.kind == "outer" for boundary in sources.boundaries)
    sides = np.diff(made.vertices[made.faces[:, [0, 1, 2, 0]]][..., :2], axis=1)
    longest = np.linalg.norm(sides, axis=2).max()
    reach = "" if outer else f", out to their hull, with sides up to {longest:.1f} m"
    document.warn(f"has no faces; the triangles are Delaunay's of {sources.words()}{reach}", owner, line)
    wound = wound_up(made.vertices, made.faces)
    return _Triangles(np.array(made.vertices), wound.faces, wound.plan_area_m2)


def _surface(document: Document, element: Element, found: _Triangles) -> SurfaceModel:
    for array in (found.vertices, found.faces):
        freeze(array)
    properties = feature_codes(element)
    name = (element.get("name") or "").strip() or f"surface at line {line_of(element) or 0}"
    return SurfaceModel(
        name=name,
        code=code_of(element, properties),
        desc=element.get("desc") or None,
        vertices=found.vertices,
        faces=found.faces,
        plan_area_m2=found.area,
        properties=properties,
        source=Source(document.path.name, name, line_of(element)),
    )


def _check_size(document: Document, units: FileUnits, owner: str, ids: Ints, rows: Floats, lines: Ints) -> None:
    """Refuse coordinates that no map has."""
    beyond = beyond_any_map(rows, units)
    if beyond.any():
        row = int(np.argmax(beyond.any(axis=1)))
        raise SiteError(
            "coordinates beyond any map",
            file=document.path,
            line=int(lines[row]) or None,
            element=f"{owner}: P id {ids[row]}",
            value=f"{rows[row][beyond[row]][0]:.9g}",
            allowed=map_limit(units),
        )


def _check_ids(document: Document, owner: str, ids: Ints, vertices: Floats, lines: Ints) -> None:
    """Refuse ids given to points in different places."""
    order = np.argsort(ids, kind="stable")
    same = np.flatnonzero(ids[order][1:] == ids[order][:-1])
    for a, b in zip(order[same], order[same + 1], strict=True):
        if not np.array_equal(vertices[a], vertices[b]):
            raise SiteError(
                f"point id {ids[b]} is given twice, at different places",
                file=document.path,
                line=int(lines[b]) or None,
                element=owner,
            )


def _indices(document: Document, owner: str, ids: Ints, named: Ints, lines: Ints) -> Ints:
    """Return faces as indices of points instead of their ids."""
    order = np.argsort(ids, kind="stable")
    sorted_ids = ids[order]
    place = np.clip(np.searchsorted(sorted_ids, named), 0, len(ids) - 1)
    missing = sorted_ids[place] != named
    if missing.any():
        face, corner = np.argwhere(missing)[0]
        raise SiteError(
            f"face {face + 1} names point {named[face, corner]}, which the surface does not have",
            file=document.path,
            line=int(lines[face]) or None,
            element=owner,
            value=f"{int(missing.any(axis=1).sum())} such faces",
            allowed=f"{len(ids)} points, ids {ids.min()} to {ids.max()}",
        )
    faces: Ints = order[place]
    return faces


def _upwards(document: Document, owner: str, vertices: Floats, faces: Ints, line: int | None) -> tuple[Ints, float]:
    """Return the faces without degenerate ones, counter-clockwise in plan, and their plan area [m2]."""
    wound = wound_up(vertices, faces)
    if wound.degenerate:
        document.warn(f"{wound.degenerate} faces without area are left out", owner, line)
    if wound.vertical:
        document.warn(f"{wound.vertical} faces are vertical", owner, line)
    return wound.faces, wound.plan_area_m2
