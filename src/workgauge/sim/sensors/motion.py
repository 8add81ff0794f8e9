"""The machine's true motion between two looks at it: where points of its links are, how fast they move and turn."""

from dataclasses import dataclass

import numpy as np

from workgauge.machine.model import Kinematics, MachineModel
from workgauge.values.arrays import Floats, Ints
from workgauge.values.transforms import rotation, rotation_vector


@dataclass(frozen=True, slots=True, eq=False)
class TrueState:
    """Truth at one time on the plant's clock: joint positions q (n,) and T_site_machine (4, 4)."""

    t_ns: int
    q: Floats
    T_site_machine: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Truth at one time, with its rates.

    Attributes:
        t_ns: on the plant's clock. T_site_machine: (4, 4).
        kin: where the links are. q_rate: (n,) [rad/s, m/s].
        velocity: (3,) of the machine frame's origin, site axes [m/s]. turn: (3,) its angular velocity [rad/s].
    """

    t_ns: int
    T_site_machine: Floats
    kin: Kinematics
    q_rate: Floats
    velocity: Floats
    turn: Floats

    def points(self, links: Ints, points_link: Floats) -> Floats:
        """Return points fixed to links, given in the links' frames (k, 3), in the site frame (k, 3) [m]."""
        machine = self._in_machine(links, points_link)
        out: Floats = machine @ self.T_site_machine[:3, :3].T + self.T_site_machine[:3, 3]
        return out

    def point_velocities(self, machine: MachineModel, links: Ints, points_link: Floats) -> Floats:
        """Return the velocities (k, 3) of points fixed to links, in the site's axes [m/s]: v + w x R p + R J q'."""
        points = self._in_machine(links, points_link)
        R = self.T_site_machine[:3, :3]
        velocities = self.velocity + np.cross(self.turn, points @ R.T)
        if self.q_rate.any():
            velocities = velocities + (machine.point_jacobians(self.kin, links, points) @ self.q_rate) @ R.T
        return velocities

    def link_turn(self, link: int) -> Floats:
        """Return the angular velocity (3,) of a link in the machine's axes [rad/s]."""
        turn: Floats = self.turn @ self.T_site_machine[:3, :3]
        if self.q_rate.any():
            turn = turn + self.kin.spatial_jacobian[3:, :link] @ self.q_rate[:link]
        return turn

    def _in_machine(self, links: Ints, points_link: Floats) -> Floats:
        T = self.kin.T_machine_links[links]
        out: Floats = (T[:, :3, :3] @ points_link[:, :, None])[:, :, 0] + T[:, :3, 3]
        return out


def motion_at(machine: MachineModel, before: TrueState, after: TrueState, t_ns: int) -> Motion:
    """Return the motion at a time between two states (both ends included), at constant rates from one to the other.

    Joint positions, translation and rotation vector are linear in time in between.
    """
    span_s = (after.t_ns - before.t_ns) * 1e-9
    if span_s <= 0.0:
        zero = np.zeros(3)
        return Motion(t_ns, after.T_site_machine, machine.forward(after.q), np.zeros(machine.n), zero, zero)
    q_rate = (after.q - before.q) / span_s
    T, velocity, turn = after.T_site_machine, np.zeros(3), np.zeros(3)
    q = after.q
    if not np.array_equal(T, before.T_site_machine):
        velocity = (T[:3, 3] - before.T_site_machine[:3, 3]) / span_s
        turn = rotation_vector(T[:3, :3] @ before.T_site_machine[:3, :3].T) / span_s
    if t_ns != after.t_ns:
        left_s = (after.t_ns - t_ns) * 1e-9
        q = after.q - q_rate * left_s
        T = np.array(T)
        T[:3, :3] = rotation(-turn * left_s) @ T[:3, :3]
        T[:3, 3] -= velocity * left_s
    return Motion(t_ns, T, machine.forward(q), q_rate, velocity, turn)
