"""How the undercarriage moves, from its own solutions or a receiver's velocity, and its pose carried on to now.

The pose of the undercarriage is found at each epoch with the swing of that epoch, so a cab that swings moves nothing
here. Its velocity v and yaw rate w are the slope of a straight line through the solutions of the last `HISTORY_S`;
a receiver's own velocity, less what swing and turn do to the antenna, is taken where it is surer. Then, dt later,

    R = Rz(w dt) R_0      t = t_0 + Rz(w dt / 2) v dt

A velocity that is a difference of solutions over the time T carries their errors along: with r = dt / T the
covariance grows by (1 + r)^2 + r^2, the value for independent errors and an upper bound for errors that are alike.
Speed may change: `ACCELERATION dt (T + dt) / 2` is added. One that is not surely above the standing speed is taken as
none, and what may hide below that counts: `sigma dt`.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from workgauge.values.arrays import Floats
from workgauge.values.navigation import FixQuality
from workgauge.values.transforms import rotation_z

#: Solutions so old still count for the velocity [s]; fewer than this give none [s].
HISTORY_S, SHORTEST_S = 0.6, 0.2
#: How fast an undercarriage may change its speed [m/s^2].
ACCELERATION = 0.5
#: 1-sigma of a speed that nothing is known of [m/s], and of a yaw rate [rad/s].
UNKNOWN_M_S, UNKNOWN_RAD_S = 1.0, 0.2
#: Share of a horizontal error of the way that may be vertical.
STEEPEST = 0.1
#: Speeds whose sigma is larger than this are not known [m/s].
KNOWN_M_S = 0.15


class Past(NamedTuple):
    """One accepted solution: when [ns], how good, where the undercarriage was [m], its yaw [rad], variances."""

    valid_ns: int
    quality: FixQuality
    x: float
    y: float
    z: float
    yaw: float
    variance: float
    yaw_variance: float


@dataclass(frozen=True, slots=True)
class Motion:
    """Velocity of the undercarriage's origin and yaw rate, site frame.

    Attributes:
        velocity: (3) [m/s]. yaw_rate: to the left [rad/s].
        sigma: 1-sigma of each horizontal component [m/s]. yaw_sigma: [rad/s].
        over_s: the time T over which solutions were differenced; inf where the rates owe nothing to them.
        standing: it is taken to stand, and the velocity is zero.
    """

    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw_rate: float = 0.0
    sigma: float = UNKNOWN_M_S
    yaw_sigma: float = UNKNOWN_RAD_S
    over_s: float = math.inf
    standing: bool = True

    @property
    def speed_m_s(self) -> float:
        """Speed over ground; NaN where it is not known well enough to say that it stands."""
        if self.standing:
            return 0.0 if self.sigma <= KNOWN_M_S else math.nan
        return math.hypot(self.velocity[0], self.velocity[1])


def remembered(history: tuple[Past, ...], new: Past) -> tuple[Past, ...]:
    """Return the history with a new solution; what is too old or of another quality falls out."""
    oldest = new.valid_ns - round(HISTORY_S * 1e9)
    kept = tuple(one for one in history if oldest <= one.valid_ns < new.valid_ns and one.quality is new.quality)
    return (*kept, new)


def slope(history: tuple[Past, ...]) -> tuple[Floats, float, float, float, float] | None:
    """Return (velocity (3,), yaw rate, sigma, yaw sigma, time between first and last) of a history, None if short."""
    if len(history) < 2:
        return None
    first, last = history[0], history[-1]
    over = (last.valid_ns - first.valid_ns) * 1e-9
    if over < SHORTEST_S:
        return None
    times = [(one.valid_ns - last.valid_ns) * 1e-9 for one in history]
    mean = sum(times) / len(times)
    weights = [t - mean for t in times]
    norm = sum(w * w for w in weights)
    weights = [w / norm for w in weights]
    x, y, z, yaw = 0.0, 0.0, 0.0, 0.0
    for w, one in zip(weights, history, strict=True):
        x += w * (one.x - last.x)
        y += w * (one.y - last.y)
        z += w * (one.z - last.z)
        yaw += w * math.remainder(one.yaw - last.yaw, 2.0 * math.pi)
    sigma = math.sqrt(2.0 * max(first.variance, last.variance)) / over
    yaw_sigma = math.sqrt(2.0 * max(first.yaw_variance, last.yaw_variance)) / over
    return np.array([x, y, z]), yaw, sigma, yaw_sigma, over


def settled(motion: Motion, standing_m_s: float, half_gauge_m: float) -> Motion:
    """Return the motion, or none where it may as well be noise; what may hide below that is its sigma then."""
    hidden = max(standing_m_s, 2.0 * motion.sigma)
    turning = abs(motion.yaw_rate) > 2.0 * motion.yaw_sigma
    if math.hypot(motion.velocity[0], motion.velocity[1]) > hidden:
        return motion
    yaw_hidden = min(2.0 * motion.yaw_sigma, max(standing_m_s, motion.sigma) / half_gauge_m)
    if turning and abs(motion.yaw_rate) > yaw_hidden:
        return Motion((0.0, 0.0, 0.0), motion.yaw_rate, hidden, motion.yaw_sigma, motion.over_s, True)
    return Motion((0.0, 0.0, 0.0), 0.0, hidden, yaw_hidden, math.inf, True)


def carried(
    T: Floats, covariance: Floats, motion: Motion, dt_s: float, along: tuple[float, float, float] | None = None
) -> tuple[Floats, Floats, float]:
    """Return (T (4, 4), covariance (6, 6), factor of what it had to do with the joints' errors), `dt_s` later.

    Args:
        along: (3) unit vector of the rails it moves on; None where it may move anywhere.
    """
    if dt_s == 0.0:
        return T, covariance, 1.0
    dt = abs(dt_s)
    out, grown = T, np.array(covariance)
    ratio = dt / motion.over_s
    moving = not motion.standing or motion.yaw_rate != 0.0
    if moving:
        out = np.array(T)
        vx, vy, vz = motion.velocity
        half = 0.5 * motion.yaw_rate * dt_s
        c, s = math.cos(half) * dt_s, math.sin(half) * dt_s
        out[0, 3] += c * vx - s * vy
        out[1, 3] += s * vx + c * vy
        out[2, 3] += vz * dt_s
        if motion.yaw_rate:
            out[:3, :3] = rotation_z(2.0 * half)[:3, :3] @ T[:3, :3]
        if ratio:
            grown *= (1.0 + ratio) ** 2 + ratio**2
    over = 0.0 if motion.over_s == math.inf else motion.over_s
    way = 0.0 if motion.standing else 0.5 * ACCELERATION * dt * (over + dt)
    if motion.standing or ratio == 0.0:
        way = math.hypot(way, motion.sigma * dt)
    variance = way * way
    if along is not None:
        u = np.array(along)
        grown[:3, :3] += variance * np.outer(u, u)
    else:
        grown[0, 0] += variance
        grown[1, 1] += variance
        grown[2, 2] += STEEPEST**2 * variance
        grown[5, 5] += (motion.yaw_sigma * dt) ** 2 if ratio == 0.0 else 0.0
    return out, grown, 1.0 + ratio if moving else 1.0


def largest_horizontal_sigma(covariance: Floats) -> float:
    """Return the larger of the two principal sigmas in plan [m]."""
    a, b, c = float(covariance[0, 0]), float(covariance[0, 1]), float(covariance[1, 1])
    return math.sqrt(max(0.0, 0.5 * (a + c) + math.hypot(0.5 * (a - c), b)))
