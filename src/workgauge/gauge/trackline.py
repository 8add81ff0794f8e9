"""An alignment in the local site frame, with a height everywhere: the line a section is swept along."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from workgauge.gauge.heights import ORIGINS, Origin, SiteHeights, profile_span
from workgauge.site.alignment import Alignment
from workgauge.values.arrays import Floats, Ints

#: Where an alignment has no heights of its own, one is taken this often along it [m].
HEIGHT_STEP = 5.0
#: A profile may be shorter than its alignment by this much at each end without a warning [m].
SHORT_PROFILE = 0.5
#: Places along a line closer than this are one place [m].
MERGE = 2e-5
#: Distances this close to a break are moved off it, so that each side of a break answers for itself [m].
NUDGE = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class LineState:
    """A track line at m places.

    Attributes:
        distance: (m,) along the alignment [m].
        points: (m, 3) in the local site frame [m].
        forward, left: (m, 2) horizontal unit vectors, square to each other.
        curvature: (m,) positive to the left [1/m]. gradient: (m,) [m/m]. cant: (m,) signed [m].
    """

    distance: Floats
    points: Floats
    forward: Floats
    left: Floats
    curvature: Floats
    gradient: Floats
    cant: Floats


class TrackLine:
    """An alignment with its heights filled in.

    Args:
        alignment: the alignment.
        origin: (3,) absolute origin of the local frame [m].
        filled: (distances, absolute heights) [m], linear between, used where `own` does not reach.
        own: from where to where along it the alignment's own profile counts [m], or None if nowhere.
    """

    def __init__(
        self, alignment: Alignment, origin: Floats, filled: tuple[Floats, Floats], own: tuple[float, float] | None
    ) -> None:
        self.alignment = alignment
        self.origin = origin
        self.length = float(alignment.length)
        self._filled, self._own = filled, own
        inner = np.concatenate([np.asarray(alignment.breaks, dtype=np.float64), filled[0]])
        self.breaks: Floats = merged(np.array([0.0, self.length]), np.clip(inner, 0.0, self.length))

    def at(self, distances: Floats) -> LineState:
        """Return the state at distances (m,) within the alignment."""
        d = np.clip(distances, 0.0, self.length)
        state = self.alignment.at(d)
        z, gradient = np.interp(d, *self._filled), _slopes(*self._filled, d)
        if self._own is not None and self.alignment.profile is not None:
            within = (d >= self._own[0]) & (d <= self._own[1])
            z[within], gradient[within] = self.alignment.profile.at(d[within])
        s, c = np.sin(state.heading), np.cos(state.heading)
        return LineState(
            d,
            np.stack([state.e, state.n, z], axis=-1) - self.origin,
            np.stack([s, c], axis=-1),
            np.stack([-c, s], axis=-1),
            np.asarray(state.curvature),
            np.asarray(gradient),
            np.asarray(state.cant),
        )


def merged(first: Floats, more: Floats) -> Floats:
    """Return `first` and those of `more` that lie farther than MERGE from them and from each other, sorted."""
    out = np.unique(first)
    extra = np.unique(more)
    extra = extra[np.diff(extra, prepend=-np.inf) > MERGE]
    i = np.searchsorted(out, extra)
    below = extra - out[np.maximum(i - 1, 0)]
    above = out[np.minimum(i, len(out) - 1)] - extra
    free = ((i == 0) | (below > MERGE)) & ((i == len(out)) | (above > MERGE))
    return np.unique(np.concatenate([out, extra[free]]))


def _slopes(knots: Floats, heights: Floats, d: Floats) -> Floats:
    """Return the slope of a polyline at each distance, 0 beyond its ends."""
    if len(knots) < 2:
        return np.zeros_like(d)
    i = np.clip(np.searchsorted(knots, d, side="right") - 1, 0, len(knots) - 2)
    inside = (d >= knots[0]) & (d <= knots[-1])
    return np.where(inside, np.diff(heights)[i] / np.diff(knots)[i], 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class FilledLine:
    """A track line, and what its heights are made of.

    Attributes:
        line: with a height everywhere; where none is known, that of the nearest place that has one.
        used: absolute heights made up, by where they are from [m].
        unknown: (from, to) along the alignment where no height is known [m].
    """

    line: TrackLine
    used: Mapping[Origin, Floats]
    unknown: tuple[tuple[float, float], ...]


def filled_line(alignment: Alignment, heights: SiteHeights, origin: Floats, rail_above_surface: float) -> FilledLine:
    """Return an alignment's line with heights where its own profile has none.

    A profile short of the alignment's end by no more than SHORT_PROFILE carries on at its end gradient. Elsewhere a
    height is taken every HEIGHT_STEP, linear between.

    Args:
        heights: where missing heights are from. origin: of the local frame.
        rail_above_surface: how far above a surface the top of rail is taken to lie [m].
    """
    length, own = float(alignment.length), profile_span(alignment)
    first, last = own or (length, length)
    d = np.empty(0)
    if first > SHORT_PROFILE or own is None:
        d = np.append(d, np.linspace(0.0, first, max(int(np.ceil(first / HEIGHT_STEP)), 1) + 1))
    if own is not None and length - last > SHORT_PROFILE:
        d = np.append(d, np.linspace(last, length, int(np.ceil((length - last) / HEIGHT_STEP)) + 1))
    if own is not None:
        d = d[(d < first) | (d > last)]
    z, source = np.empty(0), np.empty(0, dtype=np.int64)
    if len(d):
        state = alignment.at(d)
        z, source = heights.at(np.column_stack([state.e, state.n]))
        z = np.where(source == ORIGINS.index(Origin.SURFACE), z + rail_above_surface, z)
    used = {ORIGINS[i]: z[source == i] for i in np.unique(source)}
    knots, values = d, z
    if own is not None and alignment.profile is not None:
        ends = np.array([first, last])
        z_ends, gradients = alignment.profile.at(ends)
        knots, values = np.append(d, ends), np.append(z, z_ends)
        for i, edge in ((0, 0.0), (1, length)):
            if 0.0 < abs(ends[i] - edge) <= SHORT_PROFILE:
                knots, values = np.append(knots, edge), np.append(values, z_ends[i] + gradients[i] * (edge - ends[i]))
    order = np.argsort(knots, kind="stable")
    knots, values = knots[order], values[order]
    known = np.isfinite(values)
    unknown = _gaps(knots, known)
    if known.any():
        values = np.interp(knots, knots[known], values[known])
    else:
        values = np.full(len(knots), (heights.low + heights.high) / 2)
    return FilledLine(TrackLine(alignment, origin, _bends(knots, values), own), used, unknown)


def flat_line(alignment: Alignment, origin: Floats, height: float, marks: tuple[float, float]) -> TrackLine:
    """Return an alignment's line at one absolute height [m], whatever its profile; `marks` become breaks of it."""
    return TrackLine(alignment, origin, (np.array(marks), np.full(2, height)), None)


def _bends(knots: Floats, heights: Floats) -> tuple[Floats, Floats]:
    """Return the knots of a polyline without those on a straight piece."""
    run, rise = np.diff(knots), np.diff(heights)
    bend = np.abs(rise[:-1] * run[1:] - rise[1:] * run[:-1]) > 1e-9
    keep = np.concatenate([[True], bend, [True]]) if len(knots) > 1 else np.ones(1, dtype=np.bool_)
    return knots[keep], heights[keep]


def _gaps(knots: Floats, known: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> tuple[tuple[float, float], ...]:
    """Return the stretches round unknown knots, from the known knot before to the known one after each."""
    missing: Ints = np.flatnonzero(~known)
    if not len(missing):
        return ()
    runs = np.split(missing, np.flatnonzero(np.diff(missing) > 1) + 1)
    last = len(knots) - 1
    return tuple((float(knots[max(run[0] - 1, 0)]), float(knots[min(run[-1] + 1, last)])) for run in runs)
