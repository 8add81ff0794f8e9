"""Why an iteration towards a goal stands still: beyond the arm's length, at joint limits, or at a singularity."""

import math
from enum import StrEnum

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.motion.ik.task import task_error, task_jacobian
from workgauge.values.arrays import Floats
from workgauge.values.tasks import Orientation

_AT = 1e-6  # this near to a limit, as a share of the range, is at it
_FELT = 0.05  # a joint at its limit is named if it could do more for the error than this share of that
_STANDS = 0.02  # the error falls no faster than this share of what the machine could do for another direction


class Cause(StrEnum):
    """Why a goal was or was not reached."""

    REACHED = "reached"
    OUT_OF_REACH = "out of reach"  #: farther than the arm is long; no posture reaches it
    JOINT_LIMIT = "joint limit"  #: from here, only joints at their limits could come nearer
    SINGULAR = "singular"  #: from here, the joints cannot move the tool the way that is missing
    UNSETTLED = "unsettled"  #: none of these: the iterations came to an end first


def why_stuck(
    machine: MachineModel, q: Floats, T_machine_goal: Floats, orientation: Orientation, length_m_rad: float
) -> tuple[Cause, str]:
    """Return what keeps the tool from the goal at posture q (n,), in a word and in words.

    Judged from the posture alone, by what each joint would do to the error to first order. OUT_OF_REACH speaks of the
    goal; the others of this posture: from another one the goal may be reached.
    """
    kin = machine.forward(q)
    error = task_error(kin, machine, T_machine_goal, orientation)
    left = _short(error)
    beyond = beyond_reach(machine, T_machine_goal)
    if beyond > 0.0:
        return Cause.OUT_OF_REACH, f"out of reach: at least {beyond:.3f} m beyond the arm's length; {left}"
    weigh = np.where(np.arange(len(error)) < 3, 1.0, length_m_rad)
    J, wanted = weigh[:, None] * task_jacobian(kin, machine, orientation), weigh * error
    pull = J.T @ wanted
    stopped = pushed_limits(machine, q, pull, _FELT * stands_below(J, wanted))
    free = [j for j in range(machine.n) if j not in stopped]
    if float(np.linalg.norm(pull[free])) > stands_below(J, wanted):
        return Cause.UNSETTLED, f"{left}; the iterations ended before the error stood still"
    if stopped:
        names = " and ".join(_at_limit(machine, j, upper=pull[j] > 0.0) for j in stopped)
        return Cause.JOINT_LIMIT, f"{left}; {names}, and would have to go on"
    U, sigma, _ = np.linalg.svd(J)
    way = U[:, len(sigma) - 1 if len(sigma) == len(error) else -1]
    return Cause.SINGULAR, f"{left}; singular: from here the joints cannot {_way(way * np.sign(way @ wanted or 1.0))}"


def beyond_reach(machine: MachineModel, T_machine_goal: Floats) -> float:
    """Return how far the goal is beyond what the arm could reach if it were straight and had no limits [m].

    The arm's foot goes round the first joint's axis; from there the links count with their whole length. Negative
    where the arm is long enough, which does not mean that a posture exists.
    """
    first = machine.chain[0]
    T_machine_axis = first.T_parent_joint
    from_axis = T_machine_axis[:3, :3].T @ (T_machine_goal[:3, 3] - T_machine_axis[:3, 3])
    steps = [joint.T_joint_link for joint in machine.chain]
    foot = steps[0][:3, 3] if machine.n == 1 else (steps[0] @ machine.chain[1].T_parent_joint)[:3, 3]
    if first.prismatic or machine.n == 1:
        foot = np.zeros(3)
    along, goal_along = float(foot @ first.axis), float(from_axis @ first.axis)
    out = float(np.linalg.norm(foot - along * first.axis))
    goal_out = float(np.linalg.norm(from_axis - goal_along * first.axis))
    return math.hypot(goal_out - out, goal_along - along) - _arm_length(machine, 0 if not foot.any() else 1)


def stands_below(J: Floats, wanted: Floats) -> float:
    """Return the length of `J^T wanted` below which the error stands still: a share of the most it could be."""
    return _STANDS * float(np.linalg.norm(J, 2)) * float(np.linalg.norm(wanted))


def pushed_limits(machine: MachineModel, q: Floats, pull: Floats, least: float) -> list[int]:
    """Return the joints that stand at a limit and that `pull` (n,) would have go on, by more than `least`."""
    near = _AT * np.where(np.isfinite(machine.q_max - machine.q_min), machine.q_max - machine.q_min, 0.0)
    upper = (q >= machine.q_max - near) & (pull > least)
    lower = (q <= machine.q_min + near) & (pull < -least)
    return [int(j) for j in np.flatnonzero(upper | lower)]


def _arm_length(machine: MachineModel, first: int) -> float:
    """Return the length of all links from joint `first` on to the tool, joints that slide at their longest [m]."""
    length = float(np.linalg.norm(machine.T_link_tool[:3, 3]))
    for j in range(first, machine.n):
        joint = machine.chain[j]
        if j > first:
            length += float(np.linalg.norm(joint.T_parent_joint[:3, 3]))
        length += float(np.linalg.norm(joint.T_joint_link[:3, 3]))
        if joint.prismatic:
            length += max(abs(float(machine.q_min[j])), abs(float(machine.q_max[j])))
    return length


def _short(error: Floats) -> str:
    short = f"{math.hypot(*error[:3].tolist()):.3f} m"
    if len(error) > 3:
        short += f" and {math.degrees(math.hypot(*error[3:].tolist())):.1f} deg"
    return f"{short} short of the goal"


def _at_limit(machine: MachineModel, joint: int, *, upper: bool) -> str:
    end = float((machine.q_max if upper else machine.q_min)[joint])
    value = f"{end:.3f} m" if machine.prismatic[joint] else f"{math.degrees(end):.1f} deg"
    return f"{machine.joint_names[joint]} is at its {'upper' if upper else 'lower'} limit of {value}"


def _way(direction: Floats) -> str:
    """Return a direction of the task as people read it: the part that weighs more."""
    moving, turning = direction[:3], direction[3:]
    if len(turning) == 1 and abs(float(turning[0])) > float(np.linalg.norm(moving)):
        return f"turn the tool {'up' if turning[0] > 0.0 else 'down'} in the arm's plane while it stays where it is"
    verb, part = ("move", moving) if np.linalg.norm(moving) >= np.linalg.norm(turning) else ("turn", turning)
    x, y, z = (part / max(float(np.linalg.norm(part)), 1e-12)).tolist()
    return f"{verb} the tool {'along' if verb == 'move' else 'about'} ({x:.2f}, {y:.2f}, {z:.2f})"
