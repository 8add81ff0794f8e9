"""Chains of prisms and tubes: one solid outside, the union's cross-section inside."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from workgauge.values.solids import PrismChain, Tube

ENVELOPE = ((-1.9, 0.4), (1.9, 0.4), (1.9, 3.2), (1.0, 4.3), (-1.0, 4.3), (-1.9, 3.2))
CELL_M = 2.5
seeds = st.integers(0, 2**32 - 1)


def curve(radius, cells=40, gradient=0.0):
    """Points along an arc that turns left, or a straight line for an infinite radius, starting at the origin."""
    s = np.arange(cells + 1) * CELL_M
    if np.isinf(radius):
        return np.stack([s, 0 * s, gradient * s], axis=1)
    return np.stack([radius * np.sin(s / radius), radius * (1 - np.cos(s / radius)), gradient * s], axis=1)


def reaching(chain, reach):
    """The same chain with every cell reaching past its shared faces, as along a curve the outer side needs."""
    along = (chain.ends - chain.starts) / CELL_M
    joined = chain.neighbours
    return PrismChain(
        chain.starts - along * (reach * joined[:, :1]), chain.ends + along * (reach * joined[:, 1:]),
        chain.laterals, chain.sections, chain.chainages, joined,
    )  # fmt: skip


def section_depth(points):
    """Depth of points (left, up) inside the envelope, across its nearest side."""
    section = np.array(ENVELOPE)
    along = np.roll(section, -1, axis=0) - section
    inward = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]
    return np.min(np.einsum("kj,pkj->pk", inward, points[:, None] - section), axis=1)


def place_on(radius, s, offset, up):
    if np.isinf(radius):
        return np.array([s, offset, up]), 0.0
    angle, r = s / radius, radius - offset
    return np.array([r * np.sin(angle), radius - r * np.cos(angle), up]), angle


@pytest.mark.parametrize("radius", [np.inf, 600.0, 250.0])
def test_there_is_no_way_out_along_the_track(make, radius):
    """A point 0.8 m deep, anywhere along consecutive 2.5 m cells; with a box for each cell 46 % of places fail."""
    chain = reaching(make.chain_along(curve(radius), ENVELOPE), 0.03)
    for s in np.arange(5.0, 95.0, 0.373):
        centre, angle = place_on(radius, s, -1.1, 1.8)
        [found] = make.ask([chain], [make.box((0, 0, angle), centre, (0.005, 0.005, 0.005))])
        assert -0.83 < found.distance_m <= -0.8
        across = np.array([np.sin(angle), -np.cos(angle), 0.0])
        assert found.normal @ across > 0.9999
        assert_allclose(found.point_machine - found.point_limit, found.distance_m * found.normal, atol=1e-9)


@given(seeds)
@settings(max_examples=150, deadline=None)
def test_outside_a_chain_is_its_nearest_cell(make, seed):
    rng = np.random.default_rng(seed)
    radius = rng.choice([np.inf, 300.0])
    chain = make.chain_along(curve(radius, 8, rng.choice([0.0, 0.03])), ENVELOPE)
    solid = make.box(rng.normal(size=3), rng.uniform((-5, -8, -2), (25, 8, 9)), rng.uniform(0.05, 2.0, 3))
    [found] = make.ask([chain], [solid])
    each = [make.signed_distance(solid.vertices, chain.cell_vertices(i)) for i in range(len(chain))]
    if min(each) > 0:
        assert found.distance_m == pytest.approx(min(each), abs=1e-6)
        assert each[found.cell] == pytest.approx(min(each), abs=1e-6)
    else:
        assert found.distance_m <= 1e-9


@given(seeds)
@settings(max_examples=150, deadline=None)
def test_in_a_straight_chain_the_depth_is_that_of_the_one_long_prism(make, seed):
    """Wherever the joints lie, gaps and overlaps of neighbouring cells included, for boxes turned any way."""
    rng = np.random.default_rng(seed)
    chain = reaching(make.chain_along(curve(np.inf, 60), ENVELOPE), rng.choice([0.0, 0.05]))
    one = make.chain_along(np.array([[0.0, 0, 0], [150.0, 0, 0]]), ENVELOPE)
    turn = rng.normal(size=3) * rng.integers(0, 2) + (0, 0, rng.choice([0.0, 1e-6]))
    half = rng.uniform(0.05, 3.0, 3) if rng.integers(2) else np.array([3.0, 0.1, 0.1])  # a block or a boom
    solid = make.box(turn, rng.uniform((70, -2.5, 0), (80, 2.5, 5)), half)
    whole = make.signed_distance(solid.vertices, one.cell_vertices(0))
    [found] = make.ask([chain], [solid])
    assert found.distance_m == pytest.approx(whole, abs=1e-6)
    if whole < 0:
        assert abs(found.normal[0]) < 1e-9
        assert np.linalg.norm(found.normal) == pytest.approx(1.0)
        # the way out is one: there, and no nearer, the box is free
        for share, free in ((1.001, True), (0.99, False)):
            T = solid.T_frame_box.copy()
            T[:3, 3] -= found.distance_m * share * found.normal
            [moved] = make.ask([chain], [type(solid)(T, solid.half_extents)])
            assert (moved.distance_m > 0) == free


@given(seeds)
@settings(max_examples=5, deadline=None)
def test_depth_is_continuous_over_the_joints(make, seed):
    """Driving along a curve in 1 cm steps, over several joints, the clearance never jumps."""
    rng = np.random.default_rng(seed)
    radius = rng.choice([np.inf, 600.0, 250.0])
    chain = reaching(make.chain_along(curve(radius, 20), ENVELOPE), 0.03)
    turn, half = rng.normal(size=3), rng.uniform(0.1, 2.5, 3)
    offset, up = rng.uniform(-3, 3), rng.uniform(0, 5)
    start, step = rng.uniform(10, 30), 0.01
    depths = []
    for s in start + np.arange(350) * step:
        centre, _ = place_on(radius, s, offset, up)
        depths.append(make.ask([chain], [make.box(turn, centre, half)]).distances[0])
    jumps = np.abs(np.diff(depths))
    if np.isinf(radius):
        assert jumps.max() < 1e-9
    else:  # the frames of neighbouring cells differ by an angle, which acts on the box's reach
        assert jumps.max() < step + CELL_M / radius * 2 * np.linalg.norm(half)


def test_free_ends_are_a_way_out(make):
    chain = make.chain_along(curve(np.inf, 4), ENVELOPE)
    for x, expected, direction in (
        (0.05, -0.15, (-1, 0, 0)),
        (9.9, -0.2, (1, 0, 0)),
        (3.0, -2.0, (0, 0, 0)),
        (-0.3, 0.2, (-1, 0, 0)),
        (10.5, 0.4, (1, 0, 0)),
    ):
        [found] = make.ask([chain], [make.box((0, 0, 0), (x, 0.0, 2.0), (0.1, 0.1, 0.1))])
        if any(direction):
            assert found.distance_m == pytest.approx(expected, abs=1e-9)
            assert_allclose(found.normal, direction, atol=1e-9)
        else:
            assert found.distance_m < -1.5
            assert abs(found.normal[0]) < 1e-9


def test_the_way_to_a_free_end_counts_every_cell_on_it(make):
    """Half a metre cells: a box two cells in is as deep as its way back to the end."""
    path = np.stack([np.arange(9) * 0.5, np.zeros(9), np.zeros(9)], axis=1)
    chain = make.chain_along(path, ENVELOPE)
    [found] = make.ask([chain], [make.box((0, 0, 0), (1.1, 0.0, 2.0), (0.1, 0.1, 0.1))])
    assert found.distance_m == pytest.approx(-1.2, abs=1e-9)
    assert_allclose(found.normal, (-1, 0, 0), atol=1e-9)


def test_a_gap_in_the_chain_is_two_free_ends(make):
    joined = np.ones((4, 2), dtype=bool)
    joined[1, 1] = joined[2, 0] = False
    whole = make.chain_along(curve(np.inf, 4), ENVELOPE, joined)
    [found] = make.ask([whole], [make.box((0, 0, 0), (4.8, 0.0, 2.0), (0.1, 0.1, 0.1))])
    assert found.distance_m == pytest.approx(-0.3, abs=1e-9)
    assert_allclose(found.normal, (1, 0, 0), atol=1e-9)
    assert found.cell == 1
    # the other ends go on: a long way from the gap only the cross-section is left
    [found] = make.ask([whole], [make.box((0, 0, 0), (0.5, 0.0, 2.0), (0.1, 0.1, 0.1))])
    assert abs(found.normal[0]) < 1e-9


def test_sloping_chains_let_out_across_their_slope(make):
    chain = make.chain_along(curve(np.inf, 40, gradient=0.1), ENVELOPE)
    [found] = make.ask([chain], [make.box((0, 0, 0), (50.0, 0.0, 5.0 + 4.2), (0.01, 0.01, 0.01))])
    slope = np.arctan(0.1)
    assert_allclose(found.normal, (-np.sin(slope), 0, np.cos(slope)), atol=1e-9)
    top = (0.1 + 0.01 * 0.1 + 0.01) * np.cos(slope)
    assert found.distance_m == pytest.approx(-top, abs=1e-9)


@given(seeds)
@settings(max_examples=150, deadline=None)
def test_tubes_against_distance_from_the_axis(make, seed):
    rng = np.random.default_rng(seed)
    axis = np.cumsum(rng.normal(size=(rng.integers(2, 6), 3)) * 3.0, axis=0)
    radius = rng.uniform(0.02, 1.5)
    half = rng.uniform(0.05, 2.0, 3)
    solid = make.box(rng.normal(size=3), axis[0] + rng.normal(size=3) * 4, half)
    [found] = make.ask([Tube(axis, radius)], [solid])
    local = solid.T_frame_box[:3, :3]
    samples = np.concatenate([np.linspace(a, b, 4000) for a, b in itertools.pairwise(axis)])
    outside = np.abs((samples - solid.T_frame_box[:3, 3]) @ local) - half
    nearest = np.linalg.norm(np.maximum(outside, 0.0), axis=1).min()
    assert_allclose(found.point_machine - found.point_limit, found.distance_m * found.normal, atol=1e-7)
    if nearest > 0:
        assert found.distance_m == pytest.approx(nearest - radius, abs=2e-3)
        assert found.distance_m <= nearest - radius + 1e-6
    else:
        assert found.distance_m <= -radius + 1e-6


def test_a_tube_lets_out_across_its_axis_only(make):
    tube = Tube(np.stack([np.arange(21) * 1.0, np.zeros(21), np.zeros(21)], axis=1), 0.2)
    before = None
    for z in np.linspace(1.0, -0.2, 601):
        [found] = make.ask([tube], [make.box((0, 0, 0.3), (10.0, 0.0, z), (1.5, 0.5, 0.3))])
        assert_allclose(found.normal, (0, 0, 1), atol=1e-6) if z > 0.01 else None
        assert found.distance_m == pytest.approx(min(z - 0.5, 10) if z > 0 else -z - 0.5 if z < 0 else -0.5, abs=1e-6)
        assert before is None or abs(found.distance_m - before) < 0.0021
        before = found.distance_m
    [end] = make.ask([tube], [make.box((0, 0, 0), (20.0, 0.0, 0.0), (0.1, 1.0, 1.0))])
    assert end.distance_m == pytest.approx(-0.3, abs=1e-9)
    assert_allclose(end.normal, (1, 0, 0), atol=1e-9)
