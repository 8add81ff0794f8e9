"""Automatic steps that cannot be done: exit code 2, one line with file, place and value, and nothing written."""

from collections.abc import Callable
from pathlib import Path

import pytest

from workgauge.rehearse.shipped import shipped_path

#: The drive begins on this line, its first step on the next.
DRIVE_LINE = 12

#: Downwards between the tracks, as the shipped drive begins.
BETWEEN = (
    "{at_m: [4.6, 1.3, 1.3], rpy_deg: [180, 0, 105]}",
    "{at_m: [4.3, 1.9, 0.3], rpy_deg: [180, 0, 114]}",
    "{at_m: [3.4, 1.9, 0.1], rpy_deg: [180, 0, 119]}",
)
GOAL = "goal: {at_m: [4.5, 0, 1]}"


def scenario(step: str, machine: str = "rre20", rules: str | Path = "finland") -> str:
    """Return a scenario whose second step is this one."""
    posture = "{swing: 15, boom: 25, stick: -95, bucket: -20, tilt: 0, rotate: 15}" if machine == "rre20" else "{}"
    return f"""title: bad
site: {{shipped: double_track}}
machine: {machine}
rules: {rules}
guard: {{name: barrier}}
start:
  on_track: {{alignment: Track 1, distance_m: 200.0, facing: forward}}
  posture_deg: {posture}
joints: ideal
sensors: perfect
tick_ms: 10
drive:
  - {{do: hold, for_s: 0.5}}
  - {{{step}}}
"""


def follow(*points: str, more: str = "") -> str:
    """Return a step along these points."""
    return f"do: follow, {more}points: [{', '.join(points)}]"


#: Seen while the file is read: step -> what the message must have.
READ = {
    "do: go_to, goal: {at_m: [.nan, 5.0, 1.5]}": r"drive\.1\.goal\.at_m\.0: .*finite.*nan",
    "do: go_to, goal: {at_m: [1, .inf, 1.5]}": r"drive\.1\.goal\.at_m\.1: .*finite.*inf",
    "do: go_to, goal: {at_m: [1, here, 1.5]}": r"at_m\.1: .*number.*here",
    "do: go_to, goal: {at_m: [1, 2]}": r"at_m\.2: .*required",
    "do: go_to, goal: {at_m: [1.0e+300, 0, 0]}": r"at_m\.0: .*less than.*1e\+300",
    "do: go_to, goal: {at_m: [4, 0, 1], rpy_deg: [.nan, 0, 0]}": r"rpy_deg\.0: .*finite.*nan",
    "do: go_to, goal: {at_m: [4, 0, 1], rpy_deg: [9000, 0, 0]}": r"rpy_deg\.0: .*360.*9000",
    "do: go_to": r"drive\.1\.goal: .*required",
    f"do: go_to, speed_m_s: 0, {GOAL}": r"speed_m_s: .*greater than 0.*found 0",
    f"do: go_to, speed_m_s: .nan, {GOAL}": r"speed_m_s: .*finite.*nan",
    f"do: go_to, turn_deg_s: .inf, {GOAL}": r"turn_deg_s: .*finite.*inf",
    f"do: go_to, share: .nan, {GOAL}": r"share: .*finite.*nan",
    f"do: go_to, pace: 0, {GOAL}": r"pace: .*greater than 0",
    f"do: go_to, sped_m_s: 1, {GOAL}": r"sped_m_s: unknown key",
    f"do: go_to, by: magic, {GOAL}": r"by: .*'line', 'joints' or 'loop'.*magic",
    f"do: go_to, orientation: upright, {GOAL}": r"orientation: .*'full', 'pitch' or 'free'.*upright",
    f"do: fly_to, {GOAL}": r"fly_to.*go_to.*follow",
    follow(BETWEEN[0]): r"drive\.1: .*two points or more, 1 given",
    follow(): r"drive\.1: .*two points or more, 0 given",
    "do: follow": r"drive\.1\.points: .*required",
    follow(BETWEEN[0], BETWEEN[0], BETWEEN[1]): r"point 2 of the path is where point 1 is",
    follow(BETWEEN[0], "{at_m: [4.6, 0, 1.4]}"): r"rpy_deg of every point, or of none",
    follow(BETWEEN[0], "{at_mm: [4.6, 0, 1.4]}"): r"points\.1\.at_mm: unknown key",
    follow(*BETWEEN, more="deviation_m: -1, "): r"deviation_m: .*greater than or equal to 0.*-1",
    follow(*BETWEEN, more="repeat: 2, "): r"must end where it begins",
}

_TURNED = "{at_m: [4.6, 0, 1.4], rpy_deg: [90, 0, 90]}"
_LEVEL = "{at_m: [4.6, 0, 1.3], rpy_deg: [180, 0, 90]}"
_WHOLE = "do: go_to, orientation: full, goal: {at_m: [2.5, 0, 1], rpy_deg: [180, 0, 0]}"
OWN_RULES = "_ballast-removal-rules.yaml"

