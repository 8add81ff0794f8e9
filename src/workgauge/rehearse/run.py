"""Runs a scenario from its first tick to its last and gathers everything it shows."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from workgauge.guard.api import Guard
from workgauge.guard.travel import Brakes
from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.motion.job import JobFacts
from workgauge.rehearse.automatic import Automatic
from workgauge.rehearse.dug import dug_in
from workgauge.rehearse.interventions import InterventionLog
from workgauge.rehearse.operator import Operator, View
from workgauge.rehearse.recording import Recorder
from workgauge.rehearse.result import RunResult, Snapshot
from workgauge.rehearse.scenario import (
    DriveBack,
    DriveLine,
    Hold,
    Start,
    StateChange,
    Step,
    Swing,
    Target,
    TravelStep,
)
from workgauge.rehearse.scenario_file import LoadedScenario
from workgauge.rehearse.session import Session
from workgauge.rehearse.setting import INTENT_AGE_S
from workgauge.rehearse.step_result import StepResult
from workgauge.rehearse.targets import Targets, solid_points
from workgauge.rehearse.travelling import Driver
from workgauge.rehearse.true_machine import SUBSTEPS
from workgauge.rehearse.words import run_assumptions, run_facts
from workgauge.values.arrays import Floats
from workgauge.values.errors import ScenarioError
from workgauge.values.limits import Limit

#: No drive lasts longer than this [s].
LONGEST_S = 900.0

#: What turns automatic steps into jobs, and what it has to say beforehand.
Plans: TypeAlias = tuple[Automatic, tuple[str, ...]]

#: Limits within this of the machine are kept for drawing [m].
DRAW_WITHIN_M = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class Progress:
    """Where a run is: handed to the progress callback after every tick.

    Attributes:
        t_s: simulated time [s]. words: the drive's step. step, steps: its place among them, counted from 0.
        clearance_m, limit, link: nearest true clearance to a limit, None if none is in sight.
        result: the step just done.
    """

    t_s: float
    words: str
    step: int
    steps: int
    clearance_m: float | None
    limit: str | None
    link: str | None
    result: StepResult


def default_drive(lever: float = 0.8) -> tuple[Step, ...]:
    """Return the drive used where no scenario is given: swing to the nearest point, go at it, stand, come back."""
    target = Target(nearest="point")
    return (
        Hold(do="hold", for_s=0.5),
        Swing(do="swing_to", target=target, lever=0.7 * lever),
        DriveLine(do="tool_line", target=target, lever=lever, stopped_for_s=0.8),
        Hold(do="hold", for_s=0.5),
        DriveBack(do="back", lever=lever),
        Hold(do="hold", for_s=0.5),
    )


def drive_at_anything(steps: Sequence[Step]) -> tuple[Step, ...]:
    """Return the same drive aimed at the nearest limit of any kind."""
    anything = Target(nearest="any")
    return tuple(
        step.model_copy(update={"target": anything}) if isinstance(step, Swing | DriveLine) else step
        for step in steps
    )


def open_session(
    loaded: LoadedScenario,
    *,
    guard: Guard | None = None,
    machine: MachineModel | None = None,
    intent_age_s: float = INTENT_AGE_S,
) -> Session:
    """Return the session a scenario describes.

    Args:
        loaded: the scenario. guard, machine: ready-made, in place of the scenario's own.
        intent_age_s: oldest intent to move on [s].

    Raises:
        InputError: if anything in it cannot be used.
    """
    scenario = loaded.scenario
    with loaded.placed():
        machine = machine or load_machine(loaded.machine, scenario.attachment)
        if loaded.posture is not None:
            _check_units(scenario.start, machine)
        return Session(
            site=list(loaded.site_files),
            machine=machine,
            rules=loaded.rules,
            guard=guard or scenario.guard.name,
            at=loaded.place,
            posture=loaded.posture,
            guard_parameters=scenario.guard.parameters,
            tick_s=scenario.tick_ms * 1e-3,
            epsg=loaded.epsg,
            brakes=Brakes(scenario.brakes.deceleration_m_s2, scenario.brakes.reaction_s),
            joints=scenario.joints,
            sensors=scenario.sensors,
            faults=scenario.faults,
            start_utc=scenario.start_utc,
            intent_age_s=intent_age_s,
        )


def _check_units(start: Start, machine: MachineModel) -> None:
    """Refuse a start posture that gives a joint in the other kind's unit, or twice."""
    for name in {**start.posture_deg, **start.posture_m}:
        if name not in machine.joint_names:
            continue
        prismatic = bool(machine.prismatic[machine.joint_names.index(name)])
        right, wrong = (start.posture_m, "posture_deg") if prismatic else (start.posture_deg, "posture_m")
        if name not in right or name in getattr(start, wrong):
            raise ScenarioError(
                f"joint {name} is {'prismatic' if prismatic else 'revolute'}",
                element=f"start.{wrong}",
                value=name,
                allowed=f"only in {'posture_m, in metres' if prismatic else 'posture_deg, in degrees'}",
            )


