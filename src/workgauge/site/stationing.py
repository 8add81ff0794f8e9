"""Stations along an alignment: what the pegs say, against the distance from its start."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from workgauge.values.arrays import Floats, freeze
from workgauge.values.errors import SiteError


@dataclass(frozen=True, slots=True)
class StationEquation:
    """A place where the station jumps.

    Attributes:
        internal: station counted on from the start without any jump [m].
        ahead: the station from there on [m].
        increasing: whether stations grow with the distance from there on.
        name: what the file calls it (in Finland the number of the kilometre that begins there).
    """

    internal: float
    ahead: float
    increasing: bool = True
    name: str = ""

    @property
    def is_post(self) -> bool:
        """Whether it only marks a kilometre post and changes nothing."""
        return self.increasing and abs(self.ahead - self.internal) < 1e-3


class Stationing:
    """Distance <-> station.

    Args:
        start: station of the alignment's start [m].
        equations: in order of their internal station; may begin before the alignment.
    """

    def __init__(self, start: float, equations: Sequence[StationEquation] = ()) -> None:
        self.start = start
        self.equations = tuple(equations)
        rows = [(start, start, 1.0), *((e.internal, e.ahead, 1.0 if e.increasing else -1.0) for e in equations)]
        before = [row for row in rows[1:] if row[0] <= start]
        # The last equation at or before the start rules there; without one the stations run on from the start.
        first = (start, before[-1][1] + before[-1][2] * (start - before[-1][0]), before[-1][2]) if before else rows[0]
        self._rows: Floats = np.array([first, *(row for row in rows[1:] if row[0] > start)])
        freeze(self._rows)

    def station(self, distance: Floats) -> Floats:
        """Return the station [m] at distances (k,) [m]."""
        internal = np.asarray(distance, dtype=np.float64) + self.start
        index = np.clip(np.searchsorted(self._rows[:, 0], internal, side="right") - 1, 0, None)
        at, ahead, sign = self._rows[index].T
        out: Floats = ahead + sign * (internal - at)
        return out

    def distances(self, station: float, length: float) -> list[float]:
        """Return every distance within [0, length] (1 mm slack) whose station is `station` [m]."""
        found: list[float] = []
        ends = [*self._rows[1:, 0], np.inf]
        for (at, ahead, sign), end in zip(self._rows, ends, strict=True):
            internal = at + sign * (station - ahead)
            distance = float(internal - self.start)
            if at - 1e-9 <= internal < end and -1e-3 <= distance <= length + 1e-3:
                found.append(min(max(distance, 0.0), length))
        return found

    def distance(self, station: float, length: float, name: str) -> float:
        """Return the one distance [m] whose station is `station` [m].

        Raises:
            SiteError: no place of the alignment has this station, or several have.
        """
        found = self.distances(station, length)
        if len(found) == 1:
            return found[0]
        if not found:
            start, end = (float(v) for v in self.station(np.array([0.0, length])))
            message = "no place of the alignment has this station"
            allowed = f"{start:.3f} to {end:.3f} m"
        else:
            places = ", ".join(f"{d:.3f}" for d in found)
            message = "several places of the alignment have this station"
            allowed = f"a distance instead, one of {places} m"
        raise SiteError(message, element=f"alignment {name!r}", value=station, allowed=allowed)
