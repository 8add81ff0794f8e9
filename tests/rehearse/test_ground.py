"""Standing on the ground: heights against the plane they were made from, poses against their axes."""

import math
from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.gauge.heights import SiteHeights
from workgauge.gauge.rulebook import load_rule_book
from workgauge.gauge.trackline import filled_line
from workgauge.machine.load import load_machine
from workgauge.rehearse.ground import footprint_grid, plane_under
from workgauge.rehearse.scenario import OnGround, OnTrack
from workgauge.rehearse.shipped import shipped_site_files
from workgauge.rehearse.start import on_ground, stand
from workgauge.site.model import SiteModel, SurfaceModel
from workgauge.site.read import read_site
from workgauge.values.arrays import frozen, frozen_ints
from workgauge.values.errors import ScenarioError
from workgauge.values.limits import Source

E0, N0 = 500_000.0, 6_700_000.0
MACHINE = load_machine("rre20")
FINLAND = load_rule_book("finland")


def tilted(east: float, north: float, height: float = 10.0, name: str = "ground") -> SurfaceModel:
    """Return a 40 m square of 10 m triangles on the plane z = height + east x + north y about (E0, N0)."""
    grid = np.array(
        [[E0 + x, N0 + y, height + east * x + north * y] for x in range(-20, 21, 10) for y in range(-20, 21, 10)],
        dtype=np.float64,
    )
    faces = [
        face
        for i in range(4)
        for j in range(4)
        for k in (5 * i + j,)
        for face in ((k, k + 5, k + 6), (k, k + 6, k + 1))
    ]
    return SurfaceModel(name, None, None, frozen(grid), frozen_ints(faces), 1600.0, {}, Source("made.xml", name))


def site_of(*surfaces: SurfaceModel) -> SiteModel:
    return SiteModel(crs=None, crs_declared={}, units={}, surfaces=surfaces)


slopes = st.floats(-0.3, 0.3)
inside = st.floats(-12.0, 12.0)


