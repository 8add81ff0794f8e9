"""Self-collision pairs: the distance bound, what is kept and what is left out."""

import copy
from typing import Any

import coal
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.machine import pairs
from workgauge.machine.load import load_machine, machine_from
from workgauge.values.arrays import Floats
from workgauge.values.transforms import rpy, translation

numbers = st.floats(-3.0, 3.0)
triples = st.tuples(numbers, numbers, numbers)
halves = st.tuples(*[st.floats(0.05, 2.0)] * 3).map(np.array)
poses = st.tuples(triples, triples).map(lambda v: translation(*v[0]) @ rpy(*v[1]))


@settings(max_examples=200, deadline=None)
@given(poses, halves, poses, halves)
def test_the_gap_is_a_lower_bound_and_tells_overlap(first: Floats, a: Floats, second: Floats, b: Floats) -> None:
    gap = float(pairs._gaps(first[None], a[None], second[None], b[None])[0])
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    placed = [coal.Transform3s(np.array(T[:3, :3]), np.array(T[:3, 3])) for T in (first, second)]
    exact = coal.distance(coal.Box(*(2 * a)), placed[0], coal.Box(*(2 * b)), placed[1], request, result)
    assert gap <= exact + 1e-6
    if abs(exact) > 1e-6:
        assert (gap > 0) == (exact > 0)
    assert gap >= exact / 3 - 1e-6 if exact > 0 else True, "never much too small: a corner is seen from three sides"


def test_postures_fill_the_limits() -> None:
    machine = load_machine("rre20")
    seen = pairs.postures(machine, 4000)
    assert (seen >= machine.sample_min - 1e-12).all() and (seen <= machine.sample_max + 1e-12).all()
    np.testing.assert_array_equal(seen[0], machine.home)
    share = (seen[65:] - machine.sample_min) / (machine.sample_max - machine.sample_min)
    for i in range(machine.n):
        counts, _ = np.histogram(share[:, i], bins=20, range=(0, 1))
        assert counts.min() > 150 and counts.max() < 250
        for j in range(i):
            table, _, _ = np.histogram2d(share[:, i], share[:, j], bins=8, range=[[0, 1], [0, 1]])
            assert table.min() > 25, "two joints never move in step"


def two_links(**changes: Any) -> dict[str, Any]:
    """A post on the undercarriage and an arm that turns above it: neighbours with a gap of 0.1 m."""

    def revolute(name: str, **dh: float) -> dict[str, Any]:
        ends = {"type": "revolute", "lower_deg": -90, "upper_deg": 90, "home_deg": 0}
        speed = {"speed_positive_deg_s": 30, "speed_negative_deg_s": 30}
        return {"name": name, "dh": {"a_m": 0, "alpha_deg": 0, "d_m": 0, **dh}, **ends, **speed}

    description = {
        "title": "arm",
        "undercarriage": {"kind": "tracks", "gauge_m": 2.0},
        "joints": [revolute("swing", d_m=1.0, alpha_deg=90), revolute("arm", a_m=3.0)],
        "solids": [
            {"name": "post", "link": "undercarriage", "centre_m": [0, 0, 0.4], "size_m": [1, 1, 0.8]},
            {"name": "house", "link": "swing", "centre_m": [0, 0, 0], "size_m": [1, 0.2, 1]},
            {"name": "beam", "link": "arm", "centre_m": [-1.0, 0.3, 0], "size_m": [2.0, 0.2, 0.2]},
        ],
        "attachments": [{"name": "hook", "tool": {}}],
    }
    return {**copy.deepcopy(description), **changes}


def kept(description: dict[str, Any]) -> set[tuple[str, str]]:
    machine = machine_from(description)
    return {(machine.solids[i].name, machine.solids[j].name) for i, j in machine.self_pairs}


def why(description: dict[str, Any], first: str, second: str) -> str:
    machine = machine_from(description)
    return next(pair.why for pair in machine.skipped_pairs if {first, second} == {pair.first, pair.second})


def test_neighbours_that_only_turn_above_each_other_are_left_out() -> None:
    assert why(two_links(), "post", "house") == "neighbours that never touch"


def test_neighbours_that_can_touch_are_kept() -> None:
    description = two_links()
    description["solids"][2] |= {"centre_m": [-3.0, 0.45, 0], "size_m": [0.6, 0.2, 0.2]}  # turns down past the sides
    assert ("house", "beam") in kept(description)


def test_links_that_can_come_near_are_kept_whatever_lies_between() -> None:
    assert ("post", "beam") in kept(two_links())


def test_links_that_stay_away_are_left_out() -> None:
    description = two_links()
    description["joints"][1] |= {"lower_deg": 0, "upper_deg": 90}
    description["solids"][2]["centre_m"] = [-0.5, 2.0, 0]
    description["solids"][2]["size_m"] = [0.2, 0.2, 0.2]
    description["joints"][1]["upper_deg"] = 30
    assert why(description, "post", "beam").startswith("never nearer than")


def test_allowed_contacts_are_left_out() -> None:
    assert why(two_links(allowed_contacts=[["beam", "post"]]), "post", "beam") == "allowed contact"


def test_overlap_at_home_is_left_out() -> None:
    description = two_links()
    description["solids"][2]["size_m"] = [4.0, 0.6, 0.2]
    assert why(description, "house", "beam") == "overlap in the home posture"


@pytest.mark.parametrize("seed", range(3))
def test_no_random_posture_finds_a_pair_that_was_left_out_as_far(seed: int) -> None:
    """What was said never to touch or come near does not, in postures nobody looked at before."""
    machine = load_machine("rre20")
    index = {solid.name: i for i, solid in enumerate(machine.solids)}
    far = [pair for pair in machine.skipped_pairs if pair.why.startswith(("never", "neighbours"))]
    assert far
    rng = np.random.default_rng(seed)
    for _ in range(400):
        T, half = machine.solid_poses(machine.forward(rng.uniform(machine.sample_min, machine.sample_max)))
        for pair in far:
            i, j = index[pair.first], index[pair.second]
            gap = pairs._gaps(T[None, i], half[None, i], T[None, j], half[None, j])[0]
            assert gap > (0.9 if pair.why.startswith("never") else 0.0)
