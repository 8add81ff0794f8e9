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
MOST_DENSE = 36
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
def _window(times: Any, asked: Any, count: int, first: int, last: int, side: int) -> tuple[float, float]:
    """Return the least and the greatest that one side was asked for by the commands first to last."""
    low, high = math.inf, -math.inf
    for i in range(first, last + 1):
        u = asked[i]
        if (u > 0.0) != (side == 0):
            u = 0.0
        low, high = min(low, u), max(high, u)
    return low, high


@njit(cache=True)
def _follow(
    times: Any,
    asked: Any,
    count: int,
    begin: float,
    end: float,
    state: Any,
    delay: Any,
    lag: Any,
    rate: Any,
    dt: float,
    marks: Any,
    m: int,
    low: Any,
    high: Any,
    seen: Any,
) -> int:
    """Move one joint's bounds on from `begin` to `end` [ticks] and note the ways at every mark passed; next mark.

    times, asked (count): when the command became what, in ticks from now. One direction's valve side follows what of
    it is positive, the other what is negative, each with its own dead time. state (4): lower and upper bound of the
    speed, and of the way made. delay (2, 2: least and greatest, sides) in ticks, lag, rate (2, 2: slow and quick,
    sides). The upper bound follows the greatest speed that any dead time may ask for now, quickly upwards and slowly
    downwards; the lower bound the least, the other way round: whatever dead time, lag and rate a joint within
    tolerance has, and even if they change, it stays in between (comparison of scalar differential equations).
    seen (2, 2): room to write.
    """
    t = begin
    early, late = seen[0], seen[1]
    early[:], late[:] = 0, 0
    while t < end:
        stop, least, most = end, 0.0, 0.0
        for side in range(2):
            while early[side] + 1 < count and times[early[side] + 1] + delay[0, side] <= t:
                early[side] += 1
            while late[side] + 1 < count and times[late[side] + 1] + delay[1, side] <= t:
                late[side] += 1
            if early[side] + 1 < count:
                stop = min(stop, times[early[side] + 1] + delay[0, side])
            if late[side] + 1 < count:
                stop = min(stop, times[late[side] + 1] + delay[1, side])
            down, up = _window(times, asked, count, late[side], early[side], side)
            least += down
            most += up
        while t < stop:
            mark = marks[m] if m < len(marks) else math.inf
            until = mark if mark <= stop else stop
            span = (until - t) * dt
            i = 1 if least < state[0] else 0
            state[0], made = _step(state[0], least, lag[i], rate[i], span)
            state[2] += made
            i = 1 if most > state[1] else 0
            state[1], made = _step(state[1], most, lag[i], rate[i], span)
            state[3] += made
            t = until
            if mark <= stop:
                low[m], high[m] = state[2], state[3]
                m += 1
    return m


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
def _farthest(
    times: Any, asked: Any, count: int, v: float, sign: float, delay: float, lag: Any, rate: Any, dt: float
) -> float:
    """Return how far one joint may still go in one direction at most, whatever its dead time, as long as it is one.

    From a speed v, `P(v) = v^2 / 2a + a tau^2 / 2` (`v tau` below `a tau`) is left to rest, slow; the sum of way and
    P grows by at most `1 + quick / slow` times the speed asked for. That counts every command once, where `_follow`,
    not knowing when a short one acts, counts it for as long as it might. lag, rate: (slow, quick) of the direction.
    """
    knee = rate[0] * lag[0]
    v = max(sign * v, 0.0)
    left = v * lag[0] if v <= knee else v * v / (2.0 * rate[0]) + 0.5 * knee * lag[0]
    total = 0.0
    for i in range(1, count):
        begin = max(times[i] + delay, 0.0)
        end = times[i + 1] + delay if i + 1 < count else begin
        total += max(sign * asked[i], 0.0) * max(end - begin, 0.0) * dt
    quicker = rate[1] / rate[0]
    if lag[1] > 0.0:
        quicker = max(quicker, lag[0] / lag[1])
    elif lag[0] > 0.0:
        return math.inf
    return float(left + (1.0 + quicker) * total)


