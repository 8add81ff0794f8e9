"""NMEA sentences that say how an antenna moves, how sure a fix is, and where a baseline points; read and written.

VTG, GST, ZDA, HDT, THS, ROT, PTNL AVR, PASHR. Every function is one side of a row in `nmea_table`.
"""

import math
from typing import Any

import numpy as np

from workgauge.values.arrays import frozen
from workgauge.values.errors import WireError
from workgauge.values.navigation import (
    FixQuality,
    GnssError,
    GnssHeading,
    GnssVelocity,
    Inclination,
    Measurement,
    TurnRate,
)
from workgauge.wire.nmea_fields import FieldError, date_of, day_of
from workgauge.wire.nmea_positions import KNOT_M_S, course, course_degrees, write_number
from workgauge.wire.parts import Parts, Reading

KMH_M_S = 1.0 / 3.6
PER_MINUTE = math.radians(1.0) / 60.0
SIGMA_DIGITS = 4

_Q = FixQuality
_AVR = {0: _Q.NONE, 1: _Q.SINGLE, 2: _Q.FLOAT, 3: _Q.FIXED, 4: _Q.DIFFERENTIAL}
_AVR_NUMBERS = {quality: number for number, quality in _AVR.items()}
_PASHR = {0: _Q.NONE, 1: _Q.SINGLE, 2: _Q.FIXED}
_PASHR_NUMBERS = {quality: number for number, quality in _PASHR.items()}
_THS = {"A": _Q.OTHER, "E": _Q.DEAD_RECKONING, "M": _Q.MANUAL, "S": _Q.SIMULATED, "V": _Q.NONE}
_THS_LETTERS = {quality: letter for letter, quality in _THS.items()}


def read_vtg(v: dict[str, Any], by: Reading) -> tuple[Measurement, ...]:
    """A velocity, NaN in mode `N`; it has no time."""
    speed = v["sogn"] * KNOT_M_S
    if math.isnan(speed):
        speed = v["sogk"] * KMH_M_S
    if v["posMode"] == "N":
        return (GnssVelocity(by.stamp(), "VTG", math.nan, math.nan),)
    return (GnssVelocity(by.stamp(), "VTG", speed, course(v["cogt"])),)


def write_vtg(parts: Parts) -> dict[str, Any]:
    """A velocity."""
    velocity = parts.need(GnssVelocity)
    return {
        "cogt": course_degrees(velocity.course, 4),
        "sogn": velocity.speed_m_s / KNOT_M_S,
        "sogk": velocity.speed_m_s / KMH_M_S,
        "posMode": "N" if math.isnan(velocity.speed_m_s) else "A",
    }


def read_gst(v: dict[str, Any], by: Reading) -> tuple[Measurement, ...]:
    """An error: of the error ellipse if given, else of the sigmas of latitude and longitude; none of an empty one."""
    major, minor, orient = v["stdMajor"], v["stdMinor"], v["orient"]
    east, north, up = v["stdLong"], v["stdLat"], v["stdAlt"]
    if any(sigma < 0.0 for sigma in (major, minor, east, north, up)):
        raise FieldError("a standard deviation below zero")
    if not math.isnan(major + minor + orient):
        s, c = math.sin(math.radians(orient)), math.cos(math.radians(orient))
        a, b = major * major, minor * minor
        ee, en, nn = a * s * s + b * c * c, (a - b) * s * c, a * c * c + b * s * s
    elif not math.isnan(east + north):
        ee, en, nn = east * east, 0.0, north * north
    else:
        return ()
    stamp = by.timed(v["time"])
    covariance = frozen([[ee, en, 0.0], [en, nn, 0.0], [0.0, 0.0, up * up]])
    return (GnssError(stamp, "GST", covariance, v["time"]),)


def write_gst(parts: Parts) -> dict[str, Any]:
    """An error, as ellipse and as sigmas; the sentence has no place for covariances with height."""
    error = parts.need(GnssError)
    ee, en, nn = (float(error.covariance[i, j]) for i, j in ((0, 0), (0, 1), (1, 1)))
    mean, half = 0.5 * (ee + nn), math.hypot(0.5 * (nn - ee), en)
    if not mean >= half - 1e-12 * abs(mean):
        raise WireError("not a covariance", element="GST", value=[ee, en, nn])
    major = round(math.sqrt(mean + half), SIGMA_DIGITS)
    minor = round(math.sqrt(max(mean - half, 0.0)), SIGMA_DIGITS)
    orient = 0.0
    if major > minor:
        orient = round(math.degrees(0.5 * math.atan2(2.0 * en, nn - ee)) % 180.0, 6) % 180.0
    return {
        "time": parts.time_s,
        "stdMajor": major,
        "stdMinor": minor,
        "orient": orient,
        "stdLat": math.sqrt(nn),
        "stdLong": math.sqrt(ee),
        "stdAlt": float(np.sqrt(error.covariance[2, 2])),
    }


def read_zda(v: dict[str, Any], by: Reading) -> tuple[Measurement, ...]:
    """No measurement, but the date of what follows."""
    if None not in (v["day"], v["month"], v["year"]):
        by.timed(v["time"], day_of(v["year"], v["month"], v["day"]))
    return ()


