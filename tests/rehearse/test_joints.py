"""A session's joints: ideal ones follow at once, hydraulic ones late, by a drive that never asks for more."""

import functools
import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge import Session
from workgauge.drive.hydraulic import HydraulicDrive
from workgauge.drive.ideal import IdealDrive
from workgauge.machine.load import load_machine
from workgauge.rehearse.hydraulic_choice import HydraulicChoice, hydraulic_spec
from workgauge.rehearse.joints import moving
from workgauge.rehearse.run import open_session
from workgauge.rehearse.scenario_file import load_scenario
from workgauge.rehearse.shipped import shipped_path
from workgauge.sim.joints import HydraulicJoints, IdealJoints
from workgauge.values.commands import VALVE_FULL
from workgauge.values.errors import ScenarioError
from workgauge.values.measurements import Levers


@functools.cache
def machine():
    return load_machine("rre20")


def test_ideal_joints_have_the_ideal_drive() -> None:
    ideal = moving("ideal", machine())
    assert isinstance(ideal.joints, IdealJoints) and ideal.drive == IdealDrive.of(machine())
    assert ideal.words == "ideal" and "follows its valve at once" in ideal.assumption


def test_hydraulic_joints_have_a_drive_with_their_bands_and_pump() -> None:
    plain = moving("hydraulic", machine())
    assert isinstance(plain.joints, HydraulicJoints) and plain.words == "hydraulic, as the machine file says"
    assert plain.drive == HydraulicDrive(
        *(getattr(HydraulicDrive.of(machine()), name) for name in ("full_speed", "dead_band", "flow", "pump")),
        cylinders=machine().cylinders,
        rest=0.0,
        keep=0.0,
    )
    banded = moving(HydraulicChoice(dead_band_percent=8.0, pump=False), machine()).drive
    assert isinstance(banded, HydraulicDrive) and banded.rest > 0.0
    assert banded.dead_band == ((0.08, 0.08),) * 6 and math.isinf(banded.pump) and banded.flow == ()
    assert banded.jump == ((800, 800),) * 6


def test_what_is_said_of_them_is_what_was_simulated() -> None:
    choice = HydraulicChoice(dead_time_s=0.3, dead_band_percent=5.0, vary_seed=4, vary_percent=20.0)
    said, spec = moving(choice, machine()), hydraulic_spec(choice, machine())
    assert spec is not None and "seed 4" in said.words and "numbers of its own" in said.words
    assert f"dead time {spec.dead_time_s.min():.3g} to {spec.dead_time_s.max():.3g} s" in said.assumption
    assert "as the machine file says" in moving(HydraulicChoice(vary_seed=4), machine()).words


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 10_000),
    st.lists(st.floats(-1.2, 1.2), min_size=6, max_size=6),
    st.floats(0.0, 15.0),
    st.sampled_from([None, 10.0, 30.0]),
)
def test_no_drawn_machine_is_faster_than_asked(
    seed: int, shares: list[float], band: float, percent: float | None
) -> None:
    choice = HydraulicChoice(dead_band_percent=band, vary_seed=seed, vary_percent=percent)
    subject = moving(choice, machine())
    asked = np.where(np.array(shares) > 0, machine().speed_positive, machine().speed_negative) * shares
    subject.joints.set_valves(subject.drive.valves(asked.tolist(), machine().home.tolist()))
    q = machine().home
    for _ in range(60):
        q = subject.joints.advance(0.05, q)
        moved = np.abs(subject.joints.velocity) <= np.abs(asked) + 1e-9
        assert moved.all()


def drive_boom(session: Session) -> list[tuple[float, int]]:
    """Return the boom's true position and its valve of each tick: up for half a second, then let go."""
    session.step(session.intent(enable=False))
    session.step(session.intent())
    seen = []
    for k in range(150):
        done = session.step(session.intent(levers=Levers(right_y=-0.4 if k < 50 else 0.0)))
        seen.append((float(session.true_state[0][1]), done.trace.valves[1]))
    return seen


