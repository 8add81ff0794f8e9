"""What a session is handed, in the many forms people write it, turned into what it works with."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from workgauge.guard.api import Guard
from workgauge.guard.registry import guard_named
from workgauge.machine.model import MachineModel
from workgauge.rehearse.scenario import OnGround, OnTrack
from workgauge.rehearse.shipped import shipped_names, shipped_site_files
from workgauge.site.model import SiteModel
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import ScenarioError

#: Coordinates beyond this are on no map [m].
FARTHEST_M = 1e8


def chosen_guard(name: str, parameters: Mapping[str, float | str]) -> Guard:
    """Return the guard of that name with these of its parameters changed.

    Raises:
        ScenarioError: for a parameter it does not have.
    """
    guard: Any = guard_named(name)
    known = [field.name for field in fields(guard)]
    for key in parameters:
        if key not in known:
            raise ScenarioError(
                f"guard {name} has no such parameter", element=key, allowed=", ".join(known) or "none"
            )
        if isinstance(parameters[key], str) and not isinstance(getattr(guard, key), str):
            raise ScenarioError(
                f"guard {name} needs a number here", element=key, value=parameters[key], allowed="a number"
            )
    chosen: Guard = replace(guard, **parameters)
    return chosen


def chosen_files(site: str | Path | Sequence[str | Path]) -> list[Path]:
    """Return the files of a site: its own, or those of a shipped one."""
    if isinstance(site, str | Path):
        if not Path(site).exists() and str(site) in shipped_names("sites"):
            return list(shipped_site_files(str(site)))
        return [Path(site)]
    return [Path(file) for file in site]


def chosen_place(at: tuple[float, float, float] | OnTrack | OnGround | None, site: SiteModel) -> OnTrack | OnGround:
    """Return where the machine is to stand; left out, the middle of the site's first alignment.

    Raises:
        ScenarioError: for a place that is no number or on no map, or none on a site without alignments.
    """
    if isinstance(at, OnGround) and not max(abs(at.east_m), abs(at.north_m)) <= FARTHEST_M:
        raise ScenarioError(
            "no map has such a place",
            element="start",
            value=f"E {at.east_m:g} N {at.north_m:g}",
            allowed=f"up to {FARTHEST_M:g} m",
        )
    if isinstance(at, OnTrack | OnGround):
        return at
    if at is not None:
        if not all(math.isfinite(value) for value in at):
            raise ScenarioError("the place must be finite numbers", element="at", value=at, allowed="E, N, heading")
        return chosen_place(OnGround(east_m=at[0], north_m=at[1], heading_deg=at[2]), site)
    if not site.alignments:
        raise ScenarioError("say where the machine stands", element="at", allowed="(east, north, heading in degrees)")
    first = site.alignments[0]
    return OnTrack(alignment=first.name, distance_m=0.5 * first.length)


def chosen_posture(machine: MachineModel, given: Mapping[str, float]) -> Floats:
    """Return the start posture: home, with the joints named in `given`.

    Raises:
        ScenarioError: for an unknown joint or a position beyond its limits.
    """
    q = np.array(machine.home)
    for name, position in given.items():
        if name not in machine.joint_names:
            raise ScenarioError(
                "no such joint", element="posture", value=name, allowed=", ".join(machine.joint_names)
            )
        j = machine.joint_names.index(name)
        if not machine.q_min[j] <= position <= machine.q_max[j]:
            unit, factor = ("m", 1.0) if machine.prismatic[j] else ("°", math.degrees(1.0))
            low, high = machine.q_min[j] * factor, machine.q_max[j] * factor
            raise ScenarioError(
                f"joint {name} beyond its limits",
                element="posture",
                value=f"{position * factor:g} {unit}",
                allowed=f"{low:g} to {high:g} {unit}",
            )
        q[j] = position
    return frozen(q)
