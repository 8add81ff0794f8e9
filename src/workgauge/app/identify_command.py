"""`workgauge identify`: how a machine stops, from a log of steps and stops."""

import math
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml

from workgauge.app.output import busy, input_errors_exit_2, print_json, stdout, table, warn
from workgauge.app.site_commands import Json
from workgauge.machine.load import catalogue, load_machine
from workgauge.machine.model import MachineModel
from workgauge.machine.stopping import StoppingModel
from workgauge.rehearse.identify.fit import CONFIDENCE, Estimate
from workgauge.rehearse.identify.log import StepLog, read_step_log
from workgauge.rehearse.identify.programme import Encoders, rehearse_steps
from workgauge.rehearse.identify.result import JointStop, as_json, blocks, identify
from workgauge.rehearse.identify.result import table as stops_table
from workgauge.sim.hydraulics import HydraulicSpec
from workgauge.values.errors import InputError

#: Dead band of a rehearsed machine, whose file names none [share].
REHEARSED_BAND = 0.08


@input_errors_exit_2
def identify_command(
    log: Annotated[Path | None, typer.Argument(metavar="[LOG]", help="MCAP of this program, or CSV.")] = None,
    machine: Annotated[
        str | None, typer.Option(metavar="M", help="A shipped machine, or a file: for distances at the tool.")
    ] = None,
    rehearse: Annotated[
        bool, typer.Option("--rehearse", help="Drive the programme on the simulated machine M first; LOG is new.")
    ] = False,
    seed: Annotated[
        int | None, typer.Option(min=0, metavar="N", help="With --rehearse: a machine drawn within its tolerance.")
    ] = None,
    joint: Annotated[list[str] | None, typer.Option(metavar="J", help="Only this joint; may be repeated.")] = None,
    tolerance: Annotated[
        float, typer.Option(min=0, max=90, metavar="PERCENT", help="For what the log does not show, at least.")
    ] = 20.0,
    write: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the machine file's stopping blocks there.")
    ] = None,
    as_json_: Json = False,
) -> None:
    """Fit dead time, lag and deceleration of each joint to recorded stops, and say how far it still moves."""
    if log is None and not rehearse:
        raise typer.BadParameter("a LOG, or --rehearse --machine M", param_hint="LOG")
    if rehearse and machine is None:
        raise typer.BadParameter("--rehearse needs --machine M", param_hint="--machine")
    with tempfile.TemporaryDirectory(prefix="workgauge-") as folder:
        file = log or Path(folder) / "steps.mcap"
        model = None if machine is None else load_machine(machine)
        with busy("driving steps and stops on the simulated machine" if rehearse else None):
            if rehearse and model is not None:
                _rehearsed(model, file, seed, joint)
        steps = read_step_log(file)
        model = model or _machine_of(steps)
        with busy("fitting"):
            found = identify(steps, model, joint, tolerance / 100.0)
    source = f"identified from {'a rehearsal' if log is None else log.name}"
    if write is not None:
        _write(write, blocks(found, source))
    if as_json_:
        data = {"log": None if log is None else str(log), "machine": None if model is None else model.name}
        print_json({**data, **as_json(found), "written": None if write is None else str(write)})
        return
    _show(found, model)
    warn([one for each in found for side in each.sides for one in side.left_out])
    if write is not None:
        stdout().print(f"\nwritten to {write}")


def _rehearsed(machine: MachineModel, file: Path, seed: int | None, joints: Sequence[str] | None) -> None:
    """Drive the programme on the simulated machine and write its log."""
    spec = HydraulicSpec.of_machine(machine, REHEARSED_BAND)
    if seed is not None:
        spec = spec.varied(seed, StoppingModel.of(machine).tolerance)
    for name in joints or ():
        if name not in machine.joint_names:
            raise InputError("no such joint", element="--joint", value=name, allowed=", ".join(machine.joint_names))
    chosen = [machine.joint_names.index(name) for name in joints] if joints else None
    rehearse_steps(machine, file, spec=spec, encoders=Encoders(seed=seed or 0), joints=chosen)


def _machine_of(log: StepLog) -> MachineModel | None:
    """Return the machine the log names, if it is a shipped one."""
    return load_machine(log.machine) if log.machine in catalogue() else None


def _write(path: Path, content: dict[str, Any]) -> None:
    """Write the blocks beside their place first, so that nothing half-written is ever left there."""
    path = path.resolve()
    if path.exists() and not path.is_file():
        raise InputError("is not a regular file", file=path, element="--write", allowed="a file to be written")
    try:
        handle, name = tempfile.mkstemp(prefix=".stopping-", suffix=".yaml", dir=path.parent)
        work = Path(name)
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as stream:
                yaml.safe_dump(content, stream, sort_keys=False, allow_unicode=True, default_flow_style=False)
            work.chmod(0o644)
            work.replace(path)
        finally:
            work.unlink(missing_ok=True)
    except OSError as error:
        raise InputError("the blocks cannot be written there", file=path, value=error.strerror) from error


def _show(found: Sequence[JointStop], machine: MachineModel | None) -> None:
    console = stdout()
    columns = [
        *(("joint", False), ("", False), ("dead time [s]", True), ("lag [s]", True), ("deceleration", True)),
        *(("full speed", True), ("dead band [%]", True), ("tolerance [%]", True)),
    ]
    rows, stops = [], []
    for each in found:
        unit, scale = ("m", 1.0) if each.prismatic else ("°", math.degrees(1.0))
        for side in each.sides:
            fit, way = side.fit, "+" if side.direction > 0 else "−"
            rows.append(
                (
                    *(each.name, way, _spread(fit.dead_time_s, 3), _spread(fit.lag_s, 3)),
                    f"{_spread(fit.deceleration, 1, scale)} {unit}/s²",
                    f"{_spread(fit.full_speed, 1, scale)} {unit}/s",
                    *(_spread(fit.dead_band, 1, 100.0), f"{100 * side.tolerance:.0f}"),
                )
            )
            for speed, expected, most, tool in stops_table(each, side):
                shown = (f"{value * scale:.1f} {unit}" for value in (expected, most))
                at_tool = "" if tool is None else f"{tool:.2f}"
                stops.append((each.name, way, f"{speed * scale:.1f} {unit}/s", *shown, at_tool))
    console.print(table(f"Stopping, bounds holding together with {100 * CONFIDENCE:.0f} %", columns, rows))
    headings = [
        *(("joint", False), ("", False), ("from", True), ("still moves", True), ("at most", True)),
        ("at the tool, at most [m]", True),
    ]
    console.print()
    console.print(table("Stopping distances", headings, stops))
    if machine is None:
        console.print("Name the machine (--machine) for distances at the tool.", style="dim")


def _spread(one: Estimate | None, digits: int, scale: float = 1.0) -> str:
    """Return an estimate as `value (low–high)`."""
    if one is None:
        return "?"

    def text(value: float) -> str:
        return f"{value * scale:.{digits}f}" if math.isfinite(value) else "∞"

    return f"{text(one.value)} ({text(one.low)}–{text(one.high)})"
