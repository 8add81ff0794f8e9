"""How long a posture for a tool pose takes to find, and how often it is found: one JSON object with `--json`.

The shipped 20 t road-rail excavator with tiltrotator, pairs of postures drawn within the joints' limits: the tool is
to go from the first to where it is in the second, so every goal can be reached. `far` draws both; `near` draws the
second within 0.2 rad of the first, as along a path.

- `closed_form`: `ClosedForm.branches`: every branch, checked against the limits, sorted by the time to get there.
- `closed_form_many`: `branches_many`, all goals at once; per pose.
- `iterative`: the closed loop's step repeated from the start posture, `motion.solve`, without restarts.
- `pink`, `mink`: `solve_ik` for a frame task and the joints' limits repeated from the start, solved with daqp.

A solution is within 1 mm, 0.1 degrees and the limits, judged by our forward kinematics for all alike; the others stop
there themselves, or after 200 iterations. Processor time: `ms` is the median over those solved, `all_ms` the mean
over all goals. `worst_m` is the largest position error among those solved. A peer that is not installed is null, with
the reason.
"""

import argparse
import importlib.util
import json
import math
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.motion.ik.closed_form import closed_form
from workgauge.motion.ik.task import task_error
from workgauge.values.arrays import Floats
from workgauge.values.tasks import Orientation

MACHINE = "rre20"
NEAR = 0.2
TOLERANCE_M, TOLERANCE = 1e-3, math.radians(0.1)
ITERATIONS = 200
SEED = 5

#: From a start posture (n,) and a goal (4, 4) to a posture (n,), or None.
Finder = Callable[[Floats, Floats], Floats | None]


@dataclass(frozen=True)
class Job:
    """Start postures (k, n) and goals (k, 4, 4)."""

    machine: MachineModel
    starts: Floats
    goals: Floats


def jobs(machine: MachineModel, count: int) -> dict[str, Job]:
    """Return the goals far and near."""
    rng = np.random.default_rng(SEED)
    starts = rng.uniform(machine.sample_min, machine.sample_max, (count, machine.n))
    ends = {
        "far": rng.uniform(machine.sample_min, machine.sample_max, starts.shape),
        "near": np.clip(starts + rng.uniform(-NEAR, NEAR, starts.shape), machine.q_min, machine.q_max),
    }
    return {
        name: Job(machine, starts, np.array([machine.tool_pose(machine.forward(q)) for q in end]))
        for name, end in ends.items()
    }


def closed_finder(machine: MachineModel) -> Finder:
    """The closed form, nearest branch."""
    form = closed_form(machine)
    assert form is not None

    def find(start: Floats, goal: Floats) -> Floats | None:
        found = form.branches(goal, q_near=start).q
        return found[0] if len(found) else None

    return find


def iterative_finder(machine: MachineModel) -> Finder | None:
    """The closed loop's step, repeated."""
    if importlib.util.find_spec("workgauge.motion.ik.solve") is None:
        return None
    from workgauge.motion.ik.solve import SolveSettings, solve

    settings = SolveSettings(iterations=ITERATIONS, tolerance_m=TOLERANCE_M, tolerance_rad=TOLERANCE)
    return lambda start, goal: solve(machine, start, goal, Orientation.FULL, settings).q


def near_enough(error: Floats) -> bool:
    """Whether an error (6,), linear then angular, is within the tolerances."""
    return bool(np.linalg.norm(error[:3]) < TOLERANCE_M and np.linalg.norm(error[3:]) < TOLERANCE)


def pink_finder(machine: MachineModel) -> Finder | None:
    """Pink: a frame task under the joints' limits, repeated."""
    if importlib.util.find_spec("pink") is None:
        return None
    import pinocchio as pin
    from pink import Configuration, solve_ik
    from pink.limits import ConfigurationLimit
    from pink.tasks import FrameTask

    model = machine.pinocchio_model()
    data = model.createData()
    limits = [ConfigurationLimit(model, config_limit_gain=1.0)]

    def find(start: Floats, goal: Floats) -> Floats | None:
        configuration = Configuration(model, data, start)
        task = FrameTask("tool", position_cost=1.0, orientation_cost=1.0)
        task.set_target(pin.SE3(np.array(goal)))
        for _ in range(ITERATIONS):
            if near_enough(task.compute_error(configuration)):
                break
            velocity = solve_ik(configuration, [task], 1.0, solver="daqp", limits=limits)
            configuration.integrate_inplace(velocity, 1.0)
        return np.array(configuration.q)

    return find


