"""What every drive does: joint velocity to integer valve openings, and the velocity that openings come to."""

from collections.abc import Sequence
from typing import Protocol


class Drive(Protocol):
    """The way from joint velocities to valves and back, each joint and direction by its own full speed."""

    @property
    def jump(self) -> tuple[tuple[int, int], ...]:
        """Largest openings (n) on the positive and negative side that do not move yet: dead bands, 0 for none."""
        ...

    def valves(
        self,
        velocity: Sequence[float],
        q: Sequence[float] | None = None,
        previous: Sequence[int] | None = None,
    ) -> tuple[int, ...]:
        """Return valve openings (n) that are no faster than `velocity` (n) [rad/s, m/s], neutral for no numbers.

        Args:
            velocity: wanted. q: (n) joint positions, None if unknown. previous: (n) the valves sent last.
        """
        ...

    def velocity(self, valves: Sequence[int], q: Sequence[float] | None = None) -> tuple[float, ...]:
        """Return the joint velocities (n) [rad/s, m/s] that valve openings (n) come to, once nothing changes."""
        ...
