"""The track under a travelling machine: across switches, with hysteresis, and never the one that only runs beside."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.gauge.build import build_limits
from workgauge.gauge.following import OnTracks, TrackFollower
from workgauge.gauge.own_track import own_track, without_own_track
from workgauge.gauge.rulebook import parse_rule_book
from workgauge.machine.load import load_machine
from workgauge.proximity.scene import Scene

BOOK = """
version: 1
name: mine
title: t
{own}
rules:
  - {{name: t, feature: alignment, limits: [{{make: track, half_width_m: 1.8, height_m: 4.0}}]}}
"""


def book(**own: float):
    text = "own_track: {" + ", ".join(f"{key}: {float(value)}" for key, value in own.items()) + "}" if own else ""
    return parse_rule_book(BOOK.format(own=text), "mine.yaml")


#: Main goes straight east; Branch shares its first 100 m and turns left with a radius of 300 m; Beside is parallel.
TOE_M, RADIUS_M = 100.0, 300.0


@pytest.fixture(scope="module")
def switch(make):
    main = make.alignment([(400.0, 0, 0)], name="Main", yaw=0.0)
    branch = make.alignment([(TOE_M, 0, 0), (120.0, 1 / RADIUS_M, 1 / RADIUS_M)], name="Branch", yaw=0.0)
    beside = make.alignment([(1.0, 0, 0), (400.0, 0, 0)], name="Beside", yaw=0.0)
    return make.site(main, branch, _moved(make, beside, -3.2))


def _moved(make, alignment, north):
    """Return the same straight alignment `north` metres to the left."""
    element = alignment.plan.elements[0]
    start = (element.start[0], element.start[1] + north)
    plan = type(alignment.plan)(
        alignment.plan.origin, [type(element)(element.kind, element.law, start, 0.0, 400.0, 0, 0)]
    )
    return type(alignment)(name=alignment.name, source=alignment.source, plan=plan, profile=alignment.profile)


def ride(site, follower: TrackFollower, name: str, first: float, last: float, step: float = 0.2) -> list[OnTracks]:
    """Return what a machine stands on along an alignment."""
    track = site.alignment(name)
    seen, now = [], OnTracks()
    for d in np.arange(first, last, math.copysign(step, last - first)):
        state = track.at(d)
        now = follower.follow(now, float(state.e[0]), float(state.n[0]), float(state.heading[0]))
        seen.append(now)
    return seen


def changes(values) -> int:
    return sum(a != b for a, b in itertools.pairwise(values))


def apart(site, d: float) -> float:
    state = site.alignment("Branch").at(d)
    return abs(float(site.alignment("Main").project([[state.e[0], state.n[0]]])[1][0]))


def test_the_branch_becomes_its_own_once_and_each_is_let_off_while_it_is_fouled(switch) -> None:
    rules = book()
    seen = ride(switch, TrackFollower(switch, rules), "Branch", 20.0, 219.0)
    assert seen[0].own == "Main" and seen[-1].own == "Branch" and changes([one.own for one in seen]) == 1
    for d, one in zip(np.arange(20.0, 219.0, 0.2), seen, strict=True):
        away = apart(switch, float(d))
        assert one.own in one.let_off and "Beside" not in one.let_off
        if away < 3.4:
            assert one.let_off == {"Main", "Branch"}, d
        elif away > 3.95:
            assert one.let_off == {"Branch"}, d


def test_the_same_backwards_comes_back_to_the_stem(switch) -> None:
    seen = ride(switch, TrackFollower(switch, book()), "Branch", 219.0, 20.0)
    assert {one.own for one in seen} == {"Branch"}, "both run together on the stem: the one before is kept"
    assert changes([one.let_off for one in seen]) == 1 and seen[-1].let_off == {"Main", "Branch"}


def test_a_parallel_track_is_never_let_off_however_near(switch) -> None:
    """Beside lies 3.2 m away, nearer than the fouling distance, all along: it does not branch."""
    seen = ride(switch, TrackFollower(switch, book()), "Main", 5.0, 395.0, 1.0)
    assert all("Beside" not in one.let_off for one in seen)
    assert seen[-1].own == "Main"


@settings(max_examples=60, deadline=None)
@given(
    st.floats(0.0, 219.0),
    st.floats(-1.2, 1.2),
    st.lists(st.tuples(st.floats(0.0, 0.149), st.floats(0.0, 2 * math.pi)), min_size=4, max_size=12),
)
def test_noise_within_half_the_hysteresis_changes_each_answer_at_most_once(switch, d, aside, noise) -> None:
    follower = TrackFollower(switch, book())
    state = switch.alignment("Branch").at(d)
    e, n = state.offset_points(aside)[0]
    now, seen = OnTracks(), []
    for radius, angle in noise:
        now = follower.follow(
            now, e + radius * math.cos(angle), n + radius * math.sin(angle), float(state.heading[0])
        )
        seen.append(now)
    assert changes([one.own for one in seen]) <= 1
    for name in ("Main", "Branch", "Beside"):
        assert changes([name in one.let_off for one in seen]) <= 1 + changes([one.own for one in seen])


def test_without_hysteresis_noise_would_chatter(switch) -> None:
    follower = TrackFollower(switch, book(hysteresis_m=0.0))
    d = 120.0  # 0.67 m apart
    state = switch.alignment("Branch").at(d)
    now, seen = OnTracks(), []
    for k in range(20):
        e, n = state.offset_points(-apart(switch, d) / 2 + (0.15 if k % 2 else -0.15))[0]
        now = follower.follow(now, e, n, float(state.heading[0]))
        seen.append(now.own)
    assert changes(seen) == 19


def test_off_the_rails_nothing_is_let_off(switch, make) -> None:
    follower = TrackFollower(switch, book())
    e, n = make.origin
    on = follower.follow(OnTracks(), e + 50.0, n, math.pi / 2)
    assert on.own == "Main"
    assert follower.follow(on, e + 50.0, n + 0.5, 0.0) == OnTracks(None, frozenset(), e + 50.0, n + 0.5, 0.0)
    away = follower.follow(on, e + 50.0, n + 1.25, math.pi / 2)
    assert away.own == "Main", "left only beyond within_m and the hysteresis"
    assert follower.follow(away, e + 50.0, n + 1.55, math.pi / 2).own is None


def test_standing_still_asks_the_site_nothing(switch, make) -> None:
    follower = TrackFollower(switch, book())
    e, n = make.origin
    on = follower.follow(OnTracks(), e + 50.0, n, math.pi / 2)
    assert follower.follow(on, e + 50.05, n, math.pi / 2) is on


@settings(max_examples=40, deadline=None)
@given(st.floats(1.0, 219.0), st.floats(-2.0, 2.0), st.booleans())
def test_a_first_look_agrees_with_the_plain_question(switch, d, aside, back) -> None:
    rules = book()
    state = switch.alignment("Branch").at(d)
    e, n = state.offset_points(aside)[0]
    heading = float(state.heading[0]) + (math.pi if back else 0.0)
    assert TrackFollower(switch, rules).follow(OnTracks(), e, n, heading).own == own_track(
        switch, rules, e, n, heading
    )


@pytest.mark.parametrize("own", [None, "Main", "Branch"])
def test_letting_off_is_the_same_as_building_without_it(switch, own) -> None:
    machine = load_machine("rre20")
    limits = build_limits(switch, book())
    state = switch.alignment("Branch").at(140.0)
    T = np.eye(4)
    T[:3, 3] = limits.frame.to_local(np.array([state.e[0], state.n[0], 80.0]))
    kin = machine.forward(machine.home)
    one = Scene(machine, limits.limits).query(kin, T, 7.0, let_off=frozenset([own] if own else []))
    other = Scene(machine, without_own_track(limits, own)).query(kin, T, 7.0)
    assert len(one) == len(other) > 0
    assert one.distances.tobytes() == other.distances.tobytes()
    assert [one.limit_ids[i] for i in one.limits] == [other.limit_ids[i] for i in other.limits]
