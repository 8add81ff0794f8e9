"""Scenario files: what machine stands where on which site, and what its levers do when."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from workgauge.values.errors import ScenarioError

#: A scenario is a page of text; anything larger is not one.
MAX_BYTES = 1_000_000

#: The first hold lasts at least this [s].
SHORTEST_FIRST_HOLD_S = 0.1

Positive: TypeAlias = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite: TypeAlias = Annotated[float, Field(allow_inf_nan=False)]
Deflection: TypeAlias = Annotated[float, Field(gt=0, le=1)]
LeverName: TypeAlias = Literal["left_x", "left_y", "right_x", "right_y", "left_roller", "right_roller"]
LeverPosition: TypeAlias = Annotated[float, Field(ge=-1, le=1)]


class Part(BaseModel):
    """A part of a scenario: unknown keys refused, values fixed once read."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def _exactly_one(part: Part, names: Iterable[str]) -> None:
    given = [name for name in names if getattr(part, name) is not None]
    if len(given) != 1:
        raise ValueError(f"exactly one of {', '.join(names)} is needed, {len(given)} given")


class SiteChoice(Part):
    """The site: files beside the scenario, or a shipped site by name."""

    files: tuple[str, ...] | None = Field(
        default=None, min_length=1, description="site files, relative to the scenario"
    )
    shipped: str | None = Field(default=None, description="name of a shipped site")
    epsg: int | None = Field(default=None, description="coordinate system, where the files name none or a wrong one")

    @model_validator(mode="after")
    def _one(self) -> "SiteChoice":
        _exactly_one(self, ("files", "shipped"))
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
        _exactly_one(self, ("distance_m", "station_m"))
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
        _exactly_one(self, ("on_track", "on_ground"))
        return self


class GuardChoice(Part):
    """The guard by name, and its parameters by theirs; parameters not named keep the guard's defaults."""

    name: str = "linear"
    parameters: dict[str, Finite] = Field(default_factory=dict)


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
        _exactly_one(self, ("nearest", "limit", "east_m", "direction"))
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
        _exactly_one(self, ("for_s", "stopped_for_s"))
        return self


class DriveBack(Part):
    """Drive the tool back along the last line, to where that began."""

    do: Literal["back"]
    lever: Deflection = 0.5
    at_most_s: Positive = 60.0


