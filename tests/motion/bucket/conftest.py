"""Surfaces for a bucket and the machines that draw it."""

from dataclasses import fields
from functools import cache

import numpy as np
import pytest

from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.site.surface.delaunay import triangulated
from workgauge.site.surface.tin import Tin


def slope(one_in: float, turned_deg: float = 45.0, low_m: float = -1.5) -> Tin:
    """Return a plane whose fall line is turned from the machine's x axis, through (0, 0, low)."""
    way = np.array([np.cos(np.radians(turned_deg)), np.sin(np.radians(turned_deg))]) / one_in
    corners = np.array([[-20.0, -20.0], [20, -20], [20, 20], [-20, 20]])
    return Tin(np.column_stack([corners, corners @ way + low_m]), [[0, 1, 2], [0, 2, 3]], "slope")


def rough(seed: int, size_m: float = 0.05, step_m: float = 1.3) -> Tin:
    """Return a slope of 1:4 with bumps."""
    rng = np.random.default_rng(seed)
    axis = np.arange(-2.0, 12.0, step_m)
    x, y = (a.ravel() for a in np.meshgrid(axis, axis - 5.0))
    points = np.column_stack([x, y, -1.5 + 0.2 * x + 0.1 * y + rng.uniform(-size_m, size_m, len(x))])
    made = triangulated(points)
    return Tin(made.vertices, made.faces, "rough")


@cache
def four_jointed() -> MachineModel:
    """Return the excavator with tilt and rotation left out."""
    machine = load_machine("rre20")
    given = {f.name: getattr(machine, f.name) for f in fields(machine) if f.init}
    arm = 4
    chain = machine.chain[:arm]
    rest = np.eye(4)
    for joint in machine.chain[arm:]:
        rest = rest @ joint.T_parent_joint @ joint.T_joint_link
    for name in ("joint_names", "levers", "stopping_positive", "stopping_negative", "cylinders"):
        given[name] = given[name][:arm]
    for name in ("q_min", "q_max", "continuous", "prismatic", "speed_positive", "speed_negative", "home"):
        given[name] = given[name][:arm].copy()
    given["lever_signs"] = given["lever_signs"][:arm]
    given["link_names"] = given["link_names"][: arm + 1]
    given.update(chain=chain, T_link_tool=rest @ machine.T_link_tool, positioning=None, sensors=(), pump=None)
    given.update(solids=tuple(s for s in machine.solids if s.link <= arm), self_pairs=(), skipped_pairs=())
    return MachineModel(**given)


class Ground:
    """What tests of this folder share."""

    slope = staticmethod(slope)
    rough = staticmethod(rough)
    four_jointed = staticmethod(four_jointed)


@pytest.fixture(scope="session")
def ground() -> type[Ground]:
    return Ground
