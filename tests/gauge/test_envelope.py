"""The section's formulas: the worked examples to 0.1 mm, and laws that hold everywhere."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from workgauge.gauge.blocks import FormulaBlock, TableBlock
from workgauge.gauge.envelope import QuasiStatic, cant_angle, required_half_width, rotate
from workgauge.gauge.rulebook import load_rule_book, shipped_names
from workgauge.gauge.rules import TrackBlock

LEAN = QuasiStatic(0.4, 1.5, 0.05, 0.5, 0.1, 5000.0)


def shipped_widening(name):
    blocks = [b for rule in load_rule_book(name).rules for b in rule.limits if isinstance(b, TrackBlock)]
    assert blocks and blocks[0].widening is not None
    return blocks[0].widening.build()


@pytest.mark.parametrize(
    ("radius", "cant", "deficiency", "s_in", "s_out", "qs_in", "qs_out", "b_in", "b_out"),
    [
        (math.inf, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.6450, 1.6450),
        (600.0, 0.10, 0.05, 0.00625, 0.00625, 0.03667, 0.0, 1.6879, 1.6513),
        (300.0, 0.15, 0.10, 0.0125, 0.0125, 0.07333, 0.03667, 1.7308, 1.6942),
        (200.0, 0.10, 0.06, 0.065, 0.075, 0.03667, 0.00733, 1.7467, 1.7273),
    ],
)
@pytest.mark.parametrize("book", ["finland", "generic"])
def test_worked_examples_to_a_tenth_of_a_millimetre(
    book, radius, cant, deficiency, s_in, s_out, qs_in, qs_out, b_in, b_out
):
    inside, outside = shipped_widening(book).at(1.0 / radius)
    lean_in, lean_out = LEAN.lean(cant, 3.25), LEAN.lean(deficiency, 3.25)
    np.testing.assert_allclose([inside, outside, lean_in, lean_out], [s_in, s_out, qs_in, qs_out], atol=5e-6)
    assert required_half_width(1.645, inside, lean_in, 0.0) == pytest.approx(b_in, abs=1e-4)
    assert required_half_width(1.645, outside, lean_out, 0.0) == pytest.approx(b_out, abs=1e-4)


def test_worked_rotation_to_a_tenth_of_a_millimetre():
    angle = cant_angle(0.10, 1.5)
    assert math.degrees(float(angle)) == pytest.approx(3.8226, abs=5e-5)
    b_in, b_out = 1.645 + 0.00625 + 0.4 / 1.5 * 0.05 * 2.75, 1.645 + 0.00625
    for y, pivot, wanted in [
        (b_in, 0.0, (1.9008, 3.1302)),
        (b_in, 0.75, (1.9025, 3.1802)),
        (-b_out, 0.0, (-1.4309, 3.3529)),
        (-b_out, 0.75, (-1.4292, 3.4029)),
    ]:
        np.testing.assert_allclose(rotate(y, 3.25, angle, pivot), wanted, atol=1e-4)


@pytest.mark.parametrize("name", shipped_names())
def test_widening_is_continuous_and_never_shrinks_with_curvature(name):
    widening = shipped_widening(name)
    k = np.linspace(0.0, 1.0 / widening.smallest_radius, 20_001)
    for side in widening.at(k):
        assert np.all(np.isfinite(side))
        assert np.all(np.diff(side) >= -1e-12)
        assert np.max(np.diff(side)) < 1e-3
    for just in (250.0 * (1 - 1e-9), 250.0 * (1 + 1e-9)):
        np.testing.assert_allclose(widening.at(1 / just), widening.at(1 / 250.0), atol=1e-8)


def test_the_german_table_is_the_annex_row_by_row():
    rows = {250: (0, 0), 225: (25, 30), 200: (50, 65), 190: (65, 80), 180: (80, 100), 150: (135, 170)}
    rows |= {120: (335, 365), 100: (530, 570)}
    widening = shipped_widening("germany")
    for radius, wanted in rows.items():
        np.testing.assert_allclose(np.array(widening.at(1 / radius)) * 1000, wanted, atol=1e-6)
    np.testing.assert_allclose(np.array(widening.at(1 / 110.0)) * 1000, (432.5, 467.5), atol=1e-6)
    assert widening.at(0.0) == (0.0, 0.0)


@pytest.mark.parametrize("name", shipped_names())
def test_there_is_no_answer_below_the_smallest_radius(name):
    widening = shipped_widening(name)
    smallest = widening.smallest_radius
    assert np.all(np.isfinite(widening.at(1 / smallest)))
    assert np.all(np.isfinite(widening.at((1 / smallest) * (1 + 1e-9))))
    assert np.all(np.isnan(widening.at(1 / (smallest - 0.01))))


@given(x=st.floats(0, 0.2), y=st.floats(0, 0.2), h=st.floats(-1, 6), g=st.floats(-1, 6))
def test_lean_grows_with_cant_and_height_and_is_never_negative(x, y, h, g):
    low, high, down, up = min(x, y), max(x, y), min(h, g), max(h, g)
    assert 0.0 <= LEAN.lean(low, down) <= LEAN.lean(high, down) <= LEAN.lean(high, up)
    assert LEAN.lean(0.05, up) == 0.0


@given(y=st.floats(-3, 3), h=st.floats(-1, 6), cant=st.floats(-0.2, 0.2), pivot=st.floats(-1, 1))
def test_rotation_is_rigid_about_its_pivot_and_lowers_the_inside(y, h, cant, pivot):
    angle = cant_angle(cant, 1.5)
    a, b = rotate(y, h, angle, pivot)
    assert math.hypot(float(a) - pivot, float(b)) == pytest.approx(math.hypot(y - pivot, h), abs=1e-9)
    np.testing.assert_allclose(rotate(pivot, 0.0, angle, pivot), (pivot, 0.0), atol=1e-12)
    rails = [float(rotate(rail, 0.0, angle, pivot)[1]) for rail in (-0.75, 0.75)]
    assert rails[0] - rails[1] == pytest.approx(cant, abs=1e-12)


@pytest.mark.parametrize(
    "branches",
    [
        [{"from_radius_m": 250.0, "inside_a_m2": 3.75}, {"from_radius_m": 150.0, "inside_a_m2": 50.0}],
        [{"from_radius_m": 150.0, "inside_a_m2": 1.0}, {"from_radius_m": 250.0, "inside_a_m2": 3.75}],
        [{"from_radius_m": 0.0}],
        [],
    ],
)
def test_formulas_that_shrink_with_curvature_or_go_backwards_are_refused(branches):
    with pytest.raises(ValueError):
        FormulaBlock.model_validate({"kind": "formula", "branches": branches})


@pytest.mark.parametrize("rows", [[[250, 0, 0], [200, 0.05, 0.06]], [[150, 0.1, 0.1], [250, 0.2, 0.1]], []])
def test_tables_that_widen_with_the_radius_are_refused(rows):
    with pytest.raises(ValueError):
        TableBlock.model_validate({"kind": "table", "radius_inside_outside_m": rows})
