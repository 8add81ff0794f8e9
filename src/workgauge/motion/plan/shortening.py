"""Making a way through joint space shorter, roomier and smoother; what was proven of it stays proven."""

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.motion.plan.validity import Validity
from workgauge.values.arrays import Floats

#: Shortcuts tried, and in a row without any gain.
SHORTCUTS, WITHOUT_GAIN = 120, 30
#: A shortcut has to save this share of the whole time.
LEAST_GAIN = 1e-3
#: Corners with less room than this are moved away from what is near, if it costs no more than this share of time [m].
COMFORT_M, COMFORT_COST = 0.3, 0.02
#: Rounds of corner cutting, and the shares of the adjoining lines that are cut off.
ROUNDS, CUTS = 3, (0.25, 0.1)

_Stop = Callable[[], bool]


def duration_s(machine: MachineModel, way: Sequence[Floats] | Floats) -> float:
    """Return how long a way takes at least: at each line's slowest joint's full speed, without stops."""
    steps = np.diff(np.asarray(way), axis=0)
    speeds = np.where(steps > 0.0, machine.speed_positive, machine.speed_negative)
    return float(np.abs(steps / speeds).max(axis=1, initial=0.0).sum())


def proven(validity: Validity, way: Sequence[Floats]) -> bool:
    """Return whether every line of a way is proven, and moves no joints that cannot move together."""
    for a, b in itertools.pairwise(way):
        if sum((a != b)[group].any() for group in validity.groups) > 1 or not validity.straight(a, b):
            return False
    return True


def joined(validity: Validity, postures: Sequence[Floats]) -> list[Floats] | None:
    """Return the way through postures, each joined to the next by `Validity.motion`, or None if one cannot be."""
    way = [postures[0]]
    for a, b in itertools.pairwise(postures):
        legs = validity.motion(a, b)
        if legs is None:
            return None
        way.extend(legs[1:])
    return way


def shorten(validity: Validity, way: list[Floats], rng: np.random.Generator, stop: _Stop) -> list[Floats]:
    """Return a way of no longer duration with the same ends: corners skipped, then random shortcuts."""
    machine = validity.machine
    way = _skip(validity, way, stop)
    idle = 0
    for _ in range(SHORTCUTS):
        if len(way) < 3 or idle >= WITHOUT_GAIN or stop():
            break
        idle += 1
        shares, joint = np.sort(rng.random(2)), int(rng.integers(machine.n))
        single = not validity.groups and idle % 2 == 0
        tried = _joint_shortcut(validity, way, shares, joint) if single else _shortcut(validity, way, shares)
        total = duration_s(machine, way)
        if tried is not None and duration_s(machine, tried) < total * (1.0 - LEAST_GAIN):
            way, idle = tried, 0
    return _skip(validity, way, stop)


def widen(validity: Validity, way: list[Floats], stop: _Stop) -> list[Floats]:
    """Return the way with corners that have little room moved away from what is nearest, where that is cheap."""
    machine = validity.machine
    allowed = duration_s(machine, way) * (1.0 + COMFORT_COST)
    i = 1
    while i < len(way) - 1 and not stop():
        room = validity.room(way[i])
        if room < COMFORT_M:
            for q in _away(validity, way[i], room):
                if validity.room(q) <= room:
                    continue
                legs = joined(validity, [way[i - 1], q, way[i + 1]])
                if legs is None:
                    continue
                tried = [*way[: i - 1], *legs, *way[i + 2 :]]
                if duration_s(machine, tried) <= allowed:
                    way = tried
                    i += len(legs) - 3  # corners it took to get there are not moved again
                    break
        i += 1
    return way


def smooth(validity: Validity, way: list[Floats], stop: _Stop) -> list[Floats]:
    """Return the way with its corners cut, time and again, where that is proven (Chaikin)."""
    for _ in range(ROUNDS):
        cut = [way[0]]
        for before, corner, after in zip(way[:-2], way[1:-1], way[2:], strict=True):
            cut.extend([corner] if stop() else _cut(validity, cut[-1], before, corner, after))
        way = [*cut, way[-1]] if len(way) > 1 else way
    return way


