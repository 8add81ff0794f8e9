"""The one table of UBX messages: NAV-PVT, NAV-HPPOSLLH, NAV-RELPOSNED and NAV-COV, read and written.

u-blox states one horizontal accuracy; each of east and north gets all of it, so neither is ever stated too small.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import WireError
from workgauge.values.navigation import FixQuality, GnssError, GnssFix, GnssHeading, GnssVelocity, Measurement
from workgauge.wire.epochs import DAY_NS, gps_time_of_week, time_of_day
from workgauge.wire.nmea_fields import FieldError, date_of, day_of
from workgauge.wire.parts import Parts, Reading, latitude_longitude
from workgauge.wire.ubx_fields import Payload

_Q = FixQuality
_NO_FIX, _DEAD_RECKONING, _2D, _3D, _GNSS_AND_DR, _TIME_ONLY = range(6)
_PVT_QUALITIES = (_Q.NONE, _Q.SINGLE, _Q.DIFFERENTIAL, _Q.FLOAT, _Q.FIXED, _Q.DEAD_RECKONING)
_CARRIERS = {_Q.FLOAT: 1, _Q.FIXED: 2}
#: Upper ends of NAV-PVT's classes of correction age [s]; the last one is open, and stands for twice its beginning.
_AGES = (math.nan, 1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 90.0, 120.0, 240.0)
_NED_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True, slots=True)
class UbxMessage:
    """One row: class and id, payload and both directions."""

    name: str
    number: tuple[int, int]
    payload: Payload
    read: Callable[[dict[str, Any], Reading], tuple[Measurement, ...]]
    write: Callable[[Parts], dict[str, float]]


def _accuracy(horizontal_mm: float, vertical_mm: float) -> Floats:
    h, v = horizontal_mm * 1e-3, vertical_mm * 1e-3
    return frozen(np.diag([h * h, h * h, v * v]))


def _accuracies_mm(covariance: Floats | None) -> tuple[float, float]:
    """Return horizontal and vertical accuracy [mm] of a covariance: the larger of east and north."""
    if covariance is None:
        return math.nan, math.nan
    variances = np.diag(covariance)
    return 1e3 * math.sqrt(max(variances[0], variances[1])), 1e3 * math.sqrt(variances[2])


def _position(v: Mapping[str, Any], quality: FixQuality) -> tuple[float, float]:
    """Return latitude and longitude [rad], NaN without a fix; `FieldError` beyond the globe."""
    if quality is FixQuality.NONE:
        return math.nan, math.nan
    if abs(v["lat"]) > 90.0 or abs(v["lon"]) > 180.0:
        raise FieldError(f"{v['lat']}, {v['lon']}")
    return math.radians(v["lat"]), math.radians(v["lon"])


def _fix_quality(v: Mapping[str, Any]) -> FixQuality:
    kind = v["fixType"]
    if not v["gnssFixOk"] or v["invalidLlh"] or kind not in (_DEAD_RECKONING, _2D, _3D, _GNSS_AND_DR):
        return FixQuality.NONE
    if kind == _DEAD_RECKONING:
        return FixQuality.DEAD_RECKONING
    if v["carrSoln"] in (1, 2):
        return FixQuality.FIXED if v["carrSoln"] == 2 else FixQuality.FLOAT
    return FixQuality.DIFFERENTIAL if v["diffSoln"] else FixQuality.SINGLE


def _pvt_epoch(v: Mapping[str, Any], by: Reading) -> int | None:
    """Return the epoch; the date, with the week, is remembered. None where the receiver is not sure of its time."""
    if not (v["validDate"] and v["validTime"]):
        return None
    day = day_of(int(v["year"]), int(v["month"]), int(v["day"]))
    if v["hour"] > 23 or v["min"] > 59 or v["second"] > 60:
        raise FieldError("time")
    seconds = int(3600 * v["hour"] + 60 * v["min"] + v["second"])
    epoch_ns = day * DAY_NS + seconds * 1_000_000_000 + int(v["nano"])
    return by.epochs.gps_dated(by.source, int(v["iTOW"]), epoch_ns, by.received_ns)


def read_pvt(v: dict[str, Any], by: Reading) -> tuple[Measurement, ...]:
    """A fix with its covariance, and a velocity."""
    quality = _fix_quality(v)
    none = quality is FixQuality.NONE
    place = _position(v, quality)
    by.epochs.remember_quality(by.source, int(v["iTOW"]), quality)
    stamp = by.stamp(_pvt_epoch(v, by))
    time_s = time_of_day(stamp.epoch_ns)
    above, ellipsoid = v["hMSL"] * 1e-3, v["height"] * 1e-3
    return (
        GnssFix(
            stamp,
            "NAV-PVT",
            *place,
            time_s,
            math.nan if none else ellipsoid,
            math.nan if none else above,
            math.nan if none else (v["height"] - v["hMSL"]) * 1e-3,
            quality,
            int(v["numSV"]),
            correction_age_s=_AGES[min(v["lastCorrectionAge"], len(_AGES) - 1)],
            covariance=None if none else _accuracy(v["hAcc"], v["vAcc"]),
        ),
        GnssVelocity(
            stamp,
            "NAV-PVT",
            math.nan if none else v["gSpeed"] * 1e-3,
            math.nan if none else math.radians(v["headMot"] % 360.0),
            time_s,
            math.nan if none else -v["velD"] * 1e-3,
            math.nan if none else v["sAcc"] * 1e-3,
        ),
    )


def write_pvt(parts: Parts) -> dict[str, float]:
    """A fix, and a velocity if given; an error if given counts for the fix that has no covariance of its own."""
    fix, velocity, error = parts.need(GnssFix), parts.get(GnssVelocity), parts.get(GnssError)
    if fix.quality not in _PVT_QUALITIES:
        raise WireError("the message has no number for this quality", element="NAV-PVT", value=fix.quality.name)
    none = fix.quality is FixQuality.NONE
    kind = _DEAD_RECKONING if fix.quality is _Q.DEAD_RECKONING else _3D
    return {
        **_time(parts),
        "fixType": _NO_FIX if none else kind,
        "gnssFixOk": not none,
        "diffSoln": fix.quality in (_Q.DIFFERENTIAL, _Q.FLOAT, _Q.FIXED),
        "carrSoln": _CARRIERS.get(fix.quality, 0),
        "invalidLlh": none,
        "numSV": fix.satellites or 0,
        **_place_values(fix, error),
        "lastCorrectionAge": _age_class(fix.correction_age_s),
        **_velocity_values(velocity),
    }


def _velocity_values(velocity: GnssVelocity | None) -> dict[str, float]:
    if velocity is None or math.isnan(velocity.speed_m_s):
        return {}
    speed = velocity.speed_m_s * 1e3
    course = 0.0 if math.isnan(velocity.course) else velocity.course
    return {
        "velN": speed * math.cos(course),
        "velE": speed * math.sin(course),
        "velD": -velocity.climb_m_s * 1e3,
        "gSpeed": speed,
        "headMot": math.degrees(course) % 360.0,
        "sAcc": velocity.sigma_m_s * 1e3,
    }


def _age_class(age_s: float) -> int:
    """Return NAV-PVT's class of a correction age [s], 0 if not known."""
    if math.isnan(age_s):
        return 0
    return next((k for k, upper in enumerate(_AGES) if age_s <= upper), len(_AGES) - 1)


