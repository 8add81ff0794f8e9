"""The wire between a sensor and the program: silence, repeated bytes, bit errors, and bytes that take their time."""

import heapq
from dataclasses import dataclass

import numpy as np

from workgauge.sim.sensors.faults import Fault, FaultKind, FaultsOf, Identity, one
from workgauge.sim.sensors.randomness import generator
from workgauge.values.ports import Chunk


class Outbox:
    """Bytes under way, each due at its time on the plant's clock."""

    def __init__(self) -> None:
        self._waiting: list[tuple[int, int, str, bytes]] = []
        self._count = 0

    def put(self, port: str, due_ns: int, data: bytes) -> None:
        """Let bytes arrive on a port at a time."""
        heapq.heappush(self._waiting, (due_ns, self._count, port, data))
        self._count += 1

    def take(self, now_ns: int) -> list[Chunk]:
        """Return what is due by now, oldest first; bytes that arrive together on a port come in one chunk."""
        chunks: list[Chunk] = []
        together: dict[str, list[bytes]] = {}
        due_ns = 0
        while self._waiting and self._waiting[0][0] <= now_ns:
            due, _, port, data = heapq.heappop(self._waiting)
            if due != due_ns:
                chunks += [Chunk(name, due_ns, b"".join(parts)) for name, parts in together.items()]
                together.clear()
                due_ns = due
            together.setdefault(port, []).append(data)
        chunks += [Chunk(name, due_ns, b"".join(parts)) for name, parts in together.items()]
        return chunks


class Line:
    """One sensor's bytes on their way; they never overtake each other.

    Args:
        identity: whose line it is. faults: all of the scenario.
        latency_s: from the epoch to the arrival. jitter_s: mean of an additional exponential delay.
        seed: of all sensors. outbox: where the bytes wait.
    """

    def __init__(
        self,
        identity: Identity,
        faults: tuple[Fault, ...],
        latency_s: float,
        jitter_s: float,
        seed: int,
        outbox: Outbox,
    ) -> None:
        self.identity = identity
        self.faults = FaultsOf(identity, faults)
        self._latency_ns = round(latency_s * 1e9)
        self._jitter_ns = jitter_s * 1e9
        self._outbox = outbox
        self._jitter = generator(seed, identity.group, identity.name, identity.part, "jitter")
        self._errors = generator(seed, identity.group, identity.name, identity.part, "bad bytes")
        self._last_due_ns = 0
        self._last_data = b""

    def send(self, t_ns: int, data: bytes, active: tuple[Fault, ...]) -> None:
        """Send the bytes of the measurement at `t_ns`, with the faults that are active then."""
        delay_ns = self._latency_ns
        if self._jitter_ns > 0.0:
            delay_ns += round(self._jitter.standard_exponential() * self._jitter_ns)
        for fault in active:
            if fault.kind is FaultKind.LATENCY:
                delay_ns += round(fault.delay_s * 1e9)
        if one(active, FaultKind.SILENCE) is not None:
            return
        stuck = one(active, FaultKind.FROZEN)
        if stuck is not None and stuck.clock_stopped and self._last_data:
            data = self._last_data
        self._last_data = data
        for fault in active:
            if fault.kind is FaultKind.BAD_BYTES:
                data = corrupted(data, fault.flipped, fault.dropped, self._errors)
        self._last_due_ns = max(t_ns + delay_ns, self._last_due_ns)
        if data:
            self._outbox.put(self.identity.port, self._last_due_ns, data)


@dataclass(frozen=True, slots=True)
class Wiring:
    """What all sensors of a kit share.

    Attributes:
        machine_id: in their frames. seed: of all random numbers. origin_ns: no epoch is earlier.
        faults: of the scenario. outbox: where bytes wait.
    """

    machine_id: str
    seed: int
    origin_ns: int
    faults: tuple[Fault, ...]
    outbox: Outbox

    def line(self, identity: Identity, latency_s: float, jitter_s: float) -> Line:
        """Return the line of a sensor."""
        return Line(identity, self.faults, latency_s, jitter_s, self.seed, self.outbox)


def corrupted(data: bytes, flipped: float, dropped: float, source: np.random.Generator) -> bytes:
    """Return bytes with one bit flipped in a share of them, and another share of them lost."""
    array = np.frombuffer(data, dtype=np.uint8).copy()
    hit = source.random(len(array)) < flipped
    array ^= np.where(hit, 1 << source.integers(0, 8, len(array)), 0).astype(np.uint8)
    return array[source.random(len(array)) >= dropped].tobytes()
