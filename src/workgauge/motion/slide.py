"""Automatic motion along limits and past them: what is wanted, bent so that no clearance is used up too fast.

The guard lets through what stops in time and holds back the rest; it moves no joint that was not asked to. So it is
motion that has to ask for something else. Here the wanted joint velocity is replaced by the nearest one, as the tool
would feel it, that approaches every limit no faster than its room allows; and where little of it is left, a
circulating velocity along the limit is added, so that the tool goes round what stands in its way. None of this is
safety: rows are those of the present posture alone, and the guard judges what comes out.
"""

from dataclasses import dataclass

import daqp
import numpy as np

from workgauge.motion.inverse import Damping, damped_inverse
from workgauge.values.arrays import Floats

_UNBOUNDED = 1e30
#: A limit with a multiplier below this share of the largest holds nothing back.
_HOLDS = 1e-3


@dataclass(frozen=True, slots=True)
class SlideSettings:
    """How motion bends before limits.

    Attributes:
        keep_m: room left above the stop distance, for the guard not to be needed.
        ahead_s: at most so much of the room is used up in this time: e-fold. Dead time and lag are added to it.
        turn_m: so many metres of the tool weigh as much as one radian; large keeps the orientation.
        blocked: below this share of what is wanted the tool counts as blocked and goes round; from `free` on no more.
        around_m_s: the circulating speed.
    """

    keep_m: float = 0.05
    ahead_s: float = 0.4
    turn_m: float = 2.0
    blocked: float = 0.3
    free: float = 0.7
    around_m_s: float = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Surround:
    """What motion knows of the limits around.

    Attributes:
        rows: (k, n), `d(room)/dt = row @ qdot`. room: (k,) clearance less protection level and stop distance [m].
        normals: (k, 3) way out of each, machine frame. names: (k) limit ids, for reasons. links: (k) link names.
    """

    rows: Floats
    room: Floats
    normals: Floats
    names: tuple[str, ...]
    links: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Slid:
    """What is asked for instead.

    Attributes:
        velocity: (n,) [rad/s, m/s].
        left: share of the wanted velocity that is left, as the tool feels it, 0 to 1; without what goes round.
        against: index of the limit that holds most of it back, -1 for none.
        around: (3,) unit direction of the circulating velocity in the machine frame, zeros for none.
    """

    velocity: Floats
    left: float
    against: int
    around: Floats


def slid(
    wish: Floats,
    J: Floats,
    low: Floats,
    high: Floats,
    surround: Surround,
    settings: SlideSettings,
    *,
    late_s: float,
    goal: Floats,
    around: Floats | None,
) -> Slid:
    """Return the velocity nearest to a wish that leaves every clearance its due, and goes round what blocks it.

    Args:
        wish: (n,) joint velocities. J: (6, n) of the tool, machine frame.
        low, high: (n,) joint velocities that may be asked for, low at most 0, high at least 0.
        surround: see there. late_s: dead time and lag of the joints [s].
        goal: (3,) where the tool wants to go, from where it is, machine frame; length does not matter.
        around: (3,) the direction it goes round in already, zeros for none; None if it is not to go round.
    """
    floors = -np.maximum(surround.room - settings.keep_m, 0.0) / (settings.ahead_s + late_s)
    if (surround.rows @ wish >= floors).all() and (wish >= low).all() and (wish <= high).all():
        return Slid(wish, 1.0, -1, np.zeros(3))
    metric = _metric(J, settings.turn_m)
    near = np.flatnonzero(np.minimum(surround.rows * low, surround.rows * high).sum(axis=1) < floors)
    rows, floors = surround.rows[near], floors[near]
    plain, weights = _nearest(wish, metric, rows, floors, low, high)
    whole = float(wish @ metric @ wish)
    left = min(max(float(wish @ metric @ plain) / whole, 0.0), 1.0) if whole > 0.0 else 1.0
    heavy = weights.max(initial=0.0)
    against = int(near[np.argmax(weights)]) if heavy > 0.0 else -1
    going = around is not None and bool(around.any())
    if around is None or against < 0 or left >= settings.free or (left >= settings.blocked and not going):
        return Slid(plain, left, against, np.zeros(3))
    normal = weights[weights > _HOLDS * heavy] @ surround.normals[near][weights > _HOLDS * heavy]
    inverse = damped_inverse(J, Damping())
    best, best_score, chosen = plain, -np.inf, np.zeros(3)
    for direction in _tangents(normal, around):
        twist = np.concatenate([settings.around_m_s * direction, np.zeros(3)])
        asked = np.minimum(np.maximum(plain + inverse @ twist, low), high)
        found, _ = _nearest(asked, metric, rows, floors, low, high)
        moved = J[:3] @ (found - plain)
        score = float(direction @ moved) / settings.around_m_s
        if going:
            score += 2.0 * float(direction @ around)
        else:
            score += float(direction @ goal) / max(float(np.linalg.norm(goal)), 1e-9)
        if score > best_score:
            best, best_score, chosen = found, score, direction
    return Slid(best, left, against, chosen)


def _metric(J: Floats, turn_m: float) -> Floats:
    """Return the metric (n, n) of joint velocities as the tool feels them, and a little of every joint's own."""
    felt = np.concatenate([J[:3], turn_m * J[3:]])
    metric: Floats = felt.T @ felt
    own = metric.reshape(-1)[:: J.shape[1] + 1]
    own += 0.05**2 * max(float(own.max(initial=0.0)), 1e-6)
    return metric


def _nearest(
    wish: Floats, metric: Floats, rows: Floats, floors: Floats, low: Floats, high: Floats
) -> tuple[Floats, Floats]:
    """Return the point of the box nearest to a wish that keeps the rows, and the weights (k,) of the rows.

    Zero always qualifies; should the solver fail, what of the wish keeps every row is taken along its ray.
    """
    n, k = len(wish), len(rows)
    clipped = np.minimum(np.maximum(wish, low), high)
    if not k and (clipped == wish).all():
        return clipped, np.zeros(0)
    upper, lower = np.concatenate([high, np.full(k, _UNBOUNDED)]), np.concatenate([low, floors])
    found, _, flag, info = daqp.solve(metric, -(metric @ wish), np.ascontiguousarray(rows), upper, lower)
    if flag >= 1 and np.isfinite(found).all():
        point = np.minimum(np.maximum(found, low), high)
        if (rows @ point >= floors - 1e-6).all():
            return point, np.maximum(-info["lam"][n:], 0.0)
    change = rows @ clipped
    over = change < floors
    share = float((floors[over] / change[over]).min(initial=1.0))
    return max(share, 0.0) * clipped, over.astype(np.float64)


def _tangents(normal: Floats, around: Floats) -> list[Floats]:
    """Return unit directions along a limit: level both ways, and up and down it; or the one gone in already.

    What is gone round in is kept, turned into the plane of the limit, as long as it lies in it at all.
    """
    length = float(np.linalg.norm(normal))
    out = normal / length if length > 0.0 else np.array([1.0, 0.0, 0.0])
    if around.any():
        kept = around - (around @ out) * out
        size = float(np.linalg.norm(kept))
        if size > 0.3:
            return [kept / size]
    level = np.cross(out, [0.0, 0.0, 1.0])
    size = float(np.linalg.norm(level))
    level = level / size if size > 1e-3 else np.array([0.0, 1.0, 0.0])
    up = np.cross(level, out)
    up *= 1.0 if up[2] >= 0.0 else -1.0
    return [level, -level, up, -up]
