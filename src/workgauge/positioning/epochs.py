"""Epochs of a receiver's log: what its sentences say of one moment, put together without losing a position.

Sentences of one time and one receiver that give the very same latitude and longitude are one epoch. Where the digits
differ (a GLL with four decimals beside a GGA with eight) each position stays an epoch of its own; they share what
only one of them says: height, quality, error, heading.
"""

import math
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from workgauge.values.arrays import Floats
from workgauge.values.measurements import Stamp
from workgauge.values.navigation import FixQuality, GnssError, GnssFix, GnssGridFix, GnssHeading, Measurement

DAY_S = 86_400.0

#: Sentences of one time may be this many other times apart in the stream.
RECENT = 8

#: Whose word on quality counts more; the others carry a mode letter or nothing.
RANK = {"GGA": 3, "NAV-PVT": 3, "PTNL,GGK": 3, "PTNL,PJK": 3, "GNS": 2, "PASHR,POS": 2, "RMC": 1, "GLL": 1}


@dataclass(slots=True)
class Fix:
    """One position of one receiver at one moment, NaN or None where nothing is known.

    Attributes:
        source: stream and receiver. sentences: those it came in.
        latitude, longitude: [rad]. e, n: in the receiver's own projection, if it sends that [m].
        height_msl_m, height_ellipsoid_m, separation_m, correction_age_s: as sent. grid_height_m: beside e and n.
        quality: None if no sentence says. covariance: (3, 3) of east, north, up [m^2].
    """

    source: str
    latitude: float
    longitude: float
    e: float = math.nan
    n: float = math.nan
    grid_height_m: float = math.nan
    sentences: list[str] = field(default_factory=list)
    height_msl_m: float = math.nan
    height_ellipsoid_m: float = math.nan
    separation_m: float = math.nan
    correction_age_s: float = math.nan
    quality: FixQuality | None = None
    rank: int = -1
    covariance: Floats | None = None

    @property
    def placed(self) -> bool:
        """Whether it says where."""
        return math.isfinite(self.latitude + self.longitude) or math.isfinite(self.e + self.n)

    def take(self, sentence: str, quality: FixQuality) -> None:
        """Take in one more sentence's word on this position."""
        self.sentences.append(sentence)
        rank = RANK.get(sentence, 0)
        says = rank > 0 or quality is not FixQuality.NONE or not self.placed
        if says and rank > self.rank:
            self.quality, self.rank = quality, rank

    def fill(self, other: "Fix") -> None:
        """Take from another fix of the same receiver and moment what is not known here."""
        if math.isnan(self.height_msl_m) and math.isnan(self.height_ellipsoid_m):
            self.height_msl_m, self.height_ellipsoid_m = other.height_msl_m, other.height_ellipsoid_m
        if math.isnan(self.separation_m):
            self.separation_m = other.separation_m
        if other.rank > self.rank and other.placed:
            self.quality, self.rank = other.quality, other.rank
        if math.isnan(self.correction_age_s):
            self.correction_age_s = other.correction_age_s
        if self.covariance is None:
            self.covariance = other.covariance


@dataclass(slots=True)
class Instant:
    """One moment on one stream: every receiver's fixes, one heading.

    Attributes:
        port: the stream. time_of_day_s, epoch_ns: UTC, NaN and None where no sentence says.
        heading: of whichever sentence came first. first, last: indices of its measurements in the stream.
    """

    port: str
    time_of_day_s: float = math.nan
    epoch_ns: int | None = None
    fixes: dict[tuple[str, object, object], Fix] = field(default_factory=dict)
    errors: dict[str, Floats] = field(default_factory=dict)
    heading: GnssHeading | None = None
    first: int = 0
    last: int = 0

    def has(self, source: str, sentence: str) -> bool:
        """Whether this receiver's sentence is in here already."""
        return any(fix.source == source and sentence in fix.sentences for fix in self.fixes.values())

    def share(self) -> None:
        """Let each fix have what only another sentence of its receiver says."""
        by_rank = sorted(self.fixes.values(), key=lambda fix: -fix.rank)
        for fix in self.fixes.values():
            stated = self.errors.get(fix.source)
            if stated is None and len(self.errors) == 1 and len({one.source for one in by_rank}) == 1:
                stated = next(iter(self.errors.values()))
            if fix.covariance is None or (stated is not None and np.isfinite(stated).all()):
                fix.covariance = fix.covariance if stated is None else stated
            for other in by_rank:
                if other is not fix and other.source == fix.source:
                    fix.fill(other)


