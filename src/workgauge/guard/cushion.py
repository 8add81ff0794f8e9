"""The end cushion: joint speed is brought down smoothly before each joint's end; moving off the end is free."""

import math
from collections.abc import Sequence

from workgauge.values.reasons import Reason, ReasonCode

#: A cushion is never wider than this share of the joint's range.
WIDEST_SHARE = 0.25


def cushioned(
    velocity: Sequence[float],
    q: Sequence[float],
    ends: tuple[Sequence[float], Sequence[float]],
    speeds: tuple[Sequence[float], Sequence[float]],
    names: Sequence[str],
    *,
    dt_s: float,
    cushion_s: float,
    keep_direction: bool = False,
) -> tuple[list[float], list[Reason]]:
    """Return the velocity (n,) with every joint slowed towards its end (Mäkinen 3.3, end cushion).

    Within a cushion as wide as the joint travels in `cushion_s` at its highest speed, the speed towards the end is at
    most in proportion to the room left, and never more than what reaches the end within one tick: the end is
    approached exponentially and never passed. At or beyond the end the speed towards it is zero.

    Args:
        velocity: (n,) [rad/s, m/s].
        q: (n,) joint positions [rad, m].
        ends: lower and upper ends, (n,) each, infinite where there is none.
        speeds: highest speeds in positive and negative direction, (n,) each.
        names: (n) joint names.
        dt_s: time until the next tick [s].
        cushion_s: time constant of the approach [s].
        keep_direction: slow all joints by the smallest share instead of each by its own.
    """
    lower, upper = ends
    positive, negative = speeds
    shares, reasons = [], []
    for j, v in enumerate(velocity):
        if v > 0.0:
            room, speed, end = upper[j] - q[j], positive[j], "upper"
        else:
            room, speed, end = q[j] - lower[j], negative[j], "lower"
        allowed = _allowed(room, speed, upper[j] - lower[j], dt_s, cushion_s)
        if abs(v) > allowed:
            shares.append(allowed / abs(v))
            text = f"{names[j]} is {'at' if allowed == 0.0 else 'near'} its {end} end"
            reasons.append(Reason(ReasonCode.JOINT_END, text, joint=names[j], scale=shares[j]))
        else:
            shares.append(1.0)
    if keep_direction:
        shares = [min(shares, default=1.0)] * len(shares)
    return [v * share for v, share in zip(velocity, shares, strict=True)], reasons


def _allowed(room: float, speed: float, travel: float, dt_s: float, cushion_s: float) -> float:
    """Return the highest speed towards an end that is `room` away on a joint of that whole travel."""
    if not room > 0.0:  # beyond the end, or not a number
        return 0.0
    width = min(cushion_s * speed, WIDEST_SHARE * travel)
    slowed = speed * room / width if room < width else math.inf
    return min(slowed, room / dt_s)
