"""Reasons of single ticks gathered into interventions: one per cause, from its first tick to its last."""

from collections.abc import Iterable
from dataclasses import dataclass

from workgauge.rehearse.result import Intervention
from workgauge.values.reasons import Reason, ReasonCode

#: A cause that pauses for less than this and comes back is still the same intervention [s].
PAUSE_S = 0.25

#: Not interventions while the operator wants nothing: nothing is being held back.
IDLE = frozenset({ReasonCode.NOT_ENABLED, ReasonCode.NOT_NEUTRAL, ReasonCode.GATE_CLOSED, ReasonCode.NO_INTENT})

_Cause = tuple[ReasonCode, str | None, str | None]


@dataclass(slots=True)
class _Open:
    """An intervention in progress, with its most telling moment."""

    t_s: float
    until_s: float
    worst: Reason


class InterventionLog:
    """Takes in the reasons of every tick, in order.

    A cause is a code, a limit and a joint; the link, clearance, scale and text kept are those of the moment with the
    least speed left.
    """

    def __init__(self) -> None:
        self._open: dict[_Cause, _Open] = {}
        self._closed: list[_Open] = []

    def take(self, t_s: float, tick_s: float, reasons: Iterable[Reason], wanted: bool) -> None:
        """Take in one tick's reasons.

        Args:
            t_s: start of the tick [s]. tick_s: its length [s].
            wanted: whether the operator wanted any motion.
        """
        for reason in reasons:
            if reason.code in IDLE and not wanted:
                continue
            cause = (reason.code, reason.limit, reason.joint)
            current = self._open.get(cause)
            if current is not None and t_s - current.until_s > PAUSE_S:
                self._closed.append(current)
                current = None
            if current is None:
                self._open[cause] = _Open(t_s, t_s + tick_s, reason)
                continue
            current.until_s = t_s + tick_s
            if _severity(reason) < _severity(current.worst):
                current.worst = reason

    def interventions(self) -> tuple[Intervention, ...]:
        """Return all of them by their beginning."""
        found = sorted(
            (*self._closed, *self._open.values()), key=lambda one: (one.t_s, one.worst.code, one.worst.limit or "")
        )
        return tuple(
            Intervention(
                t_s=one.t_s,
                until_s=one.until_s,
                reason=str(one.worst.code),
                link=one.worst.link,
                limit=one.worst.limit,
                joint=one.worst.joint,
                clearance_m=one.worst.clearance_m,
                scale=one.worst.scale,
                text=one.worst.text,
                protection_m=one.worst.protection_m,
                stop_distance_m=one.worst.stop_distance_m,
            )
            for one in found
        )


def _severity(reason: Reason) -> tuple[float, float]:
    """Order reasons: the least speed left first, then the smallest clearance."""
    return (
        1.0 if reason.scale is None else reason.scale,
        float("inf") if reason.clearance_m is None else reason.clearance_m,
    )
