"""The protection level of every clearance, in compiled code; what it means is said in `protection`."""

import math
from typing import Any

import numpy as np

from workgauge.proximity.search import placed
from workgauge.values.compiled import njit


@njit(cache=True)
def own_variances(variances: Any, of: Any, links: Any, others: Any, tool_link: int, tool_variance: float) -> Any:
    """Return the variance (c,) of each clearance that has no direction [m^2]: the limit's, and the attachment's.

    variances: of the limits. of, links, others: (c,) limit, link and other link. tool_link: carries the attachment.
    """
    found = np.empty(len(of))
    for c in range(len(of)):
        found[c] = variances[of[c]]
        if links[c] == tool_link or others[c] == tool_link:
            found[c] += tool_variance
    return found


@njit(cache=True)
def sure_levels(
    variances: Any, of: Any, links: Any, others: Any, tool_link: int, tool_variance: float, k: float, bias: float
) -> Any:
    """Return the levels (c,) where pose, joints and limits' poses are exact [m]; see `own_variances`."""
    levels = own_variances(variances, of, links, others, tool_link, tool_variance)
    for c in range(len(levels)):
        levels[c] = k * math.sqrt(levels[c]) + bias
    return levels


@njit(cache=True)
def protection_levels(
    T: Any,
    spatial: Any,
    boxes: Any,
    clearances: Any,
    rows: Any,
    covariance: Any,
    turned: Any,
    limits: Any,
    k: float,
    variances: Any,
    largest_turn: float,
) -> Any:
    """Return the levels (c,) without bias [m].

    Args:
        T: (4, 4) site from machine. spatial: (6, n), of `Kinematics`. boxes: poses (S, 4, 4) and half extents (S, 3)
            in the machine frame, and (e, 5) which stretch, see `machine.frames.distance_rows`.
        clearances: normals, points on the machine, points on the limit (c, 3), links, other links, limits, solids.
        rows: (c, n). covariance: (6 + n, 6 + n). turned: sigma of what turns each link (n + 1,), of all joints
            together, the largest lever arm, sigma of all sliding joints.
        limits: poses, places, covariances of `LimitUncertainty`. k: factor. variances: (c,) of no place and turn.
        largest_turn: beyond it a level is infinite [rad].
    """
    poses, halves, stretches = boxes
    normals, points, on_limit, links, others, of, solids = clearances
    turns, own_turn, arm, slide = turned
    limit_poses, places, limit_covariances = limits
    n, corners = spatial.shape[1], placed(T, poses, halves)[1]
    turning = np.empty((3, n))
    for j in range(n):
        for i in range(3):
            turning[i, j] = T[i, 0] * spatial[3, j] + T[i, 1] * spatial[4, j] + T[i, 2] * spatial[5, j]
    levels = np.empty(len(normals))
    away, gradient, cross = np.empty((3, 6 + n)), np.empty(6 + n), np.zeros((3, 3))
    slope, curve = np.empty(3), np.empty((3, 3))
    for c in range(len(normals)):
        u, x, s, which = normals[c], points[c], solids[c], limit_poses[of[c]]
        cross[0, 1], cross[0, 2], cross[1, 2] = -u[2], u[1], -u[0]
        cross[1, 0], cross[2, 0], cross[2, 1] = u[2], -u[1], u[0]
        _motions(T, poses, halves, stretches, turning, u, x, s, links[c], others[c], cross, rows[c], away, gradient)
        variance = variances[c] + _square(gradient, covariance, gradient)
        for a in range(3):
            slope[a] = 2.0 * _square(away[a], covariance, gradient)
            for b in range(3):
                curve[a, b] = _square(away[a], covariance, away[b])
        turn, lever = turns[links[c]] if others[c] < 0 else own_turn, arm
        if which >= 0:
            more, far, own = _own_pose(u, on_limit[c] - places[which], cross, limit_covariances[which], slope, curve)
            variance, lever, turn = variance + more, lever + far, turn + own
        levels[c] = _worst(k, corners[s], x, u, variance, slope, curve)
        angle = k * turn
        if angle <= largest_turn:
            levels[c] += 0.5 * angle * (angle * lever + 2.0 * k * slide)
        else:
            levels[c] = math.inf
    return levels


