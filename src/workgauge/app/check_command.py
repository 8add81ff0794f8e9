"""`workgauge check`: put the tool on a known point at the start of a shift, and see what the program makes of it."""

import math
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from workgauge.app.check_file import append_check, utc_now_ns
from workgauge.app.output import facts, input_errors_exit_2, print_json, stdout, warn
from workgauge.app.site_commands import Epsg, Json
from workgauge.geodesy.crs import ProjectedCrs
from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.machine.positioning import Thresholds
from workgauge.positioning.check import BelievedTool, CheckResult, check_against
from workgauge.positioning.check_log import record_of
from workgauge.rehearse.believed_tool import tool_from_logs
from workgauge.rehearse.located_log import positioning_of
from workgauge.rehearse.log_file import log_files
from workgauge.rehearse.standing import log_ports
from workgauge.site.model import SiteModel
from workgauge.site.read import read_site
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import MachineError, SiteError
from workgauge.values.health import PositionHealth

#: Exit code of a check that did not pass.
EXIT_FAILED = 3


@input_errors_exit_2
def check_command(
    machine: Annotated[str, typer.Option(metavar="M", help="A shipped machine, or a file.")],
    attachment: Annotated[
        str | None, typer.Option(metavar="NAME", help="The attachment that is mounted; the file's first if left out.")
    ] = None,
    point: Annotated[str | None, typer.Option(metavar="E,N,H", help="The known point.")] = None,
    point_name: Annotated[
        str | None, typer.Option(metavar="NAME", help="Or its name among the points of --site.")
    ] = None,
    site: Annotated[list[Path] | None, typer.Option(metavar="FILE…", help="Site files with that point.")] = None,
    gnss: Annotated[
        list[str] | None,
        typer.Option(metavar="LOG", help="Logs of the machine with its tool on the point, FILE or PORT=FILE."),
    ] = None,
    posture_deg: Annotated[
        list[str] | None,
        typer.Option(metavar="JOINT=DEG", help="With logs that have no link sensors; home if left out."),
    ] = None,
    tool: Annotated[
        str | None, typer.Option(metavar="E,N,H", help="Or where the program has the tool, read off a screen.")
    ] = None,
    sigma_mm: Annotated[
        float | None, typer.Option(metavar="S", help="With --tool: its 1-sigma as the screen has it.")
    ] = None,
    heading_deg: Annotated[float, typer.Option(metavar="H", help="With --tool: the machine's heading.")] = 0.0,
    point_sigma_mm: Annotated[
        float, typer.Option(metavar="S", help="1-sigma of the point, and of how exactly the tool is on it.")
    ] = 5.0,
    file: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Add the check to this file, a line each.")
    ] = None,
    epsg: Epsg = None,
    as_json: Json = False,
) -> None:
    """Compare the tool with a known point, log it, and say whether the machine may work.

    Exit code 0 if it passed, 3 if it did not. `workgauge run --check FILE` arms on a check that passed, is of this
    machine and attachment, and not older than the machine's file allows.
    """
    model = load_machine(machine, attachment)
    place, name = _known_point(point, point_name, site or [], epsg)
    if not (math.isfinite(point_sigma_mm) and point_sigma_mm >= 0.0):
        raise typer.BadParameter("a finite number, 0 or more", param_hint="--point-sigma-mm")
    screen = (tool, sigma_mm, heading_deg)
    believed, health, warnings = _believed(screen, gnss or [], posture_deg or [], model, place, epsg)
    result = check_against(
        place,
        believed,
        model,
        _thresholds(model),
        utc_ns=utc_now_ns(),
        point_name=name,
        point_sigma_m=1e-3 * point_sigma_mm,
        health=health,
    )
    if file is not None:
        append_check(file, result)
    if as_json:
        print_json(record_of(result))
    else:
        _show(result, file)
        warn(warnings)
    if not result.passed:
        raise typer.Exit(EXIT_FAILED)


def parse_point(text: str, option: str) -> Floats:
    """Return (3,) of `E,N,H`.

    Raises:
        typer.BadParameter: if it is anything else.
    """
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 3 or not all(abs(number) < 1e8 for number in numbers):
        raise typer.BadParameter(f"{text!r} is not E,N,H", param_hint=option)
    return frozen(numbers)


def point_named(site: SiteModel, name: str) -> Floats:
    """Return where the one point of that name is (3,).

    Raises:
        SiteError: if there is none, there are several in different places, or it has no height.
    """
    found = [one for one in site.points if one.name.strip() == name.strip()]
    if not found:
        known = sorted({one.name.strip() for one in site.points})
        shown = ", ".join(known[:12]) + (" …" if len(known) > 12 else "")
        raise SiteError("no such point", element="--point-name", value=name, allowed=shown or "none in these files")
    position = found[0].position
    if any(not np.array_equal(one.position, position, equal_nan=True) for one in found[1:]):
        raise SiteError("several points of that name in different places", element="--point-name", value=name)
    if not np.isfinite(position).all():
        raise SiteError(
            "the point has no height", element="--point-name", value=name, allowed="a point with a height"
        )
    return position


