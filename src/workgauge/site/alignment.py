"""An alignment: plan, profile, cant and stations together, evaluated at any distance, vectorised."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from workgauge.site.cant import CantTable
from workgauge.site.plan import PlanGeometry
from workgauge.site.profile import Profile
from workgauge.site.projection import Projector
from workgauge.site.stationing import Stationing
from workgauge.values.arrays import Floats, freeze, frozen
from workgauge.values.errors import SiteError
from workgauge.values.limits import Source

#: Distances may lie outside the alignment by this much [m].
DISTANCE_SLACK_M = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class AlignmentState:
    """An alignment at k places, read-only arrays (k,).

    Attributes:
        distance: from the alignment's start [m].
        e, n: absolute easting and northing [m].
        z: height [m], NaN where there is no profile.
        heading: clockwise from grid north, in [0, 2 pi) [rad].
        curvature: positive turns left [1/m].
        gradient: [m/m], positive uphill, NaN where there is no profile.
        cant: signed [m], positive with the low rail on the left; 0 where there is no cant.
    """

    distance: Floats
    e: Floats
    n: Floats
    z: Floats
    heading: Floats
    curvature: Floats
    gradient: Floats
    cant: Floats

    def __len__(self) -> int:
        return len(self.distance)

    def offset_points(self, offset: ArrayLike) -> Floats:
        """Return the points (k, 2) east, north `offset` [m] to the left, horizontally and square to the track."""
        left = np.asarray(offset, dtype=np.float64)
        return np.column_stack([self.e - left * np.cos(self.heading), self.n + left * np.sin(self.heading)])


class Alignment:
    """A track or road axis.

    Attributes:
        name, desc: as the file gives them.
        codes: feature codes by label (Inframodel's `terrainCoding`, `infraCoding` ...).
        source: file and line.
        plan, profile, cant, stationing: the parts.
        declared_length: what the file says [m], or None.
    """

    def __init__(
        self,
        *,
        name: str,
        source: Source,
        plan: PlanGeometry,
        desc: str | None = None,
        codes: Mapping[str, str] | None = None,
        profile: Profile | None = None,
        cant: CantTable | None = None,
        stationing: Stationing | None = None,
        declared_length: float | None = None,
    ) -> None:
        self.name = name
        self.desc = desc
        self.source = source
        self.codes: Mapping[str, str] = MappingProxyType(dict(codes or {}))
        self.plan = plan
        self.profile = profile
        self.cant = cant
        self.stationing = stationing or Stationing(0.0)
        self.declared_length = declared_length

    def __repr__(self) -> str:
        return f"Alignment({self.name!r}, length={self.length:.3f})"

    def renamed(self, name: str) -> "Alignment":
        """Return the same alignment under another name."""
        return Alignment(
            name=name,
            source=self.source,
            plan=self.plan,
            desc=self.desc,
            codes=self.codes,
            profile=self.profile,
            cant=self.cant,
            stationing=self.stationing,
            declared_length=self.declared_length,
        )

    @property
    def length(self) -> float:
        """Summed length of the evaluated elements [m]."""
        return self.plan.length

    @property
    def station_start(self) -> float:
        """Station of the start [m]."""
        return self.stationing.start

    @property
    def has_profile(self) -> bool:
        """Whether there are heights."""
        return self.profile is not None

    @property
    def has_cant(self) -> bool:
        """Whether the file gives cant."""
        return self.cant is not None

    @property
    def cant_stations(self) -> int:
        """Number of places where cant is given."""
        return 0 if self.cant is None else len(self.cant.points)

    @property
    def cant_gauge_m(self) -> float | None:
        """Gauge of the cant table [m], if given."""
        return None if self.cant is None else self.cant.gauge_m

    @property
    def cant_rotation_point(self) -> str | None:
        """What the track is turned about, as the file says it (`insideRail`, `center` ...), if it says."""
        return None if self.cant is None else self.cant.rotation_point

    @property
    def element_counts(self) -> dict[str, int]:
        """Number of lines, curves and spirals."""
        kinds = [element.kind for element in self.plan.elements]
        return {kind: kinds.count(kind) for kind in ("line", "curve", "spiral")}

    @cached_property
    def breaks(self) -> Floats:
        """Sorted distances in [0, length] where an element, a vertical curve or a cant segment begins or ends [m]."""
        parts = [self.plan.boundaries]
        if self.profile is not None:
            parts.append(self.profile.breaks)
        if self.cant is not None:
            parts.append(self.cant.breaks)
        found = np.concatenate(parts)
        out = np.unique(found[(found >= 0) & (found <= self.length)])
        freeze(out)
        return out

    def at(self, distances: ArrayLike) -> AlignmentState:
        """Return the state at distances (k,) or a scalar (then k = 1) [m].

        Raises:
            SiteError: a distance outside [0, length] by more than 1 mm, or not finite.
        """
        d = np.atleast_1d(np.asarray(distances, dtype=np.float64)).ravel()
        bad = ~((d >= -DISTANCE_SLACK_M) & (d <= self.length + DISTANCE_SLACK_M))
        if bad.any():
            raise SiteError(
                "distance outside the alignment",
                element=f"alignment {self.name!r}",
                value=float(d[bad][0]),
                allowed=f"0 to {self.length:.4f} m",
            )
        d = np.clip(d, 0.0, self.length)
        plan = self.plan.at(d)
        if self.profile is None:
            z, gradient = np.full_like(d, np.nan), np.full_like(d, np.nan)
        else:
            z, gradient = self.profile.at(d)
        cant = np.zeros_like(d) if self.cant is None else self.cant.at(d)
        heading = np.mod(math.pi / 2 - plan.yaw, 2 * math.pi)
        heading[heading >= 2 * math.pi] = 0.0  # mod of a tiny negative number rounds up to 2 pi
        e0, n0 = self.plan.origin
        parts = (d, plan.e + e0, plan.n + n0, z, heading, plan.curvature, gradient, cant)
        return AlignmentState(*(frozen(part) for part in parts))

    @cached_property
    def _projector(self) -> Projector:
        return Projector(self.plan)

    def project(self, points_en: ArrayLike) -> tuple[Floats, Floats]:
        """Return (distance (k,), offset (k,)) [m] of the nearest point of the plan to each point (k, 2) east, north.

        The offset is positive to the left. Beyond an end of the alignment the distance is that of the end and the
        offset the whole way to it, signed by the side.

        Raises:
            SiteError: a point that is not finite.
        """
        points = np.asarray(points_en, dtype=np.float64).reshape(-1, 2)
        if not np.isfinite(points).all():
            raise SiteError("a point to project must be finite", element=f"alignment {self.name!r}")
        if not len(points):
            return np.empty(0), np.empty(0)
        return self._projector.project(points - np.array(self.plan.origin))

    def station(self, distance: ArrayLike) -> Floats:
        """Return the station [m] at distances (k,) or a scalar (then k = 1) [m]."""
        return self.stationing.station(np.atleast_1d(np.asarray(distance, dtype=np.float64)))

    def distance_of_station(self, station: float) -> float:
        """Return the distance [m] of a station [m].

        Raises:
            SiteError: no place has it, or (after a re-stationing) several have.
        """
        return self.stationing.distance(station, self.length, self.name)
