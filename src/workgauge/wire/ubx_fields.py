"""The fields of UBX payloads: pyubx2's definitions compiled into one `struct` each, read and written alike.

Sizes, scales and bit fields are pyubx2's. Its own building truncates a scaled value instead of rounding it, so that
47.1290927 degrees become 47.1290926, and its parsing takes about 0.1 ms for a NAV-PVT; `benchmarks/decode.py`
measures it.
"""

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pyubx2.ubxtypes_get import UBX_PAYLOADS_GET

from workgauge.values.errors import WireError

_CODES = {
    "U001": "B",
    "U002": "H",
    "U004": "I",
    "I001": "b",
    "I002": "h",
    "I004": "i",
    "R004": "f",
    "X001": "B",
    "X002": "H",
    "X004": "I",
}
_FINE = "_HP"  # marks the finer digits of the field of that name


@dataclass(frozen=True, slots=True)
class _Number:
    """A field at a place of the struct, in units of 1/per of what it says; `fine_at` its finer digits."""

    at: int
    per: float
    fine_at: int | None = None
    ratio: int = 1
    real: bool = False


@dataclass(frozen=True, slots=True)
class _Bits:
    at: int
    shift: int
    mask: int


class Payload:
    """One message's payload: names to numbers in the units of u-blox's interface description, and back.

    Args:
        definition: pyubx2's name, e.g. `NAV-PVT`.
        names: the fields in use; all others are read over, and written as zero.
    """

    def __init__(self, definition: str, names: tuple[str, ...]) -> None:
        form, places, self._bits = _compiled(UBX_PAYLOADS_GET[definition])
        self._struct = struct.Struct(form)
        self._numbers = {name: places[name] for name in names if name in places}
        missing = [name for name in names if name not in places and name not in self._bits]
        if missing:
            raise KeyError(missing)
        self._count = len(self._struct.unpack(bytes(self._struct.size)))
        self._plan = tuple((n, p.at, p.per, p.fine_at, p.ratio) for n, p in self._numbers.items())
        self._flags = tuple((n, b.at, b.shift, b.mask) for n, b in self._bits.items() if n in names)

    @property
    def size(self) -> int:
        """Length of the payload [bytes]."""
        return self._struct.size

    def read(self, payload: bytes) -> dict[str, Any]:
        """Return the fields in use."""
        raw = self._struct.unpack(payload)
        values = {
            name: raw[at] / per if fine_at is None else (raw[at] * ratio + raw[fine_at]) / per
            for name, at, per, fine_at, ratio in self._plan
        }
        for name, at, shift, mask in self._flags:
            values[name] = raw[at] >> shift & mask
        return values

    def write(self, values: Mapping[str, float]) -> bytes:
        """Return the payload; fields not named are zero, and so is NaN in a whole number.

        Raises:
            WireError: if a number does not fit its field.
        """
        raw: list[Any] = [0] * self._count
        for name, value in values.items():
            bits = self._bits.get(name)
            if bits is not None:
                raw[bits.at] |= (int(value) & bits.mask) << bits.shift
                continue
            number = self._numbers[name]
            if number.real:
                raw[number.at] = value
                continue
            units = 0 if math.isnan(value) else _units(name, value, number.per)
            if number.fine_at is None:
                raw[number.at] = units
            else:
                whole = abs(units) // number.ratio * (1 if units >= 0 else -1)
                raw[number.at], raw[number.fine_at] = whole, units - whole * number.ratio
        try:
            return self._struct.pack(*raw)
        except (struct.error, OverflowError) as error:
            raise WireError("a number does not fit its field", element="UBX payload", value=str(error)) from None


def _units(name: str, value: float, per: float) -> int:
    if math.isinf(value):
        raise WireError("a number does not fit its field", element=name, value=value)
    return round(value * per)


def _compiled(definition: Mapping[str, Any]) -> tuple[str, dict[str, _Number], dict[str, _Bits]]:
    """Return the struct's format, where each number stands in it, and where each bit field."""
    form, at = "<", 0
    numbers: dict[str, _Number] = {}
    bits: dict[str, _Bits] = {}
    for name, kind in definition.items():
        if name.endswith("_bit"):
            code, flags = kind
            shift = 0
            for flag, size in flags.items():
                width = int(size[1:])
                bits[flag] = _Bits(at, shift, (1 << width) - 1)
                shift += width
        else:
            code, scale = kind if isinstance(kind, tuple) else (kind, 1)
            if code not in _CODES:  # reserved bytes of any length
                form += f"{int(code[1:])}x"
                continue
            per = float(round(1.0 / scale))
            if name.startswith(_FINE):
                coarse = numbers[name.removeprefix(_FINE)]
                numbers[name.removeprefix(_FINE)] = _Number(coarse.at, per, at, round(per / coarse.per))
            else:
                numbers[name] = _Number(at, per, real=code == "R004")
        form += _CODES[code]
        at += 1
    return form, numbers, bits
