"""The potential guard: what is near pushes the machine away."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from workgauge.guard.api import FAR, GuardInput, GuardResult, Memory, full_stop, unusable
from workgauge.guard.cushion import cushioned
from workgauge.guard.exit import room
from workgauge.guard.giving_way import POSITION, WHOLE_POSE, Variant, freedom
from workgauge.guard.hold import held, short
from workgauge.guard.joints import one_group, within_speed
from workgauge.machine.model import MachineModel
from workgauge.values.arrays import Floats, Ints, freeze
from workgauge.values.clearances import Clearances
from workgauge.values.errors import InputError
from workgauge.values.reasons import Reason, ReasonCode

#: The field is counted no nearer than this [m].
NEAREST_M = 1e-3
#: A stop distance below this counts as this, where one is weighed against another [m].
LEAST_M = 1e-3
#: At most this many reasons about limits, the gravest first.
MAX_REASONS = 8
#: A reason's text is silent about protection levels below this [m].
WORTH_SAYING_M = 0.005


class Points(StrEnum):
    """At how many points of a link the field acts."""

    PER_LINK = "per_link"  #: its one closest point, as the document has it
    PER_LIMIT = "per_limit"  #: the closest point to each limit


@dataclass(frozen=True, slots=True)
class PotentialGuard:
    """Mäkinen's artificial potential field, 3.13 to 3.16 corrected, environment and own links alike.

    At each point `v = mu (1/p - 1/p_u) / p^2` along the way out for `p <= p_u`, else 0 (3.13), capped as p goes to
    zero, p the distance less its protection level. A clearance's row is `u^T J_O` with `J_O = J_v - r~ J_w` (3.15,
    where the document prints a pseudo-inverse), one scalar row per point. To the wanted velocity is added, over all
    points, `N (u^T J_O N)^+ v` (3.14 and 3.16), damped: with N the motions in which the task may give way, see
    `giving_way`, which keep a redundant task and the orientation of a whole pose. By joints wished one by one, every
    joint may move.

    A limit with a stop distance of its own counts as so much nearer or farther; where it is a smaller one between own
    links, the whole field is smaller in proportion, reach and speed. The push is there only while something is
    wished: nothing moves a machine that nobody drives.

    **A field alone promises nothing.** It balances wishes against nearness: a faster wish comes nearer, two limits
    push into a third, in a task's null space there may be no way out, and delayed joints are pushed too late. With
    `hold`, whatever then still approaches a clearance at its stop distance is taken off, and none loses in one tick
    more than it has above it: on joints that obey at once nothing is entered. On hydraulic joints it may be; the
    barrier guard is for those.

    Attributes:
        slow_distance_m: p_u, where the push begins. stop_distance_m: held, where a limit names none of its own.
        mu: strength of the field, not in the document; 0.01 pushes with 0.94 m/s at 0.2 m [m^4/s].
        cap_m_s: highest speed of one point's push. damping: of the inverse of its row [m/rad].
        cushion_s: time constant of the end cushion.
        points: one closest point per link, or one per link and limit.
        variant: what of a tool's task gives way. hold: whether the approach ends at the stop distance; False is the
            field as printed.
    """

    slow_distance_m: float = 0.8
    stop_distance_m: float = 0.2
    mu: float = 0.01
    cap_m_s: float = 1.0
    damping: float = 0.05
    cushion_s: float = 0.3
    points: Points = Points.PER_LIMIT
    variant: Variant = Variant.KEEP_ORIENTATION
    hold: bool = True

    def __post_init__(self) -> None:
        for name, low, high in (
            ("stop_distance_m", 0.0, 10.0),
            ("slow_distance_m", 0.01, 10.0),
            ("mu", 0.0, 10.0),
            ("cap_m_s", 0.0, 10.0),
            ("damping", 1e-3, 1.0),
            ("cushion_s", 0.01, 10.0),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise _refused(name, value, f"{low:g} to {high:g}")
        if not self.stop_distance_m < self.slow_distance_m:
            raise _refused("slow_distance_m", self.slow_distance_m, f"above stop_distance_m = {self.stop_distance_m}")
        for name, kind in (("points", Points), ("variant", Variant)):
            try:
                object.__setattr__(self, name, kind(getattr(self, name)))
            except ValueError:
                raise _refused(name, getattr(self, name), ", ".join(kind)) from None
        if self.hold not in (False, True):
            raise _refused("hold", self.hold, "false, true")
        object.__setattr__(self, "hold", bool(self.hold))

    @property
    def name(self) -> str:
        """Name it is registered under."""
        return "potential"

    @property
    def steers_itself(self) -> bool:
        """Automatic motion comes as it is wanted: the field bends it."""
        return True

    @property
    def reach_m(self) -> float:
        """Clearances up to here must be known to it [m]."""
        return self.slow_distance_m

    def start(self) -> Memory:
        """Return the memory of a guard that has done nothing yet: no exclusive group moving."""
        return {"group": -1}

    def idle(
        self, sent: Floats | None, machine: MachineModel, dt_s: float, elapsed_s: float, memory: Memory
    ) -> Memory:
        """Return the memory of a guard that has done nothing yet: it looks at nothing but the present."""
        return self.start()

    def speed(self, p: Floats) -> Floats:
        """Return the speeds (k,) [m/s] that points at clearances (k,) [m] are pushed with, eq. 3.13, capped."""
        safe = np.maximum(p, NEAREST_M)
        field = self.mu * (1.0 / safe - 1.0 / self.slow_distance_m) / safe**2
        return np.where(p <= self.slow_distance_m, np.clip(field, 0.0, self.cap_m_s), 0.0)

    def allow(self, given: GuardInput, memory: Memory) -> tuple[GuardResult, Memory]:
        """Return the wanted velocity and what the field adds, less what still approaches; why; and the moving group.

        Numbers nobody can judge (NaN, infinite, wrong shapes) and clearances searched too near stop every joint.
        """
        wrong = self._wrong(given)
        if wrong is not None:
            return full_stop(len(given.joint_names), wrong), self.start()
        previous = memory.get("group")
        group = previous if isinstance(previous, int) else -1
        moving, group, reasons = _moving(given, given.desired, group)
        wish, ends = self._before_ends(given, moving, given.keep_direction)
        ways = freedom(given, _movable(given, group), self.variant)
        slack, smaller = self._slack(given.clearances)
        speeds = np.zeros(len(slack))
        velocity = wish
        if given.desired.any():
            push, speeds = self._push(given, slack, smaller, ways)
            if push.any():
                velocity, group, more = _moving(given, push + (wish if given.keep_direction else moving), group)
                velocity, again = self._before_ends(given, velocity, False)
                reasons += _unsaid(more, reasons)
                ends = again + _unsaid(ends if given.keep_direction else [], again)
        refused = np.zeros(len(slack), dtype=np.bool_)
        if self.hold:
            velocity, refused = self._held(given, velocity, slack, group, ways)
        scale = _scale(given, wish, velocity) if speeds.any() or refused.any() else 1.0
        reasons += ends
        reasons += _reasons(given.clearances, slack, speeds, refused, scale, self.stop_distance_m)
        allowed = velocity + 0.0
        freeze(allowed)
        return GuardResult(allowed, tuple(reasons), scale), {"group": group}

    def _wrong(self, given: GuardInput) -> str | None:
        """Return what about the input cannot be judged, or None."""
        wrong = unusable(given)
        if wrong is None and not given.clearances.searched_m >= self.reach_m:
            wrong = f"clearances are known to {given.clearances.searched_m:.2f} m, {self.reach_m:.2f} m needed"
        if wrong is None and given.task is not None:
            shape = given.task.shape
            if len(shape) != 2 or not POSITION <= shape[0] <= WHOLE_POSE or shape[1] != len(given.joint_names):
                return "the tool's task is not one of these joints"
            if not (np.abs(given.task) < FAR).all():
                return "the tool's task is not made of numbers, or out of this world"
        return wrong

    def _before_ends(self, given: GuardInput, velocity: Floats, keep_direction: bool) -> tuple[Floats, list[Reason]]:
        """Return what the joints' ends leave of a velocity (n,), and why."""
        left, reasons = cushioned(
            velocity.tolist(),
            given.q.tolist(),
            (given.q_min.tolist(), given.q_max.tolist()),
            (given.speed_positive.tolist(), given.speed_negative.tolist()),
            given.joint_names,
            dt_s=given.dt_s,
            cushion_s=self.cushion_s,
            keep_direction=keep_direction,
        )
        return np.array(left), reasons

    def _slack(self, clearances: Clearances) -> tuple[Floats, Floats]:
        """Return what is left above the stop distances (k,) [m], and how much smaller than usual each field is."""
        own = clearances.stop_distances
        stops = np.where(np.isnan(own), self.stop_distance_m, own)
        small = (clearances.other_links >= 0) & (own < self.stop_distance_m)
        share = np.where(small, np.maximum(stops, LEAST_M) / max(self.stop_distance_m, LEAST_M), 1.0)
        return clearances.distances - clearances.protections - stops, share

    def _push(self, given: GuardInput, slack: Floats, smaller: Floats, ways: Floats) -> tuple[Floats, Floats]:
        """Return the joint velocity (n,) that the field adds, and how fast it drives each point out (k,) [m/s]."""
        push = smaller * self.speed(self.stop_distance_m + slack / smaller)
        if self.points is Points.PER_LINK:
            kept = np.zeros(len(push), dtype=np.bool_)
            kept[_closest(given.clearances.links, slack / smaller)] = True
            push = np.where(kept, push, 0.0)
        felt = given.rows @ ways
        squares = (felt * felt).sum(axis=1)
        inverse = push / (squares + self.damping**2)
        return ways @ (felt.T @ inverse), squares * inverse

    def _held(
        self, given: GuardInput, velocity: Floats, slack: Floats, group: int, ways: Floats
    ) -> tuple[Floats, np.ndarray]:
        """Return a velocity that uses up no slack (k,) within the tick, and which of them it was taken from."""
        floors = -np.maximum(slack, 0.0) / given.dt_s
        refused = short(velocity, given.rows, floors)
        if not refused.any():
            return velocity, refused
        low, high = room(
            *(given.q, given.q_min, given.q_max, given.speed_positive, given.speed_negative),
            settle_s=max(self.cushion_s, given.dt_s),
        )
        still = np.ones(len(velocity), dtype=np.bool_)
        still[_movable(given, group, resting=True)] = False
        low, high = np.where(still, 0.0, low), np.where(still, 0.0, high)
        low, high = np.minimum(low, velocity), np.maximum(high, velocity)
        return held(velocity, given.rows, floors, low, high, ways), refused


