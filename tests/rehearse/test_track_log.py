"""Logs as tracks: damaged ones never crash nor invent a place; health of receivers by their own word; the page."""

import json
import math
import random
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.geodesy.crs import ProjectedCrs
from workgauge.geodesy.heights import HeightModel
from workgauge.rehearse.log_file import LogFile
from workgauge.rehearse.receiver_health import WORDS, receiver_health
from workgauge.rehearse.track_log import read_track
from workgauge.rehearse.track_object import epochs_object
from workgauge.report.track_page import render, time_axis
from workgauge.values.errors import InputError

CRS = ProjectedCrs.from_epsg(3879)
SENTENCE = HeightModel.from_sentence()


def nmea(body: str) -> bytes:
    check = 0
    for byte in body.encode():
        check ^= byte
    return f"${body}*{check:02X}\r\n".encode()


def clock(t: float) -> str:
    return f"{int(t // 3600) % 24:02d}{int(t % 3600 // 60):02d}{t % 60:05.2f}"


def gga(t, minutes=12.0, quality=4, talker="GN", age="1.0"):
    place = f"60{minutes:011.8f},N,02454.00000000,E" if quality else ",,,"
    return nmea(f"{talker}GGA,{clock(t)},{place},{quality},14,0.8,25.000,M,18.000,M,{age},0001")


def zda(t, day="07"):
    return nmea(f"GNZDA,{clock(t)},{day},09,2024,00,00")


def read(tmp_path_factory, data, port="gnss"):
    path = tmp_path_factory.mktemp("log") / "log"
    path.write_bytes(data)
    return read_track([LogFile(path, port)], CRS, SENTENCE)


@pytest.fixture
def track_of(tmp_path_factory):
    return lambda data: read(tmp_path_factory, data)


def test_fixed_after_ten_in_a_row_and_lost_with_the_fix(track_of):
    good = b"".join(gga(100 + 0.1 * i, 12 + 1e-7 * i) for i in range(20))
    bad = b"".join(gga(102 + 0.1 * i, quality=0) for i in range(3))
    states = receiver_health(track_of(good + bad))
    assert states[:9] == ["stop"] * 9
    assert states[10:20] == ["fixed"] * 10
    late = receiver_health(track_of(good + gga(140.0, quality=0)))
    assert late[-1] == "stop"


def test_float_and_single_by_what_they_are_worth(track_of):
    drive = [gga(100 + 0.1 * i, 12 + 1e-7 * i, quality=q) for q in (5,) for i in range(20)]
    assert receiver_health(track_of(b"".join(drive)))[-1] == "float"
    single = [gga(100 + 0.1 * i, 12 + 1e-7 * i, quality=1) for i in range(20)]
    assert receiver_health(track_of(b"".join(single)))[-1] == "stop"


def test_each_receiver_is_judged_by_itself(track_of):
    data = b"".join(
        gga(100 + 0.1 * i, 12 + 1e-7 * i) + gga(100 + 0.1 * i, 12.001, quality=1, talker="GP") for i in range(20)
    )
    track = track_of(data)
    last = dict(zip(track.sources, receiver_health(track), strict=True))
    assert last == {"gnss/GN": "fixed", "gnss/GP": "stop"}


def test_no_time_no_judgement(track_of):
    track = track_of(nmea("GNGLL,6012.0,N,02454.0,E,,A,D"))
    assert receiver_health(track) == [None]
    assert math.isnan(track.t_s[0])


def test_dates_count_back_and_over_midnight(track_of):
    track = track_of(gga(86_399.5) + gga(0.5, 12.1) + zda(0.5, "08") + gga(1.5, 12.2))
    midnight = 1_725_753_600.0
    np.testing.assert_allclose(track.t_s - midnight, [-0.5, 0.5, 1.5], atol=1e-5)


def test_pauses_are_cut_out_of_the_axis(track_of):
    early = b"".join(gga(100 + 0.1 * i, 12 + 1e-7 * i) for i in range(30))
    later = b"".join(gga(900 + 0.1 * i, 12 + 1e-7 * i) for i in range(30))
    axis = time_axis(track_of(early + later))
    assert axis.end < 7.0
    ((words, place),) = axis.pauses
    assert words == "797 s pause" and 2.9 < place < 3.5
    assert (np.diff(axis.t) > 0).all()


def test_the_page_draws_what_is_there_and_says_what_is_not(track_of):
    track = track_of(b"".join(gga(100 + 0.1 * i, 12 + 1e-6 * i, quality=4 if i > 9 else 5) for i in range(30)))
    page = render(track, receiver_health(track), WORDS)
    assert len(re.findall(r'class="fix q4"', page)) == 20 and len(re.findall(r'class="fix q5"', page)) == 10
    assert "grid heading: the log says nothing of it" in page
    assert 'class="state stop"' in page and "above mean sea level" in page
    assert "nan" not in page.lower().replace("ordinance", "")


def test_one_epoch_makes_a_page(track_of):
    track = track_of(gga(100.0))
    assert "<svg" in render(track, receiver_health(track), WORDS)


_CLEAN = b"".join(gga(100 + 0.1 * i, 12 + 1e-4 * i) + zda(100 + 0.1 * i) for i in range(12))


@given(st.integers(0, 2**32), st.integers(1, 60))
@settings(max_examples=150, deadline=None)
def test_damaged_logs_never_crash_and_every_refusal_is_counted(tmp_path_factory, seed, damages):
    source = random.Random(seed)
    data = bytearray(_CLEAN)
    for _ in range(damages):
        at = source.randrange(len(data))
        what = source.random()
        if what < 0.4:
            data[at] = source.randrange(256)
        elif what < 0.7:
            del data[at : at + source.randrange(1, 12)]
        else:
            data[at:at] = source.randbytes(source.randrange(1, 8))
    try:
        track = read(tmp_path_factory, bytes(data))
    except InputError:
        return
    told = json.loads(json.dumps(epochs_object(track, receiver_health(track), WORDS), allow_nan=False))
    assert sum(told["rejected"].values()) == told["sentences"]["bad"]


@given(st.integers(0, len(_CLEAN) - 1), st.integers(1, 255))
@settings(max_examples=150, deadline=None)
def test_one_damaged_byte_never_gives_a_false_place(tmp_path_factory, at, change):
    """One wrong byte never keeps an exclusive or, so each place read is one that was sent."""
    data = bytearray(_CLEAN)
    data[at] ^= change
    track = read(tmp_path_factory, bytes(data))
    true = {round(60 + (12 + 1e-4 * i) / 60, 9) for i in range(12)}
    lat = np.degrees(track.latitude[np.isfinite(track.latitude)])
    assert {round(float(one), 9) for one in lat} <= true
