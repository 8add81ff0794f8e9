"""Pose of a machine on rails: the track says across, height and attitude, the receivers how far along.

The track's pose at a distance s is right but for small deviations d = (across, up, roll, pitch, yaw) in the track's
own axes, whose covariance F comes from the as-built tolerance, the flanges' play and the wheelbase. Antennas,
inclinometer and a moving base's heading measure s and d together; with residuals r = H (ds, d) + noise of covariance
V the estimate is the weighted one,

    A = H^T V^-1 H + diag(0, F^-1)     (ds, d) = A^-1 H^T V^-1 r     P = A^-1

linearised at the track, not at the receivers' own pose, so that a fix good to a metre turns nothing. **Never surer
than the track**: what is handed on is P with its block of d raised to F, which is P + (F - P_dd) there, never less
than P. So receivers move the estimate within the track's tolerance, but claim nothing beyond it: how a track lies
today against its alignment is no noise that averages away.

Whether the receivers fit the track at all is the other result: with d the estimate under the prior, d / sqrt(F - P)
is a unit Gaussian; and the weighted squares left over are chi-squared.
"""

import math
from dataclasses import dataclass

import numpy as np

from workgauge.machine.model import Kinematics, MachineModel
from workgauge.machine.positioning import RailSpec
from workgauge.positioning.antennas import (
    PlacedAntenna,
    PoseSolution,
    Tilt,
    antenna_arms,
    levelled,
    shared_covariance,
)
from workgauge.positioning.innovation import equivalent_sigmas
from workgauge.positioning.track import RailTrack
from workgauge.values.arrays import Floats, frozen
from workgauge.values.transforms import rotation, rotation_vector, skew

#: The track is linearised anew if the place found lies farther than this from where it was linearised [m].
RELINEARISE_M = 0.05
#: Half the length over which the track's turning is taken [m].
SLOPE_M = 0.05
#: A machine this far beyond the end of an alignment does not stand on it [m].
BEYOND_END_M = 1.0
_ROUNDS = 4
_TINY = 1e-14


@dataclass(frozen=True, slots=True)
class Misfit:
    """What the sensors alone say, less the track.

    Attributes:
        amount: [m] to the left of it or above it, [rad] of roll or pitch.
        sigmas: that over its own uncertainty and the track's together.
    """

    amount: float
    sigmas: float


@dataclass(frozen=True, slots=True, eq=False)
class RailSolution:
    """A pose on rails, and how well the receivers fit the track.

    Attributes:
        pose: with the covariance never below the track's.
        distance: along the alignment [m]. forward: whether the machine faces growing distances.
        curvature: of the track there, positive to the left [1/m].
        covariance: (6, 6) of (along, across, up, roll, pitch, yaw) in the track's axes, as handed on.
        posterior: (6, 6) of the same by the weights alone.
        across, above, roll, pitch: how receivers and inclinometer fit the track; `above` and `pitch` are None where
            the alignment has no heights of its own.
        misfit_sigmas: of all residuals together.
    """

    pose: PoseSolution
    distance: float
    forward: bool
    curvature: float
    covariance: Floats
    posterior: Floats
    across: Misfit
    above: Misfit | None
    roll: Misfit
    pitch: Misfit | None
    misfit_sigmas: float


@dataclass(frozen=True, slots=True, eq=False)
class Azimuth:
    """A moving base's azimuth counter-clockwise from grid east [rad], its sigma, and the baseline it belongs to.

    `arm` (3,) from master to rover in the machine frame, `arm_gain` (3, n) its change with the joints.
    """

    angle: float
    sigma: float
    arm: Floats
    arm_gain: Floats


def track_covariance(spec: RailSpec, base_m: float, curvature: float = 0.0) -> Floats:
    """Return F (5, 5) of (across, up, roll, pitch, yaw) [m, rad].

    Across: as built, play as a uniform distribution (variance play^2 / 3) and the arrow of the wheelbase's chord in a
    curve. Height: as built. Roll: cant over the rails' distance. Pitch: the same difference over the wheelbase. Yaw:
    both axles' play and what the track is out of line, over the wheelbase.
    """
    play = spec.flange_play_m**2 / 3.0
    arrow = spec.wheelbase_m**2 * curvature / 8.0
    as_built = spec.as_built_sigma_m**2
    return np.diag(
        [
            as_built + play + arrow * arrow,
            as_built,
            (spec.cant_sigma_m / base_m) ** 2,
            (spec.cant_sigma_m / spec.wheelbase_m) ** 2,
            (2.0 * play + as_built) / spec.wheelbase_m**2,
        ]
    )


