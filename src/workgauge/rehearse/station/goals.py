"""Goals for the tool: looked at ahead of time in another process, and run only as they were looked at."""

from dataclasses import dataclass

import numpy as np

from workgauge.motion.ik.task import orientation_of
from workgauge.motion.job import Job, JobFacts, JobState
from workgauge.rehearse.session import Session
from workgauge.rehearse.station.telling import guard_settings, pose_of, rows
from workgauge.values.arrays import frozen
from workgauge.values.errors import WireError
from workgauge.values.mail import Letter
from workgauge.values.measurements import Stamp
from workgauge.values.station import Foreseen, PreviewResult, PreviewTask
from workgauge.values.tasks import Orientation, ToolGoal
from workgauge.wire.station import decode_station

#: A preview is of this posture: no joint may have moved by more since [rad, m].
MOVED = 0.02
#: A goal's tolerance [m, rad].
THERE_M, THERE_RAD = 0.02, 0.02
#: No goal is farther from the machine [m].
FAR_M = 50.0


def goal_job(session: Session, name: str, goal: tuple[float, ...], full: bool) -> Job:
    """Return the job of a goal: closed-loop, round what blocks it."""
    orientation = orientation_of(session.machine) if full else Orientation.FREE
    return Job(
        name,
        goal=ToolGoal(frozen(pose_of(goal)), orientation),
        tolerance_m=THERE_M,
        tolerance_rad=THERE_RAD,
    )


@dataclass(frozen=True, slots=True)
class _World:
    """What a preview takes for granted beside the posture."""

    off_states: tuple[str, ...]
    let_off: tuple[str, ...]
    guard: str
    settings: tuple[tuple[str, float], ...]
    pose: tuple[float, ...]


def _world(session: Session) -> _World:
    return _World(
        off_states=tuple(sorted(session.off_states)),
        let_off=tuple(sorted(session.let_off)),
        guard=session.guard.name,
        settings=guard_settings(session.guard),
        pose=rows(session.true_state[1]),
    )


class Goals:
    """The goal of a session that is looked at, or run."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._task: PreviewTask | None = None
        self._world: _World | None = None
        self._found: Foreseen | None = None
        self.job: Job | None = None

    @property
    def preview_id(self) -> str:
        """Id of the last preview asked for, empty for none."""
        return "" if self._task is None else self._task.id

    @property
    def working(self) -> bool:
        """Whether a preview is being worked on."""
        return self._task is not None and self._found is None

    @property
    def running(self) -> str:
        """Id of what runs, empty for nothing."""
        return "" if self.job is None else self.job.id

    def wrong(self, numbers: tuple[float, ...]) -> str:
        """Return why numbers are no goal, empty if they are."""
        if len(numbers) != 12:
            return "a goal is twelve numbers, the upper rows of a pose"
        T = pose_of(numbers)
        R = T[:3, :3]
        if not np.abs(R).max() < 2.0 or np.abs(R.T @ R - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0.0:
            return "the goal's orientation is no rotation"
        if not np.linalg.norm(T[:3, 3] - self._session.true_state[1][:3, 3]) < FAR_M:
            return f"the goal is farther than {FAR_M:g} m"
        return ""

    def ask(self, stamp: Stamp, name: str, numbers: tuple[float, ...], full: bool) -> PreviewTask:
        """Return what is to be looked at; an earlier preview is forgotten."""
        session = self._session
        world = _world(session)
        self._task = PreviewTask(
            *(stamp, name, numbers, full, tuple(session.true_state[0].tolist()), world.pose),
            *(world.off_states, world.let_off, world.guard, world.settings),
        )
        self._world, self._found, self.job = world, None, None
        return self._task

    def found(self, letter: Letter) -> None:
        """Take in what a preview came to; what is none, or of another, does not count."""
        try:
            value = decode_station(letter.data, letter.received_ns).value
        except WireError:
            return
        if isinstance(value, PreviewResult) and self._task is not None and value.found.id == self._task.id:
            self._found = value.found

    def run(self, name: str) -> str:
        """Begin a goal that was looked at; return why not, empty if it is begun."""
        task, found, session = self._task, self._found, self._session
        if task is None or task.id != name or found is None:
            return "this goal has not been looked at"
        if not found.ready or found.goal != task.goal:
            return "this goal is not reached: " + found.text
        if np.abs(session.true_state[0] - np.array(task.q)).max() > MOVED:
            return "the machine has moved since: look at it again"
        if _world(session) != self._world:
            return "limits or guard have changed since: look at it again"
        self.job = goal_job(session, name, task.goal, task.full)
        return ""

    def cancel(self) -> None:
        """Forget the goal, looked at or run."""
        self._task = self._found = self.job = None

    def went(self, facts: JobFacts, reasons: list[str]) -> str:
        """Take in how far what runs is; return what is to be said, empty for nothing."""
        if self.job is None or facts.job != self.job.id:
            return ""
        if facts.state is JobState.DONE:
            self.cancel()
            return "the tool has reached its goal"
        if facts.state is JobState.STUCK:
            self.cancel()
            return f"the tool goes no further: {reasons[0] if reasons else 'no reason given'}"
        return ""
