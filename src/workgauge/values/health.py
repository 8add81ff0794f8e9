"""How far the machine's position may be trusted, and why not further."""

from dataclasses import dataclass
from enum import StrEnum

from workgauge.values.reasons import Reason


class HealthState(StrEnum):
    """State of the position, best first."""

    FIXED = "fixed"  #: ambiguities fixed, everything agrees
    FLOAT = "float"  #: a worse fix, believed with its own larger uncertainty
    DEAD_RECKONING = "dead_reckoning"  #: no fix; pose carried on by velocity and yaw rate, for a bounded time
    CHASSIS_FROZEN = "chassis_frozen"  #: no fix; the undercarriage is held not to move, the arm works on its sensors
    STOP = "stop"  #: position not to be used

    @property
    def usable(self) -> bool:
        """Whether the machine may move on it."""
        return self is not HealthState.STOP


@dataclass(frozen=True, slots=True)
class PositionHealth:
    """The state, since when on the tick's clock [ns], and every reason it is not better."""

    state: HealthState
    since_ns: int
    reasons: tuple[Reason, ...] = ()
