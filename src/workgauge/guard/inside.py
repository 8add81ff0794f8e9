"""What the machine is inside of, measured exactly: how deep along the stop in hand, and after a command.

A lower bound proven by a fixed plane is of little use where solids overlap: the least way out turns with the machine,
and jumps from one face to another. So inside, and only there, postures are measured by `Scene.query` itself, before
and after, and may be compared.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from workgauge.guard.plan import Plan
from workgauge.proximity.stops import Rows, Stop, Way
from workgauge.proximity.surroundings import Surroundings
from workgauge.values.arrays import Floats, Ints
from workgauge.values.clearances import Clearances

#: No clearance that is violated may be smaller by more than this after a command [m].
WORSE_M = 1e-6
#: No corner moves farther between two postures measured [m].
SPACING_M = 0.05
#: At most so many postures are measured between two that are looked at anyway.
_MOST_BETWEEN = 8
#: A command of which less than this share acts by then does not act yet.
_ACTS = 1e-6
#: Joints known better than this are known [rad, m].
_SURE = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Clearances at one posture, of each solid and limit the least.

    Attributes:
        clearances: as measured. least: (S, L) slack, infinite where nothing is near [m]. slack: (k,) of each [m].
    """

    clearances: Clearances
    least: Floats
    slack: Floats


