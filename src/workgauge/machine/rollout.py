"""Rolling the commands in flight out through the stopping model: where every joint may be until the machine rests."""

import math
from typing import Any

import numpy as np

from workgauge.machine.stopping import StoppingModel
from workgauge.values.arrays import Floats, Ints
from workgauge.values.compiled import njit

#: A joint slower than this rests: what its lag still makes of it is below 0.01 mm [rad/s, m/s].
RESTING = 1e-6
#: A deceleration that stands for none needed [rad/s^2, m/s^2].
INSTANT = 1e9
#: Between a command and its effect lies up to half a tick more or less than the dead time: ticks and bus are not one.
TIMING = 0.5
#: At most so many moments are looked at while the machine is fast.
MOST_DENSE = 24
#: A lag is over after so many time constants: a thousandth of the speed is left.
SETTLED = 7.0
#: A mark this far after the last command is at rest [s].
FOR_EVER = 1e6


@njit(cache=True)
def _step(v: float, w: float, lag: Any, rate: Any, dt: float) -> tuple[float, float]:
    """Return the speed after `dt` and the way made, towards the speed `w` asked for: exact while `w` stays.

    As long as the lag would change the speed faster than `rate` [rad/s^2, m/s^2], it changes by that; after that
    exponentially. lag, rate (2): by direction, which changes where the speed passes zero.
    """
    way = 0.0
    while dt > 0.0:
        side = 0 if v > 0.0 or (v == 0.0 and w > 0.0) else 1
        a, tau = rate[side], lag[side]
        gap = w - v
        braking = max(abs(gap) - a * tau, 0.0) / a
        if v * w < 0.0:  # stop at zero, and go on from there by the other direction's numbers
            if abs(v) <= a * braking:
                still = abs(v) / a
            else:
                left = abs(v) - a * braking
                still = braking + tau * math.log((left + abs(w)) / abs(w))
            if still <= dt:
                first = min(still, braking)
                way += (v - math.copysign(0.5 * a * first, v)) * first
                if still > braking:
                    fast = v - math.copysign(a * braking, v)
                    way += w * (still - braking) + fast * tau
                v = 0.0
                dt -= still
                continue
        if braking > 0.0:
            span = min(braking, dt)
            change = a * span if gap > 0.0 else -a * span
            way += (v + 0.5 * change) * span
            v += change
            dt -= span
            gap = w - v
            if dt <= 0.0:
                break
        if tau <= 0.0:
            return w, way + w * dt
        settled = 1.0 - math.exp(-dt / tau)
        return v + gap * settled, way + w * dt - gap * tau * settled
    return v, way


@njit(cache=True)
def _follow(
    times: Any,
    asked: Any,
    count: int,
    begin: float,
    end: float,
    v: float,
    way: float,
    delay: Any,
    lag: Any,
    rate: Any,
    dt: float,
    marks: Any,
    m: int,
    least: Any,
    most: Any,
) -> tuple[float, float, int]:
    """Move one joint on from `begin` to `end` and take its way in at every mark passed; speed, way, next mark.

    times, asked (count): when the command became what, in ticks from now. One direction's valve side follows what of
    it is positive, the other what is negative, each after its own `delay`. Time is cut where either changes.
    """
    t, i0, i1 = begin, 0, 0
    while t < end:
        while i0 + 1 < count and times[i0 + 1] + delay[0] <= t:
            i0 += 1
        while i1 + 1 < count and times[i1 + 1] + delay[1] <= t:
            i1 += 1
        stop = end
        if i0 + 1 < count:
            stop = min(stop, times[i0 + 1] + delay[0])
        if i1 + 1 < count:
            stop = min(stop, times[i1 + 1] + delay[1])
        w = max(asked[i0], 0.0) + min(asked[i1], 0.0)
        while t < stop:
            mark = marks[m] if m < len(marks) else math.inf
            until = mark if mark <= stop else stop
            v, made = _step(v, w, lag, rate, (until - t) * dt)
            way += made
            t = until
            if mark <= stop:
                least[m], most[m] = min(least[m], way), max(most[m], way)
                m += 1
    return v, way, m


