"""What a tick may command, rolled out: the way to rest, what commands change of it, what the joints' ends leave."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.guard.api import GuardInput
from workgauge.guard.plan import MINUS, NONE, PLUS, WISH, Plan, flown
from workgauge.machine.arm import arm_of
from workgauge.machine.load import load_machine
from workgauge.machine.rollout import Rollout
from workgauge.machine.stopping import StoppingModel
from workgauge.proximity.scene import Scene
from workgauge.values.arrays import frozen_ints

DT = 0.02
MACHINE = load_machine("rre20")
N = MACHINE.n
FULL = np.stack([MACHINE.speed_positive, MACHINE.speed_negative])
FARTHEST = arm_of(MACHINE).farthest
SPACING, BEND, CUSHION, ALPHA = 0.15, 0.00125, 0.07, 0.13
seeds = st.integers(0, 2**32 - 1)


def rolled(rng, tolerance):
    """A roll-out of joints that all stop in their own ways."""
    dead = rng.choice([0.0, 0.1, 0.3], (2, N)) * rng.uniform(0.6, 1.4, (2, N))
    lag = rng.choice([0.0, 0.2], (2, N)) * rng.uniform(0.6, 1.4, (2, N))
    rate = FULL / rng.uniform(0.2, 1.0, (2, N))
    return Rollout(StoppingModel(dead, lag, rate, np.full((2, N), tolerance)), DT, FULL[0], FULL[1])


def wished(rng):
    share = rng.uniform(-1.0, 1.0, N) * rng.choice([0.0, 1.0, 1.0], N)
    return np.where(share > 0.0, share * FULL[0], share * FULL[1])


def asked(q, tool_rates=None):
    clearances = Scene(replace(MACHINE, self_pairs=()), []).query(MACHINE.forward(MACHINE.home), np.eye(4), 1.0)
    return GuardInput(
        desired=np.zeros(N),
        q=q,
        q_min=MACHINE.q_min,
        q_max=MACHINE.q_max,
        speed_positive=FULL[0],
        speed_negative=FULL[1],
        clearances=clearances,
        rows=np.zeros((0, N)),
        dt_s=DT,
        joint_names=MACHINE.joint_names,
        exclusive_groups=(),
        tool_rates=tool_rates,
    )


def planned(rng, tolerance=0.3, ticks=None):
    """A plan of a machine in motion, its wish, posture and roll-out."""
    rollout, memory, sent = rolled(rng, tolerance), {}, np.zeros(N)
    for _ in range(int(rng.integers(0, 40)) if ticks is None else ticks):
        if rng.random() < 0.2:
            sent = wished(rng)
        memory = flown(rollout, sent, DT, memory).plain()
    flight = flown(rollout, sent, DT, memory)
    q = MACHINE.sample_min + rng.random(N) * (MACHINE.sample_max - MACHINE.sample_min)
    wish = wished(rng)
    facts = {"spacing_m": SPACING, "bend_m": BEND, "farthest": FARTHEST, "cushion": CUSHION, "alpha": ALPHA}
    plan = Plan(rollout, asked(q, rng.normal(size=(3, N))), flight, np.zeros((2, N)), wish, **facts)
    return plan, wish, q, rollout, flight.speeds, flight.flying


@settings(max_examples=60, deadline=None)
@given(seed=seeds, tolerance=st.sampled_from([0.0, 0.3]))
def test_the_way_is_where_the_roll_out_says_and_nothing_passes_an_end(seed, tolerance):
    plan, _, q, rollout, speeds, flying = planned(np.random.default_rng(seed), tolerance)
    way = plan.way
    low, high = (one[0] for one in rollout.displacements(speeds, flying, np.zeros((1, N))))
    assert (way.postures + way.widths <= np.maximum(MACHINE.q_max, q) + 1e-12).all()
    assert (way.postures - way.widths >= np.minimum(MACHINE.q_min, q) - 1e-12).all()
    assert (np.diff(way.times) > 0.0).all() and (way.widths >= 0.0).all()
    moments = {round(t, 9): m for m, t in enumerate(np.minimum(rollout.marks, rollout.rest_ticks) * DT)}
    for posture, width, t in zip(way.postures, way.widths, way.times, strict=True):
        m = moments[round(t, 9)]
        inside = (q + high[m] < MACHINE.q_max) & (q + low[m] > MACHINE.q_min)
        assert (posture + width)[inside] == pytest.approx((q + high[m])[inside])
        assert (posture - width)[inside] == pytest.approx((q + low[m])[inside])
    assert way.times[-1] == pytest.approx(rollout.rest_ticks * DT)


@settings(max_examples=40, deadline=None)
@given(seed=seeds)
def test_no_command_changes_nothing_and_every_other_no_more_than_the_reach(seed):
    rng = np.random.default_rng(seed)
    plan, wish, _, _, _, _ = planned(rng)
    same = plan.way_after(np.zeros(N))
    assert same.postures == pytest.approx(plan.way.postures) and same.widths == pytest.approx(plan.way.widths)
    after = plan.way_after(wish)
    change = np.abs(after.postures - plan.way.postures) + np.abs(after.widths - plan.way.widths)
    assert (change <= plan.reach[0] + 1e-12).all()
    for j in range(N):
        for speed in (FULL[0, j], -FULL[1, j]):
            one = np.zeros(N)
            one[j] = speed * float(rng.uniform(0.2, 1.0))
            after = plan.way_after(one)
            change = np.abs(after.postures - plan.way.postures) + np.abs(after.widths - plan.way.widths)
            assert (change[:, j] <= plan.reach[1 + j, j] + 1e-12).all()
            assert not np.delete(change, j, axis=1).any()
    assert plan.reach.shape == (1 + N + 3, N)


@settings(max_examples=40, deadline=None)
@given(seed=seeds)
def test_changes_are_what_the_commands_do_to_the_least_along_a_row(seed):
    rng = np.random.default_rng(seed)
    plan, wish, _, _, _, _ = planned(rng)
    count = 12
    rows: Any = SimpleNamespace(
        rows=rng.normal(size=(count, N)),
        postures=frozen_ints(rng.integers(0, len(plan.way.times), count)),
        inside=rng.random(count) < 0.3,
    )
    changes = plan.changes(rows)
    assert changes.shape == (4, 2 * count, N) and not changes[NONE].any()
    for which, command in ((WISH, wish), (PLUS, FULL[0]), (MINUS, -FULL[1])):
        after = plan.way_after(command)
        for r in range(count):
            p, g = int(rows.postures[r]), rows.rows[r]
            middle, width = after.postures[p] - plan.way.postures[p], after.widths[p] - plan.way.widths[p]
            lost = np.abs(g) * width * (not rows.inside[r])  # inside, the middle posture's way out counts
            whole, size = g * middle - lost, np.abs(middle) + np.abs(width)
            share = np.minimum(np.abs(command) * DT / np.where(size > 0.0, size, 1.0), 1.0)
            assert changes[which, count + r] == pytest.approx(whole, abs=1e-12)
            assert changes[which, r] == pytest.approx(np.where(size > 0.0, share, 1.0) * whole, abs=1e-12)


@settings(max_examples=60, deadline=None)
@given(seed=seeds)
def test_ends_are_shares_and_leave_the_last_of_a_joints_room(seed):
    rng = np.random.default_rng(seed)
    plan, wish, q, rollout, speeds, flying = planned(rng)
    ends = plan.ends
    assert ends.shape == (4, N) and (ends >= 0.0).all() and (ends <= 1.0).all() and (ends[NONE] == 1.0).all()
    rest = rollout.displacements(speeds, flying, np.stack([np.zeros(N), wish * ends[WISH]]))
    before, after = (np.stack([rest[0][c, -1], rest[1][c, -1]]) + q for c in (0, 1))
    up, down = wish > 0.0, wish < 0.0
    assert (after[1] <= np.maximum(MACHINE.q_max, before[1]) + 1e-9)[up].all()
    assert (after[0] >= np.minimum(MACHINE.q_min, before[0]) - 1e-9)[down].all()
    assert (ends[WISH][wish == 0.0] == 1.0).all()


@settings(max_examples=40, deadline=None)
@given(seed=seeds)
def test_memory_of_another_model_or_none_is_a_machine_at_rest(seed):
    rng = np.random.default_rng(seed)
    rollout, sent = rolled(rng, 0.3), wished(rng)
    fresh = flown(rollout, sent, DT, {})
    for memory in ({"speeds": np.ones((5, 2)), "flying": np.ones((3, 2))}, {"speeds": np.ones((2, N))[:1]}):
        other = flown(rollout, sent, DT, memory)
        for name in ("speeds", "flying", "ways"):
            assert np.array_equal(getattr(fresh, name), getattr(other, name))
    assert np.array_equal(fresh.flying[-1], sent) and not fresh.flying[:-1].any()
    still = flown(rollout, None, DT, {})
    assert not still.speeds.any() and not still.flying.any() and not still.ways.any()


@settings(max_examples=40, deadline=None)
@given(seed=seeds, age=st.floats(0.0, 0.25))
def test_where_a_joint_went_since_it_was_measured_is_bounded(seed, age):
    """Rolled out from then, the way to now lies within what is known of the last ticks; longer ago nobody knows."""
    rng = np.random.default_rng(seed)
    rollout, memory, sent = rolled(rng, 0.3), {}, np.zeros(N)
    ways = []
    for _ in range(30):
        if rng.random() < 0.2:
            sent = wished(rng)
        flight = flown(rollout, sent, DT, memory)
        memory = flight.plain()
        ways.append(flight.ways[-1])
    since = flight.since(age / DT)
    whole = int(np.ceil(age / DT - 1e-6))
    for count in {max(whole - 1, 0), max(whole, 0)}:
        made = np.sum(ways[len(ways) - count :], axis=0) if count else np.zeros((2, N))
        assert (since[0] <= made[0] + 1e-12).all() and (since[1] >= made[1] - 1e-12).all()
    assert (np.array(ways)[:, 0] <= np.array(ways)[:, 1]).all()
    assert flight.since(0.5 / DT) is None
