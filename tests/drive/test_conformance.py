"""What every drive keeps, for ideal and hydraulic ones alike."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.drive.api import Drive
from workgauge.drive.hydraulic import HydraulicDrive, led
from workgauge.drive.ideal import IdealDrive
from workgauge.machine.cylinder import Cylinder
from workgauge.machine.load import load_machine
from workgauge.values.commands import VALVE_FULL

SPEEDS = ((0.9, 0.8), (0.4, 0.3), (0.61, 0.59))
BANDS = ((0.05, 0.08), (0.15, 0.12), (0.0, 0.1))
DRIVES = {
    "ideal": IdealDrive(tuple(p for p, _ in SPEEDS), tuple(n for _, n in SPEEDS)),
    "hydraulic": HydraulicDrive(SPEEDS, BANDS, rest=0.0, keep=0.0),
    "at rest below a share": HydraulicDrive(SPEEDS, BANDS),
    "one pump": HydraulicDrive(SPEEDS, BANDS, ((2.0, 1.5), (3.0, 2.0), (1.0, 1.0)), 3.5),
}
every = pytest.mark.parametrize("name", DRIVES)
speeds = st.lists(st.floats(-2, 2), min_size=3, max_size=3)
openings = st.lists(st.integers(-VALVE_FULL, VALVE_FULL), min_size=3, max_size=3)


@every
@settings(max_examples=300, deadline=None)
@given(velocity=speeds)
def test_a_command_is_never_faster_than_asked(name: str, velocity: list[float]) -> None:
    drive = DRIVES[name]
    valves = drive.valves(velocity)
    assert all(abs(valve) <= VALVE_FULL for valve in valves)
    for asked, given_ in zip(velocity, drive.velocity(valves), strict=True):
        assert abs(given_) <= abs(asked) and given_ * asked >= 0.0


@every
@settings(max_examples=300, deadline=None)
@given(valves=openings)
def test_valves_and_velocities_go_back_and_forth(name: str, valves: list[int]) -> None:
    drive = DRIVES[name]
    velocity = drive.velocity(valves)
    again = drive.velocity(drive.valves(velocity))
    step = 1.0 / VALVE_FULL / (1.0 - 0.15)
    for was, now, full in zip(velocity, again, SPEEDS, strict=True):
        assert abs(now) <= abs(was) and now * was >= 0.0
        assert abs(was) - abs(now) <= (0.0051 + 2.0 * step) * max(full)


@every
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_neutral(name: str, bad: float) -> None:
    assert DRIVES[name].valves([0.5, bad, 0.1]) == (0, 0, 0)


@every
def test_nothing_asked_is_neutral(name: str) -> None:
    assert DRIVES[name].valves([0.0, -0.0, 0.0]) == (0, 0, 0)
    assert DRIVES[name].velocity([0, 0, 0]) == (0.0, 0.0, 0.0)


@settings(max_examples=300, deadline=None)
@given(speeds)
def test_a_valve_is_closed_or_beyond_its_band_and_the_fastest_such_opening(velocity: list[float]) -> None:
    drive = DRIVES["hydraulic"]
    for j, (asked, valve) in enumerate(zip(velocity, drive.valves(velocity), strict=True)):
        band, full = BANDS[j][asked < 0], SPEEDS[j][asked < 0]
        assert valve == 0 or abs(valve) / VALVE_FULL > band
        more = min(max(abs(valve), math.floor(band * VALVE_FULL)) + 1, VALVE_FULL)
        faster = [0] * 3
        faster[j] = -more if asked < 0 else more
        assert abs(valve) == VALVE_FULL or abs(drive.velocity(faster)[j]) > min(abs(asked), full) * (1 - 1e-12)


@settings(max_examples=200, deadline=None)
@given(openings)
def test_a_hydraulic_drive_without_hydraulics_is_the_ideal_one(valves: list[int]) -> None:
    plain, ideal = HydraulicDrive(SPEEDS, ((0.0, 0.0),) * 3, rest=0.0, keep=0.0), DRIVES["ideal"]
    assert plain.velocity(valves) == pytest.approx(ideal.velocity(valves), abs=1e-15)
    for one, other in zip(plain.valves(ideal.velocity(valves)), ideal.valves(ideal.velocity(valves)), strict=True):
        assert abs(one - other) <= 1


@settings(max_examples=300, deadline=None)
@given(speeds)
def test_the_pump_is_never_asked_for_more_and_the_direction_stays(velocity: list[float]) -> None:
    drive = DRIVES["one pump"]
    made = drive.velocity(drive.valves(velocity))
    flow = sum(abs(v) / SPEEDS[j][v < 0] * drive.flow[j][v < 0] for j, v in enumerate(made))
    assert flow <= 3.5 + 1e-9
    capped = [math.copysign(min(abs(v), SPEEDS[j][v < 0]), v) for j, v in enumerate(velocity)]
    ratios = [m / c for m, c in zip(made, capped, strict=True) if abs(c) > 0.1 and m]
    assert not ratios or max(ratios) - min(ratios) < 0.01


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(-0.0049, 0.0049), min_size=2, max_size=30))
def test_noise_about_zero_opens_no_valve(noise: list[float]) -> None:
    drive, valves = DRIVES["at rest below a share"], (0, 0, 0)
    for share in noise:
        valves = (
            drive.valves([share * full for full, _ in SPEEDS], previous=valves)
            if share > 0
            else drive.valves([share * full for _, full in SPEEDS], previous=valves)
        )
        assert valves == (0, 0, 0)


def test_a_joint_that_moves_goes_on_slower_than_one_at_rest_begins() -> None:
    drive = DRIVES["at rest below a share"]
    slow = [0.004 * full for full, _ in SPEEDS]
    assert drive.valves(slow) == (0, 0, 0)
    moving = drive.valves([0.01 * full for full, _ in SPEEDS])
    assert all(drive.valves(slow, previous=moving))
    assert drive.valves([-0.004 * full for _, full in SPEEDS], previous=moving) == (0, 0, 0)
    assert drive.valves([0.001 * full for full, _ in SPEEDS], previous=moving) == (0, 0, 0)


TRIANGLE = Cylinder(1.6, 0.5, math.radians(70), math.radians(-45), math.radians(65))


@settings(max_examples=200, deadline=None)
@given(st.floats(-0.78, 1.13), st.floats(-0.5, 0.5))
def test_a_cylinder_is_made_up_for_and_not_knowing_the_posture_is_slower(q: float, v: float) -> None:
    drive = HydraulicDrive(((0.5, 0.5),), ((0.05, 0.05),), cylinders=(TRIANGLE,), rest=0.0, keep=0.0)
    known, unknown = drive.valves([v], [q]), drive.valves([v])
    assert abs(unknown[0]) <= abs(known[0])
    made = drive.velocity(known, [q])[0]
    assert abs(made) <= abs(v) + 1e-15
    assert abs(v) - abs(made) <= 1e-4 or abs(known[0]) == VALVE_FULL
    assert drive.valves([v], [math.nan]) == (0,)


@settings(max_examples=300, deadline=None)
@given(speeds, speeds, st.lists(st.floats(0, 0.5), min_size=3, max_size=3), st.floats(0.001, 0.1))
def test_lead_only_ever_slows(now: list[float], before: list[float], lead: list[float], dt_s: float) -> None:
    for v, was, out, share in zip(now, before, led(now, before, lead, dt_s), lead, strict=True):
        assert abs(out) <= abs(v) and out * v >= 0.0
        if share == 0.0 or abs(v) >= abs(was):
            assert out == v


def test_lead_closes_a_valve_before_its_time() -> None:
    assert led([0.4], [0.5], [0.03], 0.01) == (pytest.approx(0.1),)
    assert led([0.4], [0.5], [0.15], 0.01) == (0.0,)
    assert led([-0.4], [-0.5], [0.03], 0.01) == (pytest.approx(-0.1),)


def test_a_machines_drive_has_its_speeds_pump_and_band() -> None:
    machine = load_machine("rre20")
    drive = HydraulicDrive.of(machine, 0.08)
    one = [0.0] * machine.n
    one[0] = float(machine.speed_positive[0])
    assert drive.valves(one)[0] == VALVE_FULL
    assert drive.velocity([801, 0, 0, 0, 0, 0])[0] > 0.0 == drive.velocity([800, 0, 0, 0, 0, 0])[0]
    everything = drive.velocity([VALVE_FULL] * machine.n)
    assert machine.pump is not None
    share = machine.pump.flow / float(machine.pump.flow_positive.sum())
    assert everything == pytest.approx((machine.speed_positive * share).tolist())


@every
def test_beyond_the_jump_every_joint_moves_and_within_it_none(name: str) -> None:
    drive: Drive = DRIVES[name]
    ups, downs = [up for up, _ in drive.jump], [-down for _, down in drive.jump]
    assert not any(drive.velocity(ups)) and not any(drive.velocity(downs))
    assert all(v > 0.0 for v in drive.velocity([up + 1 for up in ups]))
    assert all(v < 0.0 for v in drive.velocity([down - 1 for down in downs]))
