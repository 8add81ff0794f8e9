"""The start-of-shift check: what it compares, when it refuses, whose it is, what interruptions leave of its log."""

import json
import math
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from workgauge.machine.load import load_machine, machine_from
from workgauge.machine.model import MachineModel
from workgauge.machine.positioning import Thresholds
from workgauge.positioning.check import (
    BelievedTool,
    CheckResult,
    check_against,
    fingerprint,
    not_valid,
    shifted,
    tool_in_site,
    withheld,
)
from workgauge.positioning.check_log import last_check, line_of, read_line, record_of
from workgauge.values.arrays import Floats, frozen
from workgauge.values.health import HealthState, PositionHealth
from workgauge.values.reasons import Reason, ReasonCode

HOUR_NS = 3_600_000_000_000
NOW_NS = 1_800_000_000 * 1_000_000_000
RRE20 = yaml.safe_load((resources.files("workgauge") / "shipped" / "machines" / "rre20.yaml").read_text())
LIMITS = Thresholds()


@pytest.fixture(scope="module")
def machine() -> MachineModel:
    return load_machine("rre20")


def pose(heading_deg: float, lean: tuple[float, float] = (0.02, -0.01)) -> Floats:
    T = np.eye(4)
    turn = Rotation.from_euler("ZYX", [90.0 - heading_deg, *np.degrees(lean)], degrees=True)
    T[:3, :3], T[:3, 3] = turn.as_matrix(), (12.0, -7.0, 3.0)
    return frozen(T)


def believed(position: tuple[float, float, float], sigma: float = 0.012, heading_deg: float = 30.0) -> BelievedTool:
    return BelievedTool(frozen(position), frozen(sigma**2 * np.eye(3)), math.radians(heading_deg))


def checked(machine: MachineModel, off: tuple[float, float, float] = (0.01, 0.0, 0.0), **more: object) -> CheckResult:
    tool = believed((100.0 + off[0], 200.0 + off[1], 5.0 + off[2]))
    point = np.array([100.0, 200.0, 5.0])
    return check_against(point, tool, machine, LIMITS, utc_ns=NOW_NS, **more)  # type: ignore[arg-type]


def test_the_tool_and_its_covariance_are_those_of_many_drawn_machines(machine: MachineModel) -> None:
    """Draw poses, joints and tools with their covariances, correlated; compare with first order."""
    rng = np.random.default_rng(2)
    n = machine.n
    A = rng.normal(size=(6 + n, 6 + n)) * np.array([0.02] * 3 + [0.003] * (3 + n))[:, None]
    S = A @ A.T
    T, kin = pose(220.0), machine.forward(machine.home)
    tool = tool_in_site(machine, kin, T, S[:6, :6], S[6:, 6:], S[:6, 6:])
    exact = T @ np.append(machine.tool_pose(kin)[:3, 3], 1.0)
    assert tool.position == pytest.approx(exact[:3])
    assert math.degrees(tool.heading) == pytest.approx(220.0)
    places = []
    for draw in rng.multivariate_normal(np.zeros(6 + n), S, size=4000):
        R = Rotation.from_rotvec(draw[3:6]).as_matrix() @ T[:3, :3]
        tip = machine.tool_pose(machine.forward(machine.home + draw[6:]))[:3, 3]
        places.append(R @ tip + T[:3, 3] + draw[:3] + machine.tool_tolerance_m * rng.standard_normal(3))
    assert np.cov(np.array(places).T) == pytest.approx(tool.covariance, abs=0.06 * np.abs(tool.covariance).max())


@given(st.floats(0, 360), st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1))
def test_along_left_and_up_are_the_machines(
    machine: MachineModel, heading_deg: float, along: float, left: float, up: float
) -> None:
    s, c = math.sin(math.radians(heading_deg)), math.cos(math.radians(heading_deg))
    difference = np.array([s * along - c * left, c * along + s * left, up])
    tool = believed(tuple(np.array([5.0, 6.0, 7.0]) + difference), heading_deg=heading_deg)
    result = check_against(np.array([5.0, 6.0, 7.0]), tool, machine, LIMITS, utc_ns=0)
    assert (result.along, result.left, result.up) == pytest.approx((along, left, up), abs=1e-9)
    assert result.distance == pytest.approx(math.sqrt(along**2 + left**2 + up**2))


def test_a_good_check_passes_and_arms(machine: MachineModel) -> None:
    result = checked(machine)
    assert result.passed and result.why == ()
    assert not_valid(result, machine, NOW_NS + HOUR_NS, LIMITS) is None


