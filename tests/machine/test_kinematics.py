"""Laws of any machine: kinematics against plain matrices, Jacobians and distance rows against finite differences."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from workgauge.machine import pairs
from workgauge.machine.load import catalogue, load_machine, machine_from
from workgauge.machine.model import MachineModel
from workgauge.values.arrays import Floats, frozen, frozen_ints
from workgauge.values.clearances import Clearances
from workgauge.values.transforms import apply, inverse, rpy, translation

STEP = 1e-6
lengths = st.floats(-2.0, 2.0)
angles = st.floats(-180.0, 180.0)
slow = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])


@pytest.fixture(scope="module", autouse=True)
def _quick_pairs() -> Iterator[None]:
    """Look at few postures for self-collision: nothing here depends on the pairs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pairs, "POSTURES", 10)
        yield


@st.composite
def descriptions(draw: st.DrawFn, stretching: bool = False) -> dict[str, Any]:
    """A random machine; if `stretching`, with one prismatic joint that lengthens the box of link 1."""
    n = draw(st.integers(1, 6))
    joints = []
    for i in range(n):
        dh = {"a_m": draw(lengths), "alpha_deg": draw(angles), "d_m": draw(lengths), "theta_deg": draw(angles)}
        if (i == 0 and stretching) or draw(st.booleans()):
            ends = {"type": "prismatic", "lower_m": -0.5, "upper_m": 1.5, "home_m": 0.0}
            speed = {"speed_positive_m_s": 1.0, "speed_negative_m_s": 0.5}
        else:
            ends = {"type": "revolute", "lower_deg": -170, "upper_deg": 170, "home_deg": 0}
            speed = {"speed_positive_deg_s": 30, "speed_negative_deg_s": 20}
        joints.append({"name": f"j{i}", "link": f"l{i + 1}", "dh": dh, **ends, **speed})
    box: dict[str, Any] = {
        "name": "box",
        "link": f"l{draw(st.integers(1, n)) if not stretching else 1}",
        "centre_m": [draw(lengths) for _ in range(3)],
        "size_m": [draw(st.floats(0.6, 2.0)) for _ in range(3)],
        "rpy_deg": [draw(angles) for _ in range(3)],
    }
    if stretching:
        axis, side = draw(st.sampled_from("xyz")), draw(st.sampled_from(["positive", "negative"]))
        box["stretch"] = {"joint": "j0", "axis": axis, "side": side}
    pose = {"position_m": [draw(lengths) for _ in range(3)], "rpy_deg": [draw(angles) for _ in range(3)]}
    return {
        "title": "random",
        "undercarriage": {"kind": "tracks", "gauge_m": 2.0},
        "base": pose,
        "joints": joints,
        "solids": [box, {**box, "name": "base", "link": "undercarriage", "stretch": None}],
        "attachments": [{"name": "tool", "tool": pose}],
    }


def posture(machine: MachineModel, share: list[float]) -> Floats:
    """A posture a share of the way between the limits."""
    return machine.sample_min + np.array(share[: machine.n]) * (machine.sample_max - machine.sample_min)


shares = st.lists(st.floats(0.05, 0.95), min_size=6, max_size=6)
vectors = st.lists(st.floats(-5.0, 5.0), min_size=3, max_size=3).map(np.array)
transforms = st.tuples(vectors, vectors).map(lambda v: translation(*v[0]) @ rpy(*v[1]))


