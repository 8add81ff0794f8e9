"""The answer of a closed-form inverse: every posture that reaches, those beyond a joint's end, or how far it is."""

import math
from dataclasses import dataclass

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.values.arrays import Floats, Ints, freeze, frozen

#: How far beyond its end a joint may come out and still count as standing at it [rad].
AT_THE_END = 1e-10
#: Postures nearer each other than this in every joint are one, a double root [rad].
SAME = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Postures before limits are looked at.

    Attributes:
        q: (N, B, n) for N poses, some joint of a branch that does not exist NaN.
        free: (N, B) the joint that may be chosen at will there (a singular posture), or -1.
    """

    q: Floats
    free: Ints


@dataclass(frozen=True, slots=True, eq=False)
class Beyond:
    """A posture that would reach if a joint could go farther.

    Attributes:
        machine: whose it is.
        q: (n,) [rad].
        excess: (n,) by how much each joint is above (positive) or below (negative) its end, else 0 [rad].
    """

    machine: MachineModel
    q: Floats
    excess: Floats

    @property
    def joint(self) -> int:
        """Index of the joint that is farthest beyond its end."""
        return int(np.abs(self.excess).argmax())

    @property
    def by_deg(self) -> float:
        """How far beyond its end that joint is [degrees], never negative."""
        return math.degrees(float(np.abs(self.excess).max()))

    @property
    def text(self) -> str:
        """That joint in words, and which others are beyond their ends."""
        machine, worst = self.machine, self.joint
        upper = self.excess[worst] > 0.0
        end = math.degrees(machine.q_max[worst] if upper else machine.q_min[worst])
        text = (
            f"{machine.joint_names[worst]} would have to go {self.by_deg:.1f} deg beyond its "
            f"{'upper' if upper else 'lower'} end at {end:.1f} deg"
        )
        others = [machine.joint_names[j] for j in np.flatnonzero(self.excess) if j != worst]
        if others:
            text += f", and {', '.join(others)} beyond {'its' if len(others) == 1 else 'their'} end too"
        return text


@dataclass(frozen=True, slots=True)
class OutOfReach:
    """Why no posture reaches.

    Attributes:
        by_m: distance from the goal's position to the nearest the machine reaches with the orientation kept, over
            swing, tilt and elbow within their limits; 0 if the lengths would do and joints' ends are in the way;
            infinite if no position allows the orientation.
        text: one sentence, no full stop.
    """

    by_m: float
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class Branches:
    """All postures that bring the tool to a goal.

    Attributes:
        q: (b, n) within the joints' limits, the one reached soonest first [rad].
        seconds: (b,) how soon: the largest |dq| / speed of any joint from the present posture.
        beyond: the branches beyond a joint's end, the smallest excess first.
        out_of_reach: set when `q` is empty.
        notes: what was chosen where a joint was free.
    """

    q: Floats
    seconds: Floats
    beyond: tuple[Beyond, ...] = ()
    out_of_reach: OutOfReach | None = None
    notes: tuple[str, ...] = ()


def seconds_between(machine: MachineModel, q_near: Floats, q: Floats) -> Floats:
    """Return how long (...) the slowest joint takes from q_near (n,) to q (..., n) at its full speed [s]."""
    dq = q - q_near
    times: Floats = np.where(dq > 0.0, dq / machine.speed_positive, -dq / machine.speed_negative).max(-1)
    return times


def turned_within(machine: MachineModel, q: Floats, q_near: Floats) -> tuple[Floats, Floats]:
    """Return angles q (..., n) by whole turns nearest q_near (n,) within the limits, and the excess (..., n).

    A joint that fits at no turn is taken to the turn of the smallest excess, and stays outside.
    """
    turn = 2.0 * math.pi
    lowest = np.ceil((machine.q_min - AT_THE_END - q) / turn)
    highest = np.floor((machine.q_max + AT_THE_END - q) / turn)
    fits = lowest <= highest
    wanted = np.clip(np.round((q_near - q) / turn), np.where(fits, lowest, -np.inf), np.where(fits, highest, np.inf))
    with np.errstate(invalid="ignore"):
        above, below = q + turn * lowest - machine.q_max, machine.q_min - q - turn * highest
        outside = np.where(above < below, q + turn * lowest, q + turn * highest)
        turned = np.where(fits, np.clip(q + turn * wanted, machine.q_min, machine.q_max), outside)
        excess = np.where(fits, 0.0, np.where(above < below, above, -below))
        excess += 0.0 * q
    return turned, excess


def arranged(machine: MachineModel, q: Floats, q_near: Floats, notes: tuple[str, ...]) -> Branches:
    """Return candidates q (c, n) as branches: by whole turns, doubles left out, limits checked, sorted."""
    q = q[np.isfinite(q).all(-1)]
    turned, excess = turned_within(machine, q, q_near)
    apart = np.abs(np.remainder(q[:, None] - q[None] + math.pi, 2 * math.pi) - math.pi).max(-1, initial=0.0)
    double = np.tril(apart < SAME, -1).any(-1)
    fits = ~excess.any(-1)
    inside = ~double & fits
    freeze(turned)
    freeze(excess)
    seconds = seconds_between(machine, q_near, turned[inside])
    order = np.argsort(seconds, kind="stable")
    outside = np.flatnonzero(~double & ~fits)
    outside = outside[np.argsort(np.abs(excess[outside]).max(-1, initial=0.0), kind="stable")]
    return Branches(
        q=frozen(turned[inside][order]),
        seconds=frozen(seconds[order]),
        beyond=tuple(Beyond(machine, turned[i], excess[i]) for i in outside),
        notes=notes,
    )
