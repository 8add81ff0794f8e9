"""What a rehearsed run leaves behind: plain series, intervals and snapshots, ready for pages and JSON."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from workgauge.motion.bucket.dug import DugMap
from workgauge.rehearse.auto_series import AutoSeries
from workgauge.rehearse.chatter import Chatter, chatter
from workgauge.values.arrays import Floats
from workgauge.values.limits import Limit


def _rounded(value: float | None) -> float | None:
    """Return a number for JSON; None without one, and for one without bound (a protection level may be infinite)."""
    return None if value is None or not np.isfinite(value) else round(value, 6)


@dataclass(frozen=True, slots=True)
class Intervention:
    """One cause of holding the machine back, from its first tick to its last.

    Attributes:
        t_s, until_s: first tick with this cause, and the end of the last one [s].
        reason: the code of `values.reasons.ReasonCode`.
        link, limit: what came near what (limit id, or `self:<link>`), if that is the cause.
        joint: the joint concerned, if the cause is one joint's.
        clearance_m: smallest clearance the program believed meanwhile [m].
        scale: smallest share of the wanted speed left meanwhile, 0 to 1.
        text: one line for people.
        protection_m: the part of that clearance that was not sure. stop_distance_m: at which the approach ends [m].
    """

    t_s: float
    until_s: float
    reason: str
    link: str | None
    limit: str | None
    joint: str | None
    clearance_m: float | None
    scale: float | None
    text: str
    protection_m: float | None = None
    stop_distance_m: float | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the documented object of the run command."""
        return {
            "t_s": round(self.t_s, 6),
            "until_s": round(self.until_s, 6),
            "reason": self.reason,
            "link": self.link,
            "limit": self.limit,
            "joint": self.joint,
            "clearance_m": _rounded(self.clearance_m),
            "protection_m": _rounded(self.protection_m),
            "stop_distance_m": _rounded(self.stop_distance_m),
            "scale": _rounded(self.scale),
            "text": self.text,
        }


@dataclass(frozen=True, slots=True)
class Entry:
    """A contiguous interval of true signed clearance below zero, caused by the machine's own motion.

    Attributes:
        limit: limit id, or `self:<link>` for the machine's own link. link: the link that was deepest in.
        start_s, end_s: first and last substep inside [s]. depth_m: greatest depth, positive [m].
    """

    limit: str
    link: str
    start_s: float
    end_s: float
    depth_m: float


@dataclass(frozen=True, slots=True)
class TickTimes:
    """Wall-clock time of the ticks [ms]: median, 99th percentile, largest."""

    p50: float
    p99: float
    max: float


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """The machine at one moment, in the site's local frame.

    Attributes:
        t_s: when [s].
        T_site_boxes: (S, 4, 4) centre frames and half_extents: (S, 3) of the link boxes [m].
        names: what each box is called. tool: (3,) the tool centre point [m].
        point_machine, point_limit: (3,) the closest pair to the nearest limit, or None if none was in sight.
        clearance_m, limit: its true signed clearance and limit id.
    """

    t_s: float
    T_site_boxes: Floats
    half_extents: Floats
    names: tuple[str, ...]
    tool: Floats
    point_machine: Floats | None = None
    point_limit: Floats | None = None
    clearance_m: float | None = None
    limit: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """One row per tick.

    Attributes:
        t_s: (n,) start of the tick [s].
        q: (n, joints) true joint positions [rad, m].
        wanted: (n, joints) the operator's joint velocities; allowed: (n, joints) the guard's [rad/s, m/s].
        valves: (n, joints) integer valve commands that left the tick. sent: the joint velocities those ask for.
        scale: (n,) share of the wanted speed the guard left.
        true_m: (n,) smallest true clearance to a limit within the tick, NaN if none was in sight [m].
        believed_m: (n,) smallest clearance to a limit the program believed at the tick, NaN likewise [m].
        self_m: (n,) smallest true clearance between the machine's own links, NaN if none was in sight [m].
        tool: (n, 3) true tool centre point in the site's local frame [m].
        step: (n,) index of the drive's step.
        by_limit: limit id to true clearance within the tick (n,), NaN where out of sight, of the limits that came
            nearest, nearest first [m].
    """

    t_s: Floats
    q: Floats
    wanted: Floats
    allowed: Floats
    valves: Floats
    sent: Floats
    scale: Floats
    true_m: Floats
    believed_m: Floats
    self_m: Floats
    tool: Floats
    step: Floats
    by_limit: Mapping[str, Floats]

    def __len__(self) -> int:
        return len(self.t_s)


