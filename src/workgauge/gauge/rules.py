"""The rule book's own types: every key, unit, range and default. Unknown keys are refused."""

import math
from typing import Annotated, Literal, Self, TypeAlias

from pydantic import AwareDatetime, Field, model_validator

from workgauge.gauge.blocks import (
    Block,
    CantBlock,
    EarlyBlock,
    FormulaBlock,
    Height,
    Length,
    Number,
    Patterns,
    ProfileBlock,
    QuasiStaticBlock,
    Size,
    Sourced,
    TableBlock,
)


class Match(Block):
    """Which features a rule is for. Every key given must hold; patterns are shell globs, any of a list may match.

    Case is ignored. `any_of`: at least one of these further conditions must hold too.
    """

    name: Patterns | None = None
    name_regex: str | None = None
    code: Patterns | None = None
    desc: Patterns | None = None
    group: Patterns | None = None
    kind: Patterns | None = None
    property: dict[str, Patterns] | None = None
    has_cant: bool | None = None
    has_profile: bool | None = None
    not_name: Patterns | None = None
    any_of: Annotated[tuple["Match", ...], Field(min_length=1)] | None = None


class LimitBlock(Sourced):
    """What every limit of a rule carries. `{name}` in a text stands for the feature's own name.

    `active_from`, `active_until`: moments with their time zone, `2026-05-02T22:00:00+03:00`; the limit counts from
    the one to the other, both included.
    """

    name: str = "{name}"
    stop_distance_m: Length | None = None
    tolerance_m: Length = 0.0
    active_while: str | None = None
    active_from: AwareDatetime | None = None
    active_until: AwareDatetime | None = None
    exempt_links: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _window(self) -> Self:
        first, last = self.active_from, self.active_until
        if first is not None and last is not None and first >= last:
            raise ValueError("active_from must be before active_until")
        return self


class TrackBlock(LimitBlock):
    """A track's envelope: a profile, or a plain half-width and height, with what widens and turns it."""

    make: Literal["track"]
    profile: str | None = None
    half_width_m: Size | None = None
    height_m: Size | None = None
    bottom_m: Height = 0.0
    margin_m: Length = 0.0
    widening: Annotated[FormulaBlock | TableBlock, Field(discriminator="kind")] | None = None
    early_widening: EarlyBlock | None = None
    quasi_static: QuasiStaticBlock | None = None
    cant: CantBlock | None = None

    @model_validator(mode="after")
    def _one_shape(self) -> Self:
        plain = self.half_width_m is not None and self.height_m is not None
        if plain == (self.profile is not None) or (self.half_width_m is None) != (self.height_m is None):
            raise ValueError("give either profile, or half_width_m and height_m")
        if self.height_m is not None and self.bottom_m >= self.height_m:
            raise ValueError("bottom_m must be below height_m")
        return self


class LineClearance(LimitBlock):
    """No-go distances round a wire: below, to each side and above it."""

    below_m: Size | None = None
    side_m: Size | None = None
    above_m: Size
    voltage: str | None = None

    @model_validator(mode="after")
    def _numbers_or_voltage(self) -> Self:
        if (self.voltage is None) == (self.below_m is None) or (self.below_m is None) != (self.side_m is None):
            raise ValueError("give either voltage (a row of the book's `voltages`), or below_m and side_m")
        return self


class WireBlock(LineClearance):
    """Overhead line modelled as a line feature.

    `height_above_ground_m` is the lowest it may hang, for features without heights; without it they are guarded at
    every height.
    """

    make: Literal["overhead_line"]
    height_above_ground_m: Height | None = None


class WireAboveRailBlock(LineClearance):
    """Overhead line over a matched alignment, at a height above rail; follows the cant as the track does.

    `stagger_m` is how far the wire wanders to each side of the track's centre.
    """

    make: Literal["overhead_line_above_rail"]
    height_above_rail_m: Size
    stagger_m: Length = 0.0
    cant: CantBlock | None = None


class CylinderBlock(LimitBlock):
    """An upright cylinder at a point, from `base_offset_m` above (below: negative) it."""

    make: Literal["cylinder"]
    radius_m: Size
    height_m: Size
    base_offset_m: Height = 0.0


class BoxBlock(LimitBlock):
    """An upright box at a point: length along its heading, width across."""

    make: Literal["box"]
    length_m: Size
    width_m: Size
    height_m: Size
    base_offset_m: Height = 0.0
    heading_deg: Annotated[float, Field(strict=True, ge=-360, le=360)] = 0.0


class TubeBlock(LimitBlock):
    """Everything within a clearance of a line feature; its own diameter, or `diameter_m` where it has none.

    `height_above_ground_m` (below ground: negative) is for features without heights; without it they are guarded from
    the ground down.
    """

    make: Literal["tube"]
    clearance_m: Length
    diameter_m: Length | None = None
    height_above_ground_m: Height | None = None

    @model_validator(mode="after")
    def _thick(self) -> Self:
        if self.clearance_m <= 0 and not self.diameter_m:
            raise ValueError("clearance_m must be above 0 unless diameter_m is given")
        return self


class SurfaceBlock(LimitBlock):
    """A one-sided surface; the machine keeps above it, or below it for a ceiling.

    `lowered_m`: the limit lies so far below the feature, as where a tool works on a design surface: what its box
    reaches beyond its edge, and room to slide without being held up. A ceiling is raised by as much.
    """

    make: Literal["surface"]
    keep: Literal["above", "below"] = "above"
    lowered_m: Length = 0.0


Make: TypeAlias = Annotated[
    TrackBlock | WireBlock | WireAboveRailBlock | CylinderBlock | BoxBlock | TubeBlock | SurfaceBlock,
    Field(discriminator="make"),
]

