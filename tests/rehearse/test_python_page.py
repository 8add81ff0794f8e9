"""The example of docs/python.md runs as it stands, on the shipped site's files."""

import re
from pathlib import Path

import pytest

from workgauge.rehearse.shipped import shipped_path

PAGE = Path(__file__).parents[2] / "docs" / "python.md"


def test_the_example_runs(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    site = shipped_path("sites", "double_track")
    (tmp_path / "tracks.xml").symlink_to(site / "tracks.xml")
    (tmp_path / "poles.xml").symlink_to(site / "catenary.xml")
    monkeypatch.chdir(tmp_path)
    first, ranges, *_ = re.findall(r"```python\n(.*?)```", PAGE.read_text(), flags=re.DOTALL)
    exec(compile(first, str(PAGE), "exec"), {})
    rows = capsys.readouterr().out.splitlines()
    assert len(rows) >= 100
    assert "overhead_line" in rows[0] or "point:" in rows[0] or "track" in rows[0]
    barrier = first.replace('"linear"', '"barrier"').replace("    guard_parameters=", "    # ")
    exec(compile(barrier.replace("range(100)", "range(3)") + ranges, str(PAGE), "exec"), {})
    said = capsys.readouterr().out
    assert re.search(r"swing: -\d\.\d\d to \+\d\.\d\d rad/s", said) and "tool forward:" in said


def test_the_job_is_done_as_foreseen(capsys: pytest.CaptureFixture[str]) -> None:
    begin = "session = Session()\nfor enable in (False, True):\n    session.step(session.intent(enable=enable))\n"
    lift = re.findall(r"```python\n(.*?)```", PAGE.read_text(), flags=re.DOTALL)[2]
    imports = "from workgauge import Session\nfrom workgauge.values.measurements import DriveMode, Levers\n"
    exec(compile(imports + begin + lift, str(PAGE), "exec"), {})
    said = capsys.readouterr().out
    found = re.fullmatch(r"done after (\d+\.\d) s, (\d+\.\d) s foreseen\n", said)
    assert found and abs(float(found[1]) - float(found[2])) <= 0.1, said
