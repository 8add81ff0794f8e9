"""Link sensors of a machine that stands level and still: for receiver logs that have no link sensors in them."""

from dataclasses import replace

import numpy as np

from workgauge.geodesy.crs import ProjectedCrs
from workgauge.geodesy.frame import SiteFrame
from workgauge.machine.model import MachineModel
from workgauge.machine.positioning import PositioningSpec
from workgauge.sim.sensors.kit import SensorKit
from workgauge.sim.sensors.settings import LinkSettings, SensorSettings
from workgauge.values.arrays import Floats
from workgauge.values.measurements import Stamp
from workgauge.values.navigation import AngularRate, EncoderReading, Inclination, LinkMeasurement
from workgauge.values.ports import Chunk
from workgauge.wire.messages import encode
from workgauge.wire.stream import StreamDecoder

#: Long enough for the first readings to arrive [ns].
_FIRST_NS = 1_000_000_000


def link_ports(positioning: PositioningSpec) -> frozenset[str]:
    """Return the ports of a machine's tilt and joint sensors."""
    return frozenset({positioning.tilt.port, *(joint.port for joint in positioning.joints)})


def receiver_ports(positioning: PositioningSpec) -> tuple[str, ...]:
    """Return the ports of a machine's receivers, in the order of its file, then of its heading."""
    ports = [receiver.port for receiver in positioning.receivers]
    if positioning.heading.kind == "moving_base":
        ports.append(positioning.heading.port)
    return tuple(dict.fromkeys(ports))


def log_ports(positioning: PositioningSpec) -> tuple[str, ...]:
    """Return every port of a machine that a log may be of, receivers first."""
    return tuple(dict.fromkeys((*receiver_ports(positioning), *sorted(link_ports(positioning)))))


class StandingSensors:
    """What a machine's link sensors would read, free of noise, while it stands level in one posture.

    Args:
        machine: with a `positioning` section. machine_id: whose frames they are.
        crs, frame: of the site. q: (n,) posture; the machine's home if left out [rad, m].
    """

    def __init__(
        self,
        machine: MachineModel,
        machine_id: str,
        crs: ProjectedCrs,
        frame: SiteFrame,
        q: Floats | None = None,
    ) -> None:
        settings = SensorSettings(links=LinkSettings(scale=0.0))
        kit = SensorKit(machine, crs, frame, settings, machine_id=machine_id)
        kit.advance(0, machine.home if q is None else q, np.eye(4))
        self._machine_id = machine_id
        self._values: list[tuple[str, LinkMeasurement]] = []
        decoders: dict[str, StreamDecoder] = {}
        for chunk in kit.read(_FIRST_NS):
            decoder = decoders.setdefault(chunk.port, StreamDecoder(chunk.port, machine_id))
            self._values += [
                (chunk.port, one)
                for one in decoder.feed(chunk)
                if isinstance(one, Inclination | EncoderReading | AngularRate)
            ]

    def read(self, now_ns: int) -> list[Chunk]:
        """Return one reading of each, as if it had just arrived."""
        return [
            Chunk(port, now_ns, encode(replace(value, stamp=Stamp(self._machine_id, now_ns, value.stamp.source))))
            for port, value in self._values
        ]
