"""Protection levels: against corners moved by finite differences, and the laws they obey."""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from workgauge.machine.load import load_machine, machine_from
from workgauge.machine.positioning import IntegritySpec
from workgauge.proximity.protection import LARGEST_TURN, Integrity, protection_factor, with_protection
from workgauge.proximity.scene import Scene
from workgauge.proximity.uncertainty import LimitUncertainty, MachineUncertainty, own_place
from workgauge.values import transforms as tf
from workgauge.values.arrays import frozen
from workgauge.values.limits import Limit, LimitKind, Source
from workgauge.values.solids import Box, Convex, PrismChain, Solid, Surface, Tube

MACHINES = ("rre20", "brokk5", "telescope", "sleeve")


@functools.cache
def machine_named(name):
    """A machine of the catalogue, or a telescope whose box hangs on its moving link or on the sleeve around it."""
    if name not in ("telescope", "sleeve"):
        return load_machine(name)
    moving = name == "telescope"
    speeds = {f"speed_{way}_{unit}": 0.3 for way in ("positive", "negative") for unit in ("deg_s", "m_s")}
    turning = {name: value for name, value in speeds.items() if name.endswith("deg_s")}
    sliding = {name: value for name, value in speeds.items() if name.endswith("_m_s")}
    return machine_from(
        {
            "title": name,
            "undercarriage": {"kind": "wheels", "gauge_m": 2.0},
            "joints": [
                {"name": "swing", "link": "cabin", "type": "revolute", "continuous": True, "home_deg": 0, **turning}
                | {"dh": {"a_m": 0.5, "alpha_deg": 90, "d_m": 1.5}},
                {"name": "lift", "link": "boom", "type": "revolute", "lower_deg": -30, "upper_deg": 60, "home_deg": 0}
                | {**turning, "dh": {"a_m": 1.0, "alpha_deg": 70, "d_m": 0.0}},
                {"name": "reach", "link": "arm", "type": "prismatic", "lower_m": 0, "upper_m": 1.5, "home_m": 0}
                | {**sliding, "dh": {"a_m": 0, "alpha_deg": 0, "d_m": 2.0}},
            ],
            "solids": [
                {"name": "box", "centre_m": [0, 0, -1.0 if moving else 1.0], "size_m": [0.4, 0.3, 2.2]}
                | {"link": "arm" if moving else "boom"}
                | {"stretch": {"joint": "reach", "axis": "z", "side": "negative" if moving else "positive"}},
                {"name": "base", "link": "undercarriage", "centre_m": [0, 0, 0.5], "size_m": [2.0, 1.5, 1.0]},
            ],
            "attachments": [{"name": "hook", "tool": {}}],
        }
    )


EXACT = np.zeros((6, 6))
#: Small enough that the second order is nothing, large enough for rounding.
TINY = 1e-5


def limit(name: str, solid: Solid, **facts) -> Limit:
    return Limit(name, LimitKind.POINT, name, solid, "test", Source("test", name), **facts)


