"""What comes of a certificate's drives: verdict, worst cases, distributions, lost time."""

import hashlib
import json
import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from workgauge.rehearse.certify.conditions import NEAR_M, Condition
from workgauge.rehearse.certify.driving import Driven

#: Width of a class of the distribution [m].
CLASS_M = 0.025
#: With so much confidence is said what share of such drives may fail at most.
CONFIDENCE = 0.95
#: So many failed drives are named.
MOST_NAMED = 50


@dataclass(frozen=True, slots=True)
class Worst:
    """The drive with the least left of a stop distance: which, at what, and its smallest clearance."""

    seed: int
    condition: str
    kind: str
    link: str
    limit: str
    clearance_m: float
    less_stop_m: float


@dataclass(frozen=True, slots=True)
class Row:
    """Drives taken together: all, those of a condition, or what concerns a kind of limit and a link.

    Attributes:
        drives: how many (that came near, for a kind and a link). entered: of these, those that entered a limit.
        below: those in which a true clearance fell below its stop distance.
        worst_clearance_m, worst_less_stop_m: smallest true clearance, and less its stop distance, or None.
        counts: drives by how much was left of the stop distance, see `edges`.
        held_s: time the guard took. motion, free_motion: with the guard, and without any; NaN for a kind and a link.
    """

    drives: int
    entered: int
    below: int
    worst_clearance_m: float | None
    worst_less_stop_m: float | None
    counts: tuple[int, ...]
    held_s: float
    motion: float = math.nan
    free_motion: float = math.nan
    levers_s: float = math.nan


@dataclass(frozen=True, slots=True)
class Compared:
    """Guard and linear scaling on the same drives: how many, motion of each; the same where linear scaling held."""

    drives: int
    motion: float
    linear_motion: float
    held: int
    held_motion: float
    held_linear_motion: float


@dataclass(frozen=True, slots=True)
class Outcome:
    """All that is said of the drives; the same for the same drives, in whatever order they were driven.

    Attributes:
        within: all drives within the model. beyond: all beyond it, none of which counts for the verdict.
        by_condition: per condition, in order. by_place: per kind of limit and link, within the model.
        edges_m: of the classes: the first count is of what is below the first edge, the last of what is not below the
            last one or was never in sight.
        worst: within the model, or None if nothing was in sight. failed: seeds and conditions of those that failed.
        undriven: drives for which no clear start was found. on_site: drives on the site, others among random limits.
        compared: with linear scaling. sha256: of all drives.
    """

    conditions: tuple[Condition, ...]
    within: Row
    beyond: Row
    by_condition: tuple[Row, ...]
    by_place: tuple[tuple[str, str, Row], ...]
    edges_m: tuple[float, ...]
    worst: Worst | None
    failed: tuple[tuple[str, int], ...]
    undriven: int
    on_site: int
    compared: Compared | None
    sha256: str

    @property
    def passed(self) -> bool:
        """Whether there were drives within the model, and every one kept every stop distance and entered nothing."""
        return self.within.drives > 0 and self.within.entered == 0 and self.within.below == 0

    @property
    def failing_share(self) -> float:
        """Upper bound of the share of such drives that fail, with 95 % confidence, if none did; else 1."""
        return 1.0 - (1.0 - CONFIDENCE) ** (1.0 / self.within.drives) if self.passed else 1.0

    def as_json(self) -> dict[str, Any]:
        """Return the documented object."""
        within, compared = self.within, self.compared
        return {
            "passed": self.passed,
            "drives": within.drives,
            "entries": within.entered,
            "below_stop": within.below,
            "worst_clearance_m": within.worst_clearance_m,
            "worst_less_stop_m": within.worst_less_stop_m,
            "worst": None if self.worst is None else asdict(self.worst),
            "failed": [{"condition": key, "drive": seed} for key, seed in self.failed[:MOST_NAMED]],
            "failing_share_at_most": self.failing_share,
            "motion_share": _share(within.motion, within.free_motion),
            "time_lost_share": _share(within.held_s, within.levers_s),
            "linear": None
            if compared is None
            else {
                "drives": compared.drives,
                "motion_ratio": _share(compared.motion, compared.linear_motion),
                "held": compared.held,
                "held_motion_ratio": _share(compared.held_motion, compared.held_linear_motion),
            },
            "edges_m": list(self.edges_m),
            "counts": list(within.counts),
            "conditions": [
                {"condition": one.key, "words": one.words, "within_model": one.within, **_json(row)}
                for one, row in zip(self.conditions, self.by_condition, strict=True)
            ],
            "places": [
                {"kind": kind, "link": link, **{k: v for k, v in _json(row).items() if "share" not in k}}
                for kind, link, row in self.by_place
            ],
            "on_site": self.on_site,
            "undriven": self.undriven,
            "results_sha256": self.sha256,
        }


