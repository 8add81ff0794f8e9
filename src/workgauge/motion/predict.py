"""Where the joints will be when a command given now begins to act: commands in flight through dead time and lag."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.machine.stopping import StoppingModel
from workgauge.values.arrays import Floats, Ints, frozen, frozen_ints

#: Gain times the time that stays in the loop.
STEADY = 0.75


@dataclass(frozen=True, slots=True, eq=False)
class Lateness:
    """How late each joint follows, for one tick's period: the mean of its two directions.

    Attributes:
        dead_s, lag_s: (n,) dead time and first-order lag [s].
        ticks: (n,) whole ticks of dead time.
        keep: (n,) share of a joint's speed left after one tick of its lag.
        held: (n,) way a joint's present speed still makes until the dead time is over, per unit of speed [s].
        flying: (H, n) the same of each command in flight, the newest last, per unit of velocity [s].
        newest: (H, n) share of each of them in the speed at that time.
        acting: (n,) which of the commands in flight and the newest, one after the other, a joint obeys now.
    """

    dead_s: Floats
    lag_s: Floats
    ticks: Floats
    keep: Floats
    held: Floats
    flying: Floats
    newest: Floats
    acting: Ints

    @classmethod
    def of(cls, machine: MachineModel, dt_s: float) -> "Lateness":
        """Return the lateness that a machine's file gives its joints."""
        model = StoppingModel.of(machine)
        dead, lag = model.dead_time_s.mean(axis=0), model.lag_s.mean(axis=0)
        ticks = np.round(dead / dt_s)
        keep = np.where(lag > 0.0, np.exp(-dt_s / np.maximum(lag, 1e-9)), 0.0)
        longest = int(ticks.max(initial=0.0))
        flying, newest = np.zeros((longest, machine.n)), np.zeros((longest, machine.n))
        held = np.zeros(machine.n)
        for j, count in enumerate(ticks.astype(int).tolist()):
            a = float(keep[j])
            held[j] = dt_s * sum(a**k for k in range(1, count + 1))
            for i in range(count):  # acts in tick i of the dead time, counted from now
                row = longest - count + i
                flying[row, j] = dt_s * (1.0 - a ** (count - i))
                newest[row, j] = (1.0 - a) * a ** (count - 1 - i)
        acting = frozen_ints((longest - ticks) * machine.n + np.arange(machine.n))
        return cls(
            *(frozen(dead), frozen(lag), frozen(ticks), frozen(keep)),
            *(frozen(held), frozen(flying), frozen(newest)),
            acting,
        )


@lru_cache(maxsize=16)
def lateness(machine: MachineModel, dt_s: float) -> Lateness:
    """Return the lateness of a machine's joints at a tick's period."""
    return Lateness.of(machine, dt_s)


@dataclass(frozen=True, slots=True)
class InFlight:
    """What is on its way to the joints; numbers alone, so that it survives JSON.

    Attributes:
        speeds: (n) present joint speeds as the model has them [rad/s, m/s].
        commands: (H * n) velocities sent, the oldest first.
    """

    speeds: tuple[float, ...] = ()
    commands: tuple[float, ...] = ()

    def after(self, sent: Floats, late: Lateness) -> "InFlight":
        """Return what is in flight one tick later, `sent` (n,) being the newest command [rad/s, m/s]."""
        n, longest = len(sent), len(late.flying)
        speeds, before = self.arrays(n, longest)
        commands = np.concatenate([before.ravel(), sent])
        acting = commands[late.acting]
        speeds = acting + late.keep * (speeds - acting)
        return InFlight(tuple(speeds.tolist()), tuple(commands[n:].tolist()))

    def ahead(self, q: Floats, late: Lateness) -> tuple[Floats, Floats]:
        """Return joint positions and speeds (n,) when a command of now begins to act, each at its own moment."""
        speeds, commands = self.arrays(len(q), len(late.flying))
        there = q + late.held * speeds + (late.flying * commands).sum(axis=0)
        return there, late.keep**late.ticks * speeds + (late.newest * commands).sum(axis=0)

    def arrays(self, n: int, longest: int) -> tuple[Floats, Floats]:
        """Return speeds (n,) and commands (longest, n); zeros where nothing is known, as of a machine at rest."""
        speeds = np.array(self.speeds) if len(self.speeds) == n else np.zeros(n)
        commands = np.array(self.commands).reshape(-1, n) if len(self.commands) == longest * n else None
        return speeds, np.zeros((longest, n)) if commands is None else commands


@lru_cache(maxsize=16)
def steadiest_1_s(machine: MachineModel, dt_s: float) -> Floats:
    """Return the highest gains (n,) [1/s] that late joints bear without swinging.

    What dead time is known is made up for; what stays in the loop is the lag, how far the dead time may be from what
    is assumed (the file's tolerance, and half of what its two directions differ by), and the tick. A gain times what
    stays is `STEADY` at most: a damping ratio of 0.58 with a lag, a phase margin of 47 degrees with dead time.
    """
    model = StoppingModel.of(machine)
    unsure = (model.tolerance * model.dead_time_s).max(axis=0) + 0.5 * np.abs(np.diff(model.dead_time_s, axis=0)[0])
    lag = ((1.0 + model.tolerance) * model.lag_s).max(axis=0)
    return frozen(STEADY / (unsure + lag + dt_s))


def settles_s(machine: MachineModel) -> float:
    """Return the longest dead time and lag of any joint together [s]."""
    model = StoppingModel.of(machine)
    longest = (model.dead_time_s + model.lag_s).max(initial=0.0)
    return float(longest) if math.isfinite(longest) else 0.0
