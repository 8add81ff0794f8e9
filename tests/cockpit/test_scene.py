"""What is drawn round the machine goes with it."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

pytest.importorskip("viser", reason="the cockpit's extra is not installed")

from workgauge.cockpit.looks import read_mesh
from workgauge.cockpit.quaternions import quaternion, rotation_of
from workgauge.cockpit.scene import (
    DRAWN_M,
    LINES,
    LONGEST_LINE_M,
    REDRAWN_M,
    Boxes,
    Clearances,
    Limits,
    Tracks,
    _near_faces,
)
from workgauge.gauge.meshes import mesh_parts
from workgauge.machine.load import machine_from
from workgauge.machine.model import MachineModel
from workgauge.machine.parts import LinkMesh
from workgauge.rehearse.session import Session
from workgauge.rehearse.shipped import shipped_path
from workgauge.values.errors import MachineError
from workgauge.values.station import Near
from workgauge.values.transforms import rotation, translation


class Drawn:
    """Stands in for viser's scene: nodes by name, with what was asked for."""

    def __init__(self) -> None:
        self.nodes: dict[str, SimpleNamespace] = {}

    def __getattr__(self, kind: str):
        def add(name: str, *given: object, **rest: object) -> SimpleNamespace:
            assert kind.startswith("add_") and name not in self.nodes
            node = SimpleNamespace(**{"given": given, "remove": lambda: self.nodes.pop(name), "visible": True} | rest)
            self.nodes[name] = node
            return node

        return add


@pytest.fixture(scope="module")
def session() -> Session:
    return Session()


def corners(drawn: Drawn) -> np.ndarray:
    return np.concatenate([node.given[0] + np.array(node.position) for node in drawn.nodes.values()])


def test_limits_are_drawn_where_the_machine_is(session: Session) -> None:
    drawn = Drawn()
    at = session.true_state[1][:3, 3]
    limits = Limits(drawn, session.limit_set.limits, at)
    before = set(drawn.nodes)
    assert not limits.follow(at + np.array([0.8 * REDRAWN_M, 0.0, 0.0])), "not at every step"
    ahead = session.true_state[1][:3, 0]
    for far in (1.2 * REDRAWN_M, 3.5 * REDRAWN_M):
        there = at + far * ahead
        assert limits.follow(there)
        every = np.concatenate([part.vertices for one in session.limit_set.limits for part in mesh_parts(one.solid)])
        inside = np.linalg.norm((every - there)[:, :2], axis=1) < DRAWN_M
        assert inside.any() and cKDTree(corners(drawn)).query(every[inside])[0].max() < 1e-3
        assert not limits.follow(there)
    assert set(drawn.nodes) != before
    gone = sum(len(nodes) for nodes in limits._of.values())
    assert gone == len(drawn.nodes), "nothing of where it was is left"
    limits.update((), (), ())
    assert limits.follow(at) and set(drawn.nodes) == before


def test_what_is_off_stays_off_when_drawn_anew(session: Session) -> None:
    drawn = Drawn()
    at = session.true_state[1][:3, 3]
    limits = Limits(drawn, session.limit_set.limits, at)
    state = sorted(session.states)[0]
    off = [one.id for one in session.limit_set.limits if one.activity.state == state]
    for _ in range(2):
        limits.update((state,), (), ())
        assert off and all(not node.visible for name in off for node in limits._of[name])
        limits.follow(at + np.array([2.0 * REDRAWN_M, 0.0, 0.0]))


def test_limits_whose_names_look_alike_are_all_drawn(session: Session) -> None:
    drawn = Drawn()
    one = next(one for one in session.limit_set.limits if one.id == "point:P1-12")
    alike = [replace(one, id=name) for name in ("point:a/b", "point:a-b", "point:a?b")]
    limits = Limits(drawn, alike, session.true_state[1][:3, 3])
    assert {limit.id for limit in alike} == set(limits._of)
    assert len(drawn.nodes) == len(alike) * len(list(mesh_parts(one.solid)))


def test_a_face_that_spans_the_place_is_near_however_far_its_corners() -> None:
    corners = np.array([[-1e4, -1e4, 0.0], [1e4, -1e4, 0.0], [0.0, 1e4, 0.0], [2e4, 2e4, 0.0]])
    faces = np.array([[0, 1, 2], [1, 3, 2]])
    assert _near_faces(corners, faces, np.zeros(3))[0].tolist() == [0, 1, 2]
    assert not len(_near_faces(corners, faces, np.array([0.0, -3e4, 0.0])))


def test_rails_lie_at_the_machines_gauge_and_follow_the_track(session: Session) -> None:
    drawn = Drawn()
    Tracks(drawn, session, session.true_state[1][:3, 3])
    rails = [node.given[0] for name, node in drawn.nodes.items() if "/rail " in name]
    one, other = rails[:2]
    apart = np.linalg.norm(one[:, 0] - other[:, 0], axis=1)
    track = next(iter(session.site.alignments))
    assert apart == pytest.approx(track.cant_gauge_m or session.machine.undercarriage.gauge_m, abs=1e-3)


