"""What the stopping model makes of a stop: the way over time from a steady speed as the valve closes."""

import math
from typing import Any

from workgauge.values.compiled import njit

#: 1 / deceleration below this stands for no limit [s^2/rad, s^2/m].
NO_LIMIT = 1e-9


@njit(cache=True)
def _after(v: float, w: float, lag: float, slow: float, dt: float) -> tuple[float, float]:
    """Return (speed, way) after `dt` from speed v towards w: at most 1/slow of change, then by the lag."""
    way, gap = 0.0, w - v
    if slow > NO_LIMIT and abs(gap) * slow > lag:
        a = 1.0 / slow
        limited = min(abs(gap) * slow - lag, dt)
        step = a * limited if gap > 0.0 else -a * limited
        way, v, dt, gap = (v + 0.5 * step) * limited, v + step, dt - limited, gap - step
    if dt <= 0.0:
        return v, way
    if lag <= 1e-12:
        return w, way + w * dt
    settled = -math.expm1(-dt / lag)
    return v + gap * settled, way + w * dt - gap * lag * settled


@njit(cache=True)
def way(t: Any, cuts: Any, shares: Any, speed: float, dead: float, lag: float, slow: float, out: Any) -> None:
    """Fill out (m,) with the way made at times t (m,) rising, 0 where the valve begins to close.

    cuts, shares (k,): from `cuts + dead` on, the speed asked for is `shares * speed`; before, `speed`.
    """
    v, x, at, k = speed, 0.0, t[0], 0
    x = speed * t[0]
    w = speed
    for i in range(len(t)):
        while k < len(cuts) and cuts[k] + dead <= t[i]:
            if cuts[k] + dead > at:
                v, made = _after(v, w, lag, slow, cuts[k] + dead - at)
                x += made
                at = cuts[k] + dead
            w = shares[k] * speed
            k += 1
        _, made = _after(v, w, lag, slow, t[i] - at)
        out[i] = x + made


def stop_travel(speed: float, dead: float, lag: float, deceleration: float) -> float:
    """Return how far the model's joint still moves from a speed when its valve closes at once, exactly."""
    over = speed - deceleration * lag if math.isfinite(deceleration) else 0.0
    return speed * (dead + lag) + (over * over / (2.0 * deceleration) if over > 0.0 else 0.0)
