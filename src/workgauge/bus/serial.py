"""A serial port as chunks of bytes: a thread of its own reads, whoever asks never waits."""

import threading
import time
from collections import deque
from collections.abc import Callable
from types import TracebackType
from typing import Self

import serial

from workgauge.values.errors import InputError
from workgauge.values.ports import Chunk

#: Bytes kept for a reader that is late: at 115,200 baud more than a minute's.
QUEUE_BYTES = 1 << 20

#: The reader thread looks up at least this often [s]; an unplugged device is tried again after `REOPEN_S`.
LOOK_UP_S, REOPEN_S = 0.1, 1.0


class SerialPort:
    """A serial device read by a thread into a bounded queue.

    Whole reads are kept or dropped; where nobody collects them the oldest go first, and `lost_bytes` counts them. An
    unplugged device is a `fault` in words and no bytes; it is opened again as soon as it is back.

    Args:
        device: as the system calls it: `/dev/ttyUSB0`, `COM3`. baud: bits per second.
        port: the name its chunks carry, as the machine's file has it.
        clock: gives the monotonic time of receipt [ns].
        queue_bytes: how much is kept for a late reader.

    Raises:
        InputError: if the device cannot be opened.
    """

    def __init__(
        self,
        device: str,
        baud: int = 115_200,
        *,
        port: str = "gnss",
        clock: Callable[[], int] = time.monotonic_ns,
        queue_bytes: int = QUEUE_BYTES,
    ) -> None:
        self.device, self.baud, self.port = device, baud, port
        self._clock, self._queue_bytes = clock, queue_bytes
        self._chunks: deque[Chunk] = deque()
        self._waiting_bytes = 0
        self._lost_bytes = 0
        self._fault: str | None = None
        self._lock = threading.Lock()
        self._stop = threading.Event()
        try:
            self._serial: serial.Serial | None = self._opened()
        except (OSError, ValueError) as error:
            raise InputError(
                "the serial port cannot be opened",
                element=device,
                value=_words(error),
                allowed="a device that is there, free and readable, at a speed it knows",
            ) from error
        self._thread = threading.Thread(target=self._run, name=f"serial {device}", daemon=True)
        self._thread.start()

    def read(self) -> list[Chunk]:
        """Return what arrived since the last call, oldest first; never waits for bytes."""
        with self._lock:
            out = list(self._chunks)
            self._chunks.clear()
            self._waiting_bytes = 0
        return out

    @property
    def fault(self) -> str | None:
        """Why nothing arrives, or None while the device is there."""
        with self._lock:
            return self._fault

    @property
    def lost_bytes(self) -> int:
        """Bytes dropped so far because nobody collected them in time."""
        with self._lock:
            return self._lost_bytes

    def close(self) -> None:
        """Stop reading and give the device back."""
        self._stop.set()
        self._thread.join(timeout=5 * LOOK_UP_S)
        self._shut()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _opened(self) -> serial.Serial:
        return serial.Serial(self.device, self.baud, timeout=LOOK_UP_S, exclusive=True)

    def _run(self) -> None:
        """Read until told to stop; after a fault, open again."""
        while not self._stop.is_set():
            try:
                if self._serial is None:
                    self._serial = self._opened()
                    with self._lock:
                        self._fault = None
                data = self._serial.read(max(1, self._serial.in_waiting))
            except (OSError, ValueError, TypeError) as error:  # TypeError: closed under a read (pyserial 3.5)
                self._shut()
                with self._lock:
                    self._fault = f"{self.device}: {_words(error)}"
                self._stop.wait(REOPEN_S)
                continue
            if data:
                self._keep(Chunk(self.port, self._clock(), bytes(data)))

    def _keep(self, chunk: Chunk) -> None:
        with self._lock:
            self._chunks.append(chunk)
            self._waiting_bytes += len(chunk.data)
            while self._waiting_bytes > self._queue_bytes:
                dropped = len(self._chunks.popleft().data)
                self._waiting_bytes -= dropped
                self._lost_bytes += dropped

    def _shut(self) -> None:
        device, self._serial = self._serial, None
        if device is not None:
            try:
                device.close()
            except OSError:  # already gone
                return


def _words(error: Exception) -> str:
    """Return the cause in words, without the call it came from."""
    return getattr(error, "strerror", None) or str(error)
