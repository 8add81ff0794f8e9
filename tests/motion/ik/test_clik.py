"""One step of the closed-loop inverse kinematics: Lee 6-9, joint limits, speeds, groups, singular postures."""

import functools
import math
from collections.abc import Callable

import numpy as np
import pytest
import yaml
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq, lsq_linear

from workgauge.machine.load import description_path, machine_from
from workgauge.machine.model import MachineModel
from workgauge.motion.ik.clik import ClikGains, ClikMemory, clik_velocity, movable_groups
from workgauge.motion.ik.task import ROWS, orientation_of, task_error, task_jacobian
from workgauge.motion.ik.weighted import joint_weights, least_velocity, limit_gradient, manipulability
from workgauge.values.errors import InputError
from workgauge.values.tasks import Orientation

EVERY = ("rre20", "brokk5", "sun-a", "rre20/4")
FULL, PITCH, FREE = Orientation.FULL, Orientation.PITCH, Orientation.FREE
UNDAMPED = ClikGains(damping=0.0, posture_1_s=0.0)
seeds = st.integers(0, 10**6)
examples = settings(max_examples=15, deadline=None)


@functools.cache
def machine_named(name: str, wide: bool = False) -> MachineModel:
    """A shipped machine, or with `/k` its first k joints alone; with limits that let it into every singularity."""
    shipped, _, joints = name.partition("/")
    content = yaml.safe_load(description_path(shipped).read_text())
    content.pop("positioning", None)
    content["sensors"] = []
    content["joints"] = content["joints"][: int(joints or 9)]
    for joint in content["joints"]:
        if wide and "lower_deg" in joint:
            joint["lower_deg"], joint["upper_deg"] = -175, 175
    return machine_from(content, shipped)


def random_case(name: str, seed: int) -> tuple[MachineModel, np.ndarray, Orientation, np.random.Generator]:
    machine, draw = machine_named(name), np.random.default_rng(seed)
    q = draw.uniform(machine.sample_min, machine.sample_max)
    at = draw.random(machine.n) < 0.5  # some joints at an end
    ends = np.where(draw.random(machine.n) < 0.5, machine.q_min, machine.q_max)
    q = np.where(at & np.isfinite(ends), ends, q)
    return machine, q, (orientation_of(machine), FREE, PITCH)[draw.integers(3)], draw


# --- the weighted inverse


@settings(max_examples=100, deadline=None)
@given(st.floats(-3.0, 0.5), st.floats(0.2, 3.0), st.floats(0.01, 0.99))
def test_the_gradient_is_that_of_the_printed_function(low: float, span: float, share: float) -> None:
    def H(q: float) -> float:
        return span**2 / (4.0 * (low + span - q) * (q - low))

    q, h = low + share * span, 1e-6 * span
    found = float(limit_gradient(np.array([q]), np.array([low]), np.array([low + span]))[0])
    assert found == pytest.approx((H(q + h) - H(q - h)) / (2.0 * h), rel=1e-4, abs=1e-4)


def test_beyond_a_limit_nothing_inverts() -> None:
    low, high = np.full(5, -1.0), np.full(5, 1.0)
    gradient = limit_gradient(np.array([-1.3, -1.0, 0.0, 1.0, 1.3]), low, high)
    assert gradient[0] == gradient[1] < -1e4 and gradient[2] == 0.0 and gradient[3] == gradient[4] > 1e4
    assert limit_gradient(np.array([50.0]), np.array([-np.inf]), np.array([np.inf]))[0] == 0.0


def test_a_joint_that_stands_is_as_expensive_as_one_that_goes_on() -> None:
    assert joint_weights(np.array([3.0, 3.0, -3.0]), np.array([True, False, True])).tolist() == [4.0, 1.0, 4.0]


