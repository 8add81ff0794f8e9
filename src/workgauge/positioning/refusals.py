"""Why a satellite solution is not accepted, and what stops the machine: one function each, in an operator's words."""

import math

from workgauge.machine.positioning import Thresholds
from workgauge.positioning.evidence import HealthMemory, HealthSeen
from workgauge.values.navigation import FixQuality
from workgauge.values.reasons import Reason, ReasonCode

#: Qualities whose meaning is known and that come from satellites. What a receiver dead-reckons, simulates, was told
#: by hand or means by a number of its own is no fix.
BELIEVED = frozenset({FixQuality.SINGLE, FixQuality.DIFFERENTIAL, FixQuality.PPS, FixQuality.FIXED, FixQuality.FLOAT})

_LONGEST_S = 1e9  # ages beyond this are as good as none


def as_ns(seconds: float) -> int:
    """Return whole nanoseconds; ages beyond thirty years count as thirty."""
    return round(min(seconds, _LONGEST_S) * 1e9)


def frozen_limit_s(seen: HealthSeen, limits: Thresholds) -> float:
    """Return how long coordinates may stay exactly the same: less if the undercarriage is known to travel."""
    return min(limits.frozen_s, limits.fix_age_s) if seen.moving_wheels else limits.frozen_s


def refusals(seen: HealthSeen, memory: HealthMemory, limits: Thresholds) -> tuple[Reason, ...]:
    """Return why no solution may be accepted now, apart from a jump and a wrong heading, which stops.

    `memory` holds this tick's comparisons.
    """
    reasons = []
    if seen.new and seen.quality not in BELIEVED:
        name = seen.quality.name.lower().replace("_", " ")
        text = f"fix is of quality {seen.quality.value}, {name} (needed 1 to 5)"
        reasons.append(Reason(ReasonCode.POSITION_DEGRADED, text))
    if seen.new and seen.new_age_s > limits.fix_age_s:
        text = f"fix arrives {seen.new_age_s:.2f} s old (limit {limits.fix_age_s:g} s)"
        reasons.append(Reason(ReasonCode.POSITION_DEGRADED, text))
    if seen.new and seen.new_age_s < -limits.fix_age_s:
        text = f"fix is {-seen.new_age_s:.2f} s ahead of the clock (limit {limits.fix_age_s:g} s)"
        reasons.append(Reason(ReasonCode.POSITION_DEGRADED, text))
    frozen_s = frozen_limit_s(seen, limits)
    if seen.same_for_s >= frozen_s:
        text = f"receiver hangs: the very same coordinates for {seen.same_for_s:.2f} s (limit {frozen_s:g} s)"
        reasons.append(Reason(ReasonCode.RECEIVER_FROZEN, text))
    if memory.baseline_wrong != 0.0:
        text = (
            f"antennas are {1e3 * memory.baseline_wrong:+.0f} mm from their known distance "
            f"(limit {1e3 * memory.baseline_allowed:.3g} mm)"
        )
        reasons.append(Reason(ReasonCode.HEADING_DISAGREES, text))
    return tuple(reasons)


