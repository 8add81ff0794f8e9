"""The scenario's own types: what machine stands where on which site, and what its levers do when."""

from datetime import datetime
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import Field, model_validator

from workgauge.rehearse.auto_steps import FollowPath, GoTo, GradeSurface
from workgauge.rehearse.hydraulic_choice import Joints
from workgauge.rehearse.part import (
    Deflection,
    Finite,
    LeverName,
    LeverPosition,
    NotNegative,
    Part,
    Positive,
    exactly_one,
)
from workgauge.rehearse.sensing import FaultChoice, Sensors
from workgauge.sim.sensors.kit import START_UTC

#: The first hold lasts at least this [s].
SHORTEST_FIRST_HOLD_S = 0.1


class SiteChoice(Part):
    """The site: files beside the scenario, or a shipped site by name."""

    files: tuple[str, ...] | None = Field(
        default=None, min_length=1, description="site files, relative to the scenario"
    )
    shipped: str | None = Field(default=None, description="name of a shipped site")
    epsg: int | None = Field(default=None, description="coordinate system, where the files name none or a wrong one")

    @model_validator(mode="after")
    def _one(self) -> "SiteChoice":
        exactly_one(self, ("files", "shipped"))
        return self


class OnTrack(Part):
    """Standing on the rails of an alignment: pose with gradient and cant."""

    alignment: str
    distance_m: Finite | None = Field(default=None, description="along the alignment from its start")
    station_m: Finite | None = Field(
        default=None, description="or the station, as the file's own station equations count"
    )
    facing: Literal["forward", "backward"] = Field(default="forward", description="with or against the alignment")

    @model_validator(mode="after")
    def _one(self) -> "OnTrack":
        exactly_one(self, ("distance_m", "station_m"))
        return self


class OnGround(Part):
    """Standing on the ground: on the topmost surface of the site there, tilted as it is."""

    east_m: Finite
    north_m: Finite
    heading_deg: Finite = Field(description="clockwise from grid north")


class Start(Part):
    """Where the machine stands and how it holds its arm. Joints not named keep the machine's home posture."""

    on_track: OnTrack | None = None
    on_ground: OnGround | None = None
    posture_deg: dict[str, Finite] = Field(default_factory=dict, description="joint name to angle, revolute joints")
    posture_m: dict[str, Finite] = Field(default_factory=dict, description="joint name to length, prismatic joints")

    @model_validator(mode="after")
    def _one(self) -> "Start":
        exactly_one(self, ("on_track", "on_ground"))
        return self


class GuardChoice(Part):
    """The guard by name, and its parameters by theirs; parameters not named keep the guard's defaults."""

    name: str = "linear"
    parameters: dict[str, Finite | str] = Field(default_factory=dict)


class Target(Part):
    """What the tool is driven at: exactly one of the ways to name it."""

    nearest: Literal["point", "any"] | None = Field(
        default=None, description="the nearest point limit, or limit of any kind"
    )
    limit: str | None = Field(default=None, description="id or name of a limit")
    east_m: Finite | None = None
    north_m: Finite | None = None
    height_m: Finite | None = Field(default=None, description="of the coordinates; the tool's own height if left out")
    direction: tuple[Finite, Finite, Finite] | None = Field(
        default=None, description="in the machine's frame: x forward, y left, z up"
    )

    @model_validator(mode="after")
    def _one(self) -> "Target":
        exactly_one(self, ("nearest", "limit", "east_m", "direction"))
        if (self.east_m is None) != (self.north_m is None):
            raise ValueError("east_m and north_m go together")
        if self.height_m is not None and self.east_m is None:
            raise ValueError("height_m needs east_m and north_m")
        if self.direction is not None and not any(self.direction):
            raise ValueError("direction must not be zero")
        return self


class Hold(Part):
    """All levers in the middle."""

    do: Literal["hold"]
    for_s: Positive


class MoveLevers(Part):
    """Levers held at given positions, each moving its joint."""

    do: Literal["levers"]
    levers: dict[LeverName, LeverPosition] = Field(min_length=1)
    for_s: Positive


class Swing(Part):
    """Turn the cab until the tool points at the target, seen from above, or until it can turn no further."""

    do: Literal["swing_to"]
    target: Target
    lever: Deflection = 0.5
    at_most_s: Positive = 30.0


class DriveLine(Part):
    """Drive the tool centre point on a straight line towards the target."""

    do: Literal["tool_line"]
    target: Target
    lever: Deflection = 0.5
    for_s: Positive | None = Field(default=None, description="end after this time")
    stopped_for_s: Positive | None = Field(default=None, description="or when the tool has stood still for this long")
    at_most_s: Positive = 60.0

    @model_validator(mode="after")
    def _one(self) -> "DriveLine":
        exactly_one(self, ("for_s", "stopped_for_s"))
        return self


