"""Profiles, cant and station equations read from LandXML."""

import numpy as np
import pytest

from workgauge.site.transitions import Law
from workgauge.values.errors import SiteError


@pytest.fixture
def straight(tools, read):
    """Return a function that reads a straight 1000 m track with the given inner XML."""

    def make(rest: str, attributes: str = "", units: str | None = None):
        w = tools.Writer()
        if units:
            w.units = units
        line = w.element(tools.chain(("line", Law.CONSTANT, 1000.0, 0, 0))[0])
        return read(w.document(w.alignment(line, rest=rest, attributes=attributes)))

    return make


def profile(*points: str) -> str:
    return f"<Profile><ProfAlign name='p'>{''.join(points)}</ProfAlign></Profile>"


def test_profile_stations_count_from_the_alignments_start(straight):
    rest = profile("<PVI>-153.1 5</PVI>", "<ParaCurve length='100'>346.9 5</ParaCurve>", "<PVI>846.9 10</PVI>")
    site = straight(rest, ' staStart="-153.1"')
    assert site.warnings == ()
    track = site.alignments[0]
    assert track.at([0.0, 450.0, 500.0, 550.0, 1000.0]).z == pytest.approx([5.0, 5.0, 5.125, 5.5, 10.0])
    assert track.station(500.0)[0] == pytest.approx(346.9)
    assert track.distance_of_station(346.9) == pytest.approx(500.0)


@pytest.mark.parametrize("sign", ["", "-"])
def test_the_grades_say_whether_an_arc_is_a_crest(straight, sign):
    rest = profile(
        "<PVI>0 0</PVI>", f"<CircCurve radius='{sign}5000' length='100'>500 5</CircCurve>", "<PVI>1000 0</PVI>"
    )
    track = straight(rest).alignments[0]
    sagitta = 50**2 / (2 * 5000)
    assert track.at(500.0).z[0] == pytest.approx(5 - sagitta, abs=1e-4)


def test_unsymmetrical_parabola(straight):
    rest = profile(
        "<PVI>0 0</PVI>",
        "<UnsymParaCurve lengthIn='100' lengthOut='300'>500 0</UnsymParaCurve>",
        "<PVI>1000 10</PVI>",
    )
    assert straight(rest).alignments[0].at([400.0, 500.0, 800.0]).z == pytest.approx([0.0, 0.02 * 300 / 8, 6.0])


def test_an_arc_whose_length_contradicts_its_radius_is_told(straight):
    rest = profile("<PVI>0 0</PVI>", "<CircCurve radius='5000' length='60'>500 5</CircCurve>", "<PVI>1000 0</PVI>")
    site = straight(rest)
    assert "60.000 m stated, 99.997 m by radius and grades; the radius counts" in site.warnings[0]
    rest = profile("<PVI>0 0</PVI>", "<CircCurve radius='90000' length='60'>500 5</CircCurve>", "<PVI>1000 0</PVI>")
    site = straight(rest)
    assert "the length counts" in site.warnings[0]
    assert site.alignments[0].at([469.9, 470.1]).z == pytest.approx([4.699, 4.701], abs=1e-4)


def test_a_profile_that_is_too_short_gives_no_height_elsewhere_and_says_so(straight):
    site = straight(profile("<PVI>100 1</PVI>", "<PVI>900 2</PVI>"))
    assert "covers 100.000 to 900.000 m" in site.warnings[0]
    assert np.isnan(site.alignments[0].at([50.0, 950.0]).z).all()


