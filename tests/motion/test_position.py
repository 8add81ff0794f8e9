"""The tool's position rates, compiled, against the damped inverse by singular values."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from workgauge.machine.load import load_machine
from workgauge.motion.desired import MotionConfig, tool_rates
from workgauge.motion.inverse import Damping, damped_inverse
from workgauge.motion.position import position_rates


@functools.cache
def machine(name):
    return load_machine(name)


@given(st.integers(0, 2**32 - 1), st.sampled_from(["rre20", "brokk5"]), st.sampled_from([0.0, 0.02, 0.2, 2.0]))
@settings(max_examples=150, deadline=None)
def test_they_are_the_damped_inverse(seed, name, threshold):
    rng = np.random.default_rng(seed)
    one = machine(name)
    q = one.sample_min + rng.uniform(size=one.n) * (one.sample_max - one.sample_min)
    kin, damping = one.forward(q), Damping(threshold=max(threshold, 1e-9), largest=0.1)
    rates = tool_rates(one, kin, replace(MotionConfig(), damping=damping))
    wanted = damped_inverse(one.tool_jacobian(kin)[:3], damping).T
    assert_allclose(rates, wanted, atol=1e-9 * max(1.0, np.abs(wanted).max()))


@given(st.integers(0, 2**32 - 1), st.sampled_from([1.0, 1e-2, 1e-5, 1e-9, 0.0]), st.integers(3, 7))
@settings(max_examples=200, deadline=None)
def test_near_and_at_a_singularity_too_or_they_say_that_they_are_not_sure(seed, weak, n):
    """Position Jacobians with a chosen smallest singular value, of joints that slide along their columns."""
    rng = np.random.default_rng(seed)
    U, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    V, _ = np.linalg.qr(rng.normal(size=(n, 3)))
    J = U * (rng.uniform(1.0, 9.0), rng.choice([1.0, weak]), weak) @ V.T
    spatial = np.concatenate([J, np.zeros((3, n))])
    for largest in (0.1, 0.0):
        rates, sure = position_rates(np.eye(4)[None], np.eye(4), spatial, 0.2, largest)
        assert sure == (weak >= 1e-2 or largest > 0.0)
        if sure:
            wanted = damped_inverse(J, Damping(0.2, largest)).T
            assert_allclose(rates, wanted, atol=1e-9 * max(1.0, np.abs(wanted).max()))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_none_are_not_sure(bad):
    spatial = np.ones((6, 4))
    spatial[0, 1] = bad
    assert not position_rates(np.eye(4)[None], np.eye(4), spatial, 0.2, 0.1)[1]
