"""Which corners of a way may be rounded, and which of its lines may stay: what is driven keeps what a plan keeps."""

from collections.abc import Callable
from dataclasses import replace

from workgauge.motion.looking_ahead import Surroundings
from workgauge.motion.paths.rounded import Kept
from workgauge.motion.plan.validity import PROOF_M, Need, Validity
from workgauge.values.arrays import Floats

#: Where there is less room than a plan keeps, no clearance falls below the least at its own ends by more than this
#: and what proofs take besides (`PROOF_M`) [m].
GIVE_M = 0.002


def roundable(around: Surroundings, clearance_m: float) -> Kept:
    """Return which corners may be rounded: where each clearance keeps `clearance_m` above its stop distance, proven.

    Where the corner's own postures keep less, as where a guard stopped the machine, no less than the least of these.
    """
    room = _Room(around, clearance_m)

    def kept(a: Floats, corner: Floats, b: Floats) -> bool:
        return room.proven((a, corner, b), lambda validity: validity.round(a, corner, b))

    return kept


def passable(around: Surroundings, clearance_m: float) -> Callable[[Floats, Floats], bool]:
    """Return which straight lines are proven to keep so much, or what their two ends have if that is less."""
    room = _Room(around, clearance_m)

    def kept(a: Floats, b: Floats) -> bool:
        return room.proven((a, b), lambda validity: validity.straight(a, b))

    return kept


class _Room:
    """Proves motions with the clearance asked for, or what there is at given postures."""

    def __init__(self, around: Surroundings, clearance_m: float) -> None:
        self._around = around
        at = (around.now_ns, around.off_states, around.let_off)
        self._validity = Validity(around.scene, around.T_site_machine, Need(clearance_m, around.stop_distance_m, *at))

    def proven(self, postures: tuple[Floats, ...], proof: Callable[[Validity], bool]) -> bool:
        """Return whether a motion is proven, `proof`, with what postures (n,) of it have."""
        if all(self._validity.keeps(q) for q in postures):
            return proof(self._validity)
        least = min(self._validity.near(q) for q in postures) - PROOF_M - GIVE_M
        need = self._validity.need
        lower = replace(need, clearance_m=need.clearance_m + least)
        return proof(Validity(self._around.scene, self._around.T_site_machine, lower))