def test_several_profiles_and_repeated_points_are_told(straight):
    one = profile("<PVI>0 1</PVI>", "<PVI>0 1</PVI>", "<PVI>1000 2</PVI>")
    site = straight(one + profile("<PVI>0 9</PVI>", "<PVI>1000 9</PVI>") + profile("<PVI>0 1</PVI>"))
    assert site.alignments[0].at(0.0).z[0] == 1.0
    text = " ".join(site.warnings)
    assert "has 2 profiles" in text and "fewer than two points" in text and "repeats the point" in text


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (["<PVI>0 0</PVI>", "<PVI>0 1</PVI>"], "must increase"),
        (["<PVI>0 0</PVI>", "<PVI>nan 1</PVI>"], "finite"),
        (["<PVI>0 0</PVI>", "<PVI>5</PVI>"], "expected 2 numbers"),
        (
            [
                "<PVI>0 0</PVI>",
                "<ParaCurve length='400'>300 0</ParaCurve>",
                "<ParaCurve length='400'>500 5</ParaCurve>",
                "<PVI>1000 0</PVI>",
            ],
            "before the one before it ends",
        ),
        (["<PVI>0 0</PVI>", "<ParaCurve length='-4'>300 0</ParaCurve>", "<PVI>1000 0</PVI>"], "not be negative"),
    ],
)
def test_profiles_that_make_no_sense_are_refused(straight, points, message):
    with pytest.raises(SiteError, match=rf"site0\.xml:\d+: .*{message}"):
        straight(profile(*points))


def cant(
    *stations: tuple[float, float | str, str], gauge: str = "1.435", extra: str = "", rotation: str = "insideRail"
) -> str:
    rows = "".join(f'<CantStation station="{s}" appliedCant="{c}" curvature="{t}"{extra}/>' for s, c, t in stations)
    where = f' rotationPoint="{rotation}"' if rotation else ""
    return f'<Cant name="c" gauge="{gauge}"{where}>{rows}</Cant>'


RAMP = ((0.0, "cw"), (1.0, "cw"), (1.0, "cw"), (0.0, "ccw"))


def ramp(size: float, **keys: str) -> str:
    return cant(*((i * 100.0, size * share, turn) for i, (share, turn) in enumerate(RAMP)), **keys)


@pytest.mark.parametrize(
    ("size", "gauge", "unit"),
    [
        (0.06, "1.435", "meter"),
        (60, "1.435", "millimeter"),
        (150, "1435", "millimeter"),
        (0.15, "1.524", "meter"),
        (0.1, "1.5", "meter"),
    ],
)
def test_metres_and_millimetres_are_told_apart_and_stated(straight, size, gauge, unit):
    site = straight(ramp(size, gauge=gauge))
    track = site.alignments[0]
    metres = size * (0.001 if unit == "millimeter" else 1)
    assert site.units["cant"] == unit
    assert any(f"cant is read in {unit}" in t for t in site.warnings)
    assert track.at([50.0, 150.0, 250.0, 900.0]).cant == pytest.approx([-metres / 2, -metres, -metres / 2, 0.0])
    assert track.cant_gauge_m == pytest.approx(float(gauge) / (1000 if float(gauge) > 100 else 1))
    assert track.cant_rotation_point == "insideRail"
    assert track.cant_stations == 4
    assert any("between rail centres" in t for t in site.warnings) is (gauge == "1.5")


@pytest.mark.parametrize(
    ("rest", "message"),
    [
        (ramp(5), "cant of 5 meter is a unit error"),
        (ramp(5000), "cant of 5000 millimeter is a unit error"),
        (ramp(0.15, gauge="1435"), "cant in meter in a file whose gauge is in millimeter"),
        (
            cant((0, 60, "cw"), (100, 0.06, "cw"), (200, 60, "cw")),
            "cant in meter in a file whose other cant is in millimeter",
        ),
        (cant((0, 0.1, "cw"), (100, 5, "cw")), "cant of 5 meter is a unit error"),
        (ramp(0.1, gauge="9"), "no track has this gauge"),
        (cant((0, 0, "cw"), (100, "nan", "cw")), "appliedCant must be a finite number"),
        (cant((0, 0, "cw"), (100, "", "cw")), "has no appliedCant"),
        (cant((100, 0, "cw"), (50, 0.1, "cw")), "must not decrease"),
    ],
)
def test_cant_in_wrong_units_or_order_is_refused(straight, rest, message):
    with pytest.raises(SiteError, match=rf"site0\.xml:\d+: .*{message}"):
        straight(rest)


