"""The start-of-shift check: the tool is put on a known point, and the program says where it believes the tool is.

It tests everything at once that lies between satellites and tool tip: corrections, projection, height, antennas,
heading, link sensors, the attachment. It passes when the difference is within the machine file's tolerance, when the
program itself was sure enough for that to mean anything, and when the difference is not larger than its own
uncertainty admits: a position that is 5 sigma off its own word is wrong somewhere, even if only by centimetres.
"""

import hashlib
import math
from dataclasses import dataclass, replace

import numpy as np

from workgauge.machine.model import Kinematics, MachineModel
from workgauge.machine.positioning import Thresholds
from workgauge.positioning.innovation import sigmas
from workgauge.values.arrays import Floats, frozen
from workgauge.values.health import HealthState, PositionHealth
from workgauge.values.reasons import Reason, ReasonCode

#: A position whose 1-sigma is more than so many tolerances can agree by chance only: that is no check.
SURE = 2.0

#: How far a check may be stamped ahead of the clock that reads it [s].
AHEAD_S = 60.0


@dataclass(frozen=True, slots=True, eq=False)
class BelievedTool:
    """Where the program believes the tool centre point: position (3,) [m] and covariance (3, 3) [m^2] in the site."""

    position: Floats
    covariance: Floats
    heading: float  #: of the machine, clockwise from grid north [rad]


@dataclass(frozen=True, slots=True)
class CheckResult:
    """One check, as it is logged; every length in metres, absolute coordinates.

    Attributes:
        utc_ns: when, on the wall clock. machine, attachment, fingerprint: whose, see `fingerprint`.
        point_name: of the known point, empty if it was given by numbers. point, tool: east, north, height.
        along, left, up: tool less point, along the machine's heading, to its left, upwards.
        distance: length of that. sigma: 1-sigma of it in its worst direction, point and touch included.
        sigmas: the difference in units of its uncertainty. tolerance: allowed.
        passed: whether the machine may work. why: each cause of a refusal, empty if it passed.
    """

    utc_ns: int
    machine: str
    attachment: str
    fingerprint: str
    point_name: str
    point: tuple[float, float, float]
    tool: tuple[float, float, float]
    along: float
    left: float
    up: float
    distance: float
    sigma: float
    sigmas: float
    tolerance: float
    passed: bool
    why: tuple[str, ...]


def tool_in_site(
    machine: MachineModel,
    kin: Kinematics,
    T_site_machine: Floats,
    pose_covariance: Floats,
    joint_covariance: Floats,
    cross: Floats | None = None,
) -> BelievedTool:
    """Return where the tool is believed, to first order: `d + phi x (R p) + R J dq`, and the attachment's tolerance.

    Args:
        T_site_machine: (4, 4). pose_covariance: (6, 6) of (translation d, rotation vector phi), site frame.
        joint_covariance: (n, n) of dq. cross: (6, n) between the two, None for none.
    """
    R = T_site_machine[:3, :3]
    point = machine.tool_pose(kin)[:3, 3]
    arm = R @ point
    G = np.zeros((3, 6 + machine.n))
    G[:, :3] = np.eye(3)
    G[:, 3:6] = [[0.0, arm[2], -arm[1]], [-arm[2], 0.0, arm[0]], [arm[1], -arm[0], 0.0]]
    G[:, 6:] = R @ machine.tool_jacobian(kin)[:3]
    S = np.zeros((6 + machine.n, 6 + machine.n))
    S[:6, :6], S[6:, 6:] = pose_covariance, joint_covariance
    if cross is not None:
        S[:6, 6:], S[6:, :6] = cross, cross.T
    covariance = G @ S @ G.T + machine.tool_tolerance_m**2 * np.eye(3)
    heading = (math.pi / 2 - math.atan2(R[1, 0], R[0, 0])) % (2.0 * math.pi)
    return BelievedTool(frozen(arm + T_site_machine[:3, 3]), frozen(covariance), heading)


def check_against(
    point: Floats,
    believed: BelievedTool,
    machine: MachineModel,
    thresholds: Thresholds,
    *,
    utc_ns: int,
    point_name: str = "",
    point_sigma_m: float = 0.0,
    health: PositionHealth | None = None,
) -> CheckResult:
    """Compare the believed tool with a known point.

    Args:
        point: (3,) east, north, height, in the frame of `believed.position`.
        point_sigma_m: 1-sigma of the point's coordinates and of how exactly the tool is on it, each direction.
        health: of the position, None if nobody judges it.
    """
    difference = believed.position - np.asarray(point, dtype=np.float64)
    covariance = believed.covariance + point_sigma_m**2 * np.eye(3)
    s, c = math.sin(believed.heading), math.cos(believed.heading)
    distance = float(np.linalg.norm(difference))
    sigma = math.sqrt(max(0.0, float(np.linalg.eigvalsh(covariance)[-1])))
    off = sigmas(difference, covariance)
    why = _refused(distance, sigma, off, thresholds, health)
    e, n, h = (float(value) for value in point)
    te, tn, th = (float(value) for value in believed.position)
    return CheckResult(
        utc_ns=utc_ns,
        machine=machine.name,
        attachment=machine.attachment,
        fingerprint=fingerprint(machine),
        point_name=point_name,
        point=(e, n, h),
        tool=(te, tn, th),
        along=float(s * difference[0] + c * difference[1]),
        left=float(-c * difference[0] + s * difference[1]),
        up=float(difference[2]),
        distance=distance,
        sigma=sigma,
        sigmas=off,
        tolerance=thresholds.check_tolerance_m,
        passed=not why,
        why=why,
    )


