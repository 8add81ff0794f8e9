"""Coordinate systems of site files, merging of files, and the model's own frame."""

import html

import numpy as np
import pyproj
import pytest

from workgauge.site.transitions import Law
from workgauge.values.errors import GeodesyError, SiteError


@pytest.fixture
def line(tools):
    def make(crs, origin=(21_530_000.0, 6_783_000.0), name="Track 1", units=None):
        w = tools.Writer(crs=crs, origin=origin)
        if units:
            w.units = units
        return w.document(w.alignment(w.element(tools.chain(("line", Law.CONSTANT, 100.0, 0, 0))[0]), name=name))

    return make


@pytest.mark.parametrize(
    "attributes",
    ['epsgCode="3875"', 'horizontalDatum="EPSG:3875"', 'horizontalDatum="3875"', 'epsgCode="EPSG:3875"'],
)
def test_the_system_by_number(read, line, attributes):
    site = read(line(f'<CoordinateSystem name="x" {attributes} verticalDatum="EPSG:3900"/>'))
    assert site.crs is not None and site.crs.epsg == 3875
    assert site.crs_declared["name"] == "x"
    assert site.warnings == ()


def test_the_system_by_text(read, line, real):
    wkt = (real / "tin" / "nunosurf.xml").read_text().partition('ogcWktCode="')[2].partition('"')[0]
    site = read(line(f'<CoordinateSystem ogcWktCode="{wkt}"/>', origin=(500_000.0, 120_000.0)))
    assert site.crs is not None and site.crs.name == "CANQ-M6" and site.crs.epsg is None


def test_the_system_by_name_is_told(read, line):
    site = read(line('<CoordinateSystem name="ETRS89 / GK21FIN"/>'))
    assert site.crs is not None and site.crs.epsg == 3875
    assert "states no EPSG number; its name" in site.warnings[0]


def test_no_system_or_an_unknown_one_is_told(read, line):
    site = read(line(""))
    assert site.crs is None
    assert "names no coordinate system" in site.warnings[0]
    site = read(line('<CoordinateSystem name="site grid"/>'))
    assert site.crs is None
    assert "'site grid' is not known" in site.warnings[0]


@pytest.mark.parametrize(
    ("crs", "message"),
    [
        (
            '<CoordinateSystem epsgCode="999999"/>',
            r"site0\.xml: CoordinateSystem: unknown EPSG number \(found 999999",
        ),
        ('<CoordinateSystem epsgCode="4326"/>', "not a projected"),
        ('<CoordinateSystem epsgCode="many"/>', "epsgCode is no number.*many"),
        ('<CoordinateSystem ogcWktCode="PROJCS[oops"/>', "cannot be read"),
        (
            '<CoordinateSystem epsgCode="3067"/>',
            r"alignment 'Track 1' lie outside the area.*21530012\.\d+.*EPSG:3067",
        ),
    ],
)
def test_unknown_systems_and_foreign_coordinates_are_refused(read, line, crs, message):
    with pytest.raises(GeodesyError, match=message):
        read(line(crs))


def test_every_kind_of_feature_is_held_against_the_area(tools, read):
    w = tools.Writer()
    inside = '<CgPoints><CgPoint name="in">6783000 21530000</CgPoint></CgPoints>'
    for outside, called in (
        ('<CgPoints><CgPoint name="out">10 20</CgPoint></CgPoints>', "point 'out'"),
        (w.surface([(1, "0 0 1"), (2, "9 0 1"), (3, "0 9 1")], ["<F>1 2 3</F>"]), "surface 'ground'"),
        (
            "<PlanFeatures><PlanFeature name='pf'><CoordGeom><Line><Start>0 0</Start>"
            "<End>6783000 21530000</End></Line></CoordGeom></PlanFeature></PlanFeatures>",
            "line 'pf'",
        ),
    ):
        with pytest.raises(GeodesyError, match=f"coordinates of {called} lie outside"):
            read(w.document(inside, outside))


