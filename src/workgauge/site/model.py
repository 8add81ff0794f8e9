"""What is on the site: alignments, surfaces, points and lines, in absolute metres, whatever file they came from."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType

import numpy as np

from workgauge.geodesy.crs import ProjectedCrs
from workgauge.geodesy.frame import SiteFrame
from workgauge.site.alignment import Alignment
from workgauge.values.arrays import Floats, Ints, frozen
from workgauge.values.errors import SiteError
from workgauge.values.limits import Source

#: Origins of site frames are rounded to whole multiples of this [m].
ORIGIN_STEP_M = 100.0

_NOTHING: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True, slots=True, eq=False)
class PointFeature:
    """A surveyed or designed point: a pole, a mast, a signal.

    Attributes:
        name, code, desc: as the file gives them; code and desc of the enclosing group where it has none of its own.
        position: (3,) absolute east, north, height [m]; the height is NaN where the file has none.
        groups: names, codes and descriptions of the enclosing groups, outermost first.
        properties: feature properties by label, the groups' included.
    """

    name: str
    code: str | None
    desc: str | None
    position: Floats
    groups: tuple[str, ...]
    source: Source
    properties: Mapping[str, str] = field(default_factory=lambda: _NOTHING)


@dataclass(frozen=True, slots=True, eq=False)
class LineFeature:
    """A line: a plan feature, pipe, cable, break line ...

    Attributes:
        kind: `plan_feature`, `pipe`, `cable`, `string_line`, `breakline` or `boundary`.
        points: (n, 3) absolute east, north, height [m], n >= 2; heights are NaN where the file has none.
        diameter_m: of a pipe [m], if given.
        properties: feature properties by label (Inframodel's `terrainCoding`, `infraCoding` ...).
    """

    name: str
    code: str | None
    desc: str | None
    kind: str
    points: Floats
    diameter_m: float | None
    properties: Mapping[str, str]
    source: Source


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceModel:
    """A triangulated surface.

    Attributes:
        vertices: (n, 3) absolute east, north, height [m].
        faces: (m, 3) indices into vertices; in plan counter-clockwise, so that the normals point up.
        plan_area_m2: area in plan [m2].
        properties: feature properties by label.
    """

    name: str
    code: str | None
    desc: str | None
    vertices: Floats
    faces: Ints
    plan_area_m2: float
    properties: Mapping[str, str]
    source: Source


@dataclass(frozen=True, eq=False)
class SiteModel:
    """Everything the site files hold.

    Attributes:
        crs: the coordinate system as declared (or as the caller overrode it), or None.
        crs_declared: what the files say of it, verbatim (`epsgCode`, `name`, `horizontalDatum` ...).
        units: the files' units by purpose (`linear`, `elevation`, `angular`, `direction`, `diameter`, `cant` ...);
            everything in the model is in metres and radians.
        warnings: one line each: whatever a reader corrected or doubts.
        files: the files read.
    """

    crs: ProjectedCrs | None
    crs_declared: Mapping[str, str]
    units: Mapping[str, str]
    alignments: tuple[Alignment, ...] = ()
    surfaces: tuple[SurfaceModel, ...] = ()
    points: tuple[PointFeature, ...] = ()
    lines: tuple[LineFeature, ...] = ()
    warnings: tuple[str, ...] = ()
    files: tuple[str, ...] = ()

    def alignment(self, name: str) -> Alignment:
        """Return the alignment with this name (surrounding spaces do not matter).

        Raises:
            SiteError: there is none, or several; the message names those there are.
        """
        found = [a for a in self.alignments if a.name == name] or [
            a for a in self.alignments if a.name.strip() == name.strip()
        ]
        if len(found) == 1:
            return found[0]
        known = ", ".join(repr(a.name) for a in self.alignments) or "none, the site has no alignment"
        raise SiteError(
            "several alignments have this name" if found else "no such alignment", value=name, allowed=known
        )

    @cached_property
    def bounds(self) -> Floats:
        """(2, 3) smallest and largest east, north, height of everything [m]; heights NaN if there are none.

        Alignments count by the ends of their elements.
        """
        states = [a.at(a.breaks) for a in self.alignments]
        parts: list[Floats] = [np.column_stack([s.e, s.n, s.z]) for s in states]
        parts += [s.vertices for s in self.surfaces]
        parts += [line.points for line in self.lines]
        parts += [p.position[None] for p in self.points]
        if not parts:
            return frozen(np.full((2, 3), np.nan))
        low = [np.fmin.reduce(part, axis=0) for part in parts]
        high = [np.fmax.reduce(part, axis=0) for part in parts]
        return frozen([np.fmin.reduce(low, axis=0), np.fmax.reduce(high, axis=0)])

    def frame(self, near: tuple[float, ...] | None = None) -> SiteFrame:
        """Return a local frame with its origin near `near` (east, north[, height]) [m] or the middle of the site.

        The origin is rounded to whole multiples of 100 m, so that it can be written down.

        Raises:
            SiteError: `near` is not finite.
        """
        if near is None:
            place = np.nan_to_num(np.mean(self.bounds, axis=0))
        else:
            place = np.array([*near, 0.0][:3], dtype=np.float64)
            if len(near) < 3 and np.isfinite(self.bounds[:, 2]).all():
                place[2] = float(np.mean(self.bounds[:, 2]))
            if not np.isfinite(place).all():
                raise SiteError("the place of a site frame must be finite", value=near)
        return SiteFrame(self.crs, np.round(place / ORIGIN_STEP_M) * ORIGIN_STEP_M)
