"""Protection level of each clearance: how much of the believed distance may not be there.

`k sigma + bias` along the clearance's own direction, sigma^2 = g^T S g: S the covariance of the machine's pose and
joints, g what each of them does to the distance; k from a stated integrity risk.
"""

import functools
import math
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from workgauge.machine.model import Kinematics, MachineModel
from workgauge.machine.positioning import IntegritySpec
from workgauge.proximity.cells import CORNER_SIGNS
from workgauge.proximity.uncertainty import LimitUncertainty, MachineUncertainty
from workgauge.values.arrays import Floats, freeze
from workgauge.values.clearances import Clearances

#: k sigma of a solid's whole turn beyond which errors are no longer small: no protection level is given [rad].
LARGEST_TURN = 0.35


def protection_factor(risk: float) -> float:
    """Return k of `k sigma + bias` for an integrity risk, the two-sided tail of a Gaussian: 5.33 for 1e-7.

    Raises:
        ValueError: unless the risk lies above 0 and below 1.
    """
    if not 0.0 < risk < 1.0:
        raise ValueError(f"a risk lies between 0 and 1, not {risk}")
    return -NormalDist().inv_cdf(0.5 * risk)


@dataclass(frozen=True, slots=True)
class Integrity:
    """How sure a clearance's lower bound must be: so many sigma `k`, and `bias_m` for what is not noise [m]."""

    k: float
    bias_m: float = 0.0

    @classmethod
    def of(cls, spec: IntegritySpec) -> "Integrity":
        """Return what the machine file's `integrity` asks for."""
        return cls(protection_factor(spec.risk), spec.bias_m)


def with_protection(
    clearances: Clearances,
    rows: Floats,
    kin: Kinematics,
    machine: MachineModel,
    T_site_machine: Floats,
    unsure: MachineUncertainty,
    limits: LimitUncertainty,
    integrity: Integrity,
) -> tuple[Clearances, float]:
    """Return the clearances with their protection levels, and a bound of the level that any limit could have here.

    For a point x of the solid that lies on the link, an error moves it by `n . e` along the clearance's direction n:
    pose `n . d + phi . ((x - t) x n)` (translation d, rotation phi about the machine's origin t), joints `row . dq`.
    The level is the largest of `k sigma(x) - n . (x - closest point)` over the corners of the solid, and `k sigma` at
    the closest point: where a face is nearly parallel to the limit, it is the face's far corner that may be nearer
    than believed. To sigma^2 are added the squares of the limit's tolerance and, on the tool's link, of the
    attachment's, and the limit's own pose (about `uncertainty.own_place`). Between two links only the joints between
    them count.

    What it bounds: each convex cell of a limit lies beyond the plane through its closest point, and the solid on this
    side of the plane moved by its worst corner, whichever features are closest afterwards. So for Gaussian errors the
    true distance to that cell is below the bound with at most the one-sided tail of k for each corner that matters
    (one, unless a face is parallel to better than sigma). Where a limit is hollow (the inner side of a bent chain, a
    valley) cells beside the closest one, in other directions, add their own risk.

    Turning is taken to first order; the second, at most `(k sigma of the solid's turn)^2 / 2` times its largest lever
    arm, is added in full. Beyond `LARGEST_TURN` first order is no bound any more, and levels are infinite.

    The second result [m] covers limits farther away than was searched and any direction; it is crude (a few times too
    large with good sensors) and cheap.

    Args:
        clearances: of `Scene.query`. rows: (k, n) of `machine.distance_rows`.
        kin, machine, T_site_machine: as believed. unsure, limits, integrity: see there.
    """
    variances = limits.variances.take(clearances.limits)
    if unsure.tool_sigma_m:
        tool = (clearances.links == machine.tool_link) | (clearances.other_links == machine.tool_link)
        variances = variances + tool * unsure.tool_sigma_m**2
    if unsure.exact and not len(limits.places):
        levels = integrity.k * np.sqrt(variances)
        largest = integrity.k * math.sqrt(limits.largest_variance + unsure.tool_sigma_m**2)
    else:
        body = _body(kin, machine, unsure)
        levels = _levels(clearances, rows, body, T_site_machine, limits, integrity.k, variances)
        largest = _largest(body, T_site_machine, limits, integrity.k)
    levels += integrity.bias_m
    freeze(levels)
    return replace(clearances, protections=levels), largest + integrity.bias_m


@dataclass(frozen=True, slots=True, eq=False)
class _Body:
    """The machine at one posture, in its own frame, and how its solids turn.

    Attributes:
        poses: (S, 4, 4), halves: (S, 3), the solids' boxes.
        arms: (S, n) how far a joint's unit error moves a point of the solid at most, reach: (S,) the rotation's.
        turns: (L,) sigma of all that turns a link, own_turn: of all joints together [rad]. slides: sigma of all
            sliding joints [m].
    """

    kin: Kinematics
    machine: MachineModel
    unsure: MachineUncertainty
    poses: Floats
    halves: Floats
    arms: Floats
    reach: Floats
    turns: Floats
    own_turn: float
    slide: float


