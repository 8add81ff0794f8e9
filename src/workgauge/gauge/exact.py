"""The exact swept envelope, evaluated straight from the formulas, for checking the limits made of it.

Nothing here is shared with the making of cells: widening is found by brute force over a fine grid, the section is the
profile itself and not its hull, and distances to it are taken in the plane square to the alignment.
"""

from dataclasses import dataclass

import numpy as np

from workgauge.gauge.envelope import cant_angle, required_half_width, rotate
from workgauge.gauge.trackline import LineState, TrackLine
from workgauge.gauge.tracks import TrackShape
from workgauge.values.arrays import Floats

#: Widening is tabulated this often [m], and on both sides of every place where it may jump.
GRID = 0.25
#: Half the gap between the two sides of such a place [m].
ASIDE = 2e-6
#: Points found farther outside than this are looked at along the track too [m].
WORTH_A_LOOK = 0.03
#: Points are worked on this many at a time.
BATCH = 20_000


@dataclass(frozen=True, slots=True, eq=False)
class ExactEnvelope:
    """One track's exact envelope.

    Attributes:
        shape: the rule's numbers. line: the track.
        grid: (g,) distances. widening: (g, 2) left and right there [m], linear between.
    """

    shape: TrackShape
    line: TrackLine
    grid: Floats
    widening: Floats

    @classmethod
    def of(cls, shape: TrackShape, line: TrackLine) -> "ExactEnvelope":
        """Tabulate a line's widening."""
        early = shape.early
        shifts = np.zeros(1)
        if early is not None:
            e = np.array([early.inside_from, early.outside_from, early.outside_full])
            shifts = np.concatenate([[0.0], e, -e])
        places = (np.asarray(line.breaks)[:, None] + shifts).ravel()
        grid = np.concatenate([np.arange(0.0, line.length, GRID), places - ASIDE, places + ASIDE])
        grid = np.unique(np.clip(grid, 0.0, line.length))
        return cls(shape, line, grid, _running_maximum(shape, grid, np.asarray(line.at(grid).curvature)))

    def sections(self, state: LineState) -> Floats:
        """Return the section's corners (m, 2p, 2) left, up; left side bottom to top, then the right side down."""
        shape, h = self.shape, self.shape.heights
        lean = np.zeros((2, len(state.distance), len(h)))
        if shape.lean is not None:
            by_cant = shape.lean.lean(state.cant[:, None], h)
            by_deficiency = shape.lean.lean(shape.lean.assumed_deficiency(state.curvature)[:, None], h)
            for side, sign in enumerate((1.0, -1.0)):
                leans, outer = sign * state.cant[:, None] > 0, sign * state.curvature[:, None] < 0
                lean[side] = np.maximum(by_cant * leans, by_deficiency * outer)
        sides = [
            required_half_width(
                shape.half_widths, np.interp(state.distance, self.grid, self.widening[:, side])[:, None], lean[side],
                shape.margin,
            )
            for side in (0, 1)
        ]  # fmt: skip
        left = np.concatenate([sides[0], -sides[1][:, ::-1]], axis=1)
        up = np.broadcast_to(np.concatenate([h, h[::-1]]), left.shape)
        if shape.cant is not None:
            low = np.where(state.cant < 0, -1.0, 1.0)[:, None]
            half = shape.cant.base / 2
            pivots = {"centre": 0 * low, "low_rail": half + 0 * low, "high_rail": -half + 0 * low}
            pivot = {**pivots, "left_rail": half * low, "right_rail": -half * low}[shape.cant.pivot]
            angle = cant_angle(np.abs(state.cant), shape.cant.base)[:, None]
            inside, up = rotate(left * low, up, angle, pivot)
            left = inside * low
        return np.stack([left, up], axis=-1)

    def boundary(self, d: Floats, spacing: float) -> Floats:
        """Return points (m, b, 3) on the envelope's boundary in the local frame at distances (m,)."""
        state = self.line.at(d)
        ring = around(self.sections(state), spacing)
        plan = state.points[:, None, :2] + ring[..., :1] * state.left[:, None]
        return np.concatenate([plan, state.points[:, None, 2:] + ring[..., 1:]], axis=-1)

    def outside(self, points: Floats, near: Floats, radius: float = 0.1) -> tuple[Floats, Floats]:
        """Return (how far each point (n, 3) lies outside the envelope (n,), 0 inside; its distance along (n,)) [m].

        Args:
            points: in the local frame. near: (n,) a distance along the track close to each point's own [m].
            radius: sections up to this far along are tried too for points outside [m].

        Distances are to the section square to the track through the point, so never too small.
        """
        parts = [
            self._outside(points[i : i + BATCH], near[i : i + BATCH], radius) for i in range(0, len(points), BATCH)
        ]
        return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])

    def _outside(self, points: Floats, near: Floats, radius: float) -> tuple[Floats, Floats]:
        d = np.clip(near, 0.0, self.line.length)
        for _ in range(4):
            state = self.line.at(d)
            gap = points[:, :2] - state.points[:, :2]
            along = np.sum(gap * state.forward, axis=1)
            stretch = 1.0 - state.curvature * np.sum(gap * state.left, axis=1)
            d = np.clip(d + along / np.maximum(stretch, 0.2), 0.0, self.line.length)
        best = self._distance(points, d)
        far = np.flatnonzero(best > WORTH_A_LOOK)
        for shift in radius * np.array([-1.0, -0.5, -0.2, -0.1, -0.05, 0.05, 0.1, 0.2, 0.5, 1.0]):
            if len(far):
                there = np.clip(d[far] + shift, 0.0, self.line.length)
                best[far] = np.minimum(best[far], self._distance(points[far], there))
        return best, d

    def _distance(self, points: Floats, d: Floats) -> Floats:
        """Return each point's distance to the section at its distance along (n,), 0 if it lies on it."""
        state = self.line.at(d)
        gap = points[:, :2] - state.points[:, :2]
        along = np.sum(gap * state.forward, axis=1)
        flat = np.stack([np.sum(gap * state.left, axis=1), points[:, 2] - state.points[:, 2]], axis=-1)
        return np.asarray(np.hypot(polygon_distance(flat, self.sections(state)), along), dtype=np.float64)