def box(x, y, z, half, turn=(0.0, 0.0, 0.0)) -> Box:
    T = np.array(tf.translation(x, y, z))
    T[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    return Box(frozen(T), frozen(half))


def around(rng, count=6, **facts) -> list[Limit]:
    """Boxes at random places and in random positions round the machine."""
    limits = []
    for i in range(count):
        angle, away = rng.uniform(-math.pi, math.pi), rng.uniform(4.0, 14.0)
        place = away * math.cos(angle), away * math.sin(angle), rng.uniform(-1.0, 6.0)
        limits.append(limit(f"l{i}", box(*place, rng.uniform(0.1, 2.0, 3), rng.normal(size=3)), **facts))
    return limits


def spread(rng, size, scale=1.0):
    """A random covariance."""
    root = rng.normal(size=(size, size)) * scale
    return root @ root.T


class Case:
    """A machine somewhere among limits, with everything `with_protection` asks for."""

    def __init__(self, seed, name="rre20", limits=None, T=None):
        rng = self.rng = np.random.default_rng(seed)
        self.machine = machine_named(name)
        low, high = self.machine.sample_min, self.machine.sample_max
        self.q = low + rng.random(self.machine.n) * (high - low)
        if T is None:
            T = np.array(tf.translation(*rng.uniform(-3, 3, 3)))
            T[:3, :3] = Rotation.from_rotvec(rng.normal(size=3) * (0.1, 0.1, 2.0)).as_matrix()
        self.T = T
        self.kin = self.machine.forward(self.q)
        self.scene = Scene(self.machine, around(rng) if limits is None else limits)
        self.found = self.scene.query(self.kin, self.T, 12.0)
        self.rows = self.machine.distance_rows(self.kin, self.T, self.found)

    def levels(self, pose=EXACT, joints=0.0, k=1.0, bias=0.0, *, limits=None, **facts):
        sigma = np.broadcast_to(np.asarray(joints, dtype=float), (self.machine.n,))
        unsure = MachineUncertainty.of(pose, sigma, **facts)
        return self.levels_of(unsure, Integrity(k, bias), limits)

    def levels_of(self, unsure, integrity, limits=None):
        given = (self.found, self.rows, self.kin, self.machine, self.T, unsure)
        found, self.largest = with_protection(*given, limits or self.scene.uncertainty, integrity)
        assert found.distances is self.found.distances
        return found.protections

    def corner(self, i, error, corner):
        """Where a corner of clearance i's solid is after an error of pose and joints, the other link held still."""
        machine, found = self.machine, self.found
        kin = machine.forward(self.q + error[6:])
        poses, halves = machine.solid_poses(kin)
        s = found.solids[i]
        x = poses[s, :3, :3] @ (corner * halves[s]) + poses[s, :3, 3]
        other = int(found.other_links[i])
        if other >= 0:
            x = self.kin.T_machine_links[other] @ tf.inverse(kin.T_machine_links[other]) @ [*x, 1.0]
            return self.T[:3, :3] @ x[:3] + self.T[:3, 3]
        turned = Rotation.from_rotvec(error[3:6]).as_matrix() @ self.T[:3, :3]
        return turned @ x + self.T[:3, 3] + error[:3]

    def oracle(self, i, covariance, k, extra=0.0):
        """The worst corner of clearance i, each moved by finite differences."""
        n, step, worst = self.found.normals[i], 1e-6, 0.0
        for corner in np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T:
            gradient = np.array(
                [
                    n @ (self.corner(i, step * e, corner) - self.corner(i, -step * e, corner)) / (2 * step)
                    for e in np.eye(6 + self.machine.n)
                ]
            )
            beyond = n @ (self.corner(i, np.zeros(6 + self.machine.n), corner) - self.found.points_machine[i])
            worst = max(worst, k * math.sqrt(gradient @ covariance @ gradient + extra) - max(beyond, 0.0))
        return worst


def test_the_factor_is_the_gaussian_tail_on_both_sides():
    assert protection_factor(1e-7) == pytest.approx(5.3267, abs=1e-4)
    for risk in (0.3, 1e-3, 1e-7, 1e-12):
        assert 2.0 * norm.sf(protection_factor(risk)) == pytest.approx(risk, rel=1e-9)
    for risk in (0.0, 1.0, -1e-7, math.nan):
        with pytest.raises(ValueError, match="risk"):
            protection_factor(risk)
    assert Integrity.of(IntegritySpec(risk=1e-5, bias_m=0.02)) == Integrity(protection_factor(1e-5), 0.02)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from(MACHINES), st.booleans())
