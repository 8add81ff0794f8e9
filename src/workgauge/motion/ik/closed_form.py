"""Inverse kinematics in closed form: all postures that bring the tool to a goal, or how far out of reach it is."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from workgauge.machine.model import MachineModel
from workgauge.motion.ik.branches import Branches, OutOfReach, arranged, seconds_between, turned_within
from workgauge.motion.ik.planar_arm import PlanarArm, planar_arm
from workgauge.motion.ik.screws import joint_lines
from workgauge.motion.ik.tiltrotator import ROTATE, SWING, Tiltrotator, tiltrotator
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import InputError
from workgauge.values.tasks import Orientation
from workgauge.values.transforms import rotation_vector

#: A chain that misses its structure by more than this is brought home by Newton's steps on the true one [rad, m].
EXACT = 1e-12
_POLISH_STEPS, _POLISHED = 6, 1e-10
_GRID, _ROUNDS = 361, 5
_GAP_GRID = 1441
_HELD_GRID, _HALVINGS = 721, 40


@dataclass(frozen=True, slots=True, eq=False)
class ClosedForm:
    """The closed-form inverse of one machine. Every result is a pure function of its arguments.

    Attributes:
        machine: whose it is.
        orientation: `FULL` for six joints with tiltrotator, `PITCH` for an arm in a plane.
        redundant: index of the joint that `held` sets, None where the goal leaves no joint over.
    """

    machine: MachineModel
    orientation: Orientation
    redundant: int | None
    _solver: Tiltrotator | PlanarArm

    def branches(
        self, T_machine_tool: ArrayLike, *, q_near: ArrayLike | None = None, held: float | None = None
    ) -> Branches:
        """Return all postures that bring the tool frame to a pose.

        Within the joints' limits, joints that turn farther than once at the turn nearest q_near; the one reached
        soonest first. Of a continuum (swing with the wrist on its axis, rotator parallel to the arm's joints) the
        member reached soonest is given for each elbow, and `notes` says so.

        Args:
            T_machine_tool: (4, 4) in the machine frame [m]. With `Orientation.PITCH` its position and pitch count.
            q_near: (n,) the present posture [rad]; the machine's home if None.
            held: angle of the redundant joint [rad]; that of q_near if None.

        Raises:
            InputError: if the pose is no finite rigid transform, q_near is no posture, or `held` is given without a
                redundant joint or outside its limits.
        """
        T = _pose(T_machine_tool)
        near = self._near(q_near)
        solver = self._holding(near, held)
        found = solver.solve(T[None])
        q, free = found.q[0], found.free[0]
        notes: list[str] = []
        if free.max() >= 0:
            joints = sorted({int(j) for j in free if j >= 0})
            q = np.concatenate([q[free < 0], *(self._nearest_members(solver, T, j, near) for j in joints)])
            notes += [self._note(joint) for joint in joints]
        result = arranged(self.machine, self._polished(T, q), near, tuple(notes))
        return result if len(result.q) else replace(result, out_of_reach=self._why(solver, T, result))

    def branches_many(self, T_machine_tool: ArrayLike, *, q_near: ArrayLike | None = None) -> Floats:
        """Return the postures (N, B, n) of many poses (N, 4, 4) at once, NaN where none or beyond a limit.

        In no order, double roots twice, singular postures with whatever member comes out. The redundant joint is held
        where q_near (n,) has it. A chain that only nearly has the structure is taken as if it had it: where
        `exact` is false, use `branches`.
        """
        near = self._near(q_near)
        poses = np.asarray(T_machine_tool, dtype=np.float64)
        q, excess = turned_within(self.machine, self._holding(near, None).solve(poses).q, near)
        return np.where((excess == 0.0).all(-1, keepdims=True), q, np.nan)

    @property
    def exact(self) -> bool:
        """Whether the chain has the structure to rounding; else `branches` ends with Newton's steps."""
        return self._solver.missed <= EXACT

    def held_intervals(self, T_machine_tool: ArrayLike) -> Floats:
        """Return the intervals (k, 2) of the redundant joint's angle from which the pose is reached [rad].

        Found on a grid of 1/720 of the joint's range and halved to the edges: an interval shorter than the grid can
        be missed.

        Raises:
            InputError: if the machine has no redundant joint, or the pose is no finite rigid transform.
        """
        j = self.redundant
        if j is None:
            raise InputError(f"{self.machine.name} has no redundant joint for position and orientation")
        T, arm = _pose(T_machine_tool), self._solver
        assert isinstance(arm, PlanarArm)

        def reaches(values: Floats) -> Floats:
            q = arm.holding(values).solve(np.broadcast_to(T, (len(values), 4, 4))).q
            excess = turned_within(self.machine, q, self.machine.home)[1]
            fits: Floats = (excess == 0.0).all(-1).any(-1)
            return fits

        grid = np.linspace(self.machine.sample_min[j], self.machine.sample_max[j], _HELD_GRID)
        inside = reaches(grid)
        edges = np.flatnonzero(inside[1:] != inside[:-1])
        good = np.where(inside[edges], grid[edges], grid[edges + 1])
        bad = np.where(inside[edges], grid[edges + 1], grid[edges])
        for _ in range(_HALVINGS):
            middle = 0.5 * (good + bad)
            fits = reaches(middle) if len(middle) else middle.astype(bool)
            good, bad = np.where(fits, middle, good), np.where(fits, bad, middle)
        ends = [*([grid[0]] if inside[0] else []), *good, *([grid[-1]] if inside[-1] else [])]
        return frozen(np.reshape(ends, (-1, 2)))

    def _near(self, q_near: ArrayLike | None) -> Floats:
        near = self.machine.home if q_near is None else np.asarray(q_near, dtype=np.float64)
        if near.shape != (self.machine.n,) or not np.isfinite(near).all():
            raise InputError("not a posture", element="q_near", value=near, allowed=f"{self.machine.n} finite angles")
        return near

    def _holding(self, near: Floats, held: float | None) -> Tiltrotator | PlanarArm:
        """Return the solver with its redundant joint, if any, at an angle or where a posture has it."""
        j, solver = self.redundant, self._solver
        if j is None or isinstance(solver, Tiltrotator):
            if held is not None:
                raise InputError(f"{self.machine.name} has no joint to hold", element="held", value=held)
            return solver
        low, high = self.machine.q_min[j], self.machine.q_max[j]
        if held is not None and not low <= held <= high:
            ends = f"{math.degrees(low):.1f} to {math.degrees(high):.1f} deg"
            name = self.machine.joint_names[j]
            raise InputError(f"{name} cannot be held there", element="held", value=held, allowed=ends)
        return solver.holding(np.clip(near[j] if held is None else held, low, high))

    def _nearest_members(self, solver: Tiltrotator | PlanarArm, T: Floats, joint: int, near: Floats) -> Floats:
        """Return, of each branch of a continuum, the member (B, n) reached soonest: a grid, refined."""
        pitched = joint == ROTATE and isinstance(solver, Tiltrotator)
        low, high = -math.pi, math.pi
        if not pitched and not self.machine.continuous[joint]:
            low, high = float(self.machine.q_min[joint]), float(self.machine.q_max[joint])
        values = np.linspace(low, high, _GRID)
        q, cost = self._family(solver, T, joint, values, near)
        best = []
        for slot in range(q.shape[1]):
            at, width = int(cost[:, slot].argmin()), (high - low) / (_GRID - 1)
            centre, member, least = values[at], q[at, slot], cost[at, slot]
            for _ in range(_ROUNDS if np.isfinite(least) else 0):
                closer = np.clip(centre + width * np.linspace(-1.0, 1.0, 41), low, high)
                some, costs = self._family(solver, T, joint, closer, near)
                i = int(costs[:, slot].argmin())
                if costs[i, slot] <= least:
                    centre, member, least = closer[i], some[i, slot], costs[i, slot]
                width /= 20.0
            best.append(member)
        return np.array(best)

    def _family(
        self, solver: Tiltrotator | PlanarArm, T: Floats, joint: int, values: Floats, near: Floats
    ) -> tuple[Floats, Floats]:
        """Return members of a continuum (K, B, n) and their cost (K, B): seconds, or far more beyond a limit."""
        q = solver.family(T, joint, values)
        turned, excess = turned_within(self.machine, q, near)
        beyond = np.abs(excess).max(-1)
        cost = np.where(beyond > 0.0, 1e6 * (1.0 + beyond), seconds_between(self.machine, near, turned))
        return q, np.where(np.isnan(cost), np.inf, cost)

    def _note(self, joint: int) -> str:
        names = self.machine.joint_names
        if joint == SWING:
            why = "the wrist is on its axis"
        elif joint == ROTATE and self.orientation is Orientation.FULL:
            why = f"it is parallel to {names[1]}, {names[2]} and {names[3]}"
        else:
            why = "the two links behind it are folded onto each other"
        return f"{names[joint]} is free because {why}: the posture reached soonest is given"

    def _polished(self, T: Floats, q: Floats) -> Floats:
        """Return postures (c, n) as they are, or brought home where the chain only nearly has the structure."""
        if self.exact:
            return q
        return np.array([self._home_in(T, row) for row in q[np.isfinite(q).all(-1)]]).reshape(-1, self.machine.n)

    def _home_in(self, T: Floats, q: Floats) -> Floats:
        """Return one posture after Newton's steps on position and orientation, or NaN if they do not settle."""
        moving = [j for j in range(self.machine.n) if j != self.redundant]
        for _ in range(_POLISH_STEPS):
            kin = self.machine.forward(q)
            present = self.machine.tool_pose(kin)
            error = np.concatenate([T[:3, 3] - present[:3, 3], rotation_vector(T[:3, :3] @ present[:3, :3].T)])
            rows = self.machine.tool_jacobian(kin)
            if isinstance(self._solver, PlanarArm):
                wanted, present_pitch = self._solver.pitch(np.array([T, present]))
                pitch = np.remainder(wanted - present_pitch + np.pi, 2 * np.pi) - np.pi
                row = self._solver.plane.signs[0] * rows[3:, 1] @ rows[3:]
                error, rows = np.append(error[:3], pitch), np.vstack([rows[:3], row])
            if np.abs(error).max() < _POLISHED:
                return q
            q = q.copy()
            q[moving] += np.linalg.lstsq(rows[:, moving], error, rcond=1e-9)[0]
        return np.full(self.machine.n, np.nan)

    def _why(self, solver: Tiltrotator | PlanarArm, T: Floats, found: Branches) -> OutOfReach:
        """Return why there is no branch within the limits."""
        if found.beyond:
            return OutOfReach(0.0, f"inside the reach, but {found.beyond[0].text}{self._elsewhere(T)}")
        swing = (float(self.machine.sample_min[0]), float(self.machine.sample_max[0]))
        gap = _least(lambda q1: solver.gap(T, q1), *swing)
        if not math.isfinite(gap):
            return OutOfReach(math.inf, f"the orientation cannot be reached at any position{self._elsewhere(T)}")
        direction = "too close" if gap < 0.0 else "too far"
        return OutOfReach(abs(gap), f"out of reach: by {abs(gap):.2f} m, {direction}{self._elsewhere(T)}")

    def _elsewhere(self, T: Floats) -> str:
        """Return where the redundant joint would have to be, or nothing."""
        if self.redundant is None:
            return ""
        name = self.machine.joint_names[self.redundant]
        spans = [f"{math.degrees(a):.1f} to {math.degrees(b):.1f} deg" for a, b in self.held_intervals(T)]
        if not spans:
            return f"; no position of {name} reaches it"
        return f"; reached with {name} at {' or '.join(spans)}"


def _least(gap: Callable[[Floats], Floats], low: float, high: float) -> float:
    """Return the value (signed) of smallest size of gaps (K, S) over an interval: a grid, refined around the best."""
    at, width = np.linspace(low, high, _GAP_GRID), (high - low) / (_GAP_GRID - 1)
    for _ in range(4):
        gaps = gap(at)
        sizes = np.where(np.isnan(gaps), np.inf, np.abs(gaps))
        i, slot = np.unravel_index(sizes.argmin(), sizes.shape)
        best = float(gaps[i, slot]) if np.isfinite(sizes[i, slot]) else math.inf
        at, width = np.clip(at[i] + width * np.linspace(-1.0, 1.0, 81), low, high), width / 40.0
    return best


def _pose(T: ArrayLike) -> Floats:
    """Return a rigid transform (4, 4), or refuse it."""
    pose = np.asarray(T, dtype=np.float64)
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise InputError("not a pose", element="goal", value=pose.tolist(), allowed="4 x 4 finite numbers")
    R = pose[:3, :3]
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    upright = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) > 0.0
    if not upright or np.abs(R @ R.T - np.eye(3)).max() > 1e-6 or pose[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
        raise InputError("not a pose: its axes are not square", element="goal", value=pose.tolist())
    return pose


def closed_form(machine: MachineModel) -> ClosedForm | None:
    """Return the closed-form inverse of a machine, or None if its chain is not one of these.

    Recognised from the joints' lines in space at q = 0, whatever the joints and frames are called; directions and
    lengths may be off by 1e-3 rad and 1e-3 m from rounding in a file, and then Newton's steps on the true chain end
    the solution. All joints must turn.

    - Six joints, full pose: the second to fourth parallel and at least 1 mm apart one from the next, the first not
      parallel to them, the fifth not to the fourth, the sixth not to the fifth. The first may lean and lie anywhere,
      the arm may stand to its side, fifth and sixth need neither be square nor cross.
    - Four joints, position and pitch: all but the first parallel and 1 mm apart, the first not parallel to them.
    - Five joints, the same with one parallel joint more, which is held: the one that stands alone in an exclusive
      group, else the second.
    """
    found = joint_lines(machine) if machine.n in (4, 5, 6) else None
    if found is None:
        return None
    lines, T_zero = found
    limits = machine.q_min, machine.q_max
    six = tiltrotator(lines, T_zero, *limits)
    if six is not None:
        return ClosedForm(machine, Orientation.FULL, None, six)
    planar = planar_arm(lines, T_zero, *limits, machine.exclusive_groups, machine.home)
    return None if planar is None else ClosedForm(machine, Orientation.PITCH, planar.redundant, planar)