@pytest.mark.parametrize("gauge", ["1435", "1.435"])
def test_metres_of_cant_in_a_file_of_millimetres_are_refused(tools, read, gauge):
    w = tools.Writer(origin=(0.0, 0.0), crs="", units='<Units><Metric linearUnit="millimeter"/></Units>')
    line = w.element(tools.chain(("line", Law.CONSTANT, 1000.0, 0, 0))[0])
    with pytest.raises(SiteError, match="cant in meter in a file whose gauge is in millimeter"):
        read(w.document(w.alignment(line, rest=ramp(0.1, gauge=gauge))))
    site = read(w.document(w.alignment(line, rest=ramp(100, gauge=gauge))))
    assert site.alignments[0].cant_gauge_m == pytest.approx(1.435)
    assert site.alignments[0].at(0.15).cant[0] == pytest.approx(-0.1)


def test_inches_and_feet_of_cant(tools, read):
    w = tools.Writer(origin=(0.0, 0.0), crs="", units='<Units><Imperial linearUnit="foot"/></Units>')
    line = w.element(tools.chain(("line", Law.CONSTANT, 1000.0, 0, 0))[0])
    for size, unit, metres in ((6, "inch", 0.1524), (0.5, "foot", 0.1524)):
        site = read(w.document(w.alignment(line, rest=cant((0, size, "ccw"), (1000, size, "ccw"), gauge="4.708"))))
        assert site.units["cant"] == unit
        assert site.alignments[0].at(100.0).cant[0] == pytest.approx(metres)
        assert site.alignments[0].cant_gauge_m == pytest.approx(1.435, abs=1e-3)


def test_the_side_of_cant(tools, read):
    w = tools.Writer()
    right = w.element(tools.chain(("curve", Law.CONSTANT, 300.0, -1 / 500, -1 / 500))[0])

    def of(rest):
        return read(w.document(w.alignment(right, rest=rest)))

    plain = of(cant((0, 0.1, "cw"), (300, 0.1, "cw")))
    assert plain.alignments[0].at(100.0).cant[0] == pytest.approx(-0.1)
    assert not any("against the curve" in t for t in plain.warnings)
    against = of(cant((0, 0.1, "ccw"), (300, 0.1, "ccw")))
    assert against.alignments[0].at(100.0).cant[0] == pytest.approx(0.1)
    assert any("against the curve at 2 stations, the first at 0.000 m" in t for t in against.warnings)
    unsaid = of(cant((0, 0.1, ""), (300, 0.1, "")))
    assert unsaid.alignments[0].at(100.0).cant[0] == pytest.approx(-0.1)
    assert any("follows the plan" in t for t in unsaid.warnings)
    adverse = of(cant((0, 0.1, "cw"), (300, 0.1, "cw"), extra=' adverse="true"'))
    assert adverse.alignments[0].at(100.0).cant[0] == pytest.approx(0.1)
    assert any("marked adverse" in t for t in adverse.warnings)


def test_cant_outside_the_alignment_unknown_ramps_and_open_ends_are_told(straight):
    site = straight(
        cant((0, 0.0, "cw"), (500, 0.1, "cw"), (1500, 0.0, "cw"), extra=' transitionType="magic"', rotation="")
    )
    text = " ".join(site.warnings)
    assert "1 of 3 cant stations lie outside" in text
    assert "unknown transition 'magic'" in text
    assert "does not say what the track is turned about" in text
    assert site.alignments[0].cant_rotation_point is None
    site = straight(cant((100, 0.08, "cw"), (500, 0.1, "cw")))
    text = " ".join(site.warnings)
    assert "begins with -80.0 mm" in text and "ends with -100.0 mm" in text


def test_a_cant_ramp_follows_its_transition(straight):
    site = straight(cant((0, 0.0, "ccw"), (400, 0.1, "ccw"), extra=' transitionType="biquadraticParabola"'))
    assert site.alignments[0].at([100.0, 200.0]).cant == pytest.approx([0.0125, 0.05])


