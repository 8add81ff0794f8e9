"""Separating planes against coal, the theorem of separating axes and hulls of Minkowski differences."""

import coal
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from workgauge.proximity.cells import CORNER_SIGNS
from workgauge.proximity.separation import lowest, separating

seeds = st.integers(0, 2**32 - 1)


def proven(u, first, second):
    """What direction u proves of the distance of two vertex sets."""
    return float((first @ u).min() - (second @ u).max())


def asked(first, second, start=None):
    """(distance it says, direction); the start is any unit vector."""
    out = np.empty(3)
    if start is None:
        start = first.mean(axis=0) - second.mean(axis=0)
        length = np.linalg.norm(start)
        start = start / length if length > 1e-9 else np.array([0.0, 0.0, 1.0])
    said = separating(np.ascontiguousarray(first), np.ascontiguousarray(second), start, out)
    return said, out


def hold(first, second, reference, close, start=None):
    """The laws of every answer: a unit direction that proves what is said; and the distance, if there is one."""
    said, u = asked(first, second, start)
    size = 1.0 + max(np.abs(first).max(), np.abs(second).max())
    assert abs(np.linalg.norm(u) - 1.0) < 1e-9
    if said > 0.0:
        assert proven(u, first, second) == pytest.approx(said, abs=1e-12 * size)
    assert said <= reference + close
    if reference > close:
        assert proven(u, first, second) >= reference - close
    else:
        assert said <= close


def box(rng, middle, scale=1.0):
    """(rotation, half extents, centre, corners) of a random box, thin and long ones among them."""
    R = Rotation.random(random_state=rng).as_matrix()
    half = scale * rng.uniform(0.05, 2.0, 3) * rng.choice([1.0, 0.05], 3)
    return R, half, middle, CORNER_SIGNS * half @ R.T + middle


def between(first, second):
    """Signed distance of two boxes by coal."""
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    shapes = [(coal.Box(*(2.0 * half)), coal.Transform3s(R, centre)) for R, half, centre, _ in (first, second)]
    return coal.distance(*shapes[0], *shapes[1], request, result)


def best_axis(first, second):
    """The largest gap along the axes of two boxes and their cross products."""
    axes = [*first[0].T, *second[0].T, *(np.cross(a, b) for a in first[0].T for b in second[0].T)]
    units = [axis / np.linalg.norm(axis) for axis in axes if np.linalg.norm(axis) > 1e-9]
    return max(proven(side * u, first[3], second[3]) for u in units for side in (1.0, -1.0))


@settings(max_examples=40, deadline=None)
@given(seed=seeds)
def test_boxes_are_as_far_apart_as_coal_and_the_separating_axes_say(seed):
    rng = np.random.default_rng(seed)
    for _ in range(10):
        first, second = box(rng, rng.normal(size=3) * 3.0), box(rng, rng.normal(size=3) * 3.0)
        distance = between(first, second)
        said, _ = asked(first[3], second[3])
        assert (said > 1e-6) == (best_axis(first, second) > 1e-6)
        hold(first[3], second[3], max(distance, 0.0), 2e-5)


@settings(max_examples=60, deadline=None)
@given(seed=seeds)
def test_polytopes_and_segments_against_the_hull_of_their_difference(make, seed):
    rng = np.random.default_rng(seed)
    flat = rng.choice([1.0, 1e-3], 3)
    first = rng.normal(size=(int(rng.integers(4, 20)), 3)) * flat + rng.normal(size=3) * 2.0
    second = rng.normal(size=(int(rng.integers(4, 30)), 3)) + rng.normal(size=3) * 2.0
    hold(first, second, max(make.signed_distance(first, second), 0.0), 1e-6)
    # a segment, as a tube's axis is: of the difference with a box, whose hull is never flat
    segment = rng.normal(size=(2, 3)) * 3.0
    solid = box(rng, rng.normal(size=3) * 3.0)[3]
    hold(solid, segment, max(make.signed_distance(solid, segment), 0.0), 1e-6)
    # and a single point
    hold(solid, segment[:1], max(make.signed_distance(solid, segment[:1]), 0.0), 1e-6)


