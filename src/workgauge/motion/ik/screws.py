"""The joints of a chain as lines in space at q = 0, and turning about them."""

from dataclasses import dataclass, field
from typing import Self

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.values.arrays import Floats, frozen
from workgauge.values.transforms import skew


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """A directed line in the machine frame: `direction` (3,) of length 1, `point` (3,) on it [m]."""

    direction: Floats
    point: Floats
    _across: Floats = field(init=False, repr=False)
    _inwards: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        K = skew(self.direction)
        object.__setattr__(self, "_across", frozen(K.T))
        object.__setattr__(self, "_inwards", frozen((K @ K).T))

    def across(self, v: Floats) -> Floats:
        """Return `direction x v` for vectors (..., 3)."""
        product: Floats = v @ self._across
        return product

    def turn(self, angle: Floats, v: Floats) -> Floats:
        """Return vectors v (..., 3) turned about the direction by angles (...) [rad] (Rodrigues)."""
        s, versine = np.sin(angle)[..., None], (1.0 - np.cos(angle))[..., None]
        turned: Floats = v + s * (v @ self._across) + versine * (v @ self._inwards)
        return turned

    def level(self, along: Floats, v: Floats) -> tuple[Floats, Floats, Floats]:
        """Return (c0, c, s), each (...): `along . R(angle) v = c0 + c cos(angle) + s sin(angle)` for v (..., 3)."""
        c = -(v @ (self._inwards @ along))
        return v @ along - c, c, v @ (self._across @ along)

    def angle(self, a: Floats, b: Floats) -> Floats:
        """Return the angles [rad] that turn the parts of a (..., 3) across the line onto those of b (..., 3)."""
        across = self.across(a)
        angle: Floats = np.arctan2((across * b).sum(-1), (across * self.across(b)).sum(-1))
        return angle

    def reversed(self) -> Self:
        """Return the same line the other way round."""
        return type(self)(frozen(-self.direction), self.point)


def joint_lines(machine: MachineModel) -> tuple[tuple[Line, ...], Floats] | None:
    """Return the joints' lines and the tool's pose (4, 4) at q = 0, in the machine frame; None if a joint slides.

    With them the tool stands at `E1 E2 ... En T0`, E_j the turn about line j by q_j (product of exponentials).
    """
    if np.any(machine.prismatic):
        return None
    kin = machine.forward(np.zeros(machine.n))
    lines = []
    for linear, angular in zip(kin.spatial_jacobian[:3].T, kin.spatial_jacobian[3:].T, strict=True):
        length = float(np.linalg.norm(angular))
        lines.append(Line(frozen(angular / length), frozen(np.cross(angular, linear) / length**2)))
    return tuple(lines), machine.tool_pose(kin)


def common_normal(a: Line, b: Line) -> tuple[Floats, Floats]:
    """Return the points (3,), (3,) where two lines that are not parallel come nearest each other."""
    between = b.point - a.point
    cosine = float(a.direction @ b.direction)
    along_a, along_b = float(a.direction @ between), float(b.direction @ between)
    sine2 = 1.0 - cosine * cosine
    s = (along_a - cosine * along_b) / sine2
    t = (cosine * along_a - along_b) / sine2
    return a.point + s * a.direction, b.point + t * b.direction
