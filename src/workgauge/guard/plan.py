"""What a tick may command, rolled out: where the joints may be until they rest, for several commands side by side."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from workgauge.guard.api import GuardInput, Memory
from workgauge.machine.rollout import Rollout, advance, roll
from workgauge.proximity.stops import Rows, Way
from workgauge.values.arrays import Floats, freeze, frozen
from workgauge.values.compiled import njit

#: The commands rolled out: none, what is wished for, every joint at its full positive and negative speed.
NONE, WISH, PLUS, MINUS = range(4)
#: A posture may be this old; where the joints have gone since is known that long [s].
OLDEST_S = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """What is known of the joints' motion now, beside their measured positions.

    Attributes:
        speeds: (2, n) lower and upper bounds [rad/s, m/s]. flying: (H, n) commands still in flight, the newest last.
        ways: (K, 2, n) bounds of the way made in each of the last ticks, the newest last [rad, m].
        late_s: what of the time is not counted yet, less than half a tick.
    """

    speeds: Floats
    flying: Floats
    ways: Floats
    late_s: float

    def plain(self) -> dict[str, Any]:
        """Return it as a guard's memory."""
        return {"speeds": self.speeds, "flying": self.flying, "ways": self.ways, "late_s": self.late_s}

    def since(self, ticks: float) -> Floats | None:
        """Return bounds (2, n) of the way made in the last `ticks` ticks, None if that is longer than is known."""
        whole = math.ceil(ticks - 1e-6)
        if whole <= 0:
            return np.zeros(self.speeds.shape)
        if whole > len(self.ways):
            return None
        longer = self.ways[len(self.ways) - whole :].sum(axis=0)
        shorter = longer - self.ways[len(self.ways) - whole]
        return np.stack([np.minimum(longer[0], shorter[0]), np.maximum(longer[1], shorter[1])])


def flown(rollout: Rollout, sent: Floats | None, elapsed_s: float, memory: Memory) -> Flight:
    """Return what flies now.

    Args:
        rollout: the stopping model. sent: (n,) velocities the valves have asked for since the last tick, None for
            none. elapsed_s: since then; more than a tick's period if ticks were missed.
        memory: of the last tick; an empty one, or one of another model, stands for a machine at rest.
    """
    n, kept = rollout.n, math.ceil(OLDEST_S / rollout.dt_s) + 1
    speeds, flying, ways = (
        *(_known(memory.get("speeds"), (2, n)), _known(memory.get("flying"), (rollout.memory, n))),
        _known(memory.get("ways"), (kept, 2, n)),
    )
    if speeds is None or flying is None or ways is None:
        speeds, flying, ways = frozen(np.zeros((2, n))), np.zeros((rollout.memory, n)), np.zeros((kept, 2, n))
        flying, ways = frozen(flying), frozen(ways)
    passed_s = elapsed_s + float(memory.get("late_s", 0.0))
    ticks = min(max(round(passed_s / rollout.dt_s), 1), rollout.memory + round(rollout.rest_ticks))
    late_s = max(min(passed_s - ticks * rollout.dt_s, 0.5 * rollout.dt_s), -0.5 * rollout.dt_s)
    asked = np.zeros(n) if sent is None else np.array(sent, dtype=np.float64)
    speeds, flying, ways = _fly(speeds, flying, ways, asked, ticks, rollout.packed)
    for array in (speeds, flying, ways):
        freeze(array)
    return Flight(speeds, flying, ways, late_s)


def _known(value: Any, shape: tuple[int, ...]) -> Floats | None:
    """Return a remembered array, read-only, or None if it is none of that shape."""
    if type(value) is np.ndarray and value.shape == shape and value.dtype == np.float64:
        if not value.flags.writeable and value.flags.c_contiguous:
            return value
    elif value is None:
        return None
    array = frozen(value)
    return array if array.shape == shape else None


