"""As fast as joints, tool and pump allow: times for the joints' way along a path, by TOPP-RA (Pham and Pham 2018)."""

import itertools
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from workgauge.machine.model import MachineModel
from workgauge.motion.paths.joint_curve import JointCurve
from workgauge.motion.paths.joint_path import JointPath
from workgauge.motion.paths.path_limits import PathLimits
from workgauge.motion.paths.rounded import Kept, clashing, rounded
from workgauge.motion.paths.trajectory import Trajectory
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import InputError

__all__ = ["Trajectory", "default_acceleration", "timed", "timed_joints"]

#: Share of a joint's stopping deceleration that a planned motion uses; the rest is for what the plan does not know.
ACCELERATION_SHARE = 0.5
#: A joint without dynamics of its own is planned to come to full speed in this time [s].
IDEAL_RAMP_S = 0.25
#: Acceleration of the tool along its path, and across it in bends [m/s^2].
TOOL_ACCELERATION_M_S2 = 1.0
_GRID = 240
_STILL = 1e-9
#: All of a motion may be stretched by so much for what lies between the grid's points; for more it is found again
#: with lower limits where they are exceeded.
_STRETCH = 1.00002
_ROUNDS = 5


@lru_cache(maxsize=16)
def default_acceleration(machine: MachineModel) -> Floats:
    """Return the joint accelerations (n,) [rad/s^2, m/s^2] that motions are planned with.

    `ACCELERATION_SHARE` of the lower of a joint's two stopping decelerations; full speed in `IDEAL_RAMP_S` where the
    machine's file knows none.
    """
    sides = zip(machine.stopping_positive, machine.stopping_negative, strict=True)
    stopping = np.array([min(plus.deceleration, minus.deceleration) for plus, minus in sides])
    ideal = np.minimum(machine.speed_positive, machine.speed_negative) / IDEAL_RAMP_S
    return frozen(np.where(np.isfinite(stopping), ACCELERATION_SHARE * stopping, ideal))


def timed(
    joint_path: JointPath,
    machine: MachineModel,
    *,
    tool_speed_m_s: float,
    tool_turn_rad_s: float | None = None,
    acceleration: ArrayLike | None = None,
    tool_acceleration_m_s2: float = TOOL_ACCELERATION_M_S2,
    speed_share: float = 1.0,
) -> Trajectory:
    """Return the fastest motion along a path: the tool at its speed wherever the machine can, at rest at both ends.

    Bounds: joint speeds by direction, the pump's flow, joint accelerations, the tool's speed, turning and
    acceleration, along the path and across it. At sharp corners the tool stands. The bounds hold between the grid's
    points as well, to 1e-6 of them.

    Args:
        joint_path: from `joint_path`.
        tool_speed_m_s: of the tool along the path. tool_turn_rad_s: fastest turning of the tool, None for any.
        acceleration: (n,) of the joints; `default_acceleration` if None.
        speed_share: how much of joint speeds and pump flow may be used, above 0 to 1.

    Raises:
        InputError: for values that are not above 0, a path of another machine, or joints that cannot move together.
    """
    _above(tool_speed_m_s=tool_speed_m_s, tool_acceleration_m_s2=tool_acceleration_m_s2)
    if tool_turn_rad_s is not None:
        _above(tool_turn_rad_s=tool_turn_rad_s)
    limits = replace(
        _limits(joint_path.curve, machine, acceleration, speed_share),
        tool=joint_path.path,
        tool_speed=tool_speed_m_s,
        tool_turn=np.inf if tool_turn_rad_s is None else tool_turn_rad_s,
        tool_acceleration=tool_acceleration_m_s2,
    )
    ends = np.concatenate([[0.0], joint_path.path.stops_m, [joint_path.length_m]])
    return _driven(joint_path.curve, limits, ends)


