"""A tool path by distance: arc length, smoothness, corners, and what is refused before anything moves."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from workgauge.motion.paths.orientations import angles
from workgauge.motion.paths.tool_path import ToolPath
from workgauge.values.errors import InputError
from workgauge.values.tasks import Orientation
from workgauge.values.transforms import rotation_vector


def drawn(seed: int, k: int, *, turned: bool = True) -> tuple[np.ndarray, np.ndarray | None]:
    """Return k points that wander without repeating, and orientations that wander with them."""
    rng = np.random.default_rng(seed)
    heading = rng.uniform(-math.pi, math.pi)
    points = [rng.uniform(-5.0, 5.0, 3)]
    for _ in range(k - 1):
        heading += rng.uniform(-1.5, 1.5)
        step = rng.uniform(0.2, 3.0)
        points.append(points[-1] + step * np.array([math.cos(heading), math.sin(heading), rng.uniform(-0.5, 0.5)]))
    if not turned:
        return np.array(points), None
    R = [Rotation.from_rotvec(rng.uniform(-2.0, 2.0, 3))]
    R.extend(R[-1] * Rotation.from_rotvec(rng.uniform(-0.5, 0.5, 3)) for _ in range(k - 1))
    return np.array(points), np.array([one.as_matrix() for one in R])


SEEDS, COUNTS = st.integers(0, 10**6), st.integers(2, 7)
KINDS = st.sampled_from(["spline", "rounded", "sharp"])


def made(kind: str, points: np.ndarray, R: np.ndarray | None) -> ToolPath:
    if kind == "spline":
        return ToolPath.spline(points, R)
    return ToolPath.polyline(points, R, blend_m=0.05 if kind == "rounded" else 0.0)


@settings(max_examples=12, deadline=None)
@given(SEEDS, COUNTS, KINDS)
def test_distance_is_the_length_driven(seed: int, k: int, kind: str) -> None:
    path = made(kind, *drawn(seed, k))
    for start, end in itertools.pairwise(path.breaks_m):
        p = path.at(np.linspace(start, end, 801))[0][:, :3, 3]
        fine, coarse = (np.linalg.norm(np.diff(p[::step], axis=0), axis=1) for step in (1, 2))
        driven = (4.0 * (fine[::2] + fine[1::2]) - coarse) / 3.0  # chords, their second-order error taken out
        assert np.abs(driven - (end - start) / 400).max() < 1e-6 * (end - start)


@settings(max_examples=12, deadline=None)
@given(SEEDS, COUNTS, KINDS)
def test_the_tangent_is_the_change_of_the_pose(seed: int, k: int, kind: str) -> None:
    path = made(kind, *drawn(seed, k))
    rng, h = np.random.default_rng(seed), 1e-5
    s = rng.uniform(h, path.length_m - h, 20)
    s = s[np.abs(s[:, None] - path.breaks_m).min(axis=1) > 2.0 * h]
    (T, tangent), (before, _), (after, _) = path.at(s), path.at(s - h), path.at(s + h)
    assert np.linalg.norm(tangent[:, :3], axis=1) == pytest.approx(1.0, abs=1e-12)
    assert (after[:, :3, 3] - before[:, :3, 3]) / (2 * h) == pytest.approx(tangent[:, :3], abs=1e-5)
    turned = [rotation_vector(b[:3, :3] @ a[:3, :3].T) for a, b in zip(before, after, strict=True)]
    assert np.reshape(turned, (-1, 3)) / (2 * h) == pytest.approx(tangent[:, 3:], abs=1e-4)
    assert T[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2) == pytest.approx(np.tile(np.eye(3), (len(s), 1, 1)))


@settings(max_examples=8, deadline=None)
@given(SEEDS, COUNTS, KINDS)
def test_every_given_point_is_passed_in_order_within_the_stated_deviation(seed: int, k: int, kind: str) -> None:
    points, R = drawn(seed, k)
    path = made(kind, points, R)
    assert np.all(np.diff(path.point_distances_m) > 0.0)
    assert path.point_distances_m[0] == 0.0 and path.point_distances_m[-1] == path.length_m
    T, _ = path.at(path.point_distances_m)
    assert np.linalg.norm(T[:, :3, 3] - points, axis=1) == pytest.approx(path.deviations_m, abs=1e-12)
    assert path.deviations_m.max() < (0.05 + 1e-9 if kind == "rounded" else 1e-9)
    assert R is not None
    assert angles(np.swapaxes(R, 1, 2) @ T[:, :3, :3]) == pytest.approx(path.deviations_rad, abs=1e-12)
    if kind != "rounded":
        assert path.deviations_rad.max() < 1e-6
    everywhere = path.at(np.linspace(0.0, path.length_m, 4001))[0][:, :3, 3]
    for point, stated in zip(points, path.deviations_m, strict=True):
        assert np.linalg.norm(everywhere - point, axis=1).min() >= stated - 1e-9


@settings(max_examples=12, deadline=None)
@given(SEEDS, COUNTS, st.sampled_from(["spline", "rounded"]))
def test_no_step_in_direction_curvature_or_rate_of_turning(seed: int, k: int, kind: str) -> None:
    path = made(kind, *drawn(seed, k))
    inner, h = path.breaks_m[1:-1], 1e-7
    assert len(path.stops_m) == 0
    before, after = path.at(inner - h)[1], path.at(inner + h)[1]
    assert after == pytest.approx(before, abs=2e-4)
    h = 1e-5  # the second derivative from either side
    left = (path.at(inner - h)[1] - path.at(inner - 2 * h)[1]) / h
    right = (path.at(inner + 2 * h)[1] - path.at(inner + h)[1]) / h
    size = 1.0 + np.abs(left).max(initial=0.0)
    assert right / size == pytest.approx(left / size, abs=0.05)


def test_a_sharp_corner_is_a_stop_and_a_straight_one_is_none() -> None:
    path = ToolPath.polyline([[0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 1, 0]])
    assert path.stops_m == pytest.approx([2.0])
    assert path.at(2.0)[1][:3] == pytest.approx([0, 1, 0])
    assert path.at(2.0, arriving=True)[1][:3] == pytest.approx([1, 0, 0])
    assert path.orientation is Orientation.FREE


def test_a_change_of_turning_alone_is_a_corner() -> None:
    turn = Rotation.from_rotvec([[0, 0, 0], [0, 0, 0], [0, 0, 1.0]]).as_matrix()
    points = [[0, 0, 0], [1, 0, 0], [2, 0, 0]]
    assert ToolPath.polyline(points, turn).stops_m == pytest.approx([1.0])
    rounded = ToolPath.polyline(points, turn, blend_m=0.05)
    assert len(rounded.stops_m) == 0 and rounded.deviations_m.max() < 1e-12
    assert 0.0 < rounded.deviations_rad[1] < 0.1


def test_turning_back_is_a_stop_even_where_corners_are_rounded() -> None:
    path = ToolPath.polyline([[0, 0, 0], [1, 0, 0], [0, 0, 0]], blend_m=0.1)
    assert path.stops_m == pytest.approx([1.0]) and path.length_m == pytest.approx(2.0)


def test_orientations_on_a_line_go_by_slerp() -> None:
    path = ToolPath.polyline([[0, 0, 0], [2, 0, 0]], Rotation.from_rotvec([[0, 0, 0], [0, 1.0, 0]]).as_matrix())
    T, tangent = path.at([0.5, 1.0])
    assert Rotation.from_matrix(T[:, :3, :3]).as_rotvec() == pytest.approx(np.array([[0, 0.25, 0], [0, 0.5, 0]]))
    assert tangent[:, 3:] == pytest.approx(np.array([[0, 0.5, 0], [0, 0.5, 0]]))


def test_a_circle_keeps_its_curvature() -> None:
    angle = np.linspace(0.0, math.pi, 25)
    points = 2.0 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    path = ToolPath.spline(points)
    assert path.length_m == pytest.approx(2.0 * math.pi, rel=1e-4)
    assert path.curvature(np.linspace(1.0, path.length_m - 1.0, 9)) == pytest.approx(0.5, rel=0.02)


LINE = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]


@pytest.mark.parametrize("make", [ToolPath.polyline, ToolPath.spline])
@pytest.mark.parametrize(
    ("points", "orientations", "says"),
    [
        ([[0, 0, 0]], None, "not a path"),
        ([], None, "not a path"),
        ([[0, 0], [1, 1]], None, "not a path"),
        ([[0, 0, 0], [1, 0]], None, "not numbers"),
        ([[0, 0, 0], [0, 0, 0]], None, "repeats"),
        ([[0, 0, 0], [1, 0, 0], [1, 0, 0], [2, 0, 0]], None, "point 2.*repeats"),
        ([[0, 0, 0], [math.nan, 0, 0]], None, "point 1.*not finite"),
        ([[0, 0, 0], [math.inf, 0, 0]], None, "point 1.*not finite"),
        (LINE, np.tile(2.0 * np.eye(3), (2, 1, 1)), "not a rotation"),
        (LINE, np.diag([1.0, 1.0, -1.0]), "not a rotation"),
        (LINE, np.full((3, 3), math.nan), "not finite"),
        (LINE, np.tile(np.eye(3), (3, 1, 1)), "not one per point"),
        (LINE, np.array([np.eye(3), np.diag([1.0, -1.0, -1.0])]), "half a turn"),
    ],
)
def test_what_is_no_path_is_refused(make, points, orientations, says) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match=says):
        make(points, orientations)


def test_other_bad_input_is_refused() -> None:
    with pytest.raises(InputError, match="turns back"):
        ToolPath.spline([[0, 0, 0], [1, 0, 0], [0.3, 0, 0]])
    for blend in (-0.1, math.nan, math.inf):
        with pytest.raises(InputError, match="blend_m"):
            ToolPath.polyline(LINE, blend_m=blend)
    with pytest.raises(InputError, match="orientations"):
        ToolPath.polyline(LINE, orientation=Orientation.FULL)
    for wrong in (1.1, -0.1, math.nan):
        with pytest.raises(InputError, match=r"0 to 1\.000 m"):
            ToolPath.polyline(LINE).at([0.5, wrong])
