"""Guards judged by the same random drives on simulated hydraulics: one JSON object with `--json`.

    python benchmarks/guard.py --drives 1000 --jobs 2 --journal guard.jsonl --json

A drive is the shipped 20 t road-rail excavator on the shipped site or among random limits, from a posture near a
limit but clear of all, with full levers for four seconds: several joints at once, quick reversals, along what is
near, straight at it, at itself; in 3 of 10 the gate closes at random instants. Every guard gets the same drives at
every dead time. Lag 0.2 s, full speed over deceleration 0.6 s. See `workgauge.rehearse.drives`.

Three kinds of dynamics: `equal` joints; `unequal`, threefold differences between joints and between directions;
`tolerance`, unequal and the real machine anywhere within 30 % of what the guard is told, or at its ends.

Rows, one per guard, dynamics and dead time:
- `entries`: limits entered, own links among them, all drives together; `drives_entered`: drives with any.
- `worst_clearance_m`: smallest true clearance. `worst_less_stop_m`: smallest true clearance less its stop distance.
- `below_stop`: drives in which a clearance fell below its stop distance by more than 0.1 mm.
- `motion_rad`: way of all joints together. `motion_share`: of what the same hands move without a guard.
- `holds`: drives on which linear scaling holds (enters nothing, keeps every stop distance); `holds_motion_ratio`: the
  guard's motion over linear scaling's on these, null without it.

With `--journal` every drive's result is appended to a file as soon as it is there, and a run that is started again
with the same file goes on where it stopped; results of other settings in it are left alone.
"""

import argparse
import hashlib
import json
import math
import multiprocessing
import os
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

for _threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")  # before numpy: one drive, one core

from baselines import BASELINES as PLAIN_BASELINES  # noqa: E402
from baselines_potential import BASELINES as POTENTIAL_BASELINES  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn  # noqa: E402
from rich.table import Table  # noqa: E402

from workgauge.gauge.rulebook import load_rule_book  # noqa: E402
from workgauge.guard.api import Guard  # noqa: E402
from workgauge.guard.registry import GUARDS, guard_named  # noqa: E402
from workgauge.machine.load import load_machine  # noqa: E402
from workgauge.rehearse.drives.draw import Drives, DriveSettings  # noqa: E402
from workgauge.rehearse.drives.dynamics import Dynamics  # noqa: E402
from workgauge.rehearse.drives.run import DriveResult, run_drive  # noqa: E402
from workgauge.rehearse.shipped import shipped_site_files  # noqa: E402
from workgauge.site.read import read_site  # noqa: E402

#: Baselines by name; each can be told the stop distance.
BASELINES: dict[str, Callable[..., Guard]] = {**PLAIN_BASELINES, **POTENTIAL_BASELINES}
MACHINE, SITE, RULES = "rre20", "double_track", "finland"
DEAD_TIMES_S = (0.0, 0.1, 0.3, 0.6, 1.3)
LAG_S, STOP_S, RATIO, TOLERANCE = 0.2, 0.6, 3.0, 0.3
DYNAMICS = ("equal", "unequal", "tolerance")
STOP_DISTANCE_M = 0.2
#: What is no more below the stop distance than this is not below it [m].
ROUNDING_M = 1e-4
#: Grows whenever the same settings give other drives, so that an old journal is not believed.
DRIVES_VERSION = 2

#: (dynamics, dead time [s], seed)
Task = tuple[str, float, int]
#: (guard, dynamics, dead time [s], seed)
Key = tuple[str, str, float, int]
Results = dict[Key, DriveResult]


def settings(dynamics: str, dead_time_s: float) -> DriveSettings:
    """Return what all drives of one dynamics and dead time share."""
    ratio = 1.0 if dynamics == "equal" else RATIO
    worse = dynamics == "tolerance"
    return DriveSettings(
        dynamics=Dynamics(
            dead_time_s=dead_time_s,
            lag_s=LAG_S,
            stop_s=STOP_S,
            ratio=ratio,
            tolerance=TOLERANCE if worse else 0.0,
            truth="within" if worse else "believed",
        ),
        stop_distance_m=STOP_DISTANCE_M,
        near_m=0.1,
    )