def test_station_equations(straight):
    finnish = (
        '<StaEquation staBack="NaN" staAhead="-698.486" staInternal="-698.486" desc="0"/>'
        '<StaEquation staBack="1003.44" staAhead="304.955" staInternal="304.955" desc="1"/>'
    )
    site = straight(finnish)
    track = site.alignments[0]
    assert site.warnings == ()
    assert track.station([0.0, 500.0]) == pytest.approx([0.0, 500.0])
    assert [e.name for e in track.stationing.equations] == ["0", "1"]
    jump = '<StaEquation staBack="300" staAhead="350"/><StaEquation staBack="550" staAhead="450"/>'
    site = straight(jump, ' staStart="100"')
    assert site.alignments[0].station([0.0, 200.0, 400.0]) == pytest.approx([100.0, 350.0, 450.0])
    assert "stations jump at 2 places (distance 200.000 m, 400.000 m)" in site.warnings[0]
    with pytest.raises(SiteError, match="several places"):
        site.alignments[0].distance_of_station(500.0)
    with pytest.raises(SiteError, match="needs staAhead"):
        straight('<StaEquation staBack="300"/>')


@pytest.mark.parametrize("size", [8, 3.5, 0.5])
def test_a_small_cant_counts_in_the_unit_of_the_gauge(straight, size):
    track = straight(ramp(size, gauge="1524")).alignments[0]
    assert track.at(150.0).cant[0] == pytest.approx(-size / 1000)
    assert track.cant_gauge_m == pytest.approx(1.524)
    with pytest.raises(SiteError, match="unit error"):
        straight(ramp(size, gauge="1.524"))


def test_inches_and_feet_are_told_apart_by_the_gauge(tools, read):
    w = tools.Writer(origin=(0.0, 0.0), crs="", units='<Units><Imperial linearUnit="foot"/></Units>')
    line = w.element(tools.chain(("line", Law.CONSTANT, 1000.0, 0, 0))[0])

    def cant_of(table: str) -> float:
        return float(read(w.document(w.alignment(line, rest=table))).alignments[0].at(100.0).cant[0])

    flat = cant((0, 1, "ccw"), (1000, 1, "ccw"), gauge="56.5")
    assert cant_of(flat) == pytest.approx(0.0254)
    assert cant_of(flat.replace("56.5", "4.708")) == pytest.approx(0.3048)
    with pytest.raises(SiteError, match="a cant of 1 may be in foot or in inch, and there is no gauge to tell"):
        cant_of(flat.replace('gauge="56.5"', ""))


def test_of_several_cant_tables_and_profiles_it_is_said_which_one_counts(straight):
    cants = ramp(0.1) + ramp(0.05).replace('name="c"', 'name="d"')
    profiles = profile("<PVI>0 1</PVI>", "<PVI>1000 1</PVI>") + profile("<PVI>0 9</PVI>", "<PVI>1000 9</PVI>")
    site = straight(cants + profiles)
    text = " ".join(site.warnings)
    assert "has 2 cant tables; the first, Cant 'c', is used" in text
    assert "has 2 profiles; the first, ProfAlign 'p', is used" in text
    assert site.alignments[0].at(150.0).cant[0] == pytest.approx(-0.1)


def test_the_parts_of_an_alignment_may_stand_in_any_order(tools, read):
    w = tools.Writer()
    line = w.element(tools.chain(("line", Law.CONSTANT, 400.0, 0, 0))[0])
    text = w.alignment(line, rest=ramp(0.1) + profile("<PVI>0 1</PVI>", "<PVI>400 5</PVI>"))
    geometry = text[text.index("<CoordGeom>") : text.index("</CoordGeom>") + len("</CoordGeom>")]
    turned = text.replace(geometry, "").replace("</Alignment>", geometry + "</Alignment>")
    state = read(w.document(turned)).alignments[0].at(150.0)
    assert (state.cant[0], state.z[0]) == pytest.approx((-0.1, 2.5))
