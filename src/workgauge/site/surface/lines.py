"""Lines in plan for a bucket to be drawn along: side by side, as a fan, along an alignment."""

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from workgauge.site.alignment import Alignment
from workgauge.values.arrays import Floats
from workgauge.values.errors import InputError

#: A curve's chords leave it by no more than this [m].
CHORD_M = 1e-3
#: And are no longer than this [m].
_LONGEST_M = 5.0
#: Nor does anything lie farther from a machine or an alignment [m].
FARTHEST_M = 1e3
#: No more lines than this at once.
MOST_LINES = 1000


def side_by_side(
    centre: ArrayLike, yaw: float, nearest_m: float, farthest_m: float, count: int = 3, spacing_m: float = 1.0
) -> list[Floats]:
    """Return straight lines (2, 2) along a machine's x axis, each from far to near (Makkonen 9 to 12).

    The middle one first, as L1, then to the right and to the left in turn, as L2 and L3; of an even number none is in
    the middle. (9)'s direction is a unit vector here, and (12)'s sideways one the machine's left in plan.

    Args:
        centre: (2,) of the machine, absolute east, north [m]. yaw: of its x axis, counter-clockwise from east [rad].
        nearest_m, farthest_m: how far from the centre they begin and end, along x [m].

    Raises:
        InputError: for distances or numbers that make no lines.
    """
    _checked_reach(nearest_m, farthest_m)
    if not 1 <= count <= MOST_LINES:
        raise InputError("not a number of lines", element="lines", value=count, allowed=f"1 to {MOST_LINES}")
    if not (0.0 < spacing_m <= FARTHEST_M):
        raise InputError(
            "not a spacing of lines", element="spacing", value=f"{spacing_m:.6g}", allowed="above 0, at most 1000 m"
        )
    forward = np.array([math.cos(yaw), math.sin(yaw)])
    left = np.array([-forward[1], forward[0]])
    offsets = sorted(((np.arange(count) - 0.5 * (count - 1)) * spacing_m).tolist(), key=lambda o: (abs(o), o))
    middle = np.asarray(centre, dtype=np.float64)[:2]
    return [middle + o * left + np.outer([farthest_m, nearest_m], forward) for o in offsets]


def fan(centre: ArrayLike, yaws: Sequence[float], nearest_m: float, farthest_m: float) -> list[Floats]:
    """Return straight lines (2, 2) towards a swing axis, each from far to near.

    Args:
        centre: (2,) the swing axis, absolute [m]. yaws: of the lines seen from it, counter-clockwise from east [rad].

    Raises:
        InputError: for distances that make no lines.
    """
    _checked_reach(nearest_m, farthest_m)
    middle = np.asarray(centre, dtype=np.float64)[:2]
    return [middle + np.outer([farthest_m, nearest_m], [math.cos(yaw), math.sin(yaw)]) for yaw in yaws]


def beside(alignment: Alignment, offset_m: float, begin_m: float, end_m: float) -> Floats:
    """Return places (k, 2) along an alignment at an offset to its left, `CHORD_M` from it at most.

    Args:
        offset_m: positive left, horizontally and square to it [m].
        begin_m, end_m: along the alignment [m]; held to its ends.

    Raises:
        InputError: nothing of it lies between, or the offset is none.
    """
    low, high = max(begin_m, 0.0), min(end_m, alignment.length)
    if not (abs(offset_m) <= FARTHEST_M and high > low):
        value = f"{begin_m:.2f} to {end_m:.2f} m, {offset_m:.6g} m to the left"
        raise InputError(
            "nothing of the alignment is there",
            element=f"alignment {alignment.name!r}",
            value=value,
            allowed=f"0 to {alignment.length:.2f} m, 1000 m to either side",
        )
    marks = np.unique(
        np.concatenate([[low, high], alignment.breaks[(alignment.breaks > low) & (alignment.breaks < high)]])
    )
    places = [marks[:1]]
    for a, b in itertools.pairwise(marks):
        bend = np.abs(alignment.at(np.linspace(a + 1e-6 * (b - a), b - 1e-6 * (b - a), 9)).curvature)
        stretch = 1.0 + abs(offset_m) * float(bend.max())  # the line beside a bend is as much longer, or sharper
        chord = math.sqrt(8.0 * CHORD_M / max(float(bend.max()) * stretch, 1e-9))
        parts = max(1, math.ceil((b - a) / min(chord, _LONGEST_M)))
        places.append(a + (b - a) * np.arange(1, parts + 1) / parts)
    return alignment.at(np.concatenate(places)).offset_points(offset_m)


def within_ring(line: ArrayLike, centre: ArrayLike, nearest_m: float, farthest_m: float) -> list[Floats]:
    """Return the stretches (k, 2) of a line (p, 2) that lie between two distances from a centre (2,), exactly."""
    _checked_reach(nearest_m, farthest_m)
    plan = np.asarray(line, dtype=np.float64).reshape(-1, 2) - np.asarray(centre, dtype=np.float64)[:2]
    found: list[list[Floats]] = []
    open_ = False
    for a, b in itertools.pairwise(plan):
        d = b - a
        square = float(d @ d)
        if square == 0.0:
            continue
        cuts = {0.0, 1.0}
        for radius in (nearest_m, farthest_m):
            half, rest = float(a @ d) / square, (float(a @ a) - radius**2) / square
            root = half**2 - rest
            if root > 0.0:
                cuts |= {t for t in (-half - math.sqrt(root), -half + math.sqrt(root)) if 0.0 < t < 1.0}
        marks = sorted(cuts)
        for low, high in itertools.pairwise(marks):
            inside = nearest_m <= float(np.linalg.norm(a + 0.5 * (low + high) * d)) <= farthest_m
            if inside:
                if not open_:
                    found.append([a + low * d])
                found[-1].append(a + high * d)
            open_ = inside
    return [np.array(places) + np.asarray(centre, dtype=np.float64)[:2] for places in found]


def towards(line: Floats, centre: ArrayLike) -> Floats:
    """Return a line (p, 2) turned so that it ends nearer to a centre (2,) than it begins."""
    ends = np.linalg.norm(line[[0, -1]] - np.asarray(centre, dtype=np.float64)[:2], axis=1)
    return line if ends[0] >= ends[1] else line[::-1]


def _checked_reach(nearest_m: float, farthest_m: float) -> None:
    if not 0.0 <= nearest_m < farthest_m <= FARTHEST_M:
        raise InputError(
            "not a reach",
            element="reach",
            value=f"{_short(nearest_m)} to {_short(farthest_m)} m",
            allowed="0 to 1000 m, growing",
        )


def _short(value: float) -> str:
    return f"{value:.2f}" if abs(value) < 1e6 else f"{value:.3g}"