def write_zda(parts: Parts) -> dict[str, Any]:
    """The date and time of any measurement with an epoch; `WireError` without one."""
    if parts.day is None:
        raise WireError("needs a measurement with an epoch", element="ZDA")
    parts.get(type(parts.first))
    day = date_of(parts.day)
    return {"time": parts.time_s, "day": day.day, "month": day.month, "year": day.year}


def read_hdt(v: dict[str, Any], by: Reading) -> tuple[Measurement, ...]:
    """A heading, NaN if there is none now; it has no time."""
    return (GnssHeading(by.stamp(), "HDT", course(v["headingT"])),)


def write_hdt(parts: Parts) -> dict[str, Any]:
    """A heading."""
    return {"headingT": course_degrees(parts.need(GnssHeading).heading, 5)}


def read_ths(v: dict[str, Any], by: Reading) -> tuple[Measurement, ...]:
    """A heading, NaN in mode `V`; it has no time."""
    quality = _THS.get(v["mi"] or "V")
    if quality is None:
        raise FieldError(v["mi"])
    heading = math.nan if quality is FixQuality.NONE else course(v["headt"])
    return (GnssHeading(by.stamp(), "THS", heading, quality=quality),)


def write_ths(parts: Parts) -> dict[str, Any]:
    """A heading; the sentence does not tell fixes apart, so every kind of fix is written `A`."""
    heading = parts.need(GnssHeading)
    return {"headt": course_degrees(heading.heading, 5), "mi": _THS_LETTERS.get(heading.quality, "A")}


def read_rot(v: dict[str, Any], by: Reading) -> tuple[Measurement, ...]:
    """A rate of turn: the sentence's degrees per minute to the right are negative here; NaN if not valid."""
    if v["valid"] not in ("A", "V", ""):
        raise FieldError(v["valid"])
    return (TurnRate(by.stamp(), "ROT", -v["rot"] * PER_MINUTE if v["valid"] == "A" else math.nan),)


def write_rot(parts: Parts) -> dict[str, Any]:
    """A rate of turn."""
    rate = parts.need(TurnRate).rate
    return {"rot": -rate / PER_MINUTE, "valid": "V" if math.isnan(rate) else "A"}


def read_avr(v: dict[str, Any], by: Reading) -> tuple[Measurement, ...]:
    """A baseline; of antennas across the machine the sentence gives roll, which is not taken for pitch."""
    quality = _AVR.get(v["gpsQual"] or 0, FixQuality.OTHER)
    none = quality is FixQuality.NONE
    return (
        GnssHeading(
            by.timed(v["utctime"], valid=not none),
            "PTNL,AVR",
            math.nan if none else course(v["yaw"]),
            v["utctime"],
            math.nan if none else math.radians(v["tilt"]),
            v["range"],
            quality=quality,
        ),
    )


def write_avr(parts: Parts) -> dict[str, Any]:
    """A baseline."""
    heading = parts.need(GnssHeading)
    return {
        "utctime": parts.time_s,
        "yaw": course_degrees(heading.heading, 5),
        "tilt": math.degrees(heading.pitch),
        "range": heading.baseline_m,
        "gpsQual": write_number(_AVR_NUMBERS, heading.quality, "PTNL,AVR"),
    }


def read_pashr(v: dict[str, Any], by: Reading) -> tuple[Measurement, ...]:
    """Heading and attitude: nose up and left side up are positive in the sentence.

    The baseline is taken to lie along the vehicle; its roll and pitch come as an inclination too, in our own signs
    (R = Rz Ry Rx, y to the left: nose up is a negative pitch).
    """
    stamp = by.timed(v["utctime"])
    number = v["gnssQual"]
    quality = FixQuality.OTHER if number is None else _PASHR.get(number, FixQuality.OTHER)
    roll, pitch = math.radians(v["roll"]), math.radians(v["pitch"])
    sigma = math.radians(max(v["rollAcc"], v["pitchAcc"]))
    return (
        GnssHeading(
            stamp,
            "PASHR",
            course(v["trueHdg"]),
            v["utctime"],
            pitch,
            sigma=math.radians(v["hdgAcc"]),
            quality=quality,
        ),
        Inclination(stamp, roll, -pitch, sigma),
    )


def write_pashr(parts: Parts) -> dict[str, Any]:
    """A heading, and an inclination if given; without one the heading's pitch is written and no roll."""
    heading, inclination = parts.need(GnssHeading), parts.get(Inclination)
    pitch, roll, sigma = heading.pitch, math.nan, math.nan
    if inclination is not None:
        pitch, roll, sigma = -inclination.pitch, inclination.roll, inclination.sigma
    known = heading.quality is not FixQuality.OTHER
    return {
        "utctime": parts.time_s,
        "trueHdg": course_degrees(heading.heading, 4),
        "roll": math.degrees(roll),
        "pitch": math.degrees(pitch),
        "rollAcc": math.degrees(sigma),
        "pitchAcc": math.degrees(sigma),
        "hdgAcc": math.degrees(heading.sigma),
        "gnssQual": write_number(_PASHR_NUMBERS, heading.quality, "PASHR") if known else None,
    }
