"""Scenario files: what is read is what was written; what cannot be used is refused with file, line and element."""

from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.rehearse.scenario import Scenario, json_schema
from workgauge.rehearse.scenario_file import load_scenario
from workgauge.rehearse.shipped import shipped_names
from workgauge.values.errors import ScenarioError

GOOD = """\
title: By hand
site:
  files: [a.xml]
machine: rre20
start:
  on_ground: {east_m: 1, north_m: 2, heading_deg: 3}
drive:
  - {do: hold, for_s: 1.0}
  - do: tool_line
    target: {nearest: point}
    stopped_for_s: 1
  - {do: back, lever: 0.3}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "a.xml").write_text("<LandXML/>")
    return tmp_path


def write(folder: Path, text: str) -> Path:
    path = folder / "s.yaml"
    path.write_text(text)
    return path


def test_files_are_found_beside_the_scenario(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir("/")
    loaded = load_scenario(write(folder, GOOD))
    assert loaded.site_files == (folder / "a.xml",)
    assert (loaded.machine, loaded.rules) == ("rre20", "generic")
    assert [step.do for step in loaded.scenario.drive] == ["hold", "tool_line", "back"]
    assert loaded.scenario.joints == "ideal" and loaded.scenario.sensors == "perfect"


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("files: [a.xml]", "files: [gone.xml]", 3, ["gone.xml", "does not exist"]),
        ("machine: rre20", "machine: gone.yaml", 4, ["gone.yaml", "does not exist"]),
        ("machine: rre20", "machine: rre20\nrules: gone.yaml", 5, ["gone.yaml", "does not exist"]),
        ("title: By hand", "title: By hand\ntitel: x", 2, ["unknown key", "titel"]),
        ("heading_deg: 3", "heading: 3", 6, ["start.on_ground"]),
        ("east_m: 1", "east_m: .nan", 6, ["east_m", "finite"]),
        ("for_s: 1.0", "for_s: 0", 8, ["drive.0.for_s", "greater than 0"]),
        ("do: hold", "do: dance", 8, ["drive.0", "dance"]),
        ("lever: 0.3", "lever: 1.3", 12, ["drive.2.lever"]),
        ("{nearest: point}", "{nearest: point, limit: x}", 10, ["exactly one"]),
        ("    stopped_for_s: 1\n", "", 9, ["exactly one of for_s, stopped_for_s"]),
        ("{nearest: point}", "{east_m: 4}", 10, ["east_m and north_m go together"]),
        ("files: [a.xml]", "files: [a.xml]\n  shipped: double_track", 2, ["exactly one of files, shipped"]),
        ("title: By hand", "title: By hand\ntick_ms: 0.01", 2, ["tick_ms"]),
        ("title: By hand", "title: [", None, ["YAML"]),
        ("title: By hand", "title: a\ntitle: b", 2, ["twice", "title"]),
    ],
)
def test_what_is_wrong_is_said_with_its_place(
    folder: Path, old: str, new: str, line: int | None, words: list[str]
) -> None:
    assert old in GOOD
    path = write(folder, GOOD.replace(old, new, 1))
    with pytest.raises(ScenarioError) as caught:
        load_scenario(path)
    message = str(caught.value)
    assert str(path) in message
    assert "\n" not in message
    for word in words:
        assert word in message
    if line is not None:
        assert caught.value.line == line, message


def test_back_needs_a_line_before_it(folder: Path) -> None:
    start = GOOD.index("  - do: tool_line")
    with pytest.raises(ScenarioError, match="`back` needs a `tool_line` before it"):
        load_scenario(write(folder, GOOD[:start] + "  - {do: back}\n"))


def test_unknown_names_say_what_there_is(folder: Path) -> None:
    with pytest.raises(ScenarioError, match="pole-approach"):
        load_scenario("no-such-scenario")
    with pytest.raises(ScenarioError, match="double_track"):
        load_scenario(write(folder, GOOD.replace("files: [a.xml]", "shipped: nowhere")))


def test_the_shipped_ones_are_valid_and_say_what_they_assume() -> None:
    assert "pole-approach" in shipped_names("scenarios")
    for name in shipped_names("scenarios"):
        loaded = load_scenario(name)
        assert all(path.is_file() for path in loaded.site_files)
        written = yaml.safe_load(loaded.file.read_text())
        assert "joints" in written and "sensors" in written  # said, so that defaults may change


def test_schema_covers_every_key() -> None:
    schema = json_schema()
    assert set(schema["properties"]) == set(Scenario.model_fields)
    assert schema["additionalProperties"] is False


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(["site", "start", "drive", "guard", "machine", "tick_ms", "title", "rules"]), JUNK)
def test_junk_in_any_key_is_a_scenario_error_or_valid(
    tmp_path_factory: pytest.TempPathFactory, key: str, junk: Any
) -> None:
    folder = tmp_path_factory.mktemp("junk", numbered=True)
    (folder / "a.xml").write_text("x")
    data = yaml.safe_load(GOOD)
    data[key] = junk
    said = None
    try:
        load_scenario(write(folder, yaml.safe_dump(data, allow_unicode=True)))
    except ScenarioError as error:
        said = str(error)
    assert said is None or "\n" not in said


@settings(max_examples=150, deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_are_refused_cleanly(tmp_path_factory: pytest.TempPathFactory, raw: bytes) -> None:
    path = tmp_path_factory.mktemp("bytes", numbered=True) / "s.yaml"
    path.write_bytes(raw)
    with pytest.raises(ScenarioError):
        load_scenario(path)


def test_aliases_that_multiply_are_refused(tmp_path: Path) -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 9)]
    with pytest.raises(ScenarioError, match="alias"):
        load_scenario(write(tmp_path, "\n".join(lines)))
