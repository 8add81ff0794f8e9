"""A simulated satellite receiver: the error of its fix, what it says of itself, and the bytes of each epoch."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from workgauge.machine.positioning import FixSigmas, ReceiverSpec
from workgauge.sim.sensors.faults import Fault, FaultKind, lowered, one
from workgauge.sim.sensors.line import Line, Wiring
from workgauge.sim.sensors.randomness import GaussMarkov, White, generator
from workgauge.sim.sensors.settings import Protocol, ReceiverSettings
from workgauge.values.arrays import Floats, frozen
from workgauge.values.measurements import Stamp
from workgauge.values.navigation import FixQuality, GnssError, GnssFix, GnssMeasurement, GnssVelocity
from workgauge.wire.nmea import nmea_bytes
from workgauge.wire.ubx import ubx_bytes

DAY_NS = 86_400 * 10**9

#: Below this speed a receiver gives no course [m/s].
COURSE_ABOVE_M_S = 0.1

#: What talkers are called in NMEA if the machine's file does not say.
TALKER = "GN"

#: The measurements each message is made of.
_CONTENT: Mapping[str, tuple[str, ...]] = {
    "GGA": ("fix",),
    "GLL": ("fix",),
    "RMC": ("fix", "velocity"),
    "VTG": ("velocity",),
    "GST": ("error",),
    "ZDA": ("fix",),
    "PTNL,GGK": ("fix",),
    "NAV-PVT": ("fix", "velocity", "error"),
    "NAV-HPPOSLLH": ("fix",),
    "NAV-COV": ("error",),
}


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """What a receiver has found at an epoch.

    Attributes:
        latitude, longitude: [rad]. height_m: above mean sea level. separation_m: ellipsoidal = height + separation.
        velocity: (3,) east, north, up of true north [m/s].
        quality: of the fix. covariance: (3, 3) as the receiver states it [m^2]. velocity_sigma_m_s: likewise.
        correction_age_s: NaN without corrections.
    """

    latitude: float
    longitude: float
    height_m: float
    separation_m: float
    velocity: Floats
    quality: FixQuality
    covariance: Floats
    velocity_sigma_m_s: float
    correction_age_s: float


class Receiver:
    """One receiver and its line.

    Args:
        spec: of the machine's file. settings: how it behaves.
        line: where its bytes go. wiring: shared with all sensors.
        protocol, talker: what it writes.
    """

    def __init__(
        self,
        spec: ReceiverSpec,
        settings: ReceiverSettings,
        line: Line,
        wiring: Wiring,
        *,
        protocol: Protocol,
        talker: str,
    ) -> None:
        self.spec = spec
        self.settings = settings
        self.line = line
        self._machine_id = wiring.machine_id
        self._protocol = protocol
        self._talker = talker
        name, seed = line.identity.name, wiring.seed
        noise = settings.noise
        self._sigmas = {**sigmas_of(spec.sigmas), **noise.sigmas_m}
        self._white = White(generator(seed, "receiver", name, "white"), 3)
        self._velocity = White(generator(seed, "receiver", name, "velocity"), 3)
        self._own = GaussMarkov(generator(seed, "receiver", name, "own"), noise.correlation_s, wiring.origin_ns)
        self._last: Solution | None = None

    def quality(self, active: tuple[Fault, ...]) -> FixQuality:
        """Return the quality of its fix now."""
        return lowered(self.settings.quality, active)

    def position_error(self, t_ns: int, active: tuple[Fault, ...], common: Floats) -> Floats:
        """Return the error (3,) of its position at an epoch, in the grid's axes [m]; draws one epoch's noise.

        Args:
            t_ns: the epoch. active: faults then. common: (3,) what all receivers share, of unit variance.
        """
        noise = self.settings.noise
        unit = math.sqrt(1.0 - noise.correlated) * self._white.draw()
        unit = unit + math.sqrt(noise.correlated * (1.0 - noise.common)) * self._own.at(t_ns)
        unit = unit + math.sqrt(noise.correlated * noise.common) * common
        error = unit * self._sigma(self.quality(active)) * noise.scale
        for fault in active:
            if fault.kind is FaultKind.JUMP:
                share = min(fault.since_s(t_ns) / fault.ramp_s, 1.0) if fault.ramp_s > 0.0 else 1.0
                error = error + share * np.array(fault.offset_m)
            elif fault.kind is FaultKind.FOREIGN_RECEIVER and self.line.identity.group == "foreign":
                error = error + np.array(fault.offset_m)
        return np.asarray(error, dtype=np.float64)

    def velocity_error(self) -> Floats:
        """Return the error (3,) of its velocity [m/s]; draws one epoch's noise."""
        noise = self.settings.noise
        return self._velocity.draw() * (noise.velocity_m_s if noise.scale > 0.0 else 0.0)

    def solution(
        self,
        t_ns: int,
        place: tuple[float, float, float, float],
        velocity: Floats,
        active: tuple[Fault, ...],
    ) -> Solution:
        """Return what it finds: at (latitude, longitude [rad], height, separation [m]), with this velocity (3,)."""
        quality = self.quality(active)
        age_s = self.settings.correction_age_s
        for fault in active:
            if fault.kind is FaultKind.CORRECTION_AGE:
                age_s += fault.since_s(t_ns)
        corrected = quality in (FixQuality.FIXED, FixQuality.FLOAT, FixQuality.DIFFERENTIAL)
        stated = np.diag((self._sigma(quality) * self.settings.stated) ** 2)
        found = Solution(
            *place,
            velocity,
            quality,
            frozen(stated),
            self.settings.noise.velocity_m_s,
            age_s if corrected else math.nan,
        )
        stuck = one(active, FaultKind.FROZEN)
        if stuck is not None and self._last is not None:
            found = self._last
        self._last = found
        return found

    def send(self, t_ns: int, utc_ns: int, found: Solution, active: tuple[Fault, ...]) -> None:
        """Write the bytes of an epoch whose time is `utc_ns` since 1970."""
        for fault in active:
            if fault.kind is FaultKind.CLOCK_STEP:
                utc_ns += round(fault.step_s * 1e9)
        content = measurements(found, Stamp(self._machine_id, t_ns, self.spec.name, utc_ns), self.settings)
        data = bytearray()
        if self._protocol in ("nmea", "both"):
            for sentence in self.settings.sentences:
                if chosen := _chosen(content, sentence):
                    data += nmea_bytes(chosen, sentence=sentence, talker=self._talker)
        if self._protocol in ("ubx", "both"):
            for message in self.settings.messages:
                if chosen := _chosen(content, message):
                    data += ubx_bytes(chosen, message=message)
        self.line.send(t_ns, bytes(data), active)

    def _sigma(self, quality: FixQuality) -> Floats:
        """Return the 1-sigma (3,) of a quality, east, north, up [m]; that of a single fix if there is none."""
        level, height = self._sigmas.get(quality) or self._sigmas[FixQuality.SINGLE]
        return np.array([level, level, height])