def polygon_distance(points: Floats, polygons: Floats) -> Floats:
    """Return how far points (n, 2) lie outside their polygons (n, k, 2) of any simple shape, 0 inside."""
    a, b = polygons, np.roll(polygons, -1, axis=1)
    edge, gap = b - a, points[:, None] - a
    share = np.clip(np.sum(gap * edge, axis=-1) / np.maximum(np.sum(edge * edge, axis=-1), 1e-30), 0.0, 1.0)
    nearest = np.min(np.linalg.norm(gap - share[..., None] * edge, axis=-1), axis=1)
    x, y = points[:, :1], points[:, 1:]
    spans = (a[..., 1] > y) != (b[..., 1] > y)
    turn = (x - a[..., 0]) * edge[..., 1] - (y - a[..., 1]) * edge[..., 0]
    crosses = spans & (turn * np.sign(edge[..., 1]) < 0)
    inside = np.sum(crosses, axis=1) % 2 == 1
    return np.where(inside, 0.0, nearest)


def around(polygons: Floats, spacing: float) -> Floats:
    """Return points (m, b, 2) on polygons (m, k, 2): the corners, and more between them at most `spacing` apart."""
    following = np.roll(polygons, -1, axis=1)
    longest = np.max(np.linalg.norm(following - polygons, axis=-1), axis=0)
    rows = []
    for edge, length in enumerate(longest):
        share = np.arange(max(int(np.ceil(length / spacing)), 1)) / max(int(np.ceil(length / spacing)), 1)
        a, b = polygons[:, edge, None], following[:, edge, None]
        rows.append(a + share[:, None] * (b - a))
    return np.concatenate(rows, axis=1)


def _running_maximum(shape: TrackShape, grid: Floats, curvature: Floats) -> Floats:
    """Return the widening (g, 2) left, right on a grid: for every pair of places within reach, the larger counts."""
    if shape.widening is None:
        return np.zeros((len(grid), 2))
    left_in, left_out = shape.widening.at(np.maximum(curvature, 0.0))
    right_in, right_out = shape.widening.at(np.maximum(-curvature, 0.0))
    inside, outside = np.stack([left_in, right_in], axis=-1), np.stack([right_out, left_out], axis=-1)
    best = np.maximum(inside, outside)
    early = shape.early
    if early is None:
        return best
    for step in range(1, len(grid)):
        gap = grid[step:] - grid[:-step]
        reach = max(early.inside_from, early.outside_from) + 1e-7
        if gap.min() > reach:
            break
        ramp = max(early.outside_from - early.outside_full, 1e-7)
        full = (gap <= early.inside_from + 1e-7)[:, None]
        share = np.clip((early.outside_from + 1e-7 - gap) / ramp, 0.0, 1.0)[:, None]
        best[:-step] = np.maximum(best[:-step], np.maximum(inside[step:] * full, outside[step:] * share))
        best[step:] = np.maximum(best[step:], np.maximum(inside[:-step] * full, outside[:-step] * share))
    return best