def _body(kin: Kinematics, machine: MachineModel, unsure: MachineUncertainty) -> _Body:
    poses, halves = machine.solid_poses(kin)
    centres = poses[:, :3, 3]
    sizes = np.sqrt(np.vecdot(halves, halves))
    columns = machine.point_jacobians(kin, [solid.link for solid in machine.solids], centres)
    turning = ~machine.prismatic
    arms = np.sqrt((columns * columns).sum(axis=1)) + sizes[:, None] * turning
    for i, solid in enumerate(machine.solids):
        if solid.stretch is not None:
            arms[i, solid.stretch.joint] += 1.0
    reach = np.sqrt(np.vecdot(centres, centres)) + sizes
    variances = unsure.covariance.diagonal()
    pose, joints = float(variances[3:6].sum()), variances[6:] * turning
    if unsure.correlated:
        before = np.cumsum(np.sqrt(joints))
        own, turns = float(before[-1]), np.concatenate([[0.0], before]) + math.sqrt(pose)
    else:
        before = np.cumsum(joints)
        own, turns = math.sqrt(before[-1]), np.sqrt(np.concatenate([[0.0], before]) + pose)
    slide = float(np.sqrt(variances[6:][machine.prismatic]).sum())
    return _Body(kin, machine, unsure, poses, halves, arms, reach, turns, own, slide)


def _largest(body: _Body, T_site_machine: Floats, limits: LimitUncertainty, k: float) -> float:
    """Return a bound of all levels without bias [m]: traces for eigenvalues, largest lever arms for all."""
    sigmas = np.sqrt(body.unsure.covariance.diagonal())
    reach = float(body.reach.max())
    pose = math.hypot(*sigmas[:3].tolist()) + reach * math.hypot(*sigmas[3:6].tolist())
    joints = body.arms.max(axis=0) * sigmas[6:]
    moved = pose + float(joints.sum()) if body.unsure.correlated else math.hypot(pose, *joints.tolist())
    variance = limits.largest_variance + body.unsure.tool_sigma_m**2 + moved * moved
    turn, arm = float(body.turns[-1]), max(float(body.arms.max()), reach)
    if len(limits.places):
        own = np.sqrt(limits.covariances.diagonal(axis1=1, axis2=2))
        far = reach + np.sqrt(((limits.places - T_site_machine[:3, 3]) ** 2).sum(axis=1))
        own_turns = np.sqrt(np.vecdot(own[:, 3:], own[:, 3:]))
        shifts = np.sqrt(np.vecdot(own[:, :3], own[:, :3])) + far * own_turns
        variance += float((shifts * shifts).max())
        turn, arm = turn + float(own_turns.max()), max(arm, float(far.max()))
    return k * math.sqrt(variance) + float(_second_order(k, np.array([turn]), np.array([arm]), body.slide)[0])


def _levels(
    clearances: Clearances,
    rows: Floats,
    body: _Body,
    T_site_machine: Floats,
    limits: LimitUncertainty,
    k: float,
    variances: Floats,
) -> Floats:
    """Return the levels (c,) without bias; `variances` (c,) are those of no place and turn."""
    normals, n = clearances.normals, body.machine.n
    covariance = body.unsure.covariance
    outside = clearances.other_links < 0
    # gradient (c, 6 + n) of the closest point; away (c, 3, 6 + n): what a point off it by u has besides, u @ away
    crossing = _crossing(normals)
    turned = T_site_machine[:3, :3] @ body.kin.spatial_jacobian[3:]
    carried = _carried(n)
    between = carried.take(clearances.links, axis=0) - carried.take(clearances.other_links, axis=0)
    away = np.zeros((len(normals), 3, 6 + n))
    away[:, :, 3:6] = crossing * outside[:, None, None]
    np.multiply((crossing.reshape(-1, 3) @ turned).reshape(-1, 3, n), between[:, None], out=away[:, :, 6:])
    gradient = np.empty((len(normals), 6 + n))
    gradient[:, :3] = normals * outside[:, None]
    gradient[:, 3:6] = np.vecmat(clearances.points_machine - T_site_machine[:3, 3], away[:, :, 3:6])
    gradient[:, 6:] = rows
    _stretch(away, clearances, body, T_site_machine)

    weighed = gradient @ covariance
    variances = variances + np.vecdot(weighed, gradient)
    slopes = 2.0 * np.matvec(away, weighed)
    curves = (away.reshape(-1, 6 + n) @ covariance).reshape(away.shape) @ away.transpose(0, 2, 1)
    turns = np.where(outside, body.turns.take(clearances.links), body.own_turn)
    arms = np.maximum(body.arms.max(axis=1), body.reach).take(clearances.solids)
    if len(limits.places):
        turns, arms = _add_limits(clearances, limits, crossing, variances, slopes, curves, turns, arms)
    offsets = _corners(body, T_site_machine).take(clearances.solids, axis=0)
    offsets -= clearances.points_machine[:, None]
    levels = _worst_corner(k, offsets, normals, variances, slopes, curves)
    levels += _second_order(k, turns, arms, body.slide)
    return levels


