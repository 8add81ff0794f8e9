"""The stop in hand against the simulated hydraulics: where the joints may be contains where they are."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.machine.load import load_machine
from workgauge.machine.rollout import RESTING, Rollout
from workgauge.machine.stopping import StoppingModel
from workgauge.sim.hydraulics import Hydraulics, HydraulicSpec

N = 3
seeds = st.integers(0, 2**32 - 1)
periods = st.sampled_from([0.01, 0.02, 0.033, 0.05, 0.1])
#: What the lag leaves when `marks` says that the machine rests [s of full speed].
CLOSE = 1e-6
_PIECE = 3.0


def drawn(rng, tolerance):
    """A random model and full speeds (2, n): dead times of no whole tick, none at all, joints without inertia."""
    full = rng.uniform(0.2, 1.2, (2, N))
    dead = rng.choice([0.0, 0.1, 0.3, 0.6, 1.3], (2, N)) * rng.uniform(0.6, 1.4, (2, N))
    lag = rng.choice([0.0, 0.1, 0.2, 0.4], (2, N)) * rng.uniform(0.6, 1.4, (2, N))
    stop = rng.choice([0.0, 0.3, 0.6, 1.0], (2, N)) * rng.uniform(0.6, 1.4, (2, N))
    with np.errstate(divide="ignore"):
        rate = np.where(stop > 0.0, full / stop, math.inf)
    return StoppingModel(dead, lag, rate, np.full((2, N), tolerance)), full


def real(model, full, dt, dead, lag, rate, late=0.0):
    """A machine so far (-1 to 1 each) into the tolerance of a model, whose commands act `late` ticks late."""
    t = model.tolerance
    delays = np.maximum(model.dead_time_s * (1.0 + dead * t) + late * dt, 0.0)
    rates = model.deceleration * np.where(rate > 0.0, 1.0 + rate * t, 1.0 / (1.0 - rate * t))
    return HydraulicSpec.of(StoppingModel(delays, model.lag_s * (1.0 + lag * t), rates, np.zeros((2, N))), full)


def history(rng, dt):
    """Valves (T, n) of some seconds: steps, ramps, pulses, reversals."""
    ticks = int(rng.integers(1, _PIECE / dt + 2))
    out = np.zeros((ticks, N))
    for j in range(N):
        t, v, ramps = 0, 0.0, rng.random() < 0.5
        while t < ticks:
            target = float(rng.choice([-1.0, 0.0, 1.0, rng.uniform(-1.0, 1.0)]))
            step = dt / float(rng.choice([0.2, 1.0])) if ramps else 2.0
            for i in range(t, min(t + int(rng.integers(1, max(2.0, 1.2 / dt))), ticks)):
                v += float(np.clip(target - v, -step, step))
                out[i, j] = v
                t = i + 1
    return out


def outside(model, full, spec, dt, valves, rollout=None):
    """How far the truth leaves the intervals on the way to rest [s of full speed], and the widest interval."""
    rollout = Rollout(model, dt, full[0], full[1]) if rollout is None else rollout
    velocities = np.where(valves > 0.0, valves * full[0], valves * full[1])
    plant, v, sent = Hydraulics(spec, dt), rollout.rest(), np.zeros((rollout.memory, N))
    for valve, velocity in zip(valves[:-1], velocities[:-1], strict=True):
        plant.advance(valve)
        sent = np.concatenate([sent[1:], velocity[None]])
        v = rollout.advanced(v, sent)
    low, high = (one[0] for one in rollout.displacements(v, sent, velocities[-1:]))
    way, worst, done = np.zeros(N), 0.0, 0
    for k, mark in enumerate([*rollout.marks[:-1].astype(int), None]):
        until = int(rollout.marks[-2]) + math.ceil(8.0 / dt) if mark is None else mark
        if done == 0:
            way, done = way + plant.advance(valves[-1], dt_s=dt), 1
        if until > done:
            way = way + plant.advance(np.zeros(N), dt_s=(until - done) * dt)
            done = until
        beyond = np.maximum(way - high[k], low[k] - way) / full.max(axis=0)
        worst = max(worst, float(beyond.max()))
    return worst, float(((high - low) / full.max(axis=0)).max())


@settings(max_examples=80, deadline=None)
@given(seed=seeds, dt=periods)
def test_a_machine_that_is_the_model_is_where_it_is_said_to_be(seed, dt):
    rng = np.random.default_rng(seed)
    model, full = drawn(rng, 0.0)
    valves = history(rng, dt)
    nothing = np.zeros((2, N))
    for late in (-0.5, 0.0, 0.5):
        worst, _ = outside(model, full, real(model, full, dt, nothing, nothing, nothing, late), dt, valves)
        assert worst < CLOSE


def exactly_timed(model, full, dt):
    """The roll-out of a machine whose commands act neither early nor late."""
    rollout = Rollout(model, dt, full[0], full[1])
    delays = np.broadcast_to((model.dead_time_s.T / dt)[:, None], rollout.packed[0].shape)
    rollout.packed = (delays.copy(), *rollout.packed[1:])
    return rollout


@settings(max_examples=60, deadline=None)
@given(seed=seeds, dt=periods)
def test_nothing_but_timing_makes_an_interval_of_an_exact_model(seed, dt):
    rng = np.random.default_rng(seed)
    model, full = drawn(rng, 0.0)
    nothing = np.zeros((2, N))
    exact = real(model, full, dt, nothing, nothing, nothing)
    worst, wide = outside(model, full, exact, dt, history(rng, dt), exactly_timed(model, full, dt))
    assert worst < CLOSE and wide < CLOSE


@settings(max_examples=300, deadline=None)
@given(
    seed=seeds,
    dt=periods,
    tolerance=st.sampled_from([0.1, 0.3, 0.5, 0.9]),
    where=st.sampled_from(["corner", "mixed corner", "inside", "one for both directions"]),
)
def test_a_machine_anywhere_in_the_tolerance_is_within_the_intervals(seed, dt, tolerance, where):
    rng = np.random.default_rng(seed)
    model, full = drawn(rng, tolerance)
    shape = {"corner": (3, 1, 1), "mixed corner": (3, 2, N), "inside": (3, 2, N)}.get(where, (3, 1, N))
    draw = rng.choice([-1.0, 1.0], shape) if "corner" in where else rng.uniform(-1.0, 1.0, shape)
    dead, lag, rate = np.broadcast_to(draw, (3, 2, N))
    late = float(rng.choice([-0.5, 0.5, rng.uniform(-0.5, 0.5)]))
    worst, wide = outside(model, full, real(model, full, dt, dead, lag, rate, late), dt, history(rng, dt))
    assert worst < CLOSE and wide >= 0.0


@settings(max_examples=40, deadline=None)
@given(seed=seeds, dt=periods)
def test_advancing_is_rolling(seed, dt):
    """Rolled out from a tick ago with what was sent since, or from now: the same way lies ahead."""
    rng = np.random.default_rng(seed)
    model, full = drawn(rng, 0.0)
    rollout = exactly_timed(model, full, dt)
    rollout.marks = np.arange(1.0, 60.0)
    valves = history(rng, dt)
    velocities = np.where(valves > 0.0, valves * full[0], valves * full[1])
    v, sent = rollout.rest(), np.zeros((rollout.memory, N))
    for velocity in velocities:
        sent = np.concatenate([sent[1:], velocity[None]])
        before, v = v, rollout.advanced(v, sent)
    earlier = np.concatenate([np.zeros((1, N)), sent[:-1]])
    then = rollout.displacements(before, earlier, sent[-1:])
    now = rollout.displacements(v, sent, np.zeros((1, N)))
    for one, other in zip(then, now, strict=True):
        assert one[0, 1:] - one[0, 0] == pytest.approx(other[0, :-1], abs=1e-9 + 60 * dt * RESTING)


@settings(max_examples=40, deadline=None)
@given(seed=seeds, dt=periods, tolerance=st.sampled_from([0.0, 0.3]))
def test_no_command_and_no_motion_is_no_way(seed, dt, tolerance):
    rng = np.random.default_rng(seed)
    model, full = drawn(rng, tolerance)
    rollout = exactly_timed(model, full, dt) if tolerance == 0.0 else Rollout(model, dt, full[0], full[1])
    sent = np.zeros((rollout.memory, N))
    first = np.stack([np.zeros(N), full[0], -full[1], np.array([full[0, 0], 0.0, 0.0])])
    low, high = rollout.displacements(rollout.rest(), sent, first)
    assert not low[0].any() and not high[0].any()
    assert (low[1] >= -1e-12).all() and (high[2] <= 1e-12).all()
    assert (low <= high + 1e-15).all()
    if tolerance == 0.0:
        assert (high[1, -1] <= full[0] * dt * (1.0 + 1e-6)).all() and (
            low[2, -1] >= -full[1] * dt * (1.0 + 1e-6)
        ).all()
        free = np.isinf(model.deceleration)  # what a lag delays is not lost
        assert high[1, -1][free[0]] == pytest.approx((full[0] * dt)[free[0]], rel=1e-6)
        assert low[2, -1][free[1]] == pytest.approx((-full[1] * dt)[free[1]], rel=1e-6)
    # what a joint does is its own affair
    assert np.array_equal(high[3, :, 0], high[1, :, 0]) and not high[3, :, 1:].any() and not low[3, :, 1:].any()


@settings(max_examples=40, deadline=None)
@given(seed=seeds, dt=periods)
def test_a_wider_tolerance_never_narrows_an_interval(seed, dt):
    rng = np.random.default_rng(seed)
    model, full = drawn(rng, 0.0)
    valves = history(rng, dt)
    velocities = np.where(valves > 0.0, valves * full[0], valves * full[1])
    moments = np.arange(1.0, 200.0, 7.0)
    before = None
    for tolerance in (0.0, 0.1, 0.2, 0.4):
        wider = StoppingModel(model.dead_time_s, model.lag_s, model.deceleration, np.full((2, N), tolerance))
        rollout = Rollout(wider, dt, full[0], full[1])
        rollout.marks = moments
        v, sent = rollout.rest(), np.zeros((rollout.memory, N))
        for velocity in velocities:
            sent = np.concatenate([sent[1:], velocity[None]])
            v = rollout.advanced(v, sent)
        low, high = rollout.displacements(v, sent, np.zeros((1, N)))
        if before is not None:
            assert (low <= before[0] + 1e-6).all() and (high >= before[1] - 1e-6).all()
        before = low, high


@settings(max_examples=40, deadline=None)
@given(seed=seeds, dt=st.one_of(periods, st.sampled_from([0.001, 0.5, 1.0])))
def test_marks_reach_from_now_to_rest(seed, dt):
    model, full = drawn(np.random.default_rng(seed), 0.3)
    rollout = Rollout(model, dt, full[0], full[1])
    assert rollout.marks[0] == 1.0 and (np.diff(rollout.marks) > 0.0).all() and len(rollout.marks) < 100
    assert rollout.rest_ticks * dt >= model.horizon_s(full[0], full[1], 2e-3) - dt
    assert rollout.memory >= (model.dead_time_s * 1.3).max() / dt + 1


@pytest.mark.parametrize("name", ["rre20", "brokk5"])
def test_a_shipped_machine_just_as_its_file_says(name):
    machine = load_machine(name)
    model = StoppingModel.of(machine)
    full = np.stack([machine.speed_positive, machine.speed_negative])
    rng = np.random.default_rng(0)
    dt = 0.02
    rollout = Rollout(model, dt, full[0], full[1])
    n = machine.n
    valves = np.repeat(rng.choice([-1.0, 0.0, 1.0], (8, n)), 40, axis=0)
    velocities = np.where(valves > 0.0, valves * full[0], valves * full[1])
    plant, v, sent = Hydraulics(HydraulicSpec.of(model, full), dt), rollout.rest(), np.zeros((rollout.memory, n))
    for valve, velocity in zip(valves, velocities, strict=True):
        low, high = rollout.displacements(v, sent, velocity[None])
        way = plant.advance(valve)
        assert (way <= high[0, 0] + 1e-9).all() and (way >= low[0, 0] - 1e-9).all()
        sent = np.concatenate([sent[1:], velocity[None]])
        v = rollout.advanced(v, sent)
        assert (plant.velocity <= v.max(axis=0) + 1e-9).all() and (plant.velocity >= v.min(axis=0) - 1e-9).all()
