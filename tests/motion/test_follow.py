"""Jobs done tick by tick, on joints late as their file says and simulated here by dead time and lag alone."""

import functools
import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.guard.registry import guard_named
from workgauge.loop.config import tick_config
from workgauge.loop.memory import first_memory, restored
from workgauge.machine.load import load_machine
from workgauge.machine.model import MachineModel
from workgauge.machine.parts import Stopping
from workgauge.motion.follow import Followed, followed, released
from workgauge.motion.job import Job, JobMemory, JobState
from workgauge.motion.paths.trajectory import Trajectory
from workgauge.motion.planning import Pace, plan_joints
from workgauge.motion.predict import InFlight, lateness, steadiest_1_s
from workgauge.motion.slide import Surround
from workgauge.motion.wish import FollowSettings
from workgauge.values.reasons import ReasonCode
from workgauge.values.tasks import Orientation, ToolGoal

DT = 0.02
HERE = np.eye(4)
MOVING = {JobState.MOVING, JobState.HELD}


def nothing(n: int) -> Surround:
    return Surround(np.zeros((0, n)), np.zeros(0), np.zeros((0, 3)), (), ())


@functools.cache
def machine_named(name: str) -> MachineModel:
    """A shipped machine whose joints know dead time and lag, but no limit of deceleration."""
    machine = load_machine(name)

    def plain(one: tuple[Stopping, ...]) -> tuple[Stopping, ...]:
        return tuple(replace(stopping, deceleration=1e6) for stopping in one)

    return replace(
        machine,
        stopping_positive=plain(machine.stopping_positive),
        stopping_negative=plain(machine.stopping_negative),
    )


@functools.cache
def motion_of(name: str) -> Trajectory:
    """One stretch of motion from home, as gentle as the machine's file asks for."""
    machine = load_machine(name)
    to = np.array(machine.home)
    group = machine.exclusive_groups[-1] if machine.exclusive_groups else range(machine.n)
    for k, j in enumerate(group):
        to[j] += (0.4, -0.3, 0.25)[k % 3]
    return plan_joints(machine, machine.home, to, Pace(share=0.6))[0].trajectory


class Joints:
    """Joints that follow commands late: dead time in whole ticks, then a lag, stepped exactly."""

    def __init__(self, machine: MachineModel, q: np.ndarray, slower: float = 1.0, blocked: bool = False) -> None:
        late = lateness(machine, DT)
        self.q, self.v, self.blocked = np.array(q), np.zeros(machine.n), blocked
        self.ticks = np.round(late.dead_s * slower / DT).astype(int)
        self.keep = np.where(late.lag_s > 0.0, np.exp(-DT / np.maximum(late.lag_s * slower, 1e-9)), 0.0)
        self.sent = [np.zeros(machine.n)] * (int(self.ticks.max()) + 1)

    def advance(self, command: np.ndarray) -> None:
        self.sent.append(command)
        acting = np.array([self.sent[-1 - count][j] for j, count in enumerate(self.ticks)])
        self.v = self.keep * self.v + (1.0 - self.keep) * acting
        if not self.blocked:
            self.q = self.q + DT * self.v


@dataclass
class Drive:
    rows: list[Followed]
    q: list[np.ndarray]
    memory: JobMemory

    @property
    def state(self) -> JobState:
        return self.rows[-1].facts.state


def drive(
    machine: MachineModel,
    job: Job,
    q: np.ndarray,
    seconds: float,
    *,
    joints: Joints | None = None,
    memory: JobMemory | None = None,
    share: Callable[[float], float] = lambda _: 1.0,
    settings: FollowSettings | None = None,
    through: Callable[[JobMemory], JobMemory] = lambda memory: memory,
    guarded: Callable[[np.ndarray], np.ndarray] = lambda velocity: velocity,
) -> Drive:
    """Do a job until it is over, or the time is."""
    joints, memory, sent = joints or Joints(machine, q), memory or JobMemory(), np.zeros(machine.n)
    rows, at = [], []
    for k in range(round(seconds / DT)):
        at.append(joints.q)
        done = followed(
            *(job, share(k * DT), machine.forward(joints.q), machine, HERE, nothing(machine.n), through(memory)),
            settings or FollowSettings(),
            sent=sent,
            dt_s=DT,
        )
        rows.append(done)
        memory, sent = done.memory, guarded(np.array(done.velocity))
        if done.facts.state not in MOVING:
            break
        joints.advance(sent)
    return Drive(rows, at, memory)


