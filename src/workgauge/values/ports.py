"""The interfaces between rooms that must not see each other."""

from typing import Protocol


class Plant(Protocol):
    """A machine, real or simulated: valve command bytes in, sensor bytes out."""

    def write(self, frame: bytes) -> None:
        """Take one valve command frame; it acts from now until the next."""
        ...

    def advance(self, dt_s: float) -> None:
        """Let `dt_s` seconds pass, in substeps of the plant's own choosing."""
        ...

    def read(self) -> list[bytes]:
        """Return the sensor frames that arrived since the last call, oldest first."""
        ...
