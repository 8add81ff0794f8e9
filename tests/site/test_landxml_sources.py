"""Surfaces without faces: triangles of their points, break lines, contours and boundaries, and that it is said."""

import re
from pathlib import Path

import numpy as np
import pytest

from workgauge.site.read import read_site
from workgauge.site.surface.tin import Tin

E0, N0 = 21_530_000, 6_783_000
REAL = Path(__file__).parents[2].parent / "shared" / "data" / "landxml"


def row(e: float, n: float, *z: float) -> str:
    return " ".join(str(v) for v in (N0 + n, E0 + e, *z))


def grid(f=lambda e, n: 10.0 + 0.1 * e) -> list[tuple[float, float, float]]:
    return [(e, n, f(e, n)) for e in range(0, 21, 4) for n in range(0, 21, 4)]


def listed(points, tag="PntList3D") -> str:
    return f"<{tag}>{' '.join(row(*point) for point in points)}</{tag}>"


def data_points(points) -> str:
    return f"<DataPoints>{listed(points)}</DataPoints>"


def breaks(*lines) -> str:
    inner = "".join(f'<Breakline brkType="standard">{listed(line)}</Breakline>' for line in lines)
    return f"<Breaklines>{inner}</Breaklines>"


def boundaries(*given) -> str:
    return "".join(
        f'<Boundaries><Boundary bndType="{kind}">'
        f"{listed(ring, 'PntList3D' if len(ring[0]) > 2 else 'PntList2D')}</Boundary></Boundaries>"
        for kind, ring in given
    )


def box(low: float, high: float, *z: float):
    return [(low, low, *z), (high, low, *z), (high, high, *z), (low, high, *z)]


@pytest.fixture
def sourced(tools, read):
    def make(source: str, definition: str = "", units: str | None = None):
        w = tools.Writer() if units is None else tools.Writer(units=units)
        inner = f"<SourceData>{source}</SourceData>{definition}"
        return read(w.document(f'<Surfaces><Surface name="ground">{inner}</Surface></Surfaces>'))

    return make


def heights(site, *en):
    (surface,) = site.surfaces
    return Tin.of(surface).heights(np.array(en) + np.array([E0, N0]))


def test_points_alone_become_triangles_and_it_is_said(tools, read):
    w = tools.Writer()
    site = read(w.document(w.surface([(k, row(*p)) for k, p in enumerate(grid(), 1)], [])))
    assert heights(site, (5.0, 7.0), (19.9, 0.1)) == pytest.approx([10.5, 11.99])
    (said,) = (text for text in site.warnings if "no faces" in text)
    assert "Delaunay's of 36 points, out to their hull, with sides up to 5.7 m" in said
    assert site.surfaces[0].plan_area_m2 == pytest.approx(400.0)


def test_break_lines_and_contours_are_edges(sourced):
    ridge = [(1.0, 10.0, 15.0), (19.0, 10.0, 15.0)]
    contour = (
        '<Contours><Contour elev="8.0">' + listed([(1.0, 5.0), (19.0, 5.0)], "PntList2D") + "</Contour></Contours>"
    )
    site = sourced(data_points(grid()) + breaks(ridge) + contour)
    along = np.linspace(1.0, 19.0, 50)
    assert heights(site, *((e, 10.0) for e in along)) == pytest.approx(15.0)
    assert heights(site, *((e, 5.0) for e in along)) == pytest.approx(8.0)
    assert any("36 points, 2 break lines and contours" in text for text in site.warnings)
    assert len(site.lines) == 1  # the break line is a line of the site as well
    assert not any("not read" in text for text in site.warnings)
    smooth = sourced(data_points(grid()))
    assert heights(smooth, (9.0, 10.0)) == pytest.approx([10.9])


def test_points_in_lists_in_pnts_and_of_definitions_all_count(sourced):
    far = '<Definition surfType="TIN"><Pnts><P id="1">' + row(40, 0, 10) + "</P></Pnts></Definition>"
    inner = f'<DataPoints><Pnts><P id="1">{row(40, 20, 10)}</P></Pnts></DataPoints>'
    assert sourced(data_points(grid()) + inner, far).surfaces[0].plan_area_m2 == pytest.approx(800.0)


@pytest.mark.parametrize("flat", [True, False])
def test_boundaries_cut_exactly(sourced, flat):
    """With heights of their own or laid on the surface: 15 m square, less 4 m square, 1 m square in that again."""
    rings = [("outer", box(2.5, 17.5)), ("void", box(8.0, 12.0)), ("island", box(9.5, 10.5)), ("texture", box(3, 4))]
    if not flat:
        rings = [(kind, [(e, n, 10.0 + 0.1 * e) for e, n in ring]) for kind, ring in rings]
    site = sourced(data_points(grid()) + boundaries(*rings))
    assert site.surfaces[0].plan_area_m2 == pytest.approx(225.0 - 16.0 + 1.0)
    found = heights(site, (1.0, 1.0), (3.0, 3.0), (9.0, 9.0), (10.0, 10.0), (12.1, 9.0))
    assert np.isnan(found[[0, 2]]).all()
    assert found[[1, 3, 4]] == pytest.approx([10.3, 11.0, 11.21])
    assert any("3 boundaries" in text for text in site.warnings)


