"""The posture now: solved from the newest readings, carried on by the joints' rates, jumps told.

Readings are some ten milliseconds old, in which a joint at full speed turns by a degree. So each joint is carried on
by its rate, the difference of its positions over `OVER_S`. With r = age / time the covariance grows by (1 + r)^2 +
r^2, exactly so for independent errors, and a joint in motion may have changed its speed: `a age (time + age) / 2`.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.positioning.memory import Bent, PostureMemory
from workgauge.positioning.posture import PostureSolution, PostureSolver, Reading
from workgauge.positioning.timing import Sample, at_time
from workgauge.values.arrays import Floats, freeze, frozen

#: Rates are differences over about this long, at least over `SHORTEST_S` [s].
OVER_S, SHORTEST_S = 0.1, 0.03
#: A joint is wholly in motion from this share of its highest speed.
IN_MOTION = 0.2
#: Where no deceleration is known, a joint reaches its speed in this time [s].
SPEED_UP_S = 0.5
#: A jump is one only after so many postures: the first of all may themselves be wrong.
SETTLED = 10


class Bender:
    """Solves and carries on the posture of one machine; immutable.

    Args:
        machine: with a `positioning` section. jump: a joint that moves more than this between two readings, beyond
            what its speed allows, has not moved [rad]; sliding joints, a tenth of it in metres.
    """

    def __init__(self, machine: MachineModel, solver: PostureSolver, jump: float) -> None:
        self.machine, self.solver = machine, solver
        self._turning = [not slides for slides in machine.prismatic.tolist()]
        self._speed = np.maximum(machine.speed_positive, machine.speed_negative).tolist()
        self._jump = [jump if turning else 0.1 * jump for turning in self._turning]
        self._acceleration = []
        for one, other, speed in zip(machine.stopping_positive, machine.stopping_negative, self._speed, strict=True):
            found = max(one.deceleration, other.deceleration)
            self._acceleration.append(found if math.isfinite(found) else speed / SPEED_UP_S)
        assert machine.positioning is not None
        names = [channel.name for channel in solver.channels]
        by_joint = {joint.joint: names.index(joint.sensor) for joint in machine.positioning.joints}
        #: The channel of each joint's own sensor.
        self.channel_of = tuple(by_joint[name] for name in machine.joint_names)

    def measured(self, samples: Sequence[Sequence[Sample]], memory: PostureMemory) -> PostureMemory:
        """Return the memory with the posture of the newest readings; unchanged if one is missing or tells nothing."""
        if not all(samples):
            return memory
        newest = [channel[-1] for channel in samples]
        solution = self.solver.solve([sample.reading for sample in newest])
        q: list[float] = solution.q.tolist()
        if any(value != value for value in q):
            return memory
        valid = tuple(newest[channel].valid_ns for channel in self.channel_of)
        now = max(valid)
        oldest = now - round(OVER_S * 1e9)
        recent = [bent for bent in memory.recent if oldest <= max(bent.valid_ns)]
        jumped = self._jumps(memory, valid, q)
        if any(jumped) and jumped != memory.jumped:
            recent = []
        bent = Bent(valid, tuple(q))
        rates, over = self._rates(recent[0], bent) if recent else ((0.0,) * len(q), math.inf)
        return replace(
            memory,
            recent=(*recent, bent),
            covariance=solution.covariance,
            rates=rates,
            over_s=over,
            jumped=jumped,
            seen=min(memory.seen + 1, SETTLED),
        )

    def _rates(self, first: Bent, last: Bent) -> tuple[tuple[float, ...], float]:
        over = (max(last.valid_ns) - max(first.valid_ns)) * 1e-9
        if over < SHORTEST_S:
            return (0.0,) * len(last.q), math.inf
        rates = []
        for i, (a, b) in enumerate(zip(first.q, last.q, strict=True)):
            dt = (last.valid_ns[i] - first.valid_ns[i]) * 1e-9
            rates.append(self._difference(i, a, b) / dt if dt > 0.5 * over else 0.0)
        return tuple(rates), over

    def _difference(self, joint: int, a: float, b: float) -> float:
        return math.remainder(b - a, 2.0 * math.pi) if self._turning[joint] else b - a

    def _jumps(self, memory: PostureMemory, valid: tuple[int, ...], q: list[float]) -> tuple[float | None, ...]:
        """Return by joint where it was before a jump that has not been taken back.

        A machine whose joint jumped stands still: the joint must be found again near where it was.
        """
        before = memory.recent[-1] if memory.recent else None
        known = memory.jumped or (None,) * len(q)
        if before is None:
            return known
        out: list[float | None] = []
        for i, value in enumerate(q):
            was = known[i]
            if was is not None:
                out.append(None if abs(self._difference(i, was, value)) <= self._jump[i] else was)
                continue
            dt = max(0, valid[i] - before.valid_ns[i]) * 1e-9
            moved = abs(self._difference(i, before.q[i], value))
            far = moved > self._jump[i] + self._speed[i] * dt
            out.append(before.q[i] if far and memory.seen >= SETTLED else None)
        return tuple(out)

    def now(self, memory: PostureMemory, now_ns: int) -> tuple[Floats, Floats] | None:
        """Return joint positions (n,) and their covariance (n, n) at a time, None before the first posture."""
        if not memory.recent or memory.covariance is None:
            return None
        bent = memory.recent[-1]
        ages = [(now_ns - valid) * 1e-9 for valid in bent.valid_ns]
        variances: list[float] = memory.covariance.diagonal().tolist()
        ratio = max(0.0, max(ages)) / memory.over_s
        over = 0.0 if memory.over_s == math.inf else memory.over_s
        q, extra = [], []
        for i, (age, rate) in enumerate(zip(ages, memory.rates, strict=True)):
            q.append(bent.q[i] + rate * age)
            unsure = math.sqrt(2.0 * variances[i]) / memory.over_s
            share = min(1.0, (abs(rate) + unsure) / (IN_MOTION * self._speed[i]))
            extra.append((0.5 * self._acceleration[i] * share * age * (over + age)) ** 2)
        covariance = ((1.0 + ratio) ** 2 + ratio**2) * memory.covariance
        covariance.reshape(-1)[:: len(q) + 1] += extra
        freeze(covariance)
        return frozen(q), covariance

    def at(
        self, samples: Sequence[Sequence[Sample]], memory: PostureMemory, t_ns: int, within_s: float
    ) -> tuple[PostureSolution, Reading] | None:
        """Return the posture and the tilt sensor's reading at a time, None if a sensor says nothing near it."""
        readings, late = [], []
        for channel, row in zip(self.solver.channels, samples, strict=True):
            found = at_time(row, t_ns, channel.turning)
            if found is None or found[1] > within_s:
                return None
            readings.append(found[0])
            late.append(found[1])
        solution = self.solver.solve(readings)
        if np.isnan(solution.q).any():
            return None
        if max(late) > 0.0 and memory.rates:
            q, covariance = np.array(solution.q), np.array(solution.covariance)
            for i, channel_index in enumerate(self.channel_of):
                if late[channel_index] > 0.0 and samples[channel_index][-1].valid_ns < t_ns:
                    way = memory.rates[i] * late[channel_index]
                    q[i] += way
                    covariance[i, i] += (0.5 * way) ** 2
            solution = PostureSolution(frozen(q), frozen(covariance), solution.tilt_cross)
        return solution, readings[0]
