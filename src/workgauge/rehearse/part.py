"""What the parts of a scenario file have in common: unknown keys refused, numbers finite."""

from collections.abc import Iterable
from typing import Annotated, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field

Positive: TypeAlias = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative: TypeAlias = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite: TypeAlias = Annotated[float, Field(allow_inf_nan=False)]
Deflection: TypeAlias = Annotated[float, Field(gt=0, le=1, allow_inf_nan=False)]
LeverName: TypeAlias = Literal["left_x", "left_y", "right_x", "right_y", "left_roller", "right_roller"]
LeverPosition: TypeAlias = Annotated[float, Field(ge=-1, le=1)]


class Part(BaseModel):
    """A part of a scenario: unknown keys refused, values fixed once read."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def exactly_one(part: Part, names: Iterable[str]) -> None:
    given = [name for name in names if getattr(part, name) is not None]
    if len(given) != 1:
        raise ValueError(f"exactly one of {', '.join(names)} is needed, {len(given)} given")
