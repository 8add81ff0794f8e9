"""The health of a position: never better than its evidence, upwards only on agreeing evidence, bounded exactly."""

import itertools
import json
import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.machine.positioning import Thresholds
from workgauge.positioning.evidence import HealthMemory, HealthSeen, remembered
from workgauge.positioning.health import judge
from workgauge.positioning.refusals import BELIEVED
from workgauge.values.errors import InputError
from workgauge.values.health import HealthState, PositionHealth
from workgauge.values.navigation import FixQuality
from workgauge.values.reasons import ReasonCode

MS = 1_000_000
LIMITS = Thresholds()
RANK = {state: rank for rank, state in enumerate(HealthState)}
NAN = math.nan

#: A fix as good as it gets, on a machine that stands.
GOOD = HealthSeen(
    0,
    fix_age_s=0.05,
    quality=FixQuality.FIXED,
    sigma_m=0.02,
    correction_age_s=1.0,
    innovation=0.7,
    baseline_error_m=0.004,
    heading_difference=0.002,
    moving_wheels=False,
    speed_m_s=0.01,
    new_age_s=0.02,
)


class Judged:
    """A judge with its memory, a clock of 10 ms, fixes at 10 Hz, and the age of the last accepted one."""

    def __init__(self, limits: Thresholds = LIMITS) -> None:
        self.limits, self.memory = limits, HealthMemory()
        self.tick, self.epoch_ns = 0, None
        self.health: PositionHealth | None = None

    def step(self, *, fix: bool | None = None, **seen: object) -> PositionHealth:
        now = self.tick * 10 * MS
        arrives = self.tick % 10 == 0 if fix is None else fix
        age = math.inf if self.epoch_ns is None else (now - self.epoch_ns) * 1e-9
        one = replace(GOOD, now_ns=now, fix_age_s=age, **seen)
        if not arrives:
            one = replace(one, innovation=NAN, new_age_s=NAN)
        self.health, accepted, self.memory = judge(one, self.memory, self.limits)
        if accepted:
            self.epoch_ns = now - round(one.new_age_s * 1e9)
        self.tick += 1
        return self.health

    def run(self, ticks: int, **seen: object) -> list[PositionHealth]:
        return [self.step(**seen) for _ in range(ticks)]

    def until(self, state: HealthState, most: int = 7000, **seen: object) -> int:
        """Return the ticks it takes until a state is entered."""
        for ticks in range(1, most + 1):
            if self.step(**seen).state is state:
                return ticks
        raise AssertionError(f"never {state}")

    def codes(self) -> set[ReasonCode]:
        return {reason.code for reason in self.health.reasons}


def working() -> Judged:
    judged = Judged()
    judged.run(200)
    assert judged.health.state is HealthState.FIXED
    return judged


def test_starts_stopped_and_works_after_ten_fixes_that_agree() -> None:
    judged = Judged()
    assert judged.until(HealthState.FIXED) == 91  # the tenth of ten fixes 100 ms apart
    assert judged.health.reasons == ()
    assert judged.health.since_ns == 900 * MS


def test_nothing_seen_is_a_stop_with_a_reason() -> None:
    health, accepted, _ = judge(HealthSeen(5), HealthMemory(), LIMITS)
    assert health.state is HealthState.STOP and not accepted
    assert ReasonCode.POSITION_LOST in {reason.code for reason in health.reasons}


def test_silence_is_bounded_to_the_nanosecond() -> None:
    """Fixes cease: each state holds up to its bound and not a nanosecond longer."""
    base = working()
    epoch = base.epoch_ns

    def after(age_ns: int, memory: HealthMemory) -> tuple[HealthState, HealthMemory]:
        seen = replace(GOOD, now_ns=epoch + age_ns, fix_age_s=age_ns * 1e-9, innovation=NAN, new_age_s=NAN)
        health, _, memory = judge(seen, memory, LIMITS)
        return health.state, memory

    bounds = [(500 * MS, HealthState.FIXED, HealthState.DEAD_RECKONING)]
    bounds += [(2000 * MS, HealthState.DEAD_RECKONING, HealthState.CHASSIS_FROZEN)]
    bounds += [(60_000 * MS, HealthState.CHASSIS_FROZEN, HealthState.STOP)]
    memory = base.memory
    for bound, before, beyond in bounds:
        state, memory = after(bound, memory)
        assert state is before
        state, memory = after(bound + 1, memory)
        assert state is beyond


