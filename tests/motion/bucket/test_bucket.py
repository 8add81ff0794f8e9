"""The bucket's edge on a surface: frames, blending, depth, reach, and strokes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.machine.load import load_machine
from workgauge.motion.bucket.edge import Bucket, above, edge_frames, edge_points
from workgauge.motion.bucket.reach import cut_to, edge_error, followed_from
from workgauge.motion.bucket.strokes import CutPace, passes, stroke
from workgauge.motion.bucket.surface_path import Blend, surface_path
from workgauge.motion.bucket.ways import default_reach, swing_axis, ways
from workgauge.motion.planning import Pace
from workgauge.site.surface.laid import laid
from workgauge.site.surface.lines import side_by_side
from workgauge.site.surface.tin import Tin
from workgauge.values.errors import InputError

HERE = np.eye(4)
ORIGIN = np.zeros(3)


@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4), st.floats(-1.2, 1.2))
def test_frames_are_makkonens(parts, cutting):
    normal = np.array([0.7 * parts[0], 0.7 * parts[1], 1.0])
    normal /= np.linalg.norm(normal)
    way = np.array([np.cos(3 * parts[2]), np.sin(3 * parts[2]), 0.0])
    way[2] = -(normal[:2] @ way[:2]) / normal[2]
    (R,) = edge_frames(normal[None], way[None])
    assert np.linalg.det(R) == pytest.approx(1.0)
    assert R[:, 2] == pytest.approx(-normal) and R[:, 1] == pytest.approx(-way / np.linalg.norm(way))
    assert R[:, 0] == pytest.approx(np.cross(R[:, 1], R[:, 2]))
    (leaned,) = edge_frames(normal[None], way[None], cutting)
    assert leaned[:, 0] == pytest.approx(R[:, 0])  # the edge itself stays
    wrist = -1.4 * leaned[:, 2]  # (15), on the side it belongs
    assert wrist @ normal == pytest.approx(1.4 * np.cos(cutting))
    assert wrist @ way / np.linalg.norm(way) == pytest.approx(1.4 * np.sin(cutting))


def plane_line(ground, one_in=3.0, turned_deg=45.0, low_m=-1.5, ends=(7.5, 4.6)):
    tin = ground.slope(one_in, turned_deg, low_m)
    (part,) = laid(tin, [[ends[0], 0.0], [ends[1], 0.0]]).parts
    return tin, part


@pytest.mark.parametrize(("one_in", "height"), [(3.0, 0.118), (1.5, 0.236)])
def test_four_joints_leave_the_corner_and_six_do_not(ground, one_in, height):
    """A bucket of one metre at 45 degrees to the fall line: its end is 0.5 sin 45 = 35 cm along it in plan."""
    tin, part = plane_line(ground, one_in, low_m=-4.5 / one_in, ends=(6.8, 5.6))
    made = surface_path(tin, part, Bucket(1.0), Blend(over_dig_m=None), ORIGIN)
    six, four = load_machine("rre20"), ground.four_jointed()
    found, _, why = followed_from(six, made.path, HERE, six.home)
    assert found is not None, why
    with_six = edge_error(six, found, 1.0)
    found, _, why = followed_from(four, made.path, HERE, four.home)
    assert found is not None, why
    with_four = edge_error(four, found, 1.0)
    assert with_six.corner_m < 1e-3 and with_six.middle_m < 1e-3
    wanted = 0.5 * np.sin(np.radians(45.0)) / one_in
    assert wanted == pytest.approx(height, abs=1e-3)
    lean = 1.0 / np.hypot(1.0, 1.0 / one_in)  # along the plane's normal, not upright
    assert with_four.corner_m == pytest.approx(wanted * lean, rel=0.01)
    assert with_four.middle_m < 1e-3
    print(f"\n1:{one_in:g}: four joints {with_four.corner_m:.4f} m, six {with_six.corner_m:.6f} m at the edge's end")


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10**4), width=st.sampled_from([0.6, 1.0, 1.5]), deep=st.sampled_from([0.0, 0.005, 0.02]))
def test_the_edge_is_nowhere_deeper_than_allowed(ground, seed, width, deep):
    tin = ground.rough(seed)
    (part,) = laid(tin, [[8.0, 0.3], [3.0, -0.4]]).parts
    made = surface_path(tin, part, Bucket(width), Blend(over_dig_m=deep), ORIGIN)
    T = made.path.at(np.linspace(0.0, made.path.length_m, 1500))[0]
    gap = above(tin, edge_points(T, width, 0.01), ORIGIN)
    assert np.nanmin(gap) >= -deep - 1.5e-3  # between the places looked at
    free = surface_path(tin, part, Bucket(width), Blend(over_dig_m=None), ORIGIN)
    if free.below_m > deep:
        assert made.lift_m > 0.0
    else:
        assert made.lift_m == 0.0


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**4), offset=st.floats(0, 1), turn=st.sampled_from([1e-3, 0.1, 0.25]))
def test_between_edges_the_edge_lies_in_its_triangle(ground, seed, offset, turn):
    tin = ground.rough(seed, step_m=2.0)
    (part,) = laid(tin, [[8.0, 0.3], [3.0, -0.4]]).parts
    blend = Blend(turn_m=turn, over_dig_m=None)
    made = surface_path(tin, part, Bucket(), blend, ORIGIN, offset_m=offset)
    s, T = made.poses()
    middle = T[:, :3, 3] - [0, 0, offset]
    faces = tin.at(middle[:, :2]).face
    edges = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(part.points, axis=0), axis=1))])
    away = np.abs(s[:, None] - edges[1:-1]).min(axis=1)
    inside = away > turn + 0.03
    assert inside.sum() > 10
    off = np.einsum("ni,ni->n", T[:, :3, 2], tin.normals[faces])
    assert (off[inside] < -1 + 1e-6).all()  # z is against the normal
    assert np.abs(above(tin, middle, ORIGIN)).max() < blend.corner_m + 1e-3
    turned = np.degrees(np.arccos(np.clip(-off, -1, 1)))
    assert turned.max() <= np.degrees(made.turned_rad) * 2 + 0.1


def test_the_edge_runs_at_its_speed_and_joints_do_not_jump(ground):
    machine = load_machine("rre20")
    tin = ground.rough(5, 0.03)
    (part,) = laid(tin, [[7.3, 0.0], [4.9, 0.0]]).parts
    made = surface_path(tin, part, Bucket(), Blend(), ORIGIN)
    done = stroke(machine, HERE, machine.home, made, CutPace(0.3, Pace(0.5, None, 0.8)))
    cut = done.motions[done.cut].trajectory
    t = np.arange(0.0, cut.duration_s, 0.01)
    steady = np.interp(t, cut.times, cut.rate)
    assert (steady <= 0.3 + 1e-9).all() and (steady > 0.29).mean() > 0.6
    _, qdot, _ = cut.many(t)
    jump = np.abs(np.diff(qdot, axis=0)).max() / 0.01
    assert jump < 3.0  # rad/s2
    names = [motion.words for motion in done.motions]
    assert names[1:] == ["down to cut", "cut", "up from cut"]
    for one, other in zip(done.motions[:-1], done.motions[1:], strict=True):
        assert one.trajectory.q[-1] == pytest.approx(other.trajectory.q[0], abs=2e-3)
    end = HERE @ machine.tool_pose(machine.forward(done.q_end))
    assert end[2, 3] - made.path.at(made.path.length_m)[0][2, 3] == pytest.approx(done.lift_m, abs=1e-3)


@settings(max_examples=8, deadline=None)
@given(turned=st.floats(0, 360), one_in=st.floats(3.0, 10.0), allowed=st.sampled_from([0.0, 0.01, 0.03]))
def test_four_joints_are_held_out_of_the_ground_where_they_cannot_turn(ground, turned, one_in, allowed):
    """The machine's own edge, by its joints: nowhere deeper than allowed, and no higher than it must be."""
    low = -1.5 - 6.2 * np.cos(np.radians(turned)) / one_in  # in the middle of the line the ground is at -1.5 m
    machine, tin = ground.four_jointed(), ground.slope(one_in, turned, low)
    line = [np.array([[6.8, 0.0], [5.6, 0.0]])]
    (way,), _ = ways(tin, line, machine, HERE, ORIGIN, Bucket(), Blend(over_dig_m=allowed))
    assert way.joints is not None and way.error is not None
    q = way.joints.curve.at(np.linspace(0.0, way.joints.length_m, 60))[0]
    T = np.array([machine.tool_pose(machine.forward(one)) for one in q])
    across = np.linspace(-0.5, 0.5, 11)[:, None]
    edge = T[:, None, :3, 3] + across * T[:, None, :3, 0]
    normal = tin.normals[0]
    lowest = ((edge - [0.0, 0.0, low]) @ normal).min() / normal[2]  # upright
    assert lowest >= -allowed - 1.5e-3
    assert way.below_m == pytest.approx(max(0.0, -lowest), abs=1e-3)
    if way.made.lift_m > 0.0:
        assert lowest <= 2e-3  # it touches the ground all the same
    else:
        assert way.error.corner_m <= allowed + 1.5e-3


