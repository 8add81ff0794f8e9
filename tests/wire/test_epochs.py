"""Times without a date get the right one."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.values.measurements import Stamp
from workgauge.values.navigation import FixQuality, GnssFix, GnssHeading, Measurement
from workgauge.values.ports import Chunk
from workgauge.wire.epochs import DAY_NS, DAY_S, WEEK_MS, EpochCarrier, gps_time_of_week, time_of_day
from workgauge.wire.nmea import nmea_bytes
from workgauge.wire.stream import StreamDecoder
from workgauge.wire.ubx import ubx_bytes

MS = 1_000_000
NEW_YEAR = 1_798_761_600_000_000_000  # 2027-01-01T00:00:00Z


def fix(epoch_ns: int, quality: FixQuality = FixQuality.FIXED) -> GnssFix:
    return GnssFix(Stamp("m", 0, "", epoch_ns), "", 1.0, 0.4, quality=quality)


def epochs(data: bytes, *, at_ns: int = 0) -> list[int | None]:
    found = StreamDecoder("gnss", "m").feed(Chunk("gnss", at_ns, data))
    return [m.stamp.epoch_ns for m in found if isinstance(m, GnssFix | GnssHeading)]


@settings(max_examples=300, deadline=None)
@given(
    st.integers(0, 40_000),
    st.floats(0.0, DAY_S - 1e-3),
    st.floats(-0.49 * DAY_S, 0.49 * DAY_S),
    st.integers(0, 10**15),
)
def test_a_time_within_half_a_day_of_the_expected_one_gets_its_day(
    day: int, seconds: float, later: float, waited_ns: int
) -> None:
    carrier = EpochCarrier()
    first = carrier.dated("gnss/GN", day, round(seconds, 3), 5)
    true = (first + waited_ns + round(later, 3) * 1_000_000_000) // MS * MS
    true = int(true)
    assert carrier.at("gnss/GN", time_of_day(true), 5 + waited_ns) == true


def test_before_any_date_nothing_has_an_epoch() -> None:
    carrier = EpochCarrier()
    assert carrier.at("gnss/GN", 10.0, 0) is None and carrier.gps_at("gnss/UBX", 10) is None
    carrier.dated("gnss/GN", 20_000, 1.0, 0)
    assert carrier.at("gnss/GN", math.nan, 0) is None
    assert carrier.gps_at("gnss/UBX", 10) is None  # a week is not a date


def test_midnight_passes_without_a_dated_sentence() -> None:
    data = nmea_bytes(fix(NEW_YEAR - 100 * MS), "RMC")
    data += b"".join(nmea_bytes(fix(NEW_YEAR + step * 50 * MS), "GGA") for step in range(-1, 3))
    assert epochs(data) == [NEW_YEAR + step * 50 * MS for step in (-2, -1, 0, 1, 2)]


def test_a_sentence_of_yesterday_that_comes_late_keeps_its_day() -> None:
    data = nmea_bytes(fix(NEW_YEAR), "RMC") + nmea_bytes(fix(NEW_YEAR - 50 * MS), "GGA")
    assert epochs(data) == [NEW_YEAR, NEW_YEAR - 50 * MS]


def test_a_leap_second_is_a_time() -> None:
    data = b"$GNRMC,235960.00,A,6107.4,N,00401.3,W,0.0,0.0,311216,,,A"
    found = StreamDecoder("gnss", "m").feed(Chunk("gnss", 0, data + b"*%02X\r\n" % xor(data[1:])))
    assert found[0].stamp.epoch_ns == 1_483_228_800_000_000_000


def xor(body: bytes) -> int:
    total = 0
    for byte in body:
        total ^= byte
    return total


@pytest.mark.parametrize("sentence", ["RMC", "ZDA", "PTNL,GGK"])
def test_each_dated_sentence_dates_what_follows_whoever_says_it(sentence: str) -> None:
    data = nmea_bytes(fix(NEW_YEAR + 1000 * MS), sentence, "GP") + nmea_bytes(fix(NEW_YEAR + 2000 * MS), "GGA", "GN")
    assert epochs(data)[-1] == NEW_YEAR + 2000 * MS


def test_a_pvt_dates_what_follows_and_names_the_week() -> None:
    data = ubx_bytes(fix(NEW_YEAR)) + nmea_bytes(fix(NEW_YEAR + 50 * MS), "GGA")
    data += ubx_bytes(fix(NEW_YEAR + 100 * MS), "NAV-HPPOSLLH")
    data += ubx_bytes(GnssHeading(Stamp("m", 0, "", NEW_YEAR + 150 * MS), "", 1.0), "NAV-RELPOSNED")
    assert epochs(data) == [NEW_YEAR + step * 50 * MS for step in range(4)]


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 3_000_000_000_000), st.integers(-WEEK_MS // 2 + 1, WEEK_MS // 2 - 1))
def test_the_week_turns_over(epoch_ms: int, later_ms: int) -> None:
    first, second = epoch_ms * MS, (epoch_ms + later_ms) * MS
    carrier = EpochCarrier()
    assert carrier.gps_dated("u", gps_time_of_week(first), first, 0) == first
    assert carrier.gps_at("u", gps_time_of_week(second)) == second


def test_the_time_of_week_is_that_of_a_receivers_own_message() -> None:
    # of a log of a ZED-F9P: 2022-10-11T11:04:24 UTC is 212682000 ms of the week
    assert gps_time_of_week(1_665_486_264_000_000_000) == 212_682_000


def test_nanoseconds_of_a_pvt_are_rounded_so_that_one_epoch_is_one() -> None:
    carrier = EpochCarrier()
    assert carrier.gps_dated("u", 1000, 5 * DAY_NS - 240_000, 0) == 5 * DAY_NS
    assert carrier.gps_at("u", 1000) == 5 * DAY_NS


def test_the_quality_of_a_high_precision_position_is_its_pvts_of_the_same_epoch() -> None:
    def qualities(*messages: bytes) -> list[FixQuality]:
        found: list[Measurement] = StreamDecoder("gnss", "m").feed(Chunk("gnss", 0, b"".join(messages)))
        return [m.quality for m in found if isinstance(m, GnssFix) and m.sentence == "NAV-HPPOSLLH"]

    high = ubx_bytes(fix(NEW_YEAR), "NAV-HPPOSLLH")
    assert qualities(high) == [FixQuality.OTHER]
    assert qualities(ubx_bytes(fix(NEW_YEAR)), high) == [FixQuality.FIXED]
    assert qualities(ubx_bytes(fix(NEW_YEAR, FixQuality.NONE)), high) == [FixQuality.NONE]
    assert qualities(ubx_bytes(fix(NEW_YEAR - 50 * MS)), high) == [FixQuality.OTHER]


def test_no_time_is_taken_from_a_fix_that_is_not_valid() -> None:
    made_up = nmea_bytes(fix(315_964_800_000 * MS, FixQuality.NONE), "RMC")
    late = nmea_bytes(fix(NEW_YEAR + 14 * 3600 * 1000 * MS, FixQuality.NONE), "GGA")
    data = nmea_bytes(fix(NEW_YEAR), "RMC") + made_up + late + nmea_bytes(fix(NEW_YEAR + 50 * MS), "GGA")
    assert epochs(data) == [NEW_YEAR, None, None, NEW_YEAR + 50 * MS]