def along(name: str, **values: float) -> Job:
    return Job("along", trajectory=motion_of(name), **values)


def towards(name: str, **values: float) -> Job:
    machine = machine_named(name)
    q = motion_of(name).q[-1]
    counts = Orientation.PITCH if name == "brokk5" else Orientation.FULL
    return Job("goal", goal=ToolGoal(machine.tool_pose(machine.forward(q)), counts), **values)


@pytest.mark.parametrize("name", ["rre20", "brokk5"])
def test_a_trajectory_is_followed_by_late_joints(name):
    machine, job = machine_named(name), along(name)
    found = drive(machine, job, machine.home, 60.0)
    assert found.state is JobState.DONE
    late = lateness(machine, DT)
    times = np.linspace(0.0, job.trajectory.duration_s, 200)
    hardest = np.abs(job.trajectory.accelerations(times)).max(axis=0)
    levers = np.linalg.norm(machine.tool_jacobian(machine.forward(machine.home))[:3], axis=0)
    # a lag made up for by commanding so much earlier leaves half of its square times the acceleration
    assert max(row.facts.error_m for row in found.rows) < float(0.5 * late.lag_s**2 * hardest @ levers)
    whole = job.trajectory.duration_s + float((late.dead_s + late.lag_s).max())
    assert len(found.rows) * DT < whole + 1.5


@pytest.mark.parametrize("name", ["rre20", "brokk5"])
def test_joints_at_once_are_followed_to_a_millimetre(name):
    machine = machine_named(name)
    at_once = Joints(machine, machine.home)
    at_once.ticks[:], at_once.keep[:] = 0, 0.0
    plain = FollowSettings(compensate=False)
    found = drive(machine, along(name, tolerance_m=0.001), machine.home, 60.0, joints=at_once, settings=plain)
    assert found.state is JobState.DONE and max(row.facts.error_m for row in found.rows) < 1e-3


@pytest.mark.parametrize("name", ["rre20", "brokk5"])
def test_a_goal_is_reached_by_late_joints(name):
    machine = machine_named(name)
    found = drive(machine, towards(name), machine.home, 60.0)
    assert found.state is JobState.DONE
    assert found.rows[-1].facts.error_m <= 0.01 and found.rows[-1].facts.error_rad <= math.radians(0.5)


@pytest.mark.parametrize("name", ["rre20", "brokk5"])
@pytest.mark.parametrize("slower", [0.7, 1.3])
def test_dead_time_and_lag_as_wrong_as_the_file_allows_do_not_make_it_swing(name, slower):
    machine, job = machine_named(name), towards(name)
    joints = Joints(machine, machine.home, slower)
    found = drive(machine, job, machine.home, 60.0, joints=joints)
    assert found.state is JobState.DONE
    for _ in range(150):  # what was on its way arrives
        joints.advance(np.zeros(machine.n))
    T, goal = machine.tool_pose(machine.forward(joints.q)), job.goal.T_site_tool
    assert np.linalg.norm(T[:3, 3] - goal[:3, 3]) < 0.03
    assert (steadiest_1_s(machine, DT) < 5.0).all()


@pytest.mark.parametrize("make", [along, towards])
def test_done_is_there_and_stays_there(make):
    machine = machine_named("brokk5")
    job = make("brokk5", tolerance_m=0.004)
    joints = Joints(machine, machine.home)
    found = drive(machine, job, machine.home, 60.0, joints=joints)
    assert found.state is JobState.DONE and not found.rows[-1].velocity.any()
    goal = machine.tool_pose(machine.forward(motion_of("brokk5").q[-1]))
    for _ in range(120):
        joints.advance(np.zeros(machine.n))
        assert np.linalg.norm(machine.tool_pose(machine.forward(joints.q))[:3, 3] - goal[:3, 3]) <= 0.006
    again = followed(
        *(job, 1.0, machine.forward(joints.q), machine, HERE, nothing(machine.n), found.memory, FollowSettings()),
        sent=np.zeros(machine.n),
        dt_s=DT,
    )
    assert again.facts.state is JobState.DONE and not again.velocity.any()


