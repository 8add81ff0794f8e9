"""Boxes, convex solids and links against a slow independent distance, and the laws a signed distance obeys."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

ACCURACY_M = 2e-6

angles = st.one_of(st.just(0.0), st.floats(-3.2, 3.2), st.floats(-1e-4, 1e-4), st.sampled_from([np.pi / 2, 1e-8]))
turns = st.tuples(angles, angles, angles)
small = st.floats(-2.0, 2.0)
places = st.tuples(small, small, small)
sizes = st.tuples(*[st.one_of(st.floats(0.05, 2.0), st.sampled_from([0.05, 10.0]))] * 3)


def seeds():
    return st.integers(0, 2**32 - 1)


@st.composite
def box_pairs(draw):
    """Two boxes: anywhere, or parallel and about to touch."""
    turn, half, other_half = draw(turns), np.array(draw(sizes)), np.array(draw(sizes))
    if draw(st.booleans()):
        gap = draw(st.sampled_from([0.0, 1e-9, -1e-9, 1e-6, -1e-6, 1e-3, -1e-3, 0.3, -0.05]))
        shift = np.array(draw(places))
        axis = draw(st.integers(0, 2))
        shift[axis] = half[axis] + other_half[axis] + gap
        tilt = np.array(draw(st.sampled_from([(0.0, 0.0, 0.0), (1e-9, 0, 0), (0, 1e-6, 0), (0, 0, 3e-4)])))
        return (turn, half), (tuple(np.array(turn) + tilt), other_half), shift
    return (turn, half), (draw(turns), other_half), np.array(draw(places)) * (half.max() + other_half.max())


def check_row(clearance, first, second, expected):
    """Check one clearance of vertex sets first (machine) and second (limit)."""
    assert clearance.distance_m == pytest.approx(expected, abs=ACCURACY_M)
    assert np.linalg.norm(clearance.normal) == pytest.approx(1.0, abs=1e-9)
    apart = clearance.point_machine - clearance.point_limit
    assert_allclose(apart, clearance.distance_m * clearance.normal, atol=1e-9)
    assert gap_along(clearance.normal, first, second) == pytest.approx(expected, abs=slack(expected))


def gap_along(normal, first, second):
    """How far apart the solids are along a direction: the normal's certificate is that this is the distance."""
    return (first @ normal).min() - (second @ normal).max()


def slack(distance):
    """The distance is exact; the direction between nearly parallel faces good to 0.01 mrad, 0.1 mrad at contact."""
    return 5e-5 if abs(distance) > 1e-5 else 1e-3


@given(box_pairs(), turns)
@settings(max_examples=300, deadline=None)
def test_boxes_against_minkowski_hull(make, pair, frame):
    (turn, half), (other_turn, other_half), shift = pair
    base = make.pose(turn, (0.0, 0.0, 0.0))[:3, :3]
    world = make.pose(frame, (100.0, -2000.0, 3.0))
    first = make.box(turn, base @ shift, half)
    second = make.box(other_turn, (0.0, 0.0, 0.0), other_half)
    expected = make.signed_distance(first.vertices, second.vertices)
    moved = [type(b)(world @ b.T_frame_box, b.half_extents) for b in (first, second)]
    [clearance] = make.ask([moved[1]], [moved[0]])
    check_row(clearance, moved[0].vertices, moved[1].vertices, expected)


@given(seeds(), turns, sizes, st.floats(0.0, 1.6))
@settings(max_examples=150, deadline=None)
def test_convex_solids_against_minkowski_hull(make, seed, turn, half, reach):
    rng = np.random.default_rng(seed)
    solid = make.hull(rng.normal(size=(rng.integers(4, 14), 3)) * rng.uniform(0.2, 3.0, 3))
    direction = rng.normal(size=3)
    direction *= reach * (np.linalg.norm(half) + 2.0) / np.linalg.norm(direction)
    first = make.box(turn, direction, half)
    [clearance] = make.ask([solid], [first])
    check_row(clearance, first.vertices, solid.vertices, make.signed_distance(first.vertices, solid.vertices))


@given(box_pairs())
@settings(max_examples=100, deadline=None)
def test_swapping_the_roles_changes_only_the_sign_of_the_normal(make, pair):
    (turn, half), (other_turn, other_half), shift = pair
    first, second = make.box(turn, shift, half), make.box(other_turn, (0, 0, 0), other_half)
    [there], [back] = make.ask([second], [first]), make.ask([first], [second])
    assert there.distance_m == pytest.approx(back.distance_m, abs=ACCURACY_M)
    # both are certificates of the same gap; with one nearest direction they are opposite
    gap = gap_along(-back.normal, first.vertices, second.vertices)
    assert gap == pytest.approx(there.distance_m, abs=slack(there.distance_m))


