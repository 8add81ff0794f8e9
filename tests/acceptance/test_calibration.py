"""Calibration: how often the true clearance lies below the bound, from simulated sensors to every clearance.

Each epoch draws errors of two antennas, an inclinometer and the joints' sensors of the shipped road-rail excavator,
solves posture and pose from what the sensors say, asks the scene for the clearances of the machine so believed, and
compares with the clearances of the true machine. Errors have no bias: a clearance's `(believed - true) / sigma` is
standard normal, and the share of true clearances below `believed - k sigma` is the Gaussian tail of k.

Where that holds exactly, the closest features must stay what they are: tilted walls all round, each nearest to one
corner of every solid. A second scene, the shipped site, has edges, parallel faces and bent chains; there the level
counts every corner, and the share may only be smaller.

Correlated noise means three things here. Between components and antennas: independent epochs, full covariances, a
share of the error common to both antennas. Between joints and pose: always, as the solution has it (the antennas sit
on the cab, two joints share an inclinometer). In time: a first-order autoregression; its 20,000 epochs are worth
fewer independent ones, and the interval is that of the effective number, `N / (1 + 2 sum of r(lag))` with r the
autocorrelation of the event itself, a Gaussian beyond k.
"""

import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import binom, multivariate_normal, norm

from workgauge.machine.load import load_machine
from workgauge.positioning.antennas import PlacedAntenna, Tilt, two_antenna_pose
from workgauge.positioning.attitude import up_sides
from workgauge.positioning.posture import PostureSolver, Reading
from workgauge.proximity.protection import Integrity, with_protection
from workgauge.proximity.scene import Scene
from workgauge.proximity.uncertainty import MachineUncertainty
from workgauge.rehearse.scenario import OnTrack
from workgauge.rehearse.session import Session
from workgauge.values import transforms as tf
from workgauge.values.arrays import Floats, frozen
from workgauge.values.clearances import Clearances
from workgauge.values.limits import Limit, LimitKind, Source
from workgauge.values.solids import Box

MACHINE = load_machine("rre20")
SENSORS = {sensor.name: sensor for sensor in MACHINE.sensors}
SOLVER = PostureSolver(MACHINE)
#: The true joints and pose among the walls.
POSTURE = frozen(np.radians([35.0, 25.0, -80.0, -55.0, 12.0, 20.0]))
PLACE = frozen(tf.translation(3.0, -2.0, 0.4) @ tf.rpy(0.03, -0.02, 0.9))
LEVELS = (1.0, 2.0, 3.0)
EPOCHS = 20_000
#: Share of such tests that a perfectly calibrated program would fail, per clearance and k.
DOUBT = 1e-3
TOLERANCE_M = 0.01
#: Small enough for the level to be k sigma of the closest point and nothing else.
FIRST_ORDER = 1e-6

WHITE = np.diag(np.square([0.015, 0.015, 0.025]))
SLANTED = np.array([[2.6, -0.9, 1.2], [-0.9, 1.5, -1.4], [1.2, -1.4, 6.0]]) * 1e-4


@dataclass(frozen=True)
class Noise:
    """Errors of the two antennas: covariance of each, common share; autocorrelation of everything in time."""

    antenna: Floats
    common: float = 0.0
    in_time: float = 0.0


def draws(noise: Noise, rng: np.random.Generator, epochs: int) -> Iterator[Floats]:
    """Standard normal vectors, one per epoch, as alike from one to the next as the noise says."""
    channels = sum(2 if channel.tilting else 1 for channel in SOLVER.channels)
    now = rng.normal(size=9 + channels + 4)
    for _ in range(epochs):
        yield now
        now = noise.in_time * now + math.sqrt(1.0 - noise.in_time**2) * rng.normal(size=len(now))


def root(covariance: Floats) -> Floats:
    values, vectors = np.linalg.eigh(covariance)
    return (vectors * np.sqrt(values)) @ vectors.T


