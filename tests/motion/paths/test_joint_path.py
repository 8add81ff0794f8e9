"""The joints' way along a tool path: on the path, on one branch, and a true word where it ends."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, reject, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.motion.ik.task import orientation_of, task_error, task_jacobian
from workgauge.motion.paths.following import MARGIN_RAD, PathCause
from workgauge.motion.paths.joint_path import JointPath, Unreachable, joint_path
from workgauge.motion.paths.tool_path import ToolPath
from workgauge.values.errors import InputError
from workgauge.values.tasks import Orientation
from workgauge.values.transforms import rotation_z, rpy, translation

NAMES = ("rre20", "brokk5", "sun-a")
MACHINES = {name: load_machine(name) for name in NAMES}
#: The machine stands somewhere on the site, not level.
T_SITE_MACHINE = translation(130.0, -20.0, 4.0) @ rpy(0.03, -0.02, 2.0)


def none(goal: np.ndarray, orientation: Orientation, near: np.ndarray) -> None:
    """Return no answer: Newton's method alone follows the branch."""


def pose(machine: MachineModel, q: np.ndarray) -> np.ndarray:
    return T_SITE_MACHINE @ machine.tool_pose(machine.forward(q))


def wandering(name: str, seed: int, legs: int = 3, size: float = 0.25) -> np.ndarray:
    """Return postures near each other, well within the joints' ends, one exclusive group moving."""
    machine, rng = MACHINES[name], np.random.default_rng(seed)
    span = machine.sample_max - machine.sample_min
    postures = [machine.sample_min + rng.uniform(0.3, 0.7, machine.n) * span]
    for _ in range(legs):
        step = rng.uniform(-size, size, machine.n)
        if machine.exclusive_groups:
            step[1] = 0.0
        inner = np.clip(postures[-1] + step, machine.sample_min + 0.2 * span, machine.sample_max - 0.2 * span)
        postures.append(inner)
    return np.array(postures)


def drawn(name: str, seed: int, kind: str) -> tuple[ToolPath, np.ndarray]:
    """Return a path that a machine's tool can follow, and the posture at its beginning."""
    postures = wandering(name, seed)
    T = np.array([pose(MACHINES[name], q) for q in postures])
    if kind == "spline":
        try:
            return ToolPath.spline(T[:, :3, 3], T[:, :3, :3]), postures[0]
        except InputError as refused:
            if "turns back on itself" not in str(refused):  # one in some ten thousand wanderings
                raise
            reject()
    return ToolPath.polyline(T[:, :3, 3], T[:, :3, :3], blend_m=0.05 if kind == "rounded" else 0.0), postures[0]


def off(machine: MachineModel, path: JointPath, s: np.ndarray) -> tuple[float, float]:
    """Return how far the tool is off the path at worst, at distances s [m, rad]."""
    goals = np.linalg.inv(T_SITE_MACHINE) @ path.path.at(s)[0]
    errors = [
        task_error(machine.forward(q), machine, goal, path.orientation)
        for q, goal in zip(path.curve.at(s)[0], goals, strict=True)
    ]
    return max(float(np.linalg.norm(e[:3])) for e in errors), max(float(np.linalg.norm(e[3:])) for e in errors)


def held(machine: MachineModel, free: bool) -> Orientation:
    return Orientation.FREE if free else orientation_of(machine)


