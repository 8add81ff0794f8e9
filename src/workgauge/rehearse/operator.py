"""The operator of a rehearsal: goes through the drive's steps and moves the levers as each one says."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.motion.job import Job, JobFacts, JobState
from workgauge.rehearse.auto_steps import GoTo, GradeSurface
from workgauge.rehearse.automatic import Automatic, AutoStep
from workgauge.rehearse.scenario import DriveBack, DriveLine, DriveOut, Hold, MoveLevers, Step, Swing, WaitForTravel
from workgauge.rehearse.targets import Targets
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import ScenarioError
from workgauge.values.measurements import DriveMode, Levers, ToolLine

#: Slower than this [m/s] the tool stands still for an operator's eye.
STILL_M_S = 0.003

#: The enable switch is pressed this long after the start [s], the levers being neutral: this opens the gate.
PRESSED_S = 0.05

#: A step that waits for the tool to stop gives it this long to start [s].
STARTING_S = 0.4

#: On the way back the lever is eased over the last of the line [m], down to the place itself [m].
EASE_M, THERE_M = 0.10, 0.001

#: The way an automatic step came is remembered so often [s], to go back on where it is stuck.
CAME_EVERY_S = 0.2

#: A swing is eased over this angle [rad] and ends within this one [rad].
SWING_EASE, SWING_THERE = 0.30, math.radians(0.3)

#: The lever is eased no farther than to this share of its deflection: less would fall into its dead zone.
LEAST_EASE = 0.35


def eased(deflection: float, left: float, over: float) -> float:
    """Return the lever for what is left of a way, `deflection` until the last stretch `over`."""
    return deflection * min(1.0, max(LEAST_EASE, left / over))


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What the operator sees: time since the run's start [s], joints, machine pose, tool point.

    `tool_speed`: over the machine; a tool that is carried along stands still [m/s].
    `ready`: whether the program knows where the machine is; until then the enable switch is left alone.
    `T_believed`: where simulated sensors have the machine, None where they are perfect or know nothing yet.
    `travelling`: whether the undercarriage still has a way to make. `job`: how far automatic motion is.
    """

    t_s: float
    q: Floats
    T_site_machine: Floats
    tool: Floats
    tool_speed: float
    ready: bool = True
    travelling: bool = False
    job: JobFacts | None = None
    T_believed: Floats | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Hands:
    """Where the hands are: what the levers mean, their positions, the line, the job, and the enable switch."""

    mode: DriveMode = DriveMode.JOINT
    levers: Levers = field(default_factory=Levers)
    line: ToolLine | None = None
    enable: bool = True
    job: Job | None = None


class Action(Protocol):
    """One step in progress."""

    words: str

    def hands(self, view: View) -> Hands | None:
        """Return the hands now, or None when the step is over."""
        ...


class _Timed:
    """Fixed hands for a time."""

    def __init__(self, words: str, view: View, for_s: float, hands: Hands) -> None:
        self.words = words
        self._end_s = view.t_s + for_s
        self._hands = hands

    def hands(self, view: View) -> Hands | None:
        return None if view.t_s >= self._end_s - 1e-9 else self._hands


class _Waiting:
    """Levers in the middle until the travel is over."""

    words = "wait for travel"

    def __init__(self, step: WaitForTravel, view: View) -> None:
        self._end_s = view.t_s + step.at_most_s

    def hands(self, view: View) -> Hands | None:
        return Hands() if view.travelling and view.t_s < self._end_s else None


class _Still:
    """Tells when the tool has stood still for a time."""

    def __init__(self, view: View, for_s: float) -> None:
        self._for_s = for_s
        self._since_s = view.t_s + STARTING_S

    def now(self, view: View) -> bool:
        if view.tool_speed > STILL_M_S:
            self._since_s = max(self._since_s, view.t_s)
        return view.t_s - self._since_s >= self._for_s


