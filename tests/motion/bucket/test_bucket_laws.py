"""What a bucket's way promises, number by number, each against a slow computation of its own."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.machine.load import load_machine
from workgauge.motion.bucket.edge import Bucket, edge_frames
from workgauge.motion.bucket.reach import clear_of_ends, cut_to, error_between, followed_from, reached
from workgauge.motion.bucket.surface_path import Blend, surface_path
from workgauge.motion.bucket.ways import ways
from workgauge.site.surface.delaunay import triangulated
from workgauge.site.surface.laid import laid
from workgauge.site.surface.tin import Tin

HERE = np.eye(4)
ORIGIN = np.zeros(3)


def gridded(x, y, height) -> Tin:
    """Return a surface of the heights at grid lines x (k,), y (m,)."""
    points = np.array([[a, b, height(a, b)] for a in x for b in y])
    m = len(y)
    faces = []
    for i in range(len(x) - 1):
        for j in range(m - 1):
            a, b, c, d = i * m + j, (i + 1) * m + j, (i + 1) * m + j + 1, i * m + j + 1
            faces += [[a, b, c], [a, c, d]]
    return Tin(points, faces)


@settings(max_examples=6, deadline=None, derandomize=True)
@given(high=st.floats(0.03, 0.12), begin=st.floats(3.0, 5.0), long=st.floats(0.1, 1.0), left=st.booleans())
def test_a_way_is_lifted_over_thirty_centimetres_before_and_behind(high, begin, long, left):
    """A block beside the way, under one end of the edge alone: the lift is a trapezium, worked out by hand."""
    end, side = begin + long, 1.0 if left else -1.0
    tin = gridded(
        [0.0, begin - 0.002, begin, end, end + 0.002, 9.0],
        sorted([-3.0, *(side * b for b in (0.2, 0.202, 1.0, 1.002)), 3.0]),
        lambda x, y: high if begin <= x <= end and 0.202 <= side * y <= 1.0 else 0.0,
    )
    (part,) = laid(tin, [[8.0, 0.0], [1.0, 0.0]]).parts
    made = surface_path(tin, part, Bucket(1.0), Blend(over_dig_m=0.0), ORIGIN)
    at = made.path.at(np.linspace(0.0, made.path.length_m, 1500))[0][:, :3, 3]
    ramp = np.array([begin - 0.3, begin, end, end + 0.3])
    wanted = np.interp(at[:, 0], ramp, [0.0, high, high, 0.0])
    # corners are rounded by 2 mm, places are looked at every 1 cm
    slack = 3e-3 + 0.04 * high / 0.3
    assert np.abs(at[:, 2] - wanted).max() < slack
    away = (at[:, 0] < begin - 0.4) | (at[:, 0] > end + 0.4)
    assert np.abs(at[away, 2]).max() < 4e-3  # a later look may begin a ramp of its own, a few millimetres high
    assert made.lift_m == pytest.approx(high, abs=3e-3)


@pytest.mark.parametrize("seed", [2, 3, 11])
def test_where_nothing_is_too_deep_the_way_stays_on_the_surface(seed):
    """Even to begin with, then bumps: the lift ends with them and does not go on to where it is even."""
    rng = np.random.default_rng(seed)
    axis = np.arange(-2.0, 12.0, 1.3)
    x, y = (a.ravel() for a in np.meshgrid(axis, axis - 5.0))
    bumps = np.where(x < 5.0, rng.uniform(-0.05, 0.05, len(x)), 0.0)
    made = triangulated(np.column_stack([x, y, -1.5 + 0.2 * x + 0.1 * y + bumps]))
    tin = Tin(made.vertices, made.faces)
    (part,) = laid(tin, [[9.5, 0.3], [2.5, -0.4]]).parts
    way = surface_path(tin, part, Bucket(1.0), Blend(over_dig_m=0.02), ORIGIN)
    assert way.lift_m > 0.0 and way.below_m <= 0.02
    at = way.path.at(np.linspace(0.0, 2.5, 20))[0][:, :3, 3]
    assert at[:, 2] == pytest.approx(-1.5 + 0.2 * at[:, 0] + 0.1 * at[:, 1], abs=1e-6)


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**4), offset=st.floats(0.0, 1.0), width=st.sampled_from([0.5, 1.0]))
def test_distances_from_the_surface_are_less_what_is_above_it_on_purpose(ground, seed, offset, width):
    tin = ground.rough(seed)
    (part,) = laid(tin, [[8.0, 0.3], [3.0, -0.4]]).parts
    made = surface_path(tin, part, Bucket(width), Blend(over_dig_m=None), ORIGIN, offset_m=offset)
    T = made.path.at(np.linspace(0.0, made.path.length_m, 700))[0]
    gaps = []
    for t in np.linspace(-0.5, 0.5, 61):
        place = T[:, :3, 3] + t * width * T[:, :3, 0]
        gaps.append(place[:, 2] - tin.heights(place[:, :2]))
    assert made.edge_m == pytest.approx(np.abs(np.array(gaps) - offset).max(), abs=3e-3)
    assert made.below_m == pytest.approx(max(0.0, -np.min(gaps)), abs=3e-3)
    assert made.off_surface == 0.0


@settings(max_examples=30, deadline=None)
@given(
    widths=st.tuples(st.floats(1.0, 4.6), st.floats(1.0, 4.6)).filter(
        lambda w: sum(w) > 5.2 and abs(w[0] - w[1]) > 0.4
    ),
    slopes=st.lists(st.floats(-0.4, 0.4), min_size=4, max_size=4).filter(lambda s: np.abs(np.diff(s)).min() > 0.1),
)
def test_of_legs_taken_as_one_the_longest_tells_how_the_edge_lies(widths, slopes):
    """Two strips narrower than 5 mm between two wide ones; the line runs down x."""
    x = np.cumsum([0.0, 2.0, 1e-3 * widths[0], 1e-3 * widths[1], 2.0])
    z = np.concatenate([[0.0], np.cumsum(np.diff(x) * slopes)])
    tin = gridded(x, [-2.0, 2.0], lambda a, _: float(np.interp(a, x, z)))
    (part,) = laid(tin, [[0.5, 0.1], [x[-1] - 0.5, 0.1]]).parts
    lengths = np.diff(x) * np.hypot(1.0, slopes)
    if lengths[1:3].max() > 4.95e-3 or abs(lengths[1] - lengths[2]) < 1e-4:
        return  # not both of them short, or as long as each other
    made = surface_path(tin, part, Bucket(0.6), Blend(corner_m=0.0, over_dig_m=None), ORIGIN)
    ends = np.column_stack([x[[1, 3]], z[[1, 3]]])
    middle = 1.5 * np.hypot(1.0, slopes[0]) + 0.5 * np.linalg.norm(ends[1] - ends[0])
    z_there = made.path.at(middle)[0][:3, 2]
    first, second = (np.arccos(np.clip(z_there @ [s, 0.0, -1.0] / np.hypot(1.0, s), -1, 1)) for s in slopes[1:3])
    assert (first < second) == (lengths[1] > lengths[2])  # z is against the longer one's normal, nearly


@settings(max_examples=30, deadline=None)
@given(width=st.floats(0.4, 2.0), left=st.floats(0.01, 0.99), slope=st.floats(-0.5, 0.5), deep=st.booleans())
def test_the_share_of_the_edge_beside_the_surface(width, left, slope, deep):
    """The surface ends beside the way, under the edge."""
    border = left * 0.5 * width
    tin = gridded([0.0, 9.0], [-5.0, border], lambda x, _: slope * x)
    (part,) = laid(tin, [[7.0, 0.0], [3.0, 0.0]]).parts
    made = surface_path(tin, part, Bucket(width), Blend(over_dig_m=0.01 if deep else None), ORIGIN)
    points = max(np.ceil(width / 0.025) + 1, 3)
    assert made.off_surface == pytest.approx(0.5 * (1.0 - left), abs=1.01 / points)
    whole = gridded([0.0, 9.0], [-5.0, 5.0], lambda x, _: slope * x)
    assert surface_path(whole, part, Bucket(width), Blend(), ORIGIN).off_surface == 0.0


@settings(max_examples=60, deadline=None)
@given(
    tilt=st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6)),
    yaw=st.floats(-3.2, 3.2),
    cutting=st.floats(-1.3, 1.3),
    rolled=st.floats(-0.5, 0.5),
    turned=st.floats(-0.5, 0.5),
    width=st.floats(0.3, 2.0),
)
def test_ends_are_off_along_the_planes_normal_however_the_bucket_leans(tilt, yaw, cutting, rolled, turned, width):
    """An edge turned within its plane, then about the way: its ends leave the plane by the roll alone."""
    normal = np.array([*tilt, 1.0]) / np.linalg.norm([*tilt, 1.0])
    way = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    way[2] = -(normal[:2] @ way[:2]) / normal[2]
    way /= np.linalg.norm(way)
    wanted = np.tile(np.eye(4), (20, 1, 1))
    wanted[:, :3, :3] = edge_frames(normal[None], way[None], cutting)
    wanted[:, :3, 3] = np.linspace(0.0, 2.0, 20)[:, None] * way

    def about(axis, angle):
        x, y, z = axis
        K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        return np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K

    is_at = wanted.copy()
    is_at[:, :3, :3] = about(way, rolled) @ about(normal, turned) @ wanted[:, :3, :3]
    found = error_between(wanted, is_at, width)
    assert found.corner_m == pytest.approx(0.5 * width * abs(np.sin(rolled)) * np.cos(turned), abs=1e-9)
    assert found.turned_rad == pytest.approx(np.arccos(np.cos(rolled) * np.cos(turned)), abs=1e-6)
    assert found.middle_m == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("cutting_deg", "yaw"), [(0.0, 0.0), (-10.0, 0.3), (10.0, -0.4)])
def test_ways_end_where_a_joint_is_four_degrees_from_its_end(ground, cutting_deg, yaw):
    machine, tin = load_machine("rre20"), ground.slope(5.0)
    line = np.outer([9.0, 3.0], [np.cos(yaw), np.sin(yaw)])
    (part,) = laid(tin, line).parts
    bucket, blend = Bucket(0.8, np.radians(cutting_deg)), Blend(over_dig_m=None)
    whole = surface_path(tin, part, bucket, blend, ORIGIN)
    begin, end = reached(machine, whole, HERE)[0]
    inside = surface_path(tin, cut_to(part, begin + 0.05, end - 0.05), bucket, blend, ORIGIN)
    found, _, why = followed_from(machine, inside.path, HERE, machine.home)
    assert found is not None, why
    bounded = ~np.asarray(machine.continuous)

    def free(q):
        room = np.minimum(q - machine.q_min, machine.q_max - q)[..., bounded]
        return np.degrees(room.min(axis=-1))

    s = np.linspace(0.0, found.length_m, 4000)
    clear = s[free(found.curve.at(s)[0]) >= 4.0]
    low, high = clear_of_ends(machine, found)
    assert clear[0] - 1e-3 <= low <= clear[0] + 0.022 and clear[-1] - 0.022 <= high <= clear[-1] + 1e-3
    assert low > 0.0 or high < found.length_m
    (way,), _ = ways(tin, [line], machine, HERE, ORIGIN, bucket, blend)
    assert way.joints is not None
    ends = way.joints.curve.at(np.array([0.0, way.joints.length_m]))[0]
    assert free(ends).min() >= 4.0 - 0.01
