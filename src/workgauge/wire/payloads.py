"""The payload of each message, little-endian and without padding, written and read beside each other.

| message | payload |
|---|---|
| posture | u8 n; n f64 joint positions [rad, m]; n f64 standard deviations |
| machine pose | 12 f64, upper three rows of T_site_machine; 21 f64, upper triangle of the covariance, by rows |
| valve command | u8 enable (0, 1); u8 n; n i16 valves |
| inclination | 3 f64: roll, pitch, sigma [rad] |
| encoder reading | 2 f64: value, sigma [rad, m] |
| angular rate | 4 f64: rate about x, y, z, sigma [rad/s] |
| operator intent | u8 mode (0 joint, 1 tool, 2 line), enable, line; 6 f64 levers; 3 f64 start; 3 f64 direction |

Sequence and stamp stand in the header. Without a line, its six numbers are zero. Numbers may be NaN or infinite:
judging a measurement is not the wire's work.
"""

import struct

import numpy as np

from workgauge.values.arrays import frozen
from workgauge.values.commands import ValveCommand
from workgauge.values.errors import WireError
from workgauge.values.measurements import DriveMode, Intent, Levers, MachinePose, Posture, Stamp, ToolLine
from workgauge.values.navigation import AngularRate, EncoderReading, Inclination

_MODES = (DriveMode.JOINT, DriveMode.TOOL, DriveMode.LINE, DriveMode.EXIT, DriveMode.AUTO)
_POSE = struct.Struct("<33d")
_INTENT = struct.Struct("<BBB12d")
_INCLINATION = struct.Struct("<3d")
_ENCODER = struct.Struct("<2d")
_RATE = struct.Struct("<4d")
_UPPER = np.triu_indices(6)
_BOTTOM = np.array([0.0, 0.0, 0.0, 1.0])


def pack_posture(value: Posture) -> bytes:
    """Return the payload of a posture; `WireError` if it has more than 255 joints or sigma another length."""
    n = len(value.q)
    if len(value.sigma) != n or value.q.shape != (n,):
        raise WireError("one standard deviation per joint", element="sigma", value=value.sigma.shape)
    if n > 255:
        raise WireError("too many joints", element="joints", value=n, allowed="at most 255")
    return struct.pack(f"<B{2 * n}d", n, *value.q.tolist(), *value.sigma.tolist())


def unpack_posture(stamp: Stamp, sequence: int, payload: bytes) -> Posture:
    """Return the posture in a payload; `WireError` if its length does not fit its joint count."""
    n = payload[0] if payload else 0
    _expect(payload, 1 + 16 * n, "posture")
    numbers = struct.unpack_from(f"<{2 * n}d", payload, 1)
    return Posture(stamp, frozen(numbers[:n]), frozen(numbers[n:]))


def pack_pose(value: MachinePose) -> bytes:
    """Return the payload of a pose; `WireError` if the matrix is not homogeneous or the covariance not symmetric."""
    T, covariance = value.T_site_machine, value.covariance
    if T.shape != (4, 4) or not np.array_equal(T[3], _BOTTOM):
        raise WireError("not a homogeneous matrix", element="T_site_machine")
    if covariance.shape != (6, 6) or not np.array_equal(covariance, covariance.T, equal_nan=True):
        raise WireError("not symmetric", element="covariance")
    return _POSE.pack(*T[:3].ravel().tolist(), *covariance[_UPPER].tolist())


def unpack_pose(stamp: Stamp, sequence: int, payload: bytes) -> MachinePose:
    """Return the pose in a payload; `WireError` if its length is wrong."""
    _expect(payload, _POSE.size, "machine pose")
    numbers = _POSE.unpack(payload)
    T = np.empty((4, 4))
    T[:3] = np.reshape(numbers[:12], (3, 4))
    T[3] = _BOTTOM
    covariance = np.empty((6, 6))
    covariance[_UPPER] = numbers[12:]
    covariance.T[_UPPER] = numbers[12:]
    return MachinePose(stamp, frozen(T), frozen(covariance))


