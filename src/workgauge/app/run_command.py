"""`workgauge run`: a rehearsal on a simulated machine, watched or headless, with a report."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from workgauge.app.check_file import refuse_unchecked
from workgauge.app.live import LiveView, plain_bar
from workgauge.app.output import facts, input_errors_exit_2, print_json, stderr, stdout, table, warn
from workgauge.app.site_commands import Epsg, Json
from workgauge.machine.load import load_machine
from workgauge.rehearse.result import RunResult
from workgauge.rehearse.run import Progress, default_drive, drive_at_anything, open_session, run_session
from workgauge.rehearse.scenario import OnGround, StateChange, Step, TravelStep
from workgauge.rehearse.scenario_file import load_scenario
from workgauge.rehearse.session import Session
from workgauge.report.page import write_report
from workgauge.report.verdict import details, headline, metres
from workgauge.values.errors import ScenarioError
from workgauge.values.limits import LimitKind

DEFAULT_SCENARIO = "pole-approach"
DEFAULT_MACHINE = "rre20"


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
    epsg: Epsg = None,
    as_json: Json = False,
) -> None:
    """Drive a simulated machine at its limits and say what held it.

    With --site and --at, the machine swings to the nearest pole (or the nearest limit of any kind), drives its tool
    straight at it until it is stopped, and comes back. With --scenario, it does what the scenario says; the other
    options then replace what it says of them.
    """
    if site and not scenario:
        refuse_unchecked(load_machine(machine or DEFAULT_MACHINE), check)
        session, steps, words, said = _at_a_place(site, machine, rules, guard, at, epsg)
        travel: Sequence[TravelStep] = ()
        states: Sequence[StateChange] = ()
    else:
        place = None if at is None else parse_place(at)
        ground = None if place is None else OnGround(east_m=place[0], north_m=place[1], heading_deg=place[2])
        loaded = load_scenario(scenario or DEFAULT_SCENARIO).choosing(
            site_files=site or (), machine=machine, rules=rules, guard=guard, place=ground, epsg=epsg
        )
        refuse_unchecked(load_machine(loaded.machine, loaded.scenario.attachment), check)
        session, steps = open_session(loaded), loaded.scenario.drive
        words = loaded.scenario.title, loaded.scenario.description
        said = {"scenario": loaded.file.stem}
        travel, states = loaded.scenario.travel, loaded.scenario.states
    for state in off or ():
        session.check_state(state)
    states = (*(StateChange(state=state, on=False) for state in off or ()), *states)

    def run(callback: Callable[[Progress], None] | None) -> RunResult:
        return run_session(session, steps, *words, said, callback, travel=travel, states=states)

    result = _watched(session, run, headless or as_json, speed)
    page = None if report is None else write_report(result, report)
    if as_json:
        print_json(result.as_json())
        return
    _show(result)
    warn(result.warnings)
    if page is not None:
        stdout().print(f"\nreport: {page}")


_Prepared = tuple[Session, Sequence[Step], tuple[str, str], dict[str, str]]


def _at_a_place(
    site: list[Path], machine: str | None, rules: str | None, guard: str | None, at: str | None, epsg: int | None
) -> _Prepared:
    """Return a session at a place of the user's own site, with the default drive."""
    if at is None:
        raise typer.BadParameter("--site needs --at E,N,HEADING_DEG", param_hint="--at")
    session = Session(
        site, machine or DEFAULT_MACHINE, rules or "generic", guard or "linear", parse_place(at), epsg=epsg
    )
    steps = default_drive()
    if not any(limit.kind is LimitKind.POINT for limit in session.limits):
        steps = drive_at_anything(steps)
        if session.snapshot().point_limit is None:
            raise ScenarioError("no limit near the machine to drive at", element="--at", value=at)
    description = "The machine swings to the nearest limit, drives its tool straight at it, stands, and comes back."
    return session, steps, ("Rehearsal at a place of the site", description), {}


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
