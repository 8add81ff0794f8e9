"""From where automatic motion is stuck to where it is to be: a global plan, after backing out the way it came."""

from collections.abc import Callable

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.motion.looking_ahead import Surroundings
from workgauge.motion.paths.rounded import clashing
from workgauge.motion.plan.global_plan import GlobalPlan, NoPlan, NoPlanReason, plan_global
from workgauge.motion.plan.rounding import passable
from workgauge.motion.plan.validity import Need, Validity
from workgauge.values.arrays import Floats

#: Of the way it came, postures that differ by less than this in every joint are one [rad, m].
SAME = 0.02
#: A joint that differs by no more than this has not moved [rad, m].
NOTHING = 1e-6
#: What it backs out to has this much more room than a plan keeps [m].
MORE_M = 0.02

_PINNED = (NoPlanReason.START_INSIDE, NoPlanReason.START_PINNED)


def way_round(
    around: Surroundings,
    machine: MachineModel,
    came: Floats,
    goals: Floats,
    *,
    clearance_m: float,
    seconds: float,
    seed: int = 0,
    progress: Callable[[float, str], None] | None = None,
    cancelled: Callable[[], bool] = lambda: False,
) -> Floats | NoPlan:
    """Return waypoints (k, n) from where the machine is to one of the goals, or why there are none.

    Where the machine stands too near to something for a plan to begin, it first goes back along the way it came, to
    the last posture with room. Of that way postures are left out where the line past them is proven to keep what its
    ends have; lines between postures that follow each other were driven, more or less.

    Args:
        around: what stands around. came: (m, n), m >= 1, postures it came by, the present one last.
        goals: (g, n) postures, any of which will do.
        clearance_m, seconds, seed, progress, cancelled: see `plan_global`.

    Raises:
        InputError: as `plan_global`.
    """

    def plan(q: Floats) -> GlobalPlan | NoPlan:
        return plan_global(
            *(around.scene, machine, around.T_site_machine, q, goals),
            clearance_m=clearance_m,
            stop_distance_m=around.stop_distance_m,
            seed=seed,
            seconds=seconds,
            off_states=around.off_states,
            let_off=around.let_off,
            now_ns=around.now_ns,
            progress=progress,
            cancelled=cancelled,
        )

    found = plan(came[-1])
    if isinstance(found, GlobalPlan):
        return found.waypoints
    if found.reason not in _PINNED:
        return found
    at = (around.now_ns, around.off_states, around.let_off)
    roomy = Validity(around.scene, around.T_site_machine, Need(clearance_m + MORE_M, around.stop_distance_m, *at))
    back = thinned(came[::-1])
    for k in range(1, len(back)):
        if roomy.keeps(back[k]):
            onward = plan(back[k])
            if isinstance(onward, NoPlan):
                return onward
            out = straightened(machine, back[: k + 1], passable(around, clearance_m))
            return groupwise(machine, np.concatenate([out[:-1], onward.waypoints]))
    return found


def thinned(postures: Floats) -> Floats:
    """Return postures (k, n) without those that hardly differ from the one kept before; the last one stays."""
    kept = [postures[0]]
    for q in postures[1:]:
        if np.abs(q - kept[-1]).max() > SAME:
            kept.append(q)
    if np.abs(postures[-1] - kept[-1]).max() > 0.0:
        kept.append(postures[-1])
    return np.array(kept)


def straightened(machine: MachineModel, postures: Floats, kept: Callable[[Floats, Floats], bool]) -> Floats:
    """Return postures (k, n), the ends among them, without those that a line that is kept goes past.

    Args:
        kept: which lines may be driven. Of joints that cannot move together no line moves two groups.
    """
    found, i = [postures[0]], 0
    while i < len(postures) - 1:
        j = step = 1
        while i + j + step < len(postures):
            ends = postures[i], postures[i + j + step]
            if clashing(machine, (ends[1] != ends[0])[None])[0] >= 0 or not kept(*ends):
                break
            j, step = j + step, 2 * step
        i += j
        found.append(postures[i])
    return np.array(found)


def groupwise(machine: MachineModel, waypoints: Floats) -> Floats:
    """Return waypoints (k, n) between which one exclusive group moves at a time, the others waiting at the ends.

    Joints that are where they were but for `NOTHING` have not moved.
    """
    groups = machine.exclusive_groups
    if not groups:
        return waypoints
    found = [waypoints[0]]
    for wanted in waypoints[1:]:
        at = found[-1]
        q = np.where(np.abs(wanted - at) > NOTHING, wanted, at)
        if (q == at).all():
            continue
        moved = [list(group) for group in groups if np.abs(q[list(group)] - at[list(group)]).max() > 0.0]
        for group in moved[:-1]:
            at = at.copy()
            at[group] = q[group]
            found.append(at)
        found.append(q)
    return np.array(found)