def test_beyond_the_tolerance_it_fails_and_says_by_how_much(machine: MachineModel) -> None:
    result = checked(machine, (0.04, 0.0, 0.04))
    assert not result.passed and result.why[0] == "tool is 57 mm from the point (tolerance 50 mm)"
    assert "check failed: tool is 57 mm" in str(not_valid(result, machine, NOW_NS, LIMITS))


def test_an_unsure_position_is_no_check(machine: MachineModel) -> None:
    tool = believed((100.0, 200.0, 5.0), 0.3)
    result = check_against(np.array([100.0, 200.0, 5.0]), tool, machine, LIMITS, utc_ns=0)
    assert result.why == ("position is sure to 300 mm only (1 sigma, limit 100 mm): wait for a better fix",)


def test_a_position_that_contradicts_its_own_word_fails_within_the_tolerance(machine: MachineModel) -> None:
    point = np.array([100.0, 200.0, 5.0])
    tool = believed((100.045, 200.0, 5.0), 0.004)
    result = check_against(point, tool, machine, LIMITS, utc_ns=0)
    assert len(result.why) == 1 and "not as sure as it says" in result.why[0]
    assert check_against(point, tool, machine, LIMITS, utc_ns=0, point_sigma_m=0.01).passed


@pytest.mark.parametrize("state", HealthState)
def test_only_a_fix_is_checked(machine: MachineModel, state: HealthState) -> None:
    health = PositionHealth(state, 0, (Reason(ReasonCode.DEAD_RECKONING, "no good fix for 0.70 s"),))
    result = checked(machine, health=health)
    assert result.passed == (state in (HealthState.FIXED, HealthState.FLOAT))
    assert result.passed or "0.70 s" in result.why[0]


def test_numbers_that_are_none_do_not_pass(machine: MachineModel) -> None:
    for position in ((math.nan, 200.0, 5.0), (math.inf, 200.0, 5.0)):
        result = check_against(np.array([100.0, 200.0, 5.0]), believed(position), machine, LIMITS, utc_ns=0)
        assert not result.passed
        again = read_line(line_of(result))
        assert again is not None and not again.passed and not_valid(again, machine, 0, LIMITS)


@pytest.mark.parametrize(
    ("change", "hours", "words"),
    [
        ({"machine": "brokk5"}, 0.0, "is of brokk5 with grading bucket, this is rre20 with grading bucket"),
        ({"attachment": "sleeper grab"}, 0.0, "is of rre20 with sleeper grab"),
        ({"fingerprint": "0" * 16}, 0.0, "file has changed"),
        ({}, 14.01, "14.0 h old (limit 14 h)"),
        ({}, -0.02, "ahead of the clock"),
        ({"distance": 0.06}, 0.0, "60 mm off, which today's tolerance does not allow"),
        ({"distance": math.nan}, 0.0, "today's tolerance"),
        ({"passed": False}, 0.0, "no reason given"),
    ],
)
def test_a_check_that_is_not_ours_or_not_of_today_does_not_arm(
    machine: MachineModel, change: dict[str, object], hours: float, words: str
) -> None:
    result = replace(checked(machine), **change)  # type: ignore[arg-type]
    assert words in str(not_valid(result, machine, NOW_NS + round(hours * HOUR_NS), LIMITS))


def test_no_check_does_not_arm(machine: MachineModel) -> None:
    assert not_valid(None, machine, NOW_NS, LIMITS) == "no start-of-shift check of rre20"


def test_the_fingerprint_knows_what_a_check_tests() -> None:
    def changed(*place: object, value: object) -> str:
        content = json.loads(json.dumps(RRE20))
        node = content
        for part in place[:-1]:
            node = node[part]
        node[place[-1]] = value
        return fingerprint(machine_from(content, "rre20"))

    same = fingerprint(machine_from(RRE20, "rre20"))
    assert same == fingerprint(load_machine("rre20"))
    assert changed("positioning", "thresholds", value={"check_hours": 8}) == same
    assert changed("solids", 1, "size_m", value=[2.6, 2.2, 2.5]) == same
    others = {
        changed("attachments", 0, "tool", "position_m", value=[0, 0, 1.401]),
        changed("sensors", 0, "position_m", value=[-1.2, 1.55, -1.101]),
        changed("joints", 1, "dh", "a_m", value=5.201),
        changed("positioning", "joints", 1, "offset_deg", value=0.1),
        changed("positioning", "tilt", "latency_s", value=0.02),
        fingerprint(load_machine("rre20", "sleeper grab")),
    }
    assert len(others) == 6 and same not in others