@settings(max_examples=8, deadline=None)
@example("brokk5", 8819, "spline", False)
@given(st.sampled_from(NAMES), st.integers(0, 10**6), st.sampled_from(["spline", "rounded", "sharp"]), st.booleans())
def test_the_tool_stays_on_the_path_and_no_joint_jumps(name: str, seed: int, kind: str, free: bool) -> None:
    machine = MACHINES[name]
    path, start = drawn(name, seed, kind)
    found = joint_path(machine, path, T_SITE_MACHINE, start, held(machine, free), none)
    if isinstance(found, Unreachable):  # between the postures joints may have to go beyond their ends
        assert 0.0 <= found.distance_m < path.length_m
        return
    metres, radians = off(machine, found, np.random.default_rng(seed).uniform(0.0, path.length_m, 200))
    assert metres < 2e-4 and radians < math.radians(0.02)
    curve = found.curve
    assert np.all(np.diff(curve.s) > 0.0) and curve.s[0] == 0.0 and curve.s[-1] == pytest.approx(path.length_m)
    assert np.abs(np.diff(curve.q, axis=0)).max() <= 0.15
    assert (curve.q >= machine.q_min + MARGIN_RAD - 1e-9).all() and (
        curve.q <= machine.q_max - MARGIN_RAD + 1e-9
    ).all()
    assert found.start_gap_m < 1e-9 and curve.q[0] == pytest.approx(start, abs=1e-8)
    inner = np.setdiff1d(np.arange(1, len(curve.s) - 1), np.searchsorted(curve.s, path.stops_m))
    assert curve.leaving[inner] == pytest.approx(curve.arriving[inner - 1], abs=1e-9)
    for group in machine.exclusive_groups:
        if len(group) == 1:
            assert np.ptp(curve.q[:, group[0]]) == 0.0


@settings(max_examples=6, deadline=None)
@given(st.sampled_from(NAMES), st.integers(0, 10**6), st.booleans())
def test_slopes_move_the_tool_exactly_along_the_path(name: str, seed: int, free: bool) -> None:
    machine = MACHINES[name]
    path, start = drawn(name, seed, "spline")
    orientation = held(machine, free)
    found = joint_path(machine, path, T_SITE_MACHINE, start, orientation, none)
    if isinstance(found, Unreachable):
        return
    for k in range(0, len(found.curve.s) - 1, 5):
        q, slope = found.curve.q[k], found.curve.leaving[k]
        moved = task_jacobian(machine.forward(q), machine, orientation)[:3] @ slope
        tangent = T_SITE_MACHINE[:3, :3].T @ path.at(found.curve.s[k])[1][:3]
        assert moved == pytest.approx(tangent, abs=1e-7)


def test_the_inverse_is_asked_and_only_answers_that_join_on_are_taken() -> None:
    """Answers a turn off, of the other branch or with a joint that may not move do no harm."""
    machine = MACHINES["brokk5"]
    path, start = drawn("brokk5", 3, "spline")
    expected = joint_path(machine, path, T_SITE_MACHINE, start, Orientation.FREE, none)
    assert isinstance(expected, JointPath)
    asked = []

    def odd(goal: np.ndarray, orientation: Orientation, near: np.ndarray) -> np.ndarray:
        asked.append(1)
        wrong = np.array(near)
        wrong[0] += 2.0 * math.pi * (len(asked) % 3)
        if len(asked) % 2:
            wrong[1] += 0.2
        return wrong

    found = joint_path(machine, path, T_SITE_MACHINE, start, Orientation.FREE, odd)
    assert isinstance(found, JointPath) and asked
    assert np.abs(np.diff(found.curve.q, axis=0)).max() <= 0.15
    assert found.curve.q[-1] == pytest.approx(expected.curve.q[-1], abs=0.02)


def test_an_endless_joint_goes_on_turning() -> None:
    machine = MACHINES["sun-a"]
    T = machine.tool_pose(machine.forward(machine.home))
    turns = np.linspace(0.0, 4.0 * math.pi, 41)
    poses = np.array([T_SITE_MACHINE @ rotation_z(turn) @ T for turn in turns])
    path = ToolPath.spline(poses[:, :3, 3], poses[:, :3, :3])
    found = joint_path(machine, path, T_SITE_MACHINE, machine.home, Orientation.PITCH, none)
    assert isinstance(found, JointPath)
    assert found.curve.q[-1, 0] - found.curve.q[0, 0] == pytest.approx(4.0 * math.pi, abs=1e-6)
    assert found.curve.q[-1, 1:] == pytest.approx(machine.home[1:], abs=1e-6)


