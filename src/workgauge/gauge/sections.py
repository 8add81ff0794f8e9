"""What is swept along a track: the envelope's section, or the no-go section round a wire above it.

A section here stands upright and square to the alignment in plan; its coordinates are (left, up) from the alignment's
point at profile height.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from workgauge.gauge.envelope import QuasiStatic, cant_angle, required_half_width, rotate
from workgauge.gauge.trackline import LineState
from workgauge.gauge.widening import TrackWidening
from workgauge.values.arrays import Floats

#: A corner that turns by more than this is bevelled [rad].
SHARP = math.radians(100.0)


class Section(Protocol):
    """A section swept along a line; k edges, the same number everywhere."""

    def vertices(self, state: LineState) -> Floats:
        """Return points (m, v, 2) whose convex hull contains the section at each place."""
        ...

    def edges(self, state: LineState) -> tuple[Floats, Floats]:
        """Return (normals (m, k, 2), corners (m, k, 2)) of a convex polygon that fits the section at each place.

        Counter-clockwise; edge i runs from corner i to i + 1; an edge that bevels a sharp corner has no length.
        """
        ...

    def breaks(self) -> Floats:
        """Return the distances where the section changes abruptly, beside the line's own [m]."""
        ...


@dataclass(frozen=True, slots=True)
class CantRotation:
    """How cant turns a section.

    Attributes:
        base: between the rails' contact points [m].
        pivot: `centre`, `low_rail`, `high_rail`, `left_rail` or `right_rail`.
    """

    base: float
    pivot: str

    def turn(self, left: Floats, up: Floats, cant: Floats) -> tuple[Floats, Floats]:
        """Turn points (m, v) by signed cants (m,), positive with the low rail on the left."""
        sign = np.where(cant < 0, -1.0, 1.0)[:, None]
        return self._turn(left * sign, up, np.abs(cant), sign)

    def _turn(self, inside: Floats, up: Floats, cant: Floats, sign: Floats) -> tuple[Floats, Floats]:
        half = self.base / 2
        pivots = {"centre": 0.0, "low_rail": half, "high_rail": -half}
        fixed = half if self.pivot == "left_rail" else -half
        pivot = np.broadcast_to(pivots[self.pivot], sign.shape) if self.pivot in pivots else fixed * sign
        y, z = rotate(inside, up, cant_angle(cant, self.base)[:, None], pivot)
        return y * sign, z


@dataclass(frozen=True, slots=True, eq=False)
class EnvelopeSection:
    """The kinematic envelope's section, or one convex piece of it between two heights.

    Attributes:
        half_widths, heights: (p,) the reference profile, bottom to top.
        corners: indices of the profile rows that are corners of its hull.
        margin: the rule book's own margin [m].
        widening: per side, or None. lean: quasi-static part, or None. cant: rotation, or None.
        kinks: distances where the section's rate of change jumps, beside the line's own breaks [m].
    """

    half_widths: Floats
    heights: Floats
    corners: tuple[int, ...]
    margin: float
    widening: TrackWidening | None
    lean: QuasiStatic | None
    cant: CantRotation | None
    kinks: Floats

    def breaks(self) -> Floats:
        """Return where an early widening begins or ends abruptly, and the kinks [m]."""
        return self.kinks if self.widening is None else np.concatenate([self.kinks, self.widening.breaks()])

    def vertices(self, state: LineState) -> Floats:
        """Return the section's true corners (m, 2p, 2), left side bottom to top, then right side top to bottom."""
        side = self._sides(state)
        lean = np.zeros((len(state.distance), 2, len(self.heights)))
        if self.lean is not None:
            lean = self._slopes(state)[:, :, None] * np.maximum(self.heights - self.lean.height, 0.0)
        width = required_half_width(self.half_widths, side[:, :, None], lean, self.margin)
        return self._turned(width, self.heights, state)

    def edges(self, state: LineState) -> tuple[Floats, Floats]:
        """Return the fitting polygon: the profile's hull, each side sheared by its lean, which keeps it convex."""
        chosen = list(self.corners)
        side, h = self._sides(state), self.heights[chosen]
        tilt = self._slopes(state)[:, :, None] * (h - h[0])
        width = required_half_width(self.half_widths[chosen], side[:, :, None], tilt, self.margin)
        polygon = self._turned(width, h, state)
        b = self.half_widths[chosen]
        plain = np.stack([np.concatenate([b, -b[::-1]]), np.concatenate([h, h[::-1]])], axis=-1)
        return _bevelled(polygon, _sharp_corners(plain))

    def _sides(self, state: LineState) -> Floats:
        if self.widening is None:
            return np.zeros((len(state.distance), 2))
        return self.widening.at(state.distance)

    def _slopes(self, state: LineState) -> Floats:
        """Return the lean per metre of height (m, 2) left, right: cant leans to the low rail, deficiency outwards."""
        if self.lean is None:
            return np.zeros((len(state.distance), 2))
        by_cant = self.lean.slope(state.cant)
        by_deficiency = self.lean.slope(self.lean.assumed_deficiency(state.curvature))
        left = np.maximum(np.where(state.cant > 0, by_cant, 0.0), np.where(state.curvature < 0, by_deficiency, 0.0))
        right = np.maximum(np.where(state.cant < 0, by_cant, 0.0), np.where(state.curvature > 0, by_deficiency, 0.0))
        return np.stack([left, right], axis=-1)

    def _turned(self, width: Floats, heights: Floats, state: LineState) -> Floats:
        left = np.concatenate([width[:, 0], -width[:, 1, ::-1]], axis=1)
        up = np.broadcast_to(np.concatenate([heights, heights[::-1]]), left.shape)
        if self.cant is not None:
            left, up = self.cant.turn(left, up, state.cant)
        return np.stack([left, up], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class WireSection:
    """An upright rectangle round a wire above the rails; the wire follows the cant, the rectangle stays upright.

    Attributes:
        height: of the wire above the top of rail [m].
        below, side, above: no-go distances [m]; `side` already holds the stagger.
    """

    height: float
    below: float
    side: float
    above: float
    cant: CantRotation | None

    def breaks(self) -> Floats:
        """Return nothing: a wire has no abrupt changes of its own."""
        return np.empty(0)

    def vertices(self, state: LineState) -> Floats:
        """Return the rectangle's corners (m, 4, 2), counter-clockwise from the lower right."""
        left, up = np.zeros((len(state.distance), 1)), np.full((len(state.distance), 1), self.height)
        if self.cant is not None:
            left, up = self.cant.turn(left, up, state.cant)
        corners = np.array(
            [[-self.side, -self.below], [self.side, -self.below], [self.side, self.above], [-self.side, self.above]]
        )
        return np.asarray(np.stack([left, up], axis=-1) + corners, dtype=np.float64)

    def edges(self, state: LineState) -> tuple[Floats, Floats]:
        """Return the rectangle itself."""
        polygon = self.vertices(state)
        return edge_normals(polygon), polygon


def edge_normals(polygon: Floats) -> Floats:
    """Return the outward unit normals (m, k, 2) of counter-clockwise polygons (m, k, 2)."""
    along = np.roll(polygon, -1, axis=1) - polygon
    normals = np.stack([along[..., 1], -along[..., 0]], axis=-1)
    return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True))


