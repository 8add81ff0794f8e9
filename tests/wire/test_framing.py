"""Streams as they come: cut anywhere, mixed, damaged, full of noise."""

import itertools
import math
import random
import re
import struct
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.values.arrays import frozen
from workgauge.values.errors import WireError
from workgauge.values.measurements import MachinePose, Posture, Stamp
from workgauge.values.navigation import (
    AngularRate,
    EncoderReading,
    FixQuality,
    GnssError,
    GnssFix,
    GnssHeading,
    GnssVelocity,
    Inclination,
    Measurement,
)
from workgauge.values.ports import Chunk
from workgauge.wire.framing import (
    LONGEST_PAYLOAD,
    LONGEST_SENTENCE,
    Framer,
    Protocol,
    Rejected,
    nmea_checksum,
    ubx_checksum,
)
from workgauge.wire.messages import OVERHEAD, encode
from workgauge.wire.nmea import nmea_bytes
from workgauge.wire.nmea_table import SENTENCES
from workgauge.wire.stream import MOST_NAMES, StreamDecoder, Tally
from workgauge.wire.ubx import ubx_bytes
from workgauge.wire.ubx_table import MESSAGES

MS = 1_000_000
STAMP = Stamp("m", 0, "gnss/GN", 1_798_761_600_000 * MS)
FIX = GnssFix(STAMP, "", 1.0, 0.4, math.nan, 120.0, 100.0, 20.0, FixQuality.FIXED, 12, 0.7, 1.0)
VELOCITY = GnssVelocity(STAMP, "", 1.5, 2.0, climb_m_s=0.1, sigma_m_s=0.05)
HEADING = GnssHeading(STAMP, "", 1.0, math.nan, 0.01, 1.5, 0.001, FixQuality.FIXED)
ERROR = GnssError(STAMP, "", frozen([[1e-4, 0, 0], [0, 1e-4, 0], [0, 0, 4e-4]]))
TILT = Inclination(Stamp("m", 0, "tilt"), 0.01, -0.02, 0.001)
SAMPLES = (
    nmea_bytes([FIX, VELOCITY], "RMC", "GP"),
    nmea_bytes(FIX, "GGA"),
    nmea_bytes(ERROR, "GST"),
    nmea_bytes(HEADING, "HDT"),
    nmea_bytes(HEADING, "PTNL,AVR"),
    nmea_bytes(FIX, "PTNL,GGK"),
    nmea_bytes([HEADING, TILT], "PASHR"),
    b"$GPGSV,1,1,00*79\r\n",
    ubx_bytes([FIX, VELOCITY]),
    ubx_bytes(HEADING, "NAV-RELPOSNED"),
    ubx_bytes(ERROR, "NAV-COV"),
    encode(TILT, 1),
    encode(EncoderReading(Stamp("m", 0, "boom"), 1.25, 0.001), 2),
    encode(AngularRate(Stamp("m", 0, "imu"), frozen([0.1, 0.2, 0.3]), 0.01), 3),
)
NOISE = (
    b"\r\n",
    b"# a comment\r\n",
    b"\xb5",
    b"W",
    b"\x00\xff\xb5b",
    b"$",
    b"!",
    b"*",
    b"G",
    b"PTNL",
    b"$GNG",
    b"WG\x01",
)


def decoded(data: bytes, at_ns: int = 0) -> tuple[list[Measurement], Tally]:
    decoder = StreamDecoder("gnss", "m")
    found = decoder.feed(Chunk("gnss", at_ns, data)) + decoder.finish()
    return found, decoder.tally


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.sampled_from(SAMPLES) | st.sampled_from(NOISE) | st.binary(max_size=30), max_size=8),
    st.lists(st.integers(0, 600), max_size=12),
)
def test_any_cut_of_the_stream_gives_the_same_measurements(pieces: list[bytes], cuts: list[int]) -> None:
    data = b"".join(pieces)
    whole, tally = decoded(data)
    decoder = StreamDecoder("gnss", "m")
    found: list[Measurement] = []
    places = [0, *sorted(c % (len(data) + 1) for c in cuts), len(data)]
    for start, end in itertools.pairwise(places):
        found += decoder.feed(Chunk("gnss", 0, data[start:end]))
    found += decoder.finish()
    assert [repr(m) for m in found] == [repr(m) for m in whole]
    assert decoder.tally == tally


