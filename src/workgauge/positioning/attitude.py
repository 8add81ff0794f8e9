"""What an inclinometer knows of an attitude: the upward direction seen from its own frame."""

import math

import numpy as np

from workgauge.values.arrays import Floats

#: A vector or a row-major 3x3 matrix as plain floats; for three numbers these are ten times as fast as arrays.
Vec = tuple[float, float, float]
Mat = tuple[float, float, float, float, float, float, float, float, float]


def up_seen(roll: float, pitch: float) -> Vec:
    """Return the upward direction in an inclinometer's frame, the last row of R = Rz(any) Ry(pitch) Rx(roll)."""
    cp = math.cos(pitch)
    return (-math.sin(pitch), cp * math.sin(roll), cp * math.cos(roll))


def up_sides(roll: float, pitch: float) -> tuple[Vec, Vec]:
    """Return two unit vectors square to `up_seen` and to each other: towards more roll, and towards more pitch.

    An inclinometer's error tilts the vertical as much about every level axis, whichever way the sensor lies.
    """
    sr, cr, sp, cp = math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch)
    return (0.0, cr, -sr), (-cp, -sp * sr, -sp * cr)


def level(up: Floats) -> Floats:
    """Return the smallest rotation (3, 3) that turns the unit vector `up` (3,) into the vertical.

    Any other rotation that does so is this one followed by a turn about the vertical.
    """
    x, y, z = (float(part) for part in up)
    if z < -0.999999:  # upside down: half a turn about x first
        flipped: Floats = level(np.array([x, -y, -z])) @ np.diag([1.0, -1.0, -1.0])
        return flipped
    k = 1.0 / (1.0 + z)
    return np.array([[1.0 - k * x * x, -k * x * y, -x], [-k * x * y, 1.0 - k * y * y, -y], [x, y, z]])


def plain(matrix: Floats) -> Mat:
    """Return a (3, 3) matrix as nine floats, row by row."""
    a, b, c, d, e, f, g, h, i = matrix.ravel().tolist()
    return (a, b, c, d, e, f, g, h, i)


def times(m: Mat, v: Vec) -> Vec:
    """Return matrix times vector."""
    x, y, z = v
    return (m[0] * x + m[1] * y + m[2] * z, m[3] * x + m[4] * y + m[5] * z, m[6] * x + m[7] * y + m[8] * z)


def transposed_times(m: Mat, v: Vec) -> Vec:
    """Return the transposed matrix times vector."""
    x, y, z = v
    return (m[0] * x + m[3] * y + m[6] * z, m[1] * x + m[4] * y + m[7] * z, m[2] * x + m[5] * y + m[8] * z)


def cross(a: Vec, b: Vec) -> Vec:
    """Return the cross product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def dot(a: Vec, b: Vec) -> float:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def turned(axis: Vec, angle: float, v: Vec) -> Vec:
    """Return `v` turned about the unit vector `axis` [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    along, side = (1.0 - c) * dot(axis, v), cross(axis, v)
    return (
        c * v[0] + s * side[0] + along * axis[0],
        c * v[1] + s * side[1] + along * axis[1],
        c * v[2] + s * side[2] + along * axis[2],
    )


def wrapped(angle: float) -> float:
    """Return the angle in (-pi, pi] [rad]."""
    return -math.remainder(-angle, 2.0 * math.pi) if angle != math.pi else math.pi
