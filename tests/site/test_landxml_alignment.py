"""Alignments read from LandXML: what was written comes back; misclosures, gaps, kinks and nonsense are judged."""

import math
import re

import numpy as np
import pytest

from workgauge.site.plan import PlanElement
from workgauge.site.transitions import Law
from workgauge.values.errors import SiteError

LAWS = [law for law in Law if law is not Law.CONSTANT]
#: Coordinates are written with seven decimals.
ROUNDING = 1e-6


def same_place(a, b, d, tolerance=ROUNDING):
    x, y = a.at(d), b.at(d)
    return np.hypot(x.e - y.e, x.n - y.n).max() < tolerance


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("pi", [True, False], ids=["with PI", "without PI"])
def test_reading_what_was_written_gives_it_back(tools, read, law, pi):
    w = tools.Writer()
    elements = tools.track(law)
    site = read(w.document(w.alignment(*(w.element(e, pi=pi) for e in elements), attributes=' length="1180"')))
    assert site.warnings == ()
    track, made = site.alignment("Track 1"), tools.build(elements)
    assert track.length == pytest.approx(1180.0, abs=1e-5)
    assert track.declared_length == 1180.0
    assert track.element_counts == {"line": 2, "curve": 3, "spiral": 5}
    d = np.linspace(0, 1180 - 1e-5, 500)
    assert same_place(track, made, d, 2e-6)
    assert track.at(d).curvature == pytest.approx(made.at(d).curvature, abs=1e-7)
    assert track.at(d).heading == pytest.approx(made.at(d).heading, abs=2e-6)


def test_a_spiral_alone_without_tangent_point_is_laid_by_its_chord(tools, read):
    w = tools.Writer()
    item = tools.chain(("spiral", Law.BLOSS, 80.0, 0.0, -1 / 300))[0]
    site = read(w.document(w.alignment(w.element(item, pi=False))))
    assert "heading is taken from its chord" in site.warnings[0]
    assert same_place(site.alignments[0], tools.build([item]), np.linspace(0, 80, 50))


def test_an_arc_of_more_than_half_a_circle(tools, read):
    w = tools.Writer()
    for turn in (1, -1):
        item = PlanElement("curve", Law.CONSTANT, (0.0, 0.0), 1.0, 450.0, turn / 100, turn / 100)
        text = w.element(item)
        bare = re.sub("<Center>.*</Center>", "", text)
        for variant in (text, bare):
            site = read(w.document(w.alignment(variant)))
            assert same_place(site.alignments[0], tools.build([item]), np.linspace(0, 450 - 1e-5, 100), 1e-5)


def test_a_short_arc_without_centre_and_a_full_circle(tools, read):
    w = tools.Writer()
    for turn in (1, -1):
        item = PlanElement("curve", Law.CONSTANT, (0.0, 0.0), 1.0, 80.0, turn / 100, turn / 100)
        bare = re.sub("<Center>.*</Center>", "", w.element(item))
        assert same_place(
            read(w.document(w.alignment(bare))).alignments[0], tools.build([item]), np.arange(80.0), 1e-5
        )
        item = PlanElement("curve", Law.CONSTANT, (0.0, 0.0), 1.0, 200 * math.pi, turn / 100, turn / 100)
        circle = re.sub("<End>[^<]*", w.place("End", 0.0, 0.0)[:-6], w.element(item))
        track = read(w.document(w.alignment(circle))).alignments[0]
        assert track.length == pytest.approx(200 * math.pi, abs=1e-4)
        assert same_place(track, tools.build([item]), np.arange(0.0, 628.0, 4.0), 1e-4)
        with pytest.raises(SiteError, match="closed curve needs a Center"):
            read(w.document(w.alignment(re.sub("<Center>.*</Center>", "", circle))))
        with pytest.raises(SiteError, match="ends coincide"):
            read(w.document(w.alignment(re.sub('length="[^"]*"', 'length="5"', circle))))


def test_a_spiral_that_turns_by_more_than_half_a_circle(tools, read):
    w = tools.Writer()
    item = tools.chain(("spiral", Law.CLOTHOID, 160.0, 0.0, 1 / 22))[0]
    assert item.end_yaw() - item.yaw > math.pi
    site = read(w.document(w.alignment(w.element(item))))
    assert same_place(site.alignments[0], tools.build([item]), np.arange(160.0), 1e-5)


