"""Slack along a predicted stop against the scene itself: never above what is there, and no lower than it must be."""

import functools
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from workgauge.machine.load import load_machine, machine_from
from workgauge.proximity.protection import Integrity, link_turns, with_protection
from workgauge.proximity.scene import Scene
from workgauge.proximity.stops import Stop, Way
from workgauge.proximity.surroundings import Surroundings
from workgauge.proximity.uncertainty import MachineUncertainty
from workgauge.values import transforms as tf
from workgauge.values.arrays import frozen
from workgauge.values.limits import Activity, Limit, LimitKind, Source
from workgauge.values.solids import Box, Convex, PrismChain, Surface, Tube

STOP_M = 0.2
#: So far that every pair that any joint moves at all is looked at closely [rad, m].
EVERYTHING = 1e5
MACHINES = ("rre20", "brokk5", "telescope", "sleeve")
seeds = st.integers(0, 2**32 - 1)


@functools.cache
def machine_named(name):
    """A machine of the catalogue, or a telescope whose box hangs on its moving link or on the sleeve around it."""
    if name not in ("telescope", "sleeve"):
        return load_machine(name)
    moving = name == "telescope"
    turning = {f"speed_{way}_deg_s": 20.0 for way in ("positive", "negative")}
    sliding = {f"speed_{way}_m_s": 0.3 for way in ("positive", "negative")}
    joints = [
        {"name": "swing", "link": "cabin", "type": "revolute", "continuous": True, "home_deg": 0, **turning}
        | {"dh": {"a_m": 0.5, "alpha_deg": 90, "d_m": 1.5}},
        {"name": "lift", "link": "boom", "type": "revolute", "lower_deg": -30, "upper_deg": 60, "home_deg": 0}
        | {**turning, "dh": {"a_m": 1.0, "alpha_deg": 70, "d_m": 0.0}},
        {"name": "reach", "link": "arm", "type": "prismatic", "lower_m": 0, "upper_m": 1.5, "home_m": 0}
        | {**sliding, "dh": {"a_m": 0, "alpha_deg": 0, "d_m": 2.0}},
        {"name": "wrist", "link": "hand", "type": "revolute", "lower_deg": -120, "upper_deg": 120, "home_deg": 0}
        | {**turning, "dh": {"a_m": 0.8, "alpha_deg": 90, "d_m": 0.2}},
    ]
    stretch = {"joint": "reach", "axis": "z", "side": "negative" if moving else "positive"}
    solids = [
        {"name": "box", "centre_m": [0, 0, -1.0 if moving else 1.0], "size_m": [0.4, 0.3, 2.2]}
        | {"link": "arm" if moving else "boom", "stretch": stretch},
        {"name": "base", "link": "undercarriage", "centre_m": [0, 0, 0.5], "size_m": [2.0, 1.5, 1.0]},
        {"name": "fist", "link": "hand", "centre_m": [0.3, 0, 0], "size_m": [0.8, 0.4, 0.3]},
    ]
    return machine_from(
        {
            "title": name,
            "undercarriage": {"kind": "wheels", "gauge_m": 2.0},
            "joints": joints,
            "solids": solids,
            "attachments": [{"name": "hook", "tool": {}}],
        }
    )


def limit(name, solid, **facts):
    return Limit(name, LimitKind.ZONE, name, solid, "test", Source("test", name), **facts)