def planned_drive(session: Session, steps: Sequence[Step]) -> Plans:
    """Plan the automatic steps of a drive before anything moves.

    Raises:
        ScenarioError: for the first step that cannot be done, with where and why.
    """
    automatic = Automatic(session.machine, session.frame, session.surroundings, session.limit_names, session.site)
    return automatic, automatic.checked(steps, *session.true_state)


def run_scenario(loaded: LoadedScenario, progress: Callable[[Progress], None] | None = None) -> RunResult:
    """Run a scenario to its end."""
    scenario = loaded.scenario
    session = open_session(loaded)
    facts = {"scenario": loaded.file.stem}
    with loaded.placed():
        return run_session(
            session,
            scenario.drive,
            scenario.title,
            scenario.description,
            facts,
            progress,
            travel=scenario.travel,
            states=scenario.states,
        )


def run_session(
    session: Session,
    steps: Sequence[Step],
    title: str,
    description: str = "",
    facts: dict[str, str] | None = None,
    progress: Callable[[Progress], None] | None = None,
    *,
    travel: Sequence[TravelStep] = (),
    states: Sequence[StateChange] = (),
    plans: Plans | None = None,
) -> RunResult:
    """Drive a session through the steps.

    Args:
        session: fresh; a run ends with the drive, or when it is `finished`. steps: what the levers do.
        title, description, facts: for the report.
        progress: called after every tick.
        travel: what the undercarriage does meanwhile. states: work states switched, and when.
        plans: of the automatic steps, as `planned_drive` returns them; planned here if left out.

    Raises:
        ScenarioError: if a step is aimed at something that does not exist, a state is unknown, or the drive never
            ends.
    """
    automatic, notes = plans or planned_drive(session, steps)
    operator = Operator(steps, session.machine, _targets(session), automatic)
    along_m, facing = session.start_along_m or (None, 1.0)
    driver = Driver(travel, along_m, facing, session.brakes)
    switches = _switches(session, states)
    recorder, log = Recorder(session.moving.drive), InterventionLog()
    start = session.snapshot()
    before = _in_machine(session.tool, session.true_state[1])
    job: JobFacts | None = None
    while session.t_s < LONGEST_S and not session.finished:
        while switches and switches[0].at_s <= session.t_s + 1e-9:
            change = switches.pop(0)
            session.set_state(change.state, change.on)
        q, T = session.true_state
        tool = session.tool
        here = _in_machine(tool, T)
        speed = float(np.linalg.norm(here - before)) / session.tick_s
        hands = operator.hands(
            View(session.t_s, q, T, tool, speed, session.ready, not driver.over, job, session.T_believed)
        )
        if hands is None:
            break
        speed_m_s, travelled_m = session.true_travel
        wanted = driver.wants(session.t_s, travelled_m, speed_m_s) if hands.enable else (0.0, 0.0)
        session.travel(*wanted)
        intent = session.intent(hands.mode, hands.levers, enable=hands.enable, line=hands.line)
        done = session.step(intent, hands.job)
        job = done.trace.job
        recorder.take(done, q, T, tool, operator.step, hands.job)
        reasons = (*done.trace.reasons, *done.travel.reasons)
        log.take(done.t_s, session.tick_s, reasons, not hands.levers.neutral or bool(wanted[0]))
        before = here
        if progress is not None:
            progress(_progress(session, operator, len(steps), done))
    if session.t_s >= LONGEST_S:
        raise ScenarioError("the drive does not end", element="drive", allowed=f"at most {LONGEST_S:g} s in all")
    words = title, description, facts or {}
    result = _result(session, operator, recorder, log, start, words, bool(states), notes)
    return replace(result, dug=dug_in(session, steps, result.series, result.automatic))


