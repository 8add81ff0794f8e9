"""What shows a wrong heading, exchanged antennas above all, and what cannot."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from workgauge.positioning.headings import (
    course_difference,
    course_sigma,
    heading_difference,
    opposite,
    turned,
    turned_by_heights,
)
from workgauge.values.transforms import rotation_x, rotation_z

angles = st.floats(-10.0, 10.0)


@given(angles, st.integers(-3, 3))
def test_a_turn_more_or_less_is_the_same(angle: float, turns: int) -> None:
    once, again = turned(angle), turned(angle + 2 * math.pi * turns)
    assert -math.pi < once <= math.pi
    assert math.cos(once) == pytest.approx(math.cos(angle), abs=1e-9)
    assert abs(turned(once - again)) < 1e-9 or math.isclose(abs(once), math.pi, abs_tol=1e-9)


@given(angles, st.floats(-0.02, 0.02))
def test_a_track_tells_a_heading_from_its_opposite(track: float, noise: float) -> None:
    tolerance = math.radians(3)
    right = heading_difference(track + noise, track)
    wrong = heading_difference(track + math.pi + noise, track)
    assert abs(right) < tolerance and not opposite(right, tolerance)
    assert abs(wrong) > tolerance and opposite(wrong, tolerance)
    across = heading_difference(track + math.pi / 2 + noise, track)
    assert abs(across) > tolerance and not opposite(across, tolerance)


def test_no_heading_shows_nothing() -> None:
    assert math.isnan(heading_difference(math.nan, 1.0)) and not opposite(math.nan, 0.1)


@given(angles, st.booleans())
def test_a_course_tells_antennas_only_if_the_gear_is_known(heading: float, forward: bool) -> None:
    course = heading if forward else heading + math.pi
    tolerance = math.radians(3)

    def seen(measured: float, gear: bool | None) -> float:
        return course_difference(measured, course, 1.0, 0.05, gear)

    assert abs(seen(heading, forward)) < 1e-9
    assert opposite(seen(heading + math.pi, forward), tolerance)
    assert abs(seen(heading, None)) < 1e-9 and abs(seen(heading + math.pi, None)) < 1e-9
    assert abs(seen(heading + 0.3, None)) == pytest.approx(0.3) and not opposite(seen(heading + 0.3, None), tolerance)


def test_a_standing_machine_has_no_course() -> None:
    assert math.isnan(course_difference(1.0, 1.0, 0.05, 0.05, True))
    assert math.isnan(course_difference(1.0, 1.0, math.nan, 0.05, True))


def test_a_slow_course_is_unsure() -> None:
    assert course_sigma(1.0, 0.02) == pytest.approx(0.02)
    assert course_sigma(0.0, 0.02) == course_sigma(1e-6, 0.02) == pytest.approx(math.pi / math.sqrt(3))


def antennas(roll: float, left_higher_m: float, heading: float) -> np.ndarray:
    """Return the true baseline right to left on a machine that leans by roll."""
    return (rotation_z(heading) @ rotation_x(roll))[:3, :3] @ np.array([0.0, 2.2, left_higher_m])


@pytest.mark.parametrize(
    ("roll_deg", "higher_m", "told"),
    [(0.0, 0.0, False), (1.0, 0.0, False), (5.7, 0.0, True), (0.0, 0.3, True), (-5.7, 0.0, True)],
)
def test_heights_tell_exchanged_antennas_on_a_slope_or_at_two_heights(
    roll_deg: float, higher_m: float, told: bool
) -> None:
    """2,000 noisy measurements: where the heights can tell they are never wrong, on the level they say nothing."""
    rng = np.random.default_rng(4)
    R = np.diag([2 * 0.015**2, 2 * 0.015**2, 2 * 0.025**2])
    roll = math.radians(roll_deg)
    right = antennas(roll, higher_m, 0.4)
    noise = rng.standard_normal((2000, 3)) * np.sqrt(np.diag(R))
    # The same inclination on a heading that is half a turn off: the machine would lean the other way in the world.
    verdicts = {turned_by_heights(right + one, right, R, 5.0) for one in noise}
    exchanged = {turned_by_heights(-right + one, right * [-1, -1, 1], R, 5.0) for one in noise}
    assert verdicts == ({False} if told else {None})
    assert exchanged == ({True} if told else {None})


def test_heights_of_neither_kind_say_nothing() -> None:
    R = np.eye(3) * 0.02**2
    expected = np.array([2.0, 0.0, 0.3])
    assert turned_by_heights(np.array([2.0, 0.0, 1.3]), expected, R, 5.0) is None
    assert turned_by_heights(np.array([2.0, 0.0, math.nan]), expected, R, 5.0) is None
