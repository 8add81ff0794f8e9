"""How near and how quickly a guard lets the machine come, against the quickest stop there is.

    python benchmarks/approach.py --json

Two approaches at the catenary pole of the scenario `pole-approach`: `line`, its own, the tool driven straight at the
pole; and `swing`, one joint at its full speed, the boom swung at the pole from 60 degrees away. Each by every guard

- without delay and without sensor noise: `left_m`, what is left above the stop distance when the machine stands;
- with 0.3 s of dead time, 0.2 s of lag and full speed over deceleration 0.6 s: `delayed_left_m`, the same, and
  `delayed_least_m`, the least on the way; `time_s` from the push of the lever until it stays within 2 cm of its end,
  and `ratio`, that over `optimal_s`, the same of the time-optimal stop found offline for the same hydraulics on the
  same path (`workgauge.rehearse.time_optimal`): full lever at once, without the lever's ramp, until the last instant
  from which the machine still comes to rest at the stop distance.

Prints `{"rows": [{"approach", "guard", "left_m", "delayed_left_m", "delayed_least_m", "time_s", "optimal_s",
"ratio"}…]}`. `ratio` is null where the guard lets the machine nearer than the stop distance: that is no stop in time.
"""

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from baselines import NearestPairBarrier

from workgauge.guard.api import Guard
from workgauge.guard.registry import GUARDS, guard_named
from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.motion.desired import MotionConfig, MotionMemory, desired
from workgauge.motion.joystick import LeverFeel, joint_velocity
from workgauge.proximity.scene import Scene
from workgauge.rehearse.drives.dynamics import IDEAL, Dynamics, believed_machine
from workgauge.rehearse.run import open_session, run_session
from workgauge.rehearse.scenario import DriveLine, Hold, MoveLevers, Step, Target
from workgauge.rehearse.scenario_file import LoadedScenario, load_scenario
from workgauge.rehearse.session import Session
from workgauge.rehearse.targets import Targets
from workgauge.rehearse.time_optimal import Approach, Course, Slack, time_optimal_stop
from workgauge.sim.hydraulics import HydraulicSpec
from workgauge.values.arrays import Floats, frozen
from workgauge.values.measurements import DriveMode, Intent, Levers, Stamp, ToolLine

