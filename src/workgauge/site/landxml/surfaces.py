"""Triangulated surfaces: `Surface` / `Definition` with `Pnts` and `Faces`, checked and wound upwards."""

import numpy as np

from workgauge.site.landxml.blocks import NumberBlock, line_of
from workgauge.site.landxml.document import Document, Element, child, children, descendants, label
from workgauge.site.landxml.elements import beyond_any_map, map_limit
from workgauge.site.landxml.features import code_of, feature_codes
from workgauge.site.landxml.heights import doubt_heights
from workgauge.site.landxml.units import FileUnits
from workgauge.site.model import SurfaceModel
from workgauge.site.surface.winding import wound_up
from workgauge.values.arrays import Floats, Ints, freeze
from workgauge.values.errors import SiteError
from workgauge.values.limits import Source


def read_surfaces(document: Document, units: FileUnits) -> list[SurfaceModel]:
    """Return the triangulated surfaces of a file.

    Raises:
        SiteError: faces that name missing points, points with one id in two places.
    """
    surfaces: list[SurfaceModel] = []
    for element in descendants(document.root, "Surface"):
        definition = child(element, "Definition")
        blocks = (
            []
            if definition is None
            else [document.points[p] for p in children(definition, "Pnts") if p in document.points]
        )
        if definition is None or not blocks:
            document.warn("has no triangles and is left out", label(element), line_of(element))
            continue
        if sum(1 for _ in children(element, "Definition")) > 1:
            document.warn("has several definitions; the first is used", label(element), line_of(element))
        faces = [document.faces[f] for f in children(definition, "Faces") if f in document.faces]
        surface = _surface(document, units, element, definition, blocks, faces)
        if surface is not None:
            surfaces.append(surface)
    return surfaces


def _surface(
    document: Document,
    units: FileUnits,
    element: Element,
    definition: Element,
    points: list[NumberBlock],
    face_blocks: list[NumberBlock],
) -> SurfaceModel | None:
    owner = label(element)
    ids = np.concatenate([b.ids for b in points])
    rows: Floats = np.concatenate([b.values for b in points])
    rows_lines: Ints = np.concatenate([b.lines for b in points])
    _check_size(document, units, owner, ids, rows, rows_lines)
    vertices = rows[:, [1, 0, 2]] * np.array([units.linear, units.linear, units.elevation])
    empty = np.empty((0, 3), dtype=np.int64)
    named: Ints = np.concatenate([empty, *(b.values for b in face_blocks)])
    lines: Ints = np.concatenate([empty[:, 0], *(b.lines for b in face_blocks)])
    if not len(named):
        document.warn("has points but no faces and is left out", owner, line_of(element))
        return None
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
    for array in (vertices, faces):
        freeze(array)
    properties = feature_codes(element)
    name = (element.get("name") or "").strip() or f"surface at line {line_of(element) or 0}"
    return SurfaceModel(
        name=name,
        code=code_of(element, properties),
        desc=element.get("desc") or None,
        vertices=vertices,
        faces=faces,
        plan_area_m2=area,
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
