"""How fast the undercarriage may travel: no faster than it can stop before any clearance is used up.

The guards rule over joints. Travel is the operator's own, and its brakes are no joint: this says what speed is left
of what is wanted, and why. It does not scale linearly as Mäkinen's guard does, because an undercarriage cannot drop
its speed at once.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from workgauge.values.arrays import Floats
from workgauge.values.clearances import Clearances
from workgauge.values.reasons import Reason, ReasonCode

#: A clearance that shrinks by less than this per metre travelled stands still: below the rounding of the pose [m/m].
RESTING = 1e-9


@dataclass(frozen=True, slots=True)
class Brakes:
    """How an undercarriage comes to rest.

    Attributes:
        deceleration_m_s2: of the brakes. reaction_s: until they act.
    """

    deceleration_m_s2: float = 1.0
    reaction_s: float = 0.2

    def way(self, speed_m_s: float) -> float:
        """Return the way still made from a speed [m]."""
        return speed_m_s * self.reaction_s + speed_m_s**2 / (2.0 * self.deceleration_m_s2)

    def speed(self, way_m: Floats) -> Floats:
        """Return the speed from which the undercarriage stops within each way (k,) [m/s]."""
        a, t = self.deceleration_m_s2, self.reaction_s
        return np.asarray(a * (np.sqrt(t * t + 2.0 * way_m / a) - t), dtype=np.float64)


def travel_rates(clearances: Clearances, T_site_machine: Floats, twist: Floats) -> Floats:
    """Return (k,) by how much each clearance grows while the undercarriage moves with `twist`.

    Args:
        clearances: k of them; those between own links do not change.
        T_site_machine: (4, 4) pose of the undercarriage.
        twist: (6,) velocity of the machine frame's origin and angular velocity, site frame; at 1 m/s for metres per
            metre travelled.
    """
    arms = clearances.points_machine - T_site_machine[:3, 3]
    rates: Floats = np.einsum("ij,ij->i", clearances.normals, twist[:3] + np.cross(twist[3:], arms))
    rates[clearances.other_links >= 0] = 0.0
    return rates


def sideways(
    clearances: Clearances,
    T_site_machine: Floats,
    solid_corners: Floats,
    limit_corners: Mapping[int, Floats],
) -> tuple[Floats, Floats]:
    """Return (k,) how far machine and limit lie apart square to the way, and (k,) how far ahead or behind it reaches.

    What lies apart sideways is passed, not met, however near it comes: travelling does not use that up. Known only
    for limits that are one convex body; -infinity for the others and where they are not apart [m].

    Args:
        solid_corners: (S, 8, 3) of the machine's solids, site frame.
        limit_corners: index of a limit into `limit_ids` to its corners (c, 3), for convex bodies.
    """
    apart, reach = np.full(len(clearances), -math.inf), np.zeros(len(clearances))
    origin, ahead = T_site_machine[:3, 3], T_site_machine[:3, 0]
    left = np.array([-ahead[1], ahead[0], 0.0]) / math.hypot(ahead[0], ahead[1])
    for i in np.flatnonzero(clearances.other_links < 0).tolist():
        corners = limit_corners.get(int(clearances.limits[i]))
        if corners is None:
            continue
        own = solid_corners[int(clearances.solids[i])]
        mine, its = own @ left, corners @ left
        apart[i] = max(float(mine.min() - its.max()), float(its.min() - mine.max()))
        reach[i] = float(np.abs((own - origin) @ ahead).max())
    return apart, reach


def travel_speed(
    wanted_m_s: float,
    clearances: Clearances,
    rates: Floats,
    beside: tuple[Floats, Floats] | None,
    bends: tuple[float, float],
    stop_distance_m: float,
    brakes: Brakes,
) -> tuple[float, tuple[Reason, ...]]:
    """Return the speed that is left of `wanted_m_s`, same sign, and the reason if it is less.

    From the speed that is left the undercarriage stops before any clearance, less its protection level, falls below
    its stop distance: over a way s a clearance to something convex shrinks by at most `rate s + bend s^2 / 2`, bend
    being the path's curvature and that of what it travels along; sideways by `curvature (reach s + s^2 / 2)`, and the
    longer way of the two counts, sideways only for what is convex itself. What is already nearer than the stop
    distance may only grow. Nothing is known of limits beyond the search radius, so it stops within that as well. A
    limit that turns into the way more sharply than `bend` (a heap of earth, a wire with a kink) is met only by what
    the stop distance leaves.

    Args:
        wanted_m_s: along the machine's x axis, negative backwards.
        clearances: as believed, with protection levels. rates: (k,) from `travel_rates` at +1 m/s.
        beside: from `sideways`, or None if not known.
        bends: unsigned curvature of the path, and the sharpest of limits that follow an axis [1/m].
        stop_distance_m: the guard's own, where a limit has none.
    """
    if not wanted_m_s:
        return wanted_m_s, ()
    sight = clearances.searched_m - stop_distance_m - float(clearances.protections.max(initial=0.0))
    seen = float(brakes.speed(np.array([max(sight, 0.0)]))[0])
    if seen < abs(wanted_m_s):
        text = f"limits are known for {clearances.searched_m:.1f} m around only, travel slowed to {seen:.2f} m/s"
        slowed = Reason(ReasonCode.LIMIT_NEAR, text, scale=seen / abs(wanted_m_s))
        less = math.copysign(seen, wanted_m_s)
        left, reasons = travel_speed(less, clearances, rates, beside, bends, stop_distance_m, brakes)
        return left, reasons or (slowed,)
    if not len(clearances):
        return wanted_m_s, ()
    closing = -rates if wanted_m_s > 0 else rates
    own = clearances.stop_distances
    stops = np.where(np.isnan(own), stop_distance_m, own)
    safe = clearances.distances - clearances.protections
    ways = _ways(safe - stops, closing, bends[0] + bends[1])
    if beside is not None:
        apart, reach = beside
        passed = np.maximum(apart - clearances.protections - stops, 0.0)
        aside = _ways(passed, bends[0] * reach, bends[0])
        ways = np.where(passed > 0.0, np.maximum(ways, aside), ways)
    ways[clearances.other_links >= 0] = math.inf
    nearest = int(np.argmin(ways))
    if not math.isfinite(ways[nearest]):
        return wanted_m_s, ()
    most = float(brakes.speed(np.maximum(ways[nearest : nearest + 1], 0.0))[0])
    if most >= abs(wanted_m_s):
        return wanted_m_s, ()
    share, left = most / abs(wanted_m_s), float(safe[nearest])
    link = clearances.link_names[int(clearances.links[nearest])]
    limit = clearances.limit_ids[int(clearances.limits[nearest])]
    if left < 0.0:
        code, text = ReasonCode.INSIDE_LIMIT, f"{link} may be {-left:.2f} m inside {limit}, travel only away from it"
    elif most == 0.0:
        code, text = ReasonCode.LIMIT_REACHED, f"{link} is {left:.2f} m from {limit}, no travelling nearer"
    else:
        code, text = ReasonCode.LIMIT_NEAR, f"{link} is {left:.2f} m from {limit}, travel slowed to {most:.2f} m/s"
    reason = Reason(code, text, link=link, limit=limit, clearance_m=left, scale=share)
    return math.copysign(most, wanted_m_s), (reason,)


def _ways(left: Floats, closing: Floats, curvature: float) -> Floats:
    """Return how far may be travelled before each clearance has shrunk by `left` (k,) [m]; infinite where never."""
    ways = np.full(len(left), math.inf)
    approached = closing > RESTING
    if curvature < 1e-9:
        ways[approached] = np.maximum(left[approached], 0.0) / closing[approached]
        return ways
    # c s + k s^2 / 2 = left, the larger root; where nothing is left, only what grows at first, and while it does
    bent = left > 0.0
    root = np.sqrt(closing**2 + 2.0 * curvature * np.maximum(left, 0.0))
    ways[bent] = (root[bent] - closing[bent]) / curvature
    ways[~bent] = np.where(approached[~bent], 0.0, -2.0 * closing[~bent] / curvature)
    return ways
