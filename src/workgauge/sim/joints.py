"""What moves a simulated machine's joints: ideal joints or hydraulic ones, behind one interface."""

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from workgauge.drive.ideal import IdealDrive
from workgauge.machine.model import MachineModel
from workgauge.sim.hydraulics import Hydraulics, HydraulicSpec
from workgauge.values.arrays import Floats
from workgauge.values.commands import VALVE_FULL


class Joints(Protocol):
    """Joints behind valves. A plant tells them the valves it was sent, and asks where they are after each substep."""

    @property
    def velocity(self) -> Floats:
        """True joint velocities (n,) now [rad/s, m/s]."""
        ...

    def set_valves(self, valves: Sequence[int]) -> None:
        """Set the valves (n), each in [-VALVE_FULL, VALVE_FULL], from now on."""
        ...

    def advance(self, dt_s: float, q: Floats) -> Floats:
        """Return the joint positions (n,) after `dt_s`, from positions q (n,), within the joints' stops."""
        ...


class IdealJoints:
    """Joints that follow their valves at once, in proportion, up to their stops.

    Args:
        machine: its speeds and stops.
    """

    def __init__(self, machine: MachineModel) -> None:
        self._drive = IdealDrive.of(machine)
        self._q_min, self._q_max = machine.q_min, machine.q_max
        self.velocity: Floats = np.zeros(machine.n)

    def set_valves(self, valves: Sequence[int]) -> None:
        """Set the valves (n) from now on."""
        self.velocity = np.array(self._drive.velocity(valves))

    def advance(self, dt_s: float, q: Floats) -> Floats:
        """Return the joint positions (n,) after `dt_s`."""
        return np.clip(q + self.velocity * dt_s, self._q_min, self._q_max)


class HydraulicJoints:
    """Joints with hydraulics; one that runs onto its stop rests there.

    Args:
        machine: its stops. spec: how its joints follow. substep_s: of the hydraulics' pieces [s].

    Raises:
        MachineError: if the spec is not one of this machine.
    """

    def __init__(self, machine: MachineModel, spec: HydraulicSpec, substep_s: float = 0.0025) -> None:
        self.hydraulics = Hydraulics(spec.checked_for(machine.n), substep_s)
        self._q_min, self._q_max = machine.q_min, machine.q_max
        self._valves = np.zeros(machine.n)

    @property
    def velocity(self) -> Floats:
        """True joint velocities (n,) now [rad/s, m/s]."""
        return self.hydraulics.velocity

    def set_valves(self, valves: Sequence[int]) -> None:
        """Set the valves (n) from now on."""
        self._valves = np.array(valves, dtype=np.float64) / VALVE_FULL

    def advance(self, dt_s: float, q: Floats) -> Floats:
        """Return the joint positions (n,) after `dt_s`."""
        way = self.hydraulics.advance(self._valves, q, dt_s)
        moved = q + way
        ended = ((moved >= self._q_max) & (way > 0.0)) | ((moved <= self._q_min) & (way < 0.0))
        if ended.any():
            self.hydraulics.block_joints(ended.tolist())
        return np.clip(moved, self._q_min, self._q_max)


def joints_of(machine: MachineModel, spec: HydraulicSpec | None, substep_s: float = math.inf) -> Joints:
    """Return ideal joints, or hydraulic ones where there is a spec; its pieces are at most 2.5 ms long."""
    return IdealJoints(machine) if spec is None else HydraulicJoints(machine, spec, min(substep_s, 0.0025))
