"""What one step of a session did."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from workgauge.gauge.following import OnTracks
from workgauge.loop.inputs import TickInputs
from workgauge.loop.tick import Trace
from workgauge.rehearse.navigation import Known
from workgauge.rehearse.travelling import Travel
from workgauge.rehearse.truth import Reading

#: Is handed each tick: its inputs, the command bytes that left, and what it saw.
Observer: TypeAlias = Callable[[TickInputs, bytes, Trace], None]


@dataclass(frozen=True, slots=True, eq=False)
class StepResult:
    """What one step did.

    Attributes:
        t_s: start of the tick [s].
        trace: what the tick saw, wanted and allowed, with its reasons.
        frame: the valve command bytes that left the tick.
        truth: the nearest true clearance within the step. before: the truth at the step's beginning.
        known: posture, pose and health the tick was given. tracks: what the machine is believed to stand on.
        travel: of the undercarriage.
        tick_ms: wall-clock time of the tick alone [ms].
    """

    t_s: float
    trace: Trace
    frame: bytes
    truth: Reading
    before: Reading
    known: Known
    tracks: OnTracks
    travel: Travel
    tick_ms: float
