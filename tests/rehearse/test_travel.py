"""Travel of a session: stopped in time and with the gate; states switched; sensors held to the truth."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge import Session
from workgauge.guard.travel import Brakes
from workgauge.machine.load import load_machine
from workgauge.proximity.scene import Scene
from workgauge.rehearse.result import RunResult
from workgauge.rehearse.run import open_session, run_scenario, run_session
from workgauge.rehearse.scenario import Hold, OnGround, OnTrack, StateChange, TravelStep, WaitForTravel
from workgauge.rehearse.scenario_file import load_scenario
from workgauge.rehearse.sensing import SensorChoice, Silence
from workgauge.rehearse.travelling import Driver
from workgauge.site.alignment import Alignment
from workgauge.site.model import PointFeature, SiteModel, SurfaceModel
from workgauge.site.plan import PlanElement, PlanGeometry
from workgauge.site.profile import VerticalPoint, build_profile
from workgauge.site.transitions import Law
from workgauge.values.arrays import frozen, frozen_ints
from workgauge.values.errors import ScenarioError
from workgauge.values.limits import Limit, LimitKind, Source
from workgauge.values.solids import Box
from workgauge.values.transforms import translation

ARM = {"swing": math.radians(7), "boom": math.radians(16), "stick": math.radians(-40), "bucket": math.radians(-115)}
HOLD = Hold(do="hold", for_s=0.2)
WAIT = WaitForTravel(do="wait_for_travel", at_most_s=40)


def on_rails(distance_m: float = 500.0, **more) -> Session:
    return Session(at=OnTrack(alignment="Track 1", distance_m=distance_m), posture=ARM, **more)


def held_to_the_truth(run: RunResult) -> None:
    """What every run on simulated sensors must show."""
    assert run.position is not None
    share = run.position.share[np.isfinite(run.position.protection_m)]
    assert len(share) > 100 and np.nanmax(run.position.share) < 1.0
    assert run.position.as_json(run.tick_s)["ticks_beyond_protection"] == 0
    believed = np.isfinite(run.position.believed_m)
    error = np.abs(run.position.believed_m - run.position.true_m)[believed]
    assert (error <= run.position.protection_m[believed]).all() and (run.position.protection_m[believed] > 0).all()
    assert run.entries == () and run.self_entries == ()
    assert run.min_clearance_m is not None and run.min_clearance_m > 0.2


@pytest.fixture(scope="module")
def short() -> RunResult:
    """The travel scenario's beginning: 12 m, the arm turned towards the open track meanwhile."""
    loaded = load_scenario("travel")
    leg = loaded.scenario.travel[0].model_copy(update={"distance_m": 12.0})
    steps = (*loaded.scenario.drive[:3], WAIT)
    return run_session(open_session(loaded), steps, "short", travel=(leg,))


def test_what_is_believed_holds_against_the_truth_at_every_tick(short: RunResult) -> None:
    held_to_the_truth(short)
    assert short.position is not None and short.travel is not None
    assert short.position.seconds(short.tick_s)["fixed"] > 5.0
    assert short.travel.travelled_m[-1] == pytest.approx(12.0, abs=0.02)
    assert short.travel.tracks() == ((0, "Track 1"),)
    assert any(cause.limit == "track:Track 2" for cause in short.interventions)


def test_the_assumptions_say_what_was_run(short: RunResult) -> None:
    said = " ".join(short.assumptions)
    assert "Sensors are perfect" not in said and "stands still" not in said
    assert "down to the bytes" in said and "travels as its driver wants" in said
    assert "noise datasheet" in short.facts["sensors"]


def test_json_has_the_facts_of_both(short: RunResult) -> None:
    data = short.as_json()
    assert data["positioning"]["worst_error_over_protection"] < 1.0
    assert data["positioning"]["seconds_in_state"]["fixed"] > 5.0
    assert data["travel"]["own_tracks"] == [{"t_s": 0.0, "track": "Track 1"}]


def test_two_runs_on_sensors_are_the_same_byte_by_byte() -> None:
    def frames() -> bytes:
        session = on_rails(sensors=SensorChoice(seed=3), tick_s=0.02)
        sent = b""
        for k in range(90):
            session.travel(1.0 if k > 50 else 0.0)
            done = session.step(session.intent(enable=session.ready and k > 40))
            sent += done.frame + (b"" if done.known.pose is None else done.known.pose.T_site_machine.tobytes())
        return sent

    assert frames() == frames()


