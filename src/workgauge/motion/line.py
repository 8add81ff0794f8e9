"""A straight tool path driven by hand: one lever is the speed along it, the loop is closed on the measured tool."""

import math

import numpy as np

from workgauge.values.arrays import Floats
from workgauge.values.measurements import ToolLine

Vector = tuple[float, float, float]


def unit_direction(line: ToolLine | None) -> Floats | None:
    """Return the line's direction (3,) as a unit vector, or None if there is no line or it is no line."""
    if line is None or line.start_site.shape != (3,) or line.direction_site.shape != (3,):
        return None
    length = math.hypot(*line.direction_site.tolist())
    if not math.isfinite(math.hypot(*line.start_site.tolist())):
        return None
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
    off = (start - T_site_tool[:3, 3]).tolist()
    x, y, z = direction.tolist()
    along = off[0] * x + off[1] * y + off[2] * z
    across = _at_most(gain, (off[0] - along * x, off[1] - along * y, off[2] - along * z), abs(share) * speed)
    turning = _at_most(gain, rotation_vector(R_site_kept @ T_site_tool[:3, :3].T), abs(share) * turn)
    forward = share * speed
    return np.array([forward * x + across[0], forward * y + across[1], forward * z + across[2], *turning])


def rotation_vector(R: Floats) -> Vector:
    """Return axis times angle (3) [rad] of a rotation (3, 3). At exactly half a turn the axis is lost: zero."""
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    sine = 0.5 * (h - f), 0.5 * (c - g), 0.5 * (d - b)
    length = math.hypot(*sine)
    if length < 1e-12:
        return sine
    scale = math.atan2(length, 0.5 * (a + e + i - 1.0)) / length
    return sine[0] * scale, sine[1] * scale, sine[2] * scale


def _at_most(gain: float, vector: Vector, longest: float) -> Vector:
    """Return `gain` times the vector, shortened to `longest`."""
    length = gain * math.hypot(*vector)
    factor = gain if length <= longest else gain * longest / length
    return vector[0] * factor, vector[1] * factor, vector[2] * factor
