"""XYZ and DXF files: what is read of them, and what is refused with its line."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.site.read import read_site
from workgauge.site.xyz import read_places
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


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
@pytest.mark.parametrize("name", ["a.xyz", "a.txt", "a.dxf", "a.dat"])
def test_text_in_utf_16_is_refused_by_name(tmp_path, encoding, name):
    path = tmp_path / name
    path.write_bytes((dxf() if name == "a.dxf" else "0 0 1\n1 0 1\n0 1 1\n").encode(encoding))
    for read in (lambda: read_site([path]), lambda: read_places(path)):
        with pytest.raises(SiteError, match=r"UTF-16.*UTF-8"):
            read()


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
        ("0 0 nan\n1 0 1\n0 1 1\n", ":1: is no point"),
        ("1_0 0 1\n1 0 1\n0 1 1\n", ":1: is no point"),
        ("0 0 1\n1 1 1\n2 2 1\n3 3 1\n", "in one line"),
        ("0 0 1\n1 0 1\n0 1e12 1\n", "beyond any map"),
    ],
)
def test_points_that_are_no_surface(tmp_path, text, words):
    with pytest.raises(SiteError, match=words):
        points(tmp_path, text)


@pytest.mark.parametrize("apart", [" ", ";", "\t", "; ", "  "])
@pytest.mark.parametrize("which", [0, 1, 2])
def test_decimal_commas_are_refused_wherever_they_stand(tmp_path, apart, which):
    """Taken for commas between numbers they would be another point."""
    rows = [["1000.5", "2000.5", "50.1"], ["1010.5", "2000.5", "50.1"], ["1000.5", "2010.5", "51.1"]]
    rows = [[word.replace(".", ",") if k == which else word for k, word in enumerate(row)] for row in rows]
    with pytest.raises(SiteError, match=":1: is no point"):
        points(tmp_path, "\n".join(apart.join(row) for row in rows))
    line = tmp_path / "line.txt"
    line.write_text("\n".join(apart.join(row) for row in rows))
    with pytest.raises(SiteError, match=":1: is no place"):
        read_places(line)


def test_commas_with_blanks_are_commas_between_numbers(tmp_path):
    site = points(tmp_path, "0, 0, 1, tree\n10, 0, 2, a big one\n0,10,3\n")
    assert sorted(site.surfaces[0].vertices[:, 2].tolist()) == [1, 2, 3]


@pytest.mark.parametrize(
    "text",
    [
        "N,E,Z\n2000,1000,50\n2000,1010,51\n2010,1000,52\n",
        "id;Easting [m];Northing [m];H\np1;1000;2000;50\n2;1010;2000;51\np 3;1000;2010;52\n",
        "Nr\tHochwert\tRechtswert\tHöhe\n1\t2000\t1000\t50\n2\t2000\t1010\t51\n3\t2010\t1000\t52\n",
        "height north east\n50 2000 1000\n51 2000 1010\n52 2010 1000\n",
    ],
)
def test_a_heading_says_which_column_is_which(tmp_path, text):
    site = points(tmp_path, text, "a.csv")
    found = site.surfaces[0].vertices
    assert sorted(map(tuple, found.tolist())) == [(1000, 2000, 50), (1000, 2010, 52), (1010, 2000, 51)]
    assert any("by its heading east is column" in text for text in site.warnings)


def test_headings_that_do_not_say_leave_the_order_as_it_is(tmp_path):
    for heading in ("X Y Z", "E N", "E E N Z", "my survey"):
        site = points(tmp_path, f"{heading}\n0 0 1\n10 0 2\n0 10 3\n")
        assert site.surfaces[0].vertices.max(axis=0).tolist() == [10, 10, 3]
        assert not any("by its heading" in text for text in site.warnings)
    with pytest.raises(SiteError, match=":3: is no point"):
        points(tmp_path, "id,N,E,Z\n1,0,0,1\n2,,10,2\n", "a.csv")


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


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1", "utf-8-sig"])
def test_layers_with_letters_of_old_and_new_files(tmp_path, encoding):
    path = tmp_path / "a.dxf"
    path.write_bytes(dxf(face("Gräben", A, B, C)).encode(encoding))
    (surface,) = read_site([path]).surfaces
    assert surface.name == "Gräben"


def test_corners_a_hair_apart_are_one_wherever_they_lie(tmp_path):
    for at in (10.0, 10.000004, 10.0000049):
        one, other = (at, 0.0, 0.0), (at + 2e-6, 0.0, 0.0)
        path = tmp_path / "a.dxf"
        path.write_text(dxf(face("road", A, one, C, C), face("road", other, (at, 9.0, 0.0), C, C)))
        (surface,) = read_site([path]).surfaces
        assert len(surface.vertices) == 4 and len(surface.faces) == 2


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


@pytest.mark.parametrize("corners", [(A, B, C, D), (B, C, D, A)])
def test_quads_are_split_along_the_shorter_diagonal(tmp_path, corners):
    lean = [(x + 0.3 * y, y, z) for x, y, z in corners]
    (surface,) = points(tmp_path, dxf(face("road", *lean)), "a.dxf").surfaces
    (shared,) = {*map(frozenset, [{*surface.faces[0].tolist()} & {*surface.faces[1].tolist()}])}
    one, other = (surface.vertices[k] for k in shared)
    assert np.linalg.norm(one - other) == pytest.approx(
        np.linalg.norm(np.subtract(lean[0], lean[2]) if corners[0] == B else np.subtract(lean[1], lean[3]))
    )