def box(rng, place, size=1.5):
    T = np.array(tf.translation(*place))
    T[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    return Box(frozen(T), frozen(rng.uniform(0.1, size, 3)))


def placed(rng, T, near=2.0, far=9.0):
    """A random place round a machine, in the site's frame."""
    angle, away = rng.uniform(-math.pi, math.pi), rng.uniform(near, far)
    return T[:3, 3] + [away * math.cos(angle), away * math.sin(angle), rng.uniform(-1.0, 5.0)]


def shapes(make, rng, T, kinds):
    """One solid of each kind round a machine."""
    found = []
    for kind in kinds:
        place = placed(rng, T)
        if kind == "box":
            found.append(box(rng, place))
        elif kind == "convex":
            found.append(make.hull(place + rng.normal(size=(12, 3))))
        elif kind == "tube":
            found.append(
                Tube(frozen(place + np.cumsum(rng.normal(size=(4, 3)), axis=0)), float(rng.uniform(0.05, 1)))
            )
        elif kind == "chain":
            radius, first = float(rng.uniform(60.0, 300.0)), rng.uniform(-math.pi, math.pi)
            turn = first + np.arange(-6, 7) * 2.5 / radius
            path = place + np.stack([np.cos(turn), np.sin(turn), 0.01 * turn], axis=1) * radius
            path += place - path[6]
            half, high = rng.uniform(0.5, 1.8), rng.uniform(1.0, 4.0)
            found.append(make.chain_along(path, [(-half, 0.0), (half, 0.0), (half, high), (-half, high)]))
        else:
            above = kind == "ground"
            heights = (-1.5 if above else 8.0) + T[2, 3] + rng.uniform(-0.5, 0.5, (9, 9))
            found.append(make.grid_surface(heights, 3.0, T[:2, 3] - 12.0, above))
    return found


@dataclass
class Case:
    """A machine among limits, and what is sure about it."""

    machine: Any
    q: Any
    T: Any
    scene: Any
    unsure: Any
    integrity: Any

    def look(self, q, T=None, radius=60.0, scene=None):
        """Clearances with protection levels of a posture, their rows, and the largest level."""
        scene, T = scene or self.scene, self.T if T is None else T
        kin = self.machine.forward(q)
        found = scene.query(kin, T, radius)
        rows = self.machine.distance_rows(kin, T, found)
        given = found, rows, kin, self.machine, T, self.unsure, scene.uncertainty, self.integrity
        found, largest = with_protection(*given)
        return found, rows, largest

    def around(self, q, **facts):
        found, rows, largest = self.look(q)
        return found, rows, Surroundings(self.scene, self.T, self.unsure, self.integrity, largest, **facts)

    def stop(self, way, reach=EVERYTHING, margin=0.0, q=None):
        """The stop along a way, and the clearances it was given."""
        found, _, around = self.around(self.q if q is None else q)
        n = self.machine.n
        reach = np.full((1, n), reach) if np.ndim(reach) == 0 else np.asarray(reach, dtype=float)
        return found, Stop(
            around, found, self.q if q is None else q, way, stop_distance_m=STOP_M, margin_m=margin, reach=reach
        )


def case_of(make, seed, name="rre20", kinds=("box", "convex", "tube"), far=False, unsure=None, **facts):
    rng = np.random.default_rng(seed)
    machine = machine_named(name)
    q = machine.sample_min + rng.random(machine.n) * (machine.sample_max - machine.sample_min)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rng.normal(size=3) * (0.1, 0.1, 2.0)).as_matrix()
    T[:3, 3] = rng.normal(size=3) * (3000.0 if far else 1.0)
    limits = [limit(f"l{i}", solid, **facts) for i, solid in enumerate(shapes(make, rng, T, kinds))]
    doubt = unsure(rng, machine) if unsure else MachineUncertainty.of(np.zeros((6, 6)), np.zeros(machine.n))
    return rng, Case(machine, q, T, Scene(machine, limits), doubt, Integrity(5.33))


def resting(q, *, times=0.0):
    q = np.array(q, dtype=float)[None]
    return Way(q, np.zeros_like(q), np.array([times]))


def slack_of(found, stop, p=None, *, some=False):
    """The least slack of each clearance at posture p, or anywhere; infinite where it cannot matter.

    A clearance whose nearest cell no joint moves it towards says nothing of that cell: unless `some` will do, it
    counts as one that cannot matter.
    """
    slack, of = np.asarray(stop.slack), np.asarray(stop._of)
    least = np.full(len(found), np.inf)
    if len(slack):
        column = slack.min(axis=1) if p is None else slack[:, p]
        np.minimum.at(least, of, column)
        if not some:
            least[of[np.isinf(column)]] = np.inf
    return together(found, least) if len(found) else least


