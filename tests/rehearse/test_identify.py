"""Identification: the bounds hold the truth, the model stops no earlier than the machine, bad logs are refused."""

import functools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.machine.load import load_machine, machine_from
from workgauge.machine.stopping import StoppingModel
from workgauge.rehearse.identify.fit import DirectionFit, _Problem, fit_direction
from workgauge.rehearse.identify.log import StepLog
from workgauge.rehearse.identify.model import stop_travel, way
from workgauge.rehearse.identify.programme import LEVELS
from workgauge.rehearse.identify.result import as_json, blocks, identify, stopping_model
from workgauge.rehearse.identify.stops import find_stops
from workgauge.sim.hydraulics import Hydraulics, HydraulicSpec
from workgauge.values.errors import InputError

TICK = 0.01


def drawn(seed: int) -> HydraulicSpec:
    """Return one joint of a machine nobody knows, each direction by itself."""
    rng = np.random.default_rng(seed)

    def two(low: float, high: float) -> np.ndarray:
        return rng.uniform(low, high, (2, 1))

    return HydraulicSpec(two(0.05, 0.5), two(0.05, 0.3), np.exp(two(-0.7, 1.6)), two(0.03, 0.15), two(0.3, 1.0))


def swinging(seed: int) -> HydraulicSpec:
    """Return one joint with a second-order response, as FACTS' ranges have them."""
    rng = np.random.default_rng(seed)
    plain = drawn(seed)
    return replace(
        plain,
        natural_frequency=rng.uniform(6.0, 15.0, (2, 1)),
        damping=np.broadcast_to(rng.uniform(0.4, 0.7), (2, 1)),
    )


def logged(
    spec: HydraulicSpec, seed: int, sigma: float = 5e-4, step: float = 5e-4, levels=LEVELS, closing=1
) -> StepLog:
    """Return the log of a joint without ends that is driven to and fro, with noise and quantisation."""
    joint, rng, q = Hydraulics(spec), np.random.default_rng(seed), 0.3
    valves: list[float] = [0.0] * 50
    for level in levels:
        for sign in (1.0, -1.0):
            ramp = [sign * level * (1 - (i + 1) / closing) for i in range(closing - 1)]
            valves += [sign * level] * 450 + ramp + [0.0] * 450
    positions = []
    for valve in valves:
        positions.append(q)
        q += float(joint.advance(np.array([valve]), dt_s=TICK)[0])
    measured = np.array(positions) + sigma * rng.standard_normal(len(positions))
    measured = np.round(measured / step) * step if step else measured
    t = TICK * np.arange(len(valves))
    return StepLog(Path("log"), ("joint",), (False,), t, measured[:, None], t, np.array(valves)[:, None])


def inside(fit: DirectionFit, spec: HydraulicSpec, side: int) -> dict[str, bool]:
    out = {}
    for name, truth in (
        ("dead_time_s", spec.dead_time_s),
        ("lag_s", spec.lag_s),
        ("deceleration", spec.deceleration),
        ("full_speed", spec.full_speed),
        ("dead_band", spec.dead_band),
    ):
        one = getattr(fit, name)
        out[name] = bool(one.low <= truth[side, 0] <= one.high)
    return out


def held(seed: int) -> list[str]:
    """Return the parameters whose bounds miss the truth in one seeded log."""
    spec = drawn(seed)
    coarse = 1e-3 if seed % 2 else 3e-4
    log, missed = logged(spec, seed, coarse, coarse if seed % 3 else 0.0), []
    for side, direction in ((0, 1), (1, -1)):
        fit = fit_direction(find_stops(log, 0, direction)[0])
        missed += [f"{seed} {side} {name}" for name, fine in inside(fit, spec, side).items() if not fine]
    return missed


def test_the_bounds_hold_the_truth() -> None:
    missed = [name for seed in range(1000, 1006) for name in held(seed)]
    assert not missed


@pytest.mark.prove
def test_the_bounds_hold_the_truth_in_95_of_100_logs() -> None:
    failures = [seed for seed in range(200) if held(seed)]
    assert len(failures) <= 10, failures


def test_the_bounds_say_something() -> None:
    spec = drawn(3)
    for direction in (1, -1):
        fit = fit_direction(find_stops(logged(spec, 3), 0, direction)[0])
        for name in ("dead_time_s", "lag_s"):
            one = getattr(fit, name)
            assert one.high - one.low < 0.03
        assert fit.explained > 0.999 and fit.noise < 8e-4
        assert fit.step == pytest.approx(5e-4)


