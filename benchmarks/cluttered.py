"""Random cluttered scenes: which are solved by a global plan, how long that takes, and whether it holds.

    python benchmarks/cluttered.py --json
    python benchmarks/cluttered.py --scenes 200 --machine brokk5 --jobs 2 --journal cluttered.jsonl

Poles, a track envelope and a wagon, drawn at random round the machine (`workgauge.rehearse.cluttered`); from one
clear posture to another. A plan keeps 0.05 m above every stop distance (0.2 m).

Methods: `global plan`, the plan alone. `local`: closed-loop inverse kinematics to the goal's pose, bent before limits
and round them, driven by the real tick with the barrier guard on simulated hydraulic joints (20 ms ticks).
`local, then plan`: the same, and where it comes no nearer, a global plan from there, driven under the same guard.

Prints `{"machine", "scenes", "methods": [{"method", "solved", "straight", "invalid", "unsolved", "seconds_median",
"seconds_p90", "longer_median"}], "rows": […]}`. `straight`: solved
because the straight joint line is free. `invalid`: a dense search of the way (a posture for every `--spacing-mm` any
corner moves) found a clearance that is not kept. `seconds` are of the processor, over the scenes whose straight line
is not free. `longer`: the duration over that of the straight joint line at full joint speeds. `unsolved`: seed and
reason. `entered`: scenes in which a driven machine was inside a limit or itself; of what is driven `invalid` counts
clearances below their stop distances by more than 0.1 mm. `hurried`: plans ended by the clock, which another run may
not find.

With `--journal` what a method made of a scene is appended to a file as soon as it is there, and a run that is started
again with the same file goes on where it stopped; results of other settings in it are left alone.
"""

import argparse
import hashlib
import json
import math
import multiprocessing
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

for _threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")  # before numpy: one scene, one core

import numpy as np  # noqa: E402
from cluttered_methods import (  # noqa: E402
    BOTH,
    CLEARANCE_M,
    KEPT_M,
    LOCAL,
    METHODS,
    SECONDS,
    STOP_DISTANCE_M,
    THERE,
    TICK_S,
    VERSIONS,
    Outcome,
    outcomes,
    warmed,
)
from rich.console import Console  # noqa: E402
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn  # noqa: E402

from workgauge.machine.load import load_machine  # noqa: E402
from workgauge.machine.model import MachineModel  # noqa: E402
from workgauge.rehearse.cluttered import cluttered  # noqa: E402

#: (method, the scene's seed)
Key = tuple[str, int]
Results = dict[Key, Outcome]
#: (machine, the scene's seed, methods, spacing of the dense search [m])
Task = tuple[str, int, tuple[str, ...], float]


def fingerprint(machine: str, method: str, spacing_m: float) -> str:
    """Return what marks results of these settings in a journal."""
    told = [machine, method, VERSIONS[method], spacing_m, STOP_DISTANCE_M, CLEARANCE_M, SECONDS, TICK_S, THERE]
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[:16]


class Worker:
    """Draws scenes of one machine in one process; made once there."""

    machine: tuple[str, MachineModel] | None = None

    @classmethod
    def run(cls, task: Task) -> list[tuple[Key, Outcome]]:
        """Return what some methods make of a scene."""
        name, seed, methods, spacing_m = task
        if cls.machine is None or cls.machine[0] != name:
            cls.machine = name, load_machine(name)
            warmed(cluttered(cls.machine[1], 0, stop_distance_m=STOP_DISTANCE_M))
        try:
            drawn = cluttered(cls.machine[1], seed, stop_distance_m=STOP_DISTANCE_M)
            return [((method, seed), outcome) for method, outcome in outcomes(drawn, methods, spacing_m)]
        except Exception as error:
            raise RuntimeError(f"{name}, scene {seed}: {type(error).__name__}: {error}") from error


class Journal:
    """Results on disk, one line each, appended as they come.

    Args:
        path: the file, None for none. marks: method to what marks its results there.
    """

    def __init__(self, path: Path | None, marks: Mapping[str, str]) -> None:
        self._path, self._marks = path, marks

    def known(self, wanted: set[Key]) -> Results:
        """Return the wanted results that are in the file; a last line cut off by a crash is forgotten."""
        found: Results = {}
        if self._path is None or not self._path.exists():
            return found
        for line in self._path.read_text().splitlines():
            try:
                entry = json.loads(line)
                key = (entry["method"], entry["seed"])
                if key in wanted and entry["settings"] == self._marks[key[0]]:
                    found[key] = Outcome(**entry["outcome"])
            except (ValueError, KeyError, TypeError):
                continue
        return found

    def append(self, results: Iterable[tuple[Key, Outcome]]) -> None:
        """Add results to the file."""
        if self._path is None:
            return
        with self._path.open("a+b") as file:
            if file.tell():
                file.seek(-1, os.SEEK_END)
                if file.read(1) != b"\n":
                    file.write(b"\n")
            for (method, seed), outcome in results:
                entry = {"method": method, "seed": seed, "settings": self._marks[method], "outcome": asdict(outcome)}
                file.write(json.dumps(entry).encode() + b"\n")