def test_it_is_the_worst_corner_moved_by_finite_differences(seed, name, correlated):
    """Also against the closest point alone: never less than `k sigma` there."""
    case = Case(seed, name)
    if not len(case.found):
        return
    n, k = case.machine.n, 3.0
    whole = spread(case.rng, 6 + n, 0.02)
    if not correlated:
        whole[:6, 6:], whole[6:, :6] = 0.0, 0.0
        whole[6:, 6:] = np.diag(np.diag(whole)[6:])
    whole *= TINY**2
    tool = 0.01 * TINY
    sigma = np.sqrt(np.diag(whole)[6:])
    given = {"cross": whole[:6, 6:], "joint_covariance": whole[6:, 6:]} if correlated else {}
    levels = case.levels(whole[:6, :6], sigma, k, tool_sigma_m=tool, **given)
    second = 0.5 * (k * np.sqrt(np.diag(whole)[3:]).sum()) ** 2 * 30.0
    for i in case.rng.choice(len(levels), min(4, len(levels)), replace=False):
        on_tool = case.machine.tool_link in (case.found.links[i], case.found.other_links[i])
        extra = tool**2 if on_tool else 0.0
        worst = case.oracle(i, whole, k, extra)
        assert worst * (1 - 1e-5) - 1e-9 * TINY <= levels[i] <= worst * (1 + 1e-5) + second
        outside = float(case.found.other_links[i] < 0)
        wrench = np.r_[
            case.found.normals[i] * outside,
            np.cross(case.found.points_machine[i] - case.T[:3, 3], case.found.normals[i]) * outside,
            case.rows[i],
        ]
        assert levels[i] >= k * math.sqrt(wrench @ whole @ wrench + extra) * (1 - 1e-9)


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 2**32), st.sampled_from(MACHINES), st.floats(0.0, 0.1), st.floats(0.5, 6.0), st.floats(0.0, 0.2)
)
def test_with_nothing_unsure_tolerance_and_bias_are_left(seed, name, tolerance, k, bias):
    rng = np.random.default_rng(seed)
    case = Case(seed, name, around(rng, tolerance_m=tolerance))
    own = case.found.other_links >= 0
    expected = np.where(own, 0.0, k * tolerance) + bias
    assert_allclose(case.levels(k=k, bias=bias), expected, atol=1e-15)
    assert case.largest == pytest.approx(k * tolerance + bias, abs=1e-15)
    assert_allclose(case.levels(1e-40 * np.eye(6), 1e-20, k, bias), expected, atol=1e-12)
    tool = (case.found.links == case.machine.n) | (case.found.other_links == case.machine.n)
    widened = np.where(own, 0.0, tolerance**2) + np.where(tool, 0.03**2, 0.0)
    assert_allclose(case.levels(k=k, bias=bias, tool_sigma_m=0.03), k * np.sqrt(widened) + bias, atol=1e-15)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from(MACHINES), st.floats(0.1, 5.4))
def test_it_is_never_negative_grows_with_every_sigma_and_stays_below_the_largest(seed, name, k):
    case = Case(seed, name)
    n = case.machine.n
    pose, joints = spread(case.rng, 6, 0.003), case.rng.uniform(0.0, 0.003, n)
    before = case.levels(pose, joints, k)
    assert (before >= 0.0).all() and np.isfinite(before).all()
    assert before.max(initial=0.0) <= case.largest
    for j in range(6):
        more = pose + np.outer(*(2 * [np.eye(6)[j] * 0.004]))
        assert (case.levels(more, joints, k) >= before - 1e-12).all()
    for j in range(n):
        assert (case.levels(pose, joints + 0.002 * np.eye(n)[j], k) >= before - 1e-12).all()
    assert (case.levels(pose, joints, k, tool_sigma_m=0.01) >= before - 1e-12).all()
    assert (case.levels(pose, joints, 1.1 * k) >= before - 1e-12).all()
    assert_allclose(case.levels(pose, joints, k, 0.1), before + 0.1, atol=1e-12)
    loose = replace(
        case.scene.uncertainty, variances=case.scene.uncertainty.variances + 0.5**2, largest_variance=0.5**2
    )
    after = case.levels(pose, joints, k, limits=loose, tool_sigma_m=0.3)
    assert (after >= before - 1e-12).all() and after.max(initial=0.0) <= case.largest
    assert case.largest >= k * math.hypot(0.5, 0.3)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from(MACHINES))
def test_turning_and_shifting_the_whole_site_changes_nothing(seed, name):
    rng = np.random.default_rng(seed)
    solids = [one.solid for one in around(rng)]
    twist = np.array(tf.translation(*rng.uniform(-50, 50, 3)))
    twist[:3, :3] = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
    both = np.kron(np.eye(2), twist[:3, :3])
    doubt = [spread(rng, 6, 0.004) for _ in solids]
    here = Case(seed, name, [limit(f"l{i}", s, covariance=frozen(doubt[i])) for i, s in enumerate(solids)])
    there = Case(
        seed,
        name,
        [
            limit(
                f"l{i}",
                Box(frozen(twist @ s.T_frame_box), s.half_extents),
                covariance=frozen(both @ doubt[i] @ both.T),
            )
            for i, s in enumerate(solids)
        ],
        twist @ here.T,
    )
    if here.found.distances.min(initial=1.0) < 1e-3 or len(here.found) != len(there.found):
        return  # which way out of an overlap is one of several
    pose = spread(rng, 6, 0.003)
    # faces parallel to each other have no closest point of their own
    same = np.abs(there.found.points_machine - here.found.points_machine @ twist[:3, :3].T - twist[:3, 3]).max(axis=1)
    before = here.levels(pose, 0.002, 5.33)[same < 1e-5]
    after = there.levels(both @ pose @ both.T, 0.002, 5.33)[same < 1e-5]
    assert_allclose(after, before, rtol=1e-3, atol=1e-5)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from(MACHINES))
