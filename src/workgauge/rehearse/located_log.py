"""What a machine's own positioning makes of receiver logs: its pose, heading and health at every moment of them."""

import math
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from workgauge.geodesy.crs import ProjectedCrs
from workgauge.geodesy.frame import SiteFrame
from workgauge.geodesy.heights import HeightModel
from workgauge.machine.model import MachineModel
from workgauge.machine.positioning import PositioningSpec
from workgauge.positioning.locate import Locator
from workgauge.positioning.memory import Located
from workgauge.rehearse.log_file import LogFile, OnBytes
from workgauge.rehearse.replay import Timeline, timeline
from workgauge.rehearse.standing import StandingSensors, link_ports
from workgauge.rehearse.track_log import Track
from workgauge.values.arrays import frozen
from workgauge.values.errors import MachineError
from workgauge.values.measurements import MachinePose
from workgauge.values.ports import Chunk
from workgauge.wire.messages import NAME_BYTES
from workgauge.wire.stream import StreamDecoder

#: Between moments farther apart than this, positioning is asked again this often, for so long, and at the end [s].
STEP_S, STEPS = 0.1, 30

#: What is assumed where no log has link sensors, as every output states it.
STANDING = (
    "no link sensors in the logs: the machine is taken to stand level, its joints at home; heading and pose hold for "
    "that only"
)


def positioning_of(machine: MachineModel) -> PositioningSpec:
    """Return a machine's `positioning` section.

    Raises:
        MachineError: if it has none.
    """
    if machine.positioning is None:
        raise MachineError(
            "the machine's file does not say how it knows where it is",
            element=machine.name,
            allowed="a machine with a `positioning` section",
        )
    return machine.positioning


def heights_of(machine: MachineModel) -> HeightModel:
    """Return how a machine's file turns receivers' heights into the site's."""
    section = positioning_of(machine)
    return HeightModel.of(section.height, section.geoid_separation_m, section.geoid_grid)


def latencies_of(section: PositioningSpec) -> dict[str, float]:
    """Return each receiver port's latency [s]."""
    out = {receiver.port: receiver.latency_s for receiver in section.receivers}
    if section.heading.kind == "moving_base":
        out.setdefault(section.heading.port, section.heading.latency_s)
    return out


def machine_id_of(machine: MachineModel) -> str:
    """Return the name a machine's frames carry."""
    return machine.name.encode()[:NAME_BYTES].decode(errors="ignore")


@dataclass(frozen=True, slots=True, eq=False)
class LocatedLog:
    """What was known at each moment of the logs.

    Attributes:
        times_s: in the logs' own time [s], rising. located: beside them. frame: of the poses.
        warnings: what had to be assumed, and where a log's times jump.
        spread_s: by how much the ports' latencies differ.
    """

    times_s: tuple[float, ...]
    located: tuple[Located, ...]
    frame: SiteFrame
    warnings: tuple[str, ...]
    spread_s: float = 0.0

    def at(self, t_s: float) -> Located | None:
        """Return what was known once the measurements of a time had arrived; None for a time the logs have not."""
        if not math.isfinite(t_s):
            return None
        i = bisect_left(self.times_s, t_s + self.spread_s + 5e-4) - 1
        return self.located[i] if i >= 0 and self.times_s[i] > t_s - 5e-4 else None


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """One moment of a replay: when [ns], whether bytes arrived, and what was known then."""

    now_ns: int
    heard: bool
    located: Located


def replayed(
    line: Timeline,
    machine: MachineModel,
    crs: ProjectedCrs,
    frame: SiteFrame,
    heights: HeightModel | None = None,
    standing: bool = False,
) -> Iterator[Moment]:
    """Yield what a machine's positioning makes of each moment of a timeline, off rails.

    Args:
        standing: whether the link sensors are those of a machine that stands level, its joints at home.
        heights: left out, as the machine's file says.
    """
    machine_id = machine_id_of(machine)
    locator = Locator(machine, machine_id, crs, frame, heights=heights)
    memory = locator.start()
    links = StandingSensors(machine, machine_id, crs, frame) if standing else None
    decoders: dict[str, StreamDecoder] = {}
    for now_ns, chunks in _moments(line):
        measurements = []
        for chunk in (*(links.read(now_ns) if links else ()), *chunks):
            decoder = decoders.setdefault(chunk.port, StreamDecoder(chunk.port, machine_id))
            measurements += decoder.feed(chunk)
        located, memory = locator.step(measurements, now_ns, memory)
        yield Moment(now_ns, bool(chunks), located)


