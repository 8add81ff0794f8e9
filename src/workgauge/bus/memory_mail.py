"""Mail inside one process: for tests, and for a station without a page."""

import threading
import time
from collections import deque
from collections.abc import Callable

from workgauge.values.mail import Letter


class MemoryInbox:
    """Letters of one topic, the newest `depth`."""

    def __init__(self, post: "MemoryPost", topic: str, depth: int, clock: Callable[[], int]) -> None:
        self._post, self._topic, self._clock = post, topic, clock
        self._waiting: deque[bytes] = deque(maxlen=depth)
        self._lock = threading.Lock()
        self._lost = 0
        self._empty_ns = clock()

    @property
    def lost(self) -> int:
        """Letters dropped so far."""
        return self._lost

    def put(self, frame: bytes) -> None:
        """Take a frame in, the oldest going if there is no room."""
        with self._lock:
            if len(self._waiting) == self._waiting.maxlen:
                self._lost += 1
            self._waiting.append(frame)

    def read(self, at_most: int | None = None) -> list[Letter]:
        """Return what arrived since the last call, oldest first; never waits."""
        now = self._clock()
        with self._lock:
            count = len(self._waiting) if at_most is None else min(at_most, len(self._waiting))
            out = [Letter(self._topic, self._empty_ns, self._waiting.popleft()) for _ in range(count)]
            if not self._waiting:
                self._empty_ns = now
        return out

    def close(self) -> None:
        """Take in nothing more."""
        self._post.remove(self._topic, self)


class MemoryPost:
    """What the mails of one process have in common: who reads what."""

    def __init__(self, clock: Callable[[], int] = time.monotonic_ns) -> None:
        self._clock = clock
        self._readers: dict[str, list[MemoryInbox]] = {}
        self._lock = threading.Lock()

    def add(self, topic: str, depth: int) -> MemoryInbox:
        """Return a new inbox."""
        found = MemoryInbox(self, topic, depth, self._clock)
        with self._lock:
            self._readers.setdefault(topic, []).append(found)
        return found

    def remove(self, topic: str, inbox: MemoryInbox) -> None:
        """Let an inbox go; one that is gone already does not matter."""
        with self._lock:
            readers = self._readers.get(topic, [])
            if inbox in readers:
                readers.remove(inbox)

    def readers(self, topic: str) -> list[MemoryInbox]:
        """Return who reads a topic now."""
        with self._lock:
            return list(self._readers.get(topic, ()))


class MemoryMail:
    """A connection to the others of one post."""

    def __init__(self, post: MemoryPost) -> None:
        self._post = post
        self._inboxes: list[MemoryInbox] = []

    def publish(self, topic: str, frame: bytes) -> None:
        """Send a frame to whoever reads the topic now."""
        for reader in self._post.readers(topic):
            reader.put(frame)

    def inbox(self, topic: str, depth: int = 64) -> MemoryInbox:
        """Return an inbox for a topic that holds the newest `depth` letters."""
        found = self._post.add(topic, depth)
        self._inboxes.append(found)
        return found

    def close(self) -> None:
        """Leave; every inbox goes with it."""
        for one in self._inboxes:
            one.close()
        self._inboxes.clear()
