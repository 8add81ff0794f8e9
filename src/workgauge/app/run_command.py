"""`workgauge run`: a rehearsal on a simulated machine, watched or headless, with a report."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console

from workgauge.app.check_file import refuse_unchecked
from workgauge.app.gnss_run import OwnSite, gnss_run, refuse_place
from workgauge.app.live import LiveView, plain_bar
from workgauge.app.output import busy, facts, input_errors_exit_2, print_json, stderr, stdout, table, warn
from workgauge.app.preview_run import planned_meanwhile, previewed
from workgauge.app.site_commands import Epsg, Json
from workgauge.machine.load import load_machine
from workgauge.rehearse.result import RunResult
from workgauge.rehearse.run import Progress, default_drive, drive_at_anything, open_session, run_session
from workgauge.rehearse.scenario import OnGround, StateChange, Step, TravelStep
from workgauge.rehearse.scenario_file import load_scenario
from workgauge.rehearse.session import Session
from workgauge.rehearse.tick_log import Origin, recorded
from workgauge.report.auto_section import JOB_COLUMNS, job_row
from workgauge.report.page import write_report
from workgauge.report.verdict import details, headline, metres
from workgauge.values.errors import ScenarioError
from workgauge.values.limits import LimitKind

DEFAULT_SCENARIO = "pole-approach"
DEFAULT_MACHINE = "rre20"
#: No map has coordinates beyond this [m].
FARTHEST_M = 1e8


class JointsOption(StrEnum):
    """How simulated joints follow their valves."""

    IDEAL = "ideal"
    HYDRAULIC = "hydraulic"


def parse_place(text: str) -> tuple[float, float, float]:
    """Return (east, north, heading in degrees) of `E,N,HEADING_DEG`.

    Raises:
        typer.BadParameter: if it is anything else.
    """
    try:
        east, north, heading = (float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"{text!r} is not E,N,HEADING_DEG", param_hint="--at") from None
    if not all(math.isfinite(value) for value in (east, north, heading)):
        raise typer.BadParameter(f"{text!r}: numbers must be finite", param_hint="--at")
    if max(abs(east), abs(north)) > FARTHEST_M or abs(heading) > 360.0:
        raise typer.BadParameter(f"{text!r}: metres within 1e8, degrees within 360", param_hint="--at")
    return east, north, heading


@input_errors_exit_2
def run_command(
    site: Annotated[
        list[Path] | None, typer.Option(metavar="FILE…", help="Site files, one or several after it, or repeated.")
    ] = None,
    machine: Annotated[str | None, typer.Option(metavar="M", help="A shipped machine, or a file.")] = None,
    rules: Annotated[
        str | None, typer.Option(metavar="R", help="Rule book: a file, or finland, germany, generic.")
    ] = None,
    scenario: Annotated[
        str | None,
        typer.Option(metavar="S", help="A shipped scenario, or a file."),
    ] = None,
    guard: Annotated[str | None, typer.Option(metavar="G", help="The guard.", show_default="linear")] = None,
    at: Annotated[
        str | None,
        typer.Option(metavar="E,N,HEADING_DEG", help="Where the machine stands; heading clockwise from grid north."),
    ] = None,
    gnss: Annotated[
        list[str] | None,
        typer.Option(metavar="LOG|PORT", help="Receivers: a log or serial port; repeated, PORT=LOG, DEVICE@BAUD."),
    ] = None,
    headless: Annotated[bool, typer.Option("--headless", help="No live view, as fast as it computes.")] = False,
    report: Annotated[Path | None, typer.Option(metavar="DIR", help="Write report.html and run.json there.")] = None,
    speed: Annotated[float, typer.Option(min=0, help="Live view: times real time; 0 as fast as it computes.")] = 1.0,
    check: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Start-of-shift checks: refuse without a valid one.")
    ] = None,
    off: Annotated[
        list[str] | None,
        typer.Option(metavar="STATE", help="A work state that is off, `Track 2 open to traffic`; may be repeated."),
    ] = None,
    joints: Annotated[
        JointsOption | None,
        typer.Option(help="Joints follow at once, or as the machine file says.", show_default="ideal"),
    ] = None,
    record: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Record every tick there; a new .mcap file.")
    ] = None,
    preview: Annotated[
        bool,
        typer.Option("--preview", help="Run nothing; say what would become of the drive's automatic steps."),
    ] = False,
    epsg: Epsg = None,
    as_json: Json = False,
) -> None:
    """Drive a simulated machine at its limits and say what held it.

    With --site and --at, the machine swings to the nearest pole (or the nearest limit of any kind), drives its tool
    straight at it until it is stopped, and comes back. With --scenario, it does what the scenario says; the other
    options then replace what it says of them. With --gnss, it stands where receivers say instead of --at.
    """
    if preview:
        _refuse_beside_preview({"--report": report, "--record": record, "--gnss": gnss})
    choice = _Choice(site or (), machine, rules, scenario, guard, at, gnss or (), check, epsg, joints)
    with ExitStack() as stack:
        with busy(None):
            prepared = stack.enter_context(_prepared(choice))
            prepared.session.warm_up()
        session = prepared.session
        session.checked = check is not None
        for state in off or ():
            session.check_state(state)
        switched = (*(StateChange(state=state, on=False) for state in off or ()), *prepared.states)
        if preview:
            session.off_states |= {change.state for change in switched if not change.on and change.at_s <= 0.0}
            with prepared.placed():
                previewed(session, prepared.steps, as_json)
            return
        stack.enter_context(prepared.placed())
        plans = planned_meanwhile(session, prepared.steps)
        if record is not None:
            stack.enter_context(recorded(session, record, prepared.origin))

        def run(callback: Callable[[Progress], None] | None) -> RunResult:
            steps, words, said, travel = prepared.steps, prepared.words, prepared.facts, prepared.travel
            return run_session(session, steps, *words, said, callback, travel=travel, states=switched, plans=plans)

        result = _watched(session, run, headless or as_json, speed)
        page = None if report is None else write_report(result, report)
        if as_json:
            print_json(result.as_json())
            return
        _show(result)
        warn(result.warnings)
        if page is not None:
            stdout().print(f"\nreport: {page}")
        if record is not None:
            stdout().print(f"{'' if page else chr(10)}log: {record}")


@dataclass(frozen=True, slots=True)
class _Choice:
    """What the options say of machine, place and drive."""

    site: Sequence[Path]
    machine: str | None
    rules: str | None
    scenario: str | None
    guard: str | None
    at: str | None
    gnss: Sequence[str]
    check: Path | None
    epsg: int | None
    joints: JointsOption | None

    @property
    def joints_or_ideal(self) -> Literal["ideal", "hydraulic"]:
        """What the joints are where no scenario says."""
        return "hydraulic" if self.joints is JointsOption.HYDRAULIC else "ideal"


@dataclass(frozen=True, slots=True)
class _Prepared:
    """A session, what is done in it, what is said of it, and where it all came from."""

    session: Session
    steps: Sequence[Step]
    words: tuple[str, str]
    facts: dict[str, str]
    origin: Origin
    travel: Sequence[TravelStep] = ()
    states: Sequence[StateChange] = ()
    placed: Callable[[], AbstractContextManager[None]] = nullcontext


def _refuse_beside_preview(options: Mapping[str, object]) -> None:
    for name, value in options.items():
        if value:
            raise typer.BadParameter(f"a preview runs nothing: not together with {name}", param_hint="--preview")


@contextmanager
def _prepared(c: _Choice) -> Iterator[_Prepared]:
    """Yield what is run: a place of the user's own site, or a scenario, either of them on receivers."""
    if c.gnss:
        refuse_place(c.at)
    loaded = None
    if c.scenario or not c.site:
        place = None if c.at is None else parse_place(c.at)
        ground = None if place is None else OnGround(east_m=place[0], north_m=place[1], heading_deg=place[2])
        loaded = load_scenario(c.scenario or DEFAULT_SCENARIO).choosing(
            site_files=c.site,
            machine=c.machine,
            rules=c.rules,
            guard=c.guard,
            place=ground,
            epsg=c.epsg,
            joints=None if c.joints is None else c.joints.value,
        )
        refuse_unchecked(load_machine(loaded.machine, loaded.scenario.attachment), c.check)
        origin = Origin(loaded.site_files, loaded.machine, loaded.rules, loaded.epsg)
    else:
        refuse_unchecked(load_machine(c.machine or DEFAULT_MACHINE), c.check)
        origin = Origin(tuple(c.site), c.machine or DEFAULT_MACHINE, c.rules or "generic", c.epsg)
    if c.gnss:
        own = OwnSite(c.site, str(origin.machine), str(origin.rules), c.guard or "linear", c.epsg, c.joints_or_ideal)
        with gnss_run(c.gnss, loaded or own) as (session, steps, words, said, states):
            yield _Prepared(session, steps, words, said, origin, (), states)
    elif loaded is None:
        yield _at_a_place(c, origin)
    else:
        scenario = loaded.scenario
        words = scenario.title, scenario.description
        facts = {"scenario": loaded.file.stem}
        session = open_session(loaded)
        yield _Prepared(
            session, scenario.drive, words, facts, origin, scenario.travel, scenario.states, loaded.placed
        )