@njit(cache=True)
def _commands(sent: Any, j: int, times: Any, asked: Any) -> int:
    """Fill in when joint j was asked for what, and return how many entries that took; the first stands since ever."""
    count = 1
    times[0], asked[0] = -1e9, 0.0
    for i in range(sent.shape[0]):
        if sent[i, j] != asked[count - 1]:
            times[count], asked[count] = i - sent.shape[0], sent[i, j]
            count += 1
    return count


@njit(cache=True)
def roll(sent: Any, v: Any, first: Any, delay: Any, lag: Any, rate: Any, dt: float, marks: Any, out: Any) -> None:
    """Fill out (2, C, n, M) with the least and greatest displacement of every joint at each mark (M).

    sent (H, n): velocities commanded so far, the last one acting until now. v (V, n): speeds now. first (C, n): the
    command of the tick that begins, zeros follow. delay, lag, rate (V, n, 2), delay in ticks. What a command
    changes begins after its dead time: until then all first commands share one way.
    """
    commands, joints, variants, total = first.shape[0], first.shape[1], v.shape[0], len(marks)
    out[0], out[1] = math.inf, -math.inf
    least, most = np.empty(total), np.empty(total)
    times, asked = np.empty(sent.shape[0] + 3), np.empty(sent.shape[0] + 3)
    for j in range(joints):
        count = _commands(sent, j, times, asked)
        rests = count == 1
        for k in range(variants):
            rests = rests and v[k, j] == 0.0
        for k in range(variants):
            fork = min(delay[k, j, 0], delay[k, j, 1])
            least[:], most[:] = math.inf, -math.inf
            speed, way, m = v[k, j], 0.0, 0
            if rests:
                while m < total and marks[m] <= fork:
                    least[m] = most[m] = 0.0
                    m += 1
            else:
                speed, way, m = _follow(
                    times,
                    asked,
                    count,
                    0.0,
                    fork,
                    speed,
                    way,
                    delay[k, j],
                    lag[k, j],
                    rate[k, j],
                    dt,
                    marks,
                    m,
                    least,
                    most,
                )
            for c in range(commands):
                if _known(first, c, j) < c:
                    continue
                low, high = out[0, c, j], out[1, c, j]
                for i in range(m):
                    low[i], high[i] = min(low[i], least[i]), max(high[i], most[i])
                if rests and first[c, j] == 0.0:
                    for i in range(m, total):
                        low[i], high[i] = min(low[i], 0.0), max(high[i], 0.0)
                    continue
                times[count], asked[count] = 0.0, first[c, j]
                times[count + 1], asked[count + 1] = 1.0, 0.0
                _follow(
                    times,
                    asked,
                    count + 2,
                    fork,
                    marks[-1],
                    speed,
                    way,
                    delay[k, j],
                    lag[k, j],
                    rate[k, j],
                    dt,
                    marks,
                    m,
                    low,
                    high,
                )
        for c in range(commands):
            before = _known(first, c, j)
            if before < c:
                out[0, c, j], out[1, c, j] = out[0, before, j], out[1, before, j]


@njit(cache=True)
def _known(first: Any, c: int, j: int) -> int:
    """Return the first of the commands that asks joint j for the same."""
    for before in range(c):
        if first[before, j] == first[c, j]:
            return before
    return c


