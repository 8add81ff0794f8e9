"""Limits of tracks against the exact swept envelope: nothing uncovered, and how much is covered needlessly."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from workgauge.gauge.build import LimitSet
from workgauge.gauge.exact import ExactEnvelope, around
from workgauge.gauge.heights import SiteHeights
from workgauge.gauge.match import rule_for
from workgauge.gauge.rules import RuleBook, TrackBlock
from workgauge.gauge.sections import convex_pieces, edge_normals
from workgauge.gauge.trackline import filled_line
from workgauge.gauge.tracks import HULL_TOLERANCE, track_shape
from workgauge.site.alignment import Alignment
from workgauge.site.model import SiteModel
from workgauge.values.arrays import Floats, Ints
from workgauge.values.errors import RuleError
from workgauge.values.solids import PrismChain

#: The envelope is sampled this often along the track, and the limits' surface this often [m].
ALONG, SURFACE_ALONG = 0.5, 2.0
#: Points round a section lie at most this far apart [m].
SPACING = 0.25
#: Sections worked on at once.
BATCH = 512


@dataclass(frozen=True, slots=True)
class Place:
    """The worst place of one track: how much, at which distance along, and the absolute point (e, n, z) [m]."""

    alignment: str
    amount_m: float
    distance_m: float
    point: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Verification:
    """The result over all tracks.

    Attributes:
        worst_uncovered_m: farthest that a point of the exact envelope lies outside the limits; 0.0 if none does.
        worst_surplus_m: farthest that a point of the limits' surface lies outside the exact envelope.
        uncovered, surplus: the worst place of each track that has one.
        points: how many points were looked at.
    """

    worst_uncovered_m: float
    worst_surplus_m: float
    uncovered: tuple[Place, ...]
    surplus: tuple[Place, ...]
    points: int


def verify_envelopes(
    site: SiteModel, rules: RuleBook, limit_set: LimitSet, progress: Callable[[float], None] | None = None
) -> Verification:
    """Sample the exact envelope of every track and the surface of its limits against each other.

    Args:
        site, rules, limit_set: as given to and returned by `build_limits`.
        progress: called with the share done, 0 to 1.
    """
    origin = limit_set.frame.origin
    jobs = list(_tracks(site, rules, limit_set))
    if not jobs:
        return Verification(0.0, 0.0, (), (), 0)
    heights = SiteHeights(site, rules)
    uncovered: list[Place] = []
    surplus: list[Place] = []
    points = 0
    for i, (alignment, block, chains) in enumerate(jobs):
        line = filled_line(alignment, heights, origin, rules.rail_above_surface_m).line
        envelope = ExactEnvelope.of(track_shape(block, rules, alignment), line)
        worst = _Worst(alignment.name.strip(), origin)
        for part in _uncovered(envelope, chains):
            worst.see(*part)
        uncovered += worst.place()
        points += worst.seen
        _tell(progress, (i + 0.5) / len(jobs))
        worst = _Worst(alignment.name.strip(), origin)
        for chain in chains:
            for part in _surplus(envelope, chain):
                worst.see(*part)
        surplus += worst.place()
        points += worst.seen
        _tell(progress, (i + 1) / len(jobs))
    return Verification(
        max((place.amount_m for place in uncovered), default=0.0),
        max((place.amount_m for place in surplus), default=0.0),
        tuple(uncovered),
        tuple(surplus),
        points,
    )


def _tell(progress: Callable[[float], None] | None, share: float) -> None:
    if progress is not None:
        progress(share)


class _Worst:
    """Keeps the worst of many points."""

    def __init__(self, alignment: str, origin: Floats) -> None:
        self._alignment, self._origin = alignment, origin
        self._best = (0.0, 0.0, np.zeros(3))
        self.seen = 0

    def see(self, amounts: Floats, distances: Floats, points: Floats) -> None:
        """Look at amounts (n,) at distances (n,) and local points (n, 3)."""
        self.seen += len(amounts)
        worst = int(np.argmax(amounts))
        if amounts[worst] > self._best[0]:
            self._best = (float(amounts[worst]), float(distances[worst]), points[worst] + self._origin)

    def place(self) -> list[Place]:
        """Return the worst so far, nothing if no amount was above zero."""
        amount, distance, point = self._best
        if amount <= 0:
            return []
        return [Place(self._alignment, amount, distance, (float(point[0]), float(point[1]), float(point[2])))]


def _tracks(
    site: SiteModel, rules: RuleBook, limit_set: LimitSet
) -> Iterator[tuple[Alignment, TrackBlock, list[PrismChain]]]:
    """Yield every track with its rule's block and the chains made of it, in the order they were made."""
    chains = iter([limit.solid for limit in limit_set.limits if limit.own_track_of is not None])
    for alignment in site.alignments:
        rule = rule_for(rules, alignment)
        for block in () if rule is None else rule.limits:
            if isinstance(block, TrackBlock):
                shape = track_shape(block, rules, alignment)
                pieces = len(convex_pieces(shape.half_widths, shape.heights, HULL_TOLERANCE))
                mine = [
                    chain for chain in (next(chains, None) for _ in range(pieces)) if isinstance(chain, PrismChain)
                ]
                if len(mine) != pieces:
                    raise RuleError(
                        "the limits were not made of this site and rule book", element=f"alignment {alignment.name!r}"
                    )
                yield alignment, block, mine


