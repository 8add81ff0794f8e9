"""How far a position may be trusted: one state machine, fixed, float, dead reckoning, chassis frozen, stop.

Downwards at once, upwards on evidence only:

* A solution is **accepted** when its quality is known, its time is now, the coordinates move, baseline and heading
  agree, and it lies within the innovation limit of the pose carried on. Without an accepted one the state is at best
  `dead_reckoning`, counted from the epoch of the last accepted solution, then `chassis_frozen` if the undercarriage
  is known to stand, then `stop`.
* A solution that **jumped** is refused. So many in a row that agree with each other instead (`innovation_in_a_row`)
  stop the machine: one of the two places is wrong, and nothing here can say which. Solutions that return to the old
  place are accepted; the new one is, once the old one's time is over (`dead_reckoning_s`, or `chassis_frozen_s` for
  an undercarriage known to stand). Multipath that passes is so never worked on.
* A **heading** that disagrees stops: where antennas sit on the cab, it may be the swing angle that is wrong, and the
  arm works on that. What disagreed (heading, baseline, antenna order) stays wrong until a comparison agrees; that
  nothing can be compared any more, because the machine stands, is no agreement. A new start forgets it.
* **Upwards**: to `float` with an accepted solution; from `stop` and to `fixed` after `innovation_in_a_row` accepted
  in a row with nothing wrong between them. `stop` is left without being asked; the gate opens again only by its own
  rule: the enable switch let go, and pressed with neutral levers.
"""

import math
import sys
from dataclasses import replace

from workgauge.machine.positioning import Thresholds
from workgauge.positioning.evidence import HealthMemory, HealthSeen
from workgauge.positioning.refusals import as_ns, frozen_limit_s, refusals, stops
from workgauge.values.health import HealthState, PositionHealth
from workgauge.values.navigation import FixQuality
from workgauge.values.reasons import Reason, ReasonCode

__all__ = ["HealthMemory", "HealthSeen", "judge"]

#: Better states are smaller.
_RANK = {state: rank for rank, state in enumerate(HealthState)}


def judge(
    seen: HealthSeen, memory: HealthMemory, thresholds: Thresholds
) -> tuple[PositionHealth, bool, HealthMemory]:
    """Return the health now, whether this tick's solution is accepted, and what to remember.

    Pure, total and deterministic; it never raises on numbers. `False` for a tick without a new solution.
    """
    if not seen.new and seen.quality is not memory.quality:
        seen = replace(seen, quality=memory.quality)
    noted = _compared(seen, memory, thresholds)
    about = refusals(seen, noted, thresholds)
    refused = bool(about) or noted.swapped or noted.heading_wrong != 0.0
    accept, relocated, noted = _new_solution(seen, noted, refused, thresholds)
    trusted_ns = _trusted(seen, memory, accept, thresholds)
    age_ns = None if trusted_ns is None else seen.now_ns - trusted_ns
    fresh = age_ns is not None and age_ns <= as_ns(thresholds.fix_age_s)
    carried = not fresh or refused or noted.jump_sigmas > 0.0
    overdue = carried and age_ns is not None and age_ns > as_ns(thresholds.dead_reckoning_s)
    held_still = not accept and (overdue or memory.state is HealthState.CHASSIS_FROZEN)
    moved = not accept and (memory.moved or (held_still and not _standing(seen, thresholds)))
    quality = seen.quality if accept else memory.quality
    noted = replace(noted, trusted_ns=trusted_ns, quality=quality, moved=moved, now_ns=seen.now_ns)

    why_stop = stops(seen, memory, noted, age_ns, carried, relocated and memory.state.usable, thresholds)
    noted = _counted(seen, noted, accept, bool(why_stop) or carried, thresholds)
    if relocated and not why_stop and not memory.state.usable:
        noted = replace(noted, agreeing=thresholds.innovation_in_a_row)
    state, reasons = _state(seen, memory, noted, carried, held_still, accept, thresholds)
    if why_stop:
        state, reasons = HealthState.STOP, why_stop
    reasons = (*reasons, *about, *_jump(noted, thresholds), *_carried(state, age_ns or 0, thresholds))
    since_ns = memory.since_ns if state is memory.state and memory.now_ns >= 0 else seen.now_ns
    return PositionHealth(state, since_ns, reasons), accept, replace(noted, state=state, since_ns=since_ns)


