"""Surfaces of DXF files: the 3DFACEs of each layer. Read here, as text: pairs of a group code and a value."""

import re
from collections import Counter
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType

import numpy as np

from workgauge.site.model import SiteModel, SurfaceModel
from workgauge.site.surface.joined import joined
from workgauge.site.surface.winding import wound_up
from workgauge.site.text_file import refuse_wide
from workgauge.site.units import LINEAR_UNITS
from workgauge.values.arrays import Floats, Ints, freeze
from workgauge.values.errors import SiteError
from workgauge.values.limits import Source

#: $INSUNITS to the names of units.
UNITS = {
    1: "inch",
    2: "foot",
    3: "mile",
    4: "millimeter",
    5: "centimeter",
    6: "meter",
    7: "kilometer",
    14: "decimeter",
    21: "USSurveyFoot",
}
#: Corners nearer to each other than this are one [m].
SAME_M = 1e-5
LARGEST_M = 1e9
_BINARY = b"AutoCAD Binary DXF"
_CORNERS = tuple((10 + k, 20 + k, 30 + k) for k in range(4))


def looks_like_dxf(path: Path, head: bytes) -> bool:
    """Return whether a file is to be read as DXF: by its suffix or its first bytes."""
    return path.suffix.lower() == ".dxf" or head.startswith(_BINARY)


def read_dxf(path: Path) -> SiteModel:
    """Return the 3DFACEs of the model, a surface for each layer; all else is counted in a warning.

    Faces of four corners are split along the shorter diagonal. Blocks are not read.

    Raises:
        SiteError: the file is binary, cut off or malformed, or holds no 3DFACE.
    """
    pairs = _pairs(path)
    unit, faces, others = _scanned(path, pairs)
    warnings: list[str] = []
    if unit is None:
        warnings.append(f"{path.name}: names no unit ($INSUNITS), taken as metres")
    name = unit or "meter"
    if not faces:
        raise SiteError("holds no 3DFACE", file=path, value=_listed(others) or None, allowed="triangles of surfaces")
    if others:
        warnings.append(f"{path.name}: not read: {_listed(others)}")
    surfaces = [
        surface
        for layer, found in faces.items()
        if (surface := _surface(path, layer, found, LINEAR_UNITS[name], warnings)) is not None
    ]
    if not surfaces:
        raise SiteError("holds no 3DFACE with an area", file=path)
    return SiteModel(
        crs=None,
        crs_declared={},
        units={"linear": name, "elevation": name},
        surfaces=tuple(surfaces),
        warnings=tuple(warnings),
        files=(str(path),),
    )


_Face = tuple[int, list[list[float]]]


def _scanned(
    path: Path, pairs: list[tuple[int, int, str]]
) -> tuple[str | None, dict[str, list[_Face]], Counter[str]]:
    """Return the unit's name, by layer each face's line and corners, and how many other things there are."""
    unit: str | None = None
    section = ""
    faces: dict[str, list[_Face]] = {}
    others: Counter[str] = Counter()
    starts = [i for i, (_, code, _) in enumerate(pairs) if code == 0]
    for begin, end in pairwise([*starts, len(pairs)]):
        kind = pairs[begin][2]
        if kind == "SECTION":
            section = next((value for _, code, value in pairs[begin + 1 : end] if code == 2), "")
            if section == "HEADER":
                unit = _unit(path, pairs[begin:end])
        elif section == "ENTITIES" and kind not in ("ENDSEC", "EOF"):
            if kind == "3DFACE":
                layer, corners = _face(path, pairs[begin:end])
                faces.setdefault(layer, []).append((pairs[begin][0], corners))
            else:
                others[kind] += 1
    return unit, faces, others


def _unit(path: Path, header: list[tuple[int, int, str]]) -> str | None:
    """Return the name of the unit of a header, None for none."""
    for (_, code, name), (line, _, value) in pairwise(header):
        if code == 9 and name == "$INSUNITS":
            number = _number(path, line, value)
            if number == 0:
                return None
            if number not in UNITS:
                raise SiteError("unknown unit", file=path, line=line, element="$INSUNITS", value=value)
            return UNITS[int(number)]
    return None


