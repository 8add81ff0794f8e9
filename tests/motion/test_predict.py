"""Where joints will be when a command begins to act, against a simulation tick by tick."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.machine.load import load_machine
from workgauge.machine.parts import Stopping
from workgauge.motion.predict import InFlight, Lateness, settles_s

DT = 0.02


def machine_with(dead, lag):
    machine = load_machine("rre20")
    stopping = tuple(Stopping(float(d), float(t), 1e9, 0.0) for d, t in zip(dead, lag, strict=True))
    return replace(machine, stopping_positive=stopping, stopping_negative=stopping)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_the_posture_ahead_is_the_one_a_simulation_comes_to(seed):
    rng = np.random.default_rng(seed)
    dead = DT * rng.integers(0, 30, 6)
    lag = np.where(rng.random(6) < 0.3, 0.0, rng.uniform(0.05, 0.5, 6))
    late = Lateness.of(machine_with(dead, lag), DT)
    flight = InFlight()
    q, v = rng.normal(size=6), np.zeros(6)
    line = [np.zeros(6)] * 40
    for _ in range(60):
        sent = rng.normal(size=6)
        flight = flight.after(sent, late)
        line.append(sent)
        delayed = np.array([line[-1 - round(d / DT)][j] for j, d in enumerate(dead)])
        a = np.where(lag > 0.0, np.exp(-DT / np.maximum(lag, 1e-9)), 0.0)
        v = a * v + (1.0 - a) * delayed
        q = q + DT * v
    assert flight.speeds == pytest.approx(v, abs=1e-12)
    there, speeds = flight.ahead(q, late)
    for j in range(6):
        at, speed, count = q[j], v[j], round(dead[j] / DT)
        for i in range(count):
            a = np.exp(-DT / lag[j]) if lag[j] > 0.0 else 0.0
            speed = a * speed + (1.0 - a) * line[len(line) - count + i][j]
            at += DT * speed
        assert there[j] == pytest.approx(at, abs=1e-9) and speeds[j] == pytest.approx(speed, abs=1e-9)


def test_an_ideal_machine_is_where_it_is():
    machine = machine_with(np.zeros(6), np.zeros(6))
    late = Lateness.of(machine, DT)
    flight = InFlight().after(np.ones(6), late)
    q = np.arange(6.0)
    there, speeds = flight.ahead(q, late)
    assert np.array_equal(there, q) and np.array_equal(speeds, np.ones(6))
    assert settles_s(machine) == 0.0 and settles_s(load_machine("rre20")) > 0.2
