"""Which rows of the tool's motion count: position, and as much of the orientation as the machine or the goal asks.

Errors are goal minus present, in the machine frame [m, rad].
"""

import functools
import math
from dataclasses import dataclass

import numpy as np

from workgauge.machine.model import Kinematics, MachineModel
from workgauge.values.arrays import Floats, freeze, frozen
from workgauge.values.tasks import Orientation
from workgauge.values.transforms import rotation_vector

#: Task rows of each orientation, the three of the position included.
ROWS = {Orientation.FULL: 6, Orientation.PITCH: 4, Orientation.FREE: 3}
_SAMPLES = 32
_SEED = 20
_RANK = 1e-6  # singular values below this share of the largest count as zero
_SAME = 1e-9
_IN_PLANE = 0.3  # a direction of the tool that keeps this much of its length in the arm's plane can be measured there


@dataclass(frozen=True, slots=True, eq=False)
class ArmPlane:
    """How a tool pose's angle in the arm's vertical plane is measured on one machine.

    Attributes:
        axis: (3,) the direction whose elevation is measured, in the tool frame.
        normal: (3,) the plane's normal in the tool frame, where everything the swing carries turns about it; None
            where a tiltrotator turns the tool out of the plane.
        centre: (2,) where the swing axis stands, x and y in the machine frame [m].
    """

    axis: Floats
    normal: Floats | None
    centre: Floats


def sample_postures(machine: MachineModel) -> Floats:
    """Return the postures (k, n) at which a machine's general abilities are judged: seeded, always the same."""
    shares = np.random.default_rng(_SEED).uniform(size=(_SAMPLES, machine.n))
    postures: Floats = machine.sample_min + shares * (machine.sample_max - machine.sample_min)
    return postures


@functools.lru_cache(maxsize=32)
def orientation_of(machine: MachineModel) -> Orientation:
    """Return the most of an orientation that the machine can hold in general while its tool goes where it must.

    FULL if the tool Jacobian has rank 6, PITCH if position and the angle in the arm's plane are free of each other,
    else FREE; found from the ranks at a few sample postures.
    """
    kins = [machine.forward(q) for q in sample_postures(machine)]
    for orientation in (Orientation.FULL, Orientation.PITCH):
        if max(_rank(task_jacobian(kin, machine, orientation)) for kin in kins) == ROWS[orientation]:
            return orientation
    return Orientation.FREE


@functools.lru_cache(maxsize=32)
def arm_plane(machine: MachineModel) -> ArmPlane:
    """Return how the angle in the arm's vertical plane is measured on this machine.

    The plane's normal is the axis of the first joint that is level in every posture. Where it stands still in the
    tool frame, the plane belongs to the tool's orientation, and the angle is the sum of the planar joints'. Elsewhere
    the plane is the one through swing axis and tool. The direction measured is the tool's z, or else x or y, the
    first that never turns far out of the plane.
    """
    kins = [machine.forward(q) for q in sample_postures(machine)]
    poses = np.array([machine.tool_pose(kin) for kin in kins])
    centre, outwards = _swing_axis(kins), np.zeros(3)
    spread = poses[:, :2, 3] - centre
    level = [j for j in range(machine.n) if not machine.prismatic[j] and _level(kins, j)]
    normals = np.array([kin.spatial_jacobian[3:, level[0]] if level else outwards for kin in kins])
    normal: Floats | None = None
    if level:
        in_tool = np.einsum("kij,ki->kj", poses[:, :3, :3], normals)
        if float(np.ptp(in_tool, axis=0).max()) < _SAME:
            sign = 1.0 if float(np.sum(spread[:, 1] * normals[:, 0] - spread[:, 0] * normals[:, 1])) >= 0.0 else -1.0
            normal = frozen(sign * in_tool[0] / np.linalg.norm(in_tool[0]))
    out_of_plane = np.abs(np.einsum("kij,ki->kj", poses[:, :3, :3], normals)).max(axis=0)
    kept = np.sqrt(np.maximum(1.0 - out_of_plane**2, 0.0))[[2, 0, 1]]
    best = int(np.argmax(kept > _IN_PLANE)) if bool((kept > _IN_PLANE).any()) else int(np.argmax(kept))
    return ArmPlane(frozen(np.eye(3)[(2, 0, 1)[best]]), normal, frozen(centre))


