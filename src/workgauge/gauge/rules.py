"""The rule book's own types: every key, unit, range and default. Unknown keys are refused."""

import math
from itertools import pairwise
from typing import Annotated, Literal, Self, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, model_validator

from workgauge.gauge.envelope import Branch, FormulaWidening, QuasiStatic, TableWidening, Widening

Number: TypeAlias = Annotated[float, Field(strict=True, ge=-1e8, le=1e8)]
Size: TypeAlias = Annotated[float, Field(strict=True, gt=0, le=1e4)]
Length: TypeAlias = Annotated[float, Field(strict=True, ge=0, le=1e4)]
Height: TypeAlias = Annotated[float, Field(strict=True, ge=-100, le=1e4)]
Patterns: TypeAlias = Annotated[tuple[Annotated[str, Field(min_length=1)], ...], Field(min_length=1)]
Certainty = Literal["V", "S", "C", "R"]


class Block(BaseModel):
    """Anything in a rule book: frozen, unknown keys refused, no NaN or infinity."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Sourced(Block):
    """A block that says where its numbers come from.

    `certainty`: V read in the named source, S second-hand, C computed or tested, R recalled, to be confirmed.
    """

    source: str | None = None
    certainty: Certainty | None = None


class ProfileBlock(Sourced):
    """A reference profile: half-width at height, bottom to top, the same on both sides.

    Two rows at one height make a step. `bottom_m` carries the lowest width down to that height above the top of rail.
    """

    half_width_at_height_m: Annotated[tuple[tuple[Size, Height], ...], Field(min_length=2, max_length=200)]
    bottom_m: Height | None = None

    @model_validator(mode="after")
    def _rising(self) -> Self:
        heights = [h for _, h in self.half_width_at_height_m]
        if any(b < a for a, b in pairwise(heights)) or heights[0] == heights[-1]:
            raise ValueError("heights must rise from row to row and cover more than one height")
        if self.bottom_m is not None and self.bottom_m > heights[0]:
            raise ValueError(f"bottom_m must not be above the lowest row, {heights[0]} m")
        return self


class BranchBlock(Block):
    """S = a/R + b from this radius upwards, each side its own."""

    from_radius_m: Size
    inside_a_m2: Length = 0.0
    inside_b_m: Number = 0.0
    outside_a_m2: Length = 0.0
    outside_b_m: Number = 0.0


class FormulaBlock(Sourced):
    """Widening S = a/R + b in branches by rising radius; below the first there is no answer."""

    kind: Literal["formula"]
    branches: Annotated[tuple[BranchBlock, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _continuous(self) -> Self:
        for low, high in pairwise(self.branches):
            if high.from_radius_m <= low.from_radius_m:
                raise ValueError("branches must go by rising radius")
            k = 1.0 / high.from_radius_m
            for a_low, b_low, a, b in (
                (low.inside_a_m2, low.inside_b_m, high.inside_a_m2, high.inside_b_m),
                (low.outside_a_m2, low.outside_b_m, high.outside_a_m2, high.outside_b_m),
            ):
                if a_low * k + b_low < a * k + b - 1e-9:
                    raise ValueError(f"widening must not shrink below radius {high.from_radius_m} m")
        return self

    def build(self) -> Widening:
        """Return the widening as the section's arithmetic wants it."""
        return FormulaWidening(
            tuple(
                Branch(b.from_radius_m, b.inside_a_m2, b.inside_b_m, b.outside_a_m2, b.outside_b_m)
                for b in self.branches
            )
        )


