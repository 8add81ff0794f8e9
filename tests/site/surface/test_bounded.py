"""Triangles inside boundaries: their area is that of polygons cut by another library, their heights the plane's."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.site.surface.bounded import Boundary, bounded
from workgauge.site.surface.delaunay import SAME_M
from workgauge.site.surface.tin import Tin
from workgauge.values.errors import SiteError

SIZES = {"outer": 25.0, "void": 9.0, "island": 4.0}


def plane(plan):
    return 0.1 * plan[..., 0] - 0.2 * plan[..., 1] + 5.0


def star(rng, size):
    """Return a ring (p, 2) round (20, 20) that does not cross itself: no two corners half a turn apart."""
    count = int(rng.integers(4, 12))
    angle = (np.arange(count) + rng.uniform(0.0, 0.8, count)) / count * 2 * np.pi
    radius = rng.uniform(0.4, 1.0, count) * size
    return np.column_stack([20.0 + radius * np.cos(angle), 20.0 + radius * np.sin(angle)])


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), kinds=st.integers(0, 3), far=st.booleans())
def test_area_and_heights_within_boundaries(seed, kinds, far):
    rng = np.random.default_rng(seed)
    place = np.array([2.5e7, 6.7e6]) if far else np.zeros(2)

    def lifted(plan, known=True):
        return np.column_stack([plan + place, plane(plan) if known else np.full(len(plan), np.nan)])

    points = rng.uniform(0, 40, (int(rng.integers(5, 80)), 2))
    breaks = [rng.uniform(0, 40, (3, 2)) for _ in range(int(rng.integers(0, 4)))]
    rings = {kind: star(rng, SIZES[kind]) for kind in list(SIZES)[:kinds]}
    known = {kind: bool(rng.random() < 0.5) for kind in rings}
    made = bounded(
        lifted(points),
        [lifted(line) for line in breaks],
        [Boundary(kind, lifted(ring, known[kind]), kind) for kind, ring in rings.items()],
    )
    polygons = {kind: shapely.Polygon(rings.get(kind, np.empty((0, 2)))) for kind in SIZES}
    corners = np.concatenate([points, *breaks, *(ring for kind, ring in rings.items() if known[kind])])
    wanted = shapely.MultiPoint(corners).convex_hull
    if "outer" in rings:
        wanted = wanted.intersection(polygons["outer"])
    wanted = wanted.difference(polygons["void"].difference(polygons["island"]))
    corner = (made.vertices[made.faces] - [*place, 0.0])[..., :2]
    u, v = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    area = 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    assert (area > 0.0).all()
    assert area.sum() == pytest.approx(wanted.area, rel=1e-4, abs=0.02)
    # points so near are one: the plane falls by 0.224 m in a metre
    assert made.vertices[:, 2] == pytest.approx(plane(made.vertices[:, :2] - place), abs=0.224 * SAME_M + 1e-6)


def test_an_open_ring_is_closed_and_boundaries_may_leave_nothing():
    grid = np.array([[x, y, 1.0] for x in range(0, 11, 2) for y in range(0, 11, 2)])
    ring = np.array([[1.0, 1.0, np.nan], [5.0, 1.0, np.nan], [5.0, 4.0, np.nan], [1.0, 4.0, np.nan]])
    for given_ring in (ring, np.concatenate([ring, ring[:1]]), ring[::-1]):
        made = bounded(grid, [], [Boundary("outer", given_ring, "b")])
        assert Tin(made.vertices, made.faces).heights([[1.01, 1.01], [4.99, 3.99]]) == pytest.approx(1.0)
        assert np.isnan(Tin(made.vertices, made.faces).heights([[0.99, 2.0], [3.0, 4.01]])).all()
    with pytest.raises(SiteError, match="leave no triangle"):
        bounded(grid, [], [Boundary("outer", ring + np.array([50.0, 0.0, 0.0]), "b")])
