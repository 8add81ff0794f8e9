"""Coordinate systems: factors against PROJ's own and against finite differences, areas, names, refusals."""

import math

import numpy as np
import pyproj
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.geodesy.crs import ProjectedCrs
from workgauge.values.errors import GeodesyError

#: EPSG number and a box of eastings and northings [m] in its area.
AREAS = {
    3067: ((60_000, 730_000), (6_650_000, 7_770_000)),  # Finland, TM35FIN
    3879: ((25_440_000, 25_560_000), (6_650_000, 7_600_000)),  # Finland, GK25
    25832: ((300_000, 700_000), (5_300_000, 6_050_000)),  # Germany, UTM 32
    31370: ((30_000, 280_000), (30_000, 240_000)),  # Belgium, a conic
    2263: ((280_000, 325_000), (40_000, 85_000)),  # New York, in US survey feet
    28355: ((300_000, 700_000), (5_300_000, 6_100_000)),  # Victoria, south of the equator
}


@st.composite
def places(draw: st.DrawFn) -> tuple[ProjectedCrs, float, float]:
    epsg = draw(st.sampled_from(sorted(AREAS)))
    (e0, e1), (n0, n1) = AREAS[epsg]
    return ProjectedCrs.from_epsg(epsg), draw(st.floats(e0, e1)), draw(st.floats(n0, n1))


@given(places())
@settings(max_examples=80, deadline=None)
def test_factors_are_projs(place):
    crs, e, n = place
    proj = pyproj.Proj(crs.epsg)
    lon, lat = proj(e / crs.metres_per_unit, n / crs.metres_per_unit, inverse=True)
    factors = proj.get_factors(lon, lat)
    assert crs.convergence(e, n) == pytest.approx(math.radians(factors.meridian_convergence), abs=1e-9)
    assert crs.point_scale(e, n) == pytest.approx(factors.meridional_scale, abs=1e-8)


@given(places())
@settings(max_examples=80, deadline=None)
def test_convergence_is_minus_the_grid_heading_of_true_north(place):
    crs, e, n = place
    lat, lon = crs.to_geodetic(e, n)
    step = 1e-6
    e0, n0 = crs.from_geodetic(lat - step, lon)
    e1, n1 = crs.from_geodetic(lat + step, lon)
    assert crs.convergence(e, n) == pytest.approx(-math.atan2(e1 - e0, n1 - n0), abs=1e-7)


@given(places())
@settings(max_examples=80, deadline=None)
def test_point_scale_is_grid_length_over_ellipsoidal_length(place):
    crs, e, n = place
    e0, n0, e1, n1 = e - 8, n - 6, e + 8, n + 6
    lat, lon = crs.to_geodetic(np.array([e0, e1]), np.array([n0, n1]))
    geod = pyproj.CRS.from_epsg(crs.epsg).get_geod()
    _, _, length = geod.inv(*np.degrees([lon[0], lat[0], lon[1], lat[1]]))
    assert crs.point_scale(e, n) == pytest.approx(20 / length, abs=2e-7)


@given(places())
@settings(max_examples=60, deadline=None)
def test_to_geodetic_and_back(place):
    crs, e, n = place
    back_e, back_n = crs.from_geodetic(*crs.to_geodetic(e, n))
    assert math.hypot(back_e - e, back_n - n) < 1e-4


def test_convergence_is_positive_east_of_the_central_meridian():
    gk21 = ProjectedCrs.from_epsg(3875)
    assert math.degrees(gk21.convergence(21_530_673.0, 6_783_006.0)) == pytest.approx(0.499, abs=1e-3)
    assert gk21.convergence(21_469_327.0, 6_783_006.0) == pytest.approx(-gk21.convergence(21_530_673.0, 6_783_006.0))


def test_factors_keep_the_shape_of_their_input():
    crs = ProjectedCrs.from_epsg(3067)
    e = np.full((2, 3), 400_000.0)
    n = np.full((2, 3), 7_000_000.0)
    assert crs.convergence(e, n).shape == crs.point_scale(e, n).shape == crs.contains(e, n).shape == (2, 3)


@pytest.mark.parametrize(
    ("epsg", "e", "n", "inside"),
    [
        (3875, 21_530_673.0, 6_783_006.0, True),
        (2392, 25_496_706.0, 6_673_718.0, False),  # another zone's prefix
        (2392, 2_500_705.0, 6_663_359.0, True),
        (3067, 0.0, 0.0, False),
        (3067, 400_000.0, math.nan, False),
        (3067, math.inf, 7e6, False),
        (25832, 396_319.0, 45_645_928.0, False),  # once round the earth and back into Germany
        (32601, 500_000.0, 7_000_000.0, True),  # beside the date line
    ],
)
def test_contains(epsg, e, n, inside):
    assert bool(ProjectedCrs.from_epsg(epsg).contains(e, n)) is inside


def test_the_margin_widens_the_area():
    crs = ProjectedCrs.from_epsg(3875)
    area = pyproj.CRS.from_epsg(3875).area_of_use
    e, n = crs.from_geodetic(np.radians((area.south + area.north) / 2), np.radians(area.east + 0.5))
    assert bool(crs.contains(e, n, margin_deg=0.6))
    assert not bool(crs.contains(e, n, margin_deg=0.4))


@pytest.mark.parametrize("epsg", [999_999, 0, -1, 4326, 3900, 10**12])
def test_what_is_no_projected_system_is_refused_with_its_number(epsg):
    with pytest.raises(GeodesyError, match=str(epsg)):
        ProjectedCrs.from_epsg(epsg)


@pytest.mark.parametrize("epsg", [5513, 2065, 2046])
def test_a_system_that_counts_westwards_is_refused(epsg):
    """Its first two numbers are no easting and northing: left and right, and every heading, would come out wrong."""
    with pytest.raises(GeodesyError, match=f"counts westwards.*found {epsg}.*easting and northing"):
        ProjectedCrs.from_epsg(epsg)
    with pytest.raises(GeodesyError, match="counts westwards"):
        ProjectedCrs.from_wkt(pyproj.CRS.from_epsg(epsg).to_wkt())


def test_well_known_text():
    crs = ProjectedCrs.from_wkt(pyproj.CRS.from_epsg(2263).to_wkt())
    assert crs.epsg == 2263
    assert crs.metres_per_unit == pytest.approx(1200 / 3937)
    for text in ("", "PROJCS[nonsense", pyproj.CRS.from_epsg(4326).to_wkt()):
        with pytest.raises(GeodesyError):
            ProjectedCrs.from_wkt(text)


def test_the_horizontal_part_of_a_compound_system_is_taken():
    assert ProjectedCrs.from_epsg(5555).name == ProjectedCrs.from_epsg(25832).name


@pytest.mark.parametrize(
    ("name", "epsg"),
    [
        ("ETRS89 / GK25FIN", 3879),
        ("etrs89/gk25fin", 3879),
        ("GK21", 3875),
        ("ETRS-GK24", 3878),
        ("ETRS-TM35FIN", 3067),
        ("KKJ / Finland zone 2", 2392),
        ("somewhere", None),
        ("", None),
    ],
)
def test_names(name, epsg):
    found = ProjectedCrs.from_name(name)
    assert (None if found is None else found.epsg) == epsg


def test_equal_systems_are_equal_and_hashable():
    assert len({ProjectedCrs.from_epsg(3067), ProjectedCrs.from_epsg(3067), ProjectedCrs.from_epsg(3879)}) == 2
