"""Simulated link sensors: inclinometers, encoders, wire encoders and gyros, each writing frames of our own."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace

from workgauge.machine.model import MachineModel
from workgauge.machine.parts import Sensor
from workgauge.sim.sensors.faults import FaultKind, one
from workgauge.sim.sensors.line import Line, Wiring
from workgauge.sim.sensors.motion import Motion
from workgauge.sim.sensors.randomness import White, generator
from workgauge.values.arrays import Floats, frozen
from workgauge.values.measurements import Stamp
from workgauge.values.navigation import AngularRate, EncoderReading, Inclination, LinkMeasurement
from workgauge.values.transforms import rotation
from workgauge.wire.messages import SEQUENCE_MODULUS, encode


class LinkSensor(ABC):
    """One sensor on a link and its line: what it measures, its error, its frames.

    Args:
        sensor: where it sits. line: where its frames go. sigma: 1-sigma of its error [rad, m, rad/s].
        wiring: shared with all sensors.
    """

    def __init__(self, sensor: Sensor, line: Line, sigma: float, wiring: Wiring) -> None:
        self.sensor = sensor
        self.line = line
        self.sigma = sigma
        self._white = White(generator(wiring.seed, line.identity.group, sensor.name, type(self).__name__), 3)
        self._machine_id = wiring.machine_id
        self._sequence = 0
        self._last: LinkMeasurement | None = None

    def send(self, motion: Motion) -> None:
        """Measure at the time of the motion and write one frame."""
        active = self.line.faults.at(motion.t_ns)
        jump = one(active, FaultKind.SENSOR_JUMP)
        stamp = Stamp(self._machine_id, motion.t_ns, self.sensor.name)
        value = self.measure(motion, stamp, self._white.draw() * self.sigma, 0.0 if jump is None else jump.offset)
        if one(active, FaultKind.FROZEN) is not None and self._last is not None:
            value = replace(self._last, stamp=stamp)
        self._last = value
        self.line.send(motion.t_ns, encode(value, self._sequence), active)
        self._sequence = (self._sequence + 1) % SEQUENCE_MODULUS

    @abstractmethod
    def measure(self, motion: Motion, stamp: Stamp, error: Floats, jump: float) -> LinkMeasurement:
        """Return the reading with an error (3,) and off by a jump, in the sensor's own unit."""

    def _R_machine_sensor(self, motion: Motion) -> Floats:
        rotation_: Floats = motion.kin.T_machine_links[self.sensor.link, :3, :3] @ self.sensor.T_link_sensor[:3, :3]
        return rotation_


class Inclinometer(LinkSensor):
    """Roll and pitch of its frame against gravity.

    The error tilts the measured vertical, by as much about every horizontal axis, whichever way the sensor lies; a
    jump turns the sensor about `axis`.

    Args:
        axis: (3,) of the joint whose angle depends on it, in the sensor's frame.
    """

    def __init__(self, sensor: Sensor, line: Line, sigma: float, wiring: Wiring, axis: Floats) -> None:
        super().__init__(sensor, line, sigma, wiring)
        self._axis = frozen(axis, (3,))

    def measure(self, motion: Motion, stamp: Stamp, error: Floats, jump: float) -> Inclination:
        """Return roll and pitch."""
        up = motion.T_site_machine[2, :3] @ self._R_machine_sensor(motion)
        if jump:
            up = rotation(-jump * self._axis) @ up
        x, y, z = (up + error - up * (up @ error)).tolist()
        return Inclination(stamp, math.atan2(y, z), math.atan2(-x, math.hypot(y, z)))


class Encoder(LinkSensor):
    """A joint encoder's angle or a wire encoder's stroke.

    Args:
        joint: index of the joint. raw: the sensor's value at a joint position.
        joint_sigma: 1-sigma of what is wrong between the joint and the sensor, such as a calibration [rad, m].
        round_: whether it turns without end and starts again at half a turn.
    """

    def __init__(
        self,
        sensor: Sensor,
        line: Line,
        sigma: float,
        wiring: Wiring,
        joint: int,
        raw: Callable[[float], float],
        *,
        joint_sigma: float,
        round_: bool,
    ) -> None:
        super().__init__(sensor, line, 1.0, wiring)
        self._sigmas = (sigma, joint_sigma)
        self._joint = joint
        self._raw = raw
        self._round = round_

    def measure(self, motion: Motion, stamp: Stamp, error: Floats, jump: float) -> EncoderReading:
        """Return the raw value."""
        position = float(motion.kin.q[self._joint]) + float(error[1]) * self._sigmas[1]
        value = self._raw(position) + float(error[0]) * self._sigmas[0] + jump
        return EncoderReading(stamp, math.remainder(value, 2.0 * math.pi) if self._round else value)


class Gyro(LinkSensor):
    """Angular velocity of its frame, in its own axes."""

    def measure(self, motion: Motion, stamp: Stamp, error: Floats, jump: float) -> AngularRate:
        """Return the rates."""
        turn = motion.link_turn(self.sensor.link) @ self._R_machine_sensor(motion)
        return AngularRate(stamp, frozen(turn + error))


def joint_axis(machine: MachineModel, sensor: Sensor, joint: int) -> Floats:
    """Return the axis (3,) of a joint in the frame of a sensor on the link it moves."""
    geometry = machine.chain[joint]
    axis: Floats = sensor.T_link_sensor[:3, :3].T @ (geometry.T_joint_link[:3, :3].T @ geometry.axis)
    return axis