@njit(cache=True)
def _square(first: Any, matrix: Any, second: Any) -> float:
    """Return `first @ matrix @ second`."""
    total = 0.0
    for a in range(len(first)):
        if first[a] != 0.0:
            part = 0.0
            for b in range(len(second)):
                part += matrix[a, b] * second[b]
            total += first[a] * part
    return total


@njit(cache=True)
def _motions(
    T: Any,
    poses: Any,
    halves: Any,
    stretches: Any,
    turning: Any,
    u: Any,
    x: Any,
    s: int,
    link: int,
    other: int,
    cross: Any,
    row: Any,
    away: Any,
    gradient: Any,
) -> None:
    """Fill the gradient (6 + n) of the closest point and away (3, 6 + n): a point off it by v has `v @ away` more."""
    for a in range(3):
        gradient[a] = u[a] if other < 0 else 0.0
        for b in range(3):
            away[a, b] = 0.0
            away[a, 3 + b] = cross[a, b] if other < 0 else 0.0
    for b in range(3):
        gradient[3 + b] = 0.0
        for a in range(3):
            gradient[3 + b] += (x[a] - T[a, 3]) * away[a, 3 + b]
    for j in range(len(row)):
        gradient[6 + j] = row[j]
        carried = (1.0 if j < link else 0.0) - (1.0 if j < other else 0.0)
        for a in range(3):
            away[a, 6 + j] = carried * (
                cross[a, 0] * turning[0, j] + cross[a, 1] * turning[1, j] + cross[a, 2] * turning[2, j]
            )
    for e in range(len(stretches)):
        if stretches[e, 0] != s:
            continue
        joint, axis, along = stretches[e, 2], stretches[e, 3], 0.0
        for a in range(3):
            along += u[a] * _outwards(T, poses[s], a, axis, stretches[e, 4])
        for a in range(3):
            away[a, 6 + joint] += along * _outwards(T, poses[s], a, axis, stretches[e, 4]) / (2.0 * halves[s, axis])


@njit(cache=True)
def _outwards(T: Any, pose: Any, a: int, axis: int, side: int) -> float:
    """Return component a, in the site, of a box's axis."""
    return float(side * (T[a, 0] * pose[0, axis] + T[a, 1] * pose[1, axis] + T[a, 2] * pose[2, axis]))


@njit(cache=True)
def _own_pose(u: Any, apart: Any, cross: Any, covariance: Any, slope: Any, curve: Any) -> Any:
    """Add what a limit's own pose does to slope and curve; return its variance, lever arm and sigma of its turn."""
    gradient, crossed = np.empty(6), np.zeros((3, 6))
    crossed[:, 3:] = cross
    for b in range(3):
        gradient[b], gradient[3 + b] = u[b], 0.0
        for a in range(3):
            gradient[3 + b] += apart[a] * cross[a, b]
    for a in range(3):
        slope[a] += 2.0 * _square(crossed[a], covariance, gradient)
        for b in range(3):
            curve[a, b] += _square(crossed[a], covariance, crossed[b])
    far = math.sqrt(apart[0] ** 2 + apart[1] ** 2 + apart[2] ** 2)
    own = math.sqrt(covariance[3, 3] + covariance[4, 4] + covariance[5, 5])
    return _square(gradient, covariance, gradient), far, own


@njit(cache=True)
def _worst(k: float, corners: Any, x: Any, u: Any, variance: float, slope: Any, curve: Any) -> float:
    """Return the largest `k sigma(v) - u . v` over v = 0 and the offsets v of corners (8, 3) that lie farther out.

    `sigma(v)^2 = variance + slope . v + v . curve v`.
    """
    most, v = k * math.sqrt(max(variance, 0.0)), np.empty(3)
    for i in range(8):
        beyond, square = 0.0, variance
        for a in range(3):
            v[a] = corners[i, a] - x[a]
            beyond += v[a] * u[a]
        for a in range(3):
            square += v[a] * (slope[a] + curve[a, 0] * v[0] + curve[a, 1] * v[1] + curve[a, 2] * v[2])
        most = max(most, k * math.sqrt(max(square, 0.0)) - max(beyond, 0.0))
    return most