def test_between_two_links_only_the_joints_between_them_count(seed, name):
    case = Case(seed, name, [])
    pose = spread(case.rng, 6, 0.01)
    assert not case.levels(pose).any()
    links = np.arange(case.machine.n)
    for i, (mover, other) in enumerate(zip(case.found.links, case.found.other_links, strict=True)):
        assert mover > other >= 0
        elsewhere = np.where((links < other) | (links >= mover), 0.003, 0.0) * TINY
        if case.machine.solids[case.found.solids[i]].stretch is None:
            assert case.levels(pose, elsewhere, 1.0)[i] <= 1e-9
        assert_allclose(case.levels(pose, 0.003 * TINY)[i], case.levels(EXACT, 0.003 * TINY)[i])


def test_the_lever_arm_multiplies_the_heading():
    machine = machine_named("rre20")
    kin = machine.forward(machine.home)
    tip = float(max(machine.tool_pose(kin)[0, 3], 0.0))
    wall = box(0.0, 40.0, 3.0, (60.0, 30.0, 10.0), (0.0, 0.0, 0.4))
    case = Case(0, limits=[limit("wall", wall)], T=np.eye(4))
    case.q, case.kin = machine.home, kin
    case.found = case.scene.query(kin, np.eye(4), 30.0)
    case.rows = machine.distance_rows(kin, np.eye(4), case.found)
    heading = np.diag([0, 0, 0, 0, 0, (math.radians(0.1) * TINY) ** 2])
    for clearance, level in zip(case.found, case.levels(heading), strict=True):
        if clearance.limit == "wall":
            arm = abs(np.cross(clearance.point_machine, clearance.normal)[2])
            assert level == pytest.approx(arm * math.radians(0.1) * TINY, rel=1e-6)
    assert tip > 5.0 and case.levels(heading).max() > 5.0 * math.radians(0.1) * TINY


def test_the_far_corner_of_a_parallel_face_counts():
    """A tail 3 m wide before a wall: the closest point may lie anywhere on it, its corners swing with the heading."""
    machine = machine_named("rre20")
    wall = box(0.0, 12.0, 3.0, (30.0, 4.0, 10.0))
    case = Case(1, limits=[limit("wall", wall)], T=np.eye(4))
    case.q = np.array(machine.home)
    case.kin = machine.forward(case.q)
    case.found = case.scene.query(case.kin, np.eye(4), 30.0)
    case.rows = machine.distance_rows(case.kin, np.eye(4), case.found)
    sigma = math.radians(0.2)
    levels = case.levels(np.diag([0, 0, 0, 0, 0, (sigma * TINY) ** 2]), k=3.0) / TINY
    undercarriage = [i for i, c in enumerate(case.found) if c.limit == "wall" and c.link == "undercarriage"]
    poses, halves = machine.solid_poses(case.kin)
    reach = max(abs(poses[s, 0, 3]) + halves[s, 0] for s in case.found.solids[undercarriage])
    assert max(levels[undercarriage]) == pytest.approx(3.0 * sigma * reach, rel=1e-6)
    # and the true distance after the turn is what the bound says, to second order
    turned = case.scene.query(case.kin, tf.rotation_z(3.0 * sigma), 30.0)
    before = min(case.found.distances[i] for i in undercarriage)
    after = min(c.distance_m for c in turned if c.limit == "wall" and c.link == "undercarriage")
    level = max(case.levels(np.diag([0, 0, 0, 0, 0, sigma**2]), k=3.0)[undercarriage])
    assert before - level <= after <= before - 0.9 * 3.0 * sigma * reach


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from(MACHINES), st.floats(1.0, 5.33))
def test_first_and_second_order_together_bound_every_error_of_k_sigma(seed, name, k):
    """Errors on the k-sigma ellipsoid never bring the solid nearer a convex limit than the level says."""
    case = Case(seed, name)
    n = case.machine.n
    scale = case.rng.uniform(0.0, 0.25 / k) / math.sqrt(3 + n)
    whole = np.diag(case.rng.uniform(0, [0.1] * 3 + [scale] * (3 + n)) ** 2)
    levels = case.levels(whole[:6, :6], np.sqrt(np.diag(whole)[6:]), k)
    assert np.isfinite(levels).all() and levels.max(initial=0.0) <= case.largest
    known = {(s, m): i for i, (s, m) in enumerate(zip(case.found.solids, case.found.limits, strict=True))}
    for _ in range(8):
        error = case.rng.normal(size=6 + n)
        error *= k / np.linalg.norm(error)
        error *= np.sqrt(np.diag(whole))
        T = np.array(case.T)
        T[:3, :3] = Rotation.from_rotvec(error[3:6]).as_matrix() @ T[:3, :3]
        T[:3, 3] += error[:3]
        moved = case.scene.query(case.machine.forward(case.q + error[6:]), T, 12.0)
        for s, m, distance in zip(moved.solids, moved.limits, moved.distances, strict=True):
            if (s, m) in known and m < len(case.scene.limits):
                i = known[s, m]
                assert distance >= case.found.distances[i] - levels[i] - 1e-5


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from(["telescope", "sleeve"]), st.floats(0.0, 1.0))
def test_shifts_and_slides_of_any_size_are_the_worst_corner_exactly(seed, name, shift):
    """Nothing turns: no second order. A box that stretches has corners that slide and corners that do not."""
    case = Case(seed, name)
    whole = np.diag([shift**2, 0.3**2, 0.1**2, 0, 0, 0, 0, 0, case.rng.uniform(0.1, 1.0) ** 2])
    levels = case.levels(whole[:6, :6], np.sqrt(np.diag(whole)[6:]), 3.0)
    for i, level in enumerate(levels):
        assert level == pytest.approx(case.oracle(i, whole, 3.0), rel=1e-6, abs=1e-7)
    assert levels.max(initial=0.0) <= case.largest
    slide = case.levels(joints=np.array([0.0, 0.0, 1.0]), k=3.0)
    assert slide.max(initial=0.0) <= case.largest
    # together with turning, what slides out is swung as well
    both = case.levels(joints=np.array([0.0, 0.1, 1.0]), k=3.0)
    swung = (case.found.links > 1) & (case.found.other_links < 0)
    assert (both[swung] >= slide[swung] + 0.9 - 1e-9).all()


