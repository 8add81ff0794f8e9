"""Random cluttered scenes: which are solved by a global plan, how long that takes, and whether it holds.

    python benchmarks/cluttered.py --json
    python benchmarks/cluttered.py --scenes 200 --machine brokk5

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
clearances below their stop distances by more than 0.1 mm.
"""

import argparse
import itertools
import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from workgauge.guard.barrier import BarrierGuard
from workgauge.loop.config import search_radius_m, tick_config
from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.motion.ik.task import orientation_of
from workgauge.motion.job import Job
from workgauge.motion.looking_ahead import Surroundings
from workgauge.motion.plan.global_plan import GlobalPlan, NoPlan, plan_global
from workgauge.motion.plan.shortening import duration_s
from workgauge.motion.planning import Pace, plan_waypoints
from workgauge.motion.way_round import way_round
from workgauge.rehearse.cluttered import Cluttered, cluttered
from workgauge.rehearse.joints import moving
from workgauge.rehearse.preview import Preview, preview
from workgauge.values.arrays import Floats
from workgauge.values.tasks import ToolGoal

STOP_DISTANCE_M, CLEARANCE_M, SECONDS = 0.2, 0.05, 60.0
TICK_S, TICK_RADIUS_M = 0.02, 7.0
#: How near to its goal a driven tool has to come.
THERE: dict[str, Any] = {"tolerance_m": 0.02, "tolerance_rad": math.radians(1.0)}
SIGNS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))


@dataclass(frozen=True)
class Outcome:
    """What a method made of a scene.

    Attributes:
        solved: whether the goal is reached. why: if not. seconds: of the processor. duration_s: of the motion.
        kept_m: least clearance above its stop distance on the way, of a way driven or planned, by a dense search.
        straight: whether it is the straight joint line. entered: whether a driven machine was inside anything.
    """

    solved: bool
    why: str
    seconds: float
    duration_s: float | None = None
    kept_m: float | None = None
    straight: bool = False
    entered: bool = False


#: A method takes a scene and the spacing of the dense search [m].
Method = Callable[[Cluttered, float], Outcome]


def planned(task: Cluttered, spacing_m: float) -> Outcome:
    """Return what the global plan makes of a scene."""
    began = time.process_time()
    plan = plan_global(
        *(task.scene, task.scene.machine, task.T_site_machine, task.q_start, task.q_goal),
        clearance_m=CLEARANCE_M,
        stop_distance_m=STOP_DISTANCE_M,
        seed=task.seed,
        seconds=SECONDS,
    )
    seconds = time.process_time() - began
    if not isinstance(plan, GlobalPlan):
        return Outcome(False, plan.why, seconds)
    kept = least_surplus(task, plan.waypoints, spacing_m)
    straight = len(plan.waypoints) <= 1 + max(1, len(task.scene.machine.exclusive_groups))
    return Outcome(True, "", seconds, plan.duration_s, kept, straight and plan.looks < 200)


def least_surplus(task: Cluttered, lines: Floats, spacing_m: float) -> float:
    """Return the least clearance above its stop distance along straight joint lines, closely looked at [m]."""
    machine, least = task.scene.machine, math.inf
    for a, b in itertools.pairwise(lines):
        count = 2
        while True:
            postures = a + np.linspace(0.0, 1.0, count)[:, None] * (b - a)
            step = np.linalg.norm(np.diff([corners(machine, q) for q in postures], axis=0), axis=-1).max()
            if step <= spacing_m:
                break
            count = 1 + math.ceil(1.05 * (count - 1) * step / spacing_m)
        for q in postures:
            found = task.scene.query(machine.forward(q), task.T_site_machine, STOP_DISTANCE_M + 2.0 * CLEARANCE_M)
            stops = np.where(np.isnan(found.stop_distances), STOP_DISTANCE_M, found.stop_distances)
            least = min(least, float((found.distances - stops).min(initial=math.inf)))
    return least


