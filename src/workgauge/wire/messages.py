"""The program's own binary messages: posture, machine pose, valve command, operator intent, link sensors.

A frame is, little-endian and without padding:

| bytes | field |
|---|---|
| 2 | magic `WG` |
| 1 | version |
| 1 | kind, see `Kind` |
| 2 | payload length |
| 4 | sequence, counts up by one per sender and kind, modulo 2**32 |
| 8 | sent, the sender's monotonic clock [ns] |
| 8 | epoch, the source's own time of the measurement [ns], -2**63 if it has none |
| 32 | machine id, UTF-8, filled up with zero bytes |
| 32 | source, UTF-8, filled up with zero bytes |
| n | payload, see `payloads` |
| 4 | CRC-32 (zlib's) of everything before |

There is one way to write a value and `decode` accepts no other, so encoding what was decoded gives the same bytes.
"""

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from typing import Any, Generic, TypeVar, cast

from workgauge.values.commands import ValveCommand
from workgauge.values.errors import WireError
from workgauge.values.measurements import Intent, MachinePose, Posture, Stamp
from workgauge.values.navigation import AngularRate, EncoderReading, Inclination
from workgauge.wire.payloads import (
    pack_command,
    pack_encoder,
    pack_inclination,
    pack_intent,
    pack_pose,
    pack_posture,
    pack_rate,
    unpack_command,
    unpack_encoder,
    unpack_inclination,
    unpack_intent,
    unpack_pose,
    unpack_posture,
    unpack_rate,
)

MAGIC = b"WG"
VERSION = 1
SEQUENCE_MODULUS = 2**32
NAME_BYTES = 32
NO_EPOCH = -(2**63)

_HEADER = struct.Struct(f"<2sBBHIqq{NAME_BYTES}s{NAME_BYTES}s")
_CRC = struct.Struct("<I")
#: Smallest frame: header and check sum around an empty payload.
OVERHEAD = _HEADER.size + _CRC.size


class Kind(IntEnum):
    """What a message carries."""

    POSTURE = 1
    POSE = 2
    COMMAND = 3
    INTENT = 4
    INCLINATION = 5
    ENCODER = 6
    ANGULAR_RATE = 7


Value = Posture | MachinePose | ValveCommand | Intent | Inclination | EncoderReading | AngularRate
V_co = TypeVar("V_co", covariant=True, bound=Value)


@dataclass(frozen=True, slots=True)
class Message(Generic[V_co]):
    """One decoded frame.

    Attributes:
        value: what it carries; its stamp's `monotonic_ns` is the receiver's, its `epoch_ns` the source's.
        sequence: the sender's count.
        sent_ns: the sender's monotonic clock when the frame was made [ns]; comparable with the receiver's own clock
            only inside one process.
    """

    value: V_co
    sequence: int
    sent_ns: int


#: The one table: kind, the value's type, value -> payload, (stamp, sequence, payload) -> value.
_TABLE: tuple[tuple[Kind, type[Any], Callable[[Any], bytes], Callable[[Stamp, int, bytes], Value]], ...] = (
    (Kind.POSTURE, Posture, pack_posture, unpack_posture),
    (Kind.POSE, MachinePose, pack_pose, unpack_pose),
    (Kind.COMMAND, ValveCommand, pack_command, unpack_command),
    (Kind.INTENT, Intent, pack_intent, unpack_intent),
    (Kind.INCLINATION, Inclination, pack_inclination, unpack_inclination),
    (Kind.ENCODER, EncoderReading, pack_encoder, unpack_encoder),
    (Kind.ANGULAR_RATE, AngularRate, pack_rate, unpack_rate),
)
_PACK = {value_type: (int(kind), pack) for kind, value_type, pack, _ in _TABLE}
_UNPACK = {int(kind): unpack for kind, _, _, unpack in _TABLE}


def encode(value: Value, sequence: int | None = None) -> bytes:
    """Return the frame of a value; its stamp's `monotonic_ns` becomes the frame's `sent`.

    Args:
        value: posture, machine pose, valve command, intent or link measurement.
        sequence: the sender's count; a valve command carries its own, and only that is taken.

    Raises:
        WireError: if a name is too long or a value does not fit its field.
    """
    try:
        kind, pack = _PACK[type(value)]
    except KeyError:
        raise WireError("no message carries this type", value=type(value).__name__) from None
    if isinstance(value, ValveCommand):
        if sequence not in (None, value.sequence):
            raise WireError("a valve command carries its own sequence", element="sequence", value=sequence)
        sequence = value.sequence
    return framed(kind, value.stamp, 0 if sequence is None else sequence, pack(value))


