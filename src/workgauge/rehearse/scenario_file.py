"""Reading scenario files: YAML with line numbers, checked, every path in it made absolute."""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import ValidationError

from workgauge.rehearse.scenario import GuardChoice, OnGround, OnTrack, Scenario
from workgauge.rehearse.shipped import shipped_names, shipped_path, shipped_site_files
from workgauge.values.errors import ScenarioError

#: How complaints name a step of the drive, counted from 1.
STEP = re.compile(r"drive, step (\d+)")

#: A scenario is a page of text; anything larger is not one.
MAX_BYTES = 1_000_000


@dataclass(frozen=True, slots=True)
class LoadedScenario:
    """A scenario with its file and every path in it made absolute.

    Attributes:
        scenario: as written. file: where it stands.
        site_files, machine, rules, place, epsg: what it says, or what was chosen instead.
        posture: joint name to position [rad, m]; None for a posture found at the place.
        lines: dotted name of every key and item (`drive.1.goal`) to its line.
    """

    scenario: Scenario
    file: Path
    site_files: tuple[Path, ...]
    machine: str | Path
    rules: str | Path
    place: OnTrack | OnGround
    epsg: int | None
    posture: Mapping[str, float] | None
    lines: Mapping[str, int] = field(default_factory=dict)

    @contextmanager
    def placed(self) -> Iterator[None]:
        """Let a complaint about the scenario that names no file name this one, and the line of the step it names."""
        try:
            yield
        except ScenarioError as error:
            if error.file is not None:
                raise
            step = STEP.match(error.element or "")
            line = None if step is None else self.lines.get(f"drive.{int(step[1]) - 1}")
            raise ScenarioError(
                error.message,
                file=self.file,
                line=line,
                element=error.element,
                value=error.value,
                allowed=error.allowed,
            ) from error

    def choosing(
        self,
        *,
        site_files: Sequence[Path] = (),
        machine: str | Path | None = None,
        rules: str | Path | None = None,
        guard: str | None = None,
        place: OnGround | None = None,
        epsg: int | None = None,
        joints: Literal["ideal", "hydraulic"] | None = None,
    ) -> "LoadedScenario":
        """Return the same scenario with these choices instead of its own.

        Its start posture belongs to its machine and place: with another of either, one is found there. A guard of
        another name comes with its own parameters.
        """
        scenario = self.scenario
        machine = None if machine == self.machine else machine
        if guard is not None and guard != scenario.guard.name:
            scenario = scenario.model_copy(update={"guard": GuardChoice(name=guard)})
        if joints is not None:
            scenario = scenario.model_copy(update={"joints": joints})
        if machine is not None:
            scenario = scenario.model_copy(update={"attachment": None})
        return replace(
            self,
            scenario=scenario,
            site_files=tuple(site_files) or self.site_files,
            machine=machine or self.machine,
            rules=rules or self.rules,
            place=place or self.place,
            epsg=epsg if epsg is not None else None if site_files else self.epsg,
            posture=self.posture if machine is None and place is None and not site_files else None,
        )


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
    start = scenario.start
    place = start.on_track or start.on_ground
    assert place is not None, "a start has exactly one place"
    return LoadedScenario(
        scenario=scenario,
        file=path,
        site_files=site_files,
        machine=choice(scenario.machine, "machine"),
        rules=choice(scenario.rules, "rules"),
        place=place,
        epsg=scenario.site.epsg,
        posture={name: math.radians(value) for name, value in start.posture_deg.items()} | start.posture_m,
        lines=lines,
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
    """Return the first of pydantic's complaints as one of ours; a misspelt key before one that is missing."""
    found = error.errors(include_url=False)
    first = next((one for one in found if one["type"] == "extra_forbidden"), found[0])
    # What tells variants apart (`hold`, `tool_line`) stands in pydantic's place but not in the file.
    parts: list[str] = []
    for i, part in enumerate(str(step) for step in first["loc"]):
        absent = first["type"] == "missing" and i == len(first["loc"]) - 1
        if absent or ".".join([*parts, part]) in lines:
            parts.append(part)
    element = ".".join(parts)
    line = next((lines[".".join(parts[:k])] for k in range(len(parts), 0, -1) if ".".join(parts[:k]) in lines), None)
    value = first["input"]
    shown = value if isinstance(value, str | int | float | bool) else None
    message = "unknown key" if first["type"] == "extra_forbidden" else first["msg"].removeprefix("Value error, ")
    return ScenarioError(message, file=path, line=line, element=element or None, value=shown)
