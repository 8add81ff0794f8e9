"""What leaves the tick: integer valve commands."""

from dataclasses import dataclass

from workgauge.values.measurements import Stamp

#: Full valve opening. Valve commands are integers in [-VALVE_FULL, VALVE_FULL], one per joint; 0 is neutral.
VALVE_FULL = 10_000


@dataclass(frozen=True, slots=True)
class ValveCommand:
    """One command for every joint's valve.

    Attributes:
        stamp: when it was made, and for which machine.
        sequence: counts up by one each tick, modulo 2**32.
        valves: (n,) integers in [-VALVE_FULL, VALVE_FULL].
        enable: the dead-man switch as the tick saw it.
    """

    stamp: Stamp
    sequence: int
    valves: tuple[int, ...]
    enable: bool

    @property
    def neutral(self) -> bool:
        """Whether no valve is open."""
        return not any(self.valves)
