"""The shipped machines: what is known of them, what their boxes enclose, and which pairs are kept apart."""

import itertools
import json
from importlib import resources

import numpy as np
import pytest

from workgauge.machine.describe import describe
from workgauge.machine.load import catalogue, load_machine
from workgauge.machine.model import MachineModel
from workgauge.machine.parts import Stopping
from workgauge.values.arrays import Floats
from workgauge.values.measurements import LEVER_NAMES
from workgauge.values.solids import Box
from workgauge.values.transforms import apply, inverse, rotation_z, translation


@pytest.fixture(scope="module")
def rre20() -> MachineModel:
    return load_machine("rre20")


def pairs(machine: MachineModel) -> set[frozenset[str]]:
    return {frozenset((machine.solids[i].name, machine.solids[j].name)) for i, j in machine.self_pairs}


def test_the_catalogue() -> None:
    assert catalogue() == ("brokk5", "rre20", "sun-a", "sun-b")


@pytest.mark.parametrize("name", catalogue())
def test_every_machine_is_whole(name: str) -> None:
    machine = load_machine(name)
    assert machine.name == name
    assert machine.link_names[0] == "undercarriage"
    assert len(machine.link_names) == machine.n + 1
    assert (machine.q_min < machine.q_max).all()
    assert (machine.q_min <= machine.home).all() and (machine.home <= machine.q_max).all()
    assert (machine.speed_positive > 0).all() and (machine.speed_negative > 0).all()
    assert sorted(lever for lever in machine.levers if lever) == sorted(set(machine.levers) - {None})
    assert set(machine.levers) <= set(LEVER_NAMES)
    assert {solid.link for solid in machine.solids} >= {0, machine.n}
    assert machine.sensors
    for attachment in machine.attachments:
        assert load_machine(name, attachment).attachment == attachment
    summary = json.loads(json.dumps(describe(machine), allow_nan=False))
    assert [joint["name"] for joint in summary["joints"]] == list(machine.joint_names)
    tool = machine.tool_pose(machine.forward(machine.home))
    assert tool[2, 3] > 0.5 and tool[0, 3] > 1.5, "at home the tool is above ground, in front of the machine"
    np.testing.assert_allclose(tool[:3, 0], [0, 1, 0], atol=1e-12, err_msg="the tool's x axis points left at home")


@pytest.mark.parametrize("name", catalogue())
def test_pairs_are_the_same_every_time(name: str) -> None:
    first, second = load_machine(name), load_machine(name)
    assert first.self_pairs == second.self_pairs
    assert first.skipped_pairs == second.skipped_pairs
    everything = {frozenset((a.name, b.name)) for a, b in itertools.combinations(first.solids, 2) if a.link != b.link}
    assert pairs(first) | {frozenset(pair[:2]) for pair in first.skipped_pairs} == everything
    assert len(first.self_pairs) + len(first.skipped_pairs) == len(everything)
    assert all(i < j for i, j in first.self_pairs)


def test_road_rail_excavator_rows(rre20: MachineModel) -> None:
    """The rows of the domain facts, and the class's limits."""
    assert rre20.joint_names == ("swing", "boom", "stick", "bucket", "tilt", "rotate")
    assert rre20.undercarriage.kind == "rail"
    np.testing.assert_allclose(np.degrees(rre20.q_min[1:5]), [-45, -150, -150, -45])
    np.testing.assert_allclose(np.degrees(rre20.q_max[1:5]), [65, -30, 40, 45])
    assert rre20.continuous.tolist() == [True, False, False, False, False, True]
    np.testing.assert_allclose(np.degrees(rre20.speed_positive[:4]), [54, 25, 35, 60])
    straight = rre20.forward([0.0, 0.0, 0.0, 0.0, 0.0, 0.0]).T_machine_links[:, :3, 3]
    np.testing.assert_allclose(straight[:5, 0], [0, 0.1, 5.3, 7.7, 8.1], atol=1e-12)
    np.testing.assert_allclose(straight[1:5, 2], 1.9, atol=1e-12)


