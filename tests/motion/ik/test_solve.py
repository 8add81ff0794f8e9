"""Iterating to a goal: within limits at every step, to a millimetre, or a true statement of why not."""

import functools
import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

import workgauge.motion.ik.solve as solver
from workgauge.machine.load import description_path, machine_from
from workgauge.machine.model import MachineModel
from workgauge.motion.ik.solve import Solved, SolveSettings, solve, turns
from workgauge.motion.ik.task import orientation_of, task_error
from workgauge.motion.stuck import Cause, beyond_reach
from workgauge.values.errors import InputError
from workgauge.values.tasks import Orientation

EVERY = ("rre20", "brokk5", "rre20/4")
PITCH = Orientation.PITCH
TENTH = math.radians(0.1)
seeds = st.integers(0, 10**6)


@functools.cache
def machine_named(name: str, widened: str = "") -> MachineModel:
    """A shipped machine, or with `/k` its first k joints alone; one joint's limits, or `all`, 20 degrees wider,
    or all `free`."""
    shipped, _, joints = name.partition("/")
    content = yaml.safe_load(description_path(shipped).read_text())
    content.pop("positioning", None)
    content["sensors"] = []
    content["joints"] = content["joints"][: int(joints or 9)]
    for joint in content["joints"]:
        if widened in (joint["name"], "all") and "lower_deg" in joint:
            joint["lower_deg"], joint["upper_deg"] = max(joint["lower_deg"] - 20, -175), joint["upper_deg"] + 20
        if widened == "free" and "lower_deg" in joint:
            joint["lower_deg"], joint["upper_deg"] = -175, 175
    return machine_from(content, shipped)