class DriveBack(Part):
    """Drive the tool back along the last line, to where that began."""

    do: Literal["back"]
    lever: Deflection = 0.5
    at_most_s: Positive = 60.0


class DriveOut(Part):
    """Let the program drive the machine out of limits it is inside of; once it stands clear nothing moves."""

    do: Literal["exit"]
    lever: Deflection = 1.0
    for_s: Positive


class WaitForTravel(Part):
    """All levers in the middle until the undercarriage has made every leg of `travel`."""

    do: Literal["wait_for_travel"]
    at_most_s: Positive = 600.0


Step: TypeAlias = Annotated[
    Hold | MoveLevers | Swing | DriveLine | DriveBack | DriveOut | GoTo | FollowPath | GradeSurface | WaitForTravel,
    Field(discriminator="do"),
]


class TravelStep(Part):
    """One leg of the undercarriage's way, beside whatever the levers do."""

    from_s: NotNegative = Field(default=0.0, description="begins then, or when the leg before it is made")
    distance_m: Finite | None = Field(default=None, description="forwards as the machine faces, negative backwards")
    to_m: NotNegative | None = Field(default=None, description="or to this distance along the alignment it starts on")
    speed_m_s: Annotated[float, Field(gt=0, le=15)]
    radius_m: Finite | None = Field(
        default=None, description="of the turn on open ground, positive left; rails steer themselves"
    )

    @model_validator(mode="after")
    def _one(self) -> "TravelStep":
        exactly_one(self, ("distance_m", "to_m"))
        if self.distance_m == 0:
            raise ValueError("distance_m must not be zero")
        if self.radius_m is not None and abs(self.radius_m) < 1.0:
            raise ValueError("radius_m must be at least 1 m, to either side")
        return self


class BrakesChoice(Part):
    """How the undercarriage changes its speed."""

    deceleration_m_s2: Annotated[float, Field(gt=0, le=10)] = Field(default=1.0, description="and acceleration")
    reaction_s: Annotated[float, Field(ge=0, le=10)] = Field(
        default=0.2, description="until the brakes act; counted with, not simulated"
    )


class StateChange(Part):
    """A work state switched at a moment."""

    at_s: NotNegative = 0.0
    state: str = Field(min_length=1, description="as the rule book's `active_while` names it")
    on: bool

    @model_validator(mode="before")
    @classmethod
    def _plain_on(cls, given: Any) -> Any:
        """YAML reads a plain `on` as true, as a key too."""
        if isinstance(given, dict) and True in given:
            return {("on" if key is True else key): value for key, value in given.items()}
        return given


class Scenario(Part):
    """A whole scenario, as its file says it."""

    title: str = Field(min_length=1)
    description: str = ""
    site: SiteChoice
    machine: str = Field(description="a shipped machine by name, or a file beside the scenario")
    attachment: str | None = None
    rules: str = Field(default="generic", description="a shipped rule book by name, or a file beside the scenario")
    guard: GuardChoice = GuardChoice()
    start: Start
    joints: Joints = Field(
        default="ideal", description="how joints follow their valves: at once, or as hydraulics do"
    )
    sensors: Sensors = Field(
        default="perfect", description="measurements are exact and fresh at every tick; or simulated receivers"
    )
    faults: tuple[FaultChoice, ...] = Field(default=(), description="what goes wrong with simulated sensors")
    start_utc: datetime = Field(default=START_UTC, description="UTC at the start, with its time zone")
    tick_ms: Annotated[float, Field(ge=1, le=100)] = 10.0
    drive: tuple[Step, ...] = Field(min_length=1)
    travel: tuple[TravelStep, ...] = Field(default=(), description="the undercarriage's way, while the levers work")
    brakes: BrakesChoice = BrakesChoice()
    states: tuple[StateChange, ...] = Field(default=(), description="work states switched; all are on at the start")

    @model_validator(mode="after")
    def _in_order(self) -> "Scenario":
        if self.start_utc.tzinfo is None:
            raise ValueError("start_utc: needs a time zone, as in 2026-03-02T08:00:00Z")
        first = self.drive[0]
        if not isinstance(first, Hold) or first.for_s < SHORTEST_FIRST_HOLD_S:
            raise ValueError(
                f"drive: begins with a `hold` of at least {SHORTEST_FIRST_HOLD_S} s, levers neutral, to open the gate"
            )
        for i, step in enumerate(self.drive):
            if isinstance(step, DriveBack) and not any(isinstance(earlier, DriveLine) for earlier in self.drive[:i]):
                raise ValueError("drive: `back` needs a `tool_line` before it")
        if not self.travel and any(isinstance(step, WaitForTravel) for step in self.drive):
            raise ValueError("drive: `wait_for_travel` needs a `travel`")
        return self


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of scenario files."""
    return Scenario.model_json_schema()
