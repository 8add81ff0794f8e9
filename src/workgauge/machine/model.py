"""The machine as the tick uses it: forward kinematics, Jacobians of any point, link solids, distance rows."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from workgauge.machine.cylinder import Cylinder
from workgauge.machine.frames import distance_rows, link_frames
from workgauge.machine.parts import (
    JointGeometry,
    LinkMesh,
    LinkSolid,
    Pump,
    Sensor,
    SkippedPair,
    Stopping,
    Undercarriage,
)
from workgauge.machine.positioning import PositioningSpec
from workgauge.values.arrays import Floats, Ints, freeze, frozen, frozen_ints
from workgauge.values.clearances import Clearances

_NO_BOXES = frozen(np.empty((0, 4, 4))), frozen(np.empty((0, 3)))
_MINUS_SKEW_SIGNS = np.array([[0.0, 1.0, -1.0], [-1.0, 0.0, 1.0], [1.0, -1.0, 0.0]])


@dataclass(frozen=True, slots=True, eq=False)
class Kinematics:
    """Where every link is at one posture, and how it moves. All arrays are read-only.

    Attributes:
        q: (n,) joint positions [rad, m].
        T_machine_links: (L, 4, 4), frame of each link in the machine frame, 0 the undercarriage.
        spatial_jacobian: (6, n), rows linear then angular, of the point at the machine frame's origin: column j is
            what joint j does to everything it carries. `v(p) = J[:3] + J[3:] x p` for a point p that it moves.
    """

    q: Floats
    T_machine_links: Floats
    spatial_jacobian: Floats


@dataclass(frozen=True, eq=False)
class MachineModel:
    """An immutable machine. Link k moves with joints 1 to k (index 0 to k - 1); link 0 is the undercarriage.

    Every result is a pure function of its arguments.

    Attributes:
        name, title: what it is called. attachment: the one mounted; attachments: all that could be.
        joint_names: (n). link_names: (n + 1), the undercarriage first.
        q_min, q_max: (n,) joint limits [rad, m]; infinite for joints that turn without end.
        continuous, prismatic: (n,) bool.
        speed_positive, speed_negative: (n,) highest speeds, both above 0 [rad/s, m/s].
        home: (n,) posture within the limits.
        levers: (n) lever name or None. lever_signs: (n,) joint direction at the lever's positive side.
        exclusive_groups: joint indices; joints of different groups cannot move together.
        stopping_positive, stopping_negative: (n) how each joint comes to rest.
        pump: shared flow, or None. cylinders: (n) what turns each joint, where the file says so, else None.
        solids: the boxes, in a fixed order. self_pairs: pairs of solid indices to be kept apart.
        meshes: how links look, where the file says so.
        skipped_pairs: pairs of solids on different links that are not checked, with the reason.
        undercarriage, sensors: see there.
        T_link_tool: (4, 4), tool frame in the last link's frame. tool_tolerance_m: 1-sigma of its position.
        chain: the joints in space.
        positioning: how it knows where it is; None if its pose comes from outside.
        stretches: (e, 5), solid, its link, joint, axis and side of the boxes that stretch.
        self_stop_distance_m: at which its own links stop before each other, None for the guard's own distance [m].
    """

    name: str
    title: str
    attachment: str
    attachments: tuple[str, ...]
    joint_names: tuple[str, ...]
    link_names: tuple[str, ...]
    q_min: Floats
    q_max: Floats
    continuous: NDArray[np.bool_]
    prismatic: NDArray[np.bool_]
    speed_positive: Floats
    speed_negative: Floats
    home: Floats
    levers: tuple[str | None, ...]
    lever_signs: Floats
    exclusive_groups: tuple[tuple[int, ...], ...]
    stopping_positive: tuple[Stopping, ...]
    stopping_negative: tuple[Stopping, ...]
    pump: Pump | None
    solids: tuple[LinkSolid, ...]
    undercarriage: Undercarriage
    sensors: tuple[Sensor, ...]
    T_link_tool: Floats
    tool_tolerance_m: float
    chain: tuple[JointGeometry, ...]
    self_pairs: tuple[tuple[int, int], ...] = ()
    skipped_pairs: tuple[SkippedPair, ...] = ()
    positioning: PositioningSpec | None = None
    cylinders: tuple[Cylinder | None, ...] = ()
    self_stop_distance_m: float | None = None
    meshes: tuple[LinkMesh, ...] = ()

    _packed: tuple[Floats, Floats, Ints, Floats] = field(init=False, repr=False)
    _moves: Floats = field(init=False, repr=False)
    _solid_links: Ints = field(init=False, repr=False)
    _T_link_boxes: Floats = field(init=False, repr=False)
    _half_extents: Floats = field(init=False, repr=False)
    _stretching: tuple[int, ...] = field(init=False, repr=False)
    stretches: Ints = field(init=False, repr=False)

    def __post_init__(self) -> None:
        before = [np.eye(4), *(joint.T_joint_link for joint in self.chain)]
        steps = [before[j] @ joint.T_parent_joint for j, joint in enumerate(self.chain)]
        packed = (
            frozen(np.reshape(steps, (self.n, 4, 4))),
            frozen(np.reshape([joint.axis for joint in self.chain], (self.n, 3))),
            frozen_ints([joint.prismatic for joint in self.chain]),
            frozen(np.reshape(before[1:], (self.n, 4, 4))),
        )
        stretches = [(i, solid.link, *solid.stretch) for i, solid in enumerate(self.solids) if solid.stretch]
        derived = {
            "_packed": packed,
            "stretches": frozen_ints(np.reshape(stretches, (-1, 5))),
            "_moves": frozen(np.tri(self.n + 1, self.n, -1)),
            "_solid_links": frozen_ints([solid.link for solid in self.solids]),
            "_T_link_boxes": frozen([solid.T_link_box for solid in self.solids]),
            "_half_extents": frozen([solid.half_extents for solid in self.solids]),
            "_stretching": tuple(i for i, solid in enumerate(self.solids) if solid.stretch),
        }
        for name, value in derived.items():
            object.__setattr__(self, name, value)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def tool_link(self) -> int:
        """Index of the link the tool hangs on: the last."""
        return self.n

    @property
    def sample_min(self) -> Floats:
        """(n,) finite lower ends for drawing postures: `q_min`, or -pi where a joint turns without end."""
        return np.where(self.continuous, -np.pi, self.q_min)

    @property
    def sample_max(self) -> Floats:
        """(n,) finite upper ends for drawing postures: `q_max`, or pi where a joint turns without end."""
        return np.where(self.continuous, np.pi, self.q_max)

    def pinocchio_model(self) -> Any:
        """Return a pinocchio model of its own, with a frame for each link and one named `tool`."""
        return _pinocchio_model(self)

    def forward(self, q: ArrayLike) -> Kinematics:
        """Return where the links are at joint positions q (n,) [rad, m] (Mäkinen 3.4).

        Raises:
            ValueError: if q has another shape.
        """
        posture = np.array(q, dtype=np.float64)
        if posture.shape != (len(self.joint_names),):
            raise ValueError(f"expected {self.n} joint positions, got shape {posture.shape}")
        frames, jacobian = np.empty((len(posture) + 1, 4, 4)), np.empty((6, len(posture)))
        link_frames(posture, *self._packed, frames, jacobian)
        for array in (posture, frames, jacobian):
            array.setflags(write=False)
        return Kinematics(posture, frames, jacobian)

    def point_jacobians(self, kin: Kinematics, links: ArrayLike, points_machine: ArrayLike) -> Floats:
        """Return the linear Jacobians (k, 3, n) of points fixed to links, in the machine frame.

        Column j of point p is `Jv_j + Jw_j x p` if joint j carries the point's link, else 0 (cf. Mäkinen 3.15).

        Args:
            kin: the posture.
            links: (k,) link indices.
            points_machine: (k, 3) where the points are now, in the machine frame [m].
        """
        points = np.asarray(points_machine, dtype=np.float64)
        minus_skew = np.zeros((len(points), 3, 3))
        minus_skew[:, 0, 1] = minus_skew[:, 1, 0] = points[:, 2]
        minus_skew[:, 0, 2] = minus_skew[:, 2, 0] = points[:, 1]
        minus_skew[:, 1, 2] = minus_skew[:, 2, 1] = points[:, 0]
        minus_skew *= _MINUS_SKEW_SIGNS
        jacobian = kin.spatial_jacobian
        jacobians: Floats = minus_skew @ jacobian[3:]
        jacobians += jacobian[:3]
        jacobians *= self._moves[np.asarray(links, dtype=np.intp)][:, None, :]
        return jacobians

    def tool_pose(self, kin: Kinematics) -> Floats:
        """Return the tool frame (4, 4) in the machine frame (Mäkinen 3.4)."""
        pose: Floats = kin.T_machine_links[-1] @ self.T_link_tool
        return pose

    def tool_jacobian(self, kin: Kinematics) -> Floats:
        """Return the geometric Jacobian (6, n) of the tool centre point: linear, angular, machine frame (3.5)."""
        x, y, z = self.tool_pose(kin)[:3, 3]
        jacobian = np.array(kin.spatial_jacobian)
        jacobian[:3] += np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]) @ jacobian[3:]
        return jacobian

    def solid_poses(self, kin: Kinematics) -> tuple[Floats, Floats]:
        """Return box frames (S, 4, 4) in the machine frame and half extents (S, 3), both read-only.

        Boxes that stretch have their length and middle of this posture.
        """
        poses: Floats = kin.T_machine_links.take(self._solid_links, axis=0) @ self._T_link_boxes
        halves = self._half_extents
        if self._stretching:
            halves = halves.copy()
            for i in self._stretching:
                joint, axis, side = self.solids[i].stretch  # type: ignore[misc]
                grown = 0.5 * kin.q[joint]
                halves[i, axis] += grown
                poses[i, :3, 3] += side * grown * poses[i, :3, axis]
            freeze(halves)
        freeze(poses)
        return poses, halves

    def distance_rows(self, kin: Kinematics, T_site_machine: Floats, clearances: Clearances) -> Floats:
        """Return rows (k, n): `d(distance)/dt = row @ qdot` while the undercarriage stands still.

        `u . (Jv + Jw x p)` over the joints that carry the link; where the clearance is to another link of the
        machine, that link's motion at its own point is subtracted. `clearances.links` index `link_names`. A point on
        a box that stretches moves with its share of the prismatic joint: none on the fixed face, all on the moving
        one.
        """
        boxes = self.solid_poses(kin) if self._stretching else _NO_BOXES
        rows: Floats = distance_rows(
            *(np.array(T_site_machine, dtype=np.float64, order="C"), kin.spatial_jacobian, clearances.normals),
            *(clearances.points_machine, clearances.points_limit, clearances.links, clearances.other_links),
            *(self.stretches, *boxes),
        )
        return rows


def _se3(T: Floats) -> Any:
    return pin.SE3(np.array(T[:3, :3]), np.array(T[:3, 3]))


def _pinocchio_model(machine: MachineModel) -> Any:
    """Return the pinocchio model of the chain, with limits and a frame for each link and the tool."""
    model = pin.Model()
    model.name = machine.name
    parent, T_parent_link = 0, np.eye(4)
    for i, joint in enumerate(machine.chain):
        kind = pin.JointModelPrismaticUnaligned if joint.prismatic else pin.JointModelRevoluteUnaligned
        if np.array_equal(joint.axis, [0.0, 0.0, 1.0]):
            moving = pin.JointModelPZ() if joint.prismatic else pin.JointModelRZ()
        else:
            moving = kind(np.array(joint.axis))
        speed = max(machine.speed_positive[i], machine.speed_negative[i])
        parent = model.addJoint(
            parent,
            moving,
            _se3(T_parent_link @ joint.T_parent_joint),
            joint.name,
            np.array([np.inf]),
            np.array([speed]),
            np.array([machine.q_min[i]]),
            np.array([machine.q_max[i]]),
        )
        T_parent_link = joint.T_joint_link
        model.addFrame(pin.Frame(machine.link_names[i + 1], parent, 0, _se3(T_parent_link), pin.FrameType.OP_FRAME))
    T_joint_tool = T_parent_link @ machine.T_link_tool
    model.addFrame(pin.Frame("tool", parent, 0, _se3(T_joint_tool), pin.FrameType.OP_FRAME))
    return model
