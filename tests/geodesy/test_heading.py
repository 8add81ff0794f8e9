"""Grid heading against PROJ: true heading minus convergence, at a thousand places in each of four projections."""

import math

import numpy as np
import pyproj
import pytest

from workgauge.geodesy.crs import ProjectedCrs

#: EPSG number and the latitudes and longitudes [degree] to draw from.
PROJECTIONS = {
    3879: ((59.8, 69.5), (23.5, 26.5)),  # Finland, GK25: transverse Mercator
    25832: ((47.5, 55.0), (6.0, 12.0)),  # UTM 32
    31370: ((49.6, 51.4), (2.7, 6.2)),  # Belgium: conic
    28355: ((-43.0, -30.0), (144.5, 149.5)),  # Victoria: south of the equator
}


@pytest.mark.parametrize("epsg", PROJECTIONS)
def test_grid_heading_is_the_direction_of_a_geodesic_on_the_grid(epsg):
    """Independent of PROJ's factors: walk 1 m along the true heading on the ellipsoid, look where that leads."""
    rng = np.random.default_rng(epsg)
    (south, north), (west, east) = PROJECTIONS[epsg]
    lat, lon = rng.uniform(south, north, 1000), rng.uniform(west, east, 1000)
    true_deg = rng.uniform(0, 360, 1000)
    crs = pyproj.CRS.from_epsg(epsg)
    onto = pyproj.Transformer.from_crs(crs.geodetic_crs, crs, always_xy=True)
    there = [crs.get_geod().fwd(lon, lat, true_deg + turn, np.full(1000, 1.0))[:2] for turn in (0.0, 180.0)]
    (e1, n1), (e0, n0) = (onto.transform(*place) for place in there)
    walked = np.degrees(np.arctan2(e1 - e0, n1 - n0))

    ours = ProjectedCrs.from_epsg(epsg)
    e, n = ours.from_geodetic(np.radians(lat), np.radians(lon))
    grid = np.degrees(ours.grid_heading(np.radians(true_deg), e, n))

    assert ((grid >= 0) & (grid < 360)).all()
    off = np.mod(grid - walked + 180, 360) - 180
    assert np.abs(off).max() < 1e-5
    factors = pyproj.Proj(epsg).get_factors(lon, lat).meridian_convergence
    off = np.mod(grid - (true_deg - factors) + 180, 360) - 180
    assert np.abs(off).max() < 1e-9
    assert np.abs(factors).max() > 1.0  # a forgotten convergence would show


def test_a_heading_just_short_of_north_stays_below_a_full_turn():
    crs = ProjectedCrs.from_epsg(25832)
    e, n = crs.from_geodetic(math.radians(50.0), math.radians(9.0))
    on_meridian = float(crs.convergence(e, n))
    assert 0.0 <= float(crs.grid_heading(on_meridian - 1e-18, e, n)) < 2 * math.pi


@pytest.mark.parametrize(
    ("epsg", "lat", "lon", "shift"),
    [
        (3879, 60.5, 25.0, 0.0),
        (32632, 50.0, 9.0, 0.0),
        (2392, 60.5, 25.0, 177.0),  # KKJ
        (27700, 52.0, -1.0, 116.0),  # OSGB36
    ],
)
def test_datum_shift(epsg, lat, lon, shift):
    """An older datum lies a hundred metres and more beside what receivers deliver; recomputed in plain PROJ."""
    moved = ProjectedCrs.from_epsg(epsg).datum_shift_m(math.radians(lat), math.radians(lon))
    assert moved == pytest.approx(shift, abs=3.0)


def test_where_the_projection_has_no_inverse_there_is_no_grid_heading(recwarn):
    crs = ProjectedCrs.from_epsg(3879)
    assert math.isnan(float(crs.grid_heading(1.0, 1e9, 1e9)))
    assert not recwarn.list
