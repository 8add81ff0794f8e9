"""Lines in plan: side by side, as a fan, beside an alignment, and what lies within reach."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.site.surface.lines import beside, fan, side_by_side, towards, within_ring
from workgauge.values.errors import InputError


@given(yaw=st.floats(-7, 7), near=st.floats(0, 5), more=st.floats(0.1, 8), n=st.integers(1, 9), gap=st.floats(0.1, 3))
def test_lines_are_parallel_spaced_and_run_from_far_to_near(yaw, near, more, n, gap):
    centre = np.array([25_486_800.0, 6_714_300.0])
    lines = np.array(side_by_side(centre, yaw, near, near + more, n, gap))
    forward, left = np.array([math.cos(yaw), math.sin(yaw)]), np.array([-math.sin(yaw), math.cos(yaw)])
    assert (lines[:, 1] - lines[:, 0]) == pytest.approx(np.tile(-more * forward, (n, 1)), abs=1e-6)
    offsets = (lines[:, 0] - centre) @ left
    assert np.sort(offsets) == pytest.approx((np.arange(n) - (n - 1) / 2) * gap, abs=1e-6)
    assert abs(offsets[0]) == pytest.approx(np.abs(offsets).min(), abs=1e-6)
    if n == 3:
        assert offsets == pytest.approx([0.0, -gap, gap], abs=1e-6)  # L1, L2 to the right, L3 to the left


def test_a_fan_points_at_the_swing_axis():
    for line, yaw in zip(fan([3.0, 4.0], [0.0, 1.0, -2.0], 2.0, 7.0), [0.0, 1.0, -2.0], strict=True):
        assert np.linalg.norm(line - [3.0, 4.0], axis=1) == pytest.approx([7.0, 2.0])
        assert math.atan2(*(line[0] - [3.0, 4.0])[::-1]) == pytest.approx(yaw)


@pytest.mark.parametrize("offset", [-3.0, 0.0, 2.5])
def test_beside_an_alignment_chords_stay_within_a_millimetre(tools, offset):
    track = tools.build(tools.track())
    line = beside(track, offset, 100.0, 700.0)
    middles = 0.5 * (line[1:] + line[:-1])
    _, found = track.project(middles)
    assert np.abs(found - offset).max() < 1.2e-3
    distance, at = track.project(line)
    assert at == pytest.approx(offset, abs=1e-4)
    assert distance[0] == pytest.approx(100.0, abs=1e-3) and distance[-1] == pytest.approx(700.0, abs=1e-3)
    with pytest.raises(InputError, match="nothing of the alignment"):
        beside(track, 1.0, 5000.0, 5100.0)


@settings(max_examples=80, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_within_a_ring_is_what_samples_say(seed):
    rng = np.random.default_rng(seed)
    line = rng.uniform(-10, 10, (int(rng.integers(2, 6)), 2))
    centre, near, far = rng.uniform(-3, 3, 2), 2.0, 7.0
    parts = within_ring(line, centre, near, far)
    for part in parts:
        t = np.linspace(1e-6, 1 - 1e-6, 200)
        dense = np.concatenate([a + np.outer(t, b - a) for a, b in itertools.pairwise(part)])
        r = np.linalg.norm(dense - centre, axis=1)
        assert r.min() >= near - 1e-6 and r.max() <= far + 1e-6
    t = np.linspace(0, 1, 2001)
    dense = np.concatenate([a + np.outer(t, b - a) for a, b in itertools.pairwise(line)])
    inside = np.abs(np.linalg.norm(dense - centre, axis=1) - 4.5) <= 2.5
    step = np.repeat(np.linalg.norm(np.diff(line, axis=0), axis=1) / 2000, 2001)
    length = sum(float(np.linalg.norm(np.diff(part, axis=0), axis=1).sum()) for part in parts)
    assert length == pytest.approx(float(step[inside].sum()), abs=0.15)


def test_towards_and_what_is_refused():
    line = np.array([[0.0, 1.0], [0.0, 5.0]])
    assert towards(line, [0, 0]).tolist() == [[0, 5], [0, 1]]
    assert towards(line, [0, 9]).tolist() == line.tolist()
    for wrong in ({"nearest_m": 5.0, "farthest_m": 5.0}, {"count": 0}, {"spacing_m": 0.0}, {"nearest_m": -1.0}):
        with pytest.raises(InputError):
            side_by_side([0, 0], 0.0, **{"nearest_m": 2.0, "farthest_m": 7.0, **wrong})


def test_the_first_of_two_beside_the_middle_is_to_the_right():
    middle, right, left = side_by_side([0.0, 0.0], 0.0, 3.0, 6.0, 3, 1.0)
    assert middle[:, 1].tolist() == [0.0, 0.0] and right[:, 1].tolist() == [-1.0, -1.0] and left[0, 1] == 1.0
