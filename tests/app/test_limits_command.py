"""`limits`: the documented object, the check against the envelope, the export and nothing half-written."""

from pathlib import Path

import pytest

KEYS = ["rules", "limits", "counts", "chainages", "origin", "warnings"]


def test_exactly_the_documented_keys(cli, shipped: Path) -> None:
    data = cli.workgauge("limits", *sorted(shipped.glob("*.xml")), "--rules", "finland", "--json").data
    assert list(data) == KEYS
    assert data["rules"] == "finland"
    assert list(data["counts"]) == ["track", "overhead_line", "point", "line", "surface", "zone"]
    assert data["counts"]["track"] == 2 and data["counts"]["point"] == 50 and data["counts"]["surface"] == 1
    assert sum(data["counts"].values()) == data["limits"]
    track = next(c for c in data["chainages"] if c["name"] == "Track 1")
    assert list(track) == ["id", "name", "kind", "rule", "from_m", "to_m"]
    assert (track["from_m"], track["to_m"]) == (0.0, pytest.approx(1200.0, abs=2e-3))


def test_verify_and_export(cli, shipped: Path, tmp_path: Path) -> None:
    out = tmp_path / "limits.glb"
    arguments = ["limits", shipped / "tracks.xml", "--rules", "finland", "--verify", "--export", out, "--json"]
    data = cli.workgauge(*arguments).data
    assert list(data) == [*KEYS, "verify", "export"]
    assert list(data["verify"]) == ["worst_uncovered_m", "worst_surplus_m"]
    assert data["verify"]["worst_uncovered_m"] == 0.0
    assert 0.0 <= data["verify"]["worst_surplus_m"] <= 0.05
    assert out.read_bytes()[:4] == b"glTF"
    assert [path.name for path in tmp_path.iterdir()] == ["limits.glb"]


def test_an_export_that_cannot_be_written_leaves_nothing(cli, shipped: Path, tmp_path: Path) -> None:
    answer = cli.workgauge("limits", shipped / "tracks.xml", "--export", tmp_path / "no" / "limits.glb")
    cli.refused(answer, "cannot be written", "limits.glb")
    assert list(tmp_path.iterdir()) == []


def test_unknown_rule_book_and_key(cli, shipped: Path, write) -> None:
    cli.refused(cli.workgauge("limits", shipped / "tracks.xml", "--rules", "atlantis"), "atlantis", "finland")
    rules = write("version: 1\nname: x\ntitle: x\nruels: []\n", "r.yaml")
    cli.refused(cli.workgauge("limits", shipped / "tracks.xml", "--rules", rules), "r.yaml:4", "ruels")


def test_people_get_a_table(cli, shipped: Path) -> None:
    answer = cli.workgauge("limits", shipped / "tracks.xml", shipped / "catenary.xml", "--rules", "generic")
    assert answer.code == 0
    assert "overhead line" in answer.out and "from [m]" in answer.out
