"""The one table of NMEA sentences: a sentence's name, its fields, how it is read and how it is written."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from workgauge.values.navigation import Measurement
from workgauge.wire import nmea_motion as motion
from workgauge.wire import nmea_positions as positions
from workgauge.wire.nmea_fields import (
    DATE,
    DATE_MONTH_FIRST,
    HEIGHT,
    LATITUDE,
    LONGITUDE,
    TEXT,
    TIME,
    Codec,
    Layout,
    decimal,
    whole,
)
from workgauge.wire.parts import Parts, Reading


@dataclass(frozen=True, slots=True)
class Sentence:
    """One row: the fields and both directions. `proprietary`: the name stands for talker and formatter."""

    name: str
    layout: Layout
    read: Callable[[dict[str, Any], Reading], tuple[Measurement, ...]]
    write: Callable[[Parts], dict[str, Any]]
    proprietary: bool = False


_PLACE: Mapping[str, Codec] = {"lat": LATITUDE, "NS": TEXT, "lon": LONGITUDE, "EW": TEXT}
_TRIMBLE_FIX: Mapping[str, Codec] = {
    "utctime": TIME,
    "utcdate": DATE_MONTH_FIRST,
    "gpsQual": whole(),
    "sip": whole(2),
    "height": HEIGHT,
}

ROWS = (
    Sentence(
        "GGA",
        Layout(
            "GGA",
            {
                "time": TIME,
                **_PLACE,
                "quality": whole(),
                "numSV": whole(2),
                "HDOP": decimal(2),
                "alt": decimal(4),
                "sep": decimal(4),
                "diffAge": decimal(1),
            },
            6,
            {"altUnit": "M", "sepUnit": "M"},
        ),
        positions.read_gga,
        positions.write_gga,
    ),
    Sentence(
        "GLL",
        Layout("GLL", {**_PLACE, "time": TIME, "status": TEXT, "posMode": TEXT}, 6),
        positions.read_gll,
        positions.write_gll,
    ),
    Sentence(
        "RMC",
        Layout(
            "RMC",
            {
                "time": TIME,
                "status": TEXT,
                **_PLACE,
                "spd": decimal(4),
                "cog": decimal(4),
                "date": DATE,
                "posMode": TEXT,
            },
            9,
            {"navStatus": "V"},  # not a receiver that judges its own integrity
        ),
        positions.read_rmc,
        positions.write_rmc,
    ),
    Sentence(
        "VTG",
        Layout(
            "VTG",
            {"cogt": decimal(4), "sogn": decimal(4), "sogk": decimal(4), "posMode": TEXT},
            8,
            {"cogtUnit": "T", "cogmUnit": "M", "sognUnit": "N", "sogkUnit": "K"},
        ),
        motion.read_vtg,
        motion.write_vtg,
    ),
    Sentence(
        "GST",
        Layout(
            "GST",
            {
                "time": TIME,
                "stdMajor": decimal(motion.SIGMA_DIGITS),
                "stdMinor": decimal(motion.SIGMA_DIGITS),
                "orient": decimal(6),
                "stdLat": decimal(motion.SIGMA_DIGITS),
                "stdLong": decimal(motion.SIGMA_DIGITS),
                "stdAlt": decimal(motion.SIGMA_DIGITS),
            },
            8,
        ),
        motion.read_gst,
        motion.write_gst,
    ),
    Sentence(
        "ZDA",
        Layout(
            "ZDA",
            {"time": TIME, "day": whole(2), "month": whole(2), "year": whole(4)},
            4,
            {"ltzh": "00", "ltzn": "00"},
        ),
        motion.read_zda,
        motion.write_zda,
    ),
    Sentence(
        "HDT", Layout("HDT", {"headingT": decimal(5)}, 1, {"headingTu": "T"}), motion.read_hdt, motion.write_hdt
    ),
    Sentence("THS", Layout("THS", {"headt": decimal(5), "mi": TEXT}, 2), motion.read_ths, motion.write_ths),
    Sentence("ROT", Layout("ROT", {"rot": decimal(4), "valid": TEXT}, 2), motion.read_rot, motion.write_rot),
    Sentence(
        "PTNL,AVR",
        Layout(
            "TNLAVR",
            {
                "utctime": TIME,
                "yaw": decimal(5, sign="+"),
                "tilt": decimal(5, sign="+"),
                "range": decimal(4),
                "gpsQual": whole(),
            },
            9,
            {"msgId": "AVR", "yawc": "Yaw", "tiltc": "Tilt"},
        ),
        motion.read_avr,
        motion.write_avr,
        True,
    ),
    Sentence(
        "PTNL,GGK",
        Layout("TNLGGK", {**_TRIMBLE_FIX, **_PLACE}, 8, {"msgId": "GGK", "hunit": "M"}),
        positions.read_ggk,
        positions.write_ggk,
        True,
    ),
    Sentence(
        "PTNL,PJK",
        Layout(
            "TNLPJK",
            {**_TRIMBLE_FIX, "northing": decimal(4, sign="+"), "easting": decimal(4, sign="+")},
            8,
            {"msgId": "PJK", "nunit": "N", "eunit": "E", "hunit": "M"},
        ),
        positions.read_pjk,
        positions.write_pjk,
        True,
    ),
    Sentence(
        "PASHR",
        Layout(
            "ASHR",
            {
                "utctime": TIME,
                "trueHdg": decimal(4),
                "roll": decimal(4, sign="+"),
                "pitch": decimal(4, sign="+"),
                "rollAcc": decimal(4),
                "pitchAcc": decimal(4),
                "hdgAcc": decimal(4),
                "gnssQual": whole(),
            },
            5,
            {"trueHdgInd": "T"},
        ),
        motion.read_pashr,
        motion.write_pashr,
        True,
    ),
    Sentence(
        "PASHR,POS",
        Layout(
            "ASHRPOS",
            {
                "solnType": whole(),
                "sip": whole(2),
                "utctime": TIME,
                **_PLACE,
                "alt": decimal(4, sign="+"),
                "corrAge": decimal(1),
                "trueTrk": decimal(4),
                "sog": decimal(4),
                "vertVel": decimal(4, sign="+"),
                "HDOP": decimal(2),
            },
            9,
            {"msgId": "POS"},
        ),
        positions.read_pos,
        positions.write_pos,
        True,
    ),
)

SENTENCES: Mapping[str, Sentence] = {row.name: row for row in ROWS}