def readings(q: Floats, R_site_machine: Floats, errors: Iterator[float]) -> list[Reading]:
    """What the link sensors say: the true value and an error of the configured sigma."""
    assert MACHINE.positioning is not None
    joints = {joint.sensor: joint for joint in MACHINE.positioning.joints}
    kin, said = MACHINE.forward(q), []
    for channel in SOLVER.channels:
        sensor = SENSORS[channel.name]
        if channel.tilting:
            up = (R_site_machine @ kin.T_machine_links[sensor.link][:3, :3] @ sensor.T_link_sensor[:3, :3])[2]
            sides = up_sides(math.atan2(up[1], up[2]), math.atan2(-up[0], math.hypot(up[1], up[2])))
            up = up + channel.sigma * (next(errors) * np.array(sides[0]) + next(errors) * np.array(sides[1]))
            said.append(Reading(math.atan2(up[1], up[2]), math.atan2(-up[0], math.hypot(up[1], up[2]))))
        else:
            joint = joints[channel.name]
            value = q[MACHINE.joint_names.index(joint.joint)] - math.radians(joint.offset_deg)
            said.append(Reading(joint.sign * value + channel.sigma * next(errors)))
    return said


def antennas(noise: Noise, q: Floats, T: Floats, errors: Floats) -> tuple[PlacedAntenna, PlacedAntenna]:
    """Where the receivers place the two antennas, master first."""
    assert MACHINE.positioning is not None
    kin, spread = MACHINE.forward(q), root(noise.antenna)
    own, shared = math.sqrt(1.0 - noise.common), math.sqrt(noise.common)
    placed = []
    for i, name in enumerate((MACHINE.positioning.heading.master, MACHINE.positioning.heading.rover)):
        sensor = SENSORS[name]
        place = sensor.T_link_sensor[:3, 3]
        true = tf.apply(T @ kin.T_machine_links[sensor.link], place[None])[0]
        error = spread @ (own * errors[3 * i : 3 * i + 3] + shared * errors[6:9])
        placed.append(PlacedAntenna(sensor.link, place, true + error, noise.antenna))
    return placed[0], placed[1]


class Epochs:
    """Believed against true clearances over many epochs.

    Attributes:
        true: of the true machine. seen: (c,) how often each of them was among the believed ones.
        below: (k, c) how often the true distance lay below the bound.

    Args:
        scene: of the limits. noise: of the antennas. seed, epochs: of the draws. radius_m: searched.
        whole: with the levels as the tick uses them; else k sigma of the closest point alone, to first order.
        q, T: the true joints and pose.
    """

    def __init__(
        self,
        scene: Scene,
        noise: Noise,
        seed: int,
        epochs: int,
        radius_m: float = 30.0,
        *,
        whole: bool = False,
        q: Floats = POSTURE,
        T: Floats = PLACE,
    ) -> None:
        self.scene, self.noise, self.radius_m, self.whole, self.q, self.T = scene, noise, radius_m, whole, q, T
        self.true = scene.query(MACHINE.forward(q), T, radius_m)
        self.below = np.zeros((len(LEVELS), len(self.true)), dtype=np.int64)
        self.seen = np.zeros(len(self.true), dtype=np.int64)
        where = {key: i for i, key in enumerate(pairs(self.true))}
        for errors in draws(noise, np.random.default_rng(seed), epochs):
            found, levels = self.believed(errors)
            at = np.array([where.get(key, -1) for key in pairs(found)])
            known = at >= 0
            at = at[known]
            actual = self.true.distances[at] + self.misfit(errors[-4:])[at]
            self.below[:, at] += actual < found.distances[known] - levels[:, known]
            self.seen[at] += 1

    def believed(self, errors: Floats) -> tuple[Clearances, Floats]:
        """The clearances (c) of the machine as its sensors have it, and their levels (k, c)."""
        said = readings(self.q, self.T[:3, :3], iter(errors[9:-4]))
        posture = SOLVER.solve(said)
        kin = MACHINE.forward(posture.q)
        up, up_covariance = np.array(SOLVER.up(0, said[0])), SOLVER.up_covariance(0, said[0])
        tilt = Tilt(SOLVER.channels[0].link, up, up_covariance, posture.tilt_cross)
        placed, joints = antennas(self.noise, self.q, self.T, errors), posture.covariance
        pose = two_antenna_pose(MACHINE, kin, *placed, tilt, joints, common_share=self.noise.common)
        assert pose is not None
        found = self.scene.query(kin, pose.T_site_machine, self.radius_m)
        unsure = MachineUncertainty.of(
            pose.covariance,
            posture.sigma,
            tool_sigma_m=MACHINE.tool_tolerance_m,
            cross=pose.cross,
            joint_covariance=joints,
        )
        rows = MACHINE.distance_rows(kin, pose.T_site_machine, found)

        def level(k: float) -> Floats:
            given = (found, rows, kin, MACHINE, pose.T_site_machine, unsure, self.scene.uncertainty)
            return with_protection(*given, Integrity(k))[0].protections

        if self.whole:
            return found, np.array([level(k) for k in LEVELS])
        return found, np.outer(LEVELS, level(FIRST_ORDER) / FIRST_ORDER)

    def misfit(self, errors: Floats) -> Floats:
        """What the attachment's place on its link (three errors) and the limits' (one) add to the true distances."""
        tool = (self.true.links == MACHINE.tool_link) * (self.true.normals @ errors[:3]) * MACHINE.tool_tolerance_m
        return tool - errors[3] * np.sqrt(self.scene.uncertainty.variances.take(self.true.limits))


