"""The fields of NMEA sentences: text to number and back, one codec both ways.

The order and the names of a sentence's fields are pynmeagps's. The conversions are not: that library rounds
positions to 1e-10 degrees, leaves out angles whose degrees are not padded (`401.33`), reads the month of GGK and PJK
as the day, writes minutes that round up as 60, and takes 20 to 40 microseconds for a sentence, as
`benchmarks/decode.py` measures.
"""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import date
from typing import Any

from pynmeagps.nmeatypes_get import NMEA_PAYLOADS_GET
from pynmeagps.nmeatypes_get_prop import NMEA_PAYLOADS_GET_PROP

from workgauge.values.errors import WireError

_DECIMAL = re.compile(r"[+-]?(?:\d{1,12}(?:\.\d{0,12})?|\.\d{1,12})")
_ANGLE = re.compile(r"\d{1,5}(?:\.\d{0,12})?")
_TIME = re.compile(r"\d{6}(?:\.\d{0,9})?")
_DATE = re.compile(r"\d{6}")
_WHOLE = re.compile(r"\d{1,9}")
_HEIGHT = re.compile(r"([EG]HT)([+-]?\d{1,6}(?:\.\d{0,9})?)")
_EPOCH_DAY = date(1970, 1, 1).toordinal()
_FIRST_YEAR = 80  # of the century: GPS time begins in 1980
#: Minutes of a written position have eight decimals, 0.02 mm on the ground.
MINUTE_DECIMALS = 8
_UNITS = 60 * 10**MINUTE_DECIMALS


class FieldError(ValueError):
    """A field that holds what it must not."""


@dataclass(frozen=True, slots=True)
class Codec:
    """How one field is read and written; an empty field is read as `empty`, and that is written as an empty field."""

    read: Callable[[str], Any]
    write: Callable[[Any], str]


def _checked(pattern: re.Pattern[str], text: str) -> str:
    if pattern.fullmatch(text) is None:
        raise FieldError(text)
    return text


def _read_decimal(text: str) -> float:
    return float(_checked(_DECIMAL, text)) if text else math.nan


def _read_whole(text: str) -> int | None:
    return int(_checked(_WHOLE, text)) if text else None


def _read_text(text: str) -> str:
    return text


def _read_angle(text: str) -> float:
    if not text:
        return math.nan
    number = float(_checked(_ANGLE, text))
    degrees = number // 100.0
    minutes = number - 100.0 * degrees
    if minutes >= 60.0:
        raise FieldError(text)
    return degrees + minutes / 60.0


def _read_time(text: str) -> float:
    if not text:
        return math.nan
    _checked(_TIME, text)
    hours, minutes, seconds = int(text[:2]), int(text[2:4]), float(text[4:])
    if hours > 23 or minutes > 59 or seconds >= 61.0:
        raise FieldError(text)
    return 3600.0 * hours + 60.0 * minutes + seconds


def _day(year: int, month: int, day: int) -> int:
    try:
        return date(year, month, day).toordinal() - _EPOCH_DAY
    except ValueError:
        raise FieldError(f"{year}-{month}-{day}") from None


def _read_date(text: str, day_at: int, month_at: int) -> int | None:
    if not text:
        return None
    _checked(_DATE, text)
    year = int(text[4:])
    year += 1900 if year >= _FIRST_YEAR else 2000
    return _day(year, int(text[month_at : month_at + 2]), int(text[day_at : day_at + 2]))


def day_of(year: int, month: int, day: int) -> int:
    """Return the number of days since 1970-01-01; `FieldError` if there is no such day."""
    return _day(year, month, day)


def date_of(day: int) -> date:
    """Return the date so many days after 1970-01-01."""
    return date.fromordinal(day + _EPOCH_DAY)


def _read_height(text: str) -> tuple[str, float]:
    if not text:
        return "EHT", math.nan
    found = _HEIGHT.fullmatch(text)
    if found is None:
        raise FieldError(text)
    return found[1], float(found[2])


def _write_height(value: tuple[str, float]) -> str:
    kind, height = value
    text = _SIGNED_HEIGHT(height)
    return kind + text if text else ""


def _decimal_writer(digits: int, width: int, sign: str) -> Callable[[float], str]:
    form = f"{{:{sign}0{width}.{digits}f}}" if width else f"{{:{sign}.{digits}f}}"
    zero = form.format(-0.0), form.format(0.0)

    def write(value: float) -> str:
        if math.isnan(value):
            return ""
        if math.isinf(value) or abs(value) >= 1e12:
            raise WireError("a number does not fit its field", element="decimal", value=value)
        text = form.format(value)
        return zero[1] if text == zero[0] else text

    return write


