"""`workgauge path`: bucket paths on a surface from where the machine stands, and how well they will fit."""

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from workgauge.app.output import busy, facts, input_errors_exit_2, print_json, stdout, table, warn
from workgauge.app.run_command import DEFAULT_MACHINE, parse_place
from workgauge.app.site_commands import Epsg, Json
from workgauge.gauge.rulebook import load_rule_book
from workgauge.machine.load import load_machine
from workgauge.motion.bucket.dug import dug_map
from workgauge.motion.bucket.edge import Bucket
from workgauge.motion.bucket.surface_path import Blend
from workgauge.motion.bucket.ways import Way
from workgauge.rehearse.grading import Grading, Lines
from workgauge.rehearse.scenario import OnGround
from workgauge.rehearse.start import stand
from workgauge.report.path_page import write_path_report
from workgauge.site.read import read_site
from workgauge.site.xyz import read_places
from workgauge.values.arrays import Floats
from workgauge.values.errors import InputError

Files = Annotated[
    list[Path],
    typer.Argument(metavar="SURFACE…", help="LandXML, DXF or point files; alignments too", show_default=False),
]


@input_errors_exit_2
def path_command(
    files: Files,
    at: Annotated[
        str, typer.Option(metavar="E,N,HEADING_DEG", help="Where the machine stands; heading from grid north.")
    ],
    machine: Annotated[str, typer.Option(metavar="M", help="A shipped machine, or a file.")] = DEFAULT_MACHINE,
    attachment: Annotated[str | None, typer.Option(metavar="NAME", help="The attachment mounted.")] = None,
    surface: Annotated[str | None, typer.Option(metavar="NAME", help="The design, of several surfaces.")] = None,
    lines: Annotated[
        int | None, typer.Option(metavar="N", help="Lines side by side ahead.", show_default="3")
    ] = None,
    spacing: Annotated[float | None, typer.Option(metavar="M", help="Between them.", show_default="1")] = None,
    fan: Annotated[
        str | None,
        typer.Option(
            metavar="FROM,TO,N", help="N lines towards the swing axis, degrees to the left of straight ahead."
        ),
    ] = None,
    along: Annotated[str | None, typer.Option(metavar="ALIGNMENT", help="A line beside an alignment.")] = None,
    offset: Annotated[
        float | None, typer.Option(metavar="O", help="To the alignment's left.", show_default="0")
    ] = None,
    polyline: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A line of your own: east north a line.")
    ] = None,
    near: Annotated[float | None, typer.Option(metavar="M", help="From the swing axis, at least.")] = None,
    far: Annotated[float | None, typer.Option(metavar="M", help="From the swing axis, at most.")] = None,
    bucket_width: Annotated[float, typer.Option(metavar="M", help="Of the bucket's edge.")] = 1.0,
    cutting_deg: Annotated[float, typer.Option(metavar="D", help="How far the wrist leans ahead.")] = 0.0,
    over_dig_mm: Annotated[float, typer.Option(metavar="MM", help="How deep the edge may come.")] = 10.0,
    rules: Annotated[str, typer.Option(metavar="R", help="Rule book: what is a track to stand on.")] = "generic",
    report: Annotated[Path | None, typer.Option(metavar="DIR", help="Write path.html and path.json there.")] = None,
    epsg: Epsg = None,
    as_json: Json = False,
) -> None:
    """Lay bucket paths on a surface, from where the machine stands, and say how well they will fit."""
    place = parse_place(at)
    chosen = _lines(lines, spacing, fan, along, offset, polyline, near, far)
    bucket = Bucket(bucket_width, math.radians(cutting_deg))
    blend = Blend(over_dig_m=over_dig_mm * 1e-3)
    with busy("laying paths"):
        site = read_site(files, epsg=epsg)
        model = load_machine(machine, attachment)
        if not site.surfaces:
            raise InputError("no surface in the files", element="SURFACE", allowed="a file with triangles or points")
        stood = stand(
            site, load_rule_book(rules), model, OnGround(east_m=place[0], north_m=place[1], heading_deg=place[2])
        )
        T = np.array(stood.T_absolute_machine)
        origin = site.frame((float(T[0, 3]), float(T[1, 3]), float(T[2, 3]))).origin
        T[:3, 3] -= origin
        grading = Grading(site, origin)
        found, said = grading.ways(surface, chosen, model, T, bucket, blend)
    warnings = [*site.warnings, *stood.warnings, *said]
    data = {"paths": [path_object(way) for way in found], "warnings": warnings}
    if report is not None:
        tin = grading.tin(surface)
        cuts = [way.made.poses()[1] for way in found if way.joints is not None]
        planned = dug_map(tin, cuts, bucket.width_m, origin, allowed_m=blend.over_dig_m)
        page = write_path_report(report, data, tin, found, T, origin, model, planned)
    if as_json:
        print_json(data)
        return
    _show(stood.words, found)
    warn(warnings)
    if report is not None:
        stdout().print(f"\nreport: {page}")


