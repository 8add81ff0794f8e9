"""The operator's intent to desired joint velocity, in each drive mode."""

from dataclasses import dataclass, field

import numpy as np

from workgauge.machine.model import Kinematics, MachineModel
from workgauge.motion.inverse import HYSTERESIS, Damping, Solution, damped_inverse, tool_motion
from workgauge.motion.joystick import LeverFeel, joint_velocity, ramped_levers, shaped, tool_twist
from workgauge.motion.line import line_twist, unit_direction
from workgauge.motion.position import position_rates
from workgauge.motion.wish import FollowSettings
from workgauge.values.arrays import Floats, freeze
from workgauge.values.measurements import DriveMode, Intent
from workgauge.values.reasons import Reason, ReasonCode

_RIGHT_Y = 3


@dataclass(frozen=True, slots=True)
class MotionConfig:
    """How intents become motion.

    Attributes:
        dt_s: the tick's period [s].
        feel: dead zone, shaping, pattern and ramp of the levers.
        tool_speed_m_s, tool_turn_rad_s: the tool's speed at the full lever in the tool and line modes.
        line_gain_1_s: how fast the tool is drawn back to its line.
        damping: of the inverse kinematics.
        follow: how jobs are done.
        singular_share: share of the wanted tool motion that may be missed before it is said.
    """

    dt_s: float = 0.02
    feel: LeverFeel = field(default_factory=LeverFeel)
    tool_speed_m_s: float = 0.5
    tool_turn_rad_s: float = 0.5
    line_gain_1_s: float = 2.0
    damping: Damping = field(default_factory=Damping)
    singular_share: float = 0.1
    follow: FollowSettings = field(default_factory=FollowSettings)


@dataclass(frozen=True, slots=True)
class MotionMemory:
    """What motion remembers from tick to tick; fresh whenever the operator lets go.

    Attributes:
        levers: shares of full speed after the ramp.
        line: start and direction of the line being followed, six numbers, or empty.
        kept: the tool's orientation in the site when that line was taken up, nine numbers by rows, or empty.
        group: the exclusive group that moves the tool, -1 for none.
    """

    levers: tuple[float, ...] = (0.0,) * 6
    line: tuple[float, ...] = ()
    kept: tuple[float, ...] = ()
    group: int = -1


def desired(
    intent: Intent,
    kin: Kinematics,
    machine: MachineModel,
    T_site_machine: Floats,
    memory: MotionMemory,
    config: MotionConfig,
) -> tuple[Floats, tuple[Reason, ...], MotionMemory]:
    """Return the wanted joint velocities (n,) [rad/s, m/s], what hinders them, and the memory for the next tick.

    Joint mode: each lever moves its joints. Tool mode: the levers move the tool along the machine's axes. Line mode:
    the right lever's fore and aft moves the tool along the intent's line. Exit and automatic mode: nothing, the guard
    finds the way out and `follow` does the job; see `exit_share` and `pace`. Speeds may exceed what joints can do;
    the guard scales them as a whole.
    """
    step = config.dt_s / config.feel.ramp_s if config.feel.ramp_s > 0.0 else 2.0
    levers = ramped_levers(memory.levers, shaped(intent.levers.values, config.feel), step)
    if intent.mode is DriveMode.JOINT:
        qdot = np.array(joint_velocity(levers, machine))
        freeze(qdot)
        return qdot, (), MotionMemory(levers)
    if intent.mode in (DriveMode.EXIT, DriveMode.AUTO):  # somebody else knows the way: `exit_share`, `follow`
        return _still(machine.n), (), MotionMemory(levers)
    line: tuple[float, ...] = ()
    kept: tuple[float, ...] = ()
    if intent.mode is DriveMode.TOOL:
        twist = np.array(tool_twist(levers, config.tool_speed_m_s, config.tool_turn_rad_s))
    else:
        direction = unit_direction(intent.line)
        if direction is None or intent.line is None:
            reason = Reason(ReasonCode.INVALID_VALUE, "line mode needs a line with a direction")
            return _still(machine.n), (reason,), MotionMemory()
        T_site_tool = T_site_machine @ machine.tool_pose(kin)
        line = (*intent.line.start_site.tolist(), *intent.line.direction_site.tolist())
        kept = memory.kept if memory.line == line else tuple(T_site_tool[:3, :3].ravel().tolist())
        twist_site = line_twist(
            intent.line.start_site,
            direction,
            T_site_tool,
            np.reshape(kept, (3, 3)),
            share=levers[_RIGHT_Y],
            speed=config.tool_speed_m_s,
            turn=config.tool_turn_rad_s,
            gain=min(config.line_gain_1_s, 0.5 / config.dt_s),
        )
        twist = (twist_site.reshape(2, 3) @ T_site_machine[:3, :3]).ravel()
    if not twist.any():
        return _still(machine.n), (), MotionMemory(levers, line, kept, memory.group)
    solution, group = _best_group(machine.tool_jacobian(kin), twist, machine, memory.group, config.damping)
    freeze(solution.qdot)
    reasons = _hindered(solution, config.singular_share)
    return solution.qdot, reasons, MotionMemory(levers, line, kept, group)


