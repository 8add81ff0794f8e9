"""The scene as a whole: nothing near is missed, order and bits are stable, facts of limits go through."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from workgauge.machine.load import load_machine
from workgauge.proximity.scene import Scene
from workgauge.values.limits import Activity
from workgauge.values.solids import Box, Convex, PrismChain, Surface, Tube
from workgauge.values.transforms import inverse, rotation_z, rpy, translation

seeds = st.integers(0, 2**32 - 1)
ARRAYS = (
    "distances", "normals", "points_machine", "points_limit", "links", "other_links", "limits", "cells",
    "protections", "stop_distances",
)  # fmt: skip


def random_solid(make, rng, spread):
    where = rng.uniform(-spread, spread, 3) * (1, 1, 0.2)
    kind = rng.integers(5)
    if kind == 0:
        return make.box(rng.normal(size=3), where, rng.uniform(0.1, 2.0, 3))
    if kind == 1:
        return make.hull(where + rng.normal(size=(8, 3)))
    if kind == 2:
        return Tube(where + np.cumsum(rng.normal(size=(4, 3)) * (3, 3, 1), axis=0), rng.uniform(0.05, 1.0))
    if kind == 3:
        path = where + np.cumsum(np.c_[rng.uniform(1, 3, (6, 2)), np.zeros(6)], axis=0)
        return make.chain_along(path, [(-1, 0), (1, 0), (1, 2), (0, 3), (-1, 2)])
    return make.grid_surface(where[2] - 3 + rng.normal(size=(4, 4)) * 0.3, origin=where[:2])


def random_boxes(make, rng, count, spread):
    return [
        make.box(rng.normal(size=3), rng.uniform(-spread, spread, 3), rng.uniform(0.1, 2.0, 3)) for _ in range(count)
    ]


@given(seeds)
@settings(max_examples=60, deadline=None)
def test_nothing_near_is_missed_and_nothing_far_reported(make, seed):
    """Against every limit asked for alone, without any bound on the distance."""
    rng = np.random.default_rng(seed)
    spread = rng.choice([5.0, 20.0, 60.0])
    limits = [make.limit(f"n{i}", random_solid(make, rng, spread)) for i in range(25)]
    boxes = random_boxes(make, rng, 3, 4.0)
    radius = rng.choice([0.3, 2.0, 7.0, 30.0])
    found = make.ask(limits, boxes, radius, self_pairs=((0, 1), (1, 2)))
    expected = {}
    for i, limit in enumerate(limits):
        for s, solid in enumerate(boxes):
            for clearance in make.ask([limit], [solid]):
                if clearance.distance_m < radius:
                    expected[s, i] = clearance.distance_m
    own = found.other_links >= 0
    got = {(s, i): d for s, i, d, o in zip(found.links, found.limits, found.distances, own, strict=True) if not o}
    assert got.keys() == expected.keys()
    assert_allclose([got[key] for key in expected], list(expected.values()), atol=1e-9)
    for clearance, other in zip(found, found.other_links, strict=True):
        assert clearance.distance_m < radius
        if other >= 0:
            assert clearance.limit == f"self:link{other}"
    order = list(zip(found.links, found.limits, found.cells, strict=True))
    assert order == sorted(order)
    assert len(set(zip(found.links, found.limits, strict=True))) == len(found)
    assert found.searched_m == radius


@given(seeds)
@settings(max_examples=25, deadline=None)
def test_answers_do_not_depend_on_what_was_asked_before(make, seed):
    """Bit for bit: a scene that has answered other questions, and one made anew."""
    rng = np.random.default_rng(seed)
    limits = [make.limit(f"n{i}", random_solid(make, rng, 6.0)) for i in range(12)]
    pairs = ((0, 1), (1, 2))
    kins = [make.kin_of(random_boxes(make, rng, 3, 5.0)) for _ in range(4)]
    used = Scene(make.FreeBoxes(3, pairs), limits)
    for kin in kins:
        used.query(kin, np.eye(4), 5.0)
    before = used.query(kins[0], np.eye(4), 5.0)
    fresh = Scene(make.FreeBoxes(3, pairs), limits).query(kins[0], np.eye(4), 5.0)
    for name in ARRAYS:
        assert_array_equal(getattr(before, name), getattr(fresh, name))
        with pytest.raises(ValueError):
            getattr(before, name)[...] = 0


def moved(solid, T):
    match solid:
        case Box():
            return Box(T @ solid.T_frame_box, solid.half_extents)
        case Convex():
            return Convex(solid.vertices @ T[:3, :3].T + T[:3, 3], solid.faces)
        case Tube():
            return Tube(solid.axis @ T[:3, :3].T + T[:3, 3], solid.radius)
        case Surface():
            return dataclasses.replace(solid, vertices=solid.vertices @ T[:3, :3].T + T[:3, 3])
        case PrismChain():
            starts, ends = (points @ T[:3, :3].T + T[:3, 3] for points in (solid.starts, solid.ends))
            return dataclasses.replace(solid, starts=starts, ends=ends, laterals=solid.laterals @ T[:3, :3].T)


@given(seeds)
@settings(max_examples=60, deadline=None)
def test_moving_site_and_machine_together_changes_nothing(make, seed):
    rng = np.random.default_rng(seed)
    solids = [random_solid(make, rng, 4.0) for _ in range(6)]
    boxes = random_boxes(make, rng, 2, 4.0)
    T = translation(*rng.uniform(-1000, 1000, 3)) @ rotation_z(rng.uniform(-3, 3))
    here = make.ask(solids, boxes, 1e3)
    scene = Scene(make.FreeBoxes(2), [make.limit(f"l{i}", moved(solid, T)) for i, solid in enumerate(solids)])
    there = scene.query(make.kin_of(boxes), T, 1e3)
    assert_array_equal(here.limits, there.limits)
    assert_allclose(here.distances, there.distances, atol=3e-6)
    spread = rpy(*rng.uniform(-3, 3, 3))  # upright solids apart, any turn will do
    free = [solid for solid in solids if isinstance(solid, Box | Convex | Tube)]
    scene = Scene(make.FreeBoxes(2), [make.limit(f"l{i}", moved(solid, spread)) for i, solid in enumerate(free)])
    assert_allclose(
        make.ask(free, boxes, 1e3).distances, scene.query(make.kin_of(boxes), spread, 1e3).distances, atol=3e-6
    )


def test_facts_of_limits_go_through(make):
    wall = make.box((0, 0, 0), (3, 0, 0), (0.5, 5, 5))
    limits = [
        make.limit("plain", wall),
        make.limit("careful", wall, stop_distance_m=0.7, tolerance_m=0.02),
        make.limit("not the cab", wall, exempt_links=frozenset({"link0"})),
        make.limit("by day", wall, activity=Activity(not_before_ns=100, not_after_ns=200)),
        make.limit("open track", wall, activity=Activity(state="track 2")),
        make.limit(
            "ground", make.grid_surface(np.full((9, 9), -1.0), origin=(-4, -4)), exempt_links=frozenset({"link1"})
        ),
        make.limit(
            "flood", make.grid_surface(np.full((9, 9), -1.0), origin=(-4, -4)), activity=Activity(state="wet")
        ),
    ]
    boxes = [make.box((0, 0, 0), (0, 0, 0), (0.5, 0.5, 0.5)), make.box((0, 0, 0), (0, 2, 0), (0.5, 0.5, 0.5))]
    scene = Scene(make.FreeBoxes(2), limits)
    found = scene.query(make.kin_of(boxes), np.eye(4), 4.0, 150, frozenset())
    assert [(c.link, c.limit) for c in found] == [
        *(("link0", name) for name in ("plain", "careful", "by day", "open track", "ground", "flood")),
        *(("link1", name) for name in ("plain", "careful", "not the cab", "by day", "open track", "flood")),
    ]
    assert found[1].stop_distance_m == 0.7
    assert scene.uncertainty.variances[found.limits[1]] == pytest.approx(0.02**2)
    assert scene.largest_stop_m == 0.7
    assert math.isnan(found[0].stop_distance_m)
    assert not found.protections.any()
    assert found.solids.tolist() == [0] * 6 + [1] * 6
    late = scene.query(make.kin_of(boxes), np.eye(4), 4.0, 201, frozenset({"track 2", "wet"}))
    assert {c.limit for c in late} == {"plain", "careful", "not the cab", "ground"}


def test_a_site_without_limits_and_a_machine_far_away(make):
    assert len(make.ask([], [make.box((0, 0, 0), (0, 0, 0), (1, 1, 1))])) == 0
    found = make.ask([make.box((0, 0, 0), (9e3, 0, 0), (1, 1, 1))], [make.box((0, 0, 0), (0, 0, 0), (1, 1, 1))], 5.0)
    assert len(found) == 0
    assert found.nearest() is None
    assert found.limit_ids == ("l0", "self:link0")


@pytest.mark.filterwarnings("ignore:invalid value")
@pytest.mark.parametrize("place", [(0, 3), (2, 3), (1, 1)])
def test_no_answer_is_ever_read_as_free(make, place):
    scene = Scene(make.FreeBoxes(1), [make.limit("wall", make.box((0, 0, 0), (3, 0, 0), (0.5, 5, 5)))])
    kin = make.kin_of([make.box((0, 0, 0), (0, 0, 0), (1, 1, 1))])
    for bad in (math.nan, math.inf):
        T = np.eye(4)
        T[place] = bad
        with pytest.raises(ValueError, match="finite"):
            scene.query(kin, T, 2.0)
    with pytest.raises(ValueError, match="radius"):
        scene.query(kin, np.eye(4), 0.0)


@pytest.mark.parametrize("seed", range(12))
def test_a_real_machine_moves_its_clearances_as_its_rows_say(make, seed):
    """Central differences of distances against `row @ qdot`, environment and own links."""
    rng = np.random.default_rng(seed)
    machine = load_machine("rre20")
    solids = [
        make.box(rng.normal(size=3), rng.uniform((-6, -6, 0), (9, 6, 5)), rng.uniform(0.2, 0.8, 3)) for _ in range(6)
    ]
    solids.append(make.hull(rng.normal(size=(9, 3)) + np.array([7.0, 3.0, 2.0])))
    solids.append(Tube(np.array([[-10.0, 5, 6], [10, 4, 6.5]]), 0.3))
    solids.append(
        make.chain_along(np.array([[-20.0, -5, 0], [0, -5, 0], [20, -5.5, 0]]), [(-1, 0), (1, 0), (1, 3), (-1, 3)])
    )
    scene = Scene(machine, [make.limit(f"l{i}", solid) for i, solid in enumerate(solids)])
    T = translation(0.4, -0.2, 0.3) @ rpy(0.02, -0.03, 0.5)
    q = machine.sample_min + rng.uniform(0.1, 0.9, machine.n) * (machine.sample_max - machine.sample_min)
    here = scene.query(machine.forward(q), T, 6.0)
    rows = machine.distance_rows(machine.forward(q), T, here)
    checked = 0
    for _ in range(4):
        qdot = rng.normal(size=machine.n)
        step = 1e-5
        there, back = (scene.query(machine.forward(q + sign * step * qdot), T, 6.0) for sign in (1, -1))
        if not (len(here) == len(there) == len(back)) or (there.limits != here.limits).any():
            continue
        ahead, behind = (there.distances - here.distances) / step, (here.distances - back.distances) / step
        smooth = np.abs(ahead - behind) < 1e-2
        assert_allclose((rows @ qdot)[smooth], ((ahead + behind) / 2)[smooth], atol=1e-2)
        checked += int(smooth.sum())
    assert checked > len(here)


def test_poses_are_composed_in_the_right_order(make):
    """A machine that stands elsewhere sees the site from there."""
    solid = make.box((0.1, 0.2, 0.3), (4, 1, 0.5), (0.3, 0.4, 0.5))
    body = make.box((0, 0.4, 0), (1, 2, 3), (0.5, 0.6, 0.7))
    T = translation(-3, 2, 1) @ rpy(0.1, 0.2, 2.0)
    [seen] = Scene(make.FreeBoxes(1), [make.limit("x", solid)]).query(make.kin_of([body]), T, 50.0)
    [same] = make.ask([Box(inverse(T) @ solid.T_frame_box, solid.half_extents)], [body])
    assert seen.distance_m == pytest.approx(same.distance_m, abs=1e-6)
    assert_allclose(seen.normal, T[:3, :3] @ same.normal, atol=1e-6)
