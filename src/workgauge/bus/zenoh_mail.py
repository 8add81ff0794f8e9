"""Mail between processes over Zenoh, peer to peer: nothing to start, loopback only unless told otherwise.

Whoever is to be heard by another listens or connects to it, and goes on trying until it is there; nobody passes on
what others tell each other. Scouting by multicast and gossip is off.
Frames are dropped, never waited for, where a reader's link is full; what arrives is kept by Zenoh itself in a ring of
the newest, so that no thread of Python's runs for it and a flood costs the reader nothing but the ring.
"""

import json
import struct
import time
from collections.abc import Callable, Sequence
from typing import Any

import zenoh

from workgauge.values.errors import InputError
from workgauge.values.mail import Letter

#: Goes with every frame: who sent it, and its count of the topic.
_TAG = struct.Struct("<QI")
_COUNT = 2**32

#: Links that are full drop at once [us]; the data queue is as long as Zenoh allows.
_SETTINGS: dict[str, Any] = {
    "mode": "peer",
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
    "transport/link/tx/queue/size/data": 16,
    "transport/shared_memory/enabled": False,
    "connect/timeout_ms": -1,
    "connect/exit_on_failure": False,
    "connect/retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2},
}


class ZenohInbox:
    """Letters of one topic, the newest `depth`."""

    def __init__(self, session: Any, topic: str, depth: int, clock: Callable[[], int]) -> None:
        self._topic, self._clock = topic, clock
        self._subscriber = session.declare_subscriber(topic, zenoh.handlers.RingChannel(depth))
        self._counts: dict[int, int] = {}
        self._lost = 0
        self._empty_ns = clock()

    @property
    def lost(self) -> int:
        """Letters that never came or were dropped here, as far as later ones of the same sender tell."""
        return self._lost

    def read(self, at_most: int | None = None) -> list[Letter]:
        """Return what arrived since the last call, oldest first; never waits."""
        now = self._clock()
        out: list[Letter] = []
        while at_most is None or len(out) < at_most:
            sample = self._subscriber.try_recv()
            if sample is None:
                self._empty_ns = now
                break
            self._note(sample)
            out.append(Letter(self._topic, self._empty_ns, sample.payload.to_bytes()))
        return out

    def _note(self, sample: Any) -> None:
        """Count what is missing before this one."""
        tag = sample.attachment
        raw = b"" if tag is None else tag.to_bytes()
        if len(raw) != _TAG.size:
            return
        sender, count = _TAG.unpack(raw)
        before = self._counts.get(sender)
        if before is not None:
            self._lost += (count - before - 1) % _COUNT
        elif len(self._counts) >= 256:
            self._counts.clear()
        self._counts[sender] = count

    def close(self) -> None:
        """Take in nothing more."""
        self._subscriber.undeclare()


def _config(listen: str | None, connect: Sequence[str]) -> Any:
    """Return Zenoh's configuration for one process."""
    config = zenoh.Config()
    for name, value in _SETTINGS.items():
        config.insert_json5(name, json.dumps(value))
    config.insert_json5("listen/endpoints", json.dumps([] if listen is None else [listen]))
    config.insert_json5("connect/endpoints", json.dumps(list(connect)))
    return config


class ZenohMail:
    """A connection to the other processes.

    Args:
        listen: where to be reached (`tcp/127.0.0.1:7447`), None not to be. connect: whom to connect to; tried again
            until they are there, and again when they are lost. clock: monotonic [ns].

    Raises:
        InputError: if the address cannot be listened on, or is none.
    """

    def __init__(
        self, *, listen: str | None = None, connect: Sequence[str] = (), clock: Callable[[], int] = time.monotonic_ns
    ) -> None:
        try:
            self._session = zenoh.open(_config(listen, connect))
        except zenoh.ZError as error:
            raise InputError(
                "the address between the processes cannot be used",
                element="bus",
                value=listen or ", ".join(connect),
                allowed="one that is free, as tcp/127.0.0.1:7447",
            ) from error
        self._clock = clock
        self._id = time.time_ns() ^ id(self) & 0xFFFF_FFFF
        self._publishers: dict[str, Any] = {}
        self._counts: dict[str, int] = {}
        self._inboxes: list[ZenohInbox] = []

    def publish(self, topic: str, frame: bytes) -> None:
        """Send a frame to whoever reads the topic now; whoever is too slow misses it."""
        publisher = self._publishers.get(topic)
        if publisher is None:
            publisher = self._session.declare_publisher(topic, congestion_control=zenoh.CongestionControl.DROP)
            self._publishers[topic] = publisher
        count = self._counts.get(topic, 0)
        self._counts[topic] = (count + 1) % _COUNT
        publisher.put(frame, attachment=_TAG.pack(self._id & 0xFFFF_FFFF_FFFF_FFFF, count))

    def inbox(self, topic: str, depth: int = 64) -> ZenohInbox:
        """Return an inbox for a topic that holds the newest `depth` letters."""
        found = ZenohInbox(self._session, topic, depth, self._clock)
        self._inboxes.append(found)
        return found

    def close(self) -> None:
        """Leave; every inbox goes with it."""
        self._inboxes.clear()
        self._session.close()  # type: ignore[no-untyped-call]
