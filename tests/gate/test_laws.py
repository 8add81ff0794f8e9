"""Laws of the gate under random sequences of frames and facts."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.gate.gate import GateConfig, GateFacts, GateState, vet
from workgauge.values.commands import VALVE_FULL, ValveCommand
from workgauge.values.measurements import Stamp
from workgauge.wire.messages import decode_command, encode

MACHINE = "excavator-1"
CONFIG = GateConfig(MACHINE, "gate", 2, VALVE_FULL, (4000, 4000), 100, 100, 100, 20, ((0,), (1,)))

valves = st.sampled_from([(0, 0), (3000, 0), (6000, 0), (0, -3000), (3000, 3000), (VALVE_FULL + 1, 0), (0,)])
ages = st.sampled_from([0, 0, 0, 0, 0, 100, 101, -1, None])
ticks = st.tuples(valves, st.sampled_from([1, 1, 1, 1, 1, 0, 2]), ages, ages, ages, st.booleans(), st.booleans())


def stamp(now: int, age: int | None) -> Stamp | None:
    return None if age is None else Stamp(MACHINE, now - age, "s")


def drive(steps: list[tuple]) -> None:
    """Run frames through the gate and check every one against what was wrong with it, told independently."""
    state, sequence, pressed_at_neutral, let_go, sent = GateState(), 0, False, False, (0, 0)
    for number, (wanted, skip, posture, pose, intent, enable, neutral) in enumerate(steps):
        now = 1000 * number
        sequence += skip
        frame = encode(ValveCommand(Stamp(MACHINE, now, "loop"), sequence, wanted, enable))
        facts = GateFacts(now, stamp(now, posture), stamp(now, pose), stamp(now, intent), enable, neutral)
        out, state, reasons = vet(frame, facts, state, CONFIG)
        passed = decode_command(out, now).value
        fresh = all(age is not None and 0 <= age <= 100 for age in (posture, pose, intent))
        edge = enable and let_go and neutral
        if not fresh or not enable:
            pressed_at_neutral = False
        elif edge and wanted == (0, 0) and (number == 0 or skip == 1):
            pressed_at_neutral = True
        if out == frame:
            assert fresh and enable and pressed_at_neutral and len(wanted) == 2
            assert not reasons
            assert all(abs(v) <= VALVE_FULL for v in wanted) and not all(wanted)
            assert all(abs(v) - max(b * (1 if v > 0 else -1), 0) <= 4000 for v, b in zip(wanted, sent, strict=True))
        else:
            pressed_at_neutral = False
            assert reasons and passed.valves == (0, 0) and not passed.enable and not state.open
        sent = passed.valves
        assert passed.sequence == sequence
        intent_fresh = intent is not None and 0 <= intent <= 100
        let_go = intent_fresh and not enable


@settings(max_examples=400, deadline=None)
@given(st.lists(ticks, max_size=25))
def test_what_passes_is_fresh_enabled_in_order_in_range_and_gradual(steps: list[tuple]) -> None:
    drive(steps)


@pytest.mark.prove
@settings(max_examples=20_000, deadline=None)
@given(st.lists(ticks, max_size=60))
def test_what_passes_is_fresh_enabled_in_order_in_range_and_gradual_at_length(steps: list[tuple]) -> None:
    drive(steps)


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=200), st.booleans())
def test_noise_never_passes(noise: bytes, was_open: bool) -> None:
    now = 5000
    facts = GateFacts(now, stamp(now, 0), stamp(now, 0), stamp(now, 0), True, True)
    out, state, reasons = vet(noise, facts, GateState(was_open, True, (0, 0), 4), CONFIG)
    assert out != noise and reasons and not state.open
    assert decode_command(out, now).value.neutral
