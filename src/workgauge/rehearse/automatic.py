"""Automatic steps of a drive: planned and looked at before anything moves, and planned anew where they are stuck."""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from workgauge.geodesy.frame import SiteFrame
from workgauge.machine.model import MachineModel
from workgauge.motion.ik.closed_form import closed_form
from workgauge.motion.ik.task import orientation_of
from workgauge.motion.job import Job
from workgauge.motion.looking_ahead import Ahead, Surroundings, looked_ahead
from workgauge.motion.paths.tool_path import ToolPath
from workgauge.motion.plan.global_plan import NoPlan
from workgauge.motion.plan.rounding import roundable
from workgauge.motion.planning import (
    Motion,
    Pace,
    holdable,
    plan_goal,
    plan_joints,
    plan_path,
    plan_waypoints,
    reaching,
)
from workgauge.motion.way_round import way_round
from workgauge.rehearse.auto_steps import FollowPath, GoTo, GradeSurface, PathPoint
from workgauge.rehearse.grading import Grading
from workgauge.rehearse.scenario import Step
from workgauge.site.model import SiteModel
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import InputError, ScenarioError
from workgauge.values.tasks import Orientation, ToolGoal
from workgauge.values.transforms import inverse, rpy

#: A plan through joint space keeps this above every stop distance [m].
PLAN_KEEPS_M = 0.05
#: And is looked for so long [s].
PLAN_SECONDS = 30.0

#: So far the tool may be off its trajectory where nothing pushes it [m].
LAG_M = 0.15

AutoStep = GoTo | FollowPath | GradeSurface


@dataclass(frozen=True, slots=True, eq=False)
class Planned:
    """What one step comes to.

    Attributes:
        jobs: one after the other. q_end: (n,) the posture they end in. notes: for people.
    """

    jobs: tuple[Job, ...]
    q_end: Floats
    notes: tuple[str, ...] = ()


@contextmanager
def in_step(number: int) -> Iterator[None]:
    """Let a complaint say which step of the drive, counted from 1, it is about."""
    try:
        yield
    except ScenarioError as error:
        where = f"drive, step {number}" + (f": {error.element}" if error.element else "")
        raise ScenarioError(error.message, element=where, value=error.value, allowed=error.allowed) from error


