"""When limits count: work states and windows of time of the rule book."""

from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from workgauge.gauge.build import build_limits
from workgauge.gauge.rulebook import parse_rule_book
from workgauge.values.errors import RuleError

HEAD = "version: 1\nname: mine\ntitle: t\nrules:\n  - {name: t, feature: alignment, limits: [{make: track, "
TAIL = "half_width_m: 1.8, height_m: 4.0}]}\n"
ZERO = datetime(2026, 5, 2, 19, 0, 0, tzinfo=UTC)


def limit(make, text: str, zero: datetime | None = ZERO):
    site = make.site(make.alignment([(50.0, 0, 0)], name="Track 2"))
    limits = build_limits(site, parse_rule_book(HEAD + text + TAIL, "mine.yaml"), clock_zero=zero)
    return limits.limits[0], limits.warnings


@pytest.mark.parametrize("quote", ["", "'"])
def test_a_window_is_read_with_its_time_zone(make, quote: str) -> None:
    found, warnings = limit(
        make,
        f"active_from: {quote}2026-05-02T22:30:00+03:00{quote}, active_until: {quote}2026-05-02T20:00:00Z{quote}, ",
    )
    activity = found.activity
    assert (activity.not_before_ns, activity.not_after_ns) == (1_800 * 10**9, 3_600 * 10**9)
    assert not any("window" in warning for warning in warnings)
    assert [found.counts(s * 10**9) for s in (0, 1799, 1800, 3600, 3601)] == [False, False, True, True, False]


@given(st.timedeltas(timedelta(-1), timedelta(1)), st.timedeltas(timedelta(-1), timedelta(1)))
def test_it_counts_exactly_within_its_window(make, start: timedelta, now: timedelta) -> None:
    found, _ = limit(make, f"active_from: '{(ZERO + start).isoformat()}', ")
    assert found.counts(now // timedelta(microseconds=1) * 1000) == (now >= start)


def test_a_state_and_a_window_must_both_hold(make) -> None:
    found, _ = limit(make, "active_while: '{name} open', active_from: '2026-05-02T19:00:10Z', ")
    off = frozenset({"Track 2 open"})
    seconds = 10**9
    assert [found.counts(t * seconds, o) for t in (5, 15) for o in (frozenset(), off)] == [False, False, True, False]


def test_without_a_clock_it_counts_always_and_says_so(make) -> None:
    found, warnings = limit(make, "active_until: '2020-01-01T00:00:00Z', ", zero=None)
    assert found.counts(0) and found.counts(10**18)
    assert any("1 limit with a window of time counted always" in warning for warning in warnings)


@pytest.mark.parametrize(
    "text",
    [
        "active_from: '2026-05-02T22:00:00', ",  # no time zone
        "active_from: tomorrow, ",
        "active_from: '2026-05-02T22:00:00Z', active_until: '2026-05-02T22:00:00Z', ",
    ],
)
def test_what_is_no_window_is_refused_with_its_line(make, text: str) -> None:
    with pytest.raises(RuleError, match=r"mine\.yaml:5"):
        limit(make, text)
