"""The scenes that provoke chatter are what they say, and the potential field they are meant for is the document's."""

import importlib
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from workgauge.guard.api import GuardInput
from workgauge.proximity.scene import Scene
from workgauge.rehearse.run import open_session
from workgauge.rehearse.scenario_file import load_scenario
from workgauge.rehearse.session import Session
from workgauge.rehearse.shipped import shipped_names
from workgauge.values.arrays import Floats, frozen, frozen_ints
from workgauge.values.clearances import Clearances

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(scope="module", autouse=True)
def beside():
    """Benchmarks import each other by name."""
    sys.path.insert(0, str(BENCHMARKS))
    yield
    sys.path.remove(str(BENCHMARKS))


@pytest.fixture(scope="module")
def potential(beside):
    """The module of the potential field."""
    return importlib.import_module("baselines_potential")


def session_of(name: str) -> Session:
    return open_session(load_scenario(name))


def seen(session: Session, q: Floats) -> Clearances:
    scene = Scene(session.machine, session.limits)
    return scene.query(session.machine.forward(q), session.true_state[1], 3.0)


def test_rule_books_of_scenes_are_no_scenarios() -> None:
    names = shipped_names("scenarios")
    assert {"slide-along-envelope", "between-limits"} <= set(names)
    assert not any("rules" in name for name in names)


def test_between_limits_is_between_them() -> None:
    session = session_of("between-limits")
    found = seen(session, session.true_state[0])
    stick = {one.limit: one.distance_m for one in found if one.link == "stick" and not one.limit.startswith("self:")}
    assert set(stick) == {"zone:Girder", "zone:Deck"}
    assert abs(stick["zone:Girder"] - stick["zone:Deck"]) < 0.1
    others = [one.distance_m for one in found if one.link not in {"boom", "stick"} and one.limit.startswith("zone:")]
    assert min(others) > min(stick.values())


def test_the_slide_s_closest_point_jumps_while_the_distance_does_not() -> None:
    session = session_of("slide-along-envelope")
    machine, q = session.machine, np.array(session.true_state[0])
    q[machine.joint_names.index("swing")] = np.radians(13.0)

    def nearest(rotate_deg: float) -> tuple[float, Floats]:
        q[machine.joint_names.index("rotate")] = np.radians(rotate_deg)
        one = next(c for c in seen(session, q) if c.link == "attachment" and c.limit == "track:Track 2")
        return one.distance_m, one.point_machine

    turned = [nearest(angle) for angle in np.linspace(6.0, 10.0, 81)]  # steps of 0.05 degrees
    jumps = [float(np.linalg.norm(b[1] - a[1])) for a, b in pairwise(turned)]
    changes = [abs(b[0] - a[0]) for a, b in pairwise(turned)]
    assert max(jumps) > 1.0
    assert max(changes) < 0.002


def given(desired: Floats, distances: list[float], rows: Floats, **more: Floats) -> GuardInput:
    """A guard's input of three joints; all clearances are of link 0 unless `links` says otherwise."""
    k = len(distances)
    clearances = Clearances(
        distances=np.array(distances),
        normals=np.zeros((k, 3)),
        points_machine=np.zeros((k, 3)),
        points_limit=np.zeros((k, 3)),
        links=frozen_ints(more.pop("links", np.zeros(k))),
        other_links=frozen_ints([-1] * k),
        limits=frozen_ints(np.arange(k)),
        cells=frozen_ints([-1] * k),
        solids=frozen_ints(np.zeros(k)),
        protections=more.pop("protections", np.zeros(k)),
        stop_distances=more.pop("stop_distances", np.full(k, np.nan)),
        link_names=("boom", "stick"),
        limit_ids=tuple(f"limit-{i}" for i in range(k)),
        searched_m=9.0,
    )
    return GuardInput(
        desired=frozen(desired),
        q=frozen(np.zeros(3)),
        q_min=frozen(np.full(3, -3.0)),
        q_max=frozen(np.full(3, 3.0)),
        speed_positive=frozen(np.full(3, 5.0)),
        speed_negative=frozen(np.full(3, 5.0)),
        clearances=clearances,
        rows=rows,
        dt_s=0.01,
        joint_names=("a", "b", "c"),
        exclusive_groups=(),
    )


