"""Mäkinen 3.11 and 3.12, corrected and per limit."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from workgauge.guard.api import GuardInput
from workgauge.guard.linear import MAX_REASONS, RESTING_M_S, LinearGuard
from workgauge.machine.load import load_machine
from workgauge.proximity.scene import Scene
from workgauge.values.arrays import frozen, frozen_ints
from workgauge.values.clearances import Clearances
from workgauge.values.errors import InputError
from workgauge.values.reasons import ReasonCode

N = 3
GUARD = LinearGuard()
DT = 0.02


def situation(
    desired: Any, distances: Any, rows: Any, *, protections: Any = 0.0, stops: Any = math.nan, dt_s: float = DT
) -> GuardInput:
    k = len(distances)
    clearances = Clearances(
        distances=np.array(distances, dtype=float),
        normals=np.zeros((k, 3)),
        points_machine=np.zeros((k, 3)),
        points_limit=np.zeros((k, 3)),
        links=frozen_ints(np.arange(k) % 2),
        other_links=frozen_ints([-1] * k),
        limits=frozen_ints(np.arange(k) // 2),
        cells=frozen_ints([-1] * k),
        solids=frozen_ints(np.arange(k) % 2),
        protections=np.broadcast_to(np.asarray(protections, dtype=float), (k,)),
        stop_distances=np.broadcast_to(np.asarray(stops, dtype=float), (k,)),
        link_names=("boom", "stick"),
        limit_ids=tuple(f"limit-{i}" for i in range(k)),
        searched_m=10.0,
    )
    return GuardInput(
        desired=frozen(desired),
        q=frozen([0.0] * N),
        q_min=frozen([-np.inf] * N),
        q_max=frozen([np.inf] * N),
        speed_positive=frozen([1.0] * N),
        speed_negative=frozen([1.0] * N),
        clearances=clearances,
        rows=np.array(rows, dtype=float).reshape(k, N),
        dt_s=dt_s,
        joint_names=("swing", "boom", "stick"),
        exclusive_groups=(),
    )


def oracle(case: GuardInput, p_u: float = 0.8, p_l: float = 0.2) -> float:
    """The scale, told one clearance at a time in plain arithmetic."""
    scale = 1.0
    for i in range(len(case.clearances)):
        rate = sum(float(case.rows[i, j]) * float(case.desired[j]) for j in range(N))
        if rate >= -RESTING_M_S:
            continue
        own = float(case.clearances.stop_distances[i])
        shift = 0.0 if math.isnan(own) else own - p_l
        p = float(case.clearances.distances[i]) - float(case.clearances.protections[i])
        lower, upper = p_l + shift, p_u + shift
        s = min(max((p - lower) / (upper - lower), 0.0), 1.0)
        if -rate * case.dt_s > p - lower:
            s = min(s, max(p - lower, 0.0) / (-rate * case.dt_s))
        scale = min(scale, s)
    return scale


APPROACH, RETREAT, ALONG = [-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]


@pytest.mark.parametrize(
    ("distance", "scale"),
    [(5.0, 1.0), (0.8, 1.0), (0.65, 0.75), (0.5, 0.5), (0.35, 0.25), (0.2, 0.0), (0.1, 0.0), (-0.3, 0.0)],
)
def test_the_scale_falls_linearly_from_slow_to_stop_distance(distance: float, scale: float) -> None:
    result, _ = GUARD.allow(situation([0.5, 0.25, 0.0], [distance], APPROACH), GUARD.start())
    assert result.scale == pytest.approx(scale, abs=1e-12)
    assert result.allowed == pytest.approx(np.array([0.5, 0.25, 0.0]) * scale, abs=1e-12)


@pytest.mark.parametrize("distance", [5.0, 0.8, 0.5, 0.2, 0.1, -0.3])
@pytest.mark.parametrize("row", [RETREAT, ALONG, [0.0, 0.0, 0.0]])
def test_leading_away_or_along_is_not_slowed(distance: float, row: list[float]) -> None:
    result, _ = GUARD.allow(situation([0.5, 0.0, 0.0], [distance], row), GUARD.start())
    assert result.allowed.tolist() == [0.5, 0.0, 0.0] and result.reasons == () and result.scale == 1.0


def test_a_corridor_does_not_let_the_far_wall_be_rammed() -> None:
    """Leaving one wall of a narrow corridor is an approach to the other: judged per limit, not on the smallest."""
    leaving_near = situation([0.5, 0.0, 0.0], [0.1, 0.35], [RETREAT, APPROACH])
    result, _ = GUARD.allow(leaving_near, GUARD.start())
    assert result.scale == pytest.approx(0.25)
    assert [reason.link for reason in result.reasons] == ["stick"]


def test_a_limits_own_stop_distance_moves_both_ends() -> None:
    far = situation([0.5, 0.0, 0.0], [3.3], APPROACH, stops=3.0)
    assert GUARD.allow(far, GUARD.start())[0].scale == pytest.approx(0.5)
    touching = situation([0.5, 0.0, 0.0], [0.3], APPROACH, stops=0.0)
    assert GUARD.allow(touching, GUARD.start())[0].scale == pytest.approx(0.5)


def test_the_protection_level_counts_as_gone() -> None:
    case = situation([0.5, 0.0, 0.0], [0.7], APPROACH, protections=0.2)
    result, _ = GUARD.allow(case, GUARD.start())
    assert result.scale == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("distance", "own", "code", "said"),
    [
        (0.7, math.nan, ReasonCode.LIMIT_NEAR, "0.70 m from limit-0{}, slowed to 50 %"),
        (0.4, math.nan, ReasonCode.LIMIT_REACHED, "0.40 m from limit-0{}, no nearer"),
        (0.9, 0.7, ReasonCode.LIMIT_REACHED, "0.90 m from limit-0{}, no nearer"),
        (0.1, math.nan, ReasonCode.LIMIT_REACHED, "0.10 m from limit-0{}, no nearer"),
        (-0.1, math.nan, ReasonCode.INSIDE_LIMIT, "0.10 m inside limit-0, only the way out is free"),
    ],
)
def test_the_reason_tells_clearance_protection_and_stop_distance(
    distance: float, own: float, code: ReasonCode, said: str
) -> None:
    case = situation([0.5, 0.0, 0.0], [distance], APPROACH, protections=0.2, stops=own)
    (reason,) = GUARD.allow(case, GUARD.start())[0].reasons
    stop = 0.2 if math.isnan(own) else own
    doubt = f" (0.20 m of it unsure, stops at {stop:.2f} m)"
    assert (reason.code, reason.text) == (code, f"boom is {said.format(doubt)}")
    assert (reason.clearance_m, reason.protection_m) == (distance, 0.2)
    assert reason.stop_distance_m == stop


@pytest.mark.parametrize("distance", [0.5, 0.1, -0.1])
def test_backing_away_stays_free_however_little_is_sure(distance: float) -> None:
    case = situation([0.5, 0.0, 0.0], [distance], RETREAT, protections=3.0)
    result, _ = GUARD.allow(case, GUARD.start())
    assert result.allowed.tolist() == [0.5, 0.0, 0.0] and result.reasons == ()


def test_a_coarse_tick_at_high_speed_does_not_jump_over_the_stop_distance() -> None:
    case = situation([1.0, 0.0, 0.0], [0.9], [[-9.0, 0.0, 0.0]], dt_s=0.2)
    result, _ = GUARD.allow(case, GUARD.start())
    assert 0.9 - 9.0 * result.allowed[0] * 0.2 == pytest.approx(0.2)


def test_the_stop_distance_is_approached_and_never_passed() -> None:
    distance, before = 2.0, math.inf
    for _ in range(3000):
        case = situation([1.0, 0.0, 0.0], [distance], APPROACH)
        distance -= float(GUARD.allow(case, GUARD.start())[0].allowed[0]) * DT
        assert 0.2 <= distance < before or distance == pytest.approx(0.2, abs=1e-12)
        before = distance
    assert distance == pytest.approx(0.2, abs=1e-6)


@pytest.mark.parametrize(
    ("distance", "code", "said"),
    [
        (0.5, ReasonCode.LIMIT_NEAR, "boom is 0.50 m from limit-0, slowed to 50 %"),
        (0.2, ReasonCode.LIMIT_REACHED, "boom is 0.20 m from limit-0, no nearer"),
        (-0.25, ReasonCode.INSIDE_LIMIT, "boom is 0.25 m inside limit-0, only the way out is free"),
    ],
)
def test_the_reason_names_limit_link_metres_and_scale(distance: float, code: ReasonCode, said: str) -> None:
    result, _ = GUARD.allow(situation([0.5, 0.0, 0.0], [distance], APPROACH), GUARD.start())
    (reason,) = result.reasons
    assert (reason.code, reason.text, reason.link, reason.limit) == (code, said, "boom", "limit-0")
    assert reason.clearance_m == distance and reason.scale == pytest.approx(result.scale)


def test_reasons_come_gravest_first_once_per_link_and_limit_and_not_too_many() -> None:
    distances = [0.7, 0.6, 0.5, 0.4]
    result, _ = GUARD.allow(situation([0.5, 0.0, 0.0], distances, [APPROACH] * 4), GUARD.start())
    assert [reason.clearance_m for reason in result.reasons] == [0.4, 0.5, 0.6, 0.7]
    same = situation([0.5, 0.0, 0.0], [0.6, 0.7, 0.5], [APPROACH] * 3)
    merged = Clearances(
        **{
            **{name: getattr(same.clearances, name) for name in Clearances.__slots__},
            "links": frozen_ints([0, 0, 0]),
            "limits": frozen_ints([0, 0, 1]),
        }
    )
    values = {name: getattr(same, name) for name in GuardInput.__slots__}
    result, _ = GUARD.allow(GuardInput(**{**values, "clearances": merged}), GUARD.start())
    assert [(reason.limit, reason.clearance_m) for reason in result.reasons] == [("limit-1", 0.5), ("limit-0", 0.6)]
    many = situation([0.5, 0.0, 0.0], [0.5] * 40, [APPROACH] * 40)
    assert len(GUARD.allow(many, GUARD.start())[0].reasons) == MAX_REASONS


@st.composite
def cases(draw: st.DrawFn) -> GuardInput:
    k = draw(st.integers(0, 6))
    return situation(
        draw(arrays(float, N, elements=st.floats(-1, 1))),
        draw(arrays(float, k, elements=st.floats(-1, 3))),
        draw(arrays(float, (k, N), elements=st.floats(-9, 9))),
        protections=draw(arrays(float, k, elements=st.floats(0, 0.5))),
        stops=draw(arrays(float, k, elements=st.sampled_from([np.nan, 0.0, 0.3, 1.5]))),
        dt_s=draw(st.sampled_from([0.005, 0.02, 0.2])),
    )


@settings(max_examples=400, deadline=None)
@given(cases())
def test_it_agrees_with_the_equation_told_slowly(case: GuardInput) -> None:
    result, _ = GUARD.allow(case, GUARD.start())
    rates = case.rows @ case.desired
    if np.any(np.abs(rates + RESTING_M_S) < 1e-12):
        return  # on the edge of standing still either answer is right
    assert result.scale == pytest.approx(oracle(case), abs=1e-12)
    assert result.allowed == pytest.approx(case.desired * result.scale, abs=1e-15)


@settings(max_examples=300, deadline=None)
@given(cases())
def test_no_joint_goes_faster_than_asked(case: GuardInput) -> None:
    result, _ = GUARD.allow(case, GUARD.start())
    assert (np.abs(result.allowed) <= np.abs(case.desired)).all()
    assert (result.allowed * case.desired >= 0.0).all()


@settings(max_examples=300, deadline=None)
@given(cases())
def test_a_motion_that_shrinks_no_clearance_is_never_slowed(case: GuardInput) -> None:
    rows = np.where((case.rows @ case.desired < 0.0)[:, None], -case.rows, case.rows)
    clearances = case.clearances
    away = situation(
        case.desired,
        clearances.distances,
        rows,
        protections=clearances.protections,
        stops=clearances.stop_distances,
    )
    result, _ = GUARD.allow(away, GUARD.start())
    assert result.allowed.tobytes() == case.desired.tobytes()


@settings(max_examples=200, deadline=None)
@given(cases(), st.floats(0.0, 1.0))
def test_more_room_never_means_less_speed(case: GuardInput, more: float) -> None:
    clearances = case.clearances
    wider = situation(
        case.desired,
        clearances.distances + more,
        case.rows,
        protections=clearances.protections,
        stops=clearances.stop_distances,
        dt_s=case.dt_s,
    )
    assert GUARD.allow(wider, GUARD.start())[0].scale >= GUARD.allow(case, GUARD.start())[0].scale - 1e-12


@pytest.mark.parametrize(
    "settings_",
    [
        {"slow_distance_m": 0.2},
        {"stop_distance_m": -0.1},
        {"slow_distance_m": math.nan},
        {"slow_distance_m": math.inf},
        {"cushion_s": 0.0},
        {"cushion_s": math.nan},
    ],
)
def test_settings_that_make_no_sense_are_refused(settings_: dict[str, float]) -> None:
    with pytest.raises(InputError):
        LinearGuard(**settings_)


@settings(max_examples=200, deadline=None)
@given(st.floats(0.0, 1.0), st.floats(0.0, 1.2), st.booleans())
def test_links_of_a_small_machine_are_slowed_nearer_in_proportion(stop: float, distance: float, links: bool) -> None:
    case = situation([0.0, 0.3, 0.0], [distance], [[0.0, -0.1, 0.0]], stops=stop)
    if links:
        case = replace(case, clearances=replace(case.clearances, other_links=frozen_ints([0])))
    scale = GUARD.allow(case, GUARD.start())[0].scale
    width = 0.6 * max(stop, 0.001) / 0.2 if links and stop < 0.2 else 0.6
    free = min((distance - stop) / width, max(distance - stop, 0.0) / (0.03 * DT))
    assert scale == pytest.approx(min(max(free, 0.0), 1.0), abs=1e-12)


def test_a_small_machine_moves_where_the_distances_of_limits_would_hold_it() -> None:
    small, motion = load_machine("sun-a"), []
    for machine in (small, replace(small, self_stop_distance_m=None)):
        scene, q, memory = Scene(machine, []), np.array(machine.home), GUARD.start()
        rng, desired, moved = np.random.default_rng(0), np.zeros(machine.n), 0.0
        for k in range(300):
            if k % 75 == 0:
                desired = frozen(rng.uniform(-1.0, 1.0, machine.n) * machine.speed_positive)
            kin = machine.forward(q)
            found = scene.query(kin, np.eye(4), 5.0)
            assert found.distances.min() > 0.05 - 1e-9
            case = replace(
                situation([0.0] * N, [5.0], [[0.0] * N]),
                desired=desired,
                q=q,
                q_min=machine.q_min,
                q_max=machine.q_max,
                speed_positive=machine.speed_positive,
                speed_negative=machine.speed_negative,
                clearances=found,
                rows=machine.distance_rows(kin, np.eye(4), found),
                joint_names=machine.joint_names,
            )
            result, memory = GUARD.allow(case, memory)
            q = np.clip(q + result.allowed * DT, machine.q_min, machine.q_max)
            moved += float(np.abs(result.allowed).sum())
        motion.append(moved)
    assert motion[0] > 1.4 * motion[1] > 0.0