def _sharp_corners(polygon: Floats) -> list[int]:
    """Return the corners of a counter-clockwise polygon (k, 2) that turn by more than SHARP."""
    normals = edge_normals(polygon[None])[0]
    turns = np.arccos(np.clip(np.sum(np.roll(normals, 1, axis=0) * normals, axis=1), -1.0, 1.0))
    return [int(i) for i in np.flatnonzero(turns > SHARP)]


def _bevelled(polygons: Floats, sharp: Sequence[int]) -> tuple[Floats, Floats]:
    """Return (normals, corners) of polygons (m, k, 2) with an edge of no length across each sharp corner.

    Sides moved outwards meet far beyond a sharp corner; the edge across it keeps them from that.
    """
    normals = edge_normals(polygons)
    if not sharp:
        return normals, polygons
    across = np.roll(normals, 1, axis=1)[:, sharp] + normals[:, sharp]
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    return np.insert(normals, sharp, across, axis=1), np.insert(polygons, sharp, polygons[:, sharp], axis=1)


def convex_pieces(half_widths: Floats, heights: Floats, tolerance: float) -> list[tuple[int, int, tuple[int, ...]]]:
    """Split a profile into bands of rows whose hull adds at most `tolerance` [m] to the half-width.

    Args:
        half_widths, heights: (p,) rows, bottom to top; two rows at one height are a step.

    Returns:
        (first row, last row, corner rows counted from the first) per band; bands share their boundary row or step.
    """
    pieces, first, last = [], 0, len(heights) - 1
    while first < last:
        if heights[first] == heights[first + 1]:
            first += 1
            continue
        stop = next(
            stop
            for stop in range(last, first, -1)
            if heights[stop] > heights[first]
            and (stop == first + 1 or _hull_excess(half_widths, heights, first, stop) <= tolerance)
        )
        pieces.append((first, stop, tuple(i - first for i in _hull_rows(half_widths, heights, first, stop))))
        first = stop
    return pieces


def _hull_rows(b: Floats, h: Floats, first: int, stop: int) -> list[int]:
    """Return the rows on the outer hull of one side, bottom to top, those on a straight edge left out."""
    rows: list[int] = []
    for i in range(first, stop + 1):
        while rows and h[rows[-1]] == h[i] and b[rows[-1]] <= b[i]:
            rows.pop()
        if rows and h[rows[-1]] == h[i]:
            continue
        while len(rows) >= 2:
            p, q = rows[-2], rows[-1]
            if (b[q] - b[p]) * (h[i] - h[p]) - (b[i] - b[p]) * (h[q] - h[p]) > 1e-9:
                break
            rows.pop()
        rows.append(i)
    return rows


def _hull_excess(b: Floats, h: Floats, first: int, stop: int) -> float:
    """Return how far the hull of rows first..stop stands out from the profile at most [m]."""
    rows = _hull_rows(b, h, first, stop)
    inner = range(first, stop + 1)
    return max(float(np.interp(h[i], h[rows], b[rows]) - b[i]) for i in inner) if len(rows) > 1 else math.inf
