"""A section swept along a track as a chain of convex prisms that covers all of it and hardly more.

A cell spans a piece of the track; its axis is the chord, its sides are half-planes parallel to it. Each half-plane
is the support of the section over sub-stations of the cell, seen along the chord, plus a pad that bounds what the
section does between two sub-stations. A cell reaches past its ends as far as its end sections do, which stand square
to the curve and not to the chord.
"""

from dataclasses import dataclass

import numpy as np

from workgauge.gauge.sections import Section
from workgauge.gauge.trackline import NUDGE, LineState, TrackLine, merged
from workgauge.values.arrays import Floats, Ints, freeze
from workgauge.values.solids import PrismChain

#: Cells shorter than this take their direction from the tangent in the middle [m].
SHORT_CHORD = 0.5
#: Longest cell [m]; between its sub-stations a widening cannot rise and fall unseen.
LONGEST_CELL = 40.0
#: Sub-stations per cell, both ends included.
STATIONS = 5
#: Added to every side: what rounding, single precision in exports included, may take away [m].
LEAST_PAD = 5e-5
#: Every cell reaches at least this far past its ends [m].
LEAST_REACH = 2e-3
#: Beside an end of the track, or a place where the section changes by SHORTEST_JUMP at once, cells are this long [m]:
#: a short cell reaches hardly past its end.
BESIDE, SHORTEST_JUMP = 1.0, 2e-3
#: Shortest edge of a cell's polygon [m].
SHORTEST_EDGE = 1e-4
#: A cell whose sides stand out from a section within it by more than this many times the accuracy is halved, as long
#: as the halves are no shorter than SHORTEST_CELL [m].
MOST_SURPLUS, SHORTEST_CELL = 1.6, 0.25
#: Cells worked on at once, to bound the memory.
BATCH = 4096


def prism_chain(line: TrackLine, section: Section, accuracy: float) -> PrismChain:
    """Sweep a section along a whole track line.

    Args:
        line: in the local site frame.
        section: upright and square to the line in plan.
        accuracy: how much a cell may add to the section by spanning a curve or a changing section [m].

    Returns:
        A chain in the local site frame that contains the section at every distance, also if the section is read
        square to the gradient instead of upright.
    """
    nodes = _nodes(line, section, accuracy)
    spans = np.stack([nodes[:-1], nodes[1:]], axis=-1)
    done: list[tuple[Floats, ...]] = []
    while len(spans):
        halves = []
        for first in range(0, len(spans), BATCH):
            batch = spans[first : first + BATCH]
            *cells, surplus = _cells(line, section, batch)
            poor = (surplus > MOST_SURPLUS * accuracy) & (batch[:, 1] - batch[:, 0] > 2 * SHORTEST_CELL)
            done.append((batch[~poor], *(part[~poor] for part in cells)))
            middle = batch[poor].mean(axis=1)
            halves += [np.stack([batch[poor, 0], middle], axis=-1), np.stack([middle, batch[poor, 1]], axis=-1)]
        spans = np.concatenate(halves)
    chainages, *parts = (np.concatenate([cells[i] for cells in done]) for i in range(5))
    order = np.argsort(chainages[:, 0], kind="stable")
    chainages, starts, ends, laterals, sections = (part[order] for part in (chainages, *parts))
    neighbours = np.ones((len(starts), 2), dtype=np.bool_)
    neighbours[0, 0] = neighbours[-1, 1] = False
    for array in (starts, ends, laterals, sections, chainages, neighbours):
        freeze(array)
    return PrismChain(starts, ends, laterals, sections, chainages, neighbours)


