"""Velocity-level inverse kinematics, Mäkinen 3.5-3.10.

Lengths and angles are weighed one metre to one radian throughout.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from workgauge.values.arrays import Floats

#: An exclusive group keeps the right to move the tool until another misses this much less of what is wanted.
HYSTERESIS = 1.25


@dataclass(frozen=True, slots=True)
class Damping:
    """When and how much the pseudo-inverse is damped.

    Attributes:
        threshold: damping begins where the smallest singular value falls below this [m/rad].
        largest: lambda at the singularity itself [m/rad].
    """

    threshold: float = 0.2
    largest: float = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Joint velocities for a wanted tool twist.

    Attributes:
        qdot: (n,) [rad/s, m/s].
        missed: share of the wanted motion that is not achieved, 0 when it is, 1 when nothing of it is. Counted over
            position and orientation with six joints or more, over position alone with fewer.
    """

    qdot: Floats
    missed: float


def damped_inverse(J: Floats, damping: Damping) -> Floats:
    """Return `J+ = J^T (J J^T + lambda^2 I)^-1` (n, m) of J (m, n), with lambda adapted to the singularity (3.9).

    `lambda^2 = largest^2 (1 - (s / threshold)^2)` where the smallest singular value s is below the threshold, else 0.
    """
    U, sigma, Vt = np.linalg.svd(J, full_matrices=False)
    smallest = float(sigma[-1])
    squared = 0.0
    if smallest < damping.threshold:
        squared = damping.largest**2 * (1.0 - (smallest / damping.threshold) ** 2)
    inverse: Floats = (Vt.T * (sigma / (sigma * sigma + squared))) @ U.T
    return inverse


def filtered_inverse(J: Floats, damping: Damping) -> Floats:
    """Return a pseudo-inverse (n, m) of J (m, n) damped along the weak directions alone, for tasks of unknown rank.

    Each singular value below the threshold has its own lambda, and one of zero is left out, so that what cannot be
    reached at all does not dampen what can.
    """
    U, sigma, Vt = np.linalg.svd(J, full_matrices=False)
    weak = np.maximum(1.0 - (sigma / damping.threshold) ** 2, 0.0)
    inverse: Floats = (Vt.T * (sigma / (sigma * sigma + damping.largest**2 * weak + 1e-30))) @ U.T
    return inverse


def null_projector(J: Floats, tolerance: float = 1e-6) -> Floats:
    """Return the projector (n, n) onto the motions that J (m, n) does not feel.

    Undamped, by a truncated singular value decomposition: with damping, `I - J+ J` is no projector and leaks into the
    task. Singular values below `tolerance` times the largest count as zero.
    """
    _, sigma, Vt = np.linalg.svd(J, full_matrices=False)
    task = Vt[sigma > tolerance * max(float(sigma[0]), 1e-12)]
    projector: Floats = np.eye(J.shape[1]) - task.T @ task
    return projector


def resolved(J: Floats, twist: Floats, damping: Damping, z: Floats | None = None) -> Floats:
    """Return `qdot = J+ twist + (I - J+ J) z` (3.5, 3.8) for J (m, n), twist (m,) and a null-space motion z (n,)."""
    qdot: Floats = damped_inverse(J, damping) @ twist
    return qdot if z is None else qdot + null_projector(J) @ z


def tool_motion(J: Floats, twist: Floats, joints: Sequence[int], damping: Damping) -> Solution:
    """Return joint velocities that move the tool as wanted with the given joints alone.

    With six joints or more the whole twist is one task. With fewer, the position comes first, and the orientation
    gets what the position leaves: `qdot = Jv+ v + N (Jw N)+ (w - Jw Jv+ v)`, N the projector of Jv.

    Args:
        J: (6, n), linear then angular, and `twist` (6,) [m/s, rad/s], in the same axes.
        joints: indices of the joints that may move; the others stand still.
        damping: see there.
    """
    every = len(joints) == J.shape[1]
    free = J if every else J[:, joints]
    if len(joints) >= 6:
        task = 6
        some = resolved(free, twist, damping)
    else:
        task = 3
        some = resolved(free[:3], twist[:3], damping)
        if len(joints) > 3:
            N = null_projector(free[:3])
            some = some + N @ (filtered_inverse(free[3:] @ N, damping) @ (twist[3:] - free[3:] @ some))
    wanted = math.hypot(*twist[:task].tolist())
    missed = math.hypot(*(twist[:task] - free[:task] @ some).tolist()) / wanted if wanted > 0.0 else 0.0
    if every:
        return Solution(some, missed)
    qdot = np.zeros(J.shape[1])
    qdot[joints] = some
    return Solution(qdot, missed)
