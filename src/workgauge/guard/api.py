"""What every guard is given and gives back."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np

from workgauge.guard.exit import Exit
from workgauge.machine.model import MachineModel
from workgauge.proximity.surroundings import Surroundings
from workgauge.values.arrays import Floats, frozen
from workgauge.values.clearances import Clearances
from workgauge.values.compiled import njit
from workgauge.values.ranges import LeverRanges
from workgauge.values.reasons import Reason, ReasonCode

#: What a guard remembers from tick to tick: numbers and arrays, never written to. Through JSON arrays go as lists;
#: a guard takes lists for arrays.
Memory: TypeAlias = Mapping[str, Any]

#: Numbers beyond this are no measurement: what is computed from smaller ones cannot overflow.
FAR = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class GuardInput:
    """Everything a guard may look at.

    Attributes:
        desired: (n,) wanted joint velocities [rad/s, m/s].
        q: (n,) measured joint positions. q_min, q_max: (n,) joint ends, infinite where there is none [rad, m].
        speed_positive, speed_negative: (n,) highest joint speeds, both above 0 [rad/s, m/s].
        clearances: k clearances of this posture.
        rows: (k, n), `d(distance)/dt = row @ qdot` [m/rad, m/m].
        dt_s: time until the next tick [s].
        joint_names: (n).
        exclusive_groups: joint indices; joints of different groups cannot move together.
        keep_direction: a joint that must go slower slows all of them, so that the tool stays on its path.
        sent: (n,) joint velocities that the valves sent last ask for; None for none.
        elapsed_s: time since the last tick; dt_s unless ticks were missed [s].
        age_s: how long ago `q` was measured [s].
        around: what stands around the machine, for guards that look at other postures; None if nobody can say.
        tool_rates: (3, n) joint velocities that move the tool at 1 m/s along the machine's x, y and z; None if not
            asked for.
        exit_share: the operator wants to be driven out of limits so fast, 0 to 1; `desired` does not count then. None
            for no.
        task: (m, n), m from 3 to 6, Jacobian of the tool's task that `desired` was made for: the tool's velocity in
            the first three rows, below it what of its turning counts. None for joints that were wished one by one,
            and with `keep_direction` for the tool's whole pose.
    """

    desired: Floats
    q: Floats
    q_min: Floats
    q_max: Floats
    speed_positive: Floats
    speed_negative: Floats
    clearances: Clearances
    rows: Floats
    dt_s: float
    joint_names: tuple[str, ...]
    exclusive_groups: tuple[tuple[int, ...], ...]
    keep_direction: bool = False
    sent: Floats | None = None
    elapsed_s: float | None = None
    age_s: float = 0.0
    around: Surroundings | None = None
    tool_rates: Floats | None = None
    exit_share: float | None = None
    task: Floats | None = None


@dataclass(frozen=True, slots=True, eq=False)
class GuardResult:
    """What may be done.

    Attributes:
        allowed: (n,) joint velocities [rad/s, m/s].
        reasons: why `allowed` differs from `desired`; empty if it does not.
        scale: what the clearances leave of the velocity, 0 to 1.
        ranges: what each lever may still do; None from a guard that cannot say.
        exit: the way out of limits the machine is inside of, or what leaves none; None if it was not sought.
    """

    allowed: Floats
    reasons: tuple[Reason, ...]
    scale: float
    ranges: LeverRanges | None = None
    exit: Exit | None = None


class Guard(Protocol):
    """One way of keeping the machine out of its limits."""

    @property
    def name(self) -> str:
        """Name it is registered under."""
        ...

    @property
    def reach_m(self) -> float:
        """Clearances up to here must be known to it, beside what a limit's own stop distance adds [m]."""
        ...

    @property
    def steers_itself(self) -> bool:
        """Whether automatic motion is handed to it as it is wanted; else motion bends before limits by itself."""
        ...

    def start(self) -> Memory:
        """Return the memory of a guard that has done nothing yet."""
        ...

    def allow(self, given: GuardInput, memory: Memory) -> tuple[GuardResult, Memory]:
        """Return what may be done, and the memory for the next tick. Pure; raises nothing for bad numbers."""
        ...

    def idle(
        self, sent: Floats | None, machine: MachineModel, dt_s: float, elapsed_s: float, memory: Memory
    ) -> Memory:
        """Return the memory after a tick in which nobody asked it anything; what is in flight goes on flying.

        Args:
            sent, elapsed_s: as in `GuardInput`. machine, dt_s: whose joints, and the tick's period.
        """
        ...


def full_stop(n: int, text: str) -> GuardResult:
    """Return the result that stands for numbers nobody can judge: every joint stopped."""
    return GuardResult(frozen(np.zeros(n)), (Reason(ReasonCode.INVALID_VALUE, text, scale=0.0),), 0.0)


def unusable(given: GuardInput) -> str | None:
    """Return what about the input cannot be judged, or None. NaN in `stop_distances` stands for the guard's own."""
    clearances = given.clearances
    k, n = len(clearances), len(given.joint_names)
    if given.desired.shape != (n,) or given.q.shape != (n,):
        return f"{n} joints expected"
    if given.rows.shape != (k, n) or clearances.protections.shape != (k,) or clearances.stop_distances.shape != (k,):
        return "clearances and their rows differ in number"
    which = _unusable(
        *(given.desired, given.q, float(given.dt_s), clearances.distances, clearances.protections),
        *(clearances.stop_distances, given.rows),
    )
    return _UNUSABLE[which] if which >= 0 else None


_UNUSABLE = (
    "desired velocity is not a number, or out of this world",
    "joint position is not a number, or out of this world",
    "time step is not a number, or none a tick can have",
    "a clearance is not a number, or out of this world",
    "a protection level is not a number, or below zero",
    "a stop distance is infinite",
    "the motion of a clearance is not a number, or out of this world",
)


@njit(cache=True)
def _unusable(
    desired: Any, q: Any, dt_s: float, distances: Any, protections: Any, stop_distances: Any, rows: Any
) -> int:
    """Return the first of `_UNUSABLE` that is so, or -1."""
    if not _near(desired):
        return 0
    if not _near(q):
        return 1
    if not 1e-6 <= dt_s < FAR:
        return 2
    if not _near(distances):
        return 3
    for protection in protections:
        if not 0.0 <= protection < FAR:
            return 4
    for stop in stop_distances:
        if np.isinf(stop):
            return 5
    for row in rows:
        if not _near(row):
            return 6
    return -1


@njit(cache=True)
def _near(array: Any) -> bool:
    """Return whether every element (n,) is a number smaller than `FAR`; NaN is none."""
    near = True
    for value in array:
        near = near and abs(value) < FAR
    return near