def test_a_shift_to_absolute_coordinates_changes_nothing_else(machine: MachineModel) -> None:
    result = checked(machine)
    moved = shifted(result, np.array([25_000_000.0, 6_700_000.0, 10.0]))
    assert moved.point == (25_000_100.0, 6_700_200.0, 15.0)
    assert replace(moved, point=result.point, tool=result.tool) == result


def test_a_missing_check_stops_whatever_the_position_is_worth() -> None:
    fixed = PositionHealth(HealthState.FIXED, 7)
    health = withheld(fixed, "none", 9)
    assert (health.state, health.since_ns) == (HealthState.STOP, 9)
    assert health.reasons[0].code is ReasonCode.NOT_CHECKED and health.reasons[0].text.endswith("none")
    lost = PositionHealth(HealthState.STOP, 7, (Reason(ReasonCode.POSITION_LOST, "gone"),))
    assert withheld(lost, "none", 9).since_ns == 7 and withheld(lost, "none", 9).reasons[1:] == lost.reasons
    assert withheld(None, "none", 9).state is HealthState.STOP


# ---------------------------------------------------------------------------- the log

reals = st.floats(allow_nan=False, allow_infinity=False, width=64)
results = st.builds(
    CheckResult,
    utc_ns=st.integers(0, 4 * 10**18),
    machine=st.text(max_size=8),
    attachment=st.text(max_size=8),
    fingerprint=st.text(max_size=8),
    point_name=st.text(max_size=8),
    point=st.tuples(reals, reals, reals),
    tool=st.tuples(reals, reals, reals),
    along=reals,
    left=reals,
    up=reals,
    distance=reals,
    sigma=reals,
    sigmas=reals,
    tolerance=reals,
    passed=st.booleans(),
    why=st.tuples(st.text(max_size=8)) | st.just(()),
)


@given(results)
def test_what_was_written_is_read_back(result: CheckResult) -> None:
    line = line_of(result)
    assert "\n" not in line
    assert read_line(line) == result


def test_a_record_says_its_units(machine: MachineModel) -> None:
    record = record_of(checked(machine))
    assert record["utc"] == "2027-01-15T08:00:00Z" and record["kind"] == "workgauge check"
    assert record["point"] == {"e": 100.0, "n": 200.0, "h": 5.0}
    assert {"along_m", "left_m", "up_m", "distance_m", "sigma_m", "tolerance_m", "sigmas", "passed"} <= set(record)


@settings(max_examples=200)
@given(results, results, st.data())
def test_an_interrupted_line_costs_itself_alone(one: CheckResult, two: CheckResult, data: st.DataObject) -> None:
    one = replace(one, machine="m", attachment="a")
    torn = line_of(two)
    torn = torn[: data.draw(st.integers(1, len(torn) - 1))]
    found, unread = last_check([line_of(one), torn], "m", "a")
    assert found == one and unread == (1 if torn.strip() else 0)


@given(st.lists(st.tuples(st.sampled_from("mn"), st.sampled_from("ab"), st.booleans()), max_size=8))
def test_the_newest_of_this_machine_and_attachment_counts(
    machine: MachineModel, kinds: list[tuple[str, str, bool]]
) -> None:
    base = read_line(line_of(checked(machine)))
    assert base is not None
    logged = [
        replace(base, machine=whose, attachment=attachment, passed=passed, utc_ns=k)
        for k, (whose, attachment, passed) in enumerate(kinds)
    ]
    found, unread = last_check([line_of(one) for one in logged], "m", "a")
    own = [one for one in logged if (one.machine, one.attachment) == ("m", "a")]
    assert unread == 0
    assert found == (own[-1] if own else logged[-1] if logged else None)


@settings(max_examples=200)
@given(
    st.one_of(
        st.text(max_size=40),
        st.recursive(st.none() | st.integers() | st.text(max_size=4), st.lists, max_leaves=6).map(json.dumps),
    )
)
def test_any_other_line_is_no_check(text: str) -> None:
    assert read_line(text) is None


@pytest.mark.parametrize(
    "change",
    [
        {"passed": "yes"},
        {"passed": 1},
        {"utc_ns": "now"},
        {"utc_ns": True},
        {"distance_m": "3"},
        {"distance_m": True},
        {"why": "because"},
        {"why": [1]},
        {"point": [1, 2, 3]},
        {"machine": None},
        {"version": 2},
        {"kind": "other"},
    ],
)
def test_a_line_of_other_types_is_no_check(machine: MachineModel, change: dict[str, object]) -> None:
    record = {**record_of(checked(machine)), **change}
    assert read_line(json.dumps(record)) is None
