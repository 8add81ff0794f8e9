"""The positioning page says what the code does: its numbers, its names and its example."""

import math
import re
from pathlib import Path

import pytest
import yaml

from workgauge.machine.positioning import PositioningSpec, RailSpec
from workgauge.positioning.motion import ACCELERATION, HISTORY_S
from workgauge.positioning.rails import track_covariance
from workgauge.values.health import HealthState

PAGE = (Path(__file__).parents[2] / "docs" / "positioning.md").read_text()


def keys(model: type) -> set[str]:
    """Every key of a section and of what is in it."""
    schema = model.model_json_schema()  # type: ignore[attr-defined]
    parts = [schema, *schema.get("$defs", {}).values()]
    return {key for part in parts for key in part.get("properties", {})}


def test_every_key_named_is_one() -> None:
    known = keys(PositioningSpec) | {"rpy_deg", "position_m", "dead_reckoning", "chassis_frozen"}
    named = set(re.findall(r"`([a-z]+(?:_[a-z]+)+)(?::[^`]*)?`", PAGE))
    names = {state.value for state in HealthState} | {"wire_encoder", "two_antennas", "moving_base"}
    assert named - known - names == set()
    thresholds = keys(type(PositioningSpec.model_fields["thresholds"].default))
    unsaid = thresholds - named - {"source", "assumed", "note", "check_required"}
    assert unsaid == set()


def test_the_example_is_a_section() -> None:
    block = re.search(r"```yaml\n(.*?)```", PAGE, re.S)
    assert block is not None
    spec = PositioningSpec.model_validate(yaml.safe_load(block.group(1))["positioning"])
    assert [receiver.port for receiver in spec.receivers] == ["gnss-left", "gnss-right"]


def test_numbers() -> None:
    F = track_covariance(RailSpec(), 1.6)
    assert 1e3 * math.sqrt(F[0, 0]) == pytest.approx(12, abs=0.6)
    assert f"last {HISTORY_S:g} s" in PAGE and f"an acceleration of {ACCELERATION:g} m/s²" in PAGE
    assert math.degrees(math.sqrt(F[2, 2])) == pytest.approx(0.18, abs=0.01)
    assert math.degrees(math.sqrt(F[4, 4])) == pytest.approx(0.19, abs=0.01)