@njit(cache=True)
def advance(sent: Any, v: Any, delay: Any, lag: Any, rate: Any, dt: float, out: Any) -> None:
    """Fill out (V, n) with the speeds now, v (V, n) being those a tick ago."""
    times, asked, none = np.empty(sent.shape[0] + 1), np.empty(sent.shape[0] + 1), np.empty(0)
    marks = np.empty(0, np.int64)
    for j in range(v.shape[1]):
        count = _commands(sent, j, times, asked)
        for k in range(v.shape[0]):
            out[k, j] = 0.0
            if count > 1 or v[k, j] != 0.0:
                out[k, j], _, _ = _follow(
                    times,
                    asked,
                    count,
                    -1.0,
                    0.0,
                    v[k, j],
                    0.0,
                    delay[k, j],
                    lag[k, j],
                    rate[k, j],
                    dt,
                    marks,
                    0,
                    none,
                    none,
                )
            if count == 1 and abs(out[k, j]) < RESTING:
                out[k, j] = 0.0


def _marks(model: StoppingModel, dt_s: float, speeds: Floats, dense_s: float) -> Ints:
    """Return the moments looked at, in ticks: close together while a stop is fast, then farther and farther apart."""
    slow = model.slowest()
    braking = float((slow.dead_time_s + speeds / slow.deceleration).max()) / dt_s
    step, at, marks = max(round(dense_s / dt_s), math.ceil(braking / MOST_DENSE), 1), 1, [1]
    while at < braking + 1.0:
        at += step
        marks.append(at)
    rest = braking + float(slow.lag_s.max()) * SETTLED / dt_s
    while at < rest:
        step = max(round(step * 1.4), step + 1)
        at += step
        marks.append(at)
    return np.array(marks, dtype=np.int64)


class Rollout:
    """The stopping model ready for one tick period; immutable.

    Args:
        model: how the joints stop. dt_s: the tick's period [s]. speed_positive, speed_negative: (n,) highest speeds.
        dense_s: time between the moments looked at while the machine is fast [s].

    Attributes:
        marks: (M,) the moments looked at, in ticks from now; the last stands for rest.
        rest_ticks: until all but a thousandth of any speed is gone.
        memory: commands this many ticks old may still act.
        packed: what `roll` and `advance` take of the model: delays, lags, rates (V, n, 2), the tick's period.
    """

    def __init__(
        self,
        model: StoppingModel,
        dt_s: float,
        speed_positive: Floats,
        speed_negative: Floats,
        dense_s: float = 0.04,
    ) -> None:
        corners = model.corners()
        self.dt_s = dt_s
        late = np.array([TIMING, 0.0, -TIMING])[np.arange(len(corners)) * 3 // len(corners)]
        delay = np.stack([one.dead_time_s.T for one in corners]) / dt_s + late[:, None, None]
        lag = np.stack([one.lag_s.T for one in corners])
        rate = np.minimum(np.stack([one.deceleration.T for one in corners]), INSTANT)
        # in memory one joint's numbers lie side by side, whatever the shapes they came from
        self.packed = np.maximum(delay, 0.0).copy(), lag.copy(), rate.copy(), float(dt_s)
        self.memory = math.ceil(float(self.packed[0].max(initial=0.0))) + 2
        self.marks = _marks(model, dt_s, np.stack([speed_positive, speed_negative]), dense_s).astype(np.float64)
        self.rest_ticks = float(self.marks[-1])
        self.marks[-1] = FOR_EVER / dt_s
        self.variants, self.n = len(corners), model.n

    def rest(self) -> Floats:
        """Return the speeds (V, n) of a machine at rest."""
        return np.zeros((self.variants, self.n))

    def advanced(self, v: Floats, sent: Floats) -> Floats:
        """Return the speeds (V, n) one tick later; sent (H, n) has the command of that tick as its last."""
        out = np.empty_like(v)
        advance(sent, v, *self.packed, out)
        return out

    def displacements(self, v: Floats, sent: Floats, first: Floats) -> tuple[Floats, Floats]:
        """Return the least and the greatest displacement (C, M, n) at each mark, for each first command (C, n)."""
        out = np.empty((2, len(first), self.n, len(self.marks)))
        roll(sent, v, first, *self.packed, self.marks, out)
        found = out.transpose(0, 1, 3, 2)
        return found[0], found[1]