class _Swing:
    """Turn the cab, easing in, until the tool points at the target or cannot go on."""

    words = "swing"

    def __init__(self, step: Swing, view: View, machine: MachineModel, target: Floats) -> None:
        lever = machine.levers[0]
        if lever is None:
            raise ScenarioError(
                "the machine's first joint has no lever to swing with", element="drive", value=step.do
            )
        self._lever, self._sign = lever, float(machine.lever_signs[0])
        self._deflection = step.lever
        self._end_s = view.t_s + step.at_most_s
        self._still = _Still(view, 0.5)
        self._machine = machine
        error = self._error(view, target)
        q = float(view.q[0])
        if not machine.q_min[0] <= q + error <= machine.q_max[0]:
            error -= math.copysign(2 * math.pi, error)  # the long way round is the only one
        self._goal = q + error

    def _error(self, view: View, target: Floats) -> float:
        """Return by how much the tool's bearing must turn, seen from the swing axis [rad], in (-pi, pi]."""
        R, origin = view.T_site_machine[:3, :3], view.T_site_machine[:3, 3]
        tool, aim = R.T @ (view.tool - origin), R.T @ (target - origin)
        turn = math.atan2(aim[1], aim[0]) - math.atan2(tool[1], tool[0])
        return math.atan2(math.sin(turn), math.cos(turn))

    def hands(self, view: View) -> Hands | None:
        left = self._goal - float(view.q[0])
        if abs(left) <= SWING_THERE or view.t_s >= self._end_s or self._still.now(view):
            return None
        position = self._sign * math.copysign(eased(self._deflection, abs(left), SWING_EASE), left)
        return Hands(DriveMode.JOINT, Levers(**{self._lever: position}))


class _Line:
    """Drive the tool straight at a target."""

    words = "towards the limit"

    def __init__(self, step: DriveLine, view: View, target: Floats) -> None:
        away = target - view.tool
        length = float(np.linalg.norm(away))
        if length < 1e-6:
            raise ScenarioError("the tool already stands on its target", element="drive", value=step.do)
        self.line = ToolLine(frozen(view.tool), frozen(away / length))
        self._length = length
        self._hands = Hands(DriveMode.LINE, Levers(right_y=step.lever), self.line)
        self._end_s = view.t_s + (step.at_most_s if step.for_s is None else step.for_s)
        self._still = None if step.stopped_for_s is None else _Still(view, step.stopped_for_s)

    def hands(self, view: View) -> Hands | None:
        along = float((view.tool - self.line.start_site) @ self.line.direction_site)
        over = view.t_s >= self._end_s - 1e-9 or (self._still is not None and self._still.now(view))
        return None if over or along >= self._length - THERE_M else self._hands


class _Back:
    """Drive the tool back along a line to its start, easing in."""

    words = "back"

    def __init__(self, step: DriveBack, view: View, line: ToolLine) -> None:
        self._line = line
        self._deflection = step.lever
        self._end_s = view.t_s + step.at_most_s
        self._still = _Still(view, 1.0)

    def hands(self, view: View) -> Hands | None:
        left = float((view.tool - self._line.start_site) @ self._line.direction_site)
        if left <= THERE_M or view.t_s >= self._end_s or self._still.now(view):
            return None
        return Hands(DriveMode.LINE, Levers(right_y=-eased(self._deflection, left, EASE_M)), self._line)


