"""One-sided surfaces: the side is exact over the whole footprint, the distance Euclidean."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from workgauge.values.solids import Surface

seeds = st.integers(0, 2**32 - 1)
LEVEL = np.zeros((9, 9))


def brute(make, surface, solid, rng, samples=4000):
    """Euclidean distance to every triangle, and the largest vertical depth at sampled points of the box."""
    triangles = surface.vertices[surface.faces]
    flat = [np.concatenate([t, t - [[0, 0, 1e-9]]]) for t in triangles]
    apart = min(max(make.signed_distance(solid.vertices, points), 0.0) for points in flat)
    T, half = solid.T_frame_box, solid.half_extents
    local = rng.uniform(-1, 1, (samples, 3))
    local[np.arange(samples), rng.integers(0, 3, samples)] = rng.choice([-1, 1], samples)  # on the skin
    points = np.concatenate([solid.vertices, local * half @ T[:3, :3].T + T[:3, 3]])
    return apart, heights(surface, points[:, :2]) - points[:, 2], points


def heights(surface, places):
    """Surface heights above places (n, 2), -inf beyond its extent."""
    found = np.full(len(places), -np.inf)
    for a, b, c in surface.vertices[surface.faces]:
        M = np.array([b[:2] - a[:2], c[:2] - a[:2]]).T
        v, w = np.linalg.solve(M, (places - a[:2]).T)
        inside = (v >= 0) & (w >= 0) & (v + w <= 1)
        found = np.where(inside, np.maximum(found, a[2] + v * (b[2] - a[2]) + w * (c[2] - a[2])), found)
    return found


@given(seeds, st.booleans())
@settings(max_examples=120, deadline=None)
def test_side_and_distance_against_brute_force(make, seed, keep_above):
    rng = np.random.default_rng(seed)
    up = 1.0 if keep_above else -1.0
    terrain = rng.normal(size=(6, 6)) * rng.uniform(0, 0.7)
    solid = make.box(rng.normal(size=3), rng.uniform((1, 1, -1.5), (4, 4, 4.0)), rng.uniform(0.05, 1.5, 3))
    apart, depths, _ = brute(make, make.grid_surface(terrain), solid, rng)
    given = make.grid_surface(up * terrain, keep_above=keep_above)
    turned = solid.T_frame_box.copy()
    if not keep_above:  # the whole scene upside down: turned half round about x, then y mirrored back by symmetry
        flip = np.diag([1.0, 1.0, -1.0])
        turned[:3, :3] = flip @ turned[:3, :3] @ np.diag([1.0, 1.0, -1.0])
        turned[2, 3] *= -1
    [found] = make.ask([given], [type(solid)(turned, solid.half_extents)])
    assert np.linalg.norm(found.normal) == pytest.approx(1.0)
    assert_allclose(found.point_machine - found.point_limit, found.distance_m * found.normal, atol=1e-6)
    if found.distance_m > 0:
        assert depths.max() <= 1e-9  # nothing sampled lies below
        assert found.distance_m == pytest.approx(apart, abs=2e-6)
    else:
        assert apart <= 1e-6 or depths.max() > 0
        # a box point below the surface, as far from the mesh as claimed, and no sampled point much deeper
        point, foot = found.point_machine * (1, 1, up), found.point_limit * (1, 1, up)
        triangles = make.grid_surface(terrain).vertices[make.grid_surface(terrain).faces]
        assert make.point_triangles(point, triangles).min() == pytest.approx(-found.distance_m, abs=1e-6)
        assert make.point_triangles(foot, triangles[found.cell : found.cell + 1]).min() < 1e-6
        assert -found.distance_m <= max(depths.max(), 0.0) + 0.15 * solid.half_extents.max() + 1e-6
        inside = (solid.T_frame_box[:3, :3].T @ (point - solid.T_frame_box[:3, 3])) / solid.half_extents
        assert np.abs(inside).max() <= 1 + 1e-6


def test_a_box_under_an_open_mesh_is_inside(make):
    """A mesh by itself says 1.65 m clear."""
    [found] = make.ask([make.grid_surface(LEVEL)], [make.box((0, 0, 0.3), (4, 4, -2.0), (0.5, 0.4, 0.35))])
    assert found.distance_m == pytest.approx(-2.35, abs=1e-9)
    assert_allclose(found.normal, (0, 0, 1), atol=1e-9)


@pytest.mark.parametrize("slope", [0.0, 0.3, -1.0, 3.0])
def test_on_a_plane_the_depth_is_perpendicular_and_continuous(make, slope):
    surface = make.grid_surface(slope * np.arange(41.0)[:, None] * np.ones(41) - slope * 20, origin=(-10, -20))
    normal = np.array([-slope, 0, 1]) / np.hypot(1, slope)
    turn = (0.3, -0.2, 0.9)
    before = None
    for height in np.linspace(3.0, -3.0, 121):
        solid = make.box(turn, (10.0, 0.1, height), (0.6, 0.4, 0.3))
        expected = (solid.vertices - (10.0, 0.0, 0.0)) @ normal
        [found] = make.ask([surface], [solid])
        assert found.distance_m == pytest.approx(expected.min(), abs=1e-6)
        assert_allclose(found.normal, normal, atol=2e-4)
        assert_allclose(found.point_machine, solid.vertices[np.argmin(expected)], atol=1e-6)
        assert before is None or abs(found.distance_m - before) <= 0.05 + 1e-6
        before = found.distance_m


def test_a_peak_under_the_middle_of_a_level_floor_counts(make):
    """All corners are above the surface; only a mesh vertex is inside the footprint."""
    terrain = LEVEL.copy()
    terrain[4, 4] = 1.0
    [found] = make.ask([make.grid_surface(terrain)], [make.box((0, 0, 0.2), (4, 4, 1.4), (2.5, 2.5, 0.5))])
    assert found.distance_m < -0.05
    [above] = make.ask([make.grid_surface(terrain)], [make.box((0, 0, 0.2), (4, 4, 1.6), (2.5, 2.5, 0.5))])
    assert above.distance_m == pytest.approx(0.1, abs=1e-9)


def test_a_ridge_across_a_narrow_box_counts(make):
    """Neither a corner below the surface nor a mesh vertex in the footprint: only edges cross."""
    terrain = LEVEL.copy()
    terrain[4, :] = 1.0
    [found] = make.ask([make.grid_surface(terrain)], [make.box((0, 0, 0), (4.0, 4.5, 1.2), (2.0, 0.2, 0.4))])
    assert found.distance_m == pytest.approx(-0.2 * np.sqrt(0.5), abs=1e-6)


def test_behind_a_steep_wall_the_way_out_is_sideways(make):
    """5 cm inside a 2 m wall is 5 cm deep; the vertical depth would be 2 m."""
    x = np.array([-5.0, 0.0, 0.001, 5.0])
    vertices = np.array([(a, b, 2.0 if a > 0 else 0.0) for a in x for b in (-5.0, 5.0)])
    faces = np.array([f for i in (0, 2, 4) for f in ((i, i + 2, i + 3), (i, i + 3, i + 1))])
    wall = Surface(vertices, faces)
    last = None
    for x0 in np.linspace(-0.2, 0.3, 251):
        [found] = make.ask([wall], [make.box((0, 0, 0), (x0 - 0.5, 0.0, 1.0), (0.5, 0.5, 0.5))])
        assert found.distance_m == pytest.approx(-x0, abs=1.5e-3)
        assert found.normal[0] < -0.999
        assert last is None or abs(found.distance_m - last) < 0.0031
        last = found.distance_m


def test_nothing_is_forbidden_beyond_the_plan_extent(make):
    surface = make.grid_surface(LEVEL)
    [beside] = make.ask([surface], [make.box((0, 0, 0), (11.0, 4, -2.0), (1, 1, 0.5))])
    assert beside.distance_m == pytest.approx(np.hypot(2.0, 1.5), abs=1e-6)
    # partly beyond: only the part over the surface can be below it
    [partly] = make.ask([surface], [make.box((0, 0.1, 0), (8.0, 4, 0.15), (2, 1, 0.1))])
    [whole] = make.ask([make.grid_surface(np.zeros((20, 9)))], [make.box((0, 0.1, 0), (8.0, 4, 0.15), (2, 1, 0.1))])
    assert whole.distance_m < -0.1 < 0.0 < partly.distance_m


@given(seeds)
@settings(max_examples=15, deadline=None)
def test_clearance_is_continuous_along_any_path(make, seed):
    rng = np.random.default_rng(seed)
    surface = make.grid_surface(rng.normal(size=(12, 12)) * 0.2)
    turn, half = rng.normal(size=3), rng.uniform(0.2, 1.2, 3)
    start, end = rng.uniform((3, 3, -0.5), (8, 8, 2.0)), rng.uniform((3, 3, -0.5), (8, 8, 2.0))
    step = np.linalg.norm(end - start) / 300
    found = [
        make.ask([surface], [make.box(turn, start + (end - start) * s, half)]).distances[0]
        for s in np.linspace(0, 1, 301)
    ]
    assert np.abs(np.diff(found)).max() <= 3 * step + 1e-6


def test_only_what_is_near_is_reported(make):
    surface = make.grid_surface(LEVEL)
    solid = make.box((0, 0, 0), (4, 4, 3.0), (0.5, 0.5, 0.5))
    assert len(make.ask([surface], [solid], radius=2.4)) == 0
    [found] = make.ask([surface], [solid], radius=2.6)
    assert found.distance_m == pytest.approx(2.5, abs=1e-9)
    deep = make.box((0, 0, 0), (4, 4, -30.0), (0.5, 0.5, 0.5))
    [found] = make.ask([surface], [deep], radius=0.1)
    assert found.distance_m < -5.0