def _worst_corner(
    k: float, offsets: Floats, normals: Floats, variances: Floats, slopes: Floats, curves: Floats
) -> Floats:
    """Return the largest `k sigma(u) - n . u` (c,) over u = 0 and offsets (c, 8, 3) of corners.

    `sigma(u)^2 = variance + slope . u + u . curve u`, with variances (c,), slopes (c, 3), curves (c, 3, 3).
    """
    bent = offsets @ curves
    bent += slopes[:, None]
    sigmas = np.vecdot(bent, offsets)
    sigmas += variances[:, None]
    np.sqrt(np.maximum(sigmas, 0.0, out=sigmas), out=sigmas)
    sigmas *= k
    sigmas -= np.maximum(np.matvec(offsets, normals), 0.0)
    found: Floats = np.maximum(k * np.sqrt(np.maximum(variances, 0.0)), sigmas.max(axis=1))
    return found


def _second_order(k: float, turns: Floats, arms: Floats, slide: float) -> Floats:
    """Return what turning by k sigma adds beyond first order (c,) [m], infinite where that is no small angle."""
    angles = k * turns
    found: Floats = np.where(angles <= LARGEST_TURN, 0.5 * angles * (angles * arms + 2.0 * k * slide), np.inf)
    return found


def _add_limits(
    clearances: Clearances,
    limits: LimitUncertainty,
    crossing: Floats,
    variances: Floats,
    slopes: Floats,
    curves: Floats,
    turns: Floats,
    arms: Floats,
) -> tuple[Floats, Floats]:
    """Add limits of uncertain pose to variances, slopes and curves in place; return turns and arms with theirs."""
    which = limits.poses.take(clearances.limits)
    rows = np.flatnonzero(which >= 0)
    which, crossing = which[rows], crossing[rows]
    covariances, levers = limits.covariances[which], clearances.points_limit[rows] - limits.places[which]
    gradient = np.concatenate([clearances.normals[rows], np.vecmat(levers, crossing)], axis=1)
    weighed = np.matvec(covariances, gradient)
    variances[rows] += np.vecdot(weighed, gradient)
    slopes[rows] += 2.0 * np.matvec(crossing, weighed[:, 3:])
    curves[rows] += crossing @ covariances[:, 3:, 3:] @ crossing.transpose(0, 2, 1)
    turns, arms = turns.copy(), arms.copy()
    turns[rows] += np.sqrt(covariances[:, 3:, 3:].trace(axis1=1, axis2=2))
    # turning both: about the machine's joints, and about the limit's place
    arms[rows] += np.sqrt(np.vecdot(levers, levers))
    return turns, arms


def _corners(body: _Body, T_site_machine: Floats) -> Floats:
    """Return the corners (S, 8, 3) of the solids in the site frame."""
    poses = T_site_machine @ body.poses
    corners: Floats = (CORNER_SIGNS * body.halves[:, None]) @ poses[:, :3, :3].transpose(0, 2, 1)
    corners += poses[:, None, :3, 3]
    return corners


def _stretch(away: Floats, clearances: Clearances, body: _Body, T_site_machine: Floats) -> None:
    """Add to `away` that points of a box that stretches take part in its joint's motion by their place along it."""
    for i, solid in enumerate(body.machine.solids):
        if solid.stretch is None:
            continue
        joint, axis, side = solid.stretch
        outwards = side * (T_site_machine[:3, :3] @ body.poses[i, :3, axis])
        on = np.flatnonzero(clearances.solids == i)
        share = outwards / (2.0 * body.halves[i, axis])
        away[on, :, 6 + joint] += (clearances.normals[on] @ outwards)[:, None] * share


def _crossing(normals: Floats) -> Floats:
    """Return the matrices (c, 3, 3) of `n x`: `u . (n x w) = u @ crossing @ w`."""
    found = np.zeros((len(normals), 3, 3))
    x, y, z = normals.T
    found[:, 0, 1], found[:, 0, 2] = -z, y
    found[:, 1, 0], found[:, 1, 2] = z, -x
    found[:, 2, 0], found[:, 2, 1] = -y, x
    return found


@functools.cache
def _carried(n: int) -> Floats:
    """Return (n + 2, n), one where a joint carries a link; the last row, of index -1, is the environment's."""
    found = np.tri(n + 2, n, -1)
    found[-1] = 0.0
    freeze(found)
    return found
