"""All of a machine's simulated receivers: where their antennas truly are, and what they make of it."""

import math
import re
from collections.abc import Sequence

import numpy as np

from workgauge.geodesy.crs import ProjectedCrs
from workgauge.geodesy.frame import SiteFrame
from workgauge.geodesy.heights import HeightModel
from workgauge.machine.model import MachineModel
from workgauge.machine.positioning import PositioningSpec, ReceiverSpec
from workgauge.sim.sensors.faults import HEADING, Fault, FaultKind, Identity, one
from workgauge.sim.sensors.heading import MovingBase
from workgauge.sim.sensors.line import Wiring
from workgauge.sim.sensors.motion import Motion
from workgauge.sim.sensors.randomness import GaussMarkov, generator
from workgauge.sim.sensors.receiver import TALKER, Receiver
from workgauge.sim.sensors.settings import Protocol, ReceiverSettings, SensorSettings
from workgauge.values.arrays import Floats, Ints
from workgauge.values.errors import MachineError

#: Geoid separation where neither machine nor scenario says one [m]: that of southern Finland.
SEPARATION_M = 17.0

#: The talker by which a machine's file asks for UBX.
UBX = "UBX"

#: What a foreign receiver does outside its window.
_UNHEARD = Fault(FaultKind.SILENCE)


class GnssBank:
    """Receivers and the heading of a moving base, on one clock.

    Args:
        machine: its kinematics and sensors. positioning: its section. settings: how they behave.
        crs, frame: of the site, whose coordinates are the truth's.
        wiring: shared with all sensors.

    Raises:
        GeodesyError: for a geoid grid that cannot be used.
        MachineError: for a talker that no simulated receiver has.
    """

    def __init__(
        self,
        machine: MachineModel,
        positioning: PositioningSpec,
        settings: SensorSettings,
        crs: ProjectedCrs,
        frame: SiteFrame,
        wiring: Wiring,
    ) -> None:
        self._machine = machine
        self._crs = crs
        self._frame = frame
        self._sensors = {sensor.name: sensor for sensor in machine.sensors}
        self._heights = _true_heights(positioning, settings)
        common_s = settings.receivers.noise.correlation_s
        self._common = GaussMarkov(generator(wiring.seed, "common"), common_s, wiring.origin_ns)
        head = positioning.heading
        self._partner = {head.master: head.rover, head.rover: head.master}
        self.receivers: list[Receiver] = []
        self._foreign: dict[str, list[tuple[Fault, Receiver]]] = {}
        self._moved: dict[str, list[Fault]] = {}
        for spec in positioning.receivers:
            self._add(spec, settings.each.get(spec.name, settings.receivers), wiring)
        self.heading: MovingBase | None = None
        if head.kind == "moving_base":
            line = wiring.line(Identity(HEADING, "heading", head.port), head.latency_s, settings.heading.jitter_s)
            self.heading = MovingBase(head, settings.heading, line, wiring)

    def _add(self, spec: ReceiverSpec, chosen: ReceiverSettings, wiring: Wiring) -> None:
        """Add a receiver, and those that disturb it."""
        mine = _receiver(spec, chosen, wiring, "receiver")
        self.receivers.append(mine)
        for i, fault in enumerate(mine.line.faults.all):
            if fault.kind is FaultKind.FOREIGN_RECEIVER:
                named = {"name": f"{spec.name} foreign {i}", "talker": fault.talker}
                other = _receiver(spec.model_copy(update=named), chosen, wiring, "foreign")
                self._foreign.setdefault(spec.name, []).append((fault, other))
            elif fault.kind is FaultKind.ANTENNA_MOVED:
                self._moved.setdefault(spec.antenna, []).append(fault)

    def measure(self, due: Sequence[Receiver], motion: Motion, utc_ns: int) -> None:
        """Let receivers whose epoch this is measure and send."""
        t_ns = motion.t_ns
        found = [(mine, mine.line.faults.at(t_ns)) for mine in due]
        for mine, active in tuple(found):
            for fault, other in self._foreign.get(mine.spec.name, ()):
                found.append((other, (fault if fault in active else _UNHEARD,)))
        links, points = self._antennas([(mine.spec.antenna, active) for mine, active in found], t_ns)
        common = self._common.at(t_ns)
        places = self._frame.to_absolute(motion.points(links, points))
        for place, (mine, active) in zip(places, found, strict=True):
            place += mine.position_error(t_ns, active, common)
        lat, lon = self._crs.to_geodetic(places[:, 0], places[:, 1])
        convergence = self._crs.convergence(places[:, 0], places[:, 1])
        separation = self._heights.separation(lat, lon)
        velocities = motion.point_velocities(self._machine, links, points)
        for i, (mine, active) in enumerate(found):
            where = (float(lat[i]), float(lon[i]), float(places[i, 2]), float(separation[i]))
            velocity = to_true_north(velocities[i] + mine.velocity_error(), float(convergence[i]))
            mine.send(t_ns, utc_ns, mine.solution(t_ns, where, velocity, active), active)

    def measure_heading(self, motion: Motion, utc_ns: int) -> None:
        """Let the moving base measure and send."""
        assert self.heading is not None, "there is a moving base"
        spec = self.heading.spec
        active = self.heading.line.faults.at(motion.t_ns)
        links, points = self._antennas([(spec.master, active), (spec.rover, active)], motion.t_ns)
        master, rover = motion.points(links, points)
        e, n, _ = self._frame.to_absolute(master).tolist()
        self.heading.send(motion.t_ns, utc_ns, rover - master, float(self._crs.convergence(e, n)), active)

    def _antennas(self, cables: Sequence[tuple[str, tuple[Fault, ...]]], t_ns: int) -> tuple[Ints, Floats]:
        """Return the links (k,) and the places on them (k, 3) of the antennas that cables truly end at."""
        links, points = [], []
        for name, active in cables:
            if one(active, FaultKind.SWAPPED) is not None:
                name = self._partner.get(name, name)
            sensor = self._sensors[name]
            point = sensor.T_link_sensor[:3, 3]
            for fault in self._moved.get(name, ()):
                if fault.active(t_ns):
                    point = point + np.array(fault.offset_m)
            links.append(sensor.link)
            points.append(point)
        return np.array(links, dtype=np.int64), np.array(points)


