"""Vertical alignments: circles and parabolas tangent to their grades, refusals."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.site.profile import ProfileError, VerticalCurve, VerticalPoint, build_profile

CIRCLE, PARABOLA = VerticalCurve.CIRCLE, VerticalCurve.PARABOLA

grades = st.floats(-0.08, 0.08)


def three(g1: float, g2: float, **curve: object) -> list[VerticalPoint]:
    return [
        VerticalPoint(0.0, 50.0 - 500 * g1),
        VerticalPoint(500.0, 50.0, **curve),  # type: ignore[arg-type]
        VerticalPoint(1000.0, 50.0 + 500 * g2),
    ]


@given(grades, grades, st.floats(200, 2000))
@settings(max_examples=60)
def test_a_circle_has_its_radius_and_is_tangent_to_both_grades(g1, g2, radius):
    profile = build_profile(three(g1, g2, curve=CIRCLE, radius=radius))
    d = np.linspace(0, 1000, 2001)
    z, gradient = profile.at(d)
    begin, end = profile.breaks[1:3] if abs(g2 - g1) > 1e-12 else (500.0, 500.0)
    off = (d < begin - 1e-9) | (d > end + 1e-9)
    assert z[off] == pytest.approx(np.where(d < 500, 50 + (d - 500) * g1, 50 + (d - 500) * g2)[off], abs=1e-9)
    side = math.copysign(1.0, g2 - g1)
    tilt = math.hypot(1, g1)
    centre = begin - side * radius * g1 / tilt, 50 + (begin - 500) * g1 + side * radius / tilt
    inside = ~off
    assert np.hypot(d - centre[0], z - centre[1])[inside] == pytest.approx(radius, abs=1e-6)
    assert gradient[d < begin] == pytest.approx(g1)
    assert gradient[d > end] == pytest.approx(g2)


@given(grades, grades, st.floats(10, 400), st.floats(10, 400))
@settings(max_examples=60)
def test_a_parabola_is_tangent_and_its_gradient_runs_straight(g1, g2, length_in, length_out):
    profile = build_profile(three(g1, g2, curve=PARABOLA, length_in=length_in, length_out=length_out))
    begin, end = 500 - length_in, 500 + length_out
    z, gradient = profile.at(np.array([begin, 500.0, end]))
    assert z[0] == pytest.approx(50 - length_in * g1, abs=1e-9)
    assert z[2] == pytest.approx(50 + length_out * g2, abs=1e-9)
    assert z[1] - 50 == pytest.approx((g2 - g1) * length_in * length_out / (2 * (length_in + length_out)), abs=1e-9)
    assert gradient[[0, 2]] == pytest.approx([g1, g2], abs=1e-12)
    quarter = profile.at(np.array([begin + length_in / 2]))[1][0]
    assert quarter == pytest.approx((g1 + gradient[1]) / 2, abs=1e-12)


@given(grades, grades, grades, st.floats(500, 3000))
@settings(max_examples=40)
def test_gradient_is_the_rate_of_the_height(g1, g2, g3, radius):
    points = [VerticalPoint(0.0, 0.0)]
    for d, g in ((400.0, g1), (900.0, g2), (1300.0, g3)):
        points.append(VerticalPoint(d, points[-1].height + g * (d - points[-1].distance)))
    points[1] = VerticalPoint(400.0, points[1].height, CIRCLE, radius=radius)
    points[2] = VerticalPoint(900.0, points[2].height, PARABOLA, length_in=60, length_out=140)
    profile = build_profile(points)
    d = np.linspace(0, 1300, 13_001)
    z, _ = profile.at(d)
    _, gradient = profile.at(d[:-1] + 0.05)
    assert np.abs(np.diff(z) / 0.1 - gradient).max() < 1e-4
    assert np.abs(np.diff(z)).max() < 0.1


def test_outside_there_is_no_height_but_rounding_is_forgiven():
    profile = build_profile([VerticalPoint(10.0, 1.0), VerticalPoint(20.0, 2.0)])
    z, gradient = profile.at(np.array([9.98, 9.995, 10.0, 20.0, 20.005, 20.02]))
    assert np.isnan(z).tolist() == np.isnan(gradient).tolist() == [True, False, False, False, False, True]
    assert z[1:5] == pytest.approx([0.9995, 1.0, 2.0, 2.0005])


def test_a_circle_may_be_given_by_its_length():
    by_radius = build_profile(three(0.01, -0.02, curve=CIRCLE, radius=3000.0))
    length = 3000 * (math.atan(0.01) + math.atan(0.02))
    by_length = build_profile(three(0.01, -0.02, curve=CIRCLE, length_in=length / 2, length_out=length / 2))
    d = np.linspace(0, 1000, 101)
    assert by_length.at(d)[0] == pytest.approx(by_radius.at(d)[0], abs=1e-9)


@pytest.mark.parametrize(
    ("points", "message", "place"),
    [
        ([VerticalPoint(0.0, 0.0)], "at least two", 0),
        ([VerticalPoint(0.0, 0.0), VerticalPoint(0.0, 1.0)], "must increase", 1),
        ([VerticalPoint(5.0, 0.0), VerticalPoint(9.0, 1.0), VerticalPoint(7.0, 1.0)], "must increase", 2),
        (
            [
                VerticalPoint(0.0, 0.0),
                VerticalPoint(100.0, 1.0, PARABOLA, length_in=40, length_out=40),
                VerticalPoint(150.0, 0.0, PARABOLA, length_in=20, length_out=20),
                VerticalPoint(300.0, 0.0),
            ],
            "begins 10.000 m before the one before it ends",
            2,
        ),
        (three(0.02, -0.02, curve=PARABOLA, length_in=600, length_out=100), "begins 100.000 m before", 1),
        (three(0.02, -0.02, curve=PARABOLA, length_in=100, length_out=600), "ends 100.000 m after", 2),
    ],
)
def test_what_makes_no_profile_is_refused(points, message, place):
    with pytest.raises(ProfileError, match=message) as caught:
        build_profile(points)
    assert caught.value.point == place
