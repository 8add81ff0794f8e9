"""What a running machine tells everybody who watches, and what they may ask of it."""

from dataclasses import dataclass
from enum import StrEnum

from workgauge.values.measurements import Stamp


class RequestKind(StrEnum):
    """What can be asked of a running machine. All but STOP, TAKE, BEAT, WATCH and OVERRIDE need the driver's seat."""

    TAKE = "take"  #: the driver's seat, if it is free; else its driver is told that it is wanted. Ends a scenario
    GIVE = "give"  #: `text`: hand the seat over to
    LEAVE = "leave"  #: the seat
    STOP = "stop"  #: the machine, whoever drives
    CLEAR = "clear"  #: an earlier stop
    STATE = "state"  #: `text`: a work state; `on`: whether it is
    GUARD = "guard"  #: `text`: its name; `settings`: its thresholds
    PLAY = "play"  #: the scenario's own drive, from its beginning; the driver keeps the seat, their hands rest
    PAUSE = "pause"  #: or, with `on` false, go on
    RESTART = "restart"  #: put the machine back where it began
    PREVIEW = "preview"  #: `text`: an id; `numbers`: 12, upper rows of the tool's goal in the site; `on`: turned, too
    RUN = "run"  #: `text`: id of the preview to run
    CANCEL = "cancel"  #: a preview, or what runs
    OVERRIDE = "override"  #: `text`: a limit; `number`: minutes; `reason`: why. 0 minutes: end it
    BEAT = "beat"  #: `number`: of the newest snapshot seen; measures the round trip
    WATCH = "watch"  #: says that somebody is there


@dataclass(frozen=True, slots=True)
class Request:
    """Something asked of a machine.

    Attributes:
        stamp: its source is who asks. id: of the asker's own making, for the answer.
        kind: what is asked; the rest is as `RequestKind` says.
    """

    stamp: Stamp
    id: str
    kind: RequestKind
    text: str = ""
    reason: str = ""
    number: float | None = None
    on: bool | None = None
    numbers: tuple[float, ...] = ()
    settings: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, slots=True)
class Answer:
    """What became of a request: who asked, its id, whether it was done, and why not."""

    to: str
    id: str
    done: bool
    text: str


