"""What is drawn round the machine goes with it."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

pytest.importorskip("viser", reason="the cockpit's extra is not installed")

from workgauge.cockpit.scene import DRAWN_M, REDRAWN_M, Limits, Tracks, quaternion
from workgauge.gauge.meshes import mesh_parts
from workgauge.rehearse.session import Session
from workgauge.values.transforms import rotation


class Drawn:
    """Stands in for viser's scene: nodes by name, with what was asked for."""

    def __init__(self) -> None:
        self.nodes: dict[str, SimpleNamespace] = {}

    def __getattr__(self, kind: str):
        def add(name: str, *given: object, **rest: object) -> SimpleNamespace:
            assert kind.startswith("add_") and name not in self.nodes
            node = SimpleNamespace(given=given, remove=lambda: self.nodes.pop(name), visible=True, **rest)
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
    limits.update((), frozenset(), ())
    assert limits.follow(at) and set(drawn.nodes) == before


def test_what_is_off_stays_off_when_drawn_anew(session: Session) -> None:
    drawn = Drawn()
    at = session.true_state[1][:3, 3]
    limits = Limits(drawn, session.limit_set.limits, at)
    state = sorted(session.states)[0]
    off = [one.id for one in session.limit_set.limits if one.activity.state == state]
    for _ in range(2):
        limits.update((state,), frozenset(), ())
        assert off and all(not node.visible for name in off for node in limits._of[name])
        limits.follow(at + np.array([2.0 * REDRAWN_M, 0.0, 0.0]))


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