def test_everything_mixed_is_read_byte_by_byte_and_stamped_when_its_last_byte_came() -> None:
    data = b"".join(SAMPLES)
    ends, place = set(), 0
    for sample in SAMPLES:
        place += len(sample)
        ends.add(place - 2 if sample.endswith(b"\r\n") else place)
    decoder = StreamDecoder("gnss", "m")
    found: list[Measurement] = []
    for k, byte in enumerate(data):
        found += decoder.feed(Chunk("gnss", k + 1, bytes([byte])))
    assert decoder.tally.good == len(SAMPLES) - 1 and decoder.tally.unknown == 1 and decoder.tally.bad == 0
    assert {m.stamp.monotonic_ns for m in found} <= ends
    assert [type(m).__name__ for m in found[:2]] == ["GnssFix", "GnssVelocity"]
    assert {m.stamp.source for m in found} == {
        *("gnss/GP", "gnss/GN", "gnss/PTNL", "gnss/PASHR", "gnss/UBX"),
        *("tilt", "boom", "imu"),
    }


def test_a_message_held_up_behind_a_false_header_keeps_the_time_it_came() -> None:
    decoder = StreamDecoder("gnss", "m")
    assert decoder.feed(Chunk("gnss", 10, b"\xb5b\x01\x99\x00\x02")) == []
    assert decoder.feed(Chunk("gnss", 20, SAMPLES[1])) == []
    (found,) = decoder.feed(Chunk("gnss", 30, bytes(600)))
    assert found.stamp.monotonic_ns == 20
    assert decoder.tally.reasons == {"check sum differs": 1}


@pytest.mark.parametrize("sample", [s for s in SAMPLES if s.startswith((b"$GN", b"$P", b"$GP"))])
def test_a_sentence_whose_dollar_is_lost_is_read(sample: bytes) -> None:
    if b"GSV" in sample:
        return
    found, tally = decoded(b"noise" + sample[1:])
    assert tally.good == 1 and tally.bad == 0 and found


def test_a_stream_that_starts_in_the_middle_of_a_sentence_says_so() -> None:
    _, tally = decoded(SAMPLES[1][20:] + SAMPLES[1])
    assert (tally.good, tally.reasons) == (1, {"the beginning is missing": 1})


def sentence(body: bytes) -> bytes:
    return b"$" + body + b"*%02X\r\n" % nmea_checksum(body)


GGA = b"GNGGA,132819.60,4134.49795459,N,09345.03431408,W,2,10,0.9,278.161,M,-31.442,M,6.6,0133"


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"$" + GGA + b"*00\r\n", Rejected.CHECKSUM_DIFFERS),
        (b"$" + GGA + b"\r\n", Rejected.NO_CHECKSUM),
        (b"$" + GGA + b"*3)\r\n", Rejected.BROKEN_CHECKSUM),
        (b"$" + GGA + b"*\r\n", Rejected.BROKEN_CHECKSUM),
        (b"$" + GGA[:30] + b"\x80" + GGA[30:] + b"\r\n", Rejected.NOT_TEXT),
        (b"$" + GGA[:30] + sentence(GGA[:5] + b",1"), Rejected.CUT_SHORT),
        (b"$" + GGA, Rejected.CUT_OFF),
        (b"$" + GGA + b"*6", Rejected.CUT_OFF),
        (b"$A" + b"x" * LONGEST_SENTENCE, Rejected.TOO_LONG),
        (sentence(b"GNGGA,132819.60"), Rejected.TOO_FEW_FIELDS),
        (b"\xb5b\x01\x07\x5c\x00", Rejected.CUT_OFF),
        (b"\xb5b\x01\x07\xff\xff", Rejected.TOO_LONG),
        (SAMPLES[8][:-1] + b"\x00", Rejected.CHECKSUM_DIFFERS),
        (b"WG\x01\x05\xff\xff", Rejected.TOO_LONG),
        (SAMPLES[11][:-1] + b"\x00", Rejected.CHECKSUM_DIFFERS),
        (SAMPLES[11][:-1], Rejected.CUT_OFF),
        (encode(Inclination(Stamp("other", 0, "tilt"), 0.0, 0.0)), Rejected.OTHER_MACHINE),
    ],
)
def test_each_rejected_sentence_is_counted_with_its_reason(data: bytes, why: Rejected) -> None:
    found, tally = decoded(data)
    assert found == [] and tally.good == 0 and tally.reasons.get(str(why)) == 1
    assert sum(tally.reasons.values()) == tally.bad


def test_a_forged_frame_of_ours_is_refused() -> None:
    import zlib

    body = bytearray(encode(TILT)[:-4])
    body[3] = 200
    found, tally = decoded(bytes(body) + struct.pack("<I", zlib.crc32(body)))
    assert found == [] and tally.reasons == {"frame is invalid": 1}


