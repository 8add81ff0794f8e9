"""The stop certificate: what is driven, what counts for the verdict, and drives kept on disk."""

import json
import math
import random
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from workgauge.machine.load import description_path, load_machine, machine_from
from workgauge.machine.stopping import StoppingModel
from workgauge.rehearse.certify.certificate import joint_stopping, warnings
from workgauge.rehearse.certify.conditions import Task, conditions, room_s, tasks
from workgauge.rehearse.certify.driving import Driven, Driver, Held, Linear, Subject
from workgauge.rehearse.certify.fingerprint import differences, fingerprint
from workgauge.rehearse.certify.journal import Journal
from workgauge.rehearse.certify.outcome import CLASS_M, certificate_id, outcome
from workgauge.rehearse.certify.work import driven
from workgauge.rehearse.drives.bus import Bus, BusSettings
from workgauge.rehearse.drives.draw import Drives
from workgauge.rehearse.drives.watch import Nearest
from workgauge.rehearse.shipped import shipped_site_files
from workgauge.values.errors import InputError

SITE = tuple(str(file) for file in shipped_site_files("double_track"))
MACHINE = load_machine("rre20")
LINEAR = Subject("rre20", "finland", SITE, "linear", delays_s=(0.3,))


@pytest.fixture(scope="module")
def linear() -> Driver:
    return Driver(LINEAR)


@pytest.fixture(scope="module")
def by_linear(linear: Driver) -> list[Driven]:
    return [one for _, one in driven(linear, tasks(linear.conditions, 6, 0), 1)]


def ideal() -> dict[str, object]:
    """Return the shipped excavator's description without a word on how it stops."""
    content = yaml.safe_load(description_path("rre20").read_text("utf-8"))
    for joint in content["joints"]:
        joint.pop("stopping_positive", None)
        joint.pop("stopping_negative", None)
    return dict(content)


def test_the_model_covers_what_its_tolerance_does_and_no_more() -> None:
    machine = MACHINE
    room = room_s(machine)
    assert room == pytest.approx(0.3 * 0.2)
    which = {one.key: one for one in conditions(machine, (0.3, 0.05, room, room + 1e-6))}
    assert [one.within for one in which.values()] == [True] * 4 + [True, True, False, False]
    assert which["+0.05 s"].within and not which["+0.3 s"].within
    assert which["late bus"].bus.longest_s(0.02) <= room and which["missed ticks"].bus.longest_s(0.02) <= room
    for delay in (0.0, -0.1, math.nan, math.inf, 6.0):
        with pytest.raises(InputError, match="--dead-time"):
            conditions(machine, (delay,))


def test_every_real_machine_within_the_model_is(linear: Driver) -> None:
    machine = linear.machine
    drives, slowest = Drives(machine), StoppingModel.of(machine).slowest()
    met = 0
    for one in conditions(machine, (0.03, 0.3)):
        for seed in range(4):
            real = one.applied(drives.draw(seed, one.settings(machine, 0.2, 4.0))).hydraulics
            latest = real.dead_time_s + one.bus.longest_s(0.02)
            assert (latest <= slowest.dead_time_s + 1e-12).all() == one.within
            assert (real.dead_time_s >= 0.7 * StoppingModel.of(machine).dead_time_s - 1e-12).all()
            assert (real.lag_s <= slowest.lag_s + 1e-12).all()
            assert (real.deceleration >= slowest.deceleration - 1e-12).all()
            met += int(np.isclose(latest, slowest.dead_time_s).sum())
    assert met > 20  # the end of the tolerance is reached, not only kept


def test_a_machine_without_stopping_blocks_is_certified_for_nothing_hydraulic() -> None:
    machine = machine_from(ideal())
    which = conditions(machine, (0.1,))
    assert [(one.key, one.within) for one in which] == [("as described", True), ("+0.1 s", False)]
    joints = tuple(
        replace(one, stopping=machine.stopping_positive[0], assumed=False) for one in joint_stopping(Driver(LINEAR))
    )
    said = " ".join(warnings(joints, which, outcome(which, [made(0, condition="as described")])))
    assert "every joint" in said and "NOTHING" in said and "workgauge identify" in said


def test_a_longer_list_begins_with_the_shorter_one() -> None:
    which = conditions(MACHINE, (0.1,))
    short, long = tasks(which, 10, 3), tasks(which, 40, 3)
    assert set(short) <= set(long) and len(set(long)) == len(long) == 50
    assert {one.condition for one in long} == {one.key for one in which}
    assert not {one.seed for one in long} & {one.seed for one in tasks(which, 40, 4)}
    for drives, seed in ((0, 0), (1_000_001, 0), (1, 1_000_000)):
        with pytest.raises(InputError):
            tasks(which, drives, seed)


