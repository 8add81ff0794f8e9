"""A limit: something no part of the machine may enter, and everything later rooms must know about it."""

from dataclasses import dataclass, field
from enum import StrEnum

from workgauge.values.arrays import Floats, frozen
from workgauge.values.solids import Solid


class LimitKind(StrEnum):
    """What kind of thing a limit protects; colours, counts and reasons go by it."""

    TRACK = "track"
    OVERHEAD_LINE = "overhead_line"
    POINT = "point"  #: poles, masts, signals
    LINE = "line"  #: pipes, cables, other line features
    SURFACE = "surface"
    ZONE = "zone"  #: boxes and prisms drawn by hand in the rule book


@dataclass(frozen=True, slots=True)
class Source:
    """Where a limit comes from: file, the feature's own name in it, its line if known."""

    file: str
    feature: str
    line: int | None = None


@dataclass(frozen=True, slots=True)
class Activity:
    """When a limit counts.

    Attributes:
        state: the named work state that switches it (`track 2 open to traffic`), or None for always.
        not_before_ns, not_after_ns: window on the tick's clock [ns], or None for open ends.
    """

    state: str | None = None
    not_before_ns: int | None = None
    not_after_ns: int | None = None

    def active(self, now_ns: int, off_states: frozenset[str] = frozenset()) -> bool:
        """Return whether the limit counts at `now_ns`. A state counts unless it is known to be off."""
        if self.state is not None and self.state in off_states:
            return False
        if self.not_before_ns is not None and now_ns < self.not_before_ns:
            return False
        return self.not_after_ns is None or now_ns <= self.not_after_ns


@dataclass(frozen=True, slots=True, eq=False)
class Limit:
    """One forbidden solid or one-sided surface in the site frame.

    Attributes:
        id: unique in a site, stable between runs.
        kind: see `LimitKind`.
        name: what a person calls it (`Track 2`, `Pole 3036`).
        solid: its shape in the site's local frame [m].
        rule: the rule of the rule book that made it.
        source: where it comes from.
        chainage: (from, to) along its alignment [m], if it has one.
        stop_distance_m: smallest allowed clearance, or None for the guard's own.
        tolerance_m: 1-sigma as-built tolerance of the solid along any direction.
        covariance: (6, 6) of its pose, as in `MachinePose`; zero for surveyed, fixed things.
        velocity: (6,) twist of its pose in the site frame [m/s, rad/s]; zero for fixed things.
        activity: when it counts.
        exempt_links: link names it does not apply to (the undercarriage on terrain).
        own_track_of: alignment name if it is a track that a machine standing on it must be let off, else None.
    """

    id: str
    kind: LimitKind
    name: str
    solid: Solid
    rule: str
    source: Source
    chainage: tuple[float, float] | None = None
    stop_distance_m: float | None = None
    tolerance_m: float = 0.0
    covariance: Floats = field(default_factory=lambda: frozen([[0.0] * 6] * 6))
    velocity: Floats = field(default_factory=lambda: frozen([0.0] * 6))
    activity: Activity = Activity()
    exempt_links: frozenset[str] = frozenset()
    own_track_of: str | None = None

    def counts(
        self, now_ns: int, off_states: frozenset[str] = frozenset(), let_off: frozenset[str] = frozenset()
    ) -> bool:
        """Return whether it counts at `now_ns`: active, and not the envelope of a track the machine is let off."""
        if self.own_track_of is not None and self.own_track_of in let_off:
            return False
        return self.activity.active(now_ns, off_states)
