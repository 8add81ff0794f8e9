"""Stations against distances: plain, kilometre posts, re-stationing."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from workgauge.site.stationing import StationEquation, Stationing
from workgauge.values.errors import SiteError


@given(st.floats(-1e4, 1e4), st.floats(0, 1000))
def test_without_equations_stations_run_on_from_the_start(start, distance):
    plain = Stationing(start)
    station = plain.station(np.array([distance]))[0]
    assert station == pytest.approx(start + distance)
    assert plain.distance(station, 1000.0, "x") == pytest.approx(distance, abs=1e-8)


def test_kilometre_posts_change_nothing():
    posts = Stationing(0.0, [StationEquation(-698.486, -698.486), StationEquation(304.955, 304.955)])
    assert posts.station(np.array([0.0, 300.0, 600.0])) == pytest.approx([0.0, 300.0, 600.0])
    assert all(e.is_post for e in posts.equations)
    assert posts.distance(500.0, 664.8, "x") == pytest.approx(500.0)


def test_a_jump_leaves_a_gap_or_an_overlap():
    jump = Stationing(100.0, [StationEquation(300.0, 350.0), StationEquation(500.0, 450.0)])
    d = np.array([0.0, 199.999, 200.0, 399.999, 400.0, 500.0])
    assert jump.station(d) == pytest.approx([100.0, 299.999, 350.0, 549.999, 450.0, 550.0])
    assert jump.distance(250.0, 600.0, "x") == pytest.approx(150.0)
    with pytest.raises(SiteError, match="no place"):
        jump.distance(320.0, 600.0, "x")
    with pytest.raises(SiteError, match=r"several places.*350\.000, 450\.000"):
        jump.distance(500.0, 600.0, "x")


def test_an_equation_before_the_start_rules_at_the_start():
    early = Stationing(0.0, [StationEquation(-50.0, 1000.0)])
    assert early.station(np.array([0.0, 10.0])) == pytest.approx([1050.0, 1060.0])


def test_stations_may_run_backwards():
    back = Stationing(0.0, [StationEquation(100.0, 900.0, increasing=False)])
    assert back.station(np.array([100.0, 150.0])) == pytest.approx([900.0, 850.0])
    assert back.distance(870.0, 200.0, "x") == pytest.approx(130.0)
