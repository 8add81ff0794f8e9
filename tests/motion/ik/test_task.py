"""Task rows: which part of the orientation a machine can hold, errors, and Jacobians against finite differences."""

import dataclasses
import functools
import math

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.machine.load import description_path, machine_from
from workgauge.machine.model import MachineModel
from workgauge.motion.ik.task import ROWS, ArmPlane, arm_plane, elevation, orientation_of, task_error, task_jacobian
from workgauge.values.tasks import Orientation
from workgauge.values.transforms import rotation, rotation_z

EVERY = ("rre20", "brokk5", "sun-a", "rre20/4", "rre20/5")
PLANAR = ("brokk5", "sun-a", "rre20/4")


@functools.cache
def machine_named(name: str) -> MachineModel:
    """A shipped machine, or with `/k` its first k joints alone."""
    shipped, _, joints = name.partition("/")
    content = yaml.safe_load(description_path(shipped).read_text())
    content.pop("positioning", None)
    content["sensors"] = []
    content["joints"] = content["joints"][: int(joints or 9)]
    return machine_from(content, shipped)


def posture(machine: MachineModel, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(machine.sample_min, machine.sample_max)


def pose(seed: int) -> np.ndarray:
    draw = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation(draw.normal(size=3)), draw.normal(size=3) * 4.0
    return T


seeds = st.integers(0, 10**6)
examples = settings(max_examples=25, deadline=None)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("rre20", Orientation.FULL),
        ("brokk5", Orientation.PITCH),
        ("sun-a", Orientation.PITCH),
        ("rre20/4", Orientation.PITCH),
        ("rre20/5", Orientation.PITCH),
        ("rre20/3", Orientation.FREE),
    ],
)
def test_what_a_machine_can_hold_follows_from_its_joints(name: str, expected: Orientation) -> None:
    assert orientation_of(machine_named(name)) is expected


@pytest.mark.parametrize("orientation", Orientation)
@pytest.mark.parametrize("name", EVERY)
@examples
@given(seeds)
def test_the_jacobian_is_how_the_error_changes(name: str, orientation: Orientation, seed: int) -> None:
    machine = machine_named(name)
    q, step = posture(machine, seed), 1e-6
    kin = machine.forward(q)
    T = machine.tool_pose(kin)
    assert np.abs(task_error(kin, machine, T, orientation)).max() < 1e-9
    J = task_jacobian(kin, machine, orientation)
    assert J.shape == (ROWS[orientation], machine.n)
    columns = [
        task_error(machine.forward(q - step * d), machine, T, orientation)
        - task_error(machine.forward(q + step * d), machine, T, orientation)
        for d in np.eye(machine.n)
    ]
    assert np.allclose(J, np.transpose(columns) / (2.0 * step), atol=1e-7 * (1.0 + np.abs(J).max()))


@pytest.mark.parametrize("normal", [None, (0.6, 0.0, 0.8), (0.0, 1.0, 0.0)])
@examples
@given(seeds)
def test_the_row_of_the_angle_holds_for_any_pose(normal: tuple[float, ...] | None, seed: int) -> None:
    # also for poses that no arm in a plane takes
    centre = np.array([0.3, -0.2])
    plane = ArmPlane(np.array([0.0, 0.0, 1.0]), None if normal is None else np.array(normal), centre)
    T, step = pose(seed), 1e-6
    level = T[:3, :3] @ plane.normal if plane.normal is not None else np.array([*(T[:2, 3] - centre), 0.0])
    value, row = elevation(T, plane)
    z = T[:3, 2]
    if math.hypot(*level[:2]) < 0.2 or math.hypot(z[2], z[:2] @ [-level[1], level[0]]) < 0.2 or abs(value) > 3.0:
        return
    for i in range(6):
        ends = []
        for h in (step, -step):
            moved = T.copy()
            if i < 3:
                moved[i, 3] += h
            else:
                moved[:3, :3] = rotation(h * np.eye(3)[i - 3]) @ T[:3, :3]
            ends.append(elevation(moved, plane)[0])
        assert row[i] == pytest.approx((ends[0] - ends[1]) / (2.0 * step), abs=1e-5 * (1.0 + np.abs(row).max()))


