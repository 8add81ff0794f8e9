"""Lines laid on surfaces: every crossing is an edge's, none is missed, lengths are those of dense samples."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.site.read import read_site
from workgauge.site.surface.delaunay import triangulated
from workgauge.site.surface.laid import laid
from workgauge.site.surface.tin import Tin
from workgauge.values.errors import SiteError

REAL = Path(__file__).parents[3].parent / "shared" / "data" / "landxml" / "inframodel_m3"
NAMES = ["M3_Terrain.mm.xml", "M3_Highest_Comb_rev2_Highest_combination_of_surface.mm.xml"]


@cache
def real(name: str) -> Tin:
    if not REAL.is_dir():
        pytest.skip(f"real files absent: {REAL}")
    return Tin.of_all(read_site([REAL / name]).surfaces)


def sampled(tin, start, end, step):
    """Return (distances at which the triangle changes, length on the surface, of gaps nothing) by dense samples."""
    total = float(np.linalg.norm(end - start))
    t = np.arange(0.0, total, step)
    points = start + np.outer(t / total, end - start)
    found = tin.at(points)
    changes = 0.5 * (t[1:] + t[:-1])[found.face[1:] != found.face[:-1]]
    both = (found.face[1:] >= 0) & (found.face[:-1] >= 0)
    rise = np.diff(found.z)
    return changes, float(np.hypot(np.diff(t), rise)[both].sum())


def agrees(tin, start, end, step=1e-3):
    line = laid(tin, [start, end])
    changes, length = sampled(tin, start, end, step)
    crossed = np.concatenate([*(part.along for part in line.parts), [0.0, line.length_m]])
    for at in changes:
        assert np.abs(crossed - at).min() <= step, f"a crossing at {at} was missed"
    # each crossing found is one of the samples', unless two lie within one step of each other
    found = np.unique(np.round(np.concatenate([part.along[1:-1] for part in line.parts] or [[]]), 9))
    alone = found[(np.diff(found, prepend=-1.0) > 2 * step) & (np.diff(found, append=1e9) > 2 * step)]
    if len(alone):
        assert max(np.abs(changes - at).min() for at in alone) <= 2 * step
    on_surface = sum(part.length_m for part in line.parts)
    assert on_surface == pytest.approx(length, abs=4 * step * (1 + len(line.parts)) + 1e-5 * length)
    for part in line.parts:
        middle = 0.5 * (part.points[1:] + part.points[:-1])
        long = np.diff(part.along) > 1e-5
        assert (tin.at(middle[:, :2]).face == part.faces)[long].all()
        assert np.abs(tin.heights(part.points[1:-1, :2]) - part.points[1:-1, 2]).max(initial=0.0) < 1e-6
    return len(changes)


def random_lines(tin, count, seed, length=25.0):
    rng = np.random.default_rng(seed)
    for face in rng.integers(0, len(tin), count):
        start = tin.vertices[tin.faces[face], :2].mean(axis=0)
        angle = rng.uniform(0, 2 * np.pi)
        yield start, start + length * np.array([np.cos(angle), np.sin(angle)])


@pytest.mark.parametrize("name", NAMES)
def test_every_crossing_is_found_on_real_surfaces(name):
    tin = real(name)
    assert sum(agrees(tin, *line) for line in random_lines(tin, 12, 3)) > 60


@pytest.mark.prove
@pytest.mark.parametrize("name", NAMES)
def test_every_crossing_is_found_on_real_surfaces_many(name):
    tin = real(name)
    crossings = sum(agrees(tin, *line) for line in random_lines(tin, 300, 5))
    print(f"\n{name}: {crossings} crossings of 300 lines found, at 1 mm")


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), far=st.booleans())
def test_every_crossing_is_found_on_random_surfaces(seed, far):
    rng = np.random.default_rng(seed)
    place = np.array([25_486_800.0, 6_714_300.0, 80.0]) if far else np.zeros(3)
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0.0, 20.0, 2.5), np.arange(0.0, 20.0, 2.5)))
    points = np.column_stack([x, y, rng.uniform(0, 3, len(x))])
    points[:, :2] += rng.uniform(-0.8, 0.8, (len(x), 2))
    made = triangulated(points + place)
    tin = Tin(made.vertices, made.faces)
    start, end = rng.uniform(1.0, 16.5, (2, 2)) + place[:2]
    agrees(tin, start, end, step=2e-3)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_a_line_laid_backwards_is_the_same_line(seed):
    rng = np.random.default_rng(seed)
    made = triangulated(rng.uniform([0, 0, 0], [20, 20, 3], (40, 3)))
    tin = Tin(made.vertices, made.faces)
    line = rng.uniform(0, 20, (4, 2))
    there, back = laid(tin, line), laid(tin, line[::-1])
    assert sum(p.length_m for p in there.parts) == pytest.approx(sum(p.length_m for p in back.parts), abs=1e-9)
    assert len(there.parts) == len(back.parts)
    for one, other in zip(there.parts, back.parts[::-1], strict=True):
        assert one.points == pytest.approx(other.points[::-1], abs=1e-8)


GRID = np.array([[x, y, 0.1 * x * y] for x in range(4) for y in range(4)], dtype=float)


def grid_tin():
    faces = []
    for x in range(3):
        for y in range(3):
            a, b, c, d = 4 * x + y, 4 * (x + 1) + y, 4 * (x + 1) + y + 1, 4 * x + y + 1
            faces += [[a, b, c], [a, c, d]]
    return Tin(GRID, faces)


def test_along_an_edge_and_through_corners():
    tin = grid_tin()
    on_edge = laid(tin, [[1.0, 0.0], [1.0, 3.0]])
    (part,) = on_edge.parts
    assert part.points[:, :2].tolist() == [[1, 0], [1, 1], [1, 2], [1, 3]]
    assert part.points[:, 2] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    (diagonal,) = laid(tin, [[0.0, 0.0], [3.0, 3.0]]).parts
    assert diagonal.points[:, :2] == pytest.approx(np.array([[0, 0], [1, 1], [2, 2], [3, 3]]))
    (across,) = laid(tin, [[0.0, 3.0], [3.0, 0.0]]).parts
    assert across.points[:, 0] == pytest.approx([0, 0.5, 1, 1.5, 2, 2.5, 3])
    (bent,) = laid(tin, [[0.2, 0.1], [0.9, 0.1], [0.9, 0.1], [0.9, 0.8]]).parts
    assert [0.9, 0.1] in np.round(bent.points[:, :2], 9).tolist()


def test_gaps_and_steps_end_a_part_and_are_told():
    tin = Tin(
        [[0.0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0], [4, 0, 3], [4, 4, 3], [8, 0, 3], [8, 4, 3]],
        [[0, 1, 2], [0, 2, 3], [4, 6, 5], [6, 7, 5]],
    )
    line = laid(tin, [[-1.0, 1.0], [9.0, 1.0]])
    assert line.gaps == ((0.0, 1.0), (9.0, 10.0))
    assert line.steps == ((5.0, 3.0),)
    assert [round(part.length_m, 9) for part in line.parts] == [4.0, 4.0]
    assert laid(tin, [[20.0, 1.0], [30.0, 1.0]]).parts == ()
    assert laid(tin, [[20.0, 1.0], [30.0, 1.0]]).gaps == ((0.0, 10.0),)


def test_above_each_other_the_topmost_is_laid_on():
    low = [[0.0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0]]
    roof = [[2.0, -1, -1.0], [8, -1, 5.0], [5, 11, 2.0]]
    tin = Tin([*low, *roof], [[0, 1, 2], [0, 2, 3], [4, 5, 6]])
    line = laid(tin, [[0.0, 1.0], [10.0, 1.0]])
    changes, _ = sampled(tin, np.array([0.0, 1.0]), np.array([10.0, 1.0]), 1e-3)
    crossed = np.concatenate([part.along for part in line.parts])
    assert all(np.abs(crossed - at).min() <= 1e-3 for at in changes)
    heights = np.concatenate([part.points[:, 2] for part in line.parts])
    assert heights.max() > 3.0 and heights.min() >= -1e-9


def test_what_is_no_line_is_refused():
    with pytest.raises(SiteError, match="two places"):
        laid(grid_tin(), [[1.0, 1.0], [1.0, 1.0]])
    with pytest.raises(SiteError, match="numbers"):
        laid(grid_tin(), [[1.0, 1.0], [np.inf, 1.0]])