def measured(tasks: Sequence[Task], journal: Journal, jobs: int, console: Console) -> Results:
    """Return what every method makes of every scene, what the journal has as it is there."""
    results = journal.known({(method, task[1]) for task in tasks for method in task[2]})
    work = []
    for machine, seed, methods, spacing_m in tasks:
        alone = results.get((LOCAL, seed))
        if BOTH in methods and alone is not None and alone.solved:
            results.setdefault((BOTH, seed), alone)  # there was nothing left to plan
        missing = tuple(method for method in methods if (method, seed) not in results)
        if missing:
            work.append((machine, seed, missing, spacing_m))
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        bar = progress.add_task("scenes", total=len(tasks), completed=len(tasks) - len(work))
        for done in _mapped(Worker.run, work, jobs):
            journal.append(done)
            results |= dict(done)
            progress.advance(bar)
    return results


def _mapped(function: Callable[..., Any], work: list[Any], jobs: int) -> Iterator[Any]:
    if jobs == 1 or len(work) < 2:
        yield from map(function, work)
        return
    with multiprocessing.get_context("spawn").Pool(min(jobs, len(work))) as pool:
        yield from pool.imap_unordered(function, work)


def summary(method: str, found: Mapping[int, Outcome]) -> dict[str, Any]:
    """Return what a method made of all scenes, given by seed."""
    blocked = [one for one in found.values() if not one.straight]
    seconds = [one.seconds for one in blocked] or [math.nan]
    longer = [one.duration_s / one.straight_s for one in blocked if one.solved and one.duration_s is not None]
    return {
        "method": method,
        "solved": sum(one.solved for one in found.values()),
        "straight": sum(one.straight for one in found.values()),
        "invalid": sum(one.kept_m is not None and one.kept_m < KEPT_M[method] for one in found.values()),
        "entered": sum(one.entered for one in found.values()),
        "hurried": sum(one.hurried for one in found.values()),
        "unsolved": {seed: one.why for seed, one in found.items() if not one.solved},
        "seconds_median": float(np.median(seconds)),
        "seconds_p90": float(np.percentile(seconds, 90)),
        "longer_median": float(np.median(longer)) if longer else None,
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machine", default="rre20")
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="the first scene's seed")
    parser.add_argument("--method", action="append", choices=METHODS, help="only this one; may be repeated")
    parser.add_argument("--spacing-mm", type=float, default=5.0, help="of the dense search")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--journal", type=Path, help="file of results, to go on from")
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    if asked.scenes < 1 or asked.jobs < 1 or not 0.0 < asked.spacing_mm < math.inf:
        parser.error("--scenes, --jobs and --spacing-mm must be above 0")
    methods = tuple(method for method in METHODS if asked.method is None or method in asked.method)
    spacing_m, seeds = asked.spacing_mm / 1000.0, range(asked.first, asked.first + asked.scenes)
    journal = Journal(asked.journal, {method: fingerprint(asked.machine, method, spacing_m) for method in methods})
    tasks = [(asked.machine, seed, methods, spacing_m) for seed in seeds]
    results = measured(tasks, journal, asked.jobs, Console(file=sys.stderr))
    summaries = [summary(method, {seed: results[method, seed] for seed in seeds}) for method in methods]
    if asked.json:
        rows = [{"seed": seed} | {method: asdict(results[method, seed]) for method in methods} for seed in seeds]
        print(
            json.dumps({"machine": asked.machine, "scenes": len(seeds), "methods": summaries, "rows": rows}, indent=1)
        )
        return
    for one in summaries:
        print(
            f"{one['method']}: {one['solved']} of {len(seeds)} solved ({one['straight']} straight), "
            f"{one['invalid']} invalid, {one['entered']} entered, {one['hurried']} hurried, "
            f"{one['seconds_median']:.2f} s median, {one['seconds_p90']:.2f} s 90 %"
        )
        for seed, why in one["unsolved"].items():
            print(f"  {seed}: {why}")


if __name__ == "__main__":
    main()