@pytest.mark.parametrize(
    "moving", [{"moving_wheels": True}, {"moving_wheels": None, "speed_m_s": NAN}, {"speed_m_s": 0.06}]
)
def test_without_a_fix_the_undercarriage_must_be_known_to_stand(moving: dict[str, object]) -> None:
    judged = working()
    judged.until(HealthState.DEAD_RECKONING, fix=False, **moving)
    judged.until(HealthState.STOP, 160, fix=False, **moving)
    assert judged.codes() == {ReasonCode.POSITION_LOST}
    # standing again is no evidence of where
    assert all(one.state is HealthState.STOP for one in judged.run(50, fix=False))


def test_wheels_that_turn_while_the_chassis_is_held_still_stop_at_once() -> None:
    judged = working()
    judged.until(HealthState.CHASSIS_FROZEN, fix=False)
    assert judged.step(fix=False, moving_wheels=True).state is HealthState.STOP
    assert judged.until(HealthState.FIXED) <= 110


def test_a_short_outage_returns_to_float_at_once_and_to_fixed_after_ten() -> None:
    judged = working()
    judged.until(HealthState.DEAD_RECKONING, fix=False)
    assert judged.step(fix=True).state is HealthState.FLOAT
    assert "1 fixed in a row agree (needed 10)" in judged.health.reasons[0].text
    assert judged.until(HealthState.FIXED, fix=True) == 9


def test_float_fixes_work_with_their_own_uncertainty() -> None:
    judged = working()
    assert judged.step(fix=True, quality=FixQuality.FLOAT, sigma_m=0.3).state is HealthState.FLOAT
    assert judged.codes() == {ReasonCode.POSITION_DEGRADED}
    assert "RTK float" in judged.health.reasons[0].text and "0.30 m" in judged.health.reasons[0].text
    judged.run(300, quality=FixQuality.FLOAT, sigma_m=0.3)
    assert judged.health.state is HealthState.FLOAT
    assert judged.until(HealthState.FIXED, fix=True) == 10


def test_a_fix_of_no_use_stops() -> None:
    judged = working()
    assert judged.step(quality=FixQuality.SINGLE, sigma_m=3.0).state is HealthState.STOP
    assert "3.00 m" in judged.health.reasons[0].text and "0.5 m" in judged.health.reasons[0].text
    assert judged.step(sigma_m=NAN).state is HealthState.STOP


@pytest.mark.parametrize("quality", sorted(set(FixQuality) - BELIEVED))
def test_what_is_no_satellite_fix_is_not_believed(quality: FixQuality) -> None:
    judged = working()
    assert judged.step(fix=True, quality=quality).state is HealthState.DEAD_RECKONING
    assert judged.codes() == {ReasonCode.POSITION_DEGRADED, ReasonCode.DEAD_RECKONING}


def test_an_old_correction_is_a_worse_fix() -> None:
    judged = working()
    assert judged.step(correction_age_s=20.0).state is HealthState.FIXED
    assert judged.step(correction_age_s=21.0).state is HealthState.FLOAT
    assert judged.codes() == {ReasonCode.CORRECTION_OLD}
    assert judged.health.reasons[0].text == "correction is 21 s old (limit 20 s)"


def test_one_outlier_is_refused_and_forgotten_after_ten() -> None:
    judged = working()
    epoch = judged.epoch_ns
    assert judged.step(fix=True, innovation=5.1).state is HealthState.DEAD_RECKONING
    assert judged.epoch_ns == epoch
    assert judged.codes() == {ReasonCode.POSITION_JUMP, ReasonCode.DEAD_RECKONING}
    assert "5.1 sigma (limit 5)" in judged.health.reasons[0].text
    assert judged.step(fix=False).state is HealthState.DEAD_RECKONING
    assert judged.step(fix=True).state is HealthState.FLOAT
    assert judged.until(HealthState.FIXED, fix=True) == 9


