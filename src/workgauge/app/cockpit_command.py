"""`workgauge cockpit`: a machine that runs, and the page to see it and drive it by."""

import contextlib
import os
import signal
import time
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from workgauge.app.output import input_errors_exit_2, stderr, stdout
from workgauge.app.run_command import DEFAULT_SCENARIO, JointsOption
from workgauge.rehearse.run import open_session
from workgauge.rehearse.scenario_file import load_scenario
from workgauge.values.errors import InputError

DEFAULT_PORT = 8600
DEFAULT_GUARD = "barrier"


@input_errors_exit_2
def cockpit_command(
    scenario: Annotated[
        str, typer.Option(metavar="S", help="Where the machine stands: a shipped scenario, or a file.")
    ] = DEFAULT_SCENARIO,
    guard: Annotated[str, typer.Option(metavar="G", help="The guard.")] = DEFAULT_GUARD,
    machine: Annotated[str | None, typer.Option(metavar="M", help="A shipped machine, or a file.")] = None,
    rules: Annotated[str | None, typer.Option(metavar="R", help="Rule book: a file, or a shipped one.")] = None,
    joints: Annotated[
        JointsOption | None, typer.Option(help="Joints follow at once, or as the machine file says.")
    ] = None,
    port: Annotated[int, typer.Option(min=1, max=65535, help="The page's port.")] = DEFAULT_PORT,
    host: Annotated[
        str, typer.Option(help="The page's address. Anything but this computer's own needs a token, and prints it.")
    ] = "127.0.0.1",
    supervisor: Annotated[
        bool, typer.Option("--supervisor", help="Print an address for a supervisor, too, who may suspend limits.")
    ] = False,
    intent_age_ms: Annotated[
        float, typer.Option(min=20, max=2000, help="An operator silent for so long stops the machine.")
    ] = 200.0,
    round_trip_ms: Annotated[
        float, typer.Option(min=50, max=5000, help="A link slower than this stops the machine.")
    ] = 500.0,
    log: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Add what happens to a file: who drives, stops, changed guards, overrides."
        ),
    ] = None,
    open_page: Annotated[bool, typer.Option("--open/--no-open", help="Open the page in a browser.")] = True,
) -> None:
    """Run a simulated machine in real time and open the page to see it and drive it by.

    The page is served to this computer alone. WORKGAUGE_TOKEN and WORKGAUGE_SUPERVISOR_TOKEN, if set, are the tokens
    to be used; otherwise new ones are made at every start.
    """
    try:
        from workgauge.app.cockpit_processes import LOOK_S, Minder, Plan, port_taken
        from workgauge.cockpit.access import Access, loopback, new_token
        from workgauge.cockpit.looks import read_mesh
    except ModuleNotFoundError as error:
        raise InputError(
            "the cockpit's parts are not installed", value=error.name, allowed="pip install 'workgauge[cockpit]'"
        ) from None
    from workgauge.rehearse.station.desk import DeskSettings

    loaded = load_scenario(scenario).choosing(
        guard=guard, machine=machine, rules=rules, joints=None if joints is None else joints.value
    )
    session = open_session(loaded)
    for mesh in session.machine.meshes:
        read_mesh(mesh)
    token = os.environ.get("WORKGAUGE_TOKEN") or (None if loopback(host) else new_token())
    special = os.environ.get("WORKGAUGE_SUPERVISOR_TOKEN") or (new_token() if supervisor else None)
    access = Access(host, port, token, special)
    if port_taken(host, port):
        raise InputError("something listens there already", element="--port", value=port, allowed="a free port")
    desk = DeskSettings(intent_age_s=intent_age_ms * 1e-3, round_trip_s=round_trip_ms * 1e-3)
    if log is not None:
        try:
            log.open("a", encoding="utf-8").close()
        except OSError as error:
            raise InputError("cannot be written", file=log, value=error.strerror) from None
    plan = Plan.of(loaded, desk, access, session.machine_id, log)
    minder = Minder(plan, lambda text: stderr().print(text))
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ended from outside as by Ctrl-C
    stdout().print("starting (half a minute the first time on a computer) …")
    try:
        minder.start()
        _announce(host if loopback(host) else None, port, token, special, open_page)
        while minder.mind():
            time.sleep(LOOK_S)
        stderr().print("the machine's process has ended")
        raise typer.Exit(1)
    except KeyboardInterrupt:
        stdout().print("ended")
    finally:
        minder.stop()


def _announce(host: str | None, port: int, token: str | None, special: str | None, open_page: bool) -> None:
    """Say where the page is, and open it; `host` is None where others can reach it."""
    shown = host or "<this computer's address>"
    address = f"http://{shown}:{port}/"
    own = address if token is None else f"{address}?token={token}"
    stdout().print(f"cockpit: {own}", soft_wrap=True)
    if special is not None:
        stdout().print(f"supervisor: {address}?token={special}", soft_wrap=True)
    if host is None:
        stdout().print("Others can reach this page. Without TLS in front of it, the token travels unencrypted.")
    stdout().print("Ctrl-C ends it.")
    if open_page and host is not None and _has_screen():
        with contextlib.suppress(webbrowser.Error):
            webbrowser.open(own)


def _has_screen() -> bool:
    """Whether a browser can be opened here."""
    return (
        os.name == "nt"
        or os.uname().sysname == "Darwin"
        or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    )
