"""What goes wrong with simulated sensors, when, and with which of them."""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from workgauge.values.errors import ScenarioError
from workgauge.values.navigation import FixQuality

#: Names every sensor of the machine that is no receiver.
ALL_SENSORS = "all"

#: What the heading of a moving base is called beside the receivers.
HEADING = "heading"


class FaultKind(StrEnum):
    """Every fault a scenario can have."""

    FLOAT = "float"  #: ambiguities not fixed: a worse fix, stated as such
    DIFFERENTIAL = "differential"
    SINGLE = "single"
    OUTAGE = "outage"  #: messages go on, without a fix
    SILENCE = "silence"  #: nothing at all is sent
    JUMP = "jump"  #: multipath: the position is off, the receiver does not know
    FROZEN = "frozen"  #: the same measurement again and again
    SWAPPED = "swapped"  #: the cables of the two antennas exchanged
    ANTENNA_MOVED = "antenna_moved"  #: an antenna is not where the machine's file says
    CORRECTION_AGE = "correction_age"  #: corrections stop arriving, their age grows
    SENSOR_JUMP = "sensor_jump"  #: a link sensor is off by an angle or a length
    BAD_BYTES = "bad_bytes"  #: bits flipped, bytes lost
    FOREIGN_RECEIVER = "foreign_receiver"  #: another receiver writes into the same stream
    LATENCY = "latency"  #: bytes arrive later than they should
    CLOCK_STEP = "clock_step"  #: the receiver's own time is off


#: Faults of receivers (and the heading of a moving base) that only lower the quality, with what is left of it.
LOWERED = {
    FaultKind.OUTAGE: FixQuality.NONE,
    FaultKind.SINGLE: FixQuality.SINGLE,
    FaultKind.DIFFERENTIAL: FixQuality.DIFFERENTIAL,
    FaultKind.FLOAT: FixQuality.FLOAT,
}

#: Qualities from worst to best.
ORDER = (FixQuality.NONE, FixQuality.SINGLE, FixQuality.DIFFERENTIAL, FixQuality.FLOAT, FixQuality.FIXED)

_ANY = frozenset({"receiver", "heading", "sensor"})
_GNSS = frozenset({"receiver", "heading"})

#: What each fault can befall.
BEFALLS: dict[FaultKind, frozenset[str]] = {
    **dict.fromkeys(LOWERED, _GNSS),
    FaultKind.SILENCE: _ANY,
    FaultKind.JUMP: frozenset({"receiver"}),
    FaultKind.FROZEN: _ANY,
    FaultKind.SWAPPED: _GNSS,
    FaultKind.ANTENNA_MOVED: frozenset({"receiver"}),
    FaultKind.CORRECTION_AGE: frozenset({"receiver"}),
    FaultKind.SENSOR_JUMP: frozenset({"sensor"}),
    FaultKind.BAD_BYTES: _ANY,
    FaultKind.FOREIGN_RECEIVER: frozenset({"receiver"}),
    FaultKind.LATENCY: _ANY,
    FaultKind.CLOCK_STEP: _GNSS,
}


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault in its window of time.

    Attributes:
        kind: what it does.
        from_ns, until_ns: measurements of epochs in [from, until) are hit, on the plant's clock; None: to the end.
        receiver, sensor, port: whom it befalls: a receiver by name (or `heading`), a link sensor by name (or `all`),
            or everything on a port. None of them: every receiver and the heading of a moving base.
        offset_m: of a jump: (east, north, up); of a moved antenna: in the axes of its link; of a foreign receiver:
            from the antenna of the receiver it disturbs, (east, north, up).
        ramp_s: a jump grows for so long. offset: of a link sensor [rad, m]. delay_s: of a latency.
        step_s: of a clock. clock_stopped: a frozen receiver repeats its bytes, time and all.
        flipped, dropped: share of the bytes. talker: of a foreign receiver.
    """

    kind: FaultKind
    from_ns: int = 0
    until_ns: int | None = None
    receiver: str | None = None
    sensor: str | None = None
    port: str | None = None
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ramp_s: float = 0.0
    offset: float = 0.0
    delay_s: float = 0.0
    step_s: float = 0.0
    clock_stopped: bool = False
    flipped: float = 0.0
    dropped: float = 0.0
    talker: str = "GP"

    def active(self, t_ns: int) -> bool:
        """Return whether a measurement of this epoch is hit."""
        return self.from_ns <= t_ns and (self.until_ns is None or t_ns < self.until_ns)

    def since_s(self, t_ns: int) -> float:
        """Return how long it has lasted [s]."""
        return (t_ns - self.from_ns) * 1e-9


@dataclass(frozen=True, slots=True)
class Identity:
    """What a fault is aimed at.

    Attributes:
        name: of the receiver or sensor. group: receiver, heading, sensor or foreign. port: where its bytes arrive.
        part: tells one sensor's lines apart.
    """

    name: str
    group: str
    port: str
    part: str = ""


class FaultsOf:
    """The faults of one stream, looked up by time."""

    def __init__(self, identity: Identity, faults: Iterable[Fault]) -> None:
        self.all = tuple(fault for fault in faults if _befalls(fault, identity))

    def at(self, t_ns: int) -> tuple[Fault, ...]:
        """Return those that hit a measurement of this epoch."""
        if not self.all:
            return ()
        return tuple(fault for fault in self.all if fault.active(t_ns))


def one(faults: tuple[Fault, ...], kind: FaultKind) -> Fault | None:
    """Return the last of the faults of a kind, or None."""
    found = None
    for fault in faults:
        if fault.kind is kind:
            found = fault
    return found


def lowered(quality: FixQuality, faults: tuple[Fault, ...]) -> FixQuality:
    """Return what the faults leave of a quality: the worst of all."""
    for fault in faults:
        worse = LOWERED.get(fault.kind)
        if worse is not None and ORDER.index(worse) < ORDER.index(quality):
            quality = worse
    return quality


def check_targets(faults: Iterable[Fault], identities: Iterable[Identity]) -> None:
    """Refuse faults that befall nothing.

    Raises:
        ScenarioError: naming the fault, whom it was aimed at, and whom it could befall.
    """
    known = tuple(identities)
    for i, fault in enumerate(faults):
        if any(_befalls(fault, identity) for identity in known):
            continue
        fit = [identity for identity in known if identity.group in BEFALLS[fault.kind]]
        for key in ("receiver", "sensor", "port"):
            aimed = getattr(fault, key)
            if aimed is not None:
                group = {"receiver": ("receiver", "heading"), "sensor": ("sensor",)}.get(key)
                names = {
                    one.port if group is None else one.name for one in fit if group is None or one.group in group
                }
                raise ScenarioError(
                    f"`{fault.kind}` befalls no such {key}",
                    element=f"faults.{i}.{key}",
                    value=aimed,
                    allowed=", ".join(sorted(names)) or "none on this machine",
                )
        raise ScenarioError(f"`{fault.kind}` needs a `sensor`", element=f"faults.{i}", allowed=_names(fit))


def _names(identities: Iterable[Identity]) -> str:
    return ", ".join(sorted({identity.name for identity in identities})) or "none on this machine"


def _befalls(fault: Fault, identity: Identity) -> bool:
    if identity.group not in BEFALLS[fault.kind]:
        return False
    if fault.receiver is not None:
        return identity.group != "sensor" and identity.name == fault.receiver
    if fault.sensor is not None:
        return identity.group == "sensor" and fault.sensor in (identity.name, ALL_SENSORS)
    if fault.port is not None:
        return identity.port == fault.port
    return identity.group != "sensor"
