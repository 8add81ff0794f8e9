"""The barrier guard on real scenes, before simulated hydraulics: the laws it promises an operator and a bystander."""

import functools
import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from workgauge.guard.api import GuardInput
from workgauge.guard.barrier import BarrierGuard
from workgauge.machine.load import load_machine
from workgauge.machine.parts import Stopping
from workgauge.proximity.protection import Integrity, with_protection
from workgauge.proximity.scene import Scene
from workgauge.proximity.surroundings import Surroundings
from workgauge.proximity.uncertainty import MachineUncertainty
from workgauge.sim.hydraulics import Hydraulics, HydraulicSpec
from workgauge.values import transforms as tf
from workgauge.values.arrays import frozen
from workgauge.values.errors import InputError
from workgauge.values.limits import Activity, Limit, LimitKind, Source
from workgauge.values.reasons import ReasonCode
from workgauge.values.solids import Box

DT = 0.02
STOP_M = 0.2
seeds = st.integers(0, 2**32 - 1)
names = st.sampled_from(["rre20", "brokk5"])


@functools.cache
def machine_of(name, dead=0.0, lag=0.0, stop_s=0.0, tolerance=0.0, ratio=1.0, pump=False):
    """A machine of the catalogue whose joints stop like this, alike or up to `ratio` apart."""
    machine = load_machine(name)
    rng = np.random.default_rng(7)
    factors = ratio ** rng.uniform(-0.5, 0.5, (3, 2, machine.n))

    def side(which, speeds):
        stops = []
        for j, speed in enumerate(speeds.tolist()):
            a, b, c = factors[:, which, j].tolist()
            stops.append(Stopping(dead * a, lag * b, speed / stop_s * c if stop_s else math.inf, tolerance))
        return tuple(stops)

    return replace(
        machine,
        stopping_positive=side(0, machine.speed_positive),
        stopping_negative=side(1, machine.speed_negative),
        pump=machine.pump if pump else None,
    )


def limit(name, solid, **facts):
    return Limit(name, LimitKind.ZONE, name, solid, "test", Source("test", name), **facts)


