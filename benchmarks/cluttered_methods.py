"""What is made of a cluttered scene: by a global plan, by going for the goal, by one after the other."""

import itertools
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from workgauge.guard.barrier import BarrierGuard
from workgauge.loop.config import search_radius_m, tick_config
from workgauge.machine.model import MachineModel
from workgauge.motion.ik.task import orientation_of
from workgauge.motion.job import Job
from workgauge.motion.looking_ahead import Surroundings
from workgauge.motion.plan.global_plan import LOOKS, GlobalPlan, NoPlan, NoPlanReason, plan_global
from workgauge.motion.plan.rounding import roundable
from workgauge.motion.plan.shortening import duration_s
from workgauge.motion.planning import Pace, plan_waypoints
from workgauge.motion.way_round import way_round
from workgauge.rehearse.cluttered import Cluttered
from workgauge.rehearse.joints import moving
from workgauge.rehearse.preview import LONGEST_S, Preview, preview
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
            None if nothing came within sight.
        straight: whether it is the straight joint line. entered: whether a driven machine was inside anything.
        hurried: whether the clock ended the planning. straight_s: how long the straight joint line takes.
    """

    solved: bool
    why: str
    seconds: float
    duration_s: float | None = None
    kept_m: float | None = None
    straight: bool = False
    entered: bool = False
    hurried: bool = False
    straight_s: float = math.nan


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
        hurried = plan.reason is NoPlanReason.NOT_FOUND and plan.looks < LOOKS
        return Outcome(False, plan.why, seconds, hurried=hurried, straight_s=straight_s(task))
    kept = seen(least_surplus(task, plan.waypoints, spacing_m))
    straight = len(plan.waypoints) <= 1 + max(1, len(task.scene.machine.exclusive_groups)) and plan.looks < 200
    return Outcome(
        *(True, "", seconds, plan.duration_s, kept, straight), hurried=plan.hurried, straight_s=straight_s(task)
    )


def seen(least_m: float) -> float | None:
    """Return the least clearance found, None if there was none."""
    return least_m if math.isfinite(least_m) else None


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

    def drive(self, jobs: Sequence[Job], at_most_s: float = LONGEST_S) -> Preview:
        """Drive jobs from where the machine is."""
        task, before = self._task, self.seen
        if before is None:
            now = preview(
                self._config, task.scene, self._q, task.T_site_machine, jobs, self._joints, at_most_s=at_most_s
            )
        else:
            after = before.after
            now = preview(
                *(self._config, task.scene, after.q, task.T_site_machine, jobs, after.joints),
                now_ns=after.now_ns,
                memory=after.memory,
                at_most_s=at_most_s,
            )
        self.seen = now if before is None else before.then(now)
        return now

    def outcome(self, solved: bool, why: str, seconds: float) -> Outcome:
        """Return what came of it, in so many seconds of the processor."""
        assert self.seen is not None
        least = least_at(self._task, self.seen.q)
        entered = min((one.clearance_m for one in self.seen.least.values()), default=math.inf) < 0.0
        duration_s, line_s = self.seen.duration_s, straight_s(self._task)
        return Outcome(solved, why, seconds, duration_s, seen(least), entered=entered, straight_s=line_s)


class Local:
    """Goes for a scene's goal, round what blocks it, and then, if asked, by a global plan from where that ended.

    The first part is driven once, whichever of the two is asked for, and counts in the seconds of both.
    """

    def __init__(self, task: Cluttered) -> None:
        self._task, self._driver = task, Driver(task)
        began = time.process_time()
        self._done = self._driver.drive([going(task)])
        self._seconds = time.process_time() - began

    def alone(self) -> Outcome:
        """Return what going for the goal makes of the scene."""
        return self._driver.outcome(self._done.completed, self._done.why, self._seconds)

    def then_planned(self) -> Outcome:
        """Return what that makes of the scene, and a global plan from where it came no nearer; asked for last."""
        if self._done.completed:
            return self.alone()
        task, driver, began = self._task, self._driver, time.process_time() - self._seconds
        machine = task.scene.machine
        around = Surroundings(task.scene, task.T_site_machine, STOP_DISTANCE_M)
        plan = way_round(
            *(around, machine, driver.came, task.q_goal[None]),
            clearance_m=CLEARANCE_M,
            seed=task.seed,
            seconds=SECONDS,
        )
        if isinstance(plan, NoPlan):
            return driver.outcome(False, plan.why, time.process_time() - began)
        motions = plan_waypoints(machine, plan, Pace(), words="way round", kept=roundable(around, CLEARANCE_M))
        jobs = [
            Job(f"{motion.words} {i}", trajectory=motion.trajectory, on_path=False, **THERE)
            for i, motion in enumerate(motions)
        ]
        done = driver.drive(jobs)
        return driver.outcome(done.completed, done.why, time.process_time() - began)


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


def outcomes(task: Cluttered, methods: Sequence[str], spacing_m: float) -> Iterator[tuple[str, Outcome]]:
    """Yield what each of some methods makes of a scene, as soon as it is known."""
    if PLANNED in methods:
        yield PLANNED, planned(task, spacing_m)
    if LOCAL in methods or BOTH in methods:
        driven = Local(task)
        if LOCAL in methods:
            yield LOCAL, driven.alone()
        if BOTH in methods:
            yield BOTH, driven.then_planned()


def warmed(task: Cluttered) -> None:
    """Have everything loaded and compiled that the methods use, so that no scene's seconds count it."""
    planned(task, 1.0)
    machine = task.scene.machine
    turned = task.q_start + 1e-3 * (np.arange(machine.n) == 0)
    (motion,) = plan_waypoints(machine, np.array([task.q_start, turned]), Pace(), words="warm")
    for job in (going(task), Job("warm", trajectory=motion.trajectory)):
        Driver(task).drive([job], at_most_s=1.0)


PLANNED, LOCAL, BOTH = METHODS = ("global plan", "local", "local, then plan")
#: What each method promises to keep above every stop distance [m].
KEPT_M = {PLANNED: CLEARANCE_M, LOCAL: -1e-4, BOTH: -1e-4}
#: Grows with what a method does, so that an old journal of it is not believed.
VERSIONS = {PLANNED: 2, LOCAL: 1, BOTH: 3}
