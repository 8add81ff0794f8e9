"""Numbers that are too large, implausible or written in another way."""

import numpy as np
import pytest

from workgauge.site.transitions import Law
from workgauge.values.errors import SiteError

PARTS = {
    "PntList3D": "<PlanFeatures><PlanFeature name='f'><CoordGeom><IrregularLine><PntList3D>"
    "6783000 21530000 1 {0} {1} {2}</PntList3D></IrregularLine></CoordGeom></PlanFeature></PlanFeatures>",
    "CgPoint": "<CgPoints><CgPoint name='p'>{0} {1} {2}</CgPoint></CgPoints>",
    "P id 3": "<Surfaces><Surface name='s'><Definition><Pnts><P id='1'>6783000 21530000 1</P>"
    "<P id='2'>6783009 21530000 2</P><P id='3'>{0} {1} {2}</P></Pnts>"
    "<Faces><F>1 2 3</F></Faces></Definition></Surface></Surfaces>",
    "Start": "<PlanFeatures><PlanFeature name='f'><CoordGeom><Line><Start>{0} {1} {2}</Start>"
    "<End>6783000 21530000 1</End></Line></CoordGeom></PlanFeature></PlanFeatures>",
    "Breakline": "<Surfaces><Surface><SourceData><Breaklines><Breakline><PntList3D>6783000 21530000 1 {0} {1} {2}"
    "</PntList3D></Breakline></Breaklines></SourceData></Surface></Surfaces>",
}
GOOD = ("6783010", "21530010", "3")


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("place", [0, 1, 2])
@pytest.mark.parametrize("value", ["1e308", "-1e308", "1.1e8"])
def test_every_coordinate_has_the_same_bound(tools, read, part, place, value):
    numbers = [value if i == place else word for i, word in enumerate(GOOD)]
    with (
        np.errstate(all="raise"),
        pytest.raises(
            SiteError, match=r"site0\.xml:\d+: .*coordinates beyond any map \(found .*; allowed: at most 1e\+08 meter"
        ) as caught,
    ):
        read(tools.Writer().document(PARTS[part].format(*numbers)))
    assert part in str(caught.value) or part == "Breakline"


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("value", ["nan", "inf", "1e999", "1_0", "٣", "1,5", "x"])
def test_what_is_no_number_is_shown_with_what_is_allowed(tools, read, part, value):
    with pytest.raises(SiteError, match=r"site0\.xml:\d+: ") as caught:
        read(tools.Writer().document(PARTS[part].format(GOOD[0], GOOD[1], value)))
    assert value in str(caught.value)
    assert "numbers with a decimal point, separated by spaces" in str(caught.value)


@pytest.mark.parametrize("part", PARTS)
def test_commas_do_not_separate(tools, read, part):
    text = PARTS[part].replace("{0} {1} {2}", "6783010,21530010,3")
    with pytest.raises(SiteError, match=r"6783010,21530010,3.*separated by spaces"):
        read(tools.Writer().document(text))


@pytest.mark.parametrize("part", PARTS)
def test_any_white_space_separates(tools, read, part):
    site = read(tools.Writer().document(PARTS[part].replace("{0} {1} {2}", "6783010\u00a021530010\t\n3")))
    assert site.points or site.lines or site.surfaces


def test_bounds_are_told_in_the_files_unit(tools, read):
    w = tools.Writer(units='<Units><Metric linearUnit="kilometer" elevationUnit="meter"/></Units>', crs="")
    with pytest.raises(SiteError, match=r"at most 1e\+05 kilometer and heights of 1e\+08 meter"):
        read(w.document(PARTS["CgPoint"].format("2e5", "1", "1")))


def test_attributes_that_are_too_large_say_so(tools, read):
    w = tools.Writer()
    line = w.element(tools.chain(("line", Law.CONSTANT, 100.0, 0, 0))[0])
    with pytest.raises(SiteError, match=r"staStart is too large \(found 1e300; allowed: at most 1e\+12"):
        read(w.document(w.alignment(line, attributes=' staStart="1e300"')))
    with pytest.raises(SiteError, match=r"PVI: station or height is too large \(found 0 1.1e8"):
        read(
            w.document(
                w.alignment(line, rest="<Profile><ProfAlign><PVI>0 1.1e8</PVI><PVI>9 1</PVI></ProfAlign></Profile>")
            )
        )


