"""Who may drive, and whether what they send may be believed: every intent and request passes here first.

Time is an argument. Nothing here moves the machine: what the desk lets through goes to the tick like any other
intent, and the tick judges its age, the guard its wish and the gate its command once more.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from workgauge.loop.inputs import intent_wrong
from workgauge.values.errors import WireError
from workgauge.values.mail import Letter
from workgauge.values.measurements import Intent
from workgauge.values.station import Heard, Request, RequestKind
from workgauge.wire.messages import decode
from workgauge.wire.station import LONGEST_REQUEST, decode_station

#: No intent is longer than this [bytes]; so many senders are told apart.
LONGEST_INTENT, SENDERS = 512, 64
#: Sequences count modulo this.
_COUNT = 2**32
#: So many snapshots are remembered for the round trip.
_REMEMBERED = 256
#: Senders whose name begins so have shown a supervisor's token to the page's server.
SUPERVISOR = "supervisor-"

#: May be asked from anywhere, whoever drives.
_OPEN = frozenset(
    {RequestKind.TAKE, RequestKind.STOP, RequestKind.BEAT, RequestKind.WATCH, RequestKind.LEAVE, RequestKind.OVERRIDE}
)


@dataclass(frozen=True, slots=True)
class DeskSettings:
    """What an operator's link must keep to.

    Attributes:
        intent_age_s: older intents stop the machine; the tick's own limit [s].
        round_trip_s: a link slower than this stops it, too [s].
        gone_s: a driver silent for so long has left the seat [s].
        intents_per_s, requests_per_s: more of one sender are dropped.
    """

    intent_age_s: float = 0.2
    round_trip_s: float = 0.5
    gone_s: float = 5.0
    intents_per_s: float = 120.0
    requests_per_s: float = 20.0


@dataclass(slots=True)
class _Bucket:
    """Lets so many pass per second, and one second's worth at once."""

    rate: float
    left: float
    at_ns: int

    def take(self, now_ns: int) -> bool:
        self.left = min(self.rate, self.left + (now_ns - self.at_ns) * 1e-9 * self.rate)
        self.at_ns = now_ns
        if self.left < 1.0:
            return False
        self.left -= 1.0
        return True


