"""Limits suspended by a supervisor: which, for how long, why, by whom."""

from collections.abc import Mapping
from dataclasses import dataclass

from workgauge.rehearse.session import Session
from workgauge.rehearse.station.telling import Names
from workgauge.values.station import Suspended

#: A reason has at least so many letters.
SHORTEST_REASON = 5


@dataclass(frozen=True, slots=True)
class _One:
    until_s: float
    reason: str
    by: str


class Suspensions:
    """What is suspended now.

    Args:
        allowed: id of each limit that may be, to its state and for how many minutes at most.
    """

    def __init__(self, allowed: Mapping[str, tuple[str, float]]) -> None:
        self._states = {name: state for name, (state, _) in allowed.items()}
        self.minutes = {name: minutes for name, (_, minutes) in allowed.items()}
        self._now: dict[str, _One] = {}

    def refused(self, limit: str, minutes: float | None, reason: str) -> str:
        """Return why a limit is not suspended so, empty if it may be."""
        if limit not in self.minutes:
            return "the rule book does not allow this limit to be suspended"
        if minutes is None or not 0.0 <= minutes <= self.minutes[limit]:
            return f"for at most {self.minutes[limit]:g} minutes"
        if minutes > 0.0 and len(reason.strip()) < SHORTEST_REASON:
            return "a reason is needed"
        return ""

    def suspend(self, session: Session, limit: str, minutes: float, reason: str, by: str) -> None:
        """Suspend a limit, or with 0 minutes put it back in force."""
        if minutes <= 0.0:
            self._end(session, limit)
            return
        self._now[limit] = _One(session.t_s + 60.0 * minutes, reason.strip(), by)
        session.off_states |= {self._states[limit]}

    def over(self, session: Session) -> list[str]:
        """Put limits back in force whose time is over; return what is to be said of them."""
        ended = [name for name, one in self._now.items() if session.t_s >= one.until_s]
        for name in ended:
            self._end(session, name)
        return [f"{name} is in force again" for name in ended]

    def now(self, session: Session, names: Names) -> tuple[Suspended, ...]:
        """Return what is suspended."""
        return tuple(
            Suspended(name, names.name(name) or name, round(one.until_s - session.t_s, 1), one.reason, one.by)
            for name, one in self._now.items()
        )

    def _end(self, session: Session, limit: str) -> None:
        self._now.pop(limit, None)
        session.off_states -= {self._states[limit]}
