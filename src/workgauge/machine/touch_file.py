"""Touches of a tool's tip, from a table as a spreadsheet or a total station writes it.

One row per touch. Columns: every joint's position, `boom_deg` (`_m` where it slides); and where the tip was, `x_m`,
`y_m`, `z_m` in the machine frame or `e_m`, `n_m`, `h_m` in the site, or neither if all touches are of one same point.
Columns of other names are not read. Comma, semicolon or tab separates; with the last two, a comma may be the decimal
sign.
"""

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from workgauge.machine.measure_up import Touch
from workgauge.machine.model import MachineModel
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import MachineError
from workgauge.values.transforms import apply, inverse

_LARGEST = 1_000_000  # bytes
_MACHINE = ("x_m", "y_m", "z_m")
_SITE = ("e_m", "n_m", "h_m")


def read_touches(path: Path, machine: MachineModel, T_site_machine: Floats | None = None) -> list[Touch]:
    """Return the touches of a table.

    Args:
        T_site_machine: (4, 4) where the machine stood, for places in the site's coordinates.

    Raises:
        MachineError: with file, line and column, if the table is not one of touches of this machine.
    """
    header, rows, comma = _rows(path)
    joints = [f"{name}_{'m' if machine.prismatic[j] else 'deg'}" for j, name in enumerate(machine.joint_names)]
    for name in joints:
        if name not in header:
            raise MachineError("a column is missing", file=path, line=1, element=name, allowed=", ".join(joints))
    places = [columns for columns in (_MACHINE, _SITE) if any(name in header for name in columns)]
    if len(places) > 1 or any(name not in header for columns in places for name in columns):
        found = ", ".join(name for name in header if name in (*_MACHINE, *_SITE))
        allowed = "x_m, y_m, z_m in the machine frame; or e_m, n_m, h_m in the site; or none"
        raise MachineError("not a place of the tip", file=path, line=1, value=found, allowed=allowed)
    if places == [_SITE] and T_site_machine is None:
        raise MachineError(
            "places in the site's coordinates need the machine's own place",
            file=path,
            line=1,
            element="e_m",
            allowed="--pose E,N,H,HEADING_DEG",
        )
    touches = []
    for line, row in rows:
        q = [_number(path, line, row, name, comma) for name in joints]
        radians = [v if machine.prismatic[j] else math.radians(v) for j, v in enumerate(q)]
        point = None
        if places:
            point = frozen([_number(path, line, row, name, comma) for name in places[0]])
        if point is not None and places == [_SITE] and T_site_machine is not None:
            point = frozen(apply(inverse(T_site_machine), point))
        touches.append(Touch(frozen(radians), point))
    return touches


def _rows(path: Path) -> tuple[list[str], list[tuple[int, dict[str, str]]], bool]:
    """Return the header, the rows with their line numbers, and whether a comma may be the decimal sign."""
    try:
        data = path.read_bytes()
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise MachineError("cannot read the touches", file=path, value=reason) from error
    if len(data) > _LARGEST:
        raise MachineError("this is no table of touches", file=path, value=f"{len(data)} bytes", allowed="1 MB")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise MachineError("this is no table of touches", file=path, value="not text", allowed="UTF-8 text") from None
    first = text.lstrip("\r\n").split("\n", 1)[0]
    separator = next((one for one in (";", "\t") if one in first), ",")
    try:
        table = list(csv.reader(text.splitlines(), delimiter=separator))
    except csv.Error as error:
        raise MachineError("this is no table of touches", file=path, value=str(error)) from error
    numbered = [(i + 1, [cell.strip() for cell in row]) for i, row in enumerate(table) if any(map(str.strip, row))]
    if not numbered:
        raise MachineError("this is no table of touches", file=path, value="nothing", allowed="a header and rows")
    header = numbered[0][1]
    for name in header:
        if name and header.count(name) > 1:
            raise MachineError("column appears twice", file=path, line=numbered[0][0], element=name)
    return header, [(line, _row(path, line, header, cells)) for line, cells in numbered[1:]], separator != ","


def _row(path: Path, line: int, header: Sequence[str], cells: Sequence[str]) -> dict[str, str]:
    if len(cells) != len(header):
        raise MachineError(
            "the row has another number of cells", file=path, line=line, value=len(cells), allowed=f"{len(header)}"
        )
    return dict(zip(header, cells, strict=True))


def _number(path: Path, line: int, row: Mapping[str, str], name: str, comma: bool) -> float:
    text = row[name].replace(",", ".") if comma else row[name]
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) < 1e9:
        raise MachineError("not a number", file=path, line=line, element=name, value=row[name], allowed="a number")
    return value
