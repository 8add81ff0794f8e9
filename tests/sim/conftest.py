"""Simulated sensors to listen to, and machines of several makes to put them on."""

import functools
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from workgauge.geodesy.crs import ProjectedCrs
from workgauge.geodesy.frame import SiteFrame
from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.machine.parts import Sensor
from workgauge.machine.positioning import PositioningSpec
from workgauge.sim.sensors.kit import SensorKit
from workgauge.sim.sensors.settings import (
    FixNoise,
    HeadingSettings,
    LinkSettings,
    ReceiverSettings,
    SensorSettings,
)
from workgauge.values import transforms as tf
from workgauge.values.ports import Chunk
from workgauge.wire.stream import StreamDecoder

MS = 1_000_000

#: EPSG number and a place in it: the shipped site's own projection, and one far from its central meridian.
PLACES = {3879: (25487300.0, 6714600.0, 100.0), 25832: (691000.0, 5335000.0, 510.0)}


@functools.cache
def shipped(name: str) -> MachineModel:
    return load_machine(name)


@functools.cache
def moving_base() -> MachineModel:
    """Return the road-rail excavator with one receiver and the heading of a moving base."""
    machine = shipped("rre20")
    section = machine.positioning.model_dump()
    section["receivers"] = section["receivers"][:1]
    section["heading"] |= {"kind": "moving_base", "port": "gnss-left"}
    return replace(machine, positioning=PositioningSpec.model_validate(section))


@functools.cache
def sliding() -> MachineModel:
    """Return a small machine without cab or boom as others have them: wire encoders, and an antenna on a mast."""
    machine = shipped("brokk5")
    mast = [
        Sensor("mast front", "gnss_antenna", 0, tf.translation(0.6, 0.0, 1.9)),
        Sensor("mast back", "gnss_antenna", 0, tf.translation(-0.6, 0.1, 1.9)),
        Sensor("base tilt", "inclinometer", 0, tf.rpy(0.1, -0.2, 0.3)),
    ]
    joints: list[dict[str, Any]] = [
        {"joint": machine.joint_names[0], "kind": "encoder", "sensor": "base encoder", "sign": -1, "offset_deg": 12}
    ]
    wires = ("arm 1 wire", "arm 2 wire", "arm 3 wire", "tool wire")
    for j, (name, wire) in enumerate(zip(machine.joint_names[1:], wires, strict=True), start=1):
        low, high = np.degrees(machine.q_min[j]), np.degrees(machine.q_max[j])
        turns = np.linspace(low, high, 5) if j % 2 else np.linspace(high, low, 5)
        strokes = np.cumsum([0.1, 0.2, 0.15, 0.25, 0.1])
        calibration = {"stroke_m": strokes.tolist(), "position_deg": turns.tolist()}
        joints.append(
            {"joint": name, "kind": "wire_encoder", "sensor": wire, "sigma_m": 0.001, "calibration": calibration}
        )
    section = {
        "receivers": [{"name": "one", "antenna": "mast back", "port": "serial-1", "talker": "GP"}],
        "heading": {"kind": "moving_base", "master": "mast back", "rover": "mast front", "port": "serial-1"},
        "tilt": {"sensor": "base tilt"},
        "joints": joints,
    }
    return replace(machine, sensors=(*machine.sensors, *mast), positioning=PositioningSpec.model_validate(section))


@functools.cache
def reaching() -> MachineModel:
    """Return the single-antenna research excavator, listed by inclinometers throughout, all in one stream."""
    machine = shipped("sun-a")
    second = Sensor("antenna front", "gnss_antenna", 1, tf.translation(0.3, 1.6, 0.2))
    mount = Sensor("frame tilt", "inclinometer", 0, np.eye(4))
    imus = [s.name for s in machine.sensors if s.kind == "imu"]
    joints = [
        {"joint": name, "kind": "inclination" if j else "encoder", "sensor": imus[j], "sigma_deg": 0.1}
        for j, name in enumerate(machine.joint_names)
    ]
    section = {
        "receivers": [
            {"name": "back", "antenna": "antenna", "port": "all", "talker": "GN", "latency_s": 0.05},
            {"name": "front", "antenna": "antenna front", "port": "all", "talker": "UBX"},
        ],
        "heading": {"kind": "two_antennas", "master": "antenna", "rover": "antenna front"},
        "tilt": {"sensor": "frame tilt", "port": "all", "latency_s": 0.0},
        "joints": [{**joint, "port": "all"} for joint in joints],
    }
    return replace(
        machine, sensors=(*machine.sensors, second, mount), positioning=PositioningSpec.model_validate(section)
    )


MACHINES: dict[str, Callable[[], MachineModel]] = {
    "rre20": lambda: shipped("rre20"),
    "moving base": moving_base,
    "brokk5": sliding,
    "sun-a": reaching,
}


def exact(**changed: Any) -> SensorSettings:
    """Return settings without any error; `changed` are those of all receivers, `links`, `faults` of the kit."""
    own = {key: changed.pop(key) for key in ("faults", "each", "geoid_separation_m") if key in changed}
    links = changed.pop("links", LinkSettings(scale=0.0))
    changed.setdefault("noise", FixNoise(scale=0.0))
    return SensorSettings(ReceiverSettings(**changed), heading=HeadingSettings(scale=0.0), links=links, **own)


@dataclass
class Heard:
    """What came out of a kit: chunks in order of arrival, and measurements by port with the tallies."""

    chunks: list[Chunk]
    measurements: list[Any]
    tallies: dict[str, Any]

    def of(self, kind: type, source: str = "") -> list[Any]:
        return [one for one in self.measurements if isinstance(one, kind) and one.stamp.source.startswith(source)]


def frame_at(epsg: int = 3879) -> SiteFrame:
    return SiteFrame(ProjectedCrs.from_epsg(epsg), PLACES[epsg])


def kit_of(machine: MachineModel, settings: SensorSettings | None = None, epsg: int = 3879, **more: Any) -> SensorKit:
    frame = frame_at(epsg)
    return SensorKit(machine, frame.crs, frame, settings, **more)


def hear(kit: SensorKit, states: Iterable[tuple[int, Any, Any]], after_ns: int = 2_000 * MS) -> Heard:
    """Advance through states (t_ns, q, T), reading at each, and once more `after_ns` later."""
    decoders = {port: StreamDecoder(port, "machine") for port in kit.ports}
    chunks: list[Chunk] = []
    last = 0
    for t_ns, q, T in states:
        kit.advance(t_ns, q, T)
        chunks += kit.read(t_ns)
        last = t_ns
    chunks += kit.read(last + after_ns)
    measurements = [one for chunk in chunks for one in decoders[chunk.port].feed(chunk)]
    return Heard(chunks, measurements, {port: decoder.tally for port, decoder in decoders.items()})


def standing(machine: MachineModel, for_ms: int, step_ms: int = 10, q: Any = None, T: Any = None) -> Any:
    """Yield the states of a machine that does not move."""
    for t_ms in range(0, for_ms + 1, step_ms):
        yield t_ms * MS, machine.home if q is None else q, np.eye(4) if T is None else T


@pytest.fixture(scope="session")
def world() -> SimpleNamespace:
    """Everything above, for tests that cannot import it."""
    return SimpleNamespace(
        MACHINES=MACHINES,
        PLACES=PLACES,
        exact=exact,
        frame_at=frame_at,
        hear=hear,
        kit_of=kit_of,
        standing=standing,
    )
