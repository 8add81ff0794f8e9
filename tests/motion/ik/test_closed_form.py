"""The closed-form inverse: laws after forward, a search that knows nothing of it, out of reach, singular poses."""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.motion.ik.circles import crossings
from workgauge.motion.ik.closed_form import ClosedForm, closed_form
from workgauge.motion.ik.task import task_error, task_jacobian
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import InputError
from workgauge.values.tasks import Orientation
from workgauge.values.transforms import rotation_x, rotation_z, rpy, translation

machine_named = functools.cache(load_machine)
SHIPPED = ("rre20", "brokk5", "sun-a", "sun-b")
EXACT = 1e-9


def form_of(machine: MachineModel) -> ClosedForm:
    form = closed_form(machine)
    assert form is not None
    return form


def postures(machine: MachineModel, count: int, seed: int) -> Floats:
    return np.random.default_rng(seed).uniform(machine.sample_min, machine.sample_max, (count, machine.n))


def tool_poses(machine: MachineModel, q: Floats) -> Floats:
    """Return the tool's poses (N, 4, 4) at postures q (N, n), from the chain alone."""
    T = np.broadcast_to(np.eye(4), (len(q), 4, 4))
    for j, joint in enumerate(machine.chain):
        turn = np.tile(np.eye(4), (len(q), 1, 1))
        turn[:, :3, :3] = Rotation.from_rotvec(q[:, j, None] * joint.axis).as_matrix()
        T = T @ joint.T_parent_joint @ turn @ joint.T_joint_link
    poses: Floats = T @ machine.T_link_tool
    return poses


def wrapped(angle: Floats) -> Floats:
    turned: Floats = np.remainder(angle + np.pi, 2 * np.pi) - np.pi
    return turned


def misses(form: ClosedForm, T: Floats, q: Floats) -> Floats:
    """Return by how much postures q (b, n) miss a pose, in what counts of it [m, rad]."""
    machine = form.machine
    errors = [task_error(machine.forward(row), machine, T, form.orientation) for row in q]
    worst: Floats = np.abs(np.reshape(errors, (len(q), -1))).max(-1, initial=0.0)
    return worst


def check_many(machine: MachineModel, count: int, seed: int) -> tuple[float, float]:
    """Return the worst miss of any branch's pose and of the generating posture among the branches."""
    form, q = form_of(machine), postures(machine, count, seed)
    T = tool_poses(machine, q)
    if form.redundant is not None:
        q[:, form.redundant] = machine.home[form.redundant]
        T = tool_poses(machine, q)
    found = form.branches_many(T)
    apart = np.abs(wrapped(found - q[:, None])).max(-1)
    present = np.isfinite(found).all(-1)
    reached = tool_poses(machine, found[present])
    wanted = np.broadcast_to(T[:, None], (*present.shape, 4, 4))[present]
    missed = np.abs(reached - wanted)
    if form.orientation is Orientation.PITCH:  # the arm overhead has the pitch, not the whole orientation
        missed = missed[:, :3, 3]
        across = np.abs(wrapped((found - q[:, None])[present][:, 0])) > 1.0
        whole = np.abs(reached - wanted)[~across]
        assert whole.max() < EXACT
    return float(missed.max()), float(np.nanmin(apart, axis=-1).max())


@pytest.mark.parametrize("name", SHIPPED)
def test_inverse_after_forward(name: str) -> None:
    missed, apart = check_many(machine_named(name), 2_000, 1)
    assert missed < EXACT
    assert apart < EXACT


@pytest.mark.prove
@pytest.mark.parametrize("name", SHIPPED)
def test_inverse_after_forward_on_a_hundred_thousand_postures(name: str) -> None:
    worst = np.max([check_many(machine_named(name), 10_000, seed) for seed in range(10)], axis=0)
    assert worst[0] < EXACT
    assert worst[1] < EXACT


@pytest.mark.parametrize("name", SHIPPED)
def test_every_branch_reaches_and_the_nearest_comes_first(name: str) -> None:
    machine = machine_named(name)
    form = form_of(machine)
    for q in postures(machine, 60, 2):
        T = machine.tool_pose(machine.forward(q))
        found = form.branches(T, q_near=q)
        assert np.abs(found.q[0] - q).max() < EXACT
        assert found.out_of_reach is None
        assert np.all(np.diff(found.seconds) >= 0.0)
        assert np.all((machine.q_min <= found.q) & (found.q <= machine.q_max))
        beyond = np.reshape([each.q for each in found.beyond], (-1, machine.n))
        assert misses(form, T, np.vstack([found.q, beyond])).max() < EXACT
        for each in found.beyond:
            ends = np.where(each.excess > 0.0, machine.q_max, machine.q_min)
            outside = each.excess != 0.0
            assert outside.any()
            assert np.allclose((each.q - ends)[outside], each.excess[outside])
            assert np.all(((machine.q_min <= each.q) & (each.q <= machine.q_max))[~outside])


