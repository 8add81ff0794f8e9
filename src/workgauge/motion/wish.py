"""What a job asks for in one tick if nothing stood around, and how closely jobs are followed."""

import math
from dataclasses import dataclass, field

from workgauge.machine.model import MachineModel
from workgauge.motion.ik.clik import ClikGains, speed_share
from workgauge.motion.slide import SlideSettings
from workgauge.values.arrays import Floats
from workgauge.values.reasons import Reason


@dataclass(frozen=True, slots=True)
class FollowSettings:
    """How closely jobs are followed.

    Attributes:
        gain_1_s: how fast a joint is drawn back to its trajectory, and lateness made up for, no faster than it bears.
        ramp_s: from standing to the full pace of a trajectory, and back.
        stuck_s: a job that comes no nearer for so long is stuck. nearer: less than this is no nearer [m, rad, s].
        feed_forward: whether the trajectory's own speed is commanded, not only what corrects its error.
        compensate: whether dead time and lag are made up for by commanding so much earlier.
        bend: whether motion bends before limits, not for a guard that does; slide: how.
        clik: gains of the inverse kinematics towards goals.
    """

    gain_1_s: float = 2.5
    ramp_s: float = 0.5
    stuck_s: float = 8.0
    nearer: float = 0.005
    feed_forward: bool = True
    compensate: bool = True
    bend: bool = True
    slide: SlideSettings = field(default_factory=SlideSettings)
    clik: ClikGains = field(default_factory=ClikGains)


@dataclass(frozen=True, slots=True, eq=False)
class Wish:
    """What a job would ask for if nothing stood around.

    Attributes:
        velocity: (n,). goal: (3,) where the tool wants to go from where it is, machine frame [m].
        error_m, error_rad: see `JobFacts`. way_m, rate: likewise. clock_s, clocks: see `JobMemory`, of the next tick.
        there: whether the job is done.
        to_go: a number that falls as long as the job gets on. group: see `JobMemory`.
        reasons: what hinders it by itself.
    """

    velocity: Floats
    goal: Floats
    error_m: float
    error_rad: float
    way_m: float
    clock_s: float
    rate: float
    there: bool
    to_go: float
    clocks: tuple[float, ...] = ()
    group: int = -1
    reasons: tuple[Reason, ...] = ()


def sizes(error: Floats) -> tuple[float, float]:
    """Return the lengths of an error's position and orientation [m, rad]."""
    return math.hypot(*error[:3].tolist()), math.hypot(*error[3:].tolist())


def within_speeds(velocity: Floats, machine: MachineModel) -> Floats:
    """Return a velocity (n,) shortened so that no joint is to run faster than it can."""
    shortened: Floats = velocity * speed_share(velocity, machine)
    return shortened
