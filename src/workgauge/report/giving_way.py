"""Where limits held automatic motion: for how long, and how far the tool then was from where it was to be."""

import math
from dataclasses import dataclass

import numpy as np

from workgauge.rehearse.auto_series import AutoSeries
from workgauge.rehearse.interventions import PAUSE_S
from workgauge.rehearse.result import Intervention, RunResult
from workgauge.values.arrays import Floats, Ints
from workgauge.values.reasons import ReasonCode

#: Causes that are about a place, not about levers and messages.
PLACE_CAUSES = frozenset(
    {ReasonCode.LIMIT_NEAR, ReasonCode.PUSHED_AWAY, ReasonCode.LIMIT_REACHED, ReasonCode.INSIDE_LIMIT}
)

#: What automatic motion itself says of a place.
GAVE_WAY = frozenset({ReasonCode.GIVES_WAY, ReasonCode.STUCK})


@dataclass(frozen=True, slots=True)
class Held:
    """One limit that held automatic motion.

    Attributes:
        limit: its id. spans: from and to [s].
        off_m, at_s: how far the tool was from where it was to be, at most meanwhile, and when; NaN where it was on
            its way to a goal without a plan.
    """

    limit: str
    spans: tuple[tuple[float, float], ...]
    off_m: float
    at_s: float

    @property
    def seconds(self) -> float:
        """How long in all [s]."""
        return sum(end - start for start, end in self.spans)


def off_path(auto: AutoSeries) -> Floats:
    """Return how far the tool was from where it was to be (n,) [m]; NaN where nothing said where that was."""
    planned = np.array([*(not math.isnan(job.planned_s) for job in auto.jobs), False])
    return np.where(planned[auto.which], auto.error_m, np.nan)


def held_by(result: RunResult) -> tuple[Held, ...]:
    """Return the limits that held automatic motion, the one that pushed it farthest off first.

    At every tick it is the limit automatic motion itself names, else the one before which the guard left least. A
    pause of less than `PAUSE_S` does not end a stretch.
    """
    auto = result.automatic
    if auto is None:
        return ()
    owner, limits = _owners(result, auto)
    off = np.nan_to_num(off_path(auto), nan=-np.inf)
    found = []
    for index, limit in enumerate(limits):
        ticks = np.flatnonzero(owner == index)
        if not len(ticks):
            continue
        worst = ticks[int(np.argmax(off[ticks]))]
        known = np.isfinite(off[worst])
        off_m, at_s = (float(off[worst]), float(result.series.t_s[worst])) if known else (math.nan, math.nan)
        found.append(Held(limit, _spans(result, ticks), off_m, at_s))
    return tuple(sorted(found, key=lambda one: (-np.nan_to_num(one.off_m, nan=-1.0), -one.seconds)))


def _owners(result: RunResult, auto: AutoSeries) -> tuple[Ints, list[str]]:
    """Return the index (n,) of the limit that held each tick, -1 for none, and the limits."""
    causes = [cause for cause in result.interventions if cause.limit is not None]
    causes = [cause for cause in causes if cause.reason in PLACE_CAUSES | GAVE_WAY]
    limits = list(dict.fromkeys(cause.limit for cause in causes if cause.limit is not None))
    owner = np.full(len(result.series), -1)
    t = result.series.t_s + 0.5 * result.tick_s

    def order(cause: Intervention) -> tuple[bool, float]:
        return cause.reason in GAVE_WAY, -(1.0 if cause.scale is None else cause.scale)

    for cause in sorted(causes, key=order):
        assert cause.limit is not None
        owner[(t > cause.t_s) & (t < cause.until_s) & (auto.which >= 0)] = limits.index(cause.limit)
    return owner, limits


def _spans(result: RunResult, ticks: Ints) -> tuple[tuple[float, float], ...]:
    """Return the stretches that ticks (k,) make up, short pauses closed."""
    t = result.series.t_s[ticks]
    begins = np.flatnonzero(np.diff(t, prepend=-np.inf) > PAUSE_S + result.tick_s)
    ends = [*(begins[1:] - 1), len(t) - 1]
    return tuple((float(t[a]), float(t[b]) + result.tick_s) for a, b in zip(begins, ends, strict=True))
