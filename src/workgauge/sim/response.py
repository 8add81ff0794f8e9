"""How one joint's speed follows the speed asked for, exactly while that stays, and which old commands act when."""

import math
from typing import Any

import numpy as np

from workgauge.values.compiled import njit

#: What the rows of a parameter block (ROWS, 2, n) mean; the positive direction first.
DELAY, BAND, FULL, LAG, UP, DOWN, FREQUENCY, DAMPING, FLOW = range(9)
ROWS = 9
#: An acceleration that stands for none needed [rad/s^2, m/s^2].
INSTANT = 1e9


@njit(cache=True)
def _towards(v: float, w: float, lag: float, a: float, dt: float) -> tuple[float, float]:
    """Return the speed after `dt` and the way made: by `a` while the lag alone would be quicker, then by the lag."""
    gap = w - v
    limited = min(max(abs(gap) - a * lag, 0.0) / a, dt)
    step = a * limited if gap > 0.0 else -a * limited
    way = (v + 0.5 * step) * limited
    v, rest = v + step, dt - limited
    gap = w - v
    if rest <= 0.0:
        return v, way
    settled = -math.expm1(-rest / lag) if lag > 0.0 else 1.0
    return v + gap * settled, way + w * rest - gap * lag * settled


@njit(cache=True)
def _until_still(v: float, w: float, lag: float, a: float) -> float:
    """Return the time until the speed passes zero on its way from v to a w of the other sign."""
    limited = max(abs(w - v) - a * lag, 0.0) / a
    if abs(v) <= a * limited:
        return abs(v) / a
    v -= math.copysign(a * limited, v)
    return limited + lag * math.log((w - v) / w)


@njit(cache=True)
def first_order(v: float, w: float, dt: float, block: Any) -> tuple[float, float]:
    """Return (speed, way) after `dt`; block (ROWS, 2), each direction by its own numbers, changed where v is zero."""
    way = 0.0
    while dt > 0.0:
        side = 0 if v > 0.0 or (v == 0.0 and w > 0.0) else 1
        rising = v == 0.0 or (v * w > 0.0 and abs(w) > abs(v))
        a, lag = block[UP if rising else DOWN, side], block[LAG, side]
        span, turns = dt, False
        if v * w < 0.0:
            still = _until_still(v, w, lag, a)
            if still <= dt:
                span, turns = still, True
        v, made = _towards(v, w, lag, a, span)
        if turns:
            v = 0.0
        way += made
        dt -= span
    return v, way


@njit(cache=True)
def _swing(v: float, z: float, w: float, omega: float, zeta: float, dt: float) -> tuple[float, float, float]:
    """Return speed, acceleration and way after `dt` of v'' = omega^2 (w - v) - 2 zeta omega v', exactly."""
    x, decay = v - w, zeta * omega
    if abs(zeta - 1.0) < 1e-6:
        e = math.exp(-omega * dt)
        slope = z + omega * x
        after, z_after = e * (x + slope * dt), e * (slope - omega * (x + slope * dt))
    else:
        if zeta < 1.0:
            ring = omega * math.sqrt(1.0 - zeta * zeta)
            e = math.exp(-decay * dt)
            c, s = e * math.cos(ring * dt), e * math.sin(ring * dt)
        else:
            ring = omega * math.sqrt(zeta * zeta - 1.0)
            slow, fast = math.exp((ring - decay) * dt), math.exp(-(ring + decay) * dt)
            c, s = 0.5 * (slow + fast), 0.5 * (slow - fast)
        after = x * c + (z + decay * x) / ring * s
        z_after = z * c - (decay * z + omega * omega * x) / ring * s
    way = w * dt - (z_after - z + 2.0 * decay * (after - x)) / (omega * omega)
    return w + after, z_after, way


@njit(cache=True)
def second_order(v: float, z: float, w: float, dt: float, block: Any, piece: float) -> tuple[float, float, float]:
    """Return (speed, acceleration, way) after `dt`, in quarter pieces where a limit or a change of sides may act."""
    alike = block[FREQUENCY, 0] == block[FREQUENCY, 1] and block[DAMPING, 0] == block[DAMPING, 1]
    free = min(block[UP, 0], block[UP, 1], block[DOWN, 0], block[DOWN, 1]) >= INSTANT
    steps = 1 if alike and free else math.ceil(4.0 * dt / piece)
    h, way = dt / steps, 0.0
    for _ in range(steps):
        side = 0 if v > 0.0 or (v == 0.0 and w > 0.0) else 1
        after, z_after, made = _swing(v, z, w, block[FREQUENCY, side], block[DAMPING, side], h)
        most = block[UP if z_after * v >= 0.0 else DOWN, side]
        if abs(z_after) > most:
            z_after = math.copysign(most, z_after)
            after = v + 0.5 * (z + z_after) * h
            made = v * h + (2.0 * z + z_after) * h * h / 6.0
        v, z, way = after, z_after, way + made
    return v, z, way


@njit(cache=True)
def run(
    times: Any, valves: Any, count: int, t: float, end: float, block: Any, pump: float, piece: float, v: Any, z: Any
) -> Any:
    """Move speeds v (n,) and accelerations z (n,) on from `t` to `end`, in place; return the ways made (n,).

    times (m,), valves (m, n): when which valves were set, the first `count` of them, the first since ever.
    block (ROWS, 2, n); pump: its flow. Time is cut wherever an old command begins to act.
    """
    n = v.shape[0]
    way, open_ = np.zeros(n), np.empty((2, n))
    while t < end:
        stop, asked = end, 0.0
        for side in range(2):
            for j in range(n):
                delay, k = block[DELAY, side, j], count - 1
                while k > 0 and times[k] + delay > t:
                    k -= 1
                if k + 1 < count:
                    stop = min(stop, times[k + 1] + delay)
                u = valves[k, j] if side == 0 else -valves[k, j]
                band = block[BAND, side, j]
                open_[side, j] = min((u - band) / (1.0 - band), 1.0) if u > band else 0.0
                asked += open_[side, j] * block[FLOW, side, j]
        share = pump / asked if asked > pump else 1.0
        for j in range(n):
            w = share * (open_[0, j] * block[FULL, 0, j] - open_[1, j] * block[FULL, 1, j])
            if block[FREQUENCY, 0, j] > 0.0:
                v[j], z[j], made = second_order(v[j], z[j], w, stop - t, block[:, :, j], piece)
            else:
                v[j], made = first_order(v[j], w, stop - t, block[:, :, j])
            way[j] += made
        t = stop
    return way
