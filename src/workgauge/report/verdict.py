"""The run in one or two sentences: what held the machine, how near it came, whether it ever was inside."""

import math

import numpy as np

from workgauge.motion.job import JobState
from workgauge.rehearse.auto_series import AutoSeries
from workgauge.rehearse.result import Intervention, RunResult
from workgauge.report.giving_way import PLACE_CAUSES, held_by
from workgauge.values.reasons import ReasonCode

#: What is left of the wanted speed [1] below which the machine counts as stopped and not merely slowed.
STOPPED_SCALE = 0.05

#: A tool no farther off its path than this did not give way [m].
GAVE_WAY_M = 0.02

CAUSE_WORDS = {
    ReasonCode.LIMIT_NEAR: "slowed before",
    ReasonCode.PUSHED_AWAY: "pushed away from",
    ReasonCode.LIMIT_REACHED: "stopped at",
    ReasonCode.INSIDE_LIMIT: "inside",
    ReasonCode.JOINT_END: "end of a joint's travel",
    ReasonCode.JOINT_SPEED: "joint speed",
    ReasonCode.EXCLUSIVE_GROUP: "joints that cannot move together",
    ReasonCode.SINGULAR: "the tool cannot go that way from here",
    ReasonCode.GIVES_WAY: "giving way before",
    ReasonCode.STUCK: "stuck before",
}


def metres(value: float | None) -> str:
    """Return a length for people: millimetres resolution, `none in sight` for None."""
    return "none in sight" if value is None else f"{value:.3f} m"


def decisive(result: RunResult) -> Intervention | None:
    """Return the intervention that left the least speed; of equals, one by a limit, then the first."""

    def order(cause: Intervention) -> tuple[float, bool, float]:
        return 1.0 if cause.scale is None else cause.scale, cause.reason not in PLACE_CAUSES, cause.t_s

    limits = [c for c in result.interventions if c.reason in PLACE_CAUSES and stopping(c)]
    return min(limits or result.interventions, key=order, default=None)


def stopping(cause: Intervention) -> bool:
    """Return whether an intervention left so little speed that the machine counts as stopped."""
    return cause.scale is not None and cause.scale <= STOPPED_SCALE


def headline(result: RunResult) -> tuple[str, bool]:
    """Return the verdict and whether it is a good one: no entry, and what automatic motion was to do is done."""
    if result.entries or result.self_entries:
        worst = max((*result.entries, *result.self_entries), key=lambda entry: entry.depth_m)
        return (
            f"The {worst.link} entered {result.name_of(worst.limit)} at {worst.start_s:.2f} s, "
            f"{worst.depth_m * 1000:.0f} mm deep.",
            False,
        )
    if result.automatic is not None:
        return automatic_words(result, result.automatic), result.automatic.completed
    cause = decisive(result)
    if cause is None:
        return "Nothing held the machine back: it moved as its levers said.", True
    if cause.reason in PLACE_CAUSES and cause.limit is not None:
        verb = "Stopped by" if stopping(cause) else "Slowed by"
        return f"{verb} {result.name_of(cause.limit)}: the {cause.link} came no nearer.", True
    words = CAUSE_WORDS.get(ReasonCode(cause.reason), cause.reason.replace("_", " "))
    return f"Held back by {words}{f' ({cause.joint})' if cause.joint else ''}, not by a limit.", True


def automatic_words(result: RunResult, auto: AutoSeries) -> str:
    """Return in a sentence what became of automatic motion: done, and how far it gave way; or not, where and why."""
    if not auto.completed:
        return _undone(result, auto)
    words = f"Done in {auto.driven_s:.1f} s"
    if not any(math.isnan(job.planned_s) for job in auto.jobs):
        words += f", {auto.driven_s / auto.planned_s:.2f} of the planned time"
    held = held_by(result)
    if not held:
        return f"{words}; no limit held it."
    name = result.name_of(held[0].limit)
    if math.isnan(held[0].off_m):
        return f"{words}; held for {held[0].seconds:.1f} s by {name}."
    if held[0].off_m < GAVE_WAY_M:
        return f"{words}; slowed by {name}, but never off its path."
    return f"{words}; gave way before {name} by up to {held[0].off_m:.2f} m."


def _undone(result: RunResult, auto: AutoSeries) -> str:
    """Return which job came to its end undone, when, how far off and before what."""
    job = [one for one in auto.last_of_steps if one.state is not JobState.DONE][-1]
    off_m = float(auto.error_m[np.flatnonzero(auto.which == auto.jobs.index(job))[-1]])
    if job.state is not JobState.STUCK:
        return f"Not done: {job.job} ran out of time at {job.ended_s:.1f} s, {off_m:.2f} m off."
    said = [c for c in result.interventions if c.reason == ReasonCode.STUCK and job.begun_s <= c.until_s]
    causes = [c for c in said if c.limit is not None and c.t_s <= job.ended_s + result.tick_s]
    before = f"the {causes[-1].link} before {result.name_of(causes[-1].limit)}, " if causes else ""
    return f"Stuck at {job.ended_s:.1f} s: {job.job} came no nearer, {before}{off_m:.2f} m off."


def details(result: RunResult) -> str:
    """Return the sentence with the numbers behind the headline."""
    if result.min_clearance_m is None:
        return "No limit was in sight of the machine during the run."
    inside = "It was never inside a limit" if not result.entries else f"It was inside a limit {len(result.entries)}×"
    automatic = ""
    if result.automatic is not None and (result.entries or result.self_entries):
        automatic = f" {automatic_words(result, result.automatic)}"
    return (
        f"Smallest true clearance {result.min_clearance_m:.3f} m, of the {result.min_link} to "
        f"{result.name_of(result.min_limit)}, at {result.nearest.t_s:.2f} s. {inside}, checked against geometric "
        f"truth {result.substeps}× per tick.{automatic}"
    )
