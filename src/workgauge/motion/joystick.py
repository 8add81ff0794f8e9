"""Two joysticks: dead zone, feel, ramp and the lever patterns."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from workgauge.machine.model import MachineModel
from workgauge.values.errors import InputError
from workgauge.values.measurements import LEVER_NAMES

Pattern = Literal["iso", "sae"]

#: Which physical lever acts as each of `LEVER_NAMES`. Machines are described in the ISO pattern (left lever swing and
#: stick, right lever boom and bucket); SAE exchanges boom and stick.
_PATTERNS: dict[str, tuple[int, ...]] = {
    "iso": (0, 1, 2, 3, 4, 5),
    "sae": (0, 3, 2, 1, 4, 5),
}


@dataclass(frozen=True, slots=True)
class LeverFeel:
    """How a lever's position becomes a share of full speed.

    Attributes:
        dead_zone: positions up to here count as the middle.
        exponent: 1 for straight, more for finer control near the middle.
        pattern: `iso` or `sae`.
        ramp_s: time from the middle to full; back to the middle is immediate. 0 for none.
    """

    dead_zone: float = 0.05
    exponent: float = 1.5
    pattern: Pattern = "iso"
    ramp_s: float = 0.2

    def __post_init__(self) -> None:
        if self.pattern not in _PATTERNS:
            raise InputError(
                "unknown lever pattern", element="pattern", value=self.pattern, allowed=", ".join(_PATTERNS)
            )
        for name, fine, allowed in (
            ("dead_zone", 0.0 <= self.dead_zone < 1.0, "0 to below 1"),
            ("exponent", 1.0 <= self.exponent <= 5.0, "1 to 5"),
            ("ramp_s", 0.0 <= self.ramp_s < float("inf"), "0 or more"),
        ):
            if not fine:
                raise InputError(
                    "lever setting out of range", element=name, value=getattr(self, name), allowed=allowed
                )


def shaped(levers: Sequence[float], feel: LeverFeel) -> tuple[float, ...]:
    """Return the six shares of full speed in [-1, 1] of lever positions in [-1, 1], both in the order `LEVER_NAMES`.

    Odd, never falling, zero in the dead zone and one at the stop.
    """
    return tuple(_shaped(levers[i], feel.dead_zone, feel.exponent) for i in _PATTERNS[feel.pattern])


def _shaped(position: float, dead_zone: float, exponent: float) -> float:
    beyond = (abs(position) - dead_zone) / (1.0 - dead_zone)
    if beyond <= 0.0:
        return 0.0
    share: float = min(beyond, 1.0) ** exponent
    return share if position > 0.0 else -share


def ramped_levers(previous: Sequence[float], wanted: Sequence[float], step: float) -> tuple[float, ...]:
    """Return `wanted`, no value farther out than `step` beyond the previous one; inwards at once, sides from zero."""
    return tuple(
        min(value, max(before, 0.0) + step) if value > 0.0 else max(value, min(before, 0.0) - step)
        for before, value in zip(previous, wanted, strict=True)
    )


def joint_velocity(shares: Sequence[float], machine: MachineModel) -> list[float]:
    """Return the joint velocities (n) [rad/s, m/s] of lever shares: each lever's share of its joints' full speed."""
    velocity = []
    for lever, sign, positive, negative in _levers(machine):
        share = sign * shares[lever] if lever >= 0 else 0.0
        velocity.append(share * (positive if share > 0.0 else negative))
    return velocity


@functools.lru_cache(maxsize=16)
def _levers(machine: MachineModel) -> tuple[tuple[int, float, float, float], ...]:
    """Return which lever (-1: none) moves each joint, in which sense, and its full speeds, positive and negative."""
    which = [-1 if lever is None else LEVER_NAMES.index(lever) for lever in machine.levers]
    speeds = machine.speed_positive.tolist(), machine.speed_negative.tolist()
    return tuple(zip(which, machine.lever_signs.tolist(), *speeds, strict=True))


def tool_twist(shares: Sequence[float], speed: float, turn: float) -> list[float]:
    """Return the tool's twist (6) [m/s, rad/s], linear then angular, in the machine's axes, of lever shares.

    Left lever: forward is forward, right is to the right. Right lever: forward lowers, to the right turns the tool
    outwards about the machine's y axis, as opening a bucket does. Rollers: left about the x axis, right about z.
    """
    left_x, left_y, right_x, right_y, left_roller, right_roller = shares
    return [
        left_y * speed,
        -left_x * speed,
        -right_y * speed,
        left_roller * turn,
        -right_x * turn,
        right_roller * turn,
    ]
