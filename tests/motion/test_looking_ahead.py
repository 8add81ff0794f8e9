"""What a motion would come near to: each posture looked at by itself says the same, and nothing found can change."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.machine.load import load_machine
from workgauge.motion.looking_ahead import Surroundings, looked_ahead
from workgauge.motion.planning import Pace, plan_joints
from workgauge.proximity.scene import Scene
from workgauge.values.arrays import frozen
from workgauge.values.limits import Limit, LimitKind, Source
from workgauge.values.solids import Box
from workgauge.values.transforms import translation

MACHINE = load_machine("rre20")
STOP_M = 0.2


def around(*places: tuple[float, float, float]) -> Surroundings:
    """Return boxes at places seen from the tool at home."""
    tool = MACHINE.tool_pose(MACHINE.forward(MACHINE.home))[:3, 3]
    limits = [
        Limit(
            *(f"box {k}", LimitKind.ZONE, f"box {k}"),
            *(Box(frozen(translation(*(tool + place))), frozen([0.1, 0.1, 0.1])), "test", Source("test", f"{k}")),
        )
        for k, place in enumerate(places)
    ]
    return Surroundings(Scene(MACHINE, limits), np.eye(4), STOP_M)


SEEN = around((0.5, 0.0, 0.0), (0.0, 0.6, 0.2), (-0.4, 0.0, -0.5))


@settings(max_examples=25, deadline=None)
@given(st.lists(st.lists(st.floats(-0.08, 0.08), min_size=6, max_size=6), min_size=1, max_size=4))
def test_postures_together_come_as_near_as_the_nearest_of_them(turned: list[list[float]]) -> None:
    postures = [MACHINE.home + np.array(one) for one in turned]
    together, alone = looked_ahead(SEEN, [], postures), [looked_ahead(SEEN, [], [q]) for q in postures]
    assert together.worst_m == min(one.worst_m for one in alone)
    names = {name for one in alone for name in one.least}
    assert dict(together.least) == {name: min(one.least.get(name, math.inf) for one in alone) for name in names}
    if together.limit is not None:
        assert together.distance_m - together.stop_m == together.worst_m
        assert together.least[together.limit] <= together.distance_m


def test_a_motion_comes_as_near_as_its_postures_and_its_moment_is_that_of_the_nearest() -> None:
    (motion,) = plan_joints(MACHINE, MACHINE.home, MACHINE.home + np.array([0.25, 0, 0, 0, 0, 0]), Pace())
    seen = looked_ahead(SEEN, [motion.trajectory])
    dense = [looked_ahead(SEEN, [], [q]).worst_m for q in motion.trajectory.many(np.arange(0, 2, 0.01))[0]]
    assert min(dense) <= seen.worst_m + 1e-9 <= min(dense) + 0.05
    assert looked_ahead(SEEN, [], [motion.trajectory.at(seen.at)[0]]).worst_m == pytest.approx(seen.worst_m, abs=1e-9)
    later = looked_ahead(SEEN, [motion.trajectory], [MACHINE.home])
    assert later.least == {name: min(one, later.least[name]) for name, one in seen.least.items()}


def test_nothing_found_can_change() -> None:
    seen = looked_ahead(SEEN, [], [MACHINE.home])
    before = dict(seen.least)
    assert before
    with pytest.raises(TypeError):
        seen.least[next(iter(before))] = 0.0  # type: ignore[index]
    nothing = looked_ahead(around(), [], [])
    with pytest.raises(TypeError):
        nothing.least["box 0"] = 0.0  # type: ignore[index]
    assert seen.least == before and not nothing.least and math.isinf(nothing.worst_m)