@pytest.mark.prove
def test_the_whole_scenario_three_hundred_metres() -> None:
    run = run_scenario(load_scenario("travel"))
    held_to_the_truth(run)
    assert run.travel is not None and run.travel.travelled_m[-1] == pytest.approx(300.0, abs=0.02)


def ride(session: Session, speed: float, ticks: int, enable=lambda k: k > 2):
    out = []
    for k in range(ticks):
        session.travel(speed)
        out.append(session.step(session.intent(enable=enable(k))))
    return out


def test_a_gate_that_closes_stops_the_travel() -> None:
    session = on_rails(tick_s=0.05)
    done = ride(session, 1.0, 80, enable=lambda k: 2 < k < 40)
    assert done[0].travel.allowed_m_s == 0.0, "the gate is closed at first"
    assert done[39].travel.speed_m_s == pytest.approx(1.0)
    assert done[41].travel.allowed_m_s == 0.0
    assert done[-1].travel.speed_m_s == 0.0


def test_nobody_there_no_travel() -> None:
    session = on_rails(tick_s=0.05)
    ride(session, 1.0, 40)
    assert session.step(None).travel.allowed_m_s == 0.0


def test_a_position_that_is_lost_stops_the_travel() -> None:
    fault = Silence(do="silence", from_s=3.0)
    session = on_rails(tick_s=0.05, sensors=SensorChoice(), faults=(fault,))
    done = []
    for k in range(160):
        session.travel(1.0)
        done.append(session.step(session.intent(enable=(session.ready and k > 15) or k > 25)))
    fast = [one.travel.speed_m_s for one in done if one.t_s < 3.0]
    assert max(fast) == pytest.approx(1.0)
    assert done[-1].known.health is not None and done[-1].known.health.state != "fixed"
    assert done[-1].travel.allowed_m_s == 0.0 and done[-1].travel.speed_m_s == 0.0


E0, N0 = 25_500_000.0, 6_700_000.0


def field(*poles: tuple[float, float]) -> SiteModel:
    """Return a level field with poles at (east, north) of its middle."""
    corners = [[E0 + x, N0 + y, 10.0] for x in (-200, 200) for y in (-200, 200)]
    ground = SurfaceModel(
        "G", None, "ground", frozen(corners), frozen_ints([[0, 2, 3], [0, 3, 1]]), 1.0, {}, Source("f.xml", "G")
    )
    points = tuple(
        PointFeature(f"P{i}", None, "Pole", frozen([E0 + e, N0 + n, 10.0]), (), Source("f.xml", f"P{i}"))
        for i, (e, n) in enumerate(poles)
    )
    return SiteModel(crs=None, crs_declared={}, units={}, surfaces=(ground,), points=points, files=("f.xml",))


@settings(max_examples=4, deadline=None)
@given(st.floats(-2.0, 2.0), st.floats(-0.04, 0.04), st.floats(1.0, 3.0))
def test_over_the_ground_it_stops_before_poles(aside: float, curvature: float, speed: float) -> None:
    site = field((aside, 22.0), (aside - 6.0, 16.0))
    at = OnGround(east_m=E0, north_m=N0, heading_deg=0.0)
    session = Session(site, rules="finland", at=at, posture={}, tick_s=0.05, brakes=Brakes(1.0, 0.2))
    least = math.inf
    for k in range(220):
        session.travel(speed, curvature)
        done = session.step(session.intent(enable=k > 2))
        found = done.truth.found
        poles = [found.limit_ids[i].startswith("point:") for i in found.limits]
        least = min(least, float(found.distances[poles].min(initial=math.inf)))
    assert least >= 0.2 - 1e-6 and session.truth.entries() == ()


def test_states_are_switched_live_and_unknown_ones_refused() -> None:
    session = on_rails(tick_s=0.05)
    state = "Track 2 open to traffic"

    def sees() -> bool:
        done = session.step(session.intent())
        assert done.trace.clearances is not None
        believed = {done.trace.clearances.limit_ids[i] for i in done.trace.clearances.limits}
        assert ("track:Track 2" in believed) == ("track:Track 2" in done.truth.by_limit)
        return "track:Track 2" in believed

    assert sees()
    session.set_state(state, on=False)
    assert not sees() and not sees()
    session.set_state(state, on=True)
    assert sees()
    with pytest.raises(ScenarioError, match="'Track 1 open to traffic', 'Track 2 open to traffic'"):
        session.set_state("Track 3 open to traffic", on=False)