def pairs(found: Clearances) -> list[tuple[int, int]]:
    """What each clearance is between: solid of the machine, limit or own link."""
    return list(zip(found.solids.tolist(), found.limits.tolist(), strict=True))


def walls() -> Scene:
    """Walls 30 m wide all round, each askew, so that every solid is nearest to each with one corner of its own."""
    limits = []
    rng = np.random.default_rng(5)
    ways = [(1, 0, 0.1), (-0.4, 1, 0), (0, -1, 0.3), (-1, -0.3, -0.2), (0.2, 0.1, 1), (0.1, 0.2, -1)]
    for i, way in enumerate(ways):
        T = np.array(PLACE)
        askew = np.array(way) + rng.normal(size=3) * 0.1
        T[:3, :3] = Rotation.align_vectors([askew], [[1.0, 0.0, 0.0]])[0].as_matrix()
        T[:3, 3] += T[:3, :3] @ [16.0, 0.0, 0.0]
        solid = Box(frozen(T), frozen([2.0, 15.0, 15.0]))
        source = Source("test", f"wall {i}")
        limits.append(Limit(f"wall {i}", LimitKind.ZONE, "wall", solid, "test", source, tolerance_m=TOLERANCE_M))
    return Scene(MACHINE, limits)


def steady(scene: Scene, true: Clearances) -> Floats:
    """Which clearances to walls are between a corner and the inside of a face, by far: their features stay."""
    kin = MACHINE.forward(POSTURE)
    poses, halves = MACHINE.solid_poses(kin)
    kept = np.zeros(len(true), dtype=np.bool_)
    for i, clearance in enumerate(true):
        if clearance.limit.startswith("self:"):
            continue
        s = true.solids[i]
        corners = tf.apply(PLACE @ poses[s], Box(np.eye(4), halves[s]).vertices)
        beyond = np.sort((corners - clearance.point_machine) @ clearance.normal)
        wall = scene.limits[true.limits[i]].solid
        assert isinstance(wall, Box)
        foot = np.abs(tf.apply(tf.inverse(wall.T_frame_box), clearance.point_limit[None])[0])
        kept[i] = beyond[1] > 0.03 and (foot < wall.half_extents - 0.5).sum() == 2
    return kept


def interval(events: float, share: float) -> tuple[float, float]:
    """The shares that so many independent tries give with probability 1 - DOUBT."""
    low, high = binom.interval(1.0 - DOUBT, round(events), share)
    return float(low) / round(events), float(high) / round(events)


