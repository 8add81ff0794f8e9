"""Getting clear of what is too near for a plan to begin or end there: small steps, each of which makes more room."""

from collections.abc import Callable

import numpy as np
from scipy.optimize import linprog

from workgauge.motion.plan.validity import Validity
from workgauge.values.arrays import Floats

#: No point of the machine moves farther than this in one step [m].
STEP_M = 0.002
#: Clearances with less than this above what is needed have a say in the direction [m].
CLOSE_M = 0.1
#: Steps at most; a direction is kept for so many.
_STEPS, _KEPT = 400, 10


def leave(validity: Validity, q: Floats, stop: Callable[[], bool]) -> list[Floats] | None:
    """Return waypoints from posture q (n,) to one that keeps every clearance, or None if no step makes more room.

    Every step makes the least surplus grow; in between it is less by at most half of `STEP_M`. Of joints that cannot
    move together only one group moves at a time.
    """
    machine = validity.machine
    way, at, room = [q], q, validity.near(q)
    direction: Floats | None = None
    for step in range(_STEPS):
        if validity.keeps(at):
            return way
        if stop():
            return None
        if direction is None or step % _KEPT == 0:
            direction = _outwards(validity, at)
        if direction is None:
            return None
        moved = np.clip(at + direction, machine.q_min, machine.q_max)
        now = validity.near(moved)
        if not now > room:
            if step % _KEPT == 0:
                return None
            direction = None
            continue
        if len(way) > 1 and np.allclose(way[-1] - way[-2], moved - way[-1], rtol=0.0, atol=1e-12):
            way.pop()
        way.append(moved)
        at, room = moved, now
    return None


def _outwards(validity: Validity, q: Floats) -> Floats | None:
    """Return the step (n,) that makes the least of the close clearances grow most, or None if none makes all grow."""
    machine = validity.machine
    found = validity.clearances(q)
    surplus = validity.surplus(found)
    rows = machine.distance_rows(machine.forward(q), validity.T_site_machine, found)
    rows = rows[surplus < max(CLOSE_M, float(surplus.min(initial=np.inf)) + CLOSE_M)]
    n = machine.n
    best: tuple[float, Floats] | None = None
    for group in validity.groups or [np.ones(n, np.bool_)]:
        low = np.where(group & (q > machine.q_min), -machine.speed_negative, 0.0)
        high = np.where(group & (q < machine.q_max), machine.speed_positive, 0.0)
        # x = (direction, gain): the gain of every close clearance is at least `gain`, which is to be largest
        constraints = np.concatenate([-rows, np.ones((len(rows), 1))], axis=1)
        bounds = [*zip(low.tolist(), high.tolist(), strict=True), (None, None)]
        solved = linprog(np.append(np.zeros(n), -1.0), A_ub=constraints, b_ub=np.zeros(len(rows)), bounds=bounds)
        x = np.zeros(n + 1) if solved.status != 0 or solved.x is None else np.asarray(solved.x, dtype=np.float64)
        if x[n] > 1e-9 and (best is None or x[n] > best[0]):
            best = float(x[n]), x[:n]
    if best is None:
        return None
    return best[1] * (STEP_M / float(validity.scene.arm.farthest @ np.abs(best[1])))
