"""Limits cut into convex cells, each with an oriented box around it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from workgauge.values.arrays import Floats, Ints, freeze
from workgauge.values.limits import Limit
from workgauge.values.solids import Box, Convex, PrismChain, Surface, Tube

UP = np.array([0.0, 0.0, 1.0])
#: Corners of a box in half extents (8, 3), and its edges (12, 2) as indices of corners.
CORNER_SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
BOX_EDGES = np.array([(i, i | bit) for bit in (4, 2, 1) for i in range(8) if not i & bit])
for _array in (UP, CORNER_SIGNS, BOX_EDGES):
    freeze(_array)


@dataclass(frozen=True, slots=True, eq=False)
class OrientedBoxes:
    """m boxes in the site frame: centres (m, 3), axes (m, 3, 3) as columns, half extents (m, 3) [m]."""

    centres: Floats
    axes: Floats
    halves: Floats

    @classmethod
    def of_poses(cls, poses: Floats, halves: Floats) -> "OrientedBoxes":
        """Return the boxes with frames poses (m, 4, 4) and half extents (m, 3)."""
        return cls(poses[:, :3, 3], poses[:, :3, :3], halves)

    def reach(self) -> Floats:
        """Return half the size (m, 3) of the axis-parallel boxes around them."""
        found: Floats = np.matvec(np.abs(self.axes), self.halves)
        return found


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """All cells of all limits that are not surfaces, in the order of the limits.

    Attributes:
        limits: (m,) index of each cell's limit. cells: (m,) its index in the limit's chain, -1 for one-cell solids.
        boxes: a box around each cell. lows, highs: (m, 3), the axis-parallel box around that.
    """

    limits: Ints
    cells: Ints
    boxes: OrientedBoxes
    lows: Floats
    highs: Floats

    def __len__(self) -> int:
        return len(self.limits)


def cut(limits: Sequence[Limit]) -> Cells:
    """Cut every limit that is not a surface into its cells."""
    owners: list[Ints] = [np.empty(0, np.int64)]
    indices: list[Ints] = [np.empty(0, np.int64)]
    centres: list[Floats] = [np.empty((0, 3))]
    axes: list[Floats] = [np.empty((0, 3, 3))]
    halves: list[Floats] = [np.empty((0, 3))]
    for i, limit in enumerate(limits):
        boxes = _boxes_of(limit)
        if boxes is None:
            continue
        count = len(boxes.centres)
        owners.append(np.full(count, i))
        chained = isinstance(limit.solid, PrismChain | Tube)
        indices.append(np.arange(count) if chained else np.full(count, -1))
        centres.append(boxes.centres)
        axes.append(boxes.axes)
        halves.append(boxes.halves)
    around = OrientedBoxes(np.concatenate(centres), np.concatenate(axes), np.concatenate(halves))
    reach = around.reach()
    lows, highs = around.centres - reach, around.centres + reach
    found = Cells(np.concatenate(owners), np.concatenate(indices), around, lows, highs)
    for array in (found.limits, found.cells, around.centres, around.axes, around.halves, lows, highs):
        freeze(array)
    return found


def _boxes_of(limit: Limit) -> OrientedBoxes | None:
    """Return a box around each cell of the limit, None for a surface."""
    solid = limit.solid
    match solid:
        case Box():
            return OrientedBoxes.of_poses(solid.T_frame_box[None], solid.half_extents[None])
        case Convex():
            return _around(np.eye(3)[None], solid.vertices[None])
        case PrismChain():
            offsets = solid.sections[..., :1] * solid.laterals[:, None] + solid.sections[..., 1:] * UP
            vertices = np.concatenate([solid.starts[:, None] + offsets, solid.ends[:, None] + offsets], axis=1)
            return _around(frames_along(solid.ends - solid.starts, solid.laterals), vertices)
        case Tube():
            along = np.diff(solid.axis, axis=0)
            boxes = _around(frames_along(along), np.stack([solid.axis[:-1], solid.axis[1:]], axis=1))
            return OrientedBoxes(boxes.centres, boxes.axes, boxes.halves + solid.radius)
        case Surface():
            return None


def frames_along(along: Floats, laterals: Floats | None = None) -> Floats:
    """Return right-handed frames (m, 3, 3), axes as columns, x along each (m, 3) vector and y near its lateral.

    Without laterals, y is horizontal, or the site's x axis under an upright vector. A vector of no length counts as
    upright.
    """
    lengths = np.linalg.norm(along, axis=1, keepdims=True)
    x = np.where(lengths > 0.0, along / np.where(lengths > 0.0, lengths, 1.0), UP)
    if laterals is None:
        laterals = np.cross(UP, x)
        upright = np.linalg.norm(laterals, axis=1) < 1e-9
        laterals[upright] = (1.0, 0.0, 0.0)
    y = laterals - np.vecdot(laterals, x)[:, None] * x
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], axis=2)


def _around(axes: Floats, vertices: Floats) -> OrientedBoxes:
    """Return the boxes with the given axes (m, 3, 3) around vertices (m, k, 3)."""
    middle = vertices.mean(axis=1)
    local = (vertices - middle[:, None]) @ axes
    low, high = local.min(axis=1), local.max(axis=1)
    return OrientedBoxes(middle + np.matvec(axes, 0.5 * (low + high)), axes, 0.5 * (high - low))
