"""Points, plan features, pipes and cables read from LandXML."""

import math

import numpy as np
import pytest

from workgauge.site.plan import PlanElement
from workgauge.site.transitions import Law
from workgauge.values.errors import SiteError

CODING = '<Feature code="IM_coding"><Property label="{}" value="{}"/></Feature>'


def test_points_inherit_from_their_groups(tools, read):
    w = tools.Writer()
    points = (
        '<CgPoints name="lights" code="">'
        f'<CgPoints name="g1" desc="Lamps" code="336100"><CgPoints name="g2" desc="Light pole" code="D2342">'
        '<CgPoint name="3036" code="D9" desc="bent">6783020 21530666 17.4</CgPoint>'
        '<CgPoint name="3037">6783005 21530713</CgPoint>'
        f"</CgPoints>{CODING.format('infraCoding', '336100')}</CgPoints>"
        '<CgPoint name="copy" pntRef="3036"/></CgPoints>'
    )
    first, second, copy = read(w.document(points)).points
    assert (first.name, first.code, first.desc) == ("3036", "D9", "bent")
    assert first.position == pytest.approx([21530666.0, 6783020.0, 17.4])
    assert first.groups == ("lights", "g1", "336100", "Lamps", "g2", "D2342", "Light pole")
    assert first.properties == {"infraCoding": "336100"}
    assert (second.code, second.desc) == ("D2342", "Light pole")
    assert math.isnan(second.position[2])
    assert copy.position == pytest.approx(first.position)
    assert copy.code is None
    assert first.source.file == "site0.xml" and first.source.line


@pytest.mark.parametrize("text", ["", "1", "1 2 3 4", "nan 2 3", "north east"])
def test_points_without_usable_coordinates_are_refused(tools, read, text):
    w = tools.Writer()
    with pytest.raises(SiteError, match=r"site0\.xml:\d+: CgPoint 'p'"):
        read(w.document(f'<CgPoints><CgPoint name="p">{text}</CgPoint></CgPoints>'))


def plan_feature(name: str, *geometry: str, extra: str = "") -> str:
    inner = f"<CoordGeom>{''.join(geometry)}</CoordGeom>{extra}"
    return f'<PlanFeatures><PlanFeature name="{name}">{inner}</PlanFeature></PlanFeatures>'


def test_plan_features_keep_heights_and_codes(tools, read):
    w = tools.Writer()
    lines = [
        f"<Line>{w.place('Start', 0, 0, 1.0)}{w.place('End', 10, 0, 2.0)}</Line>",
        f"<Line>{w.place('Start', 10, 0, 2.0)}{w.place('End', 10, 10, 3.0)}</Line>",
    ]
    extra = CODING.format("terrainCoding", "451") + '<Feature code="IM_cable"/>'
    (line,) = read(w.document(plan_feature("power", *lines, extra=extra))).lines
    assert (line.kind, line.code, line.name) == ("cable", "451", "power")
    expected = np.array([[0, 0, 1], [10, 0, 2], [10, 10, 3]]) + np.array([*w.origin, 0])
    assert line.points == pytest.approx(expected)


@pytest.mark.parametrize("radius", [5.0, 60.0, 1000.0])
def test_curves_of_plan_features_are_cut_into_short_chords(tools, read, radius):
    w = tools.Writer()
    arc = PlanElement("curve", Law.CONSTANT, (0.0, 0.0), 0.0, radius * 2, 1 / radius, 1 / radius)
    text = w.element(arc)
    text = text.replace("</Start>", " 4.0</Start>").replace("</End>", " 8.0</End>")
    (line,) = read(w.document(plan_feature("kerb", text))).lines
    assert line.kind == "plan_feature"
    centre = np.array([w.origin[0], w.origin[1] + radius])
    assert np.hypot(*(line.points[:, :2] - centre).T) == pytest.approx(radius, abs=1e-5)
    middles = (line.points[1:, :2] + line.points[:-1, :2]) / 2
    assert (radius - np.hypot(*(middles - centre).T)).max() <= 0.005 + 1e-6
    assert line.points[[0, -1], 2] == pytest.approx([4.0, 8.0])
    assert (np.diff(line.points[:, 2]) > 0).all()


