"""What each lever may still do: the interval of speeds left to every joint and to the tool."""

from dataclasses import dataclass

from workgauge.values.arrays import Floats, Ints


@dataclass(frozen=True, slots=True, eq=False)
class LeverRanges:
    """How fast each joint alone, and the tool along one axis alone, may be commanded now; 0 is always allowed.

    Attributes:
        joints_low, joints_high: (n,) [rad/s, m/s], low at most 0, high at least 0.
        tool_low, tool_high: (3,) along the machine's x, y and z [m/s].
        joints_low_by, joints_high_by: (n,) index of the clearance that ends the interval, -1 if none does.
        tool_low_by, tool_high_by: (3,) likewise.
    """

    joints_low: Floats
    joints_high: Floats
    tool_low: Floats
    tool_high: Floats
    joints_low_by: Ints
    joints_high_by: Ints
    tool_low_by: Ints
    tool_high_by: Ints