nears = st.lists(st.tuples(st.sampled_from("abcdefg"), st.floats(0.0, 9.0)), max_size=7, unique_by=lambda one: one[0])


@given(st.lists(nears, min_size=2, max_size=6))
def test_every_near_limit_has_a_line_and_keeps_it_while_it_is_near(course: list[list[tuple[str, float]]]) -> None:
    drawn = Drawn()
    lines = Clearances(drawn)
    before: dict[str, str] = {}
    for moment in course:
        ends = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
        near = [Near("boom", name, name, "zone", m, 0.0, None, *ends) for name, m in moment]
        near.sort(key=lambda one: one.distance_m)
        lines.update(near, 0.2)
        labels = {name: node for name, node in drawn.nodes.items() if "metres" in name and node.visible}
        now = {node.text.split()[-1]: name for name, node in labels.items()}
        expected = [one for one in near if one.distance_m < LONGEST_LINE_M][:LINES]
        assert {node.text for node in labels.values()} == {f"{one.distance_m:.2f} m {one.name}" for one in expected}
        assert all(now[name] == before[name] for name in now.keys() & before.keys())
        before = now


def test_tracks_name_where_the_machine_is(session: Session) -> None:
    drawn = Drawn()
    at = session.true_state[1][:3, 3]
    tracks = Tracks(drawn, session, at)
    named = {node.given[0] for node in drawn.nodes.values() if node.given and isinstance(node.given[0], str)}
    assert any("Track 1 " in text for text in named)
    assert tracks.follow(at + 1.5 * REDRAWN_M * session.true_state[1][:3, 0])
    after = {node.given[0] for node in drawn.nodes.values() if node.given and isinstance(node.given[0], str)}
    assert any("Track 1 " in text for text in after) and after != named


@given(st.tuples(*[st.floats(-3.2, 3.2)] * 3))
def test_quaternions_turn_as_the_rotation_does(vector: tuple[float, ...]) -> None:
    R = rotation(np.array(vector))[:3, :3]
    found = quaternion(R)
    assert np.linalg.norm(found) == pytest.approx(1.0)
    assert Rotation.from_quat(found, scalar_first=True).as_matrix() == pytest.approx(R, abs=1e-9)
    assert rotation_of(np.array(found)) == pytest.approx(R, abs=1e-9)


@pytest.fixture
def pictured(tmp_path: Path) -> MachineModel:
    """rre20 whose stick is drawn by a mesh in millimetres, and whose tool by another."""
    trimesh.creation.box((2400.0, 300.0, 400.0)).export(tmp_path / "stick.stl")
    trimesh.creation.icosphere(radius=0.5).export(tmp_path / "tool.ply")
    description = yaml.safe_load(shipped_path("machines", "rre20.yaml").read_text())
    description["meshes"] = [{"link": "stick", "file": "stick.stl", "position_m": [-1.2, 0, 0], "scale": 0.001}]
    description["attachments"][0]["meshes"] = [{"file": "tool.ply"}]
    return machine_from(description, folder=tmp_path)


def test_links_look_as_their_meshes_and_the_others_as_their_boxes(pictured: MachineModel) -> None:
    drawn, T = Drawn(), translation(10.0, 20.0, 3.0)
    Boxes(drawn, pictured, "/m", (1, 2, 3)).place(pictured.home, T)
    meshed = {pictured.link_names.index("stick"), pictured.n}
    boxes = [i for i, solid in enumerate(pictured.solids) if solid.link not in meshed]
    assert set(drawn.nodes) == {"/m", "/m/mesh 0", "/m/mesh 1", *(f"/m/{i}" for i in boxes)}
    stick = drawn.nodes["/m/mesh 0"]
    corners = np.asarray(stick.given[0]) @ rotation_of(np.array(stick.wxyz)).T + stick.position
    kin = pictured.forward(pictured.home)
    here = np.linalg.inv(kin.T_machine_links[pictured.link_names.index("stick")])
    local = corners @ here[:3, :3].T + here[:3, 3]
    assert local.min(axis=0) == pytest.approx([-2.4, -0.15, -0.2], abs=1e-6)
    assert local.max(axis=0) == pytest.approx([0.0, 0.15, 0.2], abs=1e-6)
    ghost = Drawn()
    Boxes(ghost, pictured, "/g", (1, 2, 3), 0.4).place(pictured.home, T)
    assert len(ghost.nodes) == 1 + len(pictured.solids), "a ghost is what is measured"


@pytest.mark.parametrize("content", [b"", b"solid nothing\nendsolid nothing\n", b"no mesh", bytes(200)])
def test_a_mesh_that_is_none_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x.stl").write_bytes(content)
    with pytest.raises(MachineError, match="mesh"):
        read_mesh(LinkMesh(0, tmp_path / "x.stl", np.eye(4), np.ones(3)))
