"""A programme of steps and stops for every joint, driven on a simulated machine and logged as a real one would be."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.record.writer import LogWriter
from workgauge.sim.hydraulics import HydraulicSpec
from workgauge.sim.joints import HydraulicJoints
from workgauge.values.arrays import Floats, frozen
from workgauge.values.commands import VALVE_FULL, ValveCommand
from workgauge.values.measurements import Posture, Stamp

#: Lever positions, each held and let go in both directions.
LEVELS = (1.0, 0.25, 0.75, 0.45, 1.0, 0.6)
#: The valve that brings a joint to where a motion begins.
APPROACH = 0.4
#: Share of a joint's range a motion may use.
_ROOM = 0.85


@dataclass(frozen=True, slots=True)
class Encoders:
    """How positions are measured.

    Attributes:
        sigma: standard deviation [rad, m]. step: quantisation [rad, m], 0 for none. seed: of the noise.
    """

    sigma: float = 0.0005
    step: float = 0.0005
    seed: int = 1


def rehearse_steps(
    machine: MachineModel,
    path: Path,
    *,
    spec: HydraulicSpec | None = None,
    encoders: Encoders | None = None,
    joints: Sequence[int] | None = None,
    levels: Sequence[float] = LEVELS,
    tick_s: float = 0.01,
) -> None:
    """Drive the programme on a simulated machine and write its log.

    Each joint in turn moves to and fro, with room to its ends: a lever position, held until the speed is steady, let
    go, and left to come to rest.

    Args:
        machine: its ranges and speeds. path: of the log, which must not exist.
        spec: how its joints really follow; left out, as the machine's file says, with a dead band of 8 %.
        encoders: how positions are measured. joints: indices; all if left out. levels: of the valve.
        tick_s: period of commands and samples.

    Raises:
        InputError: if the log cannot be written.
    """
    spec = spec or HydraulicSpec.of_machine(machine, 0.08)
    header = {
        "machine": machine.name,
        "joints": list(machine.joint_names),
        "prismatic": [bool(one) for one in machine.prismatic],
        "tick_s": tick_s,
    }
    with LogWriter(path, header) as log:
        drive = _Drive(machine, spec, encoders or Encoders(), log, tick_s)
        for j in range(machine.n) if joints is None else joints:
            _joint(drive, machine, spec, j, levels)


def _joint(drive: "_Drive", machine: MachineModel, spec: HydraulicSpec, j: int, levels: Sequence[float]) -> None:
    """Move one joint to and fro."""
    lags, decelerations = _lag(spec), np.minimum(spec.deceleration, 1e9)
    span = float(machine.q_max[j] - machine.q_min[j])
    room = _ROOM * span if math.isfinite(span) else math.inf
    for level in levels:
        for side, sign in ((0, 1), (1, -1)):
            dead, lag = float(spec.dead_time_s[side, j]), float(lags[side, j])
            a, full = float(decelerations[side, j]), float(spec.full_speed[side, j])
            valve, hold, speed = level, 0.0, 0.0
            while valve > 0.2:
                speed = full * valve
                hold = 1.2 * (dead + speed / a + 7.0 * lag) + 0.9
                if speed * (hold + dead + lag + speed / (2.0 * a)) <= room:
                    break
                valve -= 0.1
            drive.make_room(j, sign, speed * (hold + dead + lag + speed / (2.0 * a)))
            drive.hold(j, sign * valve, hold)
            drive.hold(j, 0.0, 1.3 * (dead + speed / a + 7.0 * lag) + 0.7)


def _lag(spec: HydraulicSpec) -> Floats:
    """Return the time constants, of a second-order response those of its decay."""
    if spec.natural_frequency is None:
        return spec.lag_s
    damping = 0.7 if spec.damping is None else spec.damping
    with np.errstate(divide="ignore"):
        decay = 1.0 / (damping * spec.natural_frequency)
    return np.where(spec.natural_frequency > 0.0, decay, spec.lag_s)


class _Drive:
    """The simulated joints, their encoders and the log, tick by tick."""

    def __init__(
        self, machine: MachineModel, spec: HydraulicSpec, encoders: Encoders, log: LogWriter, tick_s: float
    ) -> None:
        self._spec = spec
        self._machine, self._joints = machine, HydraulicJoints(machine, spec)
        self._q = np.array(machine.home)
        self._encoders, self._rng = encoders, np.random.default_rng(encoders.seed)
        self._log, self._tick_s, self._tick_ns = log, tick_s, round(tick_s * 1e9)
        self._now_ns, self._sequence = 0, 0

    def hold(self, j: int, valve: float, seconds: float) -> None:
        """Hold one valve for a time, the others closed."""
        valves = [0] * len(self._q)
        valves[j] = round(valve * VALVE_FULL)
        for _ in range(max(math.ceil(seconds / self._tick_s), 1)):
            self._tick(valves)

    def make_room(self, j: int, sign: int, way: float) -> None:
        """Bring a joint back if it would run onto its end."""
        ends = float(self._machine.q_min[j]), float(self._machine.q_max[j])
        if not ends[0] <= float(self._q[j]) + sign * way <= ends[1]:
            middle, spare = 0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0] - way)
            self.approach(j, middle - sign * (0.5 * way + 0.5 * spare))

    def approach(self, j: int, position: float) -> None:
        """Bring a joint near a position by moves of the right length, and let it come to rest after each."""
        spec = self._spec
        for _ in range(4):
            away = position - float(self._q[j])
            side = 0 if away > 0.0 else 1
            band = float(spec.dead_band[side, j])
            speed = float(spec.full_speed[side, j]) * max(APPROACH - band, 0.05) / (1.0 - band)
            seconds = abs(away) / speed
            if seconds < 0.5:
                return
            self.hold(j, math.copysign(APPROACH, away), seconds)
            self.hold(j, 0.0, 3.0 + 2.0 * float(spec.dead_time_s[side, j]))

    def _tick(self, valves: list[int]) -> None:
        e, now = self._encoders, self._now_ns
        measured = self._q + e.sigma * self._rng.standard_normal(len(self._q))
        if e.step:
            measured = np.round(measured / e.step) * e.step
        stamp = Stamp("rehearsal", now, "encoders")
        sigma = math.sqrt(e.sigma**2 + e.step**2 / 12.0)
        self._log.write("/posture", now, Posture(stamp, frozen(measured), frozen(np.full(len(self._q), sigma))))
        command = ValveCommand(Stamp("rehearsal", now, "programme"), self._sequence, tuple(valves), True)
        self._log.write("/valves", now, command)
        self._joints.set_valves(valves)
        self._q = self._joints.advance(self._tick_s, self._q)
        self._now_ns, self._sequence = now + self._tick_ns, self._sequence + 1
