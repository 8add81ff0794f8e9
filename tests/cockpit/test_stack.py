"""The real stack without a browser: a program on the page's web socket, another on the bus."""

import json
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator

import pytest

for part in ("zenoh", "viser", "starlette", "uvicorn", "websockets"):
    pytest.importorskip(part, reason="the cockpit's extra is not installed")

from stack import TOKEN, Stack, wait_until  # noqa: E402
from websockets.exceptions import ConnectionClosed, InvalidStatus  # noqa: E402
from websockets.sync.client import connect  # noqa: E402

from workgauge.cockpit.access import COOKIE  # noqa: E402
from workgauge.values.measurements import DriveMode, Intent, Levers, Stamp  # noqa: E402
from workgauge.wire.messages import encode  # noqa: E402
from workgauge.wire.station import topic  # noqa: E402

# all processes, in real time: not beside other tests
pytestmark = pytest.mark.stack


class Hand:
    """A page without a browser: reads all it is told, and says thirty times a second where its levers are."""

    def __init__(self, stack: Stack) -> None:
        where = stack.address.removeprefix("http://").rstrip("/")
        self.socket = connect(
            f"ws://{where}/link",
            origin=f"http://{where}",  # type: ignore[arg-type]
            additional_headers={"Cookie": f"{COOKIE}={TOKEN}"},
            proxy=None,
        )
        self.levers, self.enable, self.seen, self.count = [0.0] * 6, False, 0, 0
        self.told: dict[str, dict[str, object]] = {}
        self._going = True
        self._threads = [threading.Thread(target=run, daemon=True) for run in (self._read, self._speak)]
        for one in self._threads:
            one.start()
        wait_until(lambda: "snapshot" in self.told, what="a snapshot")

    def say(self, what: str, **rest: object) -> None:
        seen = {"seen": self.seen} if what == "ask" else {}
        self.socket.send(json.dumps({"say": what, **seen, **rest}))

    def _read(self) -> None:
        try:
            for text in self.socket:
                said = json.loads(text)
                self.told[said["say"]] = said["is"]
                if said["say"] == "snapshot":
                    self.seen = said["is"]["number"]
                    self.say("seen", n=self.seen)
        except ConnectionClosed:
            pass

    def _speak(self) -> None:
        try:
            while self._going:
                self.count += 1
                hands = {"n": self.count, "seen": self.seen, "mode": "joint", "levers": self.levers}
                self.say("hands", **hands, enable=self.enable)
                time.sleep(1 / 30)
        except ConnectionClosed:
            pass

    def leave(self) -> None:
        self._going = False
        self.socket.close()
        for one in self._threads:
            one.join(10.0)


@pytest.fixture
def hand(stack: Stack) -> Iterator[Hand]:
    found = Hand(stack)
    found.say("ask", id="1", kind="take")
    stack.until(lambda now: now.driver, "the seat is taken")
    found.say("ask", id="2", kind="clear")
    found.say("ask", id="3", kind="restart")
    stack.until(lambda now: now.t_s < 2.0, "back at the start", 40.0)
    found.enable = True
    stack.until(lambda now: now.enabled, "enabled")
    yield found
    found.enable = False
    found.say("ask", id="4", kind="leave")
    stack.until(lambda now: not now.driver, "the seat is free")
    found.leave()


def test_without_the_token_nothing_opens(stack: Stack) -> None:
    for path in ("", "?token=wrong", "page/main.js", "view/page-1/"):
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(stack.address + path)
    where = stack.address.removeprefix("http://").rstrip("/")
    with pytest.raises(InvalidStatus, match="403"):
        connect(f"ws://{where}/link", origin=f"http://{where}", proxy=None)  # type: ignore[arg-type]


def test_it_drives_and_the_guard_stops_it(hand: Hand, stack: Stack) -> None:
    hand.levers[0] = -0.5
    stack.until(lambda now: abs(now.allowed[0]) > 0.05, "it moves")
    now = stack.until(
        lambda now: now.held and now.held[0].scale is not None and now.held[0].scale < 0.05, "held", 60.0
    )
    assert now.held[0].limit == "Pole P1-12"
    hand.levers[0] = 0.0


def test_it_stops_when_it_falls_silent_and_goes_on_only_when_enabled_anew(hand: Hand, stack: Stack) -> None:
    hand.levers[0] = 0.5
    stack.until(lambda now: any(now.valves), "it moves")
    speak, hand.say = hand.say, lambda *_, **__: None  # type: ignore[method-assign, assignment]
    now = stack.until(lambda now: not any(now.valves), "silence stops it")
    assert any(one.code == "stale_intent" for one in now.held) and not now.stopped
    stack.until(lambda now: not now.enabled, "the gate closes")
    hand.say = speak  # type: ignore[method-assign]
    for _ in range(5):
        assert not any(stack.now().valves), "the hands are still on: that is not enough"


def test_nonsense_and_floods_on_the_bus_are_counted_and_change_nothing(hand: Hand, stack: Stack) -> None:
    hand.levers[0] = 0.2
    before = stack.until(lambda now: any(now.valves), "it moves")
    name, mail = stack.plan.machine_id, stack.mail
    good = encode(Intent(Stamp(name, 1, "box"), DriveMode.JOINT, Levers(-1.0), True), 1)
    other = encode(Intent(Stamp("other", 1, before.driver), DriveMode.JOINT, Levers(-1.0), True), 2**31)
    for _ in range(200):
        mail.publish(topic(name, "request"), b"{" * 60)
        for frame in (b"\x00" * 60, good + bytes(4000), good, other):
            mail.publish(topic(name, "intent"), frame)

    def more(now, *causes: str) -> bool:
        return all(getattr(now.heard, cause) > getattr(before.heard, cause) for cause in causes)

    now = stack.until(lambda now: more(now, "malformed", "oversized", "not_driver", "invalid"), "it is counted")
    assert now.driver == before.driver and now.enabled and any(now.valves)
    for _ in range(20_000):
        mail.publish(topic(name, "intent"), good)
    now = stack.until(lambda now: more(now, "flooding", "lost"), "the flood is counted")
    assert now.driver == before.driver and now.enabled and any(now.valves)


def test_nonsense_and_floods_of_a_page_are_counted_and_change_nothing(hand: Hand, stack: Stack) -> None:
    hand.levers[0] = 0.2
    before = stack.until(lambda now: any(now.valves), "it moves")
    other = Hand(stack)
    with pytest.raises(ConnectionClosed):
        for n in range(50_000):
            other.say("hands", n=n, seen=1, mode="joint", levers=[1] * 6, enable=True)
            other.socket.send("x" * 9000 if n % 2 else "nonsense")
    other.leave()
    now = stack.now()
    assert now.driver == before.driver and now.enabled and any(now.valves)
    wait_until(lambda: {"malformed", "oversized"} <= set(hand.told.get("refused", {})), what="told to all pages")
