"""Joint positions from what sits on the links: inclinometers, encoders, wire encoders, with their covariance.

An inclinometer on link k sees the upward direction in its own frame, and so in the link's. The inclinometer nearer
the undercarriage gives the same direction in the link before, by way of the joints between. The joint in between is
the turn about its axis a that makes the two agree,

    v = R_joint_link u_k,   w = R_parent_joint^T u_parent,   q = atan2(a . (v x w), v . w - (a . v)(a . w)) + offset

whatever the machine's tilt and swing. Errors are carried to first order from every sensor to every joint, so that
two joints that share an inclinometer have correlated errors: with a folded arm that matters.
"""

import bisect
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.machine.parts import Sensor
from workgauge.machine.positioning import JointSensorSpec, PositioningSpec, WireCalibration
from workgauge.positioning.attitude import (
    Mat,
    Vec,
    cross,
    dot,
    plain,
    times,
    transposed_times,
    turned,
    up_seen,
    up_sides,
)
from workgauge.values.arrays import Floats, freeze, frozen

#: Sigma of a joint where the machine file gives none [rad, m].
DEFAULT_SIGMA_RAD, DEFAULT_SIGMA_M = math.radians(0.1), 0.005
#: A stroke this far outside its calibration, as a share of the calibrated range, is still carried on.
BEYOND_CALIBRATION = 0.01
#: Sine of the angle between a joint's axis and the vertical below which gravity says nothing of the joint.
LEAST_LEVER = 0.02


class Reading(NamedTuple):
    """What one sensor says at one moment.

    Attributes:
        first, second: roll and pitch of an inclinometer [rad], or an encoder's value and 0.
        sigma: its own statement of its error, NaN without one; it counts where it is larger than the configured.
    """

    first: float
    second: float = 0.0
    sigma: float = math.nan


@dataclass(frozen=True, slots=True)
class Channel:
    """One link sensor as the solver uses it.

    Attributes:
        name: of the sensor. port: where its bytes arrive. latency_s: from measuring to arriving.
        tilting: it is an inclinometer. turning: its values are angles.
        link: it sits on. mounting: the sensor's frame in its link's. sigma: [rad, m].
    """

    name: str
    port: str
    latency_s: float
    tilting: bool
    turning: bool
    link: int
    mounting: Mat
    sigma: float


class PostureSolution(NamedTuple):
    """Joint positions and their errors.

    Attributes:
        q: (n,) [rad, m]. covariance: (n, n) of measured less true.
        tilt_cross: (3, n) covariance of the tilt sensor's up, in its link's frame, with the joints' errors.
    """

    q: Floats
    covariance: Floats
    tilt_cross: Floats

    @property
    def sigma(self) -> Floats:
        """(n,) 1-sigma of each joint."""
        return np.sqrt(np.diag(self.covariance))


class WireCurve:
    """Joint position over a wire's stroke: a monotone cubic spline through the calibrated points (PCHIP)."""

    def __init__(self, calibration: WireCalibration) -> None:
        strokes = np.array(calibration.stroke_m)
        if calibration.position_deg is not None:
            positions = np.radians(calibration.position_deg)
        else:
            positions = np.array(calibration.position_m)
        self._knots: list[float] = strokes.tolist()
        steps = np.diff(strokes)
        chords = np.diff(positions) / steps
        slopes = _monotone_slopes(steps, chords)
        cubic = (slopes[:-1] + slopes[1:] - 2.0 * chords) / steps**2
        square = (3.0 * chords - 2.0 * slopes[:-1] - slopes[1:]) / steps
        pieces = np.column_stack([cubic, square, slopes[:-1], positions[:-1]])
        self._pieces: list[list[float]] = pieces.tolist()
        self._margin = BEYOND_CALIBRATION * (self._knots[-1] - self._knots[0])

    def at(self, stroke: float) -> tuple[float, float]:
        """Return the position and its slope over the stroke; NaN outside the calibrated range."""
        if not self._knots[0] - self._margin <= stroke <= self._knots[-1] + self._margin:
            return math.nan, math.nan
        inside = min(max(stroke, self._knots[0]), self._knots[-1])
        i = min(bisect.bisect_right(self._knots, inside) - 1, len(self._pieces) - 1)
        a, b, c, d = self._pieces[i]
        x = inside - self._knots[i]
        slope = (3.0 * a * x + 2.0 * b) * x + c
        return ((a * x + b) * x + c) * x + d + slope * (stroke - inside), slope