def test_frames_of_ours_that_are_no_measurements_are_counted_as_unknown() -> None:
    posture = Posture.exact(Stamp("m", 0, "sensors"), frozen([0.0]))
    pose = MachinePose.exact(
        Stamp("m", 0, "sensors"), frozen([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    )
    found, tally = decoded(encode(posture) + encode(pose))
    assert found == [] and tally.unknown == 2 and tally.bad == 0


@pytest.mark.parametrize(
    "body",
    [
        GGA.replace(b"132819.60", b"242819.60"),
        GGA.replace(b"132819.60", b"13281"),
        GGA.replace(b"4134.49795459", b"4160.0"),
        GGA.replace(b"4134.49795459", b"9100.0"),
        GGA.replace(b"4134.49795459", b"4e3"),
        GGA.replace(b"4134.49795459", b"nan"),
        GGA.replace(b"4134.49795459", b"41 34.4"),
        GGA.replace(b"4134.49795459", b""),
        GGA.replace(b",N,", b",X,"),
        GGA.replace(b",N,", b",,"),
        GGA.replace(b"09345.03431408", b"18100.0"),
        GGA.replace(b",2,10,", b",A,10,"),
        GGA.replace(b"278.161", b"inf"),
        GGA.replace(b"278.161", b"1_0"),
        GGA.replace(b"278.161", b"9" * 400),
        b"GNRMC,132819.60,A,4134.4,N,09345.0,W,0.1,1.0,320120,,,A",
        b"GNRMC,132819.60,X,4134.4,N,09345.0,W,0.1,1.0,310120,,,A",
        b"GNZDA,132819.60,31,02,2020,00,00",
        b"GNROT,1.0,X",
        b"GNTHS,1.0,X",
        b"GNGST,132819.60,,-1.0,1.0,0.0,1.0,1.0,1.0",
        b"PTNL,GGK,102939.00,133110,5000.9,N,00827.6,E,5,09,1.9,EHT1.0,M",
        b"PTNL,GGK,102939.00,051910,5000.9,N,00827.6,E,5,09,1.9,150.790,M",
        b"PASHR,,,,",
    ],
)
def test_a_sentence_with_a_field_that_cannot_be_is_refused_whole(body: bytes) -> None:
    found, tally = decoded(sentence(body))
    assert found == [] and tally.good == 0
    assert tally.reasons in ({"a field is invalid": 1}, {"too few fields": 1})


def test_a_ubx_message_that_cannot_be_is_refused() -> None:
    def ubx(body: bytes) -> bytes:
        return b"\xb5b" + body + ubx_checksum(body)

    pvt = bytearray(SAMPLES[8][2:-2])
    pvt[4 + 6] = 13  # month
    assert decoded(ubx(bytes(pvt)))[1].reasons == {"a field is invalid": 1}
    assert decoded(ubx(b"\x01\x07\x04\x00abcd"))[1].reasons == {"wrong length": 1}
    cov = bytearray(SAMPLES[10][2:-2])
    cov[4 + 16 : 4 + 20] = struct.pack("<f", math.nan)
    assert decoded(ubx(bytes(cov)))[1].reasons == {"a field is invalid": 1}
    version_0 = ubx(b"\x01\x3c\x28\x00" + bytes(40))
    assert decoded(version_0)[1].unknown == 1


def test_an_unpadded_longitude_and_a_bare_head_are_read() -> None:
    body = b"GPGGA,132819,401.33,S,401.33,W,4,10,,,,,,,"
    (fix,) = decoded(sentence(body)[1:])[0]
    assert isinstance(fix, GnssFix)
    assert math.degrees(fix.longitude) == pytest.approx(-(4 + 1.33 / 60), abs=1e-12)
    assert math.degrees(fix.latitude) == pytest.approx(-(4 + 1.33 / 60), abs=1e-12)


def test_a_quality_beyond_the_standard_is_other() -> None:
    for number in (b"9", b"12"):
        (fix,) = decoded(sentence(GGA.replace(b",2,10,", b"," + number + b",10,")))[0]
        assert isinstance(fix, GnssFix) and fix.quality is FixQuality.OTHER


@pytest.mark.parametrize(
    ("status", "mode", "quality"),
    [
        ("A", "", FixQuality.SINGLE),
        ("A", "A", FixQuality.SINGLE),
        ("A", "D", FixQuality.DIFFERENTIAL),
        ("A", "P", FixQuality.PPS),
        ("A", "R", FixQuality.FIXED),
        ("A", "F", FixQuality.FLOAT),
        ("A", "E", FixQuality.DEAD_RECKONING),
        ("A", "M", FixQuality.MANUAL),
        ("A", "S", FixQuality.SIMULATED),
        ("A", "N", FixQuality.NONE),
        ("A", "x", FixQuality.OTHER),
        ("V", "A", FixQuality.NONE),
        ("V", "E", FixQuality.NONE),
        ("", "", FixQuality.NONE),
    ],
)
def test_status_and_mode_letters_say_the_quality(status: str, mode: str, quality: FixQuality) -> None:
    for body in (
        f"GNRMC,132819.60,{status},4134.4,N,09345.0,W,0.1,1.0,180320,,,{mode}",
        f"GNGLL,4134.4,N,09345.0,W,132819.60,{status},{mode}",
    ):
        fix = decoded(sentence(body.encode()))[0][0]
        assert isinstance(fix, GnssFix) and fix.quality is quality
        assert math.isnan(fix.latitude) == (quality is FixQuality.NONE)


@pytest.mark.parametrize(
    ("number", "quality"),
    [
        (0, 0),
        (1, 1),
        (2, 5),
        (3, 4),
        (4, 2),
        (5, 2),
        (6, 5),
        (7, 4),
        (8, 5),
        (9, 4),
        (12, 5),
        (13, 2),
        (15, 5),
        (77, 9),
    ],
)
def test_trimbles_numbers_are_its_own(number: int, quality: int) -> None:
    for body in (
        f"PTNL,GGK,102939.00,051910,5000.9,N,00827.6,E,{number},09,1.9,EHT150.790,M",
        f"PTNL,PJK,202831.50,011112,+805083.350,N,+388997.346,E,{number},09,1.5,GHT+25.478,M",
    ):
        (fix,) = decoded(sentence(body.encode()))[0]
        assert getattr(fix, "quality") == quality  # noqa: B009


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=1100))
def test_check_sums_are_what_a_loop_gives(body: bytes) -> None:
    xor = a = b = 0
    for byte in body:
        xor ^= byte
        a = (a + byte) & 0xFF
        b = (b + a) & 0xFF
    assert nmea_checksum(body) == xor and ubx_checksum(body) == bytes([a, b])


