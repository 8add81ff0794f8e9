"""The quickest approach there is: full lever until the last instant that still stops in time, found offline."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.sim.hydraulics import Hydraulics, HydraulicSpec
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import InputError

#: From a posture (n,) to the joint velocities (n,) at the full lever, what keeps to the known path [rad/s, m/s].
Course: TypeAlias = Callable[[Floats], Floats]
#: From a posture (n,) to what is left of the nearest clearance above its stop distance [m].
Slack: TypeAlias = Callable[[Floats], float]

#: A joint slower than this has come to rest [rad/s, m/s].
RESTING = 1e-4
#: The instant is found to within this [s].
SWITCH_S = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Approach:
    """One approach, tick by tick.

    Attributes:
        t_s: (k,) from when the lever is pushed [s]. slack_m: (k,) left above the stop distance then [m].
        q: (n,) where it came to rest. switch_s: when the lever was let go [s].
    """

    t_s: Floats
    slack_m: Floats
    q: Floats
    switch_s: float

    def arrival_s(self, within_m: float = 0.02) -> float:
        """Return the time from which on it is within so much of where it ends [s]."""
        return arrival_s(self.t_s, self.slack_m, within_m)


def arrival_s(t_s: Floats, slack_m: Floats, within_m: float = 0.02) -> float:
    """Return the time from which on a clearance (k,) stays within so much of its last value [s], times (k,)."""
    away = np.flatnonzero(np.abs(slack_m - slack_m[-1]) > within_m)
    return float(t_s[away[-1] + 1]) if len(away) else float(t_s[0])


def rolled(
    machine: MachineModel, spec: HydraulicSpec, q: Floats, course: Course, slack: Slack, switch_s: float, dt_s: float
) -> Approach:
    """Return the approach with the lever full until `switch_s` and let go then, until the machine is at rest.

    Args:
        machine: its joint stops. spec: how its joints follow their valves. q: (n,) posture at the start, at rest.
        course, slack: see there. dt_s: valves are set, and clearances are looked at, so often [s].

    Raises:
        InputError: if it does not come to rest within a minute of letting go.
    """
    joints = Hydraulics(spec.checked_for(machine.n))
    q, t = np.array(q, dtype=np.float64), 0.0
    times, left = [0.0], [slack(q)]
    still_from = switch_s + float(spec.dead_time_s.max(initial=0.0)) + dt_s
    while t < still_from or (np.abs(joints.velocity) > RESTING).any():
        if t > switch_s + 60.0:
            raise InputError("the machine does not come to rest", element="time_optimal", value=t)
        pushed = min(max(switch_s - t, 0.0), dt_s)
        valves = _valves(course(q), spec) if pushed > 0.0 else np.zeros(machine.n)
        for valve, span in ((valves, pushed), (np.zeros(machine.n), dt_s - pushed)):
            if span > 1e-12:
                moved = q + joints.advance(valve, q, span)
                q = np.clip(moved, machine.q_min, machine.q_max)
                joints.block_joints((q != moved).tolist())
        t += dt_s
        times.append(t)
        left.append(slack(q))
    return Approach(np.array(times), np.array(left), frozen(q), switch_s)


def time_optimal_stop(
    machine: MachineModel,
    spec: HydraulicSpec,
    q: Floats,
    course: Course,
    slack: Slack,
    *,
    longest_s: float = 30.0,
    dt_s: float = 0.01,
) -> Approach:
    """Return the quickest approach along a known path that never has less than the stop distance left.

    Full lever until the latest instant from which the machine, its commands in flight and its limited deceleration
    included, comes to rest at the stop distance and not beyond: bang-bang with the one switch that letting go is.
    The instant is bisected, so that it has to be that later is nearer. No ramp of the lever: nothing quicker keeps to
    the path without counter-steering.

    Args:
        machine, spec, q, course, slack, dt_s: as in `rolled`.
        longest_s: the switch is looked for up to here [s].

    Raises:
        InputError: if the machine starts too near, or nothing stands in its way.
    """
    known = {switch: rolled(machine, spec, q, course, slack, switch, dt_s) for switch in (0.0, longest_s)}
    early, late = 0.0, longest_s
    if known[early].slack_m.min() < 0.0:
        raise InputError("starts nearer than the stop distance", element="q", value=float(known[early].slack_m.min()))
    if known[late].slack_m.min() >= 0.0:
        raise InputError("nothing stands in the way", element="longest_s", value=longest_s)
    late = float(known[late].t_s[np.argmax(known[late].slack_m < 0.0)])  # let go then, it is too late already
    best = known[early]
    while late - early > SWITCH_S:
        switch = 0.5 * (early + late)
        one = rolled(machine, spec, q, course, slack, switch, dt_s)
        if one.slack_m.min() >= 0.0:
            early, best = switch, one
        else:
            late = switch
    return best


def _valves(velocity: Floats, spec: HydraulicSpec) -> Floats:
    """Return the valves (n,), -1 to 1, for joint velocities (n,), past the dead band; all scaled if one is full."""
    side = (velocity < 0.0).astype(np.intp)
    j = np.arange(len(velocity))
    share = np.abs(velocity) / spec.full_speed[side, j]
    share = share / max(float(share.max(initial=0.0)), 1.0)
    band = spec.dead_band[side, j]
    return np.where(share > 0.0, np.copysign(band + (1.0 - band) * share, velocity), 0.0)