@examples
@given(seeds, st.sampled_from([(3, 5), (4, 4), (6, 6), (4, 1)]), st.floats(0.05, 0.5))
def test_the_velocity_is_lees_formula_and_its_weights_agree_with_it(
    seed: int, shape: tuple[int, int], damping: float
) -> None:
    draw = np.random.default_rng(seed)
    J, wanted, gradient = draw.normal(size=shape), draw.normal(size=shape[0]), draw.normal(size=shape[1]) * 20.0
    qdot = least_velocity(J, wanted, gradient, damping)
    inverse = np.diag(1.0 / joint_weights(gradient, qdot * gradient >= 0.0))
    printed = inverse @ J.T @ np.linalg.inv(J @ inverse @ J.T + damping**2 * np.eye(shape[0])) @ wanted
    assert np.allclose(qdot, printed, atol=1e-9 * (1.0 + np.abs(qdot).max()))

    def cost(x: np.ndarray) -> float:
        weights = joint_weights(gradient, x * gradient >= 0.0)
        return float(np.sum((J @ x - wanted) ** 2) + damping**2 * np.sum(weights * x**2))

    for _ in range(20):
        assert cost(qdot) <= cost(qdot + draw.normal(size=shape[1]) * 10.0 ** draw.uniform(-5, 0)) + 1e-12


@examples
@given(seeds)
def test_manipulability_is_the_printed_determinant(seed: int) -> None:
    draw = np.random.default_rng(seed)
    J, gradient = draw.normal(size=(4, 5)), draw.normal(size=5) * 5.0
    W = np.diag(1.0 + np.abs(gradient))
    assert manipulability(J, gradient, 4) == pytest.approx(np.sqrt(np.linalg.det(J @ np.linalg.inv(W) @ J.T)))


# --- the step


@pytest.mark.parametrize("name", EVERY)
@settings(max_examples=30, deadline=None)
@given(seeds, st.sampled_from([0.01, 0.02, 0.1, 1.0]), st.sampled_from([1e-3, 0.1, 10.0]))
def test_no_speed_is_exceeded_no_limit_crossed_no_group_joined(
    name: str, seed: int, dt_s: float, size: float
) -> None:
    machine, q, orientation, draw = random_case(name, seed)
    error, forward = draw.normal(size=(2, ROWS[orientation])) * size
    memory = ClikMemory(int(draw.integers(-1, 3)))
    qdot, memory, facts = clik_velocity(
        machine, machine.forward(q), error, forward, memory, ClikGains(), orientation, dt_s=dt_s
    )
    slack = 1.0 + 1e-12
    assert np.all(qdot <= slack * machine.speed_positive) and np.all(-qdot <= slack * machine.speed_negative)
    assert np.all(q + dt_s * qdot <= machine.q_max + 1e-12) and np.all(q + dt_s * qdot >= machine.q_min - 1e-12)
    moving = dict(movable_groups(machine))[memory.group]
    assert not qdot[[j for j in range(machine.n) if j not in moving]].any()
    assert 0.0 <= facts.missed <= 1.0 and 0.0 <= facts.scale <= 1.0


@pytest.mark.parametrize("name", EVERY)
@examples
@given(seeds, st.sampled_from([0.01, 3.0]))
def test_away_from_limits_and_singularities_the_tool_does_what_it_is_told(name: str, seed: int, size: float) -> None:
    machine, draw = machine_named(name), np.random.default_rng(seed)
    share = draw.uniform(0.2, 0.8, machine.n)
    q = machine.sample_min + share * (machine.sample_max - machine.sample_min)
    orientation, gains = orientation_of(machine), ClikGains(linear_1_s=1.5, angular_1_s=0.7)
    kin = machine.forward(q)
    error, forward = draw.normal(size=(2, ROWS[orientation])) * size
    memory = ClikMemory(len(machine.exclusive_groups) - 1)
    qdot, _, facts = clik_velocity(machine, kin, error, forward, memory, gains, orientation, dt_s=0.02)
    assume(facts.damping == 0.0 and not facts.held)
    K = np.where(np.arange(len(error)) < 3, 1.5, 0.7)
    moved = task_jacobian(kin, machine, orientation) @ qdot
    assert np.allclose(moved, facts.scale * (forward + K * error), atol=1e-9 * (1.0 + size))
    assert facts.missed < 1e-9