@given(box_pairs(), seeds(), st.sampled_from([1e-4, 0.01, 0.3, 3.0]))
@settings(max_examples=200, deadline=None)
def test_the_normal_is_a_subgradient_inside_and_outside(make, pair, seed, step):
    """The signed distance of convex solids is convex in their offset and changes no faster than they move."""
    (turn, half), (other_turn, other_half), shift = pair
    move = np.random.default_rng(seed).normal(size=3)
    move *= step / np.linalg.norm(move)
    second = make.box(other_turn, (0, 0, 0), other_half)
    [here] = make.ask([second], [make.box(turn, shift, half)])
    [there] = make.ask([second], [make.box(turn, shift + move, half)])
    error = 2 * ACCURACY_M + step * (1e-5 if abs(here.distance_m) > 1e-5 else 1e-3)
    assert there.distance_m >= here.distance_m + here.normal @ move - error
    assert abs(there.distance_m - here.distance_m) <= step + 2 * ACCURACY_M


def test_large_thin_plates_face_to_face(make):
    """20 m by 0.1 m plates: parallel, tilted by a hair, touching, and crossed."""
    plate = (10.0, 10.0, 0.05)
    for tilt in (0.0, 1e-12, 1e-9, 1e-6, 1e-4):
        for gap in (0.0, 1e-9, 1e-7, 1e-4, 0.2, 5.0):
            upper = make.box((tilt, 0.0, 0.0), (3.0, 2.0, 0.1 + gap + 10.0 * np.sin(tilt)), plate)
            lower = make.box((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), plate)
            [found] = make.ask([lower], [upper])
            expected = make.signed_distance(upper.vertices, lower.vertices)
            assert found.distance_m == pytest.approx(expected, abs=ACCURACY_M)
            if gap > 1e-5:
                assert found.normal[2] > 0.999
    [crossed] = make.ask([make.box((0, 0, 0), (0, 0, 0), plate)], [make.box((np.pi / 2, 0, 0), (0, 0, 9.95), plate)])
    assert crossed.distance_m == pytest.approx(-0.1, abs=ACCURACY_M)
    assert_allclose(crossed.normal, (0, 0, 1), atol=1e-6)


def test_boxes_a_nanometre_apart_are_not_deep_inside(make):
    """GJK alone names the far face here now and then: a way out of 4 m for a gap of 1 nm."""
    rng = np.random.default_rng(1)
    for _ in range(1500):
        half, other = rng.integers(1, 5, 3) / 2.0, rng.integers(1, 5, 3) / 2.0
        hair = rng.choice([0, 0, 1, -1], 3) * 10.0 ** rng.integers(-12, -5, 3)
        shift = rng.integers(-4, 5, 3) / 2.0 + hair
        gaps = np.abs(shift) - half - other
        expected = gaps.max() if gaps.max() < 0 else np.linalg.norm(np.maximum(gaps, 0.0))
        [found] = make.ask([make.box((0, 0, 0), (0, 0, 0), other)], [make.box((0, 0, 0), shift, half)])
        assert found.distance_m == pytest.approx(expected, abs=ACCURACY_M)


def test_contact_points_lie_where_the_faces_overlap(make):
    """A small box 5 cm deep in a large face: the points are its own face's middle, not a far corner."""
    large = make.box((0, 0, 0), (0, 0, 0), (10.0, 10.0, 1.0))
    [found] = make.ask([large], [make.box((0, 0, 0), (4.0, -3.0, 1.45), (0.2, 0.3, 0.5))])
    assert_allclose(found.point_machine, (4.0, -3.0, 0.95), atol=1e-9)
    assert_allclose(found.point_limit, (4.0, -3.0, 1.0), atol=1e-9)
    [edge] = make.ask([large], [make.box((np.pi / 4, 0, 0), (4.0, -3.0, 1.3), (0.2, 0.3, 0.3))])
    assert_allclose(edge.point_machine, (4.0, -3.0, 1.3 - 0.3 * np.sqrt(2)), atol=1e-9)


def test_corner_edge_and_face_contact(make):
    unit = make.box((0, 0, 0), (0, 0, 0), (1, 1, 1))
    for position, expected in (
        ((2.5, 0.3, 0.2), 0.5),
        ((2.3, 2.4, 0.0), 0.5),
        ((2.2, 2.2, 2.1), 0.3),
        ((2.0, 0.0, 0.0), 0.0),
        ((1.75, 0.1, 0.2), -0.25),
        ((0.0, 0.0, 1.9), -0.1),
    ):
        [found] = make.ask([unit], [make.box((0, 0, 0), position, (1, 1, 1))])
        assert found.distance_m == pytest.approx(expected, abs=1e-9)


@given(seeds())
@settings(max_examples=60, deadline=None)
def test_links_against_each_other(make, seed):
    rng = np.random.default_rng(seed)
    boxes = [make.box(rng.normal(size=3), rng.normal(size=3) * 3, rng.uniform(0.1, 2.0, 3)) for _ in range(4)]
    pairs = ((0, 2), (0, 3), (3, 1))
    found = make.ask([], boxes, self_pairs=pairs)
    assert [(c.link, c.limit) for c in found] == [
        ("link2", "self:link0"),
        ("link3", "self:link0"),
        ("link3", "self:link1"),
    ]
    assert found.other_links.tolist() == [0, 0, 1]
    assert found.cells.tolist() == [-1, -1, -1]
    for clearance, other in zip(found, found.other_links, strict=True):
        first, second = boxes[int(clearance.link[-1])].vertices, boxes[other].vertices
        check_row(clearance, first, second, make.signed_distance(first, second))