def _refused(
    distance: float, sigma: float, off: float, limits: Thresholds, health: PositionHealth | None
) -> tuple[str, ...]:
    """Return every cause for which a check does not pass."""
    why = []
    tolerance = limits.check_tolerance_m
    if not distance <= tolerance:
        why.append(f"tool is {_mm(distance)} from the point (tolerance {_mm(tolerance)})")
    if not sigma <= SURE * tolerance:
        surest = _mm(SURE * tolerance)
        why.append(f"position is sure to {_mm(sigma)} only (1 sigma, limit {surest}): wait for a better fix")
    if not off <= limits.innovation_sigmas:
        why.append(
            f"tool is {off:.1f} sigma from the point (limit {limits.innovation_sigmas:g}): "
            "the position is not as sure as it says"
        )
    if health is not None and health.state not in (HealthState.FIXED, HealthState.FLOAT):
        first = f": {health.reasons[0].text}" if health.reasons else ""
        why.append(f"there is no fix, position is in {health.state.value.replace('_', ' ')}{first}")
    return tuple(why)


def _mm(metres: float) -> str:
    return f"{1e3 * metres:.0f} mm" if metres < 10.0 else f"{metres:.0f} m"


def shifted(result: CheckResult, origin: Floats) -> CheckResult:
    """Return the same check with its coordinates moved by `origin` (3,): from a local frame to absolute ones."""
    e, n, h = (float(value) for value in origin)
    point = (result.point[0] + e, result.point[1] + n, result.point[2] + h)
    tool = (result.tool[0] + e, result.tool[1] + n, result.tool[2] + h)
    return replace(result, point=point, tool=tool)


def fingerprint(machine: MachineModel) -> str:
    """Return 16 hexadecimal digits that change with anything a check has tested.

    The attachment's tool, the joints' geometry, the places of sensors and how they are read; not thresholds, boxes or
    speeds. Lengths and angles count to a nanometre (nanoradian), so that it is the same on any computer.
    """
    digest = hashlib.sha256(f"{machine.name}\n{machine.attachment}\n".encode())
    arrays = [machine.T_link_tool, *(sensor.T_link_sensor for sensor in machine.sensors)]
    for joint in machine.chain:
        arrays += [joint.T_parent_joint, joint.T_joint_link, joint.axis]
    for array in arrays:
        digest.update(" ".join(f"{round(float(value), 9) + 0.0:.9f}" for value in array.ravel()).encode())
    digest.update("\n".join(f"{one.name} {one.kind} {one.link}" for one in machine.sensors).encode())
    if machine.positioning is not None:
        digest.update(machine.positioning.model_dump_json(exclude={"thresholds", "integrity", "rails"}).encode())
    return digest.hexdigest()[:16]


def not_valid(result: CheckResult | None, machine: MachineModel, utc_ns: int, thresholds: Thresholds) -> str | None:
    """Return why the machine may not be armed on this check, or None if it may.

    Args:
        result: the newest check of this machine, None if there is none. utc_ns: the wall clock now.
    """
    if result is None:
        return f"no start-of-shift check of {machine.name}"
    if (result.machine, result.attachment) != (machine.name, machine.attachment):
        return (
            f"the check is of {result.machine} with {result.attachment}, "
            f"this is {machine.name} with {machine.attachment}"
        )
    if result.fingerprint != fingerprint(machine):
        return "the machine's file has changed since the check: its tool, joints or sensors are others now"
    if not result.passed:
        return f"the check failed: {'; '.join(result.why) or 'no reason given'}"
    age_s = (utc_ns - result.utc_ns) * 1e-9
    if age_s < -AHEAD_S:
        return f"the check is stamped {-age_s / 3600:.1f} h ahead of the clock (limit {AHEAD_S / 3600:.2f} h)"
    if age_s > thresholds.check_hours * 3600.0:
        return f"the check is {age_s / 3600:.1f} h old (limit {thresholds.check_hours:g} h)"
    if not result.distance <= thresholds.check_tolerance_m:
        now = _mm(thresholds.check_tolerance_m)
        return f"the check was {_mm(result.distance)} off, which today's tolerance does not allow ({now})"
    return None


def withheld(health: PositionHealth | None, why: str, now_ns: int) -> PositionHealth:
    """Return a position's health with the machine stopped for want of a valid check."""
    reason = Reason(ReasonCode.NOT_CHECKED, f"start-of-shift check: {why}")
    if health is None:
        return PositionHealth(HealthState.STOP, now_ns, (reason,))
    since_ns = health.since_ns if health.state is HealthState.STOP else now_ns
    return PositionHealth(HealthState.STOP, since_ns, (reason, *health.reasons))
