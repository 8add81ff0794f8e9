"""Which postures and joint motions keep every clearance, proven for the whole motion and not only for its ends."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise, permutations

import numpy as np
from numpy.typing import NDArray

from workgauge.machine.model import MachineModel
from workgauge.proximity.scene import Scene
from workgauge.values.arrays import Floats
from workgauge.values.clearances import Clearances

#: Postures looked at have this much more room than what is proven in between: proofs end somewhere [m].
PROOF_M = 0.01
#: How far beyond what is needed clearances are looked for: what is farther away is taken to be just there [m].
SIGHT_M = 2.0
#: Postures remembered.
_REMEMBERED = 4000


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """What there is to know of one posture.

    Attributes:
        room_m: the least surplus of a clearance, negative if one falls short; minus infinity where a solid touches.
        surplus: (k + 1,) what each clearance has above what is needed, and last what all that are not seen have [m].
        levers: (k + 1, n) how far joint j moves the clearance's solid per unit, at this posture at most [m].
        widest: (k + 1, n) the same, whatever the posture. bends: (k + 1, n, n) how fast levers may grow with others.
    """

    room_m: float
    surplus: Floats
    levers: Floats
    widest: Floats
    bends: Floats


_NOWHERE = Look(-np.inf, np.empty(0), np.empty((0, 0)), np.empty((0, 0)), np.empty((0, 0, 0)))


@dataclass(frozen=True, slots=True, eq=False)
class Need:
    """What clearances have to be.

    Attributes:
        clearance_m: above each one's stop distance. stop_distance_m: of limits without one of their own.
        now_ns, off_states, let_off: as of `Scene.query`.
    """

    clearance_m: float
    stop_distance_m: float
    now_ns: int = 0
    off_states: frozenset[str] = frozenset()
    let_off: frozenset[str] = frozenset()


class Validity:
    """Tells whether the machine keeps every clearance at a posture, and on the straight joint line between two.

    A point of solid s moves by at most `sum_j |dq_j| (r_sj + 1/2 sum_k |dq_k| l_sk)`, with r_sj the largest distance
    of the solid's corners from joint j's axis now, and l_sk that at any posture, for the joints k farther out. No
    clearance can shrink by more, whichever limits there are and however they are shaped; between two links only the
    joints between them count. Postures are looked at, the worst uncovered stretch halved first, until those
    bounds cover the whole line (conservative advancement). Limits count as they are now; they are not moved.

    Args:
        scene, T_site_machine: the limits, and (4, 4) where the undercarriage stands. need: what has to be kept.

    Attributes:
        looks: how many postures were looked at.
        groups: the joints of each group that cannot move together (n,); empty if all can.
    """

    def __init__(self, scene: Scene, T_site_machine: Floats, need: Need) -> None:
        self.scene, self.machine, self.need = scene, scene.machine, need
        self.T_site_machine = np.array(T_site_machine, dtype=np.float64, order="C")
        self.looks = 0
        self.groups = _groups(self.machine)
        arm, links = scene.arm, self.machine.n + 1
        n, joints = self.machine.n, np.arange(self.machine.n)
        # by solid and by the other link (last: none), the joints that can change the distance
        self._counts = np.ones((len(arm.links), links + 1, n))
        self._counts[:, :links] = joints >= np.arange(links)[:, None]
        # another link may come nearer by stretching, and so may a solid by a joint that does not count
        self._stretched = np.zeros((links + 1, n))
        self._stretched[:links, arm.stretch[arm.stretch[:, 0] >= 0, 0]] = 1.0
        self._turning = (arm.prismatic == 0) & (arm.levers > 0.0) & (arm.stretch[:, :1] < 0)
        farther = joints[None, :] > joints[:, None]
        self._bends = np.where(self._turning[:, :, None], arm.levers[:, None, :] * farther, 0.0)
        self._seen: dict[bytes, Look] = {}

    def clearances(self, q: Floats) -> Clearances:
        """Return every clearance at a posture, nearer than what is needed and `SIGHT_M`."""
        return self.scene.query(self.machine.forward(q), self.T_site_machine, self._radius_m, *self._at)

    def surplus(self, found: Clearances) -> Floats:
        """Return what each of some clearances has above what is needed (k,) [m]."""
        stops = np.where(np.isnan(found.stop_distances), self.need.stop_distance_m, found.stop_distances)
        return np.asarray(found.distances - stops - self.need.clearance_m)

    def room(self, q: Floats) -> float:
        """Return the least surplus at a posture, minus infinity where a solid touches something [m]."""
        return self._look(q).room_m

    def near(self, q: Floats) -> float:
        """Return the least surplus at a posture, inside too: there minus the depth [m]."""
        return float(self.surplus(self.clearances(q)).min(initial=np.inf))

    def keeps(self, q: Floats) -> bool:
        """Return whether a posture keeps every clearance, with what proofs need besides."""
        return self._look(q).room_m >= PROOF_M

    def straight(self, a: Floats, b: Floats) -> bool:
        """Return whether the straight joint line from a to b (n,) is proven to keep every clearance."""
        if tuple(b) < tuple(a):  # the same postures are looked at both ways
            a, b = b, a
        return self._all_along(lambda share: a + share * (b - a), a, b, 0.5 * np.abs(b - a))

    def round(self, a: Floats, corner: Floats, b: Floats) -> bool:
        """Return whether a rounded corner is proven to keep every clearance.

        It is the parabola with the control points a, corner and b (n,): along it no joint is ever faster than twice
        the farther of its two sides.
        """
        before, after = corner - a, b - corner

        def at(share: float) -> Floats:
            found: Floats = a + share * (2.0 * before + share * (after - before))
            return found

        return self._all_along(at, a, b, np.maximum(np.abs(before), np.abs(after)))

    def _all_along(self, at: Callable[[float], Floats], a: Floats, b: Floats, half: Floats) -> bool:
        """Return whether a motion from a to b, by its share, is proven; joints move at 2 `half` per share at most."""
        if not (self.keeps(a) and self.keeps(b)):
            return False
        # stretches of the motion by the share of it that is not yet covered, widest first
        open_ = [(self.covers(a, half), 1.0 - self.covers(b, half))]
        while open_:
            open_.sort(key=lambda stretch: stretch[0] - stretch[1])
            low, high = open_.pop(0)
            if low >= high:
                return True
            middle = 0.5 * (low + high)
            q = at(middle)
            if not self.keeps(q):
                return False
            covered = self.covers(q, half)
            open_ += [(low, middle - covered), (middle + covered, high)]
        return True

    def motion(self, a: Floats, b: Floats) -> Floats | None:
        """Return the waypoints (k, n) of a proven motion from a to b, or None.

        A straight line; of a machine with groups of joints that cannot move together, one line for each that moves,
        in the first order that is proven.
        """
        for waypoints in self._ways(a, b):
            if all(self.straight(*leg) for leg in pairwise(waypoints)):
                return np.array(waypoints)
        return None

    def _ways(self, a: Floats, b: Floats) -> Iterator[list[Floats]]:
        moved = a != b
        groups = [group for group in self.groups if moved[group].any()]
        if len(groups) < 2:
            yield [a, b]
            return
        for order in permutations(groups):
            at, waypoints = a, [a]
            for group in order:
                at = np.where(group, b, at)
                waypoints.append(at)
            yield waypoints

    @property
    def _radius_m(self) -> float:
        stop = max(self.need.stop_distance_m, self.scene.largest_stop_m)
        return stop + self.need.clearance_m + SIGHT_M

    @property
    def _at(self) -> tuple[int, frozenset[str], frozenset[str]]:
        return self.need.now_ns, self.need.off_states, self.need.let_off

    def covers(self, q: Floats, half: Floats) -> float:
        """Return the share of a line of twice `half` (n,), to each side of q, that its clearances prove free."""
        look = self._look(q)
        spare = look.surplus
        slope, widest = 2.0 * (look.levers @ half), 2.0 * (look.widest @ half)
        curve = 2.0 * (look.bends @ half @ half)
        quick = 2.0 * spare / (slope + np.sqrt(slope * slope + 4.0 * curve * spare) + 1e-300)
        sure = spare / (widest + 1e-300)
        return float(np.minimum(np.maximum(quick, sure), 1.0).min())

    def _look(self, q: Floats) -> Look:
        key = q.tobytes()
        found = self._seen.get(key)
        if found is None:
            if len(self._seen) >= _REMEMBERED:
                self._seen.clear()
            found = self._seen[key] = self._looked(q)
        return found

    def _looked(self, q: Floats) -> Look:
        self.looks += 1
        found = self.scene.query_apart(self.machine.forward(q), self.T_site_machine, self._radius_m, *self._at)
        if found is None:
            return _NOWHERE
        surplus = self.surplus(found)
        room = min(float(surplus.min(initial=np.inf)), SIGHT_M)
        if room < PROOF_M:
            return Look(room, surplus, *(_NOWHERE.levers, _NOWHERE.widest, _NOWHERE.bends))
        now, most = self._levers(q), self.scene.arm.levers
        s, other = found.solids, found.other_links
        counts, stretched = self._counts[s, other], self._stretched[other]
        unseen = self._stretched.max(axis=0)
        levers = np.concatenate([now[s] * counts + stretched, (now.max(axis=0) + unseen)[None]])
        widest = np.concatenate([most[s] * counts + stretched, (most.max(axis=0) + unseen)[None]])
        bends = np.concatenate([self._bends[s] * counts[:, :, None], self._bends.max(axis=0)[None]])
        surplus = np.append(surplus, SIGHT_M)
        return Look(room, surplus, levers, widest, bends)

    def _levers(self, q: Floats) -> Floats:
        """Return how far joint j moves a point of solid s per unit now, at most: (S, n) [m]."""
        arm = self.scene.arm
        at = arm.at(self.T_site_machine, np.array(q[None]))
        arms = at.corners[0][:, :, None, :] - at.origins[0]
        axes = at.axes[0]
        along = np.einsum("sckx,kx->sck", arms, axes)
        square = np.einsum("sckx,sckx->sck", arms, arms) - along * along
        return np.where(self._turning, np.sqrt(np.maximum(square.max(axis=1), 0.0)), arm.levers)


def _groups(machine: MachineModel) -> list[NDArray[np.bool_]]:
    """Return the joints of each group that cannot move together; joints of no group go with the first."""
    masks = [np.isin(np.arange(machine.n), group) for group in machine.exclusive_groups]
    if masks:
        masks[0] = ~np.any(masks[1:], axis=0) if len(masks) > 1 else np.ones(machine.n, np.bool_)
    return masks if len(masks) > 1 else []