def _face(path: Path, pairs: list[tuple[int, int, str]]) -> tuple[str, list[list[float]]]:
    """Return the layer and the three or four corners of a 3DFACE."""
    layer, numbers = "0", {}
    for line, code, value in pairs:
        if code == 8:
            layer = value
        elif 10 <= code <= 33:
            numbers[code] = _number(path, line, value)
    corners = [[numbers[code] for code in codes] for codes in _CORNERS if all(code in numbers for code in codes)]
    if len(corners) < 3:
        raise SiteError("3DFACE without three corners", file=path, line=pairs[0][0], value=f"{len(corners)} corners")
    return layer, corners


def _surface(path: Path, layer: str, found: list[_Face], unit: float, warnings: list[str]) -> SurfaceModel | None:
    """Return the faces of a layer as a surface, equal corners joined."""
    triangles = [triangle for _, corners in found for triangle in _triangles(np.array(corners) * unit)]
    corners = np.array(triangles).reshape(-1, 3)
    if np.abs(corners).max(initial=0.0) > LARGEST_M:
        raise SiteError("coordinates beyond any map", file=path, line=found[0][0], element=f"layer {layer!r}")
    first, of = joined(corners, SAME_M)
    vertices: Floats = corners[first]
    faces: Ints = of.reshape(-1, 3)
    wound = wound_up(vertices, faces)
    if wound.degenerate:
        warnings.append(f"{path.name}: layer {layer!r}: {wound.degenerate} faces without area are left out")
    if wound.vertical:
        warnings.append(f"{path.name}: layer {layer!r}: {wound.vertical} faces are vertical")
    if not len(wound.faces):
        return None
    freeze(vertices)
    freeze(wound.faces)
    return SurfaceModel(
        name=layer,
        code=None,
        desc=None,
        vertices=vertices,
        faces=wound.faces,
        plan_area_m2=wound.plan_area_m2,
        properties=MappingProxyType({"layer": layer}),
        source=Source(path.name, layer, found[0][0]),
    )


def _triangles(corners: Floats) -> list[Floats]:
    """Return the triangles (3, 3) of a face: one if two of its corners are the same, else two."""
    if len(corners) == 4 and np.abs(corners[3] - corners[2]).max() > SAME_M:
        a, b, c, d = corners
        if np.linalg.norm(c - a) <= np.linalg.norm(d - b):
            return [np.array([a, b, c]), np.array([a, c, d])]
        return [np.array([a, b, d]), np.array([b, c, d])]
    return [corners[:3]]


def _pairs(path: Path) -> list[tuple[int, int, str]]:
    """Return (line of the value, group code, value) of a file."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise SiteError(f"cannot be read: {error.strerror or error}", file=path) from error
    if raw.startswith(_BINARY):
        raise SiteError("is a binary DXF file, which is not read", file=path, allowed="DXF as text")
    refuse_wide(path, raw)
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        # files before 2007 are in the code page of whoever wrote them; this one has every byte
        text = raw.decode("latin-1")
    return list(_each(path, re.split(r"\r\n|\r|\n", text)))


def _each(path: Path, lines: list[str]) -> Iterator[tuple[int, int, str]]:
    for i in range(0, len(lines) - 1, 2):
        code = lines[i].strip()
        if not code.lstrip("-").isdigit() or len(code) > 6:
            raise SiteError("no group code where one is to be", file=path, line=i + 1, value=code)
        yield i + 2, int(code), lines[i + 1].strip()
        if int(code) == 0 and lines[i + 1].strip() == "EOF":
            return
    raise SiteError("ends before its end", file=path, line=len(lines) - 1 or None, allowed="0 EOF as the last pair")


def _number(path: Path, line: int, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise SiteError("is no number", file=path, line=line, value=text)
    return value


def _listed(others: Counter[str]) -> str:
    return ", ".join(f"{count} {kind}" for kind, count in sorted(others.items()))