def test_plan_features_may_have_gaps_and_corners(tools, read):
    w = tools.Writer()
    geometry = [
        f"<Line>{w.place('Start', 0, 0)}{w.place('End', 10, 0)}</Line>",
        f"<Line>{w.place('Start', 10, 5)}{w.place('End', 20, 5)}</Line>",
        "<IrregularLine><PntList2D>6783005 21530020 6783009 21530020 6783009 21530030</PntList2D></IrregularLine>",
    ]
    site = read(w.document(plan_feature("fence", *geometry)))
    assert [len(line.points) for line in site.lines] == [2, 4]
    assert "has a gap and is read as two lines" in site.warnings[0]


def test_empty_plan_features_are_told(tools, read):
    w = tools.Writer()
    line = f"<Line>{w.place('Start', 0, 0)}{w.place('End', 10, 0)}</Line>"
    point = f"<Line>{w.place('Start', 0, 0)}{w.place('End', 0, 0)}</Line>"
    site = read(w.document(plan_feature("a", line), plan_feature("b"), plan_feature("c", point)))
    assert [line.name for line in site.lines] == ["a"]
    text = " ".join(site.warnings)
    assert "'b': has no geometry" in text and "'c': has fewer than two different points" in text


def network(w, pipe: str, kind: str = "sanitary") -> str:
    return (
        f'<PipeNetworks><PipeNetwork name="n" pipeNetType="{kind}"><Structs>'
        f'<Struct name="s1">{w.place("Center", 0, 0, 9.0)}<Invert elev="5.0" refPipe="p"/></Struct>'
        f'<Struct name="s2">{w.place("Center", 30, 40, 8.0)}<Invert elev="4.0" refPipe="p"/></Struct>'
        f"</Structs><Pipes>{pipe}</Pipes></PipeNetwork></PipeNetworks>"
    )


def test_pipes_run_half_their_diameter_above_their_inverts(tools, read):
    w = tools.Writer(units='<Units><Metric linearUnit="meter" diameterUnit="millimeter"/></Units>')
    pipe = '<Pipe name="p" refStart="s1" refEnd="s2"><CircPipe diameter="400"/></Pipe>'
    (line,) = read(w.document(network(w, pipe))).lines
    assert (line.kind, line.diameter_m) == ("pipe", pytest.approx(0.4))
    assert line.points == pytest.approx(np.array([[0, 0, 5.2], [30, 40, 4.2]]) + np.array([*w.origin, 0]))
    (cable,) = read(w.document(network(w, pipe, "IM_cable"))).lines
    assert cable.kind == "cable"


def test_pipes_that_hang_in_the_air_are_told_and_bad_ones_refused(tools, read):
    w = tools.Writer()
    good = '<Pipe name="q" refStart="s1" refEnd="s2"/>'
    site = read(w.document(network(w, good + '<Pipe name="p" refStart="s1" refEnd="s9"/>')))
    assert [line.name for line in site.lines] == ["q"]
    assert site.lines[0].points[:, 2] == pytest.approx([9.0, 8.0])  # no invert of its own: the structures' heights
    assert "Pipe 'p': has no refEnd" in site.warnings[0]
    with pytest.raises(SiteError, match="diameter must be positive"):
        read(w.document(network(w, '<Pipe name="p" refStart="s1" refEnd="s2"><CircPipe diameter="-1"/></Pipe>')))


LOCATION = (
    '<PlanFeatures name="Signs"><PlanFeature name="F1" code="3110" desc="Footing">'
    "<Location>6783010 21530020{}</Location>"
    + CODING.format("infraCoding", "331100")
    + "</PlanFeature></PlanFeatures>"
)


