"""How much faster than real time automatic motion is run ahead, and what the run itself then came to.

    python benchmarks/preview.py --json
    python benchmarks/preview.py --scenario ballast-removal --times 5

Prints `{"rows": [{"scenario", "guard", "tick_ms", "foreseen_s", "driven_s", "planning_s", "faster", "faster_ticks",
"foreseen_m", "driven_m"}…]}`. `faster`: simulated over wall-clock time of a whole preview, planning included: median,
least and most of `--times`; `faster_ticks`: of its ticks alone, median. `planning_s`: of that, wall clock.
`foreseen_m` and `driven_m`: smallest clearance to a limit, of the preview and of the run without disturbances, `null`
if none is near.
"""

import argparse
import json
import statistics
import time
from typing import Any

from workgauge.rehearse.automatic import Automatic
from workgauge.rehearse.preview_drive import preview_drive
from workgauge.rehearse.run import open_session, run_session
from workgauge.rehearse.scenario_file import load_scenario

SCENARIOS = ("ballast-removal", "drawn-path", "point-to-point")


def row(name: str, times: int) -> dict[str, Any]:
    """Return what a scenario's preview takes and foresees, and what its run came to."""
    loaded = load_scenario(name)
    session = open_session(loaded)
    session.warm_up()
    steps = loaded.scenario.drive
    took, planning = [], []
    for _ in range(times):
        began = time.perf_counter()
        ahead = preview_drive(session, steps)
        took.append(time.perf_counter() - began)
        automatic = Automatic(session.machine, session.frame, session.surroundings, session.limit_names)
        began = time.perf_counter()
        automatic.planned(steps, *session.true_state)
        planning.append(time.perf_counter() - began)
    foreseen_s = sum(step.preview.duration_s for step in ahead.steps)
    near = [step.preview.nearest[1].clearance_m for step in ahead.steps if step.preview.nearest is not None]
    result = run_session(open_session(loaded), steps, name)
    assert result.automatic is not None, "the scenario is automatic"
    faster = [foreseen_s / one for one in took]
    return {
        "scenario": name,
        "guard": session.guard.name,
        "tick_ms": session.tick_s * 1e3,
        "foreseen_s": round(foreseen_s, 2),
        "driven_s": round(sum(job.ended_s - job.begun_s for job in result.automatic.jobs), 2),
        "planning_s": round(statistics.median(planning), 3),
        "faster": [round(one, 1) for one in (statistics.median(faster), min(faster), max(faster))],
        "faster_ticks": round(foreseen_s / statistics.median(a - b for a, b in zip(took, planning, strict=True)), 1),
        "foreseen_m": round(min(near), 5) if near else None,
        "driven_m": None if result.min_clearance_m is None else round(result.min_clearance_m, 5),
    }


def main() -> None:
    """Parse, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", action="append", choices=SCENARIOS, help="only this one; may be repeated")
    parser.add_argument("--times", type=int, default=3, help="previews of each")
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    if asked.times < 1:
        parser.error("--times must be above 0")
    rows = [row(name, asked.times) for name in asked.scenario or SCENARIOS]
    print(json.dumps({"rows": rows}, indent=None if asked.json else 1))


if __name__ == "__main__":
    main()
