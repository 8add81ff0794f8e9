"""How much guards tremble: commanded joint acceleration above 2 Hz beyond the levers' own, in two scenes for it.

    python benchmarks/chatter.py --json

The scenes are the shipped scenarios `slide-along-envelope` and `between-limits`, after Mäkinen's figure 4.10 a and b.
Guards: `linear`; `potential`, the artificial potential field with one closest point per link; `potential-each-limit`,
with one per link and limit, both as printed; `potential-each-limit-held`, the program's own, whose approach ends at
the stop distance; `nearest-pair`, the barrier of the single nearest pair without prediction; `barrier`.

Prints `{"rows": [{"scene", "joints", "guard", "chatter", "by_joint", "share_of_potential", "share_of_nearest_pair",
"motion_rad", "min_clearance_m", "entries"}…]}`. `chatter` is that of `workgauge run --json` [rad/s^2]; `motion_rad`
the way of all joints together. Joints are `ideal`, follow at once, and the guard is told so; or `hydraulic`, as the
machine's file says, and the guard is told the same.
"""

import argparse
import itertools
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from baselines import NearestPairBarrier
from baselines_potential import PotentialField

from workgauge.guard.api import Guard
from workgauge.guard.potential import Points
from workgauge.guard.registry import GUARDS, guard_named
from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.rehearse.drives.dynamics import IDEAL, believed_machine
from workgauge.rehearse.result import RunResult
from workgauge.rehearse.run import open_session, run_session
from workgauge.rehearse.scenario_file import load_scenario
from workgauge.report.page import write_report

SCENES = ("slide-along-envelope", "between-limits")
JOINTS = ("ideal", "hydraulic")
POTENTIAL, NEAREST_PAIR = "potential", "nearest-pair"


def guards() -> list[Guard]:
    """Return the guards compared, the barrier last, if there is one."""
    compared: list[Guard] = [
        guard_named("linear"),
        PotentialField(),
        PotentialField(points=Points.PER_LIMIT),
        PotentialField(points=Points.PER_LIMIT, hold=True),
        NearestPairBarrier(),
    ]
    return [*compared, *(guard_named(name) for name in ("barrier",) if name in GUARDS)]


def machine_with(machine: MachineModel, joints: str) -> MachineModel:
    """Return the machine with the stopping model that the joints deserve."""
    return machine if joints == "hydraulic" else believed_machine(machine, IDEAL, np.random.default_rng(0))


def run(scene: str, guard: Guard, joints: str) -> RunResult:
    """Return one guard's run of one scene."""
    loaded = load_scenario(scene)
    scenario = loaded.scenario.model_copy(update={"joints": joints})
    loaded = replace(loaded, scenario=scenario)
    machine = machine_with(load_machine(loaded.machine, scenario.attachment), joints)
    session = open_session(loaded, guard=guard, machine=machine)
    return run_session(session, scenario.drive, f"{scenario.title}: {guard.name}", scenario.description)


def row(scene: str, joints: str, guard: Guard, result: RunResult) -> dict[str, Any]:
    """Return what one run shows."""
    found = result.chatter()
    assert found is not None, "the scenes' ticks are quick enough"
    plain = found.as_json(result.joint_names)
    return {
        "scene": scene,
        "joints": joints,
        "guard": guard.name,
        "chatter": plain["total"],
        "by_joint": plain["by_joint"],
        "motion_rad": round(float(np.abs(np.diff(result.series.q, axis=0)).sum()), 4),
        "min_clearance_m": None if result.min_clearance_m is None else round(result.min_clearance_m, 4),
        "entries": len(result.entries),
    }


def measure(
    scenes: Sequence[str], joints: Sequence[str], names: Sequence[str], report: Path | None = None
) -> dict[str, Any]:
    """Return every guard's row in every scene, and its share of the two it is held against."""
    rows = []
    for scene, kind in itertools.product(scenes, joints):
        here = []
        for guard in (one for one in guards() if one.name in names):
            result = run(scene, guard, kind)
            here.append(row(scene, kind, guard, result))
            if report is not None:
                write_report(result, report / f"{scene}-{kind}-{guard.name}")
        by_guard = {one["guard"]: one["chatter"] for one in here}
        for one in here:
            for key, other in (("share_of_potential", POTENTIAL), ("share_of_nearest_pair", NEAREST_PAIR)):
                one[key] = round(one["chatter"] / by_guard[other], 4) if by_guard.get(other) else None
        rows += here
    return {"rows": rows}


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=SCENES, action="append", help="only this one; may be repeated")
    known = [guard.name for guard in guards()]
    parser.add_argument("--guard", choices=known, action="append", help="only this one; may be repeated")
    parser.add_argument("--joints", choices=JOINTS, action="append", help="only these")
    parser.add_argument("--report", type=Path, metavar="DIR", help="writes every run's report into DIR")
    parser.add_argument("--json", action="store_true", help="the object instead of words")
    given = parser.parse_args()
    found = measure(given.scene or SCENES, given.joints or JOINTS, given.guard or known, given.report)
    if given.json:
        print(json.dumps(found))
        return
    for one in found["rows"]:
        shares = f"{one['share_of_potential']} of potential, {one['share_of_nearest_pair']} of nearest-pair"
        way = f"moved {one['motion_rad']:.2f} rad, {one['min_clearance_m']:.3f} m, {one['entries']} entries"
        print(
            f"{one['scene']:21} {one['joints']:10} {one['guard']:21} {one['chatter']:8.4f} rad/s^2, {shares}, {way}"
        )


if __name__ == "__main__":
    main()
