"""Random drives: the same for every guard, judged by a truth of its own, fit to tell guards apart."""

import json
import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from workgauge.gauge.rulebook import load_rule_book
from workgauge.guard.api import GuardInput, GuardResult, Memory
from workgauge.guard.linear import LinearGuard
from workgauge.guard.registry import GUARDS
from workgauge.machine.load import load_machine
from workgauge.machine.stopping import StoppingModel
from workgauge.proximity.scene import Scene
from workgauge.rehearse.drives.clutter import clutter
from workgauge.rehearse.drives.draw import START_OWN_ROOM_M, START_ROOM_M, Doubt, Drives, DriveSettings
from workgauge.rehearse.drives.dynamics import IDEAL, Dynamics, believed_machine, true_hydraulics
from workgauge.rehearse.drives.levers import DRIVE_KINDS
from workgauge.rehearse.drives.run import DriveResult, DriveRun, run_drive
from workgauge.rehearse.drives.watch import reaches_m
from workgauge.rehearse.shipped import shipped_site_files
from workgauge.site.read import read_site
from workgauge.values.errors import InputError
from workgauge.values.solids import Convex

SLUGGISH = Dynamics(dead_time_s=0.3, ratio=3.0, tolerance=0.3, truth="within")


@dataclass(frozen=True)
class LetThrough:
    """Lets every wish through."""

    name: str = "let through"
    reach_m: float = 0.5
    steers_itself: bool = False

    def start(self) -> Memory:
        return {}

    def idle(self, *_: object) -> Memory:
        return {}

    def allow(self, given: GuardInput, memory: Memory) -> tuple[GuardResult, Memory]:
        return GuardResult(given.desired, (), 1.0), memory


@pytest.fixture(scope="module")
def drives():
    return Drives(load_machine("rre20"), read_site(shipped_site_files("double_track")), load_rule_book("finland"))


@pytest.mark.parametrize("seed", [0, 3, 7])
def test_a_seed_is_one_drive_bit_for_bit(drives, seed):
    settings = DriveSettings(dynamics=SLUGGISH, seconds=2.0, doubt=Doubt(0.02, 0.002, 0.002))
    afresh = Drives(load_machine("rre20"), read_site(shipped_site_files("double_track")), load_rule_book("finland"))
    once = run_drive(drives.draw(seed, settings), LinearGuard())
    drives.draw(seed + 1, settings)  # nothing of it may be left behind
    assert run_drive(afresh.draw(seed, settings), LinearGuard()) == once
    assert DriveResult.of_plain(json.loads(json.dumps(once.plain()))) == once


def test_every_guard_gets_the_same_drive_at_every_dead_time(drives):
    slow, quick = (DriveSettings(dynamics=Dynamics(dead_time_s=s)) for s in (1.3, 0.0))
    for seed in range(4):
        one, other = drives.draw(seed, slow), drives.draw(seed, quick)
        assert one.programme == other.programme or repr(one.programme) == repr(other.programme)
        assert np.array_equal(one.q, other.q)
        assert np.array_equal(one.place.T_site_machine, other.place.T_site_machine)
        assert [limit.id for limit in one.place.scene.limits] == [limit.id for limit in other.place.scene.limits]
        results = [run_drive(one, guard) for guard in (LetThrough(), LinearGuard())]
        # the hands without a guard move the same way whoever guards, while levers move joints and the gate stays open
        if not one.programme.spells and all(held.mode == "joint" for held in one.programme.held):
            assert results[0].free_motion == pytest.approx(results[1].free_motion, rel=1e-3)
        assert results[0].ticks == results[1].ticks


def test_every_kind_is_drawn_and_starts_clear(drives):
    kinds = set()
    for seed in range(40):
        drive = drives.draw(seed, DriveSettings())
        kinds.add(drive.kind)
        scene = Scene(drive.machine, drive.place.scene.limits)
        found = scene.query(drive.machine.forward(drive.q), drive.place.T_site_machine, 3.0)
        stops = np.where(np.isnan(found.stop_distances), 0.2, found.stop_distances)
        room = np.where(found.other_links < 0, START_ROOM_M, START_OWN_ROOM_M)
        assert (found.distances - stops >= room).all()
    assert kinds == set(DRIVE_KINDS)


