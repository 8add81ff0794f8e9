"""Pose of the undercarriage from antennas and an inclinometer, each on its link, with the covariance of the errors.

Makkonen's and Mäkinen's setting: two satellite antennas and an inclinometer give `T_site_machine`. Unknown are the
rotation R and the origin t of the machine frame. With the machine's joints q, antenna i sits at `a_i(q)` and the
upward direction is `u(q)` in the machine frame, and

    R u = (0, 0, 1),    azimuth(R (a_2 - a_1)) = azimuth(p_2 - p_1),    t = sum of W_i (p_i - R a_i)

for measured places p_i. The first two fix R: level the machine by the inclinometer, then turn it about the vertical.
With a moving base, its heading takes the place of the second antenna. The weights W_i are those of the antennas'
own covariances.

Covariance to first order. The true pose is `R_true = Exp(phi) R`, `t_true = t + delta`. With errors `e_i` of the
places, `du` of u and `da_i` of the arms (measured less true, both with the joints' part), B = R (a_2 - a_1), db =
da_2 - da_1 and n = (-B_y, B_x, 0) / |B_plan|^2:

    phi_x = -(R du)_y        phi_y = (R du)_x
    phi_z = n . (R db - e_2 + e_1) + B_z (n_y phi_x - n_x phi_y)
    delta = sum of W_i (R da_i - e_i - phi x R a_i)
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from workgauge.machine.model import Kinematics, MachineModel
from workgauge.positioning.attitude import level
from workgauge.values.arrays import Floats, frozen
from workgauge.values.transforms import rotation_z, skew

#: Antennas nearer to each other in plan than this give no heading [m].
SHORTEST_BASELINE_M = 0.1


class PoseSolution(NamedTuple):
    """A pose of the undercarriage and what is known of its error.

    Attributes:
        T_site_machine: (4, 4).
        covariance: (6, 6) of (translation, rotation vector), true less estimated, site frame [m, rad].
        cross: (6, n) covariance of that with the joints' error, true less measured: nonzero where the pose was found
            through the joints. A point carried by the cab owes nothing to an error of the swing angle.
    """

    T_site_machine: Floats
    covariance: Floats
    cross: Floats


@dataclass(frozen=True, slots=True, eq=False)
class PlacedAntenna:
    """An antenna on the machine, and where it was measured.

    Attributes:
        link: it sits on. position_link: (3,) in that link's frame [m].
        position: (3,) measured in the local site frame [m]. covariance: (3, 3) of that [m^2].
    """

    link: int
    position_link: Floats
    position: Floats
    covariance: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Tilt:
    """The upward direction as an inclinometer gives it.

    Attributes:
        link: it sits on. up_link: (3,) unit vector in that link's frame. covariance: (3, 3) of that.
        joint_cross: (3, n) covariance of its error with the joints', where the joints were found through it.
    """

    link: int
    up_link: Floats
    covariance: Floats
    joint_cross: Floats | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Levelled:
    """A machine levelled by its inclinometer.

    Attributes:
        turn: (3, 3), turns the machine's up into the vertical. up_machine: (3,) that up, in the machine frame.
        up_gain: (3, 3), error of the link's up into error of the machine's up.
        joint_gain: (3, n), error of the joints into error of the machine's up.
        tilt: what it came from.
    """

    turn: Floats
    up_machine: Floats
    up_gain: Floats
    joint_gain: Floats
    tilt: Tilt


def levelled(machine: MachineModel, kin: Kinematics, tilt: Tilt) -> Levelled:
    """Return the attitude without its heading."""
    R_machine_link = kin.T_machine_links[tilt.link, :3, :3]
    up = R_machine_link @ tilt.up_link
    up = up / math.sqrt(float(up @ up))
    joint_gain = np.zeros((3, machine.n))
    if tilt.link:
        joint_gain[:, : tilt.link] = -skew(up) @ kin.spatial_jacobian[3:, : tilt.link]
    return Levelled(level(up), up, R_machine_link, joint_gain, tilt)


def two_antenna_pose(
    machine: MachineModel,
    kin: Kinematics,
    master: PlacedAntenna,
    rover: PlacedAntenna,
    tilt: Tilt,
    joint_covariance: Floats,
    *,
    common_share: float = 0.0,
    cautious: bool = False,
) -> PoseSolution | None:
    """Return the pose by two antennas and an inclinometer; None where the baseline stands upright.

    Args:
        kin: of the joints as measured when the places were. joint_covariance: (n, n) of their errors.
        common_share: correlation of the two antennas' errors, 0 to 1: what they share does not average out and turns
            nothing. cautious: it is the largest that may be, not what is; then it averages nothing out, and yet the
            heading is taken as if they shared nothing.
    """
    arms, arm_gains = antenna_arms(machine, kin, (master, rover))
    attitude = levelled(machine, kin, tilt)
    arm = attitude.turn @ (arms[1] - arms[0])
    measured = rover.position - master.position
    if min(math.hypot(arm[0], arm[1]), math.hypot(measured[0], measured[1])) < SHORTEST_BASELINE_M:
        return None
    yaw = math.atan2(measured[1], measured[0]) - math.atan2(arm[1], arm[0])
    R = rotation_z(yaw)[:3, :3] @ attitude.turn
    B = R @ (arms[1] - arms[0])
    n = np.array([-B[1], B[0], 0.0]) / (B[0] ** 2 + B[1] ** 2)
    weights = _weights(master.covariance, rover.covariance)
    joints = machine.n
    gain = np.zeros((6, 9 + joints))  # of (e_1, e_2, du of the link, dq)
    _tilt_gain(gain, R, attitude, slice(6, 9), slice(9, None))
    gain[5] = B[2] * (n[1] * gain[3] - n[0] * gain[4])
    gain[5, :3] += n
    gain[5, 3:6] -= n
    gain[5, 9:] += n @ R @ (arm_gains[1] - arm_gains[0])
    t = np.zeros(3)
    for i, (antenna, W) in enumerate(zip((master, rover), weights, strict=True)):
        t += W @ (antenna.position - R @ arms[i])
        gain[:3, 3 * i : 3 * i + 3] -= W
        gain[:3, 9:] += W @ R @ arm_gains[i]
        gain[:3] += W @ skew(R @ arms[i]) @ gain[3:]
    S = np.zeros((9 + joints, 9 + joints))
    S[:3, :3], S[3:6, 3:6] = master.covariance, rover.covariance
    extra = None
    if common_share:
        shared = common_share * shared_covariance(master.covariance, rover.covariance)
        if cautious:
            extra = weights[0] @ shared @ weights[1].T
        else:
            S[:3, 3:6], S[3:6, :3] = shared, shared.T
    return _solution(R, t, gain, S, 6, tilt, joint_covariance, extra)


def moving_base_pose(
    machine: MachineModel,
    kin: Kinematics,
    antenna: PlacedAntenna,
    azimuth: float,
    azimuth_sigma: float,
    baseline_machine: tuple[Floats, Floats],
    tilt: Tilt,
    joint_covariance: Floats,
) -> PoseSolution | None:
    """Return the pose by one antenna, an inclinometer and a baseline's azimuth; None where the baseline is upright.

    Args:
        azimuth: of the baseline, counter-clockwise from grid east [rad]; azimuth_sigma: its 1-sigma [rad].
        baseline_machine: (3,) from master to rover in the machine frame now, and (3, n) its change with the joints:
            see `baseline`.
    """
    (arm_machine,), (arm_gain,) = antenna_arms(machine, kin, (antenna,))
    along, along_gain = baseline_machine
    attitude = levelled(machine, kin, tilt)
    arm = attitude.turn @ along
    if math.hypot(arm[0], arm[1]) < SHORTEST_BASELINE_M:
        return None
    R = rotation_z(azimuth - math.atan2(arm[1], arm[0]))[:3, :3] @ attitude.turn
    B = R @ along
    n = np.array([-B[1], B[0], 0.0]) / (B[0] ** 2 + B[1] ** 2)
    gain = np.zeros((6, 7 + machine.n))  # of (e, azimuth, du of the link, dq)
    _tilt_gain(gain, R, attitude, slice(4, 7), slice(7, None))
    gain[5] = B[2] * (n[1] * gain[3] - n[0] * gain[4])
    gain[5, 3] -= 1.0
    gain[5, 7:] += n @ R @ along_gain
    gain[:3, :3] = -np.eye(3)
    gain[:3, 7:] += R @ arm_gain
    gain[:3] += skew(R @ arm_machine) @ gain[3:]
    S = np.zeros((7 + machine.n, 7 + machine.n))
    S[:3, :3] = antenna.covariance
    S[3, 3] = azimuth_sigma**2
    return _solution(R, antenna.position - R @ arm_machine, gain, S, 4, tilt, joint_covariance)


def baseline(
    machine: MachineModel, kin: Kinematics, master: tuple[int, Floats], rover: tuple[int, Floats]
) -> tuple[Floats, Floats]:
    """Return the vector (3,) from master to rover in the machine frame and its change with the joints (3, n).

    Args:
        master, rover: link and place (3,) in that link's frame [m].
    """
    first, second = (PlacedAntenna(link, place, place, np.zeros((3, 3))) for link, place in (master, rover))
    arms, gains = antenna_arms(machine, kin, (first, second))
    return arms[1] - arms[0], gains[1] - gains[0]


def antenna_arms(
    machine: MachineModel, kin: Kinematics, antennas: tuple[PlacedAntenna, ...]
) -> tuple[list[Floats], list[Floats]]:
    """Return where antennas sit in the machine frame (3,), and how that changes with the joints (3, n)."""
    arms, gains = [], []
    for antenna in antennas:
        T = kin.T_machine_links[antenna.link]
        arm = T[:3, :3] @ antenna.position_link + T[:3, 3]
        jacobian = np.zeros((3, machine.n))
        moving = kin.spatial_jacobian[:, : antenna.link]
        jacobian[:, : antenna.link] = moving[:3] - skew(arm) @ moving[3:]
        arms.append(arm)
        gains.append(jacobian)
    return arms, gains


def _tilt_gain(gain: Floats, R: Floats, attitude: Levelled, up: slice, joints: slice) -> None:
    """Write the rows of the two level components of the rotation vector."""
    by_up, by_joints = R @ attitude.up_gain, R @ attitude.joint_gain
    gain[3, up], gain[3, joints] = -by_up[1], -by_joints[1]
    gain[4, up], gain[4, joints] = by_up[0], by_joints[0]


def _weights(first: Floats, second: Floats) -> tuple[Floats, Floats]:
    """Return the weights (3, 3) of two places, by their covariances; they add up to one."""
    total = first + second
    if not float(np.trace(total)) > 0.0:
        return 0.5 * np.eye(3), 0.5 * np.eye(3)
    one: Floats = np.asarray(np.linalg.solve(total, second), dtype=np.float64).T
    return one, np.eye(3) - one


def shared_covariance(first: Floats, second: Floats) -> Floats:
    """Return the covariance (3, 3) of one place's error with another's if they have all of it in common."""
    return _root(first) @ _root(second).T


def _root(covariance: Floats) -> Floats:
    """Return the symmetric root of a covariance (3, 3)."""
    if not covariance[0, 1] and not covariance[0, 2] and not covariance[1, 2]:
        return np.diag(np.sqrt(covariance.diagonal()))
    values, vectors = np.linalg.eigh(covariance)
    root: Floats = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    return root


def _solution(
    R: Floats,
    t: Floats,
    gain: Floats,
    S: Floats,
    up: int,
    tilt: Tilt,
    joint_covariance: Floats,
    extra: Floats | None = None,
) -> PoseSolution:
    """Return pose, covariance and cross-covariance from the errors' gain and covariance.

    Args:
        up: where du begins. extra: (3, 3), half of what is added to the covariance of the translation.
    """
    S[up : up + 3, up : up + 3] = tilt.covariance
    S[up + 3 :, up + 3 :] = joint_covariance
    if tilt.joint_cross is not None:
        S[up : up + 3, up + 3 :] = tilt.joint_cross
        S[up + 3 :, up : up + 3] = tilt.joint_cross.T
    gained = gain @ S
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    covariance = gained @ gain.T
    if extra is not None:
        covariance[:3, :3] += extra + extra.T
    return PoseSolution(frozen(T), frozen(0.5 * (covariance + covariance.T)), frozen(-gained[:, up + 3 :]))
