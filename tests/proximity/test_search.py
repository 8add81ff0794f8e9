"""Closest points prove themselves; the tree and the rules of what counts against the slow way of asking."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from workgauge.machine.load import load_machine
from workgauge.proximity.closest import closest
from workgauge.proximity.scene import Scene
from workgauge.proximity.tree import Tree, inside
from workgauge.values.arrays import frozen, frozen_ints
from workgauge.values.limits import Activity, Limit, LimitKind, Source
from workgauge.values.solids import Box, Convex, Tube

seeds = st.integers(0, 2**32 - 1)


def body(rng, kind, turn):
    """Corners around the origin, and a function that says how far outside a point is."""
    if kind == "box":
        half = rng.uniform(0.05, 5.0, 3)
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
        return signs * half @ turn.T, lambda point: (np.abs(point @ turn) - half).max()
    if kind == "segment":
        corners = rng.normal(size=(2, 3)) * 3.0
        along = corners[1] - corners[0]

        def beside(point):
            share = np.clip((point - corners[0]) @ along / (along @ along), 0.0, 1.0)
            return float(np.linalg.norm(corners[0] + share * along - point))

        return corners, beside
    corners = rng.normal(size=(rng.integers(4, 20), 3)) * rng.uniform(0.2, 3.0, 3)
    planes = ConvexHull(corners).equations
    return corners, lambda point: (planes[:, :3] @ point + planes[:, 3]).max()


@given(seeds, st.sampled_from(["box", "hull", "segment"]), st.sampled_from([0.0, 1e-9, 1e-6, 1e-3, 2.0]))
@settings(max_examples=400, deadline=None)
def test_the_points_lie_on_the_bodies_and_the_plane_between_them_proves_the_distance(seed, kind, tilt):
    """Two witnesses, one from above and one from below, and nothing else needed."""
    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
    second, beside = body(rng, kind, turn)
    first, outside = body(rng, "box", Rotation.from_rotvec(tilt * rng.normal(size=3)).as_matrix() @ turn)
    apart = rng.normal(size=3)
    apart *= rng.uniform(0.1, 9.0) / np.linalg.norm(apart)
    place = rng.uniform(-1.0, 1.0, 3) * rng.choice([0.0, 3000.0])
    out = np.empty(6)
    start = apart if rng.integers(2) else rng.normal(size=3) * rng.integers(2)
    distance = closest(first + apart + place, second + place, *start, out)
    u, point = out[:3], out[3:]
    if distance < 0.0:  # then they touch: no direction parts them
        directions = rng.normal(size=(2000, 3))
        gaps = ((first + apart) @ directions.T).min(axis=0) - (second @ directions.T).max(axis=0)
        assert (gaps / np.linalg.norm(directions, axis=1)).max() < 1e-6
        return
    assert np.linalg.norm(u) == pytest.approx(1.0, abs=1e-12)
    assert outside(point - place - apart) < 1e-8
    assert beside(point - distance * u - place) < 1e-8
    proven = ((first + apart) @ u).min() - (second @ u).max()
    assert proven == pytest.approx(distance, abs=2e-9)


@given(seeds, st.integers(0, 300))
@settings(max_examples=80, deadline=None)
def test_the_tree_finds_what_meets_a_box_and_nothing_else(seed, count):
    rng = np.random.default_rng(seed)
    lows = rng.integers(-20, 20, (count, 3)) * rng.choice([0.0, 0.5, 1.0], 3)
    highs = lows + rng.integers(0, 4, (count, 3)) * rng.choice([1.0, 30.0], (count, 1), p=[0.9, 0.1])
    tree = Tree.over(lows, highs)
    assert sorted(tree.order.tolist()) == list(range(count))
    for _ in range(5):
        low = rng.integers(-25, 25, 3).astype(np.float64)
        high = low + rng.integers(0, 20, 3)
        expected = np.flatnonzero((lows <= high).all(axis=1) & (highs >= low).all(axis=1))
        assert_array_equal(inside(*tree, lows, highs, low, high), expected)


states = st.sampled_from([None, "track 1", "track 2"])
instants = st.one_of(st.none(), st.integers(-3, 3), st.sampled_from([-(2**80), 2**80]))


@given(
    st.lists(st.tuples(states, instants, instants, states, st.booleans()), min_size=1, max_size=6),
    st.integers(-3, 3),
    st.frozensets(st.sampled_from(["track 1", "track 2", "x"])),
    st.frozensets(st.sampled_from(["track 1", "track 2", "x"])),
)
@settings(max_examples=200, deadline=None)
def test_what_counts_is_what_every_limit_says_of_itself(make, facts, now, off, let_off):
    wall = make.box((0, 0, 0), (3, 0, 0), (0.5, 5, 5))
    limits = [
        make.limit(
            f"l{i}",
            wall,
            activity=Activity(state, first, last),
            own_track_of=track,
            exempt_links=frozenset({"link0"}) if exempt else frozenset(),
        )
        for i, (state, first, last, track, exempt) in enumerate(facts)
    ]
    bodies = [make.box((0, 0, 0), (0, y, 0), (1, 1, 1)) for y in (0, 1)]
    found = Scene(make.FreeBoxes(2), limits).query(make.kin_of(bodies), np.eye(4), 5.0, now, off, let_off)
    expected = [
        (link, limit.id)
        for link in ("link0", "link1")
        for limit in limits
        if limit.counts(now, off, let_off) and link not in limit.exempt_links
    ]
    assert [(one.link, one.limit) for one in found] == expected


def crowded(seed):
    """A machine deep inside, beside and touching limits of every kind, and some of its postures."""
    rng = np.random.default_rng(seed)
    machine = load_machine(("rre20", "brokk5", "sun-a")[seed % 3])
    q = rng.uniform(machine.sample_min, machine.sample_max)
    poses, _ = machine.solid_poses(machine.forward(q))
    places, source = poses[rng.integers(0, len(poses), 4), :3, 3] + rng.normal(size=(4, 3)) * 0.5, Source("test", "l")
    steps = rng.normal(size=(3, 3)) * (2.0, 2.0, 0.5)
    axis = np.cumsum(np.concatenate([places[1:2], steps]), axis=0)
    corners = places[2] + rng.normal(size=(12, 3))
    turn = np.eye(4)
    turn[:3, :3], turn[:3, 3] = Rotation.random(rng=rng).as_matrix(), places[0]
    kept = ConvexHull(corners)
    order = np.unique(kept.simplices)
    faces = np.searchsorted(order, kept.simplices)
    a, b, c = (corners[order][faces[:, i]] for i in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), kept.equations[:, :3]) < 0.0
    faces = np.where(inwards[:, None], faces[:, ::-1], faces)
    solids = (
        Box(frozen(turn), frozen(rng.uniform(0.1, 3.0, 3))),
        Tube(frozen(axis), float(rng.uniform(0.05, 0.6))),
        Convex(frozen(corners[order]), frozen_ints(faces)),
    )
    limits = [Limit(f"l{i}", LimitKind.ZONE, "l", solid, "test", source) for i, solid in enumerate(solids)]
    return machine, Scene(machine, limits), [q + rng.normal(size=machine.n) * 0.05 for _ in range(4)]


@pytest.mark.parametrize("seed", range(24))
def test_the_least_distances_are_those_of_the_clearances(seed):
    machine, scene, postures = crowded(seed)
    for q in postures:
        kin = machine.forward(q)
        found, least = scene.query(kin, np.eye(4), 2.0), scene.least(kin, np.eye(4), 2.0)
        expected = np.full(least.shape, np.inf)
        np.minimum.at(expected, (found.solids, found.limits), found.distances)
        np.testing.assert_allclose(least, expected, rtol=0.0, atol=1e-8)