def box(place, half, turn=(0.0, 0.0, 0.0)):
    T = np.array(tf.translation(*place))
    T[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    return Box(frozen(T), frozen(half))


def random_limits(rng, machine, q, near=0.0, count=3):
    """Boxes near random points of the arm, so far from its boxes or so deep in them as `near` says [m]."""
    poses, halves = machine.solid_poses(machine.forward(q))
    found = []
    for i in range(count):
        s = int(rng.integers(1, len(poses)))
        way = rng.normal(size=3)
        way /= np.linalg.norm(way)
        size = rng.uniform(0.1, 1.0, 3)
        away = float(halves[s].min() + size.min() + rng.uniform(-near, 3.0))
        found.append(limit(f"l{i}", box(poses[s][:3, 3] + away * way, size, rng.normal(size=3))))
    return found


def posture(rng, machine):
    share = rng.uniform(0.05, 0.95, machine.n)
    return machine.sample_min + share * (machine.sample_max - machine.sample_min)


EXACT = Integrity(5.33)


def seen(scene, q, T=None, now_ns=0, off_states=frozenset()):
    """Clearances, rows and surroundings as the tick makes them, everything exactly known."""
    machine, T = scene.machine, np.eye(4) if T is None else T
    kin = machine.forward(q)
    found = scene.query(kin, T, 4.0, now_ns, off_states)
    rows = machine.distance_rows(kin, T, found)
    unsure = MachineUncertainty.of(np.zeros((6, 6)), np.zeros(machine.n))
    found, largest = with_protection(found, rows, kin, machine, T, unsure, scene.uncertainty, EXACT)
    return found, rows, Surroundings(scene, T, unsure, EXACT, largest, now_ns, off_states)


def question(scene, q, wish, *, sent=None, T=None, off_states=frozenset(), **facts):
    machine = scene.machine
    found, rows, around = seen(scene, q, T, off_states=off_states)
    values: dict[str, Any] = {
        "desired": np.asarray(wish, dtype=float),
        "q": np.asarray(q, dtype=float),
        "q_min": machine.q_min,
        "q_max": machine.q_max,
        "speed_positive": machine.speed_positive,
        "speed_negative": machine.speed_negative,
        "clearances": found,
        "rows": rows,
        "dt_s": DT,
        "joint_names": machine.joint_names,
        "exclusive_groups": machine.exclusive_groups,
        "sent": sent,
        "elapsed_s": DT,
        "around": around,
        **facts,
    }
    return GuardInput(**values)


def full_lever(rng, machine):
    """Every joint at a random share of its speed, some of them not at all."""
    share = rng.uniform(-1.0, 1.0, machine.n) * rng.choice([0.0, 1.0, 1.0], machine.n)
    return np.where(share > 0.0, share * machine.speed_positive, share * machine.speed_negative)


def in_flight(rng, machine, guard, ticks):
    """A memory after so many ticks of random commands, and the last of them."""
    memory, sent = guard.start(), np.zeros(machine.n)
    for _ in range(ticks):
        if rng.random() < 0.2:
            sent = full_lever(rng, machine)
        memory = guard.idle(sent, machine, DT, DT, memory)
    return memory, sent


DYNAMICS = st.sampled_from([(), (0.3, 0.2, 0.6), (0.3, 0.2, 0.6, 0.3, 3.0), (1.3, 0.2, 0.6, 0.3)])


@settings(max_examples=40, deadline=None)
@given(seed=seeds, name=names, dynamics=DYNAMICS, keep=st.booleans())
def test_a_joint_is_never_moved_unasked_nor_reversed_nor_made_faster(seed, name, dynamics, keep):
    rng, guard = np.random.default_rng(seed), BarrierGuard()
    machine = machine_of(name, *dynamics)
    q = posture(rng, machine)
    scene = Scene(machine, random_limits(rng, machine, q, near=0.6))
    memory, sent = in_flight(rng, machine, guard, int(rng.integers(0, 40)))
    wish = full_lever(rng, machine) * rng.choice([1.0, 1.5])
    case = question(scene, q, wish, sent=sent, keep_direction=keep)
    result, _ = guard.allow(case, memory)
    allowed = result.allowed
    assert (allowed * wish >= 0.0).all() and (np.abs(allowed) <= np.abs(wish) * (1 + 1e-12)).all()
    assert not allowed[wish == 0.0].any() and not allowed.flags.writeable
    assert (allowed <= machine.speed_positive * (1 + 1e-9)).all()
    assert (allowed >= -machine.speed_negative * (1 + 1e-9)).all()
    assert 0.0 <= result.scale <= 1.0
    if not np.array_equal(allowed, wish):
        assert result.reasons
    groups = [group for group in machine.exclusive_groups if allowed[list(group)].any()]
    assert len(groups) <= 1
    if keep and allowed.any() and not machine.exclusive_groups:
        moving = wish != 0.0
        shares = allowed[moving] / wish[moving]
        assert np.ptp(shares) < 1e-9


@settings(max_examples=20, deadline=None)
@given(seed=seeds, name=names, dynamics=DYNAMICS)
def test_no_wish_is_no_command_and_needs_no_reason(seed, name, dynamics):
    rng, guard = np.random.default_rng(seed), BarrierGuard()
    machine = machine_of(name, *dynamics)
    q = posture(rng, machine)
    scene = Scene(machine, random_limits(rng, machine, q, near=0.6))
    memory, sent = in_flight(rng, machine, guard, 20)
    result, _ = guard.allow(question(scene, q, np.zeros(machine.n), sent=sent), memory)
    assert not result.allowed.any() and result.reasons == () and result.scale == 1.0


def grows(scene, q, velocity, seconds):
    """Whether a motion lessens no clearance to any limit nearer than 3 m, its own links apart, at any moment."""
    before, _, _ = seen(scene, q)
    for k in range(1, 6):
        after, _, _ = seen(scene, q + velocity * seconds * k / 5)
        pairs = dict(
            zip(zip(after.solids.tolist(), after.limits.tolist(), strict=True), after.distances, strict=True)
        )
        for one in zip(before.solids.tolist(), before.limits.tolist(), before.distances.tolist(), strict=True):
            if one[2] < 3.0 and pairs.get(one[:2], math.inf) < one[2] - 1e-9:
                return False
        before = after
    return True


@settings(max_examples=60, deadline=None)
@given(seed=seeds, name=names, dynamics=st.sampled_from([(), (0.3, 0.2, 0.6), (0.3, 0.2, 0.6, 0.3, 3.0)]))
@example(seed=107525, name="brokk5", dynamics=(0.3, 0.2, 0.6))  # along a face, away from it to second order only
def test_backing_away_from_everything_is_free(seed, name, dynamics):
    """One lever by itself, or on a machine that follows at once any of them; but for the joints' own ends."""
    rng, guard = np.random.default_rng(seed), BarrierGuard()
    machine = machine_of(name, *dynamics)
    machine = replace(machine, self_pairs=(), exclusive_groups=())
    q = machine.sample_min + 0.5 * (machine.sample_max - machine.sample_min) + rng.normal(size=machine.n) * 0.1
    scene = Scene(machine, random_limits(rng, machine, q, count=int(rng.integers(1, 3))))
    if violated(scene, q)[0]:
        return
    for _ in range(6):
        wish = full_lever(rng, machine)
        if dynamics:
            one = int(rng.integers(machine.n))
            wish = np.where(np.arange(machine.n) == one, wish, 0.0)
        if wish.any() and grows(scene, q, wish, 0.02 if not dynamics else 0.3):
            case = question(scene, q, wish)
            result, _ = guard.allow(case, guard.start())
            if any(reason.code is ReasonCode.JOINT_END for reason in result.reasons):
                continue
            assert np.array_equal(result.allowed, wish) and result.reasons == ()


def leading_out(seed, name, dynamics):
    """Wishes that make every clearance grow inside limits: what each was, and what the guard says of it."""
    rng, guard = np.random.default_rng(seed), BarrierGuard()
    machine = replace(machine_of(name, *dynamics), self_pairs=(), exclusive_groups=())
    q = machine.sample_min + 0.5 * (machine.sample_max - machine.sample_min) + rng.normal(size=machine.n) * 0.1
    scene = Scene(machine, random_limits(rng, machine, q, near=0.5, count=int(rng.integers(1, 3))))
    for _ in range(6):
        wish = full_lever(rng, machine)
        if dynamics:
            wish = np.where(np.arange(machine.n) == int(rng.integers(machine.n)), wish, 0.0)
        if wish.any() and grows(scene, q, wish, DT) and grows(scene, q, wish, 0.3 if dynamics else DT):
            result, _ = guard.allow(question(scene, q, wish), guard.start())
            if not any(reason.code is ReasonCode.JOINT_END for reason in result.reasons):
                yield wish, result


@settings(max_examples=40, deadline=None)
@given(seed=seeds, name=names, dynamics=st.sampled_from([(), (0.3, 0.2, 0.6)]))
def test_inside_a_limit_what_makes_every_clearance_grow_is_free(seed, name, dynamics):
    for wish, result in leading_out(seed, name, dynamics):
        assert np.array_equal(result.allowed, wish) and result.reasons == ()


def test_inside_a_limit_what_makes_every_clearance_grow_is_free_for_many_fixed_ones():
    """Enough of them that the law above is not about nothing."""
    count = 0
    for seed in range(60):
        name, dynamics = ("rre20", "brokk5")[seed % 2], ((), (0.3, 0.2, 0.6))[seed // 2 % 2]
        for wish, result in leading_out(seed, name, dynamics):
            assert np.array_equal(result.allowed, wish) and result.reasons == (), seed
            count += 1
    assert count >= 50


class Loop:
    """A guard before simulated hydraulics: what it allows is sent."""

    def __init__(self, scene, q, spec=None, guard=None):
        self.scene, self.guard, self.machine = scene, guard or BarrierGuard(), scene.machine
        self.q, self.sent, self.memory = np.array(q, dtype=float), np.zeros(scene.machine.n), {}
        spec = spec or HydraulicSpec.of_machine(self.machine)
        full = np.stack([self.machine.speed_positive, self.machine.speed_negative])
        self.plant = Hydraulics(replace(spec, cylinders=(), full_speed=full), DT)
        self.full = full

    def tick(self, wish, **facts):
        """One tick; returns what the guard said."""
        case = question(self.scene, self.q, wish, sent=self.sent, **facts)
        result, self.memory = self.guard.allow(case, self.memory)
        self.sent = result.allowed
        self.q = self.q + self.plant.advance(
            np.where(self.sent > 0, self.sent / self.full[0], self.sent / self.full[1])
        )
        return result

    def worst(self):
        """The least distance above the stop distance of any limit or own link now."""
        found = self.scene.query(self.machine.forward(self.q), np.eye(4), 3.0)
        stops = np.where(np.isnan(found.stop_distances), STOP_M, found.stop_distances)
        return float((found.distances - stops).min(initial=3.0))


def clear_of_everything(rng, machine, limits_of, tries=60):
    """A posture and limits, without those that are nearer than a little more than their stop distance."""
    for _ in range(tries):
        q = posture(rng, machine)
        limits = limits_of(q)
        found = Scene(machine, limits).query(machine.forward(q), np.eye(4), 3.0)
        near = set(found.limits[found.distances < STOP_M + 0.05].tolist())
        own = found.distances - np.where(np.isnan(found.stop_distances), STOP_M, found.stop_distances)
        if own[found.other_links >= 0].min(initial=1.0) > 0.05 and len(near) < len(limits):
            return q, Scene(machine, [one for i, one in enumerate(limits) if i not in near])
    raise AssertionError("no posture is clear")


@settings(max_examples=16, deadline=None)
@given(
    seed=seeds,
    name=names,
    dynamics=st.sampled_from([(), (0.1, 0.2, 0.3), (0.3, 0.2, 0.6, 0.0, 3.0), (0.3, 0.2, 0.6, 0.3, 3.0)]),
)
def test_no_limit_is_entered_at_full_lever_by_any_machine_within_tolerance(seed, name, dynamics):
    rng = np.random.default_rng(seed)
    machine = machine_of(name, *dynamics)
    q, scene = clear_of_everything(rng, machine, lambda q: random_limits(rng, machine, q, count=8))
    tolerance = dynamics[3] if len(dynamics) > 3 else 0.0
    spec = HydraulicSpec.of_machine(machine).varied(seed, tolerance, at_the_ends=bool(rng.random() < 0.5))
    loop, worst = Loop(scene, q, spec), math.inf
    lever = full_lever(rng, machine)
    for i in range(75):
        if i % 25 == 24:
            lever = full_lever(rng, machine)
        loop.tick(lever)
        worst = min(worst, loop.worst())
    assert worst > -1e-6
    for _ in range(40):
        loop.tick(np.zeros(machine.n))
        worst = min(worst, loop.worst())
    assert worst > -1e-6


@settings(max_examples=12, deadline=None)
@given(
    seed=seeds, dynamics=st.sampled_from([(), (0.3, 0.2, 0.6, 0.3), (0.3, 0.2, 0.6, 0.3, 3.0), (0.1, 0.0, 0.0, 0.5)])
)
def test_no_joint_passes_its_end(seed, dynamics):
    rng = np.random.default_rng(seed)
    machine = machine_of("brokk5", *dynamics)
    machine = replace(machine, self_pairs=(), exclusive_groups=())
    tolerance = dynamics[3] if len(dynamics) > 3 else 0.0
    spec = HydraulicSpec.of_machine(machine).varied(seed, tolerance, at_the_ends=True)
    loop = Loop(Scene(machine, []), posture(rng, machine), spec)
    reached = False
    for i in range(300):
        if i % 75 == 0:
            lever = np.where(rng.random(machine.n) < 0.5, machine.speed_positive, -machine.speed_negative)
        result = loop.tick(lever)
        reached = reached or any(reason.code is ReasonCode.JOINT_END for reason in result.reasons)
        assert (loop.q <= machine.q_max + 1e-6).all() and (loop.q >= machine.q_min - 1e-6).all()
    assert reached


def pole_ahead(machine, away):
    """A pole so far before the tool of a machine at home [m]."""
    tool = machine.tool_pose(machine.forward(machine.home))[:3, 3]
    reach = max(
        (T[:3, :3] * halves).sum(axis=1)[0] + T[0, 3]
        for T, halves in zip(*machine.solid_poses(machine.forward(machine.home)), strict=True)
    )
    return limit("pole", box((max(reach, tool[0]) + away + 0.2, 0.0, 2.5), (0.15, 0.15, 6.0)))


@pytest.mark.parametrize("dynamics", [(), (0.3, 0.2, 0.6)])
def test_the_approach_ends_at_the_stop_distance_and_says_so(dynamics):
    machine = machine_of("rre20", *dynamics)
    scene = Scene(machine, [pole_ahead(machine, 1.0)])
    loop = Loop(scene, machine.home)
    kin = machine.forward(machine.home)
    found = scene.query(kin, np.eye(4), 4.0)
    rows = machine.distance_rows(kin, np.eye(4), found)
    nearest = int(np.flatnonzero(found.limits == 0)[np.argmin(found.distances[found.limits == 0])])
    j = int(np.argmax(np.abs(rows[nearest])))
    wish = np.zeros(machine.n)
    wish[j] = -0.5 * np.sign(rows[nearest, j]) * machine.speed_positive[j]
    said = []
    for _ in range(500):
        result = loop.tick(wish)
        said = result.reasons or said
    now, _, _ = seen(scene, loop.q)
    reason = said[0]
    if reason.code is ReasonCode.JOINT_END:
        pytest.skip("the joint ends before the pole")
    least = float(now.distances[now.limits == 0].min())
    assert STOP_M <= least <= STOP_M + 0.02
    assert reason.code is ReasonCode.LIMIT_REACHED and reason.limit == "pole" and reason.link in machine.link_names
    assert reason.clearance_m == pytest.approx(least, abs=0.01) and f"{least:.2f} m" in reason.text
    assert reason.link in reason.text and reason.stop_distance_m == STOP_M
    back = loop.tick(-wish)
    assert np.array_equal(back.allowed, -wish) and back.reasons == ()


@settings(max_examples=40, deadline=None)
@given(seed=seeds, name=names, dynamics=DYNAMICS)
def test_an_end_of_a_levers_range_passes_and_more_does_not(seed, name, dynamics):
    rng, guard = np.random.default_rng(seed), BarrierGuard()
    machine = machine_of(name, *dynamics)
    q, scene = clear_of_everything(rng, machine, lambda q: random_limits(rng, machine, q, count=8))
    rates = np.zeros((3, machine.n))
    first, _ = guard.allow(question(scene, q, np.zeros(machine.n), tool_rates=rates), guard.start())
    assert first.ranges is not None
    for j in range(machine.n):
        for end, speed in (
            (first.ranges.joints_high[j], machine.speed_positive[j]),
            (first.ranges.joints_low[j], -machine.speed_negative[j]),
        ):
            assert abs(end) <= abs(speed) * (1 + 1e-12) and end * speed >= 0.0
            wish = np.zeros(machine.n)
            wish[j] = end * (1 - 1e-9)
            result, _ = guard.allow(question(scene, q, wish), guard.start())
            # proportional to within what rolling out anew shows: then a half is left, or less
            assert result.allowed[j] == pytest.approx(wish[j], rel=1e-6) or dynamics
            wish[j] = 1.05 * end
            if 1e-6 < abs(wish[j]) < abs(speed):
                result, _ = guard.allow(question(scene, q, wish), guard.start())
                assert abs(result.allowed[j]) < abs(wish[j]) * 0.999 or dynamics


@settings(max_examples=20, deadline=None)
@given(seed=seeds, name=names)
def test_memory_survives_json_bit_for_bit(seed, name):
    rng, guard = np.random.default_rng(seed), BarrierGuard()
    machine = machine_of(name, 0.3, 0.2, 0.6, 0.3, 3.0)
    q = posture(rng, machine)
    scene = Scene(machine, random_limits(rng, machine, q))
    memory, sent = in_flight(rng, machine, guard, 15)
    plain = json.loads(json.dumps({k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in memory.items()}))
    for _ in range(3):
        case = question(scene, q, full_lever(rng, machine), sent=sent)
        first, memory = guard.allow(case, memory)
        second, plain = BarrierGuard().allow(case, plain)
        assert first.allowed.tobytes() == second.allowed.tobytes() and first.reasons == second.reasons
        assert set(memory) == set(plain)
        for key, value in memory.items():
            assert np.asarray(value).tobytes() == np.asarray(plain[key]).tobytes()
            assert not isinstance(value, np.ndarray) or not value.flags.writeable
        sent = first.allowed
        plain = json.loads(json.dumps({k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in plain.items()}))


@settings(max_examples=20, deadline=None)
@given(seed=seeds, missed=st.integers(1, 120))
def test_ticks_missed_are_ticks_flown(seed, missed):
    rng, guard = np.random.default_rng(seed), BarrierGuard()
    machine = machine_of("rre20", 0.3, 0.2, 0.6, 0.3, 3.0)
    memory, _ = in_flight(rng, machine, guard, 30)
    sent = full_lever(rng, machine)
    at_once, one_by_one = guard.idle(sent, machine, DT, missed * DT, memory), memory
    for _ in range(missed):
        one_by_one = guard.idle(sent, machine, DT, DT, one_by_one)
    assert np.asarray(at_once["speeds"]) == pytest.approx(np.asarray(one_by_one["speeds"]), abs=1e-9)
    assert np.array_equal(at_once["flying"], one_by_one["flying"])
    # a loop slower than its period loses no time, one that stutters gains none
    slow, total = memory, 0.0
    for _ in range(40):
        took = DT * float(rng.uniform(0.7, 2.5))
        total += took
        slow = guard.idle(sent, machine, DT, took, slow)
    steady = memory
    for _ in range(round(total / DT)):
        steady = guard.idle(sent, machine, DT, DT, steady)
    # to within the tick that may not be counted yet
    close = np.stack([machine.speed_positive, machine.speed_negative]).max(axis=0) * 0.15
    assert (np.abs(np.asarray(slow["speeds"]) - np.asarray(steady["speeds"])) <= close).all()


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e300])
def test_numbers_nobody_can_judge_stop_everything_and_what_flies_goes_on(bad):
    guard, machine = BarrierGuard(), machine_of("rre20", 0.3, 0.2, 0.6)
    scene = Scene(machine, [pole_ahead(machine, 1.0)])
    full = np.array(machine.speed_positive)
    memory = guard.start()
    for _ in range(30):
        memory = guard.idle(full, machine, DT, DT, memory)
    for case in (
        question(scene, machine.home, np.full(machine.n, bad), sent=full),
        replace(question(scene, machine.home, full, sent=full), q=np.full(machine.n, bad)),
        replace(question(scene, machine.home, full, sent=full), desired=full[:2]),
        replace(question(scene, machine.home, full, sent=full), rows=np.zeros((1, 1))),
    ):
        result, after = guard.allow(case, memory)
        assert not result.allowed.any() and result.scale == 0.0
        assert [reason.code for reason in result.reasons] == [ReasonCode.INVALID_VALUE]
        assert np.array_equal(after["speeds"], guard.idle(full, machine, DT, DT, memory)["speeds"])
    blind, after = guard.allow(replace(question(scene, machine.home, full), around=None), memory)
    assert not blind.allowed.any() and [reason.code for reason in blind.reasons] == [ReasonCode.INVALID_VALUE]
    assert np.asarray(after["speeds"]).any()