def test_what_turns_towards_a_wall_behind_it_is_caught_by_the_second_order():
    """Turning about the machine's origin brings an arm that points away from a wall nearer, by r (1 - cos)."""
    machine = machine_named("rre20")
    T = np.array(tf.translation(0.0, 0.0, 0.0))
    case = Case(1, limits=[limit("wall", box(-13.0, 0.0, 3.0, (1.0, 60.0, 30.0)))], T=T)
    case.q = np.array(machine.home)
    case.kin = machine.forward(case.q)
    case.found = case.scene.query(case.kin, T, 40.0)
    case.rows = machine.distance_rows(case.kin, T, case.found)
    k, sigma, missed = 5.0, 0.06, 0
    first = case.levels(np.diag([0, 0, 0, 0, 0, (sigma * TINY) ** 2]), k=k) / TINY
    levels = case.levels(np.diag([0, 0, 0, 0, 0, sigma**2]), k=k)
    for turn in (k * sigma, -k * sigma):
        for i, after in enumerate(case.scene.query(case.kin, tf.rotation_z(turn), 40.0)):
            if after.limit == "wall":
                assert after.distance_m >= case.found.distances[i] - levels[i]
                missed += after.distance_m < case.found.distances[i] - first[i] - 0.05
    assert missed >= 2


def test_errors_that_go_together_add_up_to_a_larger_turn():
    case, n, k = Case(3), 6, 5.0
    sigma = 0.9 * LARGEST_TURN / k / math.sqrt(n)
    apart = case.levels(joints=sigma, k=k)
    assert np.isfinite(apart).all() and math.isfinite(case.largest)
    together = case.levels(joints=sigma, k=k, joint_covariance=np.full((n, n), sigma**2))
    assert np.isinf(together).any() and math.isinf(case.largest)


def test_an_uncertain_limit_may_not_turn_too_far_either():
    for sigma, finite in ((0.06, True), (0.08, False)):
        covariance = frozen(np.diag([0, 0, 0, 0, 0, sigma**2]))
        case = Case(3, limits=around(np.random.default_rng(3), covariance=covariance))
        levels = case.levels(k=5.0)[case.found.other_links < 0]
        assert np.isfinite(levels).all() == finite and math.isfinite(case.largest) == finite
        assert np.isfinite(case.levels(k=5.0)[case.found.other_links >= 0]).all()


