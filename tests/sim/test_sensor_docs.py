"""The page about simulated sensors: its examples run, and it names every key and every fault."""

import re
from pathlib import Path

import pytest
import yaml
from pydantic import BaseModel, TypeAdapter

from workgauge.rehearse import sensing
from workgauge.sim.sensors.faults import FaultKind

PAGE = Path(__file__).parents[2] / "docs" / "sensors.md"


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def test_the_scenarios_example_is_valid() -> None:
    (text,) = blocks("yaml")
    said = yaml.safe_load(text)
    choice = TypeAdapter(sensing.Sensors).validate_python(said["sensors"])
    faults = TypeAdapter(list[sensing.FaultChoice]).validate_python(said["faults"])
    assert len(choice.settings(faults).faults) == 3


def test_the_python_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (text,) = blocks("python")
    exec(compile(text, str(PAGE), "exec"), {})
    said = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert {port for port, _, _ in said} == {"gnss-left", "gnss-right", "links"}


def test_the_page_names_every_key_and_every_fault() -> None:
    page = PAGE.read_text(encoding="utf-8")
    parts = [one for one in vars(sensing).values() if isinstance(one, type) and issubclass(one, BaseModel)]
    keys = {key for part in parts for key in part.model_fields}
    named = set(re.findall(r"[a-z_]+", " ".join(re.findall(r"`([^`\n]+)`", page))))
    assert keys - named == set()
    assert {str(kind) for kind in FaultKind} - named == set()
