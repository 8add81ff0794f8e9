"""Looking for a way through joint space with OMPL's sampling planners."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.motion.plan.validity import Validity
from workgauge.values.arrays import Floats
from workgauge.values.errors import InputError

#: The planner, of `ompl.geometric`; it has to do without a projection of its states.
PLANNER = "RRTConnect"
#: Longest step of a tree, in seconds at full joint speeds.
STEP_S = 2.0


def ompl_modules() -> tuple[Any, Any, Any]:
    """Return OMPL's `base`, `geometric` and `util`.

    Raises:
        InputError: if it is not installed.
    """
    try:
        from ompl import base, geometric, util
    except ImportError as error:
        raise InputError(
            "a global plan needs OMPL, which is not installed", element="ompl", allowed="install workgauge[plan]"
        ) from error
    return base, geometric, util


class JointSpace:
    """The joint space as OMPL sees it: seconds at full joint speed; joints without end are circles.

    Args:
        machine: whose joints. base: `ompl.base`.
    """

    def __init__(self, machine: MachineModel, base: Any) -> None:
        self._speeds = 0.5 * (machine.speed_positive + machine.speed_negative)
        self._low, self._high = machine.q_min, machine.q_max
        self._turning = np.flatnonzero(machine.continuous).tolist()
        self._bounded = np.flatnonzero(~machine.continuous).tolist()
        self.space = base.CompoundStateSpace()
        self._first = 1 if self._bounded else 0
        if self._bounded:
            bounds = base.RealVectorBounds(len(self._bounded))
            for i, j in enumerate(self._bounded):
                bounds.setLow(i, float(machine.q_min[j] / self._speeds[j]))
                bounds.setHigh(i, float(machine.q_max[j] / self._speeds[j]))
            vector = base.RealVectorStateSpace(len(self._bounded))
            vector.setBounds(bounds)
            self.space.addSubspace(vector, 1.0)
        for j in self._turning:
            self.space.addSubspace(base.SO2StateSpace(), float(1.0 / self._speeds[j]))

    def state(self, q: Floats) -> Any:
        """Return the state of a posture (n,)."""
        state = self.space.allocState()
        for i, j in enumerate(self._bounded):
            state[0][i] = float(q[j] / self._speeds[j])
        for i, j in enumerate(self._turning):
            value = math.remainder(float(q[j]), 2.0 * math.pi)
            state[self._first + i].value = value if value < math.pi else -math.pi  # half a turn itself is no state
        return state

    def posture(self, state: Any) -> Floats:
        """Return the posture (n,) of a state, turning joints within half a turn of zero."""
        q = np.empty(len(self._speeds))
        for i, j in enumerate(self._bounded):
            q[j] = min(max(state[0][i] * self._speeds[j], self._low[j]), self._high[j])
        for i, j in enumerate(self._turning):
            q[j] = state[self._first + i].value
        return q

    def near(self, q: Floats, other: Floats) -> Floats:
        """Return the posture `q` with turning joints by whole turns as near to those of another as can be."""
        moved = np.array(q)
        for j in self._turning:
            moved[j] = other[j] + math.remainder(float(q[j] - other[j]), 2.0 * math.pi)
        return moved


def explore(
    validity: Validity,
    start: Floats,
    goals: Sequence[Floats],
    seed: int,
    stop: Callable[[], bool],
    planner: str = PLANNER,
) -> list[Floats] | None:
    """Return postures from the start to one of the goals, each joined to the next by `Validity.motion`, or None.

    Turning joints go on counting. The same seed gives the same postures as long as `stop` says the same.

    Args:
        validity: what is allowed. start: (n,), goals: each (n,), all of them allowed.
        seed: of OMPL's random numbers, which are the process's own. stop: asked often; True ends the search.
        planner: a planner of `ompl.geometric`.

    Raises:
        InputError: if OMPL is not installed.
    """
    base, geometric, util = ompl_modules()
    util.setLogLevel(util.LogLevel.LOG_NONE)
    util.RNG.setSeed(seed % (2**32 - 1) + 1)
    joints = JointSpace(validity.machine, base)
    information = base.SpaceInformation(joints.space)

    class _Motions(base.MotionValidator):  # type: ignore[misc, name-defined]
        def checkMotion(self, a: Any, b: Any) -> bool:
            q = joints.posture(a)
            return validity.motion(q, joints.near(joints.posture(b), q)) is not None

    motions = _Motions(information)
    information.setMotionValidator(motions)
    information.setStateValidityChecker(lambda state: validity.keeps(joints.posture(state)))
    information.setup()
    problem = base.ProblemDefinition(information)
    problem.addStartState(joints.state(start))
    wanted = base.GoalStates(information)
    for goal in goals:
        wanted.addState(joints.state(goal))
    problem.setGoal(wanted)
    search = getattr(geometric, planner)(information)
    if hasattr(search, "setRange"):
        search.setRange(STEP_S)
    search.setProblemDefinition(problem)
    search.setup()
    search.solve(base.PlannerTerminationCondition(stop))
    if not problem.hasExactSolution():
        return None
    found, way = start, [start]
    for state in problem.getSolutionPath().getStates()[1:]:
        found = joints.near(joints.posture(state), found)
        way.append(found)
    ends = [joints.near(goal, found) for goal in goals]
    way[-1] = min(ends, key=lambda end: float(np.abs(end - found).max()))  # without the rounding of its units
    return way