@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_joints_together_ask_for_no_more_flow_than_the_pump_gives(seed):
    rng, guard = np.random.default_rng(seed), BarrierGuard()
    machine = machine_of("rre20", pump=True)
    q = posture(rng, machine)
    wish = full_lever(rng, machine)
    result, _ = guard.allow(question(Scene(machine, []), q, wish), guard.start())
    pump = machine.pump
    shares = np.where(
        result.allowed > 0, result.allowed / machine.speed_positive, -result.allowed / machine.speed_negative
    )
    asked = float((shares * np.where(result.allowed > 0, pump.flow_positive, pump.flow_negative)).sum())
    assert asked <= pump.flow * (1 + 1e-6)
    if asked > 0.999 * pump.flow and not np.array_equal(result.allowed, wish):
        assert any(reason.code is ReasonCode.PUMP_FLOW for reason in result.reasons)


def violated(scene, q, off_states=frozenset()):
    """Distances of what has less than its stop distance now, by solid and limit."""
    found = scene.query(scene.machine.forward(q), np.eye(4), 3.0, off_states=off_states)
    least = {}
    for s, i, d in zip(found.solids.tolist(), found.limits.tolist(), found.distances, strict=True):
        least[s, i] = min(float(d), least.get((s, i), math.inf))
    return {pair: d for pair, d in least.items() if d < STOP_M - 1e-9}, least


