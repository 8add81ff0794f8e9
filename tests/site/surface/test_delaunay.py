"""Delaunay's triangles and break lines: every break line is made of edges, the area is the hull's."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.site.surface.delaunay import SAME_M, triangulated
from workgauge.site.surface.tin import Tin
from workgauge.values.errors import SiteError

FAR = np.array([2e7, 6e6, 0.0])


def edges_of(faces):
    return {tuple(sorted(pair)) for f in faces.tolist() for pair in ((f[0], f[1]), (f[1], f[2]), (f[2], f[0]))}


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), lines=st.integers(0, 6))
def test_break_lines_are_edges_and_the_hull_is_filled(seed, lines):
    rng = np.random.default_rng(seed)
    points = rng.uniform([0, 0, 0], [50, 50, 5], (int(rng.integers(4, 80)), 3)) + FAR
    breaks = [rng.uniform([0, 0, 0], [50, 50, 5], (int(rng.integers(2, 5)), 3)) + FAR for _ in range(lines)]
    made = triangulated(points, breaks)
    u, v = (made.vertices[made.faces[:, k], :2] - made.vertices[made.faces[:, 0], :2] for k in (1, 2))
    area = 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    assert (area > 0.0).all()
    every = np.concatenate([points, *breaks])[:, :2] - FAR[:2]
    hull = shapely.MultiPoint(every).convex_hull.area
    assert area.sum() == pytest.approx(hull, rel=1e-4, abs=0.05)  # slivers of no area along the hull are left out
    edges = made.vertices[np.array(sorted(edges_of(made.faces)))][..., :2] - FAR[:2]
    lengths = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    for line in breaks:
        for a, b in zip(line[:-1, :2] - FAR[:2], line[1:, :2] - FAR[:2], strict=True):
            d = (b - a) / np.linalg.norm(b - a)
            gap = edges - a
            beside = np.abs(gap[..., 0] * d[1] - gap[..., 1] * d[0]).max(axis=1)
            along = gap @ d
            on = (
                (beside < 1.5 * SAME_M)
                & (along.min(axis=1) > -5e-4)
                & (along.max(axis=1) < np.linalg.norm(b - a) + 5e-4)
            )
            assert lengths[on].sum() == pytest.approx(np.linalg.norm(b - a), abs=2e-3)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_without_break_lines_no_point_lies_in_a_circle(seed):
    rng = np.random.default_rng(seed)
    made = triangulated(rng.uniform(0, 30, (40, 3)))
    p = made.vertices[:, :2]
    for a, b, c in p[made.faces]:
        m = np.linalg.solve(2 * np.array([b - a, c - a]), [b @ b - a @ a, c @ c - a @ a])
        assert (np.linalg.norm(p - m, axis=1) >= np.linalg.norm(a - m) * (1 - 1e-7)).all()


def test_a_ridge_stays_a_ridge():
    rng = np.random.default_rng(3)
    ends = rng.uniform([0, -10], [40, 10], (60, 2))
    ends = ends[np.abs(ends[:, 1]) > 1.0]
    points = np.column_stack([ends, -np.abs(ends[:, 1])])
    ridge = [[0.0, 0.0, 0.0], [40.0, 0.0, 0.0]]
    t = np.column_stack([np.linspace(1, 39, 200), np.zeros(200)])
    with_line, without = triangulated(points, [ridge]), triangulated(points)
    assert np.abs(Tin(with_line.vertices, with_line.faces).heights(t)).max() < 1e-9
    plain = Tin(without.vertices, without.faces).heights(t)
    assert np.nanmin(plain) < -0.5  # bare points cut the ridge off


def test_crossing_break_lines_and_doubled_points_are_told():
    points = [[0.0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0], [10, 10, 2.0], [0, 0, 0]]
    made = triangulated(points, [[[1, 1, 1.0], [9, 9, 1.0]], [[1, 9, 2.0], [9, 1, 2.0]]])
    said = " ".join(made.warnings)
    assert (
        "repeat others" in said
        and "different heights, up to 2.000 m" in said
        and "cross at different heights" in said
    )
    tin = Tin(made.vertices, made.faces)
    assert tin.heights([[5.0, 5.0], [10.0, 10.0]]) == pytest.approx([1.0, 2.0])


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ([], "no points"),
        ([[0, 0, 0], [1, 1, 1]], "too few points"),
        ([[0, 0, 0], [1, 1, 1], [1, 1, 2]], "too few points"),
        ([[k, 2 * k, k] for k in range(9)], "in one line"),
        ([[0, 0, 0], [1, 0, np.nan], [0, 1, 0]], "must be numbers"),
    ],
)
def test_what_makes_no_surface_is_refused(points, words):
    with pytest.raises(SiteError, match=words):
        triangulated(points)


def test_three_points_are_a_surface_and_long_sides_can_be_left_out():
    made = triangulated([[0, 0, 1], [1, 0, 2], [0, 1, 3]])
    assert len(made.faces) == 1
    far = triangulated([[0, 0, 0], [1, 0, 0], [0, 1, 0], [50, 50, 0]], longest_m=5.0)
    assert len(far.faces) == 1 and "longer than 5 m" in far.warnings[-1]


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), apart=st.floats(1e-7, 0.9e-4))
def test_points_a_hair_apart_are_one_wherever_they_lie(seed, apart):
    """Also astride the border between two cells of a grid, where rounding would tell them apart."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 30, (30, 3)) + FAR
    angle = rng.uniform(0, 2 * np.pi, len(points))
    twins = points + apart * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(points))])
    made = triangulated(np.concatenate([points, twins]), [points[[0, 1]], twins[[1, 2]]])
    assert len(made.vertices) - len(points) <= 1  # the two break lines may cross
    assert f"{len(points)} points repeat others" in " ".join(made.warnings)
