"""What the machine is inside of, measured exactly: how deep along the stop in hand, and after a command.

A lower bound proven by a fixed plane is of little use where solids overlap: the least way out turns with the machine,
and jumps from one face to another. So inside, and only there, postures are measured by `Scene.query` itself, before
and after, and may be compared.
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from workgauge.guard.plan import MINUS, PLUS, Plan
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
#: What has less slack than this is measured, too, though it is not violated [m].
NEAR_M = 0.15
#: A command of which less than this share acts by then does not act yet.
_ACTS = 1e-6
#: Joints known better than this are known [rad, m].
_SURE = 1e-7


class Inside:
    """Exact slacks along the stop in hand.

    Slack is what a clearance has above its stop distance, protection level and the guard's margin; it is violated
    below `-floor_m`. Where nobody knows exactly how far the joints will go on, it is measured in the middle of where
    they may be, and at both ends of it: as if what is in flight went on least, and most. Protection levels are those
    of the present.

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
        self._radius_m = max(stop_distance_m, around.scene.largest_stop_m) + margin_m + around.largest_m + NEAR_M
        self._of, self._share = _between(plan.way, around.scene.arm.farthest)
        self._onwards = np.sign(plan.way.postures - q)
        self._ends = (0.0, -1.0, 1.0) if (plan.way.widths * np.abs(self._onwards) > _SURE).any() else (0.0,)
        self._postures = self._fine(plan.way)
        self._acts = plan.acts()
        self._stops, self._protections = self._kept(stop.clearances)
        self._known: dict[bytes, Floats] = {}
        self._looked: dict[bytes, tuple[Clearances, Floats]] = {}
        #: (S, L) slack of each solid and limit at each posture measured, infinite where nothing is near [m].
        self.hand = [self._least(q) for q in self._postures]
        self.violated = np.minimum.reduce(self.hand) < -floor_m
        clearances = stop.clearances
        self._at = np.full(self.violated.shape, -1)
        order = np.argsort(-clearances.distances, kind="stable")
        self._at[clearances.solids[order], clearances.limits[order]] = order
        #: (k,) whether each of the present's clearances is violated somewhere on the way, and so judged here.
        self.judged: NDArray[np.bool_] = self.violated[clearances.solids, clearances.limits]

    @property
    def at_rest(self) -> Floats:
        """Slack (S, L) at the end of the stop in hand [m]."""
        return self.hand[len(self._of) - 1]

    def worsens(self, way: Way) -> bool:
        """Return whether any violated clearance is smaller on another way; its end is looked at first."""
        order = [len(self._of) - 1, *range(len(self._of) - 1), *range(len(self._of), len(self._postures))]
        postures = self._fine(way)
        for p in order:
            q = postures[p]
            same = np.array_equal(q, self._postures[p])
            if not same and float(self._lost(self.hand[p], self._least(q)).max()) > WORSE_M:
                return True
        return False

    def spares(self, command: Floats, alpha: float) -> bool:
        """Return whether a command (n,) uses up no more than a share of any slack that is not violated."""
        for hand, q in zip(self.hand, self._fine(self._plan.way_after(command)), strict=True):
            lost = np.minimum(hand, NEAR_M) - self._least(q)
            if ((lost > alpha * np.maximum(hand, 0.0) + WORSE_M) & ~self.violated).any():
                return False
        return True

    def gained(self, command: Floats) -> float:
        """Return by how much all that is violated at rest grows together by a command (n,) [m]."""
        after = self._least(self._fine(self._plan.way_after(command))[len(self._of) - 1])
        counts = self.at_rest < -self._floor_m
        return float((np.minimum(after, 0.0) - self.at_rest)[counts].sum())

    def cuts(self, command: Floats) -> Rows:
        """Return the rows of what a command (n,) makes worse, where it does, each of which may lose nothing."""
        found, way = [], self._plan.way_after(command)
        for p, (hand, q) in enumerate(zip(self.hand, self._fine(way), strict=True)):
            spoilt = self._lost(hand, self._least(q)) > WORSE_M
            if spoilt.any():
                seen, _ = self._seen(q)
                which = spoilt[seen.solids, seen.limits]
                found.append(self._rows(q, p, seen, which, np.zeros(len(seen))))
        return joined(found) if found else picked(self._stop.rows, np.zeros(len(self._stop.rows.slack), np.bool_))

    def rows(self) -> Rows:
        """Return the rows of what is violated along the stop in hand, where a command may still change it."""
        found = []
        for p, q in enumerate(self._postures):
            seen, slack = self._seen(q)
            found.append(self._rows(q, p, seen, slack < -self._floor_m, slack))
        return joined(found)

    def beyond(self, rows: Rows) -> Rows:
        """Return those of the rows of the stop in hand that belong to what is not near anywhere along it."""
        seen = np.minimum.reduce(self.hand) < np.inf
        clearances = self._stop.clearances
        return picked(rows, ~seen[clearances.solids, clearances.limits][rows.clearances])

    def near(self, rows: Rows) -> Rows:
        """Return rows of the stop in hand with exact clearances' instead, for what is near and not judged here.

        Corners bound a face that turns; the clearance itself moves as its closest point does. So where edges cross,
        ways are left that the corners of both leave none for.
        """
        found = []
        for p, q in enumerate(self._postures[: len(self._of)]):
            seen, slack = self._seen(q)
            which = ~self.violated[seen.solids, seen.limits]
            exact = self._rows(q, p, seen, which, np.maximum(slack, 0.0))
            found.append(replace(exact, room=exact.slack))
        exact = joined(found)
        others = self.outside(rows)
        return joined([exact, picked(others, ~np.isin(others.clearances, exact.clearances))])

    def acting(self, rows: Rows) -> Rows:
        """Return rows as far as a command acts at their postures; without those where it does not yet."""
        acts = self._acts[rows.postures]
        does: NDArray[np.bool_] = np.any(acts > _ACTS, axis=1)
        return picked(replace(rows, rows=rows.rows * acts), does)

    def changes(self, rows: Rows) -> tuple[Floats, Floats]:
        """Return by how much every joint's full positive and negative speed change slacks, see `Plan.changes`."""
        found = self._plan.changes(rows)
        return found[PLUS], found[MINUS]

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

    def _kept(self, present: Clearances) -> tuple[Floats, Floats]:
        """Return what is kept to each limit (L,), and the protection level of each solid and limit (S, L) [m]."""
        scene = self._around.scene
        stops = np.where(np.isnan(scene.stop_distances), self._default_m, scene.stop_distances)
        levels = np.full((len(scene.machine.solids), len(stops)), self._around.largest_m)
        if len(present):
            known = np.full(levels.shape, -np.inf)
            np.maximum.at(known, (present.solids, present.limits), present.protections)
            levels = np.where(known >= 0.0, known, levels)
        return stops + self._margin_m, levels

    def _least(self, q: Floats) -> Floats:
        key = q.tobytes()
        if key not in self._known:
            distances = self._around.least(self._around.machine.forward(q), self._radius_m)
            self._known[key] = distances - self._protections - self._stops
        return self._known[key]

    def _seen(self, q: Floats) -> tuple[Clearances, Floats]:
        """Return the clearances at a posture, and the slack of each (k,)."""
        key = q.tobytes()
        if key not in self._looked:
            found = self._around.look(self._around.machine.forward(q), self._radius_m)
            slack = found.distances - self._protections[found.solids, found.limits] - self._stops[found.limits]
            self._looked[key] = found, slack
        return self._looked[key]

    def _lost(self, hand: Floats, after: Floats) -> Floats:
        """Return (S, L) by how much each slack falls short of what it was, or of what must be left."""
        lost: Floats = np.minimum(hand, -self._floor_m) - after
        return lost

    def _rows(self, q: Floats, p: int, seen: Clearances, which: NDArray[np.bool_], slack: Floats) -> Rows:
        machine = self._around.machine
        rows = machine.distance_rows(machine.forward(q), self._around.T_site_machine, seen)
        at = self._at[seen.solids, seen.limits]
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
