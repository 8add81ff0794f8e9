"""Driving one drive of a certificate, and what is kept of it."""

import math
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from workgauge.gauge.rulebook import load_rule_book
from workgauge.guard.api import Guard
from workgauge.guard.linear import LinearGuard
from workgauge.guard.registry import guard_named
from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.rehearse.certify.conditions import Condition, Task, conditions
from workgauge.rehearse.drives.draw import Drive, Drives
from workgauge.rehearse.drives.run import DriveRun, run_drive
from workgauge.rehearse.drives.watch import OWN, Nearest
from workgauge.site.read import read_site
from workgauge.values.errors import ScenarioError
from workgauge.values.reasons import STOPPING

#: One drive in so many within the model is driven by linear scaling as well.
COMPARED = 5
#: What is told apart from a clearance of zero [m].
ROUNDING_M = 1e-4
#: Drives drawn first of all in every process: to the last digits (1e-10 m), a distance to a mesh depends on what the
#: process looked at first, and processes begin with different drives.
_FIRST = 4
#: A guard that names no stop distance is held to this [m].
STOP_DISTANCE_M = 0.2


@dataclass(frozen=True, slots=True)
class Subject:
    """What is certified; enough to make it in any process.

    Attributes:
        machine, rules: a shipped name or a file. site_files: of the site. epsg: its coordinate system, where its
            files name none. guard: its name. delays_s: dead times injected. seconds: of lever work per drive.
    """

    machine: str
    rules: str
    site_files: tuple[str, ...]
    guard: str
    epsg: int | None = None
    delays_s: tuple[float, ...] = ()
    seconds: float = 4.0


@dataclass(frozen=True, slots=True)
class Held:
    """Time the guard took from the operator at one kind of limit with one link [s]."""

    kind: str
    link: str
    seconds: float


@dataclass(frozen=True, slots=True)
class Linear:
    """The same drive by linear scaling: its motion, and whether it kept every stop distance."""

    motion: float
    kept: bool


@dataclass(frozen=True, slots=True)
class Driven:
    """One drive of a certificate.

    Attributes:
        condition, seed: which. kind: of drive. place: words; empty if no clear start was found and nothing driven.
        entered: ids of the limits entered.
        worst_clearance_m, worst_less_stop_m: smallest true clearance, and less its stop distance; None if nothing was
            in sight.
        nearest: the same per kind of limit and link, of what came near.
        motion, free_motion: way of all joints with the guard, and of the same hands without any [rad, m].
        levers_s: time levers were worked with the gate open. held: what the guard took of it [s].
        linear: for comparison, on some drives.
    """

    condition: str
    seed: int
    kind: str
    place: str
    entered: tuple[str, ...] = ()
    worst_clearance_m: float | None = None
    worst_less_stop_m: float | None = None
    nearest: tuple[Nearest, ...] = ()
    motion: float = 0.0
    free_motion: float = 0.0
    levers_s: float = 0.0
    held: tuple[Held, ...] = ()
    linear: Linear | None = None

    @property
    def below(self) -> bool:
        """Whether a true clearance fell below its stop distance."""
        return self.worst_less_stop_m is not None and self.worst_less_stop_m < -ROUNDING_M

    @property
    def failed(self) -> bool:
        """Whether it speaks against the guard."""
        return bool(self.entered) or self.below

    def plain(self) -> dict[str, Any]:
        """Return it as dicts, lists, numbers and strings."""
        return asdict(self)

    @classmethod
    def of_plain(cls, plain: dict[str, Any]) -> "Driven":
        """Return the drive whose `plain` form this is, from JSON too."""
        return cls(
            **{
                **plain,
                "entered": tuple(plain["entered"]),
                "nearest": tuple(Nearest(**one) for one in plain["nearest"]),
                "held": tuple(Held(**one) for one in plain["held"]),
                "linear": None if plain["linear"] is None else Linear(**plain["linear"]),
            }
        )


class Driver:
    """Drives a subject's drives; what they share is made once.

    Args:
        subject: what is certified.

    Raises:
        InputError: if any of its files cannot be used.
    """

    def __init__(self, subject: Subject) -> None:
        self.subject = subject
        self.machine: MachineModel = load_machine(subject.machine)
        self.guard: Guard = guard_named(subject.guard)
        self.stop_distance_m = float(getattr(self.guard, "stop_distance_m", STOP_DISTANCE_M))
        self.conditions = conditions(self.machine, subject.delays_s)
        self._site = read_site([Path(file) for file in subject.site_files], epsg=subject.epsg)
        self._rules = load_rule_book(subject.rules)

    @cached_property
    def _drives(self) -> Drives:
        drives = Drives(self.machine, self._site, self._rules)
        settings = self.conditions[0].settings(self.machine, self.stop_distance_m, self.subject.seconds)
        for seed in range(_FIRST):
            with suppress(ScenarioError):
                drives.draw(seed, settings)
        return drives

    def drive(self, task: Task) -> Driven:
        """Drive one, bit for bit the same every time."""
        condition = next(one for one in self.conditions if one.key == task.condition)
        settings = condition.settings(self.machine, self.stop_distance_m, self.subject.seconds)
        try:
            drive = condition.applied(self._drives.draw(task.seed, settings))
        except ScenarioError:
            return Driven(task.condition, task.seed, "", "")
        run = DriveRun(drive, self.guard, condition.bus)
        levers_s, held = _watched(drive, run)
        result = run.result()
        seen = math.isfinite(result.worst_clearance_m)
        return Driven(
            condition=task.condition,
            seed=task.seed,
            kind=result.kind,
            place=result.place,
            entered=result.entered,
            worst_clearance_m=result.worst_clearance_m if seen else None,
            worst_less_stop_m=result.worst_less_stop_m if seen else None,
            nearest=result.nearest,
            motion=result.motion,
            free_motion=result.free_motion,
            levers_s=levers_s,
            held=held,
            linear=self._linear(condition, drive),
        )

    def _linear(self, condition: Condition, drive: Drive) -> Linear | None:
        """Return the same drive by linear scaling, for comparison on some."""
        if not condition.within or drive.seed % COMPARED or isinstance(self.guard, LinearGuard):
            return None
        guard = LinearGuard(slow_distance_m=self.stop_distance_m + 0.6, stop_distance_m=self.stop_distance_m)
        result = run_drive(drive, guard, condition.bus)
        return Linear(result.motion, not result.entries and result.worst_less_stop_m >= -ROUNDING_M)


def _watched(drive: Drive, run: DriveRun) -> tuple[float, tuple[Held, ...]]:
    """Drive to the end; return how long levers were worked with the gate open, and what limits took of that."""
    kinds = {limit.id: limit.kind.value for limit in drive.place.scene.limits}
    held: dict[tuple[str, str], float] = {}
    worked, dt_s = 0, drive.settings.dt_s
    for step in run.steps():
        trace = step.trace
        if not trace.desired.any() or any(reason.code in STOPPING for reason in trace.reasons):
            continue
        worked += 1
        cause = next((reason for reason in trace.reasons if reason.limit is not None), None)
        if cause is not None and trace.scale < 1.0:
            key = kinds.get(str(cause.limit), OWN), cause.link or ""
            held[key] = held.get(key, 0.0) + dt_s * (1.0 - trace.scale)
    return worked * dt_s, tuple(Held(*key, held[key]) for key in sorted(held))