def path_object(way: Way) -> dict[str, Any]:
    """Return the documented object of one path."""
    within = way.joints is not None
    return {
        "line": way.line,
        "points": [[round(v, 6) for v in point] for point in way.part.points.tolist()],
        "triangles": way.part.faces.tolist(),
        "length_m": round(way.part.length_m, 6),
        "reachable": within,
        "max_edge_error_m": round(way.made.edge_m, 6) if math.isfinite(way.made.edge_m) else None,
        "below_m": round(way.below_m, 6),
        "lifted_m": round(way.made.lift_m, 6),
        "corner_error_m": None if way.error is None else round(way.error.corner_m, 6),
        "why": way.why or None,
    }


def _lines(
    count: int | None,
    spacing: float | None,
    fan: str | None,
    along: str | None,
    offset: float | None,
    polyline: Path | None,
    near: float | None,
    far: float | None,
) -> Lines:
    """Return which lines the options ask for."""
    given = [name for name, value in _named(count, fan, along, polyline).items() if value is not None]
    if len(given) > 1:
        raise typer.BadParameter(f"not together with {given[1]}", param_hint=given[0])
    if spacing is not None and given not in ([], ["--lines"]):
        raise typer.BadParameter(f"not together with {given[0]}", param_hint="--spacing")
    if offset is not None and along is None:
        raise typer.BadParameter("only together with --along", param_hint="--offset")
    if fan is not None:
        begin, end, number = _fan(fan)
        yaws = tuple(math.radians(v) for v in np.linspace(begin, end, number).tolist())
        return Lines(yaws=yaws, near_m=near, far_m=far)
    if along is not None:
        return Lines(alignment=along, offset_m=offset or 0.0, near_m=near, far_m=far)
    if polyline is not None:
        places: Floats = read_places(polyline)
        return Lines(polyline=places, near_m=near, far_m=far)
    apart = 1.0 if spacing is None else spacing
    return Lines(count=3 if count is None else count, spacing_m=apart, near_m=near, far_m=far)


def _named(count: object, fan: object, along: object, polyline: object) -> dict[str, object]:
    return {"--lines": count, "--fan": fan, "--along": along, "--polyline": polyline}


def _fan(text: str) -> tuple[float, float, int]:
    try:
        begin, end, number = text.split(",")
        found = float(begin), float(end), int(number)
    except ValueError:
        raise typer.BadParameter(f"{text!r} is not FROM,TO,N", param_hint="--fan") from None
    if not (abs(found[0]) <= 360 and abs(found[1]) <= 360 and 1 <= found[2] <= 1000):
        raise typer.BadParameter(f"{text!r}: degrees within 360, 1 to 1000 lines", param_hint="--fan")
    return found


def _show(where: str, found: list[Way]) -> None:
    console = stdout()
    columns = [
        ("line", True),
        ("from E, N, height [m]", False),
        ("length [m]", True),
        ("edges crossed", True),
        ("in reach", False),
        ("off surface [m]", True),
        ("ends off [m]", True),
    ]
    rows = [
        (
            str(way.line),
            ", ".join(f"{v:.2f}" for v in way.part.points[0].tolist()),
            f"{way.part.length_m:.2f}",
            str(max(len(way.part.points) - 2, 0)),
            "yes" if way.joints is not None else "no",
            f"{way.made.edge_m:.3f}",
            "" if way.error is None else f"{way.error.corner_m:.4f}",
        )
        for way in found
    ]
    console.print(facts("The machine", [("stands", where)]))
    console.print()
    console.print(table("Paths", columns, rows))
