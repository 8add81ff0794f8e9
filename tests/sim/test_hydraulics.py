"""Hydraulic joints against a slow integration of their equations, written separately, and against laws."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from workgauge.machine.cylinder import Cylinder
from workgauge.machine.load import load_machine
from workgauge.machine.parts import Pump
from workgauge.machine.stopping import StoppingModel
from workgauge.sim.hydraulics import Change, Hydraulics, HydraulicSpec
from workgauge.values.errors import MachineError


def spec(n: int = 1, **changes) -> HydraulicSpec:
    """Return joints that differ by direction, and from each other."""
    j = 1.0 + 0.3 * np.arange(n)
    both = {
        "dead_time_s": np.stack([0.2 * j, 0.13 * j]),
        "lag_s": np.stack([0.15 / j, 0.22 / j]),
        "deceleration": np.stack([2.0 * j, 1.1 * j]),
        "dead_band": np.full((2, n), 0.08),
        "full_speed": np.stack([0.8 / j, 0.6 / j]),
    }
    return HydraulicSpec(**{**both, **changes})


def valve_at(t: float, steps: list[tuple[float, np.ndarray]]) -> np.ndarray:
    out = np.zeros_like(steps[0][1])
    for at, valve in steps:
        if at <= t:
            out = valve
    return out


def slow(given_: HydraulicSpec, steps: list[tuple[float, np.ndarray]], end: float, h: float = 2e-4) -> tuple:
    """Return (t, velocity (m, n), displacement (m, n)) by small Euler steps of the equations as documented."""
    n = given_.full_speed.shape[1]
    rising = given_.deceleration if given_.acceleration is None else given_.acceleration
    frequency = np.zeros((2, n)) if given_.natural_frequency is None else given_.natural_frequency
    v, z, x, spool = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    spools, ts, vs, xs = [], [], [], []
    for i in range(round(end / h)):
        t = (i + 0.5) * h
        asked = valve_at(t, steps)
        spool = spool + np.clip(asked - spool, -given_.valve_rate * h, given_.valve_rate * h)
        spools.append(spool)
        opened = np.zeros((2, n))
        for side in (0, 1):
            for j in range(n):
                k = math.floor((t - given_.dead_time_s[side, j]) / h)
                u = (spools[k][j] if k >= 0 else 0.0) * (1 if side == 0 else -1)
                opened[side, j] = max(u - given_.dead_band[side, j], 0.0) / (1 - given_.dead_band[side, j])
        share = 1.0
        if given_.pump is not None:
            flow = float(opened[0] @ given_.pump.flow_positive + opened[1] @ given_.pump.flow_negative)
            share = min(1.0, given_.pump.flow / flow) if flow else 1.0
        w = share * (opened[0] * given_.full_speed[0] - opened[1] * given_.full_speed[1])
        for j in range(n):
            side = 0 if v[j] > 0 or (v[j] == 0 and w[j] > 0) else 1
            if frequency[side, j]:
                omega, zeta = frequency[side, j], given_.damping[side, j]
                z[j] += h * (omega**2 * (w[j] - v[j]) - 2 * zeta * omega * z[j])
                most = (rising if z[j] * v[j] >= 0 else given_.deceleration)[side, j]
                z[j] = min(max(z[j], -most), most)
                rate = z[j]
            else:
                gap, lag = w[j] - v[j], given_.lag_s[side, j]
                rate = gap / lag
                most = (rising if abs(v[j] + rate * h) >= abs(v[j]) else given_.deceleration)[side, j]
                rate = min(max(rate, -most), most)
            x[j] += h * (v[j] + 0.5 * h * rate)
            v[j] += h * rate
        ts.append((i + 1) * h)
        vs.append(v.copy())
        xs.append(x.copy())
    return np.array(ts), np.array(vs), np.array(xs)


def quick(given_: HydraulicSpec, steps: list[tuple[float, np.ndarray]], end: float, h: float = 0.01) -> tuple:
    subject, x, vs, xs = Hydraulics(given_), np.zeros(given_.full_speed.shape[1]), [], []
    for i in range(round(end / h)):
        x = x + subject.advance(valve_at(i * h + 1e-9, steps), dt_s=h)
        vs.append(subject.velocity)
        xs.append(x)
    return np.array(vs), np.array(xs)


STEPS = [(0.0, np.array([1.0, -0.7])), (0.9, np.array([-0.6, -0.7])), (1.6, np.array([0.0, 0.9])), (2.3, np.zeros(2))]
TWO_AT_ONCE = Pump(1.2e-3, np.array([1e-3, 0.7e-3]), np.array([0.8e-3, 0.9e-3]))
KINDS = {
    "first order": {},
    "quick to rise": {"acceleration": np.full((2, 2), 5.0)},
    "one pump": {"pump": TWO_AT_ONCE},
    "slow spool": {"valve_rate": 4.0},
    "second order": {
        "natural_frequency": np.array([[9.0, 12.0], [7.0, 10.0]]),
        "damping": np.array([[0.5, 0.4], [0.6, 1.3]]),
    },
    "critical": {"natural_frequency": np.full((2, 2), 9.0), "damping": np.full((2, 2), 1.0)},
}


@pytest.mark.parametrize("kind", KINDS)
def test_it_follows_the_equations(kind: str) -> None:
    given_ = spec(2, **KINDS[kind])
    _, v, x = slow(given_, STEPS, 3.5)
    quick_v, quick_x = quick(given_, STEPS, 3.5)
    assert quick_v == pytest.approx(v[49::50], abs=4e-3)
    assert quick_x == pytest.approx(x[49::50], abs=1e-3)
    assert np.ptp(quick_x, axis=0).min() > 0.1


def test_a_swinging_joint_agrees_with_an_adaptive_integrator() -> None:
    given_ = spec(1, deceleration=np.full((2, 1), math.inf), natural_frequency=np.full((2, 1), 8.0))
    given_ = replace(given_, damping=np.full((2, 1), 0.35), dead_time_s=np.zeros((2, 1)))

    def rate(t: float, y: np.ndarray) -> list[float]:
        return [y[1], y[2], 64.0 * (0.8 - y[1]) - 2 * 0.35 * 8.0 * y[2]]

    exact = solve_ivp(rate, (0, 1.5), [0, 0, 0], rtol=1e-10, atol=1e-12)
    subject = Hydraulics(given_)
    way = subject.advance(np.ones(1), dt_s=1.5)
    assert way[0] == pytest.approx(exact.y[0, -1], abs=1e-8)
    assert subject.velocity[0] == pytest.approx(exact.y[1, -1], abs=1e-8)


times = st.lists(st.floats(1e-4, 0.3), min_size=1, max_size=12)


@settings(max_examples=60, deadline=None)
@given(times, times, st.floats(-1, 1), st.floats(-1, 1))
def test_while_the_valves_stay_the_steps_do_not_matter(
    first: list[float], then: list[float], a: float, b: float
) -> None:
    once, often = Hydraulics(spec()), Hydraulics(spec())
    for valve, cuts in ((a, first), (b, then)):
        one = once.advance(np.array([valve]), dt_s=sum(cuts))
        many = sum(often.advance(np.array([valve]), dt_s=cut) for cut in cuts)
        assert many == pytest.approx(one, abs=1e-11)
        assert often.velocity == pytest.approx(once.velocity, abs=1e-11)


@settings(max_examples=60, deadline=None)
@given(st.floats(0.1, 1.0), st.booleans(), st.floats(0.0, 0.4), st.floats(0.02, 0.4), st.floats(0.3, 9.0))
def test_a_stop_is_the_stopping_models(share: float, forward: bool, dead: float, lag: float, a: float) -> None:
    model = StoppingModel(*(np.full((2, 1), x) for x in (dead, lag, a, 0.0)))
    given_ = HydraulicSpec.of(model, np.array([[0.9], [0.7]]))
    subject, sign = Hydraulics(given_), 1.0 if forward else -1.0
    subject.advance(np.array([sign * share]), dt_s=30.0)
    speed = subject.velocity.copy()
    assert speed[0] == pytest.approx(sign * share * (0.9 if forward else 0.7))
    way = subject.advance(np.zeros(1), dt_s=30.0)
    most = model.stop_travel(speed)
    assert abs(way[0]) <= abs(most[0]) + 1e-9
    w, bound = abs(speed[0]), a * lag
    exact = w * (dead + lag) + (max(w - bound, 0.0) ** 2 / (2 * a) if w > bound else 0.0)
    assert abs(way[0]) == pytest.approx(exact, abs=1e-9)


def test_a_dead_band_does_nothing_and_full_valve_is_full_speed() -> None:
    subject = Hydraulics(spec())
    assert subject.advance(np.array([0.08]), dt_s=5.0) == 0.0 and subject.advance(np.array([-0.079]), dt_s=5.0) == 0.0
    subject.advance(np.ones(1), dt_s=20.0)
    assert subject.velocity == pytest.approx([0.8])


def test_the_pump_scales_all_joints_alike() -> None:
    subject = Hydraulics(spec(2, pump=TWO_AT_ONCE))
    subject.advance(np.array([1.0, -1.0]), dt_s=20.0)
    share = 1.2 / 1.9
    assert subject.velocity == pytest.approx([0.8 * share, -0.6 / 1.3 * share])


def test_cold_oil_reacts_later_from_its_moment_on() -> None:
    cold = spec(script=(Change(10.0, dead_time=2.0), Change(15.0, 20.0, joints=(0,), speed=0.5)))
    subject = Hydraulics(cold)
    assert subject.advance(np.ones(1), dt_s=0.2) == 0.0 and subject.advance(np.ones(1), dt_s=0.05) > 0.0
    subject.advance(np.zeros(1), dt_s=10.75)  # now at 11 s, at rest
    assert subject.advance(np.ones(1), dt_s=0.4) == pytest.approx(0.0, abs=1e-9)
    assert subject.advance(np.ones(1), dt_s=0.05) > 1e-4
    subject.advance(np.ones(1), dt_s=8.0)
    assert subject.velocity == pytest.approx([0.4])
    subject.advance(np.ones(1), dt_s=10.0)
    assert subject.velocity == pytest.approx([0.8])


def test_commands_in_flight_are_kept_however_many() -> None:
    late = spec(dead_time_s=np.full((2, 1), 1.3), lag_s=np.zeros((2, 1)), deceleration=np.full((2, 1), math.inf))
    subject, rng = Hydraulics(replace(late, dead_band=np.zeros((2, 1)))), np.random.default_rng(4)
    valves = rng.uniform(0, 1, 5000)
    way = [subject.advance(np.array([valve]), dt_s=0.001)[0] for valve in valves]
    assert np.array(way[1300:]) == pytest.approx(0.0008 * valves[: len(way) - 1300], abs=1e-6)


def test_a_drawn_machine_is_within_tolerance_and_the_same_for_its_seed() -> None:
    plain = HydraulicSpec.of_machine(load_machine("rre20"), 0.08)
    for seed in range(20):
        one, again = plain.varied(seed, 0.3), plain.varied(seed, 0.3)
        for name in ("dead_time_s", "lag_s", "deceleration", "dead_band", "full_speed"):
            ratio = getattr(one, name) / getattr(plain, name)
            assert (ratio == getattr(again, name) / getattr(plain, name)).all()
            assert ratio.min() >= (0.7 if name not in ("deceleration", "full_speed") else 1 / 1.3) - 1e-12
            assert ratio.max() <= (1.0 if name == "full_speed" else 1.3) + 1e-12
    assert (plain.varied(1, 0.3).dead_time_s != plain.varied(2, 0.3).dead_time_s).any()
    ends = plain.varied(3, 0.3, at_the_ends=True)
    assert set(np.round(ends.dead_time_s / plain.dead_time_s, 9).ravel()) <= {0.7, 1.3}
    slowest, drawn = StoppingModel.of(load_machine("rre20")).slowest(), plain.varied(9, 0.3)
    assert (drawn.dead_time_s <= slowest.dead_time_s + 1e-12).all()
    assert (drawn.deceleration >= slowest.deceleration - 1e-12).all()


TRIANGLE = Cylinder(1.6, 0.5, math.radians(70), math.radians(-45), math.radians(65))


@settings(max_examples=200, deadline=None)
@given(st.floats(-0.78, 1.13), st.floats(-0.5, 0.5), st.booleans())
def test_a_cylinder_moves_its_joint_by_its_own_length(q: float, way: float, mirrored: bool) -> None:
    one = replace(TRIANGLE, offset_rad=-TRIANGLE.offset_rad, q_min=-TRIANGLE.q_max, q_max=-TRIANGLE.q_min)
    one = one if mirrored else TRIANGLE
    q = -q if mirrored else q
    assert one.fits
    after = one.moved(q, way)
    assert one.q_min <= after <= one.q_max
    if one.q_min < after < one.q_max:
        assert one.length_m(after) - one.length_m(q) == pytest.approx(way / one.fastest, abs=1e-12)
        assert (after - q) * math.copysign(1.0, way) >= -1e-12
    small = one.moved(q, 1e-7) - q
    assert small == pytest.approx(1e-7 * one.gain(q), rel=1e-3) and 0.0 < one.gain(q) <= 1.0


def test_a_joint_with_a_cylinder_turns_by_its_posture() -> None:
    given_ = replace(spec(), cylinders=(TRIANGLE,), dead_time_s=np.zeros((2, 1)))
    subject, plain, q = Hydraulics(given_), Hydraulics(replace(given_, cylinders=())), np.array([0.1])
    for _ in range(40):
        q = q + subject.advance(np.ones(1), q, 0.02)
        plain.advance(np.ones(1), dt_s=0.02)
    assert subject.velocity == pytest.approx(plain.velocity * TRIANGLE.gain(q[0]))
    assert TRIANGLE.gain(TRIANGLE.q_max) == 1.0 or TRIANGLE.gain(TRIANGLE.q_min) == 1.0
    assert subject.advance(np.zeros(1), q, 0.02)[0] != 0.0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"dead_time_s": np.full((2, 1), -0.1)}, "dead_time_s"),
        ({"lag_s": np.full((2, 1), math.nan)}, "lag_s"),
        ({"dead_band": np.ones((2, 1))}, "dead_band"),
        ({"deceleration": np.zeros((2, 1)) + 1e-320}, "deceleration"),
        ({"full_speed": np.zeros((2, 1))}, "full_speed"),
        ({"lag_s": np.zeros((1, 2))}, "lag_s"),
        ({"damping": np.zeros((2, 1))}, "damping"),
        ({"valve_rate": 0.0}, "valve_rate"),
        ({"cylinders": (None, None)}, "cylinders"),
    ],
)
def test_a_spec_that_makes_no_sense_is_refused(change: dict, words: str) -> None:
    with pytest.raises(MachineError, match=words), np.errstate(over="ignore"):
        Hydraulics(spec(**change))
