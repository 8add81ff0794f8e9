"""Real files by other people: every one is read or refused for a stated reason, and the known numbers come out."""

import csv
from pathlib import Path

import numpy as np
import pytest

from workgauge.site.read import read_site
from workgauge.values.errors import SiteError

FOLDER = Path(__file__).parents[2].parent / "shared" / "data" / "landxml"
FILES = sorted(p.relative_to(FOLDER).as_posix() for p in FOLDER.glob("*/*.xml"))
REFUSED = {
    "geoviite/testfile_broken.xml": "holds no alignments, surfaces, points or lines",
    "geoviite/testfile_empty_xml.xml": "wrong root element",
}


@pytest.mark.parametrize("name", FILES or [pytest.param("", marks=pytest.mark.skip(reason=f"{FOLDER} absent"))])
def test_every_file_is_read_or_refused_for_its_reason(name):
    if name in REFUSED:
        with pytest.raises(SiteError, match=REFUSED[name]):
            read_site([FOLDER / name])
        return
    site = read_site([FOLDER / name])
    assert site.alignments or site.surfaces or site.points or site.lines
    for alignment in site.alignments:
        joints = alignment.plan.boundaries[1:-1]
        before, after = alignment.at(joints - 1e-8), alignment.at(joints + 1e-8)
        assert np.hypot(before.e - after.e, before.n - after.n).max(initial=0.0) < 1e-6
        d = np.linspace(0, alignment.length, 200)
        for offset in (-2.0, 0.0, 3.0):
            distance, found = alignment.project(alignment.at(d).offset_points(offset))
            assert distance[1:-1] == pytest.approx(d[1:-1], abs=0.01)  # kinks up to 0.5 mrad at spread spirals
            assert found == pytest.approx(offset, abs=1e-4)
    for surface in site.surfaces:
        a, b, c = (surface.vertices[surface.faces[:, k]] - surface.vertices[0] for k in range(3))
        up = np.cross(b - a, c - a)[:, 2]
        assert (up >= -1e-9).all()
        assert surface.plan_area_m2 == pytest.approx(up.sum() / 2, rel=1e-9)


def test_railway_with_clothoids_and_parabolas(real):
    site = read_site([real / "geoviite" / "testfile_clothoid_and_parabola.xml"])
    (track,) = site.alignments
    assert track.declared_length == 18901.845
    assert track.length == pytest.approx(18901.845, abs=1e-3)
    assert track.element_counts == {"line": 23, "curve": 19, "spiral": 37}
    assert track.cant_stations == 71 and track.cant_rotation_point == "insideRail" and not track.has_profile
    state = track.at(1000.0)
    assert (state.n[0], state.e[0]) == pytest.approx((6663359.661, 2500705.024), abs=1e-3)
    assert site.crs is not None and site.crs.epsg == 2392
    misses = [t for t in site.warnings if "misses its stated end" in t]
    assert misses and all("Spiral 'Q" in t for t in misses)  # the biquadratic parabolas; clothoids close within 1 mm
    curved = track.at(np.linspace(0, track.length, 5000))
    canted = np.abs(curved.cant) > 0.04
    assert (np.sign(curved.cant[canted]) == np.sign(curved.curvature[canted])).mean() > 0.999


def test_road_with_profile_lights_and_terrain(real):
    folder = real / "inframodel_m3"
    site = read_site([folder / name for name in ("M3_RS-CL.tg.xml", "M3_Terrain.mm.xml", "Lightning_columns.xy.xml")])
    road = site.alignment("M3_RS - CL")
    assert road.length == pytest.approx(1266.2462, abs=1e-4)
    state = road.at(633.123)
    assert (state.n[0], state.e[0], state.z[0]) == pytest.approx((6783006.136, 21530673.255, 17.7458), abs=1e-3)
    (terrain,) = site.surfaces
    assert (len(terrain.vertices), len(terrain.faces)) == (19_872, 36_067)
    assert terrain.plan_area_m2 == pytest.approx(69_488.61, abs=0.01)
    assert site.crs is not None and site.crs.epsg == 3875
    assert len(site.points) == 37
    pole = next(p for p in site.points if p.name == "3036")
    assert (pole.code, pole.desc) == ("D2342", "Light pole, concrete")
    _, offset = road.project([p.position[:2] for p in site.points])
    assert np.abs(offset).max() < 16
    assert np.median(np.abs(offset)) == pytest.approx(5.350, abs=1e-3)
    assert road.codes["terrainCoding"] == "101"
    assert np.isfinite(road.at([0.0, road.length]).z).all()  # the profile is 67 micrometres shorter than the road
    assert len(site.lines) == 175


def test_station_with_signals(real):
    folder = real / "signals_station"
    (track,) = read_site([folder / "Alignment_exchange.xml"]).alignments
    assert track.length == pytest.approx(1029.3721, abs=1e-4)
    state = track.at(353.1)
    assert state.offset_points(3.0)[0] == pytest.approx([452600.8615, 4539527.8176], abs=1e-4)
    assert state.z[0] + 2.5 == pytest.approx(7.5, abs=1e-6)
    assert track.station_start == -153.1
    assert track.distance_of_station(200.0) == pytest.approx(353.1)

    def rows(name):
        with (folder / name).open(encoding="utf-8-sig") as stream:
            return [{k.strip(): v for k, v in row.items()} for row in csv.DictReader(stream)]

    at = 0.0
    for row in rows("Alignment_horizontal.csv"):
        length = float(row["Segment Length"])
        state = track.at(at)
        assert (state.e[0], state.n[0]) == pytest.approx(
            (float(row["Start Point X"]), float(row["Start Point Y"])), abs=2e-4
        )
        assert np.pi / 2 - state.heading[0] == pytest.approx(float(row["Start Direction"]), abs=1e-6)
        radius = float(row["Start Radius of Curvature"])
        assert track.at(at + 1e-6).curvature[0] == pytest.approx(1 / radius if radius else 0.0, abs=1e-7)
        at += length
    for row in rows("Alignment_vertical.csv"):
        state = track.at(float(row["Start Dist Along"]) + 1e-4)
        assert state.z[0] == pytest.approx(float(row["Start Height"]), abs=2e-4)
        assert state.gradient[0] == pytest.approx(float(row["Start Gradient"]), abs=1e-5)
    for row in rows("Alignment_cant.csv"):
        cant = track.at(float(row["Start Dist Along"])).cant[0]
        assert cant == pytest.approx(float(row["Start Cant right"]) - float(row["Start Cant left"]), abs=1e-4)


def test_the_files_own_mistakes_are_told(real):
    site = read_site([real / "geoviite" / "testfile_simple.xml"])
    (track,) = site.alignments
    assert track.name == "T1"
    assert track.declared_length == pytest.approx(2372.489079)
    assert track.length == pytest.approx(664.833, abs=1e-3)
    text = "\n".join(site.warnings)
    assert "length 2372.489 m declared, 664.833 m by its elements" in text
    assert "EPSG:2392" in text and "EPSG:3879" in text
    assert "258.842 m stated" in text
    assert site.crs is not None and site.crs.epsg == 2392
    assert [e.name for e in track.stationing.equations] == ["0", "1", "2", "3"]
    mended = read_site([real / "geoviite" / "testfile_simple.xml"], epsg=3879)
    assert mended.crs is not None and mended.crs.epsg == 3879


def test_areas_that_files_state_themselves(real):
    assert read_site([real / "tin" / "DGM_LandXML.xml"]).surfaces[0].plan_area_m2 == pytest.approx(6806.0, abs=1e-3)
