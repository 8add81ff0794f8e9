"""Rolling the commands in flight out through the stopping model: where every joint may be until the machine rests."""

import math
from typing import Any

import numpy as np
from numba import njit

from workgauge.machine.stopping import StoppingModel
from workgauge.values.arrays import Floats

#: A joint slower than this that is asked for nothing rests, but for what its lag still makes of it [rad/s, m/s].
RESTING = 1e-4
#: A deceleration that stands for none needed [rad/s^2, m/s^2].
INSTANT = 1e9
TIMING = 0.5


@njit(cache=True)
def _side(sent: Any, first: float, j: int, at: int, side: int) -> float:
    """Return what the command `at` ticks from now asks of one side of joint j: 0 the positive, 1 the negative."""
    if at > 0 or at < -sent.shape[0]:
        return 0.0
    u = first if at == 0 else sent[sent.shape[0] + at, j]
    return u if (u > 0.0) == (side == 0) else 0.0


@njit(cache=True)
def _tick(
    sent: Any, first: float, j: int, step: int, v: float, delays: Any, lag: Any, a: Any, dt: float
) -> tuple[float, float]:
    """Return the speed after the tick that begins `step` ticks from now, and the way made in it.

    Commands change sides' speeds where their dead times end, which is inside a tick if a dead time is no whole one.
    """
    at0, at1 = math.floor(step - delays[0]), math.floor(step - delays[1])
    change0, change1 = 1.0 - (step - delays[0] - at0), 1.0 - (step - delays[1] - at1)
    way, done = 0.0, 0.0
    for part in range(3):
        end = min(change0, change1) if part == 0 else max(change0, change1) if part == 1 else 1.0
        if end <= done:
            continue
        w = _side(sent, first, j, int(at0) + (1 if done >= change0 else 0), 0)
        w += _side(sent, first, j, int(at1) + (1 if done >= change1 else 0), 1)
        side = 0 if v > 0.0 or (v == 0.0 and w > 0.0) else 1
        v, made = _step(v, w, lag[side], a[side], (end - done) * dt)
        way += made
        done = end
    return v, way


@njit(cache=True)
def _step(v: float, w: float, lag: float, a: float, dt: float) -> tuple[float, float]:
    """Return the speed after `dt` and the way made, towards the speed `w` asked for: exact while `w` stays.

    As long as the lag would change the speed faster than `a`, it changes by `a`; after that exponentially.
    """
    way, gap = 0.0, w - v
    if abs(gap) > a * lag:
        braking = (abs(gap) - a * lag) / a
        if braking > dt:
            braking = dt
        dv = a * braking if gap > 0.0 else -a * braking
        way = (v + 0.5 * dv) * braking
        v += dv
        dt -= braking
        gap = w - v
    if dt <= 0.0:
        return v, way
    if lag <= 0.0:
        return w, way + w * dt
    settled = 1.0 - math.exp(-dt / lag)
    return v + gap * settled, way + w * dt - gap * lag * settled


@njit(cache=True)
def _roll(
    sent: Any, v: Any, first: Any, delay: Any, lag: Any, a: Any, dt: float, marks: Any, out: Any
) -> None:
    """Fill out (2, C, M, n) with the least and greatest displacement of every joint at each mark (M).

    sent (H, n): velocities commanded so far, the last one acting until now. v (V, n): speeds now. first (C, n): the
    command of the tick that begins, zeros follow. delay, lag, a (V, n, 2), delay in ticks.
    """
    out[0], out[1] = math.inf, -math.inf
    for c in range(first.shape[0]):
        for j in range(first.shape[1]):
            for k in range(v.shape[0]):
                speed, way, m, step = v[k, j], 0.0, 0, 0
                flying = max(delay[k, j, 0], delay[k, j, 1]) + 1.0
                while m < len(marks):
                    if step == marks[m]:
                        out[0, c, m, j] = min(out[0, c, m, j], way)
                        out[1, c, m, j] = max(out[1, c, m, j], way)
                        m += 1
                        continue
                    if step < flying:
                        speed, made = _tick(sent, first[c, j], j, step, speed, delay[k, j], lag[k, j], a[k, j], dt)
                        step += 1
                    else:
                        side = 0 if speed > 0.0 else 1
                        span = (marks[m] - step) * dt
                        speed, made = _step(speed, 0.0, lag[k, j, side], a[k, j, side], span)
                        step = marks[m]
                    way += made


@njit(cache=True)
def _advance(sent: Any, v: Any, delay: Any, lag: Any, a: Any, dt: float, out: Any) -> None:
    """Fill out (V, n) with the speeds a tick later."""
    for k in range(v.shape[0]):
        for j in range(v.shape[1]):
            out[k, j], _ = _tick(sent, 0.0, j, -1, v[k, j], delay[k, j], lag[k, j], a[k, j], dt)


class Rollout:
    """The stopping model ready for one tick period; immutable.

    Args:
        model: how the joints stop. dt_s: the tick's period. speed_positive, speed_negative: (n,) highest speeds.
        marks: at most so many moments until rest are looked at.
    """

    def __init__(
        self, model: StoppingModel, dt_s: float, speed_positive: Floats, speed_negative: Floats, marks: int = 24
    ) -> None:
        corners = model.corners()
        self.dt_s = dt_s
        late = np.array([TIMING, 0.0, -TIMING])[np.arange(len(corners)) * 3 // len(corners)]
        self._delay = np.stack([one.dead_time_s.T for one in corners]) / dt_s + late[:, None, None]
        self._delay = np.maximum(self._delay, 0.0)
        self._lag = np.stack([one.lag_s.T for one in corners])
        self._deceleration = np.minimum(np.stack([one.deceleration.T for one in corners]), INSTANT)
        #: Commands this many ticks old may still act.
        self.memory = math.ceil(float(self._delay.max(initial=0.0))) + 2
        steps = max(math.ceil(model.horizon_s(speed_positive, speed_negative) / dt_s), 1) + 1
        self.marks = np.unique(np.round(np.linspace(1, steps, min(marks, steps)))).astype(np.int64)
        self.variants, self.n = len(corners), model.n

    def rest(self) -> Floats:
        """Return the speeds (V, n) of a machine at rest."""
        return np.zeros((self.variants, self.n))

    def advanced(self, v: Floats, sent: Floats) -> Floats:
        """Return the speeds (V, n) one tick later; sent (H, n) has the command of that tick as its last."""
        out = np.empty_like(v)
        _advance(sent, v, self._delay, self._lag, self._deceleration, self.dt_s, out)
        return out

    def displacements(self, v: Floats, sent: Floats, first: Floats) -> tuple[Floats, Floats]:
        """Return the least and the greatest displacement (C, M, n) at each mark, for each first command (C, n)."""
        out = np.empty((2, len(first), len(self.marks), self.n))
        _roll(sent, v, first, self._delay, self._lag, self._deceleration, self.dt_s, self.marks, out)
        return out[0], out[1]
