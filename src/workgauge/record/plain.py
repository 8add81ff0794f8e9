"""Frozen values as plain JSON and back, bit for bit, by their own type annotations; and the JSON Schema of that.

A dataclass is an object of its fields, an array nested lists, a set a sorted list, an enumeration its value. Numbers
keep every bit, as Python's shortest decimal does; what JSON has no number for is the text `NaN`, `Infinity` or
`-Infinity`.
"""

import math
import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from typing import Any, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

from workgauge.values.arrays import frozen, frozen_ints

T = TypeVar("T")
_WORDS = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}


def to_plain(value: Any) -> Any:
    """Return a value as dicts, lists, numbers, texts and None.

    Raises:
        TypeError: for a type nobody said how to write.
    """
    if value is None or (isinstance(value, bool | str) and not isinstance(value, Enum)):
        return value
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, np.ndarray):
        return _listed(value.tolist())
    if isinstance(value, float | np.floating):
        return _number(float(value))
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, frozenset | set):
        return sorted(value)
    if isinstance(value, tuple | list):
        return [to_plain(one) for one in value]
    if isinstance(value, Mapping):
        return {str(key): to_plain(one) for key, one in value.items()}
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: to_plain(getattr(value, field.name)) for field in fields(value)}
    raise TypeError(f"no plain form for {type(value).__name__}")


def from_plain(kind: type[T], plain: Any) -> T:
    """Return the value of a type (a dataclass, or anything an annotation may say) whose plain form this is.

    Raises:
        ValueError: if it is not one, naming the field.
    """
    return cast(T, _from(kind, plain, getattr(kind, "__name__", str(kind))))


def json_schema(kind: Any) -> dict[str, Any]:
    """Return the JSON Schema of a type's plain form."""
    if _is_optional(kind):
        schema = json_schema(_inner(kind))
        if "type" in schema:
            return {**schema, "type": [schema["type"], "null"]}
        return {"anyOf": [schema, {"type": "null"}]}
    origin = get_origin(kind)
    if origin is np.ndarray:
        return {"type": "array", "items": {}}
    if origin in (tuple, frozenset):
        return {"type": "array", "items": json_schema(get_args(kind)[0])}
    if origin is Literal:
        return {"enum": list(get_args(kind))}
    if isinstance(kind, type) and is_dataclass(kind):
        properties = {name: json_schema(hint) for name, hint in _hints(kind).items()}
        return {"type": "object", "properties": properties, "required": list(properties)}
    if isinstance(kind, type) and issubclass(kind, Enum):
        return {"type": "string", "enum": [one.value for one in kind]}
    return {"type": {bool: "boolean", int: "integer", float: "number", str: "string"}.get(kind, "object")}


@cache
def _hints(kind: Any) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in fields(kind)}


def _is_optional(kind: Any) -> bool:
    return get_origin(kind) in (Union, types.UnionType) and type(None) in get_args(kind)


def _inner(kind: Any) -> Any:
    return next(one for one in get_args(kind) if one is not type(None))


def _from(kind: Any, plain: Any, where: str) -> Any:
    if _is_optional(kind):
        return None if plain is None else _from(_inner(kind), plain, where)
    origin = get_origin(kind)
    if origin is np.ndarray:
        return _array(kind, plain, where)
    if origin in (tuple, frozenset):
        items = _expect(plain, list, where)
        return origin(_from(get_args(kind)[0], one, f"{where}[{i}]") for i, one in enumerate(items))
    if origin is Literal:
        if plain not in get_args(kind):
            raise ValueError(f"{where}: one of {get_args(kind)} expected, found {plain!r}")
        return plain
    if isinstance(kind, type) and is_dataclass(kind):
        found, hints = _expect(plain, dict, where), _hints(kind)
        if set(found) != set(hints):
            odd = sorted(set(found) ^ set(hints))
            raise ValueError(f"{where}: missing or unknown: {', '.join(odd)}")
        return kind(**{name: _from(hint, found[name], f"{where}.{name}") for name, hint in hints.items()})
    if isinstance(kind, type) and issubclass(kind, Enum):
        return kind(plain)
    if kind is float:
        return _float(plain, where)
    if kind in (bool, int, str):
        return _expect(plain, kind, where)
    raise ValueError(f"{where}: no value can be made of this")


def _array(kind: Any, plain: Any, where: str) -> Any:
    whole = get_args(get_args(kind)[1])[0] is np.int64
    try:
        if whole:
            return frozen_ints(_expect(plain, list, where))
        return frozen(_unlisted(_expect(plain, list, where)))
    except (TypeError, KeyError, ValueError) as error:
        raise ValueError(f"{where}: not an array of numbers ({error})") from None


def _expect(plain: Any, kind: type, where: str) -> Any:
    if not isinstance(plain, kind) or (kind is int and isinstance(plain, bool)):
        raise ValueError(f"{where}: {kind.__name__} expected, found {type(plain).__name__}")
    return plain


def _number(value: float) -> float | str:
    if math.isfinite(value):
        return value
    return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"


def _float(plain: Any, where: str) -> float:
    if isinstance(plain, float) or (isinstance(plain, int) and not isinstance(plain, bool)):
        return float(plain)
    if plain in _WORDS:
        return _WORDS[plain]
    raise ValueError(f"{where}: a number expected, found {plain!r}")


def _listed(values: Any) -> Any:
    if isinstance(values, list):
        return [_listed(one) for one in values]
    return _number(values) if isinstance(values, float) else values


def _unlisted(plain: Any) -> Any:
    if isinstance(plain, list):
        return [_unlisted(one) for one in plain]
    return _float(plain, "element")