def sigmas_of(file: FixSigmas) -> dict[FixQuality, tuple[float, float]]:
    """Return the 1-sigmas of a machine's file by quality."""
    known = (FixQuality.FIXED, FixQuality.FLOAT, FixQuality.DIFFERENTIAL, FixQuality.SINGLE)
    return {quality: file.of(quality) for quality in known}


def measurements(found: Solution, stamp: Stamp, settings: ReceiverSettings) -> dict[str, GnssMeasurement]:
    """Return fix, velocity and error of a solution; without a fix, a fix that has nothing but its time."""
    assert stamp.epoch_ns is not None, "a receiver knows its time"
    time_s = stamp.epoch_ns % DAY_NS * 1e-9
    if found.quality is FixQuality.NONE:
        fix = GnssFix(stamp, "", math.nan, math.nan, time_s)
        return {"fix": fix, "velocity": GnssVelocity(stamp, "", math.nan, math.nan, time_s)}
    east, north, up = found.velocity.tolist()
    speed = math.hypot(east, north)
    course = math.atan2(east, north) % (2 * math.pi) if speed > COURSE_ABOVE_M_S else math.nan
    return {
        "fix": GnssFix(
            stamp,
            "",
            found.latitude,
            found.longitude,
            time_s,
            height_ellipsoid_m=found.height_m + found.separation_m,
            height_msl_m=found.height_m,
            geoid_separation_m=found.separation_m,
            quality=found.quality,
            satellites=settings.satellites,
            hdop=settings.hdop,
            correction_age_s=found.correction_age_s,
            covariance=found.covariance,
        ),
        "velocity": GnssVelocity(stamp, "", speed, course, time_s, up, found.velocity_sigma_m_s),
        "error": GnssError(stamp, "", found.covariance, time_s),
    }


def _chosen(content: Mapping[str, GnssMeasurement], message: str) -> tuple[GnssMeasurement, ...]:
    """Return what a message is made of; nothing if what it is about is missing."""
    wanted = _CONTENT[message]
    if wanted[0] not in content:
        return ()
    return tuple(content[key] for key in wanted if key in content)