def test_a_wrong_code_beside_a_fitting_name_is_told_and_kept(read, line):
    mislabelled = line(
        '<CoordinateSystem name="ETRS89 / GK25FIN" epsgCode="2392"/>', origin=(25_496_000.0, 6_673_000.0)
    )
    site = read(mislabelled)
    assert site.crs is not None and site.crs.epsg == 2392
    assert "EPSG:2392" in site.warnings[0] and "EPSG:3879" in site.warnings[0]
    mended = read(mislabelled, epsg=3879)
    assert mended.crs is not None and mended.crs.epsg == 3879
    assert "read as EPSG:3879 as asked; the file says EPSG:2392" in mended.warnings[0]
    with pytest.raises(GeodesyError, match="outside"):
        read(line('<CoordinateSystem name="ETRS89 / GK25FIN" epsgCode="2392"/>', origin=(26_496_000.0, 1_000.0)))
    with pytest.raises(GeodesyError, match="outside"):
        read(mislabelled, epsg=3067)


def test_asking_for_the_system_the_file_states_changes_nothing(read, line):
    assert read(line('<CoordinateSystem epsgCode="3875"/>'), epsg=3875).warnings == ()


def test_units_that_are_not_the_systems_are_told(read, line):
    feet = line(
        '<CoordinateSystem epsgCode="2263"/>',
        origin=(1_000_000.0, 200_000.0),
        units='<Units><Imperial linearUnit="USSurveyFoot"/></Units>',
    )
    assert read(feet).warnings == ()
    metres = line('<CoordinateSystem epsgCode="2263"/>', origin=(300_000.0, 60_000.0))
    assert "coordinates are in meter, but the unit of NAD83" in read(metres).warnings[0]


def test_a_rotation_is_told(read, line):
    site = read(line('<CoordinateSystem epsgCode="3875" rotationAngle="12"/>'))
    assert "rotationAngle 12 is not applied" in site.warnings[0]


def test_files_are_merged(read, line):
    one = line('<CoordinateSystem epsgCode="3875"/>', name="A")
    other = line("", name="B", units='<Units><Metric linearUnit="meter" elevationUnit="meter"/></Units>')
    site = read(one, other)
    assert [a.name for a in site.alignments] == ["A", "B"]
    assert site.crs is not None and site.crs.epsg == 3875
    assert len(site.files) == 2
    assert any(
        t == "site1.xml: taken to be in EPSG:3875 (ETRS89 / GK21FIN) like the other files" for t in site.warnings
    )
    twice = read(one, one.replace("</LandXML>", "<!-- a copy, changed --></LandXML>"))
    assert [a.name for a in twice.alignments] == ["A", "A (2)"]
    assert any(
        "site1.xml:" in t and "several alignments are called 'A'; this one becomes 'A (2)'" in t
        for t in twice.warnings
    )
    wkt = html.escape(pyproj.CRS.from_epsg(3875).to_wkt(), quote=True)
    assert len(read(one, line(f'<CoordinateSystem ogcWktCode="{wkt}"/>', name="C")).alignments) == 2
    with pytest.raises(SiteError, match=r"different coordinate systems.*EPSG:3879.*EPSG:3875"):
        read(one, line('<CoordinateSystem epsgCode="3879"/>', origin=(25_530_000.0, 6_783_000.0)))


def test_the_frame_is_near_the_work_and_round(read, line):
    site = read(line('<CoordinateSystem epsgCode="3875"/>'))
    assert site.frame().origin.tolist() == [21_530_100.0, 6_783_000.0, 0.0]
    near = site.frame((21_534_567.0, 6_781_234.0))
    assert near.origin.tolist() == [21_534_600.0, 6_781_200.0, 0.0]
    assert site.frame((0.0, 0.0, 149.0)).origin[2] == 100.0
    assert near.crs == site.crs
    with pytest.raises(SiteError, match="finite"):
        site.frame((float("nan"), 0.0))
    assert np.isnan(site.bounds[:, 2]).all()
