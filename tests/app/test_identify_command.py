"""`identify`: the documented object, the table, the blocks, and refusals on one line."""

from pathlib import Path

import pytest
import yaml

from workgauge.machine.load import load_machine
from workgauge.rehearse.identify.programme import Encoders, rehearse_steps


@pytest.fixture(scope="module")
def steps(tmp_path_factory):  # type: ignore[no-untyped-def]
    path = tmp_path_factory.mktemp("log") / "steps.mcap"
    rehearse_steps(load_machine("rre20"), path, joints=[3], encoders=Encoders(seed=2))
    return path


def test_exactly_the_documented_object(cli, steps: Path) -> None:
    data = cli.workgauge("identify", steps, "--joint", "bucket", "--json").data
    assert list(data) == ["log", "machine", "confidence", "joints", "written"]
    assert data["machine"] == "rre20" and data["log"] == str(steps) and data["written"] is None
    (joint,) = data["joints"]
    assert list(joint) == ["joint", "positive", "negative"] and joint["joint"] == "bucket"
    side = joint["positive"]
    assert list(side) == [
        *("dead_time_s", "lag_s", "deceleration_deg_s2", "full_speed_deg_s", "dead_band_percent"),
        *("stops", "left_out", "fit", "model", "table"),
    ]
    assert list(side["fit"]) == ["residual_deg", "explained", "worst_stop_error_deg", "quantisation_deg"]
    assert list(side["table"][0]) == ["speed_deg_s", "expected_deg", "guaranteed_deg", "at_tool_m"]
    assert side["dead_time_s"]["low"] <= 0.2 <= side["dead_time_s"]["high"]
    assert side["dead_band_percent"]["low"] <= 8 <= side["dead_band_percent"]["high"]
    assert side["model"]["tolerance_percent"] == 20 and side["stops"] >= 5
    assert [row["at_tool_m"] > 0 for row in side["table"]] == [True] * 4


def test_a_table_for_people_and_blocks_for_the_file(cli, steps: Path, tmp_path: Path) -> None:
    out = tmp_path / "stopping.yaml"
    answer = cli.workgauge("identify", steps, "--joint", "bucket", "--tolerance", "35", "--write", out)
    assert answer.code == 0, answer.err
    assert "bucket" in answer.out and "at the tool" in answer.out and "°/s" in answer.out and "\x1b" not in answer.out
    (joint,) = yaml.safe_load(out.read_text())["joints"]
    assert joint["name"] == "bucket" and joint["stopping_negative"]["tolerance_percent"] == 35
    assert set(joint["stopping_positive"]) == {
        *("dead_time_s", "lag_s", "deceleration_deg_s2", "tolerance_percent", "source")
    }


def test_a_rehearsal_makes_its_own_log(cli, tmp_path: Path) -> None:
    log = tmp_path / "new.mcap"
    arguments = ("identify", log, "--rehearse", "--machine", "rre20", "--joint", "tilt", "--seed", "5", "--json")
    first = cli.workgauge(*arguments).data
    assert log.exists() and first["joints"][0]["joint"] == "tilt"
    cli.refused(cli.workgauge(*arguments), "already")
    again = cli.workgauge("identify", log, "--joint", "tilt", "--json").data
    assert again == first


def test_what_cannot_be_used_is_refused(cli, steps: Path, tmp_path: Path) -> None:
    cli.refused(cli.workgauge("identify", steps), "joint swing, positive direction", "does not excite")
    cli.refused(cli.workgauge("identify", steps, "--joint", "arm"), "no such joint", "boom")
    cli.refused(cli.workgauge("identify", tmp_path / "no.mcap"), "cannot be read")
    cli.refused(cli.workgauge("identify", steps, "--machine", "brokk5"), "another machine")
    cli.refused(cli.workgauge("identify", steps, "--joint", "bucket", "--write", tmp_path), "regular file")
    assert cli.workgauge("identify").code == 2
    assert cli.workgauge("identify", "--rehearse").code == 2