def _compared(seen: HealthSeen, memory: HealthMemory, limits: Thresholds) -> HealthMemory:
    """Return the memory with this tick's comparisons of heading and baseline in it."""
    swapped = memory.swapped
    if not math.isnan(seen.heading_difference):
        allowed = beyond(math.radians(limits.heading_deg), seen.heading_sigma, limits)
        wrong = 0.0 if abs(seen.heading_difference) <= allowed else seen.heading_difference
        memory = replace(memory, heading_wrong=wrong, heading_allowed=allowed)
        swapped = swapped and wrong != 0.0
    if not math.isnan(seen.baseline_error_m):
        allowed = beyond(limits.baseline_m, seen.baseline_sigma_m, limits)
        wrong = 0.0 if abs(seen.baseline_error_m) <= allowed else seen.baseline_error_m
        memory = replace(memory, baseline_wrong=wrong, baseline_allowed=allowed)
    swapped = swapped or seen.swapped
    return memory if swapped is memory.swapped else replace(memory, swapped=swapped)


def beyond(limit: float, sigma: float, limits: Thresholds) -> float:
    """Return the difference that honest noise of this sigma does not reach, `limit` at least."""
    return max(limit, limits.innovation_sigmas * sigma) if sigma > 0.0 else limit


def _new_solution(
    seen: HealthSeen, memory: HealthMemory, refused: bool, limits: Thresholds
) -> tuple[bool, bool, HealthMemory]:
    """Return whether this tick's solution is accepted, whether as a new place, and the memory with its jump in it."""
    if not seen.new:
        return False, False, memory
    if refused:
        return False, False, replace(memory, candidates=0)
    allowed = limits.innovation_sigmas
    agree = memory.candidates > 0 and seen.agreement <= allowed
    # A pose carried on grows unsure until any place fits: what is nearer to the jump belongs to the jump.
    if seen.innovation <= allowed and not (agree and seen.agreement < seen.innovation):
        return True, False, replace(memory, jump_sigmas=0.0, candidates=0)
    candidates = min(memory.candidates + 1, limits.innovation_in_a_row) if agree else 1
    if agree and candidates >= limits.innovation_in_a_row and _expired(seen, memory, limits):
        return True, True, replace(memory, jump_sigmas=0.0, candidates=0)
    jump = max(seen.innovation, memory.jump_sigmas, sys.float_info.min)
    return False, False, replace(memory, jump_sigmas=jump, candidates=candidates)


def _expired(seen: HealthSeen, memory: HealthMemory, limits: Thresholds) -> bool:
    """Return whether the place worked on so far has had its time without a solution."""
    if memory.trusted_ns is None:
        return True
    longest = limits.dead_reckoning_s
    if not memory.moved and _standing(seen, limits):
        longest = max(longest, limits.chassis_frozen_s)
    return seen.now_ns - memory.trusted_ns > as_ns(longest)


def _trusted(seen: HealthSeen, memory: HealthMemory, accept: bool, limits: Thresholds) -> int | None:
    """Return the epoch of the newest solution to be trusted: it never grows younger without an accepted one."""
    if accept:
        age_s = seen.new_age_s if seen.new_age_s > 0.0 else 0.0
        return seen.now_ns - as_ns(age_s)
    age_s = math.inf if math.isnan(seen.fix_age_s) else seen.fix_age_s
    if seen.same_for_s >= frozen_limit_s(seen, limits):
        age_s = max(age_s, seen.same_for_s)
    if memory.trusted_ns is None or not age_s < math.inf or seen.now_ns < memory.now_ns:
        return None
    return min(memory.trusted_ns, seen.now_ns - as_ns(age_s))


def _standing(seen: HealthSeen, limits: Thresholds) -> bool:
    """Return whether the undercarriage is known to stand: something says so and nothing says otherwise."""
    if seen.moving_wheels or seen.speed_m_s > limits.standing_m_s:
        return False
    return seen.moving_wheels is False or seen.speed_m_s <= limits.standing_m_s