class Plan:
    """Displacements of the joints from now to rest, after each of the commands `NONE` to `MINUS`.

    Args:
        rollout: the stopping model. given: of this tick. flight: see `flown`.
        since: (2, n) bounds of the way made since the posture was measured.
        wish: (n,) what the joints themselves allow of what is desired.
        spacing_m, bend_m: no corner moves farther between two postures looked at, nor farther off the straight way
            (of the joints) between them than `bend_m` [m].
        farthest: (n,) how far from each joint's axis a corner may be [m].
        cushion: one tick uses up at most this share of what is left between a joint's end and where it would rest.
        alpha: and at most this share of a slack.

    Attributes:
        way: the way to rest without a command.
        reach: (c, n) slacks below `|row| . reach` may matter to a command: the whole wish, every joint at its full
            speed by itself, the tool along each axis as fast as the joints can [rad, m].
        ends: (4, n) the share of each command that leaves every joint its due before its end.
    """

    def __init__(
        self,
        rollout: Rollout,
        given: GuardInput,
        flight: Flight,
        since: Floats,
        wish: Floats,
        *,
        spacing_m: float,
        bend_m: float,
        farthest: Floats,
        cushion: float,
        alpha: float,
    ) -> None:
        self._rollout, self._given, self._flight, self._since = rollout, given, flight, since
        tool = np.zeros((0, rollout.n)) if given.tool_rates is None else given.tool_rates
        self._middle, self._width, self._looked, way, self.reach, self.ends, self._ways = _plan(
            *(flight.speeds, flight.flying, since, wish, rollout.packed, rollout.marks, rollout.rest_ticks),
            *(given.q, given.q_min, given.q_max, given.speed_positive, given.speed_negative, tool),
            *(spacing_m, bend_m, farthest, cushion, alpha),
        )
        self.way = Way(*way)
        self._changed: tuple[Rows, Floats] | None = None

    def way_after(self, command: Floats) -> Way:
        """Return the same moments of the way to rest after another command (n,)."""
        rollout, given = self._rollout, self._given
        postures, widths = _after(
            *(self._flight.speeds, self._flight.flying, self._since, command),
            *(rollout.packed, rollout.marks, self._looked),
            *(given.q, given.q_min, given.q_max),
        )
        return Way(postures, widths, self.way.times)

    def acts(self) -> Floats:
        """Return (P, n) what share of the way of a command, 0 to 1, each joint has made by each posture looked at."""
        moved = np.abs(self._middle[[PLUS, MINUS]] - self._middle[NONE])[:, self._looked]
        shares: Floats = np.minimum(moved / self._ways[[PLUS, MINUS], None], 1.0).max(axis=0)
        return shares

    def changes(self, rows: Rows) -> Floats:
        """Return (4, 2 r, n) by how much each joint's part of each command changes each slack [m].

        First as far as it moves in this one tick, no more than speed times period: of that an approach may use up a
        share `alpha` of the slack. Then as far as it may, while nobody knows exactly when it acts: of that, all.
        Of a pair that is inside, that of the middle posture: what leads out by two joints together would never begin
        if each were counted as late as it may be where it helps, and as early where it does not.
        """
        if self._changed is not None and self._changed[0] is rows:
            return self._changed[1]
        found: Floats = _changes(
            *(rows.rows, rows.postures, rows.inside, self._looked, self._middle, self._width, self._ways)
        )
        self._changed = rows, found
        return found


@njit(cache=True)
def _fly(speeds: Any, flying: Any, ways: Any, sent: Any, ticks: int, model: Any) -> Any:
    """Return speeds, commands in flight and ways so many ticks later, all of them with the same command."""
    delay, lag, rate, dt = model
    speeds, flying, ways = speeds.copy(), flying.copy(), ways.copy()
    for _ in range(ticks):
        for i in range(flying.shape[0] - 1):
            flying[i] = flying[i + 1]
        for i in range(ways.shape[0] - 1):
            ways[i] = ways[i + 1]
        flying[flying.shape[0] - 1] = sent
        moved = np.empty_like(speeds)
        advance(flying, speeds, delay, lag, rate, dt, moved, ways[ways.shape[0] - 1])
        speeds = moved
    return speeds, flying, ways


