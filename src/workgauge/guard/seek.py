"""Seeking a way out: directions by linear programmes, believed only if the command that follows them verifies."""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from workgauge.guard.api import GuardInput
from workgauge.guard.exit import Exit, Pinned, WayOut, room, way_out
from workgauge.guard.inside import Inside, joined, picked
from workgauge.proximity.stops import Rows, Stop
from workgauge.values.arrays import Floats
from workgauge.values.clearances import Clearances

#: For a way out, a joint is at its end where that leaves less than this share of its speed.
AT_END = 0.01
#: What is tried of a way out's speed, one after the other: the shorter a step, the straighter its way.
SHARES = (1.0, 0.7, 0.5, 0.35, 0.25, 0.15, 0.1, 0.06, 0.02)
#: A way out gains at least so much [m/s]; a step along it, this share of what its direction promises.
LEAST_M_S, KEPT = 1e-3, 0.25
#: One that gains no more, all clearances together, is a creep: what rounds the valves costs as much [m/s].
CREEP_M_S = 2e-3
#: A way out that gains so much, all clearances together, is taken at once; otherwise others are sought, too [m/s].
ENOUGH_M_S = 0.05
#: Joint speeds that differ less are the same [rad/s, m/s].
SAME = 1e-4
#: So often what refused a way out is taken into account and another sought.
ROUNDS = 8
#: Where bounds refuse a way out, what has less room than this may lose none of it [m].
TIGHT_M = 0.005
#: A way out keeps so much of every other slack, one after the other: with none left, a machine whose joints do not
#: act at once can only creep.
KEPT_M = (0.005, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Sought:
    """What was found.

    Attributes:
        velocity: (n,) verified, zero if there is none [rad/s, m/s].
        exit: the way it follows, or what pins the machine. rows: those `exit` counts. clearances: those rows mean.
    """

    velocity: Floats
    exit: Exit
    rows: Rows
    clearances: Clearances


class Seeker:
    """Seeks the way out of what the stop in hand ends inside of.

    Where solids touch face to face, the corners of that patch say at once which turns help; but of corners that lie
    almost as deep not all need to count. So, should these rows pin the machine or verify no command, those of the
    exact clearances are asked, one each; what refuses the command they suggest is measured there and joins them.

    Args:
        given: of this tick. stop: the stop in hand. inside: exact measures along it. settle_s: nearer to an end than
            this at full speed, a joint is slowed. alpha: a tick uses up at most this share of a slack.
        stands: whether a command (n,) verifies. way_after: the postures after it.
    """

    def __init__(
        self,
        given: GuardInput,
        stop: Stop,
        inside: Inside,
        stands: Callable[[Floats], bool],
        *,
        settle_s: float,
        alpha: float,
    ) -> None:
        self._given, self._stop, self._inside, self._stands, self._alpha = given, stop, inside, stands, alpha
        low, high = room(*(given.q, given.q_min, given.q_max, given.speed_positive, given.speed_negative, settle_s))
        # nearer and nearer to its end a joint goes ever slower, and all that keep its pace with it
        low[low > -AT_END * given.speed_negative] = 0.0
        high[high < AT_END * given.speed_positive] = 0.0
        self._low, self._high = low, high

    def seek(self, speed_share: float) -> Sought:
        """Return the fastest verified way out, no faster than `speed_share` (0 to 1) of what the joints can."""
        exact = joined([self._inside.rows(), self._inside.near(self._stop.rows)])
        found: list[Sought] = []
        best, most = None, -math.inf
        tried = itertools.product((self._stop.rows, exact), KEPT_M, (False, True), self._groups())
        for rows, kept_m, alike, free in tried:
            one = self._followed(rows, free, speed_share, kept_m, all_alike=alike)
            if isinstance(one.exit, WayOut) and one.exit.row < 0:
                return one
            gained = self._inside.gained(one.velocity) if one.velocity.any() else 0.0
            whole = speed_share * self._given.dt_s
            if gained <= CREEP_M_S * whole:
                found.append(one)
            elif gained > most:
                best, most = one, gained
            if gained >= ENOUGH_M_S * whole:
                break
        if best is not None:
            return best
        pinned = [one for one in reversed(found) if isinstance(one.exit, Pinned)]
        return pinned[0] if pinned else self._unproven(found[-1])

    def _unproven(self, found: Sought) -> Sought:
        """Return what seems to pin the machine, where every way out that the rows promise is refused."""
        if isinstance(found.exit, Pinned):
            return found
        first, of = found.exit.row, self._stop.clearances.limits[found.rows.clearances]
        others = np.flatnonzero(of != of[first])
        second = int(others[np.argmin(found.rows.room[others])]) if len(others) else -1
        pinned = Pinned(first, second, False, max(len(np.unique(of[others])) - 1, 0), (), np.inf)
        return replace(found, exit=pinned, velocity=np.zeros(len(self._low)))

    def _followed(
        self, rows: Rows, free: NDArray[np.bool_], speed_share: float, kept_m: float, *, all_alike: bool
    ) -> Sought:
        still, last = np.zeros(len(self._low)), np.full(len(self._low), np.nan)
        for _ in range(ROUNDS):
            acting = self._inside.acting(rows)
            found = self._best(acting, free, kept_m, all_alike=all_alike)
            if isinstance(found, Pinned) or found.row < 0:
                return Sought(still, found, acting, self._stop.clearances)
            if np.abs(found.velocity - last).max() < SAME:  # what refused it said nothing new
                break
            last = found.velocity
            tight = self._slowest(found.velocity, rows)
            if tight > 0.0:
                for share in SHARES:
                    command = found.velocity * (speed_share * share * tight)
                    if not command.any() or (self._stands(command) and self._leads_out(acting, found, command)):
                        return Sought(command, found, acting, self._stop.clearances)
                cuts = self._inside.cuts(command)
                if len(cuts.slack):
                    rows = joined([rows, cuts])
                    continue
                if self._stands(command):  # its row promises what is not so: it lies at an edge, or on top of a ridge
                    clearance = acting.clearances[found.row]
                    flat = (rows.clearances == clearance) & (rows.rows @ found.velocity > 0.0)
                    rows = replace(rows, rows=np.where(flat[:, None], 0.0, rows.rows))
                    continue
            spared = (rows.slack >= 0.0) & (rows.room < TIGHT_M) & (rows.room > 0.0)
            if not spared.any():
                break
            rows = replace(rows, room=np.where(spared, 0.0, rows.room), slack=np.where(spared, 0.0, rows.slack))
        return Sought(still, found, acting, self._stop.clearances)

    def _leads_out(self, rows: Rows, found: WayOut, command: Floats) -> bool:
        """Return whether a command really gains: beside the top of a ridge a step too long ends on its other side."""
        promised = float(rows.rows[found.row] @ command) * self._given.dt_s
        return self._inside.gained(command) >= KEPT * promised or not self._inside.judged.any()

    def _best(self, rows: Rows, free: NDArray[np.bool_], kept_m: float, *, all_alike: bool) -> Exit:
        """Return the way out by some of the joints, or what pins the machine."""
        others = rows.slack >= 0.0
        return way_out(
            *(rows.rows, rows.slack, self._low * free, self._high * free),
            room=np.where(others, np.maximum(rows.room - kept_m, 0.0), rows.room),
            of=self._stop.clearances.limits[rows.clearances],
            shy=others & (rows.room < kept_m),
            all_alike=all_alike,
            least_m_s=LEAST_M_S,
        )

    def _groups(self) -> list[NDArray[np.bool_]]:
        """Return which joints (n,) may move together."""
        groups, n = self._given.exclusive_groups, len(self._low)
        shared = [j for j in range(n) if not any(j in group for group in groups)]
        return [np.isin(np.arange(n), [*group, *shared]) for group in groups or (tuple(range(n)),)]

    def _slowest(self, velocity: Floats, rows: Rows) -> float:
        """Return the share of a velocity, 0 to 1, that uses up no more of any slack than a tick may."""
        kept = picked(rows, rows.slack >= 0.0)
        plus, minus = self._inside.changes(kept)
        shares = np.where(
            velocity > 0.0, velocity / self._given.speed_positive, velocity / self._given.speed_negative
        )
        falls = -(plus @ np.maximum(shares, 0.0) + minus @ np.maximum(-shares, 0.0))
        may = np.concatenate([self._alpha * kept.room, np.where(kept.room > 0.0, kept.room, 0.0)])
        over = falls > may + 1e-9
        return float((may[over] / falls[over]).min(initial=1.0))
