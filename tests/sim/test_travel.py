"""Travel of the simulated undercarriage: speed, way, twist, the end of the way; deterministic."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.machine.load import load_machine
from workgauge.sim.kinematic import KinematicPlant
from workgauge.sim.travel import TravelDrive, twist_per_metre
from workgauge.values import transforms as tf
from workgauge.values.errors import MachineError

SPEEDS = st.floats(-6.0, 6.0)


@dataclass(frozen=True)
class Arc:
    """A place on a level circle of curvature k, ending at `end` either way."""

    s: float = 0.0
    k: float = 0.05
    end: float = 1e3

    @property
    def T_site_machine(self):
        turn = self.k * self.s
        chord = self.s * float(np.sinc(turn / 2 / math.pi))
        place = tf.translation(chord * math.cos(turn / 2), chord * math.sin(turn / 2), 0.0)
        return place @ tf.rotation_z(turn)

    def moved(self, by_m: float, curvature: float) -> "Arc":
        return Arc(min(max(self.s + by_m, -self.end), self.end), self.k, self.end)


def plant(place=None, **more) -> KinematicPlant:
    machine = load_machine("rre20")
    return KinematicPlant(machine, machine_id="m1", q=machine.home, place=place or Arc(), **more)


@given(SPEEDS, SPEEDS, st.floats(0.1, 5.0), st.floats(1e-3, 3.0))
def test_speed_changes_no_faster_than_it_can_and_the_way_is_its_integral(v0, wanted, a, dt) -> None:
    drive = TravelDrive(v0, wanted, acceleration_m_s2=a)
    after, way = drive.after(dt)
    assert abs(after.speed_m_s - v0) <= a * dt + 1e-12
    assert abs(wanted - after.speed_m_s) == pytest.approx(max(abs(wanted - v0) - a * dt, 0.0), abs=1e-9)
    n = 400
    summed, step = 0.0, drive
    for _ in range(n):
        following, made = step.after(dt / n)
        assert made == pytest.approx((step.speed_m_s + following.speed_m_s) / 2 * dt / n, abs=a * (dt / n) ** 2)
        summed, step = summed + made, following
    assert summed == pytest.approx(way, abs=1e-9) and step.speed_m_s == pytest.approx(after.speed_m_s, abs=1e-9)


def test_it_stops_in_the_way_physics_says() -> None:
    _, way = TravelDrive(3.0, 0.0, acceleration_m_s2=1.5).after(10.0)
    assert way == pytest.approx(3.0**2 / (2 * 1.5))


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(SPEEDS, st.integers(1, 40)), min_size=1, max_size=4))
def test_the_pose_is_that_of_the_way_made(orders) -> None:
    subject = plant()
    for speed, ticks in orders:
        subject.travel(speed)
        for _ in range(ticks):
            subject.advance(0.02)
    assert subject.truth[1] == pytest.approx(Arc(subject.travelled_m).T_site_machine, abs=1e-9)


def test_the_twist_is_the_change_of_the_pose() -> None:
    subject = plant()
    subject.travel(2.0)
    for _ in range(200):
        subject.advance(0.02)
    assert subject.speed_m_s == 2.0
    before, twist = subject.truth[1], subject.twist
    subject.advance(1e-4)
    moved = (subject.truth[1][:3, 3] - before[:3, 3]) / 1e-4
    assert twist[:3] == pytest.approx(moved, abs=1e-4)
    assert twist[3:] == pytest.approx([0.0, 0.0, 0.05 * 2.0], abs=1e-6)
    assert twist[:3] == pytest.approx(2.0 * before[:3, 0], abs=1e-6)


def test_at_the_end_of_its_way_it_stands() -> None:
    subject = plant(Arc(end=1.0))
    subject.travel(3.0)
    for _ in range(200):
        subject.advance(0.02)
    assert subject.travelled_m == pytest.approx(1.0, abs=0.01)  # half a substep's way
    assert subject.truth[1] == pytest.approx(Arc(1.0).T_site_machine)
    subject.travel(-1.0)
    for _ in range(100):
        subject.advance(0.02)
    assert subject.travelled_m < 0.5


def test_standing_still_changes_nothing_at_all() -> None:
    subject = plant()
    T = subject.truth[1]
    for _ in range(10):
        subject.advance(0.02)
    assert subject.truth[1] is T and not subject.twist.any() and subject.travelled_m == 0.0


def test_where_there_is_no_way_there_is_no_twist() -> None:
    assert not twist_per_metre(Arc(end=0.0), 0.0).any()
    assert twist_per_metre(Arc(1.0, end=1.0), 0.0)[0] == pytest.approx(math.cos(0.05), abs=1e-3)


def test_two_runs_are_the_same_bit_for_bit() -> None:
    def bytes_of() -> bytes:
        subject, sent = plant(), b""
        for k in range(60):
            subject.travel(1.5 * math.sin(k), 0.0)
            subject.advance(0.02)
            sent += b"".join(chunk.data for chunk in subject.read())
        return sent

    assert bytes_of() == bytes_of()


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_what_is_no_speed_is_refused(bad: float) -> None:
    with pytest.raises(ValueError, match="finite"):
        plant().travel(bad)
    with pytest.raises(ValueError, match="finite"):
        plant().travel(0.0, bad)


def test_a_pose_or_a_place_and_brakes_that_work() -> None:
    machine = load_machine("rre20")
    with pytest.raises(MachineError, match="exactly one"):
        KinematicPlant(machine, machine_id="m", q=machine.home)
    with pytest.raises(MachineError, match="exactly one"):
        KinematicPlant(machine, machine_id="m", q=machine.home, T_site_machine=np.eye(4), place=Arc())
    with pytest.raises(MachineError, match="acceleration"):
        plant(acceleration_m_s2=0.0)
