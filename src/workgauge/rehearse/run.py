"""Runs a scenario from its first tick to its last and gathers everything it shows."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.rehearse.interventions import InterventionLog
from workgauge.rehearse.operator import Operator, View
from workgauge.rehearse.result import RunResult, Series, Snapshot, TickTimes
from workgauge.rehearse.scenario import DriveBack, DriveLine, Hold, Start, Step, Swing, Target
from workgauge.rehearse.scenario_file import LoadedScenario
from workgauge.rehearse.session import SUBSTEPS, Session, StepResult
from workgauge.rehearse.targets import Targets, solid_points
from workgauge.rehearse.truth import Reading
from workgauge.values.arrays import Floats
from workgauge.values.errors import ScenarioError
from workgauge.values.limits import Limit

#: No drive lasts longer than this [s].
LONGEST_S = 900.0

#: The clearances of this many limits, those that came nearest, are kept over time.
CURVES = 4

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


def open_session(loaded: LoadedScenario) -> Session:
    """Return the session a scenario describes.

    Raises:
        InputError: if anything in it cannot be used.
    """
    scenario = loaded.scenario
    try:
        machine = load_machine(loaded.machine, scenario.attachment)
        if loaded.posture is not None:
            _check_units(scenario.start, machine)
        return Session(
            site=list(loaded.site_files),
            machine=machine,
            rules=loaded.rules,
            guard=scenario.guard.name,
            at=loaded.place,
            posture=loaded.posture,
            guard_parameters=scenario.guard.parameters,
            tick_s=scenario.tick_ms * 1e-3,
            epsg=loaded.epsg,
        )
    except ScenarioError as error:
        if error.file is not None:
            raise
        raise ScenarioError(
            error.message, file=loaded.file, element=error.element, value=error.value, allowed=error.allowed
        ) from error


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


def run_scenario(loaded: LoadedScenario, progress: Callable[[Progress], None] | None = None) -> RunResult:
    """Run a scenario to its end."""
    scenario = loaded.scenario
    session = open_session(loaded)
    facts = {"scenario": loaded.file.stem}
    return run_session(session, scenario.drive, scenario.title, scenario.description, facts, progress)


class _Recorder:
    """Gathers the rows of `Series` while a run goes on."""

    def __init__(self) -> None:
        self.rows: list[tuple[float, Floats, Floats, Floats, tuple[int, ...], float]] = []
        self.true_m: list[float] = []
        self.believed_m: list[float] = []
        self.self_m: list[float] = []
        self.tool: list[Floats] = []
        self.step: list[int] = []
        self.tick_ms: list[float] = []
        self.by_limit: list[Mapping[str, float]] = []

    def take(self, done: StepResult, q: Floats, tool: Floats, step: int) -> None:
        trace = done.trace
        scale = trace.scale if trace.desired.any() else 1.0  # nothing wanted, nothing held back
        self.rows.append((done.t_s, q, trace.desired, trace.allowed, trace.valves, scale))
        self.true_m.append(_metres(done.truth, own=False))
        self.self_m.append(_metres(done.truth, own=True))
        seen = trace.clearances
        outer = seen.distances[seen.other_links < 0] if seen is not None else np.array([])
        self.believed_m.append(float(outer.min()) if len(outer) else math.nan)
        self.tool.append(tool)
        self.step.append(step)
        self.tick_ms.append(done.tick_ms)
        self.by_limit.append(done.truth.by_limit)

    def series(self) -> Series:
        t_s, q, wanted, allowed, valves, scale = (
            np.array(column, dtype=np.float64) for column in zip(*self.rows, strict=True)
        )
        return Series(
            t_s,
            q,
            wanted,
            allowed,
            valves,
            scale,
            np.array(self.true_m),
            np.array(self.believed_m),
            np.array(self.self_m),
            np.array(self.tool),
            np.array(self.step, dtype=np.float64),
            self._nearest_limits(),
        )

    def _nearest_limits(self) -> dict[str, Floats]:
        """Return the clearance over time of the limits that came nearest."""
        least: dict[str, float] = {}
        for row in self.by_limit:
            for limit, distance in row.items():
                least[limit] = min(distance, least.get(limit, distance))
        nearest = sorted(least, key=lambda limit: (least[limit], limit))[:CURVES]
        return {limit: np.array([row.get(limit, math.nan) for row in self.by_limit]) for limit in nearest}

    def tick_times(self) -> TickTimes:
        p50, p99 = np.percentile(self.tick_ms, [50, 99])
        return TickTimes(float(p50), float(p99), max(self.tick_ms))


def _metres(reading: Reading, own: bool) -> float:
    found = reading.own if own else reading.limit
    return math.nan if found is None else found.distance_m


def run_session(
    session: Session,
    steps: Sequence[Step],
    title: str,
    description: str = "",
    facts: dict[str, str] | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> RunResult:
    """Drive a session through the steps.

    Args:
        session: fresh. steps: what the levers do. title, description, facts: for the report.
        progress: called after every tick.

    Raises:
        ScenarioError: if a step is aimed at something that does not exist, or the drive never ends.
    """
    operator = Operator(steps, session.machine, _targets(session))
    recorder, log = _Recorder(), InterventionLog()
    start = session.snapshot()
    before = session.tool
    while session.t_s < LONGEST_S:
        q, T = session.true_state
        tool = session.tool
        speed = float(np.linalg.norm(tool - before)) / session.tick_s
        hands = operator.hands(View(session.t_s, q, T, tool, speed))
        if hands is None:
            break
        done = session.step(session.intent(hands.mode, hands.levers, enable=hands.enable, line=hands.line))
        recorder.take(done, q, tool, operator.step)
        log.take(done.t_s, session.tick_s, done.trace.reasons, not hands.levers.neutral)
        before = tool
        if progress is not None:
            progress(_progress(session, operator, len(steps), done))
    else:
        raise ScenarioError("the drive does not end", element="drive", allowed=f"at most {LONGEST_S:g} s in all")
    return _result(session, operator, recorder, log, start, (title, description, facts or {}))


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
    recorder: _Recorder,
    log: InterventionLog,
    start: Snapshot,
    words: tuple[str, str, dict[str, str]],
) -> RunResult:
    title, description, facts = words
    truth, machine = session.truth, session.machine
    near = None if truth.nearest is None else truth.nearest.limit
    own = None if truth.nearest_own is None else truth.nearest_own.own
    entries = truth.entries()
    return RunResult(
        title=title,
        description=description,
        facts=facts | _facts(session),
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
        limits=_near(session.limits, session.true_state[1][:3, 3]),
        limit_names={limit.id: limit.name for limit in session.limits},
        assumptions=_assumptions(session),
        warnings=(*session.site.warnings, *session.limit_set.warnings, *session.stand.warnings),
    )


def _facts(session: Session) -> dict[str, str]:
    machine, crs = session.machine, session.site.crs
    own = session.stand.own_track
    return {
        "site": ", ".join(Path(file).name for file in session.site.files),
        "coordinates": "none stated" if crs is None else f"{crs.name} (EPSG {crs.epsg})",
        "machine": f"{machine.title} ({machine.name}), {machine.attachment}",
        "rules": f"{session.rules.title} ({session.rules.name})",
        "guard": _guard_words(session.guard),
        "stands": session.stand.words,
        "own track, let off": "none" if own is None else own.strip(),
        "limits": str(len(session.limits)),
    }


def _guard_words(guard: Any) -> str:
    """Return a guard's name and, if it has any, its parameters."""
    names = [field.name for field in fields(guard)] if is_dataclass(guard) else []
    return ", ".join([guard.name, *(f"{name} {getattr(guard, name)}" for name in names)])


def _assumptions(session: Session) -> tuple[str, ...]:
    return (
        "Joints are ideal: each follows its valve at once, without dead time, lag or flow limit.",
        "Sensors are perfect: posture and machine pose are exact and fresh at every tick.",
        "The undercarriage stands still.",
        "The site is as its files say; what they leave out is not guarded.",
        "Links are as large as the boxes of the machine's description"
        f" ({len(session.machine.solids)} of them); clearances are those of the boxes.",
        f"Truth is checked {SUBSTEPS} times per tick of {session.tick_s * 1000:g} ms, on the simulated posture.",
    )


def _near(limits: Sequence[Limit], place: Floats) -> tuple[Limit, ...]:
    """Return the limits whose bounding box comes near the machine."""

    def close(limit: Limit) -> bool:
        points = solid_points(limit.solid)[:, :2]
        gap = np.maximum(points.min(axis=0) - place[:2], place[:2] - points.max(axis=0))
        return bool(np.linalg.norm(np.maximum(gap, 0.0)) <= DRAW_WITHIN_M)

    return tuple(limit for limit in limits if close(limit))
