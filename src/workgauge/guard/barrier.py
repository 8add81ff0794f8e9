"""The barrier guard: as fast as still stops in time, each stop rolled out and verified before its command leaves."""

import functools
from dataclasses import dataclass, replace

import numpy as np

from workgauge.guard.api import GuardInput, GuardResult, Memory, full_stop, unusable
from workgauge.guard.inside import Inside, joined, picked
from workgauge.guard.joints import one_group, within_speed
from workgauge.guard.plan import MINUS, PLUS, WISH, Flight, Plan, flown, losable
from workgauge.guard.programme import Solved, flow_row, share
from workgauge.guard.ranges import lever_ranges, verified_ranges
from workgauge.guard.seek import Seeker, Sought
from workgauge.guard.why import cushioned_by, held_back, how_out
from workgauge.machine.model import MachineModel
from workgauge.machine.rollout import Rollout
from workgauge.machine.stopping import StoppingModel
from workgauge.proximity.stops import Rows, Stop
from workgauge.proximity.surroundings import Surroundings
from workgauge.proximity.sweep import INSIDE_M
from workgauge.values.arrays import Floats, freeze
from workgauge.values.errors import InputError
from workgauge.values.ranges import LeverRanges
from workgauge.values.reasons import Reason

#: A verified stop may fall short by this much, as a straight step along a curved bound does [m].
SHORT_M = 2e-6
#: What is asked anew when a command does not verify: so much of it, and then nothing.
TRIALS = (0.5, 0.25)
#: On the way out, where speed does not matter and ways are bent.
EXIT_TRIALS = (0.5, 0.25, 0.1, 0.03)
#: So often what refuses a command inside a limit is taken into account.
CUTS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Chosen:
    """What of a wish is commanded: the shares solved for, over which rows, and how much of them is verified."""

    rows: Rows
    solved: Solved
    kept: float


