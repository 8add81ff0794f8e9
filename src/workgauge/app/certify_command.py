"""`workgauge certify`: random drives at a machine's own stopping model, and a certificate of what came of them."""

import os
import shlex
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from workgauge.app.output import COMPILING, facts, input_errors_exit_2, print_json, stderr, stdout, table, warn
from workgauge.app.site_commands import Epsg, Json
from workgauge.rehearse.certify.certificate import Certificate, joint_stopping, warnings
from workgauge.rehearse.certify.conditions import Task, tasks
from workgauge.rehearse.certify.driving import Driven, Driver, Subject
from workgauge.rehearse.certify.fingerprint import fingerprint
from workgauge.rehearse.certify.journal import Journal
from workgauge.rehearse.certify.outcome import outcome
from workgauge.rehearse.certify.work import driven
from workgauge.rehearse.choices import chosen_files
from workgauge.report.certificate_page import write_certificate
from workgauge.values.compiled import before_compiling

#: Exit code of a certificate that was not passed, and of a run that was interrupted.
EXIT_NOT_PASSED, EXIT_INTERRUPTED = 3, 130
#: The shipped site, by the word for it.
SHIPPED, SHIPPED_SITE = "shipped", "double_track"
#: Dead times injected unless told otherwise [s].
DELAYS_S = (0.1, 0.3)
#: Without a terminal so many lines are written over all drives.
LINES = 10
#: The journal's name beside the report.
JOURNAL = "drives.jsonl"


@input_errors_exit_2
def certify_command(
    machine: Annotated[str, typer.Option(metavar="M", help="A shipped machine, or a file.")],
    rules: Annotated[str, typer.Option(metavar="R", help="Rule book: a file, or finland, germany, generic.")],
    site: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE…", help="Site files, or the shipped site.", show_default=SHIPPED),
    ] = None,
    guard: Annotated[str, typer.Option(metavar="G", help="The guard.")] = "barrier",
    drives: Annotated[int, typer.Option(min=1, metavar="N", help="Drives within the stopping model.")] = 1000,
    seed: Annotated[int, typer.Option(min=0, metavar="S", help="Other drives for another number.")] = 0,
    dead_time: Annotated[
        list[float] | None,
        typer.Option(
            metavar="S", help="More dead time than the file says; may be repeated.", show_default="0.1, 0.3"
        ),
    ] = None,
    report: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write certificate.html and certificate.json there.")
    ] = None,
    journal: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Keep finished drives there, and go on from it.")
    ] = None,
    jobs: Annotated[int | None, typer.Option(min=1, metavar="N", help="Processes.", show_default="cores")] = None,
    epsg: Epsg = None,
    as_json: Json = False,
) -> None:
    """Drive random approaches at a machine's stopping model, and certify what the guard kept.

    The exit code is 3 if a limit was entered, or a true clearance fell below its stop distance, in any drive within
    the model.
    """
    delays = DELAYS_S if dead_time is None else tuple(dead_time)
    files = _site_files(site)
    subject = Subject(machine, rules, tuple(str(file) for file in files), guard, epsg, delays)
    driver = Driver(subject)
    todo = tasks(driver.conditions, drives, seed)
    known_as = fingerprint(driver, seed)
    path = journal or (None if report is None else report / JOURNAL)
    kept = None if path is None else Journal(path, known_as)
    found = _driven(driver, todo, kept, jobs or _cores(), drives)
    came = outcome(driver.conditions, found)
    joints = joint_stopping(driver)
    said = warnings(joints, driver.conditions, came)
    certificate = Certificate(driver.machine.title, known_as, joints, said, came, drives, tuple(sorted(set(delays))))
    page = None if report is None else write_certificate(certificate, report, _again(subject, drives, seed))
    if as_json:
        print_json(certificate.as_json())
    else:
        _show(certificate)
        if page is not None:
            stdout().print(f"\nwritten to {page}")
    warn(said)
    if not came.passed:
        raise typer.Exit(EXIT_NOT_PASSED)


def _site_files(site: Sequence[Path] | None) -> list[Path]:
    """Return the files of a site; `shipped`, or nothing, for the shipped one."""
    if not site or [str(one) for one in site] == [SHIPPED]:
        return chosen_files(SHIPPED_SITE)
    return chosen_files(str(site[0]) if len(site) == 1 else list(site))


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _again(subject: Subject, drives: int, seed: int) -> str:
    """Return the command that makes the same certificate."""
    options: list[str] = ["--machine", subject.machine, "--rules", subject.rules]
    for file in subject.site_files:
        options += ["--site", file]
    options += ["--guard", subject.guard, "--drives", str(drives), "--seed", str(seed)]
    for delay in subject.delays_s:
        options += ["--dead-time", f"{delay:g}"]
    if subject.epsg is not None:
        options += ["--epsg", str(subject.epsg)]
    return f"workgauge certify {shlex.join(options)}"


