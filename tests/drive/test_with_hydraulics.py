"""The hydraulic drive against simulated hydraulics: it knows what they do, and does not set them cycling."""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.drive.hydraulic import HydraulicDrive
from workgauge.machine.cylinder import Cylinder
from workgauge.machine.load import load_machine
from workgauge.sim.hydraulics import Hydraulics, HydraulicSpec
from workgauge.values.commands import VALVE_FULL


@functools.cache
def machine():
    return load_machine("rre20")


@settings(max_examples=60, deadline=None)
@given(st.lists(st.integers(-VALVE_FULL, VALVE_FULL), min_size=6, max_size=6))
def test_the_drive_knows_the_speeds_that_valves_come_to(valves: list[int]) -> None:
    joints = Hydraulics(HydraulicSpec.of_machine(machine(), 0.08))
    joints.advance(np.array(valves) / VALVE_FULL, dt_s=60.0)
    assert joints.velocity == pytest.approx(HydraulicDrive.of(machine(), 0.08).velocity(valves), abs=1e-9)


TRIANGLE = Cylinder(1.6, 0.5, math.radians(70), math.radians(-45), math.radians(65))


@pytest.mark.parametrize("q", [-0.7, -0.2, 0.4, 1.0])
def test_it_knows_what_a_cylinder_makes_of_them(q: float) -> None:
    two = np.full((2, 1), 0.5)
    spec = HydraulicSpec(0 * two, 0 * two, np.full((2, 1), math.inf), 0.1 * two, two, cylinders=(TRIANGLE,))
    drive = HydraulicDrive(((0.5, 0.5),), ((0.05, 0.05),), cylinders=(TRIANGLE,))
    joints = Hydraulics(spec)
    valves = drive.valves([0.2], [q])
    way = joints.advance(np.array(valves) / VALVE_FULL, np.array([q]), 1e-4)
    assert way[0] == pytest.approx(0.2e-4, rel=1e-3)
    assert joints.velocity[0] == pytest.approx(0.2, rel=1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_a_joint_brought_to_a_place_comes_to_rest_there(seed: int) -> None:
    rng = np.random.default_rng(seed)
    spec = HydraulicSpec.of_machine(machine(), 0.08).varied(seed, 0.3)
    spec = replace(spec, dead_band=np.full((2, 6), 0.08))
    drive, joints = HydraulicDrive.of(machine(), 0.08), Hydraulics(replace(spec, pump=None))
    q, goal, valves = np.zeros(6), rng.uniform(-0.5, 0.5, 6), (0,) * 6
    moved_late, changes = 0, 0
    for k in range(4000):
        measured = q + 2e-4 * rng.standard_normal(6)
        before, valves = valves, drive.valves((0.8 * (goal - measured)).tolist(), previous=valves)
        changes += sum((a > 0) != (b > 0) or (a < 0) != (b < 0) for a, b in zip(before, valves, strict=True))
        q = q + joints.advance(np.array(valves) / VALVE_FULL, dt_s=0.01)
        moved_late += k > 3000 and any(valves)
    assert moved_late == 0 and changes < 60
    assert np.abs(q - goal) == pytest.approx(np.zeros(6), abs=0.01)