def _refused(name: str, value: object, allowed: str) -> InputError:
    return InputError("guard parameter out of range", element=name, value=value, allowed=allowed)


def _moving(given: GuardInput, velocity: Floats, group: int) -> tuple[Floats, int, list[Reason]]:
    """Return what joint speeds and exclusive groups leave of a velocity (n,), the moving group, and why."""
    names = given.joint_names
    positive, negative = given.speed_positive.tolist(), given.speed_negative.tolist()
    bounded, reasons = within_speed(velocity.tolist(), positive, negative, names)
    bounded, group, stilled = one_group(bounded, positive, negative, given.exclusive_groups, names, group)
    return np.array(bounded), group, reasons + stilled


def _unsaid(reasons: list[Reason], said: list[Reason]) -> list[Reason]:
    """Return the reasons whose cause is not among those said."""
    causes = {(reason.code, reason.joint) for reason in said}
    return [reason for reason in reasons if (reason.code, reason.joint) not in causes]


def _movable(given: GuardInput, group: int, *, resting: bool = False) -> list[int]:
    """Return the joints that may move beside an exclusive group; with none moving, all, or if resting no group's."""
    n, groups = len(given.joint_names), given.exclusive_groups
    if group < 0 and not resting:
        return list(range(n))
    kept = set(groups[group]) if group >= 0 else set()
    others = {j for one in groups for j in one} - kept
    return [j for j in range(n) if j not in others]


