"""What a tick may command, rolled out: where the joints may be until they rest, for several commands side by side."""

import numpy as np

from workgauge.guard.api import GuardInput, Memory
from workgauge.machine.rollout import Rollout
from workgauge.proximity.stops import Rows, Way
from workgauge.values.arrays import Floats, freeze

#: The commands rolled out: none, what is wished for, every joint at its full positive and negative speed.
NONE, WISH, PLUS, MINUS = range(4)


def flown(rollout: Rollout, sent: Floats | None, elapsed_s: float, memory: Memory) -> tuple[Floats, Floats]:
    """Return the speeds (V, n) of the corner machines now, and the commands in flight (H, n), the newest last.

    Args:
        rollout: the stopping model. sent: (n,) velocities the valves have asked for since the last tick, None for
            none. elapsed_s: since then; more than a tick's period if ticks were missed.
        memory: of the last tick; an empty one stands for a machine at rest.
    """
    speeds = np.asarray(memory.get("speeds", rollout.rest()), dtype=np.float64)
    flying = np.asarray(memory.get("flying", np.zeros((rollout.memory, rollout.n))), dtype=np.float64)
    if speeds.shape != (rollout.variants, rollout.n) or flying.shape != (rollout.memory, rollout.n):
        speeds, flying = rollout.rest(), np.zeros((rollout.memory, rollout.n))
    ticks = min(max(round(elapsed_s / rollout.dt_s), 1), rollout.memory)
    for _ in range(ticks):
        after = np.empty_like(flying)
        after[:-1] = flying[1:]
        after[-1] = 0.0 if sent is None else sent
        flying = after
        speeds = rollout.advanced(speeds, flying)
    freeze(speeds)
    freeze(flying)
    return speeds, flying


class Plan:
    """Displacements of the joints from now to rest, after each of the commands `NONE` to `MINUS`.

    Args:
        rollout: the stopping model. given: of this tick. speeds, flying: see `flown`.
        wish: (n,) what the joints themselves allow of what is desired.

    Attributes:
        most: (n,) how much of each joint's way one tick's command may change, at its full speed either way.
    """

    def __init__(self, rollout: Rollout, given: GuardInput, speeds: Floats, flying: Floats, wish: Floats) -> None:
        self._rollout, self._q, self._wish = rollout, given.q, wish
        self._speeds, self._flying = speeds, flying
        self._room = given.q_min - given.q, given.q_max - given.q
        first = np.array([np.zeros(rollout.n), wish, given.speed_positive, -given.speed_negative])
        self._low, self._high = rollout.displacements(speeds, flying, first)
        low, high = self._within_ends(self._low, self._high)
        self._middle, self._width = 0.5 * (low + high), 0.5 * (high - low)
        middle, width = self._middle[PLUS:] - self._middle[NONE], self._width[PLUS:] - self._width[NONE]
        self.most: Floats = (np.abs(middle) + np.abs(width)).max(axis=(0, 1))
        self._looked = np.arange(len(rollout.marks))

    def way(self, spacing_m: float, levers: Floats) -> Way:
        """Return the way to rest without a command: so many postures that no corner moves `spacing_m` in between.

        Args:
            levers: (n,) how far from each joint's axis a corner may be [m].
        """
        steps = np.abs(np.diff(self._middle[NONE], axis=0, prepend=0.0)) @ levers
        bins = np.floor(np.cumsum(steps) / spacing_m)
        self._looked = np.flatnonzero(np.diff(bins, append=np.inf) > 0.0)
        return self._seen(self._middle[NONE], self._width[NONE])

    def way_after(self, command: Floats) -> Way:
        """Return the same moments of the way to rest after a command (n,)."""
        low, high = self._rollout.displacements(self._speeds, self._flying, command[None])
        low, high = self._within_ends(low[0], high[0])
        return self._seen(0.5 * (low + high), 0.5 * (high - low))

    def changes(self, rows: Rows, command: int) -> Floats:
        """Return (r, n) by how much each joint's part of a command changes each slack [m]."""
        at = self._looked.take(rows.postures)
        middle = (self._middle[command] - self._middle[NONE]).take(at, axis=0)
        width = (self._width[command] - self._width[NONE]).take(at, axis=0)
        found: Floats = rows.rows * middle
        found -= np.abs(rows.rows) * width
        return found

    def ends(self, alpha: float) -> Floats:
        """Return (4, n) the share of each command that leaves every joint its due before its end.

        One tick uses up at most the share `alpha` of what is left between the joint's end and where it would come to
        rest.
        """
        up, down = self._room[1] - self._high[NONE, -1], self._low[NONE, -1] - self._room[0]
        shares = np.ones((4, self._rollout.n))
        for command, upwards in ((WISH, self._wish > 0.0), (PLUS, True), (MINUS, False)):
            room = np.maximum(np.where(upwards, up, down), 0.0)
            more = np.where(
                upwards, self._high[command, -1] - self._high[NONE, -1], self._low[NONE, -1] - self._low[command, -1]
            )
            binding = (more > 0.0) & (alpha * room < more)
            np.divide(alpha * room, more, out=shares[command], where=binding)
        return shares

    def _within_ends(self, low: Floats, high: Floats) -> tuple[Floats, Floats]:
        """Return displacements that pass no joint's end: there the joint stops."""
        down, up = np.minimum(self._room[0], 0.0), np.maximum(self._room[1], 0.0)
        return np.clip(low, down, up), np.clip(high, down, up)

    def _seen(self, middle: Floats, width: Floats) -> Way:
        ticks = np.minimum(self._rollout.marks.take(self._looked), self._rollout.rest_ticks)
        return Way(self._q + middle[self._looked], width[self._looked], ticks * self._rollout.dt_s)
