"""XYZ and DXF files: what is read of them, and what is refused with its line."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.site.read import read_site
from workgauge.values.errors import SiteError

TERRAIN = Path(__file__).parents[2].parent / "shared" / "data" / "terrain"


@pytest.fixture
def terrain() -> Path:
    if not TERRAIN.is_dir():
        pytest.skip(f"real files absent: {TERRAIN}")
    return TERRAIN


def test_real_points_and_faces(terrain):
    grid = read_site([terrain / "ElevationGrid.txt"])
    (surface,) = grid.surfaces
    assert len(surface.vertices) == 2040 and surface.name == "ElevationGrid"
    assert any("has no unit" in text for text in grid.warnings)
    dxf = read_site([terrain / "BadMuskau_DGM.dxf"])
    assert {s.name: len(s.faces) for s in dxf.surfaces} == {"Wald": 420, "Graben": 248}
    assert dxf.units["linear"] == "meter"
    assert any("not read: 488 ATTRIB" in text for text in dxf.warnings)
    low = dxf.surfaces[0].vertices.min(axis=0)
    assert 33_479_000 < low[0] < 33_480_000


def points(tmp_path, text, name="site.xyz"):
    path = tmp_path / name
    path.write_text(text)
    return read_site([path])


def test_headings_comments_and_separators(tmp_path):
    site = points(tmp_path, "E;N;Z\n# note\n\n0;0;1;7;tree\n10,0,2\n 0\t10  3\n")
    assert sorted(site.surfaces[0].vertices[:, 2].tolist()) == [1, 2, 3]
    assert any("third number" in text for text in site.warnings)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "holds no points"),
        ("0 0 1\n1 0 1\nfoo\n", ":3: is no point"),
        ("0 0 1\n1 0 nan\n0 1 1\n", ":2: is no point"),
        ("0 0 1\n1 0 1\n", "too few points"),
        ("0 0 1\n1 1 1\n2 2 1\n3 3 1\n", "in one line"),
        ("0 0 1\n1 0 1\n0 1e12 1\n", "beyond any map"),
    ],
)
def test_points_that_are_no_surface(tmp_path, text, words):
    with pytest.raises(SiteError, match=words):
        points(tmp_path, text)


def dxf(*entities: str, units: str = "  9\n$INSUNITS\n 70\n6\n") -> str:
    begin = f"  0\nSECTION\n  2\nHEADER\n{units}  0\nENDSEC\n  0\nSECTION\n  2\nENTITIES\n"
    return f"{begin}{''.join(entities)}  0\nENDSEC\n  0\nEOF\n"


def face(layer: str, *corners: tuple[float, float, float]) -> str:
    rows = "".join(f" {10 + k}\n{x}\n {20 + k}\n{y}\n {30 + k}\n{z}\n" for k, (x, y, z) in enumerate(corners))
    return f"  0\n3DFACE\n  8\n{layer}\n{rows}"


A, B, C, D = (0.0, 0.0, 1.0), (10.0, 0.0, 1.0), (10.0, 10.0, 3.0), (0.0, 10.0, 1.0)


def test_layers_quads_and_units(tmp_path):
    text = dxf(face("road", A, B, C, D), face("ditch", A, B, C, C), "  0\nLINE\n  8\n0\n")
    site = points(tmp_path, text, "a.dxf")
    assert {s.name: len(s.faces) for s in site.surfaces} == {"road": 2, "ditch": 1}
    assert site.surfaces[0].plan_area_m2 == pytest.approx(100.0)
    assert any("not read: 1 LINE" in text for text in site.warnings)
    feet = points(tmp_path, dxf(face("road", A, B, C), units="  9\n$INSUNITS\n 70\n2\n"), "b.dxf")
    assert feet.surfaces[0].vertices.max() == pytest.approx(3.048)
    none = points(tmp_path, dxf(face("road", A, B, C), units=""), "c.dxf")
    assert any("names no unit" in text for text in none.warnings)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (dxf(), "holds no 3DFACE"),
        (dxf("  0\nLINE\n  8\n0\n"), "1 LINE"),
        (dxf(face("road", A, B)), "without three corners"),
        (dxf(face("road", A, B, A)), "no 3DFACE with an area"),
        (dxf(face("road", A, B, C)).replace("10.0", "ten", 1), "is no number"),
        (dxf(face("road", A, B, C)).replace("EOF", "", 1), "ends before its end"),
        (dxf(face("road", A, B, C), units="  9\n$INSUNITS\n 70\n99\n"), "unknown unit"),
        ("hello\nworld\n", "no group code"),
        ("AutoCAD Binary DXF\r\n", "binary DXF"),
        (dxf(face("road", A, B, (1e12, 0.0, 0.0))), "beyond any map"),
    ],
)
def test_dxf_that_is_no_surface(tmp_path, text, words):
    with pytest.raises(SiteError, match=words):
        points(tmp_path, text, "a.dxf")


@settings(max_examples=150, deadline=None)
@given(data=st.binary(max_size=300), name=st.sampled_from(["f.xyz", "f.dxf", "f.txt"]), cut=st.integers(0, 400))
def test_any_bytes_are_read_or_refused(tmp_path_factory, data, name, cut):
    path = tmp_path_factory.mktemp("fuzz") / name
    whole = dxf(face("road", A, B, C, D)).encode()
    path.write_bytes(whole[:cut] + data + whole[cut + 5 :] if name == "f.dxf" else data)
    try:
        site = read_site([path])
    except SiteError:
        return
    assert np.isfinite(site.surfaces[0].vertices).all()
