"""Where a machine can travel from where it stands: along rails, across their joints, or over the ground."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from workgauge.gauge.heights import SiteHeights
from workgauge.gauge.rules import RuleBook
from workgauge.geodesy.frame import SiteFrame
from workgauge.machine.model import MachineModel
from workgauge.rehearse.scenario import OnGround, OnTrack
from workgauge.rehearse.start import Rails, Stand, on_ground
from workgauge.site.alignment import Alignment
from workgauge.site.model import SiteModel
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import InputError, ScenarioError
from workgauge.values.transforms import heading_from_yaw

#: Rails of two alignments join where one ends this near to the other [m], in the same direction within this [rad].
JOINT_M, JOINT_ANGLE = 0.05, math.radians(2.0)

#: An alignment leads on from a joint if there is more than this of it [m].
LEADS_ON_M = 0.01


class RailNetwork:
    """The rails of a site, joined where one alignment ends on another."""

    def __init__(self, site: SiteModel, rules: RuleBook, machine: MachineModel, frame: SiteFrame) -> None:
        self.frame = frame
        self._rails = {id(a): Rails(site, rules, a, machine) for a in site.alignments}
        self._alignments = site.alignments

    def rails(self, name: str) -> Rails:
        """Return the rails of the alignment of that name (the first, if several are called so)."""
        return next(self._rails[id(a)] for a in self._alignments if a.name == name)

    def of(self, alignment: Alignment) -> Rails:
        """Return the rails of one of the site's alignments."""
        return self._rails[id(alignment)]

    def onwards(self, rails: Rails, end_m: float, ahead: float) -> tuple[Rails, float, float] | None:
        """Return the rails that lead on from an end, the distance along them there, and which way they are travelled.

        Args:
            rails: what ends. end_m: where. ahead: the way it was travelled, +1 with growing distance or -1.
        """
        state = rails.alignment.at([end_m])
        heading = float(state.heading[0]) + (0.0 if ahead > 0 else math.pi)
        for other in self._alignments:
            if other is rails.alignment:
                continue
            along, offset = (float(value[0]) for value in other.project([[float(state.e[0]), float(state.n[0])]]))
            if abs(offset) > JOINT_M:
                continue
            turned = math.remainder(float(other.at([along]).heading[0]) - heading, 2 * math.pi)
            way = 1.0 if abs(turned) < math.pi / 2 else -1.0
            aside = abs(math.remainder(turned, math.pi))
            left = other.length - along if way > 0 else along
            if aside <= JOINT_ANGLE and left > LEADS_ON_M:
                return self._rails[id(other)], along, way
        return None


@dataclass(frozen=True, eq=False)
class RailPlace:
    """A place on rails.

    Attributes:
        network: all rails of the site. rails: those stood on. distance_m: along their alignment.
        forward: whether the machine faces growing distances.
    """

    network: RailNetwork
    rails: Rails
    distance_m: float
    forward: bool

    @cached_property
    def T_site_machine(self) -> Floats:
        """The pose of the undercarriage there, (4, 4), site frame [m]."""
        return _local(self.rails.pose(self.distance_m, self.forward), self.network.frame)

    def moved(self, by_m: float, curvature: float) -> "RailPlace":
        """Return the place `by_m` farther along the rails, or as far as they lead; rails are not steered."""
        ahead = math.copysign(1.0, by_m) * (1.0 if self.forward else -1.0)
        there = self.distance_m + ahead * abs(by_m)
        length = self.rails.alignment.length
        end = min(max(there, 0.0), length)
        place = replace(self, distance_m=end)
        if there != end and (on := self.network.onwards(self.rails, end, ahead)) is not None:
            rails, along, way = on
            there = min(max(along + way * abs(there - end), 0.0), rails.alignment.length)
            place = replace(self, rails=rails, distance_m=there, forward=self.forward == (way == ahead))
        try:
            place.T_site_machine  # noqa: B018  heights may be unknown there
        except InputError:
            return self
        return place


@dataclass(frozen=True, eq=False)
class GroundPlace:
    """A place on the ground.

    Attributes:
        heights: of the site. machine: what stands there. frame: of the poses.
        e, n: absolute [m]. heading: clockwise from grid north [rad].
    """

    heights: SiteHeights
    machine: MachineModel
    frame: SiteFrame
    e: float
    n: float
    heading: float

    @cached_property
    def T_site_machine(self) -> Floats:
        """The pose of the undercarriage there, (4, 4), site frame [m]."""
        stood = on_ground(self.heights, self.machine, self.e, self.n, self.heading)
        return _local(stood.T_absolute_machine, self.frame)

    def moved(self, by_m: float, curvature: float) -> "GroundPlace":
        """Return the place `by_m` farther on an arc in plan, or this one if the ground ends."""
        turn = curvature * by_m
        chord = by_m * float(np.sinc(turn / (2 * math.pi)))
        heading = self.heading - turn / 2
        place = replace(
            self,
            e=self.e + chord * math.sin(heading),
            n=self.n + chord * math.cos(heading),
            heading=(self.heading - turn) % (2 * math.pi),
        )
        try:
            place.T_site_machine  # noqa: B018  heights may be unknown there
        except ScenarioError:
            return self
        return place


def way_from(
    site: SiteModel,
    rules: RuleBook,
    machine: MachineModel,
    frame: SiteFrame,
    asked: OnTrack | OnGround,
    stood: Stand,
) -> RailPlace | GroundPlace:
    """Return the place a machine stands at, ready to travel from."""
    T = stood.T_absolute_machine
    e, n = float(T[0, 3]), float(T[1, 3])
    on_rails = isinstance(asked, OnTrack) or machine.undercarriage.kind == "rail"
    if not on_rails or stood.own_track is None:
        heading = heading_from_yaw(math.atan2(T[1, 0], T[0, 0]))
        if isinstance(asked, OnGround):
            e, n, heading = asked.east_m, asked.north_m, math.radians(asked.heading_deg)
        return GroundPlace(SiteHeights(site, rules), machine, frame, e, n, heading)
    network = RailNetwork(site, rules, machine, frame)
    rails = network.rails(stood.own_track)
    if isinstance(asked, OnTrack):
        along = asked.distance_m
        if along is None:
            along = rails.alignment.distance_of_station(float(asked.station_m or 0.0))
    else:
        along = float(rails.alignment.project([[asked.east_m, asked.north_m]])[0][0])
    tangent = rails.pose(along, True)[:3, 0]
    return RailPlace(network, rails, along, bool(tangent @ T[:3, 0] > 0))


def _local(T_absolute_machine: Floats, frame: SiteFrame) -> Floats:
    T = np.array(T_absolute_machine)
    T[:3, 3] = frame.to_local(T[:3, 3])
    return frozen(T)
