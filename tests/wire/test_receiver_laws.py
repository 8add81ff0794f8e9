"""What was written is read back within the message's resolution, and writing what was read changes nothing."""

import math
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pynmeagps import NMEAReader
from pyubx2 import UBXReader

from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import WireError
from workgauge.values.measurements import Stamp
from workgauge.values.navigation import (
    EncoderReading,
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
from workgauge.wire.nmea import nmea_bytes
from workgauge.wire.nmea_table import SENTENCES
from workgauge.wire.stream import StreamDecoder
from workgauge.wire.ubx import ubx_bytes
from workgauge.wire.ubx_table import MESSAGES

NAN = math.nan
Q = FixQuality
STATED = (Q.SINGLE, Q.DIFFERENTIAL, Q.FIXED, Q.FLOAT)

#: Whole milliseconds from 1980 to 2079, the years two digits can say.
epochs = st.integers(315_964_800_000, 3_471_292_800_000 - 1).map(lambda ms: ms * 1_000_000)
stamps = st.builds(Stamp, st.just("m"), st.just(0), st.just("gnss/GN"), epochs)
turns = st.floats(0.0, 2.0 * math.pi, exclude_max=True)


def maybe(low: float, high: float) -> st.SearchStrategy[float]:
    return st.just(NAN) | st.floats(low, high)


@st.composite
def covariances(draw: st.DrawFn, vertical: bool = False) -> Floats:
    """A covariance of east, north, up; correlated in the plane, with height too if wanted."""
    a = draw(st.floats(0.0, math.pi))
    major, up = draw(st.floats(0.01, 20.0)), draw(st.floats(0.01, 20.0))
    minor = draw(st.floats(0.005, 1.0)) * major
    turn = np.array([[math.sin(a), -math.cos(a), 0.0], [math.cos(a), math.sin(a), 0.0], [0.0, 0.0, 1.0]])
    full = turn @ np.diag([major**2, minor**2, up**2]) @ turn.T
    if vertical:
        full[0, 2] = full[2, 0] = draw(st.floats(-0.5, 0.5)) * math.sqrt(full[0, 0] * full[2, 2])
        full[1, 2] = full[2, 1] = draw(st.floats(-0.5, 0.5)) * math.sqrt(full[1, 1] * full[2, 2])
    return frozen(0.5 * (full + full.T))


@st.composite
def fixes(
    draw: st.DrawFn,
    stamp: Stamp,
    qualities: tuple[FixQuality, ...] = (*STATED, Q.PPS, Q.DEAD_RECKONING),
    covariance: bool = False,
) -> GnssFix:
    above, separation = draw(st.floats(-500.0, 9000.0)), draw(st.floats(-110.0, 90.0))
    return GnssFix(
        stamp,
        "",
        draw(st.floats(-math.pi / 2, math.pi / 2)),
        draw(st.floats(-math.pi, math.pi)),
        NAN,
        above + separation,
        above,
        separation,
        draw(st.sampled_from(qualities)),
        draw(st.integers(0, 60)),
        draw(maybe(0.0, 99.0)),
        draw(maybe(0.0, 119.0)),
        draw(covariances()) if covariance else None,
    )


@st.composite
def velocities(draw: st.DrawFn, stamp: Stamp) -> GnssVelocity:
    speed, course = draw(st.floats(0.0, 100.0)), draw(turns)
    return GnssVelocity(stamp, "", speed, course, NAN, draw(st.floats(-20.0, 20.0)), draw(st.floats(0.001, 5.0)))


@st.composite
def headings(draw: st.DrawFn, stamp: Stamp, qualities: tuple[FixQuality, ...]) -> GnssHeading:
    return GnssHeading(
        stamp,
        "",
        draw(turns),
        NAN,
        draw(st.floats(-1.3, 1.3)),
        draw(st.floats(0.3, 30.0)),
        draw(st.floats(1e-5, 0.1)),
        draw(st.sampled_from(qualities)),
    )


@dataclass(frozen=True)
class Law:
    """A message, what goes into it, and how near its fields come back: field name to half the last digit."""

    message: str
    parts: st.SearchStrategy[list[Measurement]]
    near: dict[type, dict[str, float]] = field(default_factory=dict)


def one(strategy: object) -> st.SearchStrategy[list[Measurement]]:
    """Measurements of one epoch: each strategy is given the stamp."""
    makers = strategy if isinstance(strategy, tuple) else (strategy,)
    return stamps.flatmap(lambda stamp: st.tuples(*[make(stamp) for make in makers]).map(list))


DEG = math.radians(1.0)
MINUTE = DEG / 60 * 0.51e-8
NMEA_PLACE = {"latitude": MINUTE, "longitude": MINUTE}
KNOTS = 0.52e-4 * 1852 / 3600
ANY = (*STATED, Q.PPS, Q.DEAD_RECKONING, Q.MANUAL, Q.SIMULATED)
TRIMBLE = STATED
NMEA = (
    Law(
        "GGA",
        one(lambda s: fixes(s, (*ANY, Q.OTHER))),
        {
            GnssFix: NMEA_PLACE
            | {
                "height_msl_m": 0.51e-4,
                "height_ellipsoid_m": 1.1e-4,
                "geoid_separation_m": 0.51e-4,
                "satellites": 0,
                "hdop": 0.51e-2,
                "correction_age_s": 0.051,
                "quality": 0,
            }
        },
    ),
    Law("GLL", one(lambda s: fixes(s, (*ANY, Q.OTHER))), {GnssFix: NMEA_PLACE | {"quality": 0}}),
    Law(
        "RMC",
        one((lambda s: fixes(s, (*ANY, Q.OTHER)), velocities)),
        {GnssFix: NMEA_PLACE | {"quality": 0}, GnssVelocity: {"speed_m_s": KNOTS, "course": 0.51e-4 * DEG}},
    ),
    Law("VTG", one(velocities), {GnssVelocity: {"speed_m_s": KNOTS, "course": 0.51e-4 * DEG}}),
    Law("GST", one(lambda s: st.builds(GnssError, st.just(s), st.just(""), covariances()))),
    Law("HDT", one(lambda s: headings(s, STATED)), {GnssHeading: {"heading": 0.51e-5 * DEG}}),
    Law(
        "THS",
        one(lambda s: headings(s, (Q.OTHER, Q.DEAD_RECKONING, Q.MANUAL, Q.SIMULATED))),
        {GnssHeading: {"heading": 0.51e-5 * DEG, "quality": 0}},
    ),
    Law(
        "ROT",
        one(lambda s: st.builds(TurnRate, st.just(s), st.just(""), st.floats(-5.0, 5.0))),
        {TurnRate: {"rate": 0.51e-4 * DEG / 60}},
    ),
    Law(
        "PTNL,AVR",
        one(lambda s: headings(s, STATED)),
        {GnssHeading: {"heading": 0.51e-5 * DEG, "pitch": 0.51e-5 * DEG, "baseline_m": 0.51e-4, "quality": 0}},
    ),
    Law(
        "PTNL,GGK",
        one(lambda s: fixes(s, TRIMBLE)),
        {GnssFix: NMEA_PLACE | {"height_ellipsoid_m": 0.51e-4, "satellites": 0, "quality": 0}},
    ),
    Law(
        "PTNL,PJK",
        one(
            lambda s: st.builds(
                GnssGridFix,
                st.just(s),
                st.just(""),
                st.floats(-1e7, 1e8),
                st.floats(-1e7, 1e7),
                st.just(NAN),
                st.floats(-500.0, 9000.0),
                st.sampled_from(TRIMBLE),
                st.integers(0, 60),
                st.booleans(),
            )
        ),
        {
            GnssGridFix: {
                "easting_m": 0.51e-4,
                "northing_m": 0.51e-4,
                "height_m": 0.51e-4,
                "quality": 0,
                "satellites": 0,
                "orthometric": 0,
            }
        },
    ),
    Law(
        "PASHR",
        one(
            (
                lambda s: headings(s, (Q.SINGLE, Q.FIXED, Q.OTHER)),
                lambda s: st.builds(
                    Inclination, st.just(s), st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(1e-4, 0.1)
                ),
            )
        ),
        {
            GnssHeading: {"heading": 0.51e-4 * DEG, "sigma": 0.51e-4 * DEG, "quality": 0},
            Inclination: {"roll": 0.51e-4 * DEG, "pitch": 0.51e-4 * DEG, "sigma": 0.51e-4 * DEG},
        },
    ),
    Law(
        "PASHR,POS",
        one((lambda s: fixes(s, (*STATED, Q.DEAD_RECKONING)), velocities)),
        {
            GnssFix: NMEA_PLACE
            | {
                "height_ellipsoid_m": 0.51e-4,
                "satellites": 0,
                "hdop": 0.51e-2,
                "correction_age_s": 0.051,
                "quality": 0,
            },
            GnssVelocity: {"speed_m_s": KNOTS, "course": 0.51e-4 * DEG, "climb_m_s": 0.51e-4},
        },
    ),
)
HEIGHTS = {"height_ellipsoid_m": 0.51e-3, "height_msl_m": 0.51e-3, "geoid_separation_m": 1.1e-3}
FINE_HEIGHTS = {name: 0.1 * near for name, near in HEIGHTS.items()}
UBX = (
    Law(
        "NAV-PVT",
        one((lambda s: fixes(s, (*STATED, Q.DEAD_RECKONING), True), velocities)),
        {
            GnssFix: HEIGHTS | {"latitude": 0.51e-7 * DEG, "longitude": 0.51e-7 * DEG, "satellites": 0, "quality": 0},
            GnssVelocity: {
                "speed_m_s": 0.51e-3,
                "course": 0.51e-5 * DEG,
                "climb_m_s": 0.51e-3,
                "sigma_m_s": 0.51e-3,
            },
        },
    ),
    Law(
        "NAV-HPPOSLLH",
        one(lambda s: fixes(s, (Q.OTHER,), True)),
        {GnssFix: FINE_HEIGHTS | {"latitude": 0.51e-9 * DEG, "longitude": 0.51e-9 * DEG, "quality": 0}},
    ),
    Law(
        "NAV-RELPOSNED",
        one(lambda s: headings(s, (Q.FIXED, Q.FLOAT, Q.DIFFERENTIAL))),
        {
            GnssHeading: {
                "heading": 0.51e-5 * DEG,
                "pitch": 1e-3,
                "baseline_m": 0.51e-4,
                "sigma": 0.51e-5 * DEG,
                "quality": 0,
            }
        },
    ),
    Law("NAV-COV", one(lambda s: st.builds(GnssError, st.just(s), st.just(""), covariances(vertical=True)))),
)
ROUND = {"longitude", "course", "heading"}
UNTIMED = {"VTG", "HDT", "THS", "ROT"}
#: Messages with fields that follow from others: written from rounded ones, their last digits may differ once.
DERIVED = {"GGA", "VTG", "GST", "NAV-PVT", "NAV-HPPOSLLH", "NAV-RELPOSNED"}


def written(law: Law, parts: list[Measurement]) -> bytes:
    return (nmea_bytes if law in NMEA else ubx_bytes)(parts, law.message)


def read(data: bytes, before: bytes = b"") -> list[Measurement]:
    """The measurements of a message; `before` says the date."""
    decoder = StreamDecoder("gnss", "m")
    decoder.feed(Chunk("gnss", 0, before))
    found = decoder.feed(Chunk("gnss", 0, data))
    assert decoder.tally.bad == decoder.tally.unknown == 0, decoder.tally
    assert decoder.held_bytes <= 5
    return found


def dated(stamp: Stamp, law: Law) -> bytes:
    """A message of a second before that says the date, as the stream's other messages would."""
    assert stamp.epoch_ns is not None
    fix = GnssFix(Stamp("m", 0, "", stamp.epoch_ns - 1_000_000_000), "", NAN, NAN)
    return nmea_bytes(fix, "ZDA") if law in NMEA else ubx_bytes(fix, "NAV-PVT")


@pytest.mark.parametrize("law", [*NMEA, *UBX], ids=lambda law: law.message)
def test_what_was_written_is_read_back_within_the_messages_resolution(law: Law) -> None:
    @settings(max_examples=100, deadline=None)
    @given(law.parts)
    def holds(parts: list[Measurement]) -> None:
        found = {type(m): m for m in read(written(law, parts), dated(parts[0].stamp, law))}
        assert set(found) == {type(p) for p in parts}
        for part in parts:
            back = found[type(part)]
            assert getattr(back, "sentence", law.message) == law.message
            assert back.stamp.epoch_ns == (None if law.message in UNTIMED else part.stamp.epoch_ns)
            for name, near in law.near.get(type(part), {}).items():
                near_number(name, getattr(part, name), getattr(back, name), near)
            covariance = getattr(part, "covariance", None)
            if covariance is not None:
                near_covariance(law.message, covariance, getattr(back, "covariance"))  # noqa: B009

    holds()


def near_number(name: str, given_: float | None, got: float | None, near: float) -> None:
    if given_ is None or math.isnan(given_):
        assert got is None or math.isnan(got), name
        return
    assert got is not None
    apart = abs(float(got) - float(given_))
    if name in ROUND:
        apart = min(apart, abs(apart - 2 * math.pi))
    assert apart <= near + 1e-12, (name, given_, got)


def near_covariance(message: str, given_: Floats, got: Floats) -> None:
    if message == "NAV-COV":
        assert got == pytest.approx(given_, rel=1e-6, abs=1e-30)
    elif message == "GST":  # sigmas of four decimals
        most = math.sqrt(np.trace(given_[:2, :2]))
        assert got[:2, :2] == pytest.approx(given_[:2, :2], rel=0.0, abs=2.2e-4 * most)
        assert math.sqrt(got[2, 2]) == pytest.approx(math.sqrt(given_[2, 2]), abs=0.51e-4)
    else:  # one accuracy for east and north, never less than either
        near = 0.51e-3 if message == "NAV-PVT" else 0.51e-4
        most = math.sqrt(max(given_[0, 0], given_[1, 1]))
        assert [math.sqrt(got[k, k]) for k in (0, 1)] == pytest.approx([most, most], abs=near)
        assert math.sqrt(got[2, 2]) == pytest.approx(math.sqrt(given_[2, 2]), abs=near)


@pytest.mark.parametrize("law", [*NMEA, *UBX], ids=lambda law: law.message)
def test_writing_what_was_read_changes_nothing(law: Law) -> None:
    @settings(max_examples=100, deadline=None)
    @given(law.parts)
    def holds(parts: list[Measurement]) -> None:
        before = dated(parts[0].stamp, law)
        if law.message in UNTIMED:
            before = b""
        first = written(law, parts)
        values = read(first, before)
        second = written(law, values)
        again = read(second, before)
        if law.message == "NAV-RELPOSNED":  # its vector and its heading round apart, by their last digits
            for name, near in law.near[GnssHeading].items():
                near_number(name, getattr(values[0], name), getattr(again[0], name), 2 * near)
            return
        assert written(law, again) == second
        if law.message not in DERIVED:
            assert second == first

    holds()


@settings(max_examples=200, deadline=None)
@given(st.sampled_from(NMEA).flatmap(lambda law: st.tuples(st.just(law), law.parts)))
def test_the_library_whose_layouts_are_used_takes_what_is_written(drawn: tuple[Law, list[Measurement]]) -> None:
    law, parts = drawn
    message = NMEAReader.parse(written(law, parts))
    if law.message in ("GGA", "GLL", "RMC", "PTNL,GGK", "PASHR,POS"):
        fix = next(p for p in parts if isinstance(p, GnssFix))
        assert math.radians(message.lat) == pytest.approx(fix.latitude, abs=3e-12)
        assert math.radians(message.lon) == pytest.approx(fix.longitude, abs=3e-12)
    if law.message == "HDT":
        heading = parts[0]
        assert isinstance(heading, GnssHeading)
        near_number("heading", heading.heading, math.radians(message.headingT), 0.51e-5 * DEG)


@settings(max_examples=200, deadline=None)
@given(st.sampled_from(UBX).flatmap(lambda law: st.tuples(st.just(law), law.parts)))
def test_the_ubx_library_reads_the_same_numbers(drawn: tuple[Law, list[Measurement]]) -> None:
    law, parts = drawn
    message = UBXReader.parse(written(law, parts))
    assert message.identity == law.message
    if law.message in ("NAV-PVT", "NAV-HPPOSLLH"):
        fix = parts[0]
        assert isinstance(fix, GnssFix)
        near = 1e-7 if law.message == "NAV-PVT" else 1e-9
        assert message.lat == pytest.approx(math.degrees(fix.latitude), abs=near)
        assert message.lon == pytest.approx(math.degrees(fix.longitude), abs=near)
        assert message.hMSL == pytest.approx(fix.height_msl_m * 1e3, abs=1.0)
    elif law.message == "NAV-RELPOSNED":
        heading = parts[0]
        assert isinstance(heading, GnssHeading)
        assert message.relPosLength == pytest.approx(heading.baseline_m * 100, abs=0.006)
        vector = (message.relPosN, message.relPosE, message.relPosD)
        assert math.sqrt(sum(x * x for x in vector)) == pytest.approx(message.relPosLength, abs=0.02)
        near_number("heading", heading.heading, math.atan2(vector[1], vector[0]) % (2 * math.pi), 2e-3)


STAMP = Stamp("m", 0, "gnss/GN", 1_700_000_000_000_000_000)
LONG_AGO = Stamp("m", 0, "gnss/GN", -1)
FIX = GnssFix(STAMP, "", 1.0, 0.4, NAN, 120.0, 100.0, 20.0, Q.FIXED, 12)
HEADING = GnssHeading(STAMP, "", 1.0, quality=Q.FIXED)


@pytest.mark.parametrize("degrees", [59.99999999999, 4 + 1.33 / 60, 0.0, 89.999999999999, 12 + 59.999999996 / 60])
def test_minutes_that_round_up_become_a_degree(degrees: float) -> None:
    fix = GnssFix(STAMP, "", math.radians(degrees), -math.radians(degrees), quality=Q.FIXED)
    (back,) = (m for m in read(nmea_bytes(fix, "GGA")))
    assert isinstance(back, GnssFix)
    assert math.degrees(back.latitude) == pytest.approx(degrees, abs=1e-10)
    assert math.degrees(back.longitude) == pytest.approx(-degrees, abs=1e-10)


def test_a_fix_of_quality_none_writes_no_position() -> None:
    for sentence in ("GGA", "GLL", "RMC", "PTNL,GGK", "PASHR,POS"):
        none = GnssFix(STAMP, "", 1.0, 0.4, quality=Q.NONE)
        data = nmea_bytes(none, sentence)
        fix = next(m for m in read(data) if isinstance(m, GnssFix))
        assert fix.quality is Q.NONE and math.isnan(fix.latitude) and math.isnan(fix.longitude)
        assert b"5717.74" in nmea_bytes(FIX, sentence) and b"5717.74" not in data
    for message in ("NAV-PVT", "NAV-HPPOSLLH"):
        fix = next(m for m in read(ubx_bytes(none, message)) if isinstance(m, GnssFix))
        assert fix.quality is Q.NONE and math.isnan(fix.latitude) and fix.covariance is None


@pytest.mark.parametrize("value", [NAN, 1.0])
def test_a_heading_that_is_lost_stays_lost(value: float) -> None:
    lost = GnssHeading(STAMP, "", value, quality=Q.NONE)
    for sentence in ("THS", "PTNL,AVR", "NAV-RELPOSNED"):
        data = ubx_bytes(lost, sentence) if sentence in MESSAGES else nmea_bytes(lost, sentence)
        (back,) = read(data)
        assert isinstance(back, GnssHeading) and math.isnan(back.heading) and back.quality is Q.NONE
    assert nmea_bytes(GnssHeading(STAMP, "", NAN), "HDT") == b"$GNHDT,,T*05\r\n"


@pytest.mark.parametrize(
    ("values", "message", "said"),
    [
        (FIX, "GSV", "no such sentence"),
        (FIX, "HDT", "needs a measurement of this kind"),
        ([FIX, HEADING], "GGA", "carries no such measurement"),
        ([FIX, FIX], "GGA", "one measurement of each kind"),
        ([], "GGA", "one measurement of each kind"),
        (GnssFix(STAMP, "", 2.0, 0.0, quality=Q.FIXED), "GGA", "not on the globe"),
        (GnssFix(STAMP, "", 1.0, 0.0, quality=Q.FIXED, hdop=math.inf), "GGA", "does not fit"),
        (GnssFix(STAMP, "", 1.0, 0.0, quality=Q.MANUAL), "PTNL,GGK", "no number for this quality"),
        (GnssFix(Stamp("m", 0, ""), "", 1.0, 0.0), "ZDA", "needs a measurement with an epoch"),
        (GnssError(STAMP, "", frozen([[1.0, 9.0, 0], [9.0, 1.0, 0], [0, 0, 1]])), "GST", "not a covariance"),
        (EncoderReading(STAMP, 1.0), "GGA", "needs a measurement of this kind"),
        (GnssFix(STAMP, "", 1.0, 0.0, height_ellipsoid_m=math.inf, quality=Q.FIXED), "PTNL,GGK", "does not fit"),
        (GnssFix(STAMP, "", 1.0, 0.0, quality=Q.FIXED, satellites=-1), "GGA", "does not fit"),
        (GnssFix(LONG_AGO, "", 1.0, 0.0, quality=Q.FIXED), "RMC", "two digits"),
        (FIX, "NAV-SAT", "no such message"),
        (HEADING, "NAV-PVT", "needs a measurement of this kind"),
        ([FIX, HEADING], "NAV-PVT", "carries no such measurement"),
        (GnssFix(STAMP, "", 1.0, 0.0, quality=Q.MANUAL), "NAV-PVT", "no number for this quality"),
        (GnssFix(STAMP, "", 1.0, 0.0, height_ellipsoid_m=3e6, quality=Q.FIXED), "NAV-PVT", "does not fit"),
        (GnssFix(STAMP, "", 1.0, 0.0, height_ellipsoid_m=math.inf, quality=Q.FIXED), "NAV-PVT", "does not fit"),
        (GnssHeading(Stamp("m", 0, ""), "", 1.0), "NAV-RELPOSNED", "needs a measurement with an epoch"),
    ],
)
def test_what_does_not_fit_is_refused(values: object, message: str, said: str) -> None:
    with pytest.raises(WireError, match=said):
        (ubx_bytes if message.startswith("NAV") else nmea_bytes)(values, message)  # type: ignore[arg-type]


def test_a_talker_is_two_letters() -> None:
    assert nmea_bytes(FIX, "GGA", "GP").startswith(b"$GPGGA,")
    for talker in ("G", "gp", "GNS", "$G"):
        with pytest.raises(WireError, match="not a talker"):
            nmea_bytes(FIX, "GGA", talker)


def test_every_row_of_both_tables_has_its_laws() -> None:
    assert {law.message for law in NMEA} | {"ZDA"} == set(SENTENCES)
    assert {law.message for law in UBX} == set(MESSAGES)
