"""Levers: dead zone, shaping, ramp, patterns and what each lever moves."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.machine.load import load_machine
from workgauge.motion.joystick import LeverFeel, joint_velocity, ramped_levers, shaped, tool_twist
from workgauge.values.errors import InputError
from workgauge.values.measurements import LEVER_NAMES, Levers

positions = st.floats(-1, 1)
feels = st.builds(LeverFeel, st.floats(0, 0.5), st.floats(1, 5))


def one(position: float, feel: LeverFeel) -> float:
    return shaped([position] * 6, feel)[0]


@settings(max_examples=300, deadline=None)
@given(positions, positions, feels)
def test_shaping_never_falls_and_is_odd(a: float, b: float, feel: LeverFeel) -> None:
    low, high = sorted((a, b))
    assert one(low, feel) <= one(high, feel)
    assert one(-a, feel) == -one(a, feel)
    assert abs(one(a, feel)) <= 1.0


@settings(max_examples=100, deadline=None)
@given(feels)
def test_the_middle_is_dead_and_the_stop_is_full(feel: LeverFeel) -> None:
    assert one(feel.dead_zone, feel) == 0.0 and one(-feel.dead_zone, feel) == 0.0
    assert one(1.0, feel) == 1.0 and one(-1.0, feel) == -1.0
    assert one(feel.dead_zone + 0.1, feel) > 0.0


def test_a_straight_lever_without_dead_zone_is_itself() -> None:
    assert one(0.37, LeverFeel(dead_zone=0.0, exponent=1.0)) == 0.37


@settings(max_examples=300, deadline=None)
@given(st.lists(positions, min_size=6, max_size=6), st.lists(positions, min_size=6, max_size=6), st.floats(0.01, 1))
def test_the_ramp_goes_out_gradually_and_in_at_once(was: list[float], want: list[float], step: float) -> None:
    for before, now, wanted in zip(was, ramped_levers(was, want, step), want, strict=True):
        assert abs(now) <= abs(wanted) and now * wanted >= 0.0
        assert min(before, 0.0) - step <= now <= max(before, 0.0) + step
        if abs(wanted) <= abs(before) and wanted * before >= 0.0:
            assert now == wanted


def test_every_lever_moves_its_joint_the_way_operators_expect() -> None:
    machine = load_machine("rre20")
    top, bottom = machine.speed_positive, -machine.speed_negative
    for lever, joint, speed in (
        ("left_x", 0, bottom[0]),  # right: swing to the right
        ("right_y", 1, bottom[1]),  # forward: boom down
        ("left_y", 2, top[2]),  # forward: stick out
        ("right_x", 3, top[3]),  # right: bucket out
        ("left_roller", 4, top[4]),
        ("right_roller", 5, top[5]),
    ):
        velocity = joint_velocity(shaped(Levers(**{lever: 1.0}).values, LeverFeel()), machine)
        assert velocity[joint] == speed
        assert [j for j, v in enumerate(velocity) if v] == [joint]
    half = joint_velocity([0.5] * 6, machine)
    assert half[1] == pytest.approx(0.5 * bottom[1]) and half[2] == pytest.approx(0.5 * top[2])


def test_the_sae_pattern_exchanges_boom_and_stick() -> None:
    machine = load_machine("rre20")
    sae = LeverFeel(pattern="sae")
    boom = joint_velocity(shaped(Levers(left_y=1.0).values, sae), machine)
    stick = joint_velocity(shaped(Levers(right_y=1.0).values, sae), machine)
    assert boom[1] == -machine.speed_negative[1] and not boom[2]
    assert stick[2] == machine.speed_positive[2] and not stick[1]
    for lever in ("left_x", "right_x", "left_roller", "right_roller"):
        levers = Levers(**{lever: 0.8}).values
        assert shaped(levers, sae) == shaped(levers, LeverFeel())


def test_a_joint_without_lever_stands_still() -> None:
    machine = load_machine("rre20")
    object.__setattr__(machine, "levers", (None,) * machine.n)
    assert joint_velocity([1.0] * 6, machine) == [0.0] * machine.n


def test_tool_mode_follows_the_machines_axes() -> None:
    twists = {name: tool_twist(Levers(**{name: 1.0}).values, 0.5, 0.3) for name in LEVER_NAMES}
    assert np.nonzero(list(twists.values()))[1].tolist() == [1, 0, 4, 2, 3, 5]
    assert twists["left_y"][0] == 0.5 and twists["left_x"][1] == -0.5 and twists["right_y"][2] == -0.5
    assert twists["right_x"][4] == -0.3 and twists["left_roller"][3] == 0.3 and twists["right_roller"][5] == 0.3


@pytest.mark.parametrize(
    "bad",
    [
        {"pattern": "cross"},
        {"dead_zone": 1.0},
        {"dead_zone": -0.1},
        {"dead_zone": math.nan},
        {"exponent": 0.5},
        {"exponent": 6.0},
        {"ramp_s": -1.0},
        {"ramp_s": math.inf},
    ],
)
def test_settings_out_of_range_are_refused(bad: dict) -> None:
    with pytest.raises(InputError):
        LeverFeel(**bad)