@pytest.mark.parametrize("make", [along, towards])
def test_the_same_again_through_json(make):
    machine, job = machine_named("rre20"), make("rre20")

    def stored(memory: JobMemory) -> JobMemory:
        back = JobMemory.of(json.loads(json.dumps(memory.plain(), allow_nan=False)))
        assert back == memory
        return back

    one = drive(machine, job, machine.home, 4.0)
    two = drive(machine, job, machine.home, 4.0, through=stored)
    assert len(one.rows) == len(two.rows)
    for a, b in zip(one.rows, two.rows, strict=True):
        assert np.array_equal(a.velocity, b.velocity) and a.memory == b.memory and a.facts.clock_s == b.facts.clock_s


def test_it_survives_in_the_memory_of_the_loop():
    machine = machine_named("rre20")
    found = drive(machine, along("rre20"), machine.home, 1.0)
    assert found.memory.clocks and any(found.memory.flight.commands)
    kept = replace(first_memory(tick_config(machine, guard_named("none"), machine_id="one")), job=found.memory)
    assert restored(json.loads(json.dumps(kept.plain(), allow_nan=False))).job == found.memory


def test_a_new_id_begins_anew_and_a_released_job_goes_on():
    machine, job = machine_named("rre20"), along("rre20")
    found = drive(machine, job, machine.home, 1.5)
    let_go = released(found.memory)
    assert let_go.rate == 0.0 and let_go.flight == InFlight() and let_go.clock_s >= found.memory.clock_s
    joints = Joints(machine, job.trajectory.at(let_go.clock_s)[0])
    on = drive(machine, job, joints.q, 60.0, joints=joints, memory=let_go)
    assert on.rows[0].facts.clock_s == let_go.clock_s and on.state is JobState.DONE
    assert min(row.facts.clock_s for row in on.rows) == let_go.clock_s
    anew = drive(machine, replace(job, id="another"), machine.home, DT, memory=found.memory)
    assert anew.rows[0].facts.clock_s == 0.0 and anew.memory.job == "another"


def test_what_falls_behind_is_waited_for_and_then_given_up_with_a_reason():
    machine, job = machine_named("rre20"), along("rre20")
    held = Joints(machine, machine.home, blocked=True)
    found = drive(machine, job, machine.home, 30.0, joints=held)
    clocks = [row.facts.clock_s for row in found.rows]
    late = lateness(machine, DT)
    beyond = float(late.dead_s.max())  # has been commanded when it falls behind, and is not taken back
    behind = next(clock for clock, row in zip(clocks, found.rows, strict=True) if row.facts.error_m >= job.lag_m)
    assert behind <= clocks[-1] <= behind + beyond + 0.05 and clocks[-1] < job.trajectory.duration_s
    assert clocks[-1] == pytest.approx(clocks[-100], abs=1e-6)
    assert found.state is JobState.STUCK and not found.rows[-1].velocity.any()
    reason = found.rows[-1].reasons[-1]
    assert reason.code is ReasonCode.STUCK and "comes no nearer" in reason.text
    idle = FollowSettings().stuck_s
    assert len(found.rows) * DT > idle