def room(found):
    """What the scene says is left of every clearance."""
    stops = np.where(np.isnan(found.stop_distances), STOP_M, found.stop_distances)
    return together(found, found.distances - stops - found.protections) if len(found) else np.empty(0)


def by_pair(found, values):
    """The least of each solid and limit: two boxes of one link are one limit to a third."""
    least = {}
    for solid, one, value in zip(found.solids.tolist(), found.limits.tolist(), values.tolist(), strict=True):
        least[solid, one] = min(value, least.get((solid, one), math.inf))
    return least


def together(found, values):
    """The same for each clearance (k,)."""
    least = by_pair(found, values)
    return np.array([least[pair] for pair in zip(found.solids.tolist(), found.limits.tolist(), strict=True)])


def convex(case, found):
    """Which clearances are to convex limits or own links: those whose depth is the depth of one body."""
    hollow = [i for i, one in enumerate(case.scene.limits) if isinstance(one.solid, Surface | PrismChain | Tube)]
    return ~np.isin(found.limits, hollow)


ALL = ("box", "convex", "tube", "chain", "ground", "ceiling")


@settings(max_examples=40, deadline=None)
@given(seed=seeds, name=st.sampled_from(MACHINES), far=st.booleans(), own=st.sampled_from([None, 0.0, 0.7]))
def test_at_rest_the_slack_is_what_the_scene_says(make, seed, name, far, own):
    _, case = case_of(make, seed, name, ALL, far, stop_distance_m=own)
    found, stop = case.stop(resting(case.q))
    slack, there = slack_of(found, stop), room(found)
    given_ = np.isfinite(slack)
    outside = together(found, found.distances) > 1e-3
    hollow = ~convex(case, found)
    close = np.where(hollow, 2e-4, 1e-6) + 1e-8 * far * np.abs(case.T[:3, 3]).max()
    assert (slack[given_ & (outside | ~hollow)] <= (there + close)[given_ & (outside | ~hollow)]).all()
    assert (slack[given_] < (there + 0.2)[given_]).all()  # inside a bent tube the union is deeper than each piece
    # nearer to a bent chain than may be, each cell counts drawn out at the faces it shares: a little less
    same = given_ & outside & ((there >= 0.0) | ~hollow)
    assert (np.abs(slack - there) <= close)[same].all()
    # what is left out is what no joint moves nearer
    left = np.isinf(slack_of(found, stop, some=True))
    assert (np.abs(case.machine.distance_rows(case.machine.forward(case.q), case.T, found)[left]) < 1e-6).all()


@settings(max_examples=40, deadline=None)
@given(seed=seeds, name=st.sampled_from(MACHINES))
def test_inside_a_convex_limit_the_slack_is_the_shortest_way_out(make, seed, name):
    rng, case = case_of(make, seed, name, ())
    corners = case.machine.solid_poses(case.machine.forward(case.q))[0]
    middle = (case.T @ corners)[int(rng.integers(len(corners))), :3, 3]
    case.scene = Scene(case.machine, [limit("l", box(rng, middle + rng.normal(size=3) * 0.6))])
    found, stop = case.stop(resting(case.q))
    slack, there = slack_of(found, stop), room(found)
    inside = (together(found, found.distances) < -1e-6) & np.isfinite(slack) & (found.other_links < 0)
    assert (np.abs(slack - there)[inside] <= 1e-6).all()


@settings(max_examples=25, deadline=None)
@given(seed=seeds, name=st.sampled_from(MACHINES), wide=st.sampled_from([0.003, 0.02, 0.1]), far=st.booleans())
def test_with_widths_the_slack_bounds_every_posture_within_them(make, seed, name, wide, far):
    rng, case = case_of(make, seed, name, ALL, far)
    n = case.machine.n
    widths = rng.uniform(0.0, wide, n) * (rng.random(n) < 0.7)
    found, stop = case.stop(Way(case.q[None].copy(), widths[None].copy(), np.zeros(1)))
    slack = slack_of(found, stop)
    bounds, hollow = by_pair(found, slack), {i for i in range(6) if ALL[i] in ("tube", "chain", "ground", "ceiling")}
    for k in range(10):
        draw = rng.choice([-1.0, 1.0], n) if k % 2 else rng.uniform(-1.0, 1.0, n)
        there, _, _ = case.look(case.q + widths * draw)
        for pair, left in by_pair(there, room(there)).items():
            if np.isfinite(bounds.get(pair, np.inf)) and not (pair[1] in hollow and left < -STOP_M):
                assert bounds[pair] <= left + (1e-4 if pair[1] in hollow else 1e-6), pair