def timed_joints(
    waypoints: ArrayLike,
    machine: MachineModel,
    *,
    kept: Kept | None = None,
    acceleration: ArrayLike | None = None,
    speed_share: float = 1.0,
) -> Trajectory:
    """Return the fastest motion along straight joint lines from posture to posture, at rest at both ends.

    Corners are rounded inwards where they may be, see `rounded`, and passed without a stop; at the others the machine
    stands. No joint leaves the range of its waypoints. The path variable counts one for the time a line takes at full
    joint speed.

    Args:
        waypoints: (k, n) [rad, m], k >= 2, within the joints' limits.
        kept: which corners may be rounded, as `roundable` knows of a plan's; None for none.

    Raises:
        InputError: for one waypoint, a repeated one, what is not finite or beyond a limit, and as for `timed`.
    """
    curve, stops = rounded(_waypoints(waypoints, machine), machine, kept)
    limits = _limits(curve, machine, acceleration, speed_share)
    return _driven(curve, limits, np.concatenate([[0.0], stops, [curve.s[-1]]]))


def _driven(curve: JointCurve, limits: PathLimits, ends: Floats) -> Trajectory:
    """Return the motion along a curve, at rest at the path values `ends` (c,)."""
    grids: list[Floats] = []
    rates: list[Floats] = []
    for start, end in itertools.pairwise(ends.tolist()):
        grid, rate = _section(curve, limits, start, end)
        grids.append(grid if not grids else grid[1:])
        rates.append(rate if not rates else rate[1:])
    return Trajectory.of(curve, np.concatenate(grids), np.concatenate(rates))


def _section(curve: JointCurve, limits: PathLimits, start: float, end: float) -> tuple[Floats, Floats]:
    """Return grid values (N + 1,) and rates (N + 1,) from rest at start to rest at end, every limit kept."""
    grid = _grid(curve, limits, start, end)
    tool = limits.tool_used(grid)
    highest = limits.highest(curve, grid, tool)
    tighter = np.ones(len(grid) - 1)
    for _ in range(_ROUNDS):
        top = highest / tighter[:, None]
        a, b = limits.rows(curve, grid, top)
        harder = np.append(tighter, 1.0)[:, None] ** 2
        beside = np.minimum(np.append(top[:, 0], top[-1, -1]), np.insert(top[:, -1], 0, top[0, 0]))
        rate = _fastest(grid, beside, a * harder, b * harder)
        exceeded = limits.exceeded(curve, grid, rate, tool)
        if exceeded.max() <= _STRETCH:
            break
        tighter *= exceeded
    return grid, rate / exceeded.max()


def _grid(curve: JointCurve, limits: PathLimits, start: float, end: float) -> Floats:
    """Return growing values from start to end: the curve's knots, the tool path's pieces, and evenly in between."""
    marks = [start, end, *curve.s[(curve.s > start) & (curve.s < end)].tolist()]
    if limits.tool is not None:
        breaks = limits.tool.breaks_m
        marks.extend(breaks[(breaks > start) & (breaks < end)].tolist())
    knots = np.unique(marks)
    keep = np.concatenate([[True], np.diff(knots) > 1e-9 * (end - start)])
    keep[-1] = True
    knots = knots[keep]
    parts = np.ceil(_GRID * np.diff(knots) / (end - start)).astype(int)
    spread = [a + (b - a) * np.arange(k) / k for a, b, k in zip(knots[:-1], knots[1:], parts, strict=True)]
    return np.append(np.concatenate(spread), end)


