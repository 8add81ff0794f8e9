"""URDF machines: against the same arm in rows, against pinocchio's own reader, and against a published excavator."""

import copy
import re
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.machine.load import machine_from
from workgauge.machine.model import MachineModel
from workgauge.machine.urdf import urdf_chain, urdf_meshes
from workgauge.values.arrays import Floats
from workgauge.values.errors import MachineError
from workgauge.values.transforms import rotation_x, rotation_z, rpy, translation

ZX200 = Path(__file__).parents[2].parent / "shared" / "data" / "machine" / "zx200" / "zx200.xacro"

ARM: dict[str, Any] = {
    "title": "arm",
    "undercarriage": {"kind": "wheels", "gauge_m": 2.0},
    "base": {"position_m": [0.2, -0.1, 0.3], "rpy_deg": [1.0, 2.0, 3.0]},
    "joints": [
        {
            "name": "swing",
            "link": "cabin",
            "type": "revolute",
            "continuous": True,
            "home_deg": 10,
            "speed_positive_deg_s": 40,
            "speed_negative_deg_s": 40,
            "dh": {"a_m": 0.3, "alpha_deg": 90, "d_m": 1.2, "theta_deg": 20},
        },
        {
            "name": "boom",
            "link": "boom",
            "type": "revolute",
            "lower_deg": -40,
            "upper_deg": 70,
            "home_deg": 30,
            "speed_positive_deg_s": 25,
            "speed_negative_deg_s": 20,
            "dh": {"a_m": 4.0, "alpha_deg": -35, "d_m": 0.1},
        },
        {
            "name": "reach",
            "link": "reach",
            "type": "prismatic",
            "lower_m": -0.2,
            "upper_m": 1.8,
            "home_m": 0.5,
            "speed_positive_m_s": 0.4,
            "speed_negative_m_s": 0.3,
            "dh": {"a_m": 0.2, "alpha_deg": 15, "d_m": 1.0, "theta_deg": -50},
        },
    ],
    "solids": [{"name": "reach", "link": "reach", "centre_m": [0, 0, -0.5], "size_m": [0.3, 0.3, 1.5]}],
    "attachments": [{"name": "hook", "tool": {"position_m": [0.1, 0.2, 0.3], "rpy_deg": [5, 6, 7]}}],
}


def origin(T: Floats) -> str:
    numbers = [
        " ".join(repr(float(x)) for x in part) for part in (T[:3, 3], pin.rpy.matrixToRpy(np.array(T[:3, :3])))
    ]
    return f'<origin xyz="{numbers[0]}" rpy="{numbers[1]}"/>'


def joint(name: str, kind: str, parent: str, child: str, inside: str) -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<link name="{child}"/><joint name="{name}" type="{kind}">{ends}{inside}</joint>'


def arm_as_urdf() -> str:
    """The arm of ARM: each joint frame is the frame before its row, the last row ends in a fixed tip."""
    body, T, parent = '<link name="base_link"/>', np.eye(4), "base_link"
    for spec in ARM["joints"]:
        row = spec["dh"]
        kind = "prismatic" if spec["type"] == "prismatic" else "continuous" if "continuous" in spec else "revolute"
        limit = ""
        if kind == "revolute":
            low, high = np.radians([spec["lower_deg"], spec["upper_deg"]])
            limit = f'<limit lower="{low!r}" upper="{high!r}" velocity="0.25" effort="1"/>'.replace("np.float64", "")
            limit = limit.replace("(", "").replace(")", "")
        elif kind == "prismatic":
            limit = f'<limit lower="{spec["lower_m"]}" upper="{spec["upper_m"]}" velocity="0.25" effort="1"/>'
        T = T @ rotation_z(np.radians(row.get("theta_deg", 0.0)))
        body += joint(spec["name"], kind, parent, spec["name"] + "_link", origin(T) + '<axis xyz="0 0 2"/>' + limit)
        T = translation(row["a_m"], 0, row["d_m"]) @ rotation_x(np.radians(row["alpha_deg"]))
        parent = spec["name"] + "_link"
    body += joint("to_tip", "fixed", parent, "tip", origin(T))
    body += joint("side", "revolute", "boom_link", "mirror", "<axis xyz='1 0 0'/>")  # hangs beside the chain
    return f'<?xml version="1.0"?><robot name="arm">{body}</robot>'


