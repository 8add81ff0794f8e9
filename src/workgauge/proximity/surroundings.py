"""What stands around the machine this tick, for a guard that looks at more postures than the present one."""

from dataclasses import dataclass

from workgauge.machine.model import Kinematics, MachineModel
from workgauge.proximity.protection import Integrity, with_protection
from workgauge.proximity.scene import Scene
from workgauge.proximity.uncertainty import MachineUncertainty
from workgauge.values.arrays import Floats
from workgauge.values.clearances import Clearances


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """The scene, where the machine stands in it, and how sure that is.

    Attributes:
        scene: the limits around the machine.
        T_site_machine: (4, 4) pose of the undercarriage in the site's local frame.
        unsure: covariance of pose and joints. integrity: how sure a clearance's lower bound must be.
        largest_m: no protection level of this tick is larger [m].
        now_ns, off_states, let_off: which limits count, see `Scene.query`.
    """

    scene: Scene
    T_site_machine: Floats
    unsure: MachineUncertainty
    integrity: Integrity
    largest_m: float
    now_ns: int = 0
    off_states: frozenset[str] = frozenset()
    let_off: frozenset[str] = frozenset()

    @property
    def machine(self) -> MachineModel:
        """The machine that stands there."""
        return self.scene.machine

    def look(self, kin: Kinematics, radius_m: float) -> Clearances:
        """Return the clearances nearer than `radius_m` at a posture, with their protection levels."""
        machine, T = self.machine, self.T_site_machine
        found = self.scene.query(kin, T, radius_m, self.now_ns, self.off_states, self.let_off)
        rows = machine.distance_rows(kin, T, found)
        limits = self.scene.uncertainty
        clearances, _ = with_protection(found, rows, kin, machine, T, self.unsure, limits, self.integrity)
        return clearances

    def least(self, kin: Kinematics, radius_m: float) -> Floats:
        """Return the least distance of each solid to each limit and own link at a posture (S, L) [m]."""
        when = self.now_ns, self.off_states, self.let_off
        return self.scene.least(kin, self.T_site_machine, radius_m, *when)