@settings(max_examples=40, deadline=None)
@given(seed=seeds, name=names, what=st.sampled_from(["switched on", "jumped"]))
def test_what_suddenly_is_too_near_comes_no_nearer(seed, name, what):
    """On a machine that follows at once, nothing it is told to do shrinks what is violated."""
    rng, guard = np.random.default_rng(seed), BarrierGuard()
    machine = replace(machine_of(name), self_pairs=())
    q = posture(rng, machine)
    zones = [replace(one, activity=Activity(state="gate")) for one in random_limits(rng, machine, q, near=0.8)]
    scene = Scene(machine, zones)
    loop = Loop(scene, q, guard=guard)
    off = frozenset(["gate"])
    for _ in range(3):
        loop.tick(full_lever(rng, machine), off_states=off)
    if what == "jumped":
        moved = [
            replace(z, solid=box(z.solid.T_frame_box[:3, 3] + rng.normal(size=3) * 0.3, (0.4, 0.4, 0.4)))
            for z in zones
        ]
        loop.scene = Scene(machine, moved)
    for _ in range(4):
        before, _ = violated(loop.scene, loop.q)
        loop.tick(full_lever(rng, machine))
        _, after = violated(loop.scene, loop.q)
        for pair, d in before.items():
            assert after.get(pair, 3.0) >= d - 2e-3, pair