@settings(max_examples=40, deadline=None)
@given(seed=seeds, name=st.sampled_from(MACHINES), size=st.sampled_from([0.002, 0.01, 0.05]))
def test_what_is_left_out_cannot_be_used_up(make, seed, name, size):
    """Neither far pairs nor those with more slack than `|row| . reach` fall short when the joints move by reach."""
    rng, case = case_of(make, seed, name, (*ALL, "box", "box"))
    n = case.machine.n
    reach = np.concatenate([np.diag(rng.uniform(0.0, size, n)), rng.uniform(0.0, size, (2, n))])
    found, stop = case.stop(resting(case.q), reach=reach)
    bounds = by_pair(found, slack_of(found, stop, some=True))
    second = (reach.sum(axis=1).max() ** 2) * 0.5 * case.scene.arm.reach_m
    free = 0
    for k in range(8):
        moved = reach[k % len(reach)] * rng.choice([-1.0, 1.0], n)
        there, _, _ = case.look(case.q + moved)
        for pair, left in by_pair(there, room(there)).items():
            if np.isinf(bounds.get(pair, np.inf)):
                free += 1
                assert left >= -second - 1e-6, pair
    assert free or not len(found)


def ways(rng, case, steps, step):
    """A way of so many postures whose corners move at most `step` from one to the next [m]."""
    per = step / max(float(case.scene.arm.farthest.sum()), 1.0)
    moves = rng.uniform(-1.0, 1.0, case.machine.n) + rng.uniform(-0.5, 0.5, (steps, case.machine.n))
    moves *= per / np.abs(moves).max()
    return np.concatenate([case.q[None], case.q + np.cumsum(moves, axis=0)])


@settings(max_examples=40, deadline=None)
@given(seed=seeds, name=st.sampled_from(MACHINES))
def test_between_two_postures_of_a_way_there_is_no_less(make, seed, name):
    """To within what a joint's arc bulges beyond its chord."""
    rng, case = case_of(make, seed, name, ALL)
    postures = ways(rng, case, 5, 0.15)
    found, stop = case.stop(Way(postures, np.zeros_like(postures), np.arange(len(postures)) * 0.05))
    bounds = [by_pair(found, slack_of(found, stop, p)) for p in range(len(postures))]
    hollow = {i for i, one in enumerate(case.scene.limits) if isinstance(one.solid, Surface | PrismChain | Tube)}
    worst = 0.0
    for p in range(1, len(postures)):
        for share in (0.25, 0.5, 0.75):
            there, _, _ = case.look(postures[p - 1] + share * (postures[p] - postures[p - 1]))
            for pair, left in by_pair(there, room(there)).items():
                bound = min(bounds[p - 1].get(pair, np.inf), bounds[p].get(pair, np.inf))
                if np.isfinite(bound) and not (pair[1] in hollow and left < -STOP_M):
                    worst = max(worst, bound - left)
    assert worst < 0.005


def shifted(solid, move):
    """A solid after a rigid motion (4, 4) of the site's frame."""
    if isinstance(solid, Box):
        return Box(frozen(move @ solid.T_frame_box), solid.half_extents)
    return Convex(frozen(solid.vertices @ move[:3, :3].T + move[:3, 3]), solid.faces)


