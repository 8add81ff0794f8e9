"""Where each measurement goes: to its receiver, its link sensor, the heading, or nowhere."""

from collections.abc import Sequence
from dataclasses import replace

from workgauge.machine.model import MachineModel
from workgauge.machine.positioning import PositioningSpec
from workgauge.positioning.memory import LocatorMemory
from workgauge.positioning.posture import Channel, Reading
from workgauge.positioning.timing import KEPT_EPOCHS, KEPT_SAMPLES, Heard, Sample, TimedHeading, epoch_key
from workgauge.values.measurements import Stamp
from workgauge.values.navigation import (
    AngularRate,
    EncoderReading,
    GnssError,
    GnssFix,
    GnssHeading,
    GnssVelocity,
    Inclination,
    Measurement,
)


class Intake:
    """Sorts measurements into the locator's memory; immutable.

    A receiver is known by its port, and by its talker where the machine file names one. A link sensor is known by its
    name. Positions in a receiver's own projection (PTNL,PJK) are not used: nobody says which projection that is.

    Args:
        channels: the link sensors, in the order of `LocatorMemory.samples`.
    """

    def __init__(
        self, machine: MachineModel, machine_id: str, spec: PositioningSpec, channels: Sequence[Channel]
    ) -> None:
        self._machine_id = machine_id
        self._receivers = [
            (one.port, one.talker, round(one.latency_s * 1e9), i) for i, one in enumerate(spec.receivers)
        ]
        self._heading = (spec.heading.port, round(spec.heading.latency_s * 1e9))
        self._silence_ns = round(spec.thresholds.fix_age_s * 1e9)
        self._channels: dict[str, tuple[int, int, bool]] = {}
        for i, channel in enumerate(channels):
            place = (i, round(channel.latency_s * 1e9), channel.tilting)
            self._channels[channel.name] = self._channels[f"{channel.port}/{channel.name}"] = place
        imus = sorted((one for one in machine.sensors if one.kind == "imu"), key=lambda one: one.link)
        #: Name of the gyro nearest the undercarriage, None without one.
        self.gyro = imus[0].name if imus else None

    def nothing(self) -> LocatorMemory:
        """Return the memory before anything was taken in."""
        count = len({index for index, _, _ in self._channels.values()})
        return LocatorMemory(((),) * count, (Heard(),) * len(self._receivers))

    def take(self, measurements: Sequence[Measurement], memory: LocatorMemory) -> tuple[LocatorMemory, bool]:
        """Return the memory with measurements in it, and whether a link sensor was among them."""
        samples, heard, links = list(memory.samples), list(memory.heard), False
        headings, clock, gyro = memory.headings, memory.heading_clock, memory.gyro
        for one in measurements:
            if one.stamp.machine_id != self._machine_id:
                continue
            if isinstance(one, Inclination | EncoderReading):
                links = self._link(one, samples) or links
            elif isinstance(one, AngularRate):
                if one.stamp.source.rpartition("/")[2] == self.gyro:
                    gyro = one
            elif isinstance(one, GnssHeading):
                port, latency_ns = self._heading
                if one.stamp.source.partition("/")[0] == port:
                    stamp = one.stamp
                    if stamp.epoch_ns is not None:
                        clock = clock.heard(stamp.monotonic_ns, stamp.epoch_ns)
                    valid = clock.valid_ns(stamp.monotonic_ns, stamp.epoch_ns, latency_ns)
                    key = epoch_key(stamp.epoch_ns, one.time_of_day_s)
                    headings = (*headings, TimedHeading(valid, key, one))[-KEPT_EPOCHS:]
            elif isinstance(one, GnssFix | GnssError | GnssVelocity):
                for receiver, latency_ns in self._of(one.stamp):
                    heard[receiver] = heard[receiver].hear(one, latency_ns, self._silence_ns)
        memory = replace(
            memory,
            samples=tuple(samples),
            heard=tuple(heard),
            headings=headings,
            heading_clock=clock,
            gyro=gyro,
        )
        return memory, links

    def _of(self, stamp: Stamp) -> list[tuple[int, int]]:
        port, _, talker = stamp.source.partition("/")
        return [
            (receiver, latency_ns)
            for known, wanted, latency_ns, receiver in self._receivers
            if known == port and wanted in (None, talker)
        ]

    def _link(self, one: Inclination | EncoderReading, samples: list[tuple[Sample, ...]]) -> bool:
        """Add a link sensor's reading; return whether it belongs to one."""
        place = self._channels.get(one.stamp.source)
        if place is None:
            return False
        channel, latency_ns, tilting = place
        if isinstance(one, Inclination):
            reading = Reading(one.roll, one.pitch, one.sigma)
            finite = abs(one.roll) + abs(one.pitch) < 1e3
        else:
            reading = Reading(one.value, 0.0, one.sigma)
            finite = abs(one.value) < 1e6
        valid = one.stamp.monotonic_ns - latency_ns
        known = samples[channel]
        if not finite or tilting != isinstance(one, Inclination) or (known and valid <= known[-1].valid_ns):
            return False
        samples[channel] = (*known[1 - KEPT_SAMPLES :], Sample(valid, reading))
        return True
