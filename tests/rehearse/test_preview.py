"""Previews: what the same drive does when it is run, without touching what is previewed."""

import dataclasses
from functools import cache
from typing import Literal

import numpy as np
import pytest

from workgauge.motion.job import Job, JobState
from workgauge.motion.planning import Pace, plan_goal, plan_joints
from workgauge.rehearse.auto_steps import FollowPath, GoTo
from workgauge.rehearse.automatic import Automatic, Planned
from workgauge.rehearse.preview_drive import preview_drive
from workgauge.rehearse.run import open_session, run_session
from workgauge.rehearse.scenario import Hold, Step
from workgauge.rehearse.scenario_file import LoadedScenario, load_scenario
from workgauge.rehearse.session import Session
from workgauge.values.arrays import frozen
from workgauge.values.measurements import DriveMode, Levers
from workgauge.values.tasks import Orientation, ToolGoal

HOLD = Hold(do="hold", for_s=0.5)
#: Down between the tracks, into the adjacent track's envelope, and out of it towards the machine.
DOWN = FollowPath.model_validate(
    {
        "do": "follow",
        "kind": "spline",
        "deviation_m": 0.8,
        "points": [
            {"at_m": [4.60, 1.30, 1.30], "rpy_deg": [180, 0, 105]},
            {"at_m": [4.30, 1.75, 0.70], "rpy_deg": [180, 0, 112]},
            {"at_m": [4.00, 1.30, 0.90], "rpy_deg": [180, 0, 108]},
        ],
    }
)
#: Beside the adjacent track's envelope.
BESIDE = GoTo.model_validate({"do": "go_to", "goal": {"at_m": [4.4, 1.3, 1.0], "rpy_deg": [180, 0, 108]}})


@cache
def drive(*steps: Step, joints: str = "ideal", guard: str = "barrier") -> LoadedScenario:
    chosen: Literal["ideal", "hydraulic"] = "hydraulic" if joints == "hydraulic" else "ideal"
    loaded = load_scenario("ballast-removal").choosing(guard=guard, joints=chosen)
    return dataclasses.replace(loaded, scenario=loaded.scenario.model_copy(update={"drive": steps}))


def to_goal(session: Session) -> list[Job]:
    """Return the jobs of a straight motion of the tool, 0.4 m forwards."""
    q, T = session.true_state
    pose = np.array(T @ session.machine.tool_pose(session.machine.forward(q)))
    pose[:3, 3] += 0.4 * T[:3, 0]
    motions = plan_goal(session.machine, T, q, ToolGoal(frozen(pose), Orientation.FULL), Pace())
    return [Job(f"goal {k}", trajectory=motion.trajectory) for k, motion in enumerate(motions)]


@pytest.mark.parametrize(("joints", "step"), [("hydraulic", DOWN), ("ideal", BESIDE)])
def test_a_run_comes_as_near_as_its_preview_said(joints: str, step: Step) -> None:
    session = open_session(drive(HOLD, step, HOLD, joints=joints))
    found = preview_drive(session, (HOLD, step, HOLD))
    (told,) = found.steps
    run = run_session(session, (HOLD, step, HOLD), "previewed")
    assert run.automatic is not None and run.min_clearance_m is not None and told.preview.nearest is not None
    limit, one = told.preview.nearest
    assert found.completed and run.automatic.completed
    assert limit == run.min_limit and one.link == run.min_link
    assert one.clearance_m == pytest.approx(run.min_clearance_m, abs=0.002)
    assert told.preview.duration_s == pytest.approx(run.automatic.driven_s, abs=0.1)
    assert told.preview.q[-1] == pytest.approx(session.true_state[0], abs=0.01)


def test_nothing_of_the_session_changes() -> None:
    plain, previewed = (open_session(drive(HOLD, DOWN, joints="hydraulic")) for _ in range(2))
    for k in range(60):
        if k % 20 == 10:
            before = previewed.true_state[0].copy()
            previewed.preview(to_goal(previewed)[:1], at_most_s=0.3)
            assert (previewed.true_state[0] == before).all() and previewed.t_s == plain.t_s
        frames = [
            session.step(session.intent(DriveMode.JOINT, Levers(left_x=0.6 if k > 5 else 0.0), enable=k > 2)).frame
            for session in (plain, previewed)
        ]
        assert frames[0] == frames[1]
    assert (plain.true_state[0] == previewed.true_state[0]).all()