def exit_share(intent: Intent, memory: MotionMemory) -> float | None:
    """Return how fast the operator wants to be driven out of limits, 0 to 1 of the fastest; None in other modes.

    Args:
        memory: as `desired` returned it, for the ramp.
    """
    return max(memory.levers[_RIGHT_Y], 0.0) if intent.mode is DriveMode.EXIT else None


def pace(memory: MotionMemory) -> float:
    """Return how fast a job is to be done, 0 to 1 of its own speed.

    Args:
        memory: as `desired` returned it, for the ramp.
    """
    return max(memory.levers[_RIGHT_Y], 0.0)


def tool_rates(machine: MachineModel, kin: Kinematics, config: MotionConfig) -> Floats:
    """Return the joint velocities (3, n) that move the tool at 1 m/s along the machine's x, y and z [1/s].

    As in the tool mode where the orientation is left to itself: damped, the position alone.
    """
    if machine.n < 3:
        return damped_inverse(machine.tool_jacobian(kin)[:3], config.damping).T
    damping = config.damping
    rates, sure = position_rates(
        kin.T_machine_links, machine.T_link_tool, kin.spatial_jacobian, damping.threshold, damping.largest
    )
    if not sure:
        return damped_inverse(machine.tool_jacobian(kin)[:3], damping).T
    freeze(rates)
    found: Floats = rates
    return found


def _best_group(
    J: Floats, twist: Floats, machine: MachineModel, previous: int, damping: Damping
) -> tuple[Solution, int]:
    """Return the solution of the exclusive group that misses least, the previous one if it is nearly as good."""
    groups = machine.exclusive_groups
    if not groups:
        return tool_motion(J, twist, range(machine.n), damping), -1
    solutions = []
    for group in groups:
        others = {j for other in groups if other is not group for j in other} - set(group)
        solutions.append(tool_motion(J, twist, [j for j in range(machine.n) if j not in others], damping))
    best = min(range(len(groups)), key=lambda g: solutions[g].missed)
    if 0 <= previous < len(groups) and solutions[previous].missed <= HYSTERESIS * solutions[best].missed:
        best = previous
    return solutions[best], best


def _hindered(solution: Solution, singular_share: float) -> tuple[Reason, ...]:
    if solution.missed <= singular_share:
        return ()
    achieved = max(1.0 - solution.missed, 0.0)
    text = (
        f"the tool cannot go that way from here, {100.0 * min(solution.missed, 1.0):.0f} % of the motion is missing"
    )
    return (Reason(ReasonCode.SINGULAR, text, scale=achieved),)


def _still(n: int) -> Floats:
    qdot = np.zeros(n)
    freeze(qdot)
    return qdot
