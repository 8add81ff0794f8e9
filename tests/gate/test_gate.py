"""The gate, case by case. No fixtures, no state between tests: the mutation test runs these against every mutant."""

import dataclasses

import pytest

from workgauge.gate import gate
from workgauge.values.commands import VALVE_FULL, ValveCommand
from workgauge.values.measurements import Stamp
from workgauge.values.reasons import Reason, ReasonCode
from workgauge.wire.messages import decode_command, encode

MS = 1_000_000
NOW = 10_000 * MS
MACHINE = "excavator-1"


def config(**changes):
    given = gate.GateConfig(
        machine_id=MACHINE,
        source="gate",
        joints=3,
        valve_limit=VALVE_FULL,
        max_step=(500, 600, 700),
        posture_age_ns=100 * MS,
        pose_age_ns=200 * MS,
        intent_age_ns=300 * MS,
        command_age_ns=20 * MS,
        exclusive_groups=(),
    )
    return dataclasses.replace(given, **changes)


def stamp(at=NOW, machine=MACHINE):
    return Stamp(machine, at, "sensors")


def facts(**changes):
    given = gate.GateFacts(NOW, stamp(), stamp(), stamp(), True, False)
    return dataclasses.replace(given, **changes)


def opened(valves=(0, 0, 0), sequence=7):
    return gate.GateState(True, False, valves, sequence)


def command(valves=(100, -200, 300), sequence=8, at=NOW, enable=True, machine=MACHINE):
    return encode(ValveCommand(Stamp(machine, at, "loop"), sequence, valves, enable))


def passes(frame, given, state, settings):
    """The frame goes out as it is, and the state remembers it."""
    out, after, reasons = gate.vet(frame, given, state, settings)
    sent = decode_command(frame, NOW).value
    assert out == frame
    assert reasons == ()
    assert after == gate.GateState(True, False, sent.valves, sent.sequence)


def refused(code, frame=None, given=None, state=None, settings=None, *, sequence=8, released=False, said=""):
    """A neutral frame goes out, for that one reason, and the gate is shut."""
    settings = settings or config()
    out, after, reasons = gate.vet(
        command() if frame is None else frame, given or facts(), state or opened(), settings
    )
    assert [reason.code for reason in reasons] == [code]
    assert said in reasons[0].text
    message = decode_command(out, NOW)
    neutral = (0,) * settings.joints
    assert message.value == ValveCommand(Stamp(MACHINE, NOW, "gate"), sequence, neutral, False)
    assert message.sent_ns == NOW
    assert after == gate.GateState(False, released, neutral, sequence)
    return after


def test_an_open_gate_passes_the_very_bytes():
    passes(command(), facts(), opened(), config())


def test_born_closed():
    born = gate.GateState()
    assert (born.open, born.released, born.valves, born.sequence) == (False, False, (), -1)
    refused(ReasonCode.GATE_CLOSED, state=born, said="let the enable switch go")


def test_types_are_frozen_and_carry_nothing_else():
    for value in (config(), facts(), opened()):
        assert not hasattr(value, "__dict__")
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(value, dataclasses.fields(value)[0].name, 0)


def test_the_whole_way_to_open():
    neutral = (0, 0, 0)
    state = refused(
        ReasonCode.NOT_ENABLED,
        command(neutral, 0, enable=False),
        facts(enable=False, levers_neutral=True),
        gate.GateState(),
        sequence=0,
        released=True,
        said="enable switch is not pressed",
    )
    passes(command(neutral, 1), facts(levers_neutral=True), state, config())


def test_a_switch_that_was_never_seen_let_go_does_not_open_the_gate():
    held = gate.GateState(False, False, (0, 0, 0), 7)
    refused(ReasonCode.GATE_CLOSED, command((0, 0, 0)), facts(levers_neutral=True), held)


def test_pressing_the_switch_with_a_lever_off_the_middle_does_not_open_the_gate():
    ready = gate.GateState(False, True, (0, 0, 0), 7)
    refused(ReasonCode.NOT_NEUTRAL, command((0, 0, 0)), facts(), ready, said="in the middle")


def test_pressing_the_switch_with_a_valve_off_the_middle_does_not_open_the_gate():
    ready = gate.GateState(False, True, (0, 0, 0), 7)
    refused(ReasonCode.NOT_NEUTRAL, command((0, 1, 0)), facts(levers_neutral=True), ready)