def corners(machine: MachineModel, q: Floats) -> Floats:
    """Return the corners (S, 8, 3) of the machine's boxes, machine frame [m]."""
    poses, halves = machine.solid_poses(machine.forward(q))
    placed: Floats = SIGNS * halves[:, None, :] @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3]
    return placed


def straight_s(task: Cluttered) -> float:
    """Return how long the straight joint line to the goal takes, whatever is in the way."""
    machine = task.scene.machine
    turns = np.round((task.q_start - task.q_goal) / (2.0 * np.pi))
    return duration_s(machine, [task.q_start, task.q_goal + np.where(machine.continuous, 2.0 * np.pi * turns, 0.0)])


def summary(name: str, tasks: Sequence[Cluttered], outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return what a method made of all scenes."""
    hard = [outcome.seconds for outcome in outcomes if not outcome.straight] or [math.nan]
    longer = [
        outcome.duration_s / straight_s(task)
        for task, outcome in zip(tasks, outcomes, strict=True)
        if outcome.duration_s is not None and not outcome.straight
    ]
    return {
        "method": name,
        "solved": sum(outcome.solved for outcome in outcomes),
        "straight": sum(outcome.straight for outcome in outcomes),
        "invalid": sum(outcome.kept_m is not None and outcome.kept_m < KEPT_M[name] for outcome in outcomes),
        "entered": sum(outcome.entered for outcome in outcomes),
        "unsolved": {task.seed: one.why for task, one in zip(tasks, outcomes, strict=True) if not one.solved},
        "seconds_median": float(np.median(hard)),
        "seconds_p90": float(np.percentile(hard, 90)),
        "longer_median": float(np.median(longer)) if longer else None,
    }


def measure(
    machine: MachineModel, seeds: Sequence[int], methods: dict[str, Method], spacing_m: float
) -> dict[str, Any]:
    """Return what each method makes of the scenes of the seeds."""
    warm = cluttered(machine, 0, stop_distance_m=STOP_DISTANCE_M)
    for method in methods.values():
        method(warm, 1.0)
    tasks = [cluttered(machine, seed, stop_distance_m=STOP_DISTANCE_M) for seed in seeds]
    outcomes = {name: [method(task, spacing_m) for task in tasks] for name, method in methods.items()}
    rows = [
        {"seed": task.seed} | {name: asdict(outcomes[name][i]) for name in methods} for i, task in enumerate(tasks)
    ]
    summaries = [summary(name, tasks, outcomes[name]) for name in methods]
    return {"machine": machine.name, "scenes": len(tasks), "methods": summaries, "rows": rows}


class Driver:
    """Drives jobs in a scene by the real tick."""

    def __init__(self, task: Cluttered) -> None:
        machine = task.scene.machine
        guard = BarrierGuard(stop_distance_m=STOP_DISTANCE_M)
        moves = moving("hydraulic", machine)
        radius_m = search_radius_m(guard, task.scene.limits)
        self._task, self._joints, self._q = task, moves.joints, task.q_start
        self._config = tick_config(
            *(machine, guard),
            machine_id=machine.name,
            dt_s=TICK_S,
            radius_m=max(radius_m, TICK_RADIUS_M),
            tool_sigma_m=0.0,
            drive=moves.drive,
        )
        self.seen: Preview | None = None

    @property
    def came(self) -> Floats:
        """The postures (k, n) it came by, five a second, the present one last."""
        assert self.seen is not None
        every: Floats = self.seen.q[::-10][::-1]
        return every

    def drive(self, jobs: Sequence[Job]) -> Preview:
        """Drive jobs from where the machine is."""
        task, before = self._task, self.seen
        if before is None:
            now = preview(self._config, task.scene, self._q, task.T_site_machine, jobs, self._joints)
        else:
            after = before.after
            now = preview(
                *(self._config, task.scene, after.q, task.T_site_machine, jobs, after.joints),
                now_ns=after.now_ns,
                memory=after.memory,
            )
        self.seen = now if before is None else before.then(now)
        return now

    def outcome(self, solved: bool, why: str, began: float) -> Outcome:
        """Return what came of it."""
        assert self.seen is not None
        seconds = time.process_time() - began
        least = least_at(self._task, self.seen.q)
        entered = min((one.clearance_m for one in self.seen.least.values()), default=math.inf) < 0.0
        return Outcome(solved, why, seconds, self.seen.duration_s, least, entered=entered)


def local(task: Cluttered, _: float) -> Outcome:
    """Return what going for the goal, round what blocks it, makes of a scene."""
    began, driver = time.process_time(), Driver(task)
    done = driver.drive([going(task)])
    return driver.outcome(done.completed, done.why, began)


def local_then_planned(task: Cluttered, _: float) -> Outcome:
    """Return what going for the goal makes of a scene, and a global plan from where that comes no nearer."""
    began, driver = time.process_time(), Driver(task)
    done = driver.drive([going(task)])
    if done.completed:
        return driver.outcome(True, "", began)
    machine = task.scene.machine
    plan = way_round(
        *(Surroundings(task.scene, task.T_site_machine, STOP_DISTANCE_M), machine, driver.came, task.q_goal[None]),
        clearance_m=CLEARANCE_M,
        seed=task.seed,
        seconds=SECONDS,
    )
    if isinstance(plan, NoPlan):
        return driver.outcome(False, plan.why, began)
    motions = plan_waypoints(machine, plan, Pace(), words="way round")
    jobs = [
        Job(f"{motion.words} {i}", trajectory=motion.trajectory, on_path=False, **THERE)
        for i, motion in enumerate(motions)
    ]
    done = driver.drive(jobs)
    return driver.outcome(done.completed, done.why, began)


def going(task: Cluttered) -> Job:
    """Return the job of bringing the tool to a scene's goal."""
    goal = ToolGoal(task.T_site_tool, orientation_of(task.scene.machine))
    return Job("goal", goal=goal, **THERE)


def least_at(task: Cluttered, postures: Floats) -> float:
    """Return the least clearance above its stop distance at postures (k, n) [m]."""
    machine, least = task.scene.machine, math.inf
    for q in postures:
        found = task.scene.query(machine.forward(q), task.T_site_machine, STOP_DISTANCE_M + 2.0 * CLEARANCE_M)
        stops = np.where(np.isnan(found.stop_distances), STOP_DISTANCE_M, found.stop_distances)
        least = min(least, float((found.distances - stops).min(initial=math.inf)))
    return least


METHODS: dict[str, Method] = {"global plan": planned, "local": local, "local, then plan": local_then_planned}
#: What each method promises to keep above every stop distance [m].
KEPT_M = {"global plan": CLEARANCE_M, "local": -1e-4, "local, then plan": -1e-4}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machine", default="rre20")
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="the first scene's seed")
    parser.add_argument("--method", action="append", choices=list(METHODS), help="only this one; may be repeated")
    parser.add_argument("--spacing-mm", type=float, default=5.0, help="of the dense search")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    seeds = range(given.first, given.first + given.scenes)
    methods = {name: METHODS[name] for name in given.method or METHODS}
    found = measure(load_machine(given.machine), seeds, methods, given.spacing_mm / 1000.0)
    if given.json:
        print(json.dumps(found, indent=1))
        return
    for one in found["methods"]:
        print(
            f"{one['method']}: {one['solved']} of {found['scenes']} solved ({one['straight']} straight), "
            f"{one['invalid']} invalid, {one['entered']} entered, "
            f"{one['seconds_median']:.2f} s median, {one['seconds_p90']:.2f} s 90 %"
        )
        for seed, why in one["unsolved"].items():
            print(f"  {seed}: {why}")


if __name__ == "__main__":
    main()