# Chains no file here describes: an arm beside a leaning swing, joints that turn either way, axes that do not cross.

far = st.floats(-1.5, 1.5).map(lambda x: round(x, 2))
angle = st.floats(-3.1, 3.1).map(lambda x: round(x, 2))
length = st.floats(0.3, 3.0).map(lambda x: round(x, 2))
place = st.tuples(far, far, far)


def pose_of(position: tuple[float, float, float], angles: tuple[float, float, float]) -> Floats:
    return translation(*position) @ rpy(*angles)


@st.composite
def six_joints(draw: st.DrawFn, crossing: bool) -> MachineModel:
    """An excavator with tiltrotator of any build, its joints free to turn."""
    machine = machine_named("rre20")
    swing = pose_of(draw(place), (0.3 * draw(st.sampled_from([-1, 0, 1])), 0.0, draw(angle)))
    foot = translation(*draw(place)) @ rotation_x(math.pi / 2 + draw(st.sampled_from([0.0, 0.3])))
    steps = [swing, foot]
    for _ in range(2):
        flip = rotation_x(draw(st.sampled_from([0.0, math.pi])))
        steps.append(rotation_z(draw(angle)) @ translation(draw(length), 0.0, draw(far)) @ flip)
    lean = draw(st.floats(0.5, 2.6))
    steps.append(translation(*draw(place)) @ rotation_z(draw(angle)) @ rotation_x(lean))
    lean = draw(st.floats(0.5, 2.6))
    offset = 0.0 if crossing else draw(st.sampled_from([0.003, 0.05, 0.4, -1.0]))
    steps.append(
        translation(0, 0, draw(far)) @ rotation_z(draw(angle)) @ translation(offset, 0, 0) @ rotation_x(lean)
    )
    chain = tuple(
        replace(joint, T_parent_joint=frozen(step), T_joint_link=frozen(np.eye(4)))
        for joint, step in zip(machine.chain, steps, strict=True)
    )
    tool = frozen(pose_of(draw(place), (draw(angle), draw(angle), draw(angle))))
    return opened(replace(machine, chain=chain, T_link_tool=tool), range(6))


def opened(machine: MachineModel, joints: range | list[int]) -> MachineModel:
    """Return the machine with some joints free to turn once around."""
    q_min, q_max = machine.q_min.copy(), machine.q_max.copy()
    for j in joints:
        if not machine.continuous[j]:
            q_min[j], q_max[j] = -math.pi, math.pi
    return replace(machine, q_min=frozen(q_min), q_max=frozen(q_max))


def check_unseen(machine: MachineModel, seed: int) -> None:
    form = form_of(machine)
    for q in postures(machine, 5, seed):
        T = tool_poses(machine, q[None])[0]
        found = form.branches(T, q_near=q)
        assert misses(form, T, found.q).max() < EXACT
        J = machine.tool_jacobian(machine.forward(q))
        if np.linalg.svd(J, compute_uv=False)[-1] > 1e-3:
            assert np.abs(wrapped(found.q - q)).max(-1).min() < 1e-8


@settings(max_examples=60, deadline=None)
@given(six_joints(crossing=True), st.integers(0, 99))
def test_tiltrotators_not_seen_before(machine: MachineModel, seed: int) -> None:
    check_unseen(machine, seed)


@settings(max_examples=60, deadline=None)
@given(six_joints(crossing=False), st.integers(0, 99))
def test_tiltrotators_whose_axes_do_not_cross(machine: MachineModel, seed: int) -> None:
    check_unseen(machine, seed)


def test_what_the_joints_are_called_does_not_matter() -> None:
    machine = machine_named("rre20")
    renamed = replace(machine, joint_names=tuple("fedcba"), link_names=tuple("tsrqpon"), name="x")
    assert form_of(renamed).orientation is Orientation.FULL


def with_chain(machine: MachineModel, joint: int, T: Floats) -> MachineModel:
    chain = list(machine.chain)
    chain[joint] = replace(chain[joint], T_parent_joint=frozen(chain[joint].T_parent_joint @ T))
    return replace(machine, chain=tuple(chain))


