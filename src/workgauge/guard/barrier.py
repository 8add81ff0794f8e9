"""The barrier guard: as fast as still stops in time, each stop rolled out and verified before its command leaves."""

import functools
from dataclasses import dataclass, replace

import numpy as np

from workgauge.guard.api import GuardInput, GuardResult, Memory, full_stop, unusable
from workgauge.guard.exit import Exit, Pinned, WayOut, room, way_out
from workgauge.guard.joints import one_group, within_speed
from workgauge.guard.plan import MINUS, PLUS, WISH, Flight, Plan, flown
from workgauge.guard.programme import share
from workgauge.guard.ranges import lever_ranges
from workgauge.guard.why import cushioned_by, held_back, how_out
from workgauge.machine.model import MachineModel
from workgauge.machine.rollout import Rollout
from workgauge.machine.stopping import StoppingModel
from workgauge.proximity.stops import Rows, Stop
from workgauge.proximity.surroundings import Surroundings
from workgauge.values.arrays import Floats, freeze
from workgauge.values.errors import InputError
from workgauge.values.reasons import Reason

#: A verified stop may fall short by this much, as a straight step along a curved bound does [m].
SHORT_M = 2e-6
#: For a way out, a joint is at its end where that leaves less than this share of its speed.
AT_END = 0.01
#: What is asked anew when a command does not verify: so much of it, then so much of that, then nothing.
TRIALS = (0.5, 0.5)


