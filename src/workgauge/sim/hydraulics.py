"""Hydraulic joints: dead band, dead time, lag, limited acceleration, cylinders, one pump for all."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from workgauge.machine.cylinder import Cylinder
from workgauge.machine.model import MachineModel
from workgauge.machine.parts import Pump
from workgauge.machine.stopping import StoppingModel
from workgauge.sim.response import BAND, DAMPING, DELAY, DOWN, FLOW, FREQUENCY, FULL, INSTANT, LAG, ROWS, UP, run
from workgauge.values.arrays import Floats
from workgauge.values.errors import MachineError

#: Room for this many commands in flight at first.
_ROOM = 256


@dataclass(frozen=True, slots=True)
class Change:
    """Joints that behave otherwise for a time: cold oil, a worn valve. Factors of several changes multiply.

    Attributes:
        from_s, until_s: on the plant's clock [s].
        joints: their indices, or None for all.
        dead_time, lag, deceleration, speed, dead_band: factors on what the spec says; deceleration on both limits,
            lag also divides a natural frequency.
        flow: factor on the pump's flow.
    """

    from_s: float
    until_s: float = math.inf
    joints: tuple[int, ...] | None = None
    dead_time: float = 1.0
    lag: float = 1.0
    deceleration: float = 1.0
    speed: float = 1.0
    dead_band: float = 1.0
    flow: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class HydraulicSpec:
    """How the joints of a simulated machine follow their valves; all arrays (2, n), positive direction first.

    Attributes:
        dead_time_s, lag_s, deceleration: as in `StoppingModel`; deceleration limits how fast a speed falls.
        dead_band: share of the valve's travel that does nothing, 0 to below 1.
        full_speed: joint speed at the full valve [rad/s, m/s]; with a cylinder, where that turns it fastest.
        valve_rate: share of the valve's travel per second at most, inf for none.
        pump: shared flow, or None for enough.
        acceleration: limits how fast a speed rises; the deceleration if None.
        natural_frequency: of a second-order response [rad/s]; 0 for the first-order lag. None for all zero.
        damping: ratio of the second-order response. None for 0.7.
        cylinders: (n) or empty.
        script: what changes when.
    """

    dead_time_s: Floats
    lag_s: Floats
    deceleration: Floats
    dead_band: Floats
    full_speed: Floats
    valve_rate: float = math.inf
    pump: Pump | None = None
    acceleration: Floats | None = None
    natural_frequency: Floats | None = None
    damping: Floats | None = None
    cylinders: tuple[Cylinder | None, ...] = ()
    script: tuple[Change, ...] = ()

    @classmethod
    def of(cls, model: StoppingModel, full_speed: Floats, pump: Pump | None = None) -> "HydraulicSpec":
        """Return joints that stop exactly as the model says, without a dead band."""
        return cls(
            model.dead_time_s, model.lag_s, model.deceleration, np.zeros_like(full_speed), full_speed, math.inf, pump
        )

    @classmethod
    def of_machine(cls, machine: MachineModel, dead_band: float = 0.0) -> "HydraulicSpec":
        """Return the joints a machine's own file describes, with one dead band for all."""
        full = np.stack([machine.speed_positive, machine.speed_negative])
        plain = cls.of(StoppingModel.of(machine), full, machine.pump)
        return replace(plain, dead_band=np.full_like(full, dead_band), cylinders=machine.cylinders)

    def varied(self, seed: int, tolerance: Floats | float, *, at_the_ends: bool = False) -> "HydraulicSpec":
        """Return a machine drawn from all within a tolerance of this one; the same for the same seed.

        Dead time, lag and dead band lie from `1 - tolerance` to `1 + tolerance` of the spec's, accelerations and
        decelerations from `1 / (1 + tolerance)` to `1 + tolerance`, full speeds from `1 / (1 + tolerance)` to 1: no
        machine is faster than its file says.

        Args:
            seed: of the draw. tolerance: relative, one number or (2, n).
            at_the_ends: every parameter at one end of its range or the other, as a stop needs to be tested.
        """
        draw = np.random.default_rng(seed)
        t = np.broadcast_to(np.asarray(tolerance, dtype=np.float64), self.full_speed.shape)

        def factor(low: Floats, high: Floats) -> Floats:
            share = draw.random(self.full_speed.shape)
            return np.asarray(low + (high - low) * (np.round(share) if at_the_ends else share))

        one, grown = np.ones_like(t), 1.0 + t
        times = factor(1.0 - t, grown), factor(1.0 - t, grown), factor(1.0 - t, grown)
        rates, speed = factor(1.0 / grown, grown), factor(1.0 / grown, one)
        return replace(
            self,
            dead_time_s=self.dead_time_s * times[0],
            lag_s=self.lag_s * times[1],
            dead_band=np.minimum(self.dead_band * times[2], 0.95),
            deceleration=self.deceleration * rates,
            acceleration=None if self.acceleration is None else self.acceleration * rates,
            natural_frequency=None if self.natural_frequency is None else self.natural_frequency / times[1],
            full_speed=self.full_speed * speed,
        )

    def block(self, t_s: float) -> tuple[Floats, float, float]:
        """Return the parameters (ROWS, 2, n) and the pump's flow at a time, and until when they stay so [s]."""
        rising = self.deceleration if self.acceleration is None else self.acceleration
        rows = np.zeros((ROWS, *self.full_speed.shape))
        rows[DELAY], rows[LAG], rows[BAND], rows[FULL] = self.dead_time_s, self.lag_s, self.dead_band, self.full_speed
        rows[UP], rows[DOWN] = rising, self.deceleration
        rows[DAMPING] = 0.7 if self.damping is None else self.damping
        if self.natural_frequency is not None:
            rows[FREQUENCY] = self.natural_frequency
        flow = math.inf
        if self.pump is not None:
            rows[FLOW] = self.pump.flow_positive, self.pump.flow_negative
            flow = self.pump.flow
        until = math.inf
        for change in self.script:
            until = min([until, *(at for at in (change.from_s, change.until_s) if at > t_s)])
            if not change.from_s <= t_s < change.until_s:
                continue
            j = slice(None) if change.joints is None else list(change.joints)
            factors = np.ones(ROWS)
            factors[[DELAY, LAG, UP, DOWN, FULL, BAND]] = (
                *(change.dead_time, change.lag, change.deceleration, change.deceleration),
                *(change.speed, change.dead_band),
            )
            factors[FREQUENCY] = 1.0 / change.lag
            rows[:, :, j] *= factors[:, None, None]
            flow *= change.flow
        rows[[UP, DOWN]] = np.minimum(rows[[UP, DOWN]], INSTANT)
        rows[BAND] = np.minimum(rows[BAND], 0.95)
        return rows, flow, until

    def checked(self) -> "HydraulicSpec":
        """Return the spec itself.

        Raises:
            MachineError: if an array has another shape or a number makes no sense, naming it.
        """
        shape = self.full_speed.shape
        rising = self.deceleration if self.acceleration is None else self.acceleration
        frequency = np.zeros(shape) if self.natural_frequency is None else self.natural_frequency
        damping = np.ones(shape) if self.damping is None else self.damping
        for name, array, fine, allowed in (
            ("dead_time_s", self.dead_time_s, self.dead_time_s >= 0.0, "0 or more, finite"),
            ("lag_s", self.lag_s, self.lag_s >= 0.0, "0 or more, finite"),
            ("dead_band", self.dead_band, (self.dead_band >= 0.0) & (self.dead_band < 1.0), "0 to below 1"),
            ("full_speed", self.full_speed, self.full_speed > 0.0, "above 0, finite"),
            ("natural_frequency", frequency, frequency >= 0.0, "0 or more, finite"),
            ("damping", damping, damping > 0.0, "above 0, finite"),
            ("deceleration", 1.0 / self.deceleration, self.deceleration > 0.0, "above 0"),
            ("acceleration", 1.0 / rising, rising > 0.0, "above 0"),
        ):
            if array.shape != shape or len(shape) != 2 or shape[0] != 2:
                raise MachineError("two directions by joints expected", element=name, value=array.shape)
            if not (fine.all() and np.isfinite(array).all()):
                raise MachineError("out of range", element=name, value=array.tolist(), allowed=allowed)
        if not self.valve_rate > 0.0:
            raise MachineError("out of range", element="valve_rate", value=self.valve_rate, allowed="above 0")
        if self.cylinders and len(self.cylinders) != shape[1]:
            raise MachineError("one cylinder or none per joint", element="cylinders", value=len(self.cylinders))
        return self

    def checked_for(self, joints: int) -> "HydraulicSpec":
        """Return the spec itself, checked, for a machine with so many joints; else `MachineError`."""
        if self.full_speed.shape != (2, joints):
            raise MachineError(
                "two directions by joints expected",
                element="full_speed",
                value=self.full_speed.shape,
                allowed=f"(2, {joints})",
            )
        return self.checked()


