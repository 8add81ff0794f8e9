"""Real receivers for a run, logs or serial ports: where the machine stands at first, and their bytes by time."""

import re
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from workgauge.bus.serial import SerialPort
from workgauge.geodesy.crs import ProjectedCrs
from workgauge.geodesy.frame import SiteFrame
from workgauge.machine.model import MachineModel
from workgauge.positioning.locate import Locator
from workgauge.positioning.memory import Located
from workgauge.rehearse.located_log import latencies_of, links_missing, machine_id_of, positioning_of, replayed
from workgauge.rehearse.log_file import LogFile, log_files
from workgauge.rehearse.replay import timeline
from workgauge.rehearse.standing import StandingSensors, receiver_ports
from workgauge.values.arrays import Floats
from workgauge.values.errors import InputError
from workgauge.values.ports import Chunk
from workgauge.wire.stream import StreamDecoder

#: A run on a log begins so long before its first usable position, for health to find its feet again [ns].
LEAD_NS = 15_000_000_000

#: A serial port is given so long for a first usable position [s], and looked at so often.
PATIENCE_S, LOOK_S = 60.0, 0.05


class Receivers(Protocol):
    """Receivers outside the program, on a clock that begins with the run."""

    words: str
    warnings: tuple[str, ...]
    lead_s: float  #: how long the run needs at its beginning until the position may be used, about

    def first_pose(self, machine: MachineModel, crs: ProjectedCrs, frame: SiteFrame) -> Floats:
        """Return the first pose (4, 4) in `frame` that may be used, level and with the joints at home.

        Raises:
            InputError: if there is none.
        """
        ...

    def begin(self) -> None:
        """Let the run's clock begin now."""
        ...

    def wait_until(self, now_ns: int) -> None:
        """Return when the run's clock has come to `now_ns`."""
        ...

    def read(self, now_ns: int) -> list[Chunk]:
        """Return what arrived since the last call, oldest first; never waits."""
        ...

    def finished(self, now_ns: int) -> bool:
        """Whether nothing more will come."""
        ...

    @property
    def faults(self) -> tuple[str, ...]:
        """What is gone now, in words."""
        ...

    def close(self) -> None:
        """Give back what was opened."""
        ...


class LogReceivers:
    """Receivers' logs, replayed by the times of their sentences.

    Args:
        logs: each with the port of the machine it is of. machine: with a `positioning` section.

    Raises:
        InputError: if a log cannot be read or has no times; if link sensors are among them.
    """

    def __init__(self, logs: Sequence[LogFile], machine: MachineModel) -> None:
        section = positioning_of(machine)
        if not links_missing(logs, section):
            raise InputError("a run's link sensors are those of the simulated machine", element="--gnss")
        self.line = timeline(logs, latencies_of(section))
        self.words = "the log " + " and ".join(log.path.name for log in logs)
        self.warnings = self.line.warnings
        self._files = ", ".join(str(log.path) for log in logs)
        self._begin_ns = self.line.chunks[0].received_ns
        self.lead_s = 0.0
        self._next = 0

    def first_pose(self, machine: MachineModel, crs: ProjectedCrs, frame: SiteFrame) -> Floats:
        """Return the first usable pose of the logs; the run begins shortly before it."""
        last: Located | None = None
        for moment in replayed(self.line, machine, crs, frame, standing=True):
            last = moment.located
            if last.pose is not None:
                self._begin_ns = max(self._begin_ns, moment.now_ns - LEAD_NS)
                self.lead_s = (moment.now_ns - self._begin_ns) * 1e-9
                return last.pose.T_site_machine
        raise _unusable(self._files, last)

    def begin(self) -> None:
        """Go to where the run begins."""
        chunks = self.line.chunks
        while chunks[self._next].received_ns < self._begin_ns:
            self._next += 1

    def wait_until(self, now_ns: int) -> None:
        """Return at once: a log's time is the run's."""

    def read(self, now_ns: int) -> list[Chunk]:
        """Return the chunks whose time has come."""
        out = []
        chunks = self.line.chunks
        while self._next < len(chunks) and chunks[self._next].received_ns - self._begin_ns <= now_ns:
            chunk = chunks[self._next]
            out.append(Chunk(chunk.port, chunk.received_ns - self._begin_ns, chunk.data))
            self._next += 1
        return out

    @property
    def left_s(self) -> float:
        """What the run has of the logs [s]."""
        return (self.line.end_ns - self._begin_ns) * 1e-9

    def finished(self, now_ns: int) -> bool:
        """Whether the logs are at their end."""
        return self._next >= len(self.line.chunks)

    @property
    def faults(self) -> tuple[str, ...]:
        """None: a log cannot be unplugged."""
        return ()

    def close(self) -> None:
        """Nothing is open."""