def guard_made(name: str) -> Guard:
    """Return one of the guards of the program or of the baselines, keeping the stop distance of the drives."""
    if name in BASELINES:
        return BASELINES[name](stop_distance_m=STOP_DISTANCE_M)
    guard = guard_named(name)
    if getattr(guard, "stop_distance_m", STOP_DISTANCE_M) != STOP_DISTANCE_M:
        raise SystemExit(f"{name} keeps another stop distance than {STOP_DISTANCE_M} m by default")
    return guard


def fingerprint(dynamics: str, dead_time_s: float) -> str:
    """Return what marks results of these settings in a journal."""
    told = [DRIVES_VERSION, MACHINE, SITE, RULES, asdict(settings(dynamics, dead_time_s))]
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[:16]


class Worker:
    """Draws and drives in one process; made once there."""

    drives: Drives | None = None

    @classmethod
    def run(cls, work: tuple[Task, tuple[str, ...]]) -> list[tuple[Key, dict[str, Any]]]:
        """Return the results of some guards on one drive."""
        (dynamics, dead_time_s, seed), guards = work
        if cls.drives is None:
            cls.drives = Drives(load_machine(MACHINE), read_site(shipped_site_files(SITE)), load_rule_book(RULES))
        drive = cls.drives.draw(seed, settings(dynamics, dead_time_s))
        results = []
        for name in guards:
            try:
                result = run_drive(drive, guard_made(name))
            except Exception as error:
                which = f"{name}, {dynamics}, dead time {dead_time_s:g} s, seed {seed}"
                raise RuntimeError(f"{which}: {type(error).__name__}: {error}") from error
            results.append(((name, dynamics, dead_time_s, seed), result.plain()))
        return results


class Journal:
    """Results on disk, one line each, appended as they come."""

    def __init__(self, path: Path | None) -> None:
        self._path = path

    def known(self, wanted: set[Key]) -> Results:
        """Return the wanted results that are in the file; a last line cut off by a crash is forgotten."""
        found: Results = {}
        if self._path is None or not self._path.exists():
            return found
        for line in self._path.read_text().splitlines():
            try:
                entry = json.loads(line)
                key = (entry["guard"], entry["dynamics"], entry["dead_time_s"], entry["seed"])
                if key in wanted and entry["settings"] == fingerprint(key[1], key[2]):
                    found[key] = DriveResult.of_plain(entry["result"])
            except (ValueError, KeyError, TypeError):
                continue
        return found

    def append(self, results: Iterable[tuple[Key, dict[str, Any]]]) -> None:
        """Add results to the file."""
        if self._path is None:
            return
        with self._path.open("a+b") as file:
            if file.tell() and not self._ends_whole():
                file.write(b"\n")
            for (guard, dynamics, dead_time_s, seed), plain in results:
                entry = {"guard": guard, "dynamics": dynamics, "dead_time_s": dead_time_s, "seed": seed}
                entry |= {"settings": fingerprint(dynamics, dead_time_s), "result": plain}
                file.write(json.dumps(entry).encode() + b"\n")

    def _ends_whole(self) -> bool:
        assert self._path is not None
        with self._path.open("rb") as file:
            file.seek(-1, os.SEEK_END)
            return file.read(1) == b"\n"


def measured(guards: tuple[str, ...], tasks: list[Task], journal: Journal, jobs: int, console: Console) -> Results:
    """Return every guard's result on every drive, those of the journal as they are."""
    results = journal.known({(name, *task) for name in guards for task in tasks})
    missing = {task: tuple(name for name in guards if (name, *task) not in results) for task in tasks}
    work = [(task, names) for task, names in missing.items() if names]
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=console) as progress:
        bar = progress.add_task("drives", total=len(tasks), completed=len(tasks) - len(work))
        for done in _mapped(Worker.run, work, jobs):
            journal.append(done)
            results |= {key: DriveResult.of_plain(plain) for key, plain in done}
            progress.advance(bar)
    return results


def _mapped(function: Callable[..., Any], work: list[Any], jobs: int) -> Iterator[Any]:
    if jobs == 1 or len(work) < 2:
        yield from map(function, work)
        return
    with multiprocessing.get_context("spawn").Pool(min(jobs, len(work))) as pool:
        yield from pool.imap_unordered(function, work)