@dataclass(slots=True, eq=False)
class _Commands:
    """When which valves were set; the first entry stands for ever before."""

    times: Floats
    valves: Floats
    count: int = 1
    last: Floats = field(init=False)

    def __post_init__(self) -> None:
        self.last = self.valves[0].copy()

    def put(self, t: float, valve: Floats, keep_from: float) -> None:
        """Take in valves set at t; of those that no longer act since `keep_from` only the last is kept."""
        self.last = valve.copy()
        if self.count == len(self.times):
            old = int(np.searchsorted(self.times[1 : self.count], keep_from, side="right"))
            self.count -= old
            self.times[: self.count] = self.times[old : old + self.count].copy()
            self.valves[: self.count] = self.valves[old : old + self.count].copy()
            if self.count > len(self.times) // 2:
                self.times = np.concatenate([self.times, np.empty_like(self.times)])
                self.valves = np.concatenate([self.valves, np.empty_like(self.valves)])
        self.times[self.count], self.valves[self.count] = t, valve
        self.count += 1


class Hydraulics:
    """The joints' state; `advance` moves it on, exactly as long as the valves stay and no valve rate acts.

    Args:
        spec: how they follow. substep_s: step of `advance` unless it is told another, and the length of the pieces
            where no closed form is known: a moving spool, a second-order response that a limit cuts.

    Raises:
        MachineError: if the spec contradicts itself.
    """

    def __init__(self, spec: HydraulicSpec, substep_s: float = 0.0025) -> None:
        if not 0.0 < substep_s < math.inf:
            raise MachineError("a substep takes time", element="substep_s", value=substep_s, allowed="above 0")
        self.spec = spec.checked()
        self.t_s = 0.0
        self._h = substep_s
        n = spec.full_speed.shape[1]
        self.velocity = np.zeros(n)
        self._speed, self._slope, self._spool = np.zeros(n), np.zeros(n), np.zeros(n)
        self._commands = _Commands(np.full(_ROOM, -math.inf), np.zeros((_ROOM, n)))
        self._block, self._flow, self._until = spec.block(0.0)
        slowest = max((one.dead_time for one in spec.script), default=1.0)
        overlap = max(slowest, 1.0) ** max(len(spec.script), 1)
        self._longest = float(spec.dead_time_s.max(initial=0.0)) * overlap

    def advance(self, valve: Floats, q: Floats | None = None, dt_s: float | None = None) -> Floats:
        """Return the displacement (n,) over a step with the valves asked for at `valve` (n,), -1 to 1.

        Args:
            valve: (n,) set at the beginning of the step.
            q: (n,) joint positions at the beginning; needed where there are cylinders.
            dt_s: length of the step, one substep if left out [s].
        """
        end = self.t_s + (self._h if dt_s is None else dt_s)
        way = np.zeros(len(self._speed))
        for begin, stop in self._moves(np.asarray(valve, dtype=np.float64), end):
            way += self._run(begin, stop)
        self.t_s = end
        if q is None or not self.spec.cylinders:
            self.velocity = self._speed.copy()
            return way
        gains = np.ones(len(way))
        for j, cylinder in enumerate(self.spec.cylinders):
            if cylinder is not None:
                after = cylinder.moved(float(q[j]), float(way[j]))
                way[j], gains[j] = after - q[j], cylinder.gain(after)
        self.velocity = gains * self._speed
        return way

    def block_joints(self, at_end: Sequence[bool]) -> None:
        """Bring joints that ran onto their stops to rest."""
        held = np.asarray(at_end, dtype=np.bool_)
        for state in (self._speed, self._slope, self.velocity):
            state[held] = 0.0

    def _moves(self, valve: Floats, end: float) -> list[tuple[float, float]]:
        """Set the valves and return the pieces of time until `end`; a spool that must move does so piece by piece."""
        begin, rate, keep_from = self.t_s, self.spec.valve_rate, self.t_s - self._longest
        if (valve == self._spool).all() and (valve == self._commands.last).all():
            return [(begin, end)]
        if math.isinf(rate):
            self._spool = valve.copy()
            self._commands.put(begin, valve, keep_from)
            return [(begin, end)]
        steps = max(math.ceil((end - begin) / self._h - 1e-9), 1)
        cuts = [begin + (end - begin) * k / steps for k in range(steps)] + [end]
        for at, until in pairwise(cuts):
            moving = np.abs(valve - self._spool) / rate  # how long it still moves
            share = np.minimum(moving, until - at) / (until - at)
            after = self._spool + np.clip(valve - self._spool, -rate * (until - at), rate * (until - at))
            mean = share * 0.5 * (self._spool + after) + (1.0 - share) * after
            self._spool = after
            self._commands.put(at, mean, keep_from)
        return list(pairwise(cuts))

    def _run(self, t: float, end: float) -> Floats:
        """Move the speeds on and return the ways (n,), cut wherever the script changes something."""
        way = np.zeros(len(self._speed))
        while t < end:
            if t >= self._until:
                self._block, self._flow, self._until = self.spec.block(t)
            stop = min(end, self._until)
            commands = self._commands
            way += run(
                *(commands.times, commands.valves, commands.count, t, stop),
                *(self._block, self._flow, self._h, self._speed, self._slope),
            )
            t = stop
        return way