def garbage(kind: str, size: int) -> bytes:
    noise = random.Random(7)
    if kind == "noise":
        return noise.randbytes(size)
    unit = {
        "dollars": b"$",
        "a sentence without end": b"$GNGGA" + b"1" * 500,
        "false UBX headers": b"\xb5b\x01\x07\x00\x10" + bytes(400),
        "false heads of ours": b"WG\x01\x05\x00\x10" + bytes(400),
        "letters": b"GNGNGNGPTNPASH",
        "stars": b"*",
        "sync": b"\xb5",
    }[kind]
    return (unit * (size // len(unit) + 1))[:size]


@pytest.mark.parametrize(
    "kind",
    [
        *("noise", "dollars", "a sentence without end", "false UBX headers", "false heads of ours"),
        *("letters", "stars", "sync"),
    ],
)
def test_endless_garbage_is_not_kept(kind: str) -> None:
    decoder = StreamDecoder("gnss", "m")
    for k in range(100):
        assert decoder.feed(Chunk("gnss", k, garbage(kind, 3000))) == []
        assert decoder.held_bytes <= LONGEST_PAYLOAD + OVERHEAD + 8
    decoder.finish()
    assert decoder.held_bytes == 0


def test_endlessly_different_unknown_sentences_are_not_kept_by_name() -> None:
    decoder = StreamDecoder("gnss", "m")
    for k in range(2 * MOST_NAMES):
        decoder.feed(Chunk("gnss", k, sentence(b"X%d" % k + b"Y" * 900 + b",1")))
    assert decoder.tally.unknown == 2 * MOST_NAMES == sum(decoder.tally.names.values())
    assert len(decoder.tally.names) <= MOST_NAMES + 1 and max(map(len, decoder.tally.names)) <= 16


def test_a_chunk_of_another_port_is_refused() -> None:
    with pytest.raises(WireError, match="another port"):
        StreamDecoder("gnss", "m").feed(Chunk("links", 0, b""))


def test_the_framer_gives_bodies_and_arrivals() -> None:
    framer = Framer()
    frames = framer.feed(SAMPLES[3] + SAMPLES[8], 5)
    assert [(f.protocol, f.rejected, f.received_ns) for f in frames] == [
        (Protocol.NMEA, None, 5),
        (Protocol.UBX, None, 5),
    ]
    assert re.fullmatch(rb"GNHDT,[\d.]+,T", frames[0].body) and frames[1].body == SAMPLES[8][2:-2]


def test_the_page_on_receivers_names_what_is_read_and_why_it_is_refused() -> None:
    page = (Path(__file__).parents[2] / "docs" / "receivers.md").read_text(encoding="utf-8")
    for name in (*SENTENCES, *MESSAGES):
        assert f"`{name}`" in page, name
    for why in Rejected:
        assert str(why) in page, why
    assert str(LONGEST_SENTENCE) in page and str(LONGEST_PAYLOAD) in page
