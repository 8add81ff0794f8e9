"""Which time a measurement is of, and which measurements belong together.

A measurement is valid at `arrival - latency`. Where the sender says the time of its epoch, arrivals that dawdle are
told from those that do not: the clock's offset is the least `arrival - epoch` so far, and the time valid is
`epoch + offset - latency`. Sentences of one epoch are found by their time of day in milliseconds, which
every receiver's message of that epoch says alike, master or rover, NMEA or UBX.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from workgauge.positioning.posture import Reading
from workgauge.values.arrays import Floats
from workgauge.values.navigation import FixQuality, GnssError, GnssFix, GnssHeading, GnssVelocity

#: Two clocks drift apart by no more than this: by so much the least delay is let rise.
DRIFT = 2e-4
#: A clock that is suddenly whole seconds off, to within this [ns], was set (a leap second), once that lasts [ns].
STEP_NS, SLACK_NS, LASTS_NS = 1_000_000_000, 30_000_000, 1_000_000_000
#: Messages without a time of their own belong to the last epoch if they arrive within this [ns].
SAME_BURST_NS = 60_000_000
#: So many epochs are kept, and so many readings of a link sensor.
KEPT_EPOCHS, KEPT_SAMPLES = 4, 64
#: Milliseconds of a day.
_DAY_MS = 86_400_000


class Clock(NamedTuple):
    """The offset between a sender's clock and ours: the least of arrival less epoch so far, but for drift [ns].

    A stream that is held up does not become punctual by being late for long. `stepped_ns`: since when the offset is
    whole seconds larger, None if it is not.
    """

    least: int | None = None
    heard_ns: int = 0
    stepped_ns: int | None = None

    def heard(self, arrived_ns: int, epoch_ns: int) -> "Clock":
        """Return the clock after an arrival."""
        offset = arrived_ns - epoch_ns
        if self.least is None:
            return Clock(offset, arrived_ns)
        least = min(offset, self.least + round(DRIFT * max(0, arrived_ns - self.heard_ns)))
        off = offset - least
        seconds = round(off / STEP_NS)
        if seconds < 1 or abs(off - seconds * STEP_NS) > SLACK_NS:
            return Clock(least, arrived_ns)
        since = arrived_ns if self.stepped_ns is None else self.stepped_ns
        return Clock(offset if arrived_ns - since >= LASTS_NS else least, arrived_ns, since)

    def valid_ns(self, arrived_ns: int, epoch_ns: int | None, latency_ns: int) -> int:
        """Return when a measurement was taken, on our clock; never later than `arrival - latency`."""
        if epoch_ns is None or self.least is None:
            return arrived_ns - latency_ns
        return min(epoch_ns + self.least, arrived_ns) - latency_ns


_UNHEARD = Clock()


class Sample(NamedTuple):
    """One reading of a link sensor and when it was taken [ns]."""

    valid_ns: int
    reading: Reading


def epoch_key(epoch_ns: int | None, time_of_day_s: float) -> int | None:
    """Return the milliseconds of the day of a message, None if it says no time."""
    if math.isfinite(time_of_day_s):
        return round(time_of_day_s * 1e3) % _DAY_MS
    return None if epoch_ns is None else round(epoch_ns / 1e6) % _DAY_MS


@dataclass(frozen=True, slots=True, eq=False)
class Epoch:
    """What one receiver said of one epoch.

    Attributes:
        key: milliseconds of the day; arrival in milliseconds, negative, where no time was said.
        valid_ns: on our clock. arrived_ns: of the first message. epoch_ns: UTC, if said.
        fix: the best of its positions, None before one came. quality, correction_age_s: from whichever says them.
        covariance: (3, 3) east, north, up as the receiver states it, None without a statement [m^2].
        velocity: of the antenna.
    """

    key: int
    valid_ns: int
    arrived_ns: int
    epoch_ns: int | None = None
    fix: GnssFix | None = None
    quality: FixQuality = FixQuality.NONE
    correction_age_s: float = math.nan
    covariance: Floats | None = None
    velocity: GnssVelocity | None = None

    def with_fix(self, fix: GnssFix) -> "Epoch":
        """Return the epoch with one more position: the better one stays, each fact from where it is said."""
        better = self.fix is None or _rank(fix) > _rank(self.fix)
        said = fix.quality is not FixQuality.OTHER and (better or self.quality is FixQuality.OTHER)
        quality = fix.quality if self.fix is None or said else self.quality
        if FixQuality.NONE in (fix.quality, self.quality) and self.fix is not None:
            quality = FixQuality.NONE  # one sentence of the epoch says there is no fix
        age = fix.correction_age_s if math.isfinite(fix.correction_age_s) else self.correction_age_s
        stated = self.covariance if fix.covariance is None else fix.covariance
        kept = fix if better else self.fix
        return Epoch(
            self.key, self.valid_ns, self.arrived_ns, self.epoch_ns, kept, quality, age, stated, self.velocity
        )


def _place(fix: GnssFix) -> tuple[float, float, float] | None:
    """Return latitude, longitude and height as sent, None without all three."""
    height = fix.height_msl_m if math.isfinite(fix.height_msl_m) else fix.height_ellipsoid_m
    if not (math.isfinite(fix.latitude) and math.isfinite(height)):
        return None
    return fix.latitude, fix.longitude, height


def _rank(fix: GnssFix) -> tuple[bool, bool, bool]:
    """Return how much a position says: finite, with height, with its own covariance (as high-precision ones have)."""
    height = math.isfinite(fix.height_msl_m) or math.isfinite(fix.height_ellipsoid_m)
    return math.isfinite(fix.latitude), height, fix.covariance is not None


@dataclass(frozen=True, slots=True, eq=False)
class Heard:
    """What is remembered of one receiver.

    Attributes:
        epochs: the newest, oldest first. clock: see there.
        talker, talker_ns: the source whose positions count, and when it last gave one; another one is not listened
            to while this one speaks.
        states_error: it sends its own error apart from its positions, so these are waited for.
        place: latitude, longitude, height of its last fix, same_since_ns: since when exactly these.
    """

    epochs: tuple[Epoch, ...] = ()
    clock: Clock = _UNHEARD
    talker: str = ""
    talker_ns: int = 0
    states_error: bool = False
    place: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    same_since_ns: int = 0

    def hear(self, message: GnssFix | GnssError | GnssVelocity, latency_ns: int, silence_ns: int) -> "Heard":
        """Return what is remembered after one more message.

        Args:
            latency_ns: of the receiver. silence_ns: a talker silent for longer gives way to another.
        """
        stamp = message.stamp
        arrived, epoch_ns = stamp.monotonic_ns, stamp.epoch_ns
        talker, talker_ns = self.talker, self.talker_ns
        if isinstance(message, GnssFix):
            if talker not in ("", stamp.source) and arrived - talker_ns <= silence_ns:
                return self
            talker, talker_ns = stamp.source, arrived
        clock = self.clock if epoch_ns is None else self.clock.heard(arrived, epoch_ns)
        key = self._key(message)
        epochs = self.epochs
        at = next((i for i, one in enumerate(epochs) if one.key == key), None)
        if at is None:
            valid = clock.valid_ns(arrived, epoch_ns, latency_ns)
            epochs = (*epochs, Epoch(key, valid, arrived, epoch_ns))[-KEPT_EPOCHS:]
            at = len(epochs) - 1
        epoch = epochs[at]
        states_error, place, same_since_ns = self.states_error, self.place, self.same_since_ns
        if isinstance(message, GnssFix):
            here = _place(message)
            if math.isnan(message.latitude):
                same_since_ns = epoch.valid_ns  # no fix is no repeated one
            elif here is not None and here != place:
                place, same_since_ns = here, epoch.valid_ns
            epoch = epoch.with_fix(message)
        elif isinstance(message, GnssError):
            states_error = True
            epoch = replace(epoch, covariance=message.covariance)
        else:
            epoch = replace(epoch, velocity=message)
        epochs = (*epochs[:at], epoch, *epochs[at + 1 :])
        return Heard(epochs, clock, talker, talker_ns, states_error, place, same_since_ns)

    def _key(self, message: GnssFix | GnssError | GnssVelocity) -> int:
        """Return the epoch a message belongs to: the one it names, or the burst it arrived in."""
        key = epoch_key(message.stamp.epoch_ns, message.time_of_day_s)
        if key is not None:
            return key
        arrived = message.stamp.monotonic_ns
        last = self.epochs[-1] if self.epochs else None
        near = last is not None and arrived - last.arrived_ns <= SAME_BURST_NS
        if near and last is not None and not (isinstance(message, GnssFix) and last.fix is not None):
            return last.key
        return -(arrived // 1_000_000) - 1

    @property
    def same_for_s(self) -> float:
        """For how long the coordinates have not changed in the least while they kept coming [s]."""
        return max(0, self.epochs[-1].valid_ns - self.same_since_ns) * 1e-9 if self.epochs else 0.0


class TimedHeading(NamedTuple):
    """A heading, when it is of [ns], and the milliseconds of the day it says, if it does."""

    valid_ns: int
    key: int | None
    heading: GnssHeading


def whole(epoch: Epoch, heard: Heard, now_ns: int, patience_ns: int) -> bool:
    """Return whether an epoch has all its receiver will say of it: a position, and its error if it sends errors.

    An error that does not come within `patience_ns` is not waited for any longer.
    """
    if epoch.fix is None:
        return False
    stated = epoch.covariance is not None or not heard.states_error
    return stated or now_ns - epoch.arrived_ns > patience_ns or heard.epochs[-1].key != epoch.key


def heading_of(epoch: Epoch, headings: Sequence[TimedHeading], within_ns: int) -> TimedHeading | None:
    """Return the heading of an epoch: the one that says its time, or else the nearest that says none."""
    for one in reversed(headings):
        if one.key == epoch.key:
            return one
    near = [one for one in headings if one.key is None and abs(one.valid_ns - epoch.valid_ns) <= within_ns]
    return min(near, key=lambda one: abs(one.valid_ns - epoch.valid_ns), default=None)


def at_time(samples: Sequence[Sample], t_ns: int, turning: bool) -> tuple[Reading, float] | None:
    """Return what a sensor would have read at a time, between its readings, and how far from one that is [s].

    Before the first and after the last reading, that reading: the distance in time then says how old it is.

    Args:
        turning: values are angles, and run round the circle.
    """
    if not samples:
        return None
    after = None
    for before in reversed(samples):
        if before.valid_ns <= t_ns:
            if after is None or after.valid_ns == before.valid_ns:
                return before.reading, (t_ns - before.valid_ns) * 1e-9
            share = (t_ns - before.valid_ns) / (after.valid_ns - before.valid_ns)
            one, two = before.reading, after.reading
            first = one.first + share * _step(one.first, two.first, turning)
            second = one.second + share * _step(one.second, two.second, turning)
            sigma = two.sigma if one.sigma != one.sigma else max(one.sigma, two.sigma)
            return Reading(first, second, sigma), 0.0
        after = before
    assert after is not None
    return after.reading, (after.valid_ns - t_ns) * 1e-9


def _step(first: float, second: float, turning: bool) -> float:
    return math.remainder(second - first, 2.0 * math.pi) if turning else second - first