def _skip(validity: Validity, way: list[Floats], stop: _Stop) -> list[Floats]:
    """Return the way without corners it can do without: from each posture on to the farthest that can be reached."""
    machine = validity.machine
    kept, i = [way[0]], 0
    while i < len(way) - 1:
        legs: Sequence[Floats] | Floats | None = None
        for j in range(len(way) - 1, i + 1, -1):
            legs = None if stop() else validity.motion(way[i], way[j])
            if legs is not None and duration_s(machine, legs) <= duration_s(machine, way[i : j + 1]):
                break
        else:
            j, legs = i + 1, way[i : i + 2]
        assert legs is not None
        kept.extend(legs[1:])
        i = j
    return kept


def _shortcut(validity: Validity, way: list[Floats], shares: Floats) -> list[Floats] | None:
    """Return the way with what lies between two shares of its duration replaced by one motion, if that is proven."""
    machine = validity.machine
    times = np.array([0.0, *(duration_s(machine, leg) for leg in itertools.pairwise(way))]).cumsum()
    (i, a), (j, b) = (_at(way, times, float(share * times[-1])) for share in shares)
    if i == j:
        return None
    legs = validity.motion(a, b)
    if legs is None or not (validity.straight(way[i], a) and validity.straight(b, way[j + 1])):
        return None
    return [*way[: i + 1], *legs, *way[j + 1 :]]


def _joint_shortcut(validity: Validity, way: list[Floats], shares: Floats, joint: int) -> list[Floats] | None:
    """Return the way with one joint moving evenly between two shares of its duration, if that is proven."""
    machine = validity.machine
    times = np.array([0.0, *(duration_s(machine, leg) for leg in itertools.pairwise(way))]).cumsum()
    first, last = (float(share * times[-1]) for share in shares)
    (i, a), (j, b) = _at(way, times, first), _at(way, times, last)
    if i == j:
        return None
    moved = [np.array(q) for q in way[i + 1 : j + 1]]
    for q, time in zip(moved, times[i + 1 : j + 1].tolist(), strict=True):
        q[joint] = a[joint] + (time - first) / (last - first) * (b[joint] - a[joint])
    tried = [way[i], a, *moved, b, way[j + 1]]
    if not all(validity.straight(*leg) for leg in itertools.pairwise(tried)):
        return None
    return [*way[:i], *tried, *way[j + 2 :]]


def _at(way: list[Floats], times: Floats, time: float) -> tuple[int, Floats]:
    """Return the line that is being driven at a time, and the posture."""
    i = min(int(np.searchsorted(times, time, side="right")) - 1, len(way) - 2)
    share = (time - times[i]) / max(float(times[i + 1] - times[i]), 1e-12)
    return i, way[i] + share * (way[i + 1] - way[i])


def _away(validity: Validity, q: Floats, room: float) -> list[Floats]:
    """Return postures farther from what is nearest at q (n,), the farthest first."""
    machine = validity.machine
    found = validity.clearances(q)
    if not len(found):
        return []
    nearest = int(np.argmin(validity.surplus(found)))
    row = machine.distance_rows(machine.forward(q), validity.T_site_machine, found)[nearest]
    speeds = 0.5 * (machine.speed_positive + machine.speed_negative)
    step = row * speeds * speeds
    gain = float(row @ step)
    if gain < 1e-12:
        return []
    step = step / gain
    return [
        np.clip(q + share * (COMFORT_M - room) * step, machine.q_min, machine.q_max) for share in (1.0, 0.5, 0.25)
    ]


def _cut(validity: Validity, last: Floats, before: Floats, corner: Floats, after: Floats) -> list[Floats]:
    """Return what takes the place of a corner: itself, or two postures on the lines that meet there."""
    for share in CUTS:
        a, b = corner + share * (before - corner), corner + share * (after - corner)
        if sum((a != b)[group].any() for group in validity.groups) > 1:
            return [corner]
        if validity.straight(a, b) and validity.straight(last, a) and validity.straight(b, after):
            return [a, b]
    return [corner]