def test_without_a_guard_drives_enter_and_the_unguarded_share_is_all(drives):
    settings = DriveSettings(dynamics=Dynamics(dead_time_s=0.3), seconds=3.0, gate_closes=0.0)
    results = [run_drive(drives.draw(seed, settings), LetThrough()) for seed in range(8)]
    assert sum(result.entries for result in results) >= 4
    for result in results:
        assert (result.entries > 0) == (result.worst_clearance_m < 0.0) == bool(result.entered)
        assert result.worst_less_stop_m < result.worst_clearance_m
    joint_mode = [r for r in results if r.kind in ("levers", "reversing", "straight", "itself")]
    assert joint_mode
    for result in joint_mode:
        assert result.motion == pytest.approx(result.free_motion, rel=1e-3)


def test_linear_scaling_keeps_ideal_joints_outside_and_off_their_stop_distances(drives):
    results = [run_drive(drives.draw(seed, DriveSettings(dynamics=IDEAL)), LinearGuard()) for seed in range(10)]
    assert all(result.entries == 0 for result in results)
    assert min(result.worst_less_stop_m for result in results) > -1e-6
    assert sum(result.motion for result in results) < sum(result.free_motion for result in results)


def test_the_truth_is_not_what_the_guard_looks_at(drives):
    settings = DriveSettings(dynamics=IDEAL, kinds=("straight",), gate_closes=0.0)
    entries = 0
    for seed in range(4):
        told = drives.draw(seed, settings)
        blind = replace(told, place=replace(told.place, scene=Scene(told.machine, ())))
        assert run_drive(told, LinearGuard()).entries == 0
        entries += run_drive(blind, LinearGuard()).entries
    assert entries > 0


@pytest.mark.parametrize("seed", [1, 4, 6, 8])
def test_looking_only_where_it_matters_finds_what_looking_everywhere_finds(drives, seed):
    drive = drives.draw(seed, DriveSettings(dynamics=SLUGGISH, seconds=2.0, near_m=0.1))
    run = DriveRun(drive, LinearGuard())
    scene, T = Scene(drive.machine, drive.place.scene.limits), drive.place.T_site_machine
    postures, moved = [np.array(drive.q)], run.watch.moved

    def kept(path):
        postures.extend(path)
        moved(path)

    run.watch.moved = kept
    for _ in run.steps():
        pass
    everything = [scene.query(drive.machine.forward(q), T, 2.0) for q in postures]
    less = [one.distances - np.where(np.isnan(one.stop_distances), 0.2, one.stop_distances) for one in everything]
    result = run.result()
    assert run.watch.looks < len(postures)
    worst = min(one.distances.min(initial=math.inf) for one in everything)
    assert result.worst_clearance_m == pytest.approx(worst, abs=2e-6)
    assert result.worst_less_stop_m == pytest.approx(min(one.min(initial=math.inf) for one in less), abs=2e-6)


def test_the_gate_is_shut_in_spells_and_opens_again(drives):
    settings = DriveSettings(dynamics=IDEAL, gate_closes=1.0)
    drive = next(
        d for d in (drives.draw(seed, settings) for seed in range(20)) if d.programme.spells[0].until_s < 2.0
    )
    spell, opened = drive.programme.spells[0], False
    for step in DriveRun(drive, LetThrough()).steps():
        if drive.programme.lost_at(step.t_s) is not None:
            assert not any(step.trace.valves)
        opened |= spell.until_s < step.t_s and any(step.trace.valves)
    assert opened


def test_errors_of_pose_and_posture_are_within_what_the_guard_is_told(drives):
    settings = DriveSettings(dynamics=IDEAL, doubt=Doubt(0.03, 0.003, 0.003), seconds=2.0)
    for seed in range(4):
        drive = drives.draw(seed, settings)
        assert np.abs(drive.q_error).max() > 0.0
        assert 0.0 < np.linalg.norm(drive.T_error[:3, 3]) < 0.2
        result = run_drive(drive, LinearGuard())
        assert result.worst_less_stop_m > -1e-6


