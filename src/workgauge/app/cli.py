"""The command line."""

import json
from collections.abc import Callable
from enum import StrEnum
from typing import Annotated, Any

import typer

from workgauge import __version__
from workgauge.app.certify_command import certify_command
from workgauge.app.check_command import check_command
from workgauge.app.cockpit_command import cockpit_command
from workgauge.app.identify_command import identify_command
from workgauge.app.limits_command import limits_command
from workgauge.app.measure_up_command import measure_up_command
from workgauge.app.output import SeveralFiles
from workgauge.app.path_command import path_command
from workgauge.app.pose_command import pose_command
from workgauge.app.replay_command import replay_command
from workgauge.app.run_command import run_command
from workgauge.app.site_commands import at_command, site_command

app = typer.Typer(
    name="workgauge",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Keeps every part of a machine inside a working gauge computed from the site's own model.",
    epilog="workgauge assists and records; it is not a certified safety function.",
)


def _version(wanted: bool) -> None:
    if wanted:
        print(f"workgauge {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Keeps every part of a machine inside a working gauge computed from the site's own model."""


class SchemaOf(StrEnum):
    """What has a JSON Schema."""

    RULES = "rules"
    MACHINE = "machine"
    SCENARIO = "scenario"


def schema_command(of: Annotated[SchemaOf, typer.Argument(help="rules, machine or scenario")]) -> None:
    """Print the JSON Schema of a file people write."""
    print(json.dumps(_schema_source(of)(), indent=2, ensure_ascii=False))


def _schema_source(of: SchemaOf) -> Callable[[], dict[str, Any]]:
    if of is SchemaOf.RULES:
        from workgauge.gauge.rulebook import json_schema
    elif of is SchemaOf.MACHINE:
        from workgauge.machine.description import json_schema
    else:
        from workgauge.rehearse.scenario import json_schema
    return json_schema


app.command("site")(site_command)
app.command("at")(at_command)
app.command("limits")(limits_command)
app.command("pose")(pose_command)
app.command("path")(path_command)
app.command("run", cls=SeveralFiles)(run_command)
app.command("cockpit")(cockpit_command)
app.command("check", cls=SeveralFiles)(check_command)
app.command("measure-up")(measure_up_command)
app.command("identify")(identify_command)
app.command("certify", cls=SeveralFiles)(certify_command)
app.command("replay", cls=SeveralFiles)(replay_command)
app.command("schema")(schema_command)


def main() -> None:
    """Run the command line."""
    app()


if __name__ == "__main__":
    main()