def test_beyond_small_angles_nothing_is_sure():
    case = Case(3)
    assert len(case.found)
    heading = np.diag([0, 0, 0, 0, 0, (0.99 * LARGEST_TURN / 5.0) ** 2])
    assert np.isfinite(case.levels(heading, k=5.0)).all() and math.isfinite(case.largest)
    outside = case.found.other_links < 0
    levels = case.levels(heading * 1.1, k=5.0)
    assert np.isinf(levels[outside]).all() and np.isfinite(levels[~outside]).all() and math.isinf(case.largest)
    case.levels(joints=0.99 * LARGEST_TURN / 5.0, k=5.0)
    assert math.isinf(case.largest)


@pytest.mark.parametrize(
    ("solid", "place"),
    [
        (box(1.0, 2.0, 3.0, (1, 1, 1), (0.3, 0.2, 0.1)), (1, 2, 3)),
        (Tube(frozen([[0, 0, 0], [2, 0, 0], [4, 3, 0]]), 0.5), (2, 1, 0)),
        (Convex(frozen([[0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, 4]]), np.zeros((0, 3), int)), (1, 1, 1)),
        (Surface(frozen([[0, 0, 0], [3, 0, 0], [0, 3, 3]]), np.zeros((0, 3), int)), (1, 1, 1)),
        (
            PrismChain(
                frozen([[0, 0, 0], [2, 0, 0]]),
                frozen([[2, 0, 0], [4, 2, 0]]),
                frozen([[0, 1, 0]] * 2),
                frozen(np.zeros((2, 4, 2))),
                frozen(np.zeros((2, 2))),
                np.ones((2, 2), bool),
            ),
            (2, 0.5, 0),
        ),
    ],
    ids=["box", "tube", "convex", "surface", "chain"],
)
def test_a_limits_own_place_is_the_mean_of_what_defines_it(solid, place):
    assert_allclose(own_place(solid), place)
    unsure = LimitUncertainty.of([limit("l", solid, covariance=frozen(np.eye(6)))])
    assert_allclose(unsure.places, [place])


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32))
def test_an_uncertain_limit_moves_and_turns_about_its_own_place(seed):
    """Against the limit moved by finite differences before a machine that stands still."""
    rng = np.random.default_rng(seed)
    covariance = spread(rng, 6, 0.01 * TINY)
    case = Case(seed, limits=around(rng, 3, covariance=frozen(covariance)))
    levels = case.levels(k=3.0)
    second = 0.5 * (3.0 * np.sqrt(np.diag(covariance)[3:]).sum()) ** 2 * 60.0
    for i, clearance in enumerate(case.found):
        if clearance.limit.startswith("self:"):
            continue
        place = case.scene.limits[case.found.limits[i]].solid.T_frame_box[:3, 3]
        n, worst, step = clearance.normal, 0.0, 1e-6
        for corner in np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T:
            x = case.corner(i, np.zeros(6 + case.machine.n), corner)
            opposite, gradient = x - n * (n @ (x - clearance.point_limit)), []
            for error in np.eye(6) * step:
                there = [
                    Rotation.from_rotvec(way * error[3:]).as_matrix() @ (opposite - place) + way * error[:3]
                    for way in (1.0, -1.0)
                ]
                gradient.append(-n @ (there[0] - there[1]) / (2 * step))
            sigma = math.sqrt(np.array(gradient) @ covariance @ gradient)
            worst = max(worst, 3.0 * sigma - max(n @ (x - clearance.point_machine), 0.0))
        assert worst * (1 - 1e-4) - 1e-9 * TINY <= levels[i] <= worst * (1 + 1e-4) + second + 2e-9
        assert levels.max() <= case.largest
    fixed = Case(seed, limits=[replace(one, covariance=EXACT) for one in case.scene.limits])
    assert not fixed.levels(k=1.0).any()


def test_nothing_near_has_no_levels_but_a_largest_one():
    case = Case(4, limits=[])
    none = case.scene.query(case.kin, case.T, 1e-9)
    if len(none):
        pytest.skip("the posture touches itself")
    case.found, case.rows = none, np.zeros((0, case.machine.n))
    assert case.levels(np.eye(6) * 1e-4).shape == (0,) and case.largest > 0.0


@pytest.mark.filterwarnings("ignore:invalid value")
def test_what_is_not_a_number_never_makes_a_level_smaller():
    case = Case(3)
    good = case.levels(np.eye(6) * 1e-4, 0.001, 5.0)
    for bad in (math.nan, math.inf):
        for place in range(6):
            pose = np.eye(6) * 1e-4
            pose[place, place] = bad
            levels = case.levels(pose, 0.001, 5.0)
            assert not (levels < good - 1e-12).any()
            assert not case.largest < 1e3