@pytest.mark.parametrize(("name", "orientation"), [("rre20", PITCH), ("rre20", FREE), ("brokk5", FREE)])
@examples
@given(seeds)
def test_the_drift_is_not_felt_and_leads_to_the_middle(name: str, orientation: Orientation, seed: int) -> None:
    machine, draw = machine_named(name), np.random.default_rng(seed)
    q = draw.uniform(machine.sample_min, machine.sample_max)
    kin, error, still = machine.forward(q), draw.normal(size=ROWS[orientation]) * 0.01, np.zeros(ROWS[orientation])
    speeds = [
        clik_velocity(machine, kin, error, still, ClikMemory(1), ClikGains(posture_1_s=rate), orientation, dt_s=0.02)[
            0
        ]
        for rate in (0.0, 0.5)
    ]
    J, drift = task_jacobian(kin, machine, orientation), speeds[1] - speeds[0]
    assert np.allclose(J @ drift, 0.0, atol=1e-9)
    middle = np.where(machine.continuous, q, 0.5 * (machine.sample_min + machine.sample_max))
    assert drift @ (middle - q) >= -1e-12


@pytest.mark.parametrize("name", EVERY)
@examples
@given(seeds)
@example(77)
@example(86)
@example(31)  # a joint is held, and let go again
def test_at_limits_the_tool_gives_way_as_little_as_possible(name: str, seed: int) -> None:
    machine, q, orientation, draw = random_case(name, seed)
    wanted = draw.normal(size=ROWS[orientation]) * 1e-3
    kin, still = machine.forward(q), np.zeros(ROWS[orientation])
    qdot, memory, facts = clik_velocity(machine, kin, still, wanted, ClikMemory(), UNDAMPED, orientation, dt_s=0.02)
    joints = list(dict(movable_groups(machine))[memory.group])
    J = task_jacobian(kin, machine, orientation)
    assume(np.linalg.svd(J[:, joints], compute_uv=False)[-1] > 1e-2)
    low, high = np.minimum((machine.q_min - q) / 0.02, 0.0), np.maximum((machine.q_max - q) / 0.02, 0.0)
    bounds = (np.maximum(low, -9.0)[joints] - 1e-12, np.minimum(high, 9.0)[joints] + 1e-12)
    best = lsq_linear(J[:, joints], wanted * facts.scale, bounds, tol=1e-14)
    missed = float(np.linalg.norm(J @ qdot - wanted * facts.scale))
    assert missed <= math.sqrt(2.0 * best.cost) + 1e-3 * float(np.linalg.norm(wanted))
    assert facts.missed == pytest.approx(missed / max(np.linalg.norm(wanted) * facts.scale, 1e-12), abs=1e-6)


def test_a_joint_at_its_limit_stays_there_and_is_named_and_is_free_to_leave() -> None:
    machine = machine_named("rre20/4")
    q = np.array([0.3, 0.4, machine.q_max[2], -1.0])
    kin, still = machine.forward(q), np.zeros(4)
    outwards = task_jacobian(kin, machine, PITCH) @ np.array([0.0, 0.0, 0.01, 0.0])
    for sign, expected in ((1.0, (2,)), (-1.0, ())):
        qdot, _, facts = clik_velocity(machine, kin, still, sign * outwards, ClikMemory(), UNDAMPED, PITCH, dt_s=0.02)
        assert facts.held == expected
        assert qdot[2] == pytest.approx(min(sign * 0.01, 0.0))
        assert (facts.missed > 0.01) == bool(expected)


def test_a_joint_beyond_its_limit_may_come_back_only() -> None:
    machine = machine_named("rre20/4")
    q = np.array(machine.home)
    q[1] = machine.q_max[1] + 0.02
    kin = machine.forward(q)
    for seed in range(20):
        wanted = np.random.default_rng(seed).normal(size=4)
        qdot = clik_velocity(machine, kin, 0 * wanted, wanted, ClikMemory(), ClikGains(), PITCH, dt_s=0.02)[0]
        assert qdot[1] <= 0.0


