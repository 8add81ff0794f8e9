"""Checks written down, one JSON object a line: read back whole lines, whatever an interruption left of the last."""

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields
from datetime import UTC, datetime
from typing import Any

from workgauge.positioning.check import CheckResult

#: What tells our lines from others.
KIND, VERSION = "workgauge check", 1

_PLACES = ("e", "n", "h")


def line_of(result: CheckResult) -> str:
    """Return a check as one line of JSON, without the line's end; numbers nobody knows are null."""
    return json.dumps(record_of(result), ensure_ascii=False, allow_nan=False)


def record_of(result: CheckResult) -> dict[str, Any]:
    """Return a check as a JSON object, keys with their unit in the name."""
    utc = datetime.fromtimestamp(result.utc_ns // 1_000_000_000, UTC).isoformat().replace("+00:00", "Z")
    out: dict[str, Any] = {"kind": KIND, "version": VERSION, "utc": utc}
    for name, value in asdict(result).items():
        key = f"{name}_m" if name in _METRES else name
        if name in ("point", "tool"):
            out[name] = {place: _number(one) for place, one in zip(_PLACES, value, strict=True)}
        else:
            out[key] = list(value) if isinstance(value, tuple) else _number(value)
    return out


def read_line(line: str) -> CheckResult | None:
    """Return the check of one line, or None if it is none: another's line, or what an interruption left of one."""
    try:
        record = json.loads(line)
        if record["kind"] != KIND or record["version"] != VERSION:
            return None
        return _from(record)
    except (ValueError, KeyError, TypeError, RecursionError):
        return None


def last_check(lines: Iterable[str], machine: str, attachment: str) -> tuple[CheckResult | None, int]:
    """Return the newest check of this machine with this attachment, and how many lines could not be read.

    The file's order counts, not the stamps. A machine without a check of its own gets the file's last, whosever it
    is, so that a refusal can say whose checks these are.
    """
    own: CheckResult | None = None
    any_: CheckResult | None = None
    unread = 0
    for line in lines:
        if not line.strip():
            continue
        result = read_line(line)
        if result is None:
            unread += 1
            continue
        any_ = result
        if (result.machine, result.attachment) == (machine, attachment):
            own = result
    return own or any_, unread


_METRES = frozenset({"along", "left", "up", "distance", "sigma", "tolerance"})
_WORDS = frozenset({"machine", "attachment", "fingerprint", "point_name"})


def _number(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _from(record: Mapping[str, Any]) -> CheckResult:
    """Return the check of a record; raises on anything that is not one."""
    values: dict[str, Any] = {}
    for field in fields(CheckResult):
        name = field.name
        value = record[f"{name}_m" if name in _METRES else name]
        if name in _WORDS:
            values[name] = _typed(value, str)
        elif name == "utc_ns":
            values[name] = _typed(value, int)
        elif name == "passed":
            values[name] = _typed(value, bool)
        elif name == "why":
            values[name] = tuple(_typed(one, str) for one in _typed(value, list))
        elif name in ("point", "tool"):
            values[name] = tuple(_float(value[place]) for place in _PLACES)
        else:
            values[name] = _float(value)
    return CheckResult(**values)


def _float(value: Any) -> float:
    """Return a number; null is infinity: what was not known is beyond any limit."""
    if value is None:
        return math.inf
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(value)
    return float(value)


def _typed(value: Any, kind: type) -> Any:
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise TypeError(value)
    return value