def test_something_wrong_at_the_edge_wastes_it():
    ready = gate.GateState(False, True, (0, 0, 0), 7)
    refused(ReasonCode.NO_POSTURE, command((0, 0, 0)), facts(posture=None, levers_neutral=True), ready)


def test_letting_the_switch_go_shuts_the_gate():
    refused(ReasonCode.NOT_ENABLED, given=facts(enable=False), released=True)


def test_a_command_that_does_not_see_the_switch_shuts_the_gate():
    refused(ReasonCode.NOT_ENABLED, command(enable=False))


def test_a_switch_let_go_in_a_bad_intent_is_not_seen():
    refused(ReasonCode.STALE_INTENT, given=facts(intent=stamp(NOW - 300 * MS - 1), enable=False))


def test_letting_go_is_seen_while_something_else_is_wrong():
    out, after, reasons = gate.vet(command(), facts(pose=None, enable=False), opened(), config())
    assert [reason.code for reason in reasons] == [ReasonCode.NO_POSE, ReasonCode.NOT_ENABLED]
    assert after.released and not after.open
    assert decode_command(out, NOW).value.neutral


def test_absent_inputs_shut_the_gate():
    refused(ReasonCode.NO_POSTURE, given=facts(posture=None), said="no posture")
    refused(ReasonCode.NO_POSE, given=facts(pose=None), said="no machine pose")
    refused(ReasonCode.NO_INTENT, given=facts(intent=None), said="no intent")


def test_each_input_may_be_as_old_as_its_own_limit_and_no_older():
    for name, age_ms, code in (
        ("posture", 100, ReasonCode.STALE_POSTURE),
        ("pose", 200, ReasonCode.STALE_POSE),
        ("intent", 300, ReasonCode.STALE_INTENT),
    ):
        passes(command(), facts(**{name: stamp(NOW - age_ms * MS)}), opened(), config())
        refused(code, given=facts(**{name: stamp(NOW - age_ms * MS - 1)}), said="too old")


def test_an_input_from_the_future_shuts_the_gate():
    for name in ("posture", "pose", "intent"):
        refused(ReasonCode.FROM_FUTURE, given=facts(**{name: stamp(NOW + 1)}), said="future")


def test_an_input_of_another_machine_shuts_the_gate():
    for name in ("posture", "pose", "intent"):
        refused(ReasonCode.INVALID_VALUE, given=facts(**{name: stamp(machine="other")}), said="other")


def test_a_command_for_another_machine_shuts_the_gate():
    refused(ReasonCode.INVALID_VALUE, command(machine="other"), said="another machine, other")


def test_a_command_from_the_future_or_too_old_shuts_the_gate():
    passes(command(at=NOW - 20 * MS), facts(), opened(), config())
    refused(ReasonCode.WRONG_SEQUENCE, command(at=NOW - 20 * MS - 1), said="too old")
    refused(ReasonCode.FROM_FUTURE, command(at=NOW + 1), said="command is stamped in the future")


def test_the_sequence_must_go_on_by_one():
    for sequence in (0, 6, 7, 9):
        refused(
            ReasonCode.WRONG_SEQUENCE, command(sequence=sequence), sequence=sequence, said=f"{sequence} follows 7"
        )
    refused(ReasonCode.WRONG_SEQUENCE, command(sequence=5), state=opened(sequence=0), sequence=5)


def test_the_sequence_wraps_around():
    passes(command(sequence=0), facts(), opened(sequence=2**32 - 1), config())
    refused(ReasonCode.WRONG_SEQUENCE, command(sequence=1), state=opened(sequence=2**32 - 1), sequence=1)


def test_the_first_frame_may_have_any_sequence():
    first = gate.GateState(True, False, (), -1)
    passes(command(sequence=123), facts(), first, config())
    passes(command(sequence=0), facts(), first, config())


def test_unreadable_bytes_shut_the_gate():
    broken = command()[:-1] + b"?"
    refused(ReasonCode.INVALID_VALUE, broken, said="check sum")
    refused(ReasonCode.INVALID_VALUE, b"", said="too short")
    refused(ReasonCode.INVALID_VALUE, b"", state=gate.GateState(), sequence=0)
    refused(ReasonCode.INVALID_VALUE, b"", state=opened(sequence=2**32 - 1), sequence=0)
    ready = gate.GateState(False, True, (0, 0, 0), 7)
    refused(ReasonCode.INVALID_VALUE, b"", facts(enable=False), ready)


