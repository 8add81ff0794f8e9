"""The track the machine stands on, from its position; its own envelope is no limit for it."""

import math

import numpy as np

from workgauge.gauge.build import LimitSet
from workgauge.gauge.match import rule_for
from workgauge.gauge.rules import RuleBook, TrackBlock
from workgauge.gauge.tracknames import track_names
from workgauge.site.model import SiteModel
from workgauge.values.limits import Limit


def own_track(site: SiteModel, rules: RuleBook, e: float, n: float, heading: float) -> str | None:
    """Return the name of the alignment a machine stands on, or None; `A#2` for the second that is called A.

    It is the nearest of the alignments that the rule book makes tracks of, if it is within the rule book's distance
    and the machine's heading agrees with it, forwards or backwards, within the rule book's angle.

    Args:
        e, n: absolute position of the machine [m].
        heading: clockwise from grid north [rad].
    """
    best: tuple[float, str] | None = None
    for alignment, name in track_names(site):
        rule = rule_for(rules, alignment)
        if rule is None or not any(isinstance(block, TrackBlock) for block in rule.limits):
            continue
        distance, offset = alignment.project(np.array([[e, n]]))
        away = abs(float(offset[0]))
        if away > rules.own_track.within_m or (best is not None and away >= best[0]):
            continue
        turned = abs(math.remainder(heading - float(alignment.at(distance).heading[0]), math.pi))
        if turned <= math.radians(rules.own_track.heading_within_deg):
            best = (away, name)
    return None if best is None else best[1]


def without_own_track(limits: LimitSet, own: str | None) -> tuple[Limit, ...]:
    """Return the limits without the envelope of the track `own`; what hangs above that track stays."""
    return tuple(limit for limit in limits.limits if own is None or limit.own_track_of != own)
