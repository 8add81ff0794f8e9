"""Alignments evaluated and projected: laws of position, heading and curvature, and a slow search as the oracle."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.site.cant import CantPoint, CantTable
from workgauge.site.plan import PlanElement
from workgauge.site.profile import VerticalPoint, build_profile
from workgauge.site.transitions import Law
from workgauge.values.errors import SiteError

LAWS = [law for law in Law if law is not Law.CONSTANT]


@pytest.fixture(scope="module")
def tracks(tools):
    return {law: tools.build(tools.track(law)) for law in LAWS}


@pytest.mark.parametrize("law", LAWS)
def test_distance_is_arc_length_heading_its_direction_curvature_its_rate(tracks, law):
    track = tracks[law]
    d = np.linspace(0, track.length, 8001)
    step = d[1]
    state, middle = track.at(d), track.at(d[:-1] + step / 2)
    de, dn = np.diff(state.e), np.diff(state.n)
    # Positions are near 2e7 m, where a float64 resolves 4e-9 m.
    assert np.hypot(de, dn) / step == pytest.approx(1.0, abs=1e-6)
    turned = (np.arctan2(de, dn) - middle.heading + math.pi) % (2 * math.pi) - math.pi
    inner = np.abs(d[:-1, None] + step / 2 - track.plan.boundaries).min(axis=1) > step
    assert np.abs(turned[inner]).max() < 5e-7
    assert np.abs(turned).max() < 1e-4
    left = -(np.diff(state.heading) + math.pi) % (2 * math.pi) - math.pi
    assert (left / step)[inner] == pytest.approx(middle.curvature[inner], abs=1e-7)


@pytest.mark.parametrize("law", LAWS)
def test_position_and_heading_are_continuous(tracks, law):
    track = tracks[law]
    joints = track.plan.boundaries[1:-1]
    before, after = track.at(joints - 1e-8), track.at(joints + 1e-8)
    assert np.hypot(after.e - before.e, after.n - before.n).max() < 1e-6
    assert np.abs(after.heading - before.heading).max() < 1e-8


def test_left_and_right(tools):
    north = tools.build([PlanElement("line", Law.CONSTANT, (0.0, 0.0), math.pi / 2, 100.0, 0.0, 0.0)])
    state = north.at(50.0)
    assert state.heading[0] == pytest.approx(0.0)
    assert state.offset_points(3.0)[0] == pytest.approx([21_529_997.0, 6_783_050.0])
    assert north.project([[21_530_002.0, 6_783_010.0]])[1] == pytest.approx(-2.0)
    east = tools.build([PlanElement("curve", Law.CONSTANT, (0.0, 0.0), 0.0, 10.0, 0.01, 0.01)])
    assert east.at(0.0).heading[0] == pytest.approx(math.pi / 2)
    assert east.at(10.0).n[0] > 6_783_000.0  # to the left of east lies north
    assert east.at(10.0).heading[0] < math.pi / 2


def test_headings_stay_below_a_full_turn(tools):
    circle = tools.build(
        [PlanElement("curve", Law.CONSTANT, (0.0, 0.0), math.pi / 2, 2 * math.pi * 50, -0.02, -0.02)]
    )
    heading = circle.at(np.linspace(0, circle.length, 1001)).heading
    assert (heading >= 0).all()
    assert (heading < 2 * math.pi).all()


def test_results_are_read_only(tracks):
    state = tracks[Law.CLOTHOID].at([1.0, 2.0])
    with pytest.raises(ValueError, match="read-only"):
        state.e[0] = 0.0


@pytest.mark.parametrize("distance", [-0.002, 1180.002, math.nan, math.inf])
def test_distances_outside_are_refused(tracks, distance):
    assert tracks[Law.CLOTHOID].length == pytest.approx(1180.0)
    with pytest.raises(SiteError, match="outside the alignment"):
        tracks[Law.CLOTHOID].at([10.0, distance])


def test_a_millimetre_beyond_the_ends_is_the_end(tracks):
    track = tracks[Law.CLOTHOID]
    assert track.at(-0.0009).e == track.at(0.0).e
    assert track.at(track.length + 0.0009).n == track.at(track.length).n


@given(st.sampled_from(LAWS), st.lists(st.tuples(st.floats(0, 1), st.floats(-100, 100)), min_size=1, max_size=20))
@settings(max_examples=60, deadline=None)
def test_projection_gives_back_distance_and_offset(tools, law, places):
    track = _cached(tools, law)
    d = np.array([share * track.length for share, _ in places])
    offset = np.array([o for _, o in places])
    distance, found = track.project(track.at(d).offset_points(offset))
    assert distance == pytest.approx(d, abs=1e-6)
    assert found == pytest.approx(offset, abs=1e-6)


_TRACKS: dict[Law, object] = {}


def _cached(tools, law):
    return _TRACKS.setdefault(law, tools.build(tools.track(law)))


@given(st.sampled_from(LAWS), st.lists(st.tuples(st.floats(-900, 900), st.floats(-900, 900)), min_size=1, max_size=8))
@settings(max_examples=60, deadline=None)
def test_no_sampled_point_is_nearer_than_the_projection(tools, law, places):
    track = _cached(tools, law)
    middle = track.at(track.length / 2)
    points = np.array(places) + np.array([middle.e[0], middle.n[0]])
    dense = track.at(np.linspace(0, track.length, 24_001))
    apart = np.hypot(dense.e - points[:, :1], dense.n - points[:, 1:])
    distance, offset = track.project(points)
    foot = track.at(distance)
    assert np.abs(offset) == pytest.approx(np.hypot(foot.e - points[:, 0], foot.n - points[:, 1]), abs=1e-7)
    assert (np.abs(offset) <= apart.min(axis=1) + 1e-7).all()
    assert (np.abs(offset) >= apart.min(axis=1) - 0.03).all()
    side = np.cos(foot.heading) * (points[:, 0] - foot.e) - np.sin(foot.heading) * (points[:, 1] - foot.n)
    assert (np.sign(offset) == -np.sign(side)).all() or np.abs(side).min() < 1e-6


@given(st.lists(st.tuples(st.floats(-20, 120), st.floats(-15, 25)), min_size=1, max_size=30))
@settings(max_examples=60, deadline=None)
def test_projection_in_a_hairpin_takes_the_nearer_leg(tools, places):
    hairpin = tools.build(
        tools.chain(
            ("line", Law.CONSTANT, 100.0, 0.0, 0.0),
            ("curve", Law.CONSTANT, 5 * math.pi, 0.2, 0.2),
            ("line", Law.CONSTANT, 95.0, 0.0, 0.0),
            yaw=0.0,
        )
    )
    points = np.array(places) + np.array([21_530_012.5, 6_783_000.0 - 31.25])
    dense = hairpin.at(np.linspace(0, hairpin.length, 20_001))
    apart = np.hypot(dense.e - points[:, :1], dense.n - points[:, 1:]).min(axis=1)
    _, offset = hairpin.project(points)
    assert (np.abs(offset) <= apart + 1e-7).all()
    assert (np.abs(offset) >= apart - 0.01).all()


@given(st.floats(-5, 5), st.floats(-5, 5))
@settings(max_examples=60, deadline=None)
def test_projection_onto_a_tiny_circle(tools, x, y):
    circle = tools.build([PlanElement("curve", Law.CONSTANT, (0.0, -1.5), 0.0, 3 * math.pi, 1 / 1.5, 1 / 1.5)])
    _, offset = circle.project([[21_530_000.0 + x, 6_783_000.0 + y]])
    assert offset[0] == pytest.approx(1.5 - math.hypot(x, y), abs=1e-7)


def test_the_nearest_span_need_not_have_the_nearest_middle(tools):
    hairpin = tools.build(
        tools.chain(
            ("line", Law.CONSTANT, 100.0, 0.0, 0.0),
            ("curve", Law.CONSTANT, 5 * math.pi, 0.2, 0.2),
            ("line", Law.CONSTANT, 100.0, 0.0, 0.0),
            yaw=0.0,
        )
    )
    # Level with the ends of the far leg's spans there are only middles of the near leg's, were they as long.
    for x in np.arange(0.0, 100.0, 0.5):
        _, offset = hairpin.project([[21_530_012.5 + x, 6_783_000.0 - 31.25 + 5.4]])
        assert abs(offset[0]) == pytest.approx(4.6, abs=1e-9)


def test_points_beyond_an_end_project_on_it(tracks):
    track = tracks[Law.CLOTHOID]
    start = track.at(0.0)
    behind = [[start.e[0] - 30 * math.sin(start.heading[0]), start.n[0] - 30 * math.cos(start.heading[0])]]
    distance, offset = track.project(behind)
    assert distance[0] == 0.0
    assert abs(offset[0]) == pytest.approx(30.0)


def test_the_centre_of_an_arc_projects_at_its_radius(tools):
    arc = tools.build([PlanElement("curve", Law.CONSTANT, (0.0, 0.0), 0.0, 300.0, 1 / 200, 1 / 200)])
    _, offset = arc.project([[21_530_000.0, 6_783_200.0]])
    assert offset[0] == pytest.approx(200.0, abs=1e-7)


def test_projection_of_nothing_and_of_what_is_not_finite(tracks):
    distance, offset = tracks[Law.CLOTHOID].project(np.empty((0, 2)))
    assert len(distance) == len(offset) == 0
    with pytest.raises(SiteError, match="finite"):
        tracks[Law.CLOTHOID].project([[math.nan, 0.0]])


def test_many_points_at_once_are_the_same_as_one_by_one(tracks):
    track = tracks[Law.BLOSS]
    d = np.linspace(0, track.length, 25_000)  # more than one chunk
    points = track.at(d).offset_points(np.sin(d) * 20)
    distance, offset = track.project(points)
    assert distance == pytest.approx(d, abs=1e-6)
    for i in (0, 12_345, 24_999):
        alone = track.project(points[i])
        assert (alone[0][0], alone[1][0]) == (distance[i], offset[i])


def test_breaks_name_every_kind_of_joint(tools):
    profile = build_profile([VerticalPoint(-5.0, 1.0), VerticalPoint(300.0, 2.0), VerticalPoint(2000.0, 5.0)])
    cant = CantTable([CantPoint(120.0, 0.0), CantPoint(200.0, 0.1)], 1.524, None)
    track = tools.build(tools.track(), profile=profile, cant=cant)
    assert track.breaks == pytest.approx([0, 120, 200, 300, 500, 570, 720, 780, 840, 1040, 1130, 1180])
    assert track.element_counts == {"line": 2, "curve": 3, "spiral": 5}
    assert track.has_profile and track.has_cant and track.cant_stations == 2
    state = track.at([0.0, 160.0, 1000.0])
    assert state.z == pytest.approx([1 + 5 / 305, 1 + 165 / 305, 2 + 700 * 3 / 1700])
    assert state.gradient == pytest.approx([1 / 305, 1 / 305, 3 / 1700])
    assert state.cant == pytest.approx([0.0, 0.05, 0.1])
