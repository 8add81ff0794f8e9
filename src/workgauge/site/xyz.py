"""Points as text, a line each: east, north, height. Read as a surface of Delaunay's triangles."""

import re
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from workgauge.site.model import SiteModel, SurfaceModel
from workgauge.site.surface.delaunay import triangulated
from workgauge.site.surface.winding import wound_up
from workgauge.site.text_file import text_of
from workgauge.values.arrays import Floats
from workgauge.values.errors import SiteError
from workgauge.values.limits import Source

SUFFIXES = (".xyz", ".txt", ".csv", ".pts", ".asc")
#: Coordinates beyond this are none [m].
LARGEST_M = 1e9
_APART = re.compile(r"[\s,;]+")
_COMMENT = ("#", "//", "!", "%")
#: What headings call the three; x and y mean one or the other by country, and say nothing.
_NAMES = (
    ("e", "east", "easting", "rechtswert", "ost", "ostwert", "itä"),
    ("n", "north", "northing", "hochwert", "nord", "nordwert", "pohjoinen"),
    ("z", "h", "height", "elev", "elevation", "level", "höhe", "hoehe", "korkeus"),
)
_POINT = "east north height, decimal points"


class _Columns(NamedTuple):
    """Where a heading says the three numbers stand. apart: what is between columns, None for blanks."""

    apart: str | None
    at: tuple[int, int, int]

    def numbers(self, line: str) -> list[float] | None:
        """Return the three numbers of a line, None if one is missing or is none."""
        fields = line.split(self.apart)
        found = [_number(fields[k]) for k in self.at if k < len(fields)]
        return [one for one in found if one is not None] if len(found) == 3 and None not in found else None


def looks_like_xyz(path: Path, head: bytes) -> bool:
    """Return whether a file is to be read as points: by its suffix, and because a line of it has three numbers."""
    if path.suffix.lower() not in SUFFIXES or b"\0" in head:
        return False
    lines = head.decode("utf-8-sig", errors="replace").splitlines()[:20]
    return path.suffix.lower() == ".xyz" or any(_numbers(line) is not None for line in lines)


def read_xyz(path: Path) -> SiteModel:
    """Return the points of a file as one surface, in metres: no unit is written in such files.

    A first line that begins with no number is a heading; where it names east, north and height, it says which columns
    they are. Lines beginning with #, //, ! or % are comments; what follows the third number is left aside. Decimal
    commas are refused, as they cannot be told from commas between numbers in every line.

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
    text = text_of(path)
    rows: list[tuple[float, float, float]] = []
    more = 0
    columns: _Columns | None = None
    for number, line in enumerate(text.splitlines(), 1):
        stripped = line.strip()
        if not stripped or stripped.startswith(_COMMENT):
            continue
        if not rows and number == 1 and _is_heading(stripped):
            columns = _columns(stripped)
            continue
        found = _numbers(stripped) if columns is None else columns.numbers(line)
        if found is None:
            raise SiteError("is no point", file=path, line=number, value=stripped, allowed=_POINT)
        if max(map(abs, found[:3])) > LARGEST_M:
            raise SiteError("coordinates beyond any map", file=path, line=number, value=stripped)
        more = max(more, len(found))
        rows.append((found[0], found[1], found[2]))
    if not rows:
        raise SiteError("holds no points", file=path, allowed="a line for each: east north height")
    said = [f"{path.name}: what follows the third number of a line is left aside"] if more > 3 else []
    if columns is not None:
        e, n, z = (k + 1 for k in columns.at)
        said.append(f"{path.name}: by its heading east is column {e}, north {n}, height {z}")
    return np.array(rows), said


def _is_heading(line: str) -> bool:
    """Return whether a first line is a heading: it begins with no number."""
    return not re.match(r"[-+.]*\d", line)


def _columns(heading: str) -> _Columns | None:
    """Return where a heading says the three stand, None if it does not say all three once, or in the usual places."""
    apart = next((mark for mark in (";", "\t", ",") if mark in heading), None)
    names = [re.sub(r"[\[(].*|[^a-zäöå]", "", field.strip().lower()) for field in heading.split(apart)]
    at = [[k for k, name in enumerate(names) if name in known] for known in _NAMES]
    if any(len(found) != 1 for found in at):
        return None
    columns = _Columns(apart, (at[0][0], at[1][0], at[2][0]))
    return None if columns.at == (0, 1, 2) else columns


def _number(text: str) -> float | None:
    """Return a finite number, None if it is none."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if np.isfinite(value) and "_" not in text else None


def _numbers(line: str, least: int = 3) -> list[float] | None:
    """Return the finite numbers a line begins with, None if they are fewer than the least, or commas are in them.

    A comma without a blank in a line that keeps numbers apart by something else as well is a decimal comma.
    """
    stripped = line.strip()
    found: list[float] = []
    for part in _APART.split(stripped):
        value = _number(part)
        if value is None:
            if part.lower().lstrip("+-") in ("nan", "inf", "infinity"):
                return None
            break
        found.append(value)
    between = _APART.findall(stripped)[: max(len(found) - 1, 0)]
    if "," in between and any("," not in mark for mark in between):
        return None
    return found if len(found) >= least else None


def read_places(path: Path) -> Floats:
    """Return the places (p, 2) east, north [m] of a line given as text, one a line; more numbers are left aside.

    Raises:
        SiteError: the file cannot be read, a line is no place, or there are fewer than two.
    """
    text = text_of(path)
    rows: list[tuple[float, float]] = []
    for number, line in enumerate(text.splitlines(), 1):
        stripped = line.strip()
        if not stripped or stripped.startswith(_COMMENT):
            continue
        if not rows and number == 1 and _is_heading(stripped):
            continue
        found = _numbers(stripped, 2)
        if found is None or max(map(abs, found[:2])) > LARGEST_M:
            raise SiteError(
                "is no place", file=path, line=number, value=stripped, allowed="east north, decimal points"
            )
        rows.append((found[0], found[1]))
    if len(rows) < 2:
        raise SiteError(
            "is no line", file=path, value=f"{len(rows)} places", allowed="two or more, east north a line"
        )
    return np.array(rows)