SQUARE = [
    (i, f"{6783000 + n} {21530000 + e} {z}")
    for i, e, n, z in ((1, 0, 0, 1), (2, 9, 0, 2), (3, 9, 9, 3), (4, 0, 9, 4))
]


@pytest.mark.parametrize(
    "number", ["100000000000000000000", "1e20", "9223372036854775807", "-9223372036854775808", "1_0"]
)
def test_face_ids_beyond_whole_numbers_are_shown_as_they_stand(tools, read, number):
    w = tools.Writer()
    with pytest.raises(SiteError, match=rf"site0\.xml:\d+: F: a face is not valid \(found 1 2 {number};"):
        read(w.document(w.surface(SQUARE, ["<F>1 2 3</F>", f"<F>1 2 {number}</F>"])))


def test_surfaces_of_degenerate_faces_are_left_out(tools, read):
    w = tools.Writer()
    bad = w.surface(SQUARE, ["<F>1 1 2</F>", "<F>3 3 3</F>"]).replace("ground", "flat")
    site = read(w.document(w.surface(SQUARE, ["<F>1 2 3</F>"]), bad))
    assert [s.name for s in site.surfaces] == ["ground"]
    assert any("Surface 'flat': has no face with an area and is left out" in t for t in site.warnings)


@pytest.mark.parametrize("height", ["-9999", "-32768", "2500.5", "-1500", "9999.000"])
def test_heights_out_of_place_are_told_and_kept(tools, read, height):
    w = tools.Writer()
    points = [*SQUARE, (77, f"6783020 21530020 {height}"), (78, "6783020 21530029 -9999")]
    shown = f"{float(height):.9g} meter"
    site = read(w.document(w.surface(points, ["<F>1 2 3</F>", "<F>1 3 4</F>", "<F>3 4 77</F>"])))
    (told,) = site.warnings  # point 78 belongs to no face
    assert f"Surface 'ground': 1 of 5 heights are implausible, the first {shown} (P id 77)" in told
    assert site.surfaces[0].vertices[:, 2].tolist().count(float(height)) >= 1
    poles = "".join(f"<CgPoint name='p{i}'>6783000 2153000{i} {z}</CgPoint>" for i, z in enumerate((2, 3, height, 4)))
    (told,) = read(w.document(f"<CgPoints>{poles}</CgPoints>")).warnings
    assert f"points: 1 of 4 heights are implausible, the first {shown} (p2)" in told


def test_heights_of_lines_out_of_place_are_told(tools, read):
    text = PARTS["PntList3D"].format(*GOOD[:2], "-9999") + PARTS["CgPoint"].format(*GOOD)
    (told,) = read(tools.Writer().document(text)).warnings
    assert "lines: 1 of 2 heights are implausible, the first -9999 meter (f)" in told


def test_heights_of_profiles_out_of_place_are_told(tools, read):
    w = tools.Writer()
    line = w.element(tools.chain(("line", Law.CONSTANT, 100.0, 0, 0))[0])
    rest = "<Profile><ProfAlign><PVI>0 10</PVI><PVI>50 -9999</PVI><PVI>100 11</PVI></ProfAlign></Profile>"
    site = read(w.document(w.alignment(line, rest=rest)))
    assert any("1 of 3 heights are implausible, the first -9999 meter (50.000 m)" in t for t in site.warnings)


def test_heights_of_mountains_and_none_are_nothing_to_tell(tools, read):
    w = tools.Writer()
    heights = ("", "1800", "2700.5", "2300")
    poles = "".join(f"<CgPoint name='p{i}'>6783000 2153000{i} {z}</CgPoint>" for i, z in enumerate(heights))
    assert read(w.document(f"<CgPoints>{poles}</CgPoints>")).warnings == ()
