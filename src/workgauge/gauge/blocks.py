"""What a track rule is made of: reference profile, widening, quasi-static lean, cant; and the kinds of numbers."""

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
