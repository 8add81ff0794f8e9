"""Seeking a way out: directions by linear programmes, believed only if the command that follows them verifies."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from workgauge.guard.api import GuardInput
from workgauge.guard.exit import Exit, Pinned, WayOut, room, way_out
from workgauge.guard.inside import Inside, joined
from workgauge.proximity.stops import Rows, Stop
from workgauge.values.arrays import Floats
from workgauge.values.clearances import Clearances

#: For a way out, a joint is at its end where that leaves less than this share of its speed.
AT_END = 0.01
#: What is tried of a way out's speed, one after the other: the shorter a step, the straighter its way.
SHARES = (1.0, 0.5, 0.2, 0.06, 0.02)
#: A way out gains at least so much [m/s]; a step along it, this share of what its direction promises.
LEAST_M_S, KEPT = 1e-3, 0.25
#: Joint speeds that differ less are the same [rad/s, m/s].
SAME = 1e-4
#: So often what refused a way out is taken into account and another sought.
ROUNDS = 8
#: Where bounds refuse a way out, what has less room than this may lose none of it [m].
TIGHT_M = 0.005


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
        exact = joined([self._inside.rows(), self._inside.outside(self._stop.rows)])
        found: list[Sought] = []
        for rows in (self._stop.rows, exact):
            one = self._followed(rows, speed_share)
            if one.velocity.any() or (isinstance(one.exit, WayOut) and one.exit.row < 0):
                return one
            found.append(one)
        pinned = [one for one in reversed(found) if isinstance(one.exit, Pinned)]
        return pinned[0] if pinned else self._unproven(found[-1])

    def _unproven(self, found: Sought) -> Sought:
        """Return what seems to pin the machine, where every way out that the rows promise is refused."""
        if isinstance(found.exit, Pinned):
            return found
        first, of = found.exit.row, self._stop.clearances.limits[found.rows.clearances]
        others = np.flatnonzero(of != of[first])
        second = int(others[np.argmin(found.rows.room[others])]) if len(others) else -1
        return replace(found, exit=Pinned(first, second, False, max(len(np.unique(of[others])) - 1, 0), (), np.inf))

    def _followed(self, rows: Rows, speed_share: float) -> Sought:
        still, last = np.zeros(len(self._low)), np.full(len(self._low), np.nan)
        for _ in range(ROUNDS):
            acting = self._inside.acting(rows)
            found = self._best(acting)
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

    def _best(self, rows: Rows) -> Exit:
        """Return the way out by whichever exclusive group has the best, or what pins the machine."""
        groups, n = self._given.exclusive_groups, len(self._low)
        grouped = {j for group in groups for j in group}
        of = self._stop.clearances.limits[rows.clearances]
        found: list[Exit] = []
        for group in groups or (tuple(range(n)),):
            free = np.array([j in group or j not in grouped for j in range(n)])
            box = self._low * free, self._high * free
            found.append(way_out(rows.rows, rows.slack, *box, room=rows.room, of=of, least_m_s=LEAST_M_S))
        out = [one for one in found if isinstance(one, WayOut)]
        return max(out, key=lambda one: one.gain) if out else found[0]

    def _slowest(self, velocity: Floats, rows: Rows) -> float:
        """Return the share of a velocity, 0 to 1, that uses up no more of any slack than a tick may."""
        kept = rows.slack >= 0.0
        falls = -(rows.rows[kept] @ velocity) * self._given.dt_s
        may = self._alpha * rows.room[kept]
        over = falls > may + 1e-9
        return float((may[over] / falls[over]).min(initial=1.0))
