"""UBX messages to measurements and back, by the table of `ubx_table`."""

from collections.abc import Sequence

from workgauge.values.errors import WireError
from workgauge.values.navigation import Measurement
from workgauge.wire.framing import UBX_SYNC, Rejected, ubx_checksum
from workgauge.wire.nmea_fields import FieldError
from workgauge.wire.parts import Parts, Reading
from workgauge.wire.ubx_table import MESSAGES

_NAMES = {bytes(row.number): row.name for row in MESSAGES.values()}
_RELPOSNED_0_SIZE = 40  # version 0: a vector from a base that stands, which says nothing of a machine's heading


def ubx_bytes(given: Measurement | Sequence[Measurement], message: str = "NAV-PVT") -> bytes:
    """Return one message, frame and check sum included.

    Args:
        given: a measurement, or those of one epoch that share a message (NAV-PVT: fix, velocity and error;
            NAV-HPPOSLLH: fix and error). All but NAV-PVT need an epoch: they carry GPS time of week alone, which is
            written with the 18 leap seconds since 2017.
        message: `NAV-PVT`, `NAV-HPPOSLLH`, `NAV-RELPOSNED` or `NAV-COV`.

    Raises:
        WireError: for an unknown message, a measurement it does not carry, or a value that does not fit.
    """
    row = MESSAGES.get(message)
    if row is None:
        raise WireError("no such message", element="message", value=message, allowed=", ".join(MESSAGES))
    parts = Parts(given, message)
    payload = row.payload.write(row.write(parts))
    parts.done()
    body = bytes(row.number) + len(payload).to_bytes(2, "little") + payload
    return UBX_SYNC + body + ubx_checksum(body)


def ubx_name(body: bytes) -> str | None:
    """Return the table's name of a frame's body (class, id, length, payload), None if it has none."""
    name = _NAMES.get(body[:2])
    if name == "NAV-RELPOSNED" and len(body) == 4 + _RELPOSNED_0_SIZE and body[4] == 0:
        return None
    return name


def read_message(name: str, payload: bytes, by: Reading) -> tuple[Measurement, ...] | Rejected:
    """Return the measurements of a message of the table, or why there are none."""
    row = MESSAGES[name]
    if len(payload) != row.payload.size:
        return Rejected.WRONG_LENGTH
    try:
        return row.read(row.payload.read(payload), by)
    except FieldError:
        return Rejected.INVALID_FIELD
