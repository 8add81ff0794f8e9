"""How much of each joint's wish may be commanded: a small convex programme, solved and then certified."""

from dataclasses import dataclass
from typing import Any

import daqp
import numpy as np

from workgauge.guard.projection import project
from workgauge.values.arrays import Floats, Ints, freeze
from workgauge.values.compiled import njit

#: No row falls short of its bound by more than this: a nanometre, or that share of the pump's flow.
SHORT = 1e-9
#: The objective `|1 - s|² / 2` is at most this far from the best there is; beyond it the exact projection is asked.
GAP = 1e-9
#: Rows handed to the solver; the others must hold all the same, and the exact projection sees every one.
MOST_ROWS = 256
#: A row whose multiplier is below this holds nothing back.
WORTH_SAYING = 1e-7

_UNUSABLE = "the programme's numbers cannot be judged"
_SHORTENED = "the best share was not found: a smaller one that keeps every limit"
_UNBOUNDED = 1e30
_NONE, _FREE, _BOUND = 0, 1, 2


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """The shares, certified.

    Attributes:
        s: (n,) share of each joint's wish, 0 to 1.
        active: rows that hold the shares back, largest multiplier first; flow rows are counted after the others.
        ok: whether `s` meets every row. Otherwise `s` is zero: nothing that could be judged was given.
        why: empty, or why `s` is not the best there is.
    """

    s: Floats
    active: tuple[int, ...]
    ok: bool
    why: str


def share(
    rows: Floats,
    slack: Floats,
    alpha: float,
    *,
    keep_direction: bool = False,
    flow_rows: Floats | None = None,
    flow_most: Floats | None = None,
    ends: Floats | None = None,
) -> Solved:
    """Return the shares nearest to one that leave every row its due.

    `min |1 - s|²` subject to `0 <= s <= ends`, `rows @ s >= -alpha max(slack, 0)` and `flow_rows @ s <= flow_most`,
    none of which counts as below 0. So s = 0 always qualifies, a row without slack only ever grows, and one tick uses
    up at most the share alpha of any slack.

    Solved by daqp on rows of unit length, those that can bind; what it returns must meet *all* rows to within
    `SHORT`, and its multipliers must prove it the best to within `GAP` (weak duality). If it fails either, the exact
    projection answers: daqp finds rows contradictory, now and then, that depend on each other but for some 1e-6.

    Args:
        rows: (k, n) change of slack for the whole of each joint's wish [m].
        slack: (k,) what is left of each clearance [m]; infinite for a row that does not matter.
        alpha: share of the slack that this tick may use up, above 0, at most 1.
        keep_direction: all joints share one s, so that the tool stays on its path; an exact ratio test.
        flow_rows: (f, n) further rows. flow_most: (f,) what they may reach; below 0 counts as 0.
        ends: (n,) most each s may be, 0 to 1; ones if None.

    Returns:
        the shares; numbers that are none give zeros and ok = False. Nothing is raised for them.
    """
    n = np.shape(rows)[1]
    if flow_rows is None or flow_most is None:
        flow_rows, flow_most = np.empty((0, n)), np.empty(0)
    state, which, units, lower, upper, tolerance, rows, least, top = _bind(
        *(np.ascontiguousarray(rows, dtype=np.float64), np.ascontiguousarray(slack, dtype=np.float64), float(alpha)),
        *(np.ascontiguousarray(flow_rows, dtype=np.float64), np.ascontiguousarray(flow_most, dtype=np.float64)),
        *(np.ones(n) if ends is None else np.ascontiguousarray(ends, dtype=np.float64), keep_direction),
    )
    if state == _NONE:
        return _solved(np.zeros(n), (), _UNUSABLE, ok=False)
    if state == _FREE:
        return _solved(top, ())
    if keep_direction:
        length, row = _ratio(rows, least, top)
        return _solved(length * top, (row,) if row >= 0 else ())
    s, _, flag, info = daqp.solve(np.eye(n), -np.ones(n), units, upper, lower, primal_tol=tolerance)
    weights = info["lam"]
    if flag == 1 and _holds(s, rows, least, top, units, lower, weights):
        return _solved(s, _heaviest(which, -weights[n:]))
    s, weights, best = _exact(rows, least, top)
    return _solved(s, _heaviest(np.arange(len(rows)), weights), "" if best else _SHORTENED)


