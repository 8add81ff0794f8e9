"""Logs on a timeline: every byte once and in order, at the time its sentence says; what has no time is refused."""

import math
import random
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.rehearse.log_file import LARGEST, LogFile, log_files
from workgauge.rehearse.replay import FIRST_NS, LogSource, timeline
from workgauge.values.errors import InputError
from workgauge.values.navigation import GnssFix
from workgauge.wire.stream import StreamDecoder


def nmea(body: str) -> bytes:
    check = 0
    for byte in body.encode():
        check ^= byte
    return f"${body}*{check:02X}\r\n".encode()


def clock(t: float) -> str:
    return f"{int(t // 3600) % 24:02d}{int(t % 3600 // 60):02d}{t % 60:05.2f}"


def burst(t: float, date: str | None = "070924") -> bytes:
    """A fix, its date and an untimed heading."""
    out = nmea(f"GNGGA,{clock(t)},6012.00000000,N,02454.00000000,E,4,14,0.8,25.000,M,18.000,M,1.0,0001")
    if date is not None:
        out += nmea(f"GNRMC,{clock(t)},A,6012.00000000,N,02454.00000000,E,0.1,3.0,{date},,,R")
    return out + nmea("GNHDT,45.25,T")


def written(folder: Path, data: bytes, name: str = "log") -> LogFile:
    path = folder / name
    path.write_bytes(data)
    return LogFile(path, "gnss")


def seconds(line) -> list[float]:
    return [(chunk.received_ns - FIRST_NS) * 1e-9 for chunk in line.chunks]


def test_bytes_arrive_at_their_epochs(tmp_path):
    noise = b"# a header\r\n"
    data = noise + b"".join(burst(40_000 + 0.1 * i) for i in range(20))
    line = timeline([written(tmp_path, data)])
    assert b"".join(chunk.data for chunk in line.chunks) == data
    assert seconds(line) == pytest.approx([0.1 * i for i in range(20)], abs=1e-5)
    assert line.utc and line.zero_s + FIRST_NS * 1e-9 == pytest.approx(1_725_667_200 + 40_000)
    assert line.warnings == ()


def test_latency_is_of_the_port(tmp_path):
    line = timeline([written(tmp_path, burst(1.0) + burst(2.0))], {"gnss": 0.05})
    assert seconds(line) == pytest.approx([0.05, 1.05], abs=1e-6)


def test_two_logs_meet_on_one_clock(tmp_path):
    left = written(tmp_path, b"".join(burst(40_000 + i) for i in range(4)), "left")
    right = written(tmp_path, b"".join(burst(40_000.5 + i, None) for i in range(4)), "right")
    line = timeline([left, LogFile(right.path, "gnss-right")])
    assert [chunk.port for chunk in line.chunks] == ["gnss", "gnss-right"] * 4
    assert seconds(line) == pytest.approx([0.5 * i for i in range(8)], abs=1e-5)


def test_what_comes_before_the_first_time_comes_with_it(tmp_path):
    data = nmea("GNHDT,44.0,T") + nmea("GNTXT,01,01,02,hello") + burst(7.0) + burst(8.0)
    line = timeline([written(tmp_path, data)])
    assert seconds(line) == pytest.approx([0.0, 1.0], abs=1e-6)
    assert b"".join(chunk.data for chunk in line.chunks) == data


def test_midnight_without_a_date(tmp_path):
    line = timeline([written(tmp_path, burst(86_399.0, None) + burst(0.0, None) + burst(1.0, None))])
    assert not line.utc
    assert seconds(line) == pytest.approx([0, 1, 2])


@pytest.mark.parametrize(("second", "way"), [(300.0, "back"), (9000.0, "ahead")])
def test_a_jump_in_time_is_cut_short_and_said(tmp_path, second, way):
    data = burst(1000.0) + burst(1001.0) + burst(second) + burst(second + 1.0)
    line = timeline([written(tmp_path, data)])
    assert seconds(line) == pytest.approx([0, 1, 2, 3], abs=1e-6)
    (said,) = line.warnings
    assert way in said and "log" in said


