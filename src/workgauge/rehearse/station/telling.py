"""What a running machine tells: snapshots from ticks, and the setup that does not change."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from workgauge.guard.registry import GUARDS
from workgauge.rehearse.session import Session
from workgauge.rehearse.step_result import StepResult
from workgauge.values.arrays import Floats
from workgauge.values.clearances import Clearances
from workgauge.values.limits import Limit
from workgauge.values.measurements import Stamp
from workgauge.values.reasons import Reason
from workgauge.values.station import GuardFacts, Held, JointFacts, Near, Setup

#: So many clearances, reasons go into a snapshot.
NEAR, REASONS = 10, 12
#: Thresholds that may be changed from the page, and between what [m].
THRESHOLDS = {"stop_distance_m": (0.05, 2.0), "slow_distance_m": (0.1, 5.0)}
_OWN = "self:"
#: Guards that keep nothing are not to be chosen where somebody drives.
NOT_OFFERED = frozenset({"none"})


def rounded(values: Floats, digits: int = 6) -> tuple[float, ...]:
    """Return numbers short enough to send."""
    return tuple(round(value, digits) + 0.0 for value in np.asarray(values, dtype=np.float64).ravel().tolist())


def rows(T: Floats) -> tuple[float, ...]:
    """Return the upper three rows (12) of a pose; exact, for it is used again."""
    return tuple(np.asarray(T, dtype=np.float64)[:3].ravel().tolist())


def pose_of(numbers: Sequence[float]) -> Floats:
    """Return the pose (4, 4) whose upper rows these are."""
    T = np.eye(4)
    T[:3] = np.reshape(numbers, (3, 4))
    return T


@dataclass(frozen=True, slots=True, eq=False)
class Names:
    """Limits by id."""

    limits: Mapping[str, Limit]

    def name(self, limit: str | None) -> str | None:
        """Return what a person calls a limit."""
        if limit is None:
            return None
        if limit.startswith(_OWN):
            return f"its own {limit.removeprefix(_OWN)}"
        found = self.limits.get(limit)
        return limit if found is None else found.name

    def kind(self, limit: str) -> str:
        """Return a limit's kind, `self` for the machine's own links."""
        found = self.limits.get(limit)
        return "self" if found is None else str(found.kind)


def nearest(seen: Clearances | None, names: Names) -> tuple[Near, ...]:
    """Return the nearest clearance to each limit, those first that leave least."""
    if seen is None or not len(seen):
        return ()
    left = seen.distances - seen.protections
    found: list[Near] = []
    told: set[int] = set()
    for i in np.argsort(left, kind="stable").tolist():
        limit = int(seen.limits[i])
        if limit in told:
            continue
        told.add(limit)
        one = seen[i]
        stop = one.stop_distance_m
        found.append(
            Near(
                *(one.link, one.limit, names.name(one.limit) or one.limit, names.kind(one.limit)),
                *(round(one.distance_m, 4), round(min(one.protection_m, 1e6), 4)),
                None if np.isnan(stop) else float(stop),
                *(rounded(one.point_machine, 4), rounded(one.point_limit, 4)),
            )
        )
        if len(found) == NEAR:
            break
    return tuple(found)


def held(reasons: Sequence[Reason], names: Names) -> tuple[Held, ...]:
    """Return reasons with their limits by name, in words too, those first that leave least."""

    def short(value: float | None) -> float | None:
        return None if value is None or not np.isfinite(value) else round(value, 4)

    def said(reason: Reason) -> str:
        text = reason.text
        for limit in (reason.limit, reason.other_limit):
            if limit is not None:
                text = text.replace(limit, names.name(limit) or limit)
        return text

    ordered = sorted(reasons, key=lambda one: 2.0 if one.scale is None else one.scale)
    return tuple(
        Held(
            *(str(one.code), said(one), one.link, names.name(one.limit), one.joint),
            *(short(one.clearance_m), short(one.scale)),
        )
        for one in ordered[:REASONS]
    )


def lever_ranges(done: StepResult) -> tuple[tuple[float, float], ...]:
    """Return what each joint may still be commanded, empty if the guard did not say."""
    ranges = done.trace.ranges
    if ranges is None:
        return ()
    pairs = zip(rounded(ranges.joints_low, 5), rounded(ranges.joints_high, 5), strict=True)
    return tuple(pairs)


def guard_settings(guard: object) -> tuple[tuple[str, float], ...]:
    """Return a guard's thresholds that can be changed."""
    return tuple((name, float(getattr(guard, name))) for name in THRESHOLDS if hasattr(guard, name))


def setup_of(
    session: Session,
    stamp: Stamp,
    title: str,
    site: str,
    scenario: bool,
    may_suspend: Sequence[tuple[str, str, float]],
    intent_age_s: float,
    round_trip_s: float,
) -> Setup:
    """Return what does not change while a machine runs."""
    machine = session.machine
    joints = tuple(
        JointFacts(
            *(name, machine.levers[j], float(machine.lever_signs[j])),
            *(float(machine.speed_positive[j]), float(machine.speed_negative[j]), bool(machine.prismatic[j])),
        )
        for j, name in enumerate(machine.joint_names)
    )
    guards = []
    for name, make in sorted(GUARDS.items()):
        guard = make()
        known = {field.name for field in fields(guard)}  # type: ignore[arg-type]
        chosen = session.guard if session.guard.name == name else guard
        settings = [(key, float(getattr(chosen, key)), *THRESHOLDS[key]) for key in THRESHOLDS if key in known]
        if name not in NOT_OFFERED:
            guards.append(GuardFacts(name, tuple(settings)))
    return Setup(
        *(stamp, title, machine.name, site, session.rules.name, joints, tuple(sorted(session.states))),
        *(tuple(guards), scenario, tuple(may_suspend)),
        *(intent_age_s * 1e3, round_trip_s * 1e3, session.tick_s * 1e3),
    )
