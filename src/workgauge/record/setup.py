"""What a tick was set up with, as plain values in a log's header, and back."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, get_type_hints

from workgauge.drive.api import Drive
from workgauge.drive.hydraulic import HydraulicDrive
from workgauge.drive.ideal import IdealDrive
from workgauge.guard.api import Guard
from workgauge.guard.registry import guard_named
from workgauge.loop.config import TickConfig
from workgauge.machine.model import MachineModel
from workgauge.record.plain import from_plain, to_plain
from workgauge.values.errors import InputError

#: Drives by the name a log has for them.
_DRIVES: Mapping[str, type[Any]] = {"ideal": IdealDrive, "hydraulic": HydraulicDrive}
#: What of a configuration is not written field by field.
_NAMED = ("machine", "guard", "drive")


def configuration(config: TickConfig) -> dict[str, Any]:
    """Return what a tick was set up with, as plain values for a log's header.

    `machine`, `attachment`, `machine_id`, `joints`, `prismatic`, `guard` and `tick_s` are for people and readers;
    `tick`, `guard_parameters` and `drive` hold every setting, so that `configured` gives the same tick.
    """
    machine = config.machine
    kind = next((name for name, kind in _DRIVES.items() if type(config.drive) is kind), type(config.drive).__name__)
    settings = {field.name: to_plain(getattr(config, field.name)) for field in fields(config) if _plain(field.name)}
    return {
        "machine": machine.name,
        "attachment": machine.attachment,
        "machine_id": config.machine_id,
        "joints": list(machine.joint_names),
        "prismatic": [bool(one) for one in machine.prismatic],
        "guard": config.guard.name,
        "guard_parameters": _parameters(config.guard),
        "tick_s": config.dt_s,
        "drive": {"kind": kind, "settings": to_plain(config.drive) if kind in _DRIVES else None},
        "tick": settings,
    }


def configured(written: Mapping[str, Any], machine: MachineModel) -> TickConfig:
    """Return the tick's configuration that a log's header tells.

    Args:
        written: as `configuration` returns it. machine: the one it was written for.

    Raises:
        InputError: if the header holds no such configuration, or one for another machine, guard or drive.
    """
    if list(machine.joint_names) != written.get("joints") or machine.attachment != written.get("attachment"):
        raise InputError(
            "not the machine of the log",
            element="machine",
            value=f"{machine.name}, {machine.attachment}",
            allowed=f"{written.get('machine')}, {written.get('attachment')}",
        )
    hints = get_type_hints(TickConfig)
    try:
        settings = written["tick"]
        given = {name: hint for name, hint in hints.items() if _plain(name) and name in settings}
        made = {name: from_plain(hint, settings[name]) for name, hint in given.items()}
        guard = _guard(str(written["guard"]), written["guard_parameters"])
        return TickConfig(machine=machine, guard=guard, drive=_drive(written["drive"]), **made)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError("its configuration cannot be used", element="header", value=str(error)) from error


def _plain(name: str) -> bool:
    return name not in _NAMED


def _parameters(guard: Any) -> dict[str, Any]:
    """Return the settings of a guard that is a dataclass, none of any other."""
    names = [field.name for field in fields(guard) if field.init] if is_dataclass(guard) else []
    return {name: to_plain(getattr(guard, name)) for name in names}


def _guard(name: str, parameters: Mapping[str, Any]) -> Guard:
    guard: Any = guard_named(name)
    hints = get_type_hints(type(guard))
    made: Guard = replace(guard, **{key: from_plain(hints[key], value) for key, value in parameters.items()})
    return made


def _drive(written: Mapping[str, Any]) -> Drive:
    drive: Drive = from_plain(_DRIVES[written["kind"]], written["settings"])
    return drive
