"""A running machine: who drives it, what stops it, and what it tells."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from workgauge.rehearse.scenario_file import load_scenario
from workgauge.rehearse.shipped import shipped_path
from workgauge.rehearse.station.station import Station
from workgauge.values.mail import Letter
from workgauge.values.measurements import DriveMode, Intent, Levers
from workgauge.values.station import RequestKind as Ask
from workgauge.wire.messages import encode
from workgauge.wire.station import decode_station, encode_station

PAGE, OTHER, BOSS = "page-1", "page-2", "supervisor-3"


def test_nobody_drives_at_the_start_and_nothing_moves(bench) -> None:
    before = bench.station.session.true_state[0]
    bench.drive(30, left_x=1.0)
    assert not any(bench.valves)
    assert np.array_equal(bench.station.session.true_state[0], before)
    assert bench.now().driver == ""
    assert bench.snapshot.heard.not_driver == 30


def test_the_driver_moves_the_machine_and_the_guard_stops_it(bench) -> None:
    bench.seated()
    at = bench.station.session.true_state[0][0]
    bench.drive(20, left_x=0.5)
    assert bench.station.session.true_state[0][0] < at - 0.01
    bench.drive(450, left_x=-1.0)
    snapshot = bench.now()
    assert snapshot.held, "the guard says what holds it back"
    assert snapshot.near[0].distance_m > 0.19
    assert any(one.limit for one in snapshot.held)


def test_a_second_page_cannot_drive_until_the_seat_is_handed_over(bench) -> None:
    bench.seated()
    refused = bench.ask(Ask.TAKE, OTHER)
    bench.step()
    assert not bench.answer(refused).done
    bench.drive(40, OTHER, left_x=1.0)
    assert not any(bench.valves)
    assert bench.now().wanted_by == OTHER
    bench.move(PAGE)
    wrong = bench.ask(Ask.GIVE, PAGE, text="page-9")
    right = bench.ask(Ask.GIVE, PAGE, text=OTHER)
    bench.step()
    assert not bench.answer(wrong).done and bench.answer(right).done
    assert bench.station.desk.driver == OTHER
    bench.move(OTHER, enable=False)
    bench.step()
    bench.drive(2, OTHER)
    bench.drive(20, OTHER, left_x=0.5)
    assert any(bench.valves)


def test_a_handover_leaves_nothing_of_the_last_hands(bench) -> None:
    bench.seated()
    bench.drive(20, left_x=0.5)
    bench.ask(Ask.TAKE, OTHER)
    bench.ask(Ask.GIVE, PAGE, text=OTHER)
    bench.step()
    assert not any(bench.valves)
    assert not bench.station.session.gate_open


@pytest.mark.parametrize("who", [PAGE, OTHER])
def test_stop_stops_within_two_ticks_whoever_asks_and_stays(bench, who: str) -> None:
    bench.seated()
    bench.drive(20, left_x=0.8)
    assert any(bench.valves)
    bench.ask(Ask.STOP, who)
    bench.drive(2, left_x=0.8)
    assert not any(bench.valves)
    bench.drive(50, left_x=0.8)
    assert not any(bench.valves)
    assert "stopped by" in bench.now().held[0].text
    cleared = bench.ask(Ask.CLEAR, OTHER)
    bench.step()
    assert not bench.answer(cleared).done
    bench.ask(Ask.CLEAR, PAGE)
    bench.drive(10, left_x=0.8)
    assert not any(bench.valves), "the levers must be let go before it moves again"
    bench.move(enable=False)
    bench.step()
    bench.drive(3)
    bench.drive(10, left_x=0.8)
    assert any(bench.valves)


@pytest.mark.parametrize("again", [Ask.PLAY, Ask.RESTART])
def test_a_stop_is_only_cleared_never_played_or_put_over(bench, again: Ask) -> None:
    bench.seated()
    bench.ask(Ask.STOP, OTHER)
    bench.ask(again)  # on its way when the stop came
    bench.drive(60)
    assert bench.station.stopped == f"stopped by {OTHER}"
    assert bench.station.player is None
    assert not any(bench.valves)


@pytest.mark.parametrize("paused", [False, True])
@pytest.mark.parametrize("cause", ["stop", "handover"])
def test_an_enable_that_was_never_let_go_does_not_open_again(bench, cause: str, paused: bool) -> None:
    bench.seated()
    if paused:
        bench.ask(Ask.PAUSE)
    bench.drive(5)
    drives = PAGE
    if cause == "stop":
        bench.ask(Ask.STOP, OTHER)
        bench.drive(5)
        bench.ask(Ask.CLEAR)
    else:
        bench.ask(Ask.TAKE, OTHER)
        bench.drive(5)
        bench.ask(Ask.GIVE, text=OTHER)
        bench.step()
        drives = OTHER
    bench.drive(5, drives)
    if paused:
        bench.ask(Ask.PAUSE, drives, on=False)
    bench.drive(5, drives)
    bench.drive(10, drives, left_x=0.8)
    assert not bench.station.session.gate_open
    assert not any(bench.valves)
    bench.move(drives, enable=False)
    bench.step()
    bench.drive(3, drives)
    assert bench.station.session.gate_open


def test_silence_stops_the_machine_and_later_frees_the_seat(bench) -> None:
    bench.seated()
    bench.drive(30, left_x=0.8)
    moving = bench.valves
    assert any(moving)
    ticks = round(0.2 / bench.station.session.tick_s)
    bench.step(ticks - 2)
    assert any(bench.valves), "not before it is too old"
    bench.step(4)
    assert not any(bench.valves)
    assert bench.now().driver == PAGE
    assert any(one.code == "stale_intent" for one in bench.snapshot.held)
    bench.step(500)
    assert bench.now().driver == ""
    bench.seated(OTHER)
    bench.drive(20, OTHER, left_x=0.5)
    assert any(bench.valves)


def test_a_slow_link_stops_the_machine(bench) -> None:
    bench.seated()
    bench.drive(20, left_x=0.5)
    seen = bench.now().number
    bench.drive(3, left_x=0.5)
    bench.ask(Ask.BEAT, PAGE, number=float(seen))
    bench.drive(4, left_x=0.5)
    quick = bench.now().round_trip_ms
    assert quick is not None and quick < 100.0
    assert any(bench.valves)
    bench.drive(60, left_x=0.5)  # no beat any more
    assert not any(bench.valves)
    assert bench.now().held[0].code == "link_slow"


def test_beats_of_snapshots_that_never_were_do_not_count(bench) -> None:
    bench.seated()
    bench.ask(Ask.BEAT, PAGE, number=1e9)
    bench.ask(Ask.BEAT, PAGE)
    bench.step()
    assert bench.station.desk.round_trip_s(bench.now_ns) is None
    assert bench.station.desk.heard.invalid == 2


def test_nothing_broken_oversized_or_foreign_gets_through(bench) -> None:
    bench.seated()
    good = encode(Intent(bench.stamp(PAGE), DriveMode.JOINT, Levers(left_x=1.0), True), 10**6)
    foreign = replace(bench.stamp(PAGE), machine_id="another")
    too_far = Intent(bench.stamp(PAGE), DriveMode.JOINT, Levers(left_x=7.0), True)
    letters = [
        b"",
        good[:-1],
        b"x" * 100_000,
        bytes(600),
        encode(Intent(foreign, DriveMode.JOINT, Levers(left_x=1.0), True), 10**6),
        encode(too_far, 10**6),
    ]
    bench.hands += [Letter("intent", bench.now_ns, one) for one in letters]
    bench.waiting += [Letter("request", bench.now_ns, one) for one in (b"", good, b"y" * 9999)]
    bench.step()
    heard = bench.station.desk.heard
    assert (heard.malformed, heard.oversized, heard.invalid) == (4, 3, 2)
    assert not any(bench.valves)
    assert bench.station.session.gate_open, "the driver's own intent still counts"


def test_an_old_intent_does_not_come_back(bench) -> None:
    bench.seated()
    first = Letter(
        "intent", bench.now_ns, encode(Intent(bench.stamp(PAGE), levers=Levers(left_x=1.0), enable=True), 500)
    )
    later = Letter("intent", bench.now_ns, encode(Intent(bench.stamp(PAGE), enable=True), 501))
    bench.hands += [first, later, first]
    bench.step()
    assert bench.station.desk.intent(bench.now_ns, bench.now_ns).levers.neutral
    assert bench.station.desk.sequence == 501


def test_a_flood_is_dropped_and_counted_and_the_driver_still_drives(bench) -> None:
    bench.seated()
    for _ in range(20):
        for _ in range(50):
            bench.move(OTHER, left_x=-1.0)
        bench.drive(1, left_x=0.5)
    heard = bench.station.desk.heard
    assert heard.flooding + heard.not_driver == 1000
    assert heard.flooding > 800
    assert any(bench.valves)


def test_many_senders_do_not_fill_the_memory(bench) -> None:
    bench.seated()
    for k in range(500):
        bench.move(f"page-x{k}", left_x=1.0)
    bench.drive(1)
    assert len(bench.station.desk._buckets) <= 64


def test_a_state_that_is_switched_appears_and_acts(bench) -> None:
    bench.seated()
    name = "Track 2 open to traffic"
    off = bench.ask(Ask.STATE, PAGE, text=name, on=False)
    unknown = bench.ask(Ask.STATE, PAGE, text="Track 9", on=False)
    bench.drive(5)
    assert bench.answer(off).done and not bench.answer(unknown).done
    assert bench.now().off_states == (name,)
    assert "track:Track 2" not in {one.limit for one in bench.snapshot.near}
    bench.ask(Ask.STATE, PAGE, text=name, on=True)
    bench.drive(5)
    assert bench.now().off_states == ()


def test_the_guard_is_chosen_at_rest_within_bounds_and_logged(bench) -> None:
    bench.seated()
    bench.drive(20, left_x=0.5)
    moving = bench.ask(Ask.GUARD, PAGE, text="linear", settings=(("stop_distance_m", 0.3),))
    bench.drive(1, left_x=0.5)
    assert not bench.answer(moving).done
    bench.drive(3)
    tried = {
        bench.ask(Ask.GUARD, PAGE, text="none"): False,
        bench.ask(Ask.GUARD, PAGE, text="linear", settings=(("stop_distance_m", 0.0),)): False,
        bench.ask(Ask.GUARD, PAGE, text="linear", settings=(("exponent", 1.0),)): False,
        bench.ask(Ask.GUARD, PAGE, text="no such"): False,
        bench.ask(Ask.GUARD, PAGE, text="linear", settings=(("stop_distance_m", 0.3),)): True,
    }
    bench.drive(1)
    assert {name: bench.answer(name).done for name in tried} == tried
    assert bench.now().guard == "linear"
    assert dict(bench.snapshot.settings)["stop_distance_m"] == 0.3
    assert any("guard linear" in one.text for one in bench.snapshot.events)


def test_the_scenario_plays_pauses_and_ends(bench) -> None:
    bench.seated()
    played = bench.ask(Ask.PLAY)
    bench.step(200)
    assert bench.answer(played).done
    assert bench.now().doing == "scenario"
    assert bench.station.desk.driver == PAGE
    assert any(bench.valves)
    refused = bench.ask(Ask.PAUSE, OTHER)
    bench.ask(Ask.PAUSE)
    bench.step(1)
    assert not bench.answer(refused).done
    t_s = bench.station.session.t_s
    for _ in range(20):
        bench.move(left_x=1.0)
        bench.step()
    assert bench.station.session.t_s == t_s
    assert bench.now().doing == "paused"
    bench.ask(Ask.PAUSE, on=False)
    bench.drive(3)
    assert bench.station.session.t_s > t_s
    assert bench.now().doing == "scenario"
    bench.ask(Ask.TAKE)  # drives on by hand
    bench.drive(2, left_x=1.0)
    assert bench.now().doing == "driving"


def test_where_a_scenario_ends_the_hands_must_be_let_go_first(bench) -> None:
    bench.seated()
    bench.ask(Ask.PLAY)
    bench.drive(200)
    assert any(bench.valves)
    bench.ask(Ask.TAKE)
    bench.drive(30, left_x=1.0)  # never let go since it was pressed
    assert not any(bench.valves)
    bench.drive(30)
    assert not bench.station.session.gate_open
    bench.move(enable=False)
    bench.step()
    bench.drive(3)
    assert bench.station.session.gate_open


def test_a_scenario_plays_on_when_its_player_falls_silent_and_anybody_may_take_the_seat(bench) -> None:
    bench.seated()
    bench.ask(Ask.PLAY)
    bench.step(600)
    assert bench.station.desk.driver == ""
    assert bench.now().doing == "scenario"
    bench.ask(Ask.TAKE, OTHER)  # takes the hands of the scenario away
    bench.step(3)
    assert bench.station.desk.driver == OTHER
    assert not any(bench.valves)


@pytest.mark.prove
def test_the_whole_scenario_ends_by_itself(bench) -> None:
    bench.seated()
    bench.ask(Ask.PLAY)
    for _ in range(4000):
        bench.step()
        if bench.station.player is None:
            break
    assert any("scenario ends" in one.text for one in bench.station.told.events)
    assert bench.station.session.truth.entries() == ()


def test_snapshots_are_small_rare_and_read_back(bench) -> None:
    bench.seated()
    found = []
    for _ in range(100):
        bench.move(left_x=-0.5)
        bench.snapshot = None
        bench.step()
        if bench.snapshot is not None:
            found.append(bench.snapshot)
    assert 20 <= len(found) <= 25
    for one in found:
        frame = encode_station(one)
        assert len(frame) < 16_000
        assert decode_station(frame, 0).value.near == one.near
    setup = encode_station(bench.station.setup(0))
    assert decode_station(setup, 0).value.states == tuple(sorted(bench.station.session.states))


def test_a_limit_is_suspended_only_where_the_rule_book_allows(bench) -> None:
    refused = bench.ask(Ask.OVERRIDE, BOSS, text="point:P1-12", number=5.0, reason="pole is being replaced")
    bench.step()
    assert "rule book" in bench.answer(refused).text


@pytest.fixture
def lenient(tmp_path: Path, bench):
    """The same, with a rule book that lets poles be suspended for ten minutes."""
    rules = yaml.safe_load(shipped_path("rules", "finland.yaml").read_text())
    loaded = load_scenario("pole-approach")
    limit = next(one for one in bench.station.session.limit_set.limits if one.id == "point:P1-12")
    rules["may_suspend"] = [{"rule": limit.rule, "at_most_min": 10}]
    path = tmp_path / "rules.yaml"
    path.write_text(yaml.safe_dump(rules))
    bench.station = Station(loaded.choosing(guard="barrier", rules=path))
    return bench


def test_a_supervisor_suspends_a_limit_for_a_while_and_it_is_told(lenient) -> None:
    bench, limit = lenient, "point:P1-12"
    assert any(one.limit == limit for one in bench.now().near)
    tried = {
        bench.ask(Ask.OVERRIDE, PAGE, text=limit, number=5.0, reason="a good reason"): False,
        bench.ask(Ask.OVERRIDE, BOSS, text=limit, number=11.0, reason="a good reason"): False,
        bench.ask(Ask.OVERRIDE, BOSS, text=limit, number=5.0, reason=" "): False,
        bench.ask(Ask.OVERRIDE, BOSS, text=limit): False,
        bench.ask(Ask.OVERRIDE, BOSS, text="track:Track 2", number=5.0, reason="a good reason"): False,
        bench.ask(Ask.OVERRIDE, BOSS, text=limit, number=0.05, reason="a good reason"): True,
    }
    bench.step()
    assert {name: bench.answer(name).done for name in tried} == tried
    (told,) = bench.now().suspended
    assert (told.limit, told.reason, told.by) == (limit, "a good reason", BOSS)
    assert not any(one.limit == limit for one in bench.snapshot.near)
    assert any("SUSPENDED" in one.text for one in bench.snapshot.events)
    assert not any(name.startswith("in force") for name in bench.snapshot.off_states)
    bench.step(300)
    assert any(one.limit == limit for one in bench.now().near)
    assert bench.snapshot.suspended == ()
