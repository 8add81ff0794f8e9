"""Arguments: several files after one option; and what is said while something takes its time."""

import io
from pathlib import Path

import pytest
from numba.core import event
from rich.console import Console

from workgauge.app import output
from workgauge.app.output import COMPILING, busy, spread
from workgauge.rehearse.session import Session
from workgauge.rehearse.shipped import shipped_path


@pytest.mark.parametrize(
    ("args", "expected"),
    [
        (["--site", "a", "b", "c"], ["--site", "a", "--site", "b", "--site", "c"]),
        (["--site", "a", "--site", "b"], ["--site", "a", "--site", "b"]),
        (["--site", "a", "b", "--at", "1,2,3"], ["--site", "a", "--site", "b", "--at", "1,2,3"]),
        (["--headless", "--site", "a", "b", "--json"], ["--headless", "--site", "a", "--site", "b", "--json"]),
        (["--at", "-1,2,3", "--site", "a"], ["--at", "-1,2,3", "--site", "a"]),
        (["--site=a", "--json"], ["--site=a", "--json"]),
        (["--site"], ["--site"]),
        (["--site", "--json"], ["--site", "--json"]),
        ([], []),
    ],
)
def test_site_takes_several_values(args: list[str], expected: list[str]) -> None:
    assert spread("--site", args) == expected


def compile_something() -> None:
    """Do as the compiler does when it begins, and ends."""
    for status in (event.EventStatus.START, event.EventStatus.END):
        event.broadcast(event.Event("numba:compile", status))


@pytest.mark.parametrize("what", [None, "planning"])
def test_without_a_terminal_compiling_is_one_line_on_stderr(what: str | None, capsys) -> None:  # type: ignore[no-untyped-def]
    with busy(what):
        assert capsys.readouterr() == ("", "")
        compile_something()
        compile_something()
        assert capsys.readouterr() == ("", COMPILING + "\n")
    compile_something()
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("what", [None, "planning"])
def test_at_a_terminal_compiling_stands_beside_what_goes_on(what: str | None, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    screen = io.StringIO()
    console = Console(file=screen, force_terminal=True, width=120)
    monkeypatch.setattr(output, "stderr", lambda: console)
    with busy(what):
        assert "compiling" not in screen.getvalue()
        compile_something()
    assert COMPILING in screen.getvalue()
    assert what is None or f"{what}; {COMPILING}" in screen.getvalue()
    written = len(screen.getvalue())
    with busy(what):
        pass
    assert "compiling" not in screen.getvalue()[written:]
    assert what is not None or len(screen.getvalue()) == written  # nothing to compile, nothing to see


RULES = shipped_path("scenarios", "_ballast-removal-rules.yaml")
DRIVE = f"""title: drive
site: {{shipped: double_track}}
machine: rre20
rules: {RULES}
guard: {{name: barrier}}
start:
  on_track: {{alignment: Track 1, distance_m: 200.0, facing: forward}}
  posture_deg: {{swing: 15, boom: 25, stick: -95, bucket: -20, tilt: 0, rotate: 15}}
drive:
  - {{do: hold, for_s: 0.1}}
  - {{do: go_to, by: joints, goal: {{at_m: [4.4, 1.3, 1.2], rpy_deg: [180, 0, 108]}}, at_most_s: 0.3}}
"""


@pytest.mark.parametrize("options", [("--headless",), ("--preview",)])
def test_a_run_says_so_before_it_waits_and_only_then(cli, write, monkeypatch, options: tuple[str, ...]) -> None:  # type: ignore[no-untyped-def]
    file: Path = write(DRIVE, "drive.yaml")
    arguments = ("run", "--scenario", file, *options, "--json")
    cli.workgauge(*arguments)  # whatever there is to compile is compiled now
    again = cli.workgauge(*arguments)
    assert again.err == "" and again.out.startswith("{")
    really = Session.warm_up

    def anew(session: Session) -> None:
        compile_something()
        really(session)

    monkeypatch.setattr(Session, "warm_up", anew)
    found = cli.workgauge(*arguments)
    assert found.err == COMPILING + "\n" and found.out.startswith("{")
