"""Surfaces read from LandXML: ids, faces, winding, area, and what is refused."""

import numpy as np
import pytest

from workgauge.site.landxml import blocks
from workgauge.values.errors import SiteError

E0, N0 = 21_530_000, 6_783_000


def corner(i: int, e: float, n: float, z: float) -> tuple[int, str]:
    return i, f"{N0 + n} {E0 + e} {z}"


SQUARE = [corner(5, 0, 0, 1), corner(7, 10, 0, 2), corner(100, 10, 20, 3), corner(2, 0, 20, 4)]
FACES = ["<F>5 7 100</F>", "<F>5 2 100</F>"]


@pytest.fixture
def surface(tools, read):
    def make(points, faces, attributes=""):
        w = tools.Writer()
        return read(w.document(w.surface(points, faces, attributes=attributes)))

    return make


def test_ids_may_be_any_numbers_and_all_faces_are_turned_up(surface):
    site = surface(SQUARE, FACES)
    (ground,) = site.surfaces
    assert site.warnings == ()
    assert ground.plan_area_m2 == pytest.approx(200.0)
    assert ground.vertices == pytest.approx(
        np.array([[E0, N0, 1], [E0 + 10, N0, 2], [E0 + 10, N0 + 20, 3], [E0, N0 + 20, 4]])
    )
    assert sorted(map(sorted, ground.faces.tolist())) == [[0, 1, 2], [0, 2, 3]]
    a, b, c = (ground.vertices[ground.faces[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()
    with pytest.raises(ValueError, match="read-only"):
        ground.vertices[0, 0] = 0.0


def test_several_blocks_and_invisible_faces(surface):
    faces = ["<F>5 7 100</F>", "</Faces><Faces>", '<F i="1">5 7 2</F>', '<F i="0" n="1 2 3">5 100 2</F>']
    (ground,) = surface(SQUARE, faces).surfaces
    assert len(ground.faces) == 2
    assert ground.plan_area_m2 == pytest.approx(200.0)


def test_degenerate_vertical_and_four_cornered_faces_are_told(surface):
    more = [*SQUARE, corner(8, 0, 0, 9)]
    site = surface(more, ["<F>5 7 100 2</F>", "<F>5 5 7</F>", "<F>5 7 8</F>"])
    assert site.surfaces[0].plan_area_m2 == pytest.approx(200.0)
    assert len(site.surfaces[0].faces) == 3
    text = " ".join(site.warnings)
    assert "1 faces without area are left out" in text
    assert "1 faces are vertical" in text
    assert "1 faces of four points are split" in text


def test_a_declared_area_that_is_wrong_is_told(surface):
    assert surface(SQUARE, FACES, ' area2DSurf="200.001"').warnings == ()
    assert "plan area 210.00 m2 declared, 200.00 m2" in surface(SQUARE, FACES, ' area2DSurf="210"').warnings[0]


@pytest.mark.parametrize(
    ("points", "faces", "message"),
    [
        (
            SQUARE,
            ["<F>5 7 100</F>", "<F>5 7 101</F>", "<F>1 7 2</F>"],
            "face 2 names point 101, which.*found 2 such faces",
        ),
        ([*SQUARE, corner(5, 1, 1, 1)], FACES, "point id 5 is given twice"),
        ([*SQUARE[:3], (2, "nan 1 1")], FACES, "P id 2: a point of a surface needs three finite numbers"),
        ([*SQUARE[:3], (2, "1 1")], FACES, "P id 2: .*three finite numbers"),
        ([*SQUARE[:3], (2, "")], FACES, "P id 2: .*found nothing"),
        ([*SQUARE[:3], (2, "a b c")], FACES, "P id 2: .*found a b c"),
        ([*SQUARE[:3], (2, "1e11 1 1")], FACES, "beyond any map"),
        ([*SQUARE, ("x", "1 1 1")], FACES, "point without a usable id.*found x"),  # type: ignore[list-item]
        (SQUARE, ["<F>5 7</F>"], "a face is not valid.*found 5 7"),
        (SQUARE, ["<F>5 7 1.5</F>"], "a face is not valid"),
        (SQUARE, ["<F></F>"], "a face is not valid.*found nothing"),
    ],
)
def test_surfaces_that_make_no_sense_are_refused_with_their_line(surface, points, faces, message):
    with pytest.raises(SiteError, match=rf"site0\.xml:\d+: .*{message}"):
        surface(points, faces)


def test_the_line_is_that_of_the_point(tools, read):
    w = tools.Writer()
    text = w.document(w.surface([*SQUARE[:3], (2, "nan 1 1")], FACES))
    line = 1 + text[: text.index("nan")].count("\n")
    with pytest.raises(SiteError, match=rf"site0\.xml:{line}: P id 2"):
        read(text)


def test_repeated_points_in_one_place_are_one(surface):
    assert surface([*SQUARE, SQUARE[0]], FACES).surfaces[0].plan_area_m2 == pytest.approx(200.0)


def test_empty_surfaces_are_told(tools, read):
    w = tools.Writer()
    empty = '<Surfaces><Surface name="bare"/></Surfaces>'
    site = read(w.document(w.surface(SQUARE, FACES), empty))
    assert len(site.surfaces) == 1
    assert any("'bare': has no triangles and no points" in t for t in site.warnings)


def test_large_surfaces_are_read_in_chunks(surface, monkeypatch):
    monkeypatch.setattr(blocks, "_CHUNK", 7)
    width = 12
    points = [corner(1 + r * width + c, c, r, 0.1 * r) for r in range(width) for c in range(width)]
    faces = []
    for r in range(width - 1):
        for c in range(width - 1):
            a = 1 + r * width + c
            faces += [f"<F>{a} {a + 1} {a + width}</F>", f"<F>{a + width + 1} {a + 1} {a + width}</F>"]
    (ground,) = surface(points, faces).surfaces
    assert (len(ground.vertices), len(ground.faces)) == (width**2, 2 * (width - 1) ** 2)
    assert ground.plan_area_m2 == pytest.approx((width - 1) ** 2)


def test_break_lines_and_boundaries_are_lines(tools, read):
    w = tools.Writer()
    source = (
        "<SourceData><Breaklines><Breakline name='kerb'><PntList3D>6783000 21530000 1 6783005 21530000 2</PntList3D>"
        "<Feature code='IM_coding'><Property label='terrainCoding' value='121'/></Feature></Breakline></Breaklines>"
        "<Boundaries><Boundary bndType='outer'><PntList2D>6783000 21530000 6783005 21530000</PntList2D></Boundary>"
        "</Boundaries></SourceData><Definition"
    )
    site = read(w.document(w.surface(SQUARE, FACES).replace("<Definition", source)))
    kerb, outline = site.lines
    assert (kerb.kind, kerb.name, kerb.code) == ("breakline", "kerb", "121")
    assert kerb.points == pytest.approx(np.array([[E0, N0, 1], [E0, N0 + 5, 2]]))
    assert outline.kind == "boundary" and np.isnan(outline.points[:, 2]).all()
    bad = source.replace("6783005 21530000 2", "6783005 21530000")
    with pytest.raises(SiteError, match="PntList3D: a list of points that cannot be read"):
        read(w.document(w.surface(SQUARE, FACES).replace("<Definition", bad)))
