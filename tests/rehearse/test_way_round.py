"""A goal behind a fence of poles, driven on hydraulic joints: stuck before it, planned round it, done or said why."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from workgauge import Session
from workgauge.motion.job import JobState
from workgauge.rehearse import automatic
from workgauge.rehearse.auto_steps import GoTo
from workgauge.rehearse.result import RunResult
from workgauge.rehearse.run import run_session
from workgauge.rehearse.scenario import Hold
from workgauge.site.model import PointFeature, SiteModel, SurfaceModel
from workgauge.values.arrays import frozen, frozen_ints
from workgauge.values.limits import Source

for _needed in ("ompl", "toppra"):
    pytest.importorskip(_needed, reason="the extra `plan` is not installed")

E0, N0 = 25_500_000.0, 6_700_000.0
HOLD, REST = Hold(do="hold", for_s=0.5), Hold(do="hold", for_s=1.6)


def poles(*places: tuple[float, float]) -> SiteModel:
    """Return a level field with poles, each so far away [m], at so many degrees to the left of straight ahead."""
    corners = [[E0 + x, N0 + y, 10.0] for x in (-50, 50) for y in (-50, 50)]
    ground = SurfaceModel(
        *("Ground", None, "ground", frozen(corners), frozen_ints([[0, 2, 3], [0, 3, 1]]), 10_000.0, {}),
        Source("f.xml", "Ground"),
    )
    stand = PointFeature("P", None, "Pole", frozen([E0, N0, 10.0]), (), Source("f.xml", "P"))
    points = []
    for k, (away, left_deg) in enumerate(places, 1):
        left = math.radians(left_deg)
        place = frozen([E0 - away * math.sin(left), N0 + away * math.cos(left), 10.0])
        points.append(replace(stand, name=f"P{k}", position=place))
    return SiteModel(crs=None, crs_declared={}, units={}, surfaces=(ground,), points=tuple(points), files=("f.xml",))


def driven(site: SiteModel, goal: tuple[float, float, float]) -> tuple[RunResult, Session]:
    session = Session(
        *(site, "rre20"),
        guard="barrier",
        guard_parameters={"stop_distance_m": 0.2},
        at=(E0, N0, 0.0),
        joints="hydraulic",
        tick_s=0.02,
    )
    step = GoTo.model_validate({"do": "go_to", "goal": {"at_m": goal}, "tolerance_mm": 50})
    return run_session(session, (HOLD, step, REST), "behind a fence"), session


CAGE = [(away, left) for away in (3.0, 3.8, 4.6, 5.4, 6.2, 7.0, 7.8) for left in (45.0, 135.0)]
FENCE = [(away, 45.0) for away in (4.0, 5.0, 6.0, 7.0)]


def test_stuck_before_a_fence_it_goes_round_by_a_plan_and_is_done() -> None:
    goal = (0.0, 6.0, 1.0)
    run, session = driven(poles(*FENCE), goal)
    assert run.entries == () and run.self_entries == ()
    assert run.min_clearance_m is not None and run.min_clearance_m > 0.0
    assert any("the straight way is not free" in said and "Pole" in said for said in run.warnings)
    assert run.automatic is not None and run.automatic.completed
    first, *others = run.automatic.jobs
    assert first.job.startswith("goal") and first.state is JobState.STUCK
    stuck = [one for one in run.interventions if one.reason == "stuck"]
    assert stuck and stuck[0].limit is not None and stuck[0].limit.startswith("point:P")
    assert "comes no nearer" in stuck[0].text
    assert others and all(job.job.startswith("way round") and job.state is JobState.DONE for job in others)
    assert not any("no way round" in said for said in run.warnings)
    T = session.true_state[1]
    assert np.linalg.norm(T[:3, :3].T @ (session.tool - T[:3, 3]) - goal) < 0.06
    assert np.ptp(np.unwrap(run.series.q[:, 0])) > math.pi  # the other way round


@pytest.mark.prove
def test_what_cannot_be_solved_is_said_to_be_so_and_the_machine_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(automatic, "PLAN_SECONDS", 2.0)
    run, session = driven(poles(*CAGE), (0.0, 6.0, 1.0))
    assert run.entries == () and run.self_entries == ()
    assert run.automatic is not None and not run.automatic.completed
    (only,) = run.automatic.jobs
    assert only.state is JobState.STUCK
    (said,) = [one for one in run.warnings if "no way round was found" in one]
    assert said.startswith("step 2: no way round was found: no way found within 2 s; that is no proof")
    last = run.series.t_s > only.ended_s + 1.0
    assert last.sum() > 20 and np.ptp(run.series.q[last], axis=0).max() < 1e-4
    assert not run.series.allowed[last].any()
    assert_none_passes(session)


def assert_none_passes(session: Session) -> None:
    """Check that no posture in either fence's direction is clear of all, so that there is indeed no way."""
    machine, scene, T = session.machine, session.scene, session.true_state[1]
    bounds = zip(machine.sample_min[1:4], machine.sample_max[1:4], strict=True)
    for arm in itertools.product(*(np.linspace(low, high, 8) for low, high in bounds)):
        for left in (45.0, 135.0):
            q = np.array([math.radians(left), *arm, 0.0, 0.0])
            found = scene.query_apart(machine.forward(q), T, 0.3)
            assert found is None or (found.distances < 0.2).any(), np.degrees(q)