def test_a_scenario_switches_states_when_it_says() -> None:
    changes = (
        StateChange(at_s=0.3, state="Track 2 open to traffic", on=True),
        StateChange(at_s=0.1, state="Track 2 open to traffic", on=False),
    )
    run = run_session(on_rails(tick_s=0.05), (HOLD, Hold(do="hold", for_s=0.3)), "t", states=changes)
    near = run.series.by_limit["track:Track 2"]
    assert np.isfinite(near).tolist() == [True] * 2 + [False] * 4 + [True] * 4
    assert any("switched by the scenario" in sentence for sentence in run.assumptions)
    with pytest.raises(ScenarioError, match="no limit depends on such a state"):
        run_session(on_rails(), (HOLD,), "t", states=(StateChange(state="Track 9", on=False),))


def rails(*tracks: tuple[str, float, float, float]) -> SiteModel:
    """Return straight level tracks: name, first and last east [m] (backwards if first is the larger), north."""
    made = []
    for name, first, last, north in tracks:
        yaw = 0.0 if last > first else math.pi
        element = PlanElement("line", Law.CONSTANT, (first, north), yaw, abs(last - first), 0.0, 0.0)
        made.append(
            Alignment(
                name=name,
                source=Source("t.xml", name),
                plan=PlanGeometry((E0, N0), [element]),
                profile=build_profile([VerticalPoint(0.0, 10.0), VerticalPoint(1e3, 10.0)]),
            )
        )
    return SiteModel(crs=None, crs_declared={}, units={}, alignments=tuple(made), files=("t.xml",))


@pytest.mark.parametrize("second", [("Track B", 50.0, 120.0, 0.0), ("Track B", 120.0, 50.0, 0.0)])
def test_rails_go_on_where_alignments_join_and_the_own_track_with_them(second) -> None:
    """Also where the second is drawn the other way round; and it stops where the rails end."""
    site = rails(("Track A", 0.0, 50.0, 0.0), second, ("Track C", 0.0, 120.0, 8.0))
    at = OnTrack(alignment="Track A", distance_m=40.0)
    session = Session(site, rules="finland", at=at, posture=ARM, tick_s=0.05)
    first = session.true_state[1]
    done = ride(session, 3.0, 700)
    moved = session.true_state[1][:3, 3] - first[:3, 3]
    assert moved == pytest.approx([80.0, 0.0, 0.0], abs=0.02), "120 m is where the rails end"
    assert session.true_state[1][:3, 0] == pytest.approx(first[:3, 0], abs=1e-9), "still facing the same way"
    owns = [one.tracks.own for one in done]
    assert owns[0] == "Track A" and owns[-1] == "Track B"
    assert sum(a != b for a, b in itertools.pairwise(owns)) == 1
    assert session.truth.entries() == ()
    assert {track for one in done for track in one.tracks.let_off} == {"Track A", "Track B"}


def test_fifty_kilometres_on_nothing_is_lost() -> None:
    """The frame stays where the machine started; a clearance 50 km from there is the same to a nanometre or so."""
    machine = load_machine("rre20")
    kin = machine.forward(machine.home)
    box = Limit(
        "b", LimitKind.ZONE, "b", Box(translation(5.0, 9.0, 1.0), frozen([1.0, 1.0, 2.0])), "r", Source("f", "b")
    )
    far = translation(50_000.0, -30_000.0, 40.0)
    moved = replace(box, solid=Box(far @ box.solid.T_frame_box, box.solid.half_extents))
    near = Scene(machine, [box]).query(kin, np.eye(4), 12.0)
    there = Scene(machine, [moved]).query(kin, far, 12.0)
    assert len(near) == len(there) > 0
    assert there.distances == pytest.approx(near.distances, abs=1e-8)


@given(st.floats(-300, 300).filter(lambda d: abs(d) > 0.05), st.floats(0.2, 8.0))
@settings(max_examples=40, deadline=None)
def test_the_driver_ends_where_the_leg_does(distance: float, speed: float) -> None:
    brakes = Brakes(1.0, 0.0)
    driver = Driver([TravelStep(distance_m=distance, speed_m_s=speed)], None, 1.0, brakes)
    way = now = t = 0.0
    while not driver.over and t < 2000.0:
        wanted, _ = driver.wants(t, way, now)
        assert abs(wanted) <= speed
        now += max(-0.05, min(0.05, wanted - now))  # 1 m/s^2
        way += now * 0.05
        t += 0.05
    assert driver.over and way == pytest.approx(distance, abs=0.06)


