"""What a stop certificate says in words: verdict, guarantee, assumptions, and what it is not."""

from workgauge.rehearse.certify.certificate import Certificate
from workgauge.rehearse.certify.outcome import CONFIDENCE, Outcome

NOT_SAFETY = (
    "workgauge assists the operator and records evidence. It is <strong>not a certified safety function</strong>: "
    "software of this kind claims no performance level, the machine's certified stop stays in charge, and a "
    "signature below says that somebody has read this, no more. The drives are simulated; no machine moved."
)

ASSUMPTIONS = (
    "Every joint stops within its stopping model: dead time and lag at most 1 + tolerance times those of the table, "
    "deceleration at least 1 / (1 + tolerance) of it, full speed at most as written.",
    "A late bus and missed ticks use up room of that same tolerance; with the dead time they stay within it. The "
    "guard learns of a missed tick only afterwards: these drives try it, the proof does not cover it.",
    "Pose and posture are known. What the sensors leave open is kept as protection level on the machine; these "
    "drives are with perfect sensors.",
    "The undercarriage stands, and limits do not move while it works.",
    "The machine's solids enclose it, attachment, hoses and load included.",
    "What stands around is in the site's files, and the rule book makes a limit of it.",
)

BREAKS = (
    "Cold oil, worn valves, another load or attachment than the stopping model was identified with.",
    "What the first-order model does not have: swinging of a soft structure, dead bands, a cylinder's changing "
    "leverage. Identified models count it as dead time; a guessed one may not.",
    "Another program version, machine file, rule book or site: the check sums below are then others, and this "
    "certificate is none.",
)


def headline(came: Outcome) -> str:
    """Return the verdict."""
    if came.passed:
        return f"Passed: {came.within.drives} random drives, none entered a limit or fell below a stop distance."
    if not came.within.drives:
        return "Not passed: nothing was driven within the model."
    return (
        f"Not passed: of {came.within.drives} random drives {came.within.entered} entered a limit and "
        f"{came.within.below} fell below a stop distance."
    )


def details(certificate: Certificate) -> str:
    """Return the sentence with the numbers behind the headline."""
    worst = certificate.outcome.worst
    if worst is None:
        return "Nothing came near the machine in any drive."
    side = "above" if worst.less_stop_m >= 0.0 else "below"
    return (
        f"The least was left by the {worst.link} at {_limit(worst.kind, worst.limit)} in drive {worst.seed} "
        f"({worst.condition}): {abs(worst.less_stop_m) * 1000:.1f} mm {side} the stop distance that applies there, "
        f"at a clearance of {worst.clearance_m:.3f} m."
    )


def guaranteed(certificate: Certificate) -> str:
    """Return what follows from the drives, and what from the guard's own verification."""
    came = certificate.outcome
    if not came.passed:
        return "Nothing: this certificate was not passed."
    sample = (
        f"These {came.within.drives} drives are a sample: with {100 * CONFIDENCE:.0f} % confidence at most "
        f"{_percent(came.failing_share)} of such drives fail."
    )
    if certificate.fingerprint["guard"]["name"] != "barrier":
        return sample
    return (
        "Before a command leaves, the guard bounds the stop that would follow it over the whole tolerance of the "
        "stopping model, and sends none that might not end in time (docs/guarantee.md has the proof). The drives "
        f"look for a gap in that, and found none. {sample}"
    )


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"


def _limit(kind: str, limit: str) -> str:
    return f"the machine's own {limit}" if kind == "self" else f"{limit} ({kind.replace('_', ' ')})"
