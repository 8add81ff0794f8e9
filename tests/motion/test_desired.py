"""Intent to joint velocity: modes, exclusive groups, singular arms."""

import functools
import math

import numpy as np
import pytest

from workgauge.machine.load import load_machine
from workgauge.motion.desired import MotionConfig, MotionMemory, desired
from workgauge.motion.joystick import LeverFeel
from workgauge.values.arrays import frozen
from workgauge.values.measurements import DriveMode, Intent, Levers, Stamp, ToolLine
from workgauge.values.reasons import ReasonCode

machine_named = functools.cache(load_machine)

CONFIG = MotionConfig(feel=LeverFeel(ramp_s=0.0))
STAMP = Stamp("m", 0, "operator")
EYE = frozen(np.eye(4))


@pytest.mark.parametrize("mode", list(DriveMode))
@pytest.mark.parametrize("name", ["rre20", "brokk5", "sun-a"])
def test_levers_in_the_middle_ask_for_nothing(name: str, mode: DriveMode) -> None:
    machine = machine_named(name)
    line = ToolLine(frozen([1.0, 2.0, 3.0]), frozen([0.0, 1.0, 0.0]))
    resting = Intent(STAMP, mode, Levers(right_y=0.04), True, line)
    qdot, reasons, _ = desired(resting, machine.forward(machine.home), machine, EYE, MotionMemory(), CONFIG)
    assert not qdot.any() and reasons == () and not qdot.flags.writeable


def test_tool_mode_moves_the_tool_along_the_machines_axes_whatever_its_heading() -> None:
    machine = machine_named("rre20")
    kin = machine.forward(machine.home)
    J = machine.tool_jacobian(kin)
    turned = frozen([[0, -1, 0, 5], [1, 0, 0, 6], [0, 0, 1, 0], [0, 0, 0, 1]])
    for levers, motion in (
        (Levers(left_y=1.0), [0.5, 0, 0, 0, 0, 0]),
        (Levers(left_x=1.0), [0, -0.5, 0, 0, 0, 0]),
        (Levers(right_y=-1.0), [0, 0, 0.5, 0, 0, 0]),
        (Levers(right_roller=1.0), [0, 0, 0, 0, 0, 0.5]),
    ):
        for pose in (EYE, turned):
            intent = Intent(STAMP, DriveMode.TOOL, levers, True)
            qdot, reasons, _ = desired(intent, kin, machine, pose, MotionMemory(), CONFIG)
            assert J @ qdot == pytest.approx(motion, abs=1e-9) and reasons == ()


def test_the_ramp_takes_its_time_and_letting_go_does_not() -> None:
    machine = machine_named("rre20")
    kin = machine.forward(machine.home)
    config, memory, speeds = MotionConfig(feel=LeverFeel(ramp_s=0.2)), MotionMemory(), []
    for lever in [1.0] * 12 + [0.0]:
        intent = Intent(STAMP, DriveMode.JOINT, Levers(left_y=lever), True)
        qdot, _, memory = desired(intent, kin, machine, EYE, memory, config)
        speeds.append(qdot[2] / machine.speed_positive[2])
    assert speeds[:10] == pytest.approx([0.1 * k for k in range(1, 11)])
    assert speeds[10:12] == [1.0, 1.0] and speeds[12] == 0.0


def test_only_one_exclusive_group_moves_the_tool() -> None:
    machine = machine_named("brokk5")
    for levers in (Levers(left_y=1.0), Levers(right_y=1.0), Levers(left_x=1.0), Levers(left_y=1.0, right_y=-0.5)):
        memory = MotionMemory()
        for _ in range(5):
            intent = Intent(STAMP, DriveMode.TOOL, levers, True)
            qdot, _, memory = desired(intent, machine.forward(machine.home), machine, EYE, memory, CONFIG)
            moving = [g for g, group in enumerate(machine.exclusive_groups) if qdot[list(group)].any()]
            assert len(moving) == 1 and memory.group == moving[0]


def test_the_group_that_moves_goes_on_while_it_is_nearly_as_good() -> None:
    machine = load_machine("brokk5")
    object.__setattr__(machine, "exclusive_groups", ((0,), (1, 2, 3, 4)))
    kin = machine.forward(machine.home)
    outwards = Intent(STAMP, DriveMode.TOOL, Levers(left_y=1.0), True)
    assert desired(outwards, kin, machine, EYE, MotionMemory(), CONFIG)[2].group == 1
    # half sideways, half outwards: either group misses about as much, so whichever moves goes on
    diagonal = Intent(STAMP, DriveMode.TOOL, Levers(left_y=1.0, left_x=1.0), True)
    for group in (0, 1):
        assert desired(diagonal, kin, machine, EYE, MotionMemory(group=group), CONFIG)[2].group == group


def test_an_arm_that_cannot_go_there_says_so() -> None:
    """A stretched planar arm cannot reach farther."""
    stretched = machine_named("sun-a")
    q = np.array([0.0, 0.3, 0.0, 0.0])
    intent = Intent(STAMP, DriveMode.TOOL, Levers(left_y=1.0, right_y=-math.tan(0.3)), True)
    qdot, reasons, _ = desired(intent, stretched.forward(q), stretched, EYE, MotionMemory(), CONFIG)
    assert [reason.code for reason in reasons] == [ReasonCode.SINGULAR]
    assert reasons[0].scale is not None and reasons[0].scale < 0.9
    assert np.isfinite(qdot).all() and np.abs(qdot).max() < 0.5 / 0.1 * 1.1
