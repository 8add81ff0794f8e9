"""Transition curves: every law against its definition, integrated independently."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from workgauge.site.plan import PlanElement
from workgauge.site.transitions import Law

#: Curvature share at u, as the laws are defined.
DEFINITIONS = {
    Law.CLOTHOID: lambda u: u,
    Law.BLOSS: lambda u: 3 * u**2 - 2 * u**3,
    Law.COSINE: lambda u: (1 - math.cos(math.pi * u)) / 2,
    Law.SINE: lambda u: u - math.sin(2 * math.pi * u) / (2 * math.pi),
    Law.BIQUADRATIC: lambda u: 2 * u**2 if u <= 0.5 else 1 - 2 * (1 - u) ** 2,
}

laws = st.sampled_from(sorted(DEFINITIONS))
curvatures = st.one_of(st.just(0.0), st.floats(1 / 5000, 1 / 100)).flatmap(lambda k: st.sampled_from([k, -k]))


def spiral(law: Law, length: float, k0: float, k1: float, yaw: float = 0.0) -> PlanElement:
    return PlanElement("spiral", law, (0.0, 0.0), yaw, length, k0, k1)


@given(laws, st.floats(5, 250), curvatures, curvatures, st.floats(0, 1))
@settings(max_examples=60, deadline=None)
def test_position_heading_and_curvature_follow_the_definition(law, length, k0, k1, share):
    def curvature(t):
        return k0 + (k1 - k0) * DEFINITIONS[law](t / length)

    def heading(t):
        return quad(curvature, 0, t, points=[length / 2] if t > length / 2 else None, epsabs=1e-13)[0]

    s = share * length
    course = spiral(law, length, k0, k1).course(np.array([s]))
    assert course.curvature[0] == pytest.approx(curvature(s), abs=1e-14)
    assert course.turn[0] == pytest.approx(heading(s), abs=1e-11)
    breaks = [length / 2] if s > length / 2 else None
    x = quad(lambda t: math.cos(heading(t)), 0, s, points=breaks, epsabs=1e-9, limit=40)[0]
    y = quad(lambda t: math.sin(heading(t)), 0, s, points=breaks, epsabs=1e-9, limit=40)[0]
    assert course.x[0] == pytest.approx(x, abs=2e-8)
    assert course.y[0] == pytest.approx(y, abs=2e-8)


def test_worked_clothoid():
    course = spiral(Law.CLOTHOID, 80.0, 0.0, 1 / 600).course(np.array([40.0, 80.0]))
    assert course.x == pytest.approx([39.99889, 79.96445], abs=6e-6)
    assert course.y == pytest.approx([0.22222, 1.77721], abs=6e-6)
    assert course.turn == pytest.approx([0.016667, 0.066667], abs=6e-7)


def test_a_clothoid_that_turns_by_half_a_circle_is_still_exact():
    # End point of the unit clothoid at turn pi by the Fresnel integrals.
    from scipy.special import fresnel

    sine, cosine = fresnel(math.sqrt(2.0))
    length = math.sqrt(2 * math.pi) * 10
    course = spiral(Law.CLOTHOID, length, 0.0, length / 100).course(np.array([length]))
    assert course.turn[0] == pytest.approx(math.pi)
    assert course.x[0] == pytest.approx(math.sqrt(math.pi) * 10 * cosine, abs=1e-9)
    assert course.y[0] == pytest.approx(math.sqrt(math.pi) * 10 * sine, abs=1e-9)


@given(st.floats(20, 150), st.floats(150, 2000), st.sampled_from([1, -1]))
@settings(max_examples=60, deadline=None)
def test_cubic_parabola_is_its_formula_from_the_straight_end(length, radius, side):
    s = np.linspace(0, length, 33)
    out = spiral(Law.CUBIC_PARABOLA, length, 0.0, side / radius).course(s)
    assert out.y == pytest.approx(side * out.x**3 / (6 * radius * length), abs=1e-9)
    assert out.turn == pytest.approx(side * np.arctan(out.x**2 / (2 * radius * length)), abs=1e-12)
    arc = quad(lambda x: math.hypot(1, x * x / (2 * radius * length)), 0, out.x[-1], epsabs=1e-12)[0]
    assert arc == pytest.approx(length, abs=1e-9)
    # Run through the other way it is the same curve.
    back = spiral(Law.CUBIC_PARABOLA, length, -side / radius, 0.0)
    end = out.x[-1], out.y[-1], out.turn[-1]
    mirrored = PlanElement("spiral", Law.CUBIC_PARABOLA, end[:2], end[2] + math.pi, length, back.k0, 0.0)
    assert mirrored.end() == pytest.approx((0.0, 0.0), abs=1e-8)
    assert mirrored.end_yaw() == pytest.approx(math.pi, abs=1e-12)


@pytest.mark.parametrize("law", [law for law in Law if law is not Law.CONSTANT])
@pytest.mark.parametrize("ends", [(0.0, 1 / 300), (1 / 300, 0.0), (-1 / 500, -1 / 250), (1 / 200, 1 / 900)])
def test_heading_is_the_direction_and_curvature_its_rate(law, ends):
    item = spiral(law, 100.0, *ends)
    s = np.linspace(0, 100, 4001)
    out = item.course(s)
    step = s[1]
    dx, dy = np.diff(out.x), np.diff(out.y)
    middle = item.course(s[:-1] + step / 2)
    assert np.hypot(dx, dy) / step == pytest.approx(1.0, abs=1e-8)
    assert np.arctan2(dy, dx) == pytest.approx(middle.turn, abs=1e-7)
    assert np.diff(out.turn) / step == pytest.approx(middle.curvature, abs=1e-8)


def test_equal_curvatures_make_an_arc_whatever_the_law():
    for law in DEFINITIONS:
        out = spiral(law, 50.0, 1 / 200, 1 / 200).course(np.array([50.0]))
        assert (out.x[0], out.y[0]) == pytest.approx((200 * math.sin(0.25), 200 * (1 - math.cos(0.25))), abs=1e-9)
