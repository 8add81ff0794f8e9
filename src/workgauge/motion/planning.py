"""From what is wanted (a goal, a path, a posture) to motions of the joints over time, or why there are none."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.motion.ik.closed_form import ClosedForm, closed_form
from workgauge.motion.ik.solve import SolveSettings, solve
from workgauge.motion.ik.task import orientation_of
from workgauge.motion.paths.joint_path import Inverse, JointPath, Unreachable, joint_path
from workgauge.motion.paths.rounded import Kept
from workgauge.motion.paths.timing import timed, timed_joints
from workgauge.motion.paths.tool_path import ToolPath
from workgauge.motion.paths.trajectory import Trajectory
from workgauge.values.arrays import Floats
from workgauge.values.errors import InputError
from workgauge.values.tasks import Orientation, ToolGoal
from workgauge.values.transforms import inverse

#: A joint nearer than this to where it is to be needs no motion [rad, m].
THERE = 1e-4
#: Where no closed form fits, the inverse is sought from so many seeded starts.
RESTARTS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """One stretch of motion, from rest to rest.

    Attributes:
        trajectory: of the joints. path: the tool's, None for a motion of the joints alone.
        words: what it is, for people.
    """

    trajectory: Trajectory
    path: ToolPath | None
    words: str


@dataclass(frozen=True, slots=True)
class Pace:
    """How fast motions are planned.

    Attributes:
        tool_speed_m_s, tool_turn_rad_s: of the tool on its path. share: of joint speeds and pump flow, above 0 to 1.
    """

    tool_speed_m_s: float = 0.5
    tool_turn_rad_s: float | None = None
    share: float = 0.8


def inverse_of(machine: MachineModel) -> Inverse:
    """Return the inverse kinematics of a machine: closed form where its structure has one, else sought."""
    form = closed_form(machine)

    def nearest(T_machine_tool: Floats, orientation: Orientation, near: Floats) -> Floats | None:
        found = reaching(machine, form, T_machine_tool, orientation, near, restarts=0)
        return found[0] if isinstance(found, list) else None

    return nearest


def reaching(
    machine: MachineModel,
    form: ClosedForm | None,
    T_machine_tool: Floats,
    orientation: Orientation,
    near: Floats,
    *,
    restarts: int = RESTARTS,
) -> list[Floats] | str:
    """Return the postures (n,) that bring the tool to a pose, the soonest reached first, or why there are none."""
    if form is not None and form.orientation is orientation:
        found = form.branches(T_machine_tool, q_near=near)
        if len(found.q):
            return list(found.q)
        why = found.out_of_reach
        if form.redundant is None or restarts == 0:
            return "out of reach" if why is None else why.text
        for low, high in form.held_intervals(T_machine_tool):
            held = float(np.clip(near[form.redundant], low, high))
            found = form.branches(T_machine_tool, q_near=near, held=held)
            if len(found.q):
                return list(found.q)
        return "out of reach" if why is None else why.text
    sought = solve(machine, near, T_machine_tool, orientation, SolveSettings(restarts=restarts))
    return [sought.q] if sought.converged else sought.why


def plan_path(
    machine: MachineModel, T_site_machine: Floats, q: Floats, path: ToolPath, pace: Pace, *, words: str = "path"
) -> list[Motion]:
    """Return the motions along a path, the way to its beginning first.

    Every branch of the inverse kinematics at the path's beginning is tried, the one reached soonest first.

    Args:
        T_site_machine: (4, 4). q: (n,) the present posture. path: in the site.

    Raises:
        InputError: if no branch follows the path to its end, with where and why the farthest ends.
    """
    orientation = holdable(machine, path.orientation, words)
    form, nearest = closed_form(machine), inverse_of(machine)
    begin = inverse(T_site_machine) @ path.at(0.0)[0]
    starts = reaching(machine, form, begin, orientation, q)
    if isinstance(starts, str):
        raise InputError(f"the {words}'s first point cannot be reached", element=words, value=starts)
    farthest: Unreachable | None = None
    for start in starts:
        found = joint_path(machine, path, T_site_machine, start, orientation, nearest)
        if isinstance(found, JointPath):
            along = timed(
                found,
                machine,
                tool_speed_m_s=pace.tool_speed_m_s,
                tool_turn_rad_s=pace.tool_turn_rad_s,
                speed_share=pace.share,
            )
            to_start = plan_joints(machine, q, found.curve.q[0], pace, words=f"to the {words}")
            return [*to_start, Motion(along, path, words)]
        if farthest is None or found.distance_m > farthest.distance_m:
            farthest = found
    raise InputError(f"the {words} cannot be followed to its end", element=words, value=str(farthest))


def plan_goal(
    machine: MachineModel, T_site_machine: Floats, q: Floats, goal: ToolGoal, pace: Pace, *, words: str = "goal"
) -> list[Motion]:
    """Return the motions to a goal: the tool on a straight line, or where that cannot be, the joints side by side.

    Raises:
        InputError: if no posture reaches the goal, with by how much it is out of reach.
    """
    orientation = holdable(machine, goal.orientation, words)
    T_machine_goal = inverse(T_site_machine) @ goal.T_site_tool
    found = reaching(machine, closed_form(machine), T_machine_goal, orientation, q)
    if isinstance(found, str):
        raise InputError(f"the {words} cannot be reached", element=words, value=found)
    here = T_site_machine @ machine.tool_pose(machine.forward(q))
    points = np.stack([here[:3, 3], goal.T_site_tool[:3, 3]])
    if np.linalg.norm(points[1] - points[0]) > THERE:
        turns = None if orientation is Orientation.FREE else np.stack([here[:3, :3], goal.T_site_tool[:3, :3]])
        try:
            line = ToolPath.polyline(points, turns, orientation=orientation)
            straight = joint_path(machine, line, T_site_machine, q, orientation, inverse_of(machine))
        except InputError:  # half a turn between the two has no one way
            straight = None
        if isinstance(straight, JointPath):
            along = timed(
                straight,
                machine,
                tool_speed_m_s=pace.tool_speed_m_s,
                tool_turn_rad_s=pace.tool_turn_rad_s,
                speed_share=pace.share,
            )
            return [Motion(along, line, words)]
    return plan_joints(machine, q, found[0], pace, words=words)


def plan_joints(machine: MachineModel, q: Floats, to: Floats, pace: Pace, *, words: str = "posture") -> list[Motion]:
    """Return the motions of the joints from one posture (n,) to another; of exclusive groups in turn."""
    waypoints = [np.array(q, dtype=np.float64)]
    groups = machine.exclusive_groups or (tuple(range(machine.n)),)
    shared = [j for j in range(machine.n) if all(j not in group for group in groups)]
    for k, group in enumerate(groups):
        at = waypoints[-1].copy()
        moved = [*group, *(shared if k == 0 else ())]
        at[moved] = to[moved]
        if np.abs(at - waypoints[-1]).max() > THERE:
            waypoints.append(at)
    return plan_waypoints(machine, np.array(waypoints), pace, words=words)


def plan_waypoints(
    machine: MachineModel, waypoints: Floats, pace: Pace, *, words: str, kept: Kept | None = None
) -> list[Motion]:
    """Return the motions along straight joint lines between postures (k, n), one after the other where groups change.

    Args:
        kept: which corners may be rounded, see `timed_joints`; at the others the machine stands.
    """
    if len(waypoints) < 2:
        return []
    runs: list[list[Floats]] = []
    before = -2
    for a, b in pairwise(waypoints):
        group = _group(machine, b - a)
        if group != before or not runs:
            runs.append([a])
        runs[-1].append(b)
        before = group
    return [
        Motion(timed_joints(np.array(run), machine, kept=kept, speed_share=pace.share), None, words) for run in runs
    ]


def holdable(machine: MachineModel, wanted: Orientation, words: str) -> Orientation:
    """Return how much of a wanted orientation a machine can hold: what is wanted, if it can.

    Raises:
        InputError: if it cannot, saying what it can.
    """
    order = (Orientation.FREE, Orientation.PITCH, Orientation.FULL)
    most = orientation_of(machine)
    if order.index(wanted) > order.index(most):
        raise InputError(
            f"{machine.name} cannot hold the whole orientation of the {words}",
            element="orientation",
            value=wanted.value,
            allowed=" or ".join(one.value for one in order[: order.index(most) + 1]),
        )
    return wanted


def _group(machine: MachineModel, step: Floats) -> int:
    """Return the exclusive group that moves in a step, -1 where there are no groups."""
    return next((k for k, group in enumerate(machine.exclusive_groups) if step[list(group)].any()), -1)
