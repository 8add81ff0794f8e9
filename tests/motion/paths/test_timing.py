"""A timed path: limits held everywhere, as fast as an independent method finds, and the tool on its path."""

import importlib.util
import itertools
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.motion.ik.task import orientation_of, task_error
from workgauge.motion.paths.joint_path import JointPath, joint_path
from workgauge.motion.paths.timing import Trajectory, default_acceleration, timed, timed_joints
from workgauge.motion.paths.tool_path import ToolPath
from workgauge.values.errors import InputError
from workgauge.values.tasks import Orientation

if importlib.util.find_spec("toppra") is None:
    pytest.skip("toppra is not installed (extra plan)", allow_module_level=True)

NAMES = ("rre20", "brokk5", "sun-a")
KINDS = ("spline", "rounded", "sharp")
MACHINES = {name: load_machine(name) for name in NAMES}
HERE = np.eye(4)
#: Limits hold to this much of them.
SLACK = 1e-6


def none(goal: np.ndarray, orientation: Orientation, near: np.ndarray) -> None:
    """Return no answer: Newton's method alone follows the branch."""


def wandering(name: str, seed: int, legs: int = 3, size: float = 0.3) -> np.ndarray:
    """Return postures near each other, well within the joints' ends, one exclusive group moving."""
    machine, rng = MACHINES[name], np.random.default_rng(seed)
    span = machine.sample_max - machine.sample_min
    postures = [machine.sample_min + rng.uniform(0.35, 0.65, machine.n) * span]
    for _ in range(legs):
        step = rng.uniform(-size, size, machine.n)
        if machine.exclusive_groups:
            step[1] = 0.0
        postures.append(
            np.clip(postures[-1] + step, machine.sample_min + 0.1 * span, machine.sample_max - 0.1 * span)
        )
    return np.array(postures)


def along(name: str, seed: int, kind: str) -> JointPath | None:
    """Return the joints' way along a path drawn through near postures, or None if it leaves the joints' ends."""
    machine, postures = MACHINES[name], wandering(name, seed)
    T = np.array([machine.tool_pose(machine.forward(q)) for q in postures])
    if kind == "spline":
        path = ToolPath.spline(T[:, :3, 3], T[:, :3, :3])
    else:
        path = ToolPath.polyline(T[:, :3, 3], T[:, :3, :3], blend_m=0.05 if kind == "rounded" else 0.0)
    found = joint_path(machine, path, HERE, postures[0], orientation_of(machine), none)
    return found if isinstance(found, JointPath) else None


def assert_held(machine: MachineModel, motion: Trajectory, acceleration: np.ndarray, share: float = 1.0) -> None:
    """Check speeds, flow, accelerations and rest at a fine grid and just beside every time of the trajectory."""
    t = np.linspace(0.0, motion.duration_s, 5001)
    t = np.concatenate([t, motion.times, motion.times[1:] - 1e-9, motion.times[:-1] + 1e-9])
    q, qdot, s = motion.many(t)
    assert (qdot <= share * machine.speed_positive * (1.0 + SLACK)).all()
    assert (qdot >= -share * machine.speed_negative * (1.0 + SLACK)).all()
    assert (np.abs(motion.accelerations(t)) <= acceleration * (1.0 + SLACK)).all()
    assert (q >= machine.q_min).all() and (q <= machine.q_max).all()
    if machine.pump is not None:
        plus = np.maximum(qdot, 0.0) / machine.speed_positive * machine.pump.flow_positive
        minus = np.maximum(-qdot, 0.0) / machine.speed_negative * machine.pump.flow_negative
        assert ((plus + minus).sum(axis=1) <= share * machine.pump.flow * (1.0 + SLACK)).all()
    assert not motion.many([0.0, motion.duration_s])[1].any()
    assert np.all(np.diff(s[:5001]) >= 0.0)


