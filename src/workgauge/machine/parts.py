"""What a machine is made of, as frozen values: joints in space, link solids, sensors, undercarriage, dynamics."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from workgauge.values.arrays import Floats


@dataclass(frozen=True, slots=True, eq=False)
class JointGeometry:
    """Where a joint sits and how it moves: `T_parent_link(q) = T_parent_joint @ motion(axis, q) @ T_joint_link`.

    Attributes:
        name: the joint's name. prismatic: it slides along `axis` [m] instead of turning about it [rad].
        T_parent_joint: (4, 4), from the parent link's frame.
        axis: (3,) unit vector in the joint's frame.
        T_joint_link: (4, 4), the link's frame seen from the moved joint frame.
    """

    name: str
    prismatic: bool
    T_parent_joint: Floats
    axis: Floats
    T_joint_link: Floats


class Stretch(NamedTuple):
    """A box that a prismatic joint lengthens.

    Attributes:
        joint: index of the joint. axis: 0, 1 or 2, the box's own axis that grows.
        side: +1 or -1, the face that moves outwards by q; the opposite face stays where it is in the link's frame.
    """

    joint: int
    axis: int
    side: int


@dataclass(frozen=True, slots=True, eq=False)
class LinkSolid:
    """One box of a link.

    Attributes:
        link: index of the link it moves with, 0 for the undercarriage; link k moves with joints 1 to k.
        name: unique in the machine.
        T_link_box: (4, 4), the box's centre frame in the link's frame (at q = 0 of its stretch).
        half_extents: (3,) along the box's own axes [m] (at q = 0 of its stretch).
        stretch: the prismatic joint that lengthens it, or None.
    """

    link: int
    name: str
    T_link_box: Floats
    half_extents: Floats
    stretch: Stretch | None = None


@dataclass(frozen=True, slots=True, eq=False)
class LinkMesh:
    """How a link looks; its boxes alone are measured.

    Attributes:
        link: index of the link it moves with, 0 for the undercarriage. file: of the mesh, in metres once scaled.
        T_link_mesh: (4, 4), the file's frame in the link's frame. scale: (3,) along the file's axes, before that.
    """

    link: int
    file: Path
    T_link_mesh: Floats
    scale: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Sensor:
    """A sensor or antenna, which link it sits on, and where: `T_link_sensor` (4, 4)."""

    name: str
    kind: str
    link: int
    T_link_sensor: Floats


@dataclass(frozen=True, slots=True)
class Undercarriage:
    """What carries the machine.

    Attributes:
        kind: `rail`, `tracks` or `wheels`.
        gauge_m: rail gauge, or the distance between the tracks' or tyres' middles [m].
        height_m: height of the machine frame's origin above top of rail, or above ground [m].
    """

    kind: str
    gauge_m: float
    height_m: float


@dataclass(frozen=True, slots=True)
class Stopping:
    """How a joint moving in one direction comes to rest; the defaults are an ideal joint.

    The angle (length) still moved from speed w is `w (dead_time + lag) + w^2 / (2 deceleration)`.

    Attributes:
        dead_time_s: from the command to the first reaction [s]. lag_s: first-order time constant [s].
        deceleration: [rad/s^2 or m/s^2].
        tolerance: relative spread of the three, 0.3 for plus or minus 30 %.
    """

    dead_time_s: float = 0.0
    lag_s: float = 0.0
    deceleration: float = math.inf
    tolerance: float = 0.0

    @property
    def ideal(self) -> bool:
        """Whether it stops at once."""
        return self.dead_time_s == 0.0 and self.lag_s == 0.0 and math.isinf(self.deceleration)


@dataclass(frozen=True, slots=True, eq=False)
class Pump:
    """Shared flow: all speeds are scaled by `min(1, flow / sum of the flows asked for)`.

    Attributes:
        flow: what the pump gives [m^3/s].
        flow_positive, flow_negative: (n,) what each joint takes at full speed in that direction [m^3/s].
    """

    flow: float
    flow_positive: Floats
    flow_negative: Floats


class SkippedPair(NamedTuple):
    """A pair of solids that is not checked for self-collision, and why."""

    first: str
    second: str
    why: str