def conservative(seed: int, spec: HydraulicSpec) -> None:
    """Check that the model to be used stops no earlier than the machine, at speeds in the log and between."""
    (joint,) = identify(logged(spec, seed))
    for index, side in enumerate(joint.sides):
        for share in (0.15, 0.3, 0.5, 0.68, 0.85, 1.0):
            subject, sign = Hydraulics(spec), 1.0 if index == 0 else -1.0
            band = float(spec.dead_band[index, 0])
            subject.advance(np.array([sign * (band + share * (1 - band))]), dt_s=30.0)
            speed, position, most = abs(float(subject.velocity[0])), 0.0, 0.0
            for _ in range(800):
                position += sign * float(subject.advance(np.zeros(1), dt_s=TICK)[0])
                most = max(most, position)
            assert side.guaranteed(speed) >= most
            assert side.guaranteed(speed) <= 2.2 * most + 0.01


@pytest.mark.parametrize("seed", range(3))
def test_a_second_order_machine_stops_within_the_model(seed: int) -> None:
    conservative(seed, swinging(seed))


@pytest.mark.prove
@pytest.mark.parametrize("seed", range(3, 60))
def test_many_second_order_machines_stop_within_the_model(seed: int) -> None:
    conservative(seed, swinging(seed))


def test_a_first_order_machine_stops_within_the_model() -> None:
    conservative(7, drawn(7))


def test_a_lever_that_is_let_go_slowly_is_no_dead_time() -> None:
    spec = drawn(11)
    for side, direction in ((0, 1), (1, -1)):
        fit = fit_direction(find_stops(logged(spec, 11, closing=20), 0, direction)[0])
        assert fit.dead_time_s.value == pytest.approx(spec.dead_time_s[side, 0], abs=0.01)


def test_a_joint_without_a_limit_on_its_deceleration_has_a_bound_below() -> None:
    spec = replace(drawn(5), deceleration=np.full((2, 1), math.inf))
    fit = fit_direction(find_stops(logged(spec, 5), 0, 1)[0])
    assert fit.deceleration.high == math.inf and fit.deceleration.low > 0.5
    assert inside(fit, spec, 0)["dead_time_s"] and inside(fit, spec, 0)["lag_s"]


def test_an_ideal_joint_is_found_ideal() -> None:
    model = StoppingModel.ideal(1)
    log = logged(HydraulicSpec.of(model, np.full((2, 1), 0.6)), 1)
    (joint,) = identify(log)
    for side in joint.sides:
        assert side.fit.dead_time_s.high < 0.02 and side.fit.lag_s.high < 0.02
        assert side.guaranteed(0.6) < 0.02


@settings(max_examples=50, deadline=None)
@given(st.floats(0.1, 1.2), st.floats(0, 0.5), st.floats(0.0, 0.4), st.floats(0.2, 20.0))
def test_the_models_way_is_the_simulated_joints(speed: float, dead: float, lag: float, a: float) -> None:
    model = StoppingModel(*(np.full((2, 1), x) for x in (dead, lag, a, 0.0)))
    joint = Hydraulics(HydraulicSpec.of(model, np.full((2, 1), speed)))
    joint.advance(np.ones(1), dt_s=60.0)
    t, position, slow = TICK * np.arange(200), [0.0], np.empty(200)
    for _ in t[1:]:
        position.append(position[-1] + float(joint.advance(np.zeros(1), dt_s=TICK)[0]))
    way(t, np.zeros(1), np.zeros(1), speed, dead, lag, 1.0 / a, slow)
    assert slow == pytest.approx(np.array(position), abs=1e-7)
    far = np.empty(2)
    way(np.array([0.0, 200.0]), np.zeros(1), np.zeros(1), speed, dead, lag, 1.0 / a, far)
    assert stop_travel(speed, dead, lag, a) == pytest.approx(far[1], abs=1e-9)


@functools.cache
def good() -> StepLog:
    return logged(drawn(3), 3)


def spoiled(**changes) -> StepLog:
    return replace(good(), **changes)


def one(array: np.ndarray, index: int, value: float) -> np.ndarray:
    out = array.copy()
    out[index] = value
    return out


BAD = {
    "nan": (lambda log: {"q": one(log.q, 700, math.nan)}, r"sample 701 at t = 7\.000"),
    "nan valve": (lambda log: {"valve": one(log.valve, 3, math.inf)}, r"valve, sample 4"),
    "back": (lambda log: {"t": one(log.t, 900, 1.0)}, r"forwards.*|sample 901"),
    "gap": (lambda log: {"t": np.where(log.t > 20.0, log.t + 2.0, log.t)}, r"gap of 2\.0"),
    "short": (lambda log: {"t": log.t[:300], "q": log.q[:300]}, r"too short.*2\.99 s"),
    "coarse": (lambda log: {"t": log.t[::20], "q": log.q[::20]}, r"too far apart"),
    "more than full": (lambda log: {"valve": one(log.valve, 800, 1.2)}, r"valve, sample 801"),
}


@pytest.mark.parametrize("kind", BAD)
def test_a_log_that_cannot_be_relied_on_is_refused_with_the_place(kind: str) -> None:
    change, words = BAD[kind]
    with pytest.raises(InputError, match=words):
        spoiled(**change(good())).checked()


