"""A certificate: what of, what was assumed, what came of it."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from workgauge.machine.load import read_description
from workgauge.machine.parts import Stopping
from workgauge.rehearse.certify.conditions import Condition
from workgauge.rehearse.certify.driving import Driver
from workgauge.rehearse.certify.fingerprint import Fingerprint
from workgauge.rehearse.certify.outcome import Outcome, certificate_id


@dataclass(frozen=True, slots=True)
class JointStopping:
    """How one direction of a joint stops, as the machine's file has it.

    Attributes:
        joint: name. way: `+` or `-`. prismatic: whether it slides. full_speed: [rad/s, m/s].
        stopping: the model. assumed: whether the file says its numbers are a guess. source: where they are from.
    """

    joint: str
    way: str
    prismatic: bool
    full_speed: float
    stopping: Stopping
    assumed: bool
    source: str

    def as_json(self) -> dict[str, Any]:
        """Return it in the units of the machine's file; a deceleration of None stands for no limit."""
        scale, unit = (1.0, "m") if self.prismatic else (float(np.degrees(1.0)), "deg")
        stopping = self.stopping
        finite = np.isfinite(stopping.deceleration)
        return {
            "joint": self.joint,
            "way": self.way,
            f"full_speed_{unit}_s": self.full_speed * scale,
            "dead_time_s": stopping.dead_time_s,
            "lag_s": stopping.lag_s,
            f"deceleration_{unit}_s2": stopping.deceleration * scale if finite else None,
            "tolerance_percent": 100.0 * stopping.tolerance,
            "ideal": stopping.ideal,
            "assumed": self.assumed,
            "source": self.source,
        }


@dataclass(frozen=True, slots=True)
class Certificate:
    """All a certificate says.

    Attributes:
        title: of the machine. fingerprint: what of. joints: how they stop. warnings: what it says nothing about.
        outcome: of the drives. wanted: how many drives within the model were asked for. delays_s: injected.
    """

    title: str
    fingerprint: Fingerprint
    joints: tuple[JointStopping, ...]
    warnings: tuple[str, ...]
    outcome: Outcome
    wanted: int
    delays_s: tuple[float, ...]

    def as_json(self) -> dict[str, Any]:
        """Return the documented object; `id` is the check sum of all the rest."""
        told = {
            "machine": self.title,
            **self.outcome.as_json(),
            "drives_wanted": self.wanted,
            "dead_times_s": list(self.delays_s),
            "stopping": [one.as_json() for one in self.joints],
            "warnings": list(self.warnings),
            "fingerprint": self.fingerprint,
        }
        return {"id": certificate_id(told), **told}


def joint_stopping(driver: Driver) -> tuple[JointStopping, ...]:
    """Return how each joint and direction of the machine's file stops."""
    machine = driver.machine
    _, content = read_description(driver.subject.machine)
    written = {one["name"]: one for one in content["joints"] if isinstance(one, dict) and "name" in one}
    found = []
    for j, name in enumerate(machine.joint_names):
        for way, key, sides, speeds in (
            ("+", "stopping_positive", machine.stopping_positive, machine.speed_positive),
            ("-", "stopping_negative", machine.stopping_negative, machine.speed_negative),
        ):
            block = written.get(name, {}).get(key) or {}
            found.append(
                JointStopping(
                    name,
                    way,
                    bool(machine.prismatic[j]),
                    float(speeds[j]),
                    sides[j],
                    bool(block.get("assumed", False)),
                    str(block.get("source") or ""),
                )
            )
    return tuple(found)


def warnings(joints: Sequence[JointStopping], which: Sequence[Condition], outcome: Outcome) -> tuple[str, ...]:
    """Return what a certificate says nothing about, and how to mend that."""
    said = []
    how = "`workgauge identify` makes the stopping blocks from a log of steps and stops"
    ideal = _names(one.joint for one in joints if one.stopping.ideal)
    if ideal:
        whose = "every joint" if len(ideal) == len(_names(one.joint for one in joints)) else ", ".join(ideal)
        said.append(
            f"the machine's file says of {whose} that it stops at once: this certificate says NOTHING about the "
            f"hydraulics there; {how}"
        )
    guessed = _names(one.joint for one in joints if one.assumed)
    if guessed:
        said.append(f"how {', '.join(guessed)} stop is a guess in the machine's file, to be confirmed; {how}")
    sure = _names(one.joint for one in joints if not one.stopping.ideal and one.stopping.tolerance == 0.0)
    if sure:
        said.append(f"the file gives {', '.join(sure)} no tolerance: nothing worse than its numbers was driven")
    if outcome.undriven:
        said.append(
            f"{outcome.undriven} drives found no posture clear of everything to begin from; they are left out"
        )
    if outcome.within.drives and not outcome.on_site:
        said.append(
            "nowhere drawn on the site was the machine clear of everything: all drives are among random limits"
        )
    if not any(one.bus.late_s for one in which):
        said.append("the model has no room for a bus or a computer that is late: none was driven")
    return tuple(said)


def _names(names: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(names))