def warm_up() -> None:
    """Compile every path, so that no tick has to: seconds the first time on a computer, milliseconds after."""
    one, least, top = np.full((1, 1), -1.0), np.zeros(1), np.ones(1)
    share(one, least, 1.0)
    share(one, least, 1.0, keep_direction=True)
    _exact(one, least, top)


def _solved(s: Floats, active: tuple[int, ...], why: str = "", *, ok: bool = True) -> Solved:
    freeze(s)
    return Solved(s, active, ok, why)


def _heaviest(which: Ints, weights: Floats) -> tuple[int, ...]:
    """Return the rows whose weight is worth saying, the heaviest first."""
    heavy = (weights > WORTH_SAYING).nonzero()[0]
    return (
        tuple(which[heavy[np.argsort(-weights[heavy])]].tolist()) if len(heavy) > 1 else tuple(which[heavy].tolist())
    )


@njit(cache=True)
def flow_row(wish: Any, speeds: Any, flows: Any, most: float) -> Any:
    """Return what a wish (n,) takes of the pump's flow, as a row (1, n) of shares of the most it gives.

    speeds, flows: (n,) of each joint at its full positive and negative speed.
    """
    row = np.empty((1, len(wish)))
    for j in range(len(wish)):
        if wish[j] > 0.0:
            row[0, j] = wish[j] / speeds[0][j] * flows[0][j] / most
        else:
            row[0, j] = -wish[j] / speeds[1][j] * flows[1][j] / most
    return row


@njit(cache=True)
def _stated(
    rows: Any, slack: Any, alpha: float, flow_rows: Any, flow_most: Any, ends: Any, keep_direction: bool
) -> Any:
    """Return all rows, what each must reach at least, and the most each share may be. NaN stays NaN."""
    k, n = rows.shape
    every, least, top = np.empty((k + len(flow_rows), n)), np.empty(k + len(flow_rows)), np.empty(n)
    every[:k], every[k:] = rows, -flow_rows
    for i in range(k):
        least[i] = -alpha * (0.0 if slack[i] <= 0.0 else slack[i])
    for i in range(len(flow_rows)):
        least[k + i] = -(0.0 if flow_most[i] <= 0.0 else flow_most[i])
    for j in range(n):
        top[j] = ends[j]
        if top[j] <= 0.0:
            top[j] = 0.0
        elif top[j] > 1.0:
            top[j] = 1.0
    if keep_direction:
        shortest = top[0]
        for j in range(n):
            if not top[j] >= shortest:
                shortest = top[j]
            if np.isnan(shortest):
                break
        top[:] = shortest
    return every, least, top


@njit(cache=True)
def _bind(
    given: Any, slack: Any, alpha: float, flow_rows: Any, flow_most: Any, ends: Any, keep_direction: bool
) -> Any:
    """Return what the solver is to be given: whether anything binds, and if so which rows, in units of their length;
    and what `_stated` does.

    A row can bind only if its negative parts at `top` break its bound. Of too many, the ones that `top` breaks most.
    """
    rows, least, top = _stated(given, slack, alpha, flow_rows, flow_most, ends, keep_direction)
    return _binding(rows, least, top) + (rows, least, top)  # noqa: RUF005 - what can be compiled


@njit(cache=True)
def _binding(rows: Any, least: Any, top: Any) -> Any:
    """Return the first six of `_bind`."""
    k, n = rows.shape
    which = np.empty(k, dtype=np.int64)
    broken = np.empty(k)
    count, free, longest = 0, True, 0.0
    for j in range(n):
        if not np.isfinite(top[j]):
            return _NONE, which[:0], rows[:0], top, top, 0.0
    for i in range(k):
        at_top, worst, length = 0.0, 0.0, 0.0
        for j in range(n):
            at_top += rows[i, j] * top[j]
            worst += min(rows[i, j], 0.0) * top[j]
            length += rows[i, j] * rows[i, j]
        if not np.isfinite(length) or np.isnan(least[i]):
            return _NONE, which[:0], rows[:0], top, top, 0.0
        free = free and at_top >= least[i]
        if worst < least[i] - SHORT:
            length = np.sqrt(length)
            longest = max(longest, length)
            which[count], broken[count] = i, (at_top - least[i]) / length
            count += 1
    if free or count == 0:
        return _FREE, which[:0], rows[:0], top, top, 0.0
    which = which[:count]
    if count > MOST_ROWS:
        which = which[np.argsort(broken[:count])[:MOST_ROWS]]
        count = MOST_ROWS
    units = np.empty((count, n))
    lower = np.zeros(n + count)
    upper = np.full(n + count, _UNBOUNDED)
    upper[:n] = top
    for i in range(count):
        row = rows[which[i]]
        length = np.sqrt(np.sum(row * row))
        units[i] = row / length
        lower[n + i] = least[which[i]] / length
    return _BOUND, which, units, lower, upper, SHORT / max(1.0, longest)