@settings(max_examples=60, deadline=None)
@given(slopes, slopes, inside, inside, st.floats(0, 2 * math.pi))
def test_the_machine_stands_flat_on_the_plane(a: float, b: float, x: float, y: float, heading: float) -> None:
    site = site_of(tilted(a, b))
    machine = MACHINE
    T = on_ground(SiteHeights(site, FINLAND), machine, E0 + x, N0 + y, heading).T_absolute_machine
    R = T[:3, :3]
    assert pytest.approx(np.eye(3), abs=1e-12) == R.T @ R
    assert np.linalg.det(R) == pytest.approx(1.0)
    normal = np.array([-a, -b, 1.0]) / math.sqrt(1 + a * a + b * b)
    assert R[:, 2] == pytest.approx(normal, abs=1e-7)
    assert math.remainder(math.atan2(R[0, 0], R[1, 0]) - heading, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
    assert T[:3, 3] == pytest.approx([E0 + x, N0 + y, 10 + a * x + b * y], abs=1e-6)


def test_the_topmost_surface_counts_and_nothing_outside() -> None:
    heights = SiteHeights(site_of(tilted(0, 0, 10.0), tilted(0, 0, 12.5, "fill")), FINLAND)
    assert on_ground(heights, MACHINE, E0 + 1, N0 + 2, 0.0).T_absolute_machine[2, 3] == pytest.approx(12.5)
    with pytest.raises(ScenarioError, match="no ground to stand on"):
        on_ground(heights, MACHINE, E0 + 500, N0, 0.0)


def test_a_design_surface_that_makes_no_limit_is_no_ground_where_there_is_terrain() -> None:
    terrain, design = tilted(0, 0, 10.0, "Terrain"), tilted(0, 0, 12.5, "Design surface")
    together = SiteHeights(site_of(terrain, design), FINLAND)
    assert on_ground(together, MACHINE, E0, N0, 0.0).T_absolute_machine[2, 3] == pytest.approx(10.0)


def test_half_off_the_edge_still_stands_but_a_single_foot_does_not() -> None:
    heights = SiteHeights(site_of(tilted(0.1, 0)), FINLAND)
    plane = plane_under(heights, E0 + 20, N0, footprint_grid(2.6, 1.25, E0 + 20, N0, 0.0))
    assert plane == pytest.approx((12.0, 0.1, 0.0), abs=1e-6)
    assert plane_under(heights, E0 + 30, N0, footprint_grid(2.6, 1.25, E0 + 30, N0, 0.0)) is None


def test_on_a_site_without_heights_it_stands_at_the_rule_books_and_says_so() -> None:
    stood = on_ground(SiteHeights(site_of(), FINLAND), MACHINE, E0, N0, 0.0)
    assert stood.T_absolute_machine[2, 3] == FINLAND.height_without_profile
    assert "rule book" in stood.warnings[0]


def test_on_rails_without_a_profile_it_stands_at_the_height_its_limits_have() -> None:
    plain = read_site(shipped_site_files("double_track"))
    track = copy(plain.alignment("Track 2"))
    track.profile = None
    bare = replace(plain, alignments=(plain.alignment("Track 1"), track))
    place = OnTrack(alignment="Track 2", distance_m=600.0)
    stood = stand(bare, FINLAND, MACHINE, place)
    line = filled_line(track, SiteHeights(bare, FINLAND), np.zeros(3), float(FINLAND.rail_above_surface_m)).line
    bed = SiteHeights(plain, FINLAND).at(stand(plain, FINLAND, MACHINE, place).T_absolute_machine[None, :2, 3])[0]
    assert abs(float(line.at(np.array([600.0])).points[0, 2]) - float(FINLAND.rail_above_surface_m) - bed[0]) < 0.2
    assert stood.T_absolute_machine[2, 3] == pytest.approx(float(line.at(np.array([600.0])).points[0, 2]), abs=0.06)
    assert "no height of its own" in stood.warnings[0]


@pytest.fixture(scope="module")
def double_track() -> SiteModel:
    return read_site(shipped_site_files("double_track"))


def test_on_rails_as_the_site_describes_the_place(double_track: SiteModel) -> None:
    place = OnTrack(alignment="Track 1", distance_m=569.5)
    stood = stand(double_track, load_rule_book("finland"), MACHINE, place)
    T = stood.T_absolute_machine
    assert T[:3, 3] == pytest.approx([25487284.745, 6714592.330, 80.183], abs=3e-3)
    heading = math.degrees(math.atan2(T[0, 0], T[1, 0]))
    assert heading == pytest.approx(42.039, abs=1e-3)
    # low rail on the left: the left side hangs by asin(0.1 / 1.6)
    assert T[2, 1] == pytest.approx(-0.1 / 1.6, abs=1e-4)
    assert stood.own_track == "Track 1"


def test_facing_backward_turns_about_the_upright(double_track: SiteModel) -> None:
    rules, machine = load_rule_book("finland"), MACHINE
    ahead = stand(double_track, rules, machine, OnTrack(alignment="Track 1", distance_m=500.0)).T_absolute_machine
    place = OnTrack(alignment="Track 1", distance_m=500.0, facing="backward")
    back = stand(double_track, rules, machine, place).T_absolute_machine
    assert back == pytest.approx(ahead @ np.diag([-1.0, -1.0, 1.0, 1.0]), abs=1e-9)


def test_put_beside_the_rails_it_is_set_on_them(double_track: SiteModel) -> None:
    rules, machine = load_rule_book("finland"), MACHINE
    on = stand(double_track, rules, machine, OnTrack(alignment="Track 1", distance_m=569.5)).T_absolute_machine
    left = on[:2, 1] / np.linalg.norm(on[:2, 1])
    east, north = on[:2, 3] + 0.4 * left
    heading = math.degrees(math.atan2(on[0, 0], on[1, 0])) + 5.0
    stood = stand(double_track, rules, machine, OnGround(east_m=east, north_m=north, heading_deg=heading))
    assert stood.T_absolute_machine == pytest.approx(on, abs=2e-3)
    assert stood.own_track == "Track 1"
    assert "0.40 m beside" in stood.warnings[0]


def test_an_unknown_track_or_distance_is_a_scenario_error(double_track: SiteModel) -> None:
    rules, machine = load_rule_book("finland"), MACHINE
    for place in (OnTrack(alignment="Track 9", distance_m=1.0), OnTrack(alignment="Track 1", distance_m=1e6)):
        with pytest.raises(ScenarioError):
            stand(double_track, rules, machine, place)
