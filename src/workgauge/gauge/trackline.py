"""An alignment in the local site frame, with a height everywhere: the line a section is swept along."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from workgauge.site.alignment import Alignment
from workgauge.site.model import SiteModel
from workgauge.values.arrays import Floats, Ints
from workgauge.values.errors import RuleError

#: Where heights are taken from the nearest surface, one is taken this often along the alignment [m].
SURFACE_STEP = 10.0
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
        heights: (knots, absolute heights) if the alignment has no profile, linear between knots. A profile that is
            shorter than the alignment carries on at its end gradients.
    """

    def __init__(self, alignment: Alignment, origin: Floats, heights: tuple[Floats, Floats]) -> None:
        self.alignment = alignment
        self.origin = origin
        self.length = float(alignment.length)
        self._heights = heights
        knots = np.empty(0) if alignment.has_profile else heights[0]
        inner = np.concatenate([np.asarray(alignment.breaks, dtype=np.float64), knots])
        self.breaks: Floats = merged(np.array([0.0, self.length]), np.clip(inner, 0.0, self.length))

    def at(self, distances: Floats) -> LineState:
        """Return the state at distances (m,) within the alignment."""
        d = np.clip(distances, 0.0, self.length)
        state = self.alignment.at(d)
        profile = self.alignment.profile
        if profile is None:
            z, gradient = np.interp(d, *self._heights), _slopes(*self._heights, d)
        else:
            within = np.clip(d, profile.start, profile.end)
            z, gradient = profile.at(within)
            z = z + gradient * (d - within)
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


class Ground:
    """Heights for features that have none: one number, or the nearest vertex of the site's surfaces in plan."""

    def __init__(self, site: SiteModel, rule: float | Literal["nearest_surface"]) -> None:
        self._number = None if rule == "nearest_surface" else float(rule)
        self._vertices = np.empty((0, 3))
        if self._number is None:
            parts = [surface.vertices[np.unique(surface.faces)] for surface in site.surfaces if len(surface.faces)]
            if not parts:
                raise RuleError(
                    "no surface to take missing heights from",
                    element="height_without_profile",
                    value=rule,
                    allowed="a number of metres, or add a surface to the site",
                )
            self._vertices = np.concatenate(parts)
        self._tree: cKDTree | None = None if self._number is not None else cKDTree(self._vertices[:, :2])

    def heights(self, en: Floats) -> Floats:
        """Return absolute heights (k,) [m] at absolute plan points (k, 2)."""
        if self._tree is None:
            return np.full(len(en), self._number, dtype=np.float64)
        nearest: Ints = np.asarray(self._tree.query(en)[1], dtype=np.int64)
        return np.asarray(self._vertices[nearest, 2], dtype=np.float64)

    def track_line(self, alignment: Alignment, origin: Floats) -> tuple[TrackLine, str | None]:
        """Return the alignment's line, and a warning that states the heights used if it has no profile."""
        who, profile = f"alignment {alignment.name.strip()!r}", alignment.profile
        if profile is not None:
            line = TrackLine(alignment, origin, (np.zeros(1), np.zeros(1)))
            if profile.start <= SHORT_PROFILE and profile.end >= alignment.length - SHORT_PROFILE:
                return line, None
            return line, (
                f"{who} has heights from {profile.start:.3f} to {profile.end:.3f} m only; "
                "beyond them they carry on at the end gradients"
            )
        if self._number is not None:
            text = f"height used: {self._number:.3f} m everywhere"
            heights = (np.array([0.0]), np.array([self._number]))
        else:
            count = max(int(np.ceil(alignment.length / SURFACE_STEP)), 1)
            knots = np.linspace(0.0, alignment.length, count + 1)
            state = alignment.at(knots)
            z = self.heights(np.stack([state.e, state.n], axis=-1))
            text = f"heights used: the nearest surface's, every {SURFACE_STEP:g} m, {z.min():.3f} to {z.max():.3f} m"
            heights = (knots, z)
        return TrackLine(alignment, origin, heights), f"{who} has no profile; {text}"