def _in_machine(tool: Floats, T_site_machine: Floats) -> Floats:
    """Return a tool point as seen from the undercarriage: one that is only carried along stands still."""
    return np.asarray(T_site_machine[:3, :3].T @ (tool - T_site_machine[:3, 3]), dtype=np.float64)


def _switches(session: Session, states: Sequence[StateChange]) -> list[StateChange]:
    """Return the changes of work states by their time; refuse unknown ones before anything runs."""
    for change in states:
        session.check_state(change.state)
    return sorted(states, key=lambda change: change.at_s)


def _targets(session: Session) -> Targets:
    def nearest_of_all() -> Floats | None:
        return session.snapshot().point_limit

    return Targets(session.limits, session.frame, nearest_of_all)


def _progress(session: Session, operator: Operator, steps: int, done: StepResult) -> Progress:
    near = done.truth.limit
    return Progress(
        t_s=session.t_s,
        words=operator.begun[-1][0],
        step=operator.step,
        steps=steps,
        clearance_m=None if near is None else near.distance_m,
        limit=None if near is None else session.limit_name(near.limit),
        link=None if near is None else near.link,
        result=done,
    )


def _result(
    session: Session,
    operator: Operator,
    recorder: Recorder,
    log: InterventionLog,
    start: Snapshot,
    words: tuple[str, str, dict[str, str]],
    switched: bool,
    notes: tuple[str, ...],
) -> RunResult:
    title, description, facts = words
    truth, machine = session.truth, session.machine
    near = None if truth.nearest is None else truth.nearest.limit
    own = None if truth.nearest_own is None else truth.nearest_own.own
    entries = truth.entries()
    travel = recorder.travels()
    places = session.true_state[1][None, :2, 3] if travel is None else travel.path
    return RunResult(
        title=title,
        description=description,
        facts=facts | run_facts(session),
        joint_names=machine.joint_names,
        prismatic=tuple(bool(slides) for slides in machine.prismatic),
        tick_s=session.tick_s,
        substeps=SUBSTEPS,
        slow_distance_m=getattr(session.guard, "slow_distance_m", None),
        stop_distance_m=getattr(session.guard, "stop_distance_m", None),
        series=recorder.series(),
        steps=tuple(operator.begun),
        min_clearance_m=None if near is None else near.distance_m,
        min_limit=None if near is None else near.limit,
        min_link=None if near is None else near.link,
        min_self_clearance_m=None if own is None else own.distance_m,
        min_self_pair=None if own is None else (own.link, own.limit.removeprefix("self:")),
        entries=tuple(entry for entry in entries if not entry.limit.startswith("self:")),
        self_entries=tuple(entry for entry in entries if entry.limit.startswith("self:")),
        interventions=log.interventions(),
        tick_ms=recorder.tick_times(),
        start=start,
        nearest=truth.nearest_snapshot or start,
        end=session.snapshot(),
        limits=_near(session.limits, places),
        limit_names={limit.id: limit.name for limit in session.limit_set.limits},
        assumptions=run_assumptions(session, travel is not None, switched),
        warnings=(
            *session.site.warnings,
            *session.limit_set.warnings,
            *session.stand.warnings,
            *notes,
            *operator.notes,
        ),
        position=recorder.positions(),
        travel=travel,
        automatic=recorder.automatic(machine, session.true_state[1], session.tick_s),
    )


def _near(limits: Sequence[Limit], places: Floats) -> tuple[Limit, ...]:
    """Return the limits whose bounding box comes near any of the machine's places (k, 2)."""

    def close(limit: Limit) -> bool:
        points = solid_points(limit.solid)[:, :2]
        gaps = np.maximum(points.min(axis=0) - places, places - points.max(axis=0))
        return bool((np.linalg.norm(np.maximum(gaps, 0.0), axis=1) <= DRAW_WITHIN_M).any())

    return tuple(limit for limit in limits if close(limit))