@given(late=st.integers(0, 12), seed=st.integers(0, 2**32), gaps=st.lists(st.integers(0, 6), min_size=1, max_size=40))
def test_a_late_bus_keeps_order_loses_nothing_new_and_is_never_later_than_it_says(
    late: int, seed: int, gaps: list[int]
) -> None:
    bus, sent, newest = Bus(BusSettings(late_s=0.005 * late), seed, 0.005), 0, 0
    sent_at: list[int] = []
    step = 0
    for gap in [*gaps, *[0] * 13]:
        if len(sent_at) < len(gaps):
            sent += 1
            sent_at.append(step)
            bus.send((sent,))
        for _ in range(gap + 1):
            arrived = bus.arrived()
            if arrived is not None:
                assert arrived[0] > newest and step >= sent_at[arrived[0] - 1]
                newest = arrived[0]
            due = sum(at + late <= step for at in sent_at)
            assert newest >= due
            step += 1
    assert newest == len(gaps)


@given(longest=st.integers(1, 5), seed=st.integers(0, 2**32))
def test_no_more_ticks_in_a_row_are_missed_than_it_says(longest: int, seed: int) -> None:
    bus = Bus(BusSettings(missed=0.5, longest=longest), seed, 0.005)
    missed = "".join("x" if bus.misses(False) else "." for _ in range(400))
    runs = [len(run) for run in missed.split(".") if run]
    assert max(runs) == longest
    waiting = Bus(BusSettings(missed=0.9), seed, 0.005)
    assert not any(waiting.misses(True) for _ in range(50))


def made(seed: int, left: float | None = 0.01, condition: str = "tolerance", **more: object) -> Driven:
    """Return a drive with so much left of a stop distance of 0.2 m."""
    near = () if left is None else (Nearest("track", "boom", "track:1", 0.2 + left, left),)
    worst = None if left is None else 0.2 + left
    base = Driven(condition, seed, "levers", "on the rails", (), worst, left, near, 1.0, 2.0, 4.0)
    return replace(base, **more)  # type: ignore[arg-type]


def test_the_verdict_is_of_drives_within_the_model_alone() -> None:
    which = conditions(MACHINE, (0.3,))
    good = [made(seed) for seed in range(20)]
    assert outcome(which, good).passed
    beyond = made(0, -0.5, "+0.3 s", entered=("track:1",))
    came = outcome(which, [*good, beyond])
    assert came.passed and came.within.entered == 0 and came.beyond.entered == 1 and came.worst is not None
    assert came.worst.less_stop_m == 0.01
    assert not outcome(which, [*good, made(20, -0.001)]).passed
    assert outcome(which, [*good, made(20, -0.00005)]).passed  # rounding
    came = outcome(which, [*good, made(20, 0.3, entered=("self:boom",))])
    assert not came.passed and came.failed == (("tolerance", 20),) and came.failing_share == 1.0
    assert not outcome(which, []).passed and not outcome(which, [beyond]).passed
    nowhere = replace(made(21), place="", kind="")
    assert outcome(which, [*good, nowhere]).undriven == 1 and outcome(which, [*good, nowhere]).within.drives == 20


def test_what_a_sample_without_a_failure_says() -> None:
    which = conditions(MACHINE, ())
    for n in (1, 20, 300):
        share = outcome(which, [made(seed) for seed in range(n)]).failing_share
        assert (1.0 - share) ** n == pytest.approx(0.05)  # a share this large would show with 95 %


@given(st.lists(st.one_of(st.none(), st.floats(-2.0, 3.0)), min_size=1, max_size=60))
def test_every_drive_is_in_one_class_of_the_distribution(left: list[float | None]) -> None:
    which = conditions(MACHINE, ())
    came = outcome(which, [made(seed, one) for seed, one in enumerate(left)])
    counts, edges = came.within.counts, came.edges_m
    assert sum(counts) == len(left) and len(counts) == len(edges) + 1
    assert np.allclose(np.diff(edges), CLASS_M) and 0.0 in edges and min(edges) < 0.0
    below = sum(count for count, edge in zip(counts, edges, strict=False) if edge <= 0.0)
    assert below == came.within.below
    assert counts[-1] == sum(one is None or one >= 0.5 for one in left)


def test_the_order_of_drives_does_not_matter_and_json_keeps_them(by_linear: list[Driven], linear: Driver) -> None:
    there = [Driven.of_plain(json.loads(json.dumps(one.plain(), allow_nan=False))) for one in by_linear]
    assert there == by_linear
    random.Random(1).shuffle(there)
    told = outcome(linear.conditions, there).as_json()
    assert told == outcome(linear.conditions, by_linear).as_json()
    assert certificate_id(told) == certificate_id({**json.loads(json.dumps(told)), "id": "x"})
    other = [replace(by_linear[0], motion=by_linear[0].motion + 1e-9), *by_linear[1:]]
    assert outcome(linear.conditions, other).as_json()["results_sha256"] != told["results_sha256"]