@pytest.mark.parametrize("name", PLANAR)
@examples
@given(seeds, seeds)
def test_the_angle_is_the_sum_of_the_planar_joints(name: str, seed: int, other: int) -> None:
    machine = machine_named(name)
    plane, a, b = arm_plane(machine), posture(machine, seed), posture(machine, other)
    kin_a, kin_b = machine.forward(a), machine.forward(b)
    assert np.allclose(task_jacobian(kin_a, machine, Orientation.PITCH)[3], [0.0] + [1.0] * (machine.n - 1))
    turned = elevation(machine.tool_pose(kin_b), plane)[0] - elevation(machine.tool_pose(kin_a), plane)[0]
    assert math.remainder(turned - (b - a)[1:].sum(), 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)


@examples
@given(seeds)
def test_upright_the_tiltrotator_changes_nothing_of_it(seed: int) -> None:
    machine = machine_named("rre20")
    q = posture(machine, seed)
    q[4] = 0.0
    plane, upright = arm_plane(machine), q * [1, 1, 1, 1, 0, 0]
    T = machine.tool_pose(machine.forward(q))
    angle = elevation(machine.tool_pose(machine.forward(upright)), plane)[0]
    assert elevation(T, plane)[0] == pytest.approx(angle, abs=1e-9)
    if T[0, 3] * math.cos(q[0]) + T[1, 3] * math.sin(q[0]) > 0.1:  # the tool is in front of the machine
        lower = elevation(machine.tool_pose(machine.forward(upright * 0.99)), plane)[0]
        expected = 0.01 * upright[1:4].sum()
        assert math.remainder(angle - lower - expected, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-6)


def test_upwards_is_positive_whichever_way_the_joints_turn() -> None:
    machine = machine_named("sun-a")
    chain = tuple(dataclasses.replace(joint, axis=-joint.axis) for joint in machine.chain)
    flipped = dataclasses.replace(machine, chain=chain, q_min=-machine.q_max, q_max=-machine.q_min)
    q = posture(machine, 3)
    there, here = flipped.forward(-q), machine.forward(q)
    assert np.allclose(flipped.tool_pose(there), machine.tool_pose(here))
    angles = [elevation(m.tool_pose(k), arm_plane(m))[0] for m, k in ((flipped, there), (machine, here))]
    assert angles[0] == pytest.approx(angles[1], abs=1e-9)
    assert np.allclose(task_jacobian(there, flipped, Orientation.PITCH)[3], [0, -1, -1, -1])


@pytest.mark.parametrize("name", EVERY)
@examples
@given(seeds, seeds, st.floats(-3.0, 3.0))
def test_the_angle_does_not_ask_where_the_machine_looks(name: str, seed: int, other: int, turned: float) -> None:
    machine = machine_named(name)
    q, goal = posture(machine, seed), machine.tool_pose(machine.forward(posture(machine, other)))
    error = task_error(machine.forward(q), machine, goal, Orientation.PITCH)
    q[0] += turned
    again = task_error(machine.forward(q), machine, rotation_z(turned) @ goal, Orientation.PITCH)
    assert math.remainder(again[3] - error[3], 2.0 * math.pi) == pytest.approx(0.0, abs=1e-8)


@pytest.mark.parametrize("orientation", Orientation)
@examples
@given(seeds, seeds)
def test_the_error_is_goal_minus_present(orientation: Orientation, seed: int, other: int) -> None:
    machine = machine_named("rre20")
    kin, goal = machine.forward(posture(machine, seed)), pose(other)
    T, error = machine.tool_pose(kin), task_error(kin, machine, goal, orientation)
    assert np.allclose(T[:3, 3] + error[:3], goal[:3, 3])
    if orientation is Orientation.FULL:
        assert np.allclose(rotation(error[3:]) @ T[:3, :3], goal[:3, :3], atol=1e-6)
    assert not error.flags.writeable
