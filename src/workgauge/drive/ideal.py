"""The ideal drive: joint speed in proportion to the valve, full valve at full speed, no dead band, no dead time."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from workgauge.machine.model import MachineModel
from workgauge.values.commands import VALVE_FULL


@dataclass(frozen=True, slots=True)
class IdealDrive:
    """Joint velocities to valves and back, each joint and direction by its own full speed.

    Attributes:
        speed_positive, speed_negative: (n) joint speed at the full valve, both above 0 [rad/s, m/s].
    """

    speed_positive: tuple[float, ...]
    speed_negative: tuple[float, ...]

    @classmethod
    def of(cls, machine: MachineModel) -> "IdealDrive":
        """Return the drive of a machine."""
        return cls(tuple(machine.speed_positive.tolist()), tuple(machine.speed_negative.tolist()))

    @property
    def jump(self) -> tuple[tuple[int, int], ...]:
        """Return zeros (n): every opening moves."""
        return ((0, 0),) * len(self.speed_positive)

    def valves(
        self,
        velocity: Sequence[float],
        q: Sequence[float] | None = None,
        previous: Sequence[int] | None = None,
    ) -> tuple[int, ...]:
        """Return the largest valve openings (n) that are no faster than `velocity` (n) [rad/s, m/s].

        Rounded towards zero and at most full. If any speed is not a number, all are neutral. Neither the posture `q`
        nor the valves before matter.
        """
        if not all(map(math.isfinite, velocity)):
            return (0,) * len(self.speed_positive)
        return tuple(
            _opening(v, positive) if v > 0.0 else -_opening(-v, negative)
            for v, positive, negative in zip(velocity, self.speed_positive, self.speed_negative, strict=True)
        )

    def velocity(self, valves: Sequence[int], q: Sequence[float] | None = None) -> tuple[float, ...]:
        """Return the joint velocities (n) [rad/s, m/s] that valve openings (n) give, in any posture."""
        return tuple(
            _speed(valve, positive) if valve > 0 else -_speed(-valve, negative)
            for valve, positive, negative in zip(valves, self.speed_positive, self.speed_negative, strict=True)
        )


def _speed(opening: int, full: float) -> float:
    return opening / VALVE_FULL * full


def _opening(speed: float, full: float) -> int:
    """Return the largest opening whose speed, as `_speed` computes it, does not exceed `speed`."""
    if speed >= full:
        return VALVE_FULL
    opening = int(speed / full * VALVE_FULL) + 1
    while _speed(opening, full) > speed:
        opening -= 1
    return opening