def test_the_group_that_misses_least_moves_and_keeps_its_turn() -> None:
    machine = machine_named("brokk5")
    kin, still = machine.forward(machine.home), np.zeros(4)
    J = task_jacobian(kin, machine, PITCH)
    along_arm_1, sideways = 0.02 * J[:, 1], 0.02 * J[:, 0]
    for before, wanted, expected in ((0, along_arm_1, 0), (1, along_arm_1, 1), (0, sideways, 1), (-1, sideways, 1)):
        qdot, memory, _ = clik_velocity(
            machine, kin, still, wanted, ClikMemory(before), ClikGains(), PITCH, dt_s=0.02
        )
        assert memory.group == expected
        assert (qdot[1] == 0.0) == (expected == 1)


@pytest.mark.parametrize("name", ["rre20", "brokk5", "rre20/4"])
def test_the_loop_works_an_error_off_as_its_gain_says(name: str) -> None:
    machine, gains = machine_named(name), ClikGains(posture_1_s=0.0)
    orientation = orientation_of(machine)
    goal = machine.tool_pose(machine.forward(machine.home + 0.02 * np.array([1, 0, -1, 1, 0.5, 1])[: machine.n]))
    q, memory, sizes = np.array(machine.home), ClikMemory(len(machine.exclusive_groups) - 1), []
    for _ in range(150):
        kin = machine.forward(q)
        error = task_error(kin, machine, goal, orientation)
        sizes.append(float(np.linalg.norm(error)))
        qdot, memory, _ = clik_velocity(machine, kin, error, 0 * error, memory, gains, orientation, dt_s=0.02)
        q = q + 0.02 * qdot
    assert sizes[-1] == pytest.approx(sizes[0] * math.exp(-2.0 * 0.02 * 149), rel=0.15)


# --- singular postures, found by construction


def at(name: str, **joints: float) -> np.ndarray:
    machine = machine_named(name, wide=True)
    q = np.array(machine.home)
    for joint, value in joints.items():
        q[machine.joint_names.index(joint.replace("_", " "))] = value
    return q


def over_the_swing_axis(name: str, joint: int, wrist: bool, **joints: float) -> np.ndarray:
    """The posture whose joint brings the tool, or the point where tilt and rotate axis cross, over the swing axis."""
    machine, q = machine_named(name, wide=True), at(name, **joints)

    def reach(x: float) -> float:
        kin = machine.forward([*q[:joint], x, *q[joint + 1 :]])
        return float((kin.T_machine_links[-1] if wrist else machine.tool_pose(kin))[0, 3])

    values = np.linspace(-3.0, 3.0, 61)
    first = next(i for i in range(60) if reach(values[i]) * reach(values[i + 1]) < 0.0)
    return np.array([*q[:joint], brentq(reach, values[first], values[first + 1], xtol=1e-14), *q[joint + 1 :]])


def upright_on_the_swing_axis() -> np.ndarray:
    """Swing and rotate turn about one line: wrist over the swing axis, the bracket made level by the bucket."""
    machine = machine_named("rre20", wide=True)

    def level(stick: float) -> float:  # the bucket angle at which the rotate axis points straight down
        return -math.pi / 2 - 1.3 - stick

    def reach(stick: float) -> float:
        return float(machine.forward([0, 1.3, stick, level(stick), 0, 0]).T_machine_links[-1][0, 3])

    stick = brentq(reach, 0.5, 1.3, xtol=1e-14)
    return np.array([0.0, 1.3, stick, level(stick), 0.0, 0.0])