@dataclass(frozen=True, slots=True)
class BarrierGuard:
    """Stops in time on late and sluggish joints, lets go at once, and never moves a joint that is not asked to move.

    Each tick, the commands in flight are rolled out through the machine's stopping model, followed by nothing, to
    bounds that hold for every joint within tolerance: that is the stop in hand. Along it, every clearance's slack is
    what is left above stop distance and protection level; see `proximity.sweep`. What the command of this one tick
    adds to the stop is linear to the millimetre: each joint gets the share of its wish, 0 to 1, nearest to 1 in the
    sum of squares, such that no slack shrinks by more than the share `dt / ease_s` of itself, and none below zero
    shrinks at all. Then the chosen command is rolled out in turn and every slack computed anew; if one falls short of
    zero by more than a quarter of the margin (or of what it had, below that), half of the command is tried, then a
    quarter, then the stop in hand.

    Inside a limit nothing may lead deeper, everything else stays enforced, and the guard seeks a way out: it says one
    when the wish is refused, drives it when asked to (`exit_share`), or names what pins the machine.

    Attributes:
        stop_distance_m: kept to limits that name none of their own.
        ease_s: time constant of the approach: the speed at which slack is used up is at most slack / ease_s.
        margin_m: kept besides, for what is computed to the millimetre only: the way between the moments looked at.
        cushion_s: time constant of the end cushion.
        spacing_m: no corner moves farther between two postures looked at.
    """

    stop_distance_m: float = 0.2
    ease_s: float = 0.15
    margin_m: float = 0.008
    cushion_s: float = 0.3
    spacing_m: float = 0.2

    def __post_init__(self) -> None:
        for name, low, high in (
            ("stop_distance_m", 0.0, 10.0),
            ("ease_s", 0.01, 10.0),
            ("margin_m", 0.0, 1.0),
            ("cushion_s", 0.01, 10.0),
            ("spacing_m", 0.01, 1.0),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError(
                    "guard parameter out of range", element=name, value=value, allowed=f"{low:g} to {high:g}"
                )

    @property
    def name(self) -> str:
        """Name it is registered under."""
        return "barrier"

    @property
    def reach_m(self) -> float:
        """Clearances up to here must be known to it [m]; it looks farther by itself where a stop is longer."""
        return self.stop_distance_m

    def start(self) -> Memory:
        """Return the memory of a guard that has done nothing yet: a machine at rest, nothing in flight."""
        return {}

    def idle(
        self, sent: Floats | None, machine: MachineModel, dt_s: float, elapsed_s: float, memory: Memory
    ) -> Memory:
        """Return the memory after a tick in which nobody asked; what is in flight goes on flying."""
        return {"group": -1, **flown(rollout_of(machine, dt_s), sent, elapsed_s, memory).plain()}

    def allow(self, given: GuardInput, memory: Memory) -> tuple[GuardResult, Memory]:
        """Return the velocity that may be driven, why, what each lever may still do, and what to remember.

        Numbers nobody can judge (NaN, infinite, wrong shapes) and an unknown neighbourhood stop every joint.
        """
        around, wrong = given.around, unusable(given)
        if around is None:
            return full_stop(len(given.joint_names), wrong or "the guard cannot see what stands around"), memory
        rollout, elapsed_s = rollout_of(around.machine, given.dt_s), given.elapsed_s or given.dt_s
        if wrong is not None:
            kept = self.idle(given.sent, around.machine, given.dt_s, elapsed_s, memory)
            return full_stop(len(given.joint_names), wrong), kept
        flight = flown(rollout, given.sent, elapsed_s, memory)
        since = flight.since(given.age_s / given.dt_s)
        if since is None:
            wrong = f"posture is {given.age_s:.2f} s old, too old to know where the joints are"
            return full_stop(len(given.joint_names), wrong), {"group": -1, **flight.plain()}
        motion = rollout, flight, since
        found: Exit | None = None
        if given.exit_share is not None:
            velocity, found = self._driven_out(around, given, motion)
            given = replace(given, desired=velocity, keep_direction=True)
        wish, group, reasons = _wish(given, memory)
        plan, stop = self._rolled(around, given, motion, wish)
        rows, changes, alpha = stop.rows, plan.changes(stop.rows), min(given.dt_s / self.ease_s, 1.0)
        room_left = np.concatenate([np.where(rows.room > 0.0, rows.room, np.inf), rows.room / alpha])
        flow_rows, flow_most = _flow(around.machine, wish)
        solved = share(
            *(changes[WISH], room_left, alpha),
            keep_direction=given.keep_direction,
            flow_rows=flow_rows,
            flow_most=flow_most,
            ends=plan.ends[WISH],
        )
        kept_share = self._verified(plan, stop, solved.s * wish)
        allowed = wish * solved.s * kept_share
        freeze(allowed)
        scale = _scale(np.where(wish == 0.0, 1.0, solved.s * kept_share), wish)
        reasons += cushioned_by(plan.ends[WISH], wish, given.joint_names)
        reasons += held_back(stop.clearances, rows, solved, kept_share, self.stop_distance_m, scale)
        if found is None and wish.any() and not allowed.any() and (rows.slack < 0.0).any():
            found = self._sought(around, given, rows)
        if found is not None:
            reasons += how_out(found, stop.clearances, rows, given.joint_names)
        ranges = None
        if given.tool_rates is not None:
            ranges = lever_ranges(
                *(changes[PLUS], changes[MINUS], room_left, alpha),
                *(given.speed_positive, given.speed_negative, given.tool_rates),
                ends_positive=plan.ends[PLUS],
                ends_negative=plan.ends[MINUS],
                clearance_of=np.concatenate([rows.clearances, rows.clearances]),
            )
        result = GuardResult(allowed, tuple(reasons), scale, ranges, found)
        return result, {"group": group, **flight.plain()}

    def _rolled(
        self, around: Surroundings, given: GuardInput, motion: tuple[Rollout, Flight, Floats], wish: Floats
    ) -> tuple[Plan, Stop]:
        """Return where a wish would lead, and the stop in hand."""
        plan = Plan(
            *(motion[0], given, *motion[1:], wish),
            spacing_m=self.spacing_m,
            bend_m=0.25 * self.margin_m,
            farthest=around.scene.arm.farthest,
            cushion=min(given.dt_s / self.cushion_s, 1.0),
            alpha=min(given.dt_s / self.ease_s, 1.0),
        )
        return plan, self._stop(around, given, plan)

    def _driven_out(
        self, around: Surroundings, given: GuardInput, motion: tuple[Rollout, Flight, Floats]
    ) -> tuple[Floats, Exit | None]:
        """Return the velocity (n,) that leads out of what the machine would come to rest inside of, and how."""
        still = np.zeros(motion[0].n)
        _, stop = self._rolled(around, given, motion, still)
        if not (stop.rows.slack < 0.0).any():
            return still, None
        found = self._sought(around, given, stop.rows)
        if isinstance(found, Pinned):
            return still, found
        return found.velocity * min(max(given.exit_share or 0.0, 0.0), 1.0), found

    def _sought(self, around: Surroundings, given: GuardInput, rows: Rows) -> Exit:
        """Return the way out by whichever exclusive group has the best, or what pins the machine."""
        low, high = room(
            *(given.q, given.q_min, given.q_max, given.speed_positive, given.speed_negative, self.cushion_s)
        )
        # nearer and nearer to its end a joint goes ever slower, and all that keep its pace with it
        low[low > -AT_END * given.speed_negative] = 0.0
        high[high < AT_END * given.speed_positive] = 0.0
        groups, n = given.exclusive_groups, len(low)
        grouped = {j for group in groups for j in group}
        found: list[Exit] = []
        for group in groups or (tuple(range(n)),):
            free = np.array([j in group or j not in grouped for j in range(n)])
            found.append(way_out(rows.rows, rows.slack, low * free, high * free, room=rows.room))
        out = [one for one in found if isinstance(one, WayOut)]
        return max(out, key=lambda one: one.gain) if out else found[0]

    def _stop(self, around: Surroundings, given: GuardInput, plan: Plan) -> Stop:
        """Return the stop in hand: everything that has little slack on the way to rest from what is in flight."""
        clearances, farther = given.clearances, 0.0
        while True:
            stop = Stop(
                *(around, clearances, given.q, plan.way),
                stop_distance_m=self.stop_distance_m,
                margin_m=self.margin_m,
                reach=plan.reach,
                known_m=max(clearances.searched_m, farther),
            )
            if stop.reach_m <= max(clearances.searched_m, farther):
                return stop
            farther = stop.reach_m
            clearances = around.look(around.machine.forward(given.q), farther)

    def _verified(self, plan: Plan, stop: Stop, command: Floats) -> float:
        """Return what of a command is verified: all, half, a quarter, or none of it."""
        kept = 1.0
        if stop.free or not command.any():
            return kept
        for again in (*TRIALS, 0.0):
            if stop.shortfall(plan.way_after(command * kept), 0.25 * self.margin_m) <= SHORT_M:
                return kept
            kept *= again
        return 0.0


@functools.lru_cache(maxsize=16)
def rollout_of(machine: MachineModel, dt_s: float) -> Rollout:
    """Return a machine's stopping model, ready for a tick's period."""
    return Rollout(StoppingModel.of(machine), dt_s, machine.speed_positive, machine.speed_negative)


def _wish(given: GuardInput, memory: Memory) -> tuple[Floats, int, list[Reason]]:
    """Return what the joints' speeds and groups leave of the desired velocity, the moving group, and why."""
    names = given.joint_names
    positive, negative = given.speed_positive.tolist(), given.speed_negative.tolist()
    velocity, reasons = within_speed(given.desired.tolist(), positive, negative, names)
    previous = int(memory.get("group", -1))
    velocity, group, held = one_group(velocity, positive, negative, given.exclusive_groups, names, previous)
    return np.array(velocity), group, reasons + held


def _flow(machine: MachineModel, wish: Floats) -> tuple[Floats | None, Floats | None]:
    """Return the row (1, n) of what a wish takes of the pump's flow, and what it gives (1,), as shares of that."""
    pump = machine.pump
    if pump is None:
        return None, None
    shares = np.where(wish > 0.0, wish / machine.speed_positive, -wish / machine.speed_negative)
    flows = np.where(wish > 0.0, pump.flow_positive, pump.flow_negative)
    return (shares * flows / pump.flow)[None], np.ones(1)


def _scale(shares: Floats, wish: Floats) -> float:
    """Return what shares leave of a wish: along it, 0 to 1."""
    whole = float(wish @ wish)
    return min(float((shares * wish) @ wish) / whole, 1.0) if whole > 0.0 else 1.0