def test_the_number_of_valves_must_be_the_machines():
    refused(ReasonCode.INVALID_VALUE, command((0, 0)), said="2 valves, the machine 3")
    refused(ReasonCode.INVALID_VALUE, command((0, 0, 0, 0)), said="4 valves")


def test_a_valve_must_stay_in_range():
    for full in (VALVE_FULL, -VALVE_FULL):
        passes(command((0, full, 0)), facts(), opened((0, full, 0)), config())
    for beyond in (VALVE_FULL + 1, -VALVE_FULL - 1):
        refused(
            ReasonCode.OUT_OF_RANGE,
            command((0, beyond, 0)),
            state=opened((0, beyond, 0)),
            said=f"valve 2 commanded to {beyond}",
        )


def test_each_valve_may_open_by_its_own_step_and_no_more():
    for joint, step in enumerate((500, 600, 700)):
        for sign in (1, -1):
            for before in (0, 1000):
                was = tuple(sign * before if j == joint else 0 for j in range(3))
                allowed = tuple(sign * (before + step) if j == joint else 0 for j in range(3))
                beyond = tuple(sign * (before + step + 1) if j == joint else 0 for j in range(3))
                passes(command(allowed), facts(), opened(was), config())
                refused(
                    ReasonCode.TOO_FAST_CHANGE,
                    command(beyond),
                    state=opened(was),
                    said=f"valve {joint + 1} would jump from {sign * before} to {sign * (before + step + 1)}",
                )


def test_closing_a_valve_is_free():
    for sign in (1, -1):
        passes(command((0, 0, 0)), facts(), opened((sign * VALVE_FULL, 0, 0)), config())
        passes(command((sign * 1, 0, 0)), facts(), opened((sign * VALVE_FULL, 0, 0)), config())


def test_through_the_middle_the_other_side_starts_from_zero():
    for sign in (1, -1):
        passes(command((-sign * 500, 0, 0)), facts(), opened((sign * VALVE_FULL, 0, 0)), config())
        refused(
            ReasonCode.TOO_FAST_CHANGE,
            command((-sign * 501, 0, 0)),
            state=opened((sign * VALVE_FULL, 0, 0)),
            said=f"from {sign * VALVE_FULL} to {-sign * 501}",
        )


def test_before_the_first_frame_every_valve_counts_as_closed():
    first = gate.GateState(True, False, (), -1)
    passes(command((500, 600, 700)), facts(), first, config())
    for beyond in (501, -501):
        refused(ReasonCode.TOO_FAST_CHANGE, command((beyond, 0, 0)), state=first)


def test_joints_that_cannot_move_together_do_not():
    split = config(exclusive_groups=((0,), (1, 2)))
    passes(command((100, 0, 0)), facts(), opened(), split)
    passes(command((0, 100, 0)), facts(), opened(), split)
    passes(command((0, 100, 100)), facts(), opened(), split)
    for valves in ((100, 0, 100), (100, 100, 0), (-1, 0, 1)):
        refused(ReasonCode.EXCLUSIVE_GROUP, command(valves), settings=split, said="cannot move together")


def test_every_cause_is_said():
    frame = command((VALVE_FULL + 1, 100, 0), 3, NOW - 21 * MS, False, "other")
    given = gate.GateFacts(NOW, None, stamp(NOW + 1), stamp(machine="third"), False, False)
    out, after, reasons = gate.vet(frame, given, opened(), config(exclusive_groups=((0,), (1,))))
    assert [reason.code for reason in reasons] == [
        ReasonCode.NO_POSTURE,
        ReasonCode.FROM_FUTURE,
        ReasonCode.INVALID_VALUE,
        ReasonCode.INVALID_VALUE,
        ReasonCode.WRONG_SEQUENCE,
        ReasonCode.WRONG_SEQUENCE,
        ReasonCode.OUT_OF_RANGE,
        ReasonCode.TOO_FAST_CHANGE,
        ReasonCode.EXCLUSIVE_GROUP,
    ]
    assert all(isinstance(reason, Reason) for reason in reasons)
    assert decode_command(out, NOW).value.neutral and not after.open
