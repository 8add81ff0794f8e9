"""`workgauge run --gnss`: a run whose undercarriage stands where logs or serial ports say."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import typer

from workgauge.app.output import stderr
from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.rehearse.gnss_session import LONGEST_S, GnssSession
from workgauge.rehearse.receivers import LogReceivers, Receivers, open_receivers
from workgauge.rehearse.run import default_drive, drive_at_anything
from workgauge.rehearse.scenario import Hold, StateChange, Step
from workgauge.rehearse.scenario_file import LoadedScenario
from workgauge.rehearse.session import Session
from workgauge.site.read import read_site
from workgauge.values.errors import ScenarioError
from workgauge.values.limits import LimitKind

Prepared = tuple[Session, Sequence[Step], tuple[str, str], dict[str, str], Sequence[StateChange]]


#: Levers stay neutral so much longer than positioning needed to find the machine [s].
SETTLE_S = 1.0


@dataclass(frozen=True, slots=True)
class OwnSite:
    """A site of the user's own, and what works there."""

    files: Sequence[Path]
    machine: str
    rules: str
    guard: str
    epsg: int | None
    joints: Literal["ideal", "hydraulic"] = "ideal"


@contextmanager
def gnss_run(given: Sequence[str], on: LoadedScenario | OwnSite) -> Iterator[Prepared]:
    """Yield session, steps, words, facts and states of a run on receivers; devices are given back at its end.

    A scenario's start place, posture, sensors and faults do not count: the receivers say where the machine is.

    Args:
        given: the values of `--gnss`. on: what is run.

    Raises:
        InputError: for receivers, machine and site that do not fit together; for a scenario that travels by itself.
    """
    if isinstance(on, LoadedScenario) and on.scenario.travel:
        raise ScenarioError(
            "the scenario travels by itself", file=on.file, element="travel", allowed="no travel with --gnss"
        )
    model = load_machine(on.machine, on.scenario.attachment if isinstance(on, LoadedScenario) else None)
    receivers = open_receivers(given, model)
    try:
        if stderr().is_terminal and not isinstance(receivers, LogReceivers):
            stderr().print(f"waiting for a position from {receivers.words}")
        session, steps, words, facts, states = (
            _scenario(receivers, on, model) if isinstance(on, LoadedScenario) else _own_site(receivers, on, model)
        )
        steps = (
            Hold(do="hold", for_s=receivers.lead_s + SETTLE_S),
            *steps,
        )  # levers neutral until there is a position
        if isinstance(receivers, LogReceivers):  # stand until the logs end
            steps = (*steps, Hold(do="hold", for_s=max(min(receivers.left_s, LONGEST_S), 0.1)))
        yield session, steps, words, facts, states
    finally:
        receivers.close()


def _scenario(receivers: Receivers, on: LoadedScenario, model: MachineModel) -> Prepared:
    scenario = on.scenario
    session = GnssSession(
        receivers,
        read_site(list(on.site_files), epsg=on.epsg),
        model,
        rules=on.rules,
        guard=scenario.guard.name,
        guard_parameters=scenario.guard.parameters,
        tick_s=scenario.tick_ms * 1e-3,
        joints=scenario.joints,
    )
    words = scenario.title, scenario.description
    return session, scenario.drive, words, {"scenario": on.file.stem}, scenario.states


def _own_site(receivers: Receivers, on: OwnSite, model: MachineModel) -> Prepared:
    site = read_site(list(on.files), epsg=on.epsg)
    session = GnssSession(receivers, site, model, rules=on.rules, guard=on.guard, joints=on.joints)
    steps: tuple[Step, ...] = default_drive()
    if not any(limit.kind is LimitKind.POINT for limit in session.limits):
        steps = drive_at_anything(steps)
        if session.snapshot().point_limit is None:
            steps = (Hold(do="hold", for_s=1.0),)
    words = "Run where the receivers are", "The machine drives its tool at the nearest limit and comes back."
    return session, steps, words, {}, ()


def refuse_place(at: str | None) -> None:
    """Refuse a place beside receivers.

    Raises:
        typer.BadParameter: if there is one.
    """
    if at is not None:
        raise typer.BadParameter("the receivers say where the machine stands; leave out --at", param_hint="--at")
