"""`workgauge pose`: receiver logs as positions in the site's system, with quality, error, heading and health."""

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from workgauge.app.output import facts, input_errors_exit_2, print_json, stderr, stdout, table, warn
from workgauge.app.site_commands import Json
from workgauge.geodesy.crs import ProjectedCrs
from workgauge.geodesy.heights import HeightModel
from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.rehearse.located_log import heights_of, locate, machine_id_of, machine_rows, positioning_of
from workgauge.rehearse.log_file import log_files
from workgauge.rehearse.receiver_health import WORDS, receiver_health
from workgauge.rehearse.standing import receiver_ports
from workgauge.rehearse.track_log import Track, read_track
from workgauge.rehearse.track_object import QUALITY_WORDS, epochs_object
from workgauge.report.track_page import write_track_report


@input_errors_exit_2
def pose_command(
    logs: Annotated[
        list[str],
        typer.Argument(metavar="LOG…", help="Files of NMEA and UBX, or PORT=FILE.", show_default=False),
    ],
    epsg: Annotated[int, typer.Option("--epsg", metavar="N", help="The site's coordinate system.")],
    machine: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="A machine with a positioning section: its own heading, health and pose."),
    ] = None,
    geoid_separation: Annotated[
        float | None, typer.Option(metavar="M", help="Heights by this constant geoid separation.")
    ] = None,
    geoid_grid: Annotated[
        str | None, typer.Option(metavar="FILE", help="Heights by this geoid grid (PROJ's formats).")
    ] = None,
    report: Annotated[Path | None, typer.Option(metavar="DIR", help="Write report.html and pose.json there.")] = None,
    as_json: Json = False,
) -> None:
    """Read receiver logs and say where the antennas were, how surely, and which way the machine faced."""
    crs = ProjectedCrs.from_epsg(epsg)
    model = None if machine is None else load_machine(machine)
    heights = _heights(geoid_separation, geoid_grid, model)
    files = log_files(logs, () if model is None else receiver_ports(positioning_of(model)))
    passes = 1 if model is None else 2
    with _progress(passes * sum(file.size for file in files)) as on_bytes:
        machine_id = "log" if model is None else machine_id_of(model)
        track = read_track(files, crs, heights, on_bytes, machine_id)
        if model is None:
            words, health, rows = WORDS, receiver_health(track), None
        else:
            words = f"as the positioning of {model.title} judges it"
            located = locate(files, model, crs, heights, track.somewhere, on_bytes)
            track, health, rows = machine_rows(track, located)
    data = epochs_object(track, health, words, rows) if as_json or report is not None else {}
    page = None if report is None else write_track_report(track, health, words, data, report)
    if as_json:
        print_json(data)
        return
    _show(track, health, words)
    warn(track.warnings)
    if page is not None:
        stdout().print(f"\nreport: {page}")


def _heights(separation: float | None, grid: str | None, machine: MachineModel | None) -> HeightModel:
    """Return the height model of the options, else of the machine, else of the sentences.

    Raises:
        typer.BadParameter: if both are given.
    """
    if separation is not None and grid is not None:
        raise typer.BadParameter("give one of --geoid-separation and --geoid-grid")
    if separation is not None:
        return HeightModel.constant(separation)
    if grid is not None:
        return HeightModel.from_grid(grid)
    return HeightModel.from_sentence() if machine is None else heights_of(machine)


@contextmanager
def _progress(total: int) -> Iterator[Callable[[int], None] | None]:
    """Show a bar of bytes on a terminal's stderr; elsewhere nothing."""
    console = stderr()
    if not console.is_terminal:
        yield None
        return
    columns = (TextColumn("reading"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("reading", total=total)
        yield lambda many: bar.update(task, advance=many)


def _show(track: Track, health: list[str | None], health_words: str) -> None:
    """Print what a person wants to know of a log."""
    console = stdout()
    placed = np.flatnonzero(track.placed)
    known = track.t_s[np.isfinite(track.t_s)]
    pairs = [
        ("logs", ", ".join(track.files)),
        ("coordinates", f"{track.crs.name} (EPSG {track.crs.epsg})"),
        ("heights", track.height_words),
        ("epochs", f"{len(track)}, {len(placed)} with a position, of {', '.join(sorted({*track.sources}))}"),
        ("time", f"{float(known.max() - known.min()):.1f} s" if len(known) else "no sentence says"),
        ("sentences", _sentences(track.tally)),
        ("first", _place(track, int(placed[0]))),
        ("last", _place(track, int(placed[-1]))),
        (
            "health",
            ", ".join(f"{state} {many}" for state, many in Counter(filter(None, health)).items()) or "unknown",
        ),
    ]
    console.print(facts("Track", pairs))
    console.print()
    columns = [("quality", False), ("epochs", True), ("share [%]", True), ("largest 1σ e, n, u [m]", True)]
    rows = []
    for value, many in sorted(Counter(track.quality.tolist()).items()):
        sigma = track.sigma_m[track.quality == value]
        worst = np.where(np.isfinite(sigma), sigma, -np.inf).max(axis=0, initial=-np.inf)
        words = " ".join("not stated" if one < 0 else f"{one:.3f}" for one in worst) if (worst >= 0).any() else ""
        rows.append((QUALITY_WORDS.get(value, str(value)), str(many), f"{100 * many / len(track):.1f}", words))
    console.print(table("Quality", columns, rows))
    console.print(f"\nhealth: {health_words}", style="dim")


def _sentences(tally: Any) -> str:
    why = "; ".join(f"{reason} {many}" for reason, many in sorted(tally["reasons"].items()))
    out = f"{tally['good']} good, {tally['bad']} bad, {tally['unknown']} of unknown kinds"
    return f"{out} ({why})" if why else out


def _place(track: Track, i: int) -> str:
    height = f", height {track.z[i]:.3f}" if np.isfinite(track.z[i]) else ""
    return f"E {track.e[i]:.3f} N {track.n[i]:.3f}{height}, {QUALITY_WORDS.get(int(track.quality[i]), 'unknown')}"
