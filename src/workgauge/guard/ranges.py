"""What each lever alone may still do, from the same rows as the programme."""

from collections.abc import Callable
from typing import Any

import numpy as np

from workgauge.guard.programme import SHORT
from workgauge.values.arrays import Floats, Ints, freeze
from workgauge.values.compiled import njit
from workgauge.values.ranges import LeverRanges

#: A joint that turns less than this for one metre per second of the tool does not turn.
_STILL = 1e-12


def lever_ranges(
    rows_positive: Floats,
    rows_negative: Floats,
    slack: Floats,
    alpha: float,
    speed_positive: Floats,
    speed_negative: Floats,
    tool_rates: Floats,
    *,
    ends_positive: Floats | None = None,
    ends_negative: Floats | None = None,
    clearance_of: Ints | None = None,
) -> LeverRanges:
    """Return how fast each joint alone, and the tool along one axis alone, may be commanded for this tick.

    An end of an interval is the largest command that leaves every row its due, `change >= -alpha max(slack, 0)` to
    within `SHORT`, exact by a ratio test: change of slack and command are taken as proportional, the joints' effects
    as additive, as in the programme. All the other levers in the middle: two levers at their ends together may be too
    much. The tool's interval also keeps every joint within its speed; where the tool cannot go at all it is 0 to 0.

    Args:
        rows_positive: (k, n) change of slack if joint j alone is commanded at its full positive speed [m].
        rows_negative: (k, n) likewise at its full negative speed.
        slack: (k,) [m], infinite for a row that does not matter.
        alpha: share of the slack that this tick may use up, above 0, at most 1.
        speed_positive, speed_negative: (n,) full speeds, both above 0 [rad/s, m/s].
        tool_rates: (3, n) joint velocities for 1 m/s of the tool along the machine's x, y, z; NaN where it cannot go.
        ends_positive, ends_negative: (n,) share of the full speed that the joint's end leaves, 0 to 1; ones if None.
        clearance_of: (k,) the clearance of each row, for `..._by`; the row itself if None.

    Returns:
        the intervals, frozen. Numbers that are none leave 0 to 0 where they matter; nothing is raised for them.
    """
    k, n = np.shape(rows_positive)
    speeds, ends = np.empty((2, n)), np.ones((2, n))
    speeds[0], speeds[1] = speed_positive, speed_negative
    if ends_positive is not None:
        ends[0] = ends_positive
    if ends_negative is not None:
        ends[1] = ends_negative
    of = np.arange(k) if clearance_of is None else np.ascontiguousarray(clearance_of, dtype=np.int64)
    joints, joints_by, tool, tool_by = _ranges(
        np.ascontiguousarray(rows_positive, dtype=np.float64),
        np.ascontiguousarray(rows_negative, dtype=np.float64),
        *(np.array(slack, dtype=np.float64), alpha, speeds, np.array(tool_rates, dtype=np.float64), ends, of, SHORT),
    )
    for array in (joints, joints_by, tool, tool_by):
        freeze(array)
    return LeverRanges(
        *(joints[1], joints[0], tool[1], tool[0]), *(joints_by[1], joints_by[0], tool_by[1], tool_by[0])
    )


