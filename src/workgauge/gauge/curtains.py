"""Protection at every height, for tracks and lines whose height nobody knows."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from workgauge.gauge.chain import prism_chain
from workgauge.gauge.heights import ORIGINS, Origin, SiteHeights
from workgauge.gauge.sections import Section, edge_normals
from workgauge.gauge.solids import wire_chain
from workgauge.gauge.trackline import HEIGHT_STEP, LineState, TrackLine
from workgauge.values.arrays import Floats, Ints, freeze
from workgauge.values.solids import PrismChain

#: A cell that reaches into a stretch by less than this only touches it [m].
SLIVER = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class CurtainSection:
    """An upright rectangle as wide as other sections together.

    Attributes:
        within: the sections. below, above: how far it reaches down and up from the line [m].
    """

    within: Sequence[Section]
    below: float
    above: float

    def breaks(self) -> Floats:
        """Return where any of the sections changes abruptly [m]."""
        return np.concatenate([section.breaks() for section in self.within])

    def vertices(self, state: LineState) -> Floats:
        """Return the rectangle's corners (m, 4, 2), counter-clockwise from the lower right."""
        left = np.concatenate([section.vertices(state)[..., 0] for section in self.within], axis=1)
        right, left = left.min(axis=1), left.max(axis=1)
        low, high = np.full(len(left), -self.below), np.full(len(left), self.above)
        corners = [np.stack(c, axis=-1) for c in ((right, low), (left, low), (left, high), (right, high))]
        return np.stack(corners, axis=1)

    def edges(self, state: LineState) -> tuple[Floats, Floats]:
        """Return the rectangle itself."""
        polygon = self.vertices(state)
        return edge_normals(polygon), polygon


def track_curtain(
    line: TrackLine, sections: Sequence[Section], heights: SiteHeights, span: tuple[float, float], accuracy: float
) -> PrismChain:
    """Return cells over a stretch of a level line, as wide as its sections, from below to above all known heights.

    Args:
        line: at one height, with a break at either end of the span. sections: of the track.
        span: (from, to) along the line [m]. accuracy: as in `prism_chain`.
    """
    z = float(line.at(np.zeros(1)).points[0, 2] + line.origin[2])
    chain = prism_chain(line, CurtainSection(sections, z - heights.low, heights.high - z), accuracy)
    low, high = chain.chainages.T
    here: Ints = np.flatnonzero((high > span[0] + SLIVER) & (low < span[1] - SLIVER))
    part = slice(int(here[0]), int(here[-1]) + 1)
    neighbours = np.array(chain.neighbours[part])
    neighbours[0, 0] = neighbours[-1, 1] = False
    freeze(neighbours)
    return PrismChain(
        chain.starts[part], chain.ends[part], chain.laterals[part], chain.sections[part], chain.chainages[part],
        neighbours,
    )  # fmt: skip


def line_curtain(points: Floats, side: float, heights: SiteHeights, origin: Floats) -> PrismChain:
    """Return what lies within `side` [m] in plan of absolute points (n, 3), from below to above all known heights."""
    middle = (heights.low + heights.high) / 2
    flat = np.column_stack([points[:, :2], np.full(len(points), middle)])
    return wire_chain(flat - origin, middle - heights.low, side, heights.high - middle)


@dataclass(frozen=True, slots=True, eq=False)
class FilledPoints:
    """A line feature's points with heights.

    Attributes:
        points: (n, 3) absolute, with more points than the feature has where heights had to be made up; NaN heights
            where none is known.
        origins: (n,) indices into ORIGINS, OWN for heights of the feature itself and between them.
        missing: whether the feature had to be given any height.
    """

    points: Floats
    origins: Ints
    missing: bool


def filled_points(points: Floats, heights: SiteHeights) -> FilledPoints:
    """Give absolute points (n, 3) of a line the heights they lack.

    Where one lacks, the line's own heights count between them and past them for as far along it as a profile counts
    beside it; farther off, heights are taken every HEIGHT_STEP.
    """
    own = ORIGINS.index(Origin.OWN)
    lacking = np.isnan(points[:, 2])
    if not lacking.any():
        return FilledPoints(points, np.full(len(points), own, dtype=np.int64), False)
    filled = np.array(points)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points[:, :2], axis=0).T))])
    if not lacking.all():
        known = along[~lacking]
        near = lacking & (np.min(np.abs(along[:, None] - known), axis=1) <= heights.within)
        filled[near, 2] = np.interp(along[near], known, points[~lacking, 2])
    rows = [filled[:1]]
    for a, b in itertools.pairwise(filled):
        far = np.isnan(a[2]) or np.isnan(b[2])
        count = max(int(np.ceil(np.hypot(*(b - a)[:2]) / HEIGHT_STEP)), 1) if far else 1
        step = a + (np.arange(1, count + 1)[:, None] / count) * (b - a)
        step[-1] = b
        rows.append(step)
    dense = np.concatenate(rows)
    origins = np.full(len(dense), own, dtype=np.int64)
    open_: Ints = np.flatnonzero(np.isnan(dense[:, 2]))
    if len(open_):
        dense[open_, 2], origins[open_] = heights.at(dense[open_, :2])
    return FilledPoints(dense, origins, True)