def mink_finder(machine: MachineModel) -> Finder | None:
    """Mink: the same."""
    if importlib.util.find_spec("mink") is None:
        return None
    import mink
    import mujoco
    from tick import mjcf, place

    tool = f'<site name="tool" {place(machine.chain[-1].T_joint_link @ machine.T_link_tool)}/>'
    described = mjcf(machine, []).replace("</body></body>", f"{tool}</body></body>", 1)
    endless = f'range="{-math.pi} {math.pi}"'
    assert described.count(endless) == machine.continuous.sum()
    model = mujoco.MjModel.from_xml_string(described.replace(endless, ""))
    limits = [mink.ConfigurationLimit(model, gain=1.0)]
    configuration = mink.Configuration(model)

    def find(start: Floats, goal: Floats) -> Floats | None:
        configuration.update(start)
        task = mink.FrameTask("tool", "site", position_cost=1.0, orientation_cost=1.0)
        task.set_target(mink.SE3.from_matrix(goal))
        for _ in range(ITERATIONS):
            if near_enough(task.compute_error(configuration)):
                break
            velocity = mink.solve_ik(configuration, [task], 1.0, "daqp", limits=limits)
            configuration.integrate_inplace(velocity, 1.0)
        return np.array(configuration.q)

    return find


def measured(given: Job, find: Finder) -> dict[str, float | None]:
    """Return time and success of one contestant on one job."""
    machine, times, solved, worst = given.machine, [], [], 0.0
    for start, goal in zip(given.starts[:3], given.goals[:3], strict=True):
        find(start, goal)
    for start, goal in zip(given.starts, given.goals, strict=True):
        began = time.process_time()
        try:
            q = find(start, goal)
        except Exception as error:  # a peer's solver may refuse
            if type(error).__module__.startswith("workgauge"):
                raise
            q = None
        times.append((time.process_time() - began) * 1e3)
        good = q is not None and bool(np.all((machine.q_min - 1e-9 <= q) & (q <= machine.q_max + 1e-9)))
        if good and q is not None:
            error_now = task_error(machine.forward(q), machine, goal, Orientation.FULL)
            good = near_enough(error_now)
            worst = max(worst, float(np.linalg.norm(error_now[:3]))) if good else worst
        solved.append(good)
    ms = [t for t, good in zip(times, solved, strict=True) if good]
    return {
        "ms": statistics.median(ms) if ms else None,
        "all_ms": statistics.fmean(times),
        "solved": sum(solved) / len(solved),
        "worst_m": worst,
    }


def measured_many(given: Job) -> dict[str, float]:
    """Return time per pose and success of the closed form over all goals at once."""
    form = closed_form(given.machine)
    assert form is not None
    form.branches_many(given.goals[:2])
    began = time.process_time()
    q = form.branches_many(given.goals)
    taken = time.process_time() - began
    present = np.isfinite(q).all(-1)
    return {"ms": taken * 1e3 / len(q), "solved": float(present.any(-1).mean())}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    parser.add_argument("--goals", type=int, default=300, help="goals far and near")
    asked = parser.parse_args()
    machine = load_machine(MACHINE)
    finders: dict[str, tuple[Finder | None, str]] = {
        "closed_form": (closed_finder(machine), ""),
        "iterative": (iterative_finder(machine), "the package has no iterative solver"),
        "pink": (pink_finder(machine), "pin-pink is not installed: pip install workgauge[bench]"),
        "mink": (mink_finder(machine), "mink is not installed: pip install workgauge[bench]"),
    }
    answer: dict[str, Any] = {"machine": MACHINE, "goals": asked.goals, "reasons": {}}
    for name, job in jobs(machine, asked.goals).items():
        row: dict[str, Any] = {"closed_form_many": measured_many(job)}
        for contestant, (find, reason) in finders.items():
            row[contestant] = None if find is None else measured(job, find)
            if find is None:
                answer["reasons"][contestant] = reason
        answer[name] = row
    if asked.json:
        print(json.dumps(answer))
        return
    for name in ("far", "near"):
        for contestant, result in answer[name].items():
            print(name, contestant, result if result is not None else answer["reasons"][contestant])


if __name__ == "__main__":
    main()
