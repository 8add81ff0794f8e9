"""A guard to compare with: the artificial potential field with one closest point."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from workgauge.guard.api import GuardInput, GuardResult, Memory, full_stop, unusable
from workgauge.guard.cushion import cushioned
from workgauge.guard.joints import one_group, within_speed
from workgauge.machine.model import MachineModel
from workgauge.values.arrays import Floats, frozen
from workgauge.values.clearances import Clearances
from workgauge.values.reasons import Reason, ReasonCode

CUSHION_S = 0.3


@dataclass(frozen=True, slots=True)
class PotentialField:
    """Mäkinen's artificial potential field, 3.13 to 3.16, as a velocity added to the joints.

    At each closest point `v = mu (1/p - 1/p_u) / p^2` along the way out for `p <= p_u`, else 0 (3.13), p the distance
    less its protection level, v never above a cap, which it is as well where p <= 0. `u J_O` is the clearance's row
    of the joints (3.15, where the document prints a pseudo-inverse), so that a point adds `(u J_O)^+ v`, damped.
    Wanted velocity and all of these are summed (3.14, with the operator's joint velocities in place of the task's:
    there is no task whose null space they would have to keep to). mu is not in the document: here the field pushes
    with 0.94 m/s at 0.2 m. A limit with a stop distance of its own counts as so much nearer or farther. The push is
    there only while the operator moves a lever: a gate opens on closed valves alone.

    Attributes:
        per_link: one closest point per link, as the document has it; else one per link and limit, which it names as
            what can already be done.
        slow_distance_m: p_u. stop_distance_m: what a limit's own is held against. mu: [m^4/s].
        cap_m_s: of one point's velocity. damping: of the inverse [m].
    """

    per_link: bool = True
    slow_distance_m: float = 0.8
    stop_distance_m: float = 0.2
    mu: float = 0.01
    cap_m_s: float = 1.0
    damping: float = 0.05

    @property
    def name(self) -> str:
        """Name in the tables."""
        return "potential" if self.per_link else "potential-each-limit"

    @property
    def reach_m(self) -> float:
        """Clearances up to here must be known to it [m]."""
        return self.slow_distance_m

    def start(self) -> Memory:
        """Return the memory of a guard that has done nothing yet."""
        return {"group": -1}

    def idle(
        self, sent: Floats | None, machine: MachineModel, dt_s: float, elapsed_s: float, memory: Memory
    ) -> Memory:
        """Return the memory after a tick in which nobody asked anything."""
        return self.start()

    def speed(self, p: Floats) -> Floats:
        """Return the avoidance speeds (k,) [m/s] at clearances (k,) [m], eq. 3.13, capped."""
        safe = np.maximum(p, 1e-3)
        field = self.mu * (1.0 / safe - 1.0 / self.slow_distance_m) / safe**2
        return np.where(p <= self.slow_distance_m, np.clip(field, 0.0, self.cap_m_s), 0.0)

    def allow(self, given: GuardInput, memory: Memory) -> tuple[GuardResult, Memory]:
        """Return the wanted velocity and what the field adds to it, within what the joints can do."""
        wrong = unusable(given)
        if wrong is not None:
            return full_stop(len(given.joint_names), wrong), self.start()
        slack = _slack(given.clearances, self.stop_distance_m)
        near = _points(given.clearances, slack, self.per_link)
        rows = given.rows[near]
        push = self.speed(slack[near] + self.stop_distance_m) if given.desired.any() else np.zeros(len(near))
        field = rows.T @ (push / ((rows * rows).sum(axis=1) + self.damping**2))
        pushing = near[push > 0.0]
        reasons = [_reason(given.clearances, int(k)) for k in pushing]
        return _within_joints(given, given.desired + field, memory, reasons)


def _slack(clearances: Clearances, stop_distance_m: float) -> Floats:
    """Return what is left of every clearance above its stop distance, less its protection level (k,) [m]."""
    own = clearances.stop_distances
    return clearances.distances - clearances.protections - np.where(np.isnan(own), stop_distance_m, own)


def _points(clearances: Clearances, slack: Floats, per_link: bool) -> np.ndarray:
    """Return the indices of the nearest clearance of every link, or of every link and limit."""
    first: dict[tuple[int, int], int] = {}
    links, limits = clearances.links.tolist(), clearances.limits.tolist()
    for k in np.argsort(slack, kind="stable").tolist():
        first.setdefault((links[k], -1 if per_link else limits[k]), k)
    return np.array(sorted(first.values()), dtype=np.intp)


def _within_joints(
    given: GuardInput, velocity: Floats, memory: Memory, reasons: Sequence[Reason]
) -> tuple[GuardResult, Memory]:
    """Return the velocity within speeds, exclusive groups and end cushions."""
    names = given.joint_names
    positive, negative = given.speed_positive.tolist(), given.speed_negative.tolist()
    bounded, fast = within_speed(velocity.tolist(), positive, negative, names)
    previous = memory.get("group")
    group = previous if isinstance(previous, int) else -1
    bounded, group, held = one_group(bounded, positive, negative, given.exclusive_groups, names, group)
    ends = (given.q_min.tolist(), given.q_max.tolist())
    bounded, near_end = cushioned(
        bounded, given.q.tolist(), ends, (positive, negative), names, dt_s=given.dt_s, cushion_s=CUSHION_S
    )
    size = float(np.abs(given.desired).max(initial=0.0))
    scale = 1.0 if not size or not reasons else min(float(np.abs(bounded).max(initial=0.0)) / size, 1.0)
    return GuardResult(frozen(bounded), (*reasons, *fast, *held, *near_end), scale), {"group": group}


def _reason(clearances: Clearances, k: int) -> Reason:
    one = clearances[k]
    return Reason(
        ReasonCode.LIMIT_NEAR,
        f"{one.link} is {one.distance_m:.2f} m from {one.limit}",
        link=one.link,
        limit=one.limit,
        clearance_m=one.distance_m,
    )