def outcome(which: Sequence[Condition], all_driven: Iterable[Driven]) -> Outcome:
    """Return what comes of drives.

    Args:
        which: conditions. all_driven: drives of those, in any order.
    """
    every = sorted(all_driven, key=lambda one: (one.condition, one.seed))
    found = [one for one in every if one.place]
    covered = {one.key for one in which if one.within}
    within = [one for one in found if one.condition in covered]
    edges = _edges(found)
    text = json.dumps([one.plain() for one in every], sort_keys=True, allow_nan=False)
    return Outcome(
        conditions=tuple(which),
        within=_row(within, edges),
        beyond=_row([one for one in found if one.condition not in covered], edges),
        by_condition=tuple(_row([one for one in found if one.condition == each.key], edges) for each in which),
        by_place=_by_place(within, edges),
        edges_m=edges,
        worst=_worst(within),
        failed=tuple((one.condition, one.seed) for one in within if one.failed),
        undriven=len(every) - len(found),
        on_site=sum(one.place.startswith("on the") for one in within),
        compared=_compared(within),
        sha256=hashlib.sha256(text.encode()).hexdigest(),
    )


def certificate_id(certificate: Mapping[str, Any]) -> str:
    """Return the SHA-256 over a certificate's JSON without its own `id`."""
    told = {key: value for key, value in certificate.items() if key != "id"}
    return hashlib.sha256(json.dumps(told, sort_keys=True, allow_nan=False).encode()).hexdigest()


def _edges(found: Sequence[Driven]) -> tuple[float, ...]:
    """Return edges of classes from the worst of all, at least one class below zero, up to `NEAR_M`."""
    least = min((one.worst_less_stop_m for one in found if one.worst_less_stop_m is not None), default=0.0)
    first = min(math.floor(least / CLASS_M - 1e-9), -1)
    return tuple(round(k * CLASS_M, 6) for k in range(max(first, -200), round(NEAR_M / CLASS_M) + 1))


def _counts(left: Iterable[float | None], edges: Sequence[float]) -> tuple[int, ...]:
    values = [math.inf if one is None else one for one in left]
    # what is not told apart from zero is not below it
    classes = np.searchsorted(edges, np.array(values) + 1e-4 * (np.abs(values) < 1e-4), side="right")
    return tuple(np.bincount(classes, minlength=len(edges) + 1).tolist())


def _row(found: Sequence[Driven], edges: Sequence[float]) -> Row:
    return Row(
        drives=len(found),
        entered=sum(bool(one.entered) for one in found),
        below=sum(one.below for one in found),
        worst_clearance_m=_least(one.worst_clearance_m for one in found),
        worst_less_stop_m=_least(one.worst_less_stop_m for one in found),
        counts=_counts((one.worst_less_stop_m for one in found), edges),
        held_s=math.fsum(each.seconds for one in found for each in one.held),
        motion=math.fsum(one.motion for one in found),
        free_motion=math.fsum(one.free_motion for one in found),
        levers_s=math.fsum(one.levers_s for one in found),
    )


def _by_place(within: Sequence[Driven], edges: Sequence[float]) -> tuple[tuple[str, str, Row], ...]:
    """Return one row per kind of limit and link, the least left of a stop distance first."""
    near, held = defaultdict(list), defaultdict(list)
    for one in within:
        for each in one.nearest:
            near[each.kind, each.link].append(each)
        for spell in one.held:
            held[spell.kind, spell.link].append(spell.seconds)
    rows = []
    for kind, link in sorted({*near, *held}):
        those = near[kind, link]
        left = [each.less_stop_m for each in those]
        row = Row(
            drives=len(those),
            entered=sum(each.clearance_m < 0.0 for each in those),
            below=sum(each.less_stop_m < -1e-4 for each in those),
            worst_clearance_m=_least(each.clearance_m for each in those),
            worst_less_stop_m=_least(left),
            counts=_counts(left, edges),
            held_s=math.fsum(held[kind, link]),
        )
        rows.append((kind, link, row))
    return tuple(
        sorted(rows, key=lambda one: math.inf if one[2].worst_less_stop_m is None else one[2].worst_less_stop_m)
    )


def _worst(within: Sequence[Driven]) -> Worst | None:
    seen = [one for one in within if one.nearest]
    if not seen:
        return None
    one = min(seen, key=lambda each: (min(near.less_stop_m for near in each.nearest), each.seed, each.condition))
    near = min(one.nearest, key=lambda each: each.less_stop_m)
    return Worst(one.seed, one.condition, near.kind, near.link, near.limit, near.clearance_m, near.less_stop_m)


def _compared(within: Sequence[Driven]) -> Compared | None:
    both = [(one.motion, one.linear) for one in within if one.linear is not None]
    if not both:
        return None
    kept = [(motion, linear) for motion, linear in both if linear.kept]
    return Compared(
        len(both),
        math.fsum(motion for motion, _ in both),
        math.fsum(linear.motion for _, linear in both),
        len(kept),
        math.fsum(motion for motion, _ in kept),
        math.fsum(linear.motion for _, linear in kept),
    )


def _least(values: Iterable[float | None]) -> float | None:
    return min((one for one in values if one is not None), default=None)


def _share(part: float, whole: float) -> float | None:
    return part / whole if whole > 0.0 else None


def _json(row: Row) -> dict[str, Any]:
    return {
        "drives": row.drives,
        "entries": row.entered,
        "below_stop": row.below,
        "worst_clearance_m": row.worst_clearance_m,
        "worst_less_stop_m": row.worst_less_stop_m,
        "counts": list(row.counts),
        "time_lost_s": row.held_s,
        "motion_share": _share(row.motion, row.free_motion),
        "time_lost_share": _share(row.held_s, row.levers_s),
    }
