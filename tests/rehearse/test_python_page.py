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
    first, ranges = re.findall(r"```python\n(.*?)```", PAGE.read_text(), flags=re.DOTALL)
    exec(compile(first, str(PAGE), "exec"), {})
    rows = capsys.readouterr().out.splitlines()
    assert len(rows) >= 100
    assert "overhead_line" in rows[0] or "point:" in rows[0] or "track" in rows[0]
    barrier = first.replace('"linear"', '"barrier"').replace("    guard_parameters=", "    # ")
    exec(compile(barrier.replace("range(100)", "range(3)") + ranges, str(PAGE), "exec"), {})
    said = capsys.readouterr().out
    assert re.search(r"swing: -\d\.\d\d to \+\d\.\d\d rad/s", said) and "tool forward:" in said
