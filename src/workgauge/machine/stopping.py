"""How a machine comes to rest: per joint and direction, and how well that is known."""

import math
from dataclasses import dataclass

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.values.arrays import Floats, frozen


@dataclass(frozen=True, slots=True, eq=False)
class StoppingModel:
    """Dead time, lag and guaranteed deceleration of every joint in both directions.

    A joint's two directions are two valve sides, each with its own dead time: the speed asked for is that of the
    positive side, `dead_time` old, less that of the negative side. The joint follows it with a first-order lag and
    never changes its speed faster than its deceleration. Real values lie within `tolerance` of the model's, relative:
    dead time and lag from `1 - tolerance` to `1 + tolerance` of it, deceleration from 1 / (1 + tolerance) to
    1 + tolerance of it: a joint that stops much sooner than another stops the other's way out, too.

    Attributes:
        dead_time_s, lag_s, deceleration, tolerance: (2, n), positive direction first; deceleration in rad/s^2, m/s^2.
    """

    dead_time_s: Floats
    lag_s: Floats
    deceleration: Floats
    tolerance: Floats

    @classmethod
    def of(cls, machine: MachineModel) -> "StoppingModel":
        """Return the model of a machine's own file."""
        sides = (machine.stopping_positive, machine.stopping_negative)
        return cls(
            frozen([[one.dead_time_s for one in side] for side in sides]),
            frozen([[one.lag_s for one in side] for side in sides]),
            frozen([[one.deceleration for one in side] for side in sides]),
            frozen([[one.tolerance for one in side] for side in sides]),
        )

    @classmethod
    def ideal(cls, n: int) -> "StoppingModel":
        """Return the model of n joints that follow at once."""
        return cls(np.zeros((2, n)), np.zeros((2, n)), np.full((2, n), math.inf), np.zeros((2, n)))

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.dead_time_s.shape[1])

    def slowest(self) -> "StoppingModel":
        """Return the machine that stops latest of all within tolerance, itself without any."""
        grown = 1.0 + self.tolerance
        none = np.zeros_like(self.tolerance)
        return StoppingModel(self.dead_time_s * grown, self.lag_s * grown, self.deceleration / grown, none)

    def spread(self) -> tuple[Floats, Floats, Floats]:
        """Return the least and the greatest (2, 2, n) of dead time, lag and deceleration within tolerance."""
        less, more = 1.0 - self.tolerance, 1.0 + self.tolerance
        return (
            np.stack([self.dead_time_s * less, self.dead_time_s * more]),
            np.stack([self.lag_s * less, self.lag_s * more]),
            np.stack([self.deceleration / more, self.deceleration * more]),
        )

    def stop_travel(self, velocity: Floats) -> Floats:
        """Return how far each joint still moves, signed (n,), when all valves close at velocities (n,) [rad/s, m/s].

        `w (dead time + lag) + w^2 / (2 deceleration)`, an upper bound for the model above: while the deceleration
        binds, the lag adds less.
        """
        which = (velocity < 0.0).astype(np.intp)
        j = np.arange(self.n)
        time = self.dead_time_s[which, j] + self.lag_s[which, j]
        return np.asarray(velocity * time + velocity * np.abs(velocity) / (2.0 * self.deceleration[which, j]))

    def horizon_s(self, speed_positive: Floats, speed_negative: Floats, settled: float = 1e-3) -> float:
        """Return the time within which any motion has come to rest, to the share `settled` of full speed [s].

        Args:
            speed_positive, speed_negative: (n,) highest speeds.
        """
        slow = self.slowest()
        speeds = np.stack([speed_positive, speed_negative])
        braking = speeds / slow.deceleration
        times = slow.dead_time_s + braking + slow.lag_s * math.log(1.0 / settled)
        return float(times.max())