def on_rails(
    machine: MachineModel,
    kin: Kinematics,
    track: RailTrack,
    spec: RailSpec,
    origin: Floats,
    antennas: tuple[PlacedAntenna, ...],
    azimuth: Azimuth | None,
    tilt: Tilt,
    joint_covariance: Floats,
    *,
    start: float,
    forward: bool,
    common_share: float = 0.0,
) -> RailSolution | None:
    """Return the pose on a track; None beyond its ends or where nothing says how high its rails are.

    Args:
        origin: (3,) absolute origin of the local site frame [m].
        antennas: measured places. azimuth: of a moving base, None without.
        start: distance along the track to begin at, within a few metres of the place [m].
        forward: which way the machine faces. common_share: correlation of the antennas' errors.
    """
    arms, arm_gains = antenna_arms(machine, kin, antennas)
    attitude = levelled(machine, kin, tilt)
    count, n = len(antennas), machine.n
    S = _noise(antennas, azimuth, tilt, joint_covariance, common_share)
    s = start
    for _ in range(_ROUNDS):
        if not -BEYOND_END_M <= s <= track.length + BEYOND_END_M:
            return None
        s = min(max(s, 0.0), track.length)
        T, along, curvature, cant_base = _linear(track, s, forward, origin)
        if not math.isfinite(T[2, 3]):
            return None
        R, t = T[:3, :3], T[:3, 3]
        G = np.zeros((6, 6))
        way = 1.0 if forward else -1.0
        G[:, 0] = along
        G[:3, 1], G[:3, 2] = way * R[:, 1], R[:, 2]
        G[3:, 3], G[3:, 4], G[3:, 5] = way * R[:, 0], way * R[:, 1], R[:, 2]
        rows = 3 * count + (azimuth is not None) + 2
        M, r, N = np.zeros((rows, 6)), np.zeros(rows), np.zeros((rows, len(S)))
        for i, antenna in enumerate(antennas):
            arm, block = R @ arms[i], slice(3 * i, 3 * i + 3)
            r[block] = antenna.position - t - arm
            M[block, :3], M[block, 3:] = np.eye(3), -skew(arm)
            N[block, block] = np.eye(3)
            N[block, -n:] = -R @ arm_gains[i]
        at = 3 * count
        if azimuth is not None:
            B = R @ azimuth.arm
            normal = np.array([-B[1], B[0], 0.0]) / (B[0] ** 2 + B[1] ** 2)
            r[at] = math.remainder(azimuth.angle - math.atan2(B[1], B[0]), 2.0 * math.pi)
            M[at, 3:] = [-B[2] * normal[1], B[2] * normal[0], 1.0]
            N[at, at] = 1.0
            N[at, -n:] = -normal @ R @ azimuth.arm_gain
            at += 1
        up = R @ (attitude.up_machine)
        r[at:] = up[:2]
        M[at, 4], M[at + 1, 3] = -1.0, 1.0
        N[at:, -n - 3 : -n] = (R @ attitude.up_gain)[:2]
        N[at:, -n:] = (R @ attitude.joint_gain)[:2]
        found = _weighted(M @ G, r, N, S, track_covariance(spec, cant_base, curvature))
        s_found = s + found.state[0]
        if abs(found.state[0]) < RELINEARISE_M:
            break
        s = s_found
    return _handed_on(found, G, T, s_found, forward, curvature, n, track.profiled)


@dataclass(frozen=True, slots=True, eq=False)
class _Weighted:
    """(ds, d), its covariance, the prior of d, the gain of the noise times its covariance, and what is left over."""

    state: Floats
    covariance: Floats
    prior: Floats
    noise_cross: Floats
    chi2: float
    degrees: int