@settings(max_examples=40, deadline=None)
@given(seed=seeds, name=st.sampled_from(MACHINES), turning=st.booleans())
def test_a_limit_that_moves_is_met_where_it_will_be(make, seed, name, turning):
    rng, case = case_of(make, seed, name, ("box", "convex", "box"))
    t = 0.4
    limits, later = [], []
    for one in case.scene.limits:
        twist = np.concatenate([rng.normal(size=3), rng.normal(size=3) * 0.2 * turning])
        middle = one.solid.T_frame_box[:3, 3] if isinstance(one.solid, Box) else one.solid.vertices.mean(axis=0)
        move = np.eye(4)
        move[:3, :3] = Rotation.from_rotvec(twist[3:] * t).as_matrix()
        move[:3, 3] = middle + twist[:3] * t - move[:3, :3] @ middle
        limits.append(replace(one, velocity=frozen(twist)))
        later.append(replace(one, solid=shifted(one.solid, move)))
    case.scene = Scene(case.machine, limits)
    found, stop = case.stop(resting(case.q, times=t))
    there, _, _ = case.look(case.q, scene=Scene(case.machine, later))
    real, now = by_pair(there, room(there)), by_pair(found, room(found))
    for pair, bound in by_pair(found, slack_of(found, stop)).items():
        if np.isinf(bound) or pair[1] >= len(limits):
            continue
        bulge = 0.5 * (np.linalg.norm(limits[pair[1]].velocity[3:]) * t) ** 2 * 6.0
        assert bound <= real[pair] + bulge + 1e-6
        # a limit that recedes does so without being counted on
        assert bound <= now[pair] + 1e-6
        if not turning and now[pair] > -STOP_M:
            assert bound >= now[pair] - np.linalg.norm(limits[pair[1]].velocity[:3]) * t - 1e-6


def some_covariance(rng, size, sigma):
    root = rng.normal(size=(size, size))
    root = root @ root.T
    scale = sigma / np.sqrt(np.diag(root))
    return root * scale[:, None] * scale


def unsure_in(what):
    """A maker of uncertainty: of the place, of pose and joints, or of all together."""

    def make(rng, machine):
        n = machine.n
        pose = np.zeros((6, 6))
        if what == "place":
            pose[:3, :3] = some_covariance(rng, 3, np.full(3, 0.02))
            return MachineUncertainty.of(pose, np.zeros(n))
        if what == "independent":
            pose = some_covariance(rng, 6, np.array([0.02, 0.02, 0.03, 0.002, 0.002, 0.004]))
            return MachineUncertainty.of(pose, np.full(n, 0.002), tool_sigma_m=0.01)
        whole = some_covariance(rng, 6 + n, np.array([0.02, 0.02, 0.03, *(0.002,) * (n + 3)]))
        return MachineUncertainty.of(
            whole[:6, :6], np.sqrt(np.diag(whole)[6:]), cross=whole[:6, 6:], joint_covariance=whole[6:, 6:]
        )

    return make


@settings(max_examples=40, deadline=None)
@given(seed=seeds, name=st.sampled_from(MACHINES), limits=st.sampled_from(["sure", "rough", "unsure"]))
def test_an_uncertain_place_costs_just_its_protection_level(make, seed, name, limits):
    facts = {"rough": {"tolerance_m": 0.03}, "unsure": {"covariance": frozen(np.diag([1e-4] * 3 + [0.0] * 3))}}
    _, case = case_of(make, seed, name, ("box", "convex", "tube"), unsure=unsure_in("place"), **facts.get(limits, {}))
    case.integrity = Integrity(5.33, 0.01)
    found, stop = case.stop(resting(case.q))
    slack, there = slack_of(found, stop), room(found)
    outside = (together(found, found.distances) > 1e-3) & np.isfinite(slack)
    assert (slack[outside] <= there[outside] + 1e-6).all()
    # a limit's own pose counts in every direction as much as in its worst
    loose = {"unsure": 5.33 * 0.03}.get(
        limits, 0.01
    )  # by what the corner nearest the limit is unsure less than another
    assert (slack[outside] >= there[outside] - loose).all()