@njit(cache=True)
def _add(out: Any, since: Any) -> None:
    """Add bounds of a way made before (2, n) to displacements out (2, C, n, M)."""
    for side in range(2):
        for c in range(out.shape[1]):
            for j in range(out.shape[2]):
                out[side, c, j] += since[side, j]


@njit(cache=True)
def _within(out: Any, q: Any, q_min: Any, q_max: Any, middle: Any, width: Any) -> None:
    """Fill middle and width (C, M, n) from displacements out (2, C, n, M) that pass no joint's end."""
    for c in range(middle.shape[0]):
        for j in range(middle.shape[2]):
            down, up = min(q_min[j] - q[j], 0.0), max(q_max[j] - q[j], 0.0)
            for m in range(middle.shape[1]):
                low = min(max(out[0, c, j, m], down), up)
                high = min(max(out[1, c, j, m], down), up)
                middle[c, m, j], width[c, m, j] = 0.5 * (low + high), 0.5 * (high - low)


@njit(cache=True)
def _looked_at(middle: Any, width: Any, spacing: float, bend: float, farthest: Any) -> Any:
    """Return the marks to look at, the first and the last among them, see `Plan`; middle, width (M, n)."""
    total, n = middle.shape
    looked, count, m = np.zeros(total, np.int64), 1, 0
    while m < total - 1:
        best = m + 1
        for end in range(m + 2, total):
            size, moved = 0.0, 0.0
            for j in range(n):
                step = farthest[j] * (middle[end, j] - middle[m, j])
                size, moved = size + step * step, moved + abs(step)
            worst = 0.0
            for between in range(m + 1, end):
                share = 0.0
                for j in range(n):
                    share += farthest[j] ** 2 * (middle[end, j] - middle[m, j]) * (middle[between, j] - middle[m, j])
                share = min(max(share / size, 0.0), 1.0) if size > 0.0 else 0.0
                off = 0.0
                for j in range(n):
                    on_way = middle[m, j] + share * (middle[end, j] - middle[m, j])
                    wide = width[m, j] + share * (width[end, j] - width[m, j])
                    off += farthest[j] * (abs(middle[between, j] - on_way) + max(width[between, j] - wide, 0.0))
                worst = max(worst, off)
            if moved > spacing or worst > bend:
                break
            best = end
        m = best
        looked[count] = m
        count += 1
    return looked[:count].copy()


@njit(cache=True)
def _plan(
    speeds: Any,
    flying: Any,
    since: Any,
    wish: Any,
    model: Any,
    marks: Any,
    rest_ticks: float,
    q: Any,
    q_min: Any,
    q_max: Any,
    positive: Any,
    negative: Any,
    tool: Any,
    spacing: float,
    bend: float,
    farthest: Any,
    cushion: float,
    alpha: float,
) -> Any:
    """Return middles and widths (4, M, n), the marks looked at, the way's fields, reach and ends, see `Plan`; and how
    far each joint moves in the tick (4, n)."""
    delay, lag, rate, dt = model
    n, total = len(q), len(marks)
    first = np.zeros((4, n))
    first[1], first[2], first[3] = wish, positive, -negative
    out = np.empty((2, 4, n, total))
    roll(flying, speeds, first, delay, lag, rate, dt, marks, out)
    _add(out, since)
    middle, width = np.empty((4, total, n)), np.empty((4, total, n))
    _within(out, q, q_min, q_max, middle, width)

    looked = _looked_at(middle[0], width[0], spacing, bend, farthest)
    count = len(looked)
    postures, widths, times = np.empty((count, n)), np.empty((count, n)), np.empty(count)
    for p in range(count):
        times[p] = min(marks[looked[p]], rest_ticks) * dt
        for j in range(n):
            postures[p, j], widths[p, j] = q[j] + middle[0, looked[p], j], width[0, looked[p], j]

    # what a command changes may be used up at once; what it moves in its tick counts 1 / alpha times, see `changes`
    reach = np.zeros((1 + n + tool.shape[0], n))
    for j in range(n):
        for c in range(1, 4):
            most = 0.0
            for m in range(total):
                change = abs(middle[c, m, j] - middle[0, m, j]) + abs(width[c, m, j] - width[0, m, j])
                most = max(most, change)
            most = max(most, min(most, abs(first[c, j]) * dt) / alpha)
            if c == 1:
                reach[0, j] = most
            else:
                reach[1 + j, j] = max(reach[1 + j, j], most)
    for a in range(tool.shape[0]):
        fastest = 0.0
        for j in range(n):
            fastest = max(fastest, abs(tool[a, j]) / min(positive[j], negative[j]))
        for j in range(n):
            if fastest > 0.0:
                share = abs(tool[a, j]) / min(positive[j], negative[j]) / fastest
                reach[1 + n + a, j] = share * reach[1 + j, j]

    ends, last = np.ones((4, n)), total - 1
    for c in range(1, 4):
        for j in range(n):
            upwards = first[c, j] > 0.0
            if upwards:
                room, more = q_max[j] - q[j] - out[1, 0, j, last], out[1, c, j, last] - out[1, 0, j, last]
            else:
                room, more = out[0, 0, j, last] - q_min[j] + q[j], out[0, 0, j, last] - out[0, c, j, last]
            room = cushion * max(room, 0.0)
            if more > 0.0 and room < more:
                ends[c, j] = room / more
    return middle, width, looked, (postures, widths, times), reach, ends, np.abs(first) * dt


