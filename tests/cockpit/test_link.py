"""A page's web socket: what passes, in whose name, and what does not."""

import json
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("starlette", reason="the cockpit's extra is not installed")

from starlette.websockets import WebSocketDisconnect

from workgauge.cockpit.speech import heard
from workgauge.values.errors import WireError
from workgauge.values.measurements import DriveMode, Intent
from workgauge.values.station import Camera, Request, RequestKind

OWN = {"origin": "http://localhost:8600", "host": "localhost:8600"}
HANDS = {"say": "hands", "n": 1, "seen": 1, "mode": "joint", "levers": [0.5, 0, 0, 0, 0, 0], "enable": True}


def wait_for(found, enough: int = 1) -> list[object]:
    out: list[object] = []
    give_up = time.monotonic() + 5.0
    while len(out) < enough and time.monotonic() < give_up:
        out += found()
        time.sleep(0.01)
    return out


def first(socket, kind: str) -> dict[str, object]:
    for _ in range(10):
        said = socket.receive_json()
        if said["say"] == kind:
            return said["is"]
    raise AssertionError(f"no {kind}")


def test_hands_become_an_intent_in_the_pages_own_name(bench, conf) -> None:
    bench.tell(conf.a_setup(), "setup")
    bench.tell(conf.a_snapshot(1), "snapshot")
    with bench.client.websocket_connect("/link", headers=OWN) as socket:
        me = first(socket, "you")["source"]
        assert first(socket, "snapshot")["number"] == 1
        socket.send_json(HANDS)
        (intent,) = wait_for(lambda: bench.got(bench.intents))
        assert isinstance(intent, Intent)
        assert (intent.stamp.source, intent.stamp.machine_id) == (me, "rre20")
        assert (intent.mode, intent.levers.left_x, intent.enable) == (DriveMode.JOINT, 0.5, True)


def test_requests_beats_and_cameras_pass(bench, conf) -> None:
    bench.tell(conf.a_snapshot(1), "snapshot")
    with bench.client.websocket_connect("/link", headers=OWN) as socket:
        socket.send_json(
            {
                "say": "ask",
                "seen": 1,
                "id": "1",
                "kind": "guard",
                "text": "linear",
                "settings": {"stop_distance_m": 0.3},
            }
        )
        socket.send_json({"say": "seen", "n": 7})
        socket.send_json({"say": "look", "view": "cab", "dark": True, "handle": False})
        asked, beat = wait_for(lambda: bench.got(bench.requests), 2)
        assert isinstance(asked, Request) and asked.settings == (("stop_distance_m", 0.3),)
        assert isinstance(beat, Request) and (beat.kind, beat.number) == (RequestKind.BEAT, 7.0)
        (camera,) = wait_for(lambda: bench.got(bench.cameras))
        assert isinstance(camera, Camera) and camera.view == "cab"


def test_hands_of_long_ago_do_not_pass(bench, conf) -> None:
    """What a network held up is wanted no more: its page had seen nothing new for too long."""
    now = [0]
    bench.hub._clock = lambda: now[0]
    bench.tell(conf.a_setup(), "setup")
    bench.tell(conf.a_snapshot(1), "snapshot")
    with bench.client.websocket_connect("/link", headers=OWN) as socket:
        now[0] = 600_000_000
        bench.tell(conf.a_snapshot(2), "snapshot")
        socket.send_json(HANDS)
        socket.send_json(HANDS | {"seen": 99})
        socket.send_json(HANDS | {"seen": 2, "n": 5})
        time.sleep(0.3)
        (intent,) = bench.got(bench.intents)
        assert isinstance(intent, Intent)


def test_what_was_asked_long_ago_is_not_done_but_a_stop_is(bench, conf) -> None:
    now = [0]
    bench.hub._clock = lambda: now[0]
    bench.tell(conf.a_setup(), "setup")
    bench.tell(conf.a_snapshot(1), "snapshot")
    with bench.client.websocket_connect("/link", headers=OWN) as socket:
        now[0] = 600_000_000
        for kind in ("play", "clear", "run", "give", "stop", "leave", "take"):
            socket.send_json({"say": "ask", "seen": 1, "id": kind, "kind": kind})
        asked = wait_for(lambda: bench.got(bench.requests), 3)
        assert [str(one.kind) for one in asked] == ["stop", "leave", "take"]
        assert bench.hub.refused["late"] == 4


