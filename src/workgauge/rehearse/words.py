"""What a run says of itself: what was run on what, and what that takes for granted."""

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from workgauge.rehearse.session import Session
from workgauge.rehearse.true_machine import SUBSTEPS


def run_facts(session: Session) -> dict[str, str]:
    """Return what was run on what, label to text, in order."""
    machine, crs = session.machine, session.site.crs
    own = session.stand.own_track
    return {
        "site": ", ".join(Path(file).name for file in session.site.files),
        "coordinates": "none stated" if crs is None else f"{crs.name} (EPSG {crs.epsg})",
        "machine": f"{machine.title} ({machine.name}), {machine.attachment}",
        "rules": f"{session.rules.title} ({session.rules.name})",
        "guard": _guard_words(session.guard),
        "joints": session.moving.words,
        "sensors": session.senses.words,
        "stands": session.stand.words,
        "own track, let off": "none" if own is None else own.strip(),
        "limits": str(len(session.limits)),
    }


def _guard_words(guard: Any) -> str:
    """Return a guard's name and, if it has any, its parameters."""
    names = [field.name for field in fields(guard)] if is_dataclass(guard) else []
    return ", ".join([guard.name, *(f"{name} {getattr(guard, name)}" for name in names)])


def run_assumptions(session: Session, travelled: bool, switched: bool) -> tuple[str, ...]:
    """Return what a run takes for granted.

    Args:
        session: as it was run. travelled: whether the undercarriage was to travel. switched: whether states were.
    """
    brakes = session.brakes
    travel = (
        f"The undercarriage travels as its driver wants, less what is left before any clearance, less its protection"
        f" level, could fall below its stop distance while braking at {brakes.deceleration_m_s2:g} m/s² after"
        f" {brakes.reaction_s:g} s. The guard itself rules over joints only: braking and joint motion each stop in"
        " time alone, together they rely on the stop distance."
    )
    states = (
        "Work states were switched by the scenario; whoever switches one off answers for it."
        if switched
        else "Every work state is on: every track but those the machine stands on counts as open to traffic."
    )
    return (
        session.moving.assumption,
        session.senses.assumption,
        travel if travelled else session.standing_assumption,
        *((states,) if session.states else ()),
        "The site is as its files say; what they leave out is not guarded.",
        "Links are as large as the boxes of the machine's description"
        f" ({len(session.machine.solids)} of them); clearances are those of the boxes.",
        f"Truth is checked {SUBSTEPS} times per tick of {session.tick_s * 1000:g} ms, on the simulated posture.",
    )
