"""What automatic motion is to do, what it remembers of it, and how far it is."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np

from workgauge.motion.paths.trajectory import Trajectory
from workgauge.motion.predict import InFlight
from workgauge.values.errors import InputError
from workgauge.values.tasks import ToolGoal

#: A goal farther than this is no place [m].
FAR = 1e6


class JobState(StrEnum):
    """How far a job is."""

    NONE = "none"  #: there is none, or nobody asks for it
    MOVING = "moving"  #: on its way
    HELD = "held"  #: limits hold it back, or bend its way
    STUCK = "stuck"  #: no nearer for a while; it stands
    DONE = "done"  #: there, within tolerance


@dataclass(frozen=True, slots=True, eq=False)
class Job:
    """One thing for automatic motion to do: reach a goal, or follow a trajectory. Exactly one of the two is given.

    Attributes:
        id: tells one job from another; a new one begins from its beginning.
        goal: for closed-loop inverse kinematics from wherever the tool is.
        trajectory: of the joints, over time.
        tool_speed_m_s, tool_turn_rad_s: highest speeds towards a goal, and back to a path.
        tolerance_m, tolerance_rad: the tool is there.
        lag_m: so far behind its trajectory the tool may fall; then that waits for it.
        deviation_m: so far limits may push it off its trajectory before that waits.
        around: whether to go round what blocks it.
        on_path: whether the trajectory's path variable is the tool's way in metres.
    """

    id: str
    goal: ToolGoal | None = None
    trajectory: Trajectory | None = None
    tool_speed_m_s: float = 0.5
    tool_turn_rad_s: float = 0.5
    tolerance_m: float = 0.01
    tolerance_rad: float = math.radians(0.5)
    lag_m: float = 0.15
    deviation_m: float = 0.15
    around: bool = True
    on_path: bool = True

    def __post_init__(self) -> None:
        if (self.goal is None) == (self.trajectory is None):
            raise InputError("a job is either a goal or a trajectory", element="job", value=self.id)
        for name in ("tool_speed_m_s", "tool_turn_rad_s", "tolerance_m", "tolerance_rad", "lag_m", "deviation_m"):
            value = getattr(self, name)
            if not 0.0 < value < 1e3:
                raise InputError("job value out of range", element=name, value=value, allowed="above 0, below 1000")

    def wrong(self, joints: int) -> str | None:
        """Return why a machine of so many joints cannot be given this job, or None."""
        if self.goal is not None:
            T = np.asarray(self.goal.T_site_tool)
            if T.shape != (4, 4) or not (np.abs(T) < FAR).all():
                return f"{self.id}: the goal is not a pose"
            R = T[:3, :3]
            if np.abs(R.T @ R - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0.0:
                return f"{self.id}: the goal's orientation is no rotation"
        if self.trajectory is not None and self.trajectory.curve.n != joints:
            return f"{self.id}: its trajectory is that of another machine"
        return None


@dataclass(frozen=True, slots=True)
class JobMemory:
    """What is remembered of a job from tick to tick; plain numbers and texts.

    Attributes:
        job: its id, empty for none. state: see `JobState`.
        clock_s: time on its trajectory [s]. rate: how fast that runs, 1 for as planned, as far as commands go ahead.
        clocks: times on its trajectory at the ticks to come, as the commands in flight have them [s].
        pushed: whether limits have pushed the tool off its trajectory.
        flight: commands on their way to the joints.
        around: direction (3) in which the tool goes round what blocks it, machine frame; zeros for none.
        least: least distance to go so far, in metres and radians alike. idle_s: since that last fell [s].
        allowed: share of what was asked for last that the guard left, 0 to 1.
        group: the exclusive group that moves the tool towards a goal, -1 for none.
    """

    job: str = ""
    state: str = JobState.NONE.value
    clock_s: float = 0.0
    clocks: tuple[float, ...] = ()
    rate: float = 0.0
    pushed: bool = False
    flight: InFlight = field(default_factory=InFlight)
    around: tuple[float, ...] = (0.0, 0.0, 0.0)
    least: float = math.inf
    idle_s: float = 0.0
    allowed: float = 1.0
    group: int = -1

    def plain(self) -> dict[str, Any]:
        """Return it as dicts, lists, numbers and texts."""
        found = asdict(self)
        found["least"] = None if math.isinf(self.least) else self.least
        return found

    @classmethod
    def of(cls, plain: Mapping[str, Any]) -> "JobMemory":
        """Return the memory whose `plain` form this is.

        Raises:
            KeyError, TypeError, ValueError: if it is none.
        """
        given = dict(plain)
        given["flight"] = InFlight(*(tuple(map(float, given["flight"][name])) for name in ("speeds", "commands")))
        for name in ("around", "clocks"):
            given[name] = tuple(map(float, given[name]))
        given["least"] = math.inf if given["least"] is None else float(given["least"])
        return cls(**given)


@dataclass(frozen=True, slots=True)
class JobFacts:
    """How far a job is, at one tick.

    Attributes:
        job: its id. state: see `JobState`.
        clock_s, duration_s: time on its trajectory and in all [s]; 0 for a goal.
        rate: how fast that time runs, 1 as planned.
        way_m: along its path [m]; NaN where it has none.
        error_m, error_rad: from where the tool is to be by now; of a goal, to it.
        left: share of what is wanted that limits leave, as motion bends it.
        against: id of the limit that holds most of it back, None for none.
    """

    job: str
    state: JobState
    clock_s: float
    duration_s: float
    rate: float
    way_m: float
    error_m: float
    error_rad: float
    left: float
    against: str | None
