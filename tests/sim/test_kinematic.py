"""The kinematic plant: its truth follows the valves, its bytes tell the truth, bad frames do nothing."""

import functools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.machine.load import load_machine
from workgauge.sim.hydraulics import HydraulicSpec
from workgauge.sim.joints import HydraulicJoints
from workgauge.sim.kinematic import KinematicPlant
from workgauge.values import transforms as tf
from workgauge.values.commands import VALVE_FULL, ValveCommand
from workgauge.values.errors import MachineError
from workgauge.values.measurements import MachinePose, Posture, Stamp
from workgauge.values.ports import VALUES_PORT, Plant
from workgauge.wire.messages import decode, encode

T_SITE = tf.translation(10.0, 20.0, 0.5) @ tf.rotation_z(0.7)


@functools.cache
def machine():
    return load_machine("rre20")


def plant(**changes) -> KinematicPlant:
    given_ = {"machine_id": "m1", "q": machine().home, "T_site_machine": T_SITE, "start_ns": 1000, **changes}
    return KinematicPlant(machine(), **given_)


def frame(valves, *, machine_id: str = "m1", enable: bool = True) -> bytes:
    return encode(ValveCommand(Stamp(machine_id, 0, "tick"), 0, tuple(valves), enable))


def test_it_is_a_plant() -> None:
    port: Plant = plant()
    port.advance(0.02)
    assert len(port.read()) == 4


def test_the_first_frames_tell_where_it_starts() -> None:
    posture, pose = (decode(c.data, 5000).value for c in plant().read())
    assert isinstance(posture, Posture) and isinstance(pose, MachinePose)
    assert posture.q.tobytes() == machine().home.tobytes() and not posture.sigma.any()
    assert pose.T_site_machine.tobytes() == T_SITE.tobytes() and not pose.covariance.any()
    assert posture.stamp == Stamp("m1", 5000, "kinematic", 1000) == pose.stamp


def test_frames_come_once_and_in_order() -> None:
    subject = plant()
    subject.read()
    for _ in range(3):
        subject.advance(0.01)
    chunks = subject.read()
    assert all(chunk.port == VALUES_PORT for chunk in chunks)
    assert [chunk.received_ns for chunk in chunks] == [m * 10_000_000 + 1000 for m in (1, 1, 2, 2, 3, 3)]
    messages = [decode(chunk.data, 0) for chunk in chunks]
    assert [type(m.value) for m in messages] == [Posture, MachinePose] * 3
    assert [m.sequence for m in messages] == [1, 1, 2, 2, 3, 3]
    assert [m.sent_ns for m in messages] == [10_001_000] * 2 + [20_001_000] * 2 + [30_001_000] * 2
    assert subject.read() == []


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.integers(-VALVE_FULL, VALVE_FULL), min_size=6, max_size=6),
    st.sampled_from([0.001, 0.005, 0.0123, 0.02]),
)
def test_joints_move_at_the_share_of_their_speed(valves: list[int], dt_s: float) -> None:
    subject = plant()
    subject.write(frame(valves))
    subject.advance(dt_s)
    speeds = [
        v / VALVE_FULL * (p if v > 0 else n)
        for v, p, n in zip(valves, machine().speed_positive, machine().speed_negative, strict=True)
    ]
    assert subject.truth[0] == pytest.approx(machine().home + np.array(speeds) * dt_s, abs=1e-12)
    posture = decode(subject.read()[-2].data, 0).value
    assert isinstance(posture, Posture) and posture.q.tobytes() == subject.truth[0].tobytes()


def test_joints_stop_at_their_stops_and_come_back() -> None:
    subject = plant()
    subject.write(frame([0, VALVE_FULL, 0, 0, 0, 0]))
    subject.advance(10.0)
    assert subject.truth[0][1] == machine().q_max[1]
    subject.write(frame([0, -VALVE_FULL, 0, 0, 0, 0]))
    subject.advance(0.1)
    assert subject.truth[0][1] == pytest.approx(machine().q_max[1] - 0.1 * machine().speed_negative[1])


