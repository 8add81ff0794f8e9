"""NMEA sentences that say where an antenna is: GGA, GLL, RMC, PTNL GGK and PJK, PASHR POS; read and written.

A sentence that says its fix is invalid (quality 0, status `V`, mode `N`) gives quality NONE and no position, even if
it repeats an old one. Every function is one side of a row in `nmea_table`.
"""

import math
from collections.abc import Mapping
from typing import Any

from workgauge.values.errors import WireError
from workgauge.values.navigation import FixQuality, GnssFix, GnssGridFix, GnssVelocity, Measurement
from workgauge.wire.nmea_fields import FieldError
from workgauge.wire.parts import Parts, Reading, latitude_longitude, quality_numbered

KNOT_M_S = 1852.0 / 3600.0

_Q = FixQuality
#: The mode letter of GLL, RMC, VTG; the first letter of a quality is the one written.
_MODES = {
    "A": _Q.SINGLE,
    "D": _Q.DIFFERENTIAL,
    "P": _Q.PPS,
    "R": _Q.FIXED,
    "F": _Q.FLOAT,
    "E": _Q.DEAD_RECKONING,
    "M": _Q.MANUAL,
    "S": _Q.SIMULATED,
    "N": _Q.NONE,
}
_LETTERS = {quality: letter for letter, quality in _MODES.items()} | {_Q.OTHER: "?"}
#: Trimble's numbers in GGK and PJK, from its receivers' manual; 2D network solutions count as their 3D ones,
#: RTK location and xFill as float, wide-area corrections as differential.
_TRIMBLE = {
    0: _Q.NONE,
    1: _Q.SINGLE,
    2: _Q.FLOAT,
    3: _Q.FIXED,
    4: _Q.DIFFERENTIAL,
    5: _Q.DIFFERENTIAL,
    6: _Q.FLOAT,
    7: _Q.FIXED,
    8: _Q.FLOAT,
    9: _Q.FIXED,
    10: _Q.DIFFERENTIAL,
    11: _Q.DIFFERENTIAL,
    12: _Q.FLOAT,
    13: _Q.DIFFERENTIAL,
    14: _Q.DIFFERENTIAL,
    15: _Q.FLOAT,
}
_TRIMBLE_NUMBERS = {_Q.NONE: 0, _Q.SINGLE: 1, _Q.FLOAT: 2, _Q.FIXED: 3, _Q.DIFFERENTIAL: 4}
#: Ashtech's solution types in PASHR POS, from its receivers' manual.
_ASHTECH = {
    0: _Q.SINGLE,
    1: _Q.DIFFERENTIAL,
    2: _Q.FLOAT,
    3: _Q.FIXED,
    5: _Q.DEAD_RECKONING,
    9: _Q.DIFFERENTIAL,
    10: _Q.DIFFERENTIAL,
    12: _Q.FLOAT,
    13: _Q.FIXED,
    22: _Q.FLOAT,
    23: _Q.FIXED,
}
_ASHTECH_NUMBERS = {_Q.SINGLE: 0, _Q.DIFFERENTIAL: 1, _Q.FLOAT: 2, _Q.FIXED: 3, _Q.DEAD_RECKONING: 5}


def write_number(numbers: Mapping[FixQuality, int], quality: FixQuality, sentence: str) -> int:
    """Return a maker's number for a quality; `WireError` if it has none."""
    if quality not in numbers:
        raise WireError("the sentence has no number for this quality", element=sentence, value=quality.name)
    return numbers[quality]


def read_mode(status: str, mode: str) -> FixQuality:
    """Return the quality of a status (`A` valid, `V` not) and a mode letter; without a mode, valid means single."""
    if status != "A":
        if status not in ("V", ""):
            raise FieldError(status)
        return FixQuality.NONE
    return _MODES.get(mode, FixQuality.OTHER) if mode else FixQuality.SINGLE


def write_mode(quality: FixQuality) -> str:
    """Return the mode letter of a quality."""
    return _LETTERS[quality]


def _signed(value: float, side: str, plus: str, minus: str, most: float) -> float:
    """Return radians with sign."""
    if math.isnan(value):
        return math.nan
    if value > most or side not in (plus, minus):
        raise FieldError(f"{value} {side}")
    return math.radians(value if side == plus else -value)


