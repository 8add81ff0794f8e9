"""What sensors say: satellite receivers, inclinometers, encoders; one frozen type per kind of measurement.

Angles are radians. Headings and courses are clockwise from **true** north as receivers give them; turning them into
grid headings is `geodesy`'s work. A number the sender left out is NaN, never zero.
"""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import TypeAlias

from workgauge.values.arrays import Floats
from workgauge.values.measurements import Stamp


class FixQuality(IntEnum):
    """Quality of a satellite fix, numbered as in the NMEA GGA sentence."""

    NONE = 0
    SINGLE = 1
    DIFFERENTIAL = 2
    PPS = 3
    FIXED = 4  #: RTK, ambiguities fixed
    FLOAT = 5  #: RTK, ambiguities not fixed
    DEAD_RECKONING = 6
    MANUAL = 7
    SIMULATED = 8
    OTHER = 9  #: whatever the maker of the receiver means by a number beyond the standard


@dataclass(frozen=True, slots=True, eq=False)
class GnssFix:
    """Where an antenna is.

    Attributes:
        stamp: `source` names the stream and the receiver in it; `epoch_ns` is UTC since 1970 if the date is known.
        sentence: the message it came in (`GGA`, `NAV-PVT`, `PTNL,GGK`).
        time_of_day_s: UTC, seconds since midnight.
        latitude, longitude: [rad], NaN without a fix.
        height_ellipsoid_m, height_msl_m, geoid_separation_m: ellipsoidal = msl + separation, where given.
        quality, satellites, hdop: as sent. correction_age_s: of the differential correction.
        covariance: (3, 3) of east, north, up [m^2], or None if the message says nothing of it.
    """

    stamp: Stamp
    sentence: str
    latitude: float
    longitude: float
    time_of_day_s: float = math.nan
    height_ellipsoid_m: float = math.nan
    height_msl_m: float = math.nan
    geoid_separation_m: float = math.nan
    quality: FixQuality = FixQuality.NONE
    satellites: int | None = None
    hdop: float = math.nan
    correction_age_s: float = math.nan
    covariance: Floats | None = None


@dataclass(frozen=True, slots=True, eq=False)
class GnssGridFix:
    """Where an antenna is, already in the receiver's own projection (PTNL,PJK): metres as the receiver has them.

    `height_m` is over the ellipsoid, or over the receiver's geoid if `orthometric`.
    """

    stamp: Stamp
    sentence: str
    easting_m: float
    northing_m: float
    time_of_day_s: float = math.nan
    height_m: float = math.nan
    quality: FixQuality = FixQuality.NONE
    satellites: int | None = None
    orthometric: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class GnssError:
    """A receiver's own statement of its error for the fix of the same time (GST, NAV-COV)."""

    stamp: Stamp
    sentence: str
    covariance: Floats  #: (3, 3) of east, north, up [m^2]
    time_of_day_s: float = math.nan


@dataclass(frozen=True, slots=True, eq=False)
class GnssVelocity:
    """Velocity of an antenna over ground: speed [m/s], course [rad], climb [m/s]; sigma of each component [m/s]."""

    stamp: Stamp
    sentence: str
    speed_m_s: float
    course: float
    time_of_day_s: float = math.nan
    climb_m_s: float = math.nan
    sigma_m_s: float = math.nan


@dataclass(frozen=True, slots=True, eq=False)
class GnssHeading:
    """True heading of a baseline from the master antenna to the other one, or of a compass.

    Attributes:
        heading: clockwise from true north [rad]; NaN if there is none now.
        pitch: inclination of the baseline, up positive [rad]. baseline_m: its measured length.
        sigma: of the heading [rad]. quality: of the baseline, OTHER for a sentence that does not say.
    """

    stamp: Stamp
    sentence: str
    heading: float
    time_of_day_s: float = math.nan
    pitch: float = math.nan
    baseline_m: float = math.nan
    sigma: float = math.nan
    quality: FixQuality = FixQuality.OTHER


@dataclass(frozen=True, slots=True, eq=False)
class TurnRate:
    """Rate of turn about the vertical, positive to the left [rad/s]."""

    stamp: Stamp
    sentence: str
    rate: float


@dataclass(frozen=True, slots=True, eq=False)
class Inclination:
    """An inclinometer: its own frame's roll and pitch against gravity, R = Rz(anything) Ry(pitch) Rx(roll) [rad].

    x forward, y left, z up of the sensor; `stamp.source` names the sensor of the machine description.
    """

    stamp: Stamp
    roll: float
    pitch: float
    sigma: float = math.nan


@dataclass(frozen=True, slots=True, eq=False)
class EncoderReading:
    """A raw encoder value in its own unit: a joint encoder's angle [rad] or a wire encoder's stroke [m]."""

    stamp: Stamp
    value: float
    sigma: float = math.nan


@dataclass(frozen=True, slots=True, eq=False)
class AngularRate:
    """Angular velocity of a sensor's frame in its own axes, (3,) [rad/s]."""

    stamp: Stamp
    rate: Floats
    sigma: float = math.nan


GnssMeasurement: TypeAlias = GnssFix | GnssGridFix | GnssError | GnssVelocity | GnssHeading | TurnRate
LinkMeasurement: TypeAlias = Inclination | EncoderReading | AngularRate
Measurement: TypeAlias = GnssMeasurement | LinkMeasurement