def stops(
    seen: HealthSeen,
    before: HealthMemory,
    memory: HealthMemory,
    age_ns: int | None,
    carried: bool,
    relocated: bool,
    limits: Thresholds,
) -> tuple[Reason, ...]:
    """Return every cause of a stop.

    Args:
        before: the memory of the last tick. memory: with this tick's comparisons, trust and movement in it.
        age_ns: of the newest accepted solution, None without one. carried: the pose is carried on without it.
        relocated: this tick's solution was taken as a new place while the machine could work on the old one.
    """
    reasons = [*_about_machine(seen, limits)]
    if seen.now_ns < before.now_ns:
        text = f"clock went back by {(before.now_ns - seen.now_ns) * 1e-9:.3f} s (limit 0 s)"
        reasons.append(Reason(ReasonCode.FROM_FUTURE, text))
    if memory.swapped:
        text = (
            f"antennas are exchanged: heading {abs(math.degrees(memory.heading_wrong or math.pi)):.0f}° off "
            f"(limit {limits.heading_deg:g}°): change the cables over"
        )
        reasons.append(Reason(ReasonCode.HEADING_DISAGREES, text))
    elif memory.heading_wrong != 0.0:
        text = (
            f"heading is {math.degrees(memory.heading_wrong):+.1f}° off the other heading "
            f"(limit {math.degrees(memory.heading_allowed):.3g}°): a heading or the swing angle is wrong"
        )
        reasons.append(Reason(ReasonCode.HEADING_DISAGREES, text))
    if relocated:
        text = (
            f"position moved by {seen.innovation:.1f} sigma (limit {limits.innovation_sigmas:g}) and "
            f"{limits.innovation_in_a_row} fixes agree on it: look where the machine stands, then arm again"
        )
        reasons.append(Reason(ReasonCode.POSITION_JUMP, text))
    elif memory.jump_sigmas > 0.0 and memory.candidates >= max(2, limits.innovation_in_a_row):
        text = (
            f"{memory.candidates} fixes in a row agree on a place {memory.jump_sigmas:.1f} sigma away "
            f"(limit {limits.innovation_sigmas:g}): one of the two is wrong, look where the machine stands"
        )
        reasons.append(Reason(ReasonCode.POSITION_JUMP, text))
    return (*reasons, *_about_position(seen, memory, age_ns, carried, limits))


def _about_machine(seen: HealthSeen, limits: Thresholds) -> list[Reason]:
    """Return what stops whatever the receivers say: no check, no posture."""
    reasons = []
    if seen.checked is False:
        text = (
            "start-of-shift check is missing, failed or too old "
            f"(limits {1e3 * limits.check_tolerance_m:g} mm, {limits.check_hours:g} h)"
        )
        reasons.append(Reason(ReasonCode.NOT_CHECKED, text))
    for sensor in seen.stale_sensors:
        text = f"{sensor} is missing or too old (limit {limits.link_age_s:g} s)"
        reasons.append(Reason(ReasonCode.SENSOR_STALE, text))
    for joint in seen.jumped_joints:
        text = f"{joint} jumped between two readings (limit {limits.link_jump_deg:g}°)"
        reasons.append(Reason(ReasonCode.SENSOR_DISAGREES, text, joint=joint))
    return reasons


def _about_position(
    seen: HealthSeen, memory: HealthMemory, age_ns: int | None, carried: bool, limits: Thresholds
) -> list[Reason]:
    """Return why there is no position to work on."""
    if age_ns is None:
        return [Reason(ReasonCode.POSITION_LOST, "no position: no fix to be believed (needed 1)")]
    reasons = []
    longest = max(limits.dead_reckoning_s, limits.chassis_frozen_s)
    age_s = age_ns * 1e-9
    if carried and age_ns > as_ns(longest):
        text = f"position lost: no good fix for {age_s:.2f} s (limit {longest:g} s)"
        reasons.append(Reason(ReasonCode.POSITION_LOST, text))
    elif memory.moved:
        wheels = "wheels turn" if seen.moving_wheels else f"speed {_speed(seen.speed_m_s)}"
        text = (
            f"position lost: no good fix for {age_s:.2f} s (limit {limits.dead_reckoning_s:g} s) and the "
            f"undercarriage is not known to have stood still: {wheels} (limit {limits.standing_m_s:g} m/s)"
        )
        reasons.append(Reason(ReasonCode.POSITION_LOST, text))
    if not seen.sigma_m <= limits.travel_sigma_m:
        sure = "nobody knows how far" if math.isnan(seen.sigma_m) else f"{seen.sigma_m:.2f} m"
        text = f"position too unsure: {sure} (1 sigma, limit {limits.travel_sigma_m:g} m)"
        reasons.append(Reason(ReasonCode.POSITION_LOST, text))
    return reasons


def _speed(speed_m_s: float) -> str:
    return "unknown" if math.isnan(speed_m_s) else f"{speed_m_s:.2f} m/s"
