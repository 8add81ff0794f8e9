"""The interfaces between rooms that must not see each other."""

from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class Chunk:
    """Bytes as they arrived: on which port, when on the receiver's monotonic clock [ns]."""

    port: str
    received_ns: int
    data: bytes


#: The port on which a plant with perfect sensors sends finished values: our own wire frames, one per chunk.
VALUES_PORT = "values"


class Plant(Protocol):
    """A machine, real or simulated: valve command bytes in, sensor bytes out."""

    def write(self, frame: bytes) -> None:
        """Take one valve command frame; it acts from now until the next."""
        ...

    def advance(self, dt_s: float) -> None:
        """Let `dt_s` seconds pass, in substeps of the plant's own choosing."""
        ...

    def read(self) -> list[Chunk]:
        """Return what arrived on its ports since the last call, oldest first."""
        ...
