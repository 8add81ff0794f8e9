"""Which time a measurement is of, and which belong together: laws, whatever the order and the delay of arrivals."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.positioning.posture import Reading
from workgauge.positioning.timing import (
    Clock,
    Heard,
    Sample,
    TimedHeading,
    at_time,
    epoch_key,
    heading_of,
    whole,
)
from workgauge.values.measurements import Stamp
from workgauge.values.navigation import FixQuality, GnssError, GnssFix, GnssHeading, GnssVelocity

MS = 1_000_000
UTC0 = 1_770_000_000_000 * MS  # some epoch, whole milliseconds
LATENCY, SILENCE = 20 * MS, 500 * MS


def stamp(arrived_ms: float, epoch_ms: int | None, source: str = "gnss/GN") -> Stamp:
    return Stamp("m", round(arrived_ms * MS), source, None if epoch_ms is None else UTC0 + epoch_ms * MS)


def tod(epoch_ms: int) -> float:
    return ((UTC0 // MS + epoch_ms) % 86_400_000) / 1e3


def fix(
    arrived_ms: float, epoch_ms: int, sentence: str = "GGA", source: str = "gnss/GN", lat: float = 1.0
) -> GnssFix:
    height = math.nan if sentence == "RMC" else 50.0
    quality = FixQuality.SINGLE if sentence == "RMC" else FixQuality.FIXED
    return GnssFix(
        stamp(arrived_ms, epoch_ms, source), sentence, lat, 0.4, tod(epoch_ms), math.nan, height, 17.0, quality
    )


def error(arrived_ms: float, epoch_ms: int) -> GnssError:
    return GnssError(stamp(arrived_ms, epoch_ms), "GST", np.eye(3) * 1e-4, tod(epoch_ms))


def velocity(arrived_ms: float, epoch_ms: int | None) -> GnssVelocity:
    return GnssVelocity(stamp(arrived_ms, epoch_ms), "VTG", 1.0, 0.5, math.nan if epoch_ms is None else tod(epoch_ms))


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(0, 300), min_size=2, max_size=40), st.integers(-(10**9), 10**9))
def test_a_late_arrival_does_not_shift_its_time(delays: list[float], ahead_ms: int) -> None:
    """After the first punctual arrival every epoch has its own time, however late it arrives."""
    clock = Clock()
    delays[0] = 0.0
    for i, delay in enumerate(delays):
        epoch = UTC0 + (ahead_ms + 50 * i) * MS
        arrived = round((50 * i + 20 + delay) * MS)
        clock = clock.heard(arrived, epoch)
        assert 0 <= clock.valid_ns(arrived, epoch, LATENCY) - 50 * i * MS <= 0.5 * MS  # drift allowed for
        assert clock.valid_ns(arrived, None, LATENCY) == arrived - LATENCY


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 400), st.integers(-5000, 5000)), min_size=1, max_size=60))
def test_no_time_is_later_than_its_arrival_allows(steps: list[tuple[int, int]]) -> None:
    clock, arrived = Clock(), 0
    for wait, jump in steps:
        arrived += wait * MS
        epoch = UTC0 + arrived + jump * MS
        clock = clock.heard(arrived, epoch)
        assert clock.valid_ns(arrived, epoch, LATENCY) <= arrived - LATENCY


@pytest.mark.parametrize(("back_ms", "believed"), [(1000, True), (3000, True), (18000, True), (800, False)])
def test_a_clock_set_back_by_whole_seconds_is_believed_and_a_late_stream_is_not(back_ms: int, believed: bool) -> None:
    clock = Clock()
    for i in range(1200):
        arrived = i * 50 * MS
        epoch = UTC0 + arrived - (back_ms * MS if i >= 100 else 0)
        clock = clock.heard(arrived, epoch)
        age_ms = (arrived - LATENCY - clock.valid_ns(arrived, epoch, LATENCY)) / MS
        if 100 <= i < 119:
            assert age_ms > back_ms - 5
    assert age_ms < 1 if believed else age_ms > back_ms - 20


@pytest.mark.parametrize("order", list(itertools.permutations(range(4))))
def test_the_sentences_of_an_epoch_make_one_epoch_in_any_order(order: tuple[int, ...]) -> None:
    heard = Heard()
    messages = [fix(20, 0), fix(20, 0, "RMC"), error(20, 0), velocity(20, 0)]
    for i in order:
        heard = heard.hear(messages[i], LATENCY, SILENCE)  # type: ignore[arg-type]
    (epoch,) = heard.epochs
    assert epoch.fix is not None and epoch.fix.sentence == "GGA" and epoch.quality is FixQuality.FIXED
    assert epoch.covariance is not None and epoch.velocity is not None and epoch.valid_ns == 0
    assert whole(epoch, heard, 20 * MS, 60 * MS)


def test_an_error_that_is_sent_is_waited_for_but_not_for_ever() -> None:
    heard = Heard()
    for message in (fix(20, 0), error(22, 0), fix(70, 50)):
        heard = heard.hear(message, LATENCY, SILENCE)  # type: ignore[arg-type]
    assert not whole(heard.epochs[-1], heard, 80 * MS, 60 * MS)
    assert whole(heard.epochs[-1], heard, 131 * MS, 60 * MS)
    overtaken = heard.hear(fix(120, 100), LATENCY, SILENCE)
    assert whole(overtaken.epochs[-2], overtaken, 121 * MS, 60 * MS)
    heard = heard.hear(error(75, 50), LATENCY, SILENCE)
    assert whole(heard.epochs[-1], heard, 80 * MS, 60 * MS)


def test_one_sentence_without_a_fix_voids_the_epoch() -> None:
    lost = GnssFix(stamp(21, 0), "GLL", math.nan, math.nan, tod(0))
    for messages in ((fix(20, 0), lost), (lost, fix(20, 0))):
        heard = Heard()
        for message in messages:
            heard = heard.hear(message, LATENCY, SILENCE)
        assert heard.epochs[-1].quality is FixQuality.NONE


def test_another_talker_is_not_listened_to_while_the_first_speaks() -> None:
    heard = Heard().hear(fix(20, 0), LATENCY, SILENCE)
    heard = heard.hear(fix(70, 50, source="gnss/GP", lat=0.9), LATENCY, SILENCE)
    assert len(heard.epochs) == 1
    heard = heard.hear(fix(620, 600, source="gnss/GP", lat=0.9), LATENCY, SILENCE)
    assert heard.talker == "gnss/GP" and heard.epochs[-1].fix is not None


def test_a_message_without_time_belongs_to_the_burst_it_arrives_in() -> None:
    heard = Heard().hear(fix(20, 0), LATENCY, SILENCE).hear(velocity(25, None), LATENCY, SILENCE)
    assert len(heard.epochs) == 1 and heard.epochs[0].velocity is not None
    heard = heard.hear(velocity(400, None), LATENCY, SILENCE)
    assert len(heard.epochs) == 2 and heard.epochs[-1].key < 0


def test_the_same_coordinates_are_timed() -> None:
    heard = Heard()
    for i in range(30):
        heard = heard.hear(fix(20 + 50 * i, 50 * i, lat=1.0 if i >= 10 else 1.0 + (i + 1) * 1e-9), LATENCY, SILENCE)
    assert heard.same_for_s == pytest.approx(50e-3 * (29 - 10), abs=1e-9)


@given(st.integers(0, 86_399_999), st.integers(0, 20_000))
def test_a_key_is_the_same_with_and_without_a_date(ms: int, day: int) -> None:
    assert epoch_key((day * 86_400_000 + ms) * MS, math.nan) == epoch_key(None, ms / 1e3) == ms


def test_headings_by_time_or_by_nearness() -> None:
    def timed(valid_ms: int, epoch_ms: int | None) -> TimedHeading:
        one = GnssHeading(stamp(valid_ms + 20, epoch_ms), "HDT", 1.0)
        return TimedHeading(valid_ms * MS, epoch_key(one.stamp.epoch_ns, math.nan), one)

    (epoch,) = Heard().hear(fix(20, 0), LATENCY, SILENCE).epochs
    named, near, far = timed(300, 0), timed(30, None), timed(200, None)
    assert heading_of(epoch, [near, named, far], 100 * MS) is named
    assert heading_of(epoch, [far, near], 100 * MS) is near
    assert heading_of(epoch, [far], 100 * MS) is None


@settings(max_examples=100, deadline=None)
@given(st.floats(-3, 3), st.floats(-3, 3), st.lists(st.integers(1, 50), min_size=2, max_size=20), st.floats(0, 1))
def test_readings_between_readings_lie_on_the_line(start: float, rate: float, steps: list[int], share: float) -> None:
    times = np.cumsum(steps).tolist()
    value = [math.remainder(start + rate * t * 1e-3, 2 * math.pi) for t in times]
    samples = [Sample(t * MS, Reading(v)) for t, v in zip(times, value, strict=True)]
    t = times[0] + share * (times[-1] - times[0])
    found = at_time(samples, round(t * MS), True)
    assert found is not None
    assert found[1] < 1e-6
    assert abs(math.remainder(found[0].first - (start + rate * t * 1e-3), 2 * math.pi)) < 1e-6
    outside = at_time(samples, (times[-1] + 30) * MS, True)
    assert outside is not None and outside[1] == pytest.approx(0.03) and outside[0] == samples[-1].reading
    before = at_time(samples, (times[0] - 30) * MS, True)
    assert before is not None and before[1] == pytest.approx(0.03) and before[0] == samples[0].reading
    assert at_time([], 0, True) is None