@functools.cache
def effective(epochs: int, k: float, in_time: float) -> float:
    """How many independent epochs those of an autoregression are worth for the event of being beyond k sigma."""
    share, total = float(norm.sf(k)), 0.0
    for lag in range(1, 10_000):
        alike = in_time**lag
        both = float(multivariate_normal(cov=[[1.0, alike], [alike, 1.0]]).cdf([-k, -k]))
        found = (both - share**2) / (share - share**2)
        total += found
        if found < 1e-4:
            break
    return epochs / (1.0 + 2.0 * total)


def check(noise: Noise, seed: int, epochs: int) -> None:
    """Every steady clearance, every k: the share of true clearances below the bound within the interval."""
    scene = walls()
    run = Epochs(scene, noise, seed, epochs)
    kept = steady(scene, run.true)
    assert kept.sum() >= 20 and (run.seen[kept] == epochs).all()
    assert set(run.true.links[kept]) == {0, 1, 2, 3, MACHINE.tool_link}
    wrong = []
    for k, below in zip(LEVELS, run.below, strict=True):
        low, high = interval(effective(epochs, k, noise.in_time), float(norm.sf(k)))
        for i in np.flatnonzero(kept):
            share = below[i] / epochs
            if not low <= share <= high:
                clearance = run.true[i]
                wrong.append(f"k {k}: {clearance.link} to {clearance.limit}: {share:.5f} of {low:.5f}..{high:.5f}")
    assert not wrong, wrong


NOISES = {
    "white": Noise(WHITE),
    "correlated components and antennas": Noise(SLANTED, common=0.6),
    "correlated in time": Noise(SLANTED, common=0.3, in_time=0.8),
}


@pytest.mark.parametrize("name", NOISES)
def test_the_share_below_the_bound_is_the_gaussian_tail(name: str) -> None:
    check(NOISES[name], 11, 1_000)


@pytest.mark.prove
@pytest.mark.parametrize("name", NOISES)
def test_the_share_below_the_bound_is_the_gaussian_tail_in_twenty_thousand_epochs(name: str) -> None:
    check(NOISES[name], 12, EPOCHS)


@functools.cache
def site() -> Session:
    """The machine on the curve of the shipped site, beside the adjacent track, under the wire."""
    return Session("double_track", MACHINE, at=OnTrack(alignment="Track 1", distance_m=573.0))


def check_site(noise: Noise, seed: int, epochs: int) -> None:
    """On the shipped site, with levels as the tick uses them, shares are at most those of the Gaussian tail."""
    session = site()
    scene = Scene(MACHINE, session.limits)
    q = np.radians([-80.0, 20.0, -104.0, -77.0, 0.0, 0.0])
    run = Epochs(scene, noise, seed, epochs, 4.0, whole=True, q=q, T=session.true_state[1])
    kinds = {scene.limits[i].kind for i in run.true.limits if i < len(scene.limits)}
    assert len(run.true) >= 25 and len(kinds) >= 4 and (run.true.other_links >= 0).any()
    assert (run.seen == epochs).all()
    for k, below in zip(LEVELS, run.below, strict=True):
        _, high = interval(epochs, float(norm.sf(k)))
        wrong = [(run.true[i].link, run.true[i].limit, n) for i, n in enumerate(below) if n / epochs > high]
        assert not wrong, (k, wrong)
    # and it is not so by being far too careful: some clearances are nearly calibrated
    assert run.below[0].max() / epochs > 0.9 * norm.sf(1.0)


@pytest.mark.parametrize("name", ["white", "correlated components and antennas"])
def test_with_edges_parallel_faces_and_bent_chains_the_share_is_only_smaller(name: str) -> None:
    check_site(NOISES[name], 21, 300)


@pytest.mark.prove
@pytest.mark.parametrize("name", ["white", "correlated components and antennas"])
def test_the_same_in_twenty_thousand_epochs(name: str) -> None:
    check_site(NOISES[name], 22, EPOCHS)
