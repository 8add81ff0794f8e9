"""Damaged NMEA and UBX: no crash, and nothing taken from a message whose check sum does not hold."""

import functools
import math
import operator
import random
import re
from collections.abc import Iterator

import numpy as np
import pytest

from workgauge.values.arrays import frozen
from workgauge.values.measurements import Stamp
from workgauge.values.navigation import (
    AngularRate,
    FixQuality,
    GnssError,
    GnssFix,
    GnssGridFix,
    GnssHeading,
    GnssVelocity,
    Inclination,
    Measurement,
    TurnRate,
)
from workgauge.values.ports import Chunk
from workgauge.wire.framing import LONGEST_PAYLOAD, ubx_checksum
from workgauge.wire.nmea import nmea_bytes
from workgauge.wire.stream import StreamDecoder
from workgauge.wire.ubx import ubx_bytes

STAMP = Stamp("m", 0, "gnss/GN", 1_798_761_600_000_000_000)
PLACE = (math.radians(61.123456789), math.radians(-4.022222222))
FIX = GnssFix(
    STAMP, "", *PLACE, math.nan, 123.45, 103.45, 20.0, FixQuality.FIXED, 17, 0.7, 1.2, frozen(np.diag([1.0, 2, 3]))
)
VELOCITY = GnssVelocity(STAMP, "", 1.234, 4.7, math.nan, 0.02, 0.05)
HEADING = GnssHeading(STAMP, "", 2.1, math.nan, 0.01, 1.5, 0.002, FixQuality.FIXED)
ERROR = GnssError(STAMP, "", frozen([[1e-2, 2e-3, 0], [2e-3, 2e-2, 0], [0, 0, 4e-2]]))
GRID = GnssGridFix(STAMP, "", 2_500_000.1, 6_700_000.2, math.nan, 12.3, FixQuality.FIXED, 9, True)
SENTENCES = (
    nmea_bytes([FIX, VELOCITY], "RMC", "GP"),
    nmea_bytes(FIX, "GGA"),
    nmea_bytes(FIX, "GLL"),
    nmea_bytes(VELOCITY, "VTG"),
    nmea_bytes(ERROR, "GST"),
    nmea_bytes(FIX, "ZDA"),
    nmea_bytes(HEADING, "HDT", "HE"),
    nmea_bytes(HEADING, "THS"),
    nmea_bytes(TurnRate(STAMP, "", 0.1), "ROT"),
    nmea_bytes(HEADING, "PTNL,AVR"),
    nmea_bytes(FIX, "PTNL,GGK"),
    nmea_bytes(GRID, "PTNL,PJK"),
    nmea_bytes([HEADING, Inclination(STAMP, 0.1, 0.2, 0.01)], "PASHR"),
    nmea_bytes([FIX, VELOCITY], "PASHR,POS"),
)
MESSAGES = (
    ubx_bytes([FIX, VELOCITY]),
    ubx_bytes(FIX, "NAV-HPPOSLLH"),
    ubx_bytes(HEADING, "NAV-RELPOSNED"),
    ubx_bytes(ERROR, "NAV-COV"),
)
TELLING = b"$,*.\r\n0123456789GPNEWSA\xb5b\x00\x01\xff"


def mutated(data: bytes, chance: random.Random) -> bytes:
    """Between one and four of: another byte, a bit, a loss, a repetition, an insertion, a swap, a cut, a splice."""
    out = bytearray(data)
    for _ in range(chance.choice((1, 1, 1, 2, 3, 4))):
        if not out:
            break
        at, kind = chance.randrange(len(out)), chance.randrange(9)
        span = chance.choice((1, 1, 2, 5, 20))
        if kind == 0:
            out[at] = chance.randrange(256)
        elif kind == 1:
            out[at] ^= 1 << chance.randrange(8)
        elif kind == 2:
            del out[at : at + span]
        elif kind == 3:
            out[at:at] = out[at : at + span]
        elif kind == 4:
            out[at:at] = bytes(chance.choice(TELLING) for _ in range(span))
        elif kind == 5:
            other = chance.randrange(len(out))
            out[at], out[other] = out[other], out[at]
        elif kind == 6:
            out[at] = chance.choice(TELLING)
        elif kind == 7:
            del out[at:]
        else:
            other_message = chance.choice(SENTENCES + MESSAGES)
            out[at:] = other_message[chance.randrange(len(other_message)) :]
    return bytes(out)


def sound(data: bytes) -> int:
    """How many places of the data begin something with a check sum that holds; by another way than the framer's."""
    count = 0
    for found in re.finditer(rb"(?=([$!]?)([A-Z][^*$]*)\*([0-9A-Fa-f]{2}))", data):
        bare_ok = found[1] or re.match(rb"(?:[A-Z]{2}[A-Z]{3}|PTNL|PASHR),", found[2])
        if bare_ok and functools.reduce(operator.xor, found[2]) == int(found[3], 16):
            count += 1
    at = data.find(b"\xb5b")
    while at >= 0:
        end = at + 6 + int.from_bytes(data[at + 4 : at + 6], "little")
        a = b = 0
        for byte in data[at + 2 : end]:
            a = (a + byte) & 0xFF
            b = (b + a) & 0xFF
        count += len(data) >= end + 2 and data[end : end + 2] == bytes([a, b])
        at = data.find(b"\xb5b", at + 1)
    return count


