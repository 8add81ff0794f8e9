"""Velocity of the undercarriage from an antenna's, and its yaw rate from a gyro, where these are surer."""

import math
from dataclasses import replace

import numpy as np

from workgauge.geodesy.crs import ProjectedCrs
from workgauge.machine.model import Kinematics, MachineModel
from workgauge.positioning.memory import PostureMemory, Solved
from workgauge.positioning.motion import Motion
from workgauge.values.arrays import Floats
from workgauge.values.navigation import AngularRate, GnssVelocity
from workgauge.values.transforms import skew

#: 1-sigma of what states none: a receiver's velocity [m/s], a gyro's rate [rad/s].
VELOCITY_SIGMA, GYRO_SIGMA = 0.05, 0.01
#: A gyro's reading this far from the epoch does not count [ns].
GYRO_NS = 100_000_000


def gyro_rate(
    machine: MachineModel,
    kin: Kinematics,
    posture: PostureMemory,
    solved: Solved,
    gyro: AngularRate | None,
    motion: Motion,
) -> Motion:
    """Return the motion with the yaw rate of a gyro on some link, less what the joints turn that link, if surer.

    Args:
        kin: at the epoch.
    """
    if gyro is None or abs(gyro.stamp.monotonic_ns - solved.valid_ns) > GYRO_NS:
        return motion
    own = gyro.sigma if gyro.sigma > 0.0 else GYRO_SIGMA
    if not own < motion.yaw_sigma:
        return motion
    name = gyro.stamp.source.rpartition("/")[2]
    sensor = next((one for one in machine.sensors if one.name == name), None)
    if sensor is None or not np.isfinite(gyro.rate).all():
        return motion
    R = kin.T_machine_links[sensor.link, :3, :3] @ sensor.T_link_sensor[:3, :3]
    up = solved.T[2, :3]
    turning = up @ kin.spatial_jacobian[3:, : sensor.link]
    rates, sigmas = _rates(posture, sensor.link)
    rate = float(up @ (R @ gyro.rate) - turning @ rates)
    sigma = math.hypot(own, float(np.linalg.norm(turning * sigmas)))
    return replace(motion, yaw_rate=rate, yaw_sigma=sigma) if sigma < motion.yaw_sigma else motion


def antenna_velocity(
    machine: MachineModel,
    kin: Kinematics,
    posture: PostureMemory,
    solved: Solved,
    given: GnssVelocity | None,
    crs: ProjectedCrs,
    antenna: str,
    motion: Motion,
) -> Motion:
    """Return the motion with the undercarriage's velocity by an antenna's, if that is surer.

    `v = v_antenna - w x R a - R J_a dq/dt`: what turning and swinging do to the antenna is not travel. The course is
    turned from true to grid north.
    """
    if given is None or not math.isfinite(given.speed_m_s) or not math.isfinite(given.course + 0.0):
        return motion
    own = given.sigma_m_s if given.sigma_m_s > 0.0 else VELOCITY_SIGMA
    if not own < motion.sigma:
        return motion
    sensor = next(one for one in machine.sensors if one.name == antenna)
    R, T = solved.T[:3, :3], kin.T_machine_links[sensor.link]
    arm = T[:3, :3] @ sensor.T_link_sensor[:3, 3] + T[:3, 3]
    moving = kin.spatial_jacobian[:, : sensor.link]
    jacobian = R @ (moving[:3] - skew(arm) @ moving[3:])
    rates, sigmas = _rates(posture, sensor.link)
    lever = math.hypot(arm[0], arm[1]) * motion.yaw_sigma
    sigma = math.sqrt(own**2 + lever**2 + float(np.square(jacobian * sigmas).sum()))
    if not sigma < motion.sigma:
        return motion
    place = solved.fixes.antennas[0].position
    course = given.course - float(crs.convergence(place[0], place[1]))
    climb = given.climb_m_s if math.isfinite(given.climb_m_s) else motion.velocity[2]
    measured = np.array([given.speed_m_s * math.sin(course), given.speed_m_s * math.cos(course), climb])
    turned = motion.yaw_rate * (R @ arm)
    swept = np.array([-turned[1], turned[0], 0.0])
    x, y, z = (measured - swept - jacobian @ rates).tolist()
    if not math.isfinite(given.climb_m_s):
        z = motion.velocity[2]
    return replace(motion, velocity=(x, y, z), sigma=sigma, over_s=math.inf)


def _rates(posture: PostureMemory, count: int) -> tuple[Floats, Floats]:
    """Return rates and their sigmas of the first `count` joints."""
    rates = np.array(posture.rates[:count] or (0.0,) * count)
    if posture.covariance is None or posture.over_s == math.inf:
        return rates, np.full(count, 1.0)
    sigmas: Floats = np.sqrt(2.0 * posture.covariance.diagonal()[:count]) / posture.over_s
    return rates, sigmas + 0.1 * np.abs(rates)
