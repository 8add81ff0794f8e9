"""`site` and `at`: exactly the documented object, and the right numbers on sites the tests know."""

import math
from pathlib import Path

import pytest


def test_site_has_exactly_the_documented_keys(cli, shipped: Path) -> None:
    data = cli.workgauge("site", *sorted(shipped.glob("*.xml")), "--json").data
    assert list(data) == ["crs", "units", "alignments", "surfaces", "points", "lines", "warnings"]
    assert data["crs"] == {"epsg": 3879, "name": "ETRS89 / GK25FIN"}
    assert [a["name"] for a in data["alignments"]] == ["Track 1", "Track 2"]
    assert list(data["alignments"][0]) == [
        "name",
        "length_m",
        "declared_length_m",
        "start",
        "end",
        "station_start_m",
        "elements",
        "has_profile",
        "cant_stations",
    ]
    assert list(data["alignments"][0]["start"]) == ["e", "n"]
    assert data["alignments"][0]["elements"] == {"line": 2, "curve": 1, "spiral": 2}
    assert data["alignments"][0]["length_m"] == pytest.approx(1200.0, abs=1e-3)
    (surface,) = data["surfaces"]
    assert list(surface) == ["name", "points", "faces", "plan_area_m2"]
    assert (surface["points"], surface["faces"]) == (3025, 5760)
    assert data["points"] == 74


def test_site_without_anything_has_the_same_keys(cli, write) -> None:
    data = cli.workgauge("site", write(cli.document(cli.POLE, crs="")), "--json").data
    assert data["crs"] == {"epsg": None, "name": None}
    assert (data["alignments"], data["surfaces"], data["points"], data["lines"]) == ([], [], 1, 0)


def test_epsg_overrides_what_the_file_says(cli, write) -> None:
    path = write(cli.document(cli.POLE, crs=""))
    assert cli.workgauge("site", path, "--epsg", 3879, "--json").data["crs"]["epsg"] == 3879
    cli.refused(cli.workgauge("site", path, "--epsg", 999999), "999999")


def test_at_has_exactly_the_documented_keys(cli, shipped: Path) -> None:
    data = cli.workgauge("at", shipped / "tracks.xml", "--alignment", "Track 1", "--distance", 569.5, "--json").data
    assert list(data) == [
        "e",
        "n",
        "z",
        "heading_deg",
        "curvature_1_per_m",
        "cant_m",
        "low_rail",
        "station",
        "distance_m",
        "convergence_deg",
        "point_scale",
    ]
    latitude, west_m = math.radians(60.54), 500_000 - 487_285  # by hand: longitude times the sine of latitude
    by_hand = -math.degrees(west_m / 6_394_400 * math.tan(latitude))
    assert data["convergence_deg"] == pytest.approx(by_hand, abs=2e-4)
    assert data["point_scale"] == pytest.approx(1 + (12_715 / 6_380_000) ** 2 / 2, abs=1e-8)
    assert data["e"] == pytest.approx(25487284.745, abs=2e-3)
    assert data["n"] == pytest.approx(6714592.330, abs=2e-3)
    assert data["z"] == pytest.approx(80.133, abs=1e-3)
    assert data["heading_deg"] == pytest.approx(42.039, abs=1e-3)
    assert data["curvature_1_per_m"] == pytest.approx(1 / 600, rel=1e-6)
    assert (data["cant_m"], data["low_rail"]) == (0.1, "left")


def test_at_by_distance_and_by_station_and_without_naming_the_only_alignment(cli, write) -> None:
    path = write(cli.document(cli.alignment(cli.STRAIGHT, rest=cli.profile(50.0), name=" Track 1 ")))
    by_distance = cli.workgauge("at", path, "--distance", 30, "--json").data
    by_station = cli.workgauge("at", path, "--alignment", "Track 1", "--station", 1030, "--json").data
    assert by_distance == by_station
    assert (by_distance["e"], by_distance["n"], by_distance["z"]) == (cli.E0, cli.N0 + 30, 50.0)
    assert by_distance["heading_deg"] == 0.0
    assert by_distance["station"] == 1030.0
    assert by_distance["cant_m"] is None and by_distance["low_rail"] is None


@pytest.mark.parametrize("heading", [0.0, 37.0, 90.0, 180.0, 271.0, 359.0])
def test_offset_is_square_to_the_left_at_every_heading(cli, write, heading: float) -> None:
    h = math.radians(heading)
    path = write(cli.document(cli.alignment(cli.line((0, 0), (200 * math.sin(h), 200 * math.cos(h))))))
    on = cli.workgauge("at", path, "--distance", 100, "--json").data
    left = cli.workgauge("at", path, "--distance", 100, "--offset", 3, "--json").data
    assert on["heading_deg"] == pytest.approx(heading, abs=1e-6)
    assert 0.0 <= on["heading_deg"] < 360.0
    assert left["e"] - on["e"] == pytest.approx(-3 * math.cos(h), abs=2e-6)
    assert left["n"] - on["n"] == pytest.approx(3 * math.sin(h), abs=2e-6)
    assert on["z"] is None


def test_at_needs_one_place_and_one_alignment(cli, shipped: Path) -> None:
    tracks = shipped / "tracks.xml"
    for arguments in ([], ["--distance", 1, "--station", 1]):
        answer = cli.workgauge("at", tracks, "--alignment", "Track 1", *arguments)
        assert answer.code == 2 and answer.out == ""
    cli.refused(cli.workgauge("at", tracks, "--distance", 1), "Track 1", "Track 2")
    cli.refused(cli.workgauge("at", tracks, "--alignment", "Track 3", "--distance", 1), "no such alignment")
    cli.refused(cli.workgauge("at", tracks, "--alignment", "Track 1", "--distance", 5000), "5000")
    cli.refused(cli.workgauge("at", tracks, "--alignment", "Track 1", "--station", -5), "-5")


def test_people_get_tables_with_units_and_warnings_beside_them(cli, shipped: Path) -> None:
    answer = cli.workgauge("site", shipped / "tracks.xml")
    assert answer.code == 0
    assert "Track 2" in answer.out and "length [m]" in answer.out
    answer = cli.workgauge("at", shipped / "tracks.xml", "--alignment", "Track 1", "--distance", 10)
    assert "heading_deg" in answer.out


def test_version_and_schemas(cli) -> None:
    assert cli.workgauge("--version").out.startswith("workgauge ")
    for of, key in (("rules", "rules"), ("machine", "joints"), ("scenario", "drive")):
        assert key in cli.workgauge("schema", of).data["properties"]
    assert cli.workgauge("schema", "nothing").code == 2


def test_without_a_coordinate_system_convergence_is_unknown(cli, write) -> None:
    path = write(cli.document(cli.alignment(cli.STRAIGHT), crs=""))
    data = cli.workgauge("at", path, "--distance", 1, "--json").data
    assert (data["convergence_deg"], data["point_scale"]) == (None, None)


@pytest.mark.parametrize("offset", ["inf", "-inf", "nan", "1e400", "1e30"])
def test_an_offset_that_is_no_number_is_refused(cli, shipped: Path, offset: str) -> None:
    answer = cli.workgauge(
        "at", shipped / "tracks.xml", "--alignment", "Track 1", "--distance=5", f"--offset={offset}"
    )
    cli.refused(answer, "--offset", "finite")
