"""What an antenna's velocity and a gyro on the cab say of the undercarriage, whatever the cab does meanwhile."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.geodesy.crs import ProjectedCrs
from workgauge.machine.load import load_machine
from workgauge.positioning.memory import Bent, GridFix, GridFixes, PostureMemory, Solved
from workgauge.positioning.motion import Motion
from workgauge.positioning.rates import antenna_velocity, gyro_rate
from workgauge.values.arrays import Floats
from workgauge.values.measurements import Stamp
from workgauge.values.navigation import AngularRate, FixQuality, GnssVelocity
from workgauge.values.transforms import rotation

from .kit import random_pose, random_q

MACHINE = load_machine("rre20")
CRS = ProjectedCrs.from_epsg(3879)
E, N = 25_497_000.0, 6_673_000.0


def solved(T: Floats, q: Floats) -> Solved:
    fix = GridFix("r", "antenna right", None, np.array([E, N, 10.0]), np.eye(3) * 1e-4, FixQuality.FIXED)
    nothing = np.zeros((6, MACHINE.n))
    grid = GridFixes(0, (fix,), 0.0)
    return Solved(0, None, 0, FixQuality.FIXED, math.nan, T, np.eye(6) * 1e-4, nothing, q, grid)


def antenna_at(T: Floats, q: Floats) -> Floats:
    sensor = next(one for one in MACHINE.sensors if one.name == "antenna right")
    return np.asarray((T @ MACHINE.forward(q).T_machine_links[sensor.link] @ sensor.T_link_sensor)[:3, 3])


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_travel_is_told_from_swing_and_turn(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T, q = random_pose(rng, 0.1), random_q(rng, MACHINE)
    rates, w = rng.uniform(-0.9, 0.9, MACHINE.n), float(rng.uniform(-0.3, 0.3))
    v = np.append(rng.uniform(-3, 3, 2), 0.1)
    h = 1e-6

    def pose(t: float) -> Floats:
        out = np.array(T)
        out[:3, :3] = rotation(np.array([0, 0, w * t])) @ T[:3, :3]
        out[:3, 3] += v * t
        return out

    moving = (antenna_at(pose(h), q + rates * h) - antenna_at(pose(-h), q - rates * h)) / (2 * h)
    course = math.atan2(moving[0], moving[1]) + float(CRS.convergence(E, N))
    speed = math.hypot(moving[0], moving[1])
    given_velocity = GnssVelocity(
        Stamp("m", 0, "x"), "VTG", speed, course, climb_m_s=float(moving[2]), sigma_m_s=0.02
    )
    posture = PostureMemory((Bent((0,) * 6, tuple(q)),), np.eye(6) * 1e-8, tuple(rates), 0.1)
    before = Motion(yaw_rate=w, yaw_sigma=1e-4, standing=False)
    found = antenna_velocity(
        MACHINE, MACHINE.forward(q), posture, solved(T, q), given_velocity, CRS, "antenna right", before
    )
    np.testing.assert_allclose(found.velocity, v, atol=1e-6)
    assert found.sigma >= 0.02 and found.over_s == math.inf

    kin = MACHINE.forward(q)
    sensor = next(one for one in MACHINE.sensors if one.name == "cabin imu")
    turning = T[:3, :3] @ kin.spatial_jacobian[3:, :1] @ rates[:1] + np.array([0, 0, w])
    R = T[:3, :3] @ kin.T_machine_links[sensor.link, :3, :3] @ sensor.T_link_sensor[:3, :3]
    gyro = AngularRate(Stamp("m", 0, "links/cabin imu"), R.T @ turning, 0.002)
    turned = gyro_rate(MACHINE, kin, posture, solved(T, q), gyro, Motion(standing=False))
    assert turned.yaw_rate == pytest.approx(w, abs=1e-9)


def test_what_is_not_surer_is_left_aside() -> None:
    T, q = np.eye(4), np.array(MACHINE.home)
    posture = PostureMemory((Bent((0,) * 6, tuple(q)),), np.eye(6) * 1e-8, (0.0,) * 6, 0.1)
    sure = Motion((1.0, 2.0, 0.0), 0.1, 1e-3, 1e-4, 0.6, False)
    velocity = GnssVelocity(Stamp("m", 0, "x"), "VTG", 5.0, 1.0)
    gyro = AngularRate(Stamp("m", 0, "cabin imu"), np.array([0, 0, 1.0]))
    kin = MACHINE.forward(q)
    assert antenna_velocity(MACHINE, kin, posture, solved(T, q), velocity, CRS, "antenna right", sure) is sure
    assert antenna_velocity(MACHINE, kin, posture, solved(T, q), None, CRS, "antenna right", sure) is sure
    assert gyro_rate(MACHINE, kin, posture, solved(T, q), gyro, sure) is sure
    late = AngularRate(Stamp("m", 10**9, "cabin imu"), np.array([0, 0, 1.0]))
    unsure = Motion(standing=False)
    assert gyro_rate(MACHINE, kin, posture, solved(T, q), late, unsure) is unsure
