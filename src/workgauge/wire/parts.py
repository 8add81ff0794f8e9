"""What the tables of NMEA and UBX share: the stamp a reader makes, and the measurements a writer is given."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from workgauge.values.errors import WireError
from workgauge.values.measurements import Stamp
from workgauge.values.navigation import FixQuality, GnssFix, Measurement
from workgauge.wire.epochs import DAY_NS, EpochCarrier, time_of_day

M = TypeVar("M", bound=Measurement)


@dataclass(slots=True)
class Reading:
    """What a message is read with: who said it, when it arrived, and the dates known so far."""

    machine_id: str
    source: str
    received_ns: int
    epochs: EpochCarrier

    def stamp(self, epoch_ns: int | None = None) -> Stamp:
        """Return the stamp of a value of that epoch."""
        return Stamp(self.machine_id, self.received_ns, self.source, epoch_ns)

    def timed(self, time_of_day_s: float, day: int | None = None, valid: bool = True) -> Stamp:
        """Return the stamp of a value of that time of day; without a day (since 1970) the carried date counts.

        Without a valid fix there is no epoch: some receivers then send a time they made up.
        """
        if not valid:
            return self.stamp()
        if day is None or math.isnan(time_of_day_s):
            return self.stamp(self.epochs.at(self.source, time_of_day_s, self.received_ns))
        return self.stamp(self.epochs.dated(self.source, day, time_of_day_s, self.received_ns))


class Parts:
    """The measurements of one epoch that go into one message, by type."""

    def __init__(self, given: Measurement | Sequence[Measurement], message: str) -> None:
        several = list(given) if isinstance(given, Sequence) else [given]
        self._message = message
        self._by_type: dict[type, Measurement] = {type(one): one for one in several}
        if not several or len(self._by_type) != len(several):
            raise WireError("needs one measurement of each kind", element=message, value=len(several))
        self.first = several[0]
        self._taken: set[type] = set()

    def need(self, kind: type[M]) -> M:
        """Return the measurement of a kind; `WireError` without it."""
        found = self.get(kind)
        if found is None:
            raise WireError("needs a measurement of this kind", element=self._message, allowed=kind.__name__)
        return found

    def get(self, kind: type[M]) -> M | None:
        """Return the measurement of a kind, None without it."""
        self._taken.add(kind)
        found = self._by_type.get(kind)
        return found if isinstance(found, kind) else None

    def done(self) -> None:
        """Raise `WireError` if a measurement was given that the message cannot carry."""
        left = [kind.__name__ for kind in self._by_type if kind not in self._taken]
        if left:
            raise WireError("carries no such measurement", element=self._message, value=", ".join(left))

    @property
    def time_s(self) -> float:
        """Seconds since midnight, rounded to a millisecond, of the epoch; without one, of the time given."""
        if self.first.stamp.epoch_ns is not None:
            return time_of_day((self.first.stamp.epoch_ns + 500_000) // 1_000_000 * 1_000_000)
        return float(getattr(self.first, "time_of_day_s", math.nan))

    @property
    def day(self) -> int | None:
        """Days since 1970 of the epoch rounded to a millisecond, None without one."""
        epoch_ns = self.first.stamp.epoch_ns
        return None if epoch_ns is None else (epoch_ns + 500_000) // DAY_NS


def quality_numbered(number: int | None) -> FixQuality:
    """Return the quality of a GGA number; OTHER beyond the standard's, NONE if empty."""
    if number is None:
        return FixQuality.NONE
    return FixQuality(number) if number <= FixQuality.OTHER else FixQuality.OTHER


def latitude_longitude(fix: GnssFix) -> tuple[float, float]:
    """Return degrees with sign, both NaN unless both are known and there is a fix; `WireError` beyond the globe."""
    latitude, longitude = math.degrees(fix.latitude), math.degrees(fix.longitude)
    if fix.quality is FixQuality.NONE or not (math.isfinite(latitude) and math.isfinite(longitude)):
        return math.nan, math.nan
    if abs(latitude) > 90.0 or abs(longitude) > 180.0:
        raise WireError("not on the globe", element="position", value=f"{latitude}, {longitude}")
    return latitude, longitude
