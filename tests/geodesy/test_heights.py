"""Heights: the three models against arithmetic and a grid written here; unknown stays unknown; refusals."""

import math
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.geodesy.heights import HeightModel
from workgauge.values.errors import GeodesyError
from workgauge.values.measurements import Stamp
from workgauge.values.navigation import GnssFix

LAT, LON = math.radians(60.5), math.radians(24.5)


def write_gtx(path: Path, south: float, west: float, step: float, rows: list[list[float]]) -> Path:
    """Write a grid of geoid heights in NOAA's GTX format: rows from south to north, columns from west to east."""
    heights = np.asarray(rows, dtype=">f4")
    path.write_bytes(struct.pack(">ddddii", south, west, step, step, *heights.shape) + heights.tobytes())
    return path


@pytest.fixture
def grid(tmp_path):
    """Geoid height 10 m at 24° E, 20 at 25°, 30 at 26°; 5 m more per degree to the north."""
    return write_gtx(tmp_path / "geoid.gtx", 60.0, 24.0, 1.0, [[10, 20, 30], [15, 25, 35], [20, 30, 40]])


def fix(msl=math.nan, ellipsoid=math.nan, separation=math.nan, lat=LAT, lon=LON):
    return GnssFix(
        Stamp("m", 0, "gnss/GN"),
        "GGA",
        lat,
        lon,
        height_msl_m=msl,
        height_ellipsoid_m=ellipsoid,
        geoid_separation_m=separation,
    )


def test_sentence_takes_the_height_as_sent():
    model = HeightModel.from_sentence()
    assert model.height(fix(msl=12.5, separation=17.0)) == 12.5
    assert model.height(fix(msl=12.5)) == 12.5
    assert model.height(fix(ellipsoid=29.5, separation=17.0)) == 12.5
    assert math.isnan(model.height(fix(ellipsoid=29.5)))
    assert math.isnan(model.height(fix()))


def test_constant_replaces_the_receivers_own_geoid():
    model = HeightModel.constant(18.0)
    assert model.height(fix(ellipsoid=30.0)) == 12.0
    assert model.height(fix(msl=13.0, separation=17.0)) == 12.0
    assert math.isnan(model.height(fix(msl=13.0)))


def test_grid_is_interpolated_between_its_points(grid):
    model = HeightModel.from_grid(grid)
    assert model.height(fix(ellipsoid=100.0)) == pytest.approx(100.0 - 17.5, abs=1e-5)
    assert model.height(fix(msl=80.0, separation=20.0)) == pytest.approx(82.5, abs=1e-5)


@given(east=st.floats(24, 26), north=st.floats(60, 62))
@settings(max_examples=60, deadline=None)
def test_grid_against_a_plane(tmp_path_factory, east, north):
    path = tmp_path_factory.getbasetemp() / "plane.gtx"
    if not path.exists():
        write_gtx(path, 60.0, 24.0, 1.0, [[10, 20, 30], [15, 25, 35], [20, 30, 40]])
    model = HeightModel.from_grid(path)
    expected = 10 + 10 * (east - 24) + 5 * (north - 60)
    assert model.separation(math.radians(north), math.radians(east)) == pytest.approx(expected, abs=1e-5)


@given(
    st.lists(st.tuples(*[st.one_of(st.just(math.nan), st.floats(-100, 1000))] * 3), min_size=1, max_size=8),
    st.sampled_from(["sentence", "constant"]),
)
def test_arrays_are_the_single_fixes_one_by_one(rows, kind):
    model = HeightModel.of(kind, 18.0 if kind == "constant" else None)
    msl, ellipsoid, separation = np.array(rows).T
    n = len(rows)
    together = model.heights(np.full(n, LAT), np.full(n, LON), msl, ellipsoid, separation)
    alone = [model.height(fix(*row)) for row in rows]
    np.testing.assert_array_equal(together, alone)


def test_outside_the_grid_nothing_is_known(grid):
    model = HeightModel.from_grid(grid)
    assert math.isnan(model.height(fix(ellipsoid=100.0, lon=math.radians(40.0))))
    assert math.isnan(model.height(fix(ellipsoid=100.0, lat=math.nan, lon=math.nan)))
    inside_and_out = model.separation([LAT, LAT], [LON, math.radians(-70.0)])
    assert np.isfinite(inside_and_out).tolist() == [True, False]


def test_a_path_with_blanks_and_signs(grid, tmp_path):
    folder = tmp_path / "my grids"
    folder.mkdir()
    moved = folder / "a+b=c ä.gtx"
    moved.write_bytes(grid.read_bytes())
    assert HeightModel.from_grid(moved).height(fix(ellipsoid=100.0)) == pytest.approx(82.5, abs=1e-5)


@pytest.mark.parametrize("name", ["missing.gtx", "@missing.gtx", "null", "@null", "", "a.gtx,null"])
def test_a_grid_that_is_not_there_is_refused_by_name(name):
    with pytest.raises(GeodesyError) as caught:
        HeightModel.from_grid(name)
    assert name in str(caught.value)


def test_a_file_that_is_no_grid_is_refused(tmp_path):
    path = tmp_path / "junk.gtx"
    path.write_bytes(b"hello" * 100)
    with pytest.raises(GeodesyError, match=r"junk\.gtx"):
        HeightModel.from_grid(path)


@pytest.mark.parametrize("separation", [math.nan, math.inf, 151.0, -1e9])
def test_no_such_separation(separation):
    with pytest.raises(GeodesyError, match="separation"):
        HeightModel.constant(separation)


def test_what_the_kind_needs():
    with pytest.raises(GeodesyError):
        HeightModel.of("constant")
    with pytest.raises(GeodesyError, match="grid"):
        HeightModel.of("grid")
    assert HeightModel.of() == HeightModel.from_sentence()


def test_the_choice_is_said(grid):
    assert "18.25 m" in HeightModel.constant(18.25).words
    assert "geoid.gtx" in HeightModel.from_grid(grid).words
    assert "receiver" in HeightModel.from_sentence().words
