"""Charts and cuts: ticks are round, thinning keeps extremes, sections are the exact cuts of their solids."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.report.axes import Chart, label, nice_step, runs_of_finite, thin, ticks
from workgauge.report.sections import plan_outline, vertical_section
from workgauge.values.arrays import frozen, frozen_ints
from workgauge.values.solids import Box, Convex, PrismChain, Surface, Tube
from workgauge.values.transforms import rotation_z, translation


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6), st.integers(2, 12))
def test_ticks_are_inside_evenly_spaced_and_round(low: float, span: float, wanted: int) -> None:
    high = low + span
    step = nice_step(high - low, wanted)
    values = ticks(low, high, wanted)
    assert 1 <= len(values) <= wanted + 2 or span / step < 1
    assert all(low - 1e-6 * span <= v <= high + 1e-6 * span for v in values)
    leading = step / 10.0 ** math.floor(math.log10(step) + 1e-9)
    assert min(abs(leading - m) for m in (1, 2, 5)) < 1e-6


def test_labels_have_the_decimals_of_their_step() -> None:
    assert [label(v, 0.05) for v in (0.0, 0.15)] == ["0.00", "0.15"]
    assert label(-20.0, 10.0) == "\N{MINUS SIGN}20"


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(500, 6000))
def test_thinning_keeps_the_extremes_and_the_order(seed: int, n: int) -> None:
    y = np.random.default_rng(seed).normal(size=n)
    x = np.arange(len(y), dtype=np.float64)
    tx, ty = thin(x, y, 100)
    assert len(tx) <= 400
    assert ty.min() == y.min() and ty.max() == y.max()
    assert (np.diff(tx) > 0).all()
    assert (tx[0], tx[-1]) == (0, len(y) - 1)


def test_nan_breaks_a_line() -> None:
    y = np.array([1.0, np.nan, 2.0, 3.0, np.nan])
    assert [(s.start, s.stop) for s in runs_of_finite(y)] == [(0, 1), (2, 4)]


def test_labels_at_the_right_end_do_not_cover_each_other() -> None:
    chart = Chart("t", "x", "y", (0, 1), (0, 1))
    for name in "abcdef":
        chart.line(np.array([0.0, 1.0]), np.array([0.5, 0.5]), "s0", name)
    rows = sorted(float(part.split('y="')[1].split('"')[0]) for part in chart.svg().split("\n") if "tag" in part)
    assert len(rows) == 6
    assert min(np.diff(rows)) >= 14.9


ORIGIN = np.array([0.0, 0.0, 0.0])


@given(st.floats(0, 2 * math.pi), st.floats(-0.9, 0.9))
def test_section_of_a_turned_box(yaw: float, aside: float) -> None:
    box = Box(rotation_z(yaw), frozen([2.0, 1.0, 1.5]))
    along = rotation_z(yaw)[:2, 0]
    across = rotation_z(yaw)[:2, 1]
    centre = np.append(aside * across, 0.0)
    cut = vertical_section(box, centre, along, 20.0)
    assert cut.bounds == pytest.approx((-2.0, -1.5, 2.0, 1.5), abs=1e-9)
    assert cut.area == pytest.approx(12.0, abs=1e-9)
    assert plan_outline(box, ORIGIN, 20.0).area == pytest.approx(8.0, abs=1e-9)


def test_a_plane_that_misses_cuts_nothing() -> None:
    box = Box(translation(0, 5, 0), frozen([1.0, 1.0, 1.0]))
    assert vertical_section(box, ORIGIN, np.array([1.0, 0.0]), 20.0).is_empty


def test_convex_and_box_cut_alike() -> None:
    box = Box(translation(1, 0, 2) @ rotation_z(0.4), frozen([1.0, 0.5, 2.0]))
    convex = Convex(frozen(box.vertices), frozen_ints(np.zeros((0, 3))))
    direction = np.array([0.6, 0.8])
    a, b = (vertical_section(solid, ORIGIN, direction, 30.0) for solid in (box, convex))
    assert a.symmetric_difference(b).area == pytest.approx(0.0, abs=1e-12)


def test_section_across_a_chain_is_its_section_and_plan_is_its_band() -> None:
    x = np.linspace(-10, 10, 11)
    axis = np.stack([x, 0 * x, 0 * x], axis=1)
    section = np.array([[-1.5, 0.0], [1.5, 0.0], [1.0, 3.0], [-1.0, 3.0]])
    chain = PrismChain(
        axis[:-1],
        axis[1:],
        np.tile([0.0, 1.0, 0.0], (10, 1)),
        np.tile(section, (10, 1, 1)),
        np.zeros((10, 2)),
        np.ones((10, 2), dtype=np.bool_),
    )
    cut = vertical_section(chain, np.array([0.3, 0.0, 1.0]), np.array([0.0, 1.0]), 20.0)
    assert cut.area == pytest.approx(7.5, abs=1e-9)
    assert plan_outline(chain, ORIGIN, 5.0).area == pytest.approx(3.0 * 10.0, abs=1e-9)


def test_tube_is_as_thick_as_it_says() -> None:
    tube = Tube(frozen([[-5, 0, 4], [5, 0, 4]]), 0.5)
    low = vertical_section(tube, np.array([0.0, 0.0, 4.0]), np.array([0.0, 1.0]), 10.0).bounds
    assert low == pytest.approx((-0.5, 3.5, 0.5, 4.5), abs=0.03)


def test_section_of_a_surface_follows_it() -> None:
    surface = Surface(frozen([[-5, -5, 0], [5, -5, 1], [5, 5, 1], [-5, 5, 0]]), frozen_ints([[0, 1, 2], [0, 2, 3]]))
    line = vertical_section(surface, np.array([0.0, 1.0, 0.5]), np.array([1.0, 0.0]), 20.0)
    assert line.bounds == pytest.approx((-5.0, 0.0, 5.0, 1.0), abs=1e-9)
    assert line.length == pytest.approx(math.hypot(10, 1), abs=1e-9)
    assert plan_outline(surface, ORIGIN, 20.0).is_empty