class PortReceivers:
    """Receivers on serial ports, in real time.

    Args:
        devices: (device, baud, port of the machine it is). clock, sleep: of the computer.

    Raises:
        InputError: if a device cannot be opened; those opened before are given back.
    """

    def __init__(
        self,
        devices: Sequence[tuple[str, int, str]],
        *,
        clock: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
        patience_s: float = PATIENCE_S,
    ) -> None:
        self._clock, self._sleep, self._patience_s = clock, sleep, patience_s
        self._zero_ns = clock()
        self._ports: list[SerialPort] = []
        try:
            for device, baud, port in devices:
                self._ports.append(SerialPort(device, baud, port=port, clock=lambda: clock() - self._zero_ns))
        except InputError:
            self.close()
            raise
        self.words = "the serial port " + " and ".join(f"{device} at {baud} baud" for device, baud, _ in devices)
        self.warnings: tuple[str, ...] = ()
        self.lead_s = 0.0

    def first_pose(self, machine: MachineModel, crs: ProjectedCrs, frame: SiteFrame) -> Floats:
        """Wait for the first usable pose."""
        machine_id = machine_id_of(machine)
        locator = Locator(machine, machine_id, crs, frame)
        links = StandingSensors(machine, machine_id, crs, frame)
        decoders = {port.port: StreamDecoder(port.port, machine_id) for port in self._ports}
        memory, located = locator.start(), None
        began_ns = self._now_ns()
        until_ns = began_ns + round(self._patience_s * 1e9)
        while (now_ns := self._now_ns()) < until_ns:
            chunks = self.read(now_ns)
            measurements = [one for chunk in chunks for one in decoders[chunk.port].feed(chunk)]
            for chunk in links.read(now_ns):
                decoder = decoders.setdefault(chunk.port, StreamDecoder(chunk.port, machine_id))
                measurements += decoder.feed(chunk)
            located, memory = locator.step(measurements, now_ns, memory)
            if located.pose is not None:
                self.lead_s = (now_ns - began_ns) * 1e-9
                return located.pose.T_site_machine
            self._sleep(LOOK_S)
        faults = [port.fault for port in self._ports if port.fault is not None]
        raise _unusable(faults[0] if faults else ", ".join(port.device for port in self._ports), located)

    def begin(self) -> None:
        """Let the clock begin; what arrived before is let go."""
        for port in self._ports:
            port.read()
        self._zero_ns = self._clock()

    def wait_until(self, now_ns: int) -> None:
        """Sleep until the computer's clock has come so far."""
        left = (now_ns - self._now_ns()) * 1e-9
        if left > 0:
            self._sleep(left)

    def read(self, now_ns: int) -> list[Chunk]:
        """Return what arrived, none of it later than now or before the beginning."""
        chunks = [chunk for port in self._ports for chunk in port.read() if chunk.received_ns >= 0]
        chunks.sort(key=lambda chunk: chunk.received_ns)
        return [Chunk(chunk.port, min(chunk.received_ns, now_ns), chunk.data) for chunk in chunks]

    @property
    def faults(self) -> tuple[str, ...]:
        """Which devices are gone, in words."""
        return tuple(port.fault for port in self._ports if port.fault is not None)

    def finished(self, now_ns: int) -> bool:
        """Whether nothing more will come: never, a device may be plugged in again."""
        return False

    def close(self) -> None:
        """Give the devices back."""
        for port in self._ports:
            port.close()

    def _now_ns(self) -> int:
        return self._clock() - self._zero_ns


def _unusable(where: str, located: Located | None) -> InputError:
    why = () if located is None else located.health.reasons
    return InputError(
        "no position the machine could start from",
        element=where,
        value="; ".join(reason.text for reason in why) or "nothing a receiver says",
        allowed="receivers as the machine's `positioning` section has them, with fixes it may use",
    )


#: `/dev/ttyUSB0`, `COM3`, `/dev/ttyUSB0@230400`: what names a serial port.
_DEVICE = re.compile(
    r"^(?:(?P<port>[A-Za-z][A-Za-z0-9_-]{0,31})=)?(?P<device>COM[0-9]+|/[^@]*)(?:@(?P<baud>[0-9]+))?$"
)

#: Speed of a serial port where none is said.
BAUD = 115_200


def open_receivers(given: Sequence[str], machine: MachineModel) -> LogReceivers | PortReceivers:
    """Return the receivers of `[PORT=]LOG` or `[PORT=]DEVICE[@BAUD]` arguments, all of one kind.

    Args:
        given: the arguments. machine: with a `positioning` section; what names no port takes the machine's in order.

    Raises:
        InputError: for logs beside devices, for what is neither, and for what cannot be read or opened.
    """
    ports = receiver_ports(positioning_of(machine))
    found = [_DEVICE.match(one) for one in given]
    devices = [one for one in found if one is not None and _is_device(one["device"])]
    if not devices:
        return LogReceivers(log_files(list(given), ports), machine)
    if len(devices) < len(given):
        raise InputError(
            "logs and serial ports together", element="--gnss", value=" ".join(given), allowed="one or the other"
        )
    named = [one["port"] for one in devices if one["port"] is not None]
    free = [port for port in ports if port not in named]
    if not set(named) <= set(ports) or len(set(named)) < len(named) or len(devices) - len(named) > len(free):
        raise InputError(
            "the machine has no such receivers",
            element="--gnss",
            value=" ".join(given),
            allowed=", ".join(f"{port}=DEVICE" for port in ports),
        )
    return PortReceivers([(one["device"], int(one["baud"] or BAUD), one["port"] or free.pop(0)) for one in devices])


def _is_device(name: str) -> bool:
    """Whether this names a device rather than a log: a character device, or a Windows port."""
    return name.startswith("COM") or Path(name).is_char_device()


def near_of(T_site_machine: Floats, frame: SiteFrame) -> tuple[float, float, float]:
    """Return (east, north [m], heading [degree] from grid north) of a pose in a local frame."""
    e, n, _ = frame.to_absolute(T_site_machine[:3, 3])
    heading = float(np.degrees(np.arctan2(T_site_machine[0, 0], T_site_machine[1, 0])) % 360.0)
    return float(e), float(n), heading