def _closest(links: Ints, nearness: Floats) -> list[int]:
    """Return the index of the nearest clearance of every link."""
    first: dict[int, int] = {}
    for k in np.argsort(nearness, kind="stable").tolist():
        first.setdefault(int(links[k]), k)
    return sorted(first.values())


def _scale(given: GuardInput, wish: Floats, velocity: Floats) -> float:
    """Return what is left of a wish along itself, joint speeds as shares of what the joints can do, 0 to 1."""
    weights = 1.0 / np.maximum(given.speed_positive, given.speed_negative) ** 2
    whole = float((weights * wish) @ wish)
    return min(max(float((weights * wish) @ velocity) / whole, 0.0), 1.0) if whole > 0.0 else 1.0


def _reasons(
    clearances: Clearances, slack: Floats, speeds: Floats, refused: np.ndarray, scale: float, stop_distance_m: float
) -> list[Reason]:
    """Return one reason per link and limit that pushes or that nothing may approach, the gravest first."""
    reasons: list[Reason] = []
    said = set()
    acting = np.flatnonzero(refused | (speeds > 0.0))
    for k in acting[np.lexsort((slack[acting], ~refused[acting]))].tolist():
        pair = int(clearances.links[k]), int(clearances.limits[k])
        if pair in said or len(reasons) == MAX_REASONS:
            continue
        said.add(pair)
        one = clearances[k]
        stop = stop_distance_m if np.isnan(one.stop_distance_m) else one.stop_distance_m
        pushed = f"pushed away at {speeds[k]:.2f} m/s"
        doubt = ""
        if one.protection_m >= WORTH_SAYING_M:
            doubt = f" ({one.protection_m:.2f} m of it unsure, stops at {stop:.2f} m)"
        if one.distance_m < 0.0:
            code, text = ReasonCode.INSIDE_LIMIT, f"{-one.distance_m:.2f} m inside {one.limit}, {pushed}"
        elif refused[k]:
            code, text = ReasonCode.LIMIT_REACHED, f"{one.distance_m:.2f} m from {one.limit}{doubt}, no nearer"
        else:
            code, text = ReasonCode.PUSHED_AWAY, f"{one.distance_m:.2f} m from {one.limit}{doubt}, {pushed}"
        reasons.append(
            Reason(
                code,
                f"{one.link} is {text}",
                link=one.link,
                limit=one.limit,
                clearance_m=one.distance_m,
                scale=scale,
                protection_m=one.protection_m,
                stop_distance_m=stop,
            )
        )
    return reasons
