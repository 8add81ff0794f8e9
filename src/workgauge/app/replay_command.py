"""`workgauge replay`: a recorded run once more, from its inputs alone."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from workgauge.app.output import busy, facts, input_errors_exit_2, print_json, stdout
from workgauge.app.site_commands import Json
from workgauge.record.reader import Log, open_log
from workgauge.rehearse.tick_log import Replayed, reopened, replayed

#: Exit code of a replay that came out otherwise.
EXIT_DIFFERENT = 3


@input_errors_exit_2
def replay_command(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Recorded by `workgauge run --record`.")],
    site: Annotated[
        list[Path] | None, typer.Option(metavar="FILE…", help="Its site files, if they are elsewhere now.")
    ] = None,
    machine: Annotated[str | None, typer.Option(metavar="M", help="Its machine file, if elsewhere.")] = None,
    rules: Annotated[str | None, typer.Option(metavar="R", help="Its rule book, if elsewhere.")] = None,
    as_json: Json = False,
) -> None:
    """Decide every tick of a recorded run once more and compare the commands with those that left.

    The exit code is 3 if any comes out otherwise.
    """
    with busy("replaying"):
        opened = open_log(log)
        scene, config = reopened(opened, site=site or (), machine=machine, rules=rules)
        done = replayed(opened, scene, config)
    if as_json:
        print_json(_plain(opened, done))
    else:
        _show(opened, done)
    if done.different:
        raise typer.Exit(EXIT_DIFFERENT)


def _plain(log: Log, done: Replayed) -> dict[str, object]:
    return {
        "log": str(log.file),
        "complete": log.cut is None,
        "written_by": asdict(log.versions),
        "machine": log.configuration["machine"],
        "guard": log.configuration["guard"],
        **asdict(done),
        "same": not done.different,
    }


def _show(log: Log, done: Replayed) -> None:
    console = stdout()
    if done.first is None:
        console.print("Every command comes out again as it left.", style="bold green")
    else:
        first = done.first
        console.print(f"{done.different} of {done.ticks} commands come out otherwise.", style="bold red")
        console.print(f"First at {first.t_s:.3f} s: valves were {list(first.logged)}, come out as {list(first.now)}.")
    pairs = [
        ("machine", f"{log.configuration['machine']}, {log.configuration['attachment']}"),
        ("guard", str(log.configuration["guard"])),
        ("ticks", f"{done.ticks}, {done.moving} of them moving, {done.from_s:.2f} to {done.until_s:.2f} s"),
        ("log", "complete" if log.cut is None else f"cut after {log.cut} bytes: what follows was never written"),
        ("written by", f"workgauge {log.versions.workgauge}, Python {log.versions.python}"),
    ]
    console.print(facts(log.file.name, pairs))
