"""UTC, and fix quality, of messages that leave it to their neighbours.

UTC of sentences that carry a time of day or a GPS time of week, but no date: the date is carried between them.

Only what a receiver said is used: before the first date nothing has an epoch.
"""

import math
from dataclasses import dataclass

from workgauge.values.navigation import FixQuality

NS = 1_000_000_000
DAY_S = 86_400
DAY_NS = DAY_S * NS
WEEK_MS = 604_800_000
#: GPS time zero, 1980-01-06, in milliseconds of UTC since 1970.
GPS_ZERO_MS = 315_964_800_000
#: GPS less UTC since 2017 [ms]. For writing only: reading takes the difference from the receiver's own messages.
LEAP_MS = 18_000


@dataclass(slots=True)
class _Known:
    """The last epoch of one source, and when it arrived."""

    epoch_ns: int
    received_ns: int


class EpochCarrier:
    """Carries date and GPS week between the messages of a stream, each source by itself, else from any other.

    A time of day gets the day that brings it nearest to what the last known epoch and the time since it arrived make
    expected. So midnight passes without a dated sentence, and a sentence a little out of order keeps its own day.
    """

    def __init__(self) -> None:
        self._known: dict[str, _Known] = {}
        self._latest: _Known | None = None
        self._weeks: dict[str, int] = {}
        self._qualities: dict[str, tuple[int, FixQuality]] = {}

    def dated(self, source: str, day: int, time_of_day_s: float, received_ns: int) -> int:
        """Return UTC since 1970 [ns] of a time on a day (counted from 1970-01-01), and remember it."""
        return self._keep(source, day * DAY_NS + round(time_of_day_s * NS), received_ns)

    def at(self, source: str, time_of_day_s: float, received_ns: int) -> int | None:
        """Return UTC since 1970 [ns] of a time of day; None without a time, or before any date is known."""
        known = self._known.get(source, self._latest)
        if known is None or math.isnan(time_of_day_s):
            return None
        expected = known.epoch_ns + received_ns - known.received_ns
        day = (expected - round(time_of_day_s * NS) + DAY_NS // 2) // DAY_NS
        return self._keep(source, day * DAY_NS + round(time_of_day_s * NS), received_ns)

    def gps_dated(self, source: str, itow_ms: int, epoch_ns: int, received_ns: int) -> int:
        """Remember which UTC [ns] a GPS time of week [ms] is, and return it rounded to a millisecond.

        Receivers give the time of week in whole milliseconds; rounding makes all messages of one epoch say the same.
        """
        epoch_ms = (epoch_ns + 500_000) // 1_000_000
        self._weeks[source] = epoch_ms - itow_ms
        return self._keep(source, epoch_ms * 1_000_000, received_ns)

    def gps_at(self, source: str, itow_ms: int) -> int | None:
        """Return UTC since 1970 [ns] of a GPS time of week [ms]; None before the source named a date."""
        week = self._weeks.get(source)
        known = self._known.get(source)
        if week is None or known is None:
            return None
        epoch_ms = week + itow_ms
        epoch_ms += WEEK_MS * ((known.epoch_ns // 1_000_000 - epoch_ms + WEEK_MS // 2) // WEEK_MS)
        return epoch_ms * 1_000_000

    def remember_quality(self, source: str, itow_ms: int, quality: FixQuality) -> None:
        """Remember the quality of a source's fix at a GPS time of week [ms], for messages that do not say theirs."""
        self._qualities[source] = (itow_ms, quality)

    def quality_at(self, source: str, itow_ms: int) -> FixQuality:
        """Return the quality remembered for this very epoch, OTHER without one."""
        itow, quality = self._qualities.get(source, (None, FixQuality.OTHER))
        return quality if itow == itow_ms else FixQuality.OTHER

    def _keep(self, source: str, epoch_ns: int, received_ns: int) -> int:
        self._latest = self._known[source] = _Known(epoch_ns, received_ns)
        return epoch_ns


def time_of_day(epoch_ns: int | None) -> float:
    """Return the seconds since midnight of an epoch [ns], NaN for none."""
    return math.nan if epoch_ns is None else epoch_ns % DAY_NS / NS


def gps_time_of_week(epoch_ns: int) -> int:
    """Return the GPS time of week [ms] of UTC since 1970 [ns]."""
    return (round(epoch_ns / 1e6) - GPS_ZERO_MS + LEAP_MS) % WEEK_MS