def _at_a_place(c: _Choice, origin: Origin) -> _Prepared:
    """Return a session at a place of the user's own site, with the default drive."""
    if c.at is None:
        raise typer.BadParameter("--site needs --at E,N,HEADING_DEG", param_hint="--at")
    session = Session(
        list(c.site),
        origin.machine,
        origin.rules,
        c.guard or "linear",
        parse_place(c.at),
        epsg=c.epsg,
        joints=c.joints_or_ideal,
    )
    steps = default_drive()
    if not any(limit.kind is LimitKind.POINT for limit in session.limits):
        steps = drive_at_anything(steps)
        if session.snapshot().point_limit is None:
            raise ScenarioError("no limit near the machine to drive at", element="--at", value=c.at)
    description = "The machine swings to the nearest limit, drives its tool straight at it, stands, and comes back."
    return _Prepared(session, steps, ("Rehearsal at a place of the site", description), {}, origin)


def _watched(
    session: Session,
    run: Callable[[Callable[[Progress], None] | None], RunResult],
    headless: bool,
    speed: float,
) -> RunResult:
    """Run, with the live view or a progress bar where somebody would be watching."""
    screen: Console = stdout()
    if not headless and screen.is_terminal:
        with LiveView(screen, session.machine, getattr(session.guard, "slow_distance_m", None), speed) as view:
            return run(view.show)
    watcher = stderr()
    if watcher.is_terminal:
        progress_bar, move = plain_bar(watcher)
        with progress_bar:
            return run(move)
    return run(None)


