"""What the fields of a machine's file are made of: checked numbers, names, mappings that refuse unknown keys."""

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from workgauge.values.measurements import LEVER_NAMES


def refusal(message: str, *, key: str | None = None, value: object = None, allowed: str | None = None) -> Exception:
    """Return the error a validator raises; the loader turns it into a `MachineError` with file and line."""
    context = {"message": message, "key": key, "value": value, "allowed": allowed}
    return PydanticCustomError("refused", "{message}", context)


def _number(value: Any) -> Any:
    if isinstance(value, bool):
        raise refusal("is not a number", value=value, allowed="a number")
    return value


def _lever(value: str) -> str:
    if value not in LEVER_NAMES:
        raise refusal("unknown lever", value=value, allowed=", ".join(LEVER_NAMES))
    return value


def _size(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if min(value) <= 0.0:
        raise refusal("the box has a side without length", value=list(value), allowed="three lengths above 0 m")
    return value


Number = Annotated[float, BeforeValidator(_number), Field(allow_inf_nan=False)]
Degrees = Annotated[Number, Field(ge=-3600, le=3600)]
Metres = Annotated[Number, Field(ge=-100, le=100)]
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]
Position = tuple[Metres, Metres, Metres]
Angles = tuple[Degrees, Degrees, Degrees]
Size = Annotated[tuple[Metres, Metres, Metres], AfterValidator(_size)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_ -]{0,63}$")]
Lever = Annotated[str, AfterValidator(_lever), Field(json_schema_extra={"enum": list(LEVER_NAMES)})]


class Strict(BaseModel):
    """A mapping that takes the keys it knows and no other."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        if isinstance(data, dict):
            for key in data:
                if key not in cls.model_fields:
                    raise refusal("unknown key", key=str(key), allowed=", ".join(cls.model_fields))
        return data


class Sourced(Strict):
    """Something with dimensions: where they come from, and whether they are assumed."""

    source: str | None = Field(default=None, description="where the numbers come from")
    assumed: bool = Field(default=False, description="true if the numbers are a plausible guess")
    note: str | None = None
