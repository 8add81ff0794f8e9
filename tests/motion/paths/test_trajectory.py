"""Trajectories: one time, many times and each joint at its own time say the same."""

import functools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.machine.load import load_machine
from workgauge.motion.paths.timing import timed_joints
from workgauge.motion.paths.trajectory import Trajectory
from workgauge.values.errors import InputError


@functools.cache
def motion() -> Trajectory:
    """Return a motion of the shipped machine through three postures."""
    machine = load_machine("rre20")
    way = np.array([machine.home, machine.home, machine.home])
    way[1] += 0.2 * np.sin(np.arange(machine.n) + 1.0)
    way[2] += 0.3 * np.cos(2.0 * np.arange(machine.n))
    return timed_joints(np.clip(way, machine.q_min, machine.q_max), machine)


TIMES = st.floats(-1.0, 20.0)


@settings(max_examples=60, deadline=None)
@given(TIMES)
def test_one_time_as_many(t: float) -> None:
    q, qdot, s = motion().at(t)
    many = motion().many([t])
    assert q == pytest.approx(many[0][0], abs=1e-12)
    assert qdot == pytest.approx(many[1][0], abs=1e-12)
    assert s == pytest.approx(float(many[2][0]), abs=1e-12)


@settings(max_examples=60, deadline=None)
@given(st.lists(TIMES, min_size=12, max_size=12))
def test_each_joint_at_its_own_time(times: list[float]) -> None:
    t, t_speed = np.array(times[:6]), np.array(times[6:])
    q, qdot = motion().each(t, t_speed)
    for j in range(6):
        assert q[j] == pytest.approx(motion().at(float(t[j]))[0][j], abs=1e-12)
        assert qdot[j] == pytest.approx(motion().at(float(t_speed[j]))[1][j], abs=1e-12)


def test_at_its_knots_and_beyond_its_ends() -> None:
    found = motion()
    for k, t in enumerate(found.times.tolist()):
        q, qdot, s = found.at(t)
        assert q == pytest.approx(found.q[k], abs=1e-12)
        assert qdot == pytest.approx(found.qdot[k], abs=1e-9)
        assert s == pytest.approx(float(found.s[k]), abs=1e-12)
    for t, k in ((-1.0, 0), (found.duration_s + 1.0, -1)):
        assert found.at(t)[0] == pytest.approx(found.q[k]) and not found.at(t)[1].any()


def test_speeds_are_the_slopes_of_positions() -> None:
    found, h = motion(), 1e-6
    for t in np.linspace(0.01, found.duration_s - 0.01, 23).tolist():
        slope = (found.at(t + h)[0] - found.at(t - h)[0]) / (2.0 * h)
        assert found.at(t)[1] == pytest.approx(slope, abs=1e-4)


def test_no_time_at_all() -> None:
    for ask in (motion().at, lambda t: motion().each(np.full(6, t), np.zeros(6)), lambda t: motion().many([t])):
        with pytest.raises(InputError):
            ask(float("nan"))
