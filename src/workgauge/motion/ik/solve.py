"""The posture that brings the tool to a goal, by iterating the closed loop's step; and why not, where it does not."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from workgauge.machine.model import Kinematics, MachineModel
from workgauge.motion.ik.clik import ClikGains, ClikMemory, clik_velocity, movable_groups, speed_share
from workgauge.motion.ik.task import ROWS, task_error, task_jacobian
from workgauge.motion.ik.weighted import least_velocity
from workgauge.motion.stuck import Cause, pushed_limits, stands_below, why_stuck
from workgauge.values.arrays import Floats, freeze, frozen
from workgauge.values.errors import InputError
from workgauge.values.tasks import Orientation

_PROGRESS = 0.99  # an iteration that leaves more of the smallest error than this gains nothing
_SHORT = 3.0  # times the largest lambda, where the error is to fall at every step
_HALVINGS = 8
_RIGID = 1e-6


@dataclass(frozen=True, slots=True)
class SolveSettings:
    """How the iteration goes and when it ends.

    Attributes:
        gains: of the step. K and the drift are not used: every iteration goes for the whole error; and lambda shrinks
            with the error, so that damping does not slow the end.
        step_s: how far one iteration may go, in seconds at the joints' full speed.
        iterations: at most, of each start. patience: that many in a row without gain end it.
        tolerance_m, tolerance_rad: a goal is reached within both.
        restarts: further starts, from seeded random postures, while the goal is not reached.
        seed: of them.
        exclusive: every iteration moves one exclusive group alone, as the loop itself drives. Otherwise the posture
            alone counts; `turns` says how to get there.
    """

    gains: ClikGains = field(default_factory=ClikGains)
    step_s: float = 0.7
    iterations: int = 120
    patience: int = 15
    tolerance_m: float = 1e-3
    tolerance_rad: float = math.radians(0.1)
    restarts: int = 0
    seed: int = 0
    exclusive: bool = False

    def __post_init__(self) -> None:
        for name, fine, allowed in (
            ("step_s", 0.0 < self.step_s < math.inf, "above 0"),
            ("iterations", self.iterations >= 1, "1 or more"),
            ("patience", self.patience >= 1, "1 or more"),
            ("tolerance_m", 0.0 < self.tolerance_m < math.inf, "above 0"),
            ("tolerance_rad", 0.0 < self.tolerance_rad < math.inf, "above 0"),
            ("restarts", self.restarts >= 0, "0 or more"),
            ("seed", self.seed >= 0, "0 or more"),
        ):
            if not fine:
                raise InputError(
                    "setting of the solver out of range", element=name, value=getattr(self, name), allowed=allowed
                )


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """The posture found.

    Attributes:
        q: (n,) within the limits, endless joints within half a turn of the start [rad, m].
        converged: whether the tool is at the goal within the tolerances.
        error: (m,) of `task_error` at q, what is left of the way [m, rad].
        iterations: of all starts together.
        cause, why: what keeps the tool from the goal at q, in a word and in words; REACHED and empty if nothing does.
    """

    q: Floats
    converged: bool
    error: Floats
    iterations: int
    cause: Cause
    why: str


@dataclass(frozen=True, slots=True, eq=False)
class _Attempt:
    kin: Kinematics
    error: Floats
    size: float
    reached: bool
    iterations: int

    @property
    def q(self) -> Floats:
        return self.kin.q


def solve(
    machine: MachineModel,
    q_start: ArrayLike,
    T_machine_goal: Floats,
    orientation: Orientation,
    settings: SolveSettings | None = None,
) -> Solved:
    """Return the posture near q_start that brings the tool to the goal, or the nearest one found and why not nearer.

    Every iteration is a step of `clik_velocity`, so that no iterate is beyond a joint limit. The start is taken into
    the limits first. Nothing is random but the restarts, and those are seeded.

    Args:
        q_start: (n,) [rad, m]. T_machine_goal: (4, 4) tool in the machine frame [m].

    Raises:
        InputError: if the start or the goal has another shape, is not finite, or the goal is no rigid pose.
    """
    settings = settings or SolveSettings()
    start = _checked_start(machine, q_start)
    goal = _checked_goal(T_machine_goal)
    draw = np.random.default_rng(settings.seed)
    best = _attempt(machine, start, goal, orientation, settings)
    iterations = best.iterations
    for _ in range(settings.restarts):
        if best.reached:
            break
        other = draw.uniform(machine.sample_min, machine.sample_max)
        found = _attempt(machine, other, goal, orientation, settings)
        iterations += found.iterations
        best = found if found.reached or found.size < best.size else best
    turns_off = np.where(machine.continuous, np.round((best.q - start) / (2.0 * np.pi)), 0.0)
    q = frozen(best.q - 2.0 * np.pi * turns_off)
    cause, why = Cause.REACHED, ""
    if not best.reached:
        cause, why = why_stuck(machine, q, goal, orientation, settings.gains.length_m_rad)
    return Solved(q, best.reached, best.error, iterations, cause, why)


def turns(machine: MachineModel, q_start: ArrayLike, q_goal: ArrayLike) -> Floats:
    """Return the postures (k, n), start and goal included, between which one exclusive group moves at a time.

    Joints of no group move in the first turn; all lie within the box of start and goal, so within the limits. Groups
    that have nothing to move have no turn.
    """
    q, goal = np.array(q_start, dtype=np.float64), np.asarray(q_goal, dtype=np.float64)
    postures = [q.copy()]
    in_groups = {j for group in machine.exclusive_groups for j in group}
    sets = [[j for j in range(machine.n) if j not in in_groups], *map(list, machine.exclusive_groups)]
    for joints in sets:
        if not np.array_equal(q[joints], goal[joints]):
            q[joints] = goal[joints]
            postures.append(q.copy())
    return frozen(np.array(postures))


def _attempt(
    machine: MachineModel, q: Floats, goal: Floats, orientation: Orientation, settings: SolveSettings
) -> _Attempt:
    """Return where the iteration from q ends: at the goal, or where the error cannot fall any further."""
    memory, idle, still = ClikMemory(), 0, np.zeros(ROWS[orientation])
    gain = 1.0 / settings.step_s
    whole = replace(settings.gains, linear_1_s=gain, angular_1_s=gain, posture_1_s=0.0)
    here = best = _look(machine, q, goal, orientation, settings, 0)
    while not here.reached and here.iterations < settings.iterations and idle <= settings.patience:
        damped = replace(whole, damping=settings.gains.damping * min(here.size, 1.0))
        qdot, memory, _ = clik_velocity(
            machine,
            here.kin,
            here.error,
            still,
            memory,
            damped,
            orientation,
            dt_s=settings.step_s,
            exclusive=settings.exclusive,
        )
        q = _moved(machine, here.q, settings.step_s * qdot)
        here = _look(machine, q, goal, orientation, settings, here.iterations + 1)
        idle = 0 if here.size < _PROGRESS * best.size else idle + 1
        best = here if here.size < best.size else best
    if here.reached:
        return here
    return _settled(machine, replace(best, iterations=here.iterations), goal, orientation, settings)


def _settled(
    machine: MachineModel, best: _Attempt, goal: Floats, orientation: Orientation, settings: SolveSettings
) -> _Attempt:
    """Return where the error stands still, falling at every step from the nearest iterate.

    The iteration may have left that by leaps, and weights keep joints from their very limits: here they count alike.
    """
    gains = settings.gains
    weigh = np.where(np.arange(ROWS[orientation]) < 3, 1.0, gains.length_m_rad)
    for _ in range(settings.iterations):
        J, wanted = weigh[:, None] * task_jacobian(best.kin, machine, orientation), weigh * best.error
        pull = J.T @ wanted
        pull[pushed_limits(machine, best.q, pull, 0.0)] = 0.0
        groups = [list(group) for _, group in movable_groups(machine, exclusive=settings.exclusive)]
        if float(np.linalg.norm(pull)) <= 0.5 * stands_below(J, wanted):
            break
        group = max(groups, key=lambda joints: float(np.linalg.norm(pull[joints])))
        free = [j for j in group if pull[j] != 0.0]
        step = np.zeros(machine.n)
        step[free] = least_velocity(J[:, free], wanted, np.zeros(len(free)), _SHORT * gains.damping)
        step *= settings.step_s * speed_share(step / settings.step_s, machine)
        slope = np.zeros(machine.n)  # falls for certain, where an end close by bends the other step too much
        slope[free] = pull[free] / float(np.linalg.norm(J, 2)) ** 2
        before = best.size
        for halvings in range(2 * _HALVINGS):
            way = step if halvings < _HALVINGS else slope
            q = _moved(machine, best.q, 0.5 ** (halvings % _HALVINGS) * way)
            here = _look(machine, q, goal, orientation, settings, best.iterations + 1)
            if here.size < best.size:
                best = here
                break
        if best.reached or best.size >= before:
            break
    return best


def _look(
    machine: MachineModel, q: Floats, goal: Floats, orientation: Orientation, settings: SolveSettings, iterations: int
) -> _Attempt:
    kin = machine.forward(q)
    error = task_error(kin, machine, goal, orientation)
    off, turned = math.hypot(*error[:3].tolist()), math.hypot(*error[3:].tolist())
    reached = off <= settings.tolerance_m and turned <= settings.tolerance_rad
    return _Attempt(kin, error, math.hypot(off, settings.gains.length_m_rad * turned), reached, iterations)


def _moved(machine: MachineModel, q: Floats, step: Floats) -> Floats:
    moved: Floats = np.clip(q + step, machine.q_min, machine.q_max)  # takes off the last rounding, no more
    return moved


def _checked_start(machine: MachineModel, q_start: ArrayLike) -> Floats:
    q = np.array(q_start, dtype=np.float64)
    if q.shape != (machine.n,) or not np.isfinite(q).all():
        raise InputError("not a posture", element="q_start", value=q.tolist(), allowed=f"{machine.n} finite numbers")
    inside: Floats = np.clip(q, machine.q_min, machine.q_max)
    return inside


def _checked_goal(T: Floats) -> Floats:
    goal = np.array(T, dtype=np.float64)
    fine = goal.shape == (4, 4) and bool(np.isfinite(goal).all()) and goal[3].tolist() == [0.0, 0.0, 0.0, 1.0]
    if fine:
        R = goal[:3, :3]
        fine = float(np.abs(R @ R.T - np.eye(3)).max()) < _RIGID and float(np.linalg.det(R)) > 0.0
    if not fine:
        raise InputError(
            "the goal is no pose", element="T_machine_goal", value=goal.tolist(), allowed="a rigid transform (4, 4)"
        )
    freeze(goal)
    return goal