def locate(
    logs: Sequence[LogFile],
    machine: MachineModel,
    crs: ProjectedCrs,
    heights: HeightModel,
    near: tuple[float, float, float],
    on_bytes: OnBytes | None = None,
) -> LocatedLog:
    """Return what a machine's positioning makes of logs, off rails.

    Args:
        logs: each with the port its bytes arrive on. crs, heights: of the site. near: a place by the work [m].

    Raises:
        InputError: if a log has no times; `MachineError` for a machine without positioning.
    """
    section = positioning_of(machine)
    latency = latencies_of(section)
    line = timeline(logs, latency, on_bytes)
    frame = SiteFrame(crs, np.round(np.asarray(near), -2))
    alone = links_missing(logs, section)
    late = [latency.get(log.port, 0.0) for log in logs]
    times_s: list[float] = []
    known: list[Located] = []
    for moment in replayed(line, machine, crs, frame, heights, alone):
        if moment.heard:
            times_s.append(line.zero_s + moment.now_ns * 1e-9 - min(late))
            known.append(moment.located)
    said = (*((STANDING,) if alone else ()), *line.warnings)
    return LocatedLog(tuple(times_s), tuple(known), frame, said, max(late) - min(late))


def links_missing(logs: Sequence[LogFile], section: PositioningSpec) -> bool:
    """Return whether no log is of a port that link sensors are on."""
    return link_ports(section).isdisjoint(log.port for log in logs)


def _moments(line: Timeline) -> Iterator[tuple[int, tuple[Chunk, ...]]]:
    """Yield the timeline's moments, and moments without bytes in its gaps, so that health sees time pass."""
    before: int | None = None
    step_ns = round(STEP_S * 1e9)
    for now_ns, chunks in line.moments():
        if before is not None:
            for k in range(1, STEPS + 1):
                if before + k * step_ns >= now_ns:
                    break
                yield before + k * step_ns, ()
            if now_ns - before > (STEPS + 1) * step_ns:
                yield now_ns - step_ns, ()
        yield now_ns, chunks
        before = now_ns


def machine_rows(track: Track, located: LocatedLog) -> tuple[Track, list[str | None], list[dict[str, Any] | None]]:
    """Return the track with the machine's own heading, and per epoch the state of health and the machine's pose.

    A heading that two antennas or a moving base gave at that moment replaces what a sentence says; it is the
    undercarriage's. What is unknown is None.
    """
    states: list[str | None] = []
    rows: list[dict[str, Any] | None] = []
    heading = np.array(track.heading)
    for i, t_s in enumerate(track.t_s):
        known = located.at(float(t_s))
        states.append(None if known is None else known.health.state.value)
        rows.append(None if known is None else pose_object(known, located.frame))
        if known is not None and known.fix is not None and math.isfinite(known.fix.heading):
            heading[i] = known.fix.heading % (2.0 * math.pi)
    return replace(track, heading=frozen(heading), warnings=(*track.warnings, *located.warnings)), states, rows


def pose_object(known: Located, frame: SiteFrame) -> dict[str, Any]:
    """Return a machine's pose, where it may be used, and why it is not trusted further."""
    out: dict[str, Any] = {} if known.pose is None else _place(known.pose, frame)
    out["reasons"] = [reason.text for reason in known.health.reasons]
    return out


def _place(pose: MachinePose, frame: SiteFrame) -> dict[str, Any]:
    """Return where the undercarriage's origin is, which way it faces, how it leans, and 1-sigma of each."""
    T = pose.T_site_machine
    e, n, z = frame.to_absolute(T[:3, 3])
    sigma = np.sqrt(np.maximum(np.diagonal(pose.covariance), 0.0))
    return {
        "e": round(float(e), 5),
        "n": round(float(n), 5),
        "z": round(float(z), 5),
        "heading_deg": round(math.degrees(math.atan2(T[0, 0], T[1, 0])) % 360.0, 6) % 360.0,
        "pitch_deg": round(math.degrees(math.asin(max(-1.0, min(1.0, T[2, 0])))), 6),
        "roll_deg": round(math.degrees(math.atan2(T[2, 1], T[2, 2])), 6),
        "sigma_m": [round(float(one), 5) for one in sigma[:3]],
        "sigma_heading_deg": round(math.degrees(float(sigma[5])), 6),
    }
