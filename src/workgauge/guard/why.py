"""Why the barrier guard leaves less than was wanted, in words an operator understands."""

from dataclasses import replace

import numpy as np

from workgauge.guard.exit import Exit, WayOut
from workgauge.guard.programme import Solved
from workgauge.proximity.stops import Rows
from workgauge.values.arrays import Floats
from workgauge.values.clearances import Clearance, Clearances
from workgauge.values.reasons import Reason, ReasonCode

#: At most this many reasons, the gravest first.
MAX_REASONS = 8
#: A slack below this is none [m].
USED_UP_M = 0.002
#: Shares above this are whole.
WHOLE = 1.0 - 1e-6
#: Joints slower than this share of the fastest are not named.
WORTH = 0.1
#: A reason's text is silent about protection levels below this [m].
WORTH_SAYING_M = 0.005


def cushioned_by(ends: Floats, wish: Floats, names: tuple[str, ...]) -> list[Reason]:
    """Return one reason for each joint that its end slows.

    Args:
        ends: (n,) share of its wish that each joint's end leaves. wish: (n,) wanted velocities. names: (n).
    """
    reasons = []
    for j, (share, v) in enumerate(zip(ends.tolist(), wish.tolist(), strict=True)):
        if share >= WHOLE or v == 0.0:
            continue
        end = "upper" if v > 0.0 else "lower"
        text = f"{names[j]} is {'at' if share == 0.0 else 'near'} its {end} end"
        reasons.append(Reason(ReasonCode.JOINT_END, text, joint=names[j], scale=share))
    return reasons


def held_back(
    clearances: Clearances, rows: Rows, solved: Solved, kept: float, stop_distance_m: float, scale: float
) -> list[Reason]:
    """Return one reason per link and limit that holds the motion back, the gravest first.

    Args:
        clearances: of the present. rows: what had little slack on the way to rest. solved: the shares left, and which
            rows hold them back. kept: what of them was verified. scale: what is left of the wish.
    """
    if not solved.ok:
        return [Reason(ReasonCode.INVALID_VALUE, f"stopped: {solved.why}", scale=0.0)]
    count = len(rows.slack)  # each stands twice in the programme, see `Plan.changes`
    active = [row % count for row in solved.active if row < 2 * count]
    flow = [] if len(active) == len(solved.active) else [_pump(scale)]
    if kept < 1.0 and not active and len(rows.slack):
        active = [int(np.argmin(rows.slack))]
    reasons: list[Reason] = []
    said = set()
    for row in sorted(active, key=lambda one: float(rows.slack[one])):
        k = int(rows.clearances[row])
        pair = int(clearances.links[k]), int(clearances.limits[k])
        if pair in said or len(reasons) == MAX_REASONS:
            continue
        said.add(pair)
        reasons.append(_near(clearances, k, float(rows.slack[row]), stop_distance_m, scale))
    return reasons + flow


def how_out(found: Exit, clearances: Clearances, rows: Rows, names: tuple[str, ...]) -> list[Reason]:
    """Return how to get out of what the machine is inside of, or what pins it.

    Args:
        found: of `exit`. clearances: of the present. rows: those `found` counts. names: of the joints.
    """
    if isinstance(found, WayOut):
        if found.row < 0:
            return []
        one = clearances[int(rows.clearances[found.row])]
        most = float(np.abs(found.velocity).max(initial=0.0))
        leading = [j for j in np.argsort(-np.abs(found.velocity)).tolist() if abs(found.velocity[j]) > WORTH * most]
        how = ", ".join(f"{names[j]} {'+' if found.velocity[j] > 0.0 else '-'}" for j in leading)
        return [_about(ReasonCode.WAY_OUT, f"out of {one.limit}: {how}", one)]
    if found.first < 0:
        return []
    first = clearances[int(rows.clearances[found.first])]
    other = None
    text = f"pinned by {first.limit}{' alone' if found.alone else ''}: no joint leads {first.link} out of it"
    if found.second >= 0:
        second = clearances[int(rows.clearances[found.second])]
        other = second.limit if second.limit != first.limit else None
        text = f"pinned between {first.limit} and {second.limit}: " if other else "pinned: "
        text += f"no joint leads {first.link} out of {first.limit} "
        text += f"without {second.link} going deeper into or nearer to {second.limit}"
    if found.more:
        text += f" or one of {found.more} more"
    if found.joints:
        text += ", with " + ", ".join(names[j] for j in found.joints) + " at the end"
    return [replace(_about(ReasonCode.PINNED, text, first), other_limit=other)]


def _about(code: ReasonCode, text: str, one: Clearance) -> Reason:
    return Reason(code, text, link=one.link, limit=one.limit, clearance_m=one.distance_m, scale=0.0)


def _near(clearances: Clearances, k: int, slack: float, stop_distance_m: float, scale: float) -> Reason:
    one = clearances[k]
    stop = stop_distance_m if np.isnan(one.stop_distance_m) else one.stop_distance_m
    doubt = ""
    if one.protection_m >= WORTH_SAYING_M:
        doubt = f" ({one.protection_m:.2f} m of it unsure, stops at {stop:.2f} m)"
    if one.distance_m < 0.0:
        code = ReasonCode.INSIDE_LIMIT
        text = f"{-one.distance_m:.2f} m inside {one.limit}, only what leads out is free"
    elif slack <= USED_UP_M:
        code, text = ReasonCode.LIMIT_REACHED, f"{one.distance_m:.2f} m from {one.limit}{doubt}, no nearer"
    else:
        code = ReasonCode.LIMIT_NEAR
        text = (
            f"{one.distance_m:.2f} m from {one.limit}{doubt}, a stop would end {slack:.2f} m before it must, "
            f"slowed to {100 * scale:.0f} %"
        )
    return Reason(
        code,
        f"{one.link} is {text}",
        link=one.link,
        limit=one.limit,
        clearance_m=one.distance_m,
        scale=scale,
        protection_m=one.protection_m,
        stop_distance_m=stop,
    )


def _pump(scale: float) -> Reason:
    return Reason(ReasonCode.PUMP_FLOW, "the pump gives no more for all joints together", scale=scale)