class Automatic:
    """Turns automatic steps into jobs.

    Args:
        machine: whose. frame: the site's local frame. around: returns what stands around now.
        names: limit id to what a person calls it. site: whose surfaces are worked on, None for no such steps.
    """

    def __init__(
        self,
        machine: MachineModel,
        frame: SiteFrame,
        around: Callable[[], Surroundings],
        names: Mapping[str, str] | None = None,
        site: SiteModel | None = None,
    ) -> None:
        self._machine, self._frame, self._around = machine, frame, around
        self._grading = None if site is None else Grading(site, frame.origin)
        self._names = names or {}
        self._form = closed_form(machine)
        self._count = itertools.count(1)

    def planned(self, steps: Iterable[Step], q: Floats, T_site_machine: Floats) -> dict[int, Planned]:
        """Return what every automatic step comes to, begun where the one before it ends, by its number from 1.

        Raises:
            ScenarioError: for the first step that cannot be done, with where and why.
        """
        found: dict[int, Planned] = {}
        for number, step in enumerate(steps, 1):
            if isinstance(step, AutoStep):
                with in_step(number):
                    found[number] = self.begun(step, q, T_site_machine)
                q = found[number].q_end
        return found

    def checked(self, steps: Iterable[Step], q: Floats, T_site_machine: Floats) -> tuple[str, ...]:
        """Return what is to be said of the automatic steps beforehand.

        Raises:
            ScenarioError: as `planned`.
        """
        found = self.planned(steps, q, T_site_machine)
        return tuple(f"step {number}: {note}" for number, planned in found.items() for note in planned.notes)

    def begun(self, step: AutoStep, q: Floats, T_site_machine: Floats) -> Planned:
        """Return the jobs of a step that begins at posture q (n,).

        Raises:
            ScenarioError: if it cannot be done.
        """
        try:
            if isinstance(step, FollowPath):
                return self._path(step, q, T_site_machine)
            if isinstance(step, GradeSurface):
                return self._graded(step, q, T_site_machine)
            return self._goal(step, q, T_site_machine)
        except ScenarioError:
            raise
        except InputError as error:
            raise ScenarioError(
                error.message, element=error.element, value=error.value, allowed=error.allowed
            ) from error

    def around_it(self, step: GoTo, came: Floats, T_site_machine: Floats) -> Planned | str:
        """Return the jobs of a way through joint space to a goal, from where it is stuck, or why there is none.

        Args:
            came: (m, n) postures it came by, the present one last.
        """
        try:
            return self._round(step, came, T_site_machine)
        except InputError as error:  # a planner that is not installed, a way that cannot be timed
            return str(error)

    def _round(self, step: GoTo, came: Floats, T_site_machine: Floats) -> Planned | str:
        goal = self._pose(step.goal, step, T_site_machine)
        orientation = self._counts(step, step.goal.rpy_deg is not None)
        near = reaching(self._machine, self._form, inverse(T_site_machine) @ goal, orientation, came[-1])
        if isinstance(near, str):
            return near
        found = self._through(came, np.array(near))
        if isinstance(found, NoPlan):
            return found.why
        motions = self._driven(found, step, "way round")
        return Planned(self._jobs(motions, step), found[-1])

    def _path(self, step: FollowPath, q: Floats, T_site_machine: Floats) -> Planned:
        poses = [self._pose(point, step, T_site_machine) for point in step.points]
        turned = step.points[0].rpy_deg is not None
        orientation = self._counts(step, turned)
        if step.repeat > 1:
            poses = [*poses, *(pose for _ in range(step.repeat - 1) for pose in poses[1:])]
        places = np.array([pose[:3, 3] for pose in poses])
        turns = np.array([pose[:3, :3] for pose in poses]) if turned else None
        if step.kind == "spline":
            path = ToolPath.spline(places, turns, orientation=orientation)
        else:
            path = ToolPath.polyline(places, turns, orientation=orientation, blend_m=step.blend_mm * 1e-3)
        in_all = f"{path.length_m:.1f} m at {step.speed_m_s:g} m/s"
        _in_time(path.length_m / step.speed_m_s, step, "path", "points", in_all, "fewer repeats")
        *approach, along = plan_path(self._machine, T_site_machine, q, path, _pace(step))
        start = along.trajectory.q[0]
        notes: list[str] = []
        if approach:
            approach = self._clear_way(q, start, approach, step, T_site_machine)
        seen = self._seen([along])
        notes += self._refused(seen, step.deviation_m, "path")
        jobs = self._jobs(approach, step) + self._jobs([along], step)
        return Planned(jobs, along.trajectory.q[-1], tuple(notes))

    def _graded(self, step: GradeSurface, q: Floats, T_site_machine: Floats) -> Planned:
        if self._grading is None:
            raise ScenarioError("there are no surfaces to work on", element="grade", allowed="a site with a surface")
        strokes, said = self._grading.strokes(step, self._machine, q, T_site_machine)
        notes, jobs = list(said), []
        for stroke in strokes:
            approach, work = list(stroke.motions[: stroke.cut - 1]), stroke.motions[stroke.cut - 1 :]
            begin = work[0].trajectory.q[0]
            if approach:
                approach = self._clear_way(q, begin, approach, step, T_site_machine)
            notes += self._refused(self._seen(work), step.deviation_m, work[1].words)
            jobs += [*self._jobs(approach, step), *self._jobs(work, step)]
            q = stroke.q_end
        in_all = f"{len(strokes)} {'cut' if len(strokes) == 1 else 'cuts'}"
        least_s = sum(job.trajectory.duration_s for job in jobs if job.trajectory is not None)
        _in_time(least_s, step, "work", "grade", in_all, "less of it in one step")
        return Planned(tuple(jobs), q, tuple(dict.fromkeys(notes)))

    def _goal(self, step: GoTo, q: Floats, T_site_machine: Floats) -> Planned:
        pose = self._pose(step.goal, step, T_site_machine)
        orientation = self._counts(step, step.goal.rpy_deg is not None)
        goal = ToolGoal(frozen(pose), orientation)
        machine = self._machine
        near = reaching(machine, self._form, inverse(T_site_machine) @ pose, orientation, q)
        if isinstance(near, str):
            raise ScenarioError("the goal cannot be reached", element="goal", value=near)
        free = [one for one in near if not self._inside(one)]
        if not free:
            worst = self._inside(near[0])
            assert worst is not None
            raise ScenarioError("the goal lies inside a limit", element="goal", value=self._words(worst))
        if step.by == "line":
            motions = plan_goal(machine, T_site_machine, q, goal, _pace(step))
        elif step.by == "joints":
            motions = plan_joints(machine, q, free[0], _pace(step), words="goal")
        else:
            return Planned((self._loop(goal, step),), free[0])
        if not motions:
            return Planned((), q, ("the tool is at its goal already",))
        if self._seen(motions).worst_m >= 0.0 and not self._inside(motions[-1].trajectory.q[-1]):
            return Planned(self._jobs(motions, step), motions[-1].trajectory.q[-1])
        note = f"the straight way is not free ({self._words(self._seen(motions))}): the tool will look for its way"
        return Planned((self._loop(goal, step),), free[0], (note,))

    def _clear_way(
        self,
        q: Floats,
        start: Floats,
        approach: list[Motion],
        step: FollowPath | GradeSurface,
        T_site_machine: Floats,
    ) -> list[Motion]:
        """Return the way to a path's beginning, through joint space if the straight one is not free."""
        if self._inside(start) and step.deviation_m <= 0.0:
            raise ScenarioError(
                "the path's first point lies inside a limit", element="points", value=self._words(self._at(start))
            )
        if self._inside(start) or self._seen(approach).worst_m >= 0.0:
            return approach
        found = self._through(q[None], start[None])
        if isinstance(found, NoPlan):
            raise ScenarioError("no way to the path's first point was found", element="points", value=found.why)
        return self._driven(found, step, "to the path")

    def _through(self, came: Floats, goals: Floats) -> Floats | NoPlan:
        return way_round(
            *(self._around(), self._machine, came, goals), clearance_m=PLAN_KEEPS_M, seconds=PLAN_SECONDS
        )

    def _driven(self, waypoints: Floats, step: AutoStep, words: str) -> list[Motion]:
        """Return the motions along a plan, corners rounded where that is proven to keep what the plan does."""
        kept = roundable(self._around(), PLAN_KEEPS_M)
        return plan_waypoints(self._machine, waypoints, _pace(step), words=words, kept=kept)

    def _refused(self, seen: Ahead, deviation_m: float, words: str) -> list[str]:
        """Return what is said of a way into limits; refuse one that goes in farther than it may give way."""
        if seen.worst_m >= 0.0:
            return []
        if -seen.worst_m > deviation_m:
            raise ScenarioError(
                f"the {words} goes through a limit",
                element="points",
                value=self._words(seen),
                allowed=f"deviation_m of at least {-seen.worst_m:.2f}, and the tool gives way so far",
            )
        return [f"the {words} as designed goes through a limit ({self._words(seen)}): the tool will give way"]

    def _seen(self, motions: Sequence[Motion]) -> Ahead:
        return looked_ahead(self._around(), [motion.trajectory for motion in motions])

    def _at(self, q: Floats) -> Ahead:
        return looked_ahead(self._around(), [], [q])

    def _inside(self, q: Floats) -> Ahead | None:
        """Return what a posture is too near to, None if nothing."""
        seen = self._at(q)
        return seen if seen.worst_m < 0.0 else None

    def _words(self, seen: Ahead) -> str:
        """Return where a way comes nearest, in words."""
        name = self._names.get(seen.limit or "", seen.limit or "")
        name = f"its own {name.removeprefix('self:')}" if name.startswith("self:") else name
        depth = f"{-seen.distance_m:.2f} m inside" if seen.distance_m < 0.0 else f"{seen.distance_m:.2f} m from"
        where = "" if math.isnan(seen.at) else f" after {seen.at:.1f} s"
        return f"{seen.link} {depth} {name}{where}, {seen.stop_m:.2f} m to be kept"

    def _pose(self, point: PathPoint, step: GoTo | FollowPath, T_site_machine: Floats) -> Floats:
        """Return the tool pose (4, 4) of a point in the site's local frame."""
        T = np.eye(4) if point.rpy_deg is None else np.array(rpy(*np.radians(point.rpy_deg).tolist()))
        T[:3, 3] = point.at_m
        if step.frame == "machine":
            return np.asarray(T_site_machine @ T)
        T[:3, 3] = self._frame.to_local(T[:3, 3])
        return T

    def _counts(self, step: GoTo | FollowPath, turned: bool) -> Orientation:
        """Return how much of a step's orientations counts."""
        if step.orientation is None:
            return orientation_of(self._machine) if turned else Orientation.FREE
        if step.orientation is not Orientation.FREE and not turned:
            raise ScenarioError(
                "an orientation needs rpy_deg",
                element="orientation",
                value=step.orientation.value,
                allowed="free, or rpy_deg beside at_m",
            )
        return holdable(self._machine, step.orientation, "step")

    def _jobs(self, motions: Sequence[Motion], step: AutoStep) -> tuple[Job, ...]:
        return tuple(
            Job(
                f"{motion.words} {next(self._count)}",
                trajectory=motion.trajectory,
                tolerance_m=step.tolerance_mm * 1e-3,
                tolerance_rad=math.radians(step.tolerance_deg),
                deviation_m=max(step.deviation_m, LAG_M),
                around=not isinstance(step, GradeSurface) and step.around,
                on_path=motion.path is not None,
            )
            for motion in motions
        )

    def _loop(self, goal: ToolGoal, step: GoTo) -> Job:
        turn = math.radians(step.turn_deg_s or 30.0)
        return Job(
            f"goal {next(self._count)}",
            goal=goal,
            tool_speed_m_s=step.speed_m_s,
            tool_turn_rad_s=turn,
            tolerance_m=step.tolerance_mm * 1e-3,
            tolerance_rad=math.radians(step.tolerance_deg),
            around=step.around,
        )


def _in_time(least_s: float, step: AutoStep, what: str, element: str, value: str, less: str) -> None:
    """Refuse beforehand what would be cut off half done by its step's time."""
    if least_s > step.at_most_s:
        raise ScenarioError(
            f"the {what} takes {least_s:.0f} s at least, longer than its step may",
            element=element,
            value=value,
            allowed=f"at_most_s of at least {math.ceil(least_s)}, a faster tool, or {less}",
        )


def _pace(step: AutoStep) -> Pace:
    return Pace(step.speed_m_s, None if step.turn_deg_s is None else math.radians(step.turn_deg_s), step.share)