def dh_product(description: dict[str, Any], q: Floats) -> list[Floats]:
    """Frames 0 to n by writing the printed matrices out (3.1 to 3.4), with no code of the product's."""

    def rz(t: float) -> Floats:
        return np.array(
            [[math.cos(t), -math.sin(t), 0, 0], [math.sin(t), math.cos(t), 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
        )

    base = description.get("base", {"position_m": [0, 0, 0], "rpy_deg": [0, 0, 0]})
    T = np.eye(4)
    T[:3, :3] = pin.rpy.rpyToMatrix(*np.radians(base["rpy_deg"]))
    T[:3, 3] = base["position_m"]
    frames = [np.eye(4)]
    for joint, value in zip(description["joints"], q, strict=True):
        row = joint["dh"]
        t, d = math.radians(row.get("theta_deg", 0.0)), row["d_m"]
        t, d = (t, d + value) if joint["type"] == "prismatic" else (t + value, d)
        a, c, s = row["a_m"], math.cos(math.radians(row["alpha_deg"])), math.sin(math.radians(row["alpha_deg"]))
        first = rz(t)
        first[2, 3] = d
        T = T @ first @ np.array([[1, 0, 0, a], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]])
        frames.append(T)
    return frames


def clearance(
    machine: MachineModel, link: int, point: Floats, other: Floats, other_link: int = -1, sign: float = 1.0
) -> Clearances:
    """One clearance between two points in the site frame."""
    distance = float(np.linalg.norm(point - other))
    normal = sign * (point - other) / distance
    return Clearances(
        frozen([sign * distance]),
        frozen([normal]),
        frozen([point]),
        frozen([other]),
        frozen_ints([link]),
        frozen_ints([other_link]),
        frozen_ints([0]),
        frozen_ints([-1]),
        frozen_ints([0]),
        frozen([0.0]),
        frozen([math.nan]),
        machine.link_names,
        ("limit",),
        100.0,
    )


@slow
@given(descriptions(), shares)
def test_frames_are_the_product_of_the_printed_matrices(description: dict[str, Any], share: list[float]) -> None:
    machine = machine_from(description)
    q = posture(machine, share)
    np.testing.assert_allclose(machine.forward(q).T_machine_links, dh_product(description, q), atol=1e-11)


@slow
@given(descriptions(), shares, st.data())
def test_point_jacobians_are_finite_differences(description: dict[str, Any], share: list[float], data: Any) -> None:
    machine = machine_from(description)
    q = posture(machine, share)
    kin = machine.forward(q)
    links = data.draw(st.lists(st.integers(0, machine.n), min_size=1, max_size=5))
    on_links = np.array([data.draw(vectors) for _ in links])
    points = np.array([apply(kin.T_machine_links[k], p) for k, p in zip(links, on_links, strict=True)])
    jacobians = machine.point_jacobians(kin, links, points)
    for j in range(machine.n):
        moved = []
        for sign in (1.0, -1.0):
            there = machine.forward(q + sign * STEP * np.eye(machine.n)[j]).T_machine_links
            moved.append(np.array([apply(there[k], p) for k, p in zip(links, on_links, strict=True)]))
        np.testing.assert_allclose(jacobians[:, :, j], (moved[0] - moved[1]) / (2 * STEP), atol=2e-7)


@slow
@given(descriptions(), shares)
def test_the_tool_jacobian_is_finite_differences(description: dict[str, Any], share: list[float]) -> None:
    machine = machine_from(description)
    q = posture(machine, share)
    jacobian = machine.tool_jacobian(machine.forward(q))
    for j in range(machine.n):
        before, after = (machine.tool_pose(machine.forward(q + s * STEP * np.eye(machine.n)[j])) for s in (-1.0, 1.0))
        turned = pin.log3(np.array((after @ inverse(before))[:3, :3]))
        expected = np.concatenate([after[:3, 3] - before[:3, 3], turned]) / (2 * STEP)
        np.testing.assert_allclose(jacobian[:, j], expected, atol=5e-7)


@slow
@given(descriptions(), shares, transforms, vectors, vectors, st.sampled_from([1.0, -1.0]), st.data())
def test_distance_rows_to_a_fixed_point(
    description: dict[str, Any],
    share: list[float],
    T_site_machine: Floats,
    on_link: Floats,
    fixed: Floats,
    sign: float,
    data: Any,
) -> None:
    machine = machine_from(description)
    q = posture(machine, share)
    link = data.draw(st.integers(0, machine.n))

    def point(q: Floats) -> Floats:
        return apply(T_site_machine @ machine.forward(q).T_machine_links[link], on_link)

    assume(np.linalg.norm(point(q) - fixed) > 0.1)
    found = machine.distance_rows(
        machine.forward(q), T_site_machine, clearance(machine, link, point(q), fixed, sign=sign)
    )
    for j in range(machine.n):
        before, after = (np.linalg.norm(point(q + s * STEP * np.eye(machine.n)[j]) - fixed) for s in (-1.0, 1.0))
        assert found[0, j] == pytest.approx(sign * (after - before) / (2 * STEP), abs=1e-6)


@slow
@given(descriptions(), shares, transforms, vectors, vectors, st.data())
def test_distance_rows_between_two_links(
    description: dict[str, Any],
    share: list[float],
    T_site_machine: Floats,
    on_link: Floats,
    on_other: Floats,
    data: Any,
) -> None:
    machine = machine_from(description)
    q = posture(machine, share)
    link, other = data.draw(st.permutations(range(machine.n + 1)))[:2]

    def points(q: Floats) -> tuple[Floats, Floats]:
        frames = T_site_machine @ machine.forward(q).T_machine_links
        return apply(frames[link], on_link), apply(frames[other], on_other)

    def distance(q: Floats) -> float:
        first, second = points(q)
        return float(np.linalg.norm(first - second))

    assume(distance(q) > 0.1)
    found = machine.distance_rows(machine.forward(q), T_site_machine, clearance(machine, link, *points(q), other))
    for j in range(machine.n):
        step = STEP * np.eye(machine.n)[j]
        assert found[0, j] == pytest.approx((distance(q + step) - distance(q - step)) / (2 * STEP), abs=1e-6)


@slow
@given(descriptions(stretching=True), shares, transforms, vectors)
def test_distance_rows_of_a_stretching_box(
    description: dict[str, Any], share: list[float], T_site_machine: Floats, fixed: Floats
) -> None:
    machine = machine_from(description)
    q = posture(machine, share)
    box = next(i for i, solid in enumerate(machine.solids) if solid.stretch)

    def nearest(q: Floats) -> Floats:
        poses, halves = machine.solid_poses(machine.forward(q))
        T = T_site_machine @ poses[box]
        return apply(T, np.clip(apply(inverse(T), fixed), -halves[box], halves[box]))

    def distance(q: Floats) -> float:
        return float(np.linalg.norm(nearest(q) - fixed))

    assume(distance(q) > 0.05)
    link = machine.solids[box].link
    for one in (
        clearance(machine, link, nearest(q), fixed),
        # the same distance seen from the undercarriage: a fixed point on it, the box as the other link
        clearance(machine, 0, fixed, nearest(q), link),
    ):
        found = machine.distance_rows(machine.forward(q), T_site_machine, one)
        for j in range(machine.n):
            step = STEP * np.eye(machine.n)[j]
            expected = (distance(q + step) - distance(q - step)) / (2 * STEP)
            assert found[0, j] == pytest.approx(expected, abs=1e-5)


@slow
@given(descriptions(stretching=True), shares)
def test_a_stretching_box_keeps_one_face_and_moves_the_other(description: dict[str, Any], share: list[float]) -> None:
    machine = machine_from(description)
    i = next(i for i, solid in enumerate(machine.solids) if solid.stretch)
    solid = machine.solids[i]
    assert solid.stretch is not None
    axis, side, q = solid.stretch.axis, solid.stretch.side, posture(machine, share)
    kin = machine.forward(q)
    poses, halves = machine.solid_poses(kin)
    T_link_box = inverse(kin.T_machine_links[solid.link]) @ poses[i]
    for face, moved in ((side, q[0]), (-side, 0.0)):
        ours, before = np.zeros(3), np.zeros(3)
        ours[axis], before[axis] = face * halves[i, axis], face * (solid.half_extents[axis] + moved)
        np.testing.assert_allclose(apply(T_link_box, ours), apply(solid.T_link_box, before), atol=1e-12)
    others = [k for k in range(3) if k != axis]
    np.testing.assert_array_equal(halves[i, others], solid.half_extents[others])


@pytest.mark.parametrize("side", ["moving link", "sleeve"])
def test_a_telescope_stays_inside_its_box(side: str) -> None:
    """The box of a telescope encloses the sleeve's foot and the inner arm's tip at every length."""
    telescope = {
        "name": "telescope",
        "centre_m": [0, 0, -1.0 if side == "moving link" else 1.0],
        "size_m": [0.4, 0.4, 2.2],
        "link": "arm" if side == "moving link" else "cabin",
        "stretch": {"joint": "reach", "axis": "z", "side": "negative" if side == "moving link" else "positive"},
    }
    machine = machine_from(
        {
            "title": "telescope",
            "undercarriage": {"kind": "wheels", "gauge_m": 2.0},
            "joints": [
                {
                    "name": "swing",
                    "link": "cabin",
                    "type": "revolute",
                    "continuous": True,
                    "home_deg": 0,
                    "speed_positive_deg_s": 30,
                    "speed_negative_deg_s": 30,
                    "dh": {"a_m": 0.5, "alpha_deg": 90, "d_m": 1.5},
                },
                {
                    "name": "reach",
                    "link": "arm",
                    "type": "prismatic",
                    "lower_m": 0,
                    "upper_m": 1.5,
                    "home_m": 0,
                    "speed_positive_m_s": 0.3,
                    "speed_negative_m_s": 0.2,
                    "dh": {"a_m": 0, "alpha_deg": 0, "d_m": 2.0},
                },
            ],
            "solids": [telescope],
            "attachments": [{"name": "hook", "tool": {}}],
        }
    )
    for reach in np.linspace(0.0, 1.5, 7):
        kin = machine.forward([0.7, reach])
        poses, halves = machine.solid_poses(kin)
        for point in (kin.T_machine_links[1][:3, 3], machine.tool_pose(kin)[:3, 3]):
            assert (np.abs(apply(inverse(poses[0]), point)) <= halves[0] + 1e-9).all()
        assert 2 * halves[0, 2] == pytest.approx(2.2 + reach)


@pytest.mark.parametrize("name", catalogue())
def test_nothing_handed_out_can_be_written_to(name: str) -> None:
    machine = load_machine(name)
    kin = machine.forward(machine.home)
    arrays = [kin.q, kin.T_machine_links, kin.spatial_jacobian, *machine.solid_poses(kin)]
    arrays += [machine.q_min, machine.q_max, machine.home, machine.T_link_tool, machine.speed_positive]
    arrays += [machine.speed_negative, machine.continuous, machine.prismatic, machine.lever_signs]
    arrays += [array for solid in machine.solids for array in (solid.T_link_box, solid.half_extents)]
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    with pytest.raises(AttributeError):
        machine.name = "other"  # type: ignore[misc]


def test_a_posture_does_not_depend_on_the_one_before() -> None:
    machine = load_machine("rre20")
    first = machine.forward(machine.home)
    kept = [first.T_machine_links.copy(), first.spatial_jacobian.copy()]
    machine.forward(machine.home + 0.3)
    again = machine.forward(machine.home)
    for ours, before in zip((first, again), (kept, kept), strict=True):
        np.testing.assert_array_equal(ours.T_machine_links, before[0])
        np.testing.assert_array_equal(ours.spatial_jacobian, before[1])


def test_wrong_number_of_joints_and_no_clearances() -> None:
    machine = load_machine("rre20")
    for q in ([0.0], np.zeros((6, 1)), np.zeros(7)):
        with pytest.raises(ValueError, match="expected 6"):
            machine.forward(q)
    kin = machine.forward(machine.home)
    one = clearance(machine, 1, np.ones(3), np.zeros(3))
    none = Clearances(
        *(array[:0] for array in (one.distances, one.normals, one.points_machine, one.points_limit)),
        *(array[:0] for array in (one.links, one.other_links, one.limits, one.cells, one.solids)),
        *(array[:0] for array in (one.protections, one.stop_distances)),
        one.link_names,
        one.limit_ids,
        1.0,
    )
    assert machine.distance_rows(kin, np.eye(4), none).shape == (0, 6)
    assert machine.point_jacobians(kin, [], np.zeros((0, 3))).shape == (0, 3, 6)


def test_the_pinocchio_model_handed_out_agrees() -> None:
    machine = load_machine("rre20")
    model = machine.pinocchio_model()
    data = model.createData()
    q = posture(machine, [0.3, 0.8, 0.4, 0.6, 0.1, 0.9])
    pin.framesForwardKinematics(model, data, q)
    kin = machine.forward(q)
    tool = data.oMf[model.getFrameId("tool")].homogeneous
    np.testing.assert_allclose(tool, machine.tool_pose(kin), atol=1e-12)
    for name, T in zip(machine.link_names[1:], kin.T_machine_links[1:], strict=True):
        np.testing.assert_allclose(data.oMf[model.getFrameId(name)].homogeneous, T, atol=1e-12)
    np.testing.assert_array_equal(model.lowerPositionLimit, machine.q_min)