class Desk:
    """Keeps the driver's seat.

    Args:
        machine_id: what is sent to any other is refused. settings: see `DeskSettings`.
    """

    def __init__(self, machine_id: str, settings: DeskSettings | None = None) -> None:
        self.settings = settings or DeskSettings()
        self._machine_id = machine_id
        self.driver = ""
        self.wanted_by = ""
        self.heard = Heard()
        self.left_because = ""
        self._intent: Intent | None = None
        self._sequence: int | None = None
        self._heard_ns = 0
        self._buckets: dict[tuple[str, str], _Bucket] = {}
        self._shown: dict[int, int] = {}
        self._round_trip_s: float | None = None
        self._beat_ns: int | None = None

    def take_intents(self, letters: Iterable[Letter], now_ns: int) -> None:
        """Take in operator intents; the driver's newest counts."""
        for letter in letters:
            if len(letter.data) > LONGEST_INTENT:
                self._count(oversized=1)
                continue
            try:
                message = decode(letter.data, letter.received_ns)
            except WireError:
                self._count(malformed=1)
                continue
            intent = message.value
            if not isinstance(intent, Intent):
                self._count(malformed=1)
            elif not self._room("intent", intent.stamp.source, self.settings.intents_per_s, now_ns):
                self._count(flooding=1)
            elif intent.stamp.machine_id != self._machine_id or intent_wrong(intent) is not None:
                self._count(invalid=1)
            elif intent.stamp.source != self.driver:
                self._count(not_driver=1)
            elif not self._newer(message.sequence):
                self._count(invalid=1)
            else:
                self._intent, self._sequence = intent, message.sequence
                self._heard_ns = now_ns

    def take_requests(self, letters: Iterable[Letter], now_ns: int) -> list[Request]:
        """Return the requests that may be considered, oldest first; those about the seat's link are dealt with."""
        found = []
        for letter in letters:
            if len(letter.data) > LONGEST_REQUEST:
                self._count(oversized=1)
                continue
            try:
                request = decode_station(letter.data, letter.received_ns).value
            except WireError:
                self._count(malformed=1)
                continue
            if not isinstance(request, Request):
                self._count(malformed=1)
            elif request.stamp.machine_id != self._machine_id:
                self._count(invalid=1)
            elif request.kind is RequestKind.BEAT:
                if self._room("beat", request.stamp.source, self.settings.intents_per_s, now_ns):
                    self._beat(request, now_ns)
                else:
                    self._count(flooding=1)
            elif request.kind is not RequestKind.STOP and not self._room(
                "request", request.stamp.source, self.settings.requests_per_s, now_ns
            ):
                self._count(flooding=1)
            elif request.kind is not RequestKind.WATCH:
                found.append(request)
        return found

    def may(self, request: Request) -> str:
        """Return why a request's sender may not ask for this, empty if they may."""
        if request.kind is RequestKind.OVERRIDE and not request.stamp.source.startswith(SUPERVISOR):
            return "only a supervisor may suspend a limit"
        if request.kind not in _OPEN and request.stamp.source != self.driver:
            return "only the driver may"
        return ""

    def seat(self, source: str, now_ns: int) -> None:
        """Give the seat to somebody, or to nobody (empty): nothing of the last one's hands is left."""
        self.driver, self._intent, self._sequence = source, None, None
        self._heard_ns, self._round_trip_s, self._beat_ns = now_ns, None, None
        if self.wanted_by == source:
            self.wanted_by = ""

    def watch_seat(self, now_ns: int) -> str:
        """Return who has left the seat by falling silent, empty for nobody; the seat is free then."""
        if not self.driver or (now_ns - self._heard_ns) * 1e-9 <= self.settings.gone_s:
            return ""
        gone = self.driver
        self.seat("", now_ns)
        return gone

    def published(self, number: int, now_ns: int) -> None:
        """Remember when a snapshot went out."""
        self._shown[number] = now_ns
        self._shown.pop(number - _REMEMBERED, None)

    def round_trip_s(self, now_ns: int) -> float | None:
        """Return how long a snapshot takes to the driver and a word back [s], None for one that never said."""
        if self._beat_ns is None or self._round_trip_s is None:
            return None
        return max(self._round_trip_s, (now_ns - self._beat_ns) * 1e-9)

    def slow(self, now_ns: int) -> bool:
        """Whether the driver's link is too slow to drive on."""
        trip_s = self.round_trip_s(now_ns)
        return trip_s is not None and trip_s > self.settings.round_trip_s

    def intent_age_s(self, now_ns: int) -> float | None:
        """Return the age of the driver's newest intent [s], None without one."""
        return None if self._intent is None else (now_ns - self._intent.stamp.monotonic_ns) * 1e-9

    @property
    def sequence(self) -> int:
        """Sequence of the driver's newest intent, 0 without one."""
        return self._sequence or 0

    def intent(self, now_ns: int, session_ns: int) -> Intent | None:
        """Return the driver's newest intent on the session's clock; None without, and where the link is too slow.

        Args:
            now_ns: real. session_ns: the machine's own time now.
        """
        if self._intent is None or self.slow(now_ns):
            return None
        age_ns = max(now_ns - self._intent.stamp.monotonic_ns, 0)
        stamp = replace(self._intent.stamp, monotonic_ns=session_ns - age_ns)
        return replace(self._intent, stamp=stamp)

    def lost(self, letters: int) -> None:
        """Say how many letters never came."""
        self.heard = replace(self.heard, lost=letters)

    def _beat(self, request: Request, now_ns: int) -> None:
        if request.stamp.source != self.driver:
            return
        shown = self._shown.get(int(request.number)) if request.number is not None else None
        if shown is None:
            self._count(invalid=1)
            return
        self._round_trip_s, self._beat_ns = (now_ns - shown) * 1e-9, now_ns

    def _newer(self, sequence: int) -> bool:
        return self._sequence is None or 0 < (sequence - self._sequence) % _COUNT < _COUNT // 2

    def _room(self, what: str, source: str, rate: float, now_ns: int) -> bool:
        bucket = self._buckets.get((what, source))
        if bucket is None:
            if len(self._buckets) >= SENDERS:
                self._forget(now_ns)
            if len(self._buckets) >= SENDERS and source != self.driver:
                return False
            bucket = self._buckets[(what, source)] = _Bucket(rate, rate, now_ns)
        return bucket.take(now_ns)

    def _forget(self, now_ns: int) -> None:
        """Forget senders that were silent for a while."""
        quiet = [name for name, one in self._buckets.items() if now_ns - one.at_ns > 10_000_000_000]
        for name in quiet:
            del self._buckets[name]

    def _count(self, **more: int) -> None:
        self.heard = replace(self.heard, **{name: getattr(self.heard, name) + n for name, n in more.items()})
