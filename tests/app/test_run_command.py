"""`run`: the documented object, the report, the live view that never shows where nobody looks."""

import io
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from workgauge.app.live import LiveView, bar, centred_bar
from workgauge.machine.load import load_machine
from workgauge.rehearse.run import Progress, open_session, run_session
from workgauge.rehearse.scenario_file import load_scenario
from workgauge.rehearse.shipped import shipped_path

SHORT = """\
title: Short
site: {shipped: double_track}
machine: rre20
rules: finland
start:
  on_track: {alignment: Track 1, distance_m: 573.0}
  posture_deg: {swing: -92, boom: 20, stick: -108, bucket: -73, tilt: 11, rotate: 4}
joints: ideal
sensors: perfect
drive:
  - {do: hold, for_s: 0.2}
  - {do: tool_line, target: {limit: "point:P1-12"}, lever: 0.8, for_s: 1.2}
"""

PROGRAM = Path(sys.executable).with_name("workgauge")


def test_exactly_the_documented_object_and_the_report(cli, write, tmp_path: Path) -> None:
    scenario = write(SHORT, "short.yaml")
    folder = tmp_path / "out" / "report"
    answer = cli.workgauge("run", "--scenario", scenario, "--headless", "--report", folder, "--json")
    data = answer.data
    assert list(data) == [
        "ticks",
        "simulated_s",
        "min_clearance_m",
        "entries",
        "interventions",
        "tick_ms",
        "min_self_clearance_m",
        "self_entries",
        "chatter",
        "positioning",
        "travel",
        "automatic",
        "dug",
        "warnings",
    ]
    assert (data["ticks"], data["simulated_s"], data["entries"]) == (140, 1.4, 0)
    keys = "t_s until_s reason link limit joint clearance_m protection_m stop_distance_m scale text"
    assert {tuple(cause) for cause in data["interventions"]} == {tuple(keys.split())}
    assert any(cause["limit"] == "point:P1-12" for cause in data["interventions"])
    assert 0 < data["tick_ms"]["p50"] <= data["tick_ms"]["p99"] <= data["tick_ms"]["max"]
    assert sorted(path.name for path in folder.iterdir()) == ["report.html", "run.json"]
    assert json.loads((folder / "run.json").read_text()) == data


def test_site_takes_several_files_and_a_place(cli, shipped: Path) -> None:
    files = [shipped / "tracks.xml", shipped / "catenary.xml"]
    arguments = ["--at", "25487288.0,6714595.5,42", "--rules", "finland", "--headless", "--json"]
    together = cli.workgauge("run", "--site", *files, *arguments)
    apart = cli.workgauge("run", "--site", files[0], "--site", files[1], *arguments)
    assert {**together.data, "tick_ms": 0} == {**apart.data, "tick_ms": 0}
    assert together.data["entries"] == 0
    assert any(cause["limit"] == "point:P1-12" for cause in together.data["interventions"])


def test_options_replace_what_a_scenario_says(cli, write, shipped: Path, tmp_path: Path) -> None:
    scenario = write(SHORT, "short.yaml")
    plain = cli.workgauge("run", "--scenario", scenario, "--json").data
    same = cli.workgauge("run", "--scenario", scenario, "--machine", "rre20", "--guard", "linear", "--json").data
    assert {**plain, "tick_ms": 0} == {**same, "tick_ms": 0}
    folder = tmp_path / "other"
    other = cli.workgauge(
        *("run", "--scenario", scenario, "--machine", "sun-a", "--rules", "generic"),
        *("--site", shipped / "catenary.xml", shipped / "terrain.xml"),
        *("--at", "25487293.0,6714591.0,42", "--report", folder, "--json"),
    ).data
    assert other["entries"] == 0
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "(sun-a)" in page and "generic" in page and "tracks.xml" not in page
    assert "on the rails" not in page


def test_as_a_program_json_is_all_there_is_on_stdout(write) -> None:
    scenario = write(SHORT, "short.yaml")
    done = subprocess.run(
        [PROGRAM, "run", "--scenario", scenario, "--json"], capture_output=True, text=True, check=True
    )
    assert json.loads(done.stdout)["ticks"] == 140
    assert "\x1b" not in done.stdout + done.stderr


def test_without_a_terminal_there_is_text_and_no_control_codes(cli, write) -> None:
    answer = cli.workgauge("run", "--scenario", write(SHORT, "short.yaml"))
    assert answer.code == 0
    assert "by Pole P1-12" in answer.out and "smallest true clearance" in answer.out
    assert "\x1b" not in answer.out


def test_the_live_view_draws_every_moment() -> None:
    loaded = load_scenario("pole-approach")
    session = open_session(loaded)
    screen = Console(file=io.StringIO(), force_terminal=True, width=100)
    seen: list[Progress] = []
    with LiveView(screen, session.machine, 0.8, speed=0.0) as view:

        def watch(progress: Progress) -> None:
            seen.append(progress)
            view.show(progress)

        run_session(session, loaded.scenario.drive[:1], "watched", progress=watch)
    assert len(seen) == 100
    plain = Console(file=io.StringIO(), width=100)
    plain.print(view.picture(seen[-1]))
    text = plain.file.getvalue()  # type: ignore[attr-defined]
    for word in ("clearance", "speed left", "swing", "hold (1 of 1)", "°/s"):
        assert word in text


@pytest.mark.parametrize("share", [-1.5, -1.0, -0.3, 0.0, 0.4, 1.0, 7.0])
def test_bars_keep_their_width(share: float) -> None:
    assert len(bar(share, 30)) == 30
    assert len(centred_bar(share, 30)) == 31


AUTOMATIC = """\
title: To a place by itself
site: {shipped: double_track}
machine: rre20
rules: RULES
start:
  on_track: {alignment: Track 1, distance_m: 200.0}
  posture_deg: {swing: -20, boom: 25, stick: -95, bucket: -20, tilt: 0, rotate: 0}
joints: ideal
sensors: perfect
drive:
  - {do: hold, for_s: 0.2}
  - {do: go_to, by: loop, goal: {at_m: [GOAL]}, orientation: free, at_most_s: 4}
"""


def test_a_job_has_a_row_in_the_terminal_and_an_object_in_json(cli, write, tmp_path: Path) -> None:
    machine = load_machine("rre20")
    q = np.radians([-17, 27, -97, -20, 0, 0])
    goal = ", ".join(f"{x:.4f}" for x in machine.tool_pose(machine.forward(q))[:3, 3])
    rules = str(shipped_path("scenarios", "_ballast-removal-rules.yaml"))
    scenario = write(AUTOMATIC.replace("GOAL", goal).replace("RULES", rules), "automatic.yaml")
    folder = tmp_path / "report"
    said = cli.workgauge("run", "--scenario", scenario, "--headless", "--report", folder)
    assert said.code == 0, said.err
    found = json.loads((folder / "run.json").read_text())["automatic"]
    assert said.out.startswith("Done in")
    row = next(line for line in said.out.splitlines() if line.startswith("goal"))
    assert row.split()[:3] == ["goal", found["jobs"][0]["job"].split()[1], "done"]
    assert found["completed"] and found["jobs"][0]["step"] == 2 and found["jobs"][0]["planned_s"] is None
    assert found["jobs"][0]["max_error_m"] <= 0.02
    assert "Automatic motion" in (folder / "report.html").read_text()