@njit(cache=True)
def _holds(
    s: Floats, rows: Floats, least: Floats, top: Floats, units: Floats, lower: Floats, weights: Floats
) -> bool:
    """Bring s into its box, and return whether it meets all rows and the weights prove it the best.

    Weak duality: for any mu >= 0, `min over the box of |1 - x|²/2 - mu (U x - b)` is a lower bound of the objective;
    the x that attains it is `1 + mu U`, clipped into the box.
    """
    m, n = units.shape
    objective = 0.0
    for j in range(n):
        s[j] = min(max(s[j], 0.0), top[j])
        objective += 0.5 * (1.0 - s[j]) ** 2
    if not objective < np.inf or _short(s, rows, least):
        return False
    x = np.ones(n)
    for i in range(m):
        if weights[n + i] < 0.0:
            for j in range(n):
                x[j] -= weights[n + i] * units[i, j]
    bound = 0.0
    for j in range(n):
        x[j] = min(max(x[j], 0.0), top[j])
        bound += 0.5 * (1.0 - x[j]) ** 2
    for i in range(m):
        if weights[n + i] < 0.0:
            over = -lower[n + i]
            for j in range(n):
                over += units[i, j] * x[j]
            bound += weights[n + i] * over
    return bool(objective <= bound + GAP)


@njit(cache=True)
def _short(s: Floats, rows: Floats, least: Floats) -> bool:
    """Return whether any row falls short of its bound by more than `SHORT`."""
    for i in range(len(least)):
        change = 0.0
        for j in range(len(s)):
            change += rows[i, j] * s[j]
        if not change >= least[i] - SHORT:
            return True
    return False


@njit(cache=True)
def _ratio(rows: Floats, least: Floats, direction: Floats) -> tuple[float, int]:
    """Return the largest t <= 1 with `rows @ (t direction) >= least`, and the row that ends it, or -1.

    A row that all of `direction` breaks by no more than `SHORT` ends nothing. least: none above 0.
    """
    most, which = 1.0, -1
    for i in range(len(least)):
        change = 0.0
        for j in range(len(direction)):
            change += rows[i, j] * direction[j]
        if change < least[i] - SHORT and least[i] / change < most:
            most, which = least[i] / change, i
    return most, which


def _exact(rows: Floats, least: Floats, top: Floats) -> tuple[Floats, Floats, bool]:
    """Return the exact projection, the weights of all rows, and whether it is the best.

    Half of `SHORT` is left to rounding. Should the projection fall short all the same, the longer of what is left of
    it and of the whole wish along their rays: zero always qualifies.
    """
    k, n = rows.shape
    lengths = np.sqrt(np.einsum("ij,ij->i", rows, rows))
    counts = np.flatnonzero(lengths > 0.0)
    lengths = lengths[counts]
    normals = np.concatenate((rows[counts] / lengths[:, None], np.eye(n), -np.eye(n)))
    offsets = np.concatenate((least[counts] / lengths, np.zeros(n), -top))
    tolerance = np.concatenate((0.5 * SHORT / lengths, np.full(2 * n, 0.01 * SHORT)))
    point, multipliers, finished = project(np.ones(n), normals, offsets, tolerance)
    weights = np.zeros(k)
    weights[counts] = multipliers[: len(counts)]
    s = np.minimum(np.maximum(point, 0.0), top)
    if not _short(s, rows, least):
        return s, weights, finished
    roomy = least - 0.5 * SHORT
    s = s * _ratio(rows, roomy, s)[0]
    whole = top * _ratio(rows, roomy, top)[0]
    if _short(s, rows, least) or np.sum((1.0 - whole) ** 2) < np.sum((1.0 - s) ** 2):
        s = whole
    return s, weights, False
