"""From the bytes of a machine's ports to its posture, pose and health."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from workgauge.machine.model import MachineModel
from workgauge.positioning.check import withheld
from workgauge.site.alignment import Alignment
from workgauge.values.arrays import Floats
from workgauge.values.health import PositionHealth
from workgauge.values.measurements import MachinePose, Posture
from workgauge.values.ports import Chunk
from workgauge.wire.messages import decode
from workgauge.wire.stream import Tally


class Source(Protocol):
    """What sends the bytes of receivers and sensors: simulated ones, a log, a serial port."""

    def advance(self, now_ns: int, q: Floats, T_site_machine: Floats) -> None:
        """Take in the true state after a substep of the simulated machine; a log does not care."""
        ...

    def read(self, now_ns: int) -> list[Chunk]:
        """Return what has arrived by `now_ns` since the last call, oldest first. Never waits."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What is known of the machine: its newest posture and pose, None if there never was one; health, if judged."""

    posture: Posture | None = None
    pose: MachinePose | None = None
    health: PositionHealth | None = None


class Navigator(Protocol):
    """Turns chunks into what is known."""

    @property
    def tallies(self) -> Mapping[str, Tally]:
        """What became of the sentences and messages of each port."""
        ...

    def take(self, chunks: Sequence[Chunk], now_ns: int, track: Alignment | None) -> Known:
        """Return what is known now.

        Args:
            chunks: arrived since the last call, oldest first. now_ns: the tick's clock.
            track: the alignment a rail machine is believed to stand on.
        """
        ...


class PerfectNavigator:
    """Takes posture and pose as finished values of our own frames."""

    def __init__(self) -> None:
        self._known = Known()

    @property
    def tallies(self) -> Mapping[str, Tally]:
        """None: there are no sentences."""
        return {}

    def take(self, chunks: Sequence[Chunk], now_ns: int, track: Alignment | None) -> Known:
        """Return the newest values; the track does not matter."""
        posture, pose = self._known.posture, self._known.pose
        for chunk in chunks:
            value = decode(chunk.data, now_ns).value
            if isinstance(value, Posture):
                posture = value
            elif isinstance(value, MachinePose):
                pose = value
        self._known = Known(posture, pose)
        return self._known


def armed(known: Known, machine: MachineModel, checked: bool) -> Known:
    """Return what is known, stopped for want of a start-of-shift check where the machine's file asks for one."""
    asked = machine.positioning is not None and machine.positioning.thresholds.check_required
    if checked or not asked:
        return known
    return replace(known, health=withheld(known.health, "the machine's file asks for one (needed 1, found 0)", 0))