@dataclass(frozen=True, slots=True, eq=False)
class PositionSeries:
    """What was believed of the position against the truth, one row per tick; NaN where nothing was believed.

    Attributes:
        states: (n) health of the position.
        believed_m, protection_m, true_m: (n,) of the pair of solid and limit believed to be nearest once its
            protection level is taken off: signed clearance, protection level, true clearance at the tick [m].
        share: (n,) largest |believed - true| / protection level of all pairs in sight; infinite if one was missed.
        error_m: (n,) how far the believed machine is from the true one. sigma_m: (n,) its largest 1-sigma [m].
    """

    states: tuple[str, ...]
    believed_m: Floats
    protection_m: Floats
    true_m: Floats
    share: Floats
    error_m: Floats
    sigma_m: Floats

    def seconds(self, tick_s: float) -> dict[str, float]:
        """Return how long each state lasted in all [s]."""
        known = dict.fromkeys(self.states)
        return {state: round(self.states.count(state) * tick_s, 6) for state in known}

    def as_json(self, tick_s: float) -> dict[str, Any]:
        """Return the documented object of the run command."""
        return {
            "worst_error_over_protection": _largest(self.share),
            "ticks_beyond_protection": int((self.share > 1.0).sum()),
            "largest_protection_m": _largest(self.protection_m),
            "largest_position_error_m": _largest(self.error_m),
            "seconds_in_state": self.seconds(tick_s),
        }


@dataclass(frozen=True, slots=True, eq=False)
class TravelSeries:
    """The undercarriage's way, one row per tick.

    Attributes:
        wanted_m_s, speed_m_s: (n,) along its own x axis, wanted and true at the tick's end, negative backwards.
        travelled_m: (n,) since the start, forwards less backwards.
        path: (n, 2) true east and north of the machine frame's origin in the site's local frame [m].
        own: (n) the track it was believed to stand on, None for none.
    """

    wanted_m_s: Floats
    speed_m_s: Floats
    travelled_m: Floats
    path: Floats
    own: tuple[str | None, ...]

    def tracks(self) -> tuple[tuple[int, str | None], ...]:
        """Return (tick, track) of the first tick and of every change."""
        own = self.own
        return tuple((k, own[k]) for k in range(len(own)) if k == 0 or own[k] != own[k - 1])

    def as_json(self, tick_s: float) -> dict[str, Any]:
        """Return the documented object of the run command."""
        return {
            "travelled_m": round(float(self.travelled_m[-1]), 6),
            "top_speed_m_s": round(float(np.abs(self.speed_m_s).max()), 6),
            "own_tracks": [{"t_s": round(k * tick_s, 6), "track": track} for k, track in self.tracks()],
        }


def _largest(values: Floats) -> float | None:
    """Return the largest of the numbers, or None if there is none or it has no bound."""
    known = values[~np.isnan(values)]
    return round(float(known.max()), 6) if len(known) and np.isfinite(known).all() else None


