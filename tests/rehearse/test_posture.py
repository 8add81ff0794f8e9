"""Start postures: home where it does no harm, else clear of limits, of the machine and of the pole it is to meet."""

import math

import numpy as np
import pytest

from workgauge.machine.load import load_machine
from workgauge.machine.model import Kinematics
from workgauge.proximity.scene import Scene
from workgauge.rehearse.posture import clearances, spread_evenly, start_posture
from workgauge.values.arrays import Floats, frozen
from workgauge.values.clearances import Clearances
from workgauge.values.limits import Limit, LimitKind, Source
from workgauge.values.solids import Box
from workgauge.values.transforms import rotation_z, translation

MACHINE = load_machine("rre20")


def pole(x: float, y: float) -> tuple[Scene, Floats]:
    """Return a scene with one pole at (x, y) of the machine, and where to aim at it."""
    box = Box(translation(x, y, 4.0), frozen([0.2, 0.2, 5.0]))
    limit = Limit("point:P", LimitKind.POINT, "P", box, "by hand", Source("t", "P"))
    return Scene(MACHINE, [limit]), np.array([x, y, 1.5])


def test_home_where_nothing_is_near() -> None:
    assert (start_posture(Scene(MACHINE, []), np.eye(4), None) == MACHINE.home).all()
    scene, aim = pole(12.0, 3.0)
    assert (start_posture(scene, np.eye(4), aim) == MACHINE.home).all()


@pytest.mark.parametrize("bearing", [0.0, 80.0, 170.0, -120.0])
@pytest.mark.parametrize("away", [5.0, 6.5])
def test_clear_where_it_starts_and_all_the_way_round_to_the_pole(bearing: float, away: float) -> None:
    b = math.radians(bearing)
    scene, aim = pole(away * math.cos(b), away * math.sin(b))
    q = start_posture(scene, np.eye(4), aim)
    assert ((q >= MACHINE.q_min) & (q <= MACHINE.q_max)).all()
    tool = MACHINE.tool_pose(MACHINE.forward(q))[:2, 3]
    turn = math.remainder(b - math.atan2(tool[1], tool[0]), 2 * math.pi)
    for swing in np.linspace(q[0], q[0] + turn, 9):
        limit, own = clearances(scene, np.array([swing, *q[1:]]), np.eye(4), 2.0)
        assert limit > 0.3 and own > 0.3


def test_it_goes_with_the_machine() -> None:
    scene, aim = pole(5.5, 1.0)
    T = translation(30.0, -4.0, 2.0) @ rotation_z(1.1)
    box = scene.limits[0].solid
    assert isinstance(box, Box)
    moved = Limit("point:P", LimitKind.POINT, "P", Box(T @ box.T_frame_box, box.half_extents), "", Source("t", "P"))
    there = start_posture(Scene(MACHINE, [moved]), T, T[:3, :3] @ aim + T[:3, 3])
    assert there == pytest.approx(start_posture(scene, np.eye(4), aim), abs=1e-9)


class Counting:
    """A scene that remembers what was asked of it."""

    machine = MACHINE

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self.asked: list[bytes] = []

    def query(self, kin: Kinematics, T_site_machine: Floats, radius_m: float, /) -> Clearances:
        self.asked.append(kin.T_machine_links.tobytes())
        return self._scene.query(kin, T_site_machine, radius_m)


@pytest.mark.parametrize("away", [2.5, 5.0])
def test_no_posture_is_looked_at_twice(away: float) -> None:
    scene, aim = pole(away, 0.5)
    counting = Counting(scene)
    assert (start_posture(counting, np.eye(4), aim) == start_posture(scene, np.eye(4), aim)).all()
    assert 1 < len(counting.asked) == len(set(counting.asked))


def test_points_fill_the_cube_evenly() -> None:
    points = spread_evenly(512, 3)
    assert ((points > 0) & (points < 1)).all()
    cells = {tuple(cell) for cell in (points * 4).astype(int)}
    assert len(cells) == 64
    assert np.abs(points.mean(axis=0) - 0.5).max() < 0.01
