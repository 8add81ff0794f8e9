"""A stroke of the bucket: over the beginning of its way, down, the cut, up again; and how many passes deep."""

import math
from dataclasses import dataclass, field

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.motion.bucket.edge import above, edge_points
from workgauge.motion.bucket.reach import EdgeError, edge_error, followed_from, held_orientation
from workgauge.motion.bucket.surface_path import SurfacePath
from workgauge.motion.ik.closed_form import closed_form
from workgauge.motion.paths.joint_path import JointPath, joint_path
from workgauge.motion.paths.timing import timed
from workgauge.motion.paths.tool_path import ToolPath
from workgauge.motion.planning import Motion, Pace, inverse_of, plan_joints, reaching
from workgauge.site.surface.tin import Tin
from workgauge.values.arrays import Floats
from workgauge.values.errors import InputError
from workgauge.values.transforms import inverse

#: The least that an edge is lifted where the machine reaches no higher [m].
LEAST_LIFT_M = 0.05
#: A stroke's pieces join where joints differ by no more than this [rad, m].
_JOINS = 2e-3
#: No more passes than this.
MOST_PASSES = 200


@dataclass(frozen=True, slots=True, eq=False)
class Stroke:
    """One pass along one way.

    Attributes:
        made: the way. motions: to above its beginning, down, the cut, up; each from rest to rest.
        cut: which of them is the cut. joints: of the cut. error: of the machine's edge beside the one wanted.
        lift_m: how high above its ends it comes and leaves.
    """

    made: SurfacePath
    motions: tuple[Motion, ...]
    cut: int
    joints: JointPath
    error: EdgeError
    lift_m: float

    @property
    def q_end(self) -> Floats:
        """(n,) the posture it ends in."""
        last: Floats = self.motions[-1].trajectory.q[-1]
        return last


@dataclass(frozen=True, slots=True)
class CutPace:
    """How fast a stroke is driven.

    Attributes:
        cut_m_s: of the edge along the surface, even across edges. move: of everything else.
    """

    cut_m_s: float = 0.3
    move: Pace = field(default_factory=Pace)


def stroke(
    machine: MachineModel,
    T_site_machine: Floats,
    q: Floats,
    made: SurfacePath,
    pace: CutPace,
    *,
    lift_m: float = 0.5,
    words: str = "cut",
) -> Stroke:
    """Return a stroke begun from a posture.

    Args:
        q: (n,) the present posture. lift_m: so high above the way's ends it comes and leaves, less where the machine
            does not reach so high with the bucket so turned.

    Raises:
        InputError: if the way cannot be followed to its end, with where and why.
    """
    found, _, why = followed_from(machine, made.path, T_site_machine, q)
    if found is None:
        raise InputError("the bucket's way cannot be followed to its end", element=words, value=why)
    down, high = _joined(machine, T_site_machine, found, lift_m, at_end=False)
    up, low = _joined(machine, T_site_machine, found, min(high, lift_m), at_end=True)
    to_start = plan_joints(machine, q, down.curve.q[0], pace.move, words=f"to {words}")
    legs = [
        _timed(machine, one, pace, f"{word}{words}")
        for one, word in ((down, "down to "), (found, ""), (up, "up from "))
    ]
    motions = (*to_start, *legs)
    error = edge_error(machine, found, made.bucket.width_m)
    return Stroke(made, motions, len(to_start) + 1, found, error, min(high, low))


def _timed(machine: MachineModel, way: JointPath, pace: CutPace, words: str) -> Motion:
    """Return the motion along one piece of a stroke."""
    along = timed(
        way,
        machine,
        tool_speed_m_s=pace.cut_m_s,
        tool_turn_rad_s=pace.move.tool_turn_rad_s,
        speed_share=pace.move.share,
    )
    return Motion(along, way.path, words)


def _joined(
    machine: MachineModel, T_site_machine: Floats, cut: JointPath, lift_m: float, *, at_end: bool
) -> tuple[JointPath, float]:
    """Return the joints' straight way down to a cut's beginning, or up from its end, and how long it is [m]."""
    orientation, inverse_kinematics = held_orientation(machine), inverse_of(machine)
    pose = cut.path.at(cut.length_m if at_end else 0.0)[0]
    posture = cut.curve.q[-1 if at_end else 0]
    height = lift_m
    while height >= LEAST_LIFT_M:
        over = np.array(pose)
        over[2, 3] += height
        ends = np.stack([pose[:3, 3], over[:3, 3]] if at_end else [over[:3, 3], pose[:3, 3]])
        path = ToolPath.polyline(ends, np.stack([pose[:3, :3]] * 2), orientation=orientation)
        start = posture
        if not at_end:
            near = reaching(machine, closed_form(machine), inverse(T_site_machine) @ over, orientation, posture)
            start = near[0] if isinstance(near, list) else posture
        found = joint_path(machine, path, T_site_machine, start, orientation, inverse_kinematics)
        if isinstance(found, JointPath) and np.abs(found.curve.q[0 if at_end else -1] - posture).max() < _JOINS:
            return found, height
        height *= 0.5
    where = "end" if at_end else "beginning"
    raise InputError(
        f"the bucket cannot be lifted at the {where} of its way", element="lift", value=f"{lift_m:.2f} m"
    )


def passes(
    ground: Tin | None, made: SurfacePath, depth_m: float | None, origin: Floats, *, margin_m: float = 0.0
) -> list[float]:
    """Return how far above the surface each pass runs, the last one on it [m].

    Args:
        ground: as it is now; None takes the surface to be near enough for one pass. depth_m: of one pass, at most.

    Raises:
        InputError: for a depth that needs more passes than `MOST_PASSES`.
    """
    if ground is None or depth_m is None:
        return [0.0]
    if not depth_m > 0.0:
        raise InputError("not a depth of a pass", element="depth", value=depth_m, allowed="above 0 m")
    highest = ground_above(ground, made, origin) + margin_m
    count = max(1, math.ceil(highest / depth_m - 1e-9))
    if count > MOST_PASSES:
        value = f"{highest:.2f} m of ground in passes of {depth_m:.3f} m"
        raise InputError("too many passes", element="depth", value=value, allowed=f"at most {MOST_PASSES}")
    return [depth_m * k for k in range(count - 1, -1, -1)]


def ground_above(ground: Tin, made: SurfacePath, origin: Floats) -> float:
    """Return the most that the ground stands above the edge's way [m]."""
    _, T = made.poses()
    gap = above(ground, edge_points(T, made.bucket.width_m), origin)
    return max(0.0, -float(np.nanmin(gap, initial=0.0)))
