"""Interventions: one per cause, whatever the ticks in between do."""

import json

from hypothesis import given
from hypothesis import strategies as st

from workgauge.rehearse.interventions import PAUSE_S, InterventionLog
from workgauge.rehearse.result import Intervention
from workgauge.values.reasons import Reason, ReasonCode

TICK = 0.01


def near(limit: str, scale: float, link: str = "stick") -> Reason:
    return Reason(ReasonCode.LIMIT_NEAR, f"{link} near {limit}", link, limit, None, 0.2 + 0.6 * scale, scale)


def fed(ticks: list[list[Reason]], wanted: bool = True) -> InterventionLog:
    log = InterventionLog()
    for i, reasons in enumerate(ticks):
        log.take(i * TICK, TICK, reasons, wanted)
    return log


def test_one_cause_over_many_ticks_is_one_and_keeps_its_worst_moment() -> None:
    scales = [0.9, 0.5, 0.1, 0.3]
    (one,) = fed([[near("pole", s)] for s in scales]).interventions()
    assert (one.t_s, round(one.until_s, 9)) == (0.0, 0.04)
    assert (one.scale, one.limit, one.link, one.reason) == (0.1, "pole", "stick", "limit_near")
    assert one.clearance_m == 0.26


def test_links_that_take_turns_do_not_make_new_causes() -> None:
    ticks = [[near("pole", 0.5, "stick" if i % 2 else "attachment")] for i in range(50)]
    assert len(fed(ticks).interventions()) == 1


def test_a_short_pause_continues_a_long_one_begins_anew() -> None:
    short, long = round(PAUSE_S / TICK) - 2, round(PAUSE_S / TICK) + 3
    on = [[near("pole", 0.5)]] * 5
    assert len(fed(on + [[]] * short + on).interventions()) == 1
    assert len(fed(on + [[]] * long + on).interventions()) == 2


def test_idle_gate_is_no_intervention_but_a_closed_gate_in_use_is() -> None:
    closed = [[Reason(ReasonCode.GATE_CLOSED, "closed")]] * 3
    assert fed(closed, wanted=False).interventions() == ()
    assert [one.reason for one in fed(closed, wanted=True).interventions()] == ["gate_closed"]


def test_lost_sensors_are_told_even_while_nothing_is_wanted() -> None:
    lost = [[Reason(ReasonCode.STALE_POSTURE, "old")]] * 3
    assert [one.reason for one in fed(lost, wanted=False).interventions()] == ["stale_posture"]


@given(
    st.lists(
        st.lists(st.tuples(st.sampled_from("abc"), st.floats(0, 1)), max_size=3, unique_by=lambda pair: pair[0]),
        max_size=80,
    )
)
def test_every_reason_lies_in_exactly_one_interval_of_its_cause(ticks: list[list[tuple[str, float]]]) -> None:
    found = fed([[near(name, scale) for name, scale in tick] for tick in ticks]).interventions()
    assert list(found) == sorted(found, key=lambda one: one.t_s)
    for i, tick in enumerate(ticks):
        for name, scale in tick:
            holding = [one for one in found if one.limit == name and one.t_s <= i * TICK < one.until_s - 1e-12]
            assert len(holding) == 1
            assert holding[0].scale is not None and holding[0].scale <= scale


def test_a_protection_level_without_bound_is_null_in_json():
    """A short baseline while the machine turns: no bound of the second order; JSON knows no infinity."""
    one = Intervention(
        t_s=1.0,
        until_s=2.0,
        reason="limit_reached",
        link="boom",
        limit="point:P",
        joint=None,
        clearance_m=1.0,
        scale=0.0,
        text="unsure",
        protection_m=float("inf"),
    )
    assert one.as_json()["protection_m"] is None
    json.dumps(one.as_json(), allow_nan=False)
