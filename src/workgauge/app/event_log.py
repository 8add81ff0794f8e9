"""A log of what happens, written beside the work it tells of."""

import queue
import threading
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from typing import TextIO

#: So many lines wait at most; what comes beyond is counted, and the count written.
WAITING = 1000


class EventLog:
    """Writes lines with their UTC time; a full disk or a stopped terminal holds nobody up who logs.

    Args:
        sinks: where to write, each line at once; one that cannot be written to is left alone from then on.
        clock: the time of a line.
    """

    def __init__(self, sinks: Sequence[TextIO], clock: Callable[[], datetime] = lambda: datetime.now(UTC)) -> None:
        self._sinks, self._clock = list(sinks), clock
        self._waiting: queue.Queue[str | None] = queue.Queue(WAITING)
        self._lost = 0
        self._thread = threading.Thread(target=self._write, daemon=True)
        self._thread.start()

    def __call__(self, text: str) -> None:
        """Log a line; never waits."""
        line = f"{self._clock():%Y-%m-%dT%H:%M:%S.%f}"[:-3] + f"Z {text}"
        if self._lost:
            line = f"({self._lost} lines lost)\n{line}"
        try:
            self._waiting.put_nowait(line)
            self._lost = 0
        except queue.Full:
            self._lost += 1

    def close(self, patience_s: float = 2.0) -> None:
        """Write what waits, for so long at most."""
        try:
            self._waiting.put(None, timeout=patience_s)
        except queue.Full:
            return
        self._thread.join(patience_s)

    def _write(self) -> None:
        while (line := self._waiting.get()) is not None:
            for sink in tuple(self._sinks):
                try:
                    sink.write(line + "\n")
                    sink.flush()
                except (OSError, ValueError):  # ValueError: closed
                    self._sinks.remove(sink)