def test_other_chains_are_not_taken() -> None:
    machine = machine_named("rre20")
    sliding = replace(machine, prismatic=np.arange(6) == 3)
    assert closed_form(sliding) is None
    assert closed_form(with_chain(machine, 2, rotation_x(0.01))) is None
    assert closed_form(with_chain(machine, 1, rotation_x(-math.pi / 2))) is None
    assert closed_form(with_chain(machine_named("sun-a"), 3, rotation_x(0.01))) is None


def test_a_chain_rounded_in_its_file_is_solved_on_the_true_one() -> None:
    for name in ("rre20", "sun-a"):
        machine = with_chain(machine_named(name), 2, rotation_x(3e-4) @ translation(0, 0, 1e-4))
        form = form_of(machine)
        assert not form.exact
        for q in postures(machine, 20, 3):
            T = machine.tool_pose(machine.forward(q))
            found = form.branches(T, q_near=q)
            assert misses(form, T, found.q).max(initial=0.0) < EXACT
            J = task_jacobian(machine.forward(q), machine, form.orientation)
            if np.linalg.svd(J, compute_uv=False)[-1] > 0.1:
                assert np.abs(found.q[0] - q).max() < 1e-8


def test_crossings_finds_both_angles() -> None:
    rng = np.random.default_rng(4)
    for _ in range(50):
        A, C, x, y = rng.normal(size=(4, 2))
        x, y = x[:1], y[:1]
        B, D = rng.normal(size=(2, 2))
        ux, uy = (np.array([math.cos(angle[0]), math.sin(angle[0])]) for angle in (x, y))
        found = crossings(A[None], B, np.array([A @ ux - B @ uy]), C[None], D, np.array([C @ ux - D @ uy]))
        apart = np.maximum(np.abs(wrapped(found[0] - x)), np.abs(wrapped(found[1] - y)))
        assert np.nanmin(apart) < 1e-8


# A search that knows nothing of the closed form.


def searched(form: ClosedForm, T: Floats, starts: Floats) -> Floats:
    """Return the different postures (k, n), limits aside, that Newton's steps from many starts settle on."""
    machine = form.machine
    found: list[Floats] = []
    moving = [j for j in range(machine.n) if j != form.redundant]
    for start in starts:
        q = start.copy()
        for _ in range(40):
            kin = machine.forward(q)
            error = task_error(kin, machine, T, form.orientation)
            if np.abs(error).max() < 1e-11:
                break
            J = task_jacobian(kin, machine, form.orientation)[:, moving]
            step = np.linalg.lstsq(J, error, rcond=1e-10)[0]
            q[moving] += step * min(1.0, 0.7 / np.abs(step).max())
        else:
            continue
        if all(np.abs(wrapped(q - other)).max() > 1e-6 for other in found):
            found.append(q)
    return np.reshape(found, (-1, machine.n))


def check_searched(name: str, poses: int, starts: int) -> tuple[int, int]:
    """Return how many branches there are and how many of them the search found; it must find no other."""
    machine = machine_named(name)
    form, known, seen = form_of(machine), 0, 0
    whole = opened(machine, range(machine.n))
    for k, q in enumerate(postures(machine, poses, 5)):
        T = machine.tool_pose(machine.forward(q))
        found = form.branches(T, q_near=q)
        mine = np.vstack([found.q, *(each.q for each in found.beyond)])
        begin = postures(whole, starts, 100 + k)
        if form.redundant is not None:
            begin[:, form.redundant] = q[form.redundant]
        other = searched(form, T, begin)
        apart = np.abs(wrapped(other[:, None] - mine)).max(-1)
        assert np.all(apart.min(-1) < 1e-6), (name, q)
        known, seen = known + len(mine), seen + int((apart.min(0) < 1e-6).sum())
    return known, seen


@pytest.mark.parametrize("name", SHIPPED)
def test_a_dense_search_finds_no_other_branch(name: str) -> None:
    known, seen = check_searched(name, 5, 30)
    assert seen > 0.7 * known


@pytest.mark.prove
@pytest.mark.parametrize("name", SHIPPED)
def test_a_denser_search_finds_no_other_branch(name: str) -> None:
    known, seen = check_searched(name, 200, 200)
    assert seen >= 0.99 * known


# What is said when nothing reaches.


def reaches(form: ClosedForm, T: Floats, shifts: Floats) -> NDArray[np.bool_]:
    poses = np.tile(T, (len(shifts), 1, 1))
    poses[:, :3, 3] += shifts
    there: NDArray[np.bool_] = np.isfinite(form.branches_many(poses)).all(-1).max(-1)
    return there