def test_a_spiral_is_held_by_the_tangent_that_closes_it(tools, read):
    """As real files have it: a parabola laid out from its straight end, 0.3 mrad off at its curved end."""
    w = tools.Writer()
    item = tools.chain(("spiral", Law.BIQUADRATIC, 240.0, 1 / 1200, 0.0))[0]
    wrong = item.yaw + 0.0003
    tangents = np.array([[math.cos(wrong), -math.cos(item.end_yaw())], [math.sin(wrong), -math.sin(item.end_yaw())]])
    meet = np.linalg.solve(tangents, np.array(item.end()) - item.start)[0]
    pi = w.place("PI", item.start[0] + meet * math.cos(wrong), item.start[1] + meet * math.sin(wrong))
    site = read(w.document(w.alignment(re.sub("<PI>.*</PI>", pi, w.element(item)))))
    assert site.warnings == ()
    assert same_place(site.alignments[0], tools.build([item]), np.arange(240.0), 2e-6)


def test_equal_radii_make_an_arc_and_radii_may_be_infinite_in_any_spelling(tools, read):
    w = tools.Writer()
    arc = tools.chain(("spiral", Law.CLOTHOID, 60.0, 1 / 400, 1 / 400))[0]
    text = w.element(arc, pi=False).replace("<Spiral", '<Spiral constant="0"')
    site = read(w.document(w.alignment(text)))
    assert site.alignments[0].element_counts["spiral"] == 1
    assert site.alignments[0].at(30.0).curvature == pytest.approx(1 / 400)
    item = tools.chain(("spiral", Law.CLOTHOID, 60.0, 0.0, 1 / 400))[0]
    for spelling in ("INF", "NaN", "inf", "Infinity", "", "1e30"):
        text = w.element(item).replace('"INF"', f'"{spelling}"')
        assert same_place(read(w.document(w.alignment(text))).alignments[0], tools.build([item]), np.arange(61.0))


@pytest.mark.parametrize("miss_mm", [0.5, 5.0, 19.0, 25.0])
def test_misclosures_are_spread_and_told_or_refused(tools, read, miss_mm):
    w = tools.Writer()
    elements = tools.track()[:3]
    last = elements[2]
    end = np.array(last.end())
    along = np.array([math.cos(last.end_yaw()), math.sin(last.end_yaw())])
    shift = along * miss_mm / 1000
    # The arc's stated end stays on its circle, so let a spiral after it miss its end instead.
    spiral = PlanElement("spiral", Law.CLOTHOID, tuple(end), last.end_yaw(), 60.0, last.k1, 0.0)
    texts = [w.element(e) for e in elements] + [w.element(spiral, shift=tuple(shift))]
    document = w.document(w.alignment(*texts))
    if miss_mm > 20:
        with pytest.raises(SiteError, match=r"does not end where it says.*25\.0 mm off"):
            read(document)
        return
    site = read(document)
    assert any("misses its stated end" in t for t in site.warnings) is (miss_mm > 1)
    state = site.alignments[0].at(site.alignments[0].length)
    stated = np.array(spiral.end()) + shift + w.origin
    assert np.hypot(state.e - stated[0], state.n - stated[1])[0] < 1e-6
    half = site.alignments[0].at(site.alignments[0].length - 30.0)
    whole = tools.build([*elements, spiral]).at(480.0 + 80.0 - 30.0)
    assert np.hypot(half.e - whole.e, half.n - whole.n)[0] == pytest.approx(miss_mm / 2000, abs=1e-5)


@pytest.mark.parametrize("gap_mm", [0.3, 8.0, 15.0])
def test_gaps_are_closed_and_told_or_refused(tools, read, gap_mm):
    w = tools.Writer()
    first, second = tools.chain(("line", Law.CONSTANT, 100.0, 0, 0), ("line", Law.CONSTANT, 80.0, 0, 0))
    aside = (second.start[0] - gap_mm / 1000 * math.sin(0.4), second.start[1] + gap_mm / 1000 * math.cos(0.4))
    moved = PlanElement("line", Law.CONSTANT, aside, second.yaw, 80.0, 0.0, 0.0)
    document = w.document(w.alignment(w.element(first), w.element(moved)))
    if gap_mm > 10:
        with pytest.raises(SiteError, match=r":\d+: Alignment 'Track 1'.*gap.*15\.0 mm"):
            read(document)
        return
    site = read(document)
    assert any("from the end before it" in t for t in site.warnings) is (gap_mm > 1)
    before, after = (site.alignments[0].at(100 + s * 1e-8) for s in (-1, 1))
    assert np.hypot(before.e - after.e, before.n - after.n)[0] < 1e-6


