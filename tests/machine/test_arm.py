"""The arm in compiled code against the machine model, and what it promises of distances, at random postures."""

from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from workgauge.machine import pairs
from workgauge.machine.arm import Arm, ArmAt, arm_of
from workgauge.machine.load import catalogue, load_machine, machine_from
from workgauge.machine.model import MachineModel
from workgauge.proximity.cells import CORNER_SIGNS
from workgauge.values.arrays import Floats

seeds = st.integers(0, 2**32 - 1)
slow = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])


@pytest.fixture(scope="module", autouse=True)
def _quick_pairs() -> Any:
    """Look at few postures for self-collision: nothing here depends on the pairs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pairs, "POSTURES", 10)
        yield


def random_machine(rng: np.random.Generator) -> MachineModel:
    """A machine of one to six joints that turn or slide, with boxes on any link, some of which stretch."""
    n = int(rng.integers(1, 7))
    sliding = rng.random(n) < 0.4
    joints = []
    for i in range(n):
        a, d = rng.uniform(-2.0, 2.0, 2).tolist()
        alpha, theta = rng.uniform(-180.0, 180.0, 2).tolist()
        dh = {"a_m": a, "alpha_deg": alpha, "d_m": d, "theta_deg": theta}
        if sliding[i]:
            lower, upper = float(rng.uniform(-1.0, 0.0)), float(rng.uniform(0.1, 2.0))
            ends = {"type": "prismatic", "lower_m": lower, "upper_m": upper, "home_m": 0.0}
            speeds = {"speed_positive_m_s": 1.0, "speed_negative_m_s": 0.5}
        else:
            ends = {"type": "revolute", "lower_deg": -170, "upper_deg": 170, "home_deg": 0}
            speeds = {"speed_positive_deg_s": 30, "speed_negative_deg_s": 20}
        joints.append({"name": f"j{i}", "link": f"l{i + 1}", "dh": dh, **ends, **speeds})
    solids = []
    links = [int(rng.integers(0, n + 1)) for _ in range(int(rng.integers(1, 6)))]
    for k, link in enumerate(links):
        box = {
            "name": f"b{k}",
            "link": f"l{link}" if link else "undercarriage",
            "centre_m": rng.uniform(-2.0, 2.0, 3).tolist(),
            "size_m": rng.uniform(2.1, 3.0, 3).tolist(),
            "rpy_deg": rng.uniform(-180.0, 180.0, 3).tolist(),
        }
        own = np.flatnonzero(sliding)  # any may stretch it, before its link or after, if it is the link's only box
        if len(own) and links.count(link) == 1 and rng.random() < 0.7:
            joint = int(rng.choice(own))
            box["stretch"] = {
                "joint": f"j{joint}",
                "axis": str(rng.choice(list("xyz"))),
                "side": str(rng.choice(["positive", "negative"])),
            }
        solids.append(box)
    pose = {"position_m": rng.uniform(-2.0, 2.0, 3).tolist(), "rpy_deg": rng.uniform(-180.0, 180.0, 3).tolist()}
    return machine_from(
        {
            "title": "random",
            "undercarriage": {"kind": "tracks", "gauge_m": 2.0},
            "base": pose,
            "joints": joints,
            "solids": solids,
            "attachments": [{"name": "tool", "tool": pose}],
        }
    )


def postures(machine: MachineModel, rng: np.random.Generator, count: int) -> Floats:
    """Postures anywhere between the joints' ends, the ends among them."""
    share = rng.random((count, machine.n))
    share[rng.random(share.shape) < 0.2] = 1.0
    share[rng.random(share.shape) < 0.2] = 0.0
    return np.asarray(machine.sample_min + share * (machine.sample_max - machine.sample_min))