def _nodes(line: TrackLine, section: Section, accuracy: float) -> Floats:
    """Return the distances where cells begin and end: every break, and as many between as the accuracy needs."""
    marks = merged(line.breaks, section.breaks())
    beside = np.concatenate([[0.0, line.length], _jumps(line, section, marks)])
    beside = np.concatenate([beside - BESIDE, beside + BESIDE])
    marks = merged(marks, beside[(beside > 0) & (beside < line.length)])
    marks = _divided(marks, LONGEST_CELL)
    low, high = marks[:-1] + NUDGE, marks[1:] - NUDGE
    span = high - low
    looks = 9
    state = line.at((low[:, None] + np.linspace(0.0, 1.0, looks) * span[:, None]).ravel())
    shapes = section.vertices(state).reshape(len(span), looks, -1, 2)
    moved = np.max(np.linalg.norm(np.diff(shapes, axis=1), axis=-1), axis=(1, 2))
    rate = moved * (looks - 1) / span
    sag = np.max(np.abs(np.diff(state.gradient.reshape(-1, looks), axis=1)), axis=1) * (looks - 1) / span
    bend = np.maximum(sag, np.max(np.abs(state.curvature.reshape(-1, looks)), axis=1))
    # bend/8 c² + rate c = accuracy: the sagitta, and the section's change
    longest = 2 * accuracy / (rate + np.sqrt(rate**2 + bend * accuracy / 2) + 1e-12)
    return _divided(marks, np.minimum(longest, LONGEST_CELL))


def _jumps(line: TrackLine, section: Section, marks: Floats) -> Floats:
    """Return those marks where the section changes at once."""
    sides = [section.vertices(line.at(marks + side)) for side in (-NUDGE, NUDGE)]
    return np.asarray(marks[np.max(np.abs(sides[1] - sides[0]), axis=(1, 2)) > SHORTEST_JUMP], dtype=np.float64)


def _divided(marks: Floats, longest: Floats | float) -> Floats:
    """Cut each interval between marks into equal parts no longer than `longest` (one for all, or one each)."""
    span = np.diff(marks)
    count = np.maximum(np.ceil(span / longest - 1e-9), 1).astype(np.int64)
    first = np.repeat(np.cumsum(count) - count, count)
    share = (np.arange(int(count.sum())) - first) / np.repeat(count, count)
    return np.append(np.repeat(marks[:-1], count) + share * np.repeat(span, count), marks[-1])


@dataclass(frozen=True, slots=True)
class _Seen:
    """A cell's sub-stations seen along its chord; c cells, s sub-stations, v vertices.

    Attributes:
        state: at (c s,) places. vertices: (c, s, v, 2) in the section's own plane.
        across, height: (c, s, v) left of the chord and above it at the vertex's own place [m].
        along: (c, s, v) from the chord's start [m].
    """

    state: LineState
    vertices: Floats
    across: Floats
    height: Floats
    along: Floats


