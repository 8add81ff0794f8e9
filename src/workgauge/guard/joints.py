"""What the joints themselves allow, whatever stands around the machine: speed and exclusive groups."""

from collections.abc import Sequence

from workgauge.values.reasons import Reason, ReasonCode

#: A group keeps the right to move until another is wanted this much more.
HYSTERESIS = 1.25
_TOLERANCE = 1e-9


def within_speed(
    velocity: Sequence[float], positive: Sequence[float], negative: Sequence[float], names: Sequence[str]
) -> tuple[list[float], list[Reason]]:
    """Return the velocity (n,), scaled as a whole so that no joint exceeds its speed in its direction.

    The tool's direction of motion is kept.
    """
    scale, slowest = 1.0, -1
    for j, v in enumerate(velocity):
        limit = positive[j] if v > 0.0 else negative[j]
        if abs(v) > limit * (1.0 + _TOLERANCE) and limit / abs(v) < scale:
            scale, slowest = limit / abs(v), j
    if slowest < 0:
        return list(velocity), []
    text = f"{names[slowest]} is at its highest speed"
    reason = Reason(ReasonCode.JOINT_SPEED, text, joint=names[slowest], scale=scale)
    return [v * scale for v in velocity], [reason]


def one_group(
    velocity: Sequence[float],
    positive: Sequence[float],
    negative: Sequence[float],
    groups: Sequence[Sequence[int]],
    names: Sequence[str],
    previous: int,
) -> tuple[list[float], int, list[Reason]]:
    """Return the velocity (n,) with at most one exclusive group moving, and that group (-1: none).

    The group wanted most, as a share of its joints' speeds, moves; the one that moved last (`previous`) keeps moving
    until another is wanted `HYSTERESIS` times as much, so that two levers held alike do not make the machine chatter.
    """
    if not groups:
        return list(velocity), -1, []
    wanted = [
        max((abs(velocity[j]) / (positive[j] if velocity[j] > 0.0 else negative[j]) for j in group), default=0.0)
        for group in groups
    ]
    strongest = max(range(len(groups)), key=wanted.__getitem__)
    if wanted[strongest] == 0.0:
        return list(velocity), -1, []
    kept = strongest
    if 0 <= previous < len(groups) and wanted[previous] > 0.0 and wanted[strongest] < HYSTERESIS * wanted[previous]:
        kept = previous
    held = [j for g, group in enumerate(groups) if g != kept for j in group if j not in groups[kept]]
    held = [j for j in held if velocity[j] != 0.0]
    if not held:
        return list(velocity), kept, []
    moving = " and ".join(names[j] for j in groups[kept] if velocity[j] != 0.0)
    reasons = [
        Reason(
            ReasonCode.EXCLUSIVE_GROUP, f"{names[j]} cannot move together with {moving}", joint=names[j], scale=0.0
        )
        for j in held
    ]
    return [0.0 if j in held else v for j, v in enumerate(velocity)], kept, reasons