_SIGNED_HEIGHT = _decimal_writer(4, 0, "+")


def _angle_writer(degree_digits: int) -> Callable[[float], str]:
    def write(value: float) -> str:
        if math.isnan(value):
            return ""
        degrees, rest = divmod(round(value * _UNITS), _UNITS)
        minutes, fraction = divmod(rest, 10**MINUTE_DECIMALS)
        return f"{degrees:0{degree_digits}d}{minutes:02d}.{fraction:0{MINUTE_DECIMALS}d}"

    return write


def _write_time(value: float) -> str:
    if math.isnan(value):
        return ""
    rest, milliseconds = divmod(round(value * 1000.0), 1000)
    rest, seconds = divmod(rest, 60)
    hours, minutes = divmod(rest, 60)
    return f"{hours % 24:02d}{minutes:02d}{seconds:02d}.{milliseconds:03d}"


def _date_writer(form: str) -> Callable[[int | None], str]:
    def write(value: int | None) -> str:
        if value is None:
            return ""
        day = date_of(value)
        if not 1900 + _FIRST_YEAR <= day.year < 2000 + _FIRST_YEAR:
            raise WireError("a year that two digits do not say", element="date", value=day, allowed="1980 to 2079")
        return day.strftime(form)

    return write


def _whole_writer(width: int) -> Callable[[int | None], str]:
    def write(value: int | None) -> str:
        if value is None:
            return ""
        if not 0 <= value < 10**9:
            raise WireError("a number does not fit its field", element="whole", value=value)
        return f"{value:0{width}d}"

    return write


def decimal(digits: int, width: int = 0, sign: str = "") -> Codec:
    """A decimal number with so many decimals, NaN if empty; `sign` `+` writes the sign always."""
    return Codec(_read_decimal, _decimal_writer(digits, width, sign))


def whole(width: int = 1) -> Codec:
    """A whole number, None if empty."""
    return Codec(_read_whole, _whole_writer(width))


LATITUDE = Codec(_read_angle, _angle_writer(2))  #: degrees without sign, NaN if empty
LONGITUDE = Codec(_read_angle, _angle_writer(3))  #: degrees without sign, NaN if empty
TIME = Codec(_read_time, _write_time)  #: seconds since midnight, NaN if empty
DATE = Codec(lambda text: _read_date(text, 0, 2), _date_writer("%d%m%y"))  #: ddmmyy: days since 1970, None if empty
DATE_MONTH_FIRST = Codec(lambda text: _read_date(text, 2, 0), _date_writer("%m%d%y"))  #: mmddyy, as Trimble's
TEXT = Codec(_read_text, str)  #: as it stands
HEIGHT = Codec(_read_height, _write_height)  #: ("EHT" ellipsoidal or "GHT" over the geoid, metres)


class Layout:
    """The fields of one sentence: which are read, where they stand, and what a written one says besides.

    Args:
        payload: pynmeagps's name of the payload, e.g. `GGA`, `TNLGGK`.
        codecs: how the fields in use are read and written, by pynmeagps's names; all others stay empty.
        least: so many fields after the sentence's name at least; older receivers leave out the last ones.
        constants: fields that are always written the same and not read, such as units.
    """

    def __init__(
        self, payload: str, codecs: Mapping[str, Codec], least: int, constants: Mapping[str, str] | None = None
    ) -> None:
        names = list(NMEA_PAYLOADS_GET.get(payload) or NMEA_PAYLOADS_GET_PROP[payload])
        self.least = least
        self._size = len(names)
        self._plan = tuple((name, names.index(name), codecs[name].read) for name in codecs)
        self._writers = {name: (names.index(name), codec.write) for name, codec in codecs.items()}
        self._template = [""] * self._size
        for name, text in (constants or {}).items():
            self._template[names.index(name)] = text

    def read(self, fields: list[str]) -> dict[str, Any]:
        """Return the values of the fields after the sentence's name; `FieldError` if one cannot be read."""
        missing = self._size - len(fields)
        if missing > 0:
            fields = fields + [""] * missing
        return {name: read(fields[at]) for name, at, read in self._plan}

    def write(self, values: Mapping[str, Any]) -> list[str]:
        """Return the fields that say these values; those not named stay empty."""
        fields = list(self._template)
        for name, value in values.items():
            at, write = self._writers[name]
            fields[at] = write(value)
        return fields
