"""How a certificate's real machines differ from what the guard is told: within the stopping model, or beyond it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.machine.stopping import StoppingModel
from workgauge.rehearse.drives.bus import IN_TIME, BusSettings
from workgauge.rehearse.drives.draw import Drive, DriveSettings
from workgauge.rehearse.drives.dynamics import Dynamics
from workgauge.values.errors import InputError

#: The tick's period, and into how many steps a tick of the simulated machine is cut.
DT_S, SUBSTEPS = 0.02, 4
#: What a link comes this near to beyond its stop distance is told by kind and link [m].
NEAR_M = 0.5
#: Share of ticks at which a computer that misses ticks begins to.
MISSED = 0.1
#: Drives per injected delay, of those within the model.
SHARE_BEYOND = 0.25
#: So many drives one seed has.
MOST_DRIVES = 1_000_000
#: Longest dead time that may be injected [s].
LONGEST_S = 5.0

Truth = Literal["believed", "within", "ends"]


@dataclass(frozen=True, slots=True)
class Condition:
    """How the real machine of some drives differs from what the guard is told.

    Attributes:
        key: short name. words: what it is.
        within: whether the stopping model covers it, so that it counts for the verdict.
        truth: what is drawn, see `Dynamics`. bus: between the tick and the valves.
        extra_s: the real dead time is the file's and this; None for one drawn with the rest [s].
    """

    key: str
    words: str
    within: bool
    truth: Truth = "within"
    bus: BusSettings = IN_TIME
    extra_s: float | None = None

    def settings(self, machine: MachineModel, stop_distance_m: float, seconds: float) -> DriveSettings:
        """Return the settings of its drives."""
        return DriveSettings(
            dynamics=Dynamics(dead_time_s=None, truth=self.truth, pump=machine.pump is not None),
            seconds=seconds,
            dt_s=DT_S,
            substeps=SUBSTEPS,
            stop_distance_m=stop_distance_m,
            near_m=NEAR_M,
        )

    def applied(self, drive: Drive) -> Drive:
        """Return a drive drawn with its settings, the real dead time as the condition has it.

        What a late bus may add is taken off the end of the tolerance, so that both together stay within it.
        """
        model, real = StoppingModel.of(drive.machine), drive.hydraulics
        if self.extra_s is not None:
            return replace(drive, hydraulics=replace(real, dead_time_s=model.dead_time_s + self.extra_s))
        late_s = self.bus.longest_s(drive.settings.dt_s)
        if not late_s:
            return drive
        latest = np.maximum(model.slowest().dead_time_s - late_s, 0.0)
        return replace(drive, hydraulics=replace(real, dead_time_s=np.minimum(real.dead_time_s, latest)))


@dataclass(frozen=True, slots=True)
class Task:
    """One drive of a certificate: its condition's key, and its seed."""

    condition: str
    seed: int


def room_s(machine: MachineModel) -> float:
    """Return by how much every dead time may be longer than the file says, within its tolerance [s]."""
    model = StoppingModel.of(machine)
    return float((model.slowest().dead_time_s - model.dead_time_s).min())


def conditions(machine: MachineModel, delays_s: Sequence[float]) -> tuple[Condition, ...]:
    """Return the conditions of a machine's certificate, those within its stopping model first.

    Args:
        machine: as its file has it. delays_s: dead time injected beside those [s].

    Raises:
        InputError: for a delay that is none.
    """
    if not StoppingModel.of(machine).tolerance.any():
        found = [Condition("as described", "every joint stops just as the machine's file says", True, "believed")]
    else:
        found = [
            Condition("tolerance", "stopping drawn within the tolerance, half of the drives at its ends", True),
            Condition("ends", "stopping at the ends of the tolerance", True, "ends"),
        ]
    room = room_s(machine)
    step = DT_S / SUBSTEPS
    late_s = round(math.floor(room / step + 1e-9) * step, 6)
    if late_s:
        words = f"commands reach the valves up to {1000 * late_s:g} ms late, each by another time"
        found.append(Condition("late bus", words, True, bus=BusSettings(late_s=late_s)))
    missed = math.floor(room / DT_S + 1e-9)
    if missed:
        words = f"up to {missed} tick{'s' * (missed > 1)} in a row missed, every tenth tick a miss begins"
        found.append(Condition("missed ticks", words, True, bus=BusSettings(missed=MISSED, longest=missed)))
    for delay in sorted(set(delays_s)):
        if not 0.0 < delay <= LONGEST_S:
            raise InputError(
                "out of range", element="--dead-time", value=delay, allowed=f"above 0 to {LONGEST_S:g} s"
            )
        words = f"every dead time {delay:g} s longer than the file says"
        found.append(Condition(f"+{delay:g} s", words, delay <= room + 1e-12, extra_s=delay))
    return tuple(found)


def tasks(which: Sequence[Condition], drives: int, seed: int) -> tuple[Task, ...]:
    """Return what is to be driven: conditions within the model take turns, injected delays get a quarter each more.

    A longer list of one seed begins with the shorter one's drives.

    Raises:
        InputError: for a number of drives or a seed out of range.
    """
    for name, value, most in (("--drives", drives, MOST_DRIVES), ("--seed", seed + 1, MOST_DRIVES)):
        if not 1 <= value <= most:
            raise InputError("out of range", element=name, value=value, allowed=f"up to {most}")
    turns = [one for one in which if one.extra_s is None]
    found = [Task(turns[i % len(turns)].key, seed * MOST_DRIVES + i) for i in range(drives)]
    for one in which:
        if one.extra_s is not None:
            found += [Task(one.key, seed * MOST_DRIVES + i) for i in range(math.ceil(drives * SHARE_BEYOND))]
    return tuple(found)