@pytest.mark.parametrize("kink_deg", [0.02, 0.3, 1.0, -5.0])
def test_kinks_are_told_or_refused(tools, read, kink_deg):
    w = tools.Writer()
    first = tools.chain(("line", Law.CONSTANT, 100.0, 0, 0))[0]
    second = PlanElement("line", Law.CONSTANT, first.end(), first.yaw + math.radians(kink_deg), 80.0, 0.0, 0.0)
    document = w.document(w.alignment(w.element(first), w.element(second)))
    if abs(kink_deg) > 0.57:
        with pytest.raises(SiteError, match=rf"kink.*{kink_deg:.3f} degrees"):
            read(document)
        return
    assert any("kink" in t for t in read(document).warnings) is (kink_deg > 0.06)


def test_declared_lengths_that_are_wrong_are_told_and_do_not_count(tools, read):
    w = tools.Writer()
    line = tools.chain(("line", Law.CONSTANT, 100.0, 0, 0))[0]
    text = w.element(line).replace('length="100.000000"', 'length="99"')
    site = read(w.document(w.alignment(text, attributes=' length="250"')))
    assert site.alignments[0].length == pytest.approx(100.0)
    assert site.alignments[0].declared_length == 250.0
    assert any("length 99.0000 m stated, 100.0000 m by its coordinates" in t for t in site.warnings)
    assert any("length 250.000 m declared, 100.000 m by its elements" in t for t in site.warnings)


def test_a_wrong_clothoid_constant_is_told(tools, read):
    w = tools.Writer()
    item = tools.chain(("spiral", Law.CLOTHOID, 90.0, 0.0, 1 / 400))[0]
    good, bad = (w.element(item).replace("<Spiral", f'<Spiral constant="{a}"') for a in (189.737, 250))
    assert read(w.document(w.alignment(good))).warnings == ()
    assert "constant 250 contradicts" in read(w.document(w.alignment(bad))).warnings[0]


def test_elements_without_length_are_left_out(tools, read):
    w = tools.Writer()
    line = tools.chain(("line", Law.CONSTANT, 100.0, 0, 0))[0]
    nothing = f'<Line length="0">{w.place("Start", *line.end())}{w.place("End", *line.end())}</Line>'
    site = read(w.document(w.alignment(w.element(line), nothing)))
    assert site.alignments[0].element_counts["line"] == 1
    assert "has no length" in site.warnings[0]


def test_feet(tools, read):
    w = tools.Writer(origin=(1_320_000.0, 628_000.0), crs="")
    for name, foot in (("foot", 0.3048), ("USSurveyFoot", 1200 / 3937)):
        w.units = f'<Units><Imperial linearUnit="{name}"/></Units>'
        arc = tools.chain(("curve", Law.CONSTANT, 500.0, 1 / 2600, 1 / 2600))[0]
        rest = "<Profile><ProfAlign><PVI>1000 50</PVI><PVI>1500 60</PVI></ProfAlign></Profile>"
        site = read(w.document(w.alignment(w.element(arc), attributes=' staStart="1000"', rest=rest)))
        track = site.alignments[0]
        assert site.units["linear"] == name
        assert track.length == pytest.approx(500 * foot, abs=1e-6)
        assert track.station_start == pytest.approx(1000 * foot)
        state = track.at(track.length / 2)
        assert state.curvature[0] == pytest.approx(1 / (2600 * foot), rel=1e-6)
        assert state.z[0] == pytest.approx(55 * foot, abs=1e-6)
        start = track.at(0.0)
        assert start.e[0] == pytest.approx((1_320_000 + arc.start[0]) * foot, abs=1e-6)
        assert start.n[0] == pytest.approx((628_000 + arc.start[1]) * foot, abs=1e-6)


@pytest.mark.parametrize(
    ("unit", "metres"), [("millimeter", 0.001), ("kilometer", 1000.0), ("centimetre", 0.01), ("Metre", 1.0)]
)
def test_metric_units(tools, read, unit, metres):
    w = tools.Writer(origin=(0.0, 0.0), crs="", units=f'<Units><Metric linearUnit="{unit}"/></Units>')
    line = PlanElement("line", Law.CONSTANT, (0.0, 0.0), 0.4, 7.0, 0.0, 0.0)
    assert read(w.document(w.alignment(w.element(line)))).alignments[0].length == pytest.approx(7 * metres)