@settings(max_examples=40, deadline=None)
@given(
    seed=seeds,
    name=st.sampled_from(MACHINES),
    what=st.sampled_from(["independent", "correlated"]),
    covariance=st.booleans(),
)
def test_an_uncertain_machine_costs_no_less_than_its_protection_level(make, seed, name, what, covariance):
    facts = {"covariance": frozen(np.diag([1e-4] * 3 + [1e-6] * 3))} if covariance else {}
    rng, case = case_of(make, seed, name, ("box", "convex", "tube", "ground"), unsure=unsure_in(what), **facts)
    found, stop = case.stop(resting(case.q))
    slack, there = slack_of(found, stop), room(found)
    outside = (together(found, found.distances) > 1e-3) & np.isfinite(slack)
    # they differ in how long an arm the second order of all turns is given
    angle = 5.33 * float(link_turns(case.unsure, case.machine.prismatic.tolist())[0].max())
    second = 0.5 * angle * angle * case.scene.arm.reach_m
    assert (slack[outside] <= there[outside] + second + 1e-6).all()
    more = there[outside] - slack[outside]
    assert more.max(initial=0.0) <= second + 1e-6 + (0.25 if covariance else 0.0)
    # small reach: what the coarse bound takes for free has as much slack as it says
    n = case.machine.n
    reach = rng.uniform(0.0, 0.01, (1, n))
    far, narrow = case.stop(resting(case.q), reach=reach)
    close = slack_of(far, narrow)
    left_out = np.isinf(slack_of(far, narrow, some=True)) & outside
    assert (there[left_out] >= 0.0).all()
    both = np.isfinite(close) & np.isfinite(slack)
    assert close[both] == pytest.approx(slack[both], abs=1e-9)


@settings(max_examples=40, deadline=None)
@given(seed=seeds, name=st.sampled_from(MACHINES))
def test_the_rows_foretell_the_slack_of_postures_nearby(make, seed, name):
    """After a small motion no clearance has less than the least of its rows said, to second order."""
    rng, case = case_of(make, seed, name, ALL)
    found, stop = case.stop(resting(case.q))
    n, rows = case.machine.n, stop.rows
    for _ in range(6):
        step = rng.normal(size=n) * (rng.random(n) < 0.6) * 2e-3
        there, _, _ = case.look(case.q + step)
        real, now = by_pair(there, room(there)), by_pair(found, room(found))
        known = by_pair(found, slack_of(found, stop))
        second = 2.0 * np.abs(step).sum() ** 2 * case.scene.arm.reach_m
        for pair, left in now.items():
            mine = (found.solids == pair[0]) & (found.limits == pair[1])
            mine = mine[rows.clearances]
            if not (mine.any() and np.isfinite(known[pair])) or left < -STOP_M:
                continue
            least = float((rows.slack[mine] + rows.rows[mine] @ step).min())
            assert real[pair] >= least - second - 1e-6, pair


@settings(max_examples=40, deadline=None)
@given(seed=seeds, name=st.sampled_from(MACHINES))
def test_rows_are_the_rates_of_the_corners_by_finite_differences(make, seed, name):
    """Where one corner alone is nearest to a limit's face, its row is the clearance's."""
    _, case = case_of(make, seed, name, ("box", "convex", "box", "box"))
    found, stop = case.stop(resting(case.q))
    rates = case.machine.distance_rows(case.machine.forward(case.q), case.T, found)
    for c in np.flatnonzero((found.distances > 0.01) & np.isfinite(slack_of(found, stop))).tolist():
        mine = np.flatnonzero(stop.rows.clearances == c)
        order = mine[np.argsort(stop.rows.slack[mine])]
        if len(order) < 2 or stop.rows.slack[order[1]] - stop.rows.slack[order[0]] < 1e-3:
            continue
        assert stop.rows.rows[order[0]] == pytest.approx(rates[c], abs=1e-4 + 1e-5 / found.distances[c])