def with_urdf(folder: Path, text: str) -> dict[str, Any]:
    (folder / "arm.urdf").write_text(text)
    description = copy.deepcopy(ARM)
    description["urdf"] = {"file": "arm.urdf", "base_link": "base_link", "tip_link": "tip"}
    for spec in description["joints"]:
        del spec["dh"]
    return description


@pytest.fixture
def from_urdf(tmp_path: Path) -> MachineModel:
    return machine_from(with_urdf(tmp_path, arm_as_urdf()), folder=tmp_path)


def test_rows_and_urdf_of_one_arm_agree(from_urdf: MachineModel) -> None:
    rows = machine_from(ARM)
    rng = np.random.default_rng(1)
    for _ in range(50):
        q = rng.uniform(rows.sample_min, rows.sample_max)
        ours, theirs = rows.forward(q), from_urdf.forward(q)
        np.testing.assert_allclose(ours.T_machine_links[-1], theirs.T_machine_links[-1], atol=1e-9)
        np.testing.assert_allclose(rows.tool_pose(ours), from_urdf.tool_pose(theirs), atol=1e-9)
        np.testing.assert_allclose(rows.tool_jacobian(ours), from_urdf.tool_jacobian(theirs), atol=1e-9)
        np.testing.assert_allclose(rows.solid_poses(ours)[0], from_urdf.solid_poses(theirs)[0], atol=1e-9)
        for k, row in enumerate(ARM["joints"][:-1], start=1):
            fixed = translation(row["dh"]["a_m"], 0, row["dh"]["d_m"]) @ rotation_x(
                np.radians(row["dh"]["alpha_deg"])
            )
            np.testing.assert_allclose(ours.T_machine_links[k], theirs.T_machine_links[k] @ fixed, atol=1e-9)


def test_limits_and_speeds_left_out_come_from_the_urdf(tmp_path: Path) -> None:
    description = with_urdf(tmp_path, arm_as_urdf())
    for spec in description["joints"][1:]:
        for key in list(spec):
            if key.startswith(("lower", "upper", "speed_positive")):
                del spec[key]
    del description["joints"][0]["continuous"]
    del description["joints"][2]["link"]
    description["solids"][0]["link"] = "tip"
    machine = machine_from(description, folder=tmp_path)
    np.testing.assert_allclose(machine.q_min, [-np.inf, np.radians(-40), -0.2])
    np.testing.assert_allclose(machine.q_max, [np.inf, np.radians(70), 1.8])
    np.testing.assert_allclose(machine.speed_positive, [np.radians(40), 0.25, 0.25])
    np.testing.assert_allclose(machine.speed_negative, [np.radians(40), np.radians(20), 0.3])
    assert machine.continuous.tolist() == [True, False, False]
    assert machine.link_names == ("undercarriage", "cabin", "boom", "tip")


numbers = st.floats(-3.0, 3.0)
triples = st.tuples(numbers, numbers, numbers)
moving = st.tuples(st.sampled_from(["revolute", "prismatic", "fixed"]), triples, triples, triples)


