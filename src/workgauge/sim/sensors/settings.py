"""How simulated sensors behave: rates, protocols, noise. Everything else the machine's own file says."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from workgauge.sim.sensors.faults import Fault
from workgauge.values.navigation import FixQuality

Protocol = Literal["nmea", "ubx", "both"]

#: Rates whose periods are whole hundredths of a second, as NMEA writes its time [Hz].
RATES_HZ = (1, 2, 4, 5, 10, 20, 25, 50, 100)


@dataclass(frozen=True, slots=True)
class FixNoise:
    """Errors of a receiver's position and velocity.

    The error of each component is `sigma (sqrt(1 - c) white + sqrt(c (1 - m)) own + sqrt(c m) common)`: its variance
    is sigma^2 whatever the shares c and m are.

    Attributes:
        sigmas_m: by quality, (each horizontal component, height) [m], where the machine's file does not count.
        scale: multiplies all of them; 0 for no error.
        correlated: share c of the variance that changes slowly (Gauss-Markov).
        common: share m of that which is the same for all receivers, as errors of one base and one sky are.
        correlation_s: of the slow part.
        velocity_m_s: 1-sigma of each component of the velocity, white.
    """

    sigmas_m: Mapping[FixQuality, tuple[float, float]] = field(default_factory=dict)
    scale: float = 1.0
    correlated: float = 0.6
    common: float = 0.5
    correlation_s: float = 60.0
    velocity_m_s: float = 0.02


@dataclass(frozen=True, slots=True)
class ReceiverSettings:
    """One receiver.

    Attributes:
        rate_hz: epochs per second, one of `RATES_HZ`.
        protocol: what it writes, unless the machine's file tells its stream by talker.
        sentences, messages: of each epoch, in this order.
        quality: of its fix while no fault says otherwise.
        noise: of its fix.
        stated: what it states as its error over what the machine's file says of it; below 1 it flatters itself.
        jitter_s: mean of what its bytes arrive later than its latency, exponentially distributed.
        correction_age_s: of the differential correction.
        satellites, hdop: as sent.
    """

    rate_hz: int = 20
    protocol: Protocol = "nmea"
    sentences: tuple[str, ...] = ("RMC", "GGA", "GST")
    messages: tuple[str, ...] = ("NAV-PVT", "NAV-HPPOSLLH")
    quality: FixQuality = FixQuality.FIXED
    noise: FixNoise = field(default_factory=FixNoise)
    stated: float = 1.0
    jitter_s: float = 0.0
    correction_age_s: float = 1.0
    satellites: int = 18
    hdop: float = 0.7


@dataclass(frozen=True, slots=True)
class HeadingSettings:
    """The heading of a moving base, where the machine has one.

    Attributes:
        rate_hz, protocol, jitter_s: as a receiver's. sentences, messages: of each epoch.
        scale: multiplies the 1-sigma of the machine's file; 0 for no error.
        correlated, correlation_s: share of the variance that changes slowly, and how slowly.
    """

    rate_hz: int = 20
    protocol: Protocol = "nmea"
    sentences: tuple[str, ...] = ("PTNL,AVR",)
    messages: tuple[str, ...] = ("NAV-RELPOSNED",)
    scale: float = 1.0
    correlated: float = 0.6
    correlation_s: float = 60.0
    jitter_s: float = 0.0


@dataclass(frozen=True, slots=True)
class LinkSettings:
    """Inclinometers, encoders, wire encoders and gyros.

    Attributes:
        rate_hz: readings per second of each.
        scale: multiplies the 1-sigmas of the machine's file; 0 for no error. The errors are white.
        gyro_rad_s: 1-sigma of each axis of a gyro. gyros: whether IMUs send angular velocities.
        jitter_s: mean of the additional delay, exponentially distributed.
    """

    rate_hz: int = 100
    scale: float = 1.0
    gyro_rad_s: float = 0.002
    gyros: bool = True
    jitter_s: float = 0.0


@dataclass(frozen=True, slots=True)
class SensorSettings:
    """All of a machine's sensors.

    Attributes:
        receivers: of every receiver; `each` has those that differ, by name.
        heading, links: see there.
        geoid_separation_m: true ellipsoidal height less the site's height; None for the constant of the machine's
            file, or 17 m if that has none.
        faults: what goes wrong, and when.
    """

    receivers: ReceiverSettings = field(default_factory=ReceiverSettings)
    each: Mapping[str, ReceiverSettings] = field(default_factory=dict)
    heading: HeadingSettings = field(default_factory=HeadingSettings)
    links: LinkSettings = field(default_factory=LinkSettings)
    geoid_separation_m: float | None = None
    faults: tuple[Fault, ...] = ()
