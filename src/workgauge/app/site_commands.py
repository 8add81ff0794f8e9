"""`workgauge site` and `workgauge at`: what is in the files, and where a place on an alignment is."""

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from workgauge.app.output import facts, input_errors_exit_2, print_json, stdout, table, warn
from workgauge.geodesy.crs import ProjectedCrs
from workgauge.site.alignment import Alignment
from workgauge.site.model import SiteModel
from workgauge.site.read import read_site
from workgauge.values.errors import SiteError

Files = Annotated[list[Path], typer.Argument(metavar="FILE…", help="LandXML or Inframodel files", show_default=False)]
Epsg = Annotated[
    int | None,
    typer.Option("--epsg", metavar="N", help="Coordinate system, where the files name none or a wrong one."),
]
Json = Annotated[bool, typer.Option("--json", help="Print the documented object on stdout, and nothing else.")]


def _alignment_object(alignment: Alignment) -> dict[str, Any]:
    ends = alignment.at([0.0, alignment.length])
    return {
        "name": alignment.name,
        "length_m": round(alignment.length, 6),
        "declared_length_m": None if alignment.declared_length is None else round(alignment.declared_length, 6),
        "start": {"e": round(float(ends.e[0]), 6), "n": round(float(ends.n[0]), 6)},
        "end": {"e": round(float(ends.e[1]), 6), "n": round(float(ends.n[1]), 6)},
        "station_start_m": round(alignment.station_start, 6),
        "elements": {kind: int(alignment.element_counts.get(kind, 0)) for kind in ("line", "curve", "spiral")},
        "has_profile": bool(alignment.has_profile),
        "cant_stations": int(alignment.cant_stations),
    }


def site_object(site: SiteModel) -> dict[str, Any]:
    """Return the documented object of `workgauge site --json`."""
    crs = site.crs
    return {
        "crs": {"epsg": None if crs is None else crs.epsg, "name": None if crs is None else crs.name},
        "units": dict(site.units),
        "alignments": [_alignment_object(alignment) for alignment in site.alignments],
        "surfaces": [
            {
                "name": surface.name,
                "points": len(surface.vertices),
                "faces": len(surface.faces),
                "plan_area_m2": round(float(surface.plan_area_m2), 4),
            }
            for surface in site.surfaces
        ],
        "points": len(site.points),
        "lines": len(site.lines),
        "warnings": list(site.warnings),
    }


@input_errors_exit_2
def site_command(files: Files, epsg: Epsg = None, as_json: Json = False) -> None:
    """Read site files and say what is in them."""
    site = read_site(files, epsg=epsg)
    data = site_object(site)
    if as_json:
        print_json(data)
        return
    console = stdout()
    crs = data["crs"]
    system = "none stated" if crs["name"] is None else f"{crs['name']} (EPSG {crs['epsg'] or 'unknown'})"
    console.print(
        facts(
            "Site",
            [
                ("files", ", ".join(str(file) for file in site.files)),
                ("coordinates", system),
                ("units", ", ".join(f"{key} {value}" for key, value in site.units.items()) or "none stated"),
                ("points", str(data["points"])),
                ("lines", str(data["lines"])),
            ],
        )
    )
    if data["alignments"]:
        console.print()
        console.print(_alignment_table(data["alignments"]))
    if data["surfaces"]:
        rows = [
            (s["name"], f"{s['points']:,}", f"{s['faces']:,}", f"{s['plan_area_m2']:,.2f}") for s in data["surfaces"]
        ]
        console.print()
        console.print(
            table("Surfaces", [("name", False), ("points", True), ("faces", True), ("plan area [m²]", True)], rows)
        )
    warn(data["warnings"])


def _alignment_table(alignments: list[dict[str, Any]]) -> Any:
    def shown(value: float | None) -> str:
        return "" if value is None else f"{value:,.3f}"

    rows = [
        (
            a["name"],
            shown(a["length_m"]),
            shown(a["declared_length_m"]),
            shown(a["station_start_m"]),
            "{line} / {curve} / {spiral}".format(**a["elements"]),
            "yes" if a["has_profile"] else "no",
            str(a["cant_stations"]),
        )
        for a in alignments
    ]
    columns = [
        ("name", False),
        ("length [m]", True),
        ("declared [m]", True),
        ("first station [m]", True),
        ("lines / curves / spirals", True),
        ("profile", False),
        ("cant stations", True),
    ]
    return table("Alignments", columns, rows)