def framed(kind: int, stamp: Stamp, sequence: int, payload: bytes) -> bytes:
    """Return the frame of a payload.

    Raises:
        WireError: if a name or the payload is too long, or a number does not fit its field.
    """
    if stamp.epoch_ns == NO_EPOCH:
        raise WireError("the epoch stands for none", element="epoch", value=stamp.epoch_ns)
    epoch = NO_EPOCH if stamp.epoch_ns is None else stamp.epoch_ns
    try:
        body = (
            _HEADER.pack(
                MAGIC,
                VERSION,
                kind,
                len(payload),
                sequence,
                stamp.monotonic_ns,
                epoch,
                _name_bytes(stamp.machine_id, "machine id"),
                _name_bytes(stamp.source, "source"),
            )
            + payload
        )
    except struct.error as error:
        raise WireError("a number does not fit its field", element="header", value=str(error)) from None
    return body + _CRC.pack(zlib.crc32(body))


def decode(frame: bytes, received_ns: int) -> Message[Value]:
    """Return the message in a frame.

    Args:
        frame: exactly one frame.
        received_ns: the receiver's monotonic clock [ns]; ages are counted from it.

    Raises:
        WireError: for anything `encode` would not have written.
    """
    kind, stamp, sequence, sent_ns, payload = unframed(frame, received_ns)
    unpack = _UNPACK.get(kind)
    if unpack is None:
        raise WireError("unknown kind", element="kind", value=kind, allowed=", ".join(str(k) for k in _UNPACK))
    return Message(unpack(stamp, sequence, payload), sequence, sent_ns)


def unframed(frame: bytes, received_ns: int) -> tuple[int, Stamp, int, int, bytes]:
    """Return kind, stamp, sequence, sender's clock [ns] and payload of a frame.

    Raises:
        WireError: for anything `framed` would not have written.
    """
    if len(frame) < OVERHEAD:
        raise WireError("frame too short", element="length", value=len(frame), allowed=f"at least {OVERHEAD} bytes")
    magic, version, kind, length, sequence, sent_ns, epoch, machine_id, source = _HEADER.unpack_from(frame)
    if magic != MAGIC:
        raise WireError("not a message of ours", element="magic", value=magic.hex(), allowed=MAGIC.hex())
    if version != VERSION:
        raise WireError("unknown version", element="version", value=version, allowed=str(VERSION))
    if len(frame) != OVERHEAD + length:
        raise WireError("wrong length", element="length", value=len(frame), allowed=str(OVERHEAD + length))
    (crc,) = _CRC.unpack_from(frame, len(frame) - _CRC.size)
    if zlib.crc32(memoryview(frame)[: -_CRC.size]) != crc:
        raise WireError("check sum differs", element="crc", value=f"{crc:08x}")
    stamp = Stamp(
        _name(machine_id, "machine id"), received_ns, _name(source, "source"), None if epoch == NO_EPOCH else epoch
    )
    return kind, stamp, sequence, sent_ns, frame[_HEADER.size : -_CRC.size]


def decode_command(frame: bytes, received_ns: int) -> Message[ValveCommand]:
    """Return the valve command in a frame; `WireError` if it is another kind of message, or none."""
    message = decode(frame, received_ns)
    if not isinstance(message.value, ValveCommand):
        raise WireError("not a valve command", element="kind", value=type(message.value).__name__)
    return cast(Message[ValveCommand], message)


@lru_cache(maxsize=64)
def _name_bytes(name: str, field: str) -> bytes:
    try:
        raw = name.encode()
    except UnicodeEncodeError:
        raise WireError("not text", element=field, value=ascii(name)) from None
    if len(raw) > NAME_BYTES or not raw or b"\0" in raw:
        raise WireError("name does not fit", element=field, value=name, allowed=f"1 to {NAME_BYTES} bytes, none zero")
    return raw


@lru_cache(maxsize=64)
def _name(raw: bytes, field: str) -> str:
    name = raw.rstrip(b"\0")
    if not name or b"\0" in name:
        raise WireError("broken name", element=field, value=raw.hex())
    try:
        return name.decode()
    except UnicodeDecodeError:
        raise WireError("broken name", element=field, value=raw.hex()) from None