def test_lines_are_cut_to_what_is_reached_and_it_is_said(ground):
    machine = load_machine("rre20")
    near, far = default_reach(machine)
    assert 2.5 < near < 4.0 and 8.5 < far < 9.5
    assert swing_axis(machine, HERE) == pytest.approx([0.0, 0.0], abs=1e-9)
    tin = ground.slope(5.0)
    found, said = ways(tin, side_by_side([0, 0], 0.0, near, far, 2), machine, HERE, ORIGIN, Bucket(), Blend())
    assert len(found) == 2 and all(way.joints is not None for way in found)
    assert all("out of reach and cut off" in text for text in said)
    for way in found:
        assert way.error is not None and way.error.corner_m < 1e-3
        assert way.part.points[0, 0] > way.part.points[-1, 0]
    gone, said = ways(tin, side_by_side([0, 0], 0.0, 12.0, 15.0, 1), machine, HERE, ORIGIN, Bucket(), Blend())
    assert gone[0].joints is None and "not reached" in said[0]
    none, said = ways(tin, side_by_side([100, 0], 0.0, 4.0, 7.0, 1), machine, HERE, ORIGIN, Bucket(), Blend())
    assert none == [] and said == ["line 1: no surface under it"]


def test_a_hole_under_the_way_ends_it_and_is_said(ground):
    machine = load_machine("rre20")
    whole = ground.rough(1, 0.0)
    middle = whole.vertices[whole.faces].mean(axis=1)
    kept = whole.faces[~((np.abs(middle[:, 0] - 6.0) < 0.9) & (np.abs(middle[:, 1]) < 1.5))]
    tin = Tin(whole.vertices, kept)
    found, said = ways(tin, side_by_side([0, 0], 0.0, 3.1, 9.0, 1), machine, HERE, ORIGIN, Bucket(), Blend())
    assert any("no surface under it from" in text for text in said)
    assert any("of the edge's way has no surface" in text or "cut off" in text for text in said)
    assert len(found) >= 1


