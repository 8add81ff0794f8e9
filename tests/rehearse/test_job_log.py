"""Runs of automatic motion come out of their own logs again, bit for bit: jobs let go, taken up, planned anew."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from workgauge.loop.memory import first_memory, restored
from workgauge.loop.tick import tick
from workgauge.motion.job import Job, JobState
from workgauge.motion.planning import Pace, plan_joints
from workgauge.record.reader import Log, open_log
from workgauge.record.ticks import replay
from workgauge.rehearse.auto_steps import FollowPath, GoTo
from workgauge.rehearse.automatic import Automatic
from workgauge.rehearse.result import RunResult
from workgauge.rehearse.run import open_session, planned_drive, run_session
from workgauge.rehearse.scenario import Hold, Step
from workgauge.rehearse.scenario_file import LoadedScenario, load_scenario
from workgauge.rehearse.session import Session
from workgauge.rehearse.tick_log import Origin, recorded, reopened, replayed
from workgauge.values.measurements import DriveMode, Levers
from workgauge.values.tasks import Orientation, ToolGoal
from workgauge.wire.messages import encode

HOLD = Hold(do="hold", for_s=0.2)
AUTO = (DriveMode.AUTO, Levers(right_y=1.0))


def short(name: str, *steps: Step, guard: str = "barrier") -> LoadedScenario:
    """Return a shipped scenario with a drive of its own."""
    loaded = load_scenario(name).choosing(guard=guard)
    return replace(loaded, scenario=loaded.scenario.model_copy(update={"drive": (HOLD, *steps, HOLD)}))


def origin_of(loaded: LoadedScenario) -> Origin:
    return Origin(loaded.site_files, loaded.machine, loaded.rules, loaded.epsg)


def run(loaded: LoadedScenario, file: Path) -> RunResult:
    session = open_session(loaded)
    plans = planned_drive(session, loaded.scenario.drive)
    with recorded(session, file, origin_of(loaded)):
        return run_session(session, loaded.scenario.drive, "recorded", plans=plans)


def jobs_of(log: Log) -> list[str]:
    """Return the ids of the jobs that ticks were given, each time another is."""
    scene, _ = reopened(log)
    ids = [one.inputs.job.id for one in replay(log, scene) if one.inputs.job is not None]
    return [name for k, name in enumerate(ids) if k == 0 or ids[k - 1] != name]


def same_again(file: Path) -> list[JobState]:
    """Check that a log replays to the bit, through memories in JSON as well; return the states of its jobs."""
    log = open_log(file)
    scene, config = reopened(log)
    done = replayed(log, scene, config)
    assert (done.different, done.first) == (0, None) and done.moving > 20
    memory, states = first_memory(config), []
    for k, one in enumerate(replay(log, scene)):
        outputs, memory, trace = tick(one.inputs, memory, config)
        assert outputs.frame == encode(one.command)
        if k % 29 == 7:
            memory = restored(json.loads(json.dumps(memory.plain())))
        if trace.job is not None and (not states or states[-1] is not trace.job.state):
            states.append(trace.job.state)
    return states


DOWN = FollowPath.model_validate(
    {
        "do": "follow",
        "kind": "spline",
        "deviation_m": 0.8,
        "at_most_s": 4.0,
        "points": [
            {"at_m": [4.60, 1.30, 1.30], "rpy_deg": [180, 0, 105]},
            {"at_m": [4.40, 1.70, 0.90], "rpy_deg": [180, 0, 110]},
            {"at_m": [4.20, 1.50, 0.90], "rpy_deg": [180, 0, 108]},
        ],
    }
)


@pytest.mark.parametrize("guard", ["barrier", "potential", "none"])
def test_ballast_removal_cut_short(tmp_path: Path, guard: str) -> None:
    loaded = short("ballast-removal", DOWN, guard=guard)
    result = run(loaded, tmp_path / "run.mcap")
    assert result.automatic is not None
    assert JobState.MOVING in same_again(tmp_path / "run.mcap")
    assert len(jobs_of(open_log(tmp_path / "run.mcap"))) == 2  # to the path, and along it


def test_point_to_point_cut_short(tmp_path: Path) -> None:
    _, step, _ = load_scenario("point-to-point").scenario.drive
    assert isinstance(step, GoTo) and step.by == "loop"
    loaded = short("point-to-point", step.model_copy(update={"at_most_s": 4.0}))
    run(loaded, tmp_path / "run.mcap")
    assert set(same_again(tmp_path / "run.mcap")) == {JobState.MOVING, JobState.HELD}
    log = open_log(tmp_path / "run.mcap")
    scene, _ = reopened(log)
    goals = {one.inputs.job.goal.T_site_tool.tobytes() for one in replay(log, scene) if one.inputs.job is not None}  # type: ignore[union-attr]
    assert len(goals) == 1 and len(jobs_of(log)) == 1


def driven(session: Session, job_at: Callable[[int], Job | None], ticks: int) -> None:
    """Drive a session with a job at some ticks and levers at rest at the others."""
    for k in range(ticks):
        job = job_at(k)
        intent = session.intent(enable=k > 2) if job is None else session.intent(*AUTO)
        session.step(intent, job)


def test_a_job_let_go_and_taken_up_again_and_another_in_between(tmp_path: Path) -> None:
    loaded = short("ballast-removal")
    session = open_session(loaded)
    q, T = session.true_state
    pose = T @ session.machine.tool_pose(session.machine.forward(q))
    pose[:3, 3] += 0.4 * T[:3, 0]
    given = np.asfortranarray(pose)
    near = Job("near", goal=ToolGoal(given, Orientation.FULL))
    (motion,) = plan_joints(session.machine, q, q + np.array([0.2, 0.0, 0.1, 0.0, 0.0, 0.0]), Pace())
    turn = Job("turn", trajectory=motion.trajectory)

    def job_at(k: int) -> Job | None:
        if k == 40:
            given[:] = 0.0  # a job keeps the goal it was given
        return None if k < 10 or 60 <= k < 80 else turn if 110 <= k < 160 else near

    with recorded(session, tmp_path / "run.mcap", origin_of(loaded)):
        driven(session, job_at, 230)
    same_again(tmp_path / "run.mcap")
    assert jobs_of(open_log(tmp_path / "run.mcap")) == ["near", "turn", "near"]


@pytest.mark.prove
def test_a_way_round_planned_while_driving(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    step = GoTo.model_validate(
        {"do": "go_to", "by": "loop", "around": False, "goal": {"at_m": [4.4, 1.3, 1.0], "rpy_deg": [180, 0, 108]}}
    )
    loaded = short("ballast-removal", step.model_copy(update={"at_most_s": 16.0}), guard="barrier")
    planned = []
    really = Automatic.around_it

    def around_it(automatic: Automatic, *given: object) -> object:
        found = really(automatic, *given)  # type: ignore[arg-type]
        planned.append(found)
        return found

    monkeypatch.setattr(Automatic, "around_it", around_it)
    monkeypatch.setattr(Automatic, "_loop", lambda automatic, goal, step: stuck_job(automatic, goal, step))
    run(loaded, tmp_path / "run.mcap")
    assert len(planned) == 1 and not isinstance(planned[0], str), planned
    states = same_again(tmp_path / "run.mcap")
    assert JobState.STUCK in states and states[-1] in (JobState.DONE, JobState.MOVING)
    assert jobs_of(open_log(tmp_path / "run.mcap"))[-1].startswith("way round")


def stuck_job(automatic: Automatic, goal: ToolGoal, step: GoTo) -> Job:
    """Return a job to a goal in the adjacent track's envelope, where it is stuck."""
    T = np.array(goal.T_site_tool)
    stand = automatic._around().T_site_machine
    T[:3, 3] = (stand @ [4.0, 3.6, 1.0, 1.0])[:3]
    return Job("inside", goal=ToolGoal(T, Orientation.FREE), around=False)
