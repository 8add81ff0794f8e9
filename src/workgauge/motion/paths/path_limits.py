"""What joints, tool and pump allow of the motion along a path: bounds on its rate and rows on its acceleration."""

from dataclasses import dataclass

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.motion.paths.joint_curve import JointCurve
from workgauge.motion.paths.tool_path import ToolPath
from workgauge.values.arrays import Floats

#: Where each interval of the grid is looked at for its highest rate.
_LOOKED = np.linspace(0.0, 1.0, 9)
#: Where in each interval accelerations are bounded while the rate is sought.
_ROWS = np.array([0.0, 0.5, 1.0])
_INSIDE_M = 1e-8
_LEAST = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class PathLimits:
    """Highest speeds and accelerations along a path.

    Attributes:
        speed_positive, speed_negative: (n,) of joints, above 0 [rad/s, m/s].
        acceleration: (n,) of joints, either way, above 0 [rad/s^2, m/s^2].
        flow, flow_positive, flow_negative: the pump's [m^3/s], and per joint speed (n,) [m^3/rad, m^2]; infinite and
            zeros without a pump.
        tool: the path of the tool, or None for none. tool_speed, tool_turn, tool_acceleration: [m/s, rad/s, m/s^2].
    """

    speed_positive: Floats
    speed_negative: Floats
    acceleration: Floats
    flow: float
    flow_positive: Floats
    flow_negative: Floats
    tool: ToolPath | None = None
    tool_speed: float = np.inf
    tool_turn: float = np.inf
    tool_acceleration: float = np.inf

    @classmethod
    def of(cls, machine: MachineModel, acceleration: Floats, share: float) -> "PathLimits":
        """Return a machine's, its joint speeds and its pump's flow times a share."""
        pump = machine.pump
        none = np.zeros(machine.n)
        return cls(
            share * machine.speed_positive,
            share * machine.speed_negative,
            acceleration,
            np.inf if pump is None else share * pump.flow,
            none if pump is None else pump.flow_positive / machine.speed_positive,
            none if pump is None else pump.flow_negative / machine.speed_negative,
        )

    def used(self, slope: Floats) -> Floats:
        """Return the share (k,) of joint speeds and pump flow used at ds/dt = 1 with slopes (k, n), the largest."""
        speed = np.maximum(slope / self.speed_positive, -slope / self.speed_negative).max(axis=1)
        flow = np.where(slope > 0.0, slope * self.flow_positive, -slope * self.flow_negative).sum(axis=1)
        return np.asarray(np.maximum(speed, flow / self.flow), dtype=np.float64)

    def tool_used(self, grid: Floats) -> Floats:
        """Return the share (N, 5) of the tool's limits used at ds/dt = 1, at even places in a grid's intervals."""
        places = grid[:-1, None] + np.diff(grid)[:, None] * _LOOKED[::2]
        if self.tool is None:
            return np.zeros_like(places)
        s = np.clip(places, places[0, 0] + _INSIDE_M, places[-1, -1] - _INSIDE_M)  # not round a sharp corner
        turning = np.linalg.norm(self.tool.at(s)[1][..., 3:], axis=-1)
        bend = np.sqrt(self.tool.curvature(s) / self.tool_acceleration)
        most = np.maximum(1.0 / self.tool_speed, turning / self.tool_turn)
        return np.asarray(np.maximum(most, bend), dtype=np.float64)

    def highest(self, curve: JointCurve, grid: Floats, tool: Floats) -> Floats:
        """Return the highest rates (N, 3) at the beginning, middle and end of each interval of a grid (N + 1,).

        `tool` (N, 5) is what the tool uses there.
        All three are lowered by as much as what is used rises above them in between.
        """
        low, width = grid[:-1, None], np.diff(grid)[:, None]
        places = low + width * _LOOKED
        pieces = np.repeat(curve.piece(0.5 * (grid[:-1] + grid[1:])), len(_LOOKED))
        joints = self.used(curve.at(places.ravel(), pieces)[1]).reshape(places.shape)
        at_rows = np.maximum(joints[:, ::4], tool[:, ::2])
        rise = np.maximum(_peaks(joints), _peaks(tool)) / np.maximum(at_rows.max(axis=1), _LEAST)
        return np.asarray(1.0 / np.maximum(at_rows * np.maximum(rise, 1.0)[:, None], _LEAST), dtype=np.float64)

    def rows(self, curve: JointCurve, grid: Floats, highest: Floats) -> tuple[Floats, Floats]:
        """Return a, b (N + 1, r): `|a u + b x| <= 1` at grid values, x the rate squared and u its acceleration.

        A distance d into an interval, x has become `x + 2 d u`. Bounded there are that, by the highest rates (N, 3)
        squared, and each joint's acceleration `q' u + q'' (x + 2 d u)`. The last row is the tool's own acceleration
        along the path.
        """
        width = np.diff(grid)
        pieces = curve.piece(0.5 * (grid[:-1] + grid[1:]))
        a, b = [], []
        for share, top in zip(_ROWS, highest.T, strict=True):
            _, slope, bend = curve.at(grid[:-1] + share * width, pieces)
            grown = 2.0 * (share * width)[:, None]
            a += [(slope + grown * bend) / self.acceleration, grown / top[:, None] ** 2]
            b += [bend / self.acceleration, 1.0 / top[:, None] ** 2]
        if self.tool is not None:
            a.append(np.full((len(width), 1), 1.0 / self.tool_acceleration))
            b.append(np.zeros((len(width), 1)))
        found = np.concatenate(a, axis=1), np.concatenate(b, axis=1)
        return np.vstack([found[0], 0.0 * found[0][-1:]]), np.vstack([found[1], 0.0 * found[1][-1:]])

    def exceeded(self, curve: JointCurve, grid: Floats, rate: Floats, tool: Floats) -> Floats:
        """Return the factors (N,) by which time must be stretched in each interval for all limits to hold, 1 or more.

        Accelerations within an interval are parabolas in s, so their largest is exact; speeds are looked at closely.
        """
        width = np.diff(grid)
        pieces = curve.piece(0.5 * (grid[:-1] + grid[1:]))
        x, u = rate**2, np.diff(rate**2) / (2.0 * width)
        worst = _peaks(tool * np.sqrt(x[:-1, None] + np.diff(x)[:, None] * _LOOKED[::2]))
        values, speeds = [], []
        for share in _LOOKED:
            _, slope, bend = curve.at(grid[:-1] + share * width, pieces)
            here = x[:-1] + share * (x[1:] - x[:-1])
            speeds.append(self.used(slope) * np.sqrt(here))
            values.append((slope * u[:, None] + bend * here[:, None]) / self.acceleration)
        worst = np.maximum(worst, _peaks(np.array(speeds).T))
        first, middle, last = values[0], values[len(values) // 2], values[-1]
        square, linear = 2.0 * (first + last - 2.0 * middle), 4.0 * middle - 3.0 * first - last
        top = np.clip(-linear / np.where(np.abs(square) < 1e-15, np.inf, 2.0 * square), 0.0, 1.0)
        peak = np.maximum(np.abs(first + top * (linear + top * square)), np.abs(values).max(axis=0)).max(axis=1)
        return np.asarray(np.maximum(np.maximum(worst, np.sqrt(peak)), 1.0), dtype=np.float64)


def _peaks(values: Floats) -> Floats:
    """Return the largest (N,) of values (N, k) at even places, and of parabolas through each largest and its two."""
    row, k = np.arange(len(values)), np.clip(values.argmax(axis=1), 1, values.shape[1] - 2)
    before, at, after = values[row, k - 1], values[row, k], values[row, k + 1]
    bend = before - 2.0 * at + after
    x = np.clip((before - after) / np.where(bend < 0.0, 2.0 * bend, -np.inf), -1.0, 1.0)
    parabola = at + 0.5 * x * (after - before) + 0.5 * x * x * bend
    return np.asarray(np.maximum(parabola, values.max(axis=1)), dtype=np.float64)
