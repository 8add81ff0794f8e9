"""Travel in a rehearsal: what the driver wants, what the limits leave of it, and what stops it."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from workgauge.guard.api import Guard
from workgauge.guard.travel import Brakes, sideways, travel_rates, travel_speed
from workgauge.loop.tick import Trace
from workgauge.machine.model import MachineModel
from workgauge.rehearse.navigation import Known
from workgauge.rehearse.scenario import TravelStep
from workgauge.rehearse.ways import RailNetwork, RailPlace
from workgauge.sim.travel import twist_per_metre
from workgauge.site.alignment import Alignment
from workgauge.values.arrays import Floats
from workgauge.values.errors import ScenarioError
from workgauge.values.health import HealthState
from workgauge.values.limits import Limit
from workgauge.values.measurements import MachinePose
from workgauge.values.reasons import STOPPING, Reason
from workgauge.values.solids import Box, Convex

#: A leg is made when no more than this is left of it [m].
THERE_M = 0.005

#: The driver brakes for the end of a leg with this share of what the brakes can do.
GENTLE = 0.8

#: The last of a leg is crept at this speed [m/s].
CREEP_M_S = 0.05

#: A guard that names no stop distance is taken to have this one [m].
STOP_DISTANCE_M = 0.2


@dataclass(frozen=True, slots=True)
class Travel:
    """Travel in one tick.

    Attributes:
        wanted_m_s, allowed_m_s: along the machine's x axis, negative backwards.
        speed_m_s, travelled_m: true, at the tick's end. curvature: how it is steered [1/m].
        reasons: why less is allowed than wanted; what stops the joints as well stands in the trace.
    """

    wanted_m_s: float = 0.0
    allowed_m_s: float = 0.0
    speed_m_s: float = 0.0
    travelled_m: float = 0.0
    curvature: float = 0.0
    reasons: tuple[Reason, ...] = field(default=())

    def made(self, speed_m_s: float, travelled_m: float) -> "Travel":
        """Return the same with what became of it."""
        return replace(self, speed_m_s=speed_m_s, travelled_m=travelled_m)


def allowed_travel(
    wanted_m_s: float,
    curvature: float,
    trace: Trace,
    known: Known,
    place: RailPlace | None,
    ground: "TravelGround",
    gate_open: bool,
) -> tuple[float, tuple[Reason, ...]]:
    """Return the speed that is left of what the driver wants, and why.

    Whatever stops the joints stops the travel: a closed gate, an input not to be believed, a position not to be used,
    and a position that counts only while the undercarriage does not move. Else it is `guard.travel`'s to say.

    Args:
        trace: of this tick. known: what it was given. place: on the rails as believed, None on the ground.
        ground: what does not change while the session lasts.
    """
    pose = known.pose
    frozen_chassis = known.health is not None and known.health.state is HealthState.CHASSIS_FROZEN
    stopped = not gate_open or frozen_chassis or any(reason.code in STOPPING for reason in trace.reasons)
    if stopped or pose is None or trace.clearances is None:
        return 0.0, ()
    T = pose.T_site_machine
    way = ground.brakes.way(abs(wanted_m_s))
    if place is not None:
        twist = twist_per_metre(place, 0.0)
        curvature = _sharpest(place, math.copysign(way, wanted_m_s))
    else:
        twist = np.concatenate([T[:3, 0], curvature * T[:3, 2]])
    rates = travel_rates(trace.clearances, T, twist)
    beside = ground.beside(trace, T)
    bends = abs(curvature), ground.sharpest
    return travel_speed(wanted_m_s, trace.clearances, rates, beside, bends, ground.stop_distance_m, ground.brakes)


class TravelGround:
    """What travel needs to know of a machine and its site, once and for all.

    Args:
        machine: its solids. limits: all, in the order of the scene. tracks: alignments that are tracks.
        brakes: of the undercarriage. guard: for its stop distance, where a limit has none.
    """

    def __init__(
        self,
        machine: MachineModel,
        limits: Sequence[Limit],
        tracks: Iterable[Alignment],
        brakes: Brakes,
        guard: Guard,
    ) -> None:
        self.brakes = brakes
        self.stop_distance_m = float(getattr(guard, "stop_distance_m", STOP_DISTANCE_M))
        self.sharpest = max((float(np.abs(_curvatures(track)).max()) for track in tracks), default=0.0)
        self._machine = machine
        self._corners = {
            i: limit.solid.vertices for i, limit in enumerate(limits) if isinstance(limit.solid, Box | Convex)
        }

    def beside(self, trace: Trace, T_site_machine: Floats) -> tuple[Floats, Floats] | None:
        """Return what lies beside the way of the machine as believed, see `guard.travel.sideways`."""
        if trace.q is None or trace.clearances is None:
            return None
        poses, halves = self._machine.solid_poses(self._machine.forward(trace.q))
        T_site_boxes = T_site_machine @ poses
        corners = (CORNERS * halves[:, None, :]) @ T_site_boxes[:, :3, :3].transpose(0, 2, 1) + T_site_boxes[
            :, None, :3, 3
        ]
        return sideways(trace.clearances, T_site_machine, corners, self._corners)


def _curvatures(track: Alignment) -> Floats:
    """Return the curvatures at the ends of a track's elements, just inside them [1/m]."""
    ends = track.breaks
    inside = np.concatenate([ends, np.maximum(ends - 1e-6, 0.0), np.minimum(ends + 1e-6, track.length)])
    return track.at(inside).curvature