def test_real_joints_lie_within_what_is_believed_and_some_at_its_ends():
    machine, ends = load_machine("rre20"), 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        believed = believed_machine(machine, SLUGGISH, rng)
        real, model = true_hydraulics(believed, SLUGGISH, rng), StoppingModel.of(believed)
        ratio = real.dead_time_s / model.dead_time_s
        assert (ratio >= 0.7 - 1e-12).all()
        assert (ratio <= 1.3 + 1e-12).all()
        assert (real.deceleration >= model.deceleration / 1.3 - 1e-12).all()
        assert np.array_equal(real.full_speed, np.stack([machine.speed_positive, machine.speed_negative]))
        ends += bool(np.isclose(np.abs(ratio - 1.0), 0.3).all())
        spread = model.dead_time_s / 0.3
        assert spread.min() >= 3**-0.5 - 1e-12
        assert spread.max() <= 3**0.5 + 1e-12
    assert 4 <= ends <= 16
    plain = Dynamics(dead_time_s=0.3)
    believed = believed_machine(machine, plain, np.random.default_rng(0))
    model, real = StoppingModel.of(believed), true_hydraulics(believed, plain, np.random.default_rng(0))
    assert np.array_equal(real.dead_time_s, model.dead_time_s)
    assert np.allclose(model.deceleration * 0.6, np.stack([machine.speed_positive, machine.speed_negative]))
    assert not model.tolerance.any()


@pytest.mark.parametrize("name", ["rre20", "brokk5", "sun-a"])
def test_no_point_moves_faster_than_its_bound(name):
    machine, rng = load_machine(name), np.random.default_rng(1)
    reaches = reaches_m(machine)
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    for _ in range(30):
        kin = machine.forward(rng.uniform(machine.sample_min, machine.sample_max))
        poses, halves = machine.solid_poses(kin)
        for solid, pose, half in zip(machine.solids, poses, halves, strict=True):
            corners = signs * half @ pose[:3, :3].T + pose[:3, 3]
            jacobians = machine.point_jacobians(kin, np.full(8, solid.link), corners)
            assert (np.linalg.norm(jacobians, axis=1) <= reaches + 1e-9).all()


@pytest.mark.parametrize("name", ["rre20", "brokk5"])
def test_random_limits_are_sound_solids(name):
    machine = load_machine(name)
    kinds = set()
    for seed in range(12):
        limits = clutter(np.random.default_rng(seed), machine)
        kinds |= {type(limit.solid).__name__ for limit in limits}
        assert len({limit.id for limit in limits}) == len(limits)
        for limit in limits:
            if isinstance(limit.solid, Convex):
                a, b, c = (limit.solid.vertices[limit.solid.faces[:, i]] for i in range(3))
                outwards = np.cross(b - a, c - a)
                beyond = np.einsum("ij,ikj->ik", outwards, limit.solid.vertices[None] - a[:, None])
                assert beyond.max() < 1e-6
        Scene(machine, limits).query(machine.forward(machine.home), np.eye(4), 5.0)
    assert kinds == {"Box", "Convex", "Tube", "PrismChain", "Surface"}


def test_machines_off_the_rails_drive_too():
    machine = load_machine("brokk5")
    drives = Drives(machine, read_site(shipped_site_files("double_track")), load_rule_book("generic"))
    settings = DriveSettings(dynamics=Dynamics(dead_time_s=None, truth="within"), seconds=1.0)
    results = [run_drive(drives.draw(seed, settings), LinearGuard()) for seed in range(4)]
    assert all(result.ticks == 50 and result.motion > 0.0 for result in results)


@pytest.mark.parametrize(
    "wrong",
    [
        {"seconds": 0.0},
        {"dt_s": math.nan},
        {"kinds": ()},
        {"kinds": ("backflip",)},
        {"gate_closes": 1.5},
        {"stop_distance_m": -0.1},
    ],
)
def test_settings_out_of_range_are_refused_by_name(wrong):
    with pytest.raises(InputError) as refused:
        DriveSettings(**wrong)
    assert refused.value.element == next(iter(wrong))


@pytest.mark.parametrize("wrong", [{"dead_time_s": -1.0}, {"lag_s": math.nan}, {"ratio": 0.5}, {"tolerance": 1.0}])
def test_dynamics_out_of_range_are_refused_by_name(wrong):
    with pytest.raises(InputError) as refused:
        Dynamics(**wrong)
    assert refused.value.element == next(iter(wrong))


@pytest.mark.parametrize("name", sorted(GUARDS))
def test_registered_guards_survive_a_drive_of_every_kind(drives, name):
    for kind in DRIVE_KINDS:
        settings = DriveSettings(dynamics=Dynamics(dead_time_s=0.1), kinds=(kind,), seconds=0.6, gate_closes=1.0)
        assert run_drive(drives.draw(5, settings), GUARDS[name]()).ticks == 30
