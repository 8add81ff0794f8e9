"""The way out of a limit one is already inside, or what leaves none."""

from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from workgauge.guard.projection import project
from workgauge.values.arrays import Floats, Ints, frozen

#: A motion worsens a clearance if it shrinks it faster than this, beyond what it may [m/s].
WORSENS_M_S = 1e-9
#: How far off the projected point lies: so far that the projection is a linear programme's solution to within
#: `n / 2 FAR_OFF` of the objective's gradient, and still near enough to leave twelve digits.
FAR_OFF = 1e4
#: A corner with less room than this counts as one of its solid's deepest [m].
DEEPEST_M = 1e-3
#: A multiplier below this share of the greatest takes no part in pinning.
TAKES_PART = 1e-6
#: That the others follow may cost the worst no more than down to this share of its growth.
FOLLOWED = 0.1
#: No clearance shrinks this fast [m/s].
_ENOUGH_M_S = 1e6


@dataclass(frozen=True, slots=True, eq=False)
class WayOut:
    """A motion that worsens no violated clearance and improves at least one.

    Attributes:
        velocity: (n,) joint velocities, as fast as the box lets them [rad/s, m/s].
        gain: what the worst clearance gains [m/s]; 0 if it gains nothing, and only others do.
        row: the worst clearance if it gains, otherwise the one that gains most; -1 if nothing is violated.
    """

    velocity: Floats
    gain: float
    row: int


@dataclass(frozen=True, slots=True, eq=False)
class Pinned:
    """Nothing in the box is a way out, and what stands in it.

    Proved, not searched: weights of the rows (Farkas) bound by weak duality what any velocity in the box could gain.
    `first` cannot grow unless another one shrinks more than it may, or one of `joints` leaves its range: `second` if
    `alone`, else `second` or one of the `more` with smaller weights. With n joints up to n + 1 rows may be needed, no
    two of which pin by themselves (Helly): then no pair is claimed to pin, the two heaviest stand for all. Where rows
    belong to limits, each of these stands for all rows of its limit, and no two for the same.

    Attributes:
        first: the worst violated row, -1 if the numbers cannot be judged.
        second: the row that opposes it most, -1 if it needs none: no joint changes it, only joints at their ends, or
            its limit alone pins.
        alone: whether `first` and `second` pin without any other row.
        more: how many further rows take part; 0 if `alone`.
        joints: joints at their ends that take part: moving them further would help.
        most: no velocity that worsens none improves the violated by more than this, all together; infinite where
            rows promised a way out, and every one of them was refused [m/s].
    """

    first: int
    second: int
    alone: bool
    more: int
    joints: tuple[int, ...]
    most: float


Exit: TypeAlias = WayOut | Pinned


@dataclass(frozen=True, slots=True, eq=False)
class _Best:
    """The best of a linear programme: where (in shares of the box), by which rows, and what is proved the most."""

    point: Floats
    weights: Floats
    pulls: Floats
    value: float
    most: float


def room(
    q: Floats, q_min: Floats, q_max: Floats, speed_positive: Floats, speed_negative: Floats, settle_s: float
) -> tuple[Floats, Floats]:
    """Return the lowest and highest joint velocities (n,): full speed, at a joint's end none towards it.

    Nearer to an end than speed times `settle_s` they fall in proportion. Beyond an end only the way back is left.
    """
    low = np.minimum(np.maximum(-np.asarray(speed_negative), (q_min - q) / settle_s), 0.0)
    high = np.maximum(np.minimum(np.asarray(speed_positive), (q_max - q) / settle_s), 0.0)
    return low, high


