"""A computer that misses ticks and a bus that delivers late, between the tick and the valves of a drive."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from workgauge.values.errors import InputError

#: Part of a drive that draws numbers of its own; those before it are in `draw`.
_BUS = 4


@dataclass(frozen=True, slots=True)
class BusSettings:
    """How late commands reach the valves.

    Attributes:
        late_s: each command by 0 up to so much, drawn anew for each; none overtakes another [s].
        missed: share of ticks at which the computer begins to miss some. longest: so many in a row at most.
    """

    late_s: float = 0.0
    missed: float = 0.0
    longest: int = 1

    def __post_init__(self) -> None:
        for name, fine, allowed in (
            ("late_s", 0.0 <= self.late_s <= 10.0, "0 to 10 s"),
            ("missed", 0.0 <= self.missed < 1.0, "0 to below 1"),
            ("longest", 1 <= self.longest <= 100, "1 to 100"),
        ):
            if not fine:
                raise InputError("out of range", element=name, value=getattr(self, name), allowed=allowed)

    def longest_s(self, dt_s: float) -> float:
        """Return by how much a command can reach the valves later than on a bus that is in time [s]."""
        return self.late_s + (self.longest * dt_s if self.missed else 0.0)


#: A bus that is always in time.
IN_TIME = BusSettings()


class Bus:
    """One drive's bus; the same for the same seed, whatever is sent.

    Args:
        settings: of it. seed: of the drive. step_s: commands arrive at multiples of it only.
    """

    def __init__(self, settings: BusSettings, seed: int, step_s: float) -> None:
        self._settings = settings
        self._late = int(settings.late_s / step_s + 1e-9)
        rng = np.random.default_rng((seed, _BUS))
        self._delays, self._misses = rng.spawn(2)
        self._flying: deque[tuple[int, tuple[int, ...]]] = deque()
        self._step = 0
        self._missing = 0

    def misses(self, waiting: bool) -> bool:
        """Return whether the computer misses this tick; never one that waits for the operator to begin."""
        begins, ticks = (
            self._misses.random() < self._settings.missed,
            int(self._misses.integers(self._settings.longest)),
        )
        if self._missing == 0 and begins:
            self._missing = ticks + 1
        elif self._missing:
            self._missing -= 1
        return self._missing > 0 and not waiting

    def send(self, valves: tuple[int, ...]) -> None:
        """Hand over a command; what it overtakes would arrive no earlier than the one before it."""
        arrives = self._step + (int(self._delays.integers(self._late + 1)) if self._late else 0)
        if self._flying:
            arrives = max(arrives, self._flying[-1][0])
        self._flying.append((arrives, valves))

    def arrived(self) -> tuple[int, ...] | None:
        """Return the newest command that arrives by now, or None, and let one step's time pass."""
        newest = None
        while self._flying and self._flying[0][0] <= self._step:
            newest = self._flying.popleft()[1]
        self._step += 1
        return newest
