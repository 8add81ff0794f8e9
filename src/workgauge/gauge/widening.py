"""Widening along a track: from curvature, begun before the curve, as a running maximum, for each side."""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from workgauge.gauge.envelope import Widening
from workgauge.gauge.trackline import NUDGE, TrackLine
from workgauge.values.arrays import Floats, Ints
from workgauge.values.errors import RuleError

#: Curvature is tabulated this often along the alignment, and on both sides of every break [m].
TABLE_STEP = 0.25
#: How far from a break its two sides are read [m]; less than NUDGE, so that a cell beside a jump never sees it.
ASIDE = NUDGE / 4
#: Into how many pieces the ramp is cut at first; only those that may matter are followed closely.
COARSE = 10
#: The ramp outside a curve is followed in steps of this length, each taken at its larger end [m].
RAMP_STEP = 0.25


@dataclass(frozen=True, slots=True)
class Early:
    """Where widening begins before a curve [m]: inside at once, outside from `outside_from` to `outside_full`."""

    inside_from: float
    outside_from: float
    outside_full: float


class _WindowMax:
    """Largest tabulated value within windows of a sorted axis, by a sparse table."""

    def __init__(self, x: Floats, values: Floats, widest: float) -> None:
        self.x = x
        most = int(np.max(np.searchsorted(x, x + widest, side="right") - np.arange(len(x)))) + 3
        levels = [values]
        for level in range(1, most.bit_length()):
            last, half = levels[-1], 1 << (level - 1)
            shifted = np.concatenate([last[half:], np.full(min(half, len(last)), -np.inf)])
            levels.append(np.maximum(last, shifted))
        self._table = np.stack(levels)

    def over(self, low: Floats, high: Floats) -> Floats:
        """Return the largest value at x in [low, high], read linearly between tabulated places."""
        ends = np.maximum(np.interp(low, self.x, self._table[0]), np.interp(high, self.x, self._table[0]))
        first: Ints = np.searchsorted(self.x, low, side="left")
        stop: Ints = np.searchsorted(self.x, high, side="right")
        level = np.minimum(np.frexp(np.maximum(stop - first, 1))[1] - 1, len(self._table) - 1)
        last = len(self.x) - 1
        left = self._table[level, np.minimum(first, last)]
        right = self._table[level, np.clip(stop - (1 << level), 0, last)]
        inner = np.where(stop > first, np.maximum(left, right), -np.inf)
        return np.asarray(np.maximum(inner, ends), dtype=np.float64)


class TrackWidening:
    """Widening of both sides of one track at any distance, never smaller than the local formula.

    Between tabulated places it is read linearly, and the ramp is followed in steps, each at its larger end: the
    result is never below the exact running maximum by more than a hundredth of a millimetre, which cells' pads cover.

    Raises:
        RuleError: somewhere the radius is below the smallest the rule book answers for.
    """

    def __init__(self, line: TrackLine, widening: Widening, early: Early | None, file: str = "") -> None:
        self._early = early
        inner = np.arange(0.0, line.length, TABLE_STEP)
        breaks = line.breaks
        x = np.concatenate([inner, breaks - ASIDE, breaks + ASIDE])
        x = np.unique(np.clip(x, 0.0, line.length))
        curvature = np.asarray(line.at(x).curvature)
        self._refuse_tight(x, curvature, widening, line, file)
        widest = 0.0 if early is None else 2 * max(early.inside_from, early.outside_from) + 1.0
        left_in, left_out = widening.at(np.maximum(curvature, 0.0))
        right_in, right_out = widening.at(np.maximum(-curvature, 0.0))
        self._x = x
        self._jumps = _jumps(breaks, x, curvature)
        self._inside = [_WindowMax(x, values, widest) for values in (left_in, right_in)]
        self._outside = [_WindowMax(x, values, widest) for values in (right_out, left_out)]

    def breaks(self) -> Floats:
        """Return the distances where an early widening begins, changes or ends because the curvature jumps [m]."""
        if self._early is None or not len(self._jumps):
            return np.empty(0)
        e = self._early
        offsets = np.array([e.inside_from, e.outside_from, e.outside_full])
        places = (self._jumps[:, None] + np.concatenate([-offsets, offsets])).ravel()
        return np.asarray(places[(places > self._x[0]) & (places < self._x[-1])], dtype=np.float64)

    def at(self, d: Floats) -> Floats:
        """Return the widening (m, 2) left, right [m] at distances (m,)."""
        sides = [
            np.maximum(self._inner(self._inside[side], d), self._outer(self._outside[side], d)) for side in (0, 1)
        ]
        return np.stack(sides, axis=-1)

    def _inner(self, table: _WindowMax, d: Floats) -> Floats:
        reach = 0.0 if self._early is None else self._early.inside_from
        return table.over(d - reach, d + reach)

    def _outer(self, table: _WindowMax, d: Floats) -> Floats:
        if self._early is None:
            return table.over(d, d)
        e = self._early
        out: Floats = table.over(d - e.outside_full, d + e.outside_full)
        rising = np.flatnonzero(table.over(d - e.outside_from, d + e.outside_from) > out)
        ramp = e.outside_from - e.outside_full
        if not len(rising) or ramp <= 0:
            return out
        at, best = d[rising], out[rising]
        coarse = np.linspace(0.0, 1.0, COARSE + 1)
        for begin, end in itertools.pairwise(coarse):
            may = np.flatnonzero(self._ramped(table, at, ramp, begin, end) > best)
            fine = np.linspace(begin, end, max(math.ceil(ramp / COARSE / RAMP_STEP), 1) + 1)
            for first, last in itertools.pairwise(fine) if len(may) else ():
                best[may] = np.maximum(best[may], self._ramped(table, at[may], ramp, first, last))
        out[rising] = best
        return out

    def _ramped(self, table: _WindowMax, d: Floats, ramp: float, begin: float, end: float) -> Floats:
        """Return an upper bound of what the ramp between two shares of its length brings to each distance."""
        full = 0.0 if self._early is None else self._early.outside_full
        near, far = full + ramp * begin, full + ramp * end
        return (1.0 - begin) * np.maximum(table.over(d + near, d + far), table.over(d - far, d - near))

    @staticmethod
    def _refuse_tight(x: Floats, curvature: Floats, widening: Widening, line: TrackLine, file: str) -> None:
        bad = np.isnan(widening.at(curvature)[0])
        if bad.any():
            first = int(np.flatnonzero(bad)[np.argmax(np.abs(curvature[bad]))])
            raise RuleError(
                "the rule book has no widening for so small a radius",
                file=file or None,
                element=f"alignment {line.alignment.name.strip()!r} at {x[first]:.3f} m",
                value=f"radius {1.0 / abs(curvature[first]):.3f} m",
                allowed=f"radius of at least {widening.smallest_radius:g} m, or a rule with a table going further",
            )


def _jumps(breaks: Floats, x: Floats, curvature: Floats) -> Floats:
    """Return the breaks where the curvature jumps, that is where the widening does."""
    before = np.interp(np.clip(breaks - ASIDE, x[0], x[-1]), x, curvature)
    after = np.interp(np.clip(breaks + ASIDE, x[0], x[-1]), x, curvature)
    return breaks[np.abs(after - before) > 1e-7]
