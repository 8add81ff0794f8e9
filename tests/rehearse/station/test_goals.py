"""A goal is looked at in another process, and run only as it was looked at."""

import numpy as np
import pytest

from workgauge.rehearse.scenario_file import load_scenario
from workgauge.rehearse.station.previewing import Previewer
from workgauge.rehearse.station.telling import rows
from workgauge.values.mail import Letter
from workgauge.values.measurements import DriveMode
from workgauge.values.station import PreviewResult
from workgauge.values.station import RequestKind as Ask
from workgauge.wire.station import encode_station

PAGE = "page-1"


@pytest.fixture(scope="module")
def previewer() -> Previewer:
    return Previewer(load_scenario("pole-approach").choosing(guard="barrier"))


def goal_at(bench, moved: tuple[float, float, float]) -> tuple[float, ...]:
    """Return the tool's pose moved by so much in the site."""
    session = bench.station.session
    q, T = session.true_state
    pose = np.array(T @ session.machine.tool_pose(session.machine.forward(q)))
    pose[:3, 3] += moved
    return rows(pose)


def looked_at(bench, previewer: Previewer, goal: tuple[float, ...], name: str = "g1") -> PreviewResult:
    asked = bench.ask(Ask.PREVIEW, text=name, numbers=goal, on=False)
    bench.move()
    bench.step()
    assert bench.answer(asked).done, bench.answer(asked).text
    (task,) = bench.station.tasks()
    found = previewer.look(task)
    letter = Letter("preview-result", bench.now_ns, encode_station(found))
    bench.move()
    bench.station.step(bench.now_ns, bench.hands, (), [letter])
    bench.hands.clear()
    bench.now_ns += 10_000_000
    return found


def run(bench, ticks: int) -> None:
    for _ in range(ticks):
        bench.move(mode=DriveMode.AUTO, right_y=1.0)
        bench.step()


def refused(bench, name: str) -> str:
    asked = bench.ask(Ask.RUN, text=name)
    bench.move()
    bench.step()
    return bench.answer(asked).text


def test_a_goal_that_is_reached_is_run_to_its_end_as_foreseen(bench, previewer) -> None:
    bench.seated()
    before = bench.station.session.tool
    goal = goal_at(bench, (0.0, 0.0, 0.4))
    assert refused(bench, "g1") == "this goal has not been looked at"
    found = looked_at(bench, previewer, goal).found
    assert found.ready and found.duration_s is not None
    assert "reaches in" in found.text and "closest" in found.text
    assert len(found.postures) <= 24
    assert refused(bench, "another")
    assert refused(bench, "g1") == ""
    assert bench.now().running == "g1"
    run(bench, round(found.duration_s / 0.01) + 20)
    assert bench.station.goals.running == ""
    assert any("reached its goal" in one.text for one in bench.station.told.events)
    assert np.linalg.norm(bench.station.session.tool - before - [0.0, 0.0, 0.4]) < 0.025
    assert np.allclose(bench.station.session.true_state[0], found.postures[-1], atol=0.02)


def test_a_goal_out_of_reach_is_not_ready_and_not_run(bench, previewer) -> None:
    bench.seated()
    found = looked_at(bench, previewer, goal_at(bench, (30.0, 0.0, 0.0))).found
    assert not found.ready and found.duration_s is None
    assert "does not reach" in found.text
    assert "not reached" in refused(bench, "g1")
    run(bench, 20)
    assert not any(bench.valves)


def test_what_was_looked_at_elsewhere_or_among_other_limits_is_not_run(bench, previewer) -> None:
    bench.seated()
    looked_at(bench, previewer, goal_at(bench, (0.0, 0.0, 0.3)))
    bench.ask(Ask.STATE, text="Track 2 open to traffic", on=False)
    bench.move()
    bench.step()
    assert "changed since" in refused(bench, "g1")
    bench.ask(Ask.STATE, text="Track 2 open to traffic", on=True)
    bench.move()
    bench.step()
    bench.drive(60, left_x=0.5)
    bench.drive(5)
    assert "moved since" in refused(bench, "g1")


def test_letting_go_stops_what_runs_and_a_goal_of_nonsense_is_refused(bench, previewer) -> None:
    bench.seated()
    looked_at(bench, previewer, goal_at(bench, (0.0, 0.0, 0.4)))
    assert refused(bench, "g1") == ""
    run(bench, 30)
    assert any(bench.valves)
    bench.step(60)  # silence
    assert not any(bench.valves)
    assert bench.station.goals.running == "", "Enable alone does not let it go on"
    huge = (1e200, 1e200, 0.0, 0.0, -1e200, 1e200, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    mirrored = tuple(-value for value in goal_at(bench, (0.0, 0.0, 0.0)))
    for numbers in ((), (0.0,) * 12, (1.0, 0, 0, 1e6, 0, 1, 0, 0, 0, 0, 1, 0), mirrored, huge):
        asked = bench.ask(Ask.PREVIEW, text="g2", numbers=numbers)
        bench.move()
        bench.step()
        assert not bench.answer(asked).done