def test_passes_go_down_to_the_surface(ground):
    tin, part = plane_line(ground)
    made = surface_path(tin, part, Bucket(), Blend(), ORIGIN)
    heap = Tin(tin.vertices + np.array([0, 0, 0.35]), tin.faces)
    assert passes(heap, made, 0.1, ORIGIN) == pytest.approx([0.3, 0.2, 0.1, 0.0])
    assert passes(heap, made, 0.35, ORIGIN) == pytest.approx([0.0])
    assert passes(None, made, 0.1, ORIGIN) == [0.0] == passes(heap, made, None, ORIGIN)
    below = Tin(tin.vertices - [0, 0, 1.0], tin.faces)
    assert passes(below, made, 0.1, ORIGIN) == [0.0]
    for wrong in (0.0, -1.0, 1e-4):
        with pytest.raises(InputError):
            passes(heap, made, wrong, ORIGIN)


def test_a_stretch_of_a_line_keeps_its_crossings(ground):
    tin = ground.rough(3)
    (part,) = laid(tin, [[8.0, 0.3], [3.0, -0.4]]).parts
    cut = cut_to(part, 1.0, 3.5)
    assert cut.length_m == pytest.approx(2.5)
    middles = 0.5 * (cut.points[1:] + cut.points[:-1])
    assert (tin.at(middles[:, :2]).face == cut.faces).all()
    assert cut_to(part, -1.0, 99.0).points == pytest.approx(part.points)
    with pytest.raises(InputError, match="nothing of the line"):
        cut_to(part, 50.0, 60.0)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Bucket(0.0),
        lambda: Bucket(1.0, 2.0),
        lambda: Blend(turn_m=0.0),
        lambda: Blend(corner_m=float("nan")),
        lambda: Blend(over_dig_m=-0.1),
    ],
)
def test_what_is_no_bucket_is_refused(make):
    with pytest.raises(InputError):
        make()


def test_a_way_that_is_too_short_is_refused(ground):
    tin, part = plane_line(ground)
    dot = cut_to(part, 1.0, 1.0011)
    short = replace(dot, points=dot.points[:1] + np.array([[0.0], [1e-5]]) * [1, 0, 0])
    with pytest.raises(InputError, match="too short"):
        surface_path(tin, short, Bucket(), Blend(), ORIGIN)