def _monotone_slopes(steps: Floats, chords: Floats) -> Floats:
    """Return the slopes (k + 1,) at the points of a monotone cubic (Fritsch and Butland 1984, as in PCHIP).

    Inside, the weighted harmonic mean of the chords on both sides; at an end, that of the parabola through three
    points, held so that the curve does not turn back.
    """
    if len(steps) == 1:
        return np.array([chords[0], chords[0]])
    left, right = 2.0 * steps[1:] + steps[:-1], steps[1:] + 2.0 * steps[:-1]
    inner = (left + right) / (left / chords[:-1] + right / chords[1:])

    def end(h0: float, h1: float, c0: float, c1: float) -> float:
        slope = ((2.0 * h0 + h1) * c0 - h0 * c1) / (h0 + h1)
        return slope if slope * c0 > 0.0 else 0.0

    first = end(float(steps[0]), float(steps[1]), float(chords[0]), float(chords[1]))
    last = end(float(steps[-1]), float(steps[-2]), float(chords[-1]), float(chords[-2]))
    return np.concatenate([[first], inner, [last]])


#: Up in a link's frame, and its two sides.
_Directions: TypeAlias = tuple[Vec, Vec, Vec]


@dataclass(frozen=True, slots=True)
class _Joint:
    """One joint of the chain with its sensor, as plain floats."""

    parent: Mat
    axis: Vec
    child: Mat
    prismatic: bool
    middle: float | None
    kind: str
    channel: int
    before: int
    sign: float
    offset: float
    curve: WireCurve | None
    extra_sigma: float