@pytest.mark.parametrize(("name", "free"), [("rre20", [1, 3]), ("sun-a", [1, 3]), ("brokk5", [2, 4])])
def test_how_far_out_of_reach(name: str, free: list[int]) -> None:
    """No nearer position is reached, and one hardly farther is: swing, elbow and tilt within their limits."""
    machine = machine_named(name)
    form, opener = form_of(machine), form_of(opened(machine, free))
    rng = np.random.default_rng(6)
    outwards = rng.normal(size=(4_000, 3))
    outwards /= np.linalg.norm(outwards, axis=1)[:, None]
    said = 0
    for q in postures(machine, 6, 7):
        T = machine.tool_pose(machine.forward(q)).copy()
        T[:3, 3] *= rng.uniform(1.2, 2.0)
        answer = form.branches(T).out_of_reach
        if answer is None or answer.by_m == 0.0:
            continue
        said += 1
        assert f"out of reach: by {answer.by_m:.2f} m" in answer.text
        assert not reaches(opener, T, 0.99 * answer.by_m * outwards).any()
        assert reaches(opener, T, (1.02 * answer.by_m + 1e-3) * outwards).any()
    assert said >= 2


def test_a_joint_beyond_its_end_is_named() -> None:
    machine = machine_named("rre20")
    q = machine.home.copy()
    q[2] = math.radians(-162.0)
    answer = form_of(machine).branches(machine.tool_pose(machine.forward(q)), q_near=machine.home)
    assert len(answer.q) == 0
    assert answer.out_of_reach is not None
    assert answer.out_of_reach.by_m == 0.0
    assert answer.beyond[0].text == "stick would have to go 12.0 deg beyond its lower end at -150.0 deg"
    assert answer.out_of_reach.text == f"inside the reach, but {answer.beyond[0].text}"
    assert answer.beyond[0].by_deg == pytest.approx(12.0)


def test_endless_joints_take_the_turn_nearest_the_present() -> None:
    machine = machine_named("rre20")
    q = machine.home.copy()
    q[[0, 5]] = 7.0, -20.0
    found = form_of(machine).branches(machine.tool_pose(machine.forward(q)), q_near=q)
    assert np.abs(found.q[0] - q).max() < EXACT


@pytest.mark.parametrize(
    "goal", [np.eye(3), np.full((4, 4), np.nan), np.diag([1.0, 1.0, 2.0, 1.0]), np.diag([1.0, 1.0, -1.0, 1.0])]
)
def test_what_is_no_pose_is_refused(goal: Floats) -> None:
    with pytest.raises(InputError, match="not a pose"):
        form_of(machine_named("rre20")).branches(goal)


def test_what_is_no_posture_or_cannot_be_held_is_refused() -> None:
    form, T = form_of(machine_named("rre20")), np.eye(4)
    with pytest.raises(InputError, match="not a posture"):
        form.branches(T, q_near=[0.0, 1.0])
    with pytest.raises(InputError, match="no joint to hold"):
        form.branches(T, held=0.3)
    with pytest.raises(InputError, match="no redundant joint"):
        form.held_intervals(T)
    with pytest.raises(InputError, match="arm 1 cannot be held there"):
        form_of(machine_named("brokk5")).branches(T, held=-1.0)


# Singular postures: a joint is free.


def check_free(machine: MachineModel, q: Floats, near: Floats, joint: str, family: Floats) -> None:
    """The answer reaches, says which joint is free, and no other member (k, n) of the continuum is sooner."""
    form = form_of(machine)
    T = machine.tool_pose(machine.forward(q))
    assert misses(form, T, family).max() < 1e-8
    found = form.branches(T, q_near=near)
    assert misses(form, T, found.q).max() < EXACT
    assert [note for note in found.notes if note.startswith(f"{joint} is free")]
    dq = family - near
    seconds = np.where(dq > 0, dq / machine.speed_positive, -dq / machine.speed_negative).max(-1)
    within = ((machine.q_min <= family) & (family <= machine.q_max)).all(-1)
    assert within.any()
    assert found.seconds[0] <= seconds[within].min() + 1e-9