def way_out(
    rows: Floats,
    slack: Floats,
    low: Floats,
    high: Floats,
    *,
    room: Floats | None = None,
    of: Ints | None = None,
    shy: NDArray[np.bool_] | None = None,
    all_alike: bool = False,
    horizon_s: float = 1.0,
    grip: float = 0.1,
    least_m_s: float = 1e-4,
) -> Exit:
    """Return the fastest way for the worst clearance that worsens none of the violated, or what leaves none.

    Three linear programmes over the box, the next only if the one before gains less than `least_m_s`: (1) the worst
    grows as fast as it can while each other violated one grows at least `grip` as fast, unless (2) gains far more: it
    may be that hardly anything moves one of them; (2) while none of the others shrinks; (3) all violated together
    grow as fast as they can while none shrinks. Clearances that are not violated lose at most their slack per
    `horizon_s` in all three, and corners of a solid that are less deep than its deepest at most what they have more.

    Args:
        rows: (k, n) `d(distance)/dt = row @ joint velocity` [m/rad, m/m].
        slack: (k,) below 0 where violated [m].
        low, high: (n,) joint velocities left, low at most 0, high at least 0; see `room` [rad/s, m/s].
        room: (k,) what each row may lose in all, at least 0; its slack if None [m]. A violated row with room is a
            corner that another one of its solid is deeper than.
        shy: (k,) rows that in (1) grow as the violated do, though they are not; none if None.
        all_alike: whether (3) is asked at once: what leads out of the rest may hardly move the worst.
        of: (k,) which limit each row belongs to, so that what pins is said of limits; each to its own if None.
        horizon_s: time over which the others' slack is kept.
        grip: share of the worst's growth, 0 to 1.
        least_m_s: slower ways out are none.
    """
    rows, slack = np.asarray(rows, dtype=np.float64), np.asarray(slack, dtype=np.float64)
    low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
    left = np.maximum(slack if room is None else np.asarray(room, dtype=np.float64), 0.0)
    finite = np.isfinite(rows).all() and np.isfinite(low).all() and np.isfinite(high).all()
    if not (finite and not np.isnan(slack).any() and not np.isnan(left).any()):
        return Pinned(-1, -1, False, 0, (), np.inf)
    violated = (slack < 0.0) & (left < DEEPEST_M)
    if not violated.any():
        return WayOut(frozen(np.zeros(len(low))), 0.0, -1)
    span = np.maximum(high, -low)
    rates, floors = rows * span, -np.minimum(left / horizon_s, _ENOUGH_M_S)
    unit = np.divide(1.0, span, out=np.zeros_like(span), where=span > 0.0)
    bottom, top = low * unit, high * unit
    worst = int(np.argmin(np.where(violated, slack, np.inf)))
    along = violated if shy is None else violated | shy
    followed = rates - grip * np.outer(along & (np.arange(len(slack)) != worst), rates[worst])
    alone = _best(rates[worst], rates, floors, bottom, top)
    both = _best(rates[worst], followed, floors, bottom, top)
    for found in (both, alone) if both.value >= FOLLOWED * alone.value else (alone,):
        if found.value > least_m_s and not all_alike and _keeps(found.point, rates, floors):
            return WayOut(frozen(found.point * span), float(rates[worst] @ found.point), worst)
    together = _best(rates[violated].sum(axis=0), rates, floors, bottom, top)
    if together.value > least_m_s and _keeps(together.point, rates, floors):
        gains = np.where(violated, rates @ together.point, -np.inf)
        return WayOut(frozen(together.point * span), max(float(gains[worst]), 0.0), int(np.argmax(gains)))
    of = np.arange(len(slack)) if of is None else np.asarray(of)
    return replace(_blame(worst, of, alone, rates, floors, bottom, top, least_m_s), most=together.most)


def exit_velocity(
    rows: Floats,
    slack: Floats,
    low: Floats,
    high: Floats,
    speed_share: float,
    *,
    settle_s: float = 0.5,
    beyond_m: float = 0.02,
) -> tuple[Floats, Exit]:
    """Return the joint velocity (n,) to command this tick for driving out, and the exit it follows.

    `speed_share` (0 to 1) of the fastest way out, slower towards its end as if to settle, in `settle_s`, `beyond_m`
    outside; zero as soon as nothing is violated, and where pinned. Nothing is remembered.
    """
    found = way_out(rows, slack, low, high)
    if isinstance(found, Pinned) or found.row < 0:
        return frozen(np.zeros(len(low))), found
    gain = float(np.asarray(rows)[found.row] @ found.velocity)
    scale = min(speed_share, (beyond_m - float(slack[found.row])) / (settle_s * gain))
    return frozen(scale * found.velocity), found