#: Seen once it is planned: step, machine, rules, what the message must have.
PLANNED = {
    "out of reach": (
        "do: go_to, goal: {at_m: [7.8, 0, 0.5], rpy_deg: [180, 0, 90]}",
        "rre20",
        "finland",
        r"goal: the goal cannot be reached \(found out of reach: by 0\.33 m",
    ),
    "out of reach, any orientation": (
        "do: go_to, goal: {at_m: [14, 0, 1]}",
        "rre20",
        "finland",
        r"goal cannot be reached .*out of reach: at least 4\.\d+ m",
    ),
    "inside a limit": (
        "do: go_to, goal: {at_m: [3.5, 5.5, 1.5]}",
        "rre20",
        "finland",
        r"goal lies inside a limit .*m inside Track 2, 0\.20 m to be kept",
    ),
    "through a limit": (
        follow(*BETWEEN),
        "rre20",
        OWN_RULES,
        r"path goes through a limit .*inside Track 2 after .*s, .*deviation_m of at least 0\.\d\d",
    ),
    "begins inside a limit": (
        follow("{at_m: [4.3, 3.4, 0.6], rpy_deg: [180, 0, 124]}", BETWEEN[0]),
        "rre20",
        OWN_RULES,
        r"path's first point lies inside a limit .*Track 2",
    ),
    "joint ends midway": (
        follow("{at_m: [4.5, 0, 1.5]}", "{at_m: [14.0, 0.0, 1.5]}"),
        "rre20",
        "finland",
        r"cannot be followed to its end \(found at 4\.\d\d m of 9\.50 m: stick at its end",
    ),
    "joint ends while it turns": (
        follow(_LEVEL, _TURNED),
        "rre20",
        "finland",
        r"cannot be followed to its end \(found at 0\.\d\d m of 0\.10 m: bucket at its end",
    ),
    "orientation that cannot be held": (
        _WHOLE,
        "brokk5",
        "finland",
        r"orientation: brokk5 cannot hold the whole orientation.*found full; allowed: free or pitch",
    ),
    "orientation without angles": (
        f"do: go_to, orientation: full, {GOAL}",
        "rre20",
        "finland",
        r"orientation: an orientation needs rpy_deg \(found full.*free, or rpy_deg",
    ),
    "longer than its step": (
        follow("{at_m: [4.5, 0, 1.5]}", "{at_m: [5.0, 0, 1.5]}", "{at_m: [4.5, 0, 1.5]}", more="repeat: 1000, "),
        "rre20",
        "finland",
        r"the path takes 2000 s at least.*found 1000\.0 m at 0\.5 m/s.*at_most_s of at least 2000",
    ),
}


def refused(cli, tmp_path: Path, file: Path, *words: str) -> None:
    """Check that a run of the file is refused with these words and leaves nothing behind."""
    before = set(tmp_path.iterdir())
    report, record = tmp_path / "report", tmp_path / "run.mcap"
    answer = cli.workgauge(
        *("run", "--scenario", file, "--headless", "--json", "--report", report, "--record", record)
    )
    cli.refused(answer, rf"{file.name}:{DRIVE_LINE + 2}: ", *words)
    assert set(tmp_path.iterdir()) == before


@pytest.mark.parametrize("step", list(READ))
def test_steps_refused_as_they_are_read(cli, write: Callable[..., Path], tmp_path: Path, step: str) -> None:
    refused(cli, tmp_path, write(scenario(step), "drive.yaml"), READ[step])


@pytest.mark.parametrize("name", list(PLANNED))
def test_steps_refused_as_they_are_planned(cli, write: Callable[..., Path], tmp_path: Path, name: str) -> None:
    step, machine, rules, words = PLANNED[name]
    path = shipped_path("scenarios", rules) if rules == OWN_RULES else rules
    refused(cli, tmp_path, write(scenario(step, machine, path), "drive.yaml"), "drive, step 2: ", words)


def test_a_preview_is_refused_alike(cli, write: Callable[..., Path], tmp_path: Path) -> None:
    step, machine, rules, words = PLANNED["out of reach"]
    answer = cli.workgauge("run", "--scenario", write(scenario(step, machine, rules), "drive.yaml"), "--preview")
    cli.refused(answer, rf"drive\.yaml:{DRIVE_LINE + 2}: drive, step 2: ", words)


def test_an_empty_drive(cli, write: Callable[..., Path]) -> None:
    text = scenario("do: hold, for_s: 1.0")
    head = text[: text.index("  - ")]
    cli.refused(cli.workgauge("run", "--scenario", write(head, "drive.yaml"), "--headless"), r"drive\.yaml:12: drive")
    cli.refused(cli.workgauge("run", "--scenario", write(text, "drive.yaml"), "--preview"), "nothing to preview")