@pytest.mark.parametrize("moving", [False, True])
def test_a_jump_that_lasts_stops_and_is_taken_once_the_old_places_time_is_over(moving: bool) -> None:
    judged = working()
    epoch = judged.epoch_ns
    at_new = {"innovation": 40.0, "agreement": 0.5, "moving_wheels": moving}
    judged.step(fix=True, **{**at_new, "agreement": NAN})
    states = [judged.step(fix=True, **at_new).state for _ in range(8)]
    assert set(states) == {HealthState.DEAD_RECKONING}
    assert judged.step(fix=True, **at_new).state is HealthState.STOP
    assert ReasonCode.POSITION_JUMP in judged.codes() and "one of the two is wrong" in judged.health.reasons[0].text
    assert judged.epoch_ns == epoch
    while judged.epoch_ns == epoch:
        assert judged.step(fix=True, **at_new).state is HealthState.STOP or judged.epoch_ns != epoch
    bound_ns = (2_000 if moving else 60_000) * MS
    assert 0 < (judged.tick - 1) * 10 * MS - epoch - bound_ns <= 10 * MS
    assert judged.health.state.usable  # ten had agreed already, and the machine was stopped all the time


def test_a_jump_that_passes_is_never_worked_on() -> None:
    judged = working()
    epoch = judged.epoch_ns
    judged.step(fix=True, innovation=40.0)
    for k in range(200):  # the pose carried on grows unsure, the jump fits it better and better
        judged.step(fix=True, innovation=40.0 / (1 + k), agreement=0.1)
        assert judged.epoch_ns == epoch
    assert judged.health.state is HealthState.STOP
    judged.step(fix=True, innovation=0.4, agreement=4.0)
    assert judged.epoch_ns != epoch
    assert judged.until(HealthState.FIXED, fix=True) == 9


def test_jumps_that_do_not_agree_with_each_other_are_never_taken() -> None:
    judged = working()
    for k in range(40):
        agreement = NAN if k == 0 else (0.5 if k % 5 else 9.0)
        judged.step(fix=True, innovation=40.0, agreement=agreement)
        assert judged.health.state is HealthState.DEAD_RECKONING
    assert judged.until(HealthState.STOP, innovation=40.0, agreement=9.0, moving_wheels=True) < 200


def test_after_a_long_outage_ten_fixes_that_agree_with_each_other_are_enough() -> None:
    judged = working()
    judged.until(HealthState.STOP, fix=False)
    judged.step(fix=True, innovation=99.0)
    states = [judged.step(fix=True, innovation=99.0, agreement=1.0).state for _ in range(9)]
    assert set(states[:-1]) == {HealthState.STOP} and states[-1].usable


def test_a_receiver_that_hangs_counts_as_silent_from_its_first_repeat() -> None:
    judged = working()
    states = {}
    for k in range(1, 6200):
        health = judged.step(same_for_s=k * 0.01)
        states.setdefault(health.state, k)
        if health.state is not HealthState.FIXED:
            assert ReasonCode.RECEIVER_FROZEN in judged.codes()
    assert states == {
        HealthState.FIXED: 1,
        HealthState.DEAD_RECKONING: 100,
        HealthState.CHASSIS_FROZEN: 201,
        HealthState.STOP: 6001,
    }
    assert judged.until(HealthState.FIXED) <= 101


def test_a_receiver_that_ignores_that_the_wheels_turn_is_found_sooner() -> None:
    judged = working()
    found = [judged.step(same_for_s=k * 0.01, moving_wheels=True).state for k in range(1, 60)]
    assert found.index(HealthState.DEAD_RECKONING) == 49


def test_a_wrong_baseline_stays_wrong_until_one_agrees() -> None:
    judged = working()
    unseen = {"baseline_error_m": NAN}
    assert judged.step(baseline_error_m=-0.051).state is HealthState.DEAD_RECKONING
    assert judged.codes() == {ReasonCode.HEADING_DISAGREES, ReasonCode.DEAD_RECKONING}
    assert judged.health.reasons[0].text == "antennas are -51 mm from their known distance (limit 50 mm)"
    states = [judged.step(**unseen).state for _ in range(6100)]
    assert [state for state, _ in itertools.groupby(states)] == [
        HealthState.DEAD_RECKONING,
        HealthState.CHASSIS_FROZEN,
        HealthState.STOP,
    ]
    judged.step(baseline_error_m=0.049)
    assert judged.until(HealthState.FIXED, **unseen) <= 101