Step: TypeAlias = Annotated[Hold | MoveLevers | Swing | DriveLine | DriveBack, Field(discriminator="do")]


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
    joints: Literal["ideal"] = Field(
        default="ideal", description="joints follow their command exactly, without delay"
    )
    sensors: Literal["perfect"] = Field(
        default="perfect", description="measurements are exact and fresh at every tick"
    )
    tick_ms: Annotated[float, Field(ge=1, le=100)] = 10.0
    drive: tuple[Step, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _in_order(self) -> "Scenario":
        first = self.drive[0]
        if not isinstance(first, Hold) or first.for_s < SHORTEST_FIRST_HOLD_S:
            raise ValueError(
                f"drive: begins with a `hold` of at least {SHORTEST_FIRST_HOLD_S} s, levers neutral, to open the gate"
            )
        for i, step in enumerate(self.drive):
            if isinstance(step, DriveBack) and not any(isinstance(earlier, DriveLine) for earlier in self.drive[:i]):
                raise ValueError("drive: `back` needs a `tool_line` before it")
        return self


@dataclass(frozen=True, slots=True)
class LoadedScenario:
    """A scenario with its file and every path in it made absolute."""

    scenario: Scenario
    file: Path
    site_files: tuple[Path, ...]
    machine: str | Path
    rules: str | Path

    def with_guard(self, guard: GuardChoice) -> "LoadedScenario":
        """Return the same scenario under another guard."""
        return replace(self, scenario=self.scenario.model_copy(update={"guard": guard}))


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of scenario files."""
    return Scenario.model_json_schema()


def shipped_names(kind: str) -> list[str]:
    """Return the names shipped under `kind` (`scenarios`, `sites`), sorted."""
    folder = files("workgauge").joinpath("shipped", kind)
    if not folder.is_dir():
        return []
    return sorted(Path(entry.name).stem for entry in folder.iterdir() if not entry.name.startswith((".", "_")))


def shipped_path(kind: str, name: str) -> Path:
    """Return the path of a shipped file or folder."""
    with as_file(files("workgauge").joinpath("shipped", kind, name)) as path:
        return path


def shipped_site_files(name: str) -> tuple[Path, ...]:
    """Return the files of a shipped site.

    Raises:
        ScenarioError: if there is none of that name.
    """
    if name not in shipped_names("sites"):
        raise ScenarioError("no such shipped site", value=name, allowed=", ".join(shipped_names("sites")) or "none")
    return tuple(sorted(shipped_path("sites", name).glob("*.xml")))


def load_scenario(name_or_path: str | Path) -> LoadedScenario:
    """Read and check a scenario: a file, or a shipped one by name.

    Raises:
        ScenarioError: if it does not exist, is not valid, or names a file that does not exist.
    """
    path = Path(name_or_path)
    if not path.is_file() and str(name_or_path) in shipped_names("scenarios"):
        path = shipped_path("scenarios", f"{name_or_path}.yaml")
    if not path.is_file():
        raise ScenarioError(
            "no such scenario", value=str(name_or_path), allowed="a file, or " + ", ".join(shipped_names("scenarios"))
        )
    scenario, lines = _parse(path)
    base = path.resolve().parent

    def beside(text: str, key: str) -> Path:
        candidate = base / text
        if not candidate.is_file():
            raise ScenarioError(
                "names a file that does not exist", file=path, line=lines.get(key), element=key, value=text
            )
        return candidate

    def choice(text: str, key: str) -> str | Path:
        return beside(text, key) if Path(text).suffix else text

    if scenario.site.shipped is not None:
        site_files = shipped_site_files(scenario.site.shipped)
    else:
        site_files = tuple(beside(text, f"site.files.{i}") for i, text in enumerate(scenario.site.files or ()))
    return LoadedScenario(
        scenario, path, site_files, choice(scenario.machine, "machine"), choice(scenario.rules, "rules")
    )


def _parse(path: Path) -> tuple[Scenario, dict[str, int]]:
    """Return the scenario and the line of every key and item, by dotted name."""
    try:
        raw = path.read_bytes()
        if len(raw) > MAX_BYTES:
            raise ScenarioError("is too large for a scenario", file=path, allowed=f"at most {MAX_BYTES} bytes")
        text = raw.decode("utf-8-sig")
        if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text, Loader=yaml.SafeLoader)):
            raise ScenarioError("YAML aliases have no use in a scenario", file=path)
        node = yaml.compose(text, Loader=yaml.SafeLoader)
        lines = dict(_lines(node, (), path))
        data = yaml.safe_load(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or "cannot be read"
        line = None if mark is None else mark.line + 1
        raise ScenarioError(f"is not valid YAML: {problem}", file=path, line=line) from error
    except (OSError, ValueError, RecursionError) as error:
        raise ScenarioError("cannot be read as YAML", file=path, value=error) from error
    try:
        return Scenario.model_validate(data), lines
    except ValidationError as error:
        raise _translated(error, path, lines) from error


def _lines(node: Any, at: tuple[str, ...], path: Path) -> Iterable[tuple[str, int]]:
    """Yield (dotted name, line counted from 1) of every key and item; a key given twice is refused."""
    if isinstance(node, yaml.MappingNode):
        pairs = [(str(key.value), key, value) for key, value in node.value]
    elif isinstance(node, yaml.SequenceNode):
        pairs = [(str(i), value, value) for i, value in enumerate(node.value)]
    else:
        return
    seen: set[str] = set()
    for name, key, value in pairs:
        here = (*at, name)
        if name in seen:
            raise ScenarioError("key given twice", file=path, line=key.start_mark.line + 1, element=".".join(here))
        seen.add(name)
        yield ".".join(here), key.start_mark.line + 1
        yield from _lines(value, here, path)


def _translated(error: ValidationError, path: Path, lines: dict[str, int]) -> ScenarioError:
    """Return the first of pydantic's complaints as one of ours."""
    first = error.errors(include_url=False)[0]
    # A step's tag (`hold`, `tool_line`) stands in pydantic's place but not in the file.
    parts = [str(part) for part in first["loc"]]
    if len(parts) > 2 and parts[0] == "drive":
        parts.pop(2)
    element = ".".join(parts)
    line = next((lines[".".join(parts[:k])] for k in range(len(parts), 0, -1) if ".".join(parts[:k]) in lines), None)
    value = first["input"]
    shown = value if isinstance(value, str | int | float | bool) else None
    message = "unknown key" if first["type"] == "extra_forbidden" else first["msg"].removeprefix("Value error, ")
    return ScenarioError(message, file=path, line=line, element=element or None, value=shown)