def choose_alignment(site: SiteModel, name: str | None) -> Alignment:
    """Return the alignment of that name, blanks around it ignored; without a name, the only one.

    Raises:
        SiteError: if there is none, or several and no name.
    """
    names = ", ".join(repr(alignment.name) for alignment in site.alignments) or "none in these files"
    if name is None:
        if len(site.alignments) == 1:
            return site.alignments[0]
        raise SiteError(
            "name the alignment with --alignment", value=f"{len(site.alignments)} alignments", allowed=names
        )
    exact = [alignment for alignment in site.alignments if alignment.name == name]
    close = exact or [alignment for alignment in site.alignments if alignment.name.strip() == name.strip()]
    if len(close) != 1:
        raise SiteError(
            "no such alignment" if not close else "several alignments of that name", value=name, allowed=names
        )
    return close[0]


#: An offset beyond this is no place beside an alignment [m].
FARTHEST_OFFSET_M = 1e5


def place_object(alignment: Alignment, distance: float, offset: float, crs: ProjectedCrs | None) -> dict[str, Any]:
    """Return the documented object of `workgauge at --json`.

    The offset moves the place square to the left of the alignment in plan; the height is the axis's own.

    Raises:
        SiteError: if the distance lies beyond the alignment, or the offset is not a finite number.
    """
    if not abs(offset) <= FARTHEST_OFFSET_M:
        allowed = f"a finite number, up to {FARTHEST_OFFSET_M:g} m to either side"
        raise SiteError("no place so far beside an alignment", element="--offset", value=offset, allowed=allowed)
    state = alignment.at([distance])
    heading, cant, z = float(state.heading[0]), float(state.cant[0]), float(state.z[0])
    station = float(alignment.station(distance)[0])
    ((e, n),) = state.offset_points(offset).tolist()
    convergence = math.nan if crs is None else math.degrees(float(crs.convergence(e, n)))
    scale = math.nan if crs is None else float(crs.point_scale(e, n))
    return {
        "e": round(e, 6),
        "n": round(n, 6),
        "z": None if math.isnan(z) else round(z, 6),
        "heading_deg": round(math.degrees(heading) % 360.0, 9) % 360.0,
        "curvature_1_per_m": float(state.curvature[0]),
        "cant_m": round(abs(cant), 6) if alignment.has_cant else None,
        "low_rail": None if not alignment.has_cant or cant == 0 else "left" if cant > 0 else "right",
        "station": None if math.isnan(station) else round(station, 6),
        "distance_m": round(distance, 6),
        "convergence_deg": round(convergence, 9) if math.isfinite(convergence) else None,
        "point_scale": round(scale, 9) if math.isfinite(scale) else None,
    }


@input_errors_exit_2
def at_command(
    files: Files,
    alignment: Annotated[
        str | None, typer.Option(metavar="NAME", help="Which alignment; not needed if there is one.")
    ] = None,
    distance: Annotated[float | None, typer.Option(metavar="D", help="Distance along it from its start [m].")] = None,
    station: Annotated[
        float | None, typer.Option(metavar="S", help="Or the station, as the file counts [m].")
    ] = None,
    offset: Annotated[float, typer.Option(metavar="O", help="Square to it, positive to the left [m].")] = 0.0,
    epsg: Epsg = None,
    as_json: Json = False,
) -> None:
    """Say where a place on an alignment is: position, heading, curvature, cant, station."""
    if (distance is None) == (station is None):
        raise typer.BadParameter("give exactly one of --distance and --station")
    site = read_site(files, epsg=epsg)
    chosen = choose_alignment(site, alignment)
    along = chosen.distance_of_station(station) if station is not None else float(distance or 0.0)
    data = place_object(chosen, float(along), offset, site.crs)
    if as_json:
        print_json(data)
        return
    units = {
        "e": "m",
        "n": "m",
        "z": "m",
        "heading_deg": "°",
        "curvature_1_per_m": "1/m",
        "cant_m": "m",
        "station": "m",
        "distance_m": "m",
        "convergence_deg": "°",
    }
    rows = [
        (key, "unknown" if value is None else f"{value} {units.get(key, '')}".strip()) for key, value in data.items()
    ]
    stdout().print(facts(f"{chosen.name} at {along:g} m, {offset:g} m to the left", rows))
    warn(site.warnings)