class PostureSolver:
    """Solves the posture of one machine from the readings of its link sensors.

    Attributes:
        channels: the sensors, the tilt sensor first; readings are given in this order.
        tilt: the tilt sensor's channel, 0.

    Args:
        machine: with a `positioning` section.

    Raises:
        ValueError: if it has none, or it does not fit the machine (the loader of machine files sees to that).
    """

    def __init__(self, machine: MachineModel) -> None:
        spec = machine.positioning
        if spec is None:
            raise ValueError(f"machine {machine.name} has no positioning section")
        self.machine = machine
        self.channels, places = _channels(machine, spec)
        by_joint = {joint.joint: joint for joint in spec.joints}
        self._joints = tuple(_joint(machine, i, by_joint[name], places) for i, name in enumerate(machine.joint_names))
        widths = [2 if channel.tilting else 1 for channel in self.channels]
        self._starts = [sum(widths[:i]) for i in range(len(widths))]
        self._width = sum(widths)
        self._sigmas = [channel.sigma for channel in self.channels]
        extra = np.diag([joint.extra_sigma**2 for joint in self._joints])
        self._extra = extra if extra.any() else None

    def up(self, channel: int, reading: Reading) -> Vec:
        """Return the upward direction in the frame of the link that an inclinometer sits on."""
        return times(self.channels[channel].mounting, up_seen(reading.first, reading.second))

    def up_covariance(self, channel: int, reading: Reading) -> Floats:
        """Return the covariance (3, 3) of `up`: sigma squared about every axis square to it."""
        up = np.array(self.up(channel, reading))
        sigma = self._sigma(channel, reading)
        covariance: Floats = (sigma * sigma) * (np.eye(3) - up[:, None] * up)
        return covariance

    def solve(self, readings: Sequence[Reading]) -> PostureSolution:
        """Return the posture from one reading per channel; NaN where a reading is, or where gravity says nothing."""
        seen = [
            self._directions(channel.mounting, reading) if channel.tilting else None
            for channel, reading in zip(self.channels, readings, strict=True)
        ]
        q: list[float] = []
        gains: list[list[float]] = []
        for joint in self._joints:
            value, gain = self._of(joint, readings, seen, q, gains)
            q.append(value)
            gains.append(gain)
        scale: list[float] = []
        for i, channel in enumerate(self.channels):
            own, least = readings[i].sigma, self._sigmas[i]
            scale += [own if own > least else least] * (2 if channel.tilting else 1)
        scaled = np.array(gains)
        scaled *= scale
        covariance = scaled @ scaled.T
        if self._extra is not None:
            covariance += self._extra
        assert seen[0] is not None
        tilt = np.array(seen[0][1:]).T * scale[0] @ scaled[:, :2].T
        for array in (covariance, tilt):
            freeze(array)
        return PostureSolution(frozen(q), covariance, tilt)

    @staticmethod
    def _directions(mounting: Mat, reading: Reading) -> _Directions:
        """Return up and its two sides in the frame of the link an inclinometer sits on."""
        by_roll, by_pitch = up_sides(reading.first, reading.second)
        up = up_seen(reading.first, reading.second)
        return times(mounting, up), times(mounting, by_roll), times(mounting, by_pitch)

    def _sigma(self, channel: int, reading: Reading) -> float:
        own = reading.sigma
        return own if own > self._sigmas[channel] else self._sigmas[channel]

    def _of(
        self,
        joint: _Joint,
        readings: Sequence[Reading],
        seen: Sequence[_Directions | None],
        q: list[float],
        gains: list[list[float]],
    ) -> tuple[float, list[float]]:
        """Return one joint's position and how it changes with every sensor's value."""
        gain = [0.0] * self._width
        own = readings[joint.channel]
        if joint.kind == "encoder":
            gain[self._starts[joint.channel]] = joint.sign
            return joint.sign * own.first + joint.offset, gain
        if joint.curve is not None:
            value, slope = joint.curve.at(joint.sign * own.first)
            gain[self._starts[joint.channel]] = joint.sign * slope
            return value + joint.offset, gain
        link, before = seen[joint.channel], seen[joint.before]
        assert link is not None and before is not None
        return self._by_gravity(joint, link, before, q, gains, gain)

    def _by_gravity(
        self,
        joint: _Joint,
        link: _Directions,
        before: _Directions,
        q: list[float],
        gains: list[list[float]],
        gain: list[float],
    ) -> tuple[float, list[float]]:
        a, first = joint.axis, self.channels[joint.before].link
        v = times(joint.child, link[0])
        w = transposed_times(joint.parent, self._carried(before[0], first, q))
        av, aw, plane = dot(a, v), dot(a, w), cross(a, v)
        square_v, square_w = 1.0 - av * av, 1.0 - aw * aw
        if not min(square_v, square_w) > LEAST_LEVER**2:
            return math.nan, [math.nan] * self._width
        value = math.atan2(dot(plane, w), dot(v, w) - av * aw) + joint.offset
        if joint.middle is not None:
            value = joint.middle + math.remainder(value - joint.middle, 2.0 * math.pi)
        # what a change of the link's direction does, in the frame of the link
        side_v = transposed_times(joint.child, plane)
        start = self._starts[joint.channel]
        gain[start] -= dot(side_v, link[1]) / square_v
        gain[start + 1] -= dot(side_v, link[2]) / square_v
        # and of the one before, in the frame of the link its sensor sits on
        side_w = times(joint.parent, cross(a, w))
        start = self._starts[joint.before]
        gain[start] += dot(side_w, self._carried(before[1], first, q)) / square_w
        gain[start + 1] += dot(side_w, self._carried(before[2], first, q)) / square_w
        for i in range(first, len(q)):
            if self._joints[i].prismatic:
                continue
            share = dot(side_w, self._change(before[0], first, i, q)) / square_w
            if share:
                for k, part in enumerate(gains[i]):
                    gain[k] += share * part
        return value, gain

    def _carried(self, direction: Vec, link: int, q: list[float]) -> Vec:
        """Return a direction given in a link's frame in that of the last link that q (of the first joints) moves."""
        for i in range(link, len(q)):
            joint = self._joints[i]
            direction = transposed_times(joint.parent, direction)
            if not joint.prismatic:
                direction = turned(joint.axis, -q[i], direction)
            direction = transposed_times(joint.child, direction)
        return direction

    def _change(self, direction: Vec, link: int, moving: int, q: list[float]) -> Vec:
        """Return how `_carried` changes with the joint `moving`."""
        joint = self._joints[moving]
        before = transposed_times(joint.parent, self._carried(direction, link, q[:moving]))
        side = cross(joint.axis, turned(joint.axis, -q[moving], before))
        changed = transposed_times(joint.child, (-side[0], -side[1], -side[2]))
        return self._carried(changed, moving + 1, q)