class TableBlock(Sourced):
    """Widening from a table, rows [radius_m, inside_m, outside_m] by rising radius; never mixed with formulas."""

    kind: Literal["table"]
    radius_inside_outside_m: Annotated[tuple[tuple[Size, Length, Length], ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _falling(self) -> Self:
        rows = self.radius_inside_outside_m
        for low, high in pairwise(rows):
            if high[0] <= low[0] or high[1] > low[1] or high[2] > low[2]:
                raise ValueError("rows must go by rising radius and never widen with it")
        return self

    def build(self) -> Widening:
        """Return the widening as the section's arithmetic wants it."""
        radii, inside, outside = zip(*self.radius_inside_outside_m, strict=True)
        return TableWidening(tuple(radii), tuple(inside), tuple(outside))


class EarlyBlock(Sourced):
    """Where widening begins before (and ends after) a curve: inside at once, outside on a ramp."""

    inside_from_m: Annotated[float, Field(strict=True, ge=0, le=200)] = 20.0
    outside_from_m: Annotated[float, Field(strict=True, ge=0, le=200)] = 26.0
    outside_full_m: Annotated[float, Field(strict=True, ge=0, le=200)] = 6.0

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.outside_full_m > self.outside_from_m:
            raise ValueError("outside_full_m must not be larger than outside_from_m")
        return self


class QuasiStaticBlock(Sourced):
    """Quasi-static lean qs = s0/L · max(x − threshold, 0) · max(h − height, 0); see `QuasiStatic`."""

    s0: Length
    base_m: Size
    threshold_m: Length = 0.05
    height_m: Length = 0.5
    cant_deficiency_m: Annotated[float, Field(strict=True, ge=0, le=0.5)]
    full_below_radius_m: Size = 5000.0

    def build(self) -> QuasiStatic:
        """Return the lean as the section's arithmetic wants it."""
        return QuasiStatic(
            self.s0, self.base_m, self.threshold_m, self.height_m, self.cant_deficiency_m, self.full_below_radius_m
        )


class CantBlock(Sourced):
    """How cant turns the section: about which point, over which base; `base_by_gauge_m` rows are [gauge, base]."""

    rotation: Literal["file", "centre", "low_rail", "left_rail", "right_rail"] = "file"
    rotation_when_missing: Literal["centre", "low_rail"] = "centre"
    base_by_gauge_m: Annotated[tuple[tuple[Size, Size], ...], Field(min_length=1)]
    base_when_missing_m: Size


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
    """What every limit of a rule carries. `{name}` in a text stands for the feature's own name."""

    name: str = "{name}"
    stop_distance_m: Length | None = None
    tolerance_m: Length = 0.0
    active_while: str | None = None
    exempt_links: tuple[str, ...] = ()


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
    """Overhead line modelled as a line feature."""

    make: Literal["overhead_line"]


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
    """Everything within a clearance of a line feature; its own diameter, or `diameter_m` where it has none."""

    make: Literal["tube"]
    clearance_m: Length
    diameter_m: Length | None = None

    @model_validator(mode="after")
    def _thick(self) -> Self:
        if self.clearance_m <= 0 and not self.diameter_m:
            raise ValueError("clearance_m must be above 0 unless diameter_m is given")
        return self


class SurfaceBlock(LimitBlock):
    """A one-sided surface; the machine keeps above it, or below it for a ceiling."""

    make: Literal["surface"]
    keep: Literal["above", "below"] = "above"


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
    """One rule: the features it is for, and the limits each becomes (none: left out on purpose)."""

    name: Annotated[str, Field(min_length=1)]
    feature: Literal["alignment", "point", "line", "surface"]
    match: Match = Match()
    limits: tuple[Make, ...]

    @model_validator(mode="after")
    def _fitting(self) -> Self:
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
    """When the machine counts as standing on a track: how near, and how parallel."""

    within_m: Size = 1.0
    heading_within_deg: Annotated[float, Field(strict=True, gt=0, le=90)] = 15.0


class RuleBook(Sourced):
    """A whole rule book; rules are tried in order and the first that matches a feature has it."""

    version: Literal[1]
    name: Annotated[str, Field(min_length=1)]
    title: str
    profiles: dict[str, ProfileBlock] = {}
    voltages: dict[str, Voltage] = {}
    own_track: OwnTrackBlock = OwnTrackBlock()
    height_without_profile: Height | Literal["nearest_surface"] = 0.0
    accuracy_m: Annotated[float, Field(strict=True, ge=0.001, le=0.05)] = 0.015
    rules: tuple[Rule, ...] = ()
    zones: tuple[Annotated[BoxZone | PrismZone, Field(discriminator="make")], ...] = ()

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
        return self
