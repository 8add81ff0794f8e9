"""`workgauge measure-up`: where an attachment's tool centre point is, from touches of its tip."""

import math
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
import yaml

from workgauge.app.output import facts, input_errors_exit_2, print_json, stdout, table, warn
from workgauge.app.site_commands import Json
from workgauge.machine.load import load_machine, machine_from, read_description
from workgauge.machine.measure_up import MeasuredUp, attachment_entry, measure_up, sensor_sigmas
from workgauge.machine.model import MachineModel
from workgauge.machine.touch_file import read_touches
from workgauge.values.arrays import Floats
from workgauge.values.errors import InputError, MachineError
from workgauge.values.transforms import rpy, yaw_from_heading


@input_errors_exit_2
def measure_up_command(
    touches: Annotated[
        Path, typer.Argument(metavar="TOUCHES", help="Table of touches: joint_deg columns and where the tip was.")
    ],
    machine: Annotated[str, typer.Option(metavar="M", help="A shipped machine, or a file.")],
    attachment: Annotated[str, typer.Option(metavar="NAME", help="The attachment, in the machine's file or new.")],
    sigma_mm: Annotated[float, typer.Option(metavar="S", help="1-sigma of a touch, each direction.")] = 5.0,
    pose: Annotated[
        str | None,
        typer.Option(metavar="E,N,H,HEADING_DEG[,PITCH_DEG,ROLL_DEG]", help="Where the machine stood, for e, n, h."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a machine file with the entry in it.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Solve the tool's place on the last link by least squares, and print the attachment's entry with its tolerance.

    Touch a known point, or have the tip surveyed, in several postures; or touch one same unknown point in several,
    turning the attachment about more than one axis.
    """
    path, content = read_description(machine)
    like = _entry(content, attachment)
    measuring = _for_measuring(path, content, attachment, like)
    stood = None if pose is None else parse_pose(pose)
    measured_touches = read_touches(touches, measuring, stood)
    measured = measure_up(measuring, measured_touches, sigma_mm * 1e-3, sensor_sigmas(measuring))
    entry = attachment_entry(attachment, measured, len(measured_touches), like)
    written = None if out is None else write_machine(out, path, content, entry)
    if as_json:
        print_json(as_object(entry, measured, written))
        return
    _show(attachment, entry, measured)
    if not entry.get("boxes"):
        warn([f"{attachment} has no boxes: the program does not know how large it is, add them before working"])
    if written is not None:
        stdout().print(f"\nmachine file: {written}")


def parse_pose(text: str) -> Floats:
    """Return T_site_machine (4, 4) of `E,N,H,HEADING_DEG[,PITCH_DEG,ROLL_DEG]`, pitch positive nose down.

    Raises:
        typer.BadParameter: if it is anything else.
    """
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (4, 6) or not all(math.isfinite(number) for number in numbers):
        raise typer.BadParameter(f"{text!r} is not E,N,H,HEADING_DEG[,PITCH_DEG,ROLL_DEG]", param_hint="--pose")
    pitch, roll = (math.radians(number) for number in (numbers[4:] or (0.0, 0.0)))
    T = np.array(rpy(roll, pitch, yaw_from_heading(math.radians(numbers[3]))))
    T[:3, 3] = numbers[:3]
    return T


def as_object(entry: Mapping[str, Any], measured: MeasuredUp, written: Path | None) -> dict[str, Any]:
    """Return the documented object of `--json`."""
    return {
        "attachment": dict(entry),
        "residuals_m": [[round(float(v), 6) for v in row] for row in measured.residuals],
        "rms_m": round(measured.rms_m, 6),
        "tolerance_m": round(measured.tolerance_m, 6),
        "dilution": round(measured.dilution, 4),
        "factor": round(measured.factor, 4),
        "redundancy": measured.redundancy,
        "covariance_m2": [[float(v) for v in row] for row in measured.covariance],
        "file": None if written is None else str(written),
    }


def write_machine(out: Path, path: Path, content: Mapping[str, Any], entry: Mapping[str, Any]) -> Path:
    """Write a machine file with the entry in it, whole or not at all, and never over another.

    Raises:
        MachineError: if a file is there already, or the machine would not load from there.
    """
    if out.exists():
        raise MachineError("the file exists already", file=out, allowed="a new file")
    others = [one for one in content["attachments"] if one.get("name") != entry["name"]]
    made = {**content, "attachments": [dict(entry), *others]}
    text = f"# {path.name} with {entry['name']} measured up; its comments are in {path.name}\n"
    text += yaml.safe_dump(made, sort_keys=False, allow_unicode=True, width=116)
    try:
        with tempfile.TemporaryDirectory(dir=out.parent) as folder:
            draft = Path(folder) / "machine.yaml"
            draft.write_text(text, encoding="utf-8")
            machine_from(made, out.stem, out.parent, str(entry["name"]))
            draft.rename(out)
    except OSError as error:
        raise MachineError("cannot write the machine file", file=out, value=error.strerror) from error
    load_machine(out, str(entry["name"]))
    return out


def _entry(content: Mapping[str, Any], name: str) -> dict[str, Any] | None:
    """Return the attachment's entry in the file, or None if it is new."""
    entries = content.get("attachments")
    for entry in entries if isinstance(entries, list) else ():
        if isinstance(entry, dict) and entry.get("name") == name:
            return dict(entry)
    return None


def _for_measuring(path: Path, content: Mapping[str, Any], name: str, like: Mapping[str, Any] | None) -> MachineModel:
    """Return the machine with the attachment mounted as far as it is known, its tool anywhere."""
    known = dict(like or {"name": name})
    known["tool"] = known.get("tool") or {}
    known["tolerance_m"] = known.get("tolerance_m") or 0.0
    try:
        return machine_from({**content, "attachments": [known]}, path.stem, path.parent, name)
    except InputError as error:
        raise MachineError(
            error.message, file=path, element=error.element, value=error.value, allowed=error.allowed
        ) from error


def _show(name: str, entry: Mapping[str, Any], measured: MeasuredUp) -> None:
    console = stdout()
    x, y, z = measured.position
    pairs = [
        ("tool", f"x {x:.4f}  y {y:.4f}  z {z:.4f} m in the last link's frame"),
        ("tolerance", f"{1e3 * measured.tolerance_m:.1f} mm (1 sigma, worst direction)"),
        ("residuals", f"{1e3 * measured.rms_m:.1f} mm rms, {measured.factor:.2f} times what was expected"),
        ("postures", f"an error of a touch counts {measured.dilution:.2f} times"),
    ]
    console.print(facts(f"{name}, measured up", pairs))
    columns = [("touch", True), ("x [mm]", True), ("y [mm]", True), ("z [mm]", True)]
    rows = [(str(i + 1), *(f"{1e3 * v:+.1f}" for v in row)) for i, row in enumerate(measured.residuals)]
    console.print()
    console.print(table("Residuals, measured less adjusted, machine frame", columns, rows))
    console.print("\nattachments:  # paste into the machine file")
    lines = yaml.safe_dump([dict(entry)], sort_keys=False, allow_unicode=True, width=112).splitlines()
    console.print("\n".join(f"  {line}" for line in lines))