@dataclass(frozen=True, slots=True, eq=False)
class RunResult:
    """Everything a run shows.

    Attributes:
        title, description: the scenario's own words.
        facts: what was run on what, label to text, in order.
        joint_names, prismatic: per joint; prismatic joints' speeds are m/s, the others' rad/s.
        tick_s: tick period [s]. substeps: truth checks per tick.
        slow_distance_m, stop_distance_m: the guard's p_u and p_l [m], None where it has none.
        series: see `Series`. steps: (words, start [s]) of the drive's steps.
        min_clearance_m, min_limit, min_link: smallest true clearance, to which limit, of which link; None if no
            limit was ever in sight.
        min_self_clearance_m, min_self_pair: the same between the machine's own links.
        entries: into limits. self_entries: of own links into each other.
        interventions, tick_ms: see there.
        start, nearest, end: snapshots; `nearest` is the moment of the smallest true clearance.
        limits: the limits near the machine, for drawing. limit_names: id to name of all that are mentioned.
        assumptions, warnings: sentences for people.
        position: what was believed against the truth, None where sensors were perfect.
        travel: the undercarriage's way, None if it stood still.
        automatic: what automatic motion was to do and did, None if there was none.
        dug: what the bucket's edge swept of a surface it was to grade, None if it was to grade none.
    """

    title: str
    description: str
    facts: dict[str, str]
    joint_names: tuple[str, ...]
    prismatic: tuple[bool, ...]
    tick_s: float
    substeps: int
    slow_distance_m: float | None
    stop_distance_m: float | None
    series: Series
    steps: tuple[tuple[str, float], ...]
    min_clearance_m: float | None
    min_limit: str | None
    min_link: str | None
    min_self_clearance_m: float | None
    min_self_pair: tuple[str, str] | None
    entries: tuple[Entry, ...]
    self_entries: tuple[Entry, ...]
    interventions: tuple[Intervention, ...]
    tick_ms: TickTimes
    start: Snapshot
    nearest: Snapshot
    end: Snapshot
    limits: tuple[Limit, ...]
    limit_names: dict[str, str]
    assumptions: tuple[str, ...] = ()
    warnings: tuple[str, ...] = field(default=())
    position: PositionSeries | None = None
    travel: TravelSeries | None = None
    automatic: AutoSeries | None = None
    dug: DugMap | None = None

    @property
    def ticks(self) -> int:
        """Number of ticks run."""
        return len(self.series)

    @property
    def simulated_s(self) -> float:
        """Simulated time [s]."""
        return self.ticks * self.tick_s

    def chatter(self) -> Chatter | None:
        """Return how much of the commanded acceleration is faster than hands move; None if the ticks are too slow."""
        return chatter(self.series.sent, self.series.wanted, self.tick_s)

    def name_of(self, limit: str | None) -> str:
        """Return what a person calls a limit id."""
        if limit is None:
            return "nothing in sight"
        if limit.startswith("self:"):
            return f"its own {limit.removeprefix('self:')}"
        return self.limit_names.get(limit, limit)

    def as_json(self) -> dict[str, Any]:
        """Return the documented object of `workgauge run --json` (docs/commands.md)."""
        return {
            "ticks": self.ticks,
            "simulated_s": round(self.simulated_s, 6),
            "min_clearance_m": None if self.min_clearance_m is None else round(self.min_clearance_m, 6),
            "entries": len(self.entries),
            "interventions": [cause.as_json() for cause in self.interventions],
            "tick_ms": {
                "p50": round(self.tick_ms.p50, 4),
                "p99": round(self.tick_ms.p99, 4),
                "max": round(self.tick_ms.max, 4),
            },
            "min_self_clearance_m": (
                None if self.min_self_clearance_m is None else round(self.min_self_clearance_m, 6)
            ),
            "self_entries": len(self.self_entries),
            "chatter": None if (found := self.chatter()) is None else found.as_json(self.joint_names),
            "positioning": None if self.position is None else self.position.as_json(self.tick_s),
            "travel": None if self.travel is None else self.travel.as_json(self.tick_s),
            "automatic": None if self.automatic is None else self.automatic.as_json(),
            "dug": None if self.dug is None else self.dug.as_json(),
            "warnings": list(self.warnings),
        }