def _counted(seen: HealthSeen, memory: HealthMemory, accept: bool, trouble: bool, limits: Thresholds) -> HealthMemory:
    """Return the memory with the runs of agreeing solutions counted on, or begun anew."""
    if trouble:
        return replace(memory, agreeing=0, fixed=0) if memory.agreeing or memory.fixed else memory
    fixed = memory.fixed if _clean(seen, limits) else 0
    if not accept:
        return memory if fixed == memory.fixed else replace(memory, fixed=fixed)
    enough = limits.innovation_in_a_row
    grown = fixed + 1 if _clean(seen, limits) else 0
    return replace(memory, agreeing=min(enough, memory.agreeing + 1), fixed=min(enough, grown))


def _clean(seen: HealthSeen, limits: Thresholds) -> bool:
    """Return whether the solution is a fixed one on a correction that is not known to be old."""
    return seen.quality is FixQuality.FIXED and not seen.correction_age_s > limits.correction_age_s


def _state(
    seen: HealthSeen,
    before: HealthMemory,
    memory: HealthMemory,
    carried: bool,
    held_still: bool,
    accept: bool,
    limits: Thresholds,
) -> tuple[HealthState, tuple[Reason, ...]]:
    """Return the best state that evidence and history allow, and why it is not better, without causes of a stop."""
    enough = limits.innovation_in_a_row
    worse = _worse_fix(seen, limits)
    if held_still:
        target = HealthState.CHASSIS_FROZEN
    elif carried:
        target = HealthState.DEAD_RECKONING
    else:
        target = HealthState.FLOAT if worse else HealthState.FIXED
    if before.state is HealthState.STOP and memory.agreeing < enough:
        text = f"position returns: {memory.agreeing} fixes in a row agree (needed {enough})"
        return HealthState.STOP, (Reason(ReasonCode.POSITION_LOST, text), *worse)
    if _RANK[target] < _RANK[before.state]:
        if before.state in _LOST and not accept:
            return before.state, ()
        if target is HealthState.FIXED and memory.fixed < enough:
            target = HealthState.FLOAT
            text = f"fix returns: {memory.fixed} fixed in a row agree (needed {enough})"
            worse = (Reason(ReasonCode.POSITION_DEGRADED, text),)
    return target, worse


_LOST = (HealthState.DEAD_RECKONING, HealthState.CHASSIS_FROZEN)
_WORDS = {
    FixQuality.FLOAT: "RTK float",
    FixQuality.DIFFERENTIAL: "differential",
    FixQuality.SINGLE: "single",
    FixQuality.PPS: "PPS",
}


def _worse_fix(seen: HealthSeen, limits: Thresholds) -> tuple[Reason, ...]:
    """Return why a solution is believed with a larger uncertainty only."""
    reasons = []
    if seen.quality in _WORDS:
        text = f"fix is {_WORDS[seen.quality]}, not RTK fixed: sure to {seen.sigma_m:.2f} m (1 sigma)"
        reasons.append(Reason(ReasonCode.POSITION_DEGRADED, text))
    if seen.correction_age_s > limits.correction_age_s:
        text = f"correction is {seen.correction_age_s:.0f} s old (limit {limits.correction_age_s:g} s)"
        reasons.append(Reason(ReasonCode.CORRECTION_OLD, text))
    return tuple(reasons)


def _jump(memory: HealthMemory, limits: Thresholds) -> tuple[Reason, ...]:
    if memory.jump_sigmas == 0.0:
        return ()
    text = (
        f"fix jumped by {memory.jump_sigmas:.1f} sigma (limit {limits.innovation_sigmas:g}) and is not used: "
        f"{memory.candidates} in a row agree (needed {limits.innovation_in_a_row})"
    )
    return (Reason(ReasonCode.POSITION_JUMP, text),)


def _carried(state: HealthState, age_ns: int, limits: Thresholds) -> tuple[Reason, ...]:
    """Return what a state without a fix means, with the time left to it."""
    since = f"no good fix for {age_ns * 1e-9:.2f} s"
    if state is HealthState.DEAD_RECKONING:
        text = f"{since}: position carried on by speed and turn (limit {limits.dead_reckoning_s:g} s)"
        return (Reason(ReasonCode.DEAD_RECKONING, text),)
    if state is HealthState.CHASSIS_FROZEN:
        text = f"{since}: undercarriage must stand still, arm may work (limit {limits.chassis_frozen_s:g} s)"
        return (Reason(ReasonCode.CHASSIS_FROZEN, text),)
    return ()
