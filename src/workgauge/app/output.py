"""What every command shares: consoles, the one-line error, exit codes, JSON on stdout and nothing else there."""

import functools
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any, ParamSpec, TypeVar

import typer
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text
from typer.core import TyperCommand

from workgauge.values.compiled import before_compiling
from workgauge.values.errors import InputError

P = ParamSpec("P")
R = TypeVar("R")

#: Exit code for anything the user handed in that cannot be used.
EXIT_INPUT = 2

#: What is said where functions have to be compiled first.
COMPILING = "compiling, once after an installation: a minute or two"

#: Tables are this wide where there is no terminal to tell.
PLAIN_WIDTH = 120


def stdout() -> Console:
    """Return a console on the standard output as it is now."""
    return Console(file=sys.stdout, highlight=False, markup=False, width=None if sys.stdout.isatty() else PLAIN_WIDTH)


def stderr() -> Console:
    """Return a console on the standard error as it is now."""
    return Console(file=sys.stderr, highlight=False, markup=False, soft_wrap=True)


def input_errors_exit_2(command: Callable[P, R]) -> Callable[P, R]:
    """Answer an `InputError` with one line on stderr and exit code 2; every other exception goes its way."""

    @functools.wraps(command)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return command(*args, **kwargs)
        except InputError as error:
            print("workgauge: " + " ".join(str(error).split()), file=sys.stderr)
            raise typer.Exit(EXIT_INPUT) from None

    return wrapped


def print_json(data: Mapping[str, Any]) -> None:
    """Print one JSON object on stdout; NaN and infinities are a mistake, not JSON."""
    print(json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False))


def warn(warnings: Sequence[str]) -> None:
    """Show warnings to a person, on stderr."""
    console = stderr()
    for text in warnings:
        console.print(Text.assemble(("warning ", "yellow"), text))


def table(title: str, columns: Sequence[tuple[str, bool]], rows: Sequence[Sequence[str]]) -> Table:
    """Return a table; a column is (heading, whether it holds numbers)."""
    out = Table(
        title=Text(title), title_justify="left", title_style="bold", header_style="dim", box=None, pad_edge=False
    )
    for heading, numeric in columns:
        out.add_column(Text(heading), justify="right" if numeric else "left", overflow="fold")
    for row in rows:
        out.add_row(*map(Text, row))
    return out


def facts(title: str, pairs: Sequence[tuple[str, str]]) -> Table:
    """Return a two-column table of facts."""
    out = Table(
        title=Text(title), title_justify="left", title_style="bold", box=None, pad_edge=False, show_header=False
    )
    out.add_column(style="dim")
    out.add_column(overflow="fold")
    for key, value in pairs:
        out.add_row(Text(key), Text(value))
    return out


@contextmanager
def busy(what: str | None) -> Iterator[None]:
    """Show what goes on meanwhile and for how long, at a terminal; with None only that functions are compiled.

    If functions have to be compiled on the way that is said as well, at a terminal or in one line on stderr; nothing
    is said of those that are on the disk.
    """
    console = stderr()
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    progress = Progress(*columns, console=console, transient=True)
    task = progress.add_task(what or COMPILING, total=None)
    with ExitStack() as shown:

        def say() -> None:
            if not console.is_terminal:
                console.print(COMPILING)
            elif what is None:
                shown.enter_context(progress)
            else:
                progress.update(task, description=f"{what}; {COMPILING}")

        if what is not None and console.is_terminal:
            shown.enter_context(progress)
        with before_compiling(say):
            yield


class SeveralFiles(TyperCommand):
    """A command whose `--site` takes one or several files after it: `--site a b` and `--site a --site b` alike."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Repeat `--site` before each of its values, then parse as usual."""
        return super().parse_args(ctx, spread("--site", args))


def spread(option: str, args: Sequence[str]) -> list[str]:
    """Return `args` with `option` repeated before every value that follows it."""
    out: list[str] = []
    taking = False
    for i, arg in enumerate(args):
        if arg == option:
            taking = True
            if i + 1 == len(args) or args[i + 1].startswith("-"):
                out.append(arg)  # no value: let the parser complain
        elif arg.startswith("-"):
            taking = False
            out.append(arg)
        elif taking:
            out.extend((option, arg))
        else:
            out.append(arg)
    return out