@settings(max_examples=60, deadline=None)
@given(st.lists(moving, min_size=1, max_size=8), st.lists(numbers, min_size=8, max_size=8))
def test_chains_with_any_axis_agree_with_pinocchio(
    tmp_path_factory: pytest.TempPathFactory, parts: list[Any], positions: list[float]
) -> None:
    text, names = '<link name="l0"/>', []
    for i, (kind, xyz, angles, axis) in enumerate(parts):
        direction = axis if np.linalg.norm(axis) > 1e-3 else (0.0, 1.0, 0.0)
        inside = "".join(
            f"<{tag} {keys}/>"
            for tag, keys in (
                ("origin", f'xyz="{xyz[0]} {xyz[1]} {xyz[2]}" rpy="{angles[0]} {angles[1]} {angles[2]}"'),
                ("axis", f'xyz="{direction[0]} {direction[1]} {direction[2]}"'),
                ("limit", 'lower="-9" upper="9" velocity="1" effort="1"'),
            )
        )
        text += joint(f"j{i}", kind, f"l{i}", f"l{i + 1}", inside)
        names += [f"j{i}"] if kind != "fixed" else []
    if not names:
        return
    xml = f'<?xml version="1.0"?><robot name="any">{text}</robot>'
    path = tmp_path_factory.mktemp("urdf") / "any.urdf"
    path.write_text(xml)
    chain = urdf_chain(path, "l0", f"l{len(parts)}", np.eye(4))
    assert [found.geometry.name for found in chain] == names
    model = pin.buildModelFromXML(xml)
    data = model.createData()
    q = np.array(positions[: model.nq])
    pin.framesForwardKinematics(model, data, q)
    T = np.eye(4)
    for found, value in zip(chain, q, strict=True):
        g = found.geometry
        motion = np.eye(4)
        if g.prismatic:
            motion[:3, 3] = g.axis * value
        else:
            motion[:3, :3] = pin.exp3(np.array(g.axis * value))
        T = T @ g.T_parent_joint @ motion @ g.T_joint_link
    np.testing.assert_allclose(T, data.oMf[model.getFrameId(f"l{len(parts)}")].homogeneous, atol=1e-9)


def visual(name: str, xyz: str, angles: str, scale: str) -> str:
    mesh = f'<geometry><mesh filename="{name}" scale="{scale}"/></geometry>'
    return f'<visual><origin xyz="{xyz}" rpy="{angles}"/>{mesh}</visual>'


@settings(max_examples=30, deadline=None)
@given(st.lists(moving, min_size=1, max_size=6), st.lists(numbers, min_size=6, max_size=6), triples, triples)
def test_visual_meshes_stand_where_pinocchio_has_them(
    tmp_path_factory: pytest.TempPathFactory, parts: list[Any], positions: list[float], xyz: Any, angles: Any
) -> None:
    words = [" ".join(map(str, one)) for one in (xyz, angles)]
    look = visual("meshes/any.stl", *words, "0.001 0.001 -0.001")
    text, kinds = f'<link name="l0">{look}</link>', [kind for kind, *_ in parts]
    if set(kinds) == {"fixed"}:
        return
    for i, (kind, place, turn, axis) in enumerate(parts):
        direction = axis if np.linalg.norm(axis) > 1e-3 else (0.0, 1.0, 0.0)
        keys = [" ".join(map(str, one)) for one in (place, turn, direction)]
        inside = f'<origin xyz="{keys[0]}" rpy="{keys[1]}"/><axis xyz="{keys[2]}"/>'
        inside += '<limit lower="-9" upper="9" velocity="1" effort="1"/>'
        text += joint(f"j{i}", kind, f"l{i}", f"l{i + 1}", inside).replace(
            f'<link name="l{i + 1}"/>', f'<link name="l{i + 1}">{look}</link>'
        )
    path = tmp_path_factory.mktemp("urdf") / "any.urdf"
    path.write_text(f'<?xml version="1.0"?><robot name="any">{text}</robot>')
    meshes = urdf_meshes(path, "l0", f"l{len(parts)}", np.eye(4))
    assert len(meshes) == len(parts) + 1
    chain = urdf_chain(path, "l0", f"l{len(parts)}", np.eye(4))
    model = pin.buildModelFromXML(path.read_text())
    data = model.createData()
    q = np.array(positions[: model.nq])
    pin.framesForwardKinematics(model, data, q)
    links = [np.eye(4)]
    for found, value in zip(chain, q, strict=True):
        g = found.geometry
        motion = np.eye(4)
        motion[:3] = np.c_[np.eye(3), g.axis * value] if g.prismatic else np.c_[pin.exp3(g.axis * value), np.zeros(3)]
        links.append(links[-1] @ g.T_parent_joint @ motion @ g.T_joint_link)
    expected = translation(*xyz) @ rpy(*angles)
    for k, mesh in enumerate(meshes):
        theirs = data.oMf[model.getFrameId(f"l{k}")].homogeneous @ expected
        np.testing.assert_allclose(links[mesh.link] @ mesh.T_link_mesh, theirs, atol=1e-8)
        assert mesh.scale.tolist() == [0.001, 0.001, -0.001] and mesh.file == path.parent / "meshes/any.stl"