def sane(m: Measurement) -> None:
    """A measurement that was accepted is within what its type says."""
    if isinstance(m, GnssFix):
        assert math.isnan(m.latitude) == math.isnan(m.longitude)
        assert math.isnan(m.latitude) or (abs(m.latitude) <= math.pi / 2 and abs(m.longitude) <= math.pi)
        assert m.quality is not FixQuality.NONE or math.isnan(m.latitude)
        assert math.isnan(m.time_of_day_s) or 0.0 <= m.time_of_day_s <= 86_401.0
        assert all(not math.isinf(x) for x in (m.height_ellipsoid_m, m.height_msl_m, m.hdop, m.correction_age_s))
        if m.covariance is not None:
            assert np.all(np.isfinite(m.covariance)) and np.all(np.diag(m.covariance) >= 0.0)
    elif isinstance(m, GnssError):
        horizontal = m.covariance[:2, :2]
        assert np.array_equal(m.covariance, m.covariance.T, equal_nan=True) and np.all(np.isfinite(horizontal))
        assert np.all(np.diag(horizontal) >= 0.0)
    elif isinstance(m, GnssHeading):
        assert math.isnan(m.heading) or 0.0 <= m.heading <= 2 * math.pi
    elif isinstance(m, GnssVelocity):
        assert math.isnan(m.course) or 0.0 <= m.course <= 2 * math.pi
        assert not math.isinf(m.speed_m_s)
    elif not isinstance(m, AngularRate):
        assert m.stamp.source


def resealed(data: bytes) -> bytes:
    """The damaged message with a check sum that fits again, if it still looks like one."""
    if data.startswith(b"$") and b"*" in data:
        body = data[1:].partition(b"*")[0]
        return b"$%b*%02X\r\n" % (body, functools.reduce(operator.xor, body, 0))
    if data.startswith(b"\xb5b") and len(data) >= 8:
        body = data[2:-2]
        body = body[:2] + (len(body) - 4).to_bytes(2, "little") + body[4:]
        return b"\xb5b" + body + ubx_checksum(body)
    return data


def cases(number: int, seed: int) -> Iterator[tuple[bytes, bytes]]:
    """Original and damaged, as many of NMEA as of UBX."""
    chance = random.Random(seed)
    for k in range(number):
        original = chance.choice(SENTENCES if k % 2 else MESSAGES)
        yield original, mutated(original, chance)


def check(number: int, seed: int) -> None:
    refused = 0
    for _, damaged in cases(number, seed):
        decoder = StreamDecoder("gnss", "m")
        found = decoder.feed(Chunk("gnss", 0, damaged))
        assert decoder.held_bytes <= len(damaged) <= LONGEST_PAYLOAD
        found += decoder.finish()
        tally = decoder.tally
        whole = sound(damaged)
        assert tally.good + tally.unknown <= whole, (damaged, tally)
        assert found == [] or tally.good, damaged
        assert sum(tally.reasons.values()) == tally.bad
        if re.search(rb"\$[A-Z]|\*[0-9A-Fa-f]{2}|\xb5b", damaged):  # something that looks like a message
            assert tally.good + tally.bad + tally.unknown, damaged
        for m in found:
            sane(m)
        refused += tally.good == 0
    assert refused > number // 2  # the damage is real
    for _, damaged in cases(number // 4, seed + 1):
        decoder = StreamDecoder("gnss", "m")
        for m in decoder.feed(Chunk("gnss", 0, resealed(damaged))) + decoder.finish():
            sane(m)


def test_damaged_messages_give_no_value_without_a_check_sum_that_holds() -> None:
    check(4_000, seed=1)


@pytest.mark.prove
def test_a_hundred_thousand_damaged_messages_give_no_value_without_a_check_sum_that_holds() -> None:
    check(100_000, seed=2)


def test_damage_does_not_reach_the_next_message() -> None:
    chance = random.Random(3)
    lost = 0
    for _ in range(1000):
        original, following = chance.choice(SENTENCES + MESSAGES), SENTENCES[1]
        at = chance.randrange(len(original))
        damaged = bytearray(original)
        damaged[at] ^= 1 << chance.randrange(8)
        decoder = StreamDecoder("gnss", "m")
        found = decoder.feed(Chunk("gnss", 0, bytes(damaged) + following)) + decoder.finish()
        lost += not any(isinstance(m, GnssFix) and m.sentence == "GGA" for m in found)
    assert lost == 0


def test_the_only_damage_a_check_sum_does_not_see_is_what_it_cannot() -> None:
    """Every single-byte change of every sentence and message is refused or leaves the meaning as it was."""
    chance = random.Random(4)
    for original in SENTENCES + MESSAGES:
        decoder = StreamDecoder("gnss", "m")
        meant = [repr(m) for m in decoder.feed(Chunk("gnss", 0, original))]
        for at in range(len(original)):
            damaged = bytearray(original)
            damaged[at] ^= chance.randrange(1, 256)
            decoder = StreamDecoder("gnss", "m")
            found = [repr(m) for m in decoder.feed(Chunk("gnss", 0, bytes(damaged))) + decoder.finish()]
            assert found == [] or found == meant, (original, at)
