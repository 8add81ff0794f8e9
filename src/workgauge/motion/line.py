"""A straight tool path driven by hand: one lever is the speed along it, the loop is closed on the measured tool."""

import math

import numpy as np

from workgauge.values.arrays import Floats
from workgauge.values.measurements import ToolLine


def unit_direction(line: ToolLine | None) -> Floats | None:
    """Return the line's direction (3,) as a unit vector, or None if there is no line or it is no line."""
    if line is None or line.start_site.shape != (3,) or line.direction_site.shape != (3,):
        return None
    if not (np.isfinite(line.start_site).all() and np.isfinite(line.direction_site).all()):
        return None
    length = math.sqrt(float(line.direction_site @ line.direction_site))
    return line.direction_site / length if 1e-9 < length < 1e9 else None


def line_twist(
    start: Floats,
    direction: Floats,
    T_site_tool: Floats,
    R_site_kept: Floats,
    *,
    share: float,
    speed: float,
    turn: float,
    gain: float,
) -> Floats:
    """Return the tool's wanted twist (6,) [m/s, rad/s] in the site's axes.

    Along the line at `share * speed`, from wherever the tool is; across it `gain` times what the tool is off the
    line; turning, `gain` times what the tool is turned off `R_site_kept`. The corrections are proportional to the
    measured error, remember nothing and are never faster than the lever asks along the line: with the lever in the
    middle nothing moves, and a machine that is held back does not wind up.

    Args:
        start, direction: (3,) a point of the line and its unit vector, site frame [m].
        T_site_tool: (4, 4) measured tool pose. R_site_kept: (3, 3) orientation to keep.
        share: the lever, -1 to 1. speed: along the line at the full lever [m/s]. turn: fastest turning [rad/s].
        gain: corrections per second [1/s].
    """
    off = start - T_site_tool[:3, 3]
    across = off - (off @ direction) * direction
    twist = np.empty(6)
    twist[:3] = share * speed * direction + _at_most(gain * across, abs(share) * speed)
    twist[3:] = _at_most(gain * rotation_vector(R_site_kept @ T_site_tool[:3, :3].T), abs(share) * turn)
    return twist


def rotation_vector(R: Floats) -> Floats:
    """Return axis times angle (3,) [rad] of a rotation (3, 3). At exactly half a turn the axis is lost: zero."""
    sine = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    length = math.sqrt(float(sine @ sine))
    if length < 1e-12:
        return sine
    cosine = 0.5 * (float(R[0, 0]) + float(R[1, 1]) + float(R[2, 2]) - 1.0)
    vector: Floats = sine * (math.atan2(length, cosine) / length)
    return vector


def _at_most(vector: Floats, longest: float) -> Floats:
    length = math.sqrt(float(vector @ vector))
    if longest == 0.0:
        return np.zeros(3)
    return vector * (longest / length) if length > longest else vector
