"""What the tool is to reach: a pose, and how much of its orientation counts."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from workgauge.values.arrays import Floats, frozen


class Orientation(StrEnum):
    """How much of a wanted orientation counts."""

    FULL = "full"  #: all of it
    PITCH = "pitch"  #: the tool's angle in the vertical plane of the arm, as a machine without tilt and rotator has
    FREE = "free"  #: none of it


@dataclass(frozen=True, slots=True, eq=False)
class ToolGoal:
    """A pose for the tool frame.

    Attributes:
        T_site_tool: (4, 4) tool frame in the site's local frame [m]; kept as a read-only copy, row by row, so that
            nothing changes under a job and one read from a log gives the same to the last bit.
        orientation: how much of its orientation counts.
    """

    T_site_tool: Floats
    orientation: Orientation = Orientation.FULL

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_site_tool", frozen(np.ascontiguousarray(self.T_site_tool)))
