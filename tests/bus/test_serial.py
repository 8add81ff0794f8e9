"""The serial port over a pseudo-terminal: what goes in comes out, nothing waits, unplugging is said."""

import os
import threading
import time
import tty
from collections.abc import Callable
from itertools import pairwise

import pytest

from workgauge.bus import serial as module
from workgauge.bus.serial import SerialPort
from workgauge.values.errors import InputError

SENTENCE = b"$GPGLL,5012.790800,N,00806.879600,W,130711,A,D*5B\r\n"


@pytest.fixture
def terminal(pseudo_terminals):
    """The far end's file descriptor and the near end's device name."""
    far, near = os.openpty()
    tty.setraw(near)
    tty.setraw(far)
    name = os.ttyname(near)
    yield far, name
    for end in (far, near):
        try:
            os.close(end)
        except OSError:
            continue


def until(condition: Callable[[], object], within_s: float = 10.0) -> None:
    """Wait for a condition; the limit only ends a test that has failed already."""
    end = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < end, "never happened"
        time.sleep(0.005)


def gathered(port: SerialPort, wanted: int) -> list:
    chunks = []
    until(lambda: chunks.extend(port.read()) or sum(len(one.data) for one in chunks) >= wanted)
    return chunks


def test_bytes_come_through_as_they_are(terminal):
    far, name = terminal
    sent = SENTENCE * 20 + bytes(range(256))
    with SerialPort(name, port="gnss-left") as port:
        threading.Thread(target=os.write, args=(far, sent), daemon=True).start()
        chunks = gathered(port, len(sent))
    assert b"".join(one.data for one in chunks) == sent
    assert {one.port for one in chunks} == {"gnss-left"}
    assert all(a.received_ns <= b.received_ns for a, b in pairwise(chunks))
    assert port.lost_bytes == 0


def test_the_stamp_is_the_clocks(terminal):
    far, name = terminal
    with SerialPort(name, clock=lambda: 4711) as port:
        os.write(far, SENTENCE)
        assert {one.received_ns for one in gathered(port, len(SENTENCE))} == {4711}


def test_asking_an_empty_port_gives_nothing_at_once(terminal):
    _, name = terminal
    with SerialPort(name) as port:
        assert [port.read() for _ in range(1000)] == [[]] * 1000
        assert port.fault is None


def test_a_late_reader_loses_the_oldest_and_knows_it(terminal):
    far, name = terminal
    with SerialPort(name, queue_bytes=200) as port:
        for i in range(40):
            os.write(far, b"%03d" % i + b"x" * 47)
            until(lambda i=i: port.lost_bytes + port._waiting_bytes >= 50 * (i + 1))
        kept = b"".join(one.data for one in port.read())
        assert 0 < len(kept) <= 200
        assert kept.endswith(b"039" + b"x" * 47)
        assert port.lost_bytes == 40 * 50 - len(kept)


def test_unplugging_is_a_fault_in_words_and_no_bytes(terminal):
    far, name = terminal
    with SerialPort(name) as port:
        os.write(far, SENTENCE)
        gathered(port, len(SENTENCE))
        os.close(far)
        until(lambda: port.fault)
        assert name in port.fault
        assert port.read() == []


def test_a_device_that_comes_back_is_read_again(pseudo_terminals, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "REOPEN_S", 0.02)
    link = tmp_path / "receiver"

    def plug() -> tuple[int, int]:
        far, near = os.openpty()
        tty.setraw(near)
        link.symlink_to(os.ttyname(near))
        return far, near

    far, near = plug()
    with SerialPort(str(link)) as port:
        link.unlink()
        os.close(far)
        os.close(near)
        until(lambda: port.fault)
        far, near = plug()
        until(lambda: port.fault is None)
        os.write(far, SENTENCE)
        assert b"".join(one.data for one in gathered(port, len(SENTENCE))) == SENTENCE
    os.close(far)
    os.close(near)


def test_closing_ends_the_thread_and_frees_the_device(terminal):
    far, name = terminal
    port = SerialPort(name)
    port.close()
    assert not port._thread.is_alive()
    with SerialPort(name) as again:
        os.write(far, SENTENCE)
        assert gathered(again, len(SENTENCE))


@pytest.mark.parametrize("what", ["missing", "file", "folder"])
def test_what_is_no_serial_port_is_refused(tmp_path, what):
    place = tmp_path / "device"
    if what == "file":
        place.write_bytes(SENTENCE)
    elif what == "folder":
        place.mkdir()
    with pytest.raises(InputError, match="device"):
        SerialPort(str(place))


def test_a_speed_no_device_has(terminal):
    with pytest.raises(InputError):
        SerialPort(terminal[1], -1)