@settings(max_examples=30, deadline=None)
@given(seed=seeds, name=st.sampled_from(MACHINES))
def test_another_way_falls_short_by_what_its_slack_says(make, seed, name):
    rng, case = case_of(make, seed, name, ("box", "convex", "tube"))
    postures = ways(rng, case, 3, 0.1)
    way = Way(postures, np.zeros_like(postures), np.arange(len(postures)) * 0.05)
    _, stop = case.stop(way)
    finite = np.asarray(stop.slack)[np.isfinite(stop.slack)]
    assert stop.shortfall(way, 0.0) <= 1e-9  # itself never falls short of itself
    if not len(finite):
        return
    other = postures + rng.normal(size=case.machine.n) * 0.02
    after = Way(other, np.zeros_like(other), way.times)
    short = stop.shortfall(after, 0.0)
    # and never less than the scene says: what had none may not lose, what had some may come down to none
    found, _, _ = case.look(case.q)
    held = by_pair(found, slack_of(found, stop))
    for p in range(len(other)):
        there, _, _ = case.look(other[p])
        before = by_pair(found, slack_of(found, stop, p))
        for pair, left in by_pair(there, room(there)).items():
            if pair[1] == 2 and left < -STOP_M:  # out of a bent tube is farther than out of each of its cells
                continue
            if np.isfinite(held.get(pair, np.inf)) and np.isfinite(before[pair]):
                assert short >= min(before[pair], 0.0) - left - 1e-6


def test_inside_a_chain_going_deeper_costs_slack(make):
    """Wherever the joints of its cells lie: the way through a shared face is no way out."""
    machine = machine_named("rre20")
    kin = machine.forward(machine.home)
    poses, halves = machine.solid_poses(kin)
    reach_of = poses[5][:3, 3] + halves[5][0]
    exact = MachineUncertainty.of(np.zeros((6, 6)), np.zeros(machine.n))
    for joint in np.linspace(0.0, 2.5, 9):
        for depth in (0.3, 0.8, 1.5):
            y = np.arange(-15.0, 15.1, 2.5) + joint
            middle = reach_of[0] - depth + 1.8
            path = np.stack([np.full(len(y), middle), y, np.zeros(len(y))], axis=1)
            envelope = make.chain_along(path, [(-1.8, -1.0), (1.8, -1.0), (1.8, 9.0), (-1.8, 9.0)])
            case = Case(
                machine, machine.home, np.eye(4), Scene(machine, [limit("track", envelope)]), exact, Integrity(5.33)
            )
            found, stop = case.stop(resting(machine.home))
            rows = stop.rows
            # straight in: boom and stick such that the tool moves towards the track
            jacobian = machine.tool_jacobian(kin)[[0, 2]][:, 1:3]
            inwards = np.zeros(machine.n)
            inwards[1:3] = np.linalg.solve(jacobian, [1.0, 0.0])
            attachment = found.solids[rows.clearances] == 5
            deepest = attachment & (rows.slack < 0.0)
            assert deepest.any()
            assert (rows.rows[deepest] @ inwards).min() < -0.1, (joint, depth)
            there, _, _ = case.look(machine.home + 1e-3 * inwards)
            assert by_pair(there, there.distances)[(5, 0)] < by_pair(found, found.distances)[(5, 0)]


def test_a_limit_that_does_not_count_is_not_there(make):
    _, case = case_of(make, 3, kinds=("box", "box", "ground"))
    solid = case.scene.limits[0].solid
    off = limit("off", solid, activity=Activity(state="gate"))
    case.scene = Scene(case.machine, [off])
    kin = case.machine.forward(case.q)
    found = case.scene.query(kin, case.T, 60.0, off_states=frozenset(["gate"]))
    around = Surroundings(case.scene, case.T, case.unsure, case.integrity, 0.0, off_states=frozenset(["gate"]))
    n = case.machine.n
    stop = Stop(
        around,
        found,
        case.q,
        resting(case.q),
        stop_distance_m=STOP_M,
        margin_m=0.0,
        reach=np.full((1, n), EVERYTHING),
    )
    assert (found.other_links[np.asarray(stop._of)] >= 0).all()
    on = case.scene.query(kin, case.T, 60.0)
    around = replace(around, off_states=frozenset())
    stop = Stop(
        around, on, case.q, resting(case.q), stop_distance_m=STOP_M, margin_m=0.0, reach=np.full((1, n), EVERYTHING)
    )
    assert (on.other_links[np.asarray(stop._of)] < 0).any()