def test_a_session_on_hydraulic_joints_sets_out_late_and_moves_on_after_the_lever() -> None:
    place = (25487288.0, 6714595.5, 42.0)
    ideal = drive_boom(Session(at=place))
    late = drive_boom(Session(at=place, joints="hydraulic"))
    banded = drive_boom(Session(at=place, joints=HydraulicChoice(dead_band_percent=8.0)))
    start = late[0][0]
    first = next(k for k, (_, valve) in enumerate(late) if valve)
    assert all(q == start for q, _ in late[: first + 18]) and ideal[first + 5][0] != ideal[0][0]
    shut = next(k for k in range(50, 150) if not ideal[k][1])
    assert abs(ideal[-1][0] - ideal[shut][0]) < 1e-12
    shut = next(k for k in range(50, 150) if not late[k][1])
    assert abs(late[-1][0] - late[shut][0]) > math.radians(1.0)
    assert late[-1][0] == pytest.approx(late[-20][0], abs=1e-3)
    # over the dead band, the same motion: nothing is lost in it but its ramp
    assert banded[-1][0] - start == pytest.approx(late[-1][0] - start, rel=0.08)
    assert all(abs(valve) > 0.0799 * VALVE_FULL for _, valve in banded[first + 2 : shut])


def test_the_gate_lets_a_valve_jump_over_its_dead_band() -> None:
    session = Session(at=(25487288.0, 6714595.5, 42.0), joints=HydraulicChoice(dead_band_percent=10.0))
    assert [gate - own for gate, own in zip(session.config.gate.max_step, session.config.max_step, strict=True)] == (
        [VALVE_FULL // 10] * 6
    )
    valves = [valve for _, valve in drive_boom(session) if valve]
    assert VALVE_FULL // 10 < abs(valves[0]) <= VALVE_FULL // 10 + session.config.max_step[1]


SHIPPED = shipped_path("scenarios", "pole-approach.yaml").read_text(encoding="utf-8")


def scenario(tmp_path, joints: str):  # type: ignore[no-untyped-def]
    start = SHIPPED.index("joints: ideal")
    text = SHIPPED[:start] + f"joints: {joints}" + SHIPPED[SHIPPED.index("\n", start) :]
    file = tmp_path / "scenario.yaml"
    file.write_text(text, encoding="utf-8")
    return load_scenario(file)


def test_a_scenario_says_what_its_joints_are(tmp_path) -> None:  # type: ignore[no-untyped-def]
    session = open_session(scenario(tmp_path, "{dead_band_percent: 6, by_joint: {boom: {dead_time_s: 0.4}}}"))
    assert session.moving.drive.jump == ((600, 600),) * 6
    assert isinstance(session.moving.joints, HydraulicJoints)
    assert open_session(scenario(tmp_path, "hydraulic")).moving.words.startswith("hydraulic")


@pytest.mark.parametrize(
    ("joints", "words"),
    [
        ("sluggish", "neither `ideal` nor `hydraulic` nor a mapping"),
        ("{dead_time: 0.3}", "joints.dead_time: unknown key"),
        ("{dead_time_s: 30}", "joints.dead_time_s.*10"),
        ("{by_joint: {bom: {lag_s: 0.1}}}", "joints.by_joint: no such joint .found bom"),
        ("{by_joint: {boom: {deceleration_m_s2: 1}}}", "joint boom has deg/s2"),
    ],
)
def test_joints_that_cannot_be_are_refused_with_the_file(tmp_path, joints: str, words: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ScenarioError, match=words) as caught:
        open_session(scenario(tmp_path, joints))
    assert "scenario.yaml" in str(caught.value)


def test_what_the_page_shows_can_be_used(tmp_path) -> None:  # type: ignore[no-untyped-def]
    page = (Path(__file__).parents[2] / "docs" / "scenarios.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```yaml\n(joints:\n.*?)```", page, re.DOTALL)
    start = SHIPPED.index("joints: ideal")
    file = tmp_path / "scenario.yaml"
    file.write_text(SHIPPED[:start] + block + SHIPPED[SHIPPED.index("\n", start) :], encoding="utf-8")
    session = open_session(load_scenario(file))
    assert "8 %" not in session.moving.assumption and "1 change on the way" in session.moving.assumption
    assert session.moving.words == "hydraulic, with numbers of its own, drawn within tolerance by seed 7"