def a_pose(rng: np.random.Generator) -> Floats:
    T = np.eye(4)
    T[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    T[:3, 3] = rng.normal(size=3) * rng.choice([1.0, 2000.0])
    return T


def check_places(machine: MachineModel, rng: np.random.Generator) -> None:
    """Corners, axes and what points do when one joint moves, against the model's own matrices and Jacobians."""
    T, some = a_pose(rng), postures(machine, rng, 4)
    at = arm_of(machine).at(T, some)
    assert isinstance(at, ArmAt)
    close = 1e-12 * (10.0 + np.abs(T[:3, 3]).max())
    for p, q in enumerate(some):
        kin = machine.forward(q)
        poses, halves = machine.solid_poses(kin)
        boxes = T @ poses
        corners = (CORNER_SIGNS * halves[:, None]) @ boxes[:, :3, :3].transpose(0, 2, 1) + boxes[:, None, :3, 3]
        assert np.abs(at.corners[p] - corners).max() < 10.0 * close
        assert np.abs(at.rotations[p] - boxes[:, :3, :3]).max() < 1e-12
        inverse = np.linalg.inv(T)
        origins = at.origins[p] @ inverse[:3, :3].T + inverse[:3, 3]
        axes = at.axes[p] @ T[:3, :3]
        linear, angular = kin.spatial_jacobian[:3].T, kin.spatial_jacobian[3:].T
        slides = machine.prismatic.astype(bool)
        assert np.abs(np.where(slides[:, None], linear, angular) - axes).max(initial=0.0) < 1e-9
        turning = np.cross(origins, axes)  # a x (0 - o): of the point at the machine frame's origin
        assert np.abs((linear - turning)[~slides]).max(initial=0.0) < 100.0 * close


@slow
@given(seed=seeds)
def test_random_machines_are_where_their_models_say(seed: int) -> None:
    rng = np.random.default_rng(seed)
    check_places(random_machine(rng), rng)


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_shipped_machines_are_where_their_models_say(name: str) -> None:
    check_places(load_machine(name), np.random.default_rng(0))


def check_bounds(machine: MachineModel, rng: np.random.Generator) -> None:
    """Levers, reach and farthest bound what they say, and by how far any corner can move."""
    arm, T = Arm(machine), a_pose(rng)
    some = postures(machine, rng, 30)
    at = arm.at(T, some)
    carried = np.arange(machine.n) < arm.links[:, None]
    rounding = 1e-9 * (1.0 + np.abs(T[:3, 3]).max())
    assert (np.linalg.norm(at.corners - T[:3, 3], axis=-1) <= arm.reach_m + rounding).all()
    for s in range(len(arm.links)):
        for j in np.flatnonzero(carried[s] & (machine.prismatic == 0)).tolist():
            apart = at.corners[:, s] - at.origins[:, j, None]
            along = np.vecdot(apart, at.axes[:, j, None])[..., None] * at.axes[:, j, None]
            assert (np.linalg.norm(apart - along, axis=-1) <= arm.levers[s, j] + rounding).all()
    assert (arm.levers.max(axis=0) <= arm.farthest).all() and (arm.levers <= max(arm.reach_m, 2.0)).all()
    # moving the joints by d moves no corner farther than the levers allow
    moved = np.clip(some + rng.uniform(-0.5, 0.5, some.shape) * rng.choice([1.0, 0.01]), some.min(0), some.max(0))
    way = np.linalg.norm(arm.at(T, moved).corners - at.corners, axis=-1).max(axis=-1)
    assert (way <= np.abs(moved - some) @ arm.levers.T + rounding).all()
    # a joint that carries or stretches no box has no lever on it
    for j in range(machine.n):
        one = some.copy()
        one[:, j] = machine.sample_min[j]
        still = np.abs(arm.at(T, one).corners - at.corners).max(axis=(0, 2, 3)) < rounding
        assert (arm.levers[~still, j] > 0.0).all()


@slow
@given(seed=seeds)
def test_nothing_moves_farther_than_the_levers_of_random_machines_allow(seed: int) -> None:
    rng = np.random.default_rng(seed)
    check_bounds(random_machine(rng), rng)


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_nothing_moves_farther_than_the_levers_of_shipped_machines_allow(name: str) -> None:
    check_bounds(load_machine(name), np.random.default_rng(1))


def test_a_machine_is_packed_once() -> None:
    machine = load_machine("rre20")
    assert arm_of(machine) is arm_of(machine)
    assert not any(array.flags.writeable for array in arm_of(machine).packed)