def test_a_heading_that_disagrees_stops_until_one_agrees() -> None:
    """Where antennas sit on the cab, the swing angle may be what is wrong, and the arm works on it."""
    judged = working()
    assert judged.step(heading_difference=math.radians(-3.1)).state is HealthState.STOP
    assert judged.codes() == {ReasonCode.HEADING_DISAGREES}
    assert judged.health.reasons[0].text.startswith("heading is -3.1° off the other heading (limit 3°)")
    assert {one.state for one in judged.run(500, heading_difference=NAN)} == {HealthState.STOP}
    judged.step(heading_difference=math.radians(2.9))
    assert judged.until(HealthState.FIXED, heading_difference=NAN) <= 101


def test_disagreement_within_honest_noise_is_none() -> None:
    judged = working()
    for noisy in (
        {"heading_difference": math.radians(20), "heading_sigma": math.radians(5)},
        {"baseline_error_m": 1.4, "baseline_sigma_m": 0.3},
    ):
        assert judged.step(**noisy).state is HealthState.FIXED
    assert judged.step(heading_difference=math.radians(20), heading_sigma=math.radians(3.9)).state.value != "fixed"


def test_exchanged_antennas_stop_until_a_heading_agrees() -> None:
    judged = working()
    assert judged.step(swapped=True, heading_difference=math.radians(179)).state is HealthState.STOP
    assert "179°" in judged.health.reasons[0].text and "cables" in judged.health.reasons[0].text
    # standing still shows nothing
    assert {one.state for one in judged.run(500, heading_difference=NAN)} == {HealthState.STOP}
    assert judged.until(HealthState.FIXED) <= 101


def test_exchanged_antennas_seen_by_their_heights_alone_stop_too() -> None:
    judged = working()
    assert judged.step(swapped=True, heading_difference=NAN).state is HealthState.STOP
    assert {one.state for one in judged.run(200, heading_difference=NAN)} == {HealthState.STOP}


@pytest.mark.parametrize(
    ("seen", "code", "words"),
    [
        ({"stale_sensors": ("boom imu",)}, ReasonCode.SENSOR_STALE, "boom imu is missing or too old (limit 0.1 s)"),
        ({"jumped_joints": ("stick",)}, ReasonCode.SENSOR_DISAGREES, "stick jumped between two readings (limit 5°)"),
        ({"checked": False}, ReasonCode.NOT_CHECKED, "(limits 50 mm, 14 h)"),
    ],
)
def test_what_stops_whatever_the_receivers_say(seen: dict[str, object], code: ReasonCode, words: str) -> None:
    judged = working()
    assert judged.step(**seen).state is HealthState.STOP
    assert judged.health.reasons[0].code is code and words in judged.health.reasons[0].text
    assert 90 < judged.until(HealthState.FIXED) <= 101


def test_a_clock_that_goes_back_stops() -> None:
    judged = working()
    judged.tick -= 5
    assert judged.step().state is HealthState.STOP
    assert ReasonCode.FROM_FUTURE in judged.codes()


@pytest.mark.parametrize("age_s", [0.6, -0.6])
def test_a_fix_of_another_time_is_not_accepted(age_s: float) -> None:
    judged = working()
    epoch = judged.epoch_ns
    assert judged.step(fix=True, new_age_s=age_s).state is HealthState.DEAD_RECKONING
    assert judged.epoch_ns == epoch and "0.60 s" in judged.health.reasons[0].text


def test_bounds_shorter_than_a_fix_are_kept_too() -> None:
    judged = Judged(Thresholds(dead_reckoning_s=0.0, chassis_frozen_s=0.0))
    judged.run(200)
    assert judged.health.state is HealthState.FIXED
    assert judged.until(HealthState.STOP, fix=False) == 40  # the last epoch is then 0.51 s old


def test_a_memory_that_is_none_is_refused() -> None:
    for plain in ({}, {"state": "rosy"}, {"state": "stop", "mood": 1}):
        with pytest.raises(InputError, match="health memory"):
            remembered(plain)