def _place(v: Mapping[str, Any], quality: FixQuality) -> tuple[float, float]:
    """Return latitude and longitude [rad], NaN without a fix; both or none."""
    latitude = _signed(v["lat"], v["NS"], "N", "S", 90.0)
    longitude = _signed(v["lon"], v["EW"], "E", "W", 180.0)
    if math.isnan(latitude) != math.isnan(longitude):
        raise FieldError("half a position")
    return (math.nan, math.nan) if quality is FixQuality.NONE else (latitude, longitude)


def _sides(fix: GnssFix) -> dict[str, Any]:
    latitude, longitude = latitude_longitude(fix)
    if math.isnan(latitude):
        return {}
    return {
        "lat": abs(latitude),
        "NS": "S" if math.copysign(1.0, latitude) < 0.0 else "N",
        "lon": abs(longitude),
        "EW": "W" if math.copysign(1.0, longitude) < 0.0 else "E",
    }


def course(degrees: float) -> float:
    """Return an angle of a circle in [0, 2 pi) from degrees; NaN stays."""
    return math.radians(degrees % 360.0)


def course_degrees(angle: float, digits: int) -> float:
    """Return degrees in [0, 360) rounded to so many digits, never 360; NaN stays."""
    return round(math.degrees(angle) % 360.0, digits) % 360.0


def read_gga(v: dict[str, Any], by: Reading) -> tuple[Measurement, ...]:
    """One fix; height over the ellipsoid if height and geoid separation are given."""
    quality = quality_numbered(v["quality"])
    latitude, longitude = _place(v, quality)
    return (
        GnssFix(
            by.timed(v["time"], valid=quality is not FixQuality.NONE),
            "GGA",
            latitude,
            longitude,
            v["time"],
            v["alt"] + v["sep"],
            v["alt"],
            v["sep"],
            quality,
            v["numSV"],
            v["HDOP"],
            v["diffAge"],
        ),
    )


def write_gga(parts: Parts) -> dict[str, Any]:
    """A fix; a height given only over the ellipsoid is written by the separation."""
    fix = parts.need(GnssFix)
    above = fix.height_msl_m
    if math.isnan(above):
        above = fix.height_ellipsoid_m - fix.geoid_separation_m
    return {
        "time": parts.time_s,
        **_sides(fix),
        "quality": int(fix.quality),
        "numSV": fix.satellites,
        "HDOP": fix.hdop,
        "alt": above,
        "sep": fix.geoid_separation_m,
        "diffAge": fix.correction_age_s,
    }


def read_gll(v: dict[str, Any], by: Reading) -> tuple[Measurement, ...]:
    """One fix."""
    quality = read_mode(v["status"], v["posMode"])
    latitude, longitude = _place(v, quality)
    stamp = by.timed(v["time"], valid=quality is not FixQuality.NONE)
    return (GnssFix(stamp, "GLL", latitude, longitude, v["time"], quality=quality),)


def write_gll(parts: Parts) -> dict[str, Any]:
    """A fix."""
    fix = parts.need(GnssFix)
    return {
        **_sides(fix),
        "time": parts.time_s,
        "status": "V" if fix.quality is FixQuality.NONE else "A",
        "posMode": write_mode(fix.quality),
    }


def read_rmc(v: dict[str, Any], by: Reading) -> tuple[Measurement, ...]:
    """A fix and a velocity; time and date count from a valid sentence only, as receivers make them up before."""
    quality = read_mode(v["status"], v["posMode"])
    latitude, longitude = _place(v, quality)
    valid = quality is not FixQuality.NONE
    stamp = by.timed(v["time"], v["date"], valid)
    return (
        GnssFix(stamp, "RMC", latitude, longitude, v["time"], quality=quality),
        GnssVelocity(
            stamp,
            "RMC",
            v["spd"] * KNOT_M_S if valid else math.nan,
            course(v["cog"]) if valid else math.nan,
            v["time"],
        ),
    )


def write_rmc(parts: Parts) -> dict[str, Any]:
    """A fix, and a velocity if given."""
    fix, velocity = parts.need(GnssFix), parts.get(GnssVelocity)
    return {
        "time": parts.time_s,
        "status": "V" if fix.quality is FixQuality.NONE else "A",
        **_sides(fix),
        "spd": math.nan if velocity is None else velocity.speed_m_s / KNOT_M_S,
        "cog": math.nan if velocity is None else course_degrees(velocity.course, 4),
        "date": parts.day,
        "posMode": write_mode(fix.quality),
    }