def _place_values(fix: GnssFix, error: GnssError | None) -> dict[str, float]:
    """Return position, heights and accuracies; one height and the separation give the other."""
    latitude, longitude = latitude_longitude(fix)
    ellipsoid, above = fix.height_ellipsoid_m, fix.height_msl_m
    if math.isnan(ellipsoid):
        ellipsoid = above + fix.geoid_separation_m
    if math.isnan(above):
        above = ellipsoid - fix.geoid_separation_m
    h_mm, v_mm = _accuracies_mm(error.covariance if fix.covariance is None and error is not None else fix.covariance)
    heights = {"height": ellipsoid * 1e3, "hMSL": above * 1e3}
    return {"lat": latitude, "lon": longitude, **heights, "hAcc": h_mm, "vAcc": v_mm}


def _time(parts: Parts) -> dict[str, float]:
    epoch_ns = parts.first.stamp.epoch_ns
    if epoch_ns is None:
        return {}
    epoch_ns = (epoch_ns + 500_000) // 1_000_000 * 1_000_000
    day, (seconds, rest) = date_of(epoch_ns // DAY_NS), divmod(epoch_ns % DAY_NS, 1_000_000_000)
    return {
        "iTOW": gps_time_of_week(epoch_ns),
        "year": day.year,
        "month": day.month,
        "day": day.day,
        "hour": seconds // 3600,
        "min": seconds // 60 % 60,
        "second": seconds % 60,
        "nano": rest,
        "validDate": 1,
        "validTime": 1,
        "fullyResolved": 1,
    }


def _week_only(parts: Parts, name: str) -> dict[str, float]:
    epoch_ns = parts.first.stamp.epoch_ns
    if epoch_ns is None:
        raise WireError("needs a measurement with an epoch", element=name)
    return {"iTOW": gps_time_of_week(epoch_ns)}


def read_hpposllh(v: dict[str, Any], by: Reading) -> tuple[Measurement, ...]:
    """A fix with its covariance; its quality is the NAV-PVT's of the same epoch, or OTHER where none came before."""
    itow = int(v["iTOW"])
    quality = FixQuality.NONE if v["invalidLlh"] else by.epochs.quality_at(by.source, itow)
    none = quality is FixQuality.NONE
    stamp = by.stamp(by.epochs.gps_at(by.source, itow))
    return (
        GnssFix(
            stamp,
            "NAV-HPPOSLLH",
            *_position(v, quality),
            time_of_day(stamp.epoch_ns),
            math.nan if none else v["height"] * 1e-3,
            math.nan if none else v["hMSL"] * 1e-3,
            math.nan if none else (v["height"] - v["hMSL"]) * 1e-3,
            quality,
            covariance=None if none else _accuracy(v["hAcc"], v["vAcc"]),
        ),
    )


def write_hpposllh(parts: Parts) -> dict[str, float]:
    """A fix; an error if given counts for the fix that has no covariance of its own."""
    fix, error = parts.need(GnssFix), parts.get(GnssError)
    return {
        **_week_only(parts, "NAV-HPPOSLLH"),
        **_place_values(fix, error),
        "invalidLlh": fix.quality is FixQuality.NONE,
    }


def read_relposned(v: dict[str, Any], by: Reading) -> tuple[Measurement, ...]:
    """A baseline; without a valid heading, or from a base that stands still, it has no heading and quality NONE."""
    valid = v["gnssFixOK"] and v["relPosValid"] and v["relPosHeadingValid"] and v["isMoving"]
    quality = FixQuality.NONE
    if valid:
        quality = {1: _Q.FLOAT, 2: _Q.FIXED}.get(v["carrSoln"], _Q.DIFFERENTIAL)
    level = math.hypot(v["relPosN"], v["relPosE"])
    stamp = by.stamp(by.epochs.gps_at(by.source, int(v["iTOW"])))
    return (
        GnssHeading(
            stamp,
            "NAV-RELPOSNED",
            math.radians(v["relPosHeading"] % 360.0) if valid else math.nan,
            time_of_day(stamp.epoch_ns),
            math.atan2(-v["relPosD"], level) if valid and level > 0.0 else math.nan,
            v["relPosLength"] * 1e-2 if valid and not v["relPosNormalized"] else math.nan,
            math.radians(v["accHeading"]) if valid and v["accHeading"] else math.nan,
            quality,
        ),
    )


def write_relposned(parts: Parts) -> dict[str, float]:
    """A baseline of a moving base; without its length, a normalised one of 1 m."""
    heading = parts.need(GnssHeading)
    valid = not math.isnan(heading.heading) and heading.quality is not FixQuality.NONE
    known = not math.isnan(heading.baseline_m)
    length_cm = 100.0 * (heading.baseline_m if known else 1.0) if valid else 0.0
    pitch = 0.0 if math.isnan(heading.pitch) else heading.pitch
    along = length_cm * math.cos(pitch)
    return {
        **_week_only(parts, "NAV-RELPOSNED"),
        "version": 1,
        "relPosN": along * math.cos(heading.heading) if valid else 0.0,
        "relPosE": along * math.sin(heading.heading) if valid else 0.0,
        "relPosD": -length_cm * math.sin(pitch),
        "relPosLength": length_cm,
        "relPosHeading": round(math.degrees(heading.heading) % 360.0, 5) % 360.0,
        "accHeading": math.degrees(heading.sigma),
        "gnssFixOK": valid,
        "diffSoln": valid,
        "relPosValid": valid,
        "relPosHeadingValid": valid,
        "isMoving": 1,
        "carrSoln": _CARRIERS.get(heading.quality, 0),
        "relPosNormalized": valid and not known,
    }


def read_cov(v: dict[str, Any], by: Reading) -> tuple[Measurement, ...]:
    """An error, none if it is not valid."""
    if not v["posCovValid"]:
        return ()
    nn, ne, nd = v["posCovNN"], v["posCovNE"], v["posCovND"]
    ee, ed, dd = v["posCovEE"], v["posCovED"], v["posCovDD"]
    if not all(map(math.isfinite, (nn, ne, nd, ee, ed, dd))) or min(nn, ee, dd) < 0.0:
        raise FieldError("not a covariance")
    covariance = frozen([[ee, ne, -ed], [ne, nn, -nd], [-ed, -nd, dd]])
    stamp = by.stamp(by.epochs.gps_at(by.source, int(v["iTOW"])))
    return (GnssError(stamp, "NAV-COV", covariance, time_of_day(stamp.epoch_ns)),)


def write_cov(parts: Parts) -> dict[str, float]:
    """An error."""
    error = parts.need(GnssError)
    ned = (_NED_ENU @ error.covariance @ _NED_ENU.T).astype(np.float32) + 0.0  # no negative zeros
    place = {f"posCov{'NED'[i]}{'NED'[j]}": float(ned[i, j]) for i in range(3) for j in range(i, 3)}
    return {**_week_only(parts, "NAV-COV"), "posCovValid": 1, **place}


_DATE = ("iTOW", "year", "month", "day", "hour", "min", "second", "validDate", "validTime", "fullyResolved", "nano")
_PLACE = ("lat", "lon", "height", "hMSL", "hAcc", "vAcc", "invalidLlh")

MESSAGES: Mapping[str, UbxMessage] = {
    row.name: row
    for row in (
        UbxMessage(
            "NAV-PVT",
            (0x01, 0x07),
            Payload(
                "NAV-PVT",
                (
                    *_DATE,
                    *_PLACE,
                    *("fixType", "gnssFixOk", "diffSoln", "carrSoln", "numSV", "lastCorrectionAge"),
                    *("velN", "velE", "velD", "gSpeed", "headMot", "sAcc"),
                ),
            ),
            read_pvt,
            write_pvt,
        ),
        UbxMessage(
            "NAV-HPPOSLLH",
            (0x01, 0x14),
            Payload("NAV-HPPOSLLH", ("version", "iTOW", *_PLACE)),
            read_hpposllh,
            write_hpposllh,
        ),
        UbxMessage(
            "NAV-RELPOSNED",
            (0x01, 0x3C),
            Payload(
                "NAV-RELPOSNED",
                (
                    *("version", "iTOW", "relPosN", "relPosE", "relPosD", "relPosLength", "relPosHeading"),
                    *("accHeading", "gnssFixOK", "diffSoln", "relPosValid", "carrSoln", "isMoving"),
                    *("relPosHeadingValid", "relPosNormalized"),
                ),
            ),
            read_relposned,
            write_relposned,
        ),
        UbxMessage(
            "NAV-COV",
            (0x01, 0x36),
            Payload(
                "NAV-COV",
                (
                    *("iTOW", "version", "posCovValid"),
                    *(f"posCov{pair}" for pair in ("NN", "NE", "ND", "EE", "ED", "DD")),
                ),
            ),
            read_cov,
            write_cov,
        ),
    )
}
