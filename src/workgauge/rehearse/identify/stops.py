"""Finding the stops in a log: a valve held, then closed, and the joint left to come to rest."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from workgauge.rehearse.identify.log import StepLog
from workgauge.values.arrays import Floats

#: A valve counts as open from this share on, as held while it stays within that share of full.
OPEN, HELD = 0.02, 0.01
#: A valve is held at least so long before a stop, closes within so long, and stays closed at least so long [s].
SHORTEST_HOLD_S, LONGEST_CLOSING_S, SHORTEST_REST_S = 0.5, 0.5, 0.5
#: Of the hold, its last part counts, at most so long [s]; of the rest after it, at most so long [s].
HOLD_SHARE, LONGEST_PRE_S, LONGEST_REST_S = 0.4, 0.5, 8.0
#: A stop counts for so many times the way made over the speed before, and so long after that [s].
STILL_SHARE, STILL_S = 3.0, 0.7
#: A joint this near its end may have run onto it [rad, m].
NEAR_END = 0.01
#: Speeds of the two halves of that part may differ by this share, beside noise.
STEADY = 0.03


@dataclass(frozen=True, slots=True, eq=False)
class Stop:
    """One stop of one joint; times from the moment the valve begins to close, positions along the motion.

    Attributes:
        at_s: that moment in the log [s]. valve: the valve held until then, its size.
        cuts, valves: (k,) when the valve changes from then on [s], and to what.
        t, x: (m,) samples: times [s] and positions [rad, m], growing with the motion.
        speed: before the stop [rad/s, m/s].
    """

    at_s: float
    valve: float
    cuts: Floats
    valves: Floats
    t: Floats
    x: Floats
    speed: float

    @property
    def travel(self) -> float:
        """The largest way made after the valve began to close, smoothed over 50 ms [rad, m]."""
        before = self.t <= 0.0
        start = float(self.x[before].mean() - self.speed * self.t[before].mean())
        window = max(int(0.05 / float(np.median(np.diff(self.t)))), 1)
        smooth = np.convolve(self.x, np.full(window, 1.0 / window), mode="valid")
        return float(smooth.max()) - start


def find_stops(
    log: StepLog, j: int, direction: int, ends: tuple[float, float] | None = None
) -> tuple[list[Stop], list[str]]:
    """Return the stops of joint j out of one direction (+1, -1), and why others were left out.

    Args:
        log, j, direction: see above. ends: of the joint, if known [rad, m]; a joint that runs onto them says nothing.
    """
    u = log.valve[:, j] * direction
    opened = np.abs(log.valve[:, j]) > OPEN
    stops: list[Stop] = []
    left_out: list[str] = []
    closings = np.flatnonzero(opened[:-1] & ~opened[1:]) + 1
    for k in closings.tolist():
        if u[k - 1] <= 0.0:
            continue
        found = _stop_at(log, j, direction, u, opened, k)
        if isinstance(found, Stop) and ends is not None:
            low, high = sorted(end * direction for end in ends)
            if found.x.min() < low + NEAR_END or found.x.max() > high - NEAR_END:
                found = "ran onto the joint's end"
        if isinstance(found, Stop):
            stops.append(found)
        else:
            left_out.append(f"{log.joints[j]}, stop at t = {log.t_valve[k]:.2f} s: {found}")
    return stops, left_out


def _stop_at(log: StepLog, j: int, direction: int, u: Floats, opened: NDArray[np.bool_], k: int) -> Stop | str:
    """Return the stop that is complete at valve sample k, or why it is none."""
    times = log.t_valve
    hold = k - 1
    while hold > 0 and abs(u[hold] - u[hold - 1]) > HELD:
        hold -= 1  # from here to k the valve closes
    level, begin = float(u[hold]), hold
    while begin > 0 and abs(u[begin - 1] - level) <= HELD:
        begin -= 1
    later = np.flatnonzero(opened[k:])
    free = float(times[k + later[0]]) if len(later) else float(log.t[-1]) + 1e-9
    closes = float(times[hold + 1])
    held, closing, rest = closes - float(times[begin]), float(times[k]) - closes, free - float(times[k])
    if held < SHORTEST_HOLD_S:
        return f"held for {held:.2f} s only"
    if closing > LONGEST_CLOSING_S:
        return f"closed over {closing:.2f} s"
    if rest < SHORTEST_REST_S:
        return f"moved on after {rest:.2f} s"
    pre = min(HOLD_SHARE * held, LONGEST_PRE_S)
    inside = (log.t >= closes - pre) & (log.t < min(free, float(times[k]) + LONGEST_REST_S))
    t, x = log.t[inside] - closes, log.q[inside, j] * direction
    speed = _steady(t[t <= 0.0], x[t <= 0.0])
    if isinstance(speed, str):
        return speed
    cuts = times[hold + 1 : k + 1] - closes
    stop = Stop(closes, level, cuts, np.maximum(u[hold + 1 : k + 1], 0.0), t, x, speed)
    # how long it stands after that says nothing more
    still = t <= float(cuts[-1]) + STILL_SHARE * stop.travel / speed + STILL_S
    return replace(stop, t=t[still], x=x[still])


def _steady(t: Floats, x: Floats) -> float | str:
    """Return the speed of a part of a motion, or why it is not steady."""
    if len(t) < 8:
        return "too few samples before it"
    slope, offset = np.polyfit(t, x, 1)
    half = len(t) // 2
    noise = float(np.std(x - slope * t - offset)) * (12.0 / half) ** 0.5 / max(float(t[half] - t[0]), 1e-9)
    first, second = (float(np.polyfit(t[part], x[part], 1)[0]) for part in (slice(half), slice(half, None)))
    if slope <= 2.0 * noise:
        return "no motion before it"
    if abs(first - second) > STEADY * slope + 4.0 * noise:
        return f"speed not steady before it, {first:.3f} then {second:.3f} per second"
    return float(slope)