def test_rotator_parallel_to_the_arms_joints() -> None:
    """The bucket turns about where the rotator's axis is: only their difference counts, and boom and stick follow."""
    machine = opened(machine_named("rre20"), [1, 2, 3, 4])
    q = machine.home.copy()
    q[4] = math.pi / 2
    form = form_of(machine)
    T = machine.tool_pose(machine.forward(q))
    solver = form._solver
    family = solver.family(T, 5, np.linspace(-np.pi, np.pi, 200)).reshape(-1, 6)
    family = family[np.isfinite(family).all(-1)]
    assert np.ptp(family[:, 5]) > 1.0
    near = q + np.array([0.2, -0.1, 0.1, 0.3, -0.2, 0.8])
    check_free(machine, q, near, "rotate", near + wrapped(family - near))


def test_wrist_on_the_swing_axis() -> None:
    machine = opened(machine_named("rre20"), [1, 2, 3, 4])
    q = machine.home.copy()
    # the wrist 0.1 + 5.2 cos + 2.4 cos + 0.4 cos = 0 from the axis, in the plane
    q[1], q[3] = math.radians(85.0), math.radians(-90.0)
    low, high = -3.14, -0.5
    for _ in range(80):
        q[2] = 0.5 * (low + high)
        pitch = np.cumsum(q[1:4])
        reach = 0.1 + 5.2 * math.cos(pitch[0]) + 2.4 * math.cos(pitch[1]) + 0.4 * math.cos(pitch[2])
        low, high = (q[2], high) if reach < 0 else (low, q[2])
    assert abs(reach) < 1e-12
    q[4] = 0.3
    T = machine.tool_pose(machine.forward(q))
    family = form_of(machine)._solver.family(T, 0, np.linspace(-np.pi, np.pi, 400)).reshape(-1, 6)
    family = family[np.isfinite(family).all(-1)]
    near = q + np.array([0.9, -0.1, 0.1, 0.3, 0.0, 0.8])
    check_free(machine, q, near, "swing", near + wrapped(family - near))


def test_equal_links_folded_onto_each_other() -> None:
    machine = machine_named("sun-a")
    chain = list(machine.chain)
    chain[1] = replace(chain[1], T_joint_link=chain[2].T_joint_link)
    machine = opened(replace(machine, chain=tuple(chain)), [1, 2, 3])
    q = np.array([0.4, 0.3, math.pi, 0.2])
    turned = np.linspace(-2.0, 2.0, 41)
    family = np.array([q + np.array([0, t, 0, -t]) for t in turned])
    check_free(machine, q, q + np.array([0.1, 0.3, -0.2, 0.1]), "boom", family)


@pytest.mark.parametrize("off", [1e-12, 1e-10, 1e-8, 1e-6, 1e-3])
def test_near_a_singular_posture_every_branch_still_reaches(off: float) -> None:
    machine = opened(machine_named("rre20"), [1, 2, 3, 4])
    form = form_of(machine)
    for q in machine.home + np.random.default_rng(9).uniform(-0.3, 0.3, (10, 6)):
        for joint, singular in ((4, math.pi / 2), (4, -math.pi / 2), (2, 0.0)):
            turned = q.copy()
            turned[joint] = singular + off
            T = machine.tool_pose(machine.forward(turned))
            found = form.branches(T, q_near=turned)
            assert len(found.q)
            assert misses(form, T, found.q).max() < EXACT


# A fifth joint in the plane.


def test_the_joint_that_is_held() -> None:
    machine = machine_named("brokk5")
    form = form_of(machine)
    assert form.redundant == machine.joint_names.index("arm 1")
    q = machine.home
    T = machine.tool_pose(machine.forward(q))
    ((low, high),) = form.held_intervals(T)
    assert low < q[1] < high
    for held in np.linspace(low, high, 9):
        found = form.branches(T, held=float(held))
        assert np.all(found.q[:, 1] == held)
        assert misses(form, T, found.q).max() < EXACT
    for held in (low - 1e-6, high + 1e-6):
        answer = form.branches(T, held=float(held)).out_of_reach
        assert answer is not None
        assert "reached with arm 1 at " in answer.text


@pytest.mark.parametrize("alone", [2, 3, 4])
def test_whichever_joint_stands_alone_is_held(alone: int) -> None:
    machine = machine_named("brokk5")
    others = tuple(j for j in range(5) if j != alone)
    machine = opened(replace(machine, exclusive_groups=((alone,), others)), [1, 2, 3, 4])
    form = form_of(machine)
    assert form.redundant == alone
    for q in postures(machine, 20, 8):
        T = machine.tool_pose(machine.forward(q))
        found = form.branches(T, q_near=q)
        assert np.abs(found.q[0] - q).max() < 1e-8
        assert misses(form, T, found.q).max() < EXACT