def stick_drive(machine: MachineModel, change: float) -> tuple[ToolPath, np.ndarray, np.ndarray]:
    """Return the tool's path as the stick alone turns by `change`, its beginning, and the stick's angles."""
    postures = np.tile(machine.home, (30, 1))
    postures[:, 2] += np.linspace(0.0, change, 30)
    T = np.array([pose(machine, q) for q in postures])
    return ToolPath.spline(T[:, :3, 3], T[:, :3, :3]), postures[0], postures[:, 2]


def test_a_joint_at_its_end_is_named_with_the_place() -> None:
    machine = MACHINES["sun-a"]
    path, start, sticks = stick_drive(machine, machine.q_min[2] - 0.2 - machine.home[2])
    found = joint_path(machine, path, T_SITE_MACHINE, start, Orientation.PITCH, none)
    assert isinstance(found, Unreachable) and found.cause is PathCause.JOINT_END and found.joint == "stick"
    at = np.interp(-(machine.q_min[2] + MARGIN_RAD), -sticks, path.point_distances_m)
    assert found.distance_m == pytest.approx(at, abs=2e-3)
    assert str(found) == f"at {at:.2f} m of {path.length_m:.2f} m: stick at its end (-150 deg)"


def test_another_branch_is_said_but_not_jumped_to() -> None:
    machine = MACHINES["sun-a"]
    path, start, _ = stick_drive(machine, -math.radians(30.0))
    low, high = np.array(machine.q_min), np.array(machine.q_max)
    low[1:], high[1:] = -3.0, 3.0
    low[2] = machine.home[2] - math.radians(20.0)
    wide = replace(machine, q_min=low, q_max=high)

    def bent_the_other_way(goal: np.ndarray, orientation: Orientation, near: np.ndarray) -> np.ndarray:
        """Return the mirror image of the two-link arm, which the caller refines."""
        lengths = [float(np.linalg.norm(joint.T_joint_link[:2, 3])) for joint in machine.chain]
        inner = math.atan2(lengths[2] * math.sin(near[2]), lengths[1] + lengths[2] * math.cos(near[2]))
        other = np.array(near)
        other[1], other[2] = near[1] + 2.0 * inner, -near[2]
        other[3] = near[1:].sum() - other[1] - other[2]
        return other

    found = joint_path(wide, path, T_SITE_MACHINE, start, Orientation.PITCH, bent_the_other_way)
    assert isinstance(found, Unreachable) and found.cause is PathCause.JOINT_END
    assert str(found).endswith("another posture reaches on, a change of branch is needed")


@pytest.mark.parametrize("name", NAMES)
def test_out_of_reach_is_said_at_the_place(name: str) -> None:
    """No joint has an end here, and every posture has less reach than what is beyond that place."""
    machine = MACHINES[name]
    wide = replace(machine, q_min=np.full(machine.n, -np.inf), q_max=np.full(machine.n, np.inf))
    T = pose(wide, machine.home)
    away = T_SITE_MACHINE[:3, 0]
    path = ToolPath.polyline([T[:3, 3], T[:3, 3] + 8.0 * away])
    found = joint_path(wide, path, T_SITE_MACHINE, machine.home, Orientation.FREE, none)
    assert isinstance(found, Unreachable) and found.cause is PathCause.OUT_OF_REACH
    assert f"of {path.length_m:.2f} m: out of reach" in str(found)
    T_machine_site = np.linalg.inv(T_SITE_MACHINE)
    free = [j for j in range(machine.n) if not (name == "brokk5" and j == 1)]

    def nearest(distance: float) -> float:
        """Return how near the tool comes to the path there, from many starts [m]."""
        goal = (T_machine_site @ path.at(distance)[0])[:3, 3]

        def off(some: np.ndarray) -> np.ndarray:
            q = np.array(machine.home)
            q[free] = some
            reached: np.ndarray = wide.tool_pose(wide.forward(q))[:3, 3] - goal
            return reached

        rng = np.random.default_rng(1)
        starts = [machine.home[free], *rng.uniform(-1.5, 1.5, (9, len(free)))]
        return min(float(np.linalg.norm(least_squares(off, start).fun)) for start in starts)

    assert nearest(found.distance_m - 1e-4) < 1e-6
    assert nearest(found.distance_m + 1e-3) > 1e-4
    assert nearest(found.distance_m + 0.05) == pytest.approx(
        float(str(found).split("by ")[1].split(" m")[0]), abs=2e-3
    )