def test_places_by_reference(tools, read):
    w = tools.Writer()
    point = w.place("CgPoint", 0.0, 0.0).replace("<CgPoint", '<CgPoint name="A"')
    points = f"<CgPoints>{point}</CgPoints>"
    line = f'<Line><Start pntRef="A"/>{w.place("End", 30.0, 40.0)}</Line>'
    site = read(w.document(points, w.alignment(line)))
    assert site.alignments[0].length == pytest.approx(50.0)
    with pytest.raises(SiteError, match=r"not in the file.*found B"):
        read(w.document(points, w.alignment(line.replace('"A"', '"B"'))))


BAD_ELEMENTS = {
    "no end": (lambda t: re.sub("<End>.*</End>", "", t), "has no End"),
    "NaN": (lambda t: re.sub("<End>[^<]*", "<End>nan 1", t), "finite"),
    "text": (lambda t: re.sub("<End>[^<]*", "<End>here there", t), "finite"),
    "one number": (lambda t: re.sub("<End>[^<]*", "<End>5", t), "expected 2 or 3 numbers"),
    "infinite": (lambda t: re.sub("<Start>[^<]*", "<Start>1e999 0", t), "finite"),
    "beyond any map": (lambda t: re.sub("<Start>[^<]*", "<Start>1e11 0", t), "beyond any map"),
    "no rotation": (lambda t: t.replace("rot=", "was="), "rot must say"),
    "length in words": (lambda t: re.sub('length="[^"]*"', 'length="long"', t), "length must be a finite number"),
}


@pytest.mark.parametrize("case", BAD_ELEMENTS)
def test_elements_that_say_nonsense_are_refused_with_file_and_line(tools, read, case):
    change, message = BAD_ELEMENTS[case]
    w = tools.Writer()
    item = tools.chain(("curve", Law.CONSTANT, 100.0, 1 / 300, 1 / 300))[0]
    with pytest.raises(SiteError, match=rf"(?s)site0\.xml:\d+: .*{message}") as caught:
        read(w.document(w.alignment(change(w.element(item)))))
    assert str(caught.value).count("\n") == 0


BAD_ARCS = {
    "centre": (lambda t: re.sub("<Center>[^<]*", "<Center>6783000 21530000", t), "not equally far"),
    "no centre": (
        lambda t: re.sub("<Center>.*</Center>", "", t).replace("radius=", "was="),
        "needs a Center, a radius or a PI",
    ),
    "radius": (lambda t: re.sub("<Center>.*</Center>", "", t).replace("300.0", "40.0"), "radius too small"),
}


@pytest.mark.parametrize("case", BAD_ARCS)
def test_arcs_that_contradict_themselves_are_refused(tools, read, case):
    change, message = BAD_ARCS[case]
    w = tools.Writer()
    item = tools.chain(("curve", Law.CONSTANT, 100.0, 1 / 300, 1 / 300))[0]
    with pytest.raises(SiteError, match=message):
        read(w.document(w.alignment(change(w.element(item)))))


BAD_SPIRALS = {
    "type": (lambda t: t.replace("clothoid", "wienerBogen"), "unknown spiral type.*wienerBogen.*bloss"),
    "no type": (lambda t: t.replace("spiType", "type"), "unknown spiral type.*none"),
    "no length": (lambda t: t.replace("length=", "was="), "positive length"),
    "negative length": (lambda t: t.replace('length="', 'length="-'), "positive length"),
    "radius in words": (lambda t: t.replace("INF", "straight"), "radiusStart is no number"),
    "tiny radius": (lambda t: t.replace("400.0", "0.000001"), "radiusEnd is too small"),
    "wrong way": (lambda t: t.replace("ccw", "cw"), "does not end where it says"),
}


@pytest.mark.parametrize("case", BAD_SPIRALS)
def test_spirals_that_contradict_themselves_are_refused(tools, read, case):
    change, message = BAD_SPIRALS[case]
    w = tools.Writer()
    item = tools.chain(("spiral", Law.CLOTHOID, 90.0, 0.0, 1 / 400))[0]
    with pytest.raises(SiteError, match=message):
        read(w.document(w.alignment(change(w.element(item)))))


def test_polylines_are_lines_not_alignments(tools, read):
    w = tools.Writer()
    numbers = "6783000 21530000 1.5 6783010 21530000 2.5 6783010 21530020 3.5"
    site = read(w.document(w.alignment(f"<IrregularLine><PntList3D>{numbers}</PntList3D></IrregularLine>")))
    assert site.alignments == ()
    (line,) = site.lines
    assert (line.kind, line.name) == ("string_line", "Track 1")
    assert line.points == pytest.approx(
        np.array([[21530000, 6783000, 1.5], [21530000, 6783010, 2.5], [21530020, 6783010, 3.5]])
    )
    assert "is a polyline" in site.warnings[0]


