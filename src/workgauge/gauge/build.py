"""From a site model and a rule book to limits in the local site frame, nothing dropped without a word."""

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import partial

import numpy as np

from workgauge.gauge.chain import prism_chain
from workgauge.gauge.curtains import track_curtain
from workgauge.gauge.heights import Origin, SiteHeights
from workgauge.gauge.madeup import MadeUpHeights, counted, listed
from workgauge.gauge.makers import SolidMaker
from workgauge.gauge.match import Feature, kind_of, rule_for
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
from workgauge.gauge.solids import one_sided, prism, upright_box
from workgauge.gauge.trackline import filled_line, flat_line
from workgauge.gauge.tracknames import track_names
from workgauge.gauge.tracks import track_sections, track_shape, wire_section
from workgauge.geodesy.frame import SiteFrame
from workgauge.site.alignment import Alignment
from workgauge.site.model import LineFeature, PointFeature, SiteModel, SurfaceModel
from workgauge.values.errors import RuleError
from workgauge.values.limits import Activity, Limit, LimitKind, Source
from workgauge.values.solids import Box, PrismChain, Solid, Surface, Tube


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


def build_limits(
    site: SiteModel, rules: RuleBook, frame: SiteFrame | None = None, clock_zero: datetime | None = None
) -> LimitSet:
    """Turn every feature of a site into the limits its rule says.

    Args:
        site: the site model.
        rules: the rule book.
        frame: the local frame the limits are wanted in; the site's own if None.
        clock_zero: the moment at which the tick's clock shows 0, for limits with a window of time. Without it they
            count always, and a warning says so.

    Raises:
        RuleError: the rule book has no answer for a feature, for instance so small a radius.
    """
    builder = _Builder(site, rules, frame or site.frame(), clock_zero)
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

    def __init__(self, site: SiteModel, book: RuleBook, frame: SiteFrame, clock_zero: datetime | None = None) -> None:
        self.site, self.book, self.frame = site, book, frame
        self._clock_zero = clock_zero
        self._timeless = 0
        self.origin = frame.origin
        self.limits: list[Limit] = []
        self.warnings: list[str] = []
        self.own_names = {id(alignment): name for alignment, name in track_names(site)}
        self._curtains: list[Callable[[], None]] = []
        self._ids: Counter[str] = Counter()
        self._unmatched: dict[str, list[str]] = {}
        self._left_out: dict[str, list[str]] = {}
        self._made_up = MadeUpHeights()
        self.heights = SiteHeights(site, book)
        self._solids = SolidMaker(book, self.heights, self.origin, self._made_up)

    def feature(self, feature: Feature, name: str, source: Source, make: Callable[..., None]) -> None:
        """Find the feature's rule and make its limits."""
        rule = rule_for(self.book, feature, self.site.surfaces)
        if rule is None:
            self._unmatched.setdefault(kind_of(feature), []).append(name.strip())
            return
        if not rule.limits:
            self._left_out.setdefault(rule.name, []).append(name.strip())
        for block in rule.limits:
            make(feature, rule, block, source)

    def alignment(self, alignment: Alignment, rule: Rule, block: LimitBlock, source: Source) -> None:
        """Make a track, or the overhead line above one."""
        filled = filled_line(alignment, self.heights, self.origin, self.book.rail_above_surface_m)
        line, name = filled.line, alignment.name.strip()
        chainage = (0.0, line.length)
        for origin, used in filled.used.items():
            self._made_up.see("alignment", alignment, origin, [] if origin is Origin.UNKNOWN else used.tolist())
        if isinstance(block, WireAboveRailBlock):
            if filled.unknown:
                raise _no_height(alignment, filled.unknown[0], self.heights.within)
            section = wire_section(block, self.book, alignment)
            chain = prism_chain(line, section, self.book.accuracy_m)
            self._add(LimitKind.OVERHEAD_LINE, name, chain, rule, block, source, chainage)
        elif isinstance(block, TrackBlock):
            own = self.own_names[id(alignment)]
            sections = track_sections(track_shape(block, self.book, alignment), line, self.book)
            for envelope in sections:
                chain = prism_chain(line, envelope, self.book.accuracy_m)
                self._add(LimitKind.TRACK, name, chain, rule, block, source, chainage, own_track_of=own)
            for span in filled.unknown:
                self._curtains.append(partial(self._curtain, alignment, rule, block, own, span))

    def _curtain(
        self, alignment: Alignment, rule: Rule, block: TrackBlock, own: str, span: tuple[float, float]
    ) -> None:
        """Guard a stretch of a track at every height."""
        line = flat_line(alignment, self.origin, (self.heights.low + self.heights.high) / 2, span)
        sections = track_sections(track_shape(block, self.book, alignment), line, self.book)
        chain = track_curtain(line, sections, self.heights, span, self.book.accuracy_m)
        name = alignment.name.strip()
        self._add(LimitKind.TRACK, name, chain, rule, block, alignment.source, span, own_track_of=own)

    def line(self, line: LineFeature, rule: Rule, block: LimitBlock, source: Source) -> None:
        """Make an overhead line's no-go region, or a tube."""
        if isinstance(block, WireBlock):
            self._add(LimitKind.OVERHEAD_LINE, line.name, self._solids.wire(line, block), rule, block, source)
        elif isinstance(block, TubeBlock):
            self._add(LimitKind.LINE, line.name, self._solids.pipe(line, rule, block), rule, block, source)

    def point(self, point: PointFeature, rule: Rule, block: LimitBlock, source: Source) -> None:
        """Make the solid of a point feature."""
        if isinstance(block, CylinderBlock | BoxBlock):
            self._add(LimitKind.POINT, point.name, self._solids.post(point, block), rule, block, source)

    def surface(self, surface: SurfaceModel, rule: Rule, block: LimitBlock, source: Source) -> None:
        """Make a one-sided surface."""
        if isinstance(block, SurfaceBlock):
            down = block.lowered_m if block.keep == "above" else -block.lowered_m
            solid = one_sided(surface, self.origin + np.array([0.0, 0.0, down]), block.keep == "above")
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
        """Make what comes last, and say what became no limit and what heights were made up."""
        for make in self._curtains:
            make()
        for kind, names in self._unmatched.items():
            self.warnings.append(f"{counted(len(names), kind)} without a rule became no limit: {listed(names)}")
        for rule, names in self._left_out.items():
            self.warnings.append(f"rule {rule!r} leaves out {counted(len(names), 'feature')}: {listed(names)}")
        if self._timeless:
            how = counted(self._timeless, "limit")
            self.warnings.append(f"{how} with a window of time counted always: nobody says what time it is")
        self.warnings += self._made_up.warnings(self.heights)

    def _activity(self, state: str | None, block: LimitBlock) -> Activity:
        """Return when a limit counts; a window of time on the tick's clock, if its zero is known."""
        window = (block.active_from, block.active_until)
        if self._clock_zero is None:
            self._timeless += window != (None, None)
            return Activity(state=state)
        first, last = (
            None if at is None else (at - self._clock_zero) // timedelta(microseconds=1) * 1000 for at in window
        )
        return Activity(state=state, not_before_ns=first, not_after_ns=last)

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
        if not _finite(solid):
            raise RuleError(
                "the limit would have places that are no numbers",
                file=source.file,
                line=source.line,
                element=f"{kind.value} {name!r}, rule {rule.name!r}",
                allowed="finite coordinates and heights",
            )
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
                activity=self._activity(state, block),
                exempt_links=frozenset(block.exempt_links),
                own_track_of=own_track_of,
            )
        )


def _no_height(alignment: Alignment, span: tuple[float, float], within: float) -> RuleError:
    return RuleError(
        "the height of the rails, and so of the wire above them, is unknown",
        file=alignment.source.file,
        line=alignment.source.line,
        element=f"alignment {alignment.name.strip()!r} from {span[0]:.3f} to {span[1]:.3f} m",
        allowed=f"a profile, a surface there, or another profile within {within:g} m (height_from_profile_within_m)",
    )


def _finite(solid: Solid) -> bool:
    """Return whether every number of a solid is one."""
    if isinstance(solid, Box):
        return bool(np.isfinite(solid.T_frame_box).all())
    if isinstance(solid, PrismChain):
        return all(bool(np.isfinite(part).all()) for part in (solid.starts, solid.ends, solid.sections))
    if isinstance(solid, Surface):
        return bool(np.isfinite(solid.vertices[solid.faces]).all())
    return bool(np.isfinite(solid.axis if isinstance(solid, Tube) else solid.vertices).all())
