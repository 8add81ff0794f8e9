"""Denavit-Hartenberg rows to joint geometry."""

import math

from workgauge.machine.description import MachineDescription, Pose
from workgauge.machine.parts import JointGeometry
from workgauge.values.arrays import Floats, frozen
from workgauge.values.transforms import rotation_x, rotation_z, rpy, translation


def pose_matrix(position_m: tuple[float, float, float], rpy_deg: tuple[float, float, float]) -> Floats:
    """Return the read-only (4, 4) transform of a position [m] and roll, pitch, yaw [degrees]."""
    return frozen(translation(*position_m) @ rpy(*(math.radians(angle) for angle in rpy_deg)))


def matrix_of(pose: Pose) -> Floats:
    """Return the read-only (4, 4) transform of a described pose."""
    return pose_matrix(pose.position_m, pose.rpy_deg)


def dh_chain(description: MachineDescription) -> tuple[JointGeometry, ...]:
    """Return the joints of a machine described by rows, A = Rz(theta) Tz(d) Tx(a) Rx(alpha) (Mäkinen 3.1 to 3.3).

    Joint k turns about (slides along) z of frame k - 1, and link k's frame is frame k.
    """
    joints = []
    T_parent = matrix_of(description.base)
    for joint in description.joints:
        row = joint.dh
        assert row is not None
        T_joint_link = translation(row.a_m, 0.0, row.d_m) @ rotation_x(math.radians(row.alpha_deg))
        joints.append(
            JointGeometry(
                name=joint.name,
                prismatic=joint.type == "prismatic",
                T_parent_joint=frozen(T_parent @ rotation_z(math.radians(row.theta_deg))),
                axis=frozen([0.0, 0.0, 1.0]),
                T_joint_link=frozen(T_joint_link),
            )
        )
        T_parent = frozen(translation(0.0, 0.0, 0.0))
    return tuple(joints)
