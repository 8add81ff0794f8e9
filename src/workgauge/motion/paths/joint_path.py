"""The joints' way along a tool path: one branch of the inverse kinematics, followed without a jump, or why not."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.motion.paths.following import Follower, LostWay, PathCause, says
from workgauge.motion.paths.joint_curve import JointCurve
from workgauge.motion.paths.tool_path import ToolPath
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import InputError
from workgauge.values.tasks import Orientation
from workgauge.values.transforms import inverse as inverse_of

#: Goal (4, 4) machine from tool, what counts of its orientation, and a posture (n,), to the posture (n,) that reaches
#: the goal and is nearest to that one, or None.
Inverse = Callable[[Floats, Orientation, Floats], Floats | None]

#: Between its knots the joints' curve keeps the tool this near to its path [m, rad].
TOLERANCE_M, TOLERANCE_RAD = 2e-4, np.radians(0.02)


_CHECKED = np.array([0.25, 0.5, 0.75])
_CLOSER = 0.8  # at the places checked, so that the tolerance holds between them
_ROUNDS = 12


@dataclass(frozen=True, slots=True, eq=False)
class JointPath:
    """The joints by distance along a tool path.

    Attributes:
        curve: of the joints, s the distance on the path [m].
        path: of the tool. T_site_machine: (4, 4) where the machine stands. orientation: what counts of it.
        start_gap_m, start_gap_rad: how far the tool is from the beginning at the posture that was given. Where it is
            more than a hair the caller adds a way there, to `curve.q[0]`.
        error_m, error_rad: the largest deviation of the tool from the path found between knots.
    """

    curve: JointCurve
    path: ToolPath
    T_site_machine: Floats
    orientation: Orientation
    start_gap_m: float
    start_gap_rad: float
    error_m: float
    error_rad: float

    @property
    def length_m(self) -> float:
        """Of the path [m]."""
        return self.path.length_m


@dataclass(frozen=True, slots=True)
class Unreachable:
    """Where and why the joints cannot follow a path.

    Attributes:
        distance_m: up to there they can. length_m: of the path. cause: see `PathCause`.
        joint: name of the joint at its end, or None. detail: the same in words.
    """

    distance_m: float
    length_m: float
    cause: PathCause
    joint: str | None
    detail: str

    def __str__(self) -> str:
        return f"at {self.distance_m:.2f} m of {self.length_m:.2f} m: {self.detail}"


def joint_path(
    machine: MachineModel,
    path: ToolPath,
    T_site_machine: Floats,
    q_start: Floats,
    orientation: Orientation,
    inverse: Inverse,
    *,
    joints: Sequence[int] | None = None,
) -> JointPath | Unreachable:
    """Return the joints' way along a tool path from the branch that a posture is on, or where it ends and why.

    Knots are set so that joints move little from one to the next and the tool stays within `TOLERANCE_M` and
    `TOLERANCE_RAD` of the path between them. The slope at a knot is the one that moves the tool exactly along the
    path, `J dq/ds = x'`, the nearest such to the knots' own differences where joints are left over. Joints keep
    `following.MARGIN_RAD`, `MARGIN_M` from their ends; endless ones go on turning.

    Args:
        path: in the site. T_site_machine: (4, 4). q_start: (n,) [rad, m].
        orientation: how much of the path's orientation counts.
        inverse: asked for the posture nearest to the one before. Its answer is refined and taken if it joins on
            without a jump; Newton's method, which stays on the branch, does the rest. For the beginning it may move
            every joint.
        joints: indices of those that may move. By default all; of groups that cannot move together the largest.

    Raises:
        InputError: for a posture or a pose that is not finite or of another shape, or an orientation the path lacks.
    """
    start, T = _checked(machine, path, T_site_machine, q_start, orientation)
    follower = Follower(machine, path, inverse_of(T), orientation, _movable(machine, joints), inverse)
    gap = follower.error(0.0, start)
    posture, distance = follower.begin(start), 0.0
    parts: list[JointCurve] = []
    worst = np.zeros(2)
    ends = [*path.stops_m.tolist(), path.length_m]
    for end in ends:
        if isinstance(posture, LostWay):
            break
        knots = follower.march(distance, float(end), posture)
        if isinstance(knots, LostWay):
            posture = knots
            break
        part = _refined(follower, *knots)
        if isinstance(part, LostWay):
            posture = part
            break
        curve, errors = part
        parts.append(curve)
        worst, posture, distance = np.maximum(worst, errors), curve.q[-1], float(end)
    if isinstance(posture, LostWay):
        return Unreachable(posture.distance_m, path.length_m, posture.cause, posture.joint, says(posture))
    curve = JointCurve.of(
        np.concatenate([parts[0].s, *(part.s[1:] for part in parts[1:])]),
        np.concatenate([parts[0].q, *(part.q[1:] for part in parts[1:])]),
        np.concatenate([part.leaving for part in parts]),
        np.concatenate([part.arriving for part in parts]),
    )
    gaps = float(np.linalg.norm(gap[:3])), float(np.linalg.norm(gap[3:]))
    return JointPath(curve, path, frozen(T), orientation, *gaps, *worst.tolist())


def _refined(follower: Follower, s: Floats, q: Floats) -> tuple[JointCurve, Floats] | LostWay:
    """Return the curve through knots, halved until the tool is near its path in between, and how near (2,)."""
    for _ in range(_ROUNDS):
        slopes = follower.slopes(s, q)
        curve = JointCurve.of(s, q, slopes[:-1], slopes[1:])
        between = s[:-1, None] + np.diff(s)[:, None] * _CHECKED
        postures = curve.at(between.ravel())[0]
        errors = follower.errors(between.ravel(), postures).reshape(len(s) - 1, len(_CHECKED), 2).max(axis=1)
        coarse = np.flatnonzero((errors[:, 0] > _CLOSER * TOLERANCE_M) | (errors[:, 1] > _CLOSER * TOLERANCE_RAD))
        if not len(coarse):
            return curve, errors.max(axis=0)
        middles, posture = between[coarse, 1], postures.reshape(len(s) - 1, len(_CHECKED), -1)[coarse, 1]
        halved = [follower.posture(float(at), near) for at, near in zip(middles, posture, strict=True)]
        for at, found, knot in zip(middles, halved, coarse, strict=True):
            if found is None or not follower.continuous(q[knot], found):
                return follower.lost(float(s[knot]), q[knot], float(at))
        s = np.insert(s, coarse + 1, middles)
        q = np.insert(q, coarse + 1, np.array(halved), axis=0)
    return LostWay(float(s[coarse[0]]), PathCause.SINGULAR)


def _movable(machine: MachineModel, joints: Sequence[int] | None) -> list[int]:
    """Return the joints that may move together: those given, or all outside the smaller exclusive groups."""
    if joints is not None:
        return sorted(set(joints))
    if not machine.exclusive_groups:
        return list(range(machine.n))
    largest = max(machine.exclusive_groups, key=len)
    others = {j for group in machine.exclusive_groups if group is not largest for j in group} - set(largest)
    return [j for j in range(machine.n) if j not in others]


def _checked(
    machine: MachineModel, path: ToolPath, T_site_machine: Floats, q_start: Floats, orientation: Orientation
) -> tuple[Floats, Floats]:
    start, T = np.array(q_start, dtype=np.float64), np.array(T_site_machine, dtype=np.float64)
    if start.shape != (machine.n,) or not np.isfinite(start).all():
        raise InputError("no posture of the machine", element="q_start", value=start.tolist(), allowed="n numbers")
    if T.shape != (4, 4) or not np.isfinite(T).all():
        raise InputError("no pose", element="T_site_machine", value=T.tolist(), allowed="(4, 4) numbers")
    if path.orientations is None and orientation is not Orientation.FREE:
        raise InputError(
            "the path has no orientations", element="orientation", value=str(orientation), allowed="free"
        )
    return start, T
