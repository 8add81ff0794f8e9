"""The time-optimal stop against closed forms, and against every other instant of letting go."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.machine.load import load_machine
from workgauge.machine.stopping import StoppingModel
from workgauge.rehearse.time_optimal import Approach, arrival_s, rolled, time_optimal_stop
from workgauge.sim.hydraulics import HydraulicSpec
from workgauge.values.errors import InputError

MACHINE = load_machine("rre20")
N = MACHINE.n
FULL = np.stack([MACHINE.speed_positive, MACHINE.speed_negative])
SPEED = float(FULL[0, 0])
RADIUS = 6.0
FULL_SWING = np.eye(N)[0] * SPEED


def spec(dead_time_s: float, lag_s: float, deceleration: float) -> HydraulicSpec:
    """Return joints that are all alike."""
    same = np.ones_like(FULL)
    return HydraulicSpec.of(StoppingModel(dead_time_s * same, lag_s * same, deceleration * same, 0.0 * same), FULL)


def wall(angle: float):  # type: ignore[no-untyped-def]
    """Return what is left [m] before the swing reaches an angle [rad], at a radius of 6 m."""
    return lambda q: RADIUS * (angle - float(q[0]))


def swing_to(angle: float, joints: HydraulicSpec, **more: float) -> Approach:
    """Return the time-optimal swing from 0 up to an angle."""
    q = np.array(MACHINE.home)
    q[0] = 0.0
    return time_optimal_stop(MACHINE, joints, q, lambda _: FULL_SWING, wall(angle), **more)


def rest_to_rest_s(way: float, speed: float, a: float) -> float:
    """Return the least time for a way with one full speed and one acceleration either way."""
    return way / speed + speed / a if way * a >= speed * speed else 2.0 * math.sqrt(way / a)


@settings(max_examples=15, deadline=None)
@given(st.floats(0.3, 3.0), st.floats(0.0, 0.6), st.floats(0.5, 5.0))
def test_without_lag_it_takes_what_the_closed_form_says(angle: float, dead_time_s: float, a: float) -> None:
    found = swing_to(angle, spec(dead_time_s, 0.0, a))
    assert 0.0 <= found.slack_m[-1] <= RADIUS * SPEED * 3e-4
    least = dead_time_s + rest_to_rest_s(angle, SPEED, a)
    # within 2 cm is reached before rest is, by what the last 2 cm take at that deceleration
    assert found.arrival_s() == pytest.approx(least - math.sqrt(2 * 0.02 / RADIUS / a), abs=0.03)


def test_the_lever_is_let_go_before_the_way_the_stopping_model_says() -> None:
    joints = spec(0.3, 0.0, 1.5)
    found = swing_to(2.0, joints)
    way_left = SPEED * 0.3 + SPEED**2 / (2 * 1.5)
    reached = 2.0 - way_left
    at_full_from = 0.3 + SPEED / 1.5
    began = 0.5 * SPEED**2 / 1.5
    assert found.switch_s == pytest.approx(at_full_from + (reached - began) / SPEED, abs=2e-3)


@pytest.mark.parametrize("lag_s", [0.0, 0.2])
def test_later_enters_and_earlier_takes_longer_to_the_same_place(lag_s: float) -> None:
    joints = spec(0.3, lag_s, 1.5)
    q = np.array(MACHINE.home)
    q[0] = 0.0
    best = swing_to(1.5, joints)
    late = rolled(MACHINE, joints, q, lambda _: FULL_SWING, wall(1.5), best.switch_s + 0.01, 0.01)
    early = rolled(MACHINE, joints, q, lambda _: FULL_SWING, wall(1.5), best.switch_s - 0.05, 0.01)
    assert late.slack_m.min() < 0.0 <= best.slack_m.min() < 0.003
    assert early.slack_m[-1] > 0.02


def test_ideal_joints_stop_where_the_lever_is_let_go() -> None:
    found = swing_to(1.0, spec(0.0, 0.0, math.inf))
    assert found.switch_s == pytest.approx(1.0 / SPEED, abs=2e-4)
    assert found.slack_m[-1] == pytest.approx(0.0, abs=2e-3)


def test_a_dead_band_is_made_up_for() -> None:
    plain = spec(0.2, 0.1, 2.0)
    banded = replace(plain, dead_band=np.full_like(FULL, 0.1))
    assert swing_to(1.0, banded).arrival_s() == pytest.approx(swing_to(1.0, plain).arrival_s(), abs=0.02)


def test_wishes_beyond_what_joints_can_do_are_scaled_as_a_whole() -> None:
    joints = spec(0.0, 0.0, math.inf)
    q = np.array(MACHINE.home)
    q[0] = 0.0
    wish = np.zeros(N)
    wish[0], wish[1] = 4.0 * SPEED, FULL[0, 1]
    found = rolled(MACHINE, joints, q, lambda _: wish, wall(9.0), 0.5, 0.01)
    assert found.q[0] == pytest.approx(0.5 * SPEED)
    assert found.q[1] - q[1] == pytest.approx(0.5 * FULL[0, 1] / 4.0)


def test_a_joint_that_runs_onto_its_stop_rests_there() -> None:
    wish = np.eye(N)[1] * FULL[0, 1]
    found = rolled(MACHINE, spec(0.1, 0.1, 2.0), MACHINE.home, lambda _: wish, wall(9.0), 5.0, 0.01)
    assert found.q[1] == MACHINE.q_max[1]


def test_what_has_no_answer_is_refused() -> None:
    with pytest.raises(InputError, match="nearer than the stop distance"):
        swing_to(-0.1, spec(0.1, 0.1, 2.0))
    with pytest.raises(InputError, match="nothing stands in the way"):
        swing_to(50.0, spec(0.1, 0.1, 2.0), longest_s=2.0)


def test_arrival_is_when_it_stays_near_where_it_ends() -> None:
    t = np.arange(6.0)
    assert arrival_s(t, np.array([1.0, 0.5, 0.0, 0.3, 0.01, 0.0])) == 4.0
    assert arrival_s(t, np.zeros(6)) == 0.0
