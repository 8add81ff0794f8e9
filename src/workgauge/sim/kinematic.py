"""The kinematic plant: joints that follow their valves, ideal or hydraulic, up to their stops; an undercarriage."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from workgauge.machine.model import MachineModel
from workgauge.sim.joints import IdealJoints, Joints
from workgauge.sim.travel import Place, TravelDrive, twist_per_metre
from workgauge.values.arrays import Floats, frozen
from workgauge.values.commands import VALVE_FULL
from workgauge.values.errors import MachineError, WireError
from workgauge.values.measurements import MachinePose, Posture, Stamp
from workgauge.values.ports import VALUES_PORT, Chunk
from workgauge.wire.messages import decode_command, encode

#: Called after every substep with the plant's clock [ns], the true joint positions (n,) and T_site_machine (4, 4).
OnSubstep = Callable[[int, Floats, Floats], None]


@dataclass(frozen=True, slots=True, eq=False)
class Fixed:
    """A place nobody travels from."""

    T_site_machine: Floats

    def moved(self, by_m: float, curvature: float) -> "Fixed":
        """Return the same place."""
        return self


class KinematicPlant:
    """A machine without mass or noise, on a clock of its own; implements `values.ports.Plant`.

    Valve frames that are broken, for another machine, of the wrong length or out of range are ignored and counted;
    the last good one goes on acting. A frame whose enable flag is off closes every valve. The undercarriage travels
    as `travel` tells it, not by valve frames.

    Args:
        machine: its kinematics and joint stops.
        machine_id: whose frames it takes and sends.
        q: (n,) joint positions at the start, within the stops [rad, m].
        T_site_machine: (4, 4) pose of the undercarriage, if it stays; else
        place: where it stands and travels from. acceleration_m_s2: of its travel.
        start_ns: the plant's clock at the start [ns].
        substep_s: longest time between two looks at the truth [s].
        on_substep: called after every substep.
        joints: what moves them, fresh; ideal ones if left out.

    Raises:
        MachineError: if the posture is not one of this machine.
    """

    def __init__(
        self,
        machine: MachineModel,
        *,
        machine_id: str,
        q: ArrayLike,
        T_site_machine: ArrayLike | None = None,
        place: Place | None = None,
        acceleration_m_s2: float = 1.0,
        start_ns: int = 0,
        substep_s: float = 0.005,
        on_substep: OnSubstep | None = None,
        joints: Joints | None = None,
    ) -> None:
        posture = np.array(q, dtype=np.float64)
        if posture.shape != (machine.n,):
            raise MachineError("one position per joint", element="q", value=posture.shape, allowed=str(machine.n))
        if not ((posture >= machine.q_min) & (posture <= machine.q_max)).all():
            raise MachineError("a joint starts beyond its stop", element="q", value=posture.tolist())
        if not substep_s > 0.0:
            raise MachineError("a substep takes time", element="substep_s", value=substep_s, allowed="above 0")
        if (T_site_machine is None) == (place is None):
            raise MachineError("stands at a pose or at a place", element="place", allowed="exactly one of the two")
        if not 0.0 < acceleration_m_s2 < math.inf:
            raise MachineError(
                "travel needs acceleration",
                element="acceleration_m_s2",
                value=acceleration_m_s2,
                allowed="above 0, finite",
            )
        self.bad_frames = 0
        self.now_ns = start_ns
        self._machine = machine
        self._machine_id = machine_id
        self._joints = joints or IdealJoints(machine)
        self._q = frozen(posture)
        self._place: Place = Fixed(frozen(T_site_machine, (4, 4))) if place is None else place  # type: ignore[arg-type]
        self._T_site_machine = frozen(self._place.T_site_machine, (4, 4))
        self._travel = TravelDrive(acceleration_m_s2=acceleration_m_s2)
        self._travelled_m = 0.0
        self._substep_s = substep_s
        self._on_substep = on_substep
        self._sequence = 0
        self._sent: list[Chunk] = []
        self._measure()

    @property
    def truth(self) -> tuple[Floats, Floats]:
        """Where the machine really is: joint positions (n,) and T_site_machine (4, 4)."""
        return self._q, self._T_site_machine

    @property
    def speed_m_s(self) -> float:
        """True speed of the undercarriage along its own x axis, negative backwards [m/s]."""
        return self._travel.speed_m_s

    @property
    def travelled_m(self) -> float:
        """Way made since the start, forwards less backwards [m]."""
        return self._travelled_m

    @property
    def twist(self) -> Floats:
        """True twist (6,) of the undercarriage: its origin's velocity [m/s] and its turning [rad/s], site frame."""
        if not self._travel.speed_m_s:
            return frozen(np.zeros(6))
        return frozen(twist_per_metre(self._place, self._travel.curvature) * self._travel.speed_m_s)

    def travel(self, speed_m_s: float, curvature: float = 0.0) -> None:
        """Tell the undercarriage to travel from now on, negative backwards, and how it is steered on open ground.

        Raises:
            ValueError: if either is not a finite number.
        """
        if not (math.isfinite(speed_m_s) and math.isfinite(curvature)):
            raise ValueError(f"a machine travels at finite speed and curvature, not {speed_m_s} m/s, {curvature} 1/m")
        self._travel = replace(self._travel, wanted_m_s=speed_m_s, curvature=curvature)

    def stand_at(self, T_site_machine: ArrayLike) -> None:
        """Put the undercarriage at a pose (4, 4) from outside, standing; the joints stay as they are."""
        self._place = Fixed(frozen(T_site_machine, (4, 4)))
        self._T_site_machine = self._place.T_site_machine
        self._travel = replace(self._travel, speed_m_s=0.0, wanted_m_s=0.0)

    def write(self, frame: bytes) -> None:
        """Take one valve command frame; it acts from now until the next."""
        try:
            command = decode_command(frame, self.now_ns).value
        except WireError:
            self.bad_frames += 1
            return
        valves = command.valves
        fits = len(valves) == self._machine.n and all(abs(valve) <= VALVE_FULL for valve in valves)
        if not fits or command.stamp.machine_id != self._machine_id:
            self.bad_frames += 1
            return
        self._joints.set_valves(valves if command.enable else (0,) * len(valves))

    def advance(self, dt_s: float) -> None:
        """Let `dt_s` seconds pass in equal substeps, then measure.

        Raises:
            ValueError: if `dt_s` is not a positive, finite number.
        """
        if not 0.0 < dt_s < math.inf:
            raise ValueError(f"time passes forwards, not by {dt_s} s")
        start, total = self.now_ns, max(round(dt_s * 1e9), 1)
        steps = math.ceil(total / (self._substep_s * 1e9) - 1e-9)
        for step in range(1, steps + 1):
            now = start + total * step // steps
            passed_s = (now - self.now_ns) * 1e-9
            self._q = frozen(self._joints.advance(passed_s, self._q))
            self._roll(passed_s)
            self.now_ns = now
            if self._on_substep is not None:
                self._on_substep(now, self._q, self._T_site_machine)
        self._measure()

    def _roll(self, dt_s: float) -> None:
        """Let the undercarriage travel for a substep; at the end of its way it stands."""
        if not (self._travel.speed_m_s or self._travel.wanted_m_s):
            return
        self._travel, way = self._travel.after(dt_s)
        self._place = self._place.moved(way, self._travel.curvature)
        T = frozen(self._place.T_site_machine, (4, 4))
        made = float((T[:3, 3] - self._T_site_machine[:3, 3]) @ self._T_site_machine[:3, 0])
        if abs(made) < 0.5 * abs(way):  # the way ends here
            self._travel, way = replace(self._travel, speed_m_s=0.0), made
        self._travelled_m += way
        self._T_site_machine = T

    def read(self) -> list[Chunk]:
        """Return the sensor frames since the last call, oldest first, one per chunk on the port `values`.

        The first call has the start's.
        """
        sent, self._sent = self._sent, []
        return sent

    def _measure(self) -> None:
        stamp = Stamp(self._machine_id, self.now_ns, "kinematic", self.now_ns)
        for value in (Posture.exact(stamp, self._q), MachinePose.exact(stamp, self._T_site_machine)):
            self._sent.append(Chunk(VALUES_PORT, self.now_ns, encode(value, self._sequence)))
        self._sequence = (self._sequence + 1) % 2**32