@pytest.mark.parametrize("frame", ["{}", "<Roadways><Roadway name='R1'>{}</Roadway></Roadways>"])
@pytest.mark.parametrize("height", ["", " 4.5"])
def test_plan_features_with_a_location_are_points(tools, read, frame, height):
    site = read(tools.Writer().document(frame.format(LOCATION.format(height))))
    (point,) = site.points
    assert (point.name, point.code, point.desc) == ("F1", "3110", "Footing")
    assert point.properties == {"infraCoding": "331100"}
    assert point.groups[-1] == "Signs"
    assert point.position == pytest.approx([21530020.0, 6783010.0, 4.5 if height else math.nan], nan_ok=True)
    assert point.source.feature == "F1" and point.source.line
    assert site.lines == () and site.warnings == ()


def test_a_plan_feature_may_have_a_line_and_several_locations(tools, read):
    w = tools.Writer()
    line = f"<Line>{w.place('Start', 0, 0)}{w.place('End', 10, 0)}</Line>"
    spots = '<Location name="a">6783010 21530020 1</Location><Location>6783011 21530021 1</Location>'
    site = read(w.document(plan_feature("gantry", line, extra=spots)))
    assert [p.name for p in site.points] == ["a", "gantry"]
    assert [line.name for line in site.lines] == ["gantry"]


def test_codes_of_located_features_come_from_their_features_where_they_have_none(tools, read):
    text = LOCATION.format(" 4.5").replace(' code="3110"', "")
    assert read(tools.Writer().document(text)).points[0].code == "331100"


def test_irregular_lines_by_their_ends_their_list_or_both(tools, read):
    w = tools.Writer()
    start, end = w.place("Start", 0, 0, 1.0), w.place("End", 30, 0, 4.0)
    middle = "<PntList3D>6783005 21530010 2 6783005 21530020 3</PntList3D>"
    whole = "<PntList3D>6783000 21530000 1 6783005 21530010 2 6783005 21530020 3 6783000 21530030 4</PntList3D>"
    for inner, heights in (
        (start + end, [1, 4]),
        (start + middle + end, [1, 2, 3, 4]),
        (start + whole + end, [1, 2, 3, 4]),
        (middle, [2, 3]),
        (start + "<PntList3D/>" + end, [1, 4]),
    ):
        site = read(w.document(plan_feature("kerb", f"<IrregularLine>{inner}</IrregularLine>")))
        assert site.lines[0].points[:, 2] == pytest.approx(heights), inner
        assert site.warnings == ()


def test_irregular_lines_without_points_are_told(tools, read):
    w = tools.Writer()
    line = f"<Line>{w.place('Start', 0, 0)}{w.place('End', 10, 0)}</Line>"
    site = read(
        w.document(plan_feature("kerb", line, "<IrregularLine/>", "<IrregularLine><PntList2D/></IrregularLine>"))
    )
    assert len(site.lines) == 1
    assert sum("'kerb': IrregularLine: has no points and is left out" in t for t in site.warnings) == 2


def test_chains_are_lists_of_points_by_name(tools, read):
    w = tools.Writer()
    points = "".join(f'<CgPoint name="{n}">678300{n} 21530000 {n}</CgPoint>' for n in (1, 2, 3))
    chain = plan_feature("fence", "<Chain>1 3 2</Chain>")
    site = read(w.document(f"<CgPoints>{points}</CgPoints>", chain))
    assert site.lines[0].points[:, 2] == pytest.approx([1, 3, 2])
    with pytest.raises(SiteError, match=r"Chain: refers to a point that is not in the file \(found 4"):
        read(w.document(f"<CgPoints>{points}</CgPoints>", chain.replace("1 3", "1 4")))