def test_legs_follow_each_other_and_their_times() -> None:
    steps = [TravelStep(to_m=120.0, speed_m_s=2.0), TravelStep(from_s=30.0, distance_m=-5.0, speed_m_s=1.0)]
    driver = Driver(steps, 100.0, -1.0, Brakes())
    assert driver.wants(0.0, 0.0, 0.0)[0] < 0, "facing backwards, growing distances lie behind"
    assert driver.wants(20.0, -20.0, 0.0) == (0.0, 0.0)
    assert driver.wants(29.0, -20.0, 0.0) == (0.0, 0.0) and not driver.over
    assert driver.wants(30.0, -20.0, 0.0)[0] < 0
    driver.wants(40.0, -25.0, 0.0)
    assert driver.over
    with pytest.raises(ScenarioError, match="no rails"):
        Driver(steps, None, 1.0, Brakes())


def test_through_a_switch_onto_the_branch_without_an_entry() -> None:
    """The main line is let off while the undercarriage fouls it, and counts as an adjacent track from there on."""

    def track(name: str, *parts: tuple[float, float]) -> Alignment:
        at, yaw, elements = (0.0, 0.0), 0.0, []
        for length, k in parts:
            elements.append(PlanElement("curve" if k else "line", Law.CONSTANT, at, yaw, length, k, k))
            at, yaw = elements[-1].end(), elements[-1].end_yaw()
        profile = build_profile([VerticalPoint(0.0, 10.0), VerticalPoint(1e3, 10.0)])
        return Alignment(
            name=name, source=Source("t.xml", name), plan=PlanGeometry((E0, N0), elements), profile=profile
        )

    tracks = track("Track Main", (300.0, 0.0)), track("Track Branch", (60.0, 0.0), (90.0, 1 / 300), (60.0, 0.0))
    site = SiteModel(crs=None, crs_declared={}, units={}, alignments=tracks, files=("t.xml",))
    at = OnTrack(alignment="Track Branch", distance_m=60.0)
    session = Session(site, rules="finland", at=at, posture={**ARM, "swing": 0.0}, tick_s=0.1)
    done = ride(session, 3.0, 260)
    let_off = [one.tracks.let_off for one in done]
    assert let_off[0] == {"Track Main", "Track Branch"} and let_off[-1] == {"Track Branch"}
    assert sum(a != b for a, b in itertools.pairwise(let_off)) == 1
    assert session.true_travel[1] > 60.0 and session.truth.entries() == ()
    seen = done[-1].truth.by_limit
    assert "track:Track Branch" not in seen


GOOD = """
title: t
site: {shipped: double_track}
machine: rre20
start: {on_track: {alignment: Track 1, distance_m: 500}, posture_deg: {boom: 16, stick: -40, bucket: -115}}
drive:
  - {do: hold, for_s: 0.2}
"""


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("  - {do: wait_for_travel}", "wait_for_travel` needs a `travel`"),
        ("travel:\n  - {distance_m: 1, to_m: 2, speed_m_s: 1}", "s.yaml:9: travel.0"),
        ("travel:\n  - {distance_m: 0, speed_m_s: 1}", "must not be zero"),
        ("travel:\n  - {distance_m: 5, speed_m_s: 0}", "s.yaml:9: travel.0.speed_m_s"),
        ("travel:\n  - {distance_m: 5, speed_m_s: 1, radius_m: 0.1}", "at least 1 m"),
        ("brakes: {deceleration_m_s2: 0}", "s.yaml:8: brakes.deceleration_m_s2"),
        ("states:\n  - {at_s: 0, state: '', on: true}", "s.yaml:9: states.0.state"),
        ("start_utc: 2026-03-02T08:00:00", "time zone"),
    ],
)
def test_what_makes_no_sense_is_refused_with_its_place(tmp_path, more: str, said: str) -> None:
    file = tmp_path / "s.yaml"
    file.write_text(GOOD + more + "\n")
    with pytest.raises(ScenarioError) as error:
        load_scenario(file)
    assert said in str(error.value)


def test_perfect_sensors_have_no_faults() -> None:
    with pytest.raises(ScenarioError, match="perfect sensors have no faults"):
        on_rails(faults=(Silence(do="silence"),))