#: Which limits can be made of which feature.
MAKES = {
    "alignment": {"track", "overhead_line_above_rail"},
    "point": {"cylinder", "box"},
    "line": {"overhead_line", "tube"},
    "surface": {"surface"},
}


class Rule(Sourced):
    """One rule: the features it is for, and the limits each becomes (none: left out on purpose).

    `beside`: the rule is only for surfaces of a site that also has a surface of that description which `match` does
    not hold for.
    """

    name: Annotated[str, Field(min_length=1)]
    feature: Literal["alignment", "point", "line", "surface"]
    match: Match = Match()
    beside: Match | None = None
    limits: tuple[Make, ...]

    @model_validator(mode="after")
    def _fitting(self) -> Self:
        if self.beside is not None and self.feature != "surface":
            raise ValueError("beside is for rules of surfaces")
        allowed = MAKES[self.feature]
        for block in self.limits:
            if block.make not in allowed:
                raise ValueError(
                    f"a feature of kind {self.feature} cannot make {block.make}; allowed: {sorted(allowed)}"
                )
        return self


class BoxZone(LimitBlock):
    """A free box in absolute site coordinates: centre (e, n), bottom and top height, heading of its length."""

    make: Literal["box"]
    centre_en_m: tuple[Number, Number]
    bottom_z_m: Number
    top_z_m: Number
    length_m: Size
    width_m: Size
    heading_deg: Annotated[float, Field(strict=True, ge=-360, le=360)] = 0.0

    @model_validator(mode="after")
    def _upright(self) -> Self:
        if self.top_z_m <= self.bottom_z_m:
            raise ValueError("top_z_m must be above bottom_z_m")
        return self


class PrismZone(LimitBlock):
    """A free upright prism: a convex outline (e, n) in absolute site coordinates, bottom and top height."""

    make: Literal["prism"]
    outline_en_m: Annotated[tuple[tuple[Number, Number], ...], Field(min_length=3, max_length=200)]
    bottom_z_m: Number
    top_z_m: Number

    @model_validator(mode="after")
    def _upright_convex(self) -> Self:
        if self.top_z_m <= self.bottom_z_m:
            raise ValueError("top_z_m must be above bottom_z_m")
        ring = self.outline_en_m
        edges = [(b[0] - a[0], b[1] - a[1]) for a, b in zip(ring, ring[1:] + ring[:1], strict=True)]
        turns = [a[0] * b[1] - a[1] * b[0] for a, b in zip(edges, edges[1:] + edges[:1], strict=True)]
        around = sum(
            abs(math.atan2(t, a[0] * b[0] + a[1] * b[1]))
            for t, a, b in zip(turns, edges, edges[1:] + edges[:1], strict=True)
        )
        if not (all(t > 1e-9 for t in turns) or all(t < -1e-9 for t in turns)) or around > 2 * math.pi + 1e-6:
            raise ValueError("outline_en_m must be a convex ring with no corner repeated and none on a straight edge")
        return self


class Voltage(Sourced):
    """No-go distances for one voltage."""

    below_m: Size
    side_m: Size


class OwnTrackBlock(Sourced):
    """When the machine counts as standing on a track: how near, and how parallel.

    `fouling_m`: a track that branches from its own is let off too while nearer than this. `hysteresis_m`: by so much
    a track must be nearer to become its own, or farther to be left.
    """

    within_m: Size = 1.0
    heading_within_deg: Annotated[float, Field(strict=True, gt=0, le=90)] = 15.0
    fouling_m: Size = 3.5
    hysteresis_m: Length = 0.3


class MaySuspend(Block):
    """Limits that a supervisor may suspend: those that a rule, or a zone of that name, made."""

    rule: Annotated[str, Field(min_length=1)]
    at_most_min: Annotated[float, Field(gt=0, le=120)]


class RuleBook(Sourced):
    """A whole rule book; rules are tried in order and the first that matches a feature has it."""

    version: Literal[1]
    name: Annotated[str, Field(min_length=1)]
    title: str
    profiles: dict[str, ProfileBlock] = Field(default_factory=dict)
    voltages: dict[str, Voltage] = Field(default_factory=dict)
    own_track: OwnTrackBlock = OwnTrackBlock()
    height_without_profile: Height = 0.0
    height_from_profile_within_m: Length = 50.0
    rail_above_surface_m: Height = 0.0
    accuracy_m: Annotated[float, Field(strict=True, ge=0.001, le=0.05)] = 0.015
    rules: tuple[Rule, ...] = ()
    zones: tuple[Annotated[BoxZone | PrismZone, Field(discriminator="make")], ...] = ()
    may_suspend: tuple[MaySuspend, ...] = Field(
        default=(), description="limits a supervisor may suspend for some minutes; none unless named here"
    )

    @model_validator(mode="after")
    def _names_known(self) -> Self:
        seen: set[str] = set()
        for rule in self.rules:
            if rule.name in seen:
                raise ValueError(f"two rules are named {rule.name!r}")
            seen.add(rule.name)
            for block in rule.limits:
                if isinstance(block, TrackBlock) and block.profile is not None and block.profile not in self.profiles:
                    raise ValueError(
                        f"rule {rule.name!r} names profile {block.profile!r}; allowed: {sorted(self.profiles)}"
                    )
                if (
                    isinstance(block, LineClearance)
                    and block.voltage is not None
                    and block.voltage not in self.voltages
                ):
                    raise ValueError(
                        f"rule {rule.name!r} names voltage {block.voltage!r}; allowed: {sorted(self.voltages)}"
                    )
        makers = seen | {zone.name for zone in self.zones}
        for one in self.may_suspend:
            if one.rule not in makers:
                raise ValueError(f"may_suspend names {one.rule!r}, no rule or zone; allowed: {sorted(makers)}")
        return self