def verified_ranges(
    whole: LeverRanges,
    wide: LeverRanges,
    narrow: LeverRanges,
    tool_rates: Floats,
    stands: Callable[[Floats], bool],
    spares: Callable[[Floats], bool],
) -> LeverRanges:
    """Return, for each end, the first that stands of: `whole` if spared, `wide`, `narrow`, half and a quarter, 0.

    Args:
        whole, wide, narrow: intervals, each inside the one before. tool_rates: as in `lever_ranges`.
        stands: whether the command of one lever alone (n,) is verified. spares: whether it comes near nothing else.
    """
    n = len(narrow.joints_low)
    units = {"joints": np.eye(n), "tool": np.where(np.isfinite(tool_rates), tool_rates, 0.0)}
    found: dict[str, Any] = {}
    for which, directions in units.items():
        for end in ("low", "high"):
            side = f"{which}_{end}"
            full, far, near = getattr(whole, side), getattr(wide, side), getattr(narrow, side)
            ends, by = np.zeros(len(directions)), np.array(getattr(narrow, f"{side}_by"))
            for i, direction in enumerate(directions):
                tried = 0.0
                for speed in (full[i], far[i], near[i], 0.5 * near[i], 0.25 * near[i]):
                    if speed in (0.0, tried):
                        continue
                    command, tried = speed * direction, speed
                    if (speed == far[i] or speed != full[i] or spares(command)) and stands(command):
                        ends[i] = speed
                        break
                if ends[i] == full[i]:
                    by[i] = getattr(whole, f"{side}_by")[i]
                elif ends[i] == far[i]:
                    by[i] = getattr(wide, f"{side}_by")[i]
            found[side], found[f"{side}_by"] = ends, by
    for array in found.values():
        freeze(array)
    return LeverRanges(**found)


def warm_up() -> None:
    """Compile the kernel, so that no tick has to: seconds the first time on a computer, milliseconds after."""
    lever_ranges(np.ones((1, 1)), np.ones((1, 1)), np.ones(1), 1.0, np.ones(1), np.ones(1), np.ones((3, 1)))


@njit(cache=True)
def _ranges(
    positive: Floats,
    negative: Floats,
    slack: Floats,
    alpha: float,
    speeds: Floats,
    rates: Floats,
    ends: Floats,
    of: Ints,
    short: float,
) -> tuple[Floats, Ints, Floats, Ints]:
    """Return the ends of the joints' ranges (2, n) and what ends them, those of the tool (2, 3) likewise.

    positive, negative: (k, n) rows. speeds, ends: (2, n). Positive first, then negative.
    """
    k, n = positive.shape
    joints, joints_by = np.zeros((2, n)), np.full((2, n), -1)
    tool, tool_by = np.zeros((2, 3)), np.full((2, 3), -1)
    change = np.empty(k)
    for side in range(2):
        sign = 1.0 if side == 0 else -1.0
        for j in range(n):
            for i in range(k):
                change[i] = positive[i, j] if side == 0 else negative[i, j]
            most, row = _furthest(change, slack, alpha, ends[side, j], short)
            joints[side, j] = sign * most * speeds[side, j] + 0.0  # no minus zero
            joints_by[side, j] = of[row] if row >= 0 else -1
        for axis in range(3):
            most, moves = np.inf, False
            change[:] = 0.0
            for j in range(n):
                rate = sign * rates[axis, j]
                if abs(rate) <= _STILL:
                    continue
                toward = 0 if rate > 0.0 else 1
                part = abs(rate) / speeds[toward, j]
                moves = True
                most = min(most, ends[toward, j] / part) if part >= 0.0 else np.nan
                for i in range(k):
                    change[i] += part * (positive[i, j] if toward == 0 else negative[i, j])
            if not moves or not most > 0.0:
                continue
            change *= most
            part, row = _furthest(change, slack, alpha, 1.0, short)
            tool[side, axis] = sign * most * part + 0.0
            tool_by[side, axis] = of[row] if row >= 0 else -1
    return joints, joints_by, tool, tool_by


@njit(cache=True)
def _furthest(change: Any, slack: Any, alpha: float, most: float, short: float) -> tuple[float, int]:
    """Return the largest share, at most `most`, of a motion that changes the slacks by `change`, and what ends it."""
    if not most > 0.0:
        return 0.0, -1
    which = -1
    for i in range(len(change)):
        least = -alpha * max(slack[i], 0.0)
        if not (np.isfinite(change[i]) and least <= 0.0):
            return 0.0, i
        if change[i] * most < least - short:
            most, which = least / change[i], i
    return most, which
