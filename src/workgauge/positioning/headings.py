"""Two headings, a heading and a course, antennas the right way round: what can be compared, and what it shows.

**What shows exchanged antennas.** Their baseline keeps its length and its line, only its sense is turned, so length
never shows it. Evidence is whatever knows the machine's forward direction or its tilt by other means:

* on rails, the track: a machine that faces the way it was set on the rails has the track's heading or it has not;
* another receiver's heading, or a compass;
* the course over ground, once the machine travels faster than its noise and it is known which way the gear is set:
  without that, a course fits a heading and its opposite alike, and shows only that the heading is *across*;
* heights: antennas mounted at different heights, or a machine that stands on a slope or cant measured by its
  inclinometer, must show the height difference with the right sign. On the level with antennas of one height there
  is none to see: two antennas and an inclinometer alone can then not tell.
"""

import math

import numpy as np

from workgauge.values.arrays import Floats


def turned(angle: float) -> float:
    """Return an angle in (-pi, pi] [rad]; NaN stays NaN."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


def heading_difference(measured: float, known: float) -> float:
    """Return measured less known heading, (-pi, pi] [rad]; NaN if either is."""
    return turned(measured - known)


def course_difference(
    heading: float, course: float, speed_m_s: float, fastest_standing_m_s: float, forward: bool | None
) -> float:
    """Return heading less the course over ground, or NaN while the machine does not travel [rad].

    Args:
        heading, course: both from the same north [rad].
        speed_m_s: over ground; a course below `fastest_standing_m_s` is noise.
        forward: whether the gear is set forwards; None if nothing says so: then the nearer of both senses counts, and
            exchanged antennas do not show.
    """
    if not speed_m_s > fastest_standing_m_s:
        return math.nan
    if forward is not None:
        return turned(heading - (course if forward else course + math.pi))
    along = turned(heading - course)
    return along if abs(along) <= math.pi / 2 else turned(along + math.pi)


def course_sigma(speed_m_s: float, velocity_sigma_m_s: float) -> float:
    """Return the 1-sigma of a course: velocity's over speed, at most a uniform angle's pi / sqrt 3 [rad]."""
    worst = math.pi / math.sqrt(3.0)
    if not speed_m_s > 0.0:
        return worst
    return min(worst, velocity_sigma_m_s / speed_m_s)


def opposite(difference: float, tolerance: float) -> bool:
    """Return whether a heading stands the other way round, within a tolerance [rad]; False for NaN."""
    return math.pi - abs(turned(difference)) <= tolerance


def turned_by_heights(measured: Floats, expected: Floats, covariance: Floats, sigmas: float) -> bool | None:
    """Return whether the heights show exchanged antennas: True, False, or None if they cannot tell.

    A baseline that is turned about has the negative of the height difference it should have. The better of both
    hypotheses counts, if the two lie far enough apart to be told: `2 |h| > sigmas * sigma_h`, and if the measured
    height difference lies within `sigmas` of it.

    Args:
        measured: (3,) baseline, master to rover, east, north, up [m].
        expected: (3,) what the known places on the machine, its tilt and the measured heading make of it.
        covariance: (3, 3) of their difference. sigmas: how many count as certain.
    """
    sigma = math.sqrt(max(0.0, float(np.asarray(covariance)[2, 2])))
    up, right = float(measured[2]), float(expected[2])
    if not math.isfinite(up + right + sigma) or not 2.0 * abs(right) > sigmas * sigma:
        return None
    wrong_way, right_way = abs(up + right), abs(up - right)
    if min(wrong_way, right_way) > sigmas * sigma:
        return None
    return wrong_way < right_way