def test_feet_are_metres(sourced):
    feet = '<Units><Imperial linearUnit="foot"/></Units>'
    rows = " ".join(f"{(N0 + n) / 0.3048!r} {(E0 + e) / 0.3048!r} {z / 0.3048!r}" for e, n, z in grid())
    ring = " ".join(f"{(N0 + n) / 0.3048!r} {(E0 + e) / 0.3048!r}" for e, n in box(4.0, 12.0))
    site = sourced(
        f"<DataPoints><PntList3D>{rows}</PntList3D></DataPoints><Boundaries><Boundary bndType='outer'>"
        f"<PntList2D>{ring}</PntList2D></Boundary></Boundaries>",
        units=feet,
    )
    assert heights(site, (5.0, 7.0)) == pytest.approx([10.5], abs=1e-6)
    assert site.surfaces[0].plan_area_m2 == pytest.approx(64.0, abs=1e-4)


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("", "has no triangles and no points"),
        (data_points([(0, 0, 1), (1, 1, 1)]), "too few points"),
        (data_points([(k, 2 * k, 1) for k in range(5)]), "all points lie in one line"),
        (data_points(grid()) + boundaries(("outer", box(100, 110))), "its boundaries leave no triangle"),
        ("<DataPoints><PntList2D>" + row(0, 0) + "</PntList2D></DataPoints>", "has no heights and is left out"),
        ("<Contours><Contour>" + listed(box(0, 9), "PntList2D") + "</Contour></Contours>", "has no height and"),
    ],
)
def test_what_makes_no_surface_is_left_out_and_told(tools, read, source, words):
    w = tools.Writer()
    whole = w.surface([(k, row(*p)) for k, p in enumerate(grid()[:8], 1)], ["<F>1 2 7</F>"])
    bad = f'<Surfaces><Surface name="bad"><SourceData>{source}</SourceData></Surface></Surfaces>'
    site = read(w.document(whole, bad))
    assert [surface.name for surface in site.surfaces] == ["ground"]
    assert any(words in text for text in site.warnings)


def test_boundaries_that_are_none_are_left_out_and_told(sourced):
    bow = [(5.0, 5.0), (15.0, 15.0), (15.0, 5.0), (5.0, 15.0)]
    site = sourced(data_points(grid()) + boundaries(("void", bow), ("outer", [(0.0, 0.0), (9.0, 9.0)])))
    assert site.surfaces[0].plan_area_m2 == pytest.approx(400.0)
    text = " ".join(site.warnings)
    assert "(void) crosses itself and is left out" in text and "(outer) has no area and is left out" in text


def test_the_files_own_faces_count_even_if_all_are_invisible(tools, read):
    w = tools.Writer()
    points = [(k, row(*p)) for k, p in enumerate(grid()[:8], 1)]
    seen = read(w.document(w.surface(points, ["<F>1 2 7</F>", '<F i="1">2 7 8</F>'])))
    assert len(seen.surfaces[0].faces) == 1 and not any("Delaunay" in text for text in seen.warnings)
    other = w.surface(points, ['<F i="1">1 2 7</F>'])
    site = read(w.document(w.surface(points, ["<F>1 2 7</F>"]), other))
    assert len(site.surfaces) == 1 and any("has no visible face" in text for text in site.warnings)


@pytest.mark.prove
def test_a_real_surface_is_made_again_of_what_it_was_made_of(tmp_path):
    """Its faces taken away: 11,380 points, 2415 break lines and an outer boundary give the same triangles again."""
    file = REAL / "infraroom" / "INDOT_Combined_Terrain_tin.xml"
    if not file.is_file():
        pytest.skip(f"real files absent: {file}")
    bare = tmp_path / "bare.xml"
    bare.write_text(re.sub(r"(?s)<Faces>.*?</Faces>", "", file.read_text("utf-8-sig")))
    (given,), (made,) = read_site([file]).surfaces, read_site([bare]).surfaces
    assert len(made.faces) == len(given.faces)
    assert made.plan_area_m2 == pytest.approx(given.plan_area_m2, abs=0.01)
    low, high = given.vertices[:, :2].min(axis=0), given.vertices[:, :2].max(axis=0)
    places = np.random.default_rng(0).uniform(low, high, (40_000, 2))
    one, other = Tin.of(given).heights(places), Tin.of(made).heights(places)
    assert (np.isfinite(one) == np.isfinite(other)).all()
    off = np.abs(one - other)[np.isfinite(one)]
    assert len(off) > 2000 and (off < 1e-3).mean() > 0.995 and off.max() < 0.02  # where four points lie on a circle