def test_a_path_that_needs_speed_without_bound_is_singular() -> None:
    """The tool passes 0.3 mm beside the swing axis: half a turn of the swing within a millimetre."""
    machine = MACHINES["sun-a"]
    ends = np.array([np.inf, 3.0, 3.0, 3.0])
    wide = replace(machine, q_min=-ends, q_max=ends)
    points = np.array([[2.0, 3e-4, 3.5], [-2.0, 3e-4, 3.5]]) @ T_SITE_MACHINE[:3, :3].T + T_SITE_MACHINE[:3, 3]
    found = joint_path(wide, ToolPath.polyline(points), T_SITE_MACHINE, machine.home, Orientation.FREE, none)
    assert isinstance(found, Unreachable) and found.cause is PathCause.SINGULAR
    assert found.distance_m == pytest.approx(2.0, abs=0.01)


def test_a_pitch_that_is_lost_is_not_called_a_distance() -> None:
    """The demolition robot with arm 1 standing still: the position goes on, the tool's angle does not."""
    machine = MACHINES["brokk5"]
    postures = wandering("brokk5", 1)
    T = np.array([pose(machine, q) for q in postures])
    path = ToolPath.spline(T[:, :3, 3], T[:, :3, :3])
    found = joint_path(machine, path, T_SITE_MACHINE, machine.home, Orientation.PITCH, none)
    assert isinstance(found, Unreachable) and found.cause is PathCause.OUT_OF_REACH
    assert "the position is in reach, not with its orientation, while arm 1 stands still" in str(found)
    there = joint_path(machine, path, T_SITE_MACHINE, machine.home, Orientation.PITCH, lambda *_: postures[0])
    assert isinstance(there, JointPath) and there.curve.q[0] == pytest.approx(postures[0], abs=1e-8)


def test_the_way_to_the_beginning_is_left_to_the_caller_and_said() -> None:
    machine = MACHINES["sun-a"]
    path, start = drawn("sun-a", 5, "spline")
    moved = np.array(start)
    moved[2] -= 0.1
    found = joint_path(machine, path, T_SITE_MACHINE, moved, Orientation.PITCH, none)
    assert isinstance(found, JointPath)
    gap = np.linalg.norm(pose(machine, moved)[:3, 3] - path.points[0])
    assert found.start_gap_m == pytest.approx(gap) and found.start_gap_rad > 0.01
    assert found.curve.q[0] == pytest.approx(start, abs=1e-8)


def test_a_beginning_out_of_reach_is_said() -> None:
    machine = MACHINES["sun-a"]
    path = ToolPath.polyline([[150.0, -20.0, 4.0], [151.0, -20.0, 4.0]])
    found = joint_path(machine, path, T_SITE_MACHINE, machine.home, Orientation.FREE, none)
    assert isinstance(found, Unreachable) and found.distance_m == 0.0
    assert found.cause is PathCause.OUT_OF_REACH
    reach = float(str(found).split("by ")[1].split(" m")[0])
    assert 5.0 < reach < 20.0


def test_bad_input_is_refused() -> None:
    machine = MACHINES["sun-a"]
    path = ToolPath.polyline([[131.0, -20.0, 4.0], [132.0, -20.0, 4.0]])
    nan = np.full(machine.n, math.nan)
    with pytest.raises(InputError, match="q_start"):
        joint_path(machine, path, T_SITE_MACHINE, nan, Orientation.FREE, none)
    with pytest.raises(InputError, match="q_start"):
        joint_path(machine, path, T_SITE_MACHINE, np.zeros(3), Orientation.FREE, none)
    with pytest.raises(InputError, match="T_site_machine"):
        joint_path(machine, path, np.full((4, 4), math.nan), machine.home, Orientation.FREE, none)
    with pytest.raises(InputError, match="orientation"):
        joint_path(machine, path, T_SITE_MACHINE, machine.home, Orientation.PITCH, none)