SINGULAR: dict[str, tuple[str, Orientation, Callable[[], np.ndarray]]] = {
    "stick in line with the boom": ("rre20", FULL, lambda: at("rre20", stick=0.0, tilt=0.3, rotate=0.5)),
    "tilted flat": ("rre20", FULL, lambda: at("rre20", tilt=math.pi / 2, rotate=0.4)),
    "tilted flat to the other side": ("rre20", FULL, lambda: at("rre20", tilt=-math.pi / 2, rotate=0.4)),
    "wrist over the swing axis": ("rre20", FULL, lambda: over_the_swing_axis("rre20", 2, True, boom=1.1, tilt=0.3)),
    "rotate axis on the swing axis": ("rre20", FULL, upright_on_the_swing_axis),
    "arm stretched": ("brokk5", PITCH, lambda: at("brokk5", arm_2=0.0, arm_3=0.0, tool=0.0)),
    "arm 2 and 3 in line": ("brokk5", PITCH, lambda: at("brokk5", arm_3=0.0, tool=0.5)),
    "tool over the swing axis": ("brokk5", PITCH, lambda: over_the_swing_axis("brokk5", 2, False)),
    "arm stretched, orientation free": ("brokk5", FREE, lambda: at("brokk5", arm_2=0.0, arm_3=0.0, tool=0.0)),
    "four joints, stick in line": ("rre20/4", PITCH, lambda: at("rre20/4", stick=0.0)),
    "four joints stretched, orientation free": (
        "rre20/4",
        FREE,
        lambda: at("rre20/4", stick=0.0, bucket=-math.atan2(1.4, 0.4)),
    ),
    "four joints, over the swing axis": (
        "rre20/4",
        PITCH,
        lambda: over_the_swing_axis("rre20/4", 2, False, boom=1.1),
    ),
}


@pytest.mark.parametrize("place", SINGULAR)
def test_singular_postures_are_passed_at_bounded_speeds_without_a_jump(place: str) -> None:
    name, orientation, construct = SINGULAR[place]
    machine, q = machine_named(name, wide=True), construct()
    joints = movable_groups(machine)[-1][1]
    sigma = np.linalg.svd(task_jacobian(machine.forward(q), machine, orientation)[:, joints], compute_uv=False)
    assert sigma[-1] < 1e-9  # it is singular
    draw, speed = np.random.default_rng(1), np.minimum(machine.speed_positive, machine.speed_negative)
    for size, posture_1_s in ((0.01, 2.0), (1.0, 0.1)):
        gains = ClikGains(posture_1_s=posture_1_s)
        way, error = draw.normal(size=machine.n), draw.normal(size=ROWS[orientation]) * size
        way *= 0.05 / np.linalg.norm(way)
        jumps = []
        for count in (30, 240):
            memory, before, jump = ClikMemory(len(machine.exclusive_groups) - 1), None, 0.0
            for share in np.linspace(-1.0, 1.0, count + 1):
                kin = machine.forward(q + share * way)
                qdot, memory, _ = clik_velocity(machine, kin, error, 0 * error, memory, gains, orientation, dt_s=0.02)
                assert np.all(np.abs(qdot) <= speed * (1.0 + 1e-12))
                jump = jump if before is None else max(jump, float(np.abs((qdot - before) / speed).max()))
                before = qdot
            jumps.append(jump)
        assert jumps[1] <= 0.3 * jumps[0] + 1e-3  # eight times the samples: a jump would stay, a slope falls


@pytest.mark.parametrize(
    ("error", "dt_s"), [([0.0, 0.0, 0.0], 0.02), ([math.nan, 0.0, 0.0, 0.0], 0.02), ([0.0] * 4, 0.0)]
)
def test_what_is_no_task_is_refused(error: list[float], dt_s: float) -> None:
    machine = machine_named("sun-a")
    kin = machine.forward(machine.home)
    with pytest.raises(InputError):
        clik_velocity(machine, kin, np.array(error), np.zeros(4), ClikMemory(), ClikGains(), PITCH, dt_s=dt_s)


@pytest.mark.parametrize("name", ["linear_1_s", "length_m_rad", "damping", "threshold"])
def test_settings_out_of_range_are_refused(name: str) -> None:
    with pytest.raises(InputError, match=name):
        ClikGains(**{name: -1.0})