def pair(machine: MachineModel, draw: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A start, and the tool's pose at another posture within the limits."""
    start, there = draw.uniform(machine.sample_min, machine.sample_max, (2, machine.n))
    return start, machine.tool_pose(machine.forward(there))


def statement_is_true(machine: MachineModel, found: Solved, goal: np.ndarray, orientation: Orientation) -> bool:
    """Judge by small motions alone: moving on, no joint may do much for the error but those named to be at limits."""

    def size(q: np.ndarray) -> float:
        return float(np.linalg.norm(task_error(machine.forward(q), machine, goal, orientation)))

    here, step = size(found.q), 1e-5
    if found.cause not in (Cause.JOINT_LIMIT, Cause.SINGULAR):
        return False
    slopes = np.array(
        [(size(found.q + step * d) - size(found.q - step * d)) / (2.0 * step) for d in np.eye(machine.n)]
    )
    stopped = (found.q >= machine.q_max - 1e-5) & (slopes < 0.0) | (found.q <= machine.q_min + 1e-5) & (slopes > 0.0)
    named = np.array([f"{joint} is at its" in found.why for joint in machine.joint_names])
    most = np.linalg.norm(machine.tool_jacobian(machine.forward(found.q)), 2)  # per joint motion, of any direction
    only_named = bool(np.all(stopped[named])) and (found.cause is Cause.JOINT_LIMIT) == bool(named.any())
    return here > 0.0 and only_named and float(np.linalg.norm(slopes[~named])) < 0.05 * float(most)


@pytest.mark.parametrize("name", EVERY)
def test_goals_are_reached_or_it_is_said_why_not(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    machine, draw = machine_named(name), np.random.default_rng(11)
    orientation, step = orientation_of(machine), solver.clik_velocity
    within, iterates = [], []

    def watched(machine, kin, *others, dt_s, **more):  # type: ignore[no-untyped-def]
        qdot, memory, facts = step(machine, kin, *others, dt_s=dt_s, **more)
        moved = kin.q + dt_s * qdot
        within.append(bool(np.all(moved <= machine.q_max + 1e-12) and np.all(moved >= machine.q_min - 1e-12)))
        return qdot, memory, facts

    def seen(kin, *others):  # type: ignore[no-untyped-def]
        iterates.append(kin.q)
        return task_error(kin, *others)

    monkeypatch.setattr(solver, "clik_velocity", watched)
    monkeypatch.setattr(solver, "task_error", seen)
    reached = 0
    for _ in range(60):
        start, goal = pair(machine, draw)
        found = solve(machine, start, goal, orientation)
        off = task_error(machine.forward(found.q), machine, goal, orientation)
        assert np.allclose(off, found.error, atol=1e-9)
        close = bool(np.linalg.norm(off[:3]) <= 1e-3 and np.linalg.norm(off[3:]) <= TENTH)
        assert found.converged == close == (found.cause is Cause.REACHED) == (found.why == "")
        assert found.converged or statement_is_true(machine, found, goal, orientation)
        assert np.all(np.abs((found.q - start)[machine.continuous]) <= math.pi + 1e-9)
        reached += found.converged
    assert reached >= (40 if name == "brokk5" else 56)
    assert all(within) and len(within) > 300
    assert all(np.all(q <= machine.q_max) and np.all(q >= machine.q_min) for q in iterates)


@pytest.mark.prove
@pytest.mark.parametrize(
    ("name", "first", "restarted"), [("rre20", 0.96, 0.999), ("brokk5", 0.75, 0.998), ("rre20/4", 0.96, 0.999)]
)
def test_ten_thousand_pairs(name: str, first: float, restarted: float, tmp_path: Path) -> None:
    machine, draw, journal = machine_named(name), np.random.default_rng(2026), tmp_path / "pairs.jsonl"
    orientation, count = orientation_of(machine), 10_000
    reached = again = untrue = 0
    with journal.open("w") as lines:
        for number in range(count):
            start, goal = pair(machine, draw)
            found = solve(machine, start, goal, orientation)
            reached += found.converged
            if not found.converged:
                untrue += not statement_is_true(machine, found, goal, orientation)
                later = solve(machine, start, goal, orientation, SolveSettings(restarts=10))
                again += later.converged
                untrue += not (later.converged or statement_is_true(machine, later, goal, orientation))
                lines.write(json.dumps([number, found.why, later.why]) + "\n")
            assert np.all(found.q <= machine.q_max) and np.all(found.q >= machine.q_min)
    print(f"{name}: {reached} of {count} reached, {reached + again} with ten restarts, {untrue} untrue; {journal}")
    assert untrue <= 0.001 * count
    assert reached >= first * count
    assert reached + again >= restarted * count


@pytest.mark.parametrize("name", [*EVERY, "sun-a"])
@settings(max_examples=25, deadline=None)
@given(seeds)
def test_what_is_reached_is_not_called_out_of_reach(name: str, seed: int) -> None:
    machine = machine_named(name, "all")
    assert beyond_reach(machine, pair(machine, np.random.default_rng(seed))[1]) <= 1e-9


def test_out_of_reach_says_by_how_much() -> None:
    machine = machine_named("brokk5")
    arm = 1.05 + 1.05 + 0.8 + 0.25 + 0.9  # straight out at the height of its foot, 0.12 m out and 0.85 m up
    goal = machine.tool_pose(machine.forward([0.7, 0, 0, 0, 0]))
    assert beyond_reach(machine, goal) == pytest.approx(0.0, abs=1e-9)
    goal[:2, 3] *= (0.12 + arm + 0.43) / (0.12 + arm)
    found = solve(machine, machine.home, goal, PITCH)
    assert found.cause is Cause.OUT_OF_REACH and not found.converged
    assert "at least 0.430 m beyond" in found.why
    assert found.error[:3] @ goal[:3, 3] > 0.0  # it went as far as it could
    assert float(np.linalg.norm(found.error[:3])) < 0.6


def test_the_joint_whose_limit_is_in_the_way_is_named() -> None:
    machine, wider = machine_named("rre20/4"), machine_named("rre20/4", "boom")
    q = np.array(machine.home)
    q[1] = machine.q_max[1] + 0.2
    found = solve(machine, machine.home, machine.tool_pose(machine.forward(q)), PITCH)
    assert found.cause is Cause.JOINT_LIMIT and "boom is at its upper limit of 65.0 deg" in found.why
    assert solve(wider, machine.home, machine.tool_pose(machine.forward(q)), PITCH).converged


def test_a_singular_direction_is_said() -> None:
    machine = machine_named("brokk5", "free")
    # the coupler 0.3 m beyond what arm 1 to 3 can reach together, the tool hanging straight down from there
    goal = machine.tool_pose(machine.forward([0.3, 0.0, 0.0, 0.0, -math.pi / 2]))
    goal[:2, 3] += 0.3 * np.array([math.cos(0.3), math.sin(0.3)])
    assert beyond_reach(machine, goal) < -0.3
    found = solve(machine, [0.5, 0.4, -0.5, -0.5, -1.0], goal, PITCH)
    assert found.cause is Cause.SINGULAR and "singular: from here the joints cannot" in found.why
    assert statement_is_true(machine, found, goal, PITCH)
    in_line = found.q[1:4].tolist()
    assert in_line[1] == pytest.approx(0.0, abs=0.1) and in_line[2] == pytest.approx(0.0, abs=0.1)


def test_restarts_find_what_the_first_start_does_not_and_always_the_same() -> None:
    machine, draw = machine_named("brokk5"), np.random.default_rng(4)
    failed = []
    while len(failed) < 6:
        start, goal = pair(machine, draw)
        if not solve(machine, start, goal, PITCH).converged:
            failed.append((start, goal))
    found = [[solve(machine, *case, PITCH, SolveSettings(restarts=10)) for case in failed] for _ in range(2)]
    assert sum(one.converged for one in found[0]) >= 5
    assert all(np.array_equal(a.q, b.q) for a, b in zip(*found, strict=True))


def test_one_group_at_a_time_reaches_what_is_near() -> None:
    machine = machine_named("brokk5")
    near = machine.tool_pose(machine.forward(machine.home + np.array([0.2, 0.0, -0.2, 0.1, 0.1])))
    assert solve(machine, machine.home, near, PITCH, SolveSettings(exclusive=True)).converged


@settings(max_examples=40, deadline=None)
@given(seeds)
def test_turns_move_one_group_each_and_end_at_the_goal(seed: int) -> None:
    machine, draw = machine_named("brokk5"), np.random.default_rng(seed)
    a, b = draw.uniform(machine.sample_min, machine.sample_max, (2, machine.n))
    way = turns(machine, a, b)
    assert np.array_equal(way[0], a) and np.array_equal(way[-1], b)
    for before, after in itertools.pairwise(way):
        moved = set(np.flatnonzero(before != after))
        assert moved and any(moved <= set(group) for group in machine.exclusive_groups)
    assert np.all(way <= np.maximum(a, b)) and np.all(way >= np.minimum(a, b))
    assert len(turns(machine, a, a)) == 1


@pytest.mark.parametrize("fault", ["nan", "shape", "mirror", "scale", "start"])
def test_what_is_no_pose_or_posture_is_refused(fault: str) -> None:
    machine = machine_named("brokk5")
    goal, start = np.array(machine.tool_pose(machine.forward(machine.home))), np.array(machine.home)
    if fault == "nan":
        goal[0, 3] = math.nan
    elif fault == "shape":
        goal = goal[:3]
    elif fault == "mirror":
        goal[:3, 0] *= -1.0
    elif fault == "scale":
        goal[:3, :3] *= 1.01
    else:
        start = start[:3]
    with pytest.raises(InputError, match="q_start" if fault == "start" else "T_machine_goal"):
        solve(machine, start, goal, PITCH)


@pytest.mark.parametrize("setting", ["step_s", "iterations", "patience", "tolerance_m", "tolerance_rad", "restarts"])
def test_settings_out_of_range_are_refused(setting: str) -> None:
    with pytest.raises(InputError, match=setting):
        SolveSettings(**{setting: -1})