def test_the_truth_is_seen_at_every_substep() -> None:
    seen = []
    subject = plant(substep_s=0.004, on_substep=lambda now, q, T: seen.append((now, q, T)))
    subject.write(frame([VALVE_FULL, 0, 0, 0, 0, 0]))
    subject.advance(0.02)
    subject.advance(0.01)
    assert [now for now, _, _ in seen] == [1000 + n * 1_000_000 for n in (4, 8, 12, 16, 20)] + [
        1000 + 23_333_333,
        1000 + 26_666_666,
        1000 + 30_000_000,
    ]
    swung = [q[0] for _, q, _ in seen]
    assert swung == pytest.approx([machine().speed_positive[0] * (now - 1000) * 1e-9 for now, _, _ in seen])
    assert seen[-1][1] is subject.truth[0] and not seen[0][1].flags.writeable
    assert all(T is subject.truth[1] for _, _, T in seen)


@pytest.mark.parametrize(
    "bad",
    [
        b"",
        frame([1] * 6)[:-1],
        frame([1] * 5),
        frame([1] * 7),
        frame([VALVE_FULL + 1, 0, 0, 0, 0, 0]),
        frame([0, -VALVE_FULL - 1, 0, 0, 0, 0]),
        frame([1] * 6, machine_id="m2"),
        encode(Posture.exact(Stamp("m1", 0, "s"), np.zeros(6))),
    ],
)
def test_bad_frames_are_ignored_and_counted(bad: bytes) -> None:
    subject, undisturbed = plant(), plant()
    for each in (subject, undisturbed):
        each.write(frame([VALVE_FULL, 0, 0, 0, 0, 0]))
    subject.write(bad)
    for each in (subject, undisturbed):
        each.advance(0.02)
    assert subject.bad_frames == 1 and undisturbed.bad_frames == 0
    assert subject.truth[0].tobytes() == undisturbed.truth[0].tobytes()


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=200))
def test_noise_does_nothing(noise: bytes) -> None:
    subject = plant()
    subject.write(noise)
    subject.advance(0.02)
    assert subject.bad_frames == 1 and subject.truth[0].tobytes() == machine().home.tobytes()


def test_a_command_without_the_enable_switch_closes_the_valves() -> None:
    subject = plant()
    subject.write(frame([VALVE_FULL] * 6))
    subject.write(frame([VALVE_FULL] * 6, enable=False))
    subject.advance(0.1)
    assert subject.truth[0].tobytes() == machine().home.tobytes() and subject.bad_frames == 0


@pytest.mark.parametrize("bad", [{"q": [0.0] * 5}, {"q": [0.0, 5.0, -1.0, 0.0, 0.0, 0.0]}, {"substep_s": 0.0}])
def test_a_start_that_is_none_is_refused(bad: dict) -> None:
    with pytest.raises(MachineError):
        plant(**bad)


@pytest.mark.parametrize("dt_s", [0.0, -1.0, math.nan, math.inf])
def test_time_only_passes_forwards(dt_s: float) -> None:
    with pytest.raises(ValueError, match="forwards"):
        plant().advance(dt_s)


def test_hydraulic_joints_move_as_they_do_alone_and_at_another_beat() -> None:
    spec = HydraulicSpec.of_machine(machine(), 0.08)
    subject, alone, q = (
        plant(joints=HydraulicJoints(machine(), spec)),
        HydraulicJoints(machine(), spec),
        machine().home,
    )
    valves = [VALVE_FULL // 2, 0, -VALVE_FULL // 3, 0, 0, 0]
    subject.write(frame(valves))
    alone.set_valves(valves)
    for _ in range(20):
        subject.advance(0.05)
        q = alone.advance(0.05, q)
    assert subject.truth[0] == pytest.approx(q, abs=1e-9) and abs(q[0] - machine().home[0]) > 0.1
    subject.write(frame(valves, enable=False))
    alone.set_valves([0] * 6)
    subject.advance(0.1)
    coasting = subject.truth[0].copy()
    subject.advance(2.0)
    q = alone.advance(2.1, q)
    assert subject.truth[0] == pytest.approx(q, abs=1e-9) and (subject.truth[0] - coasting)[0] > 0.05


def test_hydraulic_joints_wait_for_their_dead_time() -> None:
    subject = plant(joints=HydraulicJoints(machine(), HydraulicSpec.of_machine(machine())))
    subject.write(frame([VALVE_FULL, 0, 0, 0, 0, 0]))
    subject.advance(0.19)
    assert (subject.truth[0] == machine().home).all()
    subject.advance(0.05)
    assert subject.truth[0][0] > machine().home[0]
