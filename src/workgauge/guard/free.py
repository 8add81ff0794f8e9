"""No guard: what would happen without one, for comparison on a simulated machine."""

from dataclasses import dataclass

import numpy as np

from workgauge.guard.api import GuardInput, GuardResult, Memory, full_stop, unusable
from workgauge.guard.cushion import cushioned
from workgauge.guard.joints import one_group, within_speed
from workgauge.machine.model import MachineModel
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import InputError


@dataclass(frozen=True, slots=True)
class NoGuard:
    """Joint speeds, groups and ends are kept; limits are not. Never for a machine that is real.

    Attributes:
        cushion_s: time constant of the end cushion.
    """

    cushion_s: float = 0.3

    def __post_init__(self) -> None:
        if not 0.01 <= self.cushion_s <= 10.0:
            raise InputError(
                "guard parameter out of range", element="cushion_s", value=self.cushion_s, allowed="0.01 to 10"
            )

    @property
    def name(self) -> str:
        """Name it is registered under."""
        return "none"

    @property
    def steers_itself(self) -> bool:
        """Automatic motion comes as it is wanted, and goes as it came."""
        return True

    @property
    def reach_m(self) -> float:
        """It looks at no clearance."""
        return 0.0

    def start(self) -> Memory:
        """Return the memory of a guard that has done nothing yet."""
        return {"group": -1}

    def idle(
        self, sent: Floats | None, machine: MachineModel, dt_s: float, elapsed_s: float, memory: Memory
    ) -> Memory:
        """Return the memory after a tick in which nobody asked."""
        return self.start()

    def allow(self, given: GuardInput, memory: Memory) -> tuple[GuardResult, Memory]:
        """Return the velocity the joints can do. Numbers nobody can judge stop every joint."""
        wrong = unusable(given)
        if wrong is not None:
            return full_stop(len(given.joint_names), wrong), self.start()
        names = given.joint_names
        positive, negative = given.speed_positive.tolist(), given.speed_negative.tolist()
        velocity, reasons = within_speed(given.desired.tolist(), positive, negative, names)
        previous = memory.get("group")
        group = previous if isinstance(previous, int) else -1
        velocity, group, held = one_group(velocity, positive, negative, given.exclusive_groups, names, group)
        velocity, ends = cushioned(
            velocity,
            given.q.tolist(),
            (given.q_min.tolist(), given.q_max.tolist()),
            (positive, negative),
            names,
            dt_s=given.dt_s,
            cushion_s=self.cushion_s,
            keep_direction=given.keep_direction,
        )
        allowed = frozen(np.array(velocity))
        return GuardResult(allowed, (*reasons, *held, *ends), 1.0), {"group": group}
