"""What enters the tick: posture, machine pose, the operator's intent, each with its stamp."""

from dataclasses import dataclass, field
from enum import StrEnum

from workgauge.values.arrays import Floats, frozen


@dataclass(frozen=True, slots=True)
class Stamp:
    """When, on whose clock, and from where a value came.

    Attributes:
        machine_id: the machine the value belongs to.
        monotonic_ns: receipt on this process's monotonic clock [ns]; ages are counted from it.
        source: the sensor or sender.
        epoch_ns: the source's own time of the measurement [ns], if it has one.
    """

    machine_id: str
    monotonic_ns: int
    source: str
    epoch_ns: int | None = None

    def age_s(self, now_ns: int) -> float:
        """Return the age at `now_ns` [s]; negative for a stamp from the future."""
        return (now_ns - self.monotonic_ns) * 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Posture:
    """Measured joint positions q (n,) [rad, m] and their standard deviations sigma (n,).

    Attributes:
        covariance: (n, n) of the joints where their errors are correlated (one inclinometer serves the joints on both
            sides of its link), its diagonal sigma squared; None if they are independent.
    """

    stamp: Stamp
    q: Floats
    sigma: Floats
    covariance: Floats | None = None

    @classmethod
    def exact(cls, stamp: Stamp, q: Floats) -> "Posture":
        """Return a posture known without error."""
        return cls(stamp, frozen(q), frozen([0.0] * len(q)))


@dataclass(frozen=True, slots=True, eq=False)
class MachinePose:
    """Pose of the undercarriage in the site frame.

    Attributes:
        T_site_machine: (4, 4), machine coordinates (x forward, y left, z up) into site (east, north, up) [m].
        covariance: (6, 6) of (translation, rotation vector), both in the site frame [m, rad].
        cross: (6, n) covariance of that with the errors of the joints of the posture it was found with (antennas on
            the cab: the undercarriage's heading hangs on the swing angle); None if they are independent.
    """

    stamp: Stamp
    T_site_machine: Floats
    covariance: Floats
    cross: Floats | None = None

    @classmethod
    def exact(cls, stamp: Stamp, T_site_machine: Floats) -> "MachinePose":
        """Return a pose known without error."""
        return cls(stamp, frozen(T_site_machine, (4, 4)), frozen([[0.0] * 6] * 6))


class DriveMode(StrEnum):
    """What the levers mean."""

    JOINT = "joint"  #: each lever moves its joint
    TOOL = "tool"  #: levers move the tool centre point along the machine's axes
    LINE = "line"  #: one lever moves the tool centre point along a given straight line
    EXIT = "exit"  #: one lever drives the machine out of limits it is inside of, by the program's own way
    AUTO = "auto"  #: the program does a job (a goal, a trajectory); one lever is its pace


#: Lever names, in the order of `Levers.values`. Signs: x to the right, y forward, roller up are positive.
LEVER_NAMES = ("left_x", "left_y", "right_x", "right_y", "left_roller", "right_roller")


@dataclass(frozen=True, slots=True)
class Levers:
    """Positions of the two joysticks and their rollers, each in [-1, 1]; see `LEVER_NAMES` for signs."""

    left_x: float = 0.0
    left_y: float = 0.0
    right_x: float = 0.0
    right_y: float = 0.0
    left_roller: float = 0.0
    right_roller: float = 0.0

    @property
    def values(self) -> tuple[float, ...]:
        """The six positions in the order of `LEVER_NAMES`."""
        return (self.left_x, self.left_y, self.right_x, self.right_y, self.left_roller, self.right_roller)

    @property
    def neutral(self) -> bool:
        """Whether every lever stands exactly in the middle."""
        return not any(self.values)


@dataclass(frozen=True, slots=True, eq=False)
class ToolLine:
    """A straight line for the tool centre point: start (3,) and unit direction (3,) in the site frame [m]."""

    start_site: Floats
    direction_site: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Intent:
    """What the operator wants now.

    Attributes:
        enable: the dead-man switch; without it nothing moves.
        line: the line of `DriveMode.LINE`; `right_y` is then the speed along it. In `DriveMode.EXIT`, `right_y`
            forward is the speed out; in `DriveMode.AUTO`, the pace of the job.
    """

    stamp: Stamp
    mode: DriveMode = DriveMode.JOINT
    levers: Levers = field(default_factory=Levers)
    enable: bool = False
    line: ToolLine | None = None
