"""Every kind of joints keeps the plant's contract; what is particular to each."""

import functools
import math

import numpy as np
import pytest

from workgauge.machine.load import load_machine, machine_from
from workgauge.machine.stopping import StoppingModel
from workgauge.sim.hydraulics import HydraulicSpec
from workgauge.sim.joints import HydraulicJoints, IdealJoints, Joints, joints_of
from workgauge.values.commands import VALVE_FULL
from workgauge.values.errors import MachineError


@functools.cache
def machine():
    return load_machine("rre20")


def kinds() -> dict[str, Joints]:
    full = np.stack([machine().speed_positive, machine().speed_negative])
    none = HydraulicSpec.of(StoppingModel.ideal(machine().n), full)
    return {
        "ideal": IdealJoints(machine()),
        "as the file says": HydraulicJoints(machine(), HydraulicSpec.of_machine(machine(), 0.08)),
        "hydraulic without delay": joints_of(machine(), none),
    }


@pytest.mark.parametrize("kind", ["ideal", "as the file says", "hydraulic without delay"])
def test_joints_start_at_rest_follow_their_valves_and_stop_at_their_stops(kind: str) -> None:
    subject, q = kinds()[kind], machine().home
    assert not subject.velocity.any()
    assert (subject.advance(0.5, q) == q).all()
    subject.set_valves([0, VALVE_FULL, 0, -VALVE_FULL, 0, 0])
    for _ in range(400):
        q = subject.advance(0.05, q)
        assert (q >= machine().q_min).all() and (q <= machine().q_max).all()
    assert q[1] == machine().q_max[1] and q[3] == machine().q_min[3]
    assert q[0] == machine().home[0] and q[2] == machine().home[2]
    subject.set_valves([0, -VALVE_FULL, 0, 0, 0, 0])
    for _ in range(10):
        q = subject.advance(0.05, q)
    assert q[1] < machine().q_max[1]


def test_ideal_joints_and_hydraulic_ones_without_delay_are_the_same() -> None:
    one, other = kinds()["ideal"], kinds()["hydraulic without delay"]
    rng, q, p = np.random.default_rng(3), machine().home, machine().home
    for _ in range(100):
        valves = rng.integers(-VALVE_FULL // 9, VALVE_FULL // 9, machine().n).tolist()
        one.set_valves(valves)
        other.set_valves(valves)
        q, p = one.advance(0.01, q), other.advance(0.01, p)
    assert p == pytest.approx(q, abs=1e-7)


def test_a_joint_on_its_stop_rests_there() -> None:
    subject, q = kinds()["as the file says"], machine().home
    subject.set_valves([0, VALVE_FULL, 0, 0, 0, 0])
    for _ in range(300):
        q = subject.advance(0.02, q)
    assert q[1] == machine().q_max[1] and subject.velocity[1] == 0.0


def test_joints_of_another_machine_are_refused() -> None:
    with pytest.raises(MachineError, match="joints"):
        HydraulicJoints(machine(), HydraulicSpec.of_machine(load_machine("brokk5")))


ARM = {
    "title": "arm",
    "undercarriage": {"kind": "tracks", "gauge_m": 2.0},
    "joints": [
        {
            "name": "boom",
            "type": "revolute",
            "lower_deg": -40,
            "upper_deg": 60,
            "home_deg": 0,
            "dh": {"a_m": 3, "alpha_deg": 0, "d_m": 0},
            "speed_positive_deg_s": 30,
            "speed_negative_deg_s": 25,
            "cylinder": {"a_m": 1.5, "b_m": 0.6, "offset_deg": 60},
        }
    ],
    "solids": [{"name": "boom", "link": "boom", "centre_m": [-1.5, 0, 0], "size_m": [3, 0.5, 0.5]}],
    "attachments": [{"name": "none", "tool": {}}],
}


def test_a_machines_file_may_say_what_cylinder_turns_a_joint() -> None:
    arm = machine_from(ARM)
    (cylinder,) = arm.cylinders
    assert cylinder is not None and cylinder.q_max == pytest.approx(math.radians(60)) and cylinder.a_m == 1.5
    assert HydraulicSpec.of_machine(arm).cylinders == arm.cylinders
    assert load_machine("rre20").cylinders == (None,) * 6


@pytest.mark.parametrize("offset", [39.0, 120.0, -60.5])
def test_a_triangle_that_folds_is_refused(offset: float) -> None:
    joint = {**ARM["joints"][0], "cylinder": {"a_m": 1.5, "b_m": 0.6, "offset_deg": offset}}
    with pytest.raises(MachineError, match="cylinder"):
        machine_from({**ARM, "joints": [joint]})