def test_a_urdfs_meshes_are_found_by_package_and_left_out_where_they_are_not(tmp_path: Path) -> None:
    arm = tmp_path / "arm_description" / "urdf"
    arm.mkdir(parents=True)
    (tmp_path / "arm_description" / "meshes").mkdir()
    (tmp_path / "arm_description" / "meshes" / "boom.STL").write_bytes(b"later")
    names = ("package://arm_description/meshes/boom.STL", "package://elsewhere/x.stl", "boom.dae")
    looks = "".join(visual(name, "0 0 0", "0 0 0", "1 1 1") for name in names)
    text = arm_as_urdf().replace('<link name="boom_link"/>', f'<link name="boom_link">{looks}</link>')
    machine = machine_from(with_urdf(arm, text), folder=arm)
    assert [(mesh.file.name, mesh.link) for mesh in machine.meshes] == [("boom.STL", 2)]


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"link": "arm"}, "unknown link"),
        ({"file": "none.stl"}, "no such file"),
        ({"file": "arm.step"}, "not a mesh that can be drawn"),
        ({"scale": 0}, "above 0"),
    ],
)
def test_a_mesh_that_cannot_be_drawn_is_refused(tmp_path: Path, changed: dict[str, Any], words: str) -> None:
    (tmp_path / "arm.stl").write_bytes(b"later")
    description = copy.deepcopy(ARM)
    mesh = {"link": "boom", "file": "arm.stl", "position_m": [1, 0, 0]}
    assert machine_from(description | {"meshes": [mesh]}, folder=tmp_path).meshes[0].link == 2
    with pytest.raises(MachineError, match=words):
        machine_from(description | {"meshes": [mesh | changed]}, folder=tmp_path)


NAMELESS = "<visual><geometry><mesh/></geometry></visual>"
FLAT = visual("a.stl", "0 0 0", "0 0 0", "1 0 1")

SPOILED = {
    "not XML": (lambda text: text[:-9], "not XML"),
    "another root": (lambda text: text.replace("robot", "machine"), "no URDF"),
    "entity": (lambda text: text.replace("?>", '?><!DOCTYPE robot [<!ENTITY a "b">]>', 1), "document type"),
    "xacro": (lambda text: text.replace('xyz="0 0 2"', 'xyz="0 0 ${pi}"'), "xacro"),
    "no tip": (lambda text: text.replace('<link name="tip"/>', ""), "no such link"),
    "cut chain": (lambda text: text.replace('<parent link="swing_link"/>', '<parent link="x"/>'), "does not hang"),
    "loop": (lambda text: text.replace('<parent link="base_link"/>', '<parent link="boom_link"/>'), "does not hang"),
    "two parents": (lambda text: text.replace('<child link="mirror"/>', '<child link="tip"/>'), "two parents"),
    "no parent": (lambda text: text.replace('<parent link="base_link"/>', ""), "without parent"),
    "floating": (lambda text: text.replace('"continuous"', '"floating"'), "cannot be driven"),
    "mimic": (lambda text: text.replace("<axis", '<mimic joint="side"/><axis'), "cannot be driven"),
    "axis": (lambda text: text.replace('xyz="0 0 2"', 'xyz="0 0 0"'), "axis without length"),
    "axis of two": (lambda text: text.replace('xyz="0 0 2"', 'xyz="0 1"'), "bad xyz"),
    "NaN": (lambda text: text.replace('xyz="0 0 2"', 'xyz="0 0 nan"'), "bad xyz"),
    "limit": (lambda text: text.replace('upper="1.8"', 'upper="far"'), "bad upper"),
    "mesh of no file": (
        lambda text: text.replace('<link name="tip"/>', f'<link name="tip">{NAMELESS}</link>'),
        "without filename",
    ),
    "flat mesh": (
        lambda text: text.replace('<link name="tip"/>', f'<link name="tip">{FLAT}</link>'),
        "scaled to nothing",
    ),
    "other kind": (lambda text: text.replace('"prismatic"', '"revolute"'), "has it otherwise"),
    "other names": (lambda text: text.replace('name="boom"', 'name="jib"'), "not the URDF's joints"),
}  # fmt: skip


