"""Heights for features that have none, in a fixed order, and how far up and down protection goes where none is known.

A surface at that place; else the profile of the nearest alignment near enough; else, on a site without any heights,
the rule book's constant; else nothing, and the feature is guarded at every height.
"""

from enum import StrEnum
from functools import cached_property

import numpy as np

from workgauge.gauge.match import rule_for
from workgauge.gauge.rules import RuleBook, SurfaceBlock
from workgauge.gauge.topmost import Topmost
from workgauge.site.alignment import Alignment
from workgauge.site.model import PointFeature, SiteModel, SurfaceModel
from workgauge.values.arrays import Floats, Ints

#: Where no height is known, protection goes this far below the lowest and above the highest height of the site [m].
BEYOND = 100.0


class Origin(StrEnum):
    """Where a made-up height is from."""

    OWN = "own"  #: the feature's own heights beside the place
    SURFACE = "surface"
    PROFILE = "profile"
    CONSTANT = "constant"
    UNKNOWN = "unknown"


#: The origins in the order that arrays of them count by.
ORIGINS = tuple(Origin)


class SiteHeights:
    """What a site knows of heights.

    Attributes:
        constant: the rule book's `height_without_profile`, for a site without any heights [m].
        within: how far a profile counts [m].
        low, high: BEYOND below the lowest and above the highest known height of the site [m].
        any_known: whether the site has any height at all.
    """

    def __init__(self, site: SiteModel, book: RuleBook) -> None:
        self.constant = float(book.height_without_profile)
        self.within = float(book.height_from_profile_within_m)
        known = site.bounds[:, 2]
        self.any_known = bool(np.isfinite(known).all())
        lowest, highest = known if self.any_known else (self.constant, self.constant)
        self.low, self.high = float(lowest) - BEYOND, float(highest) + BEYOND
        self._site, self._book = site, book

    @cached_property
    def _surfaces(self) -> tuple[Topmost, ...]:
        """Surfaces the machine is kept above; then those no limit is made of. Ceilings are no ground."""
        kept: list[SurfaceModel] = []
        other: list[SurfaceModel] = []
        for surface in self._site.surfaces:
            rule = rule_for(self._book, surface, self._site.surfaces)
            blocks = [] if rule is None else [b for b in rule.limits if isinstance(b, SurfaceBlock)]
            if any(block.keep == "above" for block in blocks):
                kept.append(surface)
            elif not blocks:
                other.append(surface)
        return tuple(Topmost(surfaces) for surfaces in (kept, other) if surfaces)

    @cached_property
    def _profiles(self) -> tuple[tuple[Alignment, float, float], ...]:
        """Alignments with heights, and from where to where they have them [m]."""
        return tuple((a, *span) for a in self._site.alignments if (span := profile_span(a)) is not None)

    def at(self, en: Floats) -> tuple[Floats, Ints]:
        """Return (absolute heights (k,) [m], indices into ORIGINS (k,)) at absolute plan points (k, 2).

        The height is NaN where the origin is UNKNOWN.
        """
        z = np.full(len(en), np.nan)
        origin = np.full(len(en), ORIGINS.index(Origin.UNKNOWN), dtype=np.int64)
        if not self.any_known:
            return np.full(len(en), self.constant), np.full(len(en), ORIGINS.index(Origin.CONSTANT), dtype=np.int64)
        for surface in self._surfaces:
            open_: Ints = np.flatnonzero(np.isnan(z))
            if len(open_):
                z[open_] = surface.heights(en[open_])
                origin[open_[np.isfinite(z[open_])]] = ORIGINS.index(Origin.SURFACE)
        open_ = np.flatnonzero(np.isnan(z))
        if len(open_):
            z[open_] = self._from_profiles(en[open_])
            origin[open_[np.isfinite(z[open_])]] = ORIGINS.index(Origin.PROFILE)
        return z, origin

    @cached_property
    def _points(self) -> dict[int, tuple[float, Origin]]:
        """Heights of all points of the site that have none, found together, by the identity of the point."""
        points = [point for point in self._site.points if np.isnan(point.position[2])]
        if not points:
            return {}
        z, origin = self.at(np.array([point.position[:2] for point in points]))
        return {id(p): (float(h), ORIGINS[i]) for p, h, i in zip(points, z, origin.tolist(), strict=True)}

    def of_point(self, point: PointFeature) -> tuple[float, Origin]:
        """Return (absolute height [m], where it is from) of a point of the site without one; NaN if UNKNOWN."""
        return self._points[id(point)]

    def _from_profiles(self, en: Floats) -> Floats:
        """Return the height of the nearest profile within reach (k,), NaN where there is none."""
        best, z = np.full(len(en), self.within), np.full(len(en), np.nan)
        for alignment, first, last in self._profiles:
            state = alignment.at(np.clip(alignment.project(en)[0], first, last))
            apart = np.hypot(state.e - en[:, 0], state.n - en[:, 1])
            nearer = np.isfinite(state.z) & (apart <= best)
            best[nearer], z[nearer] = apart[nearer], state.z[nearer]
        return z


def profile_span(alignment: Alignment) -> tuple[float, float] | None:
    """Return from where to where along it an alignment has heights [m], or None if it has none."""
    if alignment.profile is None:
        return None
    first = min(max(float(alignment.profile.start), 0.0), float(alignment.length))
    last = min(max(float(alignment.profile.end), 0.0), float(alignment.length))
    return (first, last) if last > first else None
