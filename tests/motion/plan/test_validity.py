"""What is said to be proven of a joint line holds at every posture of it, looked at closely by other means."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from workgauge.machine import pairs
from workgauge.machine.load import load_machine, machine_from
from workgauge.machine.model import MachineModel
from workgauge.motion.plan.validity import PROOF_M, Need, Validity
from workgauge.proximity.scene import Scene
from workgauge.rehearse.cluttered import cluttered
from workgauge.values.arrays import Floats, frozen
from workgauge.values.limits import Limit, LimitKind, Source
from workgauge.values.solids import Box
from workgauge.values.transforms import rpy

seeds = st.integers(0, 2**32 - 1)
law = settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.too_slow])
NEED = Need(clearance_m=0.05, stop_distance_m=0.2)


@pytest.fixture(scope="module", autouse=True)
def _quick_pairs() -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pairs, "POSTURES", 10)
        yield


def sliding_machine(rng: np.random.Generator) -> MachineModel:
    """A machine of turning and sliding joints with boxes, the last of which stretches."""
    joints = []
    for i, slides in enumerate(rng.permutation([False, False, True, True])):
        a, d = rng.uniform(-1.0, 1.0, 2).tolist()
        alpha, theta = rng.uniform(-180.0, 180.0, 2).tolist()
        ends = {"type": "revolute", "lower_deg": -170, "upper_deg": 170, "home_deg": 0}
        ends |= {"speed_positive_deg_s": 30, "speed_negative_deg_s": 20}
        if slides:
            ends = {"type": "prismatic", "lower_m": 0.0, "upper_m": 1.5, "home_m": 0.5}
            ends |= {"speed_positive_m_s": 1.0, "speed_negative_m_s": 0.5}
        dh = {"a_m": a, "alpha_deg": alpha, "d_m": d, "theta_deg": theta}
        joints.append({"name": f"j{i}", "link": f"l{i + 1}", "dh": dh, **ends})
    first, last = (next(j for j in some if j["type"] == "prismatic") for some in (joints, joints[::-1]))
    boxes: list[dict[str, Any]] = [
        {"name": f"b{k}", "link": link, "centre_m": [0.2, 0.0, 0.0], "size_m": [1.7, 0.3, 0.3]}
        for k, link in enumerate(("undercarriage", "l2", "l4"))
    ]
    for box, joint in ((boxes[1], last), (boxes[2], first)):
        box["stretch"] = {"joint": joint["name"], "axis": "x", "side": "positive"}
    pose = {"position_m": [0.5, 0.0, 0.0], "rpy_deg": [0.0, 0.0, 0.0]}
    return machine_from(
        {
            "title": "sliding",
            "undercarriage": {"kind": "tracks", "gauge_m": 2.0},
            "joints": joints,
            "solids": boxes,
            "attachments": [{"name": "tool", "tool": pose}],
        }
    )


def boxes_round(rng: np.random.Generator) -> list[Limit]:
    """Some boxes round a small machine."""
    limits = []
    for i in range(4):
        T = rpy(*rng.uniform(-math.pi, math.pi, 3).tolist())
        away = rng.normal(size=3)
        T[:3, 3] = away / np.linalg.norm(away) * rng.uniform(1.5, 4.0)
        solid = Box(frozen(T), frozen(rng.uniform(0.05, 0.6, 3)))
        limits.append(Limit(f"box {i}", LimitKind.ZONE, f"box {i}", solid, "random", Source("t", "b")))
    return limits


def setting(rng: np.random.Generator, which: int) -> Validity:
    """One of the shipped machines among clutter, or a sliding one among boxes."""
    if which:
        machine = load_machine(("rre20", "brokk5")[which - 1])
        drawn = cluttered(machine, int(rng.integers(1000)), stop_distance_m=NEED.stop_distance_m)
        return Validity(drawn.scene, drawn.T_site_machine, NEED)
    return Validity(Scene(sliding_machine(rng), boxes_round(rng)), np.eye(4), NEED)


def surplus(validity: Validity, q: Floats) -> float:
    """What the least clearance has above what is needed, asked of the scene alone."""
    found = validity.scene.query(validity.machine.forward(q), validity.T_site_machine, 1.0)
    stops = np.where(np.isnan(found.stop_distances), NEED.stop_distance_m, found.stop_distances)
    return float((found.distances - stops).min(initial=1.0)) - NEED.clearance_m


def kept(rng: np.random.Generator, validity: Validity) -> Floats | None:
    """A posture that keeps every clearance, if one of some is."""
    low, high = validity.machine.sample_min, validity.machine.sample_max
    return next((q for q in rng.uniform(low, high, (60, validity.machine.n)) if validity.keeps(q)), None)


@given(seeds, st.integers(0, 2))
@law
def test_no_clearance_is_used_up_where_a_posture_covers_a_line(seed: int, which: int) -> None:
    rng = np.random.default_rng(seed)
    validity = setting(rng, which)
    q = kept(rng, validity)
    if q is None:
        return
    for _ in range(8):
        half = rng.normal(size=len(q)) * (rng.random(len(q)) < 0.6) * 10.0 ** rng.uniform(-2.0, 0.3)
        share = validity.covers(q, np.abs(half))
        assert 0.0 < share <= 1.0
        for part in np.linspace(-1.0, 1.0, 9):
            moved = q + 2.0 * part * share * half
            slid = validity.machine.prismatic  # bounds hold within the travel of sliding joints
            if ((moved < validity.machine.q_min) | (moved > validity.machine.q_max))[slid].any():
                continue
            assert surplus(validity, moved) >= -1e-7


@given(seeds, st.integers(0, 2))
@law
def test_a_proven_line_keeps_every_clearance_all_along(seed: int, which: int) -> None:
    rng = np.random.default_rng(seed)
    validity = setting(rng, which)
    a = kept(rng, validity)
    if a is None:
        return
    for _ in range(6):
        toward = rng.uniform(validity.machine.sample_min, validity.machine.sample_max)
        b = a + rng.random() * (toward - a)
        straight = validity.straight(a, b)
        assert straight == validity.straight(b, a)
        if straight:
            assert all(surplus(validity, a + share * (b - a)) >= 0.0 for share in np.linspace(0.0, 1.0, 100))
        else:
            between = float(validity.scene.arm.farthest @ np.abs(b - a)) / 60
            assert any(
                surplus(validity, a + share * (b - a)) < PROOF_M + between for share in np.linspace(0.0, 1.0, 61)
            )


def test_joints_that_cannot_move_together_move_one_group_after_the_other() -> None:
    rng = np.random.default_rng(4)
    validity = setting(rng, 2)
    groups = validity.machine.exclusive_groups
    assert len(groups) == 2
    moved = 0
    while moved < 5:
        a, b = kept(rng, validity), kept(rng, validity)
        assert a is not None and b is not None
        way = validity.motion(a, b)
        if way is None:
            continue
        moved += 1
        assert np.array_equal(way[0], a) and np.array_equal(way[-1], b)
        for leg in np.diff(way, axis=0):
            assert sum(bool(leg[list(group)].any()) for group in groups) == 1


def test_a_posture_that_touches_keeps_nothing_and_is_told_from_one_that_is_only_near() -> None:
    machine = load_machine("rre20")
    tool = machine.tool_pose(machine.forward(machine.home))[:3, 3]
    for away, touches in ((0.0, True), (0.6, False)):
        T = np.eye(4)
        T[:3, 3] = tool + np.array([0.5 + away, 0.0, 0.0])
        limit = Limit("b", LimitKind.ZONE, "b", Box(frozen(T), frozen([0.3, 3.0, 3.0])), "r", Source("t", "b"))
        scene = Scene(machine, [limit])
        apart = scene.query_apart(machine.forward(machine.home), np.eye(4), 1.0)
        plain = scene.query(machine.forward(machine.home), np.eye(4), 1.0)
        validity = Validity(scene, np.eye(4), Need(0.05, 0.2))
        assert (apart is None) == touches == bool((plain.distances < 0.0).any())
        assert (validity.room(machine.home) == -np.inf) == touches
        assert validity.near(machine.home) == pytest.approx(float(plain.distances.min()) - 0.25)
        if apart is not None:
            assert np.array_equal(apart.distances, plain.distances)


@given(seeds, st.integers(0, 2))
@law
def test_giving_up_early_says_the_same_as_looking_closely(seed: int, which: int) -> None:
    rng = np.random.default_rng(seed)
    validity = setting(rng, which)
    machine, scene, T = validity.machine, validity.scene, validity.T_site_machine
    for q in rng.uniform(machine.sample_min, machine.sample_max, (8, machine.n)):
        plain, apart = scene.query(machine.forward(q), T, 1.0), scene.query_apart(machine.forward(q), T, 1.0)
        least = float(plain.distances.min(initial=1.0))
        assert least > 0.0 if apart is not None else least < 1e-4
        if apart is not None:
            assert np.array_equal(apart.distances, plain.distances) and np.array_equal(apart.limits, plain.limits)
