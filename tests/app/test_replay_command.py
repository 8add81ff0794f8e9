"""`run --record` and `replay`: the documented object, what people read, exit codes."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from workgauge.record.reader import open_log
from workgauge.record.writer import LogWriter
from workgauge.rehearse.shipped import shipped_path

MACHINE = shipped_path("machines", "rre20.yaml")

SHORT = """\
title: Short
site: {shipped: double_track}
machine: own.yaml
rules: finland
start:
  on_track: {alignment: Track 1, distance_m: 573.0}
  posture_deg: {swing: -92, boom: 20, stick: -108, bucket: -73, tilt: 11, rotate: 4}
joints: {dead_band_percent: 5}
sensors: perfect
drive:
  - {do: hold, for_s: 0.2}
  - {do: tool_line, target: {limit: "point:P1-12"}, lever: 0.8, for_s: 0.6}
"""


@pytest.fixture
def log(cli, write, tmp_path: Path) -> Path:
    scenario = write(SHORT, "short.yaml")
    shutil.copy(MACHINE, scenario.parent / "own.yaml")
    path = tmp_path / "run.mcap"
    assert cli.workgauge("run", "--scenario", scenario, "--headless", "--record", path, "--json").data["ticks"] == 80
    return path


def test_exactly_the_documented_object(cli, log: Path) -> None:
    data = cli.workgauge("replay", log, "--json").data
    assert list(data) == [
        *("log", "complete", "written_by", "machine", "guard"),
        *("ticks", "from_s", "until_s", "different", "first", "moving", "same"),
    ]
    assert (data["ticks"], data["different"], data["first"], data["same"]) == (80, 0, None, True)
    assert data["complete"] is True and data["machine"] == "own" and data["moving"] > 10
    assert open_log(log).configuration["origin"]["joints"].startswith("hydraulic")


def test_people_are_told_and_a_cut_log_is_said_to_be_cut(cli, log: Path, tmp_path: Path) -> None:
    answer = cli.workgauge("replay", log)
    assert answer.code == 0 and "Every command comes out again" in answer.out and "\x1b" not in answer.out
    cut = tmp_path / "cut.mcap"
    begin, length = open_log(log).chunks[-1]
    cut.write_bytes(log.read_bytes()[: begin + length])
    answer = cli.workgauge("replay", cut)
    assert answer.code == 0 and "cut after" in answer.out


def test_another_command_in_the_log_is_found_with_exit_code_3(cli, log: Path, tmp_path: Path) -> None:
    forged, opened = tmp_path / "forged.mcap", open_log(log)
    with LogWriter(forged, opened.configuration) as writer:
        for topic, time_ns, value in opened.entries():
            if topic == "/intent" and any(value.levers.values):
                value = replace(value, levers=type(value.levers)())
            writer.write(topic, time_ns, value)
    answer = cli.workgauge("replay", forged)
    assert answer.code == 3 and "come out otherwise" in answer.out and "First at" in answer.out


def test_what_cannot_be_used_is_refused(cli, write, log: Path, tmp_path: Path) -> None:
    cli.refused(cli.workgauge("replay", tmp_path / "no.mcap"), "cannot be read")
    cli.refused(cli.workgauge("replay", log, "--rules", "generic"), "another one than the run had", "finland")
    own = next(log.parent.rglob("own.yaml"))
    own.write_text(own.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    cli.refused(cli.workgauge("replay", log), "own.yaml", "not as it was")
    refused = cli.workgauge("run", "--headless", "--record", log)
    cli.refused(refused, "never written over")


def test_joints_may_be_chosen_on_the_command_line(cli, write, tmp_path: Path) -> None:
    scenario = write(SHORT, "short.yaml")
    shutil.copy(MACHINE, scenario.parent / "own.yaml")
    path = tmp_path / "run.mcap"
    arguments = ("run", "--scenario", scenario, "--headless", "--record", path, "--joints", "ideal", "--json")
    assert cli.workgauge(*arguments).code == 0
    assert open_log(path).configuration["drive"]["kind"] == "ideal"
    assert cli.workgauge(*arguments[:-2], "soft").code == 2