@pytest.mark.parametrize("name", ["rre20", "brokk5"])
@pytest.mark.parametrize("most", [0.5, 0.2])
def test_time_runs_evenly_as_fast_as_what_is_let_through(name: str, most: float) -> None:
    machine, job = machine_named(name), along(name)
    peak = max(np.abs(job.trajectory.at(t)[1] / machine.speed_positive).max() for t in np.linspace(0.0, 20.0, 400))

    def capped(velocity: np.ndarray) -> np.ndarray:
        fast = np.abs(velocity / machine.speed_positive).max() / (most * peak)
        return velocity / max(fast, 1.0)

    found = drive(machine, job, machine.home, 120.0, guarded=capped)
    assert found.state is JobState.DONE
    clocks, rates = (np.array([getattr(row.facts, name) for row in found.rows]) for name in ("clock_s", "rate"))
    whole = job.trajectory.duration_s
    assert rates[(clocks > 0.1 * whole) & (clocks < 0.9 * whole)].min() > 0.5 * most
    assert np.abs(np.diff(rates)).sum() < 5.0  # up, down to what is let through, up, down: it does not swing
    ramps = 2.0 * FollowSettings().ramp_s + 2.0 * float(lateness(machine, DT).dead_s.max()) + 2.0
    assert len(found.rows) * DT < whole / most + ramps
    assert max(row.facts.error_m for row in found.rows) < job.lag_m


@pytest.mark.parametrize("make", [along, towards])
def test_nothing_moves_is_never_done_and_stuck_in_time(make):
    machine = machine_named("rre20")
    quick = FollowSettings(stuck_s=1.0)
    held = Joints(machine, machine.home, blocked=True)
    found = drive(machine, make("rre20"), machine.home, 12.0, joints=held, settings=quick)
    assert JobState.DONE not in {row.facts.state for row in found.rows}
    assert found.state is JobState.STUCK


def test_at_no_pace_it_stands_and_is_not_stuck():
    machine = machine_named("rre20")
    found = drive(machine, along("rre20"), machine.home, 10.0, share=lambda _: 0.0)
    assert found.state is JobState.MOVING and len(found.rows) == 500
    assert np.abs(found.q[-1] - machine.home).max() < 1e-9


@pytest.mark.parametrize("turns", [-2, 1, 3])
def test_endless_joints_take_the_near_turn(turns):
    machine = machine_named("rre20")
    endless = np.flatnonzero(machine.continuous)
    assert len(endless)
    q = np.array(machine.home)
    q[endless] += 2.0 * np.pi * turns
    found = drive(machine, along("rre20"), q, 60.0)
    assert found.state is JobState.DONE
    assert np.abs(found.q[-1][endless] - q[endless]).max() < np.pi


def test_one_exclusive_group_moves_at_a_time():
    machine = machine_named("brokk5")
    first, second = (list(group) for group in machine.exclusive_groups)
    for row in drive(machine, towards("brokk5"), machine.home, 20.0).rows:
        assert not (row.velocity[first].any() and row.velocity[second].any())


@settings(max_examples=60, deadline=None)
@given(
    name=st.sampled_from(["rre20", "brokk5"]),
    make=st.sampled_from([along, towards]),
    seed=st.integers(0, 10**6),
    flying=st.booleans(),
    share=st.floats(0.0, 1.0),
)
def test_from_anywhere_velocities_are_numbers_within_speeds(name, make, seed, flying, share):
    machine, draw = machine_named(name), np.random.default_rng(seed)
    q = draw.uniform(machine.sample_min, machine.sample_max)
    job = make(name)
    late = lateness(machine, DT)
    longest = len(late.flying)
    clock_s = float(draw.uniform(0.0, 20.0))
    ahead = np.sort(draw.uniform(clock_s, clock_s + 2.0, longest))
    memory = JobMemory(
        job=job.id,
        clock_s=clock_s,
        clocks=tuple(ahead.tolist()) if flying else (),
        rate=float(draw.uniform(0.0, 1.0)),
        flight=InFlight(
            tuple(draw.normal(size=machine.n).tolist()), tuple(draw.normal(size=longest * machine.n).tolist())
        )
        if flying
        else InFlight(),
        group=int(draw.integers(-1, 2)),
    )
    done = followed(
        *(job, share, machine.forward(q), machine, HERE, nothing(machine.n), memory, FollowSettings()),
        sent=draw.normal(size=machine.n),
        dt_s=DT,
    )
    assert np.isfinite(done.velocity).all()
    assert (done.velocity <= machine.speed_positive + 1e-12).all()
    assert (done.velocity >= -machine.speed_negative - 1e-12).all()
    assert done.memory.clock_s >= memory.clock_s or make is towards
    json.dumps(done.memory.plain(), allow_nan=False)
