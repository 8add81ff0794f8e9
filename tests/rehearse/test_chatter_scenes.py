"""The scenes that provoke chatter are what they say, and the potential fields beside them the document's and ours."""

import importlib
import sys
from dataclasses import fields
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from workgauge.guard.potential import Points, PotentialGuard
from workgauge.proximity.scene import Scene
from workgauge.rehearse.run import open_session
from workgauge.rehearse.scenario_file import load_scenario
from workgauge.rehearse.session import Session
from workgauge.rehearse.shipped import shipped_names
from workgauge.values.arrays import Floats
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


def test_the_potential_fields_compared_are_the_printed_ones_and_the_program_s_own(potential) -> None:  # type: ignore[no-untyped-def]
    made = {name: make(stop_distance_m=0.2) for name, make in potential.BASELINES.items()}
    assert {name: guard.name for name, guard in made.items()} == {name: name for name in made}
    assert [(guard.points, guard.hold) for guard in made.values()] == [
        *((Points.PER_LINK, False), (Points.PER_LIMIT, False), (Points.PER_LIMIT, True))
    ]
    own = PotentialGuard()
    last = made["potential-each-limit-held"]
    assert all(getattr(last, field.name) == getattr(own, field.name) for field in fields(own))


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
