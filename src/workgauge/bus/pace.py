"""A fixed period on the real clock."""

import time
from collections.abc import Callable


class Pace:
    """Waits for the next period; where one was missed, goes on from now instead of catching up.

    Args:
        period_s: of the loop [s]. clock: monotonic [ns]. sleep: waits so long [s].
    """

    def __init__(
        self,
        period_s: float,
        *,
        clock: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._period_ns = round(period_s * 1e9)
        self._clock, self._sleep = clock, sleep
        self._next_ns = clock()
        self.late = 0

    def wait(self) -> int:
        """Wait until the next period begins and return the time it does [ns]; `late` counts those missed."""
        now = self._clock()
        if now < self._next_ns:
            self._sleep((self._next_ns - now) * 1e-9)
            now = self._clock()
        elif now - self._next_ns > self._period_ns:
            self.late += 1
            self._next_ns = now
        self._next_ns += self._period_ns
        return now
