"""A receiver's log on a timeline: its bytes in chunks, each arriving when its own sentences say it was measured."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from workgauge.positioning.epochs import Instant, times
from workgauge.rehearse.log_file import LogFile, OnBytes
from workgauge.values.errors import InputError
from workgauge.values.navigation import Measurement
from workgauge.values.ports import Chunk
from workgauge.wire.stream import StreamDecoder

#: Where a sentence or message may begin: the stream may be cut there, or anywhere else, without harm.
_BEGINS = re.compile(rb"[$!](?=[A-Z])|\xb5\x62|WG\x01")

#: A log whose times go back by more, or ahead by more, goes on after `CUT_PAUSE_S` [s].
BACK_S, AHEAD_S, CUT_PAUSE_S = 2.0, 600.0, 1.0

#: The first bytes arrive this long after the clock's zero [ns], so that no latency makes a time negative.
FIRST_NS = 1_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Timeline:
    """Logs as they would have arrived.

    Attributes:
        chunks: by time of arrival; of one time, in the order of the logs.
        zero_s: what the clock's zero is in the logs' time [s]. utc: whether that is UTC since 1970, else of the day.
        warnings: where a log's times jump.
    """

    chunks: tuple[Chunk, ...]
    zero_s: float
    utc: bool
    warnings: tuple[str, ...]

    @property
    def end_ns(self) -> int:
        """When the last chunk arrives."""
        return self.chunks[-1].received_ns

    def moments(self) -> Iterator[tuple[int, tuple[Chunk, ...]]]:
        """Yield (arrival, the chunks that arrive then), in order."""
        begin = 0
        for i, chunk in enumerate(self.chunks):
            if chunk.received_ns != self.chunks[begin].received_ns:
                yield self.chunks[begin].received_ns, self.chunks[begin:i]
                begin = i
        yield self.chunks[begin].received_ns, self.chunks[begin:]


@dataclass(slots=True)
class _Piece:
    """Bytes of one log between two times of its sentences."""

    log: int
    moment: Instant
    data: bytearray = field(default_factory=bytearray)


def timeline(
    logs: Sequence[LogFile], latency_s: Mapping[str, float] | None = None, on_bytes: OnBytes | None = None
) -> Timeline:
    """Return logs on one timeline.

    Bytes arrive at the time of the sentence they complete; those of a sentence without a time (a heading, a velocity)
    with the one before it. Sentences before the first date get theirs by counting back.

    Args:
        logs: each with the port its bytes arrive on. latency_s: per port, from the epoch to the arrival [s].

    Raises:
        InputError: if a log cannot be read, or none of its sentences has a time.
    """
    pieces: list[_Piece] = []
    for i, log in enumerate(logs):
        own = _pieces(i, log, on_bytes)
        if not any(_timed(piece.moment) for piece in own):
            raise InputError(
                "a log without times cannot be replayed",
                file=log.path,
                allowed="sentences with a time: GGA, RMC, GLL, GST, NAV-PVT",
            )
        pieces += own
    stated, utc = times([piece.moment for piece in pieces])
    begins = [next(k for k, piece in enumerate(pieces) if piece.log == i) for i in range(len(logs))]
    zero = float(stated[begins].min())
    warnings: list[str] = []
    chunks: list[Chunk] = []
    for i, log in enumerate(logs):
        own_rows = [k for k, piece in enumerate(pieces) if piece.log == i]
        latency_ns = round(1e9 * (latency_s or {}).get(log.port, 0.0))
        arrivals, said = _arrivals([float(stated[k]) - zero for k in own_rows], log.path)
        warnings += said
        chunks += [
            Chunk(log.port, FIRST_NS + latency_ns + round(at * 1e9), bytes(pieces[k].data))
            for k, at in zip(own_rows, arrivals, strict=True)
        ]
    chunks.sort(key=lambda chunk: chunk.received_ns)
    return Timeline(tuple(chunks), zero - FIRST_NS * 1e-9, utc, tuple(warnings))


def _pieces(index: int, log: LogFile, on_bytes: OnBytes | None) -> list[_Piece]:
    """Return a log cut where the time of its sentences changes."""
    decoder = StreamDecoder(log.port, "log")
    out = [_Piece(index, Instant(log.port))]
    for block in log.blocks(on_bytes):
        begins = [0, *(found.start() for found in _BEGINS.finditer(block) if found.start()), len(block)]
        for a, b in pairwise(begins):
            data = block[a:b]
            for measurement in decoder.feed(Chunk(log.port, 0, data)):
                moment = _moment(log.port, measurement)
                if moment is not None and not _same(out[-1].moment, moment):
                    out.append(_Piece(index, moment))
            out[-1].data += data
    if len(out) > 1:  # what comes before the first time comes with it
        lead = out.pop(0)
        out[0].data[:0] = lead.data
    return out


def _moment(port: str, measurement: Measurement) -> Instant | None:
    time_s = float(getattr(measurement, "time_of_day_s", math.nan))
    moment = Instant(port, time_s, measurement.stamp.epoch_ns)
    return moment if _timed(moment) else None


def _timed(moment: Instant) -> bool:
    return moment.epoch_ns is not None or math.isfinite(moment.time_of_day_s)


def _same(a: Instant, b: Instant) -> bool:
    """Whether two moments are one; the date may be known of one of them only."""
    if a.epoch_ns is not None and b.epoch_ns is not None:
        return a.epoch_ns == b.epoch_ns
    return a.time_of_day_s == b.time_of_day_s


def _arrivals(stated: Sequence[float], path: Path) -> tuple[list[float], list[str]]:
    """Return times that never go back, cut short where the log jumps, and what was cut."""
    out: list[float] = []
    said: list[str] = []
    shift, before = 0.0, stated[0]
    for at in stated:
        step = at - before
        if step < -BACK_S or step > AHEAD_S:
            shift += CUT_PAUSE_S - step
            way = "back" if step < 0 else "ahead"
            said.append(f"{path.name}: its times jump {way} by {abs(step):.1f} s; it goes on after {CUT_PAUSE_S:g} s")
        out.append(max(at + shift, out[-1] if out else at))
        before = at
    return out, said


class LogSource:
    """Logs as the machine's receivers: gives each chunk once its time has come."""

    def __init__(self, line: Timeline) -> None:
        self.line = line
        self._next = 0

    def read(self, now_ns: int) -> list[Chunk]:
        """Return the chunks that arrived since the last call up to now, oldest first."""
        begin = self._next
        chunks = self.line.chunks
        while self._next < len(chunks) and chunks[self._next].received_ns <= now_ns:
            self._next += 1
        return list(chunks[begin : self._next])

    @property
    def finished(self) -> bool:
        """Whether the logs are at their end."""
        return self._next >= len(self.line.chunks)