class _Automatic:
    """Let the program do the jobs of a step, one after the other; where it is stuck, look for a way round once."""

    def __init__(self, step: AutoStep, view: View, automatic: Automatic, say: Callable[[str], None]) -> None:
        self._say = say
        self.words = {"go_to": "go to"}.get(step.do, step.do)
        self._step, self._automatic = step, automatic
        self._jobs = self._begun(view)
        self._end_s = view.t_s + step.at_most_s
        self._levers = Levers(right_y=step.pace)
        self._planned = not (isinstance(step, GoTo) and step.plan)
        self._came: list[Floats] = []
        self._next_s = view.t_s

    def hands(self, view: View) -> Hands | None:
        facts = view.job
        if view.t_s >= self._next_s:
            self._came.append(view.q)
            self._next_s += CAME_EVERY_S
        if self._jobs and facts is not None and facts.job == self._jobs[0].id:
            if facts.state is JobState.DONE:
                self._jobs.pop(0)
            elif facts.state is JobState.STUCK:
                self._jobs = self._round(view)
        if not self._jobs or view.t_s >= self._end_s:
            return None
        return Hands(DriveMode.AUTO, self._levers, job=self._jobs[0])

    def _begun(self, view: View) -> list[Job]:
        """Return the jobs of the step from where the machine stands now; none if it cannot be done from here."""
        # a surface lies where the site has it: what is believed of the machine's place is an error of the edge's
        believed = view.T_believed if isinstance(self._step, GradeSurface) else None
        T = view.T_site_machine if believed is None else believed
        try:
            return list(self._automatic.begun(self._step, view.q, T).jobs)
        except ScenarioError as error:
            self._say(f"cannot be done from where the machine stands by then, left out: {error}")
            return []

    def _round(self, view: View) -> list[Job]:
        """Return the jobs of a way round, none if there is none or it has been tried."""
        if self._planned or not isinstance(self._step, GoTo):
            return []
        self._planned = True
        found = self._automatic.around_it(self._step, np.array([*self._came, view.q]), view.T_site_machine)
        if isinstance(found, str):
            self._say(f"no way round was found: {found}")
            return []
        return list(found.jobs)


class Operator:
    """Goes through the steps of a drive, one after the other.

    Args:
        steps: the drive. machine: the machine driven. targets: what the steps are aimed at.
        automatic: turns automatic steps into jobs.
    """

    def __init__(self, steps: Sequence[Step], machine: MachineModel, targets: Targets, automatic: Automatic) -> None:
        self._steps = tuple(steps)
        self._machine = machine
        self._targets = targets
        self._automatic = automatic
        self._next = 0
        self._action: Action | None = None
        self._line: ToolLine | None = None
        self._pressing = False
        self.begun: list[tuple[str, float]] = []
        self.notes: list[str] = []  # what there is to say of automatic steps that could not be done

    @property
    def step(self) -> int:
        """Index of the step in progress."""
        return self._next - 1

    @property
    def line(self) -> ToolLine | None:
        """The last straight line driven."""
        return self._line

    def hands(self, view: View) -> Hands | None:
        """Return where the hands are now, or None when the drive is over."""
        while True:
            if self._action is not None:
                hands = self._action.hands(view)
                if hands is not None:
                    return hands if self._pressed(view) else replace(hands, enable=False)
            if self._next == len(self._steps):
                return None
            self._action = self._begin(self._steps[self._next], view)
            self._next += 1
            self.begun.append((self._action.words, view.t_s))

    def _pressed(self, view: View) -> bool:
        """Return whether the enable switch is pressed: once the position is known, and from then on."""
        if not self._pressing and view.ready and view.t_s >= PRESSED_S:
            self._pressing = True
        return self._pressing

    def _begin(self, step: Step, view: View) -> Action:
        if isinstance(step, Hold):
            return _Timed("hold", view, step.for_s, Hands())
        if isinstance(step, MoveLevers):
            return _Timed("levers", view, step.for_s, Hands(DriveMode.JOINT, Levers(**step.levers)))
        if isinstance(step, DriveOut):
            return _Timed("way out", view, step.for_s, Hands(DriveMode.EXIT, Levers(right_y=step.lever)))
        if isinstance(step, WaitForTravel):
            return _Waiting(step, view)
        if isinstance(step, AutoStep):
            number = self._next + 1
            return _Automatic(step, view, self._automatic, lambda said: self.notes.append(f"step {number}: {said}"))
        if isinstance(step, DriveBack):
            assert self._line is not None, "a scenario has no `back` without a line before it"
            return _Back(step, view, self._line)
        target = self._targets.point(step.target, view.T_site_machine, view.tool)
        if isinstance(step, Swing):
            return _Swing(step, view, self._machine, target)
        line = _Line(step, view, target)
        self._line = line.line
        return line
