"""Heights, normals and triangles at plan points, against every triangle one by one."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.site.read import read_site
from workgauge.site.surface.delaunay import triangulated
from workgauge.site.surface.tin import Tin
from workgauge.values.errors import SiteError

REAL = Path(__file__).parents[3].parent / "shared" / "data" / "landxml" / "inframodel_m3"
TERRAIN = "M3_Terrain.mm.xml"
ROAD = "M3_Highest_Comb_rev2_Highest_combination_of_surface.mm.xml"


@cache
def real(name: str) -> Tin:
    if not REAL.is_dir():
        pytest.skip(f"real files absent: {REAL}")
    return Tin.of_all(read_site([REAL / name]).surfaces)


def by_every_triangle(tin, points, slack=1e-9):
    """Return height and triangle of the topmost at each point by solving for every triangle, 40 points at a time."""
    corners = tin.vertices[tin.faces] - tin.vertices[0]
    gaps = points - tin.vertices[0, :2]
    a, b, c = (corners[:, k] for k in range(3))
    area = np.cross(b - a, c - a)[:, 2]
    z, face = np.full(len(points), np.nan), np.full(len(points), -1)
    for first in range(0, len(points), 40):
        p = gaps[first : first + 40, None]
        shares = []
        for q, r in ((b, c), (c, a), (a, b)):
            cross = (q[:, 0] - p[..., 0]) * (r[:, 1] - p[..., 1]) - (q[:, 1] - p[..., 1]) * (r[:, 0] - p[..., 0])
            shares.append(cross / area)
        inside = (np.array(shares) >= -slack).all(axis=0)
        height = np.where(inside, shares[0] * a[:, 2] + shares[1] * b[:, 2] + shares[2] * c[:, 2], -np.inf)
        best = height.argmax(axis=1)
        found = inside.any(axis=1)
        rows = np.arange(len(best))
        z[first : first + 40] = np.where(found, height[rows, best] + tin.vertices[0, 2], np.nan)
        face[first : first + 40] = np.where(found, best, -1)
    return z, face


def compared(name, count):
    tin = real(name)
    rng = np.random.default_rng(7)
    # half of them on the surface for certain, the rest anywhere in its box
    share = rng.dirichlet(np.ones(3), count // 2)
    corners = tin.vertices[tin.faces[rng.integers(0, len(tin), count // 2)]]
    low, high = tin.vertices[:, :2].min(axis=0), tin.vertices[:, :2].max(axis=0)
    points = np.concatenate(
        [np.einsum("kc,kcd->kd", share, corners)[:, :2], rng.uniform(low, high, (count - count // 2, 2))]
    )
    z, face = by_every_triangle(tin, points)
    found = tin.at(points)
    assert ((found.face >= 0) == (face >= 0)).all()
    on = face >= 0
    assert on.sum() >= count // 2
    assert np.abs(found.z - z)[on].max() < 1e-6  # at coordinates of 2e7 m
    same = found.face == face
    assert same[on].mean() > 0.999  # on an edge either is right
    a, b, c = (tin.vertices[tin.faces[found.face[on], k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    assert np.abs(np.abs((normal * found.normal[on]).sum(axis=1)) - 1.0).max() < 1e-9
    assert (found.normal[on, 2] > 0.0).all()


@pytest.mark.parametrize("name", [TERRAIN, ROAD])
def test_heights_and_normals_are_those_of_every_triangle(name):
    compared(name, 400)


@pytest.mark.prove
@pytest.mark.parametrize("name", [TERRAIN, ROAD])
def test_heights_and_normals_at_ten_thousand_points(name):
    compared(name, 10_000)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), tilt=st.tuples(st.floats(-2, 2), st.floats(-2, 2)), far=st.booleans())
def test_a_plane_in_triangles_is_a_plane(seed, tilt, far):
    rng = np.random.default_rng(seed)
    place = np.array([25_486_800.0, 6_714_300.0]) if far else np.zeros(2)
    xy = rng.uniform(0, 30, (40, 2))
    points = np.column_stack([xy + place, xy @ tilt + 7.0])
    made = triangulated(points)
    tin = Tin(made.vertices, made.faces)
    weights = rng.dirichlet(np.ones(len(xy)), 50)  # inside the hull
    asked = weights @ xy
    found = tin.at(asked + place)
    assert (found.face >= 0).all()
    assert found.z == pytest.approx(asked @ tilt + 7.0, abs=1e-6)
    normal = np.array([-tilt[0], -tilt[1], 1.0])
    assert found.normal == pytest.approx(np.tile(normal / np.linalg.norm(normal), (50, 1)), abs=1e-5)
    assert np.array_equal(tin.at(made.vertices[:, :2]).z, tin.at(made.vertices[:, :2]).z)
    assert tin.at(made.vertices[:, :2]).z == pytest.approx(made.vertices[:, 2], abs=1e-6)  # no crack at a corner


SQUARE = np.array([[0.0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0]])


def test_the_topmost_counts_and_overlaps_are_told():
    tin = Tin(np.concatenate([SQUARE, SQUARE[:3] + np.array([1, 0, 2.0])]), [[0, 1, 2], [0, 2, 3], [4, 5, 6]], "road")
    assert tin.at([[8.0, 1.0], [0.5, 0.1], [3.0, 9.0]]).z.tolist() == [2.0, 0.0, 0.0]
    assert tin.at([[8.0, 1.0]]).face.tolist() == [2]
    assert tin.findings.overlaps.tolist() == [[0, 2]] or len(tin.findings.overlaps) == 2
    assert any("lie above each other" in text for text in tin.findings.words("road"))


def test_a_hole_is_told_and_has_no_height():
    outer = np.array([[0.0, 0, 1], [9, 0, 1], [9, 9, 1], [0, 9, 1], [3, 3, 1], [6, 3, 1], [6, 6, 1], [3, 6, 1]])
    faces = [[k, (k + 1) % 4, 4 + k] for k in range(4)] + [[4 + k, (k + 1) % 4, 4 + (k + 1) % 4] for k in range(4)]
    tin = Tin(outer, faces, "pit")
    found = tin.at([[4.5, 4.5], [1.0, 1.0], [20.0, 1.0], [np.nan, 1.0]])
    assert np.isnan(found.z[[0, 2, 3]]).all() and found.z[1] == 1.0
    assert found.face.tolist()[0] == -1 and np.isnan(found.normal[0]).all()
    (hole,) = tin.findings.holes
    assert "1 holes, 9.0 m2" in tin.findings.words("pit")[0]
    assert len(hole) == 5 and len(tin.findings.outlines) == 1 and not len(tin.findings.overlaps)


def test_a_vertical_triangle_is_told_and_the_upper_edge_counts():
    wall = np.array([[0.0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0], [4, 0, 3], [4, 4, 3], [8, 0, 3], [8, 4, 3]])
    faces = [[0, 1, 2], [0, 2, 3], [1, 4, 2], [4, 5, 2], [4, 6, 5], [6, 7, 5]]
    tin = Tin(wall, faces, "wall")
    assert tin.findings.vertical == 2
    assert tin.at([[4.0, 2.0], [3.999, 2.0], [4.001, 2.0]]).z.tolist() == [3.0, 0.0, 3.0]
    assert any("2 vertical" in text for text in tin.findings.words("wall"))
    assert len(tin.findings.outlines) == 1  # the two halves touch in plan


def test_what_is_no_surface_is_refused():
    with pytest.raises(SiteError, match="no triangles"):
        Tin(SQUARE, [])
    with pytest.raises(SiteError, match="no numbers"):
        Tin([[0, 0, 0], [1, 0, np.nan], [0, 1, 0]], [[0, 1, 2]])
    with pytest.raises(SiteError, match="without area"):
        Tin(SQUARE, [[0, 1, 1]])
    with pytest.raises(SiteError, match="no surface given"):
        Tin.of_all([])
    assert len(Tin(SQUARE, [[0, 1, 2]]).at(np.empty((0, 2))).z) == 0


@pytest.mark.parametrize("at", [1.0, 1.0000004, 1.00000049])
def test_triangles_that_share_a_side_to_a_hair_are_one_piece(at):
    left, right = [[0, 0, 0], [at, 0, 0], [at, 1, 0]], [[at + 2e-7, 0, 0], [2, 0, 0], [at + 2e-7, 1, 0]]
    tin = Tin(np.array(left + right, dtype=float), [[0, 1, 2], [3, 4, 5]])
    assert len(tin.findings.outlines) == 1 and not tin.findings.holes and not len(tin.findings.overlaps)
