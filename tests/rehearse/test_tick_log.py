"""A run comes out of its own log again, and not out of one that was made of something else."""

import json
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from workgauge import Session
from workgauge.guard.linear import LinearGuard
from workgauge.loop.memory import first_memory, restored
from workgauge.loop.tick import tick
from workgauge.record.reader import open_log
from workgauge.record.ticks import replay
from workgauge.rehearse.hydraulic_choice import HydraulicChoice
from workgauge.rehearse.identify.log import read_step_log
from workgauge.rehearse.identify.result import identify
from workgauge.rehearse.scenario import OnTrack
from workgauge.rehearse.sensing import SensorChoice
from workgauge.rehearse.shipped import shipped_path, shipped_site_files
from workgauge.rehearse.tick_log import Origin, recorded, reopened, replayed
from workgauge.values.errors import InputError
from workgauge.values.measurements import Levers
from workgauge.wire.messages import encode

TRACK = OnTrack(alignment="Track 1", distance_m=573.0)
POSTURE = {
    name: math.radians(angle)
    for name, angle in (("swing", -92), ("boom", 20), ("stick", -108), ("bucket", -73), ("tilt", 11), ("rotate", 4))
}


def own_files(folder: Path) -> Origin:
    """Return the shipped site, machine and rules as files of one's own."""
    site = [folder / file.name for file in shipped_site_files("double_track")]
    for copy, file in zip(site, shipped_site_files("double_track"), strict=True):
        copy.write_bytes(file.read_bytes())
    for room, name in (("machines", "rre20.yaml"), ("rules", "finland.yaml")):
        (folder / name).write_bytes(shipped_path(room, name).read_bytes())
    return Origin(tuple(site), folder / "rre20.yaml", folder / "finland.yaml")


def driven(session: Session, ticks: int, levers: Sequence[tuple[int, Levers]] = ()) -> None:
    """Drive a session: the enable switch is pressed once it is ready, levers change at given ticks."""
    held, pressed = Levers(), False
    for k in range(ticks):
        held = next((value for at, value in levers if at == k), held)
        session.step(session.intent(levers=held, enable=pressed) if k % 97 != 96 else None)
        pressed = session.ready and k % 97 != 96


@pytest.fixture(scope="module")
def run(tmp_path_factory):  # type: ignore[no-untyped-def]
    """Return the log of a run on simulated sensors and hydraulic joints, made of files, and its folder."""
    folder = tmp_path_factory.mktemp("run")
    origin = own_files(folder)
    session = Session(
        list(origin.site),
        origin.machine,
        origin.rules,
        LinearGuard(slow_distance_m=1.0),
        TRACK,
        posture=POSTURE,
        sensors=SensorChoice(seed=3),
        joints=HydraulicChoice(dead_band_percent=8.0, vary_seed=2),
        tick_s=0.02,
    )
    state = min(session.states)
    with recorded(session, folder / "run.mcap", origin):
        driven(session, 150, [(80, Levers(left_x=-0.9, right_y=0.6))])
        session.set_state(state, False)
        driven(session, 80, [(5, Levers(left_x=0.7))])
        session.set_state(state, True)
        driven(session, 20)
    return folder, state


def test_a_run_on_sensors_and_hydraulics_comes_out_again(run) -> None:  # type: ignore[no-untyped-def]
    folder, state = run
    log = open_log(folder / "run.mcap")
    scene, config = reopened(log)
    done = replayed(log, scene, config)
    assert (done.ticks, done.different, done.first) == (250, 0, None)
    assert done.moving > 60 and done.until_s == pytest.approx(249 * 0.02)
    inputs = [one.inputs for one in replay(log, scene)]
    assert {one.health.state.value for one in inputs if one.health is not None} >= {"stop", "fixed"}
    assert {name for one in inputs for name in one.let_off} and {
        name for one in inputs for name in one.off_states
    } == {state}
    assert any(one.posture is not None and one.posture.covariance is not None for one in inputs)


