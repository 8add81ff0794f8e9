"""`workgauge path`: its object, its lines, its page, and what it refuses."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import workgauge
from workgauge.app.cli import app
from workgauge.site.read import read_site

SITE = Path(workgauge.__file__).parent / "shipped" / "sites" / "double_track"
DATA = Path(__file__).parents[2].parent / "shared" / "data" / "landxml"
HERE = "25486978.201,6714390.798,63"


def run(*args: str):
    return CliRunner().invoke(app, ["path", *args])


def slope(tmp_path, scale=1.0, name="slope.xyz", hole=False, extra=""):
    rows = [
        f"{1000 + x} {2000 + y} {scale * (50 + 0.05 * x - 0.04 * y):.4f}"
        for x in range(-12, 13, 2)
        for y in range(-12, 13, 2)
        if not (hole and 5 <= x <= 7 and -3 <= y <= 3)
    ]
    path = tmp_path / name
    path.write_text("\n".join(rows) + "\n" + extra)
    return path


def paths(*args: str) -> dict:
    done = run(*args, "--json")
    assert done.exit_code == 0, done.stderr
    return json.loads(done.stdout)


def test_the_object_and_the_page(tmp_path):
    file = slope(tmp_path)
    out = tmp_path / "report"
    data = paths(str(file), "--at", "1000,2000,90", "--lines", "2", "--spacing", "0.8", "--report", str(out))
    assert len(data["paths"]) == 2
    for path in data["paths"]:
        points = np.array(path["points"])
        assert len(path["triangles"]) == len(points) - 1
        assert path["length_m"] == pytest.approx(np.linalg.norm(np.diff(points, axis=0), axis=1).sum(), abs=1e-4)
        assert path["reachable"] and path["max_edge_error_m"] < 5e-3 and path["corner_error_m"] < 1e-3
        assert points[:, 2] == pytest.approx(
            50 + 0.05 * (points[:, 0] - 1000) - 0.04 * (points[:, 1] - 2000), abs=1e-3
        )
        assert points[0, 0] > points[-1, 0]  # heading east, from far to near
    assert any("has no unit" in text for text in data["warnings"])
    assert any("out of reach and cut off" in text for text in data["warnings"])
    assert json.loads((out / "path.json").read_text()) == data
    page = (out / "path.html").read_text()
    assert "<svg" in page and "http" not in page.replace("http://www.w3.org", "")


def test_along_an_alignment_with_a_fan_and_a_polyline(tmp_path):
    files = [str(SITE / "terrain.xml"), str(SITE / "tracks.xml")]
    beside = paths(*files, "--at", HERE, "--along", "Track 1", "--offset", "-6.0")["paths"]
    assert len(beside) == 1 and beside[0]["reachable"] and beside[0]["length_m"] > 5.0
    line = tmp_path / "line.txt"
    line.write_text("# east north\n25486981.3,6714384.6\n25486979.9 6714387.3\n")
    own = paths(*files, "--at", HERE, "--polyline", str(line), "--cutting-deg=-20")["paths"]
    assert len(own) == 1 and own[0]["reachable"]
    assert own[0]["points"][0][:2] == pytest.approx([25486981.3, 6714384.6], abs=1e-3)
    shown = run(*files, "--at", HERE, "--fan=-90,-78,1", "--cutting-deg=-20")
    assert shown.exit_code == 0 and "Paths" in shown.stdout and "on the rails of Track 1" in shown.stdout


def test_four_joints_state_the_misfit(tmp_path):
    """The machine stands level; ahead of it the ground falls to its right."""
    rows = [f"{1000 + x} {2000 + y} {50 + 0.1 * y * (x > 1)}" for x in range(-12, 13) for y in range(-12, 13, 3)]
    file = tmp_path / "bent.xyz"
    file.write_text("\n".join(rows))
    place = ("--at", "1000,2000,90", "--lines", "1", "--near", "2.1", "--over-dig-mm", "200")
    four = paths(str(file), *place, "--machine", "sun-a")["paths"][0]
    assert four["reachable"]
    assert four["corner_error_m"] == pytest.approx(0.5 * 0.1, rel=0.1)  # it stands a little askew


def test_a_hole_under_the_path_is_said(tmp_path):
    rows = [(x, y) for x in range(-12, 13, 2) for y in range(-12, 13, 2)]
    site = read_site([slope(tmp_path)]).surfaces[0]
    middles = site.vertices[site.faces].mean(axis=1)
    keep = ~((np.abs(middles[:, 0] - 1006) < 0.9) & (np.abs(middles[:, 1] - 2000) < 2.5))
    assert len(rows) == len(site.vertices)
    faces = "".join(f"<F>{a + 1} {b + 1} {c + 1}</F>" for a, b, c in site.faces[keep])
    points = "".join(f'<P id="{i}">{n} {e} {z}</P>' for i, (e, n, z) in enumerate(site.vertices, 1))
    file = tmp_path / "hole.xml"
    file.write_text(
        '<LandXML xmlns="http://www.landxml.org/schema/LandXML-1.2"><Units><Metric linearUnit="meter"/></Units>'
        f'<Surfaces><Surface name="pit"><Definition surfType="TIN"><Pnts>{points}</Pnts><Faces>{faces}</Faces>'
        "</Definition></Surface></Surfaces></LandXML>"
    )
    data = paths(str(file), "--at", "1000,2000,90", "--lines", "1")
    said = " ".join(data["warnings"])
    assert "holes" in said and "no surface under it from" in said
    assert len(data["paths"]) >= 1


def test_heights_in_feet_beside_metres_are_doubted(tmp_path):
    feet = slope(tmp_path, 3.28084, "feet.xyz")
    data = paths(str(slope(tmp_path)), str(feet), "--at", "1000,2000,90", "--surface", "slope", "--lines", "1")
    assert any("differ as metres and feet do" in text for text in data["warnings"])


def test_real_surface_from_where_a_machine_stands():
    file = DATA / "inframodel_m3" / "M3_Terrain.mm.xml"
    if not file.is_file():
        pytest.skip(f"real files absent: {file}")
    surface = read_site([file]).surfaces[0]
    e, n = surface.vertices[surface.faces[20_000], :2].mean(axis=0)
    data = paths(str(file), "--at", f"{e},{n},45", "--lines", "1")
    assert len(data["paths"]) >= 1 and data["paths"][0]["reachable"]


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["--at", "5000,2000,90"], "no ground to stand on"),
        (["--at", "1000,2000"], "is not E,N,HEADING_DEG"),
        (["--at", "1000,2000,90", "--lines", "0"], "not a number of lines"),
        (["--at", "1000,2000,90", "--spacing", "0"], "not a spacing"),
        (["--at", "1000,2000,90", "--lines", "2", "--fan=-10,10,3"], "not together"),
        (["--at", "1000,2000,90", "--fan=-10,10"], "is not FROM,TO,N"),
        (["--at", "1000,2000,90", "--spacing", "2", "--fan=-10,10,3"], "not together with --fan"),
        (["--at", "1000,2000,90", "--offset", "2"], "only together with --along"),
        (["--at", "1000,2000,90", "--spacing", "nan"], "not a spacing"),
        (["--at", "1000,2000,90", "--lines", "10000"], "1 to 1000"),
        (["--at", "1000,2000,90", "--near", "2.123456789", "--far", "1"], "found 2.12 to 1.00 m"),
        (["--at", "1000,2000,90", "--along", "Track 9"], "no such alignment"),
        (["--at", "1000,2000,90", "--surface", "road"], "no such surface"),
        (["--at", "1000,2000,90", "--polyline", "absent.txt"], "cannot be read"),
        (["--at", "1000,2000,90", "--bucket-width", "0"], "not a bucket"),
        (["--at", "1000,2000,90", "--over-dig-mm", "-1"], "not a blend"),
        (["--at", "1000,2000,90", "--near", "8", "--far", "5"], "not a reach"),
        (["--at", "1000,2000,90", "--machine", "spoon"], "spoon"),
        (["--at", "1e300,2000,90"], "'1e300,2000,90': metres within 1e8"),
        (["--at", "1000,2000,1e300"], "'1000,2000,1e300': metres within 1e8"),
        (["--at", "1000,2000,90", "--near", "1e300"], "found 1e+300 to"),
        (["--at", "1000,2000,90", "--far", "1e300"], "allowed: 0 to 1000 m"),
        (["--at", "1000,2000,90", "--spacing", "1e300"], "found 1e+300; allowed"),
        (["--at", "1000,2000,90", "--cutting-deg", "1e300"], "found 1e+300; allowed"),
        (["--at", "1000,2000,90", "--bucket-width", "30"], "bucket width: not a bucket (found 30;"),
    ],
)
def test_what_is_refused(tmp_path, args, words):
    done = run(str(slope(tmp_path)), *args)
    assert done.exit_code == 2
    assert words in " ".join(done.stderr.split())


def test_a_place_at_national_coordinates_stays_on_one_line(tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    shown = run(str(SITE / "terrain.xml"), str(SITE / "tracks.xml"), "--at", HERE, "--lines", "1")
    (path,) = paths(str(SITE / "terrain.xml"), str(SITE / "tracks.xml"), "--at", HERE, "--lines", "1")["paths"]
    assert ", ".join(f"{v:.2f}" for v in path["points"][0]) in shown.stdout


@pytest.mark.parametrize(
    ("text", "words"),
    [("0 0 1\n5 0 1\n0 5 1\n", ""), ("0 0 1\n0 5 1\n", "too few points"), ("", "holds no points")],
)
def test_three_points_two_and_none(tmp_path, text, words):
    file = tmp_path / "few.xyz"
    file.write_text(text)
    done = run(str(file), "--at", "1.5,1.5,0", "--json")
    if words:
        assert done.exit_code == 2 and words in done.stderr
    else:
        assert done.exit_code == 0 and not any(one["reachable"] for one in json.loads(done.stdout)["paths"])