@pytest.mark.parametrize("spoil", SPOILED)
def test_a_spoiled_urdf_is_refused(tmp_path: Path, spoil: str) -> None:
    change, message = SPOILED[spoil]
    text = change(arm_as_urdf())
    assert text != arm_as_urdf()
    with pytest.raises(MachineError, match=message):
        machine_from(with_urdf(tmp_path, text), folder=tmp_path)


def test_what_a_urdf_needs_and_does_not_have(tmp_path: Path) -> None:
    description = with_urdf(tmp_path, arm_as_urdf())
    description["urdf"]["file"] = "missing.urdf"
    with pytest.raises(MachineError, match=r"cannot read the URDF.*No such file"):
        machine_from(description, folder=tmp_path)
    description = with_urdf(tmp_path, arm_as_urdf().replace('velocity="0.25"', 'velocity="0"'))
    del description["joints"][1]["speed_positive_deg_s"]
    with pytest.raises(MachineError, match=r"joints\[boom\].*speed must be above 0"):
        machine_from(description, folder=tmp_path)
    description = with_urdf(tmp_path, re.sub("<limit[^>]*>", "", arm_as_urdf()))
    del description["joints"][1]["lower_deg"]
    with pytest.raises(MachineError, match=r"joints\[boom\].lower_deg: missing key"):
        machine_from(description, folder=tmp_path)
    description["urdf"]["tip_link"] = "base_link"
    with pytest.raises(MachineError, match="no moving joint"):
        machine_from(description, folder=tmp_path)


@pytest.fixture
def zx200(tmp_path: Path) -> MachineModel:
    """The published excavator: the little xacro it uses is expanded here."""
    if not ZX200.exists():
        pytest.skip("the published excavator's description is not here: ../shared/data/machine/zx200")
    text = ZX200.read_text()
    text = re.sub(r"\$\{radians\(([^)]*)\)\}", lambda found: repr(np.radians(float(found[1])).item()), text)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.S).replace('xmlns:xacro="http://www.ros.org/wiki/xacro"', "")
    (tmp_path / "zx200.urdf").write_text(text)
    names = ("swing_joint", "boom_joint", "arm_joint", "bucket_joint")
    joints = [
        {"name": name, "type": "revolute", "home_deg": home, "speed_positive_deg_s": 25, "speed_negative_deg_s": 25}
        for name, home in zip(names, (0, -30, 90, 30), strict=True)
    ]
    return machine_from(
        {
            "title": "ZX200",
            "undercarriage": {"kind": "tracks", "gauge_m": 2.2},
            "urdf": {"file": "zx200.urdf", "base_link": "base_link", "tip_link": "bucket_link"},
            "joints": joints,
            "solids": [{"name": "arm", "link": "arm_link", "centre_m": [1, 0, 1], "size_m": [3, 0.5, 0.8]}],
            "attachments": [{"name": "bucket", "tool": {"position_m": [1.2, 0, 1]}}],
        },
        folder=tmp_path,
    )


@pytest.mark.parametrize(
    ("swing", "expected"), [(0.0, (6.793033, -0.087077, 2.882942)), (1.2, (2.579480, 6.177409, 2.882942))]
)
def test_the_published_excavator(zx200: MachineModel, swing: float, expected: tuple[float, ...]) -> None:
    kin = zx200.forward([swing, -0.6, 1.5, 0.5])
    bucket_joint = kin.T_machine_links[zx200.link_names.index("bucket_link")][:3, 3]
    np.testing.assert_allclose(bucket_joint, expected, atol=1e-6)
    assert zx200.q_min.tolist() == [-np.inf, -1.137, 0.594, -0.622]
    assert zx200.q_max.tolist() == [np.inf, -0.1, 2.687, 2.372]
    assert zx200.continuous.tolist() == [True, False, False, False]


def test_rpy_is_read_as_urdf_means_it() -> None:
    np.testing.assert_allclose(rpy(0.1, -0.7, 2.0)[:3, :3], pin.rpy.rpyToMatrix(0.1, -0.7, 2.0), atol=1e-12)