def pack_command(value: ValveCommand) -> bytes:
    """Return the payload of a valve command; `WireError` if a valve does not fit 16 bits."""
    n = len(value.valves)
    try:
        return struct.pack(f"<BB{n}h", bool(value.enable), n, *value.valves)
    except struct.error as error:
        raise WireError("a valve does not fit its field", element="valves", value=str(error)) from None


def unpack_command(stamp: Stamp, sequence: int, payload: bytes) -> ValveCommand:
    """Return the valve command in a payload; `WireError` if its length or a flag is wrong."""
    n = payload[1] if len(payload) > 1 else 0
    _expect(payload, 2 + 2 * n, "valve command")
    return ValveCommand(stamp, sequence, struct.unpack_from(f"<{n}h", payload, 2), _flag(payload[0], "enable"))


def pack_intent(value: Intent) -> bytes:
    """Return the payload of an operator intent; `WireError` if the line is not two vectors of three."""
    line = value.line
    numbers = [0.0] * 6
    if line is not None:
        if line.start_site.shape != (3,) or line.direction_site.shape != (3,):
            raise WireError("a line is two vectors of three", element="line")
        numbers = [*line.start_site.tolist(), *line.direction_site.tolist()]
    return _INTENT.pack(
        _MODES.index(value.mode), bool(value.enable), line is not None, *value.levers.values, *numbers
    )


def unpack_intent(stamp: Stamp, sequence: int, payload: bytes) -> Intent:
    """Return the operator intent in a payload; `WireError` if its length, mode or a flag is wrong."""
    _expect(payload, _INTENT.size, "operator intent")
    mode, enable, given, *numbers = _INTENT.unpack(payload)
    if mode >= len(_MODES):
        raise WireError("unknown mode", element="mode", value=mode, allowed=f"0 to {len(_MODES) - 1}")
    line = None
    if _flag(given, "line given"):
        line = ToolLine(frozen(numbers[6:9]), frozen(numbers[9:12]))
    elif payload[-48:] != bytes(48):
        raise WireError("numbers of a line that is not given", element="line")
    return Intent(stamp, _MODES[mode], Levers(*numbers[:6]), _flag(enable, "enable"), line)


def pack_inclination(value: Inclination) -> bytes:
    """Return the payload of an inclination."""
    return _INCLINATION.pack(value.roll, value.pitch, value.sigma)


def unpack_inclination(stamp: Stamp, sequence: int, payload: bytes) -> Inclination:
    """Return the inclination in a payload; `WireError` if its length is wrong."""
    _expect(payload, _INCLINATION.size, "inclination")
    return Inclination(stamp, *_INCLINATION.unpack(payload))


def pack_encoder(value: EncoderReading) -> bytes:
    """Return the payload of an encoder reading."""
    return _ENCODER.pack(value.value, value.sigma)


def unpack_encoder(stamp: Stamp, sequence: int, payload: bytes) -> EncoderReading:
    """Return the encoder reading in a payload; `WireError` if its length is wrong."""
    _expect(payload, _ENCODER.size, "encoder reading")
    return EncoderReading(stamp, *_ENCODER.unpack(payload))


def pack_rate(value: AngularRate) -> bytes:
    """Return the payload of an angular rate; `WireError` if it is not a vector of three."""
    if value.rate.shape != (3,):
        raise WireError("an angular rate has three components", element="rate", value=value.rate.shape)
    return _RATE.pack(*value.rate.tolist(), value.sigma)


def unpack_rate(stamp: Stamp, sequence: int, payload: bytes) -> AngularRate:
    """Return the angular rate in a payload; `WireError` if its length is wrong."""
    _expect(payload, _RATE.size, "angular rate")
    *rate, sigma = _RATE.unpack(payload)
    return AngularRate(stamp, frozen(rate), sigma)


def _expect(payload: bytes, length: int, element: str) -> None:
    if len(payload) != length:
        raise WireError("wrong payload length", element=element, value=len(payload), allowed=str(length))


def _flag(byte: int, element: str) -> bool:
    if byte > 1:
        raise WireError("not a flag", element=element, value=byte, allowed="0 or 1")
    return byte == 1