def test_structures_of_pipe_networks_are_points(tools, read):
    w = tools.Writer()
    pipe = '<Pipe name="p" refStart="s1" refEnd="s2"><CircPipe diameter="0.4"/></Pipe>'
    text = network(w, pipe).replace('name="s1"', 'name="s1" desc="Manhole" code="W" elevRim="7"')
    text = text.replace("</Center>", "</Center><CircStruct diameter='0.8'/>", 1)
    text = text.replace(w.place("Center", 30, 40, 8.0), w.place("Center", 30, 40)).replace(
        'name="s2"', 'name="s2" elevRim="11.5"'
    )
    text = text.replace("</Structs>", '<Struct name="s3"/></Structs>')
    site = read(w.document(text))
    first, second = site.points
    assert (first.name, first.code, first.desc, first.groups) == ("s1", "W", "Manhole", ("n", "sanitary"))
    assert first.properties == {"diameter_m": "0.8"}
    assert [p.position[2] for p in site.points] == [9.0, 11.5]
    assert second.position[:2] == pytest.approx([w.origin[0] + 30, w.origin[1] + 40])
    assert ["Struct 's3': has no Center and is left out" in t for t in site.warnings] == [True]


@pytest.mark.parametrize(
    ("unit", "diameter", "outcome"),
    [
        ("meter", "300", "a diameter of 300 meter is a unit error.*allowed: 0.001 to 20 meter"),
        ("millimeter", "0.3", "a diameter of 0.3 millimeter is a unit error.*allowed: 1 to 2e.04 millimeter"),
        ("meter", "20.5", "unit error"),
        ("meter", "6", "warning"),
        ("meter", "5", "fine"),
        ("millimeter", "300", "fine"),
    ],
)
def test_diameters_in_another_unit_are_refused(tools, read, unit, diameter, outcome):
    w = tools.Writer(units=f'<Units><Metric linearUnit="meter" diameterUnit="{unit}"/></Units>')
    pipe = f'<Pipe name="p" refStart="s1" refEnd="s2"><CircPipe diameter="{diameter}"/></Pipe>'
    if outcome in ("fine", "warning"):
        told = [t for t in read(w.document(network(w, pipe))).warnings if "has a diameter of 6 m" in t]
        assert len(told) == (outcome == "warning")
        return
    with pytest.raises(SiteError, match=rf"site0\.xml:\d+: Pipe 'p': .*{outcome}"):
        read(w.document(network(w, pipe)))


def test_references_are_followed_from_point_to_point(tools, read):
    w = tools.Writer()
    points = (
        '<CgPoint name="a">6783000 21530000 5</CgPoint><CgPoint name="b" pntRef="a"/><CgPoint name="c" pntRef="b"/>'
    )
    line = f'<Line><Start pntRef="c"/>{w.place("End", 30.0, 40.0)}</Line>'
    site = read(w.document(f"<CgPoints>{points}</CgPoints>", w.alignment(line)))
    assert [p.position[2] for p in site.points] == [5, 5, 5]
    assert site.alignments[0].length == pytest.approx(50.0)
    circle = points.replace('name="a">6783000 21530000 5<', 'name="a" pntRef="c"><')
    with pytest.raises(SiteError, match=r"site0\.xml:\d+: CgPoint 'a': points refer to each other in a circle"):
        read(w.document(f"<CgPoints>{circle}</CgPoints>"))


def test_references_to_one_of_several_points_of_a_name_are_told(tools, read):
    w = tools.Writer()
    points = '<CgPoint name="a">6783000 21530000</CgPoint><CgPoint name="a">6783500 21530000</CgPoint>'
    line = f'<Line><Start pntRef="a"/>{w.place("End", 30.0, 40.0)}</Line>'
    site = read(w.document(f"<CgPoints>{points}</CgPoints>", w.alignment(line)))
    assert site.alignments[0].length == pytest.approx(50.0)
    assert any("Start: refers to 'a', as 2 points are called; the first counts" in t for t in site.warnings)