def test_a_joint_that_is_not_excited_is_refused() -> None:
    with pytest.raises(InputError, match=r"joint joint, positive direction.*does not excite.*0 stops"):
        identify(spoiled(valve=np.zeros_like(good().valve)))
    with pytest.raises(InputError, match=r"negative direction.*does not excite"):
        identify(spoiled(valve=np.maximum(good().valve, 0.0)))
    with pytest.raises(InputError, match=r"from 1 lever positions"):
        identify(logged(drawn(3), 3, levels=(0.8, 0.8, 0.8, 0.8)))
    with pytest.raises(InputError, match=r"positive direction"):
        identify(spoiled(q=np.full_like(good().q, 0.2)))
    with pytest.raises(InputError, match=r"no such joint"):
        identify(good(), joints=["boom"])


def test_a_stop_at_the_joints_end_is_left_out() -> None:
    stops, left_out = find_stops(good(), 0, 1, (-9.0, float(good().q.max()) + 0.005))
    assert len(left_out) == 1 and "end" in left_out[0] and len(stops) == len(LEVELS) - 1
    assert find_stops(good(), 0, -1, (-9.0, 9.0))[1] == []


def test_the_model_covers_its_bounds_and_every_stop() -> None:
    (joint,) = identify(good())
    model, slow = stopping_model([joint]), stopping_model([joint]).slowest()
    for index, side in enumerate(joint.sides):
        assert side.tolerance >= 0.2
        assert slow.dead_time_s[index, 0] >= side.fit.dead_time_s.high
        assert slow.lag_s[index, 0] >= side.fit.lag_s.high
        assert slow.deceleration[index, 0] <= side.fit.deceleration.low
        assert model.tolerance[index, 0] == side.tolerance
        for speed, travel in zip(side.fit.speeds, side.fit.travels, strict=True):
            assert side.guaranteed(speed) >= travel


def test_the_blocks_are_a_machine_files() -> None:
    (joint,) = identify(good())
    written = blocks([joint], "log of today")["joints"][0]
    content = {
        "title": "arm",
        "undercarriage": {"kind": "tracks", "gauge_m": 2.0},
        "joints": [
            {
                "type": "revolute",
                "continuous": True,
                "home_deg": 0,
                "dh": {"a_m": 3, "alpha_deg": 0, "d_m": 0},
                "speed_positive_deg_s": 30,
                "speed_negative_deg_s": 25,
                **written,
            }
        ],
        "solids": [{"name": "boom", "link": "joint", "centre_m": [-1.5, 0, 0], "size_m": [3, 0.5, 0.5]}],
        "attachments": [{"name": "none", "tool": {}}],
    }
    read, found = StoppingModel.of(machine_from(content)), stopping_model([joint])
    assert read.dead_time_s == pytest.approx(found.dead_time_s, abs=1.1e-4)
    assert (read.dead_time_s >= found.dead_time_s - 1e-12).all() and (read.lag_s >= found.lag_s - 1e-12).all()
    assert (read.deceleration <= found.deceleration + 1e-12).all()
    assert read.deceleration == pytest.approx(found.deceleration, abs=1e-5)
    assert (read.tolerance >= found.tolerance - 1e-9).all()


def test_the_object_is_json_and_a_log_of_another_machine_is_refused() -> None:
    import json

    (joint,) = identify(good())
    data = as_json([joint])
    json.dumps(data, allow_nan=False)
    rows = data["joints"][0]["positive"]["table"]
    assert [row["speed_deg_s"] for row in rows] == sorted(row["speed_deg_s"] for row in rows) and len(rows) == 4
    assert all(row["guaranteed_deg"] > row["expected_deg"] > 0 for row in rows)
    with pytest.raises(InputError, match="another machine"):
        identify(good(), load_machine("rre20"))


def test_the_reduced_problem_is_the_same_least_squares_problem() -> None:
    stops, _ = find_stops(logged(drawn(4), 4), 0, 1)
    problem = _Problem(stops, 0.02)
    rng = np.random.default_rng(4)
    for _ in range(5):
        p = np.concatenate([rng.uniform(0.05, 0.5, 2), rng.uniform(0.2, 2.0, 1), rng.uniform(0.1, 1.0, len(stops))])
        f, J = problem.reduced(p)
        r, whole = problem.residuals(p), problem.jacobian(p)
        assert len(f) <= 5 * len(stops) < len(r)
        assert f @ f == pytest.approx(r @ r, rel=1e-9)
        assert J.T @ f == pytest.approx(whole.T @ r, rel=1e-7, abs=1e-9 * np.abs(whole.T @ r).max())
        squares = whole.T @ whole
        assert np.allclose(J.T @ J, squares, rtol=1e-7, atol=1e-9 * float(squares.max()))
