"""The arm at many postures at once: where its joints and boxes are, in compiled code; the same as `MachineModel`."""

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np

from workgauge.machine.frames import product, turn
from workgauge.machine.model import MachineModel
from workgauge.values.arrays import Floats, Ints, freeze, frozen, frozen_ints
from workgauge.values.compiled import njit


@dataclass(frozen=True, slots=True, eq=False)
class ArmAt:
    """The arm at P postures, in the frame that `Arm.at` was given the machine's pose in.

    Attributes:
        axes: (P, n, 3) unit axes of the joints. origins: (P, n, 3) points on them [m].
        rotations: (P, S, 3, 3) axes of the boxes as columns. corners: (P, S, 8, 3), signs as in
            `product((-1, 1), repeat=3)` of the box's own axes [m].
    """

    axes: Floats
    origins: Floats
    rotations: Floats
    corners: Floats


class Arm:
    """A machine's chain and boxes, packed; immutable.

    Attributes:
        links: (S,) link of each box: joints 0 to link - 1 carry it.
        prismatic: (n,) 1 for joints that slide.
        stretch: (S, 3) joint that lengthens the box (-1: none), the box's axis, and the side that moves.
        levers: (S, n) no point of the box is farther from a turning joint's axis [m]; 1 or 2 for sliding joints, 0
            for joints that do not move it.
        farthest: (n,) the largest lever of each joint [m]. packed: what `place` takes, and the levers.
        reach_m: no point is farther from the machine frame's origin, nor from a turning joint's axis [m].
    """

    def __init__(self, machine: MachineModel) -> None:
        n = machine.n
        before = [np.eye(4), *(joint.T_joint_link for joint in machine.chain)]
        steps = [before[j] @ joint.T_parent_joint for j, joint in enumerate(machine.chain)]
        boxes = [before[solid.link] @ solid.T_link_box for solid in machine.solids]
        self._steps = frozen(np.reshape(steps, (n, 4, 4)))
        self._boxes = frozen(np.reshape(boxes, (-1, 4, 4)))
        self._axes = frozen(np.reshape([joint.axis for joint in machine.chain], (n, 3)))
        self._halves = frozen([solid.half_extents for solid in machine.solids])
        self.links: Ints = frozen_ints([solid.link for solid in machine.solids])
        self.prismatic: Ints = frozen_ints(machine.prismatic.astype(np.int64))
        self.stretch: Ints = frozen_ints([solid.stretch or (-1, 0, 0) for solid in machine.solids])
        self.levers, self.reach_m = self._bounds(machine)
        self.farthest: Floats = frozen(self.levers.max(axis=0, initial=0.0))
        self.packed = (
            *(self._steps, self._axes, self.prismatic, self._boxes, self._halves),
            *(self.links, self.stretch, self.levers),
        )

    def at(self, T_frame_machine: Floats, postures: Floats) -> ArmAt:
        """Return the arm at postures (P, n) of a machine at T_frame_machine (4, 4)."""
        count, n, boxes = len(postures), len(self._axes), len(self.links)
        out = ArmAt(
            np.empty((count, n, 3)),
            np.empty((count, n, 3)),
            np.empty((count, boxes, 3, 3)),
            np.empty((count, boxes, 8, 3)),
        )
        place(
            np.ascontiguousarray(T_frame_machine),
            np.ascontiguousarray(postures),
            *(self._steps, self._axes, self.prismatic, self._boxes, self._halves, self.links, self.stretch),
            *(out.axes, out.origins, out.rotations, out.corners),
        )
        return out

    def _bounds(self, machine: MachineModel) -> tuple[Floats, float]:
        """Return the levers and the reach: lengths of the links in between and of the box, all in one line."""
        travel = np.maximum(np.abs(machine.q_min), np.abs(machine.q_max))
        levers, farthest = np.zeros((len(machine.solids), machine.n)), 0.0
        for s, solid in enumerate(machine.solids):
            grown = travel[solid.stretch.joint] if solid.stretch else 0.0
            reach = float(np.linalg.norm(self._boxes[s, :3, 3]) + np.linalg.norm(solid.half_extents) + grown)
            for j in range(solid.link - 1, -1, -1):
                own = solid.stretch is not None and solid.stretch.joint == j
                levers[s, j] = 1.0 + own if machine.prismatic[j] else reach
                reach += float(np.linalg.norm(self._steps[j, :3, 3]) + (travel[j] if machine.prismatic[j] else 0.0))
            if solid.stretch is not None and solid.stretch.joint >= solid.link:
                levers[s, solid.stretch.joint] = 1.0
            farthest = max(farthest, reach)
        freeze(levers)
        return levers, farthest


@functools.lru_cache(maxsize=16)
def arm_of(machine: MachineModel) -> Arm:
    """Return a machine's chain and boxes, packed once for each machine."""
    return Arm(machine)


@njit(cache=True)
def place(
    T: Any,
    q: Any,
    steps: Any,
    joint_axes: Any,
    prismatic: Any,
    boxes: Any,
    halves: Any,
    links: Any,
    stretch: Any,
    axes: Any,
    origins: Any,
    rotations: Any,
    corners: Any,
) -> None:
    """Fill axes, origins, rotations and corners, see `ArmAt`; T (4, 4), q (P, n), the rest is `Arm.packed`."""
    n = q.shape[1]
    frames = np.zeros((n + 1, 4, 4))
    motion, step, box = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((4, 4))
    half = np.empty(3)
    for p in range(q.shape[0]):
        frames[0] = T
        for j in range(n):
            product(frames[j], steps[j], step)
            for i in range(3):
                axes[p, j, i] = (
                    step[i, 0] * joint_axes[j, 0] + step[i, 1] * joint_axes[j, 1] + step[i, 2] * joint_axes[j, 2]
                )
                origins[p, j, i] = step[i, 3]
            if prismatic[j]:
                frames[j + 1] = step
                for i in range(3):
                    frames[j + 1, i, 3] += q[p, j] * axes[p, j, i]
            else:
                turn(joint_axes[j], q[p, j], motion)
                product(step, motion, frames[j + 1])
        for s in range(len(links)):
            product(frames[links[s]], boxes[s], box)
            for i in range(3):
                half[i] = halves[s, i]
            joint = stretch[s, 0]
            if joint >= 0:
                grown = 0.5 * q[p, joint]
                half[stretch[s, 1]] += grown
                for i in range(3):
                    box[i, 3] += stretch[s, 2] * grown * box[i, stretch[s, 1]]
            for i in range(3):
                for k in range(3):
                    rotations[p, s, i, k] = box[i, k]
                x, y, z = box[i, 0] * half[0], box[i, 1] * half[1], box[i, 2] * half[2]
                for k in range(8):
                    total = box[i, 3] + (x if k & 4 else -x)
                    corners[p, s, k, i] = total + (y if k & 2 else -y) + (z if k & 1 else -z)
