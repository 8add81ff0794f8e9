"""Rigid transforms as 4x4 homogeneous matrices; `T_a_b` maps coordinates of frame b into frame a."""

import math

import numpy as np

from workgauge.values.arrays import Floats


def translation(x: float, y: float, z: float) -> Floats:
    """Return the transform that moves by (x, y, z) [m]."""
    T = np.eye(4)
    T[:3, 3] = (x, y, z)
    return T


def rotation_x(angle: float) -> Floats:
    """Return the transform that turns about x by `angle` [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]], dtype=np.float64)


def rotation_y(angle: float) -> Floats:
    """Return the transform that turns about y by `angle` [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1]], dtype=np.float64)


def rotation_z(angle: float) -> Floats:
    """Return the transform that turns about z by `angle` [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], dtype=np.float64)


def rpy(roll: float, pitch: float, yaw: float) -> Floats:
    """Return Rz(yaw) Ry(pitch) Rx(roll) [rad], as URDF reads `rpy`."""
    return rotation_z(yaw) @ rotation_y(pitch) @ rotation_x(roll)


def inverse(T: Floats) -> Floats:
    """Return the inverse of a rigid transform."""
    R = T[:3, :3].T
    out = np.eye(4)
    out[:3, :3] = R
    out[:3, 3] = -R @ T[:3, 3]
    return out


def apply(T: Floats, points: Floats) -> Floats:
    """Map points (..., 3) through T (4, 4)."""
    return points @ T[:3, :3].T + T[:3, 3]


def skew(v: Floats) -> Floats:
    """Return the matrix (3, 3) of `v x`."""
    x, y, z = (float(part) for part in v)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation(vector: Floats) -> Floats:
    """Return the rotation (3, 3) of a rotation vector (3,) [rad] (Rodrigues)."""
    angle = math.sqrt(float(vector @ vector))
    K = skew(vector)
    if angle < 1e-8:
        return np.eye(3) + K + 0.5 * K @ K
    rotated: Floats = np.eye(3) + math.sin(angle) / angle * K + (1.0 - math.cos(angle)) / angle**2 * K @ K
    return rotated


def rotation_vector(R: Floats) -> Floats:
    """Return the rotation vector (3,) [rad] of a rotation (3, 3), of length at most pi."""
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2.0
    sine, cosine = math.sqrt(float(axis @ axis)), (float(np.trace(R)) - 1.0) / 2.0
    angle = math.atan2(sine, cosine)
    if sine > 1e-7:
        vector: Floats = axis * (angle / sine)
        return vector
    if cosine > 0.0:
        return axis
    outer = (R + np.eye(3)) / 2.0  # half a turn: a aT
    column: Floats = outer[:, int(np.argmax(np.diag(outer)))]
    return angle * column / math.sqrt(float(column @ column))


def yaw_from_heading(heading: float) -> float:
    """Return the mathematical angle (counter-clockwise from east) of a heading clockwise from grid north [rad]."""
    return math.pi / 2 - heading


def heading_from_yaw(yaw: float) -> float:
    """Return the heading clockwise from grid north, in [0, 2 pi), of an angle counter-clockwise from east [rad]."""
    return (math.pi / 2 - yaw) % (2 * math.pi)
