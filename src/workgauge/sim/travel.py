"""Travelling: how an undercarriage gets from place to place, whatever it stands on."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from workgauge.values.arrays import Floats, frozen

#: A twist is the difference of two poses this far to either side [m].
TWIST_STEP_M = 1e-3


class Place(Protocol):
    """A place an undercarriage can stand at and travel from. Immutable."""

    @property
    def T_site_machine(self) -> Floats:
        """The pose of the undercarriage there, (4, 4), site frame [m]."""
        ...

    def moved(self, by_m: float, curvature: float) -> "Place":
        """Return the place `by_m` farther, negative backwards, steered to `curvature` [1/m], positive left.

        Where the way ends (the end of the rails, of the ground) it is as far as it leads; rails do not steer.
        """
        ...


@dataclass(frozen=True, slots=True)
class TravelDrive:
    """Speed of an undercarriage that follows what it is told as fast as it can accelerate.

    Attributes:
        speed_m_s: now, along the machine's x axis, negative backwards.
        wanted_m_s: what it was told last. curvature: how it is steered [1/m], positive left.
        acceleration_m_s2: how fast its speed can change, either way.
    """

    speed_m_s: float = 0.0
    wanted_m_s: float = 0.0
    curvature: float = 0.0
    acceleration_m_s2: float = 1.0

    def after(self, dt_s: float) -> tuple["TravelDrive", float]:
        """Return the drive `dt_s` later and the way made meanwhile [m], exactly."""
        change = self.wanted_m_s - self.speed_m_s
        ramp_s = min(abs(change) / self.acceleration_m_s2, dt_s)
        end = self.speed_m_s + math.copysign(self.acceleration_m_s2 * ramp_s, change) if change else self.speed_m_s
        if ramp_s < dt_s:
            end = self.wanted_m_s
        way = 0.5 * (self.speed_m_s + end) * ramp_s + end * (dt_s - ramp_s)
        return TravelDrive(end, self.wanted_m_s, self.curvature, self.acceleration_m_s2), way


def twist_per_metre(place: Place, curvature: float) -> Floats:
    """Return (6,) velocity of the machine frame's origin and angular velocity, site frame, at 1 m/s [1, rad/m].

    At the end of a way it is that of the side that is left; where no way is left, zero.
    """
    before, after = place.moved(-TWIST_STEP_M, curvature), place.moved(TWIST_STEP_M, curvature)
    A, B = before.T_site_machine, after.T_site_machine
    apart = float(np.linalg.norm(B[:3, 3] - A[:3, 3]))
    if apart < TWIST_STEP_M / 2:
        return frozen(np.zeros(6))
    turn = B[:3, :3] @ A[:3, :3].T
    skew = 0.5 * (turn - turn.T)
    return frozen(
        np.concatenate([B[:3, 3] - A[:3, 3], [skew[2, 1], skew[0, 2], skew[1, 0]]]) / apart,
        (6,),
    )