@dataclass(frozen=True, slots=True)
class Near:
    """One clearance, nearest first. Points (3) in the site's local frame [m]; `stop_m`: None for the guard's."""

    link: str
    limit: str
    name: str
    kind: str
    distance_m: float
    protection_m: float
    stop_m: float | None
    point_machine: tuple[float, ...]
    point_limit: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Held:
    """One reason why the machine is held back, its limit by name; see `Reason`."""

    code: str
    text: str
    link: str | None
    limit: str | None
    joint: str | None
    clearance_m: float | None
    scale: float | None


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened, for the log: when [s, of the machine's time] and what."""

    t_s: float
    text: str


@dataclass(frozen=True, slots=True)
class Foreseen:
    """What a preview came to.

    Attributes:
        id: of the request. ready: whether it may be run. text: the verdict in words.
        duration_s: None if it does not get there. goal: (12) as asked.
        postures: (k) of (n) joints on the way [rad, m]. tool: (k) of (3) in the site's local frame [m].
    """

    id: str
    ready: bool
    text: str
    duration_s: float | None
    goal: tuple[float, ...]
    postures: tuple[tuple[float, ...], ...]
    tool: tuple[tuple[float, ...], ...]


@dataclass(frozen=True, slots=True)
class Suspended:
    """A limit suspended by a supervisor: its id and name, how long yet [s], why, and who did it."""

    limit: str
    name: str
    left_s: float
    reason: str
    by: str


@dataclass(frozen=True, slots=True)
class Heard:
    """What was refused so far, by cause."""

    malformed: int = 0
    oversized: int = 0
    flooding: int = 0
    not_driver: int = 0
    invalid: int = 0
    lost: int = 0


@dataclass(frozen=True, slots=True)
class Snapshot:
    """A machine as it is now. What is not known is None.

    Attributes:
        stamp: of the machine. number: counts up.
        t_s: the machine's own time [s].
        doing: `driving`, `scenario`, `paused` or `idle`. step: of the scenario, in words.
        driver, wanted_by: who has the seat, and who wants it; empty for nobody.
        round_trip_ms: of the driver's link. intent_age_ms: of the driver's newest intent. intent: its sequence.
        stopped: why somebody stopped the machine, empty if nobody did. enabled: whether the gate lets commands pass.
        q: (n) joints [rad, m]. pose: (12) upper rows of T_site_machine.
        stop_q: (n) where the joints would come to rest if the valves closed now.
        desired, allowed: (n) joint speeds [rad/s, m/s]. valves: (n) as sent.
        levers: (6) of the driver. scale: what the guard left.
        near: clearances, the nearest first. held: every reason of the tick.
        ranges: (n) of (least, greatest) speed each lever alone may still command; empty if the guard cannot say.
        health: state of the position. health_reasons: in words.
        guard, settings: in use. off_states: work states that are off.
        let_off: tracks whose envelopes are no limit now.
        suspended: limits a supervisor has suspended.
        preview: the last one, and whether one is being worked on. running: id of the preview that runs.
        job: state of what runs. tick_ms: the last second's median and greatest. late_ticks: begun late.
        heard: what was refused. answers, events: the newest.
    """

    stamp: Stamp
    number: int
    t_s: float
    doing: str
    step: str
    driver: str
    wanted_by: str
    round_trip_ms: float | None
    intent_age_ms: float | None
    intent: int
    stopped: str
    enabled: bool
    q: tuple[float, ...]
    pose: tuple[float, ...]
    stop_q: tuple[float, ...]
    desired: tuple[float, ...]
    allowed: tuple[float, ...]
    valves: tuple[int, ...]
    levers: tuple[float, ...]
    scale: float
    near: tuple[Near, ...]
    held: tuple[Held, ...]
    ranges: tuple[tuple[float, float], ...]
    health: str
    health_reasons: tuple[str, ...]
    guard: str
    settings: tuple[tuple[str, float], ...]
    off_states: tuple[str, ...]
    let_off: tuple[str, ...]
    suspended: tuple[Suspended, ...]
    preview: str
    previewing: bool
    running: str
    job: str
    tick_ms: tuple[float, float]
    late_ticks: int
    heard: Heard
    answers: tuple[Answer, ...]
    events: tuple[Event, ...]


@dataclass(frozen=True, slots=True)
class JointFacts:
    """A joint: its name, the lever that moves it and in which sense, its full speeds, and whether it slides."""

    name: str
    lever: str | None
    sign: float
    speed_positive: float
    speed_negative: float
    slides: bool


@dataclass(frozen=True, slots=True)
class GuardFacts:
    """A guard that can be chosen, and its thresholds as (name, value, least, greatest) [m]."""

    name: str
    settings: tuple[tuple[str, float, float, float], ...]


@dataclass(frozen=True, slots=True)
class Setup:
    """What does not change while a machine runs.

    Attributes:
        title, site, rules: for people. joints: see `JointFacts`. states: work states that can be switched.
        guards: to choose from. scenario: whether there is one to play.
        may_suspend: (id, name, minutes at most) of limits a supervisor may suspend.
        intent_age_ms, round_trip_ms: limits beyond which the machine stops. period_ms: of the tick.
    """

    stamp: Stamp
    title: str
    machine: str
    site: str
    rules: str
    joints: tuple[JointFacts, ...]
    states: tuple[str, ...]
    guards: tuple[GuardFacts, ...]
    scenario: bool
    may_suspend: tuple[tuple[str, str, float], ...]
    intent_age_ms: float
    round_trip_ms: float
    period_ms: float


@dataclass(frozen=True, slots=True)
class PreviewTask:
    """A goal to be looked at ahead of time: from where, among what.

    Attributes:
        id: of the request. goal: (12) upper rows of the tool's pose in the site.
        full: whether its orientation counts.
        q: (n). pose: (12) of the machine. off_states, let_off: see `TickInputs`. guard, settings: to be used.
    """

    stamp: Stamp
    id: str
    goal: tuple[float, ...]
    full: bool
    q: tuple[float, ...]
    pose: tuple[float, ...]
    off_states: tuple[str, ...]
    let_off: tuple[str, ...]
    guard: str
    settings: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True)
class PreviewResult:
    """A preview that is done."""

    stamp: Stamp
    found: Foreseen


@dataclass(frozen=True, slots=True)
class Handle:
    """Where the tool's drag handle stands: (12) upper rows of the tool's goal in the site's local frame."""

    stamp: Stamp
    pose: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Camera:
    """How one page wants to look: `view` is `overview`, `top`, `side`, `cab` or `follow`; `dark` for night."""

    stamp: Stamp
    page: str
    view: str
    dark: bool
    handle: bool
