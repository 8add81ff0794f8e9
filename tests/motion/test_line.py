"""The straight tool path: drawn back to the line, orientation kept, nothing wound up."""

import functools
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.motion.desired import MotionConfig, MotionMemory, desired
from workgauge.motion.joystick import LeverFeel
from workgauge.motion.line import line_twist, rotation_vector, unit_direction
from workgauge.values import transforms as tf
from workgauge.values.arrays import frozen
from workgauge.values.measurements import DriveMode, Intent, Levers, Stamp, ToolLine
from workgauge.values.reasons import ReasonCode

machine_named = functools.cache(load_machine)

STAMP = Stamp("m", 0, "operator")
CONFIG = MotionConfig(feel=LeverFeel(ramp_s=0.0))
T_SITE = tf.translation(12.0, -3.0, 0.4) @ tf.rpy(0.01, -0.02, 2.1)


def intent(share: float, line: ToolLine | None, mode: DriveMode = DriveMode.LINE) -> Intent:
    return Intent(STAMP, mode, Levers(right_y=share), True, line)


def tool(machine: MachineModel, q: np.ndarray) -> np.ndarray:
    return T_SITE @ machine.tool_pose(machine.forward(q))


def follow(
    machine: MachineModel, q: np.ndarray, line: ToolLine, shares: list[float], allow: float = 1.0
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Drive along a line with ideal joints; returns the last posture and the tool pose at every tick."""
    memory, poses = MotionMemory(), []
    for share in shares:
        kin = machine.forward(q)
        qdot, _, memory = desired(intent(share, line), kin, machine, T_SITE, memory, CONFIG)
        q = q + allow * qdot * CONFIG.dt_s
        poses.append(tool(machine, q))
    return q, poses


def off_line(pose: np.ndarray, line: ToolLine) -> float:
    off = pose[:3, 3] - line.start_site
    along = off @ line.direction_site / np.linalg.norm(line.direction_site)
    return math.sqrt(max(off @ off - along * along, 0.0))


def test_the_tool_runs_straight_and_keeps_its_orientation() -> None:
    machine = machine_named("rre20")
    start = tool(machine, machine.home)
    line = ToolLine(frozen(start[:3, 3]), frozen([0.6, 0.8, 0.0]))
    _, poses = follow(machine, machine.home, line, [1.0] * 150 + [-1.0] * 150)
    assert np.linalg.norm(poses[149][:3, 3] - start[:3, 3]) == pytest.approx(150 * 0.5 * 0.02, rel=1e-2)
    assert max(off_line(pose, line) for pose in poses) < 1e-3
    assert max(np.linalg.norm(rotation_vector(start[:3, :3] @ p[:3, :3].T)) for p in poses) < 1e-3
    assert np.linalg.norm(poses[-1][:3, 3] - start[:3, 3]) < 5e-3


def test_a_tool_that_was_turned_is_turned_back() -> None:
    machine = machine_named("rre20")
    line = ToolLine(frozen(tool(machine, machine.home)[:3, 3]), frozen([0.0, 0.0, 1.0]))
    _, _, memory = desired(intent(0.0, line), machine.forward(machine.home), machine, T_SITE, MotionMemory(), CONFIG)
    kept = np.reshape(memory.kept, (3, 3))
    q = machine.home + np.array([0.0, 0.0, 0.0, 0.2, 0.1, -0.3])
    errors = []
    for k in range(200):
        kin = machine.forward(q)
        errors.append(np.linalg.norm(rotation_vector(kept @ tool(machine, q)[:3, :3].T)))
        qdot, _, memory = desired(intent((-1.0) ** (k // 50), line), kin, machine, T_SITE, memory, CONFIG)
        q = q + qdot * CONFIG.dt_s
    assert errors[0] > 0.3 and errors[-1] < 1e-2
    assert all(b <= a + 1e-6 for a, b in itertools.pairwise(errors))


def test_half_the_lever_is_slower_and_backwards_is_back() -> None:
    machine = machine_named("rre20")
    kin = machine.forward(machine.home)
    line = ToolLine(frozen(tool(machine, machine.home)[:3, 3]), frozen([0.0, 0.0, 2.0]))
    J = machine.tool_jacobian(kin)
    R = T_SITE[:3, :3]
    for share, feel in ((1.0, 1.0), (-1.0, -1.0), (0.5, (0.45 / 0.95) ** 1.5)):
        qdot, reasons, _ = desired(intent(share, line), kin, machine, T_SITE, MotionMemory(), CONFIG)
        assert R @ (J @ qdot)[:3] == pytest.approx([0.0, 0.0, 0.5 * feel], abs=1e-9)
        assert reasons == ()


def test_a_tool_off_the_line_is_drawn_to_it() -> None:
    machine = machine_named("rre20")
    at = tool(machine, machine.home)[:3, 3]
    line = ToolLine(frozen(at + np.array([0.0, 0.0, 0.2])), frozen(T_SITE[:3, 0]))
    _, poses = follow(machine, machine.home, line, [-0.6] * 250)
    errors = [off_line(pose, line) for pose in poses]
    assert errors[0] > 0.19 and errors[-1] < 2e-3
    assert all(b <= a + 1e-6 for a, b in itertools.pairwise(errors))


def test_a_lever_in_the_middle_moves_nothing_even_off_the_line() -> None:
    machine = machine_named("rre20")
    line = ToolLine(frozen([0.0, 0.0, 0.0]), frozen([1.0, 0.0, 0.0]))
    qdot, _, memory = desired(
        intent(0.0, line), machine.forward(machine.home), machine, T_SITE, MotionMemory(), CONFIG
    )
    assert not qdot.any() and memory.line and memory.kept


def test_a_machine_that_is_held_back_does_not_wind_up() -> None:
    machine = machine_named("rre20")
    kin = machine.forward(machine.home)
    line = ToolLine(frozen(tool(machine, machine.home)[:3, 3] + 0.05), frozen([0.0, 1.0, 0.0]))
    first, _, memory = desired(intent(1.0, line), kin, machine, T_SITE, MotionMemory(), CONFIG)
    for _ in range(500):
        held, _, memory = desired(intent(1.0, line), kin, machine, T_SITE, memory, CONFIG)
    assert held.tobytes() == first.tobytes()


def test_a_guard_that_slows_all_joints_alike_does_not_bend_the_path() -> None:
    machine = machine_named("rre20")
    line = ToolLine(frozen(tool(machine, machine.home)[:3, 3]), frozen([0.6, 0.8, 0.0]))
    _, poses = follow(machine, machine.home, line, [1.0] * 300, allow=0.3)
    assert max(off_line(pose, line) for pose in poses) < 1e-3


def test_the_orientation_is_taken_anew_with_a_new_line() -> None:
    machine = machine_named("rre20")
    at = tool(machine, machine.home)[:3, 3]
    first, second = ToolLine(frozen(at), frozen([1.0, 0, 0])), ToolLine(frozen(at), frozen([0, 1.0, 0]))
    kin = machine.forward(machine.home)
    turned = machine.forward(machine.home + np.array([0.0, 0.0, 0.0, 0.1, 0.0, 0.0]))
    _, _, memory = desired(intent(1.0, first), kin, machine, T_SITE, MotionMemory(), CONFIG)
    _, _, same = desired(intent(1.0, first), turned, machine, T_SITE, memory, CONFIG)
    _, _, fresh = desired(intent(1.0, second), turned, machine, T_SITE, memory, CONFIG)
    assert same.kept == memory.kept and fresh.kept != memory.kept
    _, _, joint = desired(intent(1.0, first, DriveMode.JOINT), kin, machine, T_SITE, memory, CONFIG)
    assert joint.kept == () and joint.line == ()


@pytest.mark.parametrize(
    "line",
    [
        None,
        ToolLine(frozen([0.0, 0, 0]), frozen([0.0, 0, 0])),
        ToolLine(frozen([0.0, 0, 0]), frozen([math.nan, 0, 0])),
        ToolLine(frozen([math.inf, 0, 0]), frozen([1.0, 0, 0])),
        ToolLine(frozen([0.0, 0]), frozen([1.0, 0, 0])),
    ],
)
def test_a_line_that_is_none_stops_with_the_reason(line: ToolLine | None) -> None:
    machine = machine_named("rre20")
    qdot, reasons, _ = desired(
        intent(1.0, line), machine.forward(machine.home), machine, T_SITE, MotionMemory(), CONFIG
    )
    assert not qdot.any() and [reason.code for reason in reasons] == [ReasonCode.INVALID_VALUE]
    assert unit_direction(line) is None


vectors = arrays(float, 3, elements=st.floats(-5, 5))


@settings(max_examples=200, deadline=None)
@given(vectors, vectors, st.floats(-1, 1), vectors)
def test_corrections_are_never_faster_than_the_lever_asks(
    at: np.ndarray, start: np.ndarray, share: float, turned: np.ndarray
) -> None:
    pose = tf.translation(*at) @ tf.rpy(*turned)
    twist = line_twist(start, np.array([1.0, 0, 0]), pose, np.eye(3), share=share, speed=0.5, turn=0.4, gain=2.0)
    assert twist[0] == pytest.approx(share * 0.5, abs=1e-12)
    assert math.hypot(twist[1], twist[2]) <= abs(share) * 0.5 * (1 + 1e-12) + 1e-150
    assert np.linalg.norm(twist[3:]) <= abs(share) * 0.4 * (1 + 1e-12) + 1e-150
    assert share or not twist.any()
    off = (start - at)[1:]
    assert off @ twist[1:3] >= 0.0


@settings(max_examples=200, deadline=None)
@given(arrays(float, 3, elements=st.floats(-1, 1)), st.floats(1e-6, math.pi - 1e-3))
def test_the_rotation_vector_gives_axis_and_angle_back(axis: np.ndarray, angle: float) -> None:
    if np.linalg.norm(axis) < 0.1:
        return
    axis = axis / np.linalg.norm(axis)
    K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    R = np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K
    assert rotation_vector(R) == pytest.approx(axis * angle, abs=1e-6)
    assert rotation_vector(np.eye(3)) == (0.0, 0.0, 0.0)
