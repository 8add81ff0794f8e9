"""Points as text, a line each: east, north, height. Read as a surface of Delaunay's triangles."""

import re
from pathlib import Path
from types import MappingProxyType

import numpy as np

from workgauge.site.model import SiteModel, SurfaceModel
from workgauge.site.surface.delaunay import triangulated
from workgauge.site.surface.winding import wound_up
from workgauge.values.arrays import Floats
from workgauge.values.errors import SiteError
from workgauge.values.limits import Source

SUFFIXES = (".xyz", ".txt", ".csv", ".pts", ".asc")
#: Coordinates beyond this are none [m].
LARGEST_M = 1e9
_APART = re.compile(r"[\s,;]+")
_COMMENT = ("#", "//", "!", "%")


def looks_like_xyz(path: Path, head: bytes) -> bool:
    """Return whether a file is to be read as points: by its suffix, and because a line of it has three numbers."""
    if path.suffix.lower() not in SUFFIXES or b"\0" in head:
        return False
    lines = head.decode("utf-8-sig", errors="replace").splitlines()[:20]
    return path.suffix.lower() == ".xyz" or any(_numbers(line) is not None for line in lines)


def read_xyz(path: Path) -> SiteModel:
    """Return the points of a file as one surface, in metres: no unit is written in such files.

    A first line that is no numbers is a heading, lines beginning with #, //, ! or % are comments; what follows the
    third number is left aside.

    Raises:
        SiteError: a line is no point, or the points make no surface.
    """
    points, warnings = _points(path)
    name = path.stem
    try:
        made = triangulated(points)
    except SiteError as error:
        raise SiteError(
            error.message, file=path, element=error.element, value=error.value, allowed=error.allowed
        ) from error
    wound = wound_up(made.vertices, made.faces)
    warnings += [f"{path.name}: {text}" for text in made.warnings]
    warnings.append(f"{path.name}: has no unit, taken as metres; the triangles are Delaunay's, without break lines")
    surface = SurfaceModel(
        name=name,
        code=None,
        desc=None,
        vertices=made.vertices,
        faces=wound.faces,
        plan_area_m2=wound.plan_area_m2,
        properties=MappingProxyType({}),
        source=Source(path.name, name, 1),
    )
    return SiteModel(
        crs=None,
        crs_declared={},
        units={"linear": "meter", "elevation": "meter"},
        surfaces=(surface,),
        warnings=tuple(warnings),
        files=(str(path),),
    )


def _points(path: Path) -> tuple[Floats, list[str]]:
    """Return the points (k, 3) of a file, and what is to be said of them."""
    try:
        text = path.read_bytes().decode("utf-8-sig", errors="replace")
    except OSError as error:
        raise SiteError(f"cannot be read: {error.strerror or error}", file=path) from error
    rows: list[tuple[float, float, float]] = []
    more = 0
    for number, line in enumerate(text.splitlines(), 1):
        stripped = line.strip()
        if not stripped or stripped.startswith(_COMMENT):
            continue
        found = _numbers(stripped)
        if found is None:
            if not rows and number == 1:
                continue  # a heading
            raise SiteError(
                "is no point", file=path, line=number, value=stripped, allowed="east north height, decimal points"
            )
        if max(map(abs, found[:3])) > LARGEST_M:
            raise SiteError("coordinates beyond any map", file=path, line=number, value=stripped)
        more = max(more, len(found))
        rows.append((found[0], found[1], found[2]))
    if not rows:
        raise SiteError("holds no points", file=path, allowed="a line for each: east north height")
    said = [f"{path.name}: what follows the third number of a line is left aside"] if more > 3 else []
    return np.array(rows), said


def _numbers(line: str, least: int = 3) -> list[float] | None:
    """Return the finite numbers a line begins with, None if they are fewer than the least."""
    found: list[float] = []
    for part in _APART.split(line.strip()):
        try:
            value = float(part)
        except ValueError:
            break
        if not np.isfinite(value):
            return None
        found.append(value)
    return found if len(found) >= least else None


def read_places(path: Path) -> Floats:
    """Return the places (p, 2) east, north [m] of a line given as text, one a line; more numbers are left aside.

    Raises:
        SiteError: the file cannot be read, a line is no place, or there are fewer than two.
    """
    try:
        text = path.read_bytes().decode("utf-8-sig", errors="replace")
    except OSError as error:
        raise SiteError(f"cannot be read: {error.strerror or error}", file=path) from error
    rows: list[tuple[float, float]] = []
    for number, line in enumerate(text.splitlines(), 1):
        stripped = line.strip()
        if not stripped or stripped.startswith(_COMMENT):
            continue
        found = _numbers(stripped, 2)
        if found is None or max(map(abs, found[:2])) > LARGEST_M:
            if not rows and number == 1:
                continue  # a heading
            raise SiteError("is no place", file=path, line=number, value=stripped, allowed="east north")
        rows.append((found[0], found[1]))
    if len(rows) < 2:
        raise SiteError(
            "is no line", file=path, value=f"{len(rows)} places", allowed="two or more, east north a line"
        )
    return np.array(rows)
