"""The log: what was written is read, also from a file cut anywhere; damage is said with its place."""

import io
from collections import Counter
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from workgauge.record.reader import Log, open_log
from workgauge.record.topics import Reasons, Velocities, transform
from workgauge.record.writer import LogWriter, Versions
from workgauge.values import transforms as tf
from workgauge.values.commands import ValveCommand
from workgauge.values.errors import InputError
from workgauge.values.measurements import MachinePose, Posture, Stamp
from workgauge.values.reasons import Reason, ReasonCode

SETUP = {"machine": "rre20", "tick_s": 0.01, "joints": ["swing", "boom"]}
TICK_NS = 10_000_000


def posture(k: int) -> Posture:
    return Posture.exact(Stamp("m", k * TICK_NS, "encoder"), np.random.default_rng(k).normal(size=6))


def written(path: Path, count: int = 500, finish: bool = True) -> Path:
    log = LogWriter(path, SETUP)
    for k in range(count):
        log.write("/posture", k * TICK_NS, posture(k))
        log.write("/valves", k * TICK_NS, ValveCommand(Stamp("m", k, "tick"), k, (k, -k), True))
    if finish:
        log.close()
    return path


def postures(log: Log) -> list[bytes]:
    return [value.q.tobytes() for _, _, value in log.entries("/posture")]


WANTED = [posture(k).q.tobytes() for k in range(500)]


def test_what_was_written_is_read_with_its_header(tmp_path: Path) -> None:
    log = open_log(written(tmp_path / "a.mcap"))
    assert log.cut is None and log.configuration == SETUP and log.versions == Versions.here()
    assert postures(log) == WANTED
    entries = list(log.entries())
    assert Counter(entry.topic for entry in entries) == {"/posture": 500, "/valves": 500}
    assert [entry.time_ns for entry in entries[::2]] == [k * TICK_NS for k in range(500)]
    assert entries[7].value == ValveCommand(Stamp("m", 3, "tick"), 3, (3, -3), True)


def test_other_readers_read_it(tmp_path: Path) -> None:
    with written(tmp_path / "a.mcap").open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        assert summary.statistics.message_count == 1000
        assert {one.name for one in summary.schemas.values()} == {"workgauge.Posture", "workgauge.ValveCommand"}
        assert sum(1 for _ in reader.iter_messages(topics=["/posture"])) == 500
        assert [one.name for one in reader.iter_metadata()] == ["workgauge"]


def test_a_run_that_was_never_finished_is_read_up_to_its_last_second(tmp_path: Path) -> None:
    path = written(tmp_path / "a.mcap", finish=False)
    log = open_log(path)
    found = postures(log)
    assert log.cut == path.stat().st_size and WANTED[: len(found)] == found and len(found) >= 400


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0, 1))
def test_a_file_cut_anywhere_is_read_up_to_its_last_chunk(tmp_path: Path, share: float) -> None:
    whole = tmp_path / "whole.mcap"
    if not whole.exists():
        written(whole)
    data = whole.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: int(share * len(data))])
    try:
        log = open_log(cut)
    except InputError:
        assert share * len(data) < 400  # not even the header is there
        return
    found = postures(log)
    assert found == WANTED[: len(found)]
    complete = [begin + length for begin, length in open_log(whole).chunks]
    assert len(log.chunks) == sum(end <= int(share * len(data)) for end in complete)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0, 1), flip=st.integers(1, 255))
def test_a_damaged_byte_gives_no_wrong_value(tmp_path: Path, share: float, flip: int) -> None:
    whole = tmp_path / "whole.mcap"
    if not whole.exists():
        written(whole)
    data = bytearray(whole.read_bytes())
    data[int(share * (len(data) - 1))] ^= flip
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(data)
    found: list[bytes] = []
    with suppress(InputError):
        found.extend(value.q.tobytes() for _, _, value in open_log(bad).entries("/posture"))
    assert set(found) <= set(WANTED)


@pytest.mark.parametrize("data", [b"", b"MCAP", bytes(100), b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" + bytes(50)])
def test_what_is_no_log_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "no.mcap"
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"no\.mcap"):
        open_log(path)
    with pytest.raises(InputError, match="cannot be read"):
        open_log(tmp_path / "absent.mcap")


def test_a_log_is_never_written_over(tmp_path: Path) -> None:
    path = written(tmp_path / "a.mcap", 3)
    with pytest.raises(InputError, match="already"):
        LogWriter(path, SETUP)
    with pytest.raises(InputError, match="cannot be made"):
        LogWriter(tmp_path / "no" / "a.mcap", SETUP)


class Full(io.BytesIO):
    """A disk with so much room."""

    def write(self, data: object) -> int:
        if self.tell() > 20_000:
            raise OSError("No space left on device")
        return super().write(data)  # type: ignore[arg-type]


def test_a_full_disk_silences_the_log_and_is_said_at_the_end() -> None:
    log = LogWriter(Full(), SETUP)
    for k in range(2000):
        log.write("/posture", k * TICK_NS, posture(k))
    assert log.fault is not None and "No space" in log.fault and log.lost > 0
    with pytest.raises(InputError, match="incomplete"):
        log.close()
    log.close()


def test_what_waits_in_memory_is_bounded() -> None:
    stream = io.BytesIO()
    log = LogWriter(stream, SETUP, flush_ns=10**18)
    big = Velocities(np.zeros(2000), np.zeros(2000))
    sizes = []
    for k in range(400):
        log.write("/velocities", k, big)
        sizes.append(stream.tell())
    assert len(set(sizes)) > 20  # chunks leave although no time passes


def test_clocks_that_jump_do_not_hold_the_log_back(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    log = LogWriter(path, SETUP)
    for now in (10**15, 0, 5, 10**17):
        log.write("/reasons", now, Reasons((Reason(ReasonCode.LIMIT_NEAR, "near"),), 0.5))
    assert len(list(open_log(path).entries())) >= 3


def test_quaternions_of_poses_are_right() -> None:
    rng = np.random.default_rng(5)
    for _ in range(50):
        a, b, c = rng.uniform(-np.pi, np.pi, 3)
        T = tf.rotation_z(a) @ tf.rotation_x(b) @ tf.rotation_z(c)
        shown = transform(1_500_000_000, MachinePose.exact(Stamp("m", 0, "s"), T))
        assert shown is not None and shown.data["timestamp"] == {"sec": 1, "nsec": 500_000_000}
        x, y, z, w = (shown.data["rotation"][axis] for axis in "xyzw")
        assert x * x + y * y + z * z + w * w == pytest.approx(1.0)
        v = rng.normal(size=3)
        u = np.array([x, y, z])
        turned = v + 2 * np.cross(u, np.cross(u, v) + w * v)
        assert turned == pytest.approx(T[:3, :3] @ v)