def test_names_are_found_and_the_known_ones_told(tools, read):
    w = tools.Writer()
    line = w.element(tools.chain(("line", Law.CONSTANT, 100.0, 0, 0))[0])
    site = read(
        w.document(w.alignment(line, name="  A1 "), w.alignment(line, name="A1"), w.alignment(line, name="B"))
    )
    assert site.alignment("B ").name == "B"
    with pytest.raises(SiteError, match=r"no such alignment.*found C; allowed: 'A1', 'A1 \(2\)', 'B'"):
        site.alignment("C")
    assert site.alignment("A1") is site.alignments[0]
    assert site.alignment("A1 (2)") is site.alignments[1]
    assert any("several alignments are called 'A1'; this one becomes 'A1 (2)'" in t for t in site.warnings)


@pytest.mark.parametrize("turn", [1, -1])
@pytest.mark.parametrize("angle", [0.2, 2.5, 4.5])
def test_an_arc_by_its_ends_and_tangent_point_alone(tools, read, turn, angle):
    w = tools.Writer()
    item = PlanElement("curve", Law.CONSTANT, (0.0, 0.0), 1.0, 100 * angle, turn / 100, turn / 100)
    reach = 100 * math.tan(angle / 2)
    pi = w.place("PI", reach * math.cos(1.0), reach * math.sin(1.0))
    text = re.sub("<Center>.*</Center>", pi, w.element(item)).replace("radius=", "was=")
    site = read(w.document(w.alignment(text)))
    assert site.warnings == ()
    assert same_place(site.alignments[0], tools.build([item]), np.linspace(0, 100 * angle - 1e-5, 100), 1e-5)
    assert site.alignments[0].at(1.0).curvature[0] == pytest.approx(turn / 100)


BAD_TANGENTS = {
    "uneven": (
        lambda w, t: re.sub("<PI>[^<]*", w.place("PI", 9.0, 3.0)[:-5], t),
        "start and end are not equally far from the PI",
    ),
    "wrong way": (lambda w, t: t.replace("ccw", "cw"), "rot contradicts the PI"),
    "straight": (
        lambda w, t: re.sub(
            "<PI>[^<]*", w.place("PI", 25.0, 0.0)[:-5], re.sub("<End>[^<]*", w.place("End", 50.0, 0.0)[:-6], t)
        ),
        "its PI lies on its chord",
    ),
}


@pytest.mark.parametrize("case", BAD_TANGENTS)
def test_tangent_points_that_make_no_arc_are_refused(tools, read, case):
    change, message = BAD_TANGENTS[case]
    w = tools.Writer()
    item = PlanElement("curve", Law.CONSTANT, (0.0, 0.0), 0.0, 50.0, 0.01, 0.01)
    pi = w.place("PI", 100 * math.tan(0.25), 0.0)
    text = re.sub("<Center>.*</Center>", pi, w.element(item)).replace("radius=", "was=")
    with pytest.raises(SiteError, match=rf"site0\.xml:\d+: Alignment 'Track 1': Curve: {message}"):
        read(w.document(w.alignment(change(w, text))))


def test_elements_out_of_order_are_refused_as_a_gap(tools, read):
    w = tools.Writer()
    texts = [w.element(e) for e in tools.track()]
    with pytest.raises(SiteError, match="gap before this element"):
        read(w.document(w.alignment(texts[1], texts[0], *texts[2:])))


def test_alignments_without_a_first_station_begin_at_0(tools, read):
    w = tools.Writer()
    line = w.element(tools.chain(("line", Law.CONSTANT, 100.0, 0, 0))[0])
    site = read(w.document(w.alignment(line).replace(' staStart="0"', "")))
    assert site.alignments[0].station_start == 0.0
    assert any("has no staStart; stations begin at 0" in t for t in site.warnings)


def test_lines_whose_ends_are_references(tools, read):
    w = tools.Writer()
    points = '<CgPoint name="1">6783000 21530000</CgPoint><CgPoint name=" 2 ">6783040 21530030</CgPoint>'
    line = '<Line><Start pntRef="1"/><End pntRef="2"/></Line>'
    assert read(w.document(f"<CgPoints>{points}</CgPoints>", w.alignment(line))).alignments[
        0
    ].length == pytest.approx(50)
