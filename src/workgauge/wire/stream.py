"""A stream of receiver or sensor bytes to measurements: the one way in."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

from workgauge.values.errors import WireError
from workgauge.values.navigation import AngularRate, EncoderReading, Inclination, Measurement
from workgauge.values.ports import Chunk
from workgauge.wire.epochs import EpochCarrier
from workgauge.wire.framing import Frame, Framer, Protocol, Rejected
from workgauge.wire.messages import decode
from workgauge.wire.nmea import read_sentence, sentence_name
from workgauge.wire.nmea_table import SENTENCES
from workgauge.wire.parts import Reading
from workgauge.wire.ubx import read_message, ubx_name

#: So many different names of messages are counted by name; any beyond are counted together.
MOST_NAMES = 200
MORE_NAMES = "more"
LONGEST_NAME = 16


@dataclass(frozen=True, slots=True)
class Tally:
    """What became of a stream's sentences and messages.

    Attributes:
        good: read; also those that carry a time and no measurement.
        bad: refused, see `reasons`.
        unknown: check sum in order, but none of the table.
        reasons: why `bad` ones were refused, and how many each; they add up to `bad`.
        names: how many of each good or unknown message, by name (`GNGGA`, `PTNL,GGK`, `NAV-PVT`, `UBX 01-07`).
    """

    good: int
    bad: int
    unknown: int
    reasons: Mapping[str, int]
    names: Mapping[str, int]


class StreamDecoder:
    """Measurements out of the bytes of one port; holds a frame that is not complete, and the date.

    A measurement's stamp has as `source` the port and the talker (`gnss/GP`, `gnss/PTNL`, `gnss/UBX`), or for a frame
    of ours the source in it; as `monotonic_ns` the arrival of the frame's last byte; as `epoch_ns` UTC since 1970, if
    the message has a time and a date has been said on this port. Nothing is taken from a sentence without check sum:
    a receiver that sends none gives no position, and the tally says why.

    Args:
        port: the port's name, as in the chunks.
        machine_id: for the stamps; frames of ours that name another machine are refused.
    """

    def __init__(self, port: str, machine_id: str) -> None:
        self._port = port
        self._machine_id = machine_id
        self._framer = Framer()
        self._epochs = EpochCarrier()
        self._good = 0
        self._unknown = 0
        self._rejected: Counter[Rejected] = Counter()
        self._names: Counter[str] = Counter()

    @property
    def tally(self) -> Tally:
        """What became of everything so far."""
        reasons = {str(why): count for why, count in self._rejected.items()}
        return Tally(self._good, self._rejected.total(), self._unknown, reasons, dict(self._names))

    @property
    def held_bytes(self) -> int:
        """How many bytes wait for the rest of their frame; bounded whatever comes."""
        return self._framer.held

    def feed(self, chunk: Chunk) -> list[Measurement]:
        """Return the measurements that a chunk completes, in the order of the stream.

        Raises:
            WireError: for a chunk of another port.
        """
        if chunk.port != self._port:
            raise WireError("a chunk of another port", element="port", value=chunk.port, allowed=self._port)
        return self._read(self._framer.feed(chunk.data, chunk.received_ns))

    def finish(self) -> list[Measurement]:
        """Return what the bytes held give, now that nothing follows (the end of a log)."""
        return self._read(self._framer.finish())

    def _read(self, frames: list[Frame]) -> list[Measurement]:
        found: list[Measurement] = []
        for frame in frames:
            if frame.rejected is not None:
                self._rejected[frame.rejected] += 1
            elif frame.protocol is Protocol.NMEA:
                found += self._nmea(frame)
            elif frame.protocol is Protocol.UBX:
                found += self._ubx(frame)
            else:
                found += self._own(frame)
        return found

    def _nmea(self, frame: Frame) -> tuple[Measurement, ...]:
        fields = frame.body.decode("ascii").split(",")
        talker, name = sentence_name(fields)
        if name not in SENTENCES or not talker.isalpha() or not talker.isupper():
            return self._strange(name if talker[:1] == "P" else fields[0])
        return self._read_or_rejected(
            name if talker[0] == "P" else fields[0],
            read_sentence(name, fields, self._by(talker, frame)),
        )

    def _ubx(self, frame: Frame) -> tuple[Measurement, ...]:
        name = ubx_name(frame.body)
        if name is None:
            return self._strange(f"UBX {frame.body[0]:02X}-{frame.body[1]:02X}")
        return self._read_or_rejected(name, read_message(name, frame.body[4:], self._by("UBX", frame)))

    def _own(self, frame: Frame) -> tuple[Measurement, ...]:
        try:
            value = decode(frame.body, frame.received_ns).value
        except WireError:
            self._rejected[Rejected.WRONG_FRAME] += 1
            return ()
        if value.stamp.machine_id != self._machine_id:
            self._rejected[Rejected.OTHER_MACHINE] += 1
            return ()
        name = type(value).__name__
        if not isinstance(value, Inclination | EncoderReading | AngularRate):
            return self._strange(name)
        return self._read_or_rejected(name, (value,))

    def _by(self, talker: str, frame: Frame) -> Reading:
        return Reading(self._machine_id, _source(self._port, talker), frame.received_ns, self._epochs)

    def _read_or_rejected(self, name: str, read: tuple[Measurement, ...] | Rejected) -> tuple[Measurement, ...]:
        if isinstance(read, Rejected):
            self._rejected[read] += 1
            return ()
        self._good += 1
        self._count(name)
        return read

    def _strange(self, name: str) -> tuple[Measurement, ...]:
        self._unknown += 1
        self._count(name)
        return ()

    def _count(self, name: str) -> None:
        name = name[:LONGEST_NAME]
        self._names[name if name in self._names or len(self._names) < MOST_NAMES else MORE_NAMES] += 1


@lru_cache(maxsize=1024)
def _source(port: str, talker: str) -> str:
    return f"{port}/{talker}"