def _sharpest(place: RailPlace, way_m: float) -> float:
    """Return the sharpest curvature of the rails from a place to the end of a way [1/m]."""
    alignment, sign = place.rails.alignment, 1.0 if place.forward else -1.0
    ahead = place.distance_m + sign * way_m * np.linspace(0.0, 1.0, 5)
    return float(np.abs(alignment.at(np.clip(ahead, 0.0, alignment.length)).curvature).max())


#: Signs of a box's corners (8, 3).
CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])


class Driver:
    """Goes through the legs of a scenario's travel, one after the other.

    Args:
        steps: the legs. start_m: the place along the alignment at the start, None on the ground.
        facing: +1 where the machine faces growing distances, -1 against them.
        brakes: of the undercarriage.

    Raises:
        ScenarioError: for a leg to a distance along an alignment where the machine stands on none.
    """

    def __init__(self, steps: Sequence[TravelStep], start_m: float | None, facing: float, brakes: Brakes) -> None:
        for i, step in enumerate(steps):
            if step.to_m is not None and start_m is None:
                raise ScenarioError(
                    "the machine stands on no rails",
                    element=f"travel.{i}.to_m",
                    value=step.to_m,
                    allowed="distance_m",
                )
        self._steps = tuple(steps)
        self._start_m, self._facing, self._brakes = start_m, facing, brakes
        self._next = 0
        self._goal_m: float | None = None
        self._leg: TravelStep | None = None

    @property
    def over(self) -> bool:
        """Whether every leg is made."""
        return self._goal_m is None and self._next == len(self._steps)

    def wants(self, t_s: float, travelled_m: float, speed_m_s: float) -> tuple[float, float]:
        """Return the speed [m/s] and curvature [1/m] wanted now.

        Args:
            t_s: since the run's start. travelled_m: forwards less backwards. speed_m_s: now.
        """
        if self._goal_m is None and self._next < len(self._steps) and t_s >= self._steps[self._next].from_s - 1e-9:
            self._leg = self._steps[self._next]
            self._goal_m = self._goal(self._leg, travelled_m)
            self._next += 1
        if self._goal_m is None or self._leg is None:
            return 0.0, 0.0
        left = self._goal_m - travelled_m
        if abs(left) <= THERE_M and abs(speed_m_s) <= 2 * CREEP_M_S:
            self._goal_m = None
            return 0.0, 0.0
        a = GENTLE * self._brakes.deceleration_m_s2
        most = max(math.sqrt(2.0 * a * abs(left)) - a * self._brakes.reaction_s, CREEP_M_S)
        radius = self._leg.radius_m
        return math.copysign(min(self._leg.speed_m_s, most), left), 0.0 if radius is None else 1.0 / radius

    def _goal(self, leg: TravelStep, travelled_m: float) -> float:
        if leg.distance_m is not None:
            return travelled_m + leg.distance_m
        assert leg.to_m is not None and self._start_m is not None, "checked at the start"
        return (leg.to_m - self._start_m) * self._facing


def believed_place(pose: MachinePose, network: RailNetwork, own: Alignment) -> RailPlace:
    """Return the place on the rails of an alignment that is nearest to a believed pose."""
    T = pose.T_site_machine
    along = float(own.project(network.frame.to_absolute(T[:3, 3])[None, :2])[0][0])
    heading = float(own.at([along]).heading[0])
    ahead = T[:2, 0] @ np.array([math.sin(heading), math.cos(heading)])
    return RailPlace(network, network.of(own), along, bool(ahead > 0))
