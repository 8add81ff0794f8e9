"""Where a chain's links are at one posture and how points on them move, in compiled code."""

import math
from typing import Any

import numpy as np

from workgauge.values.compiled import njit


@njit(cache=True)
def product(A: Any, B: Any, out: Any) -> None:
    """Fill out (4, 4) with the product of two rigid transforms; its last row is left alone."""
    for i in range(3):
        for k in range(4):
            total = A[i, 0] * B[0, k] + A[i, 1] * B[1, k] + A[i, 2] * B[2, k]
            out[i, k] = total + A[i, 3] if k == 3 else total


@njit(cache=True)
def turn(axis: Any, angle: float, out: Any) -> None:
    """Fill out (4, 4) with the turn about an axis through the origin (Rodrigues)."""
    c, s = math.cos(angle), math.sin(angle)
    x, y, z = axis[0], axis[1], axis[2]
    d = 1.0 - c
    out[0, 0], out[0, 1], out[0, 2] = c + d * x * x, d * x * y - s * z, d * x * z + s * y
    out[1, 0], out[1, 1], out[1, 2] = d * x * y + s * z, c + d * y * y, d * y * z - s * x
    out[2, 0], out[2, 1], out[2, 2] = d * x * z - s * y, d * y * z + s * x, c + d * z * z
    out[0, 3] = out[1, 3] = out[2, 3] = 0.0


@njit(cache=True)
def link_frames(q: Any, steps: Any, axes: Any, prismatic: Any, ends: Any, frames: Any, jacobian: Any) -> None:
    """Fill frames (n + 1, 4, 4) of the links and the spatial jacobian (6, n), see `Kinematics`.

    Args:
        q: (n,) positions. steps: (n, 4, 4) from the joint before to the joint. axes: (n, 3) of the joints.
        prismatic: (n,). ends: (n, 4, 4) from the joint to its link.
    """
    frame, step, motion = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((4, 4))
    frames[:] = 0.0
    for i in range(4):
        frame[i, i] = frames[0, i, i] = 1.0
    for j in range(len(q)):
        product(frame, steps[j], step)
        a, b, c = axes[j, 0], axes[j, 1], axes[j, 2]
        x = step[0, 0] * a + step[0, 1] * b + step[0, 2] * c
        y = step[1, 0] * a + step[1, 1] * b + step[1, 2] * c
        z = step[2, 0] * a + step[2, 1] * b + step[2, 2] * c
        if prismatic[j]:
            frame[:] = step
            frame[0, 3] += q[j] * x
            frame[1, 3] += q[j] * y
            frame[2, 3] += q[j] * z
            jacobian[0, j], jacobian[1, j], jacobian[2, j] = x, y, z
            jacobian[3:, j] = 0.0
        else:
            turn(axes[j], q[j], motion)
            product(step, motion, frame)
            jacobian[0, j] = step[1, 3] * z - step[2, 3] * y
            jacobian[1, j] = step[2, 3] * x - step[0, 3] * z
            jacobian[2, j] = step[0, 3] * y - step[1, 3] * x
            jacobian[3, j], jacobian[4, j], jacobian[5, j] = x, y, z
        product(frame, ends[j], frames[j + 1])
        frames[j + 1, 3, 3] = 1.0


@njit(cache=True)
def distance_rows(
    T: Any,
    jacobian: Any,
    normals: Any,
    on_machine: Any,
    on_limit: Any,
    links: Any,
    others: Any,
    stretches: Any,
    poses: Any,
    halves: Any,
) -> Any:
    """Return the rows (k, n) of `MachineModel.distance_rows`.

    Args:
        T: (4, 4) site from machine. jacobian: (6, n) spatial. normals, on_machine, on_limit: (k, 3), site frame.
        links, others: (k,). stretches: (e, 5) solid, link, joint, axis, side of the boxes that stretch; poses, halves
            of all boxes if there are any.
    """
    n, count = jacobian.shape[1], len(normals)
    rows, moving = np.zeros((count, n)), np.empty((6, n))
    for j in range(n):
        for i in range(3):
            moving[i, j] = T[i, 0] * jacobian[0, j] + T[i, 1] * jacobian[1, j] + T[i, 2] * jacobian[2, j]
            moving[3 + i, j] = T[i, 0] * jacobian[3, j] + T[i, 1] * jacobian[4, j] + T[i, 2] * jacobian[5, j]
    box, wide = np.zeros((4, 4)), 0.0
    for r in range(count):
        u = normals[r]
        for side in range(2):
            sign, x, link = (1.0, on_machine[r], links[r]) if side == 0 else (-1.0, on_limit[r], others[r])
            if link < 0:
                continue
            px, py, pz = x[0] - T[0, 3], x[1] - T[1, 3], x[2] - T[2, 3]
            mx, my, mz = py * u[2] - pz * u[1], pz * u[0] - px * u[2], px * u[1] - py * u[0]
            for j in range(link):
                rows[r, j] += sign * (
                    u[0] * moving[0, j] + u[1] * moving[1, j] + u[2] * moving[2, j]
                    + mx * moving[3, j] + my * moving[4, j] + mz * moving[5, j]
                )  # fmt: skip
            for e in range(len(stretches)):
                solid, own, joint, axis = stretches[e, 0], stretches[e, 1], stretches[e, 2], stretches[e, 3]
                if own != link:
                    continue
                product(T, poses[solid], box)
                wide, along, share = 2.0 * halves[solid, axis], 0.0, 0.0
                for c in range(3):
                    outwards = stretches[e, 4] * box[c, axis]
                    along += u[c] * outwards
                    share += (x[c] - box[c, 3]) * outwards
                rows[r, joint] += sign * min(max(0.5 + share / wide, 0.0), 1.0) * along
    return rows