def read_ggk(v: dict[str, Any], by: Reading) -> tuple[Measurement, ...]:
    """One fix with its ellipsoidal height."""
    quality = _TRIMBLE.get(v["gpsQual"] or 0, FixQuality.OTHER)
    latitude, longitude = _place(v, quality)
    kind, height = v["height"]
    stamp = by.timed(v["utctime"], v["utcdate"], quality is not FixQuality.NONE)
    fix = {"height_ellipsoid_m" if kind == "EHT" else "height_msl_m": height}
    return (
        GnssFix(
            stamp,
            "PTNL,GGK",
            latitude,
            longitude,
            v["utctime"],
            quality=quality,
            satellites=v["sip"],
            **fix,
        ),
    )


def write_ggk(parts: Parts) -> dict[str, Any]:
    """A fix with its ellipsoidal height."""
    fix = parts.need(GnssFix)
    return {
        "utctime": parts.time_s,
        "utcdate": parts.day,
        **_sides(fix),
        "gpsQual": write_number(_TRIMBLE_NUMBERS, fix.quality, "PTNL,GGK"),
        "sip": fix.satellites,
        "height": ("EHT", fix.height_ellipsoid_m),
    }


def read_pjk(v: dict[str, Any], by: Reading) -> tuple[Measurement, ...]:
    """One fix in the receiver's own projection."""
    quality = _TRIMBLE.get(v["gpsQual"] or 0, FixQuality.OTHER)
    none = quality is FixQuality.NONE
    kind, height = v["height"]
    return (
        GnssGridFix(
            by.timed(v["utctime"], v["utcdate"], not none),
            "PTNL,PJK",
            math.nan if none else v["easting"],
            math.nan if none else v["northing"],
            v["utctime"],
            height,
            quality,
            v["sip"],
            kind == "GHT",
        ),
    )


def write_pjk(parts: Parts) -> dict[str, Any]:
    """A fix in the receiver's own projection."""
    fix = parts.need(GnssGridFix)
    return {
        "utctime": parts.time_s,
        "utcdate": parts.day,
        "northing": fix.northing_m,
        "easting": fix.easting_m,
        "gpsQual": write_number(_TRIMBLE_NUMBERS, fix.quality, "PTNL,PJK"),
        "sip": fix.satellites,
        "height": ("GHT" if fix.orthometric else "EHT", fix.height_m),
    }


def read_pos(v: dict[str, Any], by: Reading) -> tuple[Measurement, ...]:
    """A fix with its ellipsoidal height, and a velocity; without a position there is no fix."""
    quality = FixQuality.NONE
    if not math.isnan(v["lat"]) and v["solnType"] is not None:
        quality = _ASHTECH.get(v["solnType"], FixQuality.OTHER)
    latitude, longitude = _place(v, quality)
    valid = quality is not FixQuality.NONE
    stamp = by.timed(v["utctime"], valid=valid)
    return (
        GnssFix(
            stamp,
            "PASHR,POS",
            latitude,
            longitude,
            v["utctime"],
            height_ellipsoid_m=v["alt"],
            quality=quality,
            satellites=v["sip"],
            hdop=v["HDOP"],
            correction_age_s=v["corrAge"],
        ),
        GnssVelocity(
            stamp,
            "PASHR,POS",
            v["sog"] * KNOT_M_S if valid else math.nan,
            course(v["trueTrk"]) if valid else math.nan,
            v["utctime"],
            v["vertVel"] if valid else math.nan,
        ),
    )


def write_pos(parts: Parts) -> dict[str, Any]:
    """A fix, and a velocity if given."""
    fix, velocity = parts.need(GnssFix), parts.get(GnssVelocity)
    none = fix.quality is FixQuality.NONE
    return {
        "solnType": None if none else write_number(_ASHTECH_NUMBERS, fix.quality, "PASHR,POS"),
        "sip": fix.satellites,
        "utctime": parts.time_s,
        **_sides(fix),
        "alt": fix.height_ellipsoid_m,
        "corrAge": fix.correction_age_s,
        "trueTrk": math.nan if velocity is None else course_degrees(velocity.course, 4),
        "sog": math.nan if velocity is None else velocity.speed_m_s / KNOT_M_S,
        "vertVel": math.nan if velocity is None else velocity.climb_m_s,
        "HDOP": fix.hdop,
    }
