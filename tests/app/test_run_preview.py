"""`workgauge run --preview`: verdicts, the JSON object, exit codes, and nothing run or written."""

from collections.abc import Callable
from pathlib import Path

import pytest

from workgauge.rehearse.shipped import shipped_path

RULES = shipped_path("scenarios", "_ballast-removal-rules.yaml")
HEAD = f"""title: preview
site: {{shipped: double_track}}
machine: rre20
rules: {RULES}
guard: {{name: barrier}}
start:
  on_track: {{alignment: Track 1, distance_m: 200.0, facing: forward}}
  posture_deg: {{swing: 15, boom: 25, stick: -95, bucket: -20, tilt: 0, rotate: 15}}
drive:
  - {{do: hold, for_s: 0.5}}
"""
FIRST = "  - {do: go_to, by: joints, goal: {at_m: [4.4, 1.3, 1.0], rpy_deg: [180, 0, 108]}}\n"
LATE = "  - {do: go_to, by: joints, at_most_s: 0.2, goal: {at_m: [4.4, 1.3, 1.2], rpy_deg: [180, 0, 108]}}\n"


def test_what_completes(cli, write: Callable[..., Path], tmp_path: Path) -> None:
    file = write(HEAD + FIRST, "drive.yaml")
    answer = cli.workgauge("run", "--scenario", file, "--preview")
    assert answer.code == 0
    assert answer.out.startswith("step 2, go_to: reaches in ") and " m to " in answer.out
    found = cli.workgauge("run", "--scenario", file, "--preview", "--json").data
    (step,) = found["steps"]
    assert found["completed"] and step["completed"] and step["why"] is None and step["step"] == 2
    assert f"reaches in {found['duration_s']:.1f} s" in answer.out
    assert step["closest"]["clearance_m"] == min(
        one["clearance_m"] for one in step["clearances"] if not one["limit"].startswith("self:")
    )
    rows = {len(step["swept"]["t_s"]), len(step["swept"]["tool_m"]), *map(len, step["swept"]["joints"].values())}
    assert len(rows) == 1 and step["swept"]["t_s"][0] == 0.0
    assert step["swept"]["t_s"][-1] >= step["duration_s"] - 1e-6
    assert [path.name for path in tmp_path.iterdir()] == ["drive.yaml"]


def test_what_does_not_complete(cli, write: Callable[..., Path]) -> None:
    answer = cli.workgauge("run", "--scenario", write(HEAD + LATE + FIRST, "drive.yaml"), "--preview")
    assert answer.code == 1
    assert "step 2, go_to: does not complete, ends after 0.2 s: " in answer.out and "step 3" not in answer.out
    assert "not previewed: step 3" in answer.err


@pytest.mark.parametrize("option", ["--report", "--record"])
def test_nothing_is_run_and_so_nothing_written(cli, write: Callable[..., Path], tmp_path: Path, option: str) -> None:
    file = write(HEAD + FIRST, "drive.yaml")
    answer = cli.workgauge("run", "--scenario", file, "--preview", option, tmp_path / "x")
    assert answer.code == 2 and "preview runs nothing" in " ".join(answer.err.split())
    assert [path.name for path in tmp_path.iterdir()] == ["drive.yaml"]