@dataclass(frozen=True, slots=True)
class BarrierGuard:
    """Stops in time on late and sluggish joints, lets go at once, and never moves a joint that is not asked to move.

    Each tick, the commands in flight are rolled out through the machine's stopping model, followed by nothing, to
    bounds that hold for every joint within tolerance: that is the stop in hand. Along it, every clearance's slack is
    what is left above stop distance and protection level; see `proximity.sweep`. What the command of this one tick
    adds to the stop is linear to the millimetre: each joint gets the share of its wish, 0 to 1, nearest to 1 in the
    sum of squares, such that no slack shrinks by more than the share `dt / ease_s` of itself, and one that is used up
    by no more than `SHORT_M`, fading to nothing a quarter of the margin lower. Then the chosen command is rolled out
    in turn and every slack computed anew; if one falls short of zero by more than a quarter of the margin (or of what
    it had, below that), half of the command is tried, then a quarter, then the stop in hand.

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
    def steers_itself(self) -> bool:
        """It only ever holds back: automatic motion bends before limits by itself."""
        return False

    @property
    def reach_m(self) -> float:
        """Clearances up to here must be known to it [m]; it looks farther by itself where a stop is longer."""
        return self.stop_distance_m

    @property
    def _floor_m(self) -> float:
        """How much of the margin a verified stop may use up [m]."""
        return 0.25 * self.margin_m

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
        sought: Sought | None = None
        if given.exit_share is not None:
            sought = self._driven_out(around, given, motion)
            velocity = np.zeros(motion[0].n) if sought is None else sought.velocity
            given = replace(given, desired=velocity, keep_direction=True)
        wish, group, reasons = _wish(given, memory)
        plan, stop = self._rolled(around, given, motion, wish)
        inside = self._inside(around, given, plan, stop)
        chosen = self._chosen(around, given, plan, stop, inside, wish)
        shares = chosen.solved.s * chosen.kept
        allowed = wish * shares
        freeze(allowed)
        scale = _scale(np.where(wish == 0.0, 1.0, shares), wish)
        reasons += cushioned_by(plan.ends[WISH], wish, given.joint_names)
        reasons += held_back(
            *(stop.clearances, chosen.rows, chosen.solved, chosen.kept, self.stop_distance_m, scale),
        )
        if sought is None and inside is not None and wish.any() and not allowed.any():
            sought = self._seeker(given, plan, stop, inside).seek(1.0)
        if sought is not None:
            reasons += how_out(sought.exit, sought.clearances, sought.rows, given.joint_names)
        ranges = self._ranges(given, plan, stop, inside) if given.tool_rates is not None else None
        found = None if sought is None else sought.exit
        result = GuardResult(allowed, tuple(reasons), scale, ranges, found)
        return result, {"group": group, **flight.plain()}

    def _chosen(
        self, around: Surroundings, given: GuardInput, plan: Plan, stop: Stop, inside: Inside | None, wish: Floats
    ) -> Chosen:
        """Return the shares of a wish that verify.

        Inside a limit, first the whole wish, measured: what leads out of it and comes nearer to nothing else passes.
        Then what the others' corners leave of it, then what bounds of what is violated leave, and then its
        exact rows, of what refuses a command among them.
        """
        flow_rows, flow_most = _flow(around.machine, wish)
        alpha = min(given.dt_s / self.ease_s, 1.0)

        def solved(rows: Rows) -> Solved:
            return share(
                *(plan.changes(rows)[WISH], _room(rows, alpha, self._floor_m), alpha),
                keep_direction=given.keep_direction,
                flow_rows=flow_rows,
                flow_most=flow_most,
                ends=plan.ends[WISH],
            )

        if inside is None:
            first = solved(stop.rows)
            return Chosen(stop.rows, first, self._verified(plan, stop, None, first.s * wish, TRIALS))
        others = inside.outside(stop.rows)
        if given.exit_share is not None:  # sought and verified already: but for the pump and the joints' ends
            none = picked(others, np.zeros(len(others.slack), np.bool_))
            first = solved(none)
            return Chosen(none, first, self._verified(plan, stop, inside, first.s * wish, EXIT_TRIALS))
        far = inside.beyond(stop.rows)
        first = solved(far)
        if inside.spares(first.s * wish, alpha) and self._stands(plan, stop, inside, first.s * wish):
            return Chosen(far, first, 1.0)
        first = solved(others)
        found = Chosen(others, first, self._verified(plan, stop, inside, first.s * wish, ()))
        if found.kept:
            return found
        bound = solved(stop.rows)
        found = Chosen(stop.rows, bound, self._verified(plan, stop, inside, bound.s * wish, TRIALS))
        if (found.kept * bound.s * wish).any():
            return found
        rows = joined([inside.rows(), others, inside.cuts(first.s * wish)])
        for _ in range(CUTS):
            exact = solved(rows)
            command = exact.s * wish
            if not command.any():
                break
            kept = self._verified(plan, stop, inside, command, TRIALS)
            if kept:
                return Chosen(rows, exact, kept)
            rows = joined([rows, inside.cuts(0.25 * command)])
        return found

    def _ranges(self, given: GuardInput, plan: Plan, stop: Stop, inside: Inside | None) -> LeverRanges:
        """Return what each lever alone may still do; inside a limit, each end is verified, or none is left."""
        alpha = min(given.dt_s / self.ease_s, 1.0)

        def ranges(rows: Rows) -> LeverRanges:
            changes = plan.changes(rows)
            return lever_ranges(
                *(changes[PLUS], changes[MINUS], _room(rows, alpha, self._floor_m), alpha),
                *(given.speed_positive, given.speed_negative, np.asarray(given.tool_rates)),
                ends_positive=plan.ends[PLUS],
                ends_negative=plan.ends[MINUS],
                clearance_of=np.concatenate([rows.clearances, rows.clearances]),
            )

        if inside is None:
            return ranges(stop.rows)
        return verified_ranges(
            *(ranges(inside.beyond(stop.rows)), ranges(inside.outside(stop.rows)), ranges(stop.rows)),
            np.asarray(given.tool_rates),
            lambda command: self._stands(plan, stop, inside, command),
            lambda command: inside.spares(command, alpha),
        )

    def _inside(self, around: Surroundings, given: GuardInput, plan: Plan, stop: Stop) -> Inside | None:
        """Return exact measures of what the stop in hand is inside of, None if it is inside of nothing."""
        if stop.least >= -INSIDE_M:
            return None
        return self._measured(around, given, plan, stop)

    def _measured(self, around: Surroundings, given: GuardInput, plan: Plan, stop: Stop) -> Inside:
        return Inside(
            *(around, given.q, plan, stop),
            stop_distance_m=self.stop_distance_m,
            margin_m=self.margin_m,
            floor_m=self._floor_m,
        )

    def _seeker(self, given: GuardInput, plan: Plan, stop: Stop, inside: Inside) -> Seeker:
        return Seeker(
            *(given, stop, inside, lambda command: self._stands(plan, stop, inside, command)),
            settle_s=self.cushion_s,
            alpha=min(given.dt_s / self.ease_s, 1.0),
        )

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
    ) -> Sought | None:
        """Return the command that leads out of what the machine would come to rest inside of, and how."""
        every = np.maximum(given.speed_positive, given.speed_negative)  # whatever the way out may come near
        plan, stop = self._rolled(around, given, motion, every)
        if not (stop.rows.slack < 0.0).any():
            return None
        seeker = self._seeker(given, plan, stop, self._measured(around, given, plan, stop))
        return seeker.seek(min(max(given.exit_share or 0.0, 0.0), 1.0))

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

    def _verified(
        self, plan: Plan, stop: Stop, inside: Inside | None, command: Floats, trials: tuple[float, ...]
    ) -> float:
        """Return what of a command is verified: all, or so much of it as the first of the trials says, or nothing."""
        if stop.free or not command.any():
            return 1.0
        for kept in (1.0, *trials):
            if self._stands(plan, stop, inside, command * kept):
                return kept
        return 0.0

    def _stands(self, plan: Plan, stop: Stop, inside: Inside | None, command: Floats) -> bool:
        """Return whether a command is verified: still stops in time, and nothing that is violated gets worse."""
        way, judged = plan.way_after(command), None if inside is None else inside.judged
        if stop.shortfall(way, self._floor_m, judged) > SHORT_M:
            return False
        return inside is None or not inside.worsens(way)


def _room(rows: Rows, alpha: float, floor_m: float) -> Floats:
    """Return what each row of `Plan.changes` may lose, as the programme counts: a share alpha of what is here.

    What has none left, but more than -floor_m, may lose `SHORT_M`, the less the nearer it is to that: a motion along
    a face, whose clearance grows to second order only, is none towards it. A command is verified all the same.
    """
    found: Floats = losable(rows.room, rows.slack, rows.inside, alpha, floor_m, SHORT_M)
    return found


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
    speeds, flows = (machine.speed_positive, machine.speed_negative), (pump.flow_positive, pump.flow_negative)
    return flow_row(wish, speeds, flows, float(pump.flow)), np.ones(1)


def _scale(shares: Floats, wish: Floats) -> float:
    """Return what shares leave of a wish: along it, 0 to 1."""
    whole = float(wish @ wish)
    return min(float((shares * wish) @ wish) / whole, 1.0) if whole > 0.0 else 1.0
