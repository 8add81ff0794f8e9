"""Protection level of each clearance: how much of the believed distance may not be there.

`k sigma + bias` along the clearance's own direction, sigma^2 = g^T S g: S the covariance of the machine's pose and
joints, g what each of them does to the distance; k from a stated integrity risk.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from workgauge.machine.model import Kinematics, MachineModel
from workgauge.machine.positioning import IntegritySpec
from workgauge.proximity.levels import own_variances, protection_levels, sure_levels
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
    if unsure.exact and not (limits.largest_variance or unsure.tool_sigma_m or len(limits.places)):
        levels = np.full(len(clearances), integrity.bias_m)
        freeze(levels)
        return clearances.with_protections(levels), integrity.bias_m
    own = (
        *(limits.variances, clearances.limits, clearances.links, clearances.other_links),
        *(machine.tool_link, unsure.tool_sigma_m**2),
    )
    if unsure.exact and not len(limits.places):
        levels = sure_levels(*own, float(integrity.k), float(integrity.bias_m))
        largest = integrity.k * math.sqrt(limits.largest_variance + unsure.tool_sigma_m**2)
    else:
        body = _body(kin, machine, unsure)
        levels = _levels(clearances, rows, body, T_site_machine, limits, integrity.k, own_variances(*own))
        levels += integrity.bias_m
        largest = _largest(body, T_site_machine, limits, integrity.k)
    freeze(levels)
    return clearances.with_protections(levels), largest + integrity.bias_m


@dataclass(frozen=True, slots=True, eq=False)
class _Body:
    """The machine at one posture, in its own frame, and how far it turns.

    Attributes:
        poses: (S, 4, 4), halves: (S, 3), the solids' boxes.
        reach: no point is farther from the origin [m]. arms: (n), nor moved farther by a joint's unit error.
        turns: (L,) sigma of all that turns a link, own_turn: of all joints together [rad]. slide: of all sliding
            joints [m].
    """

    kin: Kinematics
    machine: MachineModel
    unsure: MachineUncertainty
    poses: Floats
    halves: Floats
    reach: float
    arms: list[float]
    turns: Floats
    own_turn: float
    slide: float


def _body(kin: Kinematics, machine: MachineModel, unsure: MachineUncertainty) -> _Body:
    poses, halves = machine.solid_poses(kin)
    sizes, centres = np.vecdot(halves, halves).tolist(), poses[:, :3, 3]
    away = np.vecdot(centres, centres).tolist()
    reach = max(math.sqrt(r) + math.sqrt(size) for r, size in zip(away, sizes, strict=True))
    # |Jv + Jw x p| of a turning joint; twice 1 for a sliding one, which may both carry a box and stretch it
    squares = np.square(kin.spatial_jacobian[:3]).sum(axis=0).tolist()
    sliding = machine.prismatic.tolist()
    arms = [2.0 if slides else math.sqrt(v) + reach for v, slides in zip(squares, sliding, strict=True)]
    turns, own_turn, slide = link_turns(unsure, sliding)
    return _Body(kin, machine, unsure, poses, halves, reach, arms, turns, own_turn, slide)


def link_turns(unsure: MachineUncertainty, sliding: Sequence[bool]) -> tuple[Floats, float, float]:
    """Return sigma of all that turns each link (n + 1,), of all joints together [rad], of all sliding joints [m]."""
    variances = unsure.covariance.diagonal().tolist()
    pose = variances[3] + variances[4] + variances[5]
    turning, slide, turns, root = 0.0, 0.0, [math.sqrt(pose)], math.sqrt(pose)
    for variance, slides in zip(variances[6:], sliding, strict=True):
        if slides:
            slide += math.sqrt(variance)
        else:
            turning += math.sqrt(variance) if unsure.correlated else variance
        turns.append(root + turning if unsure.correlated else math.sqrt(pose + turning))
    return np.array(turns), turning if unsure.correlated else math.sqrt(turning), slide


def _largest(body: _Body, T_site_machine: Floats, limits: LimitUncertainty, k: float) -> float:
    """Return a bound of all levels without bias [m]: traces for eigenvalues, largest lever arms for all."""
    sigmas = [math.sqrt(variance) for variance in body.unsure.covariance.diagonal().tolist()]
    pose = math.hypot(*sigmas[:3]) + body.reach * math.hypot(*sigmas[3:6])
    joints = [arm * sigma for arm, sigma in zip(body.arms, sigmas[6:], strict=True)]
    moved = pose + sum(joints) if body.unsure.correlated else math.hypot(pose, *joints)
    variance = limits.largest_variance + body.unsure.tool_sigma_m**2 + moved * moved
    turn, arm = float(body.turns[-1]), max(*body.arms, body.reach)
    if len(limits.places):
        own = np.sqrt(limits.covariances.diagonal(axis1=1, axis2=2))
        far = body.reach + np.sqrt(((limits.places - T_site_machine[:3, 3]) ** 2).sum(axis=1))
        own_turns = np.sqrt(np.vecdot(own[:, 3:], own[:, 3:]))
        shifts = np.sqrt(np.vecdot(own[:, :3], own[:, :3])) + far * own_turns
        variance += float((shifts * shifts).max())
        turn, arm = turn + float(own_turns.max()), arm + float(far.max())
    return k * math.sqrt(variance) + float(second_order(k, np.array([turn]), arm, body.slide)[0])


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
    levels: Floats = protection_levels(
        np.array(T_site_machine, dtype=np.float64, order="C"),
        body.kin.spatial_jacobian,
        (body.poses, body.halves, body.machine.stretches),
        (
            *(clearances.normals, clearances.points_machine, clearances.points_limit),
            *(clearances.links, clearances.other_links, clearances.limits, clearances.solids),
        ),
        rows,
        body.unsure.covariance,
        (body.turns, body.own_turn, float(max(*body.arms, body.reach)), float(body.slide)),
        (limits.poses, limits.places, limits.covariances),
        *(float(k), variances, LARGEST_TURN),
    )
    return levels


def second_order(k: float, turns: Floats, arm: float | Floats, slide: float) -> Floats:
    """Return what turning by k sigma adds beyond first order (c,) [m], infinite where that is no small angle."""
    angles = k * turns
    found: Floats = 0.5 * angles * (angles * arm + 2.0 * k * slide)
    found[~(angles <= LARGEST_TURN)] = np.inf
    return found