@njit(cache=True)
def roll(sent: Any, v: Any, first: Any, delay: Any, lag: Any, rate: Any, dt: float, marks: Any, out: Any) -> None:
    """Fill out (2, C, n, M) with the least and greatest displacement of every joint at each mark (M).

    sent (H, n): velocities commanded so far, the last one acting until now. v (2, n): bounds of the speeds now. first
    (C, n): the command of the tick that begins, zeros follow. delay (n, 2, 2) in ticks, lag, rate (n, 2, 2), see
    `_follow`. What a command changes begins after the least dead time: until then all first commands share one way.
    """
    commands, joints, total = first.shape[0], first.shape[1], len(marks)
    least, most = np.empty(total), np.empty(total)
    times, asked = np.empty(sent.shape[0] + 3), np.empty(sent.shape[0] + 3)
    begun, state, seen = np.empty(4), np.empty(4), np.empty((2, 2), np.int64)
    for j in range(joints):
        count = _commands(sent, j, times, asked)
        rests = count == 1 and v[0, j] == 0.0 and v[1, j] == 0.0
        fork = min(delay[j, 0, 0], delay[j, 0, 1])
        begun[0], begun[1], begun[2], begun[3] = v[0, j], v[1, j], 0.0, 0.0
        m = 0
        if rests:
            while m < total and marks[m] <= fork:
                least[m] = most[m] = 0.0
                m += 1
        else:
            m = _follow(
                times, asked, count, 0.0, fork, begun, delay[j], lag[j], rate[j], dt, marks, m, least, most, seen
            )
        for c in range(commands):
            low, high = out[0, c, j], out[1, c, j]
            before = _known(first, c, j)
            if before < c:
                low[:], high[:] = out[0, before, j], out[1, before, j]
                continue
            low[:m], high[:m] = least[:m], most[:m]
            if rests and first[c, j] == 0.0:
                low[m:], high[m:] = 0.0, 0.0
                continue
            times[count], asked[count] = 0.0, first[c, j]
            times[count + 1], asked[count + 1] = 1.0, 0.0
            state[:] = begun
            _follow(
                times,
                asked,
                count + 2,
                fork,
                marks[-1],
                state,
                delay[j],
                lag[j],
                rate[j],
                dt,
                marks,
                m,
                low,
                high,
                seen,
            )
            up = _farthest(times, asked, count + 2, v[1, j], 1.0, delay[j, 1, 0], lag[j, :, 0], rate[j, :, 0], dt)
            down = _farthest(times, asked, count + 2, v[0, j], -1.0, delay[j, 1, 1], lag[j, :, 1], rate[j, :, 1], dt)
            for i in range(total):
                low[i], high[i] = max(low[i], -down), min(high[i], up)


@njit(cache=True)
def _known(first: Any, c: int, j: int) -> int:
    """Return the first of the commands that asks joint j for the same."""
    for before in range(c):
        if first[before, j] == first[c, j]:
            return before
    return c


@njit(cache=True)
def advance(sent: Any, v: Any, delay: Any, lag: Any, rate: Any, dt: float, out: Any, way: Any) -> None:
    """Fill out (2, n) with bounds of the speeds now, way (2, n) of the way since; v (2, n): speeds a tick ago."""
    times, asked, none = np.empty(sent.shape[0] + 1), np.empty(sent.shape[0] + 1), np.empty(0)
    state, seen = np.empty(4), np.empty((2, 2), np.int64)
    for j in range(v.shape[1]):
        count = _commands(sent, j, times, asked)
        out[0, j] = out[1, j] = way[0, j] = way[1, j] = 0.0
        if count > 1 or v[0, j] != 0.0 or v[1, j] != 0.0:
            state[0], state[1], state[2], state[3] = v[0, j], v[1, j], 0.0, 0.0
            _follow(times, asked, count, -1.0, 0.0, state, delay[j], lag[j], rate[j], dt, none, 0, none, none, seen)
            out[0, j], out[1, j], way[0, j], way[1, j] = state[0], state[1], state[2], state[3]
        if count == 1 and max(abs(out[0, j]), abs(out[1, j])) < RESTING:
            out[0, j] = out[1, j] = 0.0


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
        packed: what `roll` and `advance` take of the model: delays, lags, rates (n, 2, 2), the tick's period.
    """

    def __init__(
        self,
        model: StoppingModel,
        dt_s: float,
        speed_positive: Floats,
        speed_negative: Floats,
        dense_s: float = 0.03,
    ) -> None:
        self.dt_s = dt_s
        delay, lag, rate = model.spread()
        timing = np.array([-TIMING, TIMING])[:, None, None]
        # (n, 2, 2): joint, least and greatest (of lag and rate: slow and quick), side
        self.packed = (
            np.maximum(delay / dt_s + timing, 0.0).transpose(2, 0, 1).copy(),
            lag[::-1].transpose(2, 0, 1).copy(),
            np.minimum(rate, INSTANT).transpose(2, 0, 1).copy(),
            float(dt_s),
        )
        self.memory = math.ceil(float(self.packed[0].max(initial=0.0))) + 2
        self.marks = _marks(model, dt_s, np.stack([speed_positive, speed_negative]), dense_s).astype(np.float64)
        self.rest_ticks = float(self.marks[-1])
        self.marks[-1] = FOR_EVER / dt_s
        self.n = model.n

    def rest(self) -> Floats:
        """Return the bounds of the speeds (2, n) of a machine at rest."""
        return np.zeros((2, self.n))

    def advanced(self, v: Floats, sent: Floats) -> Floats:
        """Return the bounds of the speeds (2, n) a tick later; sent (H, n) ends with the command of that tick."""
        out = np.empty_like(v)
        advance(sent, v, *self.packed, out, np.empty_like(v))
        return out

    def displacements(self, v: Floats, sent: Floats, first: Floats) -> tuple[Floats, Floats]:
        """Return the least and the greatest displacement (C, M, n) at each mark, for each first command (C, n)."""
        out = np.empty((2, len(first), self.n, len(self.marks)))
        roll(sent, v, first, *self.packed, self.marks, out)
        found = out.transpose(0, 1, 3, 2)
        return found[0], found[1]