def _keeps(point: Floats, rates: Floats, floors: Floats) -> bool:
    """Return whether no row falls faster than it may."""
    return bool((rates @ point >= floors - WORSENS_M_S).all())


def _best(wish: Floats, rates: Floats, floors: Floats, bottom: Floats, top: Floats) -> _Best:
    """Return the `point` (n,) with the largest `wish @ point`, `rates @ point >= floors`, `bottom <= point <= top`.

    The projection of a point far off along `wish`, so of all the best the smallest. `most`: by weak duality, for any
    weights y >= 0 nothing exceeds `max over the box of (wish + y rates) @ x - y floors`.
    """
    k, n = rates.shape
    size = float(np.linalg.norm(wish))
    if size < WORSENS_M_S:
        return _Best(np.zeros(n), np.zeros(k), wish, 0.0, float(np.maximum(wish * top, wish * bottom).sum()))
    lengths = np.linalg.norm(rates, axis=1)
    counts = lengths > WORSENS_M_S
    scale = np.divide(1.0, lengths, out=np.zeros(k), where=counts)
    normals = np.concatenate((rates * scale[:, None], np.eye(n), -np.eye(n)))
    offsets = np.concatenate((np.where(counts, floors * scale, -np.inf), bottom, -top))
    tolerance = np.full(k + 2 * n, 1e-10)
    point, multipliers, _ = project(wish * (FAR_OFF / size), normals, offsets, tolerance)
    point = np.minimum(np.maximum(point, bottom), top)
    change = rates @ point
    over = change < floors - WORSENS_M_S
    if over.any():
        point = point * np.min(floors[over] / change[over])
    weights = multipliers[:k] * scale * (size / FAR_OFF)
    pulls = wish + weights @ rates
    most = float(np.maximum(pulls * top, pulls * bottom).sum() - weights @ floors)
    return _Best(point, weights, pulls, float(wish @ point), most)


def _blame(
    worst: int, of: Ints, best: _Best, rates: Floats, floors: Floats, bottom: Floats, top: Floats, least: float
) -> Pinned:
    """Return what pins `worst`, from the weights of the rows that keep it from growing."""
    shares = best.weights * np.linalg.norm(rates, axis=1)
    own = of == of[worst]
    shares[own] = 0.0
    size = float(np.linalg.norm(rates[worst]))
    order = np.flatnonzero(shares > TAKES_PART * max(size, float(shares.max())))
    order = order[np.argsort(-shares[order], kind="stable")]
    order = order[np.sort(np.unique(of[order], return_index=True)[1])]  # the heaviest of each limit
    by_itself = _best(rates[worst], rates[own], floors[own], bottom, top)
    if by_itself.value <= least or not len(order):
        return Pinned(worst, -1, True, 0, _ends(by_itself, bottom, top), by_itself.most)
    for row in order.tolist():
        pair = own | (of == of[row])
        by_two = _best(rates[worst], rates[pair], floors[pair], bottom, top)
        if by_two.value <= least:
            return Pinned(worst, row, True, 0, _ends(by_two, bottom, top), by_two.most)
    return Pinned(worst, int(order[0]), False, len(order) - 1, _ends(best, bottom, top), best.most)


def _ends(best: _Best, bottom: Floats, top: Floats) -> tuple[int, ...]:
    """Return the joints at their ends that would help if they could go on."""
    helps = TAKES_PART * max(float(np.abs(best.pulls).max()), WORSENS_M_S)
    stuck = ((best.pulls > helps) & (top <= 0.0) & (bottom < 0.0)) | (
        (best.pulls < -helps) & (bottom >= 0.0) & (top > 0.0)
    )
    return tuple(np.flatnonzero(stuck).tolist())
