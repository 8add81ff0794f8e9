"""The travel limiter stops in time: against a rolled-out way past boxes, computed without it."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.guard.travel import Brakes, sideways, travel_rates, travel_speed
from workgauge.values.arrays import frozen, frozen_ints
from workgauge.values.clearances import Clearances
from workgauge.values.reasons import ReasonCode
from workgauge.values.transforms import rotation_z

BRAKES = Brakes(1.0, 0.2)
STOP = 0.2


def seen(distances, normals, points, *, own=None, protections=None, stops=None, searched=20.0) -> Clearances:
    k = len(distances)
    others = frozen_ints([-1] * k if own is None else own)
    zeros = frozen_ints([0] * k)
    points = frozen(np.reshape(points, (k, 3)))
    normals = frozen(np.reshape(normals, (k, 3)))
    return Clearances(
        frozen(distances),
        normals,
        points,
        frozen(points - np.reshape(distances, (k, 1)) * normals),
        zeros,
        others,
        frozen_ints(range(k)),
        zeros,
        zeros,
        frozen([0.0] * k if protections is None else protections),
        frozen([math.nan] * k if stops is None else stops),
        ("arm",),
        tuple(f"point:{i}" for i in range(k)),
        searched,
    )


def left_of(wanted, clearances, twist, curvature=0.0, beside=None, bend=0.0):
    rates = travel_rates(clearances, np.eye(4), np.asarray(twist, dtype=float))
    return travel_speed(wanted, clearances, rates, beside, (abs(curvature), bend), STOP, BRAKES)


AHEAD = [1.0, 0, 0, 0, 0, 0]


@given(st.floats(0.0, 8.0), st.floats(0.05, 5.0), st.floats(0.0, 1.0), st.sampled_from([-1.0, 1.0]))
def test_from_the_speed_left_it_stops_before_a_wall(way, wanted, protection, sign) -> None:
    wall = seen([way], [[-sign, 0, 0]], [[0, 0, 0]], protections=[protection])
    speed, reasons = left_of(sign * wanted, wall, AHEAD)
    left = max(way - protection - STOP, 0.0)
    assert BRAKES.way(abs(speed)) <= left + 1e-9
    assert speed * sign >= 0.0 and abs(speed) <= wanted
    assert bool(reasons) == (speed != sign * wanted)
    if reasons:  # and no slower than it must be
        assert BRAKES.way(abs(speed)) == pytest.approx(left, abs=1e-9)


@given(st.floats(-1.0, 3.0), st.floats(0.1, 3.0))
def test_away_from_a_wall_is_free(distance, wanted) -> None:
    wall = seen([distance], [[1.0, 0, 0]], [[0, 0, 0]])
    assert left_of(wanted, wall, AHEAD) == (wanted, ())


def test_own_links_do_not_move_against_each_other() -> None:
    assert left_of(2.0, seen([0.0], [[-1.0, 0, 0]], [[0, 0, 0]], own=[0]), AHEAD) == (2.0, ())


def test_it_never_goes_faster_than_it_sees() -> None:
    speed, (reason,) = left_of(5.0, seen([], [], [], searched=3.0), AHEAD)
    assert BRAKES.way(speed) == pytest.approx(3.0 - STOP) and "known for 3.0 m" in reason.text


def test_a_limit_with_its_own_stop_distance_is_kept_off_by_it() -> None:
    wall = seen([3.0], [[-1.0, 0, 0]], [[0, 0, 0]], stops=[1.0])
    assert BRAKES.way(left_of(5.0, wall, AHEAD)[0]) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("distance", "code"),
    [(0.1, ReasonCode.LIMIT_REACHED), (-0.1, ReasonCode.INSIDE_LIMIT), (2.0, ReasonCode.LIMIT_NEAR)],
)
def test_the_reason_says_which_and_how_far(distance, code) -> None:
    speed, (reason,) = left_of(4.0, seen([distance], [[-1.0, 0, 0]], [[0, 0, 0]]), AHEAD)
    assert (reason.code, reason.limit, reason.link, reason.clearance_m) == (code, "point:0", "arm", distance)
    assert reason.scale == pytest.approx(speed / 4.0)


@settings(max_examples=200, deadline=None)
@given(
    st.floats(-0.08, 0.08),
    st.floats(0.5, 5.0),
    st.lists(st.tuples(st.floats(-12.0, 12.0), st.floats(-6.0, 6.0)), min_size=1, max_size=5),
    st.tuples(st.floats(-2.0, 8.0), st.floats(-2.5, 2.5)),
)
def test_braking_on_any_arc_past_points_keeps_the_stop_distance(curvature, wanted, posts, tip) -> None:
    """A point on an arc past fixed points, walked in 1 cm steps; what is too near already may not come nearer."""
    posts, tip = np.array(posts), np.array(tip)
    away = tip - posts
    distances = np.linalg.norm(away, axis=1)
    if distances.min() < 1e-3:
        return
    normals = np.column_stack([away / distances[:, None], np.zeros(len(posts))])
    clearances = seen(distances, normals, np.tile([*tip, 0.0], (len(posts), 1)))
    reach = float(np.hypot(*tip))
    twist = [1.0, 0, 0, 0, 0, curvature]
    # a tip off the axis moves on an arc of its own, longer by up to 1 + reach k
    speed, _ = left_of(wanted, clearances, twist, curvature * (1 + abs(curvature) * reach))
    way = BRAKES.way(speed)
    for s in np.arange(0.0, way + 1e-9, 0.01):
        turn = curvature * s
        chord = s * float(np.sinc(turn / 2 / math.pi))
        place = np.array([chord * math.cos(turn / 2), chord * math.sin(turn / 2)])
        now = place + rotation_z(turn)[:2, :2] @ tip
        still = np.linalg.norm(now - posts, axis=1)
        assert (still >= np.minimum(distances, STOP) - 1e-6).all()


def test_what_stands_beside_the_way_is_passed() -> None:
    """A post aside and ahead of the arm: the plane through the closest points alone would slow for it."""
    post = np.array([[5.0 + x, 2.0 + y, z] for x in (0, 0.3) for y in (0, 0.3) for z in (0, 5)])
    solid = np.array([[[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (0, 3)]])
    gap = np.array([4.0, 1.0, 0.0])
    distance = float(np.linalg.norm(gap))
    given_ = seen([distance], [-gap / distance], [[1.0, 1.0, 1.0]])
    beside = sideways(given_, np.eye(4), solid, {0: post})
    assert beside[0] == pytest.approx([1.0]) and beside[1] == pytest.approx([1.0])
    assert left_of(3.0, given_, AHEAD)[0] < 3.0
    assert left_of(3.0, given_, AHEAD, beside=beside) == (3.0, ())
    straight_on = sideways(given_, np.eye(4), solid, {0: post - [0.0, 1.5, 0.0]})
    assert left_of(3.0, given_, AHEAD, beside=straight_on)[0] < 3.0
    assert sideways(given_, np.eye(4), solid, {})[0] == pytest.approx([-math.inf])