@settings(max_examples=25, deadline=None)
@given(seed=seeds, name=names, dynamics=DYNAMICS)
def test_nothing_is_kept_but_the_memory(seed, name, dynamics):
    """The same question and memory, asked of a guard and a scene made this moment, have the same answer."""
    rng, guard = np.random.default_rng(seed), BarrierGuard()
    machine = machine_of(name, *dynamics)
    q = posture(rng, machine)
    limits = random_limits(rng, machine, q, near=0.5)
    scene = Scene(machine, limits)
    for _ in range(3):  # elsewhere first: whatever a cache would hold
        guard.allow(question(scene, posture(rng, machine), full_lever(rng, machine)), guard.start())
    memory, sent = in_flight(rng, machine, guard, 10)
    wish = full_lever(rng, machine)
    first, _ = guard.allow(question(scene, q, wish, sent=sent), memory)
    second, _ = BarrierGuard().allow(question(Scene(machine, limits), q, wish, sent=sent), memory)
    assert first.allowed.tobytes() == second.allowed.tobytes()
    assert [r.text for r in first.reasons] == [r.text for r in second.reasons]


@pytest.mark.parametrize("speed", [0.2, 0.6])
def test_a_limit_on_its_way_here_holds_no_joint_that_leaves_and_stops_one_that_comes(speed):
    """Another machine comes towards an arm that stands: never a command towards it, away is free."""
    machine = replace(machine_of("rre20", 0.3, 0.2, 0.6), self_pairs=())
    pole = pole_ahead(machine, 1.2)
    twist = frozen([-speed, 0.0, 0.0, 0.0, 0.0, 0.0])
    kin = machine.forward(machine.home)
    found = Scene(machine, [pole]).query(kin, np.eye(4), 4.0)
    rows = machine.distance_rows(kin, np.eye(4), found)
    j = 1  # the boom: down brings all it carries nearer
    assert (rows[found.links > 1, j] > 0.0).all() or (rows[found.links > 1, j] < 0.0).all()
    towards = np.zeros(machine.n)
    towards[j] = -np.sign(rows[found.links > 1, j][0]) * machine.speed_positive[j] * 0.5
    guard, stood = BarrierGuard(), False
    for k in range(12):
        solid = Box(frozen(tf.translation(-0.1 * k, 0.0, 0.0) @ pole.solid.T_frame_box), pole.solid.half_extents)
        scene = Scene(machine, [replace(pole, solid=solid, velocity=twist)])
        result, _ = guard.allow(question(scene, machine.home, towards), guard.start())
        away, _ = guard.allow(question(scene, machine.home, -towards), guard.start())
        assert np.array_equal(away.allowed, -towards)
        still = Scene(machine, [replace(pole, solid=solid)])
        resting, _ = guard.allow(question(still, machine.home, towards), guard.start())
        assert abs(result.allowed[j]) <= abs(resting.allowed[j]) + 1e-9
        stood = stood or not result.allowed.any()
        if stood:
            assert not result.allowed.any()
    assert stood


def test_parameters_out_of_range_are_refused():
    for field in ("stop_distance_m", "ease_s", "margin_m", "cushion_s", "spacing_m"):
        with pytest.raises(InputError, match="out of range"):
            BarrierGuard(**{field: -1.0})
        with pytest.raises(InputError, match="out of range"):
            BarrierGuard(**{field: math.nan})