def _known_point(point: str | None, name: str | None, files: list[Path], epsg: int | None) -> tuple[Floats, str]:
    if (point is None) == (name is None):
        raise typer.BadParameter("give exactly one of --point and --point-name")
    if point is not None:
        return parse_point(point, "--point"), ""
    if not files:
        raise typer.BadParameter("--point-name needs --site FILE…", param_hint="--point-name")
    return point_named(read_site(files, epsg=epsg), name or ""), (name or "").strip()


def _read_off(tool: str | None, sigma_mm: float | None, heading_deg: float) -> BelievedTool:
    """Return the tool as somebody has read it off a screen."""
    if tool is None:
        raise typer.BadParameter("say where the program has the tool", param_hint="--tool")
    if sigma_mm is None or not (math.isfinite(sigma_mm) and sigma_mm > 0.0):
        raise typer.BadParameter("--tool needs its 1-sigma, above 0", param_hint="--sigma-mm")
    if not math.isfinite(heading_deg):
        raise typer.BadParameter("a finite number", param_hint="--heading-deg")
    covariance = (1e-3 * sigma_mm) ** 2 * np.eye(3)
    return BelievedTool(parse_point(tool, "--tool"), frozen(covariance), math.radians(heading_deg))


_Believed = tuple[BelievedTool, PositionHealth | None, tuple[str, ...]]


def _believed(
    screen: tuple[str | None, float | None, float],
    logs: list[str],
    posture: list[str],
    machine: MachineModel,
    point: Floats,
    epsg: int | None,
) -> _Believed:
    """Return the tool as read off a screen, or as the machine's positioning has it at the end of logs."""
    if (screen[0] is None) == (not logs):
        raise typer.BadParameter("give exactly one of --gnss and --tool")
    if not logs:
        return _read_off(*screen), None, ()
    if epsg is None:
        raise typer.BadParameter("--gnss needs the site's coordinate system", param_hint="--epsg")
    files = log_files(logs, log_ports(positioning_of(machine)))
    q = parse_posture(machine, posture) if posture else None
    return tool_from_logs(files, machine, ProjectedCrs.from_epsg(epsg), point, q)


def parse_posture(machine: MachineModel, given: list[str]) -> Floats:
    """Return (n,) of `JOINT=DEGREES` (metres for joints that slide), home for the others.

    Raises:
        typer.BadParameter: for another form. MachineError: for a joint the machine has not.
    """
    q = np.array(machine.home)
    for one in given:
        name, _, text = one.rpartition("=")
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not name or not math.isfinite(value):
            raise typer.BadParameter(f"{one!r} is not JOINT=DEGREES", param_hint="--posture-deg")
        if name not in machine.joint_names:
            allowed = ", ".join(machine.joint_names)
            raise MachineError("no such joint", element="--posture-deg", value=name, allowed=allowed)
        j = machine.joint_names.index(name)
        q[j] = value if machine.prismatic[j] else math.radians(value)
    return frozen(q)


def _thresholds(machine: MachineModel) -> Thresholds:
    return Thresholds() if machine.positioning is None else machine.positioning.thresholds


def _show(result: CheckResult, file: Path | None) -> None:
    console = stdout()
    verdict = "Check passed" if result.passed else "Check not passed: the machine must not work"
    console.print(verdict, style="bold green" if result.passed else "bold red")
    for cause in result.why:
        console.print(cause)
    e, n, h = result.point
    te, tn, th = result.tool
    ways = (("along", result.along), ("left", result.left), ("up", result.up))
    pairs = [
        ("point", f"E {e:.3f} N {n:.3f} H {h:.3f} {result.point_name}".rstrip()),
        ("tool", f"E {te:.3f} N {tn:.3f} H {th:.3f}"),
        ("tool less point", ", ".join(f"{name} {1e3 * value:+.0f} mm" for name, value in ways)),
        ("distance", f"{1e3 * result.distance:.0f} mm (tolerance {1e3 * result.tolerance:.0f} mm)"),
        ("believed", f"{1e3 * result.sigma:.0f} mm (1 sigma): off by {result.sigmas:.1f} sigma"),
        ("machine", f"{result.machine} with {result.attachment} ({result.fingerprint})"),
    ]
    if file is not None:
        pairs.append(("added to", str(file)))
    console.print()
    console.print(facts("Start-of-shift check", pairs))