# ------------------------------------------------------------------ laws over anything at all

numbers = st.one_of(st.just(NAN), st.just(math.inf), st.floats(-10.0, 10.0), st.sampled_from([0.0, 0.05, 0.5, 5.0]))
seconds = st.one_of(st.just(NAN), st.just(math.inf), st.floats(0.0, 0.6), st.floats(0.0, 100.0))


def mostly(good: object, strategy: st.SearchStrategy[object]) -> st.SearchStrategy[object]:
    """Draw the good value often, so that good states are reached at all."""
    return st.integers(0, 7).flatmap(lambda k: strategy if k == 0 else st.just(good))


observed = st.fixed_dictionaries(
    {
        "quality": mostly(FixQuality.FIXED, st.sampled_from(FixQuality)),
        "sigma_m": mostly(0.02, numbers),
        "correction_age_s": mostly(1.0, seconds),
        "innovation": st.integers(0, 9).flatmap(
            lambda k: st.just(NAN) if k < 2 else st.floats(0, 12) if k < 4 else st.just(0.8)
        ),
        "agreement": st.one_of(st.just(NAN), st.just(0.5), st.floats(0, 12)),
        "baseline_error_m": mostly(0.0, numbers),
        "baseline_sigma_m": mostly(NAN, numbers),
        "heading_difference": mostly(0.0, numbers),
        "heading_sigma": mostly(NAN, numbers),
        "swapped": mostly(False, st.booleans()),
        "same_for_s": mostly(0.0, seconds),
        "moving_wheels": mostly(False, st.sampled_from([True, False, None])),
        "speed_m_s": mostly(0.0, numbers),
        "stale_sensors": mostly((), st.just(("boom imu",))),
        "jumped_joints": mostly((), st.just(("boom",))),
        "checked": mostly(True, st.sampled_from([True, False, None])),
        "new_age_s": mostly(0.02, st.floats(-1.0, 1.0)),
    }
)
steps = st.tuples(st.sampled_from([10, 10, 100, 100, 100, 400, 5000, 61_000]), observed)
limits_drawn = st.builds(
    Thresholds,
    innovation_in_a_row=st.integers(1, 3),
    dead_reckoning_s=st.sampled_from([0.0, 0.3, 2.0]),
    chassis_frozen_s=st.sampled_from([0.0, 1.0, 60.0]),
)


def told(now: int, epoch: int | None, fields: dict[str, object]) -> HealthSeen:
    age = math.inf if epoch is None else (now - epoch) * 1e-9
    return HealthSeen(now_ns=now, fix_age_s=age, **fields)  # type: ignore[arg-type]


@settings(max_examples=300, deadline=None)
@given(st.lists(steps, min_size=1, max_size=60), limits_drawn)
def test_never_better_than_its_evidence(drawn: list[tuple[int, dict[str, object]]], limits: Thresholds) -> None:
    memory, now, epoch = HealthMemory(), 0, None
    before, since_stop, quality = HealthState.STOP, 0, FixQuality.NONE
    for wait_ms, fields in drawn:
        now += wait_ms * MS
        seen = told(now, epoch, fields)
        health, accepted, memory = judge(seen, memory, limits)
        assert not accepted or seen.new
        if accepted:
            epoch = now - round(max(0.0, seen.new_age_s) * 1e9)
            quality = seen.quality
        _follows_from(health, seen, accepted, epoch, limits)
        if health.state is HealthState.FIXED:
            assert quality is FixQuality.FIXED
        # out of a stop only by a row of agreeing solutions
        good = accepted or (seen.new and seen.agreement <= limits.innovation_sigmas)
        since_stop = since_stop + 1 if good or seen.new else since_stop
        if before is HealthState.STOP and health.state.usable:
            assert accepted and since_stop >= limits.innovation_in_a_row
        if before is not HealthState.STOP:
            since_stop = 0
        if RANK[health.state] < RANK[before] and before in (HealthState.DEAD_RECKONING, HealthState.CHASSIS_FROZEN):
            assert accepted
        before = health.state