def _cells(line: TrackLine, section: Section, spans: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Return (starts, ends, laterals, sections) of the cells over spans (c, 2), and what each adds at most (c,)."""
    low, high = spans[:, 0] + NUDGE, spans[:, 1] - NUDGE
    cells = len(low)
    d = low[:, None] + np.linspace(0.0, 1.0, STATIONS) * (high - low)[:, None]
    state = line.at(d.ravel())
    points = state.points.reshape(cells, STATIONS, 3)
    middle = line.at((low + high) / 2)
    chord = points[:, -1] - points[:, 0]
    # rounding of absolute coordinates would turn a very short chord
    tangent = np.concatenate([middle.forward, middle.gradient[:, None]], axis=1) * (high - low)[:, None]
    chord = np.where((high - low < SHORT_CHORD)[:, None], tangent, chord)
    length = np.hypot(chord[:, 0], chord[:, 1])
    forward = chord[:, :2] / length[:, None]
    lateral = np.stack([-forward[:, 1], forward[:, 0]], axis=-1)
    slope = chord[:, 2] / length
    seen = _seen_along(section, state, points, forward, lateral, slope)
    normals, corners = section.edges(middle)
    pad = _pad(seen, high - low)
    across, up = normals[..., 0, None, None], normals[..., 1, None, None]
    supports = np.max(seen.across[:, None] * across + seen.height[:, None] * up, axis=3)
    support = np.max(supports, axis=2) + pad[:, None]
    surplus = np.max(support - np.min(supports, axis=2), axis=1)
    polygons = _polygons(normals, support, corners)

    before = np.maximum(-np.min(seen.along, axis=(1, 2)), 0.0) + LEAST_REACH
    after = np.maximum(np.max(seen.along, axis=(1, 2)) - length, 0.0) + LEAST_REACH
    axis = np.concatenate([forward, slope[:, None]], axis=1)
    starts = points[:, 0] - before[:, None] * axis
    ends = points[:, 0] + (length + after)[:, None] * axis
    return starts, ends, np.concatenate([lateral, np.zeros((cells, 1))], axis=1), polygons, surplus


def _seen_along(
    section: Section, state: LineState, points: Floats, forward: Floats, lateral: Floats, slope: Floats
) -> _Seen:
    """Look at every sub-station's section along the cell's chord."""
    cells, stations = points.shape[:2]
    vertices = section.vertices(state).reshape(cells, stations, -1, 2)
    left = state.left.reshape(cells, stations, 2)
    offset = points - points[:, :1]
    side, up = vertices[..., 0], vertices[..., 1]
    along = (
        np.einsum("csi,ci->cs", offset[..., :2], forward)[..., None]
        + side * np.einsum("csi,ci->cs", left, forward)[..., None]
    )
    across = (
        np.einsum("csi,ci->cs", offset[..., :2], lateral)[..., None]
        + side * np.einsum("csi,ci->cs", left, lateral)[..., None]
    )
    height = offset[..., 2:] + up - slope[:, None, None] * along
    return _Seen(state, vertices, across, height, along)


def _pad(seen: _Seen, span: Floats) -> Floats:
    """Bound what the section may do beyond the larger of two neighbouring sub-stations (c,) [m].

    Between sub-stations a step h apart the line bows by bend h²/8. The section itself bows by at most its second
    difference, even if its rate jumps once in between. Where the cant changes sides its pivot does too. And a section
    read square to a gradient g reaches z g²/2 higher and z g further along.
    """
    cells, stations = seen.across.shape[:2]
    step = span / (stations - 1)
    curvature = np.max(np.abs(seen.state.curvature.reshape(cells, stations)), axis=1)
    gradient = seen.state.gradient.reshape(cells, stations)
    cant = seen.state.cant.reshape(cells, stations)
    bend = curvature + np.max(np.abs(np.diff(gradient, axis=1)), axis=1) / step
    reach = np.max(np.abs(seen.vertices), axis=(1, 2, 3))
    line = bend * step**2 / 8 * (1 + reach * curvature) + reach * (curvature * step) ** 2 / 8
    moves = np.diff(seen.vertices, axis=1)
    change = np.max(np.linalg.norm(moves, axis=-1), axis=(1, 2))
    section = np.max(np.linalg.norm(np.diff(moves, axis=1), axis=-1), axis=(1, 2))
    turned_over = np.where(np.min(cant, axis=1) * np.max(cant, axis=1) < 0, change, 0.0)
    steepest = np.max(np.abs(gradient), axis=1)
    tilted = reach * steepest**2 / 2 + change / step * reach * steepest
    return np.asarray(line + section + turned_over + tilted + LEAST_PAD)


def _polygons(normals: Floats, support: Floats, corners: Floats) -> Floats:
    """Intersect half-planes `normal · p <= support` (c, k) to polygons (c, k, 2).

    Where a half-plane would have no edge left, the polygon is instead the fitting one moved outwards evenly, which
    keeps every edge and contains the intersection.
    """
    polygons = _intersections(normals, support)
    along = np.stack([-normals[..., 1], normals[..., 0]], axis=-1)
    lengths = np.einsum("cki,cki->ck", np.roll(polygons, -1, axis=1) - polygons, along)
    poor: Ints = np.flatnonzero(np.min(lengths, axis=1) < SHORTEST_EDGE)
    if len(poor):
        own = np.einsum("cki,cki->ck", corners[poor], normals[poor])
        even = own + np.maximum(np.max(support[poor] - own, axis=1, keepdims=True), 0.0)
        polygons[poor] = _intersections(normals[poor], even)
    return polygons


def _intersections(normals: Floats, support: Floats) -> Floats:
    """Return corner i (c, k, 2) where the lines of edges i − 1 and i meet."""
    n0, s0 = np.roll(normals, 1, axis=1), np.roll(support, 1, axis=1)
    cross = n0[..., 0] * normals[..., 1] - n0[..., 1] * normals[..., 0]
    x = (s0 * normals[..., 1] - support * n0[..., 1]) / cross
    y = (n0[..., 0] * support - normals[..., 0] * s0) / cross
    return np.stack([x, y], axis=-1)
