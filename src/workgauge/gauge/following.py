"""The track under a machine that travels: followed across switches with hysteresis, and what it is let off there.

While the undercarriage is on a switch it blocks both branches: no train can pass on either. So a track that branches
from its own is let off as long as the undercarriage fouls it, that is until the two lie `fouling_m` apart; from there
on it is an adjacent track like any other, and counts. Where its own alignment ends and another one goes on from
there, that one is the same rails and let off too, from `AHEAD_M` before the joint. A track that only runs beside its
own is never let off. That a track is let off says that the undercarriage stands on it, not that the machine may be
there.
"""

import math
from dataclasses import dataclass

import numpy as np

from workgauge.gauge.match import rule_for
from workgauge.gauge.rules import RuleBook, TrackBlock
from workgauge.gauge.tracknames import track_names
from workgauge.site.alignment import Alignment
from workgauge.site.model import SiteModel

#: The track is judged anew when the machine has moved by this [m] or turned by this [rad].
MOVED_M, TURNED = 0.25, math.radians(0.2)

#: Two tracks branch from each other if they run so close together [m], no farther than this from the machine [m].
TOGETHER_M, BRANCH_WITHIN_M = 0.3, 250.0

#: So near the end of its own alignment the one that goes on is let off [m]: farther than an arm and its brakes reach.
AHEAD_M = 30.0

#: Places between the two where that is looked at [m], and how finely the machine's own place is taken for it [m].
BRANCH_STEP_M, BRANCH_GRID_M = 2.0, 50.0


@dataclass(frozen=True, slots=True)
class OnTracks:
    """What a machine stands on, in plain values.

    Attributes:
        own: the track it stands on, or None.
        let_off: the tracks whose envelopes are no limit for it, `own` among them.
        e, n, heading: where that was judged [m, rad], NaN before the first time.
    """

    own: str | None = None
    let_off: frozenset[str] = frozenset()
    e: float = math.nan
    n: float = math.nan
    heading: float = math.nan


class TrackFollower:
    """Tells the track under a machine from its position; immutable but for a cache of the site's geometry.

    Args:
        site: its alignments. rules: which of them are tracks, and the distances of `own_track`.
    """

    def __init__(self, site: SiteModel, rules: RuleBook) -> None:
        self._tracks: dict[str, Alignment] = {}
        for alignment, name in track_names(site):
            rule = rule_for(rules, alignment)
            if rule is not None and any(isinstance(block, TrackBlock) for block in rule.limits):
                self._tracks[name] = alignment
        self._within = rules.own_track.within_m
        self._fouling = rules.own_track.fouling_m
        self._hysteresis = rules.own_track.hysteresis_m
        self._angle = math.radians(rules.own_track.heading_within_deg)
        self._going_on = {name: self._goes_on(name) for name in self._tracks}
        self._branching: dict[tuple[str, str, int], bool] = {}

    @property
    def tracks(self) -> tuple[Alignment, ...]:
        """The alignments that are tracks by the rule book."""
        return tuple(self._tracks.values())

    def track(self, name: str | None) -> Alignment | None:
        """Return the alignment of a track by its name here; None for None."""
        return None if name is None else self._tracks[name]

    def follow(self, before: OnTracks, e: float, n: float, heading: float) -> OnTracks:
        """Return what the machine stands on now.

        Its own track is the nearest within `within_m` whose direction agrees with the machine's, either way. It stays
        its own until it lies farther than that by `hysteresis_m`, or another lies nearer by that much. Membership of
        `let_off` has the same hysteresis.

        Args:
            before: what it stood on last; `OnTracks()` at the start.
            e, n: absolute position [m]. heading: clockwise from grid north [rad].
        """
        turned = abs(math.remainder(heading - before.heading, 2 * math.pi)) if math.isfinite(before.heading) else 9.0
        if math.hypot(e - before.e, n - before.n) <= MOVED_M and turned <= TURNED:
            return before
        away = self._away(e, n, heading)
        own = self._own(before.own, away)
        if own is None:
            return OnTracks(None, frozenset(), e, n, heading)
        let_off = {own}
        for name, (distance, along) in away.items():
            slack = self._hysteresis if name in before.let_off else 0.0
            near = distance <= self._fouling + slack and name != own
            if near and (distance <= self._within + slack or self._branches(own, name, along)):
                let_off.add(name)
        along, length = away[own][1], self._tracks[own].length
        for end_m, others in self._going_on[own]:
            for other in others:
                slack = self._hysteresis if other in before.let_off else 0.0
                if abs(along - min(end_m, length)) <= AHEAD_M + slack:
                    let_off.add(other)
        return OnTracks(own, frozenset(let_off), e, n, heading)

    def _goes_on(self, name: str) -> tuple[tuple[float, tuple[str, ...]], ...]:
        """Return, for both ends of a track, its distance along and the tracks that begin or end there and lead on."""
        track, found = self._tracks[name], []
        for end_m, outwards in ((0.0, -1.0), (track.length, 1.0)):
            state = track.at(end_m)
            heading = float(state.heading[0]) + (0.0 if outwards > 0 else math.pi)
            others = []
            for other, alignment in self._tracks.items():
                for at_m, inwards in ((0.0, 1.0), (alignment.length, -1.0)) if other != name else ():
                    there = alignment.at(at_m)
                    apart = math.hypot(float(there.e[0] - state.e[0]), float(there.n[0] - state.n[0]))
                    leads = float(there.heading[0]) + (0.0 if inwards > 0 else math.pi)
                    if apart <= TOGETHER_M and abs(math.remainder(leads - heading, 2 * math.pi)) <= self._angle:
                        others.append(other)
            found.append((end_m, tuple(others)))
        return tuple(found)

    def _away(self, e: float, n: float, heading: float) -> dict[str, tuple[float, float]]:
        """Return (distance from the machine, distance along) [m] of the tracks near it and along its heading."""
        reach = max(self._fouling, self._within) + self._hysteresis
        found = {}
        for name, alignment in self._tracks.items():
            along, offset = (float(value[0]) for value in alignment.project(np.array([[e, n]])))
            if abs(offset) > reach:
                continue
            turned = abs(math.remainder(heading - float(alignment.at(along).heading[0]), math.pi))
            if turned <= self._angle:
                found[name] = abs(offset), along
        return found

    def _own(self, before: str | None, away: dict[str, tuple[float, float]]) -> str | None:
        """Return the nearest track within reach; the one before unless it has to be left."""
        standing = [(distance, name) for name, (distance, _) in away.items() if distance <= self._within]
        nearest = min(standing, default=(math.inf, None), key=lambda one: one[0])
        if before in away:
            kept = away[before][0]
            if kept <= self._within + self._hysteresis and kept <= nearest[0] + self._hysteresis:
                return before
        return nearest[1]

    def _branches(self, own: str, other: str, along: float) -> bool:
        """Return whether the other track runs together with its own somewhere near the place `along` it."""
        key = own, other, round(along / BRANCH_GRID_M)
        known = self._branching.get(key)
        if known is None:
            track = self._tracks[other]
            middle = key[2] * BRANCH_GRID_M
            first, last = max(middle - BRANCH_WITHIN_M, 0.0), min(middle + BRANCH_WITHIN_M, track.length)
            places = np.linspace(first, last, max(int((last - first) / BRANCH_STEP_M), 1) + 1)
            state = track.at(places)
            _, offset = self._tracks[own].project(np.column_stack([state.e, state.n]))
            known = self._branching[key] = bool((np.abs(offset) <= TOGETHER_M).any())
        return known