@settings(max_examples=40, deadline=None)
@given(seed=seeds, shift=st.sampled_from([0.0, 0.25, 5000.0]))
def test_ties_of_boxes_along_the_axes(seed, shift):
    rng = np.random.default_rng(seed)
    for _ in range(20):
        halves, centres = 0.5 * rng.integers(1, 5, (2, 3)), 0.5 * rng.integers(-6, 7, (2, 3)) + shift
        first, second = (CORNER_SIGNS * half + centre for half, centre in zip(halves, centres, strict=True))
        gap = np.maximum(np.abs(centres[0] - centres[1]) - halves.sum(axis=0), 0.0)
        start = np.eye(3)[rng.integers(3)] * rng.choice([-1.0, 1.0])
        hold(first, second, float(np.linalg.norm(gap)), 1e-6, start if rng.random() < 0.5 else None)


@settings(max_examples=40, deadline=None)
@given(seed=seeds, tilt=st.sampled_from([0.0, 1e-12, 1e-9, 1e-6, 1e-4]), gap=st.sampled_from([1e-3, 0.2, 3.0]))
def test_nearly_parallel_faces(seed, tilt, gap):
    rng = np.random.default_rng(seed)
    R = Rotation.random(random_state=rng).as_matrix()
    place = rng.normal(size=3) * rng.choice([1.0, 1e3])
    halves = rng.uniform(0.3, 3.0, (2, 3))
    first = CORNER_SIGNS * halves[0] @ Rotation.from_rotvec(rng.normal(size=3) * tilt).as_matrix().T
    second = CORNER_SIGNS * halves[1]
    aside = rng.uniform(-1.0, 1.0, 2) * (halves[0, :2] + halves[1, :2]) * 0.8
    first = first + np.array([*aside, halves[0, 2] + halves[1, 2] + gap + 10.0 * tilt])
    faces = float(first[:, 2].min() - second[:, 2].max())  # they overlap across: the faces' own direction is the best
    hold(first @ R.T + place, second @ R.T + place, faces, 1e-6 + 10.0 * tilt)


@settings(max_examples=40, deadline=None)
@given(seed=seeds, size=st.sampled_from([1e-3, 1e-2, 1.0, 1e2, 1e3]), away=st.sampled_from([0.0, 500.0, 5000.0]))
def test_tiny_and_huge_bodies_near_and_far_from_the_origin(seed, size, away):
    rng = np.random.default_rng(seed)
    offset = rng.normal(size=3)
    offset *= away / np.linalg.norm(offset)
    first, second = box(rng, rng.normal(size=3) * size * 2.0 + offset, size), box(rng, offset + 0.0, size)
    distance = max(best_axis(first, second), 0.0)
    said, u = asked(first[3], second[3])
    close = 1e-5 * size + 1e-9 * away
    exact = between(
        (*first[:2], first[2] - offset, first[3] - offset), (*second[:2], second[2] - offset, second[3] - offset)
    )
    assert proven(u, first[3], second[3]) <= max(exact, 0.0) + close + 1e-5
    assert distance <= max(exact, 0.0) + close + 1e-5
    if exact > close + 1e-5:
        assert proven(u, first[3], second[3]) >= exact - close - 1e-5
        assert said >= exact - close - 1e-5


@settings(max_examples=40, deadline=None)
@given(seed=seeds)
def test_bodies_that_overlap_are_never_said_to_be_apart(seed):
    rng = np.random.default_rng(seed)
    for _ in range(20):
        first, second = box(rng, rng.normal(size=3)), box(rng, np.zeros(3))
        weights = rng.dirichlet(np.ones(8), 2)
        first_shared = first[3] - weights[0] @ first[3] + weights[1] @ second[3]  # they share a point
        said, u = asked(first_shared, second[3])
        assert said <= 1e-9
        assert proven(u, first_shared, second[3]) <= 1e-9


def test_the_lowest_corner_is_the_first_of_the_least():
    points = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0], [0.0, 2.0, 0.0]])
    assert lowest(points, 0.0, 1.0, 0.0) == 0
    assert lowest(points, 0.0, -1.0, 0.0) == 1
    assert lowest(points, 0.0, 0.0, -1.0) == 2
