"""What a scenario may say of the joints: ideal, hydraulic as the machine's file has them, or with numbers of its own.

```yaml
joints: ideal            # follow their valves at once
joints: hydraulic        # as the machine's file says
joints:
  dead_band_percent: 8
  vary_seed: 7           # one machine of all within the file's tolerance
  by_joint:
    boom: {dead_time_s: 0.4}
  changes:
    - {from_s: 10, dead_time_factor: 2}   # cold oil
```
"""

import math
from dataclasses import replace
from typing import Annotated, Literal, TypeAlias

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, Tag, model_validator

from workgauge.machine.model import MachineModel
from workgauge.machine.stopping import StoppingModel
from workgauge.rehearse.either import in_words
from workgauge.sim.hydraulics import Change, HydraulicSpec
from workgauge.values.arrays import Floats
from workgauge.values.errors import ScenarioError

Positive: TypeAlias = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative: TypeAlias = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Factor: TypeAlias = Annotated[float, Field(gt=0, le=100)]
Band: TypeAlias = Annotated[float, Field(ge=0, le=50)]
Seconds: TypeAlias = Annotated[float, Field(ge=0, le=10)]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Response(_Part):
    """How joints follow their valves; what is left out is as the machine's file says."""

    dead_time_s: Seconds | None = None
    lag_s: Seconds | None = None
    natural_frequency_rad_s: Positive | None = Field(default=None, description="a second-order response, not a lag")
    damping: Annotated[float, Field(gt=0, le=10)] | None = Field(default=None, description="its damping ratio; 0.7")
    deceleration_deg_s2: Positive | None = Field(default=None, description="of revolute joints")
    deceleration_m_s2: Positive | None = Field(default=None, description="of prismatic joints")
    acceleration_deg_s2: Positive | None = Field(default=None, description="the deceleration if left out")
    acceleration_m_s2: Positive | None = None
    dead_band_percent: Band | None = Field(default=None, description="of the valve's travel")

    @model_validator(mode="after")
    def _one_response(self) -> "Response":
        if self.lag_s is not None and self.natural_frequency_rad_s is not None:
            raise ValueError("lag_s or natural_frequency_rad_s, not both")
        if self.damping is not None and self.natural_frequency_rad_s is None:
            raise ValueError("damping needs natural_frequency_rad_s")
        return self


class ByDirection(Response):
    """A joint of its own; a direction of it may have numbers of its own again."""

    positive: Response | None = None
    negative: Response | None = None


class TimedChange(_Part):
    """Joints that behave otherwise for a time; factors on what holds otherwise."""

    from_s: NotNegative
    until_s: Positive | None = Field(default=None, description="to the end if left out")
    joints: tuple[str, ...] | None = Field(default=None, min_length=1, description="all if left out")
    dead_time_factor: Factor = 1.0
    lag_factor: Factor = 1.0
    deceleration_factor: Factor = 1.0
    speed_factor: Annotated[float, Field(gt=0, le=1)] = 1.0
    dead_band_factor: Factor = 1.0
    pump_factor: Factor = 1.0

    @model_validator(mode="after")
    def _forwards(self) -> "TimedChange":
        if self.until_s is not None and self.until_s <= self.from_s:
            raise ValueError("until_s must be after from_s")
        return self


class HydraulicChoice(Response):
    """Hydraulic joints with numbers of the scenario's own, for all joints or by joint."""

    valve_full_travel_s: Annotated[float, Field(ge=0, le=10)] = Field(
        default=0.0, description="a spool takes this long from closed to full"
    )
    pump: bool = Field(default=True, description="false: flow enough for all joints")
    pump_flow_l_min: Positive | None = Field(default=None, description="in place of the machine file's")
    by_joint: dict[str, ByDirection] = Field(default_factory=dict)
    changes: tuple[TimedChange, ...] = Field(default=(), max_length=16)
    vary_seed: Annotated[int, Field(ge=0)] | None = Field(
        default=None, description="draws one machine of all within tolerance"
    )
    vary_percent: Annotated[float, Field(ge=0, lt=100)] | None = Field(
        default=None, description="that tolerance; the machine file's if left out"
    )

    @model_validator(mode="after")
    def _together(self) -> "HydraulicChoice":
        if self.vary_percent is not None and self.vary_seed is None:
            raise ValueError("vary_percent needs vary_seed")
        if self.pump_flow_l_min is not None and not self.pump:
            raise ValueError("pump_flow_l_min needs the pump")
        return self


#: What a scenario's `joints` may be.
Joints: TypeAlias = Annotated[
    Annotated[Literal["ideal", "hydraulic"], Tag("<word>")] | Annotated[HydraulicChoice, Tag("<mapping>")],
    in_words(("ideal", "hydraulic"), "a mapping such as `{dead_time_s: 0.3, dead_band_percent: 8}`"),
]


