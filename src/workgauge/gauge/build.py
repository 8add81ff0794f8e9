"""From a site model and a rule book to limits in the local site frame, nothing dropped without a word."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from workgauge.gauge.chain import LEAST_PAD, prism_chain
from workgauge.gauge.match import Feature, rule_for
from workgauge.gauge.rules import (
    BoxBlock,
    BoxZone,
    CylinderBlock,
    LimitBlock,
    PrismZone,
    Rule,
    RuleBook,
    SurfaceBlock,
    TrackBlock,
    TubeBlock,
    WireAboveRailBlock,
    WireBlock,
)
from workgauge.gauge.solids import cylinder, one_sided, prism, tube, upright_box, wire_chain
from workgauge.gauge.trackline import Ground
from workgauge.gauge.tracks import clearances, track_sections, track_shape, wire_section
from workgauge.geodesy.frame import SiteFrame
from workgauge.site.alignment import Alignment
from workgauge.site.model import LineFeature, PointFeature, SiteModel, SurfaceModel
from workgauge.values.arrays import Floats
from workgauge.values.errors import RuleError
from workgauge.values.limits import Activity, Limit, LimitKind, Source
from workgauge.values.solids import Solid

#: How many names a warning spells out.
NAMED = 5


@dataclass(frozen=True, slots=True, eq=False)
class LimitSet:
    """The limits of a site.

    Attributes:
        frame: the local site frame the solids are in.
        limits: in a stable order; ids are unique and the same in every run.
        warnings: one line each.
        rules: name of the rule book.
    """

    frame: SiteFrame
    limits: tuple[Limit, ...]
    warnings: tuple[str, ...]
    rules: str


def build_limits(site: SiteModel, rules: RuleBook, frame: SiteFrame | None = None) -> LimitSet:
    """Turn every feature of a site into the limits its rule says.

    Args:
        site: the site model.
        rules: the rule book.
        frame: the local frame the limits are wanted in; the site's own if None.

    Raises:
        RuleError: the rule book has no answer for a feature, for instance so small a radius.
    """
    builder = _Builder(site, rules, frame or site.frame())
    for alignment in site.alignments:
        builder.feature(alignment, alignment.name, alignment.source, builder.alignment)
    for line in site.lines:
        builder.feature(line, line.name, line.source, builder.line)
    for point in site.points:
        builder.feature(point, point.name, point.source, builder.point)
    for surface in site.surfaces:
        builder.feature(surface, surface.name, surface.source, builder.surface)
    for i, zone in enumerate(rules.zones):
        builder.zone(zone, i)
    builder.finish()
    return LimitSet(builder.frame, tuple(builder.limits), tuple(builder.warnings), rules.name)


class _Builder:
    """Collects limits, warnings and counts while the features go by."""

    def __init__(self, site: SiteModel, book: RuleBook, frame: SiteFrame) -> None:
        self.site, self.book, self.frame = site, book, frame
        self.origin = frame.origin
        self.limits: list[Limit] = []
        self.warnings: list[str] = []
        self._ids: Counter[str] = Counter()
        self._unmatched: dict[str, list[str]] = {}
        self._left_out: Counter[str] = Counter()
        self._heightless: dict[str, list[str]] = {}
        self._ground: Ground | None = None

    @property
    def ground(self) -> Ground:
        """Heights for features that have none, made when first needed."""
        if self._ground is None:
            self._ground = Ground(self.site, self.book.height_without_profile)
        return self._ground

    def feature(self, feature: Feature, name: str, source: Source, make: Callable[..., None]) -> None:
        """Find the feature's rule and make its limits."""
        rule = rule_for(self.book, feature)
        if rule is None:
            kind = {Alignment: "alignment", LineFeature: "line", PointFeature: "point"}.get(type(feature), "surface")
            self._unmatched.setdefault(kind, []).append(name.strip())
            return
        if not rule.limits:
            self._left_out[rule.name] += 1
        for block in rule.limits:
            make(feature, rule, block, source)

    def alignment(self, alignment: Alignment, rule: Rule, block: LimitBlock, source: Source) -> None:
        """Make a track, or the overhead line above one."""
        line, warning = self.ground.track_line(alignment, self.origin)
        if warning is not None and warning not in self.warnings:
            self.warnings.append(warning)
        chainage, name = (0.0, line.length), alignment.name.strip()
        if isinstance(block, WireAboveRailBlock):
            section = wire_section(block, self.book, alignment)
            chain = prism_chain(line, section, self.book.accuracy_m)
            self._add(LimitKind.OVERHEAD_LINE, name, chain, rule, block, source, chainage)
        elif isinstance(block, TrackBlock):
            shape = track_shape(block, self.book, alignment)
            for envelope in track_sections(shape, line, self.book):
                chain = prism_chain(line, envelope, self.book.accuracy_m)
                self._add(LimitKind.TRACK, name, chain, rule, block, source, chainage, own_track_of=alignment.name)

    def line(self, line: LineFeature, rule: Rule, block: LimitBlock, source: Source) -> None:
        """Make an overhead line's no-go region, or a tube."""
        axis = self._filled(line.points, "lines", line.name) - self.origin
        if isinstance(block, WireBlock):
            below, side = clearances(block.voltage, block.below_m, block.side_m, self.book)
            solid: Solid = wire_chain(axis, below, side, block.above_m)
            self._add(LimitKind.OVERHEAD_LINE, line.name, solid, rule, block, source)
        elif isinstance(block, TubeBlock):
            diameter = line.diameter_m if line.diameter_m is not None else block.diameter_m
            if diameter is None:
                raise RuleError(
                    "the line has no diameter and the rule none for it",
                    file=source.file,
                    line=source.line,
                    element=f"line {line.name!r}, rule {rule.name!r}",
                    allowed="diameter_m in the rule",
                )
            if diameter / 2 + block.clearance_m <= 0:
                raise RuleError(
                    "the tube round the line has no thickness",
                    file=source.file,
                    line=source.line,
                    element=f"line {line.name!r}, rule {rule.name!r}",
                    value=diameter,
                    allowed="a diameter or a clearance above 0",
                )
            solid = tube(axis, diameter / 2 + block.clearance_m + LEAST_PAD)
            self._add(LimitKind.LINE, line.name, solid, rule, block, source)

    def point(self, point: PointFeature, rule: Rule, block: LimitBlock, source: Source) -> None:
        """Make the solid of a point feature."""
        foot = self._filled(point.position[None], "points", point.name)[0] - self.origin
        if isinstance(block, CylinderBlock):
            up = np.array([0.0, 0.0, block.base_offset_m])
            solid: Solid = cylinder(foot + up, block.radius_m, block.height_m)
            self._add(LimitKind.POINT, point.name, solid, rule, block, source)
        elif isinstance(block, BoxBlock):
            centre = foot + np.array([0.0, 0.0, block.base_offset_m + block.height_m / 2])
            size = (block.length_m + 2 * LEAST_PAD, block.width_m + 2 * LEAST_PAD, block.height_m + 2 * LEAST_PAD)
            solid = upright_box(centre, *size, math.radians(block.heading_deg))
            self._add(LimitKind.POINT, point.name, solid, rule, block, source)

    def surface(self, surface: SurfaceModel, rule: Rule, block: LimitBlock, source: Source) -> None:
        """Make a one-sided surface."""
        if isinstance(block, SurfaceBlock):
            solid = one_sided(surface, self.origin, block.keep == "above")
            self._add(LimitKind.SURFACE, surface.name, solid, rule, block, source)

    def zone(self, zone: BoxZone | PrismZone, i: int) -> None:
        """Make a zone drawn by hand in the rule book."""
        low, high = zone.bottom_z_m - self.origin[2], zone.top_z_m - self.origin[2]
        if isinstance(zone, BoxZone):
            middle = np.array([*zone.centre_en_m, 0.0]) - self.origin
            centre = np.array([middle[0], middle[1], (low + high) / 2])
            heading = math.radians(zone.heading_deg)
            solid: Solid = upright_box(centre, zone.length_m, zone.width_m, high - low, heading)
        else:
            solid = prism(np.asarray(zone.outline_en_m, dtype=np.float64) - self.origin[:2], low, high)
        rule = Rule(name=f"zones[{i}]", feature="surface", limits=())
        name = zone.name if "name" in zone.model_fields_set else f"zone {i + 1}"
        source = Source(self.book.name, f"zones[{i}]")
        self._add(LimitKind.ZONE, name, solid, rule, zone, source)

    def finish(self) -> None:
        """Say what became no limit, and what heights were made up."""
        for kind, names in self._unmatched.items():
            self.warnings.append(f"{_counted(len(names), kind)} without a rule became no limit: {_listed(names)}")
        for rule, count in self._left_out.items():
            self.warnings.append(f"rule {rule!r} leaves out {_counted(count, 'feature')}")
        for kind, names in self._heightless.items():
            how = self.book.height_without_profile
            used = "the nearest surface's" if how == "nearest_surface" else f"{how:.3f} m"
            self.warnings.append(f"{len(names)} {kind} have no height, used {used}: {_listed(names)}")

    def _filled(self, points: Floats, kind: str, name: str) -> Floats:
        """Return absolute points (n, 3) with heights where the file has none."""
        missing = np.isnan(points[:, 2])
        if not missing.any():
            return points
        self._heightless.setdefault(kind, []).append(name)
        filled = np.array(points)
        if missing.all():
            filled[:, 2] = self.ground.heights(points[:, :2])
        else:
            along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points[:, :2], axis=0).T))])
            filled[missing, 2] = np.interp(along[missing], along[~missing], points[~missing, 2])
        return filled

    def _add(
        self,
        kind: LimitKind,
        name: str,
        solid: Solid,
        rule: Rule,
        block: LimitBlock,
        source: Source,
        chainage: tuple[float, float] | None = None,
        own_track_of: str | None = None,
    ) -> None:
        key = f"{kind.value}:{name}"
        self._ids[key] += 1
        while (number := self._ids[key]) > 1 and self._ids[f"{key}#{number}"]:
            self._ids[key] += 1  # a feature that is itself called so
        if number > 1:
            self._ids[f"{key}#{number}"] += 1
        state = None if block.active_while is None else block.active_while.replace("{name}", name)
        self.limits.append(
            Limit(
                id=key if number == 1 else f"{key}#{number}",
                kind=kind,
                name=block.name.replace("{name}", name),
                solid=solid,
                rule=rule.name,
                source=source,
                chainage=chainage,
                stop_distance_m=block.stop_distance_m,
                tolerance_m=block.tolerance_m,
                activity=Activity(state=state),
                exempt_links=frozenset(block.exempt_links),
                own_track_of=own_track_of,
            )
        )


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(repr(name) for name in names[:NAMED])
    return shown if len(names) <= NAMED else f"{shown} and {len(names) - NAMED} more"
