"""A run replays from its log: the same inputs, the same valve integers."""

from dataclasses import replace
from pathlib import Path

import pytest

from workgauge.loop.memory import first_memory
from workgauge.loop.tick import tick
from workgauge.record.reader import open_log
from workgauge.record.setup import configuration
from workgauge.record.ticks import TickRecorder, replay
from workgauge.record.writer import LogWriter
from workgauge.rehearse import session as session_module
from workgauge.rehearse.session import Session
from workgauge.values.errors import InputError
from workgauge.values.measurements import Levers
from workgauge.wire.messages import encode


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):  # type: ignore[no-untyped-def]
    """Return a driven session, its log's path and the frames that left it."""
    session = Session(at=(25487288.0, 6714595.5, 42.0))
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    frames: list[bytes] = []
    with LogWriter(path, configuration(session.config)) as log, pytest.MonkeyPatch.context() as patch:
        recorder = TickRecorder(log)

        def watched(inputs, memory, config):  # type: ignore[no-untyped-def]
            inputs = replace(inputs, off_states=frozenset({"works on track 2"} if len(frames) > 90 else ()))
            outputs, after, trace = tick(inputs, memory, config)
            recorder.take(inputs, outputs.frame, trace)
            frames.append(outputs.frame)
            return outputs, after, trace

        patch.setattr(session_module, "tick", watched)
        for k in range(180):
            lever = 0.0 if k < 20 else -0.8
            levers = Levers(left_x=lever, right_y=-lever / 2)
            session.step(None if k in (150, 151) else session.intent(levers=levers, enable=k > 5))
    return session, path, frames


def test_a_replayed_run_sends_the_same_bytes(recorded) -> None:  # type: ignore[no-untyped-def]
    session, path, frames = recorded
    log = open_log(path)
    assert log.cut is None and log.configuration["machine"] == "rre20"
    memory, count = first_memory(session.config), 0
    for recorded_tick, frame in zip(replay(log, session.scene), frames, strict=True):
        outputs, memory, trace = tick(recorded_tick.inputs, memory, session.config)
        assert outputs.frame == frame
        assert trace.valves == recorded_tick.command.valves
        assert encode(recorded_tick.command) == frame
        count += 1
    assert count == 180 and any(any(one.command.valves) for one in replay(log, session.scene))
    assert [one.inputs.intent is None for one in replay(log, session.scene)].count(True) == 2
    assert list(replay(log, session.scene))[-1].inputs.off_states == {"works on track 2"}


def test_what_the_tick_saw_is_there_too(recorded) -> None:  # type: ignore[no-untyped-def]
    _, path, _ = recorded
    topics = {entry.topic for entry in open_log(path).entries()}
    assert topics == {"/posture", "/pose", "/intent", "/tick", "/velocities", "/valves", "/clearance", "/reasons"}


def test_a_cut_run_replays_up_to_the_cut(recorded, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    session, path, frames = recorded
    log = open_log(path)
    cut = tmp_path / "cut.mcap"
    begin, length = log.chunks[-1]
    cut.write_bytes(path.read_bytes()[: begin + length - 1])
    commands = [encode(one.command) for one in replay(open_log(cut), session.scene)]
    assert 90 < len(commands) < 180 and commands == frames[: len(commands)]


def test_a_log_without_its_inputs_does_not_replay(tmp_path: Path, recorded) -> None:  # type: ignore[no-untyped-def]
    session, path, _ = recorded
    hollow = tmp_path / "hollow.mcap"
    with LogWriter(hollow, {}) as log:
        for entry in open_log(path).entries("/tick", "/valves", "/intent"):
            log.write(entry.topic, entry.time_ns, entry.value)
    with pytest.raises(InputError, match="/posture"):
        list(replay(open_log(hollow), session.scene))
