"""One pass that cuts a stream of bytes into NMEA sentences, UBX messages and the program's own frames.

It starts anywhere, takes any cut of the stream into chunks and gives the same frames for each, and keeps at most one
frame's bytes. What it looks for, outside a frame:

- `$` or `!` and a capital letter: an NMEA sentence. It ends with `*` and two hexadecimal digits; what follows is not
  waited for. It is refused where it meets another `$` or a byte that is no printable ASCII first.
- the head of a sentence in the table of `nmea_table` without its `$`.
- `B5 62`: a UBX message.
- `WG` and the version: a frame of `messages`.
- `*` and two hexadecimal digits: the end of a sentence whose beginning is missing, counted as such.

Everything else is noise and passes unseen. A check sum that fails costs an NMEA sentence its whole text, but a
binary message only its first bytes: the length that was damaged may reach over good messages.
"""

import re
import zlib
from collections import deque
from enum import StrEnum
from itertools import accumulate
from typing import NamedTuple

from workgauge.wire.messages import MAGIC, OVERHEAD, VERSION

UBX_SYNC = b"\xb5\x62"
UBX_OVERHEAD = 8
#: Longest sentence looked at, from `$` to `*` [bytes]. The standard says 82; makers' own sentences are longer.
LONGEST_SENTENCE = 1024
#: Longest payload of a binary message waited for [bytes].
LONGEST_PAYLOAD = 4096

_OWN_SYNC = MAGIC + bytes([VERSION])
_KNOWN_HEADS = rb"(?:[A-Z]{2}(?:GGA|GLL|RMC|VTG|GST|ZDA|HDT|THS|ROT)|PTNL|PASHR),"
_MARKER = re.compile(
    rb"[$!]|" + re.escape(UBX_SYNC) + rb"|" + re.escape(_OWN_SYNC) + rb"|\*[0-9A-Fa-f]{2}|" + _KNOWN_HEADS
)
_LONGEST_MARKER = 6
_END = re.compile(rb"[*$]|[^\x20-\x7e]")
_HEX = frozenset(b"0123456789ABCDEFabcdef")


class Protocol(StrEnum):
    """What a frame is."""

    NMEA = "nmea"
    UBX = "ubx"
    OWN = "own"


class Rejected(StrEnum):
    """Why a sentence or message was refused."""

    CHECKSUM_DIFFERS = "check sum differs"
    NO_CHECKSUM = "no check sum"
    BROKEN_CHECKSUM = "check sum is no number"
    NOT_TEXT = "a byte that is no text"
    CUT_SHORT = "another sentence begins inside"
    CUT_OFF = "the stream ends inside"
    NO_START = "the beginning is missing"
    TOO_LONG = "too long"
    TOO_FEW_FIELDS = "too few fields"
    INVALID_FIELD = "a field is invalid"
    WRONG_LENGTH = "wrong length"
    WRONG_FRAME = "frame is invalid"
    OTHER_MACHINE = "of another machine"


class Frame(NamedTuple):
    """One frame, or what was refused.

    Attributes:
        protocol: which kind.
        body: NMEA: the text between `$` and `*`. UBX: class, id, length and payload. Own: the whole frame.
        received_ns: when its last byte arrived.
        rejected: why it is refused; None for a frame whose check sum holds.
    """

    protocol: Protocol
    body: bytes
    received_ns: int
    rejected: Rejected | None = None


def nmea_checksum(body: bytes) -> int:
    """Return the exclusive or of all bytes between `$` and `*`."""
    folded = int.from_bytes(body, "little")
    shift = 4 << len(body).bit_length()
    while shift >= 8:
        folded ^= folded >> shift
        shift >>= 1
    return folded & 0xFF


def ubx_checksum(body: bytes) -> bytes:
    """Return the two bytes of the 8-bit Fletcher sum over class, id, length and payload."""
    return bytes((sum(body) & 0xFF, sum(accumulate(body)) & 0xFF))


def own_checksum_holds(frame: bytes) -> bool:
    """Return whether the CRC-32 at the end of one of the program's own frames fits."""
    return zlib.crc32(memoryview(frame)[:-4]) == int.from_bytes(frame[-4:], "little")