def _fastest(grid: Floats, highest: Floats, a: Floats, b: Floats) -> Floats:
    """Return the highest rates (N + 1,), at rest at both ends, under `|a u + b x| <= 1` and `x <= highest^2`.

    The grid is measured in its own length, and rates in the highest of them, for the solver's tolerances.
    """
    try:
        import toppra.algorithm
        import toppra.constraint
    except ImportError as error:
        raise InputError("timing a path needs toppra", element="plan", allowed="workgauge[plan] installed") from error

    length, unit = float(grid[-1] - grid[0]), float(highest.max())
    squared = (unit / length) ** 2
    at = (grid - grid[0]) / length
    at[-1] = 1.0
    given = (a * squared * length, b * squared * length**2, (highest / unit) ** 2)

    class Bounds(toppra.constraint.LinearConstraint):  # type: ignore[misc]
        def compute_constraint_params(self, path: Any, gridpoints: Any, *_: Any) -> tuple[Any, ...]:
            width = given[0].shape[1]
            both = np.vstack([np.eye(width), -np.eye(width)])
            bounds = np.column_stack([np.zeros(len(at)), given[2]])
            return given[0], given[1], np.zeros_like(given[0]), both, np.ones(2 * width), None, bounds

    bounds = Bounds()
    bounds.identical = True
    bounds.dof = 1
    line = toppra.SplineInterpolator([0.0, 1.0], [[0.0], [1.0]])
    solver = toppra.algorithm.TOPPRA([bounds], line, gridpoints=at, solver_wrapper="seidel")
    _, rates, _ = solver.compute_parameterization(0.0, 0.0)
    if rates is None or not np.isfinite(rates).all() or rates[1:-1].min(initial=np.inf) <= 0.0:
        raise InputError("no motion along this path keeps to the limits", element="path", allowed="a smoother path")
    found: Floats = np.asarray(rates) * unit
    return found


def _limits(curve: JointCurve, machine: MachineModel, acceleration: ArrayLike | None, share: float) -> PathLimits:
    if curve.n != machine.n:
        raise InputError(
            "a path of another machine", element="path", value=f"{curve.n} joints", allowed=str(machine.n)
        )
    if not 0.0 < share <= 1.0:
        raise InputError("not a share of speed", element="speed_share", value=share, allowed="above 0 to 1")
    chosen = default_acceleration(machine) if acceleration is None else np.array(acceleration, dtype=np.float64)
    if chosen.shape != (machine.n,) or not ((chosen > 0.0) & np.isfinite(chosen)).all():
        shown = np.array2string(chosen)
        raise InputError("joint acceleration", element="acceleration", value=shown, allowed=f"{machine.n} above 0")
    moves = np.maximum(np.abs(curve.leaving), np.abs(curve.arriving)) > _STILL
    group = int(clashing(machine, moves).max())
    if group >= 0:
        names = ", ".join(machine.joint_names[j] for j in machine.exclusive_groups[group])
        raise InputError("joints cannot move together with the others", element=names, allowed="one group alone")
    return PathLimits.of(machine, chosen, share)


def _waypoints(waypoints: ArrayLike, machine: MachineModel) -> Floats:
    try:
        q = np.array(waypoints, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("not numbers in rows of equal length", element="waypoints") from error
    if q.ndim != 2 or q.shape[1] != machine.n or len(q) < 2:
        shape = f"shape {q.shape}"
        raise InputError("no way", element="waypoints", value=shape, allowed=f"(k, {machine.n}) with 2 or more")
    if not np.isfinite(q).all():
        wrong = int(np.flatnonzero(~np.isfinite(q).all(axis=1))[0])
        raise InputError("not finite", element=f"waypoint {wrong}", value=q[wrong].tolist(), allowed="numbers")
    outside = (q < machine.q_min - _STILL) | (q > machine.q_max + _STILL)
    if outside.any():
        row, j = (int(at[0]) for at in np.nonzero(outside))
        allowed = f"{machine.q_min[j]:.4f} to {machine.q_max[j]:.4f}"
        element = f"waypoint {row}, {machine.joint_names[j]}"
        raise InputError("beyond the joint's limits", element=element, value=float(q[row, j]), allowed=allowed)
    again = np.flatnonzero(np.abs(np.diff(q, axis=0)).max(axis=1) < _STILL)
    if len(again):
        raise InputError("repeats the one before", element=f"waypoint {int(again[0]) + 1}", allowed="another posture")
    return q


def _above(**values: float) -> None:
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0.0):
            raise InputError("not a limit for a motion", element=name, value=value, allowed="above 0")