def _weighted(H: Floats, r: Floats, N: Floats, S: Floats, prior: Floats) -> _Weighted:
    NS = N @ S
    V = NS @ N.T
    V[np.diag_indices_from(V)] += _TINY
    weighted = np.linalg.solve(V, np.column_stack([H, r]))
    HtV = weighted[:, :6].T
    A = HtV @ H
    A[range(1, 6), range(1, 6)] += 1.0 / np.diag(prior)
    P = np.linalg.inv(A)
    b = HtV @ r
    y = P @ b
    chi2 = max(0.0, float(r @ weighted[:, 6]) - float(y @ b))
    return _Weighted(y, 0.5 * (P + P.T), prior, P @ HtV @ NS, chi2, len(r) - 1)


def _handed_on(
    found: _Weighted, G: Floats, T: Floats, distance: float, forward: bool, curvature: float, n: int, profiled: bool
) -> RailSolution:
    P = np.array(found.covariance)
    P[1:, 1:] = found.prior
    xi = G @ found.state
    T_found = np.array(T)
    T_found[:3, 3] += xi[:3]
    T_found[:3, :3] = rotation(xi[3:]) @ T[:3, :3]
    covariance = G @ P @ G.T
    pose = PoseSolution(
        frozen(T_found), frozen(0.5 * (covariance + covariance.T)), frozen(G @ found.noise_cross[:, -n:])
    )
    return RailSolution(
        pose=pose,
        distance=distance,
        forward=forward,
        curvature=curvature,
        covariance=frozen(P),
        posterior=frozen(found.covariance),
        across=_misfit(found, 0),
        above=_misfit(found, 1) if profiled else None,
        roll=_misfit(found, 2),
        pitch=_misfit(found, 3) if profiled else None,
        misfit_sigmas=equivalent_sigmas(found.chi2, found.degrees),
    )


def _misfit(found: _Weighted, i: int) -> Misfit:
    """Return what the measurements say of the track's axis i (across, up, roll, pitch), its prior taken out."""
    moved, prior = float(found.state[1 + i]), float(found.prior[i, i])
    spread = prior - float(found.covariance[1 + i, 1 + i])
    return Misfit(moved * prior / spread, abs(moved) / math.sqrt(spread)) if spread > 0.0 else Misfit(0.0, 0.0)


def _linear(track: RailTrack, s: float, forward: bool, origin: Floats) -> tuple[Floats, Floats, float, float]:
    """Return the pose at s in the site frame, its change (6,) per metre, the curvature, and the rails' distance."""
    first, last = max(s - SLOPE_M, 0.0), min(s + SLOPE_M, track.length)
    poses, curvature, _ = track.poses(np.array([s, first, last]), forward)
    run = last - first
    along = np.empty(6)
    along[:3] = (poses[2, :3, 3] - poses[1, :3, 3]) / run
    along[3:] = rotation_vector(poses[2, :3, :3] @ poses[1, :3, :3].T) / run
    T = poses[0]
    T[:3, 3] -= origin
    return T, along, float(curvature[0]), track.rotation.base


def _noise(
    antennas: tuple[PlacedAntenna, ...],
    azimuth: Azimuth | None,
    tilt: Tilt,
    joint_covariance: Floats,
    common_share: float,
) -> Floats:
    """Return the covariance of (places, azimuth, up of the tilt's link, joints)."""
    n = len(joint_covariance)
    places = 3 * len(antennas)
    size = places + (azimuth is not None) + 3 + n
    S = np.zeros((size, size))
    for i, antenna in enumerate(antennas):
        S[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = antenna.covariance
    if common_share and len(antennas) == 2:
        shared = common_share * shared_covariance(antennas[0].covariance, antennas[1].covariance)
        S[:3, 3:6], S[3:6, :3] = shared, shared.T
    if azimuth is not None:
        S[places, places] = azimuth.sigma**2
    S[-n - 3 : -n, -n - 3 : -n] = tilt.covariance
    S[-n:, -n:] = joint_covariance
    if tilt.joint_cross is not None:
        S[-n - 3 : -n, -n:] = tilt.joint_cross
        S[-n:, -n - 3 : -n] = tilt.joint_cross.T
    return S