def _uncovered(envelope: ExactEnvelope, chains: Sequence[PrismChain]) -> Iterator[tuple[Floats, Floats, Floats]]:
    """Yield (how far outside all cells (n,), distance along (n,), point (n, 3)) of points of the exact envelope."""
    line = envelope.line
    places = np.asarray(line.breaks)
    d = np.concatenate([np.arange(0.0, line.length, ALONG), places - 1e-6, places + 1e-6])
    d = np.unique(np.clip(d, 0.0, line.length))
    for first in range(0, len(d), BATCH):
        here = d[first : first + BATCH]
        points = envelope.boundary(here, SPACING)
        along = np.repeat(here, points.shape[1])
        flat = points.reshape(-1, 3)
        depth = np.full(len(flat), np.inf)
        for chain in chains:
            cell = np.clip(np.searchsorted(chain.chainages[:, 0], along, side="right") - 1, 0, len(chain) - 1)
            for shift in (0, -1, 1):
                open_: Ints = np.flatnonzero(depth > 0)
                if len(open_):
                    near = np.clip(cell[open_] + shift, 0, len(chain) - 1)
                    depth[open_] = np.minimum(depth[open_], _outside_cell(chain, near, flat[open_]))
        yield np.maximum(depth, 0.0), along, flat


def _outside_cell(chain: PrismChain, cell: Ints, points: Floats) -> Floats:
    """Return how far points (n, 3) lie outside their cells (n,): positive outside, in the worst face's direction."""
    lateral, polygons = chain.laterals[cell], chain.sections[cell]
    forward = np.stack([lateral[:, 1], -lateral[:, 0]], axis=-1)
    span = chain.ends[cell] - chain.starts[cell]
    length = np.sum(span[:, :2] * forward, axis=1)
    gap = points - chain.starts[cell]
    along = np.sum(gap[:, :2] * forward, axis=1)
    flat = np.stack([np.sum(gap * lateral, axis=1), gap[:, 2] - span[:, 2] / length * along], axis=-1)
    normals = edge_normals(polygons)
    sides = np.max(np.sum((flat[:, None] - polygons) * normals, axis=-1), axis=1)
    return np.asarray(np.maximum(sides, np.maximum(-along, along - length)), dtype=np.float64)


def _surplus(envelope: ExactEnvelope, chain: PrismChain) -> Iterator[tuple[Floats, Floats, Floats]]:
    """Yield (how far outside the exact envelope (n,), distance along (n,), point (n, 3)) of points of cells' faces.

    Sides and both end faces' rims are sampled; an end face's inside lies no farther out than its rim.
    """
    length = np.linalg.norm(chain.ends - chain.starts, axis=1)
    count = np.ceil(length / SURFACE_ALONG).astype(np.int64) + 1
    cell = np.repeat(np.arange(len(chain)), count)
    first = np.repeat(np.cumsum(count) - count, count)
    share = (np.arange(len(cell)) - first) / np.repeat(count - 1, count)
    for begin in range(0, len(cell), BATCH):
        c, t = cell[begin : begin + BATCH], share[begin : begin + BATCH, None]
        axis = chain.starts[c] * (1 - t) + chain.ends[c] * t
        near = chain.chainages[c, 0] * (1 - t[:, 0]) + chain.chainages[c, 1] * t[:, 0]
        ring = around(chain.sections[c], SPACING)
        points = axis[:, None] + ring[..., :1] * chain.laterals[c][:, None]
        points[..., 2] += ring[..., 1]
        flat = points.reshape(-1, 3)
        amount, along = envelope.outside(flat, np.repeat(near, ring.shape[1]))
        yield amount, along, flat
