"""Which joint motions may serve to give way, so that the tool's task suffers least."""

from enum import StrEnum

import numpy as np

from workgauge.guard.api import GuardInput
from workgauge.values.arrays import Floats

#: A task's singular value below this share of its largest is none.
RANK = 1e-6
#: Joints of the document's own variant, from the undercarriage on.
FIRST = 3
#: Rows of a task that are the tool's velocity; the rest turn it.
POSITION = 3
WHOLE_POSE = 6


class Variant(StrEnum):
    """Which part of a tool's task gives way."""

    KEEP_ORIENTATION = "keep_orientation"  #: a redundant task not at all, any other in position alone
    FIRST_THREE = "first_three"  #: whatever the first three joints do to it


def freedom(given: GuardInput, free: list[int], variant: Variant) -> Floats:
    """Return an orthonormal basis (n, d) of the joint velocities that may be added to give way, d at least 1.

    Mäkinen 3.14 lets every term act in the null space of the task, `I - J+ J`. Where the task leaves joints over that
    is what comes back: undamped and truncated, for damped it is no projector and leaks into the task. A task that
    needs all joints leaves nothing: with a square J that projector is zero, and (3.16) as printed avoids nothing.
    Then the position gives way and the orientation is kept, by `I - Jw+ Jw` of the task's rows that turn the tool.
    Where there is no task, or it leaves no motion at all, every joint may move.

    Args:
        given: with its task, or `keep_direction` and the machine that stands there for the tool's whole pose. A
            machine with fewer than six joints to move has no whole pose; there the task must be given.
        free: joints that may move; the others' rows are zero. variant: see there.
    """
    joints = np.eye(len(given.joint_names))[:, free]
    task = _task(given, len(free))
    if task is None:
        return joints
    if variant is Variant.FIRST_THREE:
        first = [j for j in free if j < FIRST]
        return joints if not first else np.eye(len(given.joint_names))[:, first]
    kept = task[:, free] if len(task) < len(free) else task[POSITION:, free]
    null = _null_space(kept)
    return joints @ null if null.shape[1] else joints


def _task(given: GuardInput, free: int) -> Floats | None:
    """Return the Jacobian (m, n) of the task the wish was made for, None if it is none of the tool's."""
    if given.task is not None:
        return given.task
    if not given.keep_direction or given.around is None or free < WHOLE_POSE:
        return None
    machine = given.around.machine
    return machine.tool_jacobian(machine.forward(given.q)) if machine.n == len(given.q) else None


def _null_space(J: Floats) -> Floats:
    """Return an orthonormal basis (n, d) of the motions that J (m, n) does not feel."""
    if not len(J):
        return np.eye(J.shape[1])
    _, sigma, Vt = np.linalg.svd(J)
    rank = int((sigma > RANK * max(float(sigma[0]), 1e-12)).sum())
    null: Floats = Vt[rank:].T
    return null
