"""Towards a goal in one tick: closed-loop inverse kinematics from where a command of now begins to act."""

import math
from dataclasses import replace

import numpy as np

from workgauge.machine.model import Kinematics, MachineModel
from workgauge.motion.ik.clik import ClikFacts, ClikMemory, clik_velocity
from workgauge.motion.ik.task import task_error
from workgauge.motion.job import Job, JobMemory
from workgauge.motion.predict import InFlight, Lateness, steadiest_1_s
from workgauge.motion.wish import FollowSettings, Wish, sizes
from workgauge.values.arrays import Floats
from workgauge.values.reasons import Reason, ReasonCode
from workgauge.values.transforms import inverse

#: Share of the motion towards a goal that may be missed before it is said.
MISSED = 0.1


def towards(
    job: Job,
    share: float,
    kin: Kinematics,
    machine: MachineModel,
    T_site_machine: Floats,
    memory: JobMemory,
    flight: InFlight,
    settings: FollowSettings,
    late: Lateness,
    dt_s: float,
) -> Wish:
    """Return the wish of a goal: closed-loop inverse kinematics from where a command of now begins to act (Lee 5)."""
    goal = job.goal
    assert goal is not None
    T_machine_goal = inverse(T_site_machine) @ goal.T_site_tool
    error_m, error_rad = sizes(task_error(kin, machine, T_machine_goal, goal.orientation))
    ahead = machine.forward(flight.ahead(kin.q, late)[0]) if settings.compensate else kin
    error = task_error(ahead, machine, T_machine_goal, goal.orientation)
    left_m, left_rad = sizes(error)
    rate = min(share, memory.rate + dt_s / settings.ramp_s)
    gains = settings.clik
    if settings.compensate:
        most = float(steadiest_1_s(machine, dt_s).min())
        gains = replace(gains, linear_1_s=min(gains.linear_1_s, most), angular_1_s=min(gains.angular_1_s, most))
    pace = min(
        1.0,
        rate * job.tool_speed_m_s / max(gains.linear_1_s * left_m, 1e-12),
        rate * job.tool_turn_rad_s / max(gains.angular_1_s * left_rad, 1e-12),
    )
    velocity, clik, facts = clik_velocity(
        *(machine, ahead, pace * error, np.zeros(len(error)), ClikMemory(memory.group), gains, goal.orientation),
        dt_s=dt_s,
    )
    return Wish(
        velocity,
        T_machine_goal[:3, 3] - machine.tool_pose(kin)[:3, 3],
        *(error_m, error_rad, math.nan, 0.0, rate),
        there=max(error_m, left_m) <= job.tolerance_m and max(error_rad, left_rad) <= job.tolerance_rad,
        to_go=error_m + error_rad,
        group=clik.group,
        reasons=_hindered(facts, machine),
    )


def _hindered(facts: ClikFacts, machine: MachineModel) -> tuple[Reason, ...]:
    """Return why the joints cannot do what a goal asks of them."""
    if facts.missed <= MISSED:
        return ()
    left = max(1.0 - facts.missed, 0.0)
    if facts.held:
        names = ", ".join(machine.joint_names[j] for j in facts.held)
        text = f"{names} at the end of the way to the goal: {100.0 * facts.missed:.0f} % of the motion is missing"
        return (Reason(ReasonCode.JOINT_END, text, joint=machine.joint_names[facts.held[0]], scale=left),)
    text = f"the tool cannot go that way from here, {100.0 * facts.missed:.0f} % of the motion is missing"
    return (Reason(ReasonCode.SINGULAR, text, scale=left),)