class Framer:
    """Cuts one stream into frames; holds what is not complete yet."""

    def __init__(self) -> None:
        self._held = b""
        self._start = 0  # stream position of the first byte held
        self._arrivals: deque[tuple[int, int]] = deque()  # (stream position after a chunk, when it came)

    def feed(self, data: bytes, received_ns: int) -> list[Frame]:
        """Return the frames that `data` completes, in the order of the stream."""
        if not data:
            return []
        self._held += data
        self._arrivals.append((self._start + len(self._held), received_ns))
        return self._cut(final=False)

    def finish(self) -> list[Frame]:
        """Return what the rest holds, now that nothing follows."""
        return self._cut(final=True)

    @property
    def held(self) -> int:
        """How many bytes wait for the rest of their frame."""
        return len(self._held)

    def _cut(self, final: bool) -> list[Frame]:
        frames: list[Frame] = []
        held, at = self._held, 0
        while True:
            marker = _MARKER.search(held, at)
            if marker is None:
                at = len(held) if final else max(at, len(held) - _LONGEST_MARKER + 1)
                break
            at = marker.start()
            end, frame = self._frame(held, at, final)
            if frame is not None:
                frames.append(frame)
            if end == at:  # incomplete: wait
                break
            at = end
        self._held = held[at:]
        self._start += at
        while self._arrivals and self._arrivals[0][0] <= self._start:
            self._arrivals.popleft()
        return frames

    def _frame(self, held: bytes, at: int, final: bool) -> tuple[int, Frame | None]:
        """Return where to go on and the frame at a marker, if there is one; `at` again to wait for more."""
        first = held[at]
        if first == 0xB5:
            return self._ubx(held, at, final)
        if first == 0x2A:  # *
            return at + 3, self._made(Protocol.NMEA, b"", at + 3, Rejected.NO_START)
        if held.startswith(_OWN_SYNC, at):
            return self._own(held, at, final)
        if first in b"$!":
            if at + 1 == len(held) and not final:
                return at, None
            if not held[at + 1 : at + 2].isupper():
                return at + 1, None
            return self._sentence(held, at, at + 1, final)
        return self._sentence(held, at, at, final)

    def _sentence(self, held: bytes, at: int, begin: int, final: bool) -> tuple[int, Frame | None]:
        found = _END.search(held, begin, begin + LONGEST_SENTENCE)
        if found is None:
            if len(held) >= begin + LONGEST_SENTENCE:
                end = begin + LONGEST_SENTENCE
                return end, self._made(Protocol.NMEA, b"", end, Rejected.TOO_LONG)
            if not final:
                return at, None
            return len(held), self._made(Protocol.NMEA, b"", len(held), Rejected.CUT_OFF)
        end = found.start()
        body, byte = held[begin:end], held[end]
        if byte == 0x2A:  # *
            digits = held[end + 1 : end + 3]
            if not _HEX.issuperset(digits):
                return end + 1, self._made(Protocol.NMEA, body, end + 1, Rejected.BROKEN_CHECKSUM)
            if len(digits) < 2:
                if not final:
                    return at, None
                return len(held), self._made(Protocol.NMEA, body, len(held), Rejected.CUT_OFF)
            good = nmea_checksum(body) == int(digits, 16)
            return end + 3, self._made(Protocol.NMEA, body, end + 3, None if good else Rejected.CHECKSUM_DIFFERS)
        if byte == 0x24:  # $
            return end, self._made(Protocol.NMEA, body, end, Rejected.CUT_SHORT)
        why = Rejected.NO_CHECKSUM if byte in b"\r\n" else Rejected.NOT_TEXT
        return end, self._made(Protocol.NMEA, body, end, why)

    def _ubx(self, held: bytes, at: int, final: bool) -> tuple[int, Frame | None]:
        if len(held) < at + 6:
            return self._binary_wait(Protocol.UBX, held, at, final)
        length = held[at + 4] | held[at + 5] << 8
        if length > LONGEST_PAYLOAD:
            return at + 2, self._made(Protocol.UBX, held[at + 2 : at + 6], at + 6, Rejected.TOO_LONG)
        end = at + UBX_OVERHEAD + length
        if len(held) < end:
            return self._binary_wait(Protocol.UBX, held, at, final)
        body = held[at + 2 : end - 2]
        if ubx_checksum(body) != held[end - 2 : end]:
            return at + 2, self._made(Protocol.UBX, body, end, Rejected.CHECKSUM_DIFFERS)
        return end, self._made(Protocol.UBX, body, end)

    def _own(self, held: bytes, at: int, final: bool) -> tuple[int, Frame | None]:
        if len(held) < at + 6:
            return self._binary_wait(Protocol.OWN, held, at, final)
        length = held[at + 4] | held[at + 5] << 8
        if length > LONGEST_PAYLOAD:
            return at + 2, self._made(Protocol.OWN, b"", at + 6, Rejected.TOO_LONG)
        end = at + OVERHEAD + length
        if len(held) < end:
            return self._binary_wait(Protocol.OWN, held, at, final)
        body = held[at:end]
        if not own_checksum_holds(body):
            return at + 2, self._made(Protocol.OWN, b"", end, Rejected.CHECKSUM_DIFFERS)
        return end, self._made(Protocol.OWN, body, end)

    def _binary_wait(self, protocol: Protocol, held: bytes, at: int, final: bool) -> tuple[int, Frame | None]:
        if not final:
            return at, None
        return at + 2, self._made(protocol, b"", len(held), Rejected.CUT_OFF)

    def _made(self, protocol: Protocol, body: bytes, end: int, rejected: Rejected | None = None) -> Frame:
        """Return a frame that ends at place `end` of the bytes held, with the arrival of its last byte."""
        position = self._start + end
        when = next((ns for after, ns in self._arrivals if after >= position), 0)
        return Frame(protocol, body, when, rejected)
