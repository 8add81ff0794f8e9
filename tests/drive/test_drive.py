"""Velocity to valves and back, and the ramp."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.drive.ideal import IdealDrive
from workgauge.drive.ramp import ramped
from workgauge.machine.load import load_machine
from workgauge.values.commands import VALVE_FULL

DRIVE = IdealDrive((0.9, 0.4, 0.61), (0.8, 0.3, 0.59))
speeds = st.lists(st.floats(-2, 2), min_size=3, max_size=3)
openings = st.lists(st.integers(-VALVE_FULL, VALVE_FULL), min_size=3, max_size=3)
any_full = st.floats(1e-3, 1e3)


@settings(max_examples=400, deadline=None)
@given(speeds)
def test_the_command_is_never_faster_than_asked(velocity: list[float]) -> None:
    for asked, given_ in zip(velocity, DRIVE.velocity(DRIVE.valves(velocity)), strict=True):
        assert abs(given_) <= abs(asked) and given_ * asked >= 0.0


@settings(max_examples=400, deadline=None)
@given(speeds)
def test_the_command_is_the_fastest_such_opening(velocity: list[float]) -> None:
    full = [p if v > 0 else n for v, p, n in zip(velocity, DRIVE.speed_positive, DRIVE.speed_negative, strict=True)]
    for asked, valve, top in zip(velocity, DRIVE.valves(velocity), full, strict=True):
        assert abs(valve) == VALVE_FULL or (abs(valve) + 1) / VALVE_FULL * top > abs(asked)
        assert abs(valve) <= VALVE_FULL


@settings(max_examples=400, deadline=None)
@given(openings)
def test_a_velocity_made_by_valves_gives_them_back(valves: list[int]) -> None:
    assert DRIVE.valves(DRIVE.velocity(valves)) == tuple(valves)


@settings(max_examples=400, deadline=None)
@given(any_full, st.floats(0, 1e3), st.integers(0, VALVE_FULL))
def test_the_laws_hold_for_any_full_speed(full: float, asked: float, valve: int) -> None:
    drive = IdealDrive((full,), (full,))
    assert drive.velocity(drive.valves([asked]))[0] <= asked
    assert drive.valves(drive.velocity([valve])) == (valve,)


def test_full_speed_is_full_valve_and_more_is_no_more() -> None:
    assert DRIVE.valves([0.9, -0.3, 5.0]) == (VALVE_FULL, -VALVE_FULL, VALVE_FULL)
    assert DRIVE.velocity([VALVE_FULL, -VALVE_FULL, 0]) == (0.9, -0.3, 0.0)
    assert DRIVE.valves([0.45, -0.2, 0.0]) == (5000, -6666, 0)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_neutral(bad: float) -> None:
    assert DRIVE.valves([0.5, bad, 0.1]) == (0, 0, 0)


def test_a_machines_drive_has_its_speeds() -> None:
    machine = load_machine("rre20")
    drive = IdealDrive.of(machine)
    assert drive.valves(machine.speed_positive.tolist()) == (VALVE_FULL,) * machine.n
    assert drive.valves((-machine.speed_negative).tolist()) == (-VALVE_FULL,) * machine.n


STEPS = (500, 500, 600)


@settings(max_examples=400, deadline=None)
@given(openings, openings)
def test_the_ramp_opens_no_valve_by_more_than_its_step_and_keeps_the_direction(
    was: list[int], want: list[int]
) -> None:
    out = ramped(was, want, STEPS)
    for before, now, wanted, step in zip(was, out, want, STEPS, strict=True):
        assert min(before, 0) - step <= now <= max(before, 0) + step
        assert abs(now) <= abs(wanted) and now * wanted >= 0
    shares = [abs(o / w) for o, w in zip(out, want, strict=True) if w]
    slack = [1 / abs(w) for w in want if w]
    assert not shares or max(shares) - min(shares) <= max(slack)


@settings(max_examples=200, deadline=None)
@given(openings, openings)
def test_the_ramp_gets_there(was: list[int], want: list[int]) -> None:
    state: tuple[int, ...] = tuple(was)
    for _ in range(2 * math.ceil(VALVE_FULL / 500) + 2):
        state = ramped(state, want, STEPS)
    assert state == tuple(want)


def test_closing_is_immediate() -> None:
    assert ramped((9000, -9000, 0), (0, -100, 0), STEPS) == (0, -100, 0)


def test_one_valve_that_must_wait_makes_all_wait() -> None:
    assert ramped((1000, 0, 0), (1000, 5000, 0), STEPS) == (100, 500, 0)


JUMPS = ((500, 800), (1500, 1200), (0, 1000))


def beyond(valve: int, jump: tuple[int, int]) -> int:
    """Return what of an opening lies beyond its jump, signed."""
    return max(valve - jump[0], 0) if valve > 0 else -max(-valve - jump[1], 0)


@settings(max_examples=400, deadline=None)
@given(openings, openings)
def test_a_valve_jumps_at_once_and_ramps_beyond(was: list[int], want: list[int]) -> None:
    out = ramped(was, want, STEPS, JUMPS)
    moved = [beyond(valve, jump) for valve, jump in zip(out, JUMPS, strict=True)]
    asked = [beyond(valve, jump) for valve, jump in zip(want, JUMPS, strict=True)]
    before = [beyond(valve, jump) for valve, jump in zip(was, JUMPS, strict=True)]
    assert [valve == 0 for valve in out] == [share == 0 for share in moved]
    for b, m, a, step in zip(before, moved, asked, STEPS, strict=True):
        assert min(b, 0) - step <= m <= max(b, 0) + step and abs(m) <= abs(a) and m * a >= 0
    shares = [abs(m / a) for m, a in zip(moved, asked, strict=True) if a]
    assert not shares or max(shares) - min(shares) <= max(1 / abs(a) for a in asked if a)
    assert ramped(was, want, STEPS, ((0, 0),) * 3) == ramped(was, want, STEPS)
    for _ in range(2 * math.ceil(VALVE_FULL / 500) + 2):
        out = ramped(out, want, STEPS, JUMPS)
    assert [beyond(valve, jump) for valve, jump in zip(out, JUMPS, strict=True)] == asked