def test_what_is_swept_is_what_is_looked_at() -> None:
    session = open_session(drive(HOLD, DOWN, guard="none"))
    machine, (q, T) = session.machine, session.true_state
    (told,) = preview_drive(session, (DOWN,)).steps
    seen = told.preview
    assert seen.completed and seen.nearest is not None and seen.nearest[1].clearance_m < 0.0  # nobody gives way
    assert (seen.q[0] == q).all()
    assert np.diff(seen.t) == pytest.approx(session.tick_s)
    speed = np.diff(seen.q, axis=0) / session.tick_s
    assert (speed <= machine.speed_positive + 1e-9).all() and (speed >= -machine.speed_negative - 1e-9).all()
    nearest = {}
    for row, tool in zip(seen.q[::25], seen.tool[::25], strict=True):
        kin = machine.forward(row)
        assert tool == pytest.approx((T @ machine.tool_pose(kin))[:3, 3])
        clearances = session.scene.query(kin, T, 2.0, 0, session.off_states, session.surroundings().let_off)
        for limit, metres in zip(clearances.limits.tolist(), clearances.distances.tolist(), strict=True):
            name = clearances.limit_ids[limit]
            nearest[name] = min(metres, nearest.get(name, np.inf))
    assert nearest
    for name, metres in nearest.items():
        assert seen.least[name].clearance_m <= metres + 1e-6
        assert seen.least[name].clearance_m >= metres - 0.25  # a quarter of a second at 1 m/s


def test_it_goes_on_from_the_middle_of_a_job() -> None:
    session = open_session(drive(HOLD, BESIDE))
    jobs = to_goal(session)
    whole = session.preview(jobs)
    session.step(session.intent(enable=False))
    session.step(session.intent())
    for _ in range(60):
        session.step(session.intent(DriveMode.AUTO, Levers(right_y=1.0)), jobs[0])
    rest = session.preview(jobs)
    assert whole.completed and rest.completed
    assert rest.duration_s == pytest.approx(whole.duration_s - 0.6, abs=0.05)
    assert rest.q[-1] == pytest.approx(whole.q[-1], abs=1e-3)


def test_a_goal_inside_a_limit_is_told_as_stuck() -> None:
    session = open_session(drive(HOLD, BESIDE))
    q, T = session.true_state
    pose = np.array(T @ session.machine.tool_pose(session.machine.forward(q)))
    pose[:3, 3] = (T @ [4.0, 3.6, 1.0, 1.0])[:3]
    found = session.preview([Job("inside", goal=ToolGoal(frozen(pose), Orientation.FREE), around=False)])
    assert not found.completed and found.state is JobState.STUCK
    assert "inside comes no nearer" in found.why and found.against
    assert found.nearest is not None and 0.19 < found.nearest[1].clearance_m < 0.3


def test_a_goal_that_is_stuck_is_planned_round_once(monkeypatch: pytest.MonkeyPatch) -> None:
    session = open_session(drive(HOLD, BESIDE))
    q, T = session.true_state
    pose = np.array(T @ session.machine.tool_pose(session.machine.forward(q)))
    pose[:3, 3] = (T @ [4.0, 3.6, 1.0, 1.0])[:3]
    stuck = Job("inside", goal=ToolGoal(frozen(pose), Orientation.FREE), around=False)
    asked: list[np.ndarray] = []

    def around_it(automatic: Automatic, step: GoTo, came: np.ndarray, T_site_machine: np.ndarray) -> Planned:
        asked.append(came[-1])
        (motion,) = plan_joints(session.machine, came[-1], q, Pace())
        return Planned((Job("back", trajectory=motion.trajectory),), q)

    monkeypatch.setattr(Automatic, "begun", lambda *_: Planned((stuck,), q))
    monkeypatch.setattr(Automatic, "around_it", around_it)
    (told,) = preview_drive(session, (HOLD, BESIDE)).steps
    seen = told.preview
    assert seen.completed and seen.state is JobState.DONE and not seen.why and len(asked) == 1
    assert any((row == asked[0]).all() for row in seen.q)
    assert np.diff(seen.t) == pytest.approx(session.tick_s) and len(seen.t) == len(seen.q) == len(seen.tool)
    assert seen.q[-1] == pytest.approx(q, abs=0.01)
    assert seen.nearest is not None and 0.19 < seen.nearest[1].clearance_m < 0.3 and seen.against

    monkeypatch.setattr(Automatic, "around_it", lambda *_: "nothing but walls")
    (told,) = preview_drive(session, (HOLD, BESIDE)).steps
    assert not told.preview.completed and told.preview.why.endswith("no way round: nothing but walls")


def test_too_slow_or_shut_out_is_not_completed() -> None:
    session = open_session(drive(HOLD, BESIDE))
    jobs = to_goal(session)
    slow = session.preview(jobs, at_most_s=0.5)
    assert not slow.completed and slow.duration_s == pytest.approx(0.5) and "within 0.5 s" in slow.why
    nothing = session.preview([])
    assert nothing.completed and nothing.duration_s == 0.0 and len(nothing.q) == 1
