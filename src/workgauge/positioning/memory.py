"""What the locator remembers from tick to tick, all of it frozen and made of plain values and read-only arrays."""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from workgauge.positioning.evidence import HealthMemory
from workgauge.positioning.innovation import Candidate
from workgauge.positioning.motion import Motion, Past
from workgauge.positioning.timing import Clock, Heard, Sample, TimedHeading
from workgauge.values.arrays import Floats
from workgauge.values.health import PositionHealth
from workgauge.values.measurements import MachinePose, Posture
from workgauge.values.navigation import AngularRate, FixQuality


@dataclass(frozen=True, slots=True, eq=False)
class GridFix:
    """One antenna's fix in the site's coordinates.

    Attributes:
        receiver, antenna: names in the machine file. epoch_ns: UTC since 1970, None if not said.
        position: (3,) absolute east, north, height [m]. covariance: (3, 3) as used [m^2]. quality: as sent.
    """

    receiver: str
    antenna: str
    epoch_ns: int | None
    position: Floats
    covariance: Floats
    quality: FixQuality


@dataclass(frozen=True, slots=True, eq=False)
class GridFixes:
    """The fixes of one epoch and the heading they gave.

    Attributes:
        valid_ns: on the tick's clock. antennas: one or two.
        heading: of the undercarriage, clockwise from grid north [rad]; of the receivers alone, NaN without.
        off_track: in words, how receivers and inclinometer contradict the track they are said to stand on; the pose
            is then their own. Empty where they fit it, and off rails.
    """

    valid_ns: int
    antennas: tuple[GridFix, ...]
    heading: float
    off_track: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """The undercarriage's pose at one epoch.

    Attributes:
        valid_ns: on the tick's clock. epoch_ns: UTC, if said. key: milliseconds of the day of its epoch.
        quality: the worse of its fixes'. correction_age_s: the older.
        T: (4, 4). covariance: (6, 6). cross: (6, n). q: (n,) joints at the epoch, with which it was found.
        along: (3) unit vector of the rails it was put on, None off rails. distance: along them. curvature: there, in
            the direction of `along`.
        fixes: what it was found from.
        baseline_error_m, baseline_sigma_m, heading_difference, heading_sigma, swapped: see `HealthSeen`.
    """

    valid_ns: int
    epoch_ns: int | None
    key: int
    quality: FixQuality
    correction_age_s: float
    T: Floats
    covariance: Floats
    cross: Floats
    q: Floats
    fixes: GridFixes
    along: tuple[float, float, float] | None = None
    distance: float = math.nan
    curvature: float = 0.0
    baseline_error_m: float = math.nan
    baseline_sigma_m: float = math.nan
    heading_difference: float = math.nan
    heading_sigma: float = math.nan
    swapped: bool = False


class Bent(NamedTuple):
    """A posture and when each joint's sensor took it [ns]."""

    valid_ns: tuple[int, ...]
    q: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class PostureMemory:
    """The newest posture as measured, and the ones shortly before it.

    Attributes:
        recent: oldest first. covariance: (n, n), tilt_cross: (3, n) of the newest.
        rates: (n) [rad/s, m/s]; over_s: the time they were taken over.
        jumped: by joint, the position before a jump that has not been taken back; None where there was none.
        seen: how many postures so far, counted up to a few.
    """

    recent: tuple[Bent, ...] = ()
    covariance: Floats | None = None
    rates: tuple[float, ...] = ()
    over_s: float = math.inf
    jumped: tuple[float | None, ...] = ()
    seen: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class LocatorMemory:
    """Everything the locator remembers.

    Attributes:
        samples: by link channel, oldest first. gyro: the newest rate of the gyro nearest the undercarriage.
        heard: by receiver. headings: of a moving base or a compass, oldest first; heading_clock: of their sender.
        posture: see there. solved: the newest accepted solution. history: those before it.
        motion: of the undercarriage. refused: the last solution, if it was refused.
        tried_ns: time of the last epoch tried. newest: what came of it.
        track: name of the track that `solved` stands on.
        health: the judge's. frozen_ns: since when the undercarriage is held, None if it is not.
    """

    samples: tuple[tuple[Sample, ...], ...]
    heard: tuple[Heard, ...]
    gyro: AngularRate | None = None
    headings: tuple[TimedHeading, ...] = ()
    heading_clock: Clock = field(default_factory=Clock)
    posture: PostureMemory = field(default_factory=PostureMemory)
    solved: Solved | None = None
    history: tuple[Past, ...] = ()
    motion: Motion = field(default_factory=Motion)
    refused: Candidate | None = None
    tried_ns: int | None = None
    newest: GridFixes | None = None
    track: str | None = None
    health: HealthMemory = field(default_factory=HealthMemory)
    frozen_ns: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """Where the machine is, and how far that may be trusted.

    Attributes:
        pose: of the undercarriage now, None where it may not be used. `stamp.epoch_ns` is that of the last fix.
        posture: of the joints now, None before every joint was measured. `stamp.monotonic_ns` is the tick's while
            all sensors are fresh, else when the oldest was last heard of.
        health: the state and its reasons.
        fix: the newest fixes in the site's coordinates, used or refused, None before the first.
    """

    pose: MachinePose | None
    posture: Posture | None
    health: PositionHealth
    fix: GridFixes | None
