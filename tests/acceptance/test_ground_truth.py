"""The rows of the ground-truth table, through the command line, on real third-party files."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared" / "data"
PROGRAM = Path(sys.executable).with_name("workgauge")

pytestmark = pytest.mark.skipif(
    not (DATA / "landxml").is_dir(), reason="third-party files are not at ../shared/data/landxml"
)


def workgauge(*arguments: object) -> dict[str, Any]:
    done = subprocess.run(
        [PROGRAM, *map(str, arguments), "--json"], capture_output=True, text=True, check=False, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def landxml(name: str) -> Path:
    return DATA / "landxml" / name


def test_railway_alignment_length_elements_and_cant() -> None:
    told = workgauge("site", landxml("geoviite/testfile_clothoid_and_parabola.xml"))
    (alignment,) = told["alignments"]
    assert alignment["declared_length_m"] == pytest.approx(18901.845, abs=1e-3)
    assert alignment["length_m"] == pytest.approx(18901.845, abs=1e-3)
    assert alignment["elements"] == {"line": 23, "curve": 19, "spiral": 37}
    assert alignment["cant_stations"] == 71
    assert alignment["has_profile"] is False
    assert told["crs"]["epsg"] == 2392


def test_railway_alignment_position() -> None:
    at = workgauge(
        "at", landxml("geoviite/testfile_clothoid_and_parabola.xml"), "--alignment", "1", "--distance", 1000
    )
    assert at["n"] == pytest.approx(6663359.661, abs=1e-3)
    assert at["e"] == pytest.approx(2500705.024, abs=1e-3)
    assert at["z"] is None


def test_road_alignment_length_position_and_height() -> None:
    file = landxml("inframodel_m3/M3_RS-CL.tg.xml")
    told = workgauge("site", file)
    assert told["crs"]["epsg"] == 3875
    assert told["alignments"][0]["length_m"] == pytest.approx(1266.2462, abs=1e-3)
    at = workgauge("at", file, "--alignment", told["alignments"][0]["name"], "--distance", 633.123)
    assert at["n"] == pytest.approx(6783006.136, abs=1e-3)
    assert at["e"] == pytest.approx(21530673.255, abs=1e-3)
    assert at["z"] == pytest.approx(17.7458, abs=1e-3)


def test_terrain_counts_and_plan_area() -> None:
    (surface,) = workgauge("site", landxml("inframodel_m3/M3_Terrain.mm.xml"))["surfaces"]
    assert (surface["points"], surface["faces"]) == (19872, 36067)
    assert surface["plan_area_m2"] == pytest.approx(69488.61, abs=0.01)


def test_light_poles() -> None:
    assert workgauge("site", landxml("inframodel_m3/Lightning_columns.xy.xml"))["points"] == 37


def test_signal_by_distance_station_and_offset() -> None:
    file = landxml("signals_station/Alignment_exchange.xml")
    told = workgauge("site", file)
    assert told["alignments"][0]["length_m"] == pytest.approx(1029.3721, abs=1e-3)
    by_distance = workgauge("at", file, "--alignment", "Asse_BP", "--distance", 353.1, "--offset", 3)
    by_station = workgauge("at", file, "--alignment", "Asse_BP", "--station", 200, "--offset", 3)
    for at in (by_distance, by_station):
        assert at["e"] == pytest.approx(452600.8615, abs=1e-3)
        assert at["n"] == pytest.approx(4539527.8176, abs=1e-3)
        assert at["z"] + 2.5 == pytest.approx(7.5, abs=1e-3)
        assert at["station"] == pytest.approx(200, abs=1e-3)


def test_cant_of_the_millimetre_file_is_told_in_metres() -> None:
    file = landxml("signals_station/Alignment_exchange.xml")
    at = workgauge("at", file, "--alignment", "Asse_BP", "--distance", 500)
    assert at["cant_m"] == pytest.approx(0.060, abs=1e-6)
    assert abs(at["curvature_1_per_m"]) == pytest.approx(1 / 1000, rel=1e-6)


def test_a_files_own_mistakes_are_warnings() -> None:
    told = workgauge("site", landxml("geoviite/testfile_simple.xml"))
    (alignment,) = told["alignments"]
    assert alignment["declared_length_m"] == pytest.approx(2372.489079, abs=1e-3)
    assert alignment["length_m"] == pytest.approx(664.833, abs=1e-3)
    warnings = " ".join(told["warnings"])
    assert "2372.489" in warnings and "664.83" in warnings
    assert "2392" in warnings and "3879" in warnings
    assert told["crs"]["epsg"] == 2392


def test_envelope_of_the_real_railway_is_covered_and_tight() -> None:
    told = workgauge(
        "limits", landxml("geoviite/testfile_clothoid_and_parabola.xml"), "--rules", "finland", "--verify"
    )
    assert told["verify"]["worst_uncovered_m"] == 0.0
    assert 0.0 <= told["verify"]["worst_surplus_m"] <= 0.05


def test_machine_beside_a_real_light_pole_is_stopped_by_it(tmp_path: Path) -> None:
    names = ("M3_RS-CL.tg.xml", "M3_Terrain.mm.xml", "Lightning_columns.xy.xml")
    files = [landxml(f"inframodel_m3/{name}") for name in names]
    told = workgauge(
        "run", "--site", *files, "--at", "21530666.4,6783013.5,0", "--headless", "--report", tmp_path / "r"
    )
    assert told["entries"] == 0
    assert told["min_clearance_m"] > 0
    assert any("3036" in entry["limit"] for entry in told["interventions"] if entry["limit"])
    assert (tmp_path / "r" / "report.html").stat().st_size > 10_000
