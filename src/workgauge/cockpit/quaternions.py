"""Unit quaternions (w, x, y, z), as the view writes rotations."""

import numpy as np

from workgauge.values.arrays import Floats


def quaternion(R: Floats) -> tuple[float, float, float, float]:
    """Return the unit quaternion (w, x, y, z) of a rotation (3, 3)."""
    trace = float(np.trace(R))
    candidates = np.array([trace, R[0, 0], R[1, 1], R[2, 2]])
    k = int(np.argmax(candidates))
    if k == 0:
        q = np.array([1.0 + trace, R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    else:
        i = k - 1
        j, m = (i + 1) % 3, (i + 2) % 3
        q = np.zeros(4)
        q[0] = R[m, j] - R[j, m]
        q[1 + i] = 1.0 + R[i, i] - R[j, j] - R[m, m]
        q[1 + j] = R[j, i] + R[i, j]
        q[1 + m] = R[m, i] + R[i, m]
    w, x, y, z = (q / np.linalg.norm(q)).tolist()
    return w, x, y, z


def rotation_of(wxyz: Floats) -> Floats:
    """Return the rotation (3, 3) of a quaternion (w, x, y, z)."""
    w, x, y, z = wxyz / np.linalg.norm(wxyz)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