def elevation(T_machine_tool: Floats, plane: ArmPlane) -> tuple[float, Floats]:
    """Return the tool's angle in the arm's vertical plane [rad] and its row (6,) for a twist [m/s, rad/s].

    `theta = atan2(a_z, a . e)` with a the measured direction and e the level direction outwards in the plane:
    positive upwards, in (-pi, pi], smooth as long as the direction has a part in the plane. A function of the pose
    alone, so that goal and present are measured alike; the row is its derivative along linear and angular velocity.
    """
    R = T_machine_tool[:3, :3]
    ax, ay, az = (R @ plane.axis).tolist()
    # e, not yet of length 1, and the row of how fast the plane turns about the vertical
    if plane.normal is not None:
        nx, ny, nz = (R @ plane.normal).tolist()
        ex, ey = -ny, nx
        squared = max(ex * ex + ey * ey, 1e-18)
        turning = (0.0, 0.0, 0.0, -nz * ey / squared, nz * ex / squared, 1.0)  # n x (z x n)
    else:
        ex, ey = (T_machine_tool[:2, 3] - plane.centre).tolist()
        squared = max(ex * ex + ey * ey, 1e-18)
        turning = (-ey / squared, ex / squared, 0.0, 0.0, 0.0, 0.0)
    length = math.sqrt(squared)
    ex, ey = ex / length, ey / length
    out, across = ax * ex + ay * ey, ay * ex - ax * ey
    whole = max(az * az + out * out, 1e-18)
    share = -az * across / whole
    row = np.array(turning) * share
    row[3] += (out * ay + az * az * ey) / whole  # a x z, a x e
    row[4] += (-out * ax - az * az * ex) / whole
    row[5] += az * across / whole
    return math.atan2(az, out), row


def task_error(kin: Kinematics, machine: MachineModel, T_machine_goal: Floats, orientation: Orientation) -> Floats:
    """Return goal minus present (m,), m of `ROWS`, machine frame: position [m], then the orientation's part [rad].

    FULL is the rotation vector from the present orientation to the goal's; PITCH the difference of the two angles in
    the arm's plane, in [-pi, pi]; see `elevation`.
    """
    T = machine.tool_pose(kin)
    error = np.empty(ROWS[orientation])
    error[:3] = T_machine_goal[:3, 3] - T[:3, 3]
    if orientation is Orientation.FULL:
        error[3:] = rotation_vector(T_machine_goal[:3, :3] @ T[:3, :3].T)
    elif orientation is Orientation.PITCH:
        plane = arm_plane(machine)
        error[3] = math.remainder(elevation(T_machine_goal, plane)[0] - elevation(T, plane)[0], 2.0 * math.pi)
    freeze(error)
    return error


def task_jacobian(kin: Kinematics, machine: MachineModel, orientation: Orientation) -> Floats:
    """Return the task's Jacobian (m, n), m of `ROWS`: how the task's present values change with the joints."""
    J = machine.tool_jacobian(kin)
    if orientation is Orientation.FREE:
        J = J[:3]
    elif orientation is Orientation.PITCH:
        row = elevation(machine.tool_pose(kin), arm_plane(machine))[1]
        J = np.vstack((J[:3], row @ J))
    freeze(J)
    return J


def _rank(J: Floats) -> int:
    sigma = np.linalg.svd(J, compute_uv=False)
    return int(np.sum(sigma > _RANK * max(float(sigma[0]), 1e-12)))


def _level(kins: list[Kinematics], joint: int) -> bool:
    return all(abs(float(kin.spatial_jacobian[5, joint])) < _SAME for kin in kins)


def _swing_axis(kins: list[Kinematics]) -> Floats:
    """Return where the first joint's axis stands in plan (2,), the origin if it is not vertical."""
    vx, vy, _, wx, wy, wz = kins[0].spatial_jacobian[:, 0].tolist()
    if abs(wx) + abs(wy) > _SAME or abs(wz) < 0.5:
        return np.zeros(2)
    return np.array([-vy / wz, vx / wz])
