"""Automatic motion under different guards, side by side: the shipped scenario `ballast-removal`, after Mäkinen.

    python benchmarks/ballast.py --json
    python benchmarks/ballast.py --guard barrier --joints hydraulic --report DIR

The path as designed enters the envelope of the adjacent track and comes near the machine itself. Guards: `none`,
which shows what would happen without; `potential`, the artificial potential field; `barrier`. Joints: `ideal`, which
follow at once, and the guard is told so; `hydraulic`, as the machine's file says, and the guard is told the same. A
run takes about a minute.

Prints `{"rows": [{"guard", "joints", "entries", "completed", "planned_s", "driven_s", "driven_over_planned",
"worst_clearance_m", "depth_m", "max_error_m", "chatter"}…]}`. `entries` are those into limits and into the machine's
own links, `depth_m` the deepest, 0 without one; `worst_clearance_m` the smallest true clearance of either kind,
negative inside; `max_error_m` the tool's largest distance from where its plan had it by then, `null` without a plan;
`chatter` that of `workgauge run --json` [rad/s^2].
"""

import argparse
import itertools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from workgauge.guard.registry import GUARDS
from workgauge.machine.load import load_machine
from workgauge.rehearse.drives.dynamics import IDEAL, believed_machine
from workgauge.rehearse.result import RunResult
from workgauge.rehearse.run import open_session, run_session
from workgauge.rehearse.scenario_file import load_scenario
from workgauge.report.giving_way import off_path
from workgauge.report.page import write_report

SCENARIO = "ballast-removal"
COMPARED = ("none", "potential", "barrier")
Joints = Literal["ideal", "hydraulic"]
JOINTS: tuple[Joints, ...] = ("ideal", "hydraulic")


def run(guard: str, joints: Joints) -> RunResult:
    """Return one guard's run of the scenario."""
    loaded = load_scenario(SCENARIO).choosing(guard=guard, joints=joints)
    machine = load_machine(loaded.machine, loaded.scenario.attachment)
    if joints == "ideal":
        machine = believed_machine(machine, IDEAL, np.random.default_rng(0))
    scenario = loaded.scenario
    session = open_session(loaded, machine=machine)
    return run_session(session, scenario.drive, f"{scenario.title}: {guard}", scenario.description)


def row(guard: str, joints: str, result: RunResult) -> dict[str, Any]:
    """Return what one run shows."""
    auto, chatter = result.automatic, result.chatter()
    assert auto is not None and chatter is not None, "the scenario is automatic, and its ticks are quick enough"
    found = auto.as_json()
    off = off_path(auto)
    entries = (*result.entries, *result.self_entries)
    clearances = [one for one in (result.min_clearance_m, result.min_self_clearance_m) if one is not None]
    return {
        "guard": guard,
        "joints": joints,
        "entries": len(entries),
        **{key: found[key] for key in ("completed", "planned_s", "driven_s", "driven_over_planned")},
        "worst_clearance_m": round(min(clearances), 4) if clearances else None,
        "depth_m": round(max((entry.depth_m for entry in entries), default=0.0), 4),
        "max_error_m": round(float(np.nanmax(off)), 4) if np.isfinite(off).any() else None,
        "chatter": round(chatter.total, 4),
    }


def measure(guards: Sequence[str], joints: Sequence[Joints], report: Path | None = None) -> dict[str, Any]:
    """Return every guard's row with every kind of joints; reports go into folders named after both."""
    rows = []
    for kind, guard in itertools.product(joints, guards):
        result = run(guard, kind)
        rows.append(row(guard, kind, result))
        if report is not None:
            write_report(result, report / f"{kind}-{guard}")
    return {"rows": rows}


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--guard", choices=sorted(GUARDS), action="append", help="only this one; may be repeated")
    parser.add_argument("--joints", choices=JOINTS, action="append", help="only these")
    parser.add_argument("--report", type=Path, metavar="DIR", help="writes every run's report into DIR")
    parser.add_argument("--json", action="store_true", help="the object instead of words")
    given = parser.parse_args()
    found = measure(given.guard or COMPARED, given.joints or JOINTS, given.report)
    if given.json:
        print(json.dumps(found))
        return
    for one in found["rows"]:
        end = "done" if one["completed"] else "not done"
        times = f"{end} in {one['driven_s']:.1f} s of {one['planned_s']:.1f} s planned"
        near = f"{one['entries']} entries, {one['depth_m']:.3f} m deep, nearest {one['worst_clearance_m']:.3f} m"
        print(f"{one['guard']:10} {one['joints']:10} {times}, {near}, off by up to {one['max_error_m']} m")


if __name__ == "__main__":
    main()