def test_sentences_a_little_out_of_order_do_not_turn_time_back(tmp_path):
    line = timeline([written(tmp_path, burst(10.0) + burst(10.2) + burst(10.1) + burst(10.3))])
    assert all(a <= b for a, b in pairwise(seconds(line)))


def test_a_log_without_times_is_refused(tmp_path):
    data = nmea("GNHDT,44.0,T") * 5 + nmea("GNGLL,6012.0,N,02454.0,E,,A,D")
    with pytest.raises(InputError, match="without times") as caught:
        timeline([written(tmp_path, data)])
    assert "log" in str(caught.value)


@given(st.integers(0, 2**32), st.integers(0, 12))
@settings(max_examples=40, deadline=None)
def test_no_byte_is_lost_whatever_lies_between(tmp_path_factory, seed, bursts):
    source = random.Random(seed)
    data = b"".join(
        source.choice([b"", source.randbytes(source.randrange(80)), b"\xb5\x62", b"$GN", b"WG\x01"]) + burst(50.0 + i)
        for i in range(bursts)
    )
    log = written(tmp_path_factory.mktemp("fuzz"), data + burst(99.0))
    line = timeline([log])
    assert b"".join(chunk.data for chunk in line.chunks) == log.path.read_bytes()
    again, whole = StreamDecoder("gnss", "m"), StreamDecoder("gnss", "m")
    fixes = [one for chunk in line.chunks for one in again.feed(chunk) if isinstance(one, GnssFix)]
    assert len(fixes) == sum(
        isinstance(one, GnssFix) for one in whole.feed(type(line.chunks[0])("gnss", 0, log.path.read_bytes()))
    )
    for fix in fixes:  # each fix arrives at its own time
        if math.isfinite(fix.time_of_day_s):
            expected = fix.time_of_day_s - (50.0 if bursts else 99.0)
            assert (fix.stamp.monotonic_ns - FIRST_NS) * 1e-9 == pytest.approx(expected, abs=1e-5)


def test_a_source_gives_each_chunk_once_its_time_has_come(tmp_path):
    line = timeline([written(tmp_path, b"".join(burst(40_000 + i) for i in range(5)))])
    source = LogSource(line)
    assert source.read(FIRST_NS - 1) == []
    assert len(source.read(FIRST_NS)) == 1
    assert source.read(FIRST_NS) == []
    assert len(source.read(FIRST_NS + 3 * 10**9 + 10**6)) == 3
    assert not source.finished
    assert len(source.read(line.end_ns)) == 1
    assert source.finished


def test_moments_gather_what_arrives_together(tmp_path):
    one = written(tmp_path, burst(1.0) + burst(2.0), "one")
    line = timeline([one, LogFile(one.path, "other")])
    assert [[chunk.port for chunk in chunks] for _, chunks in line.moments()] == [["gnss", "other"]] * 2


def test_ports_of_logs(tmp_path):
    files = [written(tmp_path, b"x", name).path for name in ("a", "b", "c=d")]
    a, b, odd = map(str, files)
    assert [log.port for log in log_files([a, b])] == ["gnss", "gnss-2"]
    assert [log.port for log in log_files([f"left={a}", b])] == ["left", "gnss"]
    assert [log.port for log in log_files([a, f"l={b}"], ("l", "r"))] == ["r", "l"]
    assert [log.port for log in log_files([odd])] == ["gnss"]
    with pytest.raises(InputError, match="more logs"):
        log_files([a, b], ("gnss",))
    with pytest.raises(InputError, match="no receiver on such a port"):
        log_files([f"middle={a}"], ("left", "right"))


def test_logs_too_large_together_are_refused(tmp_path):
    paths = []
    for name in ("one", "two"):
        path = tmp_path / name
        with path.open("wb") as file:
            file.truncate(LARGEST // 2 + 1)
        paths.append(str(path))
    with pytest.raises(InputError, match="too large"):
        log_files(paths)
    assert log_files(paths[:1])
