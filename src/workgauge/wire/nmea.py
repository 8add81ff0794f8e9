"""NMEA 0183 sentences to measurements and back, by the table of `nmea_table`."""

import re
from collections.abc import Sequence

from workgauge.values.errors import WireError
from workgauge.values.navigation import Measurement
from workgauge.wire.framing import Rejected, nmea_checksum
from workgauge.wire.nmea_fields import FieldError
from workgauge.wire.nmea_table import SENTENCES
from workgauge.wire.parts import Parts, Reading

_TALKER = re.compile(r"[A-Z]{2}")


def nmea_bytes(given: Measurement | Sequence[Measurement], sentence: str = "GGA", talker: str = "GN") -> bytes:
    """Return one sentence, check sum and line end included.

    Args:
        given: a measurement, or those of one epoch that share a sentence (RMC: fix and velocity; PASHR: heading and
            inclination; PASHR,POS: fix and velocity). What the sentence has no place for is left out of it. Time and
            date written are of the first one's `epoch_ns`, else the time is its `time_of_day_s`; rounded to 1 ms.
        sentence: a name of the table: `GGA`, `GLL`, `RMC`, `VTG`, `GST`, `ZDA`, `HDT`, `THS`, `ROT`, `PTNL,AVR`,
            `PTNL,GGK`, `PTNL,PJK`, `PASHR`, `PASHR,POS`. `ZDA` takes any measurement with an epoch.
        talker: two letters; proprietary sentences have none.

    Raises:
        WireError: for an unknown sentence, a measurement it does not carry, or a value that does not fit.
    """
    row = SENTENCES.get(sentence)
    if row is None:
        raise WireError("no such sentence", element="sentence", value=sentence, allowed=", ".join(SENTENCES))
    if _TALKER.fullmatch(talker) is None:
        raise WireError("not a talker", element="talker", value=talker, allowed="two capital letters")
    parts = Parts(given, sentence)
    fields = row.layout.write(row.write(parts))
    parts.done()
    head = sentence.partition(",")[0] if row.proprietary else talker + sentence
    body = ",".join([head, *fields]).encode("ascii")
    return b"$%b*%02X\r\n" % (body, nmea_checksum(body))


def sentence_name(fields: list[str]) -> tuple[str, str]:
    """Return talker and name, as the table has it, of a sentence's fields, head first."""
    head = fields[0]
    if not head.startswith("P"):
        return head[:2], head[2:]
    if len(fields) < 2 or head not in ("PTNL", "PASHR"):
        return head, head
    second = fields[1]
    if head == "PASHR" and not second[:1].isalpha():  # its attitude sentence has no name: the time comes first
        return head, head
    return head, f"{head},{second}"


def read_sentence(name: str, fields: list[str], by: Reading) -> tuple[Measurement, ...] | Rejected:
    """Return the measurements of a sentence of the table, or why there are none.

    Args:
        name: a name of the table. fields: all of them, head first. by: who said it and when it arrived.
    """
    row = SENTENCES[name]
    if len(fields) <= row.layout.least:
        return Rejected.TOO_FEW_FIELDS
    try:
        return row.read(row.layout.read(fields[1:]), by)
    except FieldError:
        return Rejected.INVALID_FIELD
