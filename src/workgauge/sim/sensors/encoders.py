"""What an encoder reads at a joint position: the inverse of what the machine's file says of it."""

import math
from collections.abc import Callable

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

from workgauge.machine.positioning import JointSensorSpec, WireCalibration


def sensor_value(spec: JointSensorSpec, prismatic: bool) -> Callable[[float], float]:
    """Return what a joint's encoder reads [rad, m] at a joint position [rad, m].

    Joint = sign x value + offset, or the calibration's curve at sign x stroke, + offset; a sliding joint's own
    encoder has no offset.
    """
    sign = spec.sign
    offset = 0.0 if prismatic and spec.calibration is None else math.radians(spec.offset_deg)
    if spec.calibration is None:
        return lambda position: sign * (position - offset)
    stroke = stroke_of(spec.calibration)
    return lambda position: sign * stroke(position - offset)


def stroke_of(calibration: WireCalibration) -> Callable[[float], float]:
    """Return the function from joint position [rad, m] to stroke [m], the true curve being monotone cubic.

    Positions beyond the calibrated ones give the stroke at the nearer end, as a wire at its stop does.
    """
    strokes = np.array(calibration.stroke_m)
    if calibration.position_deg is not None:
        positions = np.radians(calibration.position_deg)
    else:
        assert calibration.position_m is not None, "a calibration has positions"
        positions = np.array(calibration.position_m)
    curve = PchipInterpolator(strokes, positions)
    low, high = sorted((float(positions[0]), float(positions[-1])))

    def stroke(position: float) -> float:
        wanted = min(max(position, low), high)
        ends = (float(strokes[0]), float(strokes[-1]))
        for end, at in zip(ends, (float(positions[0]), float(positions[-1])), strict=True):
            if math.isclose(wanted, at, rel_tol=0.0, abs_tol=1e-15):
                return end
        return float(brentq(lambda s: float(curve(s)) - wanted, *ends, xtol=1e-12))

    return stroke