def posture_of(solver: PostureSolver, readings: Sequence[Reading]) -> tuple[Floats, Floats]:
    """Return joint positions (n,) and their sigmas (n,) [rad, m] from one reading per channel."""
    solution = solver.solve(readings)
    return solution.q, solution.sigma


def _channels(machine: MachineModel, spec: PositioningSpec) -> tuple[tuple[Channel, ...], dict[str, int]]:
    sensors = {sensor.name: sensor for sensor in machine.sensors}
    tilt = spec.tilt
    sigma = math.radians(tilt.sigma_deg)
    found = {tilt.sensor: _channel(sensors[tilt.sensor], tilt.port, tilt.latency_s, (True, True), sigma)}
    prismatic = dict(zip(machine.joint_names, machine.prismatic.tolist(), strict=True))
    named = [(joint.sensor, joint) for joint in spec.joints]
    named += [(joint.before, joint) for joint in spec.joints if joint.before is not None]
    for name, joint in named:
        if name not in found:
            tilting = joint.kind == "inclination"
            slides = bool(prismatic[joint.joint])
            turning = tilting or (joint.kind == "encoder" and not slides)
            sigma = _sensor_sigma(joint, slides)
            found[name] = _channel(sensors[name], joint.port, joint.latency_s, (tilting, turning), sigma)
    return tuple(found.values()), {name: i for i, name in enumerate(found)}


def _channel(sensor: Sensor, port: str, latency_s: float, kind: tuple[bool, bool], sigma: float) -> Channel:
    mounting = plain(sensor.T_link_sensor[:3, :3])
    return Channel(sensor.name, port, latency_s, *kind, sensor.link, mounting, sigma)


def _sensor_sigma(joint: JointSensorSpec, prismatic: bool) -> float:
    """Return the 1-sigma of what a joint's sensor itself measures [rad, m]."""
    if joint.kind == "wire_encoder":
        return joint.sigma_m or 0.0
    if prismatic:
        return joint.sigma_m or DEFAULT_SIGMA_M
    return DEFAULT_SIGMA_RAD if joint.sigma_deg is None else math.radians(joint.sigma_deg)


def _joint(machine: MachineModel, i: int, spec: JointSensorSpec, places: dict[str, int]) -> _Joint:
    geometry = machine.chain[i]
    prismatic = bool(machine.prismatic[i])
    curve = None if spec.calibration is None else WireCurve(spec.calibration)
    middle = None
    if spec.kind == "inclination":
        middle = 0.0 if machine.continuous[i] else float(machine.q_min[i] + machine.q_max[i]) / 2.0
    extra = 0.0
    if curve is not None:
        if spec.sigma_deg is not None:
            extra = math.radians(spec.sigma_deg)
        elif spec.sigma_m is None:
            extra = DEFAULT_SIGMA_M if prismatic else DEFAULT_SIGMA_RAD
    x, y, z = geometry.axis.tolist()
    return _Joint(
        parent=plain(geometry.T_parent_joint[:3, :3]),
        axis=(x, y, z),
        child=plain(geometry.T_joint_link[:3, :3]),
        prismatic=prismatic,
        middle=middle,
        kind=spec.kind,
        channel=places[spec.sensor],
        before=places[spec.before] if spec.before is not None else 0,
        sign=float(spec.sign),
        offset=0.0 if prismatic and spec.kind != "wire_encoder" else math.radians(spec.offset_deg),
        curve=curve,
        extra_sigma=extra,
    )