def test_road_rail_excavator_home(rre20: MachineModel) -> None:
    x, y, z = rre20.tool_pose(rre20.forward(rre20.home))[:3, 3]
    assert 6.0 <= x <= 7.0 and abs(y) < 1e-12 and 1.8 <= z <= 2.5


def test_the_levers_follow_the_iso_pattern(rre20: MachineModel) -> None:
    """Pushed to its positive side, each lever does what the driver expects of it."""
    kin = rre20.forward(rre20.home)
    jacobian = rre20.tool_jacobian(kin)
    levers = dict(zip(rre20.levers, range(6), strict=True))

    def push(lever: str) -> Floats:
        j = levers[lever]
        motion: Floats = jacobian[:, j] * rre20.lever_signs[j]
        return motion

    assert push("left_x")[1] < 0, "left lever to the right turns right"
    assert push("left_y")[0] > 0, "left lever forward reaches out"
    assert push("right_y")[2] < 0, "right lever forward lowers"
    assert push("right_x")[0] > 0, "right lever to the right opens the bucket outwards"


def test_the_tiltrotator_axes(rre20: MachineModel) -> None:
    """Hanging tool: pin across, tilt axis fore and aft 0.4 m below, rotation axis down and through the tilt axis."""
    kin = rre20.forward(rre20.home)
    J = kin.spatial_jacobian
    np.testing.assert_allclose(J[3:, 3], [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(J[3:, 4], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(J[3:, 5], [0, 0, -1], atol=1e-12)
    pin, crossing, tool = kin.T_machine_links[3, :3, 3], kin.T_machine_links[5, :3, 3], rre20.tool_pose(kin)[:3, 3]
    np.testing.assert_allclose(crossing - pin, [0, 0, -0.4], atol=1e-12)
    np.testing.assert_allclose(tool - crossing, [0, 0, -1.4], atol=1e-12)
    on_the_axes = rre20.point_jacobians(kin, [6, 6], [crossing, tool])
    np.testing.assert_allclose(on_the_axes[:, :, 5], 0.0, atol=1e-12)
    np.testing.assert_allclose(on_the_axes[0, :, 4], 0.0, atol=1e-12)


def inside(T: Floats, half_extents: Floats, points: Floats) -> bool:
    return bool((np.abs(apply(inverse(T), points)) <= half_extents + 1e-9).all())


@pytest.mark.parametrize("attachment", ["grading bucket", "sleeper grab"])
def test_the_attachments_box_encloses_the_bracket_however_it_is_turned(attachment: str) -> None:
    machine = load_machine("rre20", attachment)
    index = next(i for i, solid in enumerate(machine.solids) if solid.name == "attachment")
    # in the bracket's frame: x from the pin down, 0.25 m either way along the pin, 0.2 m fore and aft
    bracket = Box(translation(-0.2, 0.0, 0.0), np.array([0.3, 0.25, 0.2])).vertices
    for tilt, rotation in itertools.product(np.radians([-45, -26.6, 0, 10, 45]), np.linspace(-np.pi, np.pi, 25)):
        q = machine.home.copy()
        q[4:] = tilt, rotation
        kin = machine.forward(q)
        poses, halves = machine.solid_poses(kin)
        assert inside(poses[index], halves[index], apply(kin.T_machine_links[4], bracket))
        assert inside(poses[index], halves[index], machine.tool_pose(kin)[:3, 3])


def test_boxes_hold_their_links_from_joint_to_joint(rre20: MachineModel) -> None:
    """Each arm's axis lies in its own box, the boom's first metre in the cabin's while the boom is kept clear."""
    names = [solid.name for solid in rre20.solids]
    for boom in np.radians(np.arange(-45.0, 65.1, 2.5)):
        q = rre20.home.copy()
        q[1] = boom
        kin = rre20.forward(q)
        poses, halves = rre20.solid_poses(kin)
        foot, tip, pin = (kin.T_machine_links[k, :3, 3] for k in (1, 2, 3))
        boxes = {name: (poses[i], halves[i]) for i, name in enumerate(names)}
        for share in np.linspace(0.0, 1.0, 60):
            along = foot + share * (tip - foot)
            if boom > np.radians(-25.0):  # below, the boom's box has met the undercarriage's
                assert inside(*boxes["boom"], along) or inside(*boxes["cabin"], along)
            assert inside(*boxes["stick"], tip + share * (pin - tip))


def test_the_rear_radius_is_that_of_a_rail_machine(rre20: MachineModel) -> None:
    poses, halves = rre20.solid_poses(rre20.forward(rre20.home))
    tail = next(i for i, solid in enumerate(rre20.solids) if solid.name == "tail")
    corners = Box(poses[tail], halves[tail]).vertices
    assert 1.5 <= np.linalg.norm(corners[:, :2], axis=1).max() <= 2.0
    assert corners[:, 0].max() < -1.0


def test_road_rail_excavator_pairs(rre20: MachineModel) -> None:
    assert [solid.link for solid in rre20.solids] == [0, 1, 1, 2, 3, 6]
    assert pairs(rre20) == {
        frozenset(pair)
        for pair in (
            ("undercarriage", "boom"),
            ("undercarriage", "stick"),
            ("undercarriage", "attachment"),
            ("cabin", "stick"),
            ("cabin", "attachment"),
            ("boom", "attachment"),
        )
    }


@pytest.mark.parametrize(("name", "tool"), [("sun-a", "bucket"), ("brokk5", "breaker")])
def test_tools_are_kept_off_undercarriage_and_cabin(name: str, tool: str) -> None:
    kept = pairs(load_machine(name))
    cabin = "turret" if name == "brokk5" else "cabin"
    assert {frozenset((tool, "undercarriage")), frozenset((tool, cabin))} <= kept


@pytest.mark.parametrize("name", ["sun-a", "sun-b"])
def test_the_small_excavators_reach(name: str) -> None:
    """Boom 30°, stick -60°, bucket +30°: the reach the study prints is 4.01 m."""
    machine = load_machine(name)
    q = np.radians([25.0, 30.0, -60.0, 30.0])
    assert np.hypot(*machine.tool_pose(machine.forward(q))[:2, 3]) == pytest.approx(4.013, abs=5e-4)
    steps = np.diff(machine.forward(q).T_machine_links[1:, :3, 3], axis=0)
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), [1.72, 0.951, 0.7], atol=1e-12)


def test_the_demolition_robot() -> None:
    machine = load_machine("brokk5")
    assert machine.n == 5
    assert machine.exclusive_groups == ((1,), (0, 2, 3, 4))
    assert {stopping.dead_time_s for stopping in machine.stopping_positive + machine.stopping_negative} == {1.3}
    text = (resources.files("workgauge") / "shipped" / "machines" / "brokk5.yaml").read_text()
    assert text.count("assumed: true") >= 1 + machine.n


def test_stopping_and_pump_in_si(rre20: MachineModel) -> None:
    assert rre20.stopping_positive[0] == Stopping(0.2, 0.15, np.radians(35.0), 0.3)
    assert rre20.stopping_negative[1].dead_time_s == 0.25
    assert Stopping().ideal and not rre20.stopping_positive[0].ideal
    assert rre20.pump is not None
    assert rre20.pump.flow == pytest.approx(320 / 60000)
    np.testing.assert_allclose(rre20.pump.flow_positive * 60000, [150, 240, 180, 130, 40, 50])
    np.testing.assert_allclose(rre20.pump.flow_negative * 60000, [150, 160, 200, 160, 40, 50])


def test_antennas_turn_with_the_cabin(rre20: MachineModel) -> None:
    antennas = [sensor for sensor in rre20.sensors if sensor.kind == "gnss_antenna"]
    assert [rre20.link_names[sensor.link] for sensor in antennas] == ["cabin", "cabin"]
    q = rre20.home.copy()
    for swing in (0.0, 1.0):
        q[0] = swing
        left, right = (
            (rre20.forward(q).T_machine_links[sensor.link] @ sensor.T_link_sensor)[:3, 3] for sensor in antennas
        )
        expected = rotation_z(swing)[:3, :3] @ [0.0, 2.2, 0.0]
        np.testing.assert_allclose(left - right, expected, atol=1e-12)
        assert left[2] == pytest.approx(3.45)