def _receiver(spec: ReceiverSpec, chosen: ReceiverSettings, wiring: Wiring, group: str) -> Receiver:
    """Return a receiver that writes what its talker says: UBX, NMEA, or as chosen if the file has none."""
    talker = spec.talker
    if talker not in (None, UBX) and re.fullmatch("[A-Z]{2}", talker or "") is None:
        raise MachineError(
            "no simulated receiver has this talker",
            element=f"positioning: receiver {spec.name!r}",
            value=talker,
            allowed=f"two capital letters, {UBX}, or none",
        )
    protocol: Protocol = "ubx" if talker == UBX else chosen.protocol if talker is None else "nmea"
    line = wiring.line(Identity(spec.name, group, spec.port), spec.latency_s, chosen.jitter_s)
    return Receiver(spec, chosen, line, wiring, protocol=protocol, talker=talker or TALKER)


def to_true_north(velocity: Floats, convergence: float) -> Floats:
    """Return a velocity (3,) in east, north, up of the grid in those of true north."""
    c, s = math.cos(convergence), math.sin(convergence)
    return np.array([c * velocity[0] + s * velocity[1], c * velocity[1] - s * velocity[0], velocity[2]])


def _true_heights(positioning: PositioningSpec, settings: SensorSettings) -> HeightModel:
    """Return by how much ellipsoidal heights exceed the site's: as the scenario says, else as the machine's file."""
    if settings.geoid_separation_m is not None:
        return HeightModel.constant(settings.geoid_separation_m)
    if positioning.height == "sentence":
        return HeightModel.constant(SEPARATION_M)
    return HeightModel.of(positioning.height, positioning.geoid_separation_m, positioning.geoid_grid)