class Gatherer:
    """Puts measurements of any number of streams together into moments, in the order they first appear."""

    def __init__(self) -> None:
        self.instants: list[Instant] = []
        self._recent: dict[str, OrderedDict[int, Instant]] = {}
        self._last: dict[str, Instant] = {}
        self._heading_ahead: dict[str, GnssHeading] = {}
        self._count = 0

    def take(self, measurement: Measurement) -> None:
        """Take in one measurement; those that are neither position nor heading are passed over."""
        if isinstance(measurement, GnssFix):
            instant = self._instant(measurement)
            key = _key(measurement.latitude, measurement.longitude)
            fix = instant.fixes.setdefault(
                (measurement.stamp.source, *key),
                Fix(measurement.stamp.source, measurement.latitude, measurement.longitude),
            )
            _take_numbers(fix, measurement)
            fix.take(measurement.sentence, measurement.quality)
        elif isinstance(measurement, GnssGridFix):
            instant = self._instant(measurement)
            grid = (measurement.easting_m, measurement.northing_m)
            fix = instant.fixes.setdefault(
                (f"{measurement.stamp.source} grid", *grid),
                Fix(measurement.stamp.source, math.nan, math.nan, *grid, measurement.height_m),
            )
            fix.take(measurement.sentence, measurement.quality)
        elif isinstance(measurement, GnssError):
            self._instant(measurement).errors.setdefault(measurement.stamp.source, measurement.covariance)
        elif isinstance(measurement, GnssHeading):
            self._take_heading(measurement)
        self._count += 1

    def finished(self) -> list[Instant]:
        """Return every moment that has a fix or a heading, each fix knowing what its receiver said."""
        for port in list(self._heading_ahead):
            self._new(port, math.nan, None)
        kept = [one for one in self.instants if one.fixes or (one.heading and math.isfinite(one.heading.heading))]
        for instant in kept:
            instant.share()
        return kept

    def _instant(self, measurement: GnssFix | GnssGridFix | GnssError | GnssHeading) -> Instant:
        """Return the moment a measurement belongs to, begun if needed."""
        port, time_s = _port(measurement.stamp), measurement.time_of_day_s
        recent = self._recent.setdefault(port, OrderedDict())
        if math.isfinite(time_s):
            key = round(time_s * 1000)
            instant = recent.get(key)
            if instant is None:
                instant = self._new(port, time_s, measurement.stamp.epoch_ns)
                recent[key] = instant
                if len(recent) > RECENT:
                    recent.popitem(last=False)
        else:
            last = self._last.get(port)
            source, sentence = measurement.stamp.source, measurement.sentence
            if last is not None and math.isnan(last.time_of_day_s) and not last.has(source, sentence):
                instant = last
            else:
                instant = self._new(port, math.nan, measurement.stamp.epoch_ns)
        if instant.epoch_ns is None:
            instant.epoch_ns = measurement.stamp.epoch_ns
        instant.last = self._count
        return instant

    def _new(self, port: str, time_of_day_s: float, epoch_ns: int | None) -> Instant:
        instant = Instant(port, time_of_day_s, epoch_ns, first=self._count, last=self._count)
        instant.heading = self._heading_ahead.pop(port, None)
        self.instants.append(instant)
        self._last[port] = instant
        return instant

    def _take_heading(self, heading: GnssHeading) -> None:
        """Give a heading to its own moment, or, having no time of its own, to the one beside it in the stream."""
        port = _port(heading.stamp)
        if math.isfinite(heading.time_of_day_s):
            instant = self._instant(heading)
            if instant.heading is None or math.isnan(instant.heading.heading):
                instant.heading = heading
            return
        last = self._last.get(port)
        if last is not None and last.heading is None:
            last.heading = heading
        else:
            self._ahead(port, heading)

    def _ahead(self, port: str, heading: GnssHeading) -> None:
        """Keep a heading for the next moment; one that waits already is a moment of its own."""
        if port in self._heading_ahead:
            self._new(port, math.nan, None)
        self._heading_ahead[port] = heading


def gathered(measurements: Iterable[Measurement]) -> list[Instant]:
    """Return the moments of a stream of measurements."""
    gatherer = Gatherer()
    for measurement in measurements:
        gatherer.take(measurement)
    return gatherer.finished()


def times(instants: Sequence[Instant]) -> tuple[Floats, bool]:
    """Return the times (n,) [s] and whether they are UTC since 1970.

    They are if any sentence of the log gives a date; moments before it get the date by counting back. Otherwise they
    are seconds since the first moment's midnight, growing past a day's 86,400 at the next. NaN for a moment without.
    """
    day = np.array([one.time_of_day_s for one in instants])
    stated = np.array([math.nan if one.epoch_ns is None else one.epoch_ns * 1e-9 for one in instants])
    dated = np.flatnonzero(np.isfinite(stated))
    if len(dated):
        missing = np.flatnonzero(np.isnan(stated) & np.isfinite(day))
        after = np.clip(np.searchsorted(dated, missing), 0, len(dated) - 1)
        before = np.clip(after - 1, 0, None)
        nearer = missing - dated[before] <= np.abs(dated[after] - missing)
        reference = stated[dated[np.where(nearer, before, after)]]
        guess = reference - np.mod(reference, DAY_S) + day[missing]
        stated[missing] = guess - DAY_S * np.round((guess - reference) / DAY_S)
        return stated, True
    known = np.flatnonzero(np.isfinite(day))
    day[known[1:]] += DAY_S * np.cumsum(np.diff(day[known]) < -0.5 * DAY_S)
    return day, False


def fixes_of(instants: Sequence[Instant]) -> Iterator[tuple[int, Fix | None]]:
    """Yield (index of the moment, fix) in order; a moment with nothing but a heading has None."""
    for i, instant in enumerate(instants):
        if not instant.fixes:
            yield i, None
        # A sentence without a position adds nothing beside one that has it.
        placed = {fix.source for fix in instant.fixes.values() if fix.placed}
        for fix in instant.fixes.values():
            if fix.placed or fix.source not in placed:
                yield i, fix


def _port(stamp: Stamp) -> str:
    return stamp.source.partition("/")[0]


def _key(latitude: float, longitude: float) -> tuple[object, object]:
    """Return what tells positions apart; without a position, one and the same."""
    return (latitude, longitude) if math.isfinite(latitude + longitude) else (None, None)


def _take_numbers(fix: Fix, sent: GnssFix) -> None:
    if math.isnan(fix.correction_age_s):
        fix.correction_age_s = sent.correction_age_s
    if math.isnan(fix.height_msl_m):
        fix.height_msl_m = sent.height_msl_m
    if math.isnan(fix.height_ellipsoid_m):
        fix.height_ellipsoid_m = sent.height_ellipsoid_m
    if math.isnan(fix.separation_m):
        fix.separation_m = sent.geoid_separation_m
    if fix.covariance is None:
        fix.covariance = sent.covariance