@njit(cache=True)
def _after(
    speeds: Any,
    flying: Any,
    since: Any,
    command: Any,
    model: Any,
    marks: Any,
    looked: Any,
    q: Any,
    q_min: Any,
    q_max: Any,
) -> Any:
    """Return postures and widths (P, n) at the marks looked at, after a command (n,)."""
    delay, lag, rate, dt = model
    n, total, count = len(q), len(marks), len(looked)
    first = np.empty((1, n))
    first[0] = command
    out, middle, width = np.empty((2, 1, n, total)), np.empty((1, total, n)), np.empty((1, total, n))
    roll(flying, speeds, first, delay, lag, rate, dt, marks, out)
    _add(out, since)
    _within(out, q, q_min, q_max, middle, width)
    postures, widths = np.empty((count, n)), np.empty((count, n))
    for p in range(count):
        for j in range(n):
            postures[p, j], widths[p, j] = q[j] + middle[0, looked[p], j], width[0, looked[p], j]
    return postures, widths


@njit(cache=True)
def _changes(rows: Any, postures: Any, inside: Any, looked: Any, middle: Any, width: Any, ways: Any) -> Any:
    """Return (4, 2 r, n), see `Plan.changes`; ways (4, n): how far each joint moves in the tick."""
    count, n = rows.shape
    found = np.empty((4, 2 * count, n))
    for c in range(4):
        for r in range(count):
            m = looked[postures[r]]
            for j in range(n):
                g = rows[r, j]
                moved, wide = middle[c, m, j] - middle[0, m, j], width[c, m, j] - width[0, m, j]
                change = g * moved
                if not inside[r]:
                    change -= abs(g) * wide
                size = abs(moved) + abs(wide)
                found[c, r, j] = change * (min(ways[c, j] / size, 1.0) if size > 0.0 else 1.0)
                found[c, count + r, j] = change
    return found


@njit(cache=True)
def losable(room: Any, slack: Any, inside: Any, alpha: float, floor: float, short: float) -> Any:
    """Return (2 r,) what each row of `Plan.changes` may lose, all of it and then a share alpha of it.

    A row that is not inside may lose `short` where it has less, as long as its slack is above -floor; the nearer it
    is to that, the less.
    """
    count = len(room)
    found = np.empty(2 * count)
    for i in range(count):
        left = room[i]
        found[i] = left if left > 0.0 else np.inf
        if not inside[i] and floor > 0.0:
            left = max(left, short * min(max(1.0 + slack[i] / floor, 0.0), 1.0))
        found[count + i] = left / alpha
    return found
