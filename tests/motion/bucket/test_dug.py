"""What an edge sweeps, cell by cell, against a surface whose differences are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.motion.bucket.dug import dug_map, merged
from workgauge.motion.bucket.edge import edge_frames


def drawn(tin, start, end, above, steps=40):
    """Return poses (N, 4, 4) along a straight line, so far above the surface."""
    t = np.linspace(0.0, 1.0, steps)[:, None]
    plan = start + t * (np.array(end) - start)
    found = tin.at(plan)
    way = np.append(np.array(end, dtype=float) - start, 0.0)
    ways = np.tile(way, (steps, 1))
    ways[:, 2] = -(found.normal[:, :2] @ way[:2]) / found.normal[:, 2]
    T = np.tile(np.eye(4), (steps, 1, 1))
    T[:, :3, :3] = edge_frames(found.normal, ways)
    T[:, :3, 3] = np.column_stack([plan, found.z + above])
    return T


@settings(max_examples=25, deadline=None)
@given(above=st.floats(-0.05, 0.3), width=st.floats(0.4, 2.0), turned=st.floats(0, 360))
def test_an_even_sweep_is_even_everywhere(ground, above, width, turned):
    tin = ground.slope(4.0, turned)
    dug = dug_map(tin, [drawn(tin, [6.0, 0.0], [3.0, 0.5], above)], width, np.zeros(3), allowed_m=0.02)
    known = dug.left_m[np.isfinite(dug.left_m)]
    assert known == pytest.approx(above, abs=1e-9)
    assert dug.rms_m == pytest.approx(abs(above), abs=1e-9) and dug.mean_m == pytest.approx(above, abs=1e-9)
    assert dug.deepest_m == pytest.approx(max(0.0, -above), abs=1e-9)
    assert dug.over_dug == (above < -0.02 - 1e-12)
    length = np.hypot(3.0, 0.5)
    edges = 2 * (length + width) * dug.cell_m
    assert dug.area_m2 == pytest.approx(length * width, abs=1.5 * edges)


def test_the_lowest_pass_counts_and_places_are_absolute(ground):
    tin = ground.slope(4.0)
    far = np.array([25_486_800.0, 6_714_300.0, 80.0])
    moved = type(tin)(tin.vertices + far, tin.faces)
    high, low = drawn(tin, [6.0, 0.0], [3.0, 0.0], 0.2), drawn(tin, [5.0, 0.0], [4.0, 0.0], 0.05)
    for tin_there, origin in ((tin, np.zeros(3)), (moved, far)):
        dug = dug_map(tin_there, [high, low], 1.0, origin)
        known = dug.left_m[np.isfinite(dug.left_m)]
        assert sorted(set(np.round(known, 4).tolist())) == [0.05, 0.2]
        assert 0.25 < (known < 0.1).mean() < 0.45
        assert dug.low == pytest.approx(np.array([3.0, -0.5]) + origin[:2], abs=0.06)
        assert dug.as_json()["allowed_m"] is None and not dug.over_dug
    assert dug_map(tin, [], 1.0, np.zeros(3)) is None
    assert dug_map(tin, [high], 1.0, np.array([1e5, 0.0, 0.0])) is None


def test_a_dip_between_two_ticks_is_in_the_map_and_at_ticks_in_deepest(ground):
    tin = ground.slope(1e6)
    T = drawn(tin, [6.0, 0.0], [5.0, 0.0], 0.0, steps=3)
    T[1, 2, 3] -= 0.04
    dug = dug_map(tin, [T], 1.0, np.zeros(3), allowed_m=0.03)
    assert dug.deepest_m == pytest.approx(0.04, abs=1e-4) and dug.over_dug
    assert np.nanmin(dug.left_m) == pytest.approx(-0.04, abs=1e-3)
    assert np.nanmean(dug.left_m) == pytest.approx(-0.02, abs=5e-3)


def test_ways_there_and_back_count_in_depth_and_not_in_the_map(ground):
    tin = ground.slope(4.0)
    cut, down = drawn(tin, [6.0, 0.0], [3.0, 0.0], 0.05), drawn(tin, [6.5, 0.0], [6.0, 0.0], -0.03)
    dug = dug_map(tin, [cut], 1.0, np.zeros(3), allowed_m=0.02, beside=[down])
    assert dug.deepest_m == pytest.approx(0.03) and dug.over_dug
    assert dug.left_m[np.isfinite(dug.left_m)] == pytest.approx(0.05)


@settings(max_examples=20, deadline=None)
@given(shift=st.tuples(st.floats(-4, 4), st.floats(-4, 4)), far=st.booleans())
def test_maps_of_several_designs_are_laid_upon_each_other(ground, shift, far):
    """A second design lies 1 m lower: against its own, each cut is exact; the lowest of each cell counts."""
    high = ground.slope(4.0)
    low = type(high)(high.vertices - [0.0, 0.0, 1.0], high.faces)
    origin = np.array([25_486_800.0, 6_714_300.0, 80.0]) if far else np.zeros(3)
    high, low = (type(high)(tin.vertices + origin, tin.faces) for tin in (high, low))
    local = type(high)(high.vertices - origin, high.faces)
    under = type(high)(low.vertices - origin, low.faces)
    start = np.array([6.0, 0.0])
    one = dug_map(high, [drawn(local, start, start - [3.0, 0.0], 0.04)], 1.0, origin, allowed_m=0.02)
    two_at = start + np.array(shift)
    two = dug_map(low, [drawn(under, two_at, two_at - [2.0, 0.5], -0.01)], 0.6, origin, allowed_m=0.005)
    both = merged([one, two])
    known = both.left_m[np.isfinite(both.left_m)]
    assert sorted(set(np.round(known, 6).tolist())) in ([-0.01, 0.04], [-0.01])
    assert (known < 0.0).sum() == np.isfinite(two.left_m).sum()  # of two in one cell the lower
    assert (known < 0.0).sum() <= len(known) <= np.isfinite(one.left_m).sum() + np.isfinite(two.left_m).sum()
    assert both.low == pytest.approx(np.minimum(one.low, two.low), abs=1e-6)
    assert both.deepest_m == pytest.approx(0.01) and both.allowed_m == 0.005 and both.over_dug
    assert merged([one]).left_m == pytest.approx(one.left_m, nan_ok=True)