@settings(max_examples=8, deadline=None)
@given(
    st.sampled_from(NAMES),
    st.integers(0, 10**6),
    st.sampled_from(KINDS),
    st.floats(0.05, 3.0),
    st.floats(0.3, 1.0),
)
def test_limits_hold_along_any_path(name: str, seed: int, kind: str, speed: float, share: float) -> None:
    assert_path_held(name, seed, kind, speed, share)


@pytest.mark.prove
def test_limits_hold_along_many_paths() -> None:
    rng = np.random.default_rng(22)
    for seed in range(200):
        kind, name = KINDS[seed % 3], NAMES[seed // 3 % 3]
        assert_path_held(name, 10**6 + seed, kind, float(rng.uniform(0.05, 3.0)), float(rng.uniform(0.3, 1.0)))


def assert_path_held(name: str, seed: int, kind: str, speed: float, share: float) -> None:
    """Check one path, timed: limits, the tool's speed and turning, its place, and standing at corners."""
    machine, way = MACHINES[name], along(name, seed, kind)
    if way is None:
        return
    motion = timed(way, machine, tool_speed_m_s=speed, tool_turn_rad_s=0.4, speed_share=share)
    assert_held(machine, motion, default_acceleration(machine), share)
    t = np.linspace(0.0, motion.duration_s, 400)
    q, qdot, s = motion.many(t)
    twists = np.array([machine.tool_jacobian(machine.forward(a)) @ b for a, b in zip(q, qdot, strict=True)])
    assert np.linalg.norm(twists[:, :3], axis=1).max() <= speed * 1.01  # between knots the tool is 0.2 mm off
    if way.orientation is Orientation.FULL:
        assert np.linalg.norm(twists[:, 3:], axis=1).max() <= 0.4 * 1.01
    goals = way.path.at(s)[0]
    errors = [
        task_error(machine.forward(a), machine, goal, way.orientation) for a, goal in zip(q, goals, strict=True)
    ]
    assert max(float(np.linalg.norm(e[:3])) for e in errors) < 1e-3
    for stop in way.path.stops_m:
        q, qdot, s_there = motion.at(motion.time_of(float(stop)))
        assert np.abs(qdot).max() < 1e-5 and s_there == pytest.approx(stop, abs=1e-9)


@settings(max_examples=8, deadline=None)
@given(st.sampled_from(NAMES), st.integers(0, 10**6), st.integers(1, 6), st.integers(0, 4))
def test_limits_hold_along_any_lines_whichever_corners_are_rounded(
    name: str, seed: int, legs: int, tried: int
) -> None:
    machine, postures = MACHINES[name], wandering(name, seed, legs, 0.5)
    asked: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def kept(*corner: np.ndarray) -> bool:
        """Allow of each corner the rounding tried at last, of every third none."""
        asked.append(corner)
        place = int(np.flatnonzero((postures == corner[1]).all(axis=1))[0])
        return place % 3 > 0 and sum(np.array_equal(one[1], corner[1]) for one in asked) > tried

    motion = timed_joints(postures, machine, kept=kept)
    assert_held(machine, motion, default_acceleration(machine))
    t = np.linspace(0.0, motion.duration_s, 2001)
    q = motion.many(t)[0]
    low, high = np.minimum(postures[:-1], postures[1:]), np.maximum(postures[:-1], postures[1:])
    assert (q >= low.min(axis=0) - 1e-9).all() and (q <= high.max(axis=0) + 1e-9).all()
    rounds = [corner for k, corner in enumerate(asked) if k + 1 == len(asked) or asked[k + 1][1] is not corner[1]]
    assert from_way(q[::8], postures, rounds) < 1e-9
    for place in range(1, legs):
        if place % 3 == 0:
            knot = np.abs(motion.curve.q - postures[place]).max(axis=1).argmin()
            stood = motion.at(motion.time_of(float(motion.curve.s[knot])))
            assert stood[0] == pytest.approx(postures[place], abs=1e-9) and np.abs(stood[1]).max() < 1e-5
    h = 1e-6
    inside = t[(t > h) & (t < motion.duration_s - h)]
    difference = (motion.many(inside + h)[0] - motion.many(inside - h)[0]) / (2.0 * h)
    assert difference == pytest.approx(motion.many(inside)[1], abs=1e-4)


def from_way(q: np.ndarray, postures: np.ndarray, rounds: list[tuple[np.ndarray, ...]]) -> float:
    """Return how far postures (k, n) are from straight lines and parabolas, each by its own least distance."""
    x = np.linspace(0.0, 1.0, 401)[:, None]
    worst = np.full(len(q), np.inf)
    for a, b in itertools.pairwise(postures):
        share = np.clip((q - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        worst = np.minimum(worst, np.linalg.norm(q - a - share[:, None] * (b - a), axis=1))
    for a, corner, b in rounds:
        curve = (1.0 - x) ** 2 * a + 2.0 * x * (1.0 - x) * corner + x**2 * b
        near = np.linalg.norm(q[:, None] - curve, axis=2)
        spacing = np.linalg.norm(np.diff(curve, axis=0), axis=1).max()
        worst = np.minimum(worst, np.maximum(near.min(axis=1) - spacing, 0.0))
    return float(worst.max())


@pytest.mark.parametrize("name", NAMES)
def test_one_joint_alone_takes_the_time_of_the_textbook(name: str) -> None:
    """Ramp up, hold, ramp down: `d / v + v / a`, or `2 sqrt(d / a)` where it never comes to full speed."""
    machine = MACHINES[name]
    acceleration = default_acceleration(machine)
    for joint, turn in ((0, 1.5), (0, -0.05), (2, -0.3)):
        goal = np.array(machine.home)
        goal[joint] += turn
        speed = (machine.speed_positive if turn > 0.0 else machine.speed_negative)[joint]
        if machine.pump is not None:
            flow = (machine.pump.flow_positive if turn > 0.0 else machine.pump.flow_negative)[joint]
            speed = speed * min(1.0, machine.pump.flow / flow)
        a, way = acceleration[joint], abs(turn)
        expected = way / speed + speed / a if way > speed**2 / a else 2.0 * math.sqrt(way / a)
        assert timed_joints([machine.home, goal], machine).duration_s == pytest.approx(expected, rel=5e-3)


def oracle(way: JointPath, machine: MachineModel, speed: float, count: int) -> float:
    """Return the least time [s] by a linear programme over the rate squared at `count` + 1 places.

    Its slopes and bends are differences of postures found by Newton's method at each place: it shares neither the
    joints' curve nor the solver. The highest profile is the fastest, so the sum of the squared rates is maximised.
    """
    s = np.linspace(0.0, way.length_m, count + 1)
    h = way.length_m / count / 4.0
    q = []
    for place in np.clip(s[:, None] + np.array([-h, 0.0, h]), 0.0, way.length_m).ravel():
        posture = way.curve.at(np.array([place]))[0][0]
        goal = way.path.at(place)[0]
        for _ in range(4):
            kin = machine.forward(posture)
            J = machine.tool_jacobian(kin)
            error = np.concatenate([task_error(kin, machine, goal, Orientation.FULL)])
            posture = posture + np.linalg.lstsq(J, error, rcond=1e-9)[0]
        q.append(posture)
    three = np.reshape(q, (count + 1, 3, machine.n))
    slope = (three[:, 2] - three[:, 0]) / (2.0 * h)
    bend = (three[:, 2] - 2.0 * three[:, 1] + three[:, 0]) / h**2
    slope[[0, -1]], bend[[0, -1]] = slope[[1, -2]], bend[[1, -2]]
    used = np.maximum(slope / machine.speed_positive, -slope / machine.speed_negative).max(axis=1)
    if machine.pump is not None:
        shares = np.maximum(slope, 0.0) / machine.speed_positive * machine.pump.flow_positive
        shares = shares + np.maximum(-slope, 0.0) / machine.speed_negative * machine.pump.flow_negative
        used = np.maximum(used, shares.sum(axis=1) / machine.pump.flow)
    highest = np.minimum(np.minimum(speed, 1.0 / used) ** 2, 1.0 / np.maximum(way.path.curvature(s), 1e-9))
    limits = default_acceleration(machine)
    rows, step = [], way.length_m / count
    for i in range(count):
        middle_slope, middle_bend = 0.5 * (slope[i] + slope[i + 1]), 0.5 * (bend[i] + bend[i + 1])
        for coefficient, sway in zip(middle_slope / limits, middle_bend / limits, strict=True):
            row = np.zeros(count + 1)
            row[i], row[i + 1] = 0.5 * sway - coefficient / (2.0 * step), 0.5 * sway + coefficient / (2.0 * step)
            rows += [row, -row]
        row = np.zeros(count + 1)
        row[i], row[i + 1] = -1.0 / (2.0 * step), 1.0 / (2.0 * step)
        rows += [row, -row]
    bounds = [(0.0, 0.0 if i in (0, count) else float(top)) for i, top in enumerate(highest)]
    found = linprog(-np.ones(count + 1), A_ub=np.array(rows), b_ub=np.ones(len(rows)), bounds=bounds)
    assert found.status == 0
    rate = np.sqrt(np.maximum(found.x, 0.0))
    return float((2.0 * step / (rate[1:] + rate[:-1])).sum())


@pytest.mark.parametrize(("seed", "speed"), [(1, 0.3), (3, 3.0)])
def test_no_slower_than_a_linear_programme(seed: int, speed: float) -> None:
    machine, way = MACHINES["rre20"], along("rre20", seed, "spline")
    assert way is not None
    motion = timed(way, machine, tool_speed_m_s=speed, tool_acceleration_m_s2=1.0)
    least = oracle(way, machine, speed, 100)
    print(f"seed {seed}: {motion.duration_s:.3f} s, linear programme {least:.3f} s")
    assert 0.99 * least < motion.duration_s < 1.02 * least


def line(machine: MachineModel, length: float) -> JointPath:
    """Return the way along a straight line towards the machine from its home posture."""
    T = machine.tool_pose(machine.forward(machine.home))
    path = ToolPath.polyline([T[:3, 3], T[:3, 3] - length * np.array([1.0, 0.0, 0.0])], T[:3, :3])
    found = joint_path(machine, path, HERE, machine.home, orientation_of(machine), none)
    assert isinstance(found, JointPath)
    return found


def test_the_tool_goes_at_its_speed_wherever_the_machine_can() -> None:
    machine = MACHINES["rre20"]
    motion = timed(line(machine, 1.5), machine, tool_speed_m_s=0.3)
    t = np.linspace(0.0, motion.duration_s, 2001)
    q, qdot, s = motion.many(t)
    speeds = [
        np.linalg.norm((machine.tool_jacobian(machine.forward(a)) @ b)[:3]) for a, b in zip(q, qdot, strict=True)
    ]
    at_speed = np.abs(np.array(speeds) - 0.3) < 0.3 * 0.01
    share = np.diff(s)[at_speed[1:]].sum() / motion.s[-1]
    ramps = 2.0 * 0.3**2 / (2.0 * 1.0) / 1.5
    print(f"{share:.3f} of the length at 0.3 m/s, {1.0 - ramps:.3f} without the ramps")
    assert share > 1.0 - ramps - 0.005
    assert motion.duration_s == pytest.approx(1.5 / 0.3 + 0.3 / 1.0, rel=2e-3)


def test_the_pump_slows_what_joints_alone_could_do() -> None:
    machine = MACHINES["rre20"]
    assert machine.pump is not None
    goal = np.clip(machine.home + np.array([1.5, 0.5, -0.8, -0.5, 0.2, 1.0]), machine.q_min, machine.q_max)
    motion = timed_joints([machine.home, goal], machine)
    without = timed_joints([machine.home, goal], replace(machine, pump=None))
    assert motion.duration_s > 1.02 * without.duration_s
    qdot = motion.many(np.linspace(0.0, motion.duration_s, 500))[1]
    plus = np.maximum(qdot, 0.0) / machine.speed_positive * machine.pump.flow_positive
    minus = np.maximum(-qdot, 0.0) / machine.speed_negative * machine.pump.flow_negative
    assert (plus + minus).sum(axis=1).max() == pytest.approx(machine.pump.flow, rel=0.01)


def test_a_share_of_the_speed_is_the_same_way_slower() -> None:
    machine = MACHINES["sun-a"]
    motion = timed_joints(wandering("sun-a", 4), machine)
    slow = motion.scaled(0.5)
    assert slow.duration_s == pytest.approx(2.0 * motion.duration_s)
    t = np.linspace(0.0, motion.duration_s, 50)
    assert slow.many(2.0 * t)[0] == pytest.approx(motion.many(t)[0], abs=1e-9)
    assert slow.many(2.0 * t)[1] == pytest.approx(0.5 * motion.many(t)[1], abs=1e-9)
    assert [motion.time_of(motion.at(float(one))[2]) for one in t] == pytest.approx(t, abs=1e-6)
    read = json.loads(json.dumps(motion.plain()))
    assert read["duration_s"] == motion.duration_s and np.array(read["q"]) == pytest.approx(motion.q)
    before, after = motion.at(-1.0), motion.at(1e9)
    assert before[0] == pytest.approx(motion.q[0]) and after[0] == pytest.approx(motion.q[-1])
    assert not before[1].any() and not after[1].any()


def test_joints_that_cannot_move_together_are_refused() -> None:
    machine = MACHINES["brokk5"]
    both = np.array(machine.home)
    both[:2] += 0.1
    with pytest.raises(InputError, match="cannot move together"):
        timed_joints([machine.home, both], machine)
    first = np.array(machine.home)
    first[0] += 0.1
    motion = timed_joints([machine.home, first, both], machine)
    qdot = motion.many(np.linspace(0.0, motion.duration_s, 500))[1]
    assert not (qdot[:, 0] * qdot[:, 1]).any()


@pytest.mark.parametrize(
    ("waypoints", "says"),
    [
        ([], "no way"),
        ([[0.0, 0.3, -0.6, 0.0]], "no way"),
        ([[0.0, 0.3], [0.1, 0.3]], "no way"),
        ([[0.0, 0.3, -0.6, 0.0], [0.0]], "not numbers"),
        ([[0.0, 0.3, -0.6, 0.0]] * 2, "waypoint 1.*repeats"),
        ([[0.0, 0.3, -0.6, 0.0], [math.nan, 0.3, -0.6, 0.0]], "waypoint 1.*not finite"),
        ([[0.0, 0.3, -0.6, 0.0], [0.0, 3.0, -0.6, 0.0]], "waypoint 1, boom.*beyond"),
    ],
)
def test_waypoints_that_are_no_way_are_refused(waypoints, says) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match=says):
        timed_joints(waypoints, MACHINES["sun-a"])


def test_limits_that_are_none_are_refused() -> None:
    machine = MACHINES["sun-a"]
    way = line(machine, 0.2)
    for wrong in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(InputError, match="tool_speed_m_s"):
            timed(way, machine, tool_speed_m_s=wrong)
        with pytest.raises(InputError, match="tool_turn_rad_s"):
            timed(way, machine, tool_speed_m_s=0.3, tool_turn_rad_s=wrong)
        with pytest.raises(InputError, match="acceleration"):
            timed(way, machine, tool_speed_m_s=0.3, acceleration=np.full(4, wrong))
        with pytest.raises(InputError, match="share"):
            timed(way, machine, tool_speed_m_s=0.3).scaled(wrong)
    for share in (0.0, 1.1, math.nan):
        with pytest.raises(InputError, match="speed_share"):
            timed(way, machine, tool_speed_m_s=0.3, speed_share=share)
    with pytest.raises(InputError, match="another machine"):
        timed(way, MACHINES["rre20"], tool_speed_m_s=0.3)
    with pytest.raises(InputError, match="acceleration"):
        timed(way, machine, tool_speed_m_s=0.3, acceleration=np.ones(3))
    with pytest.raises(InputError, match="time"):
        timed(way, machine, tool_speed_m_s=0.3).at(math.nan)
