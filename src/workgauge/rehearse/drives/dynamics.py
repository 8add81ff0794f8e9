"""How a drive's joints follow their valves: what the guard is told, and what is true."""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.machine.parts import Stopping
from workgauge.machine.stopping import StoppingModel
from workgauge.sim.hydraulics import HydraulicSpec
from workgauge.values.arrays import Floats
from workgauge.values.errors import InputError


@dataclass(frozen=True, slots=True)
class Dynamics:
    """How a drive's machine follows and stops.

    Attributes:
        dead_time_s: of every joint; None for the machine's own file in all three.
        lag_s: first-order [s]. stop_s: full speed over deceleration [s]; 0 for joints without inertia.
        ratio: the joints, and the directions of one, differ by up to this factor in each of the three; 1 for not.
        tolerance: how well the guard is told it knows all that, relative; None for the machine file's, which is 0
            where `dead_time_s` is given.
        truth: `believed` for a real machine just as the guard is told, `within` for one anywhere within the tolerance
            or at its ends, half of the drives each; `ends` always at the ends.
        pump: whether the joints share the pump of the machine's file.
    """

    dead_time_s: float | None = 0.3
    lag_s: float = 0.2
    stop_s: float = 0.6
    ratio: float = 1.0
    tolerance: float | None = None
    truth: Literal["believed", "within", "ends"] = "believed"
    pump: bool = False

    def __post_init__(self) -> None:
        numbers = {"dead_time_s": self.dead_time_s or 0.0, "lag_s": self.lag_s, "stop_s": self.stop_s}
        for name, value in numbers.items():
            if not 0.0 <= value <= 10.0:
                raise InputError("out of range", element=name, value=value, allowed="0 to 10 s")
        if not 1.0 <= self.ratio <= 100.0:
            raise InputError("out of range", element="ratio", value=self.ratio, allowed="1 to 100")
        if self.tolerance is not None and not 0.0 <= self.tolerance < 1.0:
            raise InputError("out of range", element="tolerance", value=self.tolerance, allowed="0 to below 1")


#: Joints that follow their valves at once.
IDEAL = Dynamics(dead_time_s=0.0, lag_s=0.0, stop_s=0.0)


def believed_machine(machine: MachineModel, dynamics: Dynamics, rng: np.random.Generator) -> MachineModel:
    """Return the machine as the guard is told it is: its joints stop as the dynamics say.

    The draw takes the same numbers from `rng` whatever the dead time, so that drives of one seed differ in it alone.
    """
    factors = dynamics.ratio ** rng.uniform(-0.5, 0.5, (3, 2, machine.n))
    if dynamics.dead_time_s is None:
        model = StoppingModel.of(machine)
    else:
        speeds = np.stack([machine.speed_positive, machine.speed_negative])
        slowing = speeds / dynamics.stop_s if dynamics.stop_s > 0.0 else np.full_like(speeds, math.inf)
        times = np.full_like(speeds, dynamics.dead_time_s), np.full_like(speeds, dynamics.lag_s)
        model = StoppingModel(*times, slowing, np.zeros_like(speeds))
    model = StoppingModel(
        model.dead_time_s * factors[0],
        model.lag_s * factors[1],
        model.deceleration * factors[2],
        model.tolerance if dynamics.tolerance is None else np.full_like(model.tolerance, dynamics.tolerance),
    )
    positive, negative = (tuple(_stopping(model, side, j) for j in range(machine.n)) for side in (0, 1))
    return replace(
        machine,
        stopping_positive=positive,
        stopping_negative=negative,
        pump=machine.pump if dynamics.pump else None,
    )


def true_hydraulics(machine: MachineModel, dynamics: Dynamics, rng: np.random.Generator) -> HydraulicSpec:
    """Return how the joints of a `believed_machine` really follow their valves.

    Full speeds are those of the machine: its tolerance is of dead time, lag and deceleration.
    """
    seed, at_the_ends = int(rng.integers(2**31)), bool(rng.random() < 0.5)
    spec = replace(HydraulicSpec.of_machine(machine), cylinders=())
    if dynamics.truth == "believed":
        return spec
    tolerance = StoppingModel.of(machine).tolerance
    real = spec.varied(seed, tolerance, at_the_ends=at_the_ends or dynamics.truth == "ends")
    return replace(real, full_speed=spec.full_speed)


def flying_s(spec: HydraulicSpec) -> float:
    """Return the longest time a command sent now goes on acting [s]."""
    return float(np.max(spec.dead_time_s, initial=0.0))


def _stopping(model: StoppingModel, side: int, j: int) -> Stopping:
    rows: tuple[Floats, ...] = (model.dead_time_s, model.lag_s, model.deceleration, model.tolerance)
    return Stopping(*(float(row[side, j]) for row in rows))