def rows(results: Results) -> list[dict[str, Any]]:
    """Return one row per guard, dynamics and dead time."""
    groups: dict[tuple[str, str, float], dict[int, DriveResult]] = defaultdict(dict)
    for (guard, dynamics, dead_time_s, seed), result in results.items():
        groups[guard, dynamics, dead_time_s][seed] = result
    out = []
    for (guard, dynamics, dead_time_s), found in groups.items():
        linear = groups.get(("linear", dynamics, dead_time_s), {})
        kept = (seed for seed, one in linear.items() if not one.entries and one.worst_less_stop_m >= -ROUNDING_M)
        held = sorted(kept)
        all_of = [found[seed] for seed in sorted(found)]
        there, here = (sum(table[seed].motion for seed in held) for table in (linear, found))
        free = sum(one.free_motion for one in all_of)
        out.append(
            {
                "guard": guard,
                "dynamics": dynamics,
                "dead_time_s": dead_time_s,
                "entries": sum(one.entries for one in all_of),
                "drives_entered": sum(one.entries > 0 for one in all_of),
                "worst_clearance_m": _least(one.worst_clearance_m for one in all_of),
                "worst_less_stop_m": _least(one.worst_less_stop_m for one in all_of),
                "below_stop": sum(one.worst_less_stop_m < -ROUNDING_M for one in all_of),
                "motion_rad": sum(one.motion for one in all_of),
                "motion_share": sum(one.motion for one in all_of) / free if free else None,
                "holds": len(held) if linear else None,
                "holds_motion_ratio": here / there if there else None,
                "drives": len(all_of),
                "drives_near": sum(one.near for one in all_of),
                "seeds_below_stop": [one.seed for one in all_of if one.worst_less_stop_m < -ROUNDING_M][:20],
            }
        )
    return out


def _least(values: Iterable[float]) -> float | None:
    """Return the smallest value, None if nothing was ever in sight."""
    least = min(values)
    return least if math.isfinite(least) else None


def shown(table_rows: list[dict[str, Any]]) -> Table:
    """Return the rows as a table for people."""
    heads = "guard", "dynamics", "delay s", "entries", "below", "worst m", "less stop", "rad", "of free", "of linear"
    table = Table(*heads, box=None, caption="below: drives that fell below a stop distance")
    for row in table_rows:
        numbers = row["worst_clearance_m"], row["worst_less_stop_m"], row["motion_share"], row["holds_motion_ratio"]
        worst, less, share, ratio = ("" if one is None else f"{one:.3f}" for one in numbers)
        below = f"{row['below_stop']} of {row['drives']}"
        table.add_row(
            *(row["guard"], row["dynamics"], f"{row['dead_time_s']:g}", str(row["entries"]), below, worst, less),
            *(f"{row['motion_rad']:.1f}", share, ratio),
        )
    return table


def main() -> None:
    """Drive and print."""
    known = tuple(dict.fromkeys((*GUARDS, *BASELINES)))
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drives", type=int, default=1000, help="per dynamics and dead time")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--guards", nargs="+", default=list(known), choices=known, metavar="GUARD", help=str(known))
    parser.add_argument("--dead-times", nargs="+", type=float, default=list(DEAD_TIMES_S), metavar="S")
    parser.add_argument("--dynamics", nargs="+", default=list(DYNAMICS), choices=DYNAMICS)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--journal", type=Path, help="file of results, to go on from")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    asked = parser.parse_args()
    if asked.drives < 1 or asked.jobs < 1:
        parser.error("--drives and --jobs must be at least 1")
    guards = tuple(name for name in known if name in asked.guards)
    seeds = range(asked.first_seed, asked.first_seed + asked.drives)
    tasks = [(dynamics, dead, seed) for seed in seeds for dynamics in asked.dynamics for dead in asked.dead_times]
    console = Console(file=sys.stderr)
    results = measured(guards, tasks, Journal(asked.journal), asked.jobs, console)
    order = [(name, dynamics, dead) for dynamics in asked.dynamics for dead in asked.dead_times for name in guards]
    table_rows = sorted(
        rows(results), key=lambda row: order.index((row["guard"], row["dynamics"], row["dead_time_s"]))
    )
    if asked.json:
        print(json.dumps({"drives": asked.drives, "rows": table_rows}))
    else:
        Console().print(shown(table_rows))


if __name__ == "__main__":
    main()