DELAYED = Dynamics(dead_time_s=0.3, lag_s=0.2, stop_s=0.6, tolerance=0.0)
STOP_DISTANCE_M = 0.2
#: How far clearances are looked for [m].
SIGHT_M = 6.0
TARGET = Target(limit="point:P1-12")
#: A stop is no stop if it ends nearer than its distance by more than this [m].
ROUNDING_M = 1e-4


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of approach: the posture it starts from (None for the scenario's), and what the levers do."""

    name: str
    posture_deg: dict[str, float] | None
    push: Step


KINDS = (
    Kind("line", None, DriveLine(do="tool_line", target=TARGET, lever=1.0, stopped_for_s=2.0)),
    Kind(
        "swing",
        {"swing": -130.0, "boom": 16.0, "stick": -45.0, "bucket": -112.0, "tilt": 0.0, "rotate": 0.0},
        MoveLevers(do="levers", levers={"left_x": -1.0}, for_s=12.0),
    ),
)
FIRST = Hold(do="hold", for_s=0.5)


def guards() -> list[Guard]:
    """Return the guards compared."""
    compared: list[Guard] = [guard_named("linear"), NearestPairBarrier()]
    return [*compared, *(guard_named(name) for name in ("barrier",) if name in GUARDS)]


def scenario_of(kind: Kind, joints: str) -> LoadedScenario:
    """Return `pole-approach` with these joints, and with this start."""
    loaded = load_scenario("pole-approach")
    loaded = replace(loaded, scenario=loaded.scenario.model_copy(update={"joints": joints}))
    if kind.posture_deg is None:
        return loaded
    return replace(loaded, posture={name: math.radians(value) for name, value in kind.posture_deg.items()})


def slack_of(session: Session) -> Slack:
    """Return what is left of the nearest clearance above its stop distance, by posture [m]."""
    scene, T = Scene(session.machine, session.limits), session.true_state[1]

    def slack(q: Floats) -> float:
        found = scene.query(session.machine.forward(q), T, SIGHT_M)
        own = found.stop_distances
        left = found.distances - np.where(np.isnan(own), STOP_DISTANCE_M, own)
        return float(left.min(initial=SIGHT_M))

    return slack


def guarded(kind: Kind, guard: Guard, machine: MachineModel, joints: str) -> Approach:
    """Return a guard's approach, from the push of the lever on."""
    session = open_session(scenario_of(kind, joints), guard=guard, machine=machine)
    slack = slack_of(session)
    series = run_session(session, (FIRST, kind.push), kind.name).series
    pushed = series.step >= 1
    left = np.array([slack(q) for q in series.q[pushed]])
    return Approach(series.t_s[pushed] - series.t_s[pushed][0], left, frozen(series.q[-1]), math.inf)


def course_of(kind: Kind, session: Session) -> Course:
    """Return the joint velocities at the full lever by posture: the swing's, or what keeps the tool on its line."""
    machine, (q, T) = session.machine, session.true_state
    if isinstance(kind.push, MoveLevers):
        levers = Levers(**kind.push.levers)
        velocity = np.array(joint_velocity(levers.values, machine))
        return lambda _: velocity
    tool = session.tool
    away = Targets(session.limits, session.frame, lambda: None).point(TARGET, T, tool) - tool
    line = ToolLine(frozen(tool), frozen(away / np.linalg.norm(away)))
    intent = Intent(Stamp("", 0, ""), DriveMode.LINE, Levers(right_y=1.0), True, line)
    config = MotionConfig(dt_s=session.tick_s, feel=LeverFeel(ramp_s=0.0))
    start = machine.tool_pose(machine.forward(q))
    kept = tuple((T[:3, :3] @ start[:3, :3]).ravel().tolist())
    memory = MotionMemory(line=(*line.start_site.tolist(), *line.direction_site.tolist()), kept=kept)
    return lambda at: desired(intent, machine.forward(at), machine, T, memory, config)[0]


def optimal(kind: Kind, machine: MachineModel) -> Approach:
    """Return the time-optimal approach on the same path with the same hydraulics."""
    session = open_session(scenario_of(kind, "hydraulic"), machine=machine)
    spec = HydraulicSpec.of_machine(machine)
    return time_optimal_stop(machine, spec, session.true_state[0], course_of(kind, session), slack_of(session))


def measure(kinds: Sequence[Kind], compared: Sequence[Guard]) -> dict[str, Any]:
    """Return the rows."""
    plain = load_machine("rre20")
    ideal, delayed = (believed_machine(plain, one, np.random.default_rng(0)) for one in (IDEAL, DELAYED))
    rows = []
    for kind in kinds:
        best = optimal(kind, delayed)
        for guard in compared:
            near = guarded(kind, guard, ideal, "ideal")
            late = guarded(kind, guard, delayed, "hydraulic")
            stopped = float(late.slack_m.min()) >= -ROUNDING_M
            rows.append(
                {
                    "approach": kind.name,
                    "guard": guard.name,
                    "left_m": round(float(near.slack_m[-1]), 4),
                    "delayed_left_m": round(float(late.slack_m[-1]), 4),
                    "delayed_least_m": round(float(late.slack_m.min()), 4),
                    "time_s": round(late.arrival_s(), 3),
                    "optimal_s": round(best.arrival_s(), 3),
                    "ratio": round(late.arrival_s() / best.arrival_s(), 4) if stopped else None,
                }
            )
    return {"rows": rows}


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    known = {guard.name: guard for guard in guards()}
    parser.add_argument("--guard", choices=list(known), action="append", help="only this one; may be repeated")
    parser.add_argument("--json", action="store_true", help="the object instead of words")
    given = parser.parse_args()
    found = measure(KINDS, [known[name] for name in given.guard or known])
    if given.json:
        print(json.dumps(found))
        return
    for row in found["rows"]:
        print("  ".join(f"{key} {value}" for key, value in row.items()))


if __name__ == "__main__":
    main()
