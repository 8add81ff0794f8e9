"""The run in one or two sentences: what held the machine, how near it came, whether it ever was inside."""

from workgauge.rehearse.result import Intervention, RunResult
from workgauge.values.reasons import ReasonCode

#: Causes that are about a place, not about levers and messages.
PLACE_CAUSES = frozenset(
    {ReasonCode.LIMIT_NEAR, ReasonCode.PUSHED_AWAY, ReasonCode.LIMIT_REACHED, ReasonCode.INSIDE_LIMIT}
)

#: What is left of the wanted speed [1] below which the machine counts as stopped and not merely slowed.
STOPPED_SCALE = 0.05

CAUSE_WORDS = {
    ReasonCode.LIMIT_NEAR: "slowed before",
    ReasonCode.PUSHED_AWAY: "pushed away from",
    ReasonCode.LIMIT_REACHED: "stopped at",
    ReasonCode.INSIDE_LIMIT: "inside",
    ReasonCode.JOINT_END: "end of a joint's travel",
    ReasonCode.JOINT_SPEED: "joint speed",
    ReasonCode.EXCLUSIVE_GROUP: "joints that cannot move together",
    ReasonCode.SINGULAR: "the tool cannot go that way from here",
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
    """Return the verdict and whether it is a good one (no entry into a limit or the machine itself)."""
    cause = decisive(result)
    if result.entries or result.self_entries:
        worst = max((*result.entries, *result.self_entries), key=lambda entry: entry.depth_m)
        return (
            f"The {worst.link} entered {result.name_of(worst.limit)} at {worst.start_s:.2f} s, "
            f"{worst.depth_m * 1000:.0f} mm deep.",
            False,
        )
    if cause is None:
        return "Nothing held the machine back: it moved as its levers said.", True
    if cause.reason in PLACE_CAUSES and cause.limit is not None:
        verb = "Stopped by" if stopping(cause) else "Slowed by"
        return f"{verb} {result.name_of(cause.limit)}: the {cause.link} came no nearer.", True
    words = CAUSE_WORDS.get(ReasonCode(cause.reason), cause.reason.replace("_", " "))
    return f"Held back by {words}{f' ({cause.joint})' if cause.joint else ''}, not by a limit.", True


def details(result: RunResult) -> str:
    """Return the sentence with the numbers behind the headline."""
    if result.min_clearance_m is None:
        return "No limit was in sight of the machine during the run."
    inside = "It was never inside a limit" if not result.entries else f"It was inside a limit {len(result.entries)}×"
    return (
        f"Smallest true clearance {result.min_clearance_m:.3f} m, of the {result.min_link} to "
        f"{result.name_of(result.min_limit)}, at {result.nearest.t_s:.2f} s. {inside}, checked against geometric "
        f"truth {result.substeps}× per tick."
    )
