"""Every mail delivers in order, never waits, keeps the newest, and counts what is lost."""

import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest

from workgauge.bus.memory_mail import MemoryMail, MemoryPost
from workgauge.values.errors import InputError
from workgauge.values.mail import Inbox, Letter, Mail

zenoh_mail = pytest.importorskip("workgauge.bus.zenoh_mail", reason="the cockpit's extra is not installed")

PATIENCE_S = 10.0


def free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


@dataclass
class Line:
    """Two ends of one connection, and a way to a third."""

    near: Mail
    far: Mail
    another: Callable[[], Mail]


@pytest.fixture(params=["memory", "zenoh"])
def line(request: pytest.FixtureRequest) -> Iterator[Line]:
    if request.param == "memory":
        post = MemoryPost()
        yield Line(MemoryMail(post), MemoryMail(post), lambda: MemoryMail(post))
        return
    address = f"tcp/127.0.0.1:{free_port()}"
    near = zenoh_mail.ZenohMail(listen=address)
    made = [near]

    def another() -> Mail:
        made.append(zenoh_mail.ZenohMail(connect=[address]))
        return made[-1]

    yield Line(near, another(), another)
    for one in made:
        one.close()


def gather(inbox: Inbox, enough: Callable[[list[Letter]], bool]) -> list[Letter]:
    found: list[Letter] = []
    give_up = time.monotonic() + PATIENCE_S
    while not enough(found) and time.monotonic() < give_up:
        found += inbox.read()
        time.sleep(0.002)
    return found


def joined(sender: Mail, inbox: Inbox, topic: str) -> None:
    """Wait until what is sent arrives, and until the last of it has."""
    give_up = time.monotonic() + PATIENCE_S
    while time.monotonic() < give_up:
        sender.publish(topic, b"hello")
        time.sleep(0.02)
        if inbox.read():
            break
    else:
        pytest.fail("nothing arrives")
    sender.publish(topic, b"last hello")
    gather(inbox, lambda letters: any(one.data == b"last hello" for one in letters))


def test_frames_arrive_whole_and_in_order_both_ways(line: Line) -> None:
    for sender, reader in ((line.near, line.far), (line.far, line.near)):
        inbox = reader.inbox("a/b")
        joined(sender, inbox, "a/b")
        frames = [bytes([k]) * (1 + 977 * k) for k in range(10)]
        for frame in frames:
            sender.publish("a/b", frame)
        letters = gather(inbox, lambda found: len(found) >= 10)
        assert [one.data for one in letters] == frames
        assert {one.topic for one in letters} == {"a/b"}


def test_only_its_own_topic_arrives(line: Line) -> None:
    mine, other = line.far.inbox("mine"), line.far.inbox("other")
    joined(line.near, mine, "mine")
    joined(line.near, other, "other")
    line.near.publish("other", b"2")
    line.near.publish("mine", b"1")
    assert [one.data for one in gather(mine, bool)] == [b"1"]
    assert [one.data for one in gather(other, bool)] == [b"2"]


def test_a_reader_that_does_not_read_keeps_the_newest_and_counts_the_rest(line: Line) -> None:
    inbox = line.far.inbox("busy", depth=4)
    joined(line.near, inbox, "busy")
    before = inbox.lost
    for k in range(40):
        line.near.publish("busy", str(k).encode())
        time.sleep(0.001)
    time.sleep(0.2)
    found = inbox.read()
    assert [one.data for one in found] == [b"36", b"37", b"38", b"39"]
    assert inbox.lost - before == 36


def test_reading_never_waits_and_at_most_so_many(line: Line) -> None:
    inbox = line.far.inbox("few")
    joined(line.near, inbox, "few")
    assert inbox.read() == []
    for k in range(5):
        line.near.publish("few", str(k).encode())
    time.sleep(0.2)
    assert [one.data for one in inbox.read(2)] == [b"0", b"1"]
    assert [one.data for one in inbox.read()] == [b"2", b"3", b"4"]


def test_a_letter_is_never_taken_for_younger_than_it_is(line: Line) -> None:
    """It may have lain there since the inbox was last seen empty, and is taken to have."""
    inbox = line.far.inbox("age")
    joined(line.near, inbox, "age")
    inbox.read()
    seen_empty = time.monotonic_ns()
    line.near.publish("age", b"1")
    sent = time.monotonic_ns()
    time.sleep(0.3)
    (letter,) = inbox.read()
    assert letter.received_ns <= sent
    assert letter.received_ns <= seen_empty


def test_a_closed_inbox_takes_nothing_and_nobody_minds(line: Line) -> None:
    inbox = line.far.inbox("gone")
    joined(line.near, inbox, "gone")
    inbox.close()
    line.near.publish("gone", b"1")
    still = line.far.inbox("here")
    joined(line.near, still, "here")


def test_who_leaves_does_not_disturb_those_who_stay(line: Line) -> None:
    third = line.another()
    stays, leaves = line.far.inbox("all"), third.inbox("all")
    joined(line.near, leaves, "all")
    third.close()
    joined(line.near, stays, "all")
    line.near.publish("all", b"after")
    assert gather(stays, bool)[-1].data == b"after"


def test_one_connects_to_several_and_hears_all() -> None:
    addresses = [f"tcp/127.0.0.1:{free_port()}" for _ in range(2)]
    first = zenoh_mail.ZenohMail(listen=addresses[0])
    second = zenoh_mail.ZenohMail(listen=addresses[1], connect=addresses[:1])
    third = zenoh_mail.ZenohMail(connect=addresses)
    joined(second, third.inbox("from second"), "from second")
    joined(first, third.inbox("from first"), "from first")
    joined(first, second.inbox("between"), "between")
    for one in (third, second, first):
        one.close()


def test_publishing_to_nobody_is_fine(line: Line) -> None:
    for _ in range(1000):
        line.near.publish("void", b"x" * 1000)


def test_who_connects_first_finds_the_listener_later() -> None:
    address = f"tcp/127.0.0.1:{free_port()}"
    early = zenoh_mail.ZenohMail(connect=[address])
    inbox = early.inbox("late")
    late = zenoh_mail.ZenohMail(listen=address)
    joined(late, inbox, "late")
    early.close()
    late.close()


def test_nothing_listens_beyond_loopback() -> None:
    port = free_port()
    mail = zenoh_mail.ZenohMail(listen=f"tcp/127.0.0.1:{port}")
    listening = _listening_ports()
    mail.close()
    assert (f"{0x0100007F:08X}", port) in listening
    assert not [one for one in listening if one[1] == port and one[0] != f"{0x0100007F:08X}"]


def _listening_ports() -> list[tuple[str, int]]:
    """Addresses (hexadecimal, as the kernel writes them) and ports of the listening TCP sockets."""
    try:
        lines = open("/proc/net/tcp").read().splitlines()[1:]  # noqa: SIM115
    except OSError:
        pytest.skip("no /proc/net/tcp here")
    places = [line.split()[1].split(":") for line in lines if line.split()[3] == "0A"]
    return [(place, int(port, 16)) for place, port in places]


@pytest.mark.parametrize("address", ["not an address", "tcp/127.0.0.1:99999999"])
def test_an_address_that_is_none_is_refused(address: str) -> None:
    with pytest.raises(InputError, match="address"):
        zenoh_mail.ZenohMail(listen=address)
