"""Epochs: no position and no heading is lost, one moment's sentences share what one of them says, times are dated."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.positioning.epochs import Instant, fixes_of, gathered, times
from workgauge.values.measurements import Stamp
from workgauge.values.navigation import FixQuality, GnssError, GnssFix, GnssGridFix, GnssHeading, GnssVelocity

Q = FixQuality
DAY_NS = 86_400 * 10**9


def stamp(source="gnss/GN", epoch_s=None):
    return Stamp("m", 0, source, None if epoch_s is None else round(epoch_s * 1e9))


def fix(t, lat=0.7, lon=0.2, sentence="GGA", quality=Q.FIXED, source="gnss/GN", epoch_s=None, **more):
    return GnssFix(stamp(source, epoch_s), sentence, lat, lon, t, quality=quality, **more)


def heading(angle, t=math.nan, source="gnss/GN"):
    return GnssHeading(stamp(source), "HDT", angle, t)


def rows(measurements):
    """Return (time, latitude, quality, heading) of every epoch."""
    instants = gathered(measurements)
    return [
        (
            instants[i].time_of_day_s,
            None if one is None else one.latitude,
            None if one is None else one.quality,
            None if instants[i].heading is None else instants[i].heading.heading,
        )
        for i, one in fixes_of(instants)
    ]


def test_sentences_of_one_position_are_one_epoch_by_the_better_word():
    (only,) = rows(
        [fix(1.0, sentence="RMC", quality=Q.SINGLE), fix(1.0), fix(1.0, sentence="GLL", quality=Q.DIFFERENTIAL)]
    )
    assert only == (1.0, 0.7, Q.FIXED, None)


def test_positions_of_different_digits_stay_apart_and_share_the_rest():
    instants = gathered(
        [
            fix(1.0, 0.7000001, sentence="GLL", quality=Q.SINGLE),
            fix(1.0, 0.7, height_msl_m=12.0, geoid_separation_m=17.0, correction_age_s=3.0),
            GnssError(stamp(), "GST", np.diag([1.0, 4.0, 9.0]), 1.0),
        ]
    )
    found = [one for _, one in fixes_of(instants)]
    assert [one.latitude for one in found] == [0.7000001, 0.7]
    for one in found:
        assert (one.quality, one.height_msl_m, one.separation_m, one.correction_age_s) == (Q.FIXED, 12.0, 17.0, 3.0)
        np.testing.assert_array_equal(np.diagonal(one.covariance), [1, 4, 9])


def test_two_receivers_share_nothing():
    found = [
        one
        for _, one in fixes_of(
            gathered(
                [
                    fix(1.0, 0.7, height_msl_m=12.0),
                    fix(1.0, 0.7, source="gnss/GP", sentence="RMC", quality=Q.SINGLE),
                    GnssError(stamp(), "GST", np.eye(3), 1.0),
                ]
            )
        )
    ]
    assert [(one.source, one.quality) for one in found] == [("gnss/GN", Q.FIXED), ("gnss/GP", Q.SINGLE)]
    assert math.isnan(found[1].height_msl_m)
    assert found[1].covariance is None


def test_no_fix_is_an_epoch_but_not_beside_a_position():
    nowhere = fix(1.0, math.nan, math.nan, quality=Q.NONE)
    assert rows([nowhere]) == [(1.0, pytest.approx(math.nan, nan_ok=True), Q.NONE, None)]
    assert [row[1] for row in rows([nowhere, fix(1.0, sentence="RMC", quality=Q.SINGLE)])] == [0.7]


def test_a_velocity_alone_is_no_epoch():
    assert gathered([GnssVelocity(stamp(), "VTG", 1.0, 2.0)]) == []


def test_a_position_in_the_receivers_own_projection_is_kept():
    instants = gathered([GnssGridFix(stamp(), "PTNL,PJK", 500.0, 600.0, 1.0, 7.0, Q.FLOAT)])
    ((_, only),) = fixes_of(instants)
    assert (only.e, only.n, only.grid_height_m, only.quality, only.placed) == (500.0, 600.0, 7.0, Q.FLOAT, True)


@pytest.mark.parametrize("ahead", [True, False])
def test_headings_without_a_time_stay_with_the_fix_of_their_burst(ahead):
    bursts = [[heading(0.1 * i), fix(float(i), 0.7 + i)] for i in range(1, 6)]
    stream = [one for burst in bursts for one in (burst if ahead else reversed(burst))]
    assert rows(stream) == [(float(i), 0.7 + i, Q.FIXED, pytest.approx(0.1 * i)) for i in range(1, 6)]


def test_a_heading_with_a_time_joins_it_whatever_the_order():
    assert rows([fix(1.0), fix(2.0), heading(0.5, 1.0)]) == [(1.0, 0.7, Q.FIXED, 0.5), (2.0, 0.7, Q.FIXED, None)]


def test_a_heading_of_another_talker_belongs_to_the_stream():
    assert rows([fix(1.0), heading(0.5, source="gnss/HE")]) == [(1.0, 0.7, Q.FIXED, 0.5)]
    assert len(rows([fix(1.0), heading(0.5, source="compass/HE")])) == 2


_ANGLES = st.integers(0, 10**9).map(lambda i: i * 1e-9)
_MEASUREMENTS = st.lists(
    st.one_of(
        st.builds(
            fix,
            st.sampled_from([1.0, 2.0, 3.0, math.nan]),
            _ANGLES,
            _ANGLES,
            st.sampled_from(["GGA", "RMC", "GLL", "NAV-PVT", "NAV-HPPOSLLH"]),
            st.sampled_from([Q.NONE, Q.SINGLE, Q.FIXED]),
            st.sampled_from(["gnss/GN", "gnss/GP", "other/UBX"]),
        ),
        st.builds(heading, _ANGLES),
    ),
    max_size=30,
)


@given(_MEASUREMENTS)
@settings(max_examples=300, deadline=None)
def test_nothing_is_lost_and_nothing_made_up(measurements):
    instants = gathered(measurements)
    out = list(fixes_of(instants))
    positions = {(one.source, one.latitude, one.longitude) for _, one in out if one is not None}
    sent = [one for one in measurements if isinstance(one, GnssFix)]
    assert positions == {(one.stamp.source, one.latitude, one.longitude) for one in sent}
    kept = {instants[i].heading.heading for i, _ in out if instants[i].heading is not None}
    assert kept == {one.heading for one in measurements if isinstance(one, GnssHeading)}
    assert len(out) <= len(measurements)
    assert all(a <= b for a, b in pairwise(i for i, _ in out))


def moments(*pairs):
    return [Instant("gnss", day, None if epoch is None else round(epoch * 1e9)) for day, epoch in pairs]


def test_moments_before_the_first_date_get_it_by_counting_back():
    day = 18_000 * 86_400.0
    t, utc = times(moments((10.0, None), (10.5, None), (11.0, day + 11.0), (12.0, None)))
    assert utc
    np.testing.assert_allclose(t - day, [10.0, 10.5, 11.0, 12.0])


def test_counting_back_over_midnight():
    day = 18_000 * 86_400.0
    t, _ = times(moments((86_399.0, None), (0.5, day + 0.5)))
    np.testing.assert_allclose(t - day, [-1.0, 0.5])


def test_without_any_date_midnight_is_passed_upwards():
    t, utc = times(moments((86_399.5, None), (math.nan, None), (0.5, None), (1.5, None)))
    assert not utc
    np.testing.assert_allclose(t, [86_399.5, math.nan, 86_400.5, 86_401.5])


@given(
    st.lists(st.floats(0.1, 40_000.0), min_size=1, max_size=12),
    st.floats(0, 86_399),
    st.data(),
)
@settings(max_examples=200, deadline=None)
def test_dates_are_found_again_wherever_they_are_known(steps, first, data):
    """Moments less than half a day apart, one of them dated: the others' dates follow from it or its neighbour."""
    true = 18_000 * 86_400.0 + first + np.concatenate([[0.0], np.cumsum(steps)])
    known = data.draw(st.lists(st.booleans(), min_size=len(true), max_size=len(true)))
    for i in range(len(true)):  # so that none is half a day away from its nearest date
        if not known[i] and not any(
            known[j] and abs(true[j] - true[i]) < 40_000 for j in (i - 1, i + 1) if 0 <= j < len(true)
        ):
            known[i] = True
    t, utc = times(moments(*((float(x % 86_400), float(x) if k else None) for x, k in zip(true, known, strict=True))))
    assert utc
    np.testing.assert_allclose(t, true, atol=1e-5)
