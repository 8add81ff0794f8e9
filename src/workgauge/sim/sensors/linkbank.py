"""All of a machine's simulated link sensors, as its `positioning:` section lists them."""

import math

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.machine.positioning import JointSensorSpec, PositioningSpec
from workgauge.sim.sensors.encoders import sensor_value
from workgauge.sim.sensors.faults import Identity
from workgauge.sim.sensors.line import Line, Wiring
from workgauge.sim.sensors.links import (
    Encoder,
    Gyro,
    Inclinometer,
    LinkSensor,
    joint_axis,
)
from workgauge.sim.sensors.motion import Motion
from workgauge.sim.sensors.settings import LinkSettings
from workgauge.values.arrays import Floats

#: 1-sigma of a joint whose file says none [degree, m].
JOINT_SIGMA_DEG, JOINT_SIGMA_M = 0.1, 0.005

_PITCH_AXIS = np.array([0.0, 1.0, 0.0])


class LinkBank:
    """Inclinometers, encoders and gyros, in the order of the machine's file, read together.

    An inclinometer that several joints name is one sensor. Each IMU of the machine, listed or not, also has a gyro.

    Args:
        machine: its kinematics and sensors. positioning: its section. settings: how they behave.
        wiring: shared with all sensors.
    """

    def __init__(
        self,
        machine: MachineModel,
        positioning: PositioningSpec,
        settings: LinkSettings,
        wiring: Wiring,
    ) -> None:
        self._machine = machine
        self._sensors = {sensor.name: sensor for sensor in machine.sensors}
        self._scale = settings.scale
        self._jitter_s = settings.jitter_s
        self._wiring = wiring
        tilt = positioning.tilt
        self._tilts: dict[str, Inclinometer] = {}
        self._add_tilt(tilt.sensor, tilt.port, tilt.latency_s, math.radians(tilt.sigma_deg), _PITCH_AXIS)
        encoders = [self._add_joint(spec) for spec in positioning.joints]
        for spec in positioning.joints:
            if spec.before is not None:
                sigma = math.radians(spec.sigma_deg or JOINT_SIGMA_DEG)
                self._add_tilt(spec.before, spec.port, spec.latency_s, sigma, _PITCH_AXIS)
        gyros: list[LinkSensor] = []
        if settings.gyros:
            for sensor in machine.sensors:
                if sensor.kind == "imu":
                    like = self._tilts.get(sensor.name)
                    port = tilt.port if like is None else like.line.identity.port
                    line = self._line(sensor.name, port, tilt.latency_s, "gyro")
                    gyros.append(Gyro(sensor, line, settings.gyro_rad_s * self._scale, wiring))
        self.sensors: tuple[LinkSensor, ...] = (
            *self._tilts.values(),
            *(encoder for encoder in encoders if encoder is not None),
            *gyros,
        )

    def measure(self, motion: Motion, utc_ns: int) -> None:
        """Let every sensor measure and send; they know no UTC."""
        for sensor in self.sensors:
            sensor.send(motion)

    def _add_joint(self, spec: JointSensorSpec) -> Encoder | None:
        """Add what measures a joint; return its encoder if it has one."""
        j = self._machine.joint_names.index(spec.joint)
        sensor = self._sensors[spec.sensor]
        if spec.kind == "inclination":
            sigma = math.radians(spec.sigma_deg or JOINT_SIGMA_DEG)
            axis = joint_axis(self._machine, sensor, j)
            self._add_tilt(sensor.name, spec.port, spec.latency_s, sigma, axis)
            return None
        prismatic = bool(self._machine.prismatic[j])
        if spec.calibration is None:
            angle = math.radians(spec.sigma_deg or JOINT_SIGMA_DEG)
            sigmas = (spec.sigma_m or JOINT_SIGMA_M if prismatic else angle, 0.0)
        else:
            unsaid = 0.0 if spec.sigma_m else JOINT_SIGMA_M if prismatic else math.radians(JOINT_SIGMA_DEG)
            sigmas = (spec.sigma_m or 0.0, math.radians(spec.sigma_deg) if spec.sigma_deg else unsaid)
        return Encoder(
            sensor,
            self._line(sensor.name, spec.port, spec.latency_s, "sensor"),
            sigmas[0] * self._scale,
            self._wiring,
            j,
            sensor_value(spec, prismatic),
            joint_sigma=sigmas[1] * self._scale,
            round_=bool(self._machine.continuous[j]) and spec.kind == "encoder",
        )

    def _add_tilt(self, name: str, port: str, latency_s: float, sigma: float, axis: Floats) -> None:
        if name in self._tilts:
            return
        self._tilts[name] = Inclinometer(
            self._sensors[name],
            self._line(name, port, latency_s, "sensor"),
            sigma * self._scale,
            self._wiring,
            axis,
        )

    def _line(self, name: str, port: str, latency_s: float, what: str) -> Line:
        identity = Identity(name, "sensor", port, what)
        return self._wiring.line(identity, latency_s, self._jitter_s)
