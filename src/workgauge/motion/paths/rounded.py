"""Straight joint lines from posture to posture, their corners rounded where that is known to be free."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from workgauge.machine.model import MachineModel
from workgauge.motion.paths.joint_curve import JointCurve
from workgauge.values.arrays import Floats

#: Whether a corner may be rounded: it is given the postures (n,) where the rounding begins, the corner, and where it
#: ends. The rounding is the parabola with these three as its control points.
Kept = Callable[[Floats, Floats, Floats], bool]

#: A corner is rounded over this share of what there is room for, the first that may be.
SHARES = (1.0, 0.5, 0.25, 0.12, 0.06, 0.03)
#: A corner that turns back so much that less than this share of full speed would be left inside it is none to round.
TURNS_BACK = 0.2
#: Slopes that differ by less than this share of full speed make no corner.
_STRAIGHT = 1e-9


def rounded(q: Floats, machine: MachineModel, kept: Kept | None) -> tuple[JointCurve, Floats]:
    """Return the way along straight lines through postures, and the path values (k,) of corners that stay sharp.

    The path variable counts one for the time a line takes at its slowest joint's full speed. A rounded corner leaves
    its two lines equally long before and after it, by that measure, and no more than half of either; joints turn
    evenly from one line's slope to the other's (a parabola). Between joints that cannot move together, and where the
    way turns back, a corner stays sharp.

    Args:
        q: (m, n) postures, no two in a row the same. kept: which corners may be rounded, None for none.
    """
    steps = np.diff(q, axis=0)
    legs = np.maximum(steps / machine.speed_positive, -steps / machine.speed_negative).max(axis=1)
    s = np.concatenate([[0.0], np.cumsum(legs)])
    slopes = steps / legs[:, None]
    bends = np.abs(np.diff(slopes, axis=0)).max(axis=1, initial=0.0) > _STRAIGHT
    moves = steps != 0.0
    alone = clashing(machine, moves[:-1] | moves[1:]) >= 0
    way, stops = _Way(q[0], float(s[-1])), []
    for i in range(1, len(legs)):
        before, after, at = slopes[i - 1], slopes[i], float(s[i])
        if not bends[i - 1]:
            continue
        room = 0.5 * float(min(legs[i - 1], legs[i]))
        sharp = kept is None or alone[i - 1] or _slowest(before, after, machine) < TURNS_BACK
        halves = [] if sharp else [share * room for share in SHARES]
        for half in halves:
            a, b = q[i] - half * before, q[i] + half * after
            if kept is not None and kept(a, q[i], b):
                way.to(at - half, a, before, before)
                way.to(at + half, b, before, after)
                break
        else:
            way.to(at, q[i], before, before)
            stops.append(at)
    way.to(float(s[-1]), q[-1], slopes[-1], slopes[-1])
    return JointCurve.of(*(np.array(part) for part in (way.s, way.q, way.leaving, way.arriving))), np.array(stops)


def _slowest(before: Floats, after: Floats, machine: MachineModel) -> float:
    """Return the least slope of a rounding between two slopes (n,), in shares of full speed."""
    a, b = before / machine.speed_positive, after / machine.speed_positive
    way = b - a
    half = min(max(-float(a @ way) / float(way @ way), 0.0), 1.0)
    return float(np.linalg.norm(a + half * way))


def clashing(machine: MachineModel, moves: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return which exclusive group (k,) moves with one that excludes it, by which joints (k, n) move; -1 for none."""
    found = np.full(len(moves), -1, dtype=np.int64)
    for g, group in enumerate(machine.exclusive_groups):
        rest = [j for other in machine.exclusive_groups if other is not group for j in other if j not in group]
        found[moves[:, list(group)].any(axis=1) & moves[:, rest].any(axis=1)] = g
    return found


class _Way:
    """A curve being put together, piece by piece."""

    def __init__(self, start: Floats, length: float) -> None:
        self._least = 1e-12 * length
        self.s, self.q = [0.0], [start]
        self.leaving: list[Floats] = []
        self.arriving: list[Floats] = []

    def to(self, s: float, q: Floats, leaving: Floats, arriving: Floats) -> None:
        """Go on to a path value and posture, unless that is where it is."""
        if s > self.s[-1] + self._least:
            self.s.append(s)
            self.q.append(q)
            self.leaving.append(leaving)
            self.arriving.append(arriving)
