"""Sessions: what a run shows is true, repeatable, and an entry is noticed when the guard is asleep."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from workgauge import Session
from workgauge.gauge.build import LimitSet
from workgauge.guard.api import GuardInput, GuardResult, Memory
from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.rehearse.result import RunResult
from workgauge.rehearse.run import default_drive, open_session, run_scenario, run_session
from workgauge.rehearse.scenario import OnTrack
from workgauge.rehearse.scenario_file import load_scenario
from workgauge.rehearse.shipped import shipped_path
from workgauge.rehearse.truth import GeometricTruth
from workgauge.site.model import PointFeature, SiteModel, SurfaceModel
from workgauge.values.arrays import Floats, frozen, frozen_ints
from workgauge.values.commands import VALVE_FULL
from workgauge.values.errors import InputError, ScenarioError
from workgauge.values.limits import Activity, Limit, LimitKind, Source
from workgauge.values.measurements import DriveMode, Levers
from workgauge.values.reasons import ReasonCode
from workgauge.values.solids import Box
from workgauge.values.transforms import translation
from workgauge.wire.messages import decode_command

E0, N0 = 25_500_000.0, 6_700_000.0


def field(east: float = 0.0, north: float = 7.0) -> SiteModel:
    """Return a level field with one pole at (east, north) of the machine."""
    corners = [[E0 + x, N0 + y, 10.0] for x in (-50, 50) for y in (-50, 50)]
    ground = SurfaceModel(
        "Ground",
        None,
        "ground",
        frozen(corners),
        frozen_ints([[0, 2, 3], [0, 3, 1]]),
        10_000.0,
        {},
        Source("f.xml", "Ground"),
    )
    place = frozen([E0 + east, N0 + north, 10.0])
    pole = PointFeature("P1", None, "Pole", place, (), Source("f.xml", "P1"))
    return SiteModel(crs=None, crs_declared={}, units={}, surfaces=(ground,), points=(pole,), files=("f.xml",))


@dataclass(frozen=True)
class Asleep:
    """A guard that lets everything through."""

    name: str = "asleep"
    reach_m: float = 0.0
    steers_itself: bool = False

    def start(self) -> Memory:
        return {}

    def allow(self, given: GuardInput, memory: Memory) -> tuple[GuardResult, Mapping[str, float]]:
        return GuardResult(given.desired, (), 1.0), {}

    def idle(
        self, sent: Floats | None, machine: MachineModel, dt_s: float, elapsed_s: float, memory: Memory
    ) -> Memory:
        return {}


@pytest.fixture(scope="module")
def pole_approach() -> RunResult:
    return run_scenario(load_scenario("pole-approach"))


def times(run: RunResult) -> dict[str, float]:
    """Return when the steps of pole-approach begin."""
    return {words: start for words, start in run.steps if words != "hold"}


def test_clearance_never_falls_below_the_stop_distance_and_settles_at_it(pole_approach: RunResult) -> None:
    run = pole_approach
    assert run.stop_distance_m == 0.2 and run.slow_distance_m == 0.8
    assert run.min_clearance_m is not None
    assert 0.20 <= run.min_clearance_m <= 0.22
    assert run.series.true_m.min() >= 0.20
    stopped = run.series.t_s[:] < times(run)["back"]
    assert run.series.true_m[stopped][-1] == pytest.approx(0.20, abs=0.02)
    assert run.entries == () and run.self_entries == ()


def test_the_pole_and_nothing_else_intervenes(pole_approach: RunResult) -> None:
    (only,) = pole_approach.interventions
    assert (only.limit, only.reason) == ("point:P1-12", "limit_near")
    assert only.scale is not None and only.scale < 0.05
    assert pole_approach.min_limit == "point:P1-12"


def test_it_starts_at_one_second_and_speeds_fall_linearly_with_the_clearance(pole_approach: RunResult) -> None:
    series = pole_approach.series
    assert not series.allowed[series.t_s < 1.0].any()
    assert series.allowed[series.t_s >= 1.05][0].any()
    near = (series.believed_m < 0.8) & (series.t_s > 1.3) & (series.t_s < times(pole_approach)["back"] - 0.6)
    assert near.sum() > 100
    assert series.scale[near] == pytest.approx((series.believed_m[near] - 0.2) / 0.6, abs=1e-9)
    assert np.abs(series.allowed[near] - series.scale[near, None] * series.wanted[near]).max() < 1e-12


def test_the_way_back_is_unhindered_and_ends_where_it_began(pole_approach: RunResult) -> None:
    series = pole_approach.series
    back = series.t_s >= times(pole_approach)["back"]
    assert (series.scale[back] == 1.0).all()
    assert (series.allowed[back] == series.wanted[back]).all()
    assert np.linalg.norm(series.tool[-1] - series.tool[0]) < 0.005
    assert np.degrees(np.abs(series.q[-1] - series.q[0])).max() < 0.5


def test_the_tool_keeps_to_the_straight_line(pole_approach: RunResult) -> None:
    tool = pole_approach.series.tool
    far = tool[np.argmax(np.linalg.norm(tool - tool[0], axis=1))]
    along = (far - tool[0]) / np.linalg.norm(far - tool[0])
    off = (tool - tool[0]) - np.outer((tool - tool[0]) @ along, along)
    assert np.linalg.norm(off, axis=1).max() < 0.005


def test_two_runs_are_the_same_valve_by_valve(pole_approach: RunResult) -> None:
    loaded = load_scenario("pole-approach")
    line = loaded.scenario.drive[1].model_copy(update={"stopped_for_s": None, "for_s": 3.0})
    again = run_session(open_session(loaded), (loaded.scenario.drive[0], line), "again")
    n = len(again.series)
    assert n == 400
    assert (again.series.valves == pole_approach.series.valves[:n]).all()
    assert (again.series.q == pole_approach.series.q[:n]).all()
    assert (again.series.true_m == pole_approach.series.true_m[:n]).all()


@pytest.mark.prove
def test_two_whole_runs_are_the_same(pole_approach: RunResult) -> None:
    again = run_scenario(load_scenario("pole-approach"))
    assert (again.series.valves == pole_approach.series.valves).all()
    assert again.interventions == pole_approach.interventions
    assert {**again.as_json(), "tick_ms": 0} == {**pole_approach.as_json(), "tick_ms": 0}


def test_true_clearance_at_the_nearest_moment_by_another_way(pole_approach: RunResult) -> None:
    """Both solids' points at the reported distance, found by alternating projection, not by the scene's own code."""
    near = pole_approach.nearest
    pole = next(limit for limit in pole_approach.limits if limit.id == "point:P1-12")
    box = near.names.index("attachment")
    T, half = near.T_site_boxes[box], near.half_extents[box]
    assert not isinstance(pole.solid, Box)
    corners = np.asarray(pole.solid.vertices)  # type: ignore[union-attr]
    middle, low, high = corners[:, :2].mean(axis=0), corners[:, 2].min(), corners[:, 2].max()
    radius = np.linalg.norm(corners[:, :2] - middle, axis=1)
    on_box = T[:3, 3]
    for _ in range(4000):
        away = on_box[:2] - middle
        on_axis = np.array(
            [*(middle + away * min(1.0, radius.max() / np.linalg.norm(away))), np.clip(on_box[2], low, high)]
        )
        on_box = T[:3, 3] + T[:3, :3] @ np.clip(T[:3, :3].T @ (on_axis - T[:3, 3]), -half, half)
    # the limit is a prism that encloses the cylinder of its rule, so corners lie on the larger circle
    distance = float(np.linalg.norm(on_box - on_axis))
    sagitta = radius.max() * (1 - math.cos(math.pi / (len(corners) / 2)))
    assert near.clearance_m is not None
    assert distance - 1e-6 <= near.clearance_m <= distance + sagitta + 1e-6


def test_an_unguarded_run_enters_and_says_so() -> None:
    scenario = load_scenario("pole-approach")
    session = open_session(scenario)
    careless = Session(
        session.site,
        session.machine,
        session.rules,
        Asleep(),
        OnTrack(alignment="Track 1", distance_m=573.0),
        posture={"swing": math.radians(-104), "boom": math.radians(20), "stick": math.radians(-104)}
        | {"bucket": math.radians(-77)},
    )
    run = run_session(careless, scenario.scenario.drive[:2], "careless")
    assert [entry.limit for entry in run.entries] == ["point:P1-12"]
    (entry,) = run.entries
    assert run.min_clearance_m is not None and run.min_clearance_m < -0.05
    assert entry.depth_m == pytest.approx(-run.min_clearance_m)
    inside = run.series.t_s[run.series.true_m < 0]
    assert entry.start_s == pytest.approx(inside[0], abs=0.011)
    assert run.as_json()["entries"] == 1


def test_nobody_there_nothing_moves() -> None:
    session = Session(field(), at=(E0, N0, 0.0))
    before = session.true_state[0]
    for _ in range(20):
        done = session.step()
        assert ReasonCode.NO_INTENT in {reason.code for reason in done.trace.reasons}
        assert decode_command(done.frame, 0).value.neutral
    assert (session.true_state[0] == before).all()


def test_levers_move_the_joint_only_after_the_switch_was_pressed_on_neutral() -> None:
    session = Session(field(), at=(E0, N0, 0.0))
    pushed = Levers(left_x=-1.0)
    for enable, levers in ((True, pushed), (False, pushed)):
        for _ in range(5):
            session.step(session.intent(DriveMode.JOINT, levers, enable=enable))
    assert (session.true_state[0] == session.machine.forward(session.true_state[0]).q).all()
    before = session.true_state[0]
    session.step(session.intent(enable=False))
    session.step(session.intent())
    for _ in range(30):
        done = session.step(session.intent(DriveMode.JOINT, pushed))
    moved = session.true_state[0] - before
    assert moved[0] > 0.05 and not moved[1:].any()
    assert max(map(abs, decode_command(done.frame, 0).value.valves)) <= VALVE_FULL


@pytest.mark.parametrize(
    "bearing", [135.0, *(pytest.param(b, marks=pytest.mark.prove) for b in (10.0, 70.0, 200.0, 260.0, 320.0))]
)
def test_the_default_drive_is_stopped_by_a_pole_anywhere_around(bearing: float) -> None:
    angle = math.radians(bearing)
    session = Session(field(6.3 * math.sin(angle), 6.3 * math.cos(angle)), at=(E0, N0, 77.0))
    run = run_session(session, default_drive(), "around")
    assert run.entries == () and run.self_entries == ()
    assert run.min_limit == "point:P1"
    assert run.min_clearance_m is not None and 0.2 <= run.min_clearance_m <= 0.22
    assert any(cause.limit == "point:P1" and (cause.scale or 0) < 0.05 for cause in run.interventions)


def test_a_start_inside_a_limit_is_refused_with_limit_and_link() -> None:
    with pytest.raises(ScenarioError, match=r"starts inside .*P1.* m deep"):
        Session(field(0.0, 1.0), at=(E0, N0, 0.0))


def test_bad_arguments_are_input_errors() -> None:
    for change in (
        {"guard": "wishful"},
        {"machine": "no-such"},
        {"rules": "no-such"},
        {"posture": {"elbow": 1.0}},
        {"posture": {"boom": 9.0}},
        {"guard_parameters": {"softness": 1.0}},
        {"guard_parameters": {"slow_distance_m": 0.1}},
        {"at": (E0, N0, math.nan)},
        {"at": (E0 + 1e4, N0, 0.0)},
    ):
        arguments: dict[str, object] = {"site": field(), "at": (E0, N0, 0.0), **change}
        with pytest.raises(InputError):
            Session(**arguments)  # type: ignore[arg-type]


def arm_box() -> tuple[GeometricTruth, Floats, Floats, LimitSet | None]:
    """Return truth for a machine with a limit over its tool that counts from 1 s on."""
    machine = load_machine("rre20")
    tool = machine.tool_pose(machine.forward(machine.home))[:3, 3]
    box = Box(translation(*tool), frozen([0.2, 0.2, 0.2]))
    limit = Limit("zone:late", LimitKind.ZONE, "late", box, "by hand", Source("t", "late"))
    late = replace(limit, activity=Activity(not_before_ns=1_000_000_000))
    return GeometricTruth(machine, [late], 5.0), np.array(machine.home), np.eye(4), None


def test_a_limit_that_becomes_active_over_the_machine_is_no_entry_until_it_goes_back_in() -> None:
    truth, q, T, _ = arm_box()
    away = q + np.array([0.6, 0, 0, 0, 0, 0])
    for ns, posture in ((0, q), (500_000_000, q), (1_000_000_000, q), (1_100_000_000, q)):
        truth.check(ns, posture, T)
    assert truth.nearest is not None and truth.nearest.limit is not None and truth.nearest.limit.distance_m < 0
    truth.check(1_200_000_000, away, T)
    assert truth.entries() == ()
    truth.check(1_300_000_000, q, T)
    truth.check(1_400_000_000, q, T)
    truth.check(1_500_000_000, away, T)
    (entry,) = truth.entries()
    assert (entry.limit, entry.start_s, entry.end_s) == ("zone:late", pytest.approx(1.3), pytest.approx(1.4))


def test_a_machine_may_have_a_long_name() -> None:
    machine = replace(load_machine("rre20"), name="päällirakennekone, number 4711 of the northern yard")
    session = Session(site=field(), machine=machine, at=(E0, N0, 0.0))
    session.step(session.intent(enable=False))
    session.step(session.intent())
    assert any(session.step(session.intent(levers=Levers(left_x=-1.0))).trace.valves)


def test_a_limit_with_a_long_stop_distance_is_seen_in_time(tmp_path: Path) -> None:
    text = shipped_path("rules", "generic.yaml").read_text(encoding="utf-8")
    changed = re.sub(r"(make: cylinder\n)( +)", r"\1\2stop_distance_m: 9.0\n\2", text)
    assert changed != text
    rules = tmp_path / "far.yaml"
    rules.write_text(changed, encoding="utf-8")
    session = Session(site=field(0.0, 14.0), rules=rules, at=(E0, N0, 0.0), posture={"swing": 1.4})
    session.step(session.intent(enable=False))
    session.step(session.intent())
    steps = [session.step(session.intent(levers=Levers(left_x=1.0))) for _ in range(300)]
    assert ReasonCode.LIMIT_NEAR in {reason.code for step in steps for reason in step.trace.reasons if reason.limit}
    assert min(step.truth.by_limit.get("point:P1", math.inf) for step in steps) > 8.99


@pytest.mark.parametrize(("key", "unit"), [("posture_m", "degrees"), ("posture_deg", "degrees")])
def test_a_posture_in_the_wrong_unit_or_twice_is_refused(key: str, unit: str, tmp_path: Path) -> None:
    text = shipped_path("scenarios", "pole-approach.yaml").read_text(encoding="utf-8")
    twice = "  posture_m: {tilt: 0.5}\n"
    changed = text.replace("tilt: 0, ", "") if key == "posture_m" else text
    file = tmp_path / "mixed.yaml"
    file.write_text(changed.replace("joints: ideal", twice + "joints: ideal"), encoding="utf-8")
    with pytest.raises(ScenarioError, match=f"joint tilt is revolute.*{unit}"):
        open_session(load_scenario(file))


def test_a_limit_switched_on_around_the_machine_by_its_state_is_no_entry() -> None:
    state = "Track 2 open to traffic"
    solid = Box(frozen(translation(6.0, 0.0, 2.0)), frozen([3.0, 3.0, 3.0]))
    limit = Limit("t", LimitKind.TRACK, "Track 2", solid, "r", Source("f", "t"), activity=Activity(state=state))
    machine = load_machine("rre20")
    truth = GeometricTruth(machine, [limit], 5.0)
    truth.check(0, machine.home, np.eye(4), frozenset({state}))
    truth.check(1, machine.home, np.eye(4), frozenset())
    assert truth.entries() == ()


def test_a_place_on_no_map_is_refused() -> None:
    with pytest.raises(ScenarioError, match="no map has such a place"):
        Session(site=field(), at=(1e300, 0.0, 0.0))