def hydraulic_spec(choice: Joints, machine: MachineModel) -> HydraulicSpec | None:
    """Return how the machine's joints follow their valves in a scenario, None for ideal joints.

    Raises:
        ScenarioError: for a joint the machine does not have, a unit that is not the joint's, or a pump it lacks.
    """
    if choice == "ideal":
        return None
    spec = HydraulicSpec.of_machine(machine)
    if isinstance(choice, str):
        return spec
    rows = _Rows(spec)
    every = range(machine.n)
    rows.put(choice, [j for j in every if not machine.prismatic[j]], "deg", (0, 1))
    rows.put(choice, [j for j in every if machine.prismatic[j]], "m", (0, 1))
    for name, one in choice.by_joint.items():
        j = _index(machine, name, "by_joint")
        unit, wrong = ("m", "deg") if machine.prismatic[j] else ("deg", "m")
        for part, sides in ((one, (0, 1)), (one.positive, (0,)), (one.negative, (1,))):
            if part is not None:
                if any(getattr(part, f"{key}_{wrong}_s2") is not None for key in ("deceleration", "acceleration")):
                    raise ScenarioError(f"joint {name} has {unit}/s2", element=f"joints.by_joint.{name}")
                rows.put(part, [j], unit, sides)
    spec = replace(
        rows.spec(spec),
        valve_rate=1.0 / choice.valve_full_travel_s if choice.valve_full_travel_s else math.inf,
        pump=spec.pump if choice.pump else None,
        script=tuple(_change(one, machine) for one in choice.changes),
    )
    if choice.pump_flow_l_min is not None:
        if spec.pump is None:
            raise ScenarioError("the machine's file has no pump", element="joints.pump_flow_l_min")
        spec = replace(spec, pump=replace(spec.pump, flow=choice.pump_flow_l_min * 1e-3 / 60.0))
    if choice.vary_seed is not None:
        own = StoppingModel.of(machine).tolerance
        spec = spec.varied(choice.vary_seed, own if choice.vary_percent is None else choice.vary_percent / 100.0)
    return spec.checked_for(machine.n)


class _Rows:
    """A spec's arrays while they are filled in."""

    def __init__(self, spec: HydraulicSpec) -> None:
        shape = spec.full_speed.shape
        self.arrays: dict[str, Floats] = {
            "dead_time_s": np.array(spec.dead_time_s),
            "lag_s": np.array(spec.lag_s),
            "deceleration": np.array(spec.deceleration),
            "acceleration": np.full(shape, math.nan),
            "dead_band": np.array(spec.dead_band),
            "natural_frequency": np.zeros(shape),
            "damping": np.full(shape, 0.7),
        }

    def put(self, part: Response, joints: list[int], unit: str, sides: tuple[int, ...]) -> None:
        """Fill in what a part says, for some joints and directions."""
        scale = math.radians(1.0) if unit == "deg" else 1.0
        given = {
            "dead_time_s": part.dead_time_s,
            "lag_s": part.lag_s,
            "natural_frequency": 0.0 if part.lag_s is not None else part.natural_frequency_rad_s,
            "damping": part.damping,
            "dead_band": None if part.dead_band_percent is None else part.dead_band_percent / 100.0,
        }
        for key in ("deceleration", "acceleration"):
            value = getattr(part, f"{key}_{unit}_s2")
            given[key] = None if value is None else value * scale
        for name, value in given.items():
            if value is not None and joints:
                self.arrays[name][np.ix_(sides, joints)] = value

    def spec(self, plain: HydraulicSpec) -> HydraulicSpec:
        """Return the spec with these arrays; acceleration is the deceleration where nothing else is said."""
        rising = self.arrays["acceleration"]
        rising[np.isnan(rising)] = self.arrays["deceleration"][np.isnan(rising)]
        return replace(plain, **self.arrays)  # type: ignore[arg-type]


def _change(one: TimedChange, machine: MachineModel) -> Change:
    return Change(
        from_s=one.from_s,
        until_s=math.inf if one.until_s is None else one.until_s,
        joints=None if one.joints is None else tuple(_index(machine, name, "changes") for name in one.joints),
        dead_time=one.dead_time_factor,
        lag=one.lag_factor,
        deceleration=one.deceleration_factor,
        speed=one.speed_factor,
        dead_band=one.dead_band_factor,
        flow=one.pump_factor,
    )


def _index(machine: MachineModel, name: str, where: str) -> int:
    if name not in machine.joint_names:
        allowed = ", ".join(machine.joint_names)
        raise ScenarioError("no such joint", element=f"joints.{where}", value=name, allowed=allowed)
    return machine.joint_names.index(name)