class Inside:
    """Exact slacks along the stop in hand.

    Slack is what a clearance has above its stop distance, protection level and the guard's margin; it is violated
    below `-floor_m`. Where nobody knows exactly how far the joints will go on, it is measured in the middle of where
    they may be, and at both ends of it: as if what is in flight went on least, and most.

    Args:
        around: the surroundings. q: (n,) the present posture. plan: whose way to rest without a command is the stop
            in hand. stop: that stop.
        stop_distance_m: for limits that have none of their own. margin_m: kept besides.
        floor_m: a verified stop may use up so much of it.
    """

    def __init__(
        self,
        around: Surroundings,
        q: Floats,
        plan: Plan,
        stop: Stop,
        *,
        stop_distance_m: float,
        margin_m: float,
        floor_m: float,
    ) -> None:
        self._around, self._plan, self._stop = around, plan, stop
        self._default_m, self._margin_m, self._floor_m = stop_distance_m, margin_m, floor_m
        self._radius_m = max(stop_distance_m, around.scene.largest_stop_m) + margin_m + around.largest_m + 0.01
        self._of, self._share = _between(plan.way, around.scene.arm.farthest)
        self._onwards = np.sign(plan.way.postures - q)
        self._ends = (0.0, -1.0, 1.0) if (plan.way.widths * np.abs(self._onwards) > _SURE).any() else (0.0,)
        self._postures = self._fine(plan.way)
        self._acts = plan.acts()
        self._known: dict[bytes, Measured] = {}
        self.hand = [self._measured(q) for q in self._postures]
        least = np.minimum.reduce([one.least for one in self.hand])
        self.violated = least < -floor_m
        clearances = stop.clearances
        self._at = np.full(least.shape, -1)
        order = np.argsort(-clearances.distances, kind="stable")
        self._at[clearances.solids[order], clearances.limits[order]] = order
        #: (k,) whether each of the present's clearances is violated somewhere on the way, and so judged here.
        self.judged: NDArray[np.bool_] = self.violated[clearances.solids, clearances.limits]

    def worse(self, way: Way) -> float:
        """Return by how much the violated clearance that suffers most is smaller after another way [m]."""
        worst = -math.inf
        for hand, q, before in zip(self.hand, self._fine(way), self._postures, strict=True):
            if not np.array_equal(q, before):
                worst = max(worst, float(self._lost(hand, self._measured(q)).max()))
        return worst

    def gained(self, command: Floats) -> float:
        """Return by how much all that is violated at rest grows together by a command (n,) [m]."""
        hand, after = (
            self.hand[len(self._of) - 1],
            self._measured(self._fine(self._plan.way_after(command))[len(self._of) - 1]),
        )
        counts = hand.least < -self._floor_m
        return float((np.minimum(after.least, 0.0) - hand.least)[counts].sum())

    def cuts(self, command: Floats) -> Rows:
        """Return the rows of what a command (n,) makes worse, where it does, each of which may lose nothing."""
        found, way = [], self._plan.way_after(command)
        for p, (hand, q) in enumerate(zip(self.hand, self._fine(way), strict=True)):
            after = self._measured(q)
            spoilt = self._lost(hand, after) > WORSE_M
            which = spoilt[after.clearances.solids, after.clearances.limits]
            found.append(self._rows(q, p, after, which, np.zeros(len(after.slack))))
        return joined(found)

    def rows(self) -> Rows:
        """Return the rows of what is violated along the stop in hand, where a command may still change it."""
        found = []
        for p, (hand, q) in enumerate(zip(self.hand, self._postures, strict=True)):
            which = hand.slack < -self._floor_m
            found.append(self._rows(q, p, hand, which, hand.slack))
        return joined(found)

    def acting(self, rows: Rows) -> Rows:
        """Return rows as far as a command acts at their postures; without those where it does not yet."""
        acts = self._acts[rows.postures]
        does: NDArray[np.bool_] = np.any(acts > _ACTS, axis=1)
        return picked(replace(rows, rows=rows.rows * acts), does)

    def outside(self, rows: Rows) -> Rows:
        """Return those of the rows of the stop in hand that are not judged here; none of them counts as violated."""
        others = picked(rows, ~self.judged[rows.clearances])
        return replace(others, slack=np.maximum(others.slack, 0.0))

    def _fine(self, way: Way) -> Floats:
        """Return postures (F, n) to be measured on a way: those of its middle, then those of either end."""
        after = np.minimum(self._of + 1, len(way.postures) - 1)
        found = []
        for end in self._ends:
            coarse = way.postures + end * self._onwards * way.widths
            found.append(coarse[self._of] + self._share[:, None] * (coarse[after] - coarse[self._of]))
        return np.concatenate(found)

    def _measured(self, q: Floats) -> Measured:
        key = q.tobytes()
        if key not in self._known:
            clearances = self._around.look(self._around.machine.forward(q), self._radius_m)
            stops = np.where(np.isnan(clearances.stop_distances), self._default_m, clearances.stop_distances)
            slack = clearances.distances - clearances.protections - stops - self._margin_m
            least = np.full((len(self._around.machine.solids), len(clearances.limit_ids)), np.inf)
            np.minimum.at(least, (clearances.solids, clearances.limits), slack)
            self._known[key] = Measured(clearances, least, slack)
        return self._known[key]

    def _lost(self, hand: Measured, after: Measured) -> Floats:
        """Return (S, L) by how much each slack falls short of what it was, or of what must be left."""
        lost: Floats = np.minimum(hand.least, -self._floor_m) - after.least
        return lost

    def _rows(self, q: Floats, p: int, seen: Measured, which: NDArray[np.bool_], slack: Floats) -> Rows:
        machine, clearances = self._around.machine, seen.clearances
        rows = machine.distance_rows(machine.forward(q), self._around.T_site_machine, clearances)
        at = self._at[clearances.solids, clearances.limits]
        which = which & (at >= 0)
        k, p = int(which.sum()), p % len(self._of)
        posture = self._of[p] + int(self._share[p] > 0.0)
        return Rows(*(slack[which], np.zeros(k), rows[which], np.full(k, posture), at[which], np.ones(k, np.bool_)))


def joined(parts: list[Rows]) -> Rows:
    """Return all rows of several sets, in order."""
    return Rows(
        *(np.concatenate([part.slack for part in parts]), np.concatenate([part.room for part in parts])),
        *(np.concatenate([part.rows for part in parts]), np.concatenate([part.postures for part in parts])),
        *(np.concatenate([part.clearances for part in parts]), np.concatenate([part.inside for part in parts])),
    )


def picked(rows: Rows, which: NDArray[np.bool_]) -> Rows:
    """Return some of the rows."""
    return Rows(
        *(rows.slack[which], rows.room[which], rows.rows[which], rows.postures[which]),
        *(rows.clearances[which], rows.inside[which]),
    )


def _between(way: Way, farthest: Floats) -> tuple[Ints, Floats]:
    """Return where postures are to be measured: after which of a way's, and at what share of the step from there."""
    of, share = [], []
    for p in range(len(way.postures) - 1):
        moved = float(np.abs(way.postures[p + 1] - way.postures[p]) @ farthest)
        count = min(max(math.ceil(moved / SPACING_M), 1), _MOST_BETWEEN)
        of += [p] * count
        share += [k / count for k in range(count)]
    return np.array([*of, len(way.postures) - 1]), np.array([*share, 0.0])
