"""Following a tool path from posture to posture on one branch, and saying why it cannot go on."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from scipy.interpolate import CubicSpline

from workgauge.machine.model import MachineModel
from workgauge.motion.ik.task import ROWS, arm_plane, elevation, task_error, task_jacobian
from workgauge.motion.paths.tool_path import ToolPath
from workgauge.values.arrays import Floats
from workgauge.values.tasks import Orientation

#: What joints keep from their ends along a path [rad, m].
MARGIN_RAD, MARGIN_M = np.radians(0.5), 0.005
#: Joints move no farther than this from one knot to the next [rad, m].
LARGEST_STEP = 0.15
#: A way is lost where not even this little of it can be followed [m].
SMALLEST_M = 1e-4
#: Knots are nowhere farther apart [m].
FARTHEST_M = 0.25
#: The tool is on the path [m, rad].
_ON_PATH = 1e-9
#: Joint speeds per metre of tool beyond this count as without bound [rad/m].
_UNBOUNDED = 50.0
#: How far ahead it is asked whether the path goes out of reach [m].
_AHEAD_M = 0.05
#: A goal is reached [m and rad]; a position that is missed by less is in reach [m].
_REACHED, _NEAR_M = 1e-6, 1e-4
_LEAST_SQUARES_STEPS = 60
_FIRST_STEP_M = 0.05
_NEWTON_STEPS = 15
_GROWTH = 1.6


class PathCause(StrEnum):
    """Why joints cannot follow a path."""

    JOINT_END = "joint at its end"
    OUT_OF_REACH = "out of reach"
    SINGULAR = "singular"
    BRANCH = "branch change"


@dataclass(frozen=True, slots=True)
class LostWay:
    """Where the way ends, and why.

    Attributes:
        distance_m: along the path. cause: see there.
        joint, end: the joint at its end, and where that is, in degrees or metres with its unit.
        by_m: how far out of reach, a little farther on but for the beginning. still: the joints that may not move.
        other: whether another posture reaches on from there.
    """

    distance_m: float
    cause: PathCause
    joint: str | None = None
    end: str = ""
    by_m: float = 0.0
    still: tuple[str, ...] = ()
    other: bool = False


def says(lost: LostWay) -> str:
    """Return why in words."""
    if lost.cause is PathCause.OUT_OF_REACH:
        place = " a little farther on" if lost.distance_m > 0.0 else ""
        text = f"out of reach, by {lost.by_m:.3f} m{place}"
        if lost.by_m < _NEAR_M:
            text = "the position is in reach, not with its orientation"
        return f"{text}, while {', '.join(lost.still)} stands still" if lost.still else text
    text = {
        PathCause.JOINT_END: f"{lost.joint} at its end ({lost.end})",
        PathCause.SINGULAR: "singular: joints would have to move without bound",
        PathCause.BRANCH: "no posture joins on without a jump",
    }[lost.cause]
    return f"{text}; another posture reaches on, a change of branch is needed" if lost.other else text


@dataclass(frozen=True, slots=True, eq=False)
class Follower:
    """One machine following one path.

    Attributes:
        machine, path: see there. T_machine_site: (4, 4). orientation: what counts.
        joints: indices of those that may move. inverse: see `joint_path.Inverse`.
        low, high: (n,) what joints may reach, their margins kept.
    """

    machine: MachineModel
    path: ToolPath
    T_machine_site: Floats
    orientation: Orientation
    joints: Sequence[int]
    inverse: Callable[[Floats, Orientation, Floats], Floats | None]
    low: Floats = field(init=False)
    high: Floats = field(init=False)

    def __post_init__(self) -> None:
        margin = np.where(self.machine.prismatic, MARGIN_M, MARGIN_RAD)
        object.__setattr__(self, "low", self.machine.q_min + margin)
        object.__setattr__(self, "high", self.machine.q_max - margin)

    @property
    def square(self) -> bool:
        """Whether no joint is left over."""
        return len(self.joints) <= ROWS[self.orientation]

    def goals(self, s: Floats, arriving: bool = False) -> tuple[Floats, Floats]:
        """Return goals (N, 4, 4) in the machine and the task's rates (N, m) per metre at distances s (N,)."""
        T, tangent = self.path.at(s, arriving=arriving)
        goals = self.T_machine_site @ T
        R = self.T_machine_site[:3, :3]
        twists = np.concatenate([tangent[:, :3] @ R.T, tangent[:, 3:] @ R.T], axis=1)
        if self.orientation is Orientation.FULL:
            return goals, twists
        if self.orientation is Orientation.FREE:
            return goals, twists[:, :3]
        plane = arm_plane(self.machine)
        turning = [elevation(goal, plane)[1] @ twist for goal, twist in zip(goals, twists, strict=True)]
        return goals, np.column_stack([twists[:, :3], turning])

    def error(self, s: float, q: Floats) -> Floats:
        """Return goal minus present (m,) at a distance and a posture (n,)."""
        goal = self.goals(np.array([s]))[0][0]
        return task_error(self.machine.forward(q), self.machine, goal, self.orientation)

    def errors(self, s: Floats, q: Floats) -> Floats:
        """Return how far the tool is off (N, 2) [m, rad] at distances s (N,) and postures q (N, n)."""
        goals, found = self.goals(s)[0], np.empty((len(s), 2))
        for i, (goal, posture) in enumerate(zip(goals, q, strict=True)):
            error = task_error(self.machine.forward(posture), self.machine, goal, self.orientation)
            found[i] = np.linalg.norm(error[:3]), np.linalg.norm(error[3:])
        return found

    def slopes(self, s: Floats, q: Floats) -> Floats:
        """Return dq/ds (N, n) at knots s (N,), q (N, n): exact in the task, smooth in what is left over."""
        guesses = np.zeros_like(q) if self.square else CubicSpline(s, q, bc_type="natural")(s, 1)
        rates = self.goals(s, arriving=True)[1]
        rates[0] = self.goals(s[:1])[1][0]
        return np.array([self.slope(*one) for one in zip(q, rates, guesses, strict=True)])

    def slope(self, q: Floats, rate: Floats, guess: Floats) -> Floats:
        """Return the dq/ds (n,) nearest to a guess (n,) that moves the task at its rate (m,)."""
        J = task_jacobian(self.machine.forward(q), self.machine, self.orientation)[:, self.joints]
        slope = np.array(guess)
        slope[self.joints] += np.linalg.lstsq(J, rate - J @ slope[self.joints], rcond=1e-9)[0]
        return slope

    def newton(self, goal: Floats, q: Floats, steps: int = _NEWTON_STEPS) -> Floats | None:
        """Return the posture (n,) that reaches a goal, by Newton's method from q, joint ends ignored, or None."""
        posture = np.array(q)
        for _ in range(steps):
            kin = self.machine.forward(posture)
            error = task_error(kin, self.machine, goal, self.orientation)
            if np.abs(error).max() < _ON_PATH:
                return posture
            J = task_jacobian(kin, self.machine, self.orientation)[:, self.joints]
            step = np.linalg.lstsq(J, error, rcond=1e-9)[0]
            posture[self.joints] += step * min(1.0, 0.5 / max(float(np.abs(step).max()), 1e-12))
        return None

    def posture(self, s: float, near: Floats) -> Floats | None:
        """Return a posture (n,) on the path at s within the joints' ends, near the one given; None if none is found.

        Where joints are left over the inverse chooses, else Newton's method, as it stays on the branch.
        """
        goal = self.goals(np.array([s]))[0][0]
        for solve in (self.newton, self._asked) if self.square else (self._asked, self.newton):
            found = solve(goal, near)
            if found is not None and self.within(found):
                return found
        return None

    def _asked(self, goal: Floats, near: Floats, everywhere: bool = False) -> Floats | None:
        """Return the inverse's answer (n,), at the nearest turns and refined; None if joints move that may not."""
        answer = self.inverse(goal, self.orientation, near)
        if answer is None:
            return None
        whole = np.where(self.machine.prismatic, 0.0, 2.0 * np.pi * np.round((answer - near) / (2.0 * np.pi)))
        rest = np.setdiff1d(np.arange(self.machine.n), self.joints)
        if not everywhere and np.abs((answer - whole - near)[rest]).max(initial=0.0) > _ON_PATH:
            return None
        return self.newton(goal, answer - whole)

    def within(self, q: Floats) -> bool:
        """Whether all joints that move keep their margins."""
        ends = self.joints
        return bool((q[ends] >= self.low[ends]).all() and (q[ends] <= self.high[ends]).all())

    def continuous(self, q: Floats, after: Floats) -> bool:
        """Whether a posture is near enough to the one before to be the next knot."""
        return bool(np.abs(after - q).max() <= LARGEST_STEP)

    def begin(self, q_start: Floats) -> Floats | LostWay:
        """Return the posture (n,) on the path's beginning nearest to the one given, or why there is none.

        The way there is not part of the path: the inverse may move every joint.
        """
        goal = self.goals(np.zeros(1))[0][0]
        found = self.newton(goal, q_start)
        if found is None or not self.continuous(q_start, found):
            asked = self._asked(goal, q_start, everywhere=True)
            found = found if asked is None else asked
        if found is None:
            by_m = self._left(goal, q_start, Orientation.FREE)
            return LostWay(0.0, PathCause.OUT_OF_REACH, by_m=by_m, still=self._still())
        return found if self.within(found) else self._at_end(0.0, found, False)

    def march(self, start: float, end: float, q: Floats) -> tuple[Floats, Floats] | LostWay:
        """Return knots s (N,) and q (N, n) from start to end [m], near enough to each other to be one branch."""
        distances, postures = [start], [np.array(q)]
        slope, step = np.zeros_like(q), _FIRST_STEP_M
        slope = self.slope(q, self.goals(np.array([start]))[1][0], slope)
        while distances[-1] < end:
            s, q = distances[-1], postures[-1]
            ahead = end if s + step > end - SMALLEST_M else s + step
            guess = q + np.clip((ahead - s) * slope, -LARGEST_STEP, LARGEST_STEP)
            found = self.posture(ahead, guess)
            after = None
            if found is not None and self.continuous(q, found):
                rate = self.goals(np.array([ahead]), arriving=True)[1][0]
                after = self.slope(found, rate, np.zeros_like(q) if self.square else (found - q) / (ahead - s))
            if found is None or after is None or not _joins(found - q, ahead - s, slope, after):
                if ahead - s <= 2.0 * SMALLEST_M:
                    return self.lost(s, q, ahead)
                step = 0.4 * (ahead - s)
                continue
            distances.append(ahead)
            postures.append(found)
            slope, step = after, min(_GROWTH * step, FARTHEST_M)
        return np.array(distances), np.array(postures)

    def lost(self, s: float, q: Floats, ahead: float) -> LostWay:
        """Return why the path cannot be followed from a posture (n,) at s to the distance just ahead."""
        goal = self.goals(np.array([ahead]))[0][0]
        asked = self._asked(goal, q)
        other = asked is not None and self.within(asked) and not self.continuous(q, asked)
        onwards = self.newton(goal, q)
        if onwards is not None and self.continuous(q, onwards) and not self.within(onwards):
            return self._at_end(s, onwards, other)
        beyond = self.goals(np.array([min(s + _AHEAD_M, self.path.length_m)]))[0][0]
        if self._left(beyond, q, self.orientation) > _REACHED and self._asked(beyond, q) is None:
            by_m = self._left(beyond, q, Orientation.FREE)
            return LostWay(s, PathCause.OUT_OF_REACH, by_m=by_m, still=self._still())
        rate = self.goals(np.array([s]))[1][0]
        if np.abs(self.slope(q, rate, np.zeros_like(q))).max() > _UNBOUNDED:
            return LostWay(s, PathCause.SINGULAR, other=other)
        return LostWay(s, PathCause.BRANCH, other=other)

    def _at_end(self, s: float, q: Floats, other: bool) -> LostWay:
        """Return the joint that is farthest beyond its end at a posture (n,)."""
        over = np.maximum(self.low - q, q - self.high)
        over[[j for j in range(self.machine.n) if j not in self.joints]] = -np.inf
        worst = int(over.argmax())
        end = float((self.machine.q_min if q[worst] < self.low[worst] else self.machine.q_max)[worst])
        shown = f"{end:.2f} m" if self.machine.prismatic[worst] else f"{np.degrees(end):.0f} deg"
        return LostWay(s, PathCause.JOINT_END, joint=self.machine.joint_names[worst], end=shown, other=other)

    def _left(self, goal: Floats, q: Floats, orientation: Orientation) -> float:
        """Return how much of a goal is left [m and rad] by damped least squares from q, joint ends ignored."""
        posture, damping = np.array(q), 1e-2
        error = task_error(self.machine.forward(posture), self.machine, goal, orientation)
        for _ in range(_LEAST_SQUARES_STEPS):
            J = task_jacobian(self.machine.forward(posture), self.machine, orientation)[:, self.joints]
            trial = np.array(posture)
            trial[self.joints] += np.linalg.solve(J.T @ J + damping * np.eye(len(self.joints)), J.T @ error)
            left = task_error(self.machine.forward(trial), self.machine, goal, orientation)
            if np.linalg.norm(left) < np.linalg.norm(error):
                posture, error, damping = trial, left, max(0.3 * damping, 1e-9)
            else:
                damping = min(4.0 * damping, 1e3)
        return float(np.linalg.norm(error))

    def _still(self) -> tuple[str, ...]:
        """Return the names of the joints that may not move."""
        return tuple(name for j, name in enumerate(self.machine.joint_names) if j not in self.joints)


def _joins(moved: Floats, distance: float, before: Floats, after: Floats) -> bool:
    """Whether a step (n,) is what the slopes (n,) at its ends say, so that it is no jump."""
    mean = 0.5 * distance * (before + after)
    size = 0.5 * distance * float((np.abs(before) + np.abs(after)).max())
    return bool(np.abs(moved - mean).max() <= 1e-3 + 0.1 * size)
