"""The stopping model: its corners, its own arithmetic against the simulated hydraulics."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.machine.load import catalogue, load_machine
from workgauge.machine.stopping import StoppingModel
from workgauge.sim.hydraulics import Hydraulics, HydraulicSpec

N = 3
numbers = st.integers(0, 2**32 - 1)


def drawn(seed, tolerance=0.3):
    """A random model and full speeds (2, n); every number may be ideal."""
    rng = np.random.default_rng(seed)
    full = rng.uniform(0.2, 1.2, (2, N))
    dead = rng.choice([0.0, 0.1, 0.6, 1.3], (2, N)) * rng.uniform(0.6, 1.4, (2, N))
    lag = rng.choice([0.0, 0.1, 0.4], (2, N)) * rng.uniform(0.6, 1.4, (2, N))
    stop = rng.choice([0.0, 0.3, 1.0], (2, N)) * rng.uniform(0.6, 1.4, (2, N))
    with np.errstate(divide="ignore"):
        rate = np.where(stop > 0.0, full / stop, math.inf)
    return StoppingModel(dead, lag, rate, np.full((2, N), tolerance)), full


def stopped_from(model, full, share, sides):
    """Way (n,) made after the valves close on a machine that has run at a share of its speeds for ever, and its time
    to come down to a thousandth of full speed (n,)."""
    plant = Hydraulics(HydraulicSpec.of(model, full))
    valves = np.where(sides, share, -share)
    plant.advance(valves, dt_s=60.0)
    way, rest, t = np.zeros(N), np.full(N, math.inf), 0.0
    while t < 12.0:
        way += plant.advance(np.zeros(N), dt_s=0.02)
        t += 0.02
        still = np.abs(plant.velocity) <= 1e-3 * np.where(sides, full[0], full[1])
        rest = np.where(still & np.isinf(rest), t, rest)
    return way, rest


@settings(max_examples=25, deadline=None)
@given(seed=numbers, share=st.floats(0.05, 1.0))
def test_no_joint_moves_on_farther_than_its_stop_travel(seed, share):
    model, full = drawn(seed, 0.0)
    sides = np.random.default_rng(seed).random(N) < 0.5
    velocity = share * np.where(sides, full[0], -full[1])
    way, _ = stopped_from(model, full, share, sides)
    promised = model.stop_travel(velocity)
    assert (np.sign(promised) == np.sign(velocity)).all()
    assert (np.abs(way) <= np.abs(promised) + 1e-9).all()
    # the bound is met where nothing but one of the two brakes
    which = np.where(sides, 0, 1), np.arange(N)
    single = (model.lag_s[which] == 0.0) | np.isinf(model.deceleration[which])
    assert way[single] == pytest.approx(promised[single], abs=1e-9)
    assert (np.abs(promised) - np.abs(way) <= np.abs(velocity) * model.lag_s[which] + 1e-9).all()


@settings(max_examples=25, deadline=None)
@given(seed=numbers)
def test_every_machine_within_tolerance_rests_after_the_horizon(seed):
    model, full = drawn(seed)
    spec = HydraulicSpec.of(model, full).varied(seed, model.tolerance, at_the_ends=True)
    real = StoppingModel(spec.dead_time_s, spec.lag_s, spec.deceleration, np.zeros((2, N)))
    sides = np.random.default_rng(seed).random(N) < 0.5
    _, rest = stopped_from(real, full, 1.0, sides)
    assert rest.max() <= model.horizon_s(full[0], full[1]) + 0.021


@settings(max_examples=40, deadline=None)
@given(seed=numbers, tolerance=st.sampled_from([0.0, 0.1, 0.3, 0.9]))
def test_the_spread_is_the_tolerance_and_the_slowest_its_worst_corner(seed, tolerance):
    model, full = drawn(seed, tolerance)
    dead, lag, rate = model.spread()
    for values, own, low in (
        (dead, model.dead_time_s, 1.0 - tolerance),
        (lag, model.lag_s, 1.0 - tolerance),
        (rate, model.deceleration, 1.0 / (1.0 + tolerance)),
    ):
        assert values.shape == (2, 2, N)
        assert values[0] == pytest.approx(low * own) and values[1] == pytest.approx((1.0 + tolerance) * own)
    slowest = model.slowest()
    assert not slowest.tolerance.any()
    assert np.array_equal(slowest.dead_time_s, dead[1]) and np.array_equal(slowest.lag_s, lag[1])
    assert slowest.deceleration == pytest.approx(rate[0])
    inside = HydraulicSpec.of(model, full).varied(seed, model.tolerance)
    for values, drawn_ones in ((dead, inside.dead_time_s), (lag, inside.lag_s), (rate, inside.deceleration)):
        assert (values[0] <= drawn_ones * (1 + 1e-12)).all() and (drawn_ones <= values[1] * (1 + 1e-12)).all()


def test_an_ideal_machine_stops_at_once():
    model = StoppingModel.ideal(4)
    assert model.n == 4
    assert not model.stop_travel(np.array([1.0, -2.0, 0.0, 0.5])).any()
    assert model.horizon_s(np.ones(4), np.ones(4)) == 0.0


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_a_machines_model_is_its_files(name):
    machine = load_machine(name)
    model = StoppingModel.of(machine)
    for side, stops in enumerate((machine.stopping_positive, machine.stopping_negative)):
        for j, stop in enumerate(stops):
            assert model.dead_time_s[side, j] == stop.dead_time_s and model.lag_s[side, j] == stop.lag_s
            assert model.deceleration[side, j] == stop.deceleration and model.tolerance[side, j] == stop.tolerance