def test_a_replay_goes_on_from_a_memory_that_went_through_json(run) -> None:  # type: ignore[no-untyped-def]
    folder, _ = run
    log = open_log(folder / "run.mcap")
    scene, config = reopened(log)
    memory = first_memory(config)
    for k, one in enumerate(replay(log, scene)):
        outputs, memory, _ = tick(one.inputs, memory, config)
        assert outputs.frame == encode(one.command)
        if k % 17 == 3:
            memory = restored(json.loads(json.dumps(memory.plain())))


def test_another_guard_does_not_send_the_same(run) -> None:  # type: ignore[no-untyped-def]
    folder, _ = run
    log = open_log(folder / "run.mcap")
    scene, config = reopened(log)
    done = replayed(log, scene, replace(config, guard=LinearGuard(slow_distance_m=30.0)))
    assert done.different > 20 and done.first is not None and done.first.t_s > 1.0
    assert done.first.logged != done.first.now


def test_files_that_changed_or_went_are_refused_and_moved_ones_found(run, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    folder, _ = run
    log = open_log(folder / "run.mcap")
    moved = own_files(tmp_path)
    scene, config = reopened(log, site=moved.site, machine=moved.machine, rules=moved.rules)
    assert replayed(log, scene, config).different == 0
    with pytest.raises(InputError, match="other site files"):
        reopened(log, site=[*moved.site, moved.site[0]])
    with pytest.raises(InputError, match="cannot be read"):
        reopened(log, machine=tmp_path / "gone.yaml")
    rules = Path(moved.rules)
    rules.write_text(rules.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"finland.yaml: the file is not as it was"):
        reopened(log, rules=rules)


def test_a_log_that_does_not_say_what_it_was_made_of_is_refused(tmp_path: Path) -> None:
    session = Session(at=TRACK, posture=POSTURE)
    with recorded(session, tmp_path / "bare.mcap"):
        driven(session, 5)
    log = open_log(tmp_path / "bare.mcap")
    with pytest.raises(InputError, match="does not say what it was made of"):
        reopened(log)
    assert replayed(log, session.scene, session.config).different == 0
    with pytest.raises(InputError, match="first tick"), recorded(session, tmp_path / "late.mcap"):
        pass
    with (
        pytest.raises(InputError, match="never written over"),
        recorded(Session(at=TRACK, posture=POSTURE), log.file),
    ):
        pass
    with recorded(Session(at=TRACK, posture=POSTURE), tmp_path / "none.mcap"):
        pass
    with pytest.raises(InputError, match="no tick"):
        replayed(open_log(tmp_path / "none.mcap"), session.scene, session.config)


def test_a_drive_of_steps_and_stops_is_a_log_to_identify_from(tmp_path: Path) -> None:
    choice = HydraulicChoice(dead_band_percent=6.0, dead_time_s=0.3, pump=False)
    session = Session(at=TRACK, posture=POSTURE, joints=choice, tick_s=0.02, guard=LinearGuard(0.3, 0.1))
    with recorded(session, tmp_path / "steps.mcap"):
        at, levers = 10, []
        for level in (1.0, 0.7, 0.85, 0.6):
            for sign in (1.0, -1.0):
                levers += [(at, Levers(left_roller=sign * level)), (at + 60, Levers())]
                at += 130
        for k in range(at):
            held = next((value for since, value in reversed(levers) if since <= k), Levers())
            session.step(session.intent(levers=held, enable=k > 2))
    machine = session.machine
    (joint,) = [
        name for name, lever in zip(machine.joint_names, machine.levers, strict=True) if lever == "left_roller"
    ]
    log = read_step_log(tmp_path / "steps.mcap")
    (found,) = identify(log, machine, [joint], 0.2)
    for side in found.sides:
        assert side.fit.dead_time_s.value == pytest.approx(0.3, abs=0.03)
        assert side.fit.dead_band is not None and side.fit.dead_band.value == pytest.approx(0.06, abs=0.01)
        assert math.isfinite(side.fit.lag_s.value)


def test_the_recording_page_runs_as_it_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = Path(__file__).parents[2] / "docs" / "recording.md"
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 2
    monkeypatch.chdir(tmp_path)
    for file in shipped_site_files("double_track"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    names: dict[str, object] = {}
    for block in blocks:
        exec(block, names)
    assert (tmp_path / "run.mcap").exists() and (tmp_path / "ticks.mcap").exists()
