"""Lines beside bends against curves summed up step by step, and steps of a surface at their border."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.site.surface.laid import laid
from workgauge.site.surface.lines import beside, side_by_side
from workgauge.site.surface.tin import Tin
from workgauge.site.transitions import Law


def summed(rows, offset, step=0.01):
    """Return places (N, 2) beside a curve of (length, curvature, curvature) rows by summing up small steps."""
    e, n, yaw = 12.5, -31.25, 0.4
    found = []
    for length, k0, k1 in rows:
        count = int(np.ceil(length / step))
        ds = length / count
        s = ds * np.arange(count + 1)
        turned = yaw + k0 * s + 0.5 * (k1 - k0) / length * s**2
        middle = 0.5 * (turned[1:] + turned[:-1])
        es = e + np.concatenate([[0.0], np.cumsum(ds * np.cos(middle))])
        ns = n + np.concatenate([[0.0], np.cumsum(ds * np.sin(middle))])
        found.append(np.column_stack([es - offset * np.sin(turned), ns + offset * np.cos(turned)]))
        e, n, yaw = es[-1], ns[-1], turned[-1]
    return np.concatenate(found) + np.array([21_530_000.0, 6_783_000.0])


def from_polyline(points, line):
    """Return the distance of each of points (N, 2) from a polyline (k, 2): every one against every chord."""
    a, d = line[:-1], np.diff(line, axis=0)
    gap = points[:, None] - a
    t = np.clip((gap * d).sum(-1) / (d * d).sum(-1), 0.0, 1.0)
    return np.linalg.norm(gap - t[..., None] * d, axis=-1).min(axis=1)


@settings(max_examples=30, deadline=None)
@given(
    radius=st.floats(40.0, 400.0),
    side=st.sampled_from([-1.0, 1.0]),
    share=st.floats(-0.6, 0.6),
    arc=st.floats(5.0, 20.0),
    spiral=st.floats(8.0, 20.0),
)
def test_chords_beside_arcs_and_clothoids_stay_within_a_millimetre(tools, radius, side, share, arc, spiral):
    k = side / radius
    offset = share * min(radius, 60.0)
    rows = [(3.0, 0.0, 0.0), (spiral, 0.0, k), (arc, k, k), (spiral, k, 0.0), (spiral, 0.0, -k), (arc, -k, -k)]
    kinds = ["line", "spiral", "curve", "spiral", "spiral", "curve"]
    laws = [Law.CLOTHOID if kind == "spiral" else Law.CONSTANT for kind in kinds]
    items = [(kind, law, *row) for kind, law, row in zip(kinds, laws, rows, strict=True)]
    track = tools.build(tools.chain(*items))
    line = beside(track, offset, 0.0, track.length)
    assert from_polyline(summed(rows, offset)[::5], line).max() < 1.02e-3
    assert line[[0, -1]] == pytest.approx(summed(rows, offset)[[0, -1]], abs=1e-4)


@given(count=st.integers(1, 12), gap=st.floats(0.1, 3.0), yaw=st.floats(-7, 7))
def test_of_two_as_far_from_the_middle_the_right_one_is_first(count, gap, yaw):
    lines = np.array(side_by_side([0.0, 0.0], yaw, 3.0, 6.0, count, gap))
    right = lines[:, 0] @ [np.sin(yaw), -np.cos(yaw)] / gap
    odd = [k if k == 0 else (k + 1) // 2 * (1 if k % 2 else -1) for k in range(count)]
    even = [(k // 2 + 0.5) * (-1 if k % 2 else 1) for k in range(count)]
    assert right == pytest.approx(odd if count % 2 else even, abs=1e-6)


@settings(max_examples=60, deadline=None)
@given(
    jump_mm=st.one_of(st.floats(0.05, 0.98), st.floats(1.02, 9.0)),
    down=st.booleans(),
    slopes=st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
    ends=st.tuples(st.floats(-3, 3), st.floats(-3, 3)),
    back=st.booleans(),
)
def test_steps_of_more_than_a_millimetre_end_a_part(jump_mm, down, slopes, ends, back):
    jump = (-1e-3 if down else 1e-3) * jump_mm
    corners = np.array([[-6.0, -5.0], [0, -5], [0, 5], [-6, 5], [0, -5], [6, -5], [6, 5], [0, 5]])
    z = corners @ slopes + jump * (np.arange(8) >= 4)
    tin = Tin(np.column_stack([corners, z]), [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    line = np.array([[-5.0, ends[0]], [5.0, ends[1]]])
    found = laid(tin, line[::-1] if back else line)
    assert found.gaps == ()
    if jump_mm > 1.0:
        ((at, rise),) = found.steps
        assert at == pytest.approx(0.5 * found.length_m, abs=1e-6)
        assert rise == pytest.approx(-jump if back else jump, abs=1e-9)
        assert len(found.parts) == 2
    else:
        assert found.steps == () and len(found.parts) == 1
