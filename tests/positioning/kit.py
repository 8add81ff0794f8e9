"""Random machines, poses and exact measurements of them, for the tests of this room."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from workgauge.machine.load import machine_from
from workgauge.machine.model import MachineModel
from workgauge.positioning.antennas import PlacedAntenna, Tilt
from workgauge.positioning.attitude import up_seen, up_sides
from workgauge.positioning.posture import PostureSolver, Reading
from workgauge.values.arrays import Floats
from workgauge.values.transforms import rotation, rotation_vector, rpy


def random_machine(rng: np.random.Generator, tilt_link: int | None = None, antenna_link: int = 1) -> MachineModel:
    """A machine of 3 to 6 joints with any rows, sensors mounted anyhow; all joints but the swing lean on gravity."""
    n = int(rng.integers(3, 7))
    links = ["undercarriage"] + [f"j{i}" for i in range(n)]
    joints: list[dict[str, Any]] = [
        {
            "name": "j0",
            "type": "revolute",
            "continuous": True,
            "home_deg": 0,
            "speed_positive_deg_s": 50,
            "speed_negative_deg_s": 50,
            "dh": {"a_m": float(rng.uniform(-0.5, 0.5)), "alpha_deg": 90, "d_m": 1.5},
        }
    ]
    for i in range(1, n):
        alpha = float(rng.choice([0.0, 90.0, -90.0, rng.uniform(-20, 20)]))
        joints.append(
            {
                "name": f"j{i}",
                "type": "revolute",
                "lower_deg": -170,
                "upper_deg": 170,
                "home_deg": 0,
                "speed_positive_deg_s": 50,
                "speed_negative_deg_s": 50,
                "dh": {
                    "a_m": float(rng.uniform(0.2, 5)),
                    "alpha_deg": alpha,
                    "d_m": float(rng.uniform(-0.3, 0.3)),
                    "theta_deg": float(rng.uniform(-180, 180)),
                },
            }
        )

    def sensor(name: str, kind: str, link: str, spread: float) -> dict[str, Any]:
        angles = rng.uniform(-180, 180, 3).tolist() if kind != "gnss_antenna" else [0, 0, 0]
        return {
            "name": name,
            "kind": kind,
            "link": link,
            "position_m": rng.uniform(-spread, spread, 3).tolist(),
            "rpy_deg": angles,
        }

    tilted = int(rng.integers(0, 2)) if tilt_link is None else tilt_link
    sensors = [
        sensor("ant 1", "gnss_antenna", links[antenna_link], 1.5),
        sensor("ant 2", "gnss_antenna", links[antenna_link], 1.5),
        sensor("tilt", "inclinometer", links[tilted], 1),
        sensor("e0", "encoder", "j0", 1),
        *[sensor(f"i{i}", "imu", f"j{i}", 1) for i in range(1, n)],
    ]
    sensors[1]["position_m"][0] = sensors[0]["position_m"][0] + float(rng.choice([-2.0, 2.0]))
    specs: list[dict[str, Any]] = [
        {"joint": "j0", "kind": "encoder", "sensor": "e0", "sigma_deg": 0.05, "sign": -1, "offset_deg": 12.5}
    ]
    for i in range(1, n):
        spec: dict[str, Any] = {"joint": f"j{i}", "kind": "inclination", "sensor": f"i{i}", "sigma_deg": 0.1}
        if i > 1 and rng.uniform() < 0.6:
            spec["before"] = f"i{int(rng.integers(1, i))}"
        specs.append(spec)
    return machine_from(
        {
            "title": "random",
            "undercarriage": {"kind": "rail", "gauge_m": 1.5},
            "base": {"position_m": rng.uniform(-0.3, 0.3, 3).tolist(), "rpy_deg": rng.uniform(-5, 5, 3).tolist()},
            "joints": joints,
            "solids": [{"name": "box", "link": "undercarriage", "centre_m": [0, 0, 0], "size_m": [1, 1, 1]}],
            "attachments": [{"name": "hook", "tool": {}, "tolerance_m": 0.01}],
            "sensors": sensors,
            "positioning": {
                "receivers": [
                    {"name": "r1", "antenna": "ant 1", "port": "p1"},
                    {"name": "r2", "antenna": "ant 2", "port": "p2"},
                ],
                "heading": {"kind": "two_antennas", "master": "ant 1", "rover": "ant 2"},
                "tilt": {"sensor": "tilt", "sigma_deg": 0.05},
                "joints": specs,
            },
        }
    )


def random_pose(rng: np.random.Generator, most_tilt: float = 0.3) -> Floats:
    """A pose anywhere near the origin, any heading, tilted up to `most_tilt` in roll and pitch [rad]."""
    T = rpy(*rng.uniform(-most_tilt, most_tilt, 2), rng.uniform(-math.pi, math.pi))
    T[:3, 3] = rng.uniform(-300, 300, 3)
    return T


def random_q(rng: np.random.Generator, machine: MachineModel) -> Floats:
    """A posture within the limits."""
    return np.asarray(rng.uniform(machine.sample_min, machine.sample_max), dtype=np.float64)


def reading_of_up(up: Floats) -> tuple[float, float]:
    """Roll and pitch of an inclinometer that sees the unit vector up."""
    return math.atan2(up[1], up[2]), math.atan2(-up[0], math.hypot(up[1], up[2]))


@dataclass
class Exact:
    """What perfect sensors of a machine see."""

    machine: MachineModel
    T: Floats
    q: Floats

    def __post_init__(self) -> None:
        self.kin = self.machine.forward(self.q)
        self.sensors = {sensor.name: sensor for sensor in self.machine.sensors}

    def antenna(self, name: str, covariance: Floats | None = None, error: Floats | None = None) -> PlacedAntenna:
        sensor = self.sensors[name]
        place = sensor.T_link_sensor[:3, 3]
        at = self.T @ self.kin.T_machine_links[sensor.link] @ np.append(place, 1.0)
        moved = at[:3] if error is None else at[:3] + error
        return PlacedAntenna(sensor.link, place, moved, np.eye(3) * 1e-4 if covariance is None else covariance)

    def up_sensor(self, name: str) -> Floats:
        sensor = self.sensors[name]
        R = self.T[:3, :3] @ self.kin.T_machine_links[sensor.link][:3, :3] @ sensor.T_link_sensor[:3, :3]
        return np.asarray(R[2], dtype=np.float64)

    def inclination(self, name: str) -> tuple[float, float]:
        return reading_of_up(self.up_sensor(name))

    def tilt(self, name: str = "tilt", sigma: float = 1e-3, error: tuple[float, float] = (0.0, 0.0)) -> Tilt:
        sensor = self.sensors[name]
        roll, pitch = self.inclination(name)
        R = sensor.T_link_sensor[:3, :3]
        sides = np.array(up_sides(roll, pitch))
        up = np.array(up_seen(roll, pitch)) + np.array(error) @ sides
        gain = R @ sides.T
        return Tilt(sensor.link, R @ (up / np.linalg.norm(up)), sigma**2 * gain @ gain.T)

    def readings(self) -> list[Reading]:
        """One reading per channel of the posture solver."""
        assert self.machine.positioning is not None
        joints = {joint.sensor: joint for joint in self.machine.positioning.joints}
        out = []
        for channel in PostureSolver(self.machine).channels:
            if channel.tilting:
                out.append(Reading(*self.inclination(channel.name)))
            else:
                joint = joints[channel.name]
                position = self.q[self.machine.joint_names.index(joint.joint)]
                out.append(Reading((position - math.radians(joint.offset_deg)) * joint.sign))
        return out


def tipped(reading: Reading, part: int, angle: float) -> Reading:
    """An inclinometer's reading with its vertical tipped towards one of its two sides [rad]."""
    up = np.array(up_seen(reading.first, reading.second)) + angle * np.array(
        up_sides(reading.first, reading.second)[part]
    )
    roll, pitch = reading_of_up(up / np.linalg.norm(up))
    return reading._replace(first=roll, second=pitch)


def pose_error(T_true: Floats, T: Floats) -> Floats:
    """(6,) translation and rotation vector that lead from the estimated to the true pose."""
    return np.concatenate([T_true[:3, 3] - T[:3, 3], rotation_vector(T_true[:3, :3] @ T[:3, :3].T)])


def moved(T: Floats, xi: Floats) -> Floats:
    """The pose a small (6,) away."""
    out = np.array(T)
    out[:3, 3] += xi[:3]
    out[:3, :3] = rotation(xi[3:]) @ T[:3, :3]
    return out