def _show(result: RunResult) -> None:
    console = stdout()
    verdict, good = headline(result)
    console.print(verdict, style="bold green" if good else "bold red")
    console.print(details(result))
    console.print()
    tick = result.tick_ms
    pairs = [
        ("smallest true clearance", metres(result.min_clearance_m)),
        ("entries", str(len(result.entries))),
        ("simulated", f"{result.simulated_s:.2f} s in {result.ticks} ticks"),
        ("tick", f"{tick.p50:.2f} ms median, {tick.p99:.2f} ms 99th percentile, {tick.max:.2f} ms largest"),
    ]
    console.print(facts(result.title, pairs))
    if result.automatic is not None:
        console.print()
        console.print(table("Jobs", JOB_COLUMNS, [job_row(result, job) for job in result.automatic.jobs]))
    if result.interventions:
        columns = [
            ("at [s]", True),
            ("cause", False),
            ("link or joint", False),
            ("limit", False),
            ("clearance [m]", True),
            ("speed left [%]", True),
        ]
        rows = [
            (
                f"{cause.t_s:.2f}",
                cause.reason.replace("_", " "),
                cause.link or cause.joint or "",
                "" if cause.limit is None else result.name_of(cause.limit),
                "" if cause.clearance_m is None else f"{cause.clearance_m:.3f}",
                "" if cause.scale is None else f"{100 * cause.scale:.1f}",
            )
            for cause in result.interventions
        ]
        console.print()
        console.print(table("Interventions", columns, rows))
