"""Frames between processes: published on a topic by whoever has them, read without waiting by whoever asked."""

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class Letter:
    """One frame as it arrived.

    Attributes:
        topic: it was published on. data: the frame.
        received_ns: not later than its arrival, on the reader's monotonic clock [ns]: the inbox was empty then.
    """

    topic: str
    received_ns: int
    data: bytes


class Inbox(Protocol):
    """Letters on one topic; where nobody collects them the oldest go first."""

    @property
    def lost(self) -> int:
        """How many letters were dropped so far because nobody collected them in time."""
        ...

    def read(self, at_most: int | None = None) -> list[Letter]:
        """Return what arrived since the last call, oldest first, at most so many; never waits."""
        ...

    def close(self) -> None:
        """Take in nothing more."""
        ...


class Mail(Protocol):
    """A connection to the other processes. Nothing in it waits for anybody."""

    def publish(self, topic: str, frame: bytes) -> None:
        """Send a frame to whoever reads the topic now; whoever is too slow misses it."""
        ...

    def inbox(self, topic: str, depth: int = 64) -> Inbox:
        """Return an inbox for a topic that holds the newest `depth` letters."""
        ...

    def close(self) -> None:
        """Leave; every inbox goes with it."""
        ...