def _driven(driver: Driver, todo: Sequence[Task], kept: Journal | None, jobs: int, drives: int) -> list[Driven]:
    """Return every drive, those of the journal as they are; an interrupt ends the program and says how to go on."""
    found = {} if kept is None else {task: kept.known[task] for task in todo if task in kept.known}
    missing = [task for task in todo if task not in found]
    covered = {one.key for one in driver.conditions if one.within}
    with _progress(len(todo), len(found)) as say:
        failed = sum(one.failed for one in found.values() if one.condition in covered)
        try:
            for task, one in driven(driver, missing, jobs):
                found[task] = one
                if kept is not None:
                    kept.append(task, one)
                failed += one.failed and one.condition in covered
                say(len(found), failed)
        except KeyboardInterrupt:
            interrupted = True
        else:
            interrupted = False
    if interrupted:
        _say_how_to_go_on(len(found), len(todo), kept)
        raise typer.Exit(EXIT_INTERRUPTED)
    return [found[task] for task in todo]


def _say_how_to_go_on(done: int, of: int, kept: Journal | None) -> None:
    console = stderr()
    if kept is None:
        console.print(f"stopped after {done} of {of} drives; nothing is kept without --journal or --report")
    else:
        console.print(
            f"stopped after {done} of {of} drives, kept in {kept.path}; the same command again goes on there"
        )


@contextmanager
def _progress(of: int, done: int) -> Iterator[Callable[[int, int], None]]:
    """Yield what is told how many drives are done and how many failed: a bar at a terminal, else plain lines.

    Either says as well when functions are compiled first.
    """
    console = stderr()
    if not console.is_terminal:
        step = max(of // LINES, 1)

        def say(count: int, failed: int) -> None:
            if count % step == 0 or count == of:
                console.print(f"{count} of {of} drives, {failed} failed")

        if done:
            console.print(f"{done} of {of} drives are in the journal")
        with before_compiling(lambda: console.print(COMPILING)):
            yield say
        return
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("drives", total=of, completed=done)
        with before_compiling(lambda: bar.update(task, description=COMPILING)):
            yield lambda count, failed: bar.update(task, completed=count, description=_words(failed))


def _words(failed: int) -> str:
    return f"drives, {failed} failed" if failed else "drives"


def _metres(value: float | None) -> str:
    return "nothing near" if value is None else f"{value:.3f} m"


def _percent(value: float | None) -> str:
    return "" if value is None else f"{100 * value:.1f} %"


def _show(certificate: Certificate) -> None:
    console, came = stdout(), certificate.outcome
    data, row = certificate.as_json(), came.within
    if came.passed:
        console.print(f"Passed: {row.drives} drives within the stopping model, no limit entered.", style="bold green")
    else:
        words = f"{row.entered} of {row.drives} drives entered a limit, {row.below} fell below a stop distance"
        console.print(f"Not passed: {words}.", style="bold red")
    console.print()
    pairs = [
        ("smallest true clearance", _metres(row.worst_clearance_m)),
        ("less its stop distance", _metres(row.worst_less_stop_m)),
        ("of the way without a guard", _percent(data["motion_share"])),
        ("lever time lost at limits", _percent(data["time_lost_share"])),
        ("certificate", data["id"]),
    ]
    console.print(facts(certificate.title, pairs))
    columns = [
        *(("condition", False), ("counts", False), ("drives", True), ("entered", True), ("below", True)),
        *(("least left [m]", True), ("of the way", True)),
    ]
    rows = [
        (
            *(one["words"], "yes" if one["within_model"] else "beyond the model", str(one["drives"])),
            *(str(one["entries"]), str(one["below_stop"])),
            "" if one["worst_less_stop_m"] is None else f"{one['worst_less_stop_m']:.3f}",
            _percent(one["motion_share"]),
        )
        for one in data["conditions"]
    ]
    console.print()
    console.print(table("How the real machine differs from the model", columns, rows))
    columns = [("limit", False), ("link", False), ("drives near", True), ("least left [m]", True), ("lost [s]", True)]
    places = [
        (
            *(one["kind"].replace("_", " "), one["link"], str(one["drives"])),
            "" if one["worst_less_stop_m"] is None else f"{one['worst_less_stop_m']:.3f}",
            f"{one['time_lost_s']:.1f}",
        )
        for one in data["places"]
    ]
    console.print()
    console.print(table("By kind of limit and link, within the model", columns, places))
    console.print("\nThis assists and is evidence; it is not a certified safety function.", style="dim")