def test_a_guard_that_does_not_know_how_a_machine_stops_does_not_pass(
    by_linear: list[Driven], linear: Driver
) -> None:
    came = outcome(linear.conditions, by_linear)
    assert not came.passed and came.within.drives == 6 and came.beyond.drives == 2
    assert came.within.below > 0 and came.compared is None
    for one in by_linear:
        assert 0.0 <= sum(each.seconds for each in one.held) <= one.levers_s <= 4.0 + 1e-9
    assert came.within.held_s > 0.5
    assert any(sum(row.counts) == row.drives > 0 for _, _, row in came.by_place)


def test_a_journal_cut_off_goes_on_and_another_ones_is_refused(
    linear: Driver, by_linear: list[Driven], tmp_path: Path
) -> None:
    path, of = tmp_path / "deep" / "drives.jsonl", fingerprint(linear, 0)
    first = Journal(path, of)
    todo = tasks(linear.conditions, 6, 0)
    for task, one in zip(todo[:3], by_linear[:3], strict=True):
        first.append(task, one)
    path.write_bytes(path.read_bytes()[:-40])
    again = Journal(path, of)
    assert again.known == dict(zip(todo[:2], by_linear[:2], strict=True))
    again.append(todo[2], by_linear[2])
    assert Journal(path, of).known == dict(zip(todo[:3], by_linear[:3], strict=True))
    kept = path.read_bytes()
    other = json.loads(json.dumps(of))
    other["machine"]["sha256"], other["seed"] = "0" * 64, 1
    with pytest.raises(InputError, match=r"another certificate.*machine, seed"):
        Journal(path, other)
    assert path.read_bytes() == kept
    for content in (b"hello\n", b"{}\n", b"[1]\n", b'{"journal": 3, "of": {}}\n', b"\xff\xfe\n"):
        path.write_bytes(content)
        with pytest.raises(InputError, match="no journal"):
            Journal(path, of)
        assert path.read_bytes() == content
    with pytest.raises(InputError, match="cannot be read"):
        Journal(tmp_path, of)


def test_a_journal_cut_within_its_first_line_begins_anew(linear: Driver, tmp_path: Path) -> None:
    path, of = tmp_path / "drives.jsonl", fingerprint(linear, 0)
    path.write_bytes(b"")
    assert Journal(path, of).known == {}
    assert Journal(path, of).known == {} and len(path.read_text().splitlines()) == 1


def test_the_fingerprint_is_of_everything_that_makes_other_drives(linear: Driver, tmp_path: Path) -> None:
    of = fingerprint(linear, 0)
    assert of == fingerprint(Driver(LINEAR), 0) and json.loads(json.dumps(of)) == of
    machine = tmp_path / "rre20.yaml"
    machine.write_text(description_path("rre20").read_text("utf-8").replace("dead_time_s: 0.25", "dead_time_s: 0.6"))
    site = tmp_path / Path(SITE[0]).name
    site.write_bytes(Path(SITE[0]).read_bytes() + b"\n")
    for subject, words in (
        (replace(LINEAR, machine=str(machine)), ["machine"]),
        (replace(LINEAR, site_files=(str(site), *SITE[1:])), ["site"]),
        (
            replace(LINEAR, rules="germany", guard="barrier", seconds=5.0),
            ["rule book", "guard", "settings of the drives"],
        ),
    ):
        assert differences(of, fingerprint(Driver(subject), 0)) == words
    assert differences(of, fingerprint(linear, 7)) == ["seed"]
    assert differences(of, fingerprint(Driver(replace(LINEAR, delays_s=(0.7,))), 0)) == []


def test_where_the_guard_is_slower_than_linear_is_told(linear: Driver) -> None:
    which = linear.conditions
    came = outcome(
        which,
        [made(0, linear=Linear(2.0, True), held=(Held("track", "boom", 0.5),)), made(5, linear=Linear(8.0, False))],
    )
    told = came.as_json()
    assert told["linear"] == {"drives": 2, "motion_ratio": 0.2, "held": 1, "held_motion_ratio": 0.5}
    assert told["time_lost_share"] == pytest.approx(0.5 / 8.0) and told["motion_share"] == 0.5
    assert told["places"][0]["time_lost_s"] == 0.5
    assert Task("tolerance", 0) == tasks(which, 1, 0)[0]