def test_a_stop_passes_whatever_else_its_page_says(bench) -> None:
    """Three seconds of hands that a network held up arrive at once, and the stop behind them."""
    with bench.client.websocket_connect("/link", headers=OWN) as socket:
        for _ in range(400):
            socket.send_json(HANDS)
        socket.send_json({"say": "ask", "seen": 1, "id": "9", "kind": "stop"})
        (asked,) = wait_for(lambda: bench.got(bench.requests))
        assert asked.kind is RequestKind.STOP
        assert bench.hub.refused["flooding"] > 100


WRONG = [
    "",
    "{}",
    "[]",
    "null",
    "NaN",
    "[" * 3000,
    "x" * 5000,
    json.dumps(HANDS | {"levers": [2, 0, 0, 0, 0, 0]}),
    json.dumps(HANDS | {"levers": [0] * 5}),
    json.dumps(HANDS | {"enable": 1}),
    json.dumps(HANDS | {"mode": "line"}),
    json.dumps(HANDS | {"source": "page-other"}),
    json.dumps(HANDS | {"n": -1}),
    json.dumps(HANDS).replace("0.5", "NaN"),
    json.dumps(HANDS).replace("0.5", "1e999"),
    json.dumps({"say": "ask", "id": "1", "kind": "stop"}),
    json.dumps({"say": "ask", "seen": 1, "id": "1", "kind": "beat"}),
    json.dumps({"say": "ask", "seen": 1, "id": "1", "kind": "fly"}),
    json.dumps({"say": "ask", "seen": 1, "id": "", "kind": "stop"}),
    json.dumps({"say": "ask", "seen": 1, "id": "1", "kind": "preview", "numbers": [0] * 13}),
    json.dumps({"say": "look", "view": "../..", "dark": True, "handle": True}),
    json.dumps({"say": ["hands"]}),
]


@pytest.mark.parametrize("text", WRONG)
def test_what_is_not_said_by_a_page_is_refused(text: str) -> None:
    with pytest.raises(WireError):
        heard(text)


@settings(max_examples=100)
@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(), lambda x: st.lists(x) | st.dictionaries(st.text(), x)
    )
)
def test_no_json_makes_anything_but_a_refusal(given_json: object) -> None:
    with pytest.raises(WireError):
        heard(json.dumps(given_json))


def test_nonsense_shows_a_page_out_and_nobody_else(bench) -> None:
    with bench.client.websocket_connect("/link", headers=OWN) as other:
        with bench.client.websocket_connect("/link", headers=OWN) as socket:
            first(socket, "you")
            for _ in range(60):
                socket.send_text("nonsense")
            with pytest.raises(WebSocketDisconnect):
                while True:
                    socket.receive_text()
        other.send_json({"say": "ask", "seen": 1, "id": "1", "kind": "stop"})
        (asked,) = wait_for(lambda: bench.got(bench.requests))
        assert isinstance(asked, Request) and asked.kind is RequestKind.STOP


def test_a_flood_is_cut_down_and_in_the_end_shown_out(bench) -> None:
    with bench.client.websocket_connect("/link", headers=OWN) as socket:
        first(socket, "you")
        for _ in range(600):
            socket.send_json({"say": "seen", "n": 1})
        time.sleep(0.5)
        assert 150 <= len(bench.got(bench.requests)) < 500
        with pytest.raises((WebSocketDisconnect, RuntimeError)):
            for _ in range(20_000):
                socket.send_json({"say": "seen", "n": 1})
            while True:
                socket.receive_text()
        assert len(bench.got(bench.requests)) < 1000


def test_a_page_that_does_not_read_gets_the_newest_when_it_does(bench, conf) -> None:
    post = bench.hub.join()
    for number in range(1, 200):
        bench.tell(conf.a_snapshot(number), "snapshot")
    assert list(post.waiting) == ["snapshot"]
    assert '"number":199,' in post.waiting["snapshot"]