WISH = np.array([0.1, 0.0, 0.0])


def test_the_field_is_the_equation_s(potential) -> None:  # type: ignore[no-untyped-def]
    field = potential.PotentialField(mu=0.02, cap_m_s=50.0)
    for p in (0.1, 0.2, 0.5, 0.79):
        assert field.speed(np.array([p]))[0] == pytest.approx(0.02 * (1 / p - 1 / 0.8) / p**2)
    assert field.speed(np.array([0.8, 0.81, 5.0])).tolist() == [0.0, 0.0, 0.0]
    assert potential.PotentialField().speed(np.array([0.01, 0.0, -1.0])).tolist() == [1.0, 1.0, 1.0]


def test_it_pushes_the_point_out_at_that_speed(potential) -> None:  # type: ignore[no-untyped-def]
    field = potential.PotentialField(damping=0.0)
    rows = np.array([[4.0, 2.0, 0.5]])
    result, _ = field.allow(given(WISH, [0.3], rows), field.start())
    added = result.allowed - WISH
    assert float(rows[0] @ added) == pytest.approx(float(field.speed(np.array([0.3]))[0]))
    assert np.linalg.matrix_rank(np.stack([added, rows[0]]), tol=1e-9) == 1


def test_it_takes_off_what_is_unsure_and_what_a_limit_s_own_stop_distance_says(potential) -> None:  # type: ignore[no-untyped-def]
    field = potential.PotentialField()
    rows = np.array([[4.0, 2.0, 0.5]])
    plain, _ = field.allow(given(WISH, [0.3], rows), field.start())
    unsure, _ = field.allow(given(WISH, [0.4], rows, protections=np.array([0.1])), field.start())
    own, _ = field.allow(given(WISH, [0.15], rows, stop_distances=np.array([0.05])), field.start())
    assert np.allclose(plain.allowed, unsure.allowed)
    assert np.allclose(plain.allowed, own.allowed)


def test_one_closest_point_per_link_forgets_the_other_limit(potential) -> None:  # type: ignore[no-untyped-def]
    rows = np.array([[4.0, 0.0, 0.0], [0.0, 4.0, 0.0]])
    per_link, each = potential.PotentialField(), potential.PotentialField(per_link=False)
    near = given(WISH, [0.30, 0.31], rows)
    assert per_link.allow(near, {})[0].allowed[1] == 0.0
    assert each.allow(near, {})[0].allowed[1] > 0.0
    on_two_links = given(WISH, [0.30, 0.31], rows, links=np.array([0, 1]))
    assert per_link.allow(on_two_links, {})[0].allowed[1] > 0.0


def test_it_leaves_a_machine_alone_that_nobody_moves_and_one_that_is_far(potential) -> None:  # type: ignore[no-untyped-def]
    field = potential.PotentialField()
    rows = np.array([[4.0, 2.0, 0.5]])
    assert not field.allow(given(np.zeros(3), [0.3], rows), {})[0].allowed.any()
    assert field.allow(given(WISH, [0.9], rows), {})[0].allowed.tolist() == WISH.tolist()
    assert not field.allow(given(np.full(3, np.nan), [0.9], rows), {})[0].allowed.any()


def test_the_benchmark_s_rows(beside) -> None:  # type: ignore[no-untyped-def]
    chatter = importlib.import_module("chatter")
    found = chatter.measure(["between-limits"], ["ideal"], ["linear"])
    (row,) = found["rows"]
    assert set(row) == {
        *("scene", "joints", "guard", "chatter", "by_joint", "share_of_potential", "share_of_nearest_pair"),
        *("motion_rad", "min_clearance_m", "entries"),
    }
    assert row["entries"] == 0
    assert row["chatter"] < 0.02
    assert row["share_of_potential"] is None