def _follows_from(
    health: PositionHealth, seen: HealthSeen, accepted: bool, epoch: int | None, limits: Thresholds
) -> None:
    """Check one verdict against what was seen, written out state by state."""
    state = health.state
    assert (state is HealthState.FIXED) == (not health.reasons)
    assert all(any(letter.isdigit() for letter in reason.text) for reason in health.reasons)
    assert health.since_ns <= seen.now_ns
    if state.usable:
        assert epoch is not None
        assert not seen.stale_sensors and not seen.jumped_joints and seen.checked is not False and not seen.swapped
        assert seen.sigma_m <= limits.travel_sigma_m
        bounds = {
            HealthState.FIXED: limits.fix_age_s,
            HealthState.FLOAT: limits.fix_age_s,
            HealthState.DEAD_RECKONING: max(limits.dead_reckoning_s, limits.fix_age_s),
            HealthState.CHASSIS_FROZEN: max(limits.chassis_frozen_s, limits.dead_reckoning_s),
        }
        assert seen.now_ns - epoch <= round(bounds[state] * 1e9)
        if not accepted and seen.same_for_s >= limits.frozen_s:
            assert seen.same_for_s <= bounds[state] and RANK[state] >= RANK[HealthState.DEAD_RECKONING]
    if state is HealthState.CHASSIS_FROZEN:
        assert seen.moving_wheels is False or (seen.moving_wheels is None and seen.speed_m_s <= limits.standing_m_s)
        assert not seen.speed_m_s > limits.standing_m_s
    if state is HealthState.FIXED:
        assert not seen.correction_age_s > limits.correction_age_s
        assert accepted or not seen.new
    if accepted:
        assert seen.quality in BELIEVED and abs(seen.new_age_s) <= limits.fix_age_s and not seen.swapped
        assert seen.same_for_s < limits.frozen_s or math.isnan(seen.same_for_s)
        assert min(seen.innovation, seen.agreement if seen.innovation > 5 else 99.0) <= limits.innovation_sigmas


@settings(max_examples=100, deadline=None)
@given(st.lists(steps, min_size=1, max_size=40), limits_drawn)
def test_the_same_again_from_a_memory_written_down(
    drawn: list[tuple[int, dict[str, object]]], limits: Thresholds
) -> None:
    memory, now, epoch = HealthMemory(), 0, None
    for wait_ms, fields in drawn:
        now += wait_ms * MS
        seen = told(now, epoch, fields)
        first = judge(seen, memory, limits)
        second = judge(seen, remembered(json.loads(json.dumps(memory.plain()))), limits)
        assert first == second
        memory = first[2]
        if first[1]:
            epoch = now


worse = st.sampled_from(
    [
        {"quality": FixQuality.FLOAT},
        {"quality": FixQuality.NONE},
        {"sigma_m": 0.6},
        {"sigma_m": NAN},
        {"correction_age_s": 30.0},
        {"innovation": NAN},
        {"innovation": 7.0, "agreement": NAN},
        {"baseline_error_m": 0.2},
        {"heading_difference": 0.2},
        {"swapped": True},
        {"same_for_s": 1.5},
        {"fix_age_s": math.inf, "innovation": NAN},
        {"stale_sensors": ("boom imu",)},
        {"jumped_joints": ("boom",)},
        {"checked": False},
        {"new_age_s": 3.0},
    ]
)


@settings(max_examples=300, deadline=None)
@given(st.lists(steps, max_size=30), worse)
def test_worse_evidence_is_never_a_better_state(
    drawn: list[tuple[int, dict[str, object]]], change: dict[str, object]
) -> None:
    memory, now, epoch = HealthMemory(), 0, None
    limits = Thresholds(innovation_in_a_row=2)
    good = {key: getattr(GOOD, key) for key in ("quality", "sigma_m", "innovation", "moving_wheels", "speed_m_s")}
    for wait_ms, fields in [*drawn, (100, good)]:
        now += wait_ms * MS
        seen = told(now, epoch, fields)
        health, accepted, after = judge(seen, memory, limits)
        if fields is good:
            bad, _, _ = judge(replace(seen, **change), memory, limits)
            assert RANK[bad.state] >= RANK[health.state]
        memory, epoch = after, now if accepted else epoch
