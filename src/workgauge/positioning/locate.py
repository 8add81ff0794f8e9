"""Measurements in, the machine's pose, posture and their trustworthiness out: the positioning of one tick.

Each epoch of the receivers is solved for itself with the link sensors' readings of that moment (`solve`), judged
(`health`), and carried on to now (`motion`). No filter: what is said of the uncertainty holds for each snapshot, for
white and for correlated noise alike.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from workgauge.geodesy.crs import ProjectedCrs
from workgauge.geodesy.frame import SiteFrame
from workgauge.geodesy.heights import HeightModel
from workgauge.machine.model import MachineModel
from workgauge.positioning.bend import Bender
from workgauge.positioning.evidence import HealthSeen
from workgauge.positioning.headings import course_difference, course_sigma
from workgauge.positioning.health import judge
from workgauge.positioning.innovation import Candidate, agreement, sigmas
from workgauge.positioning.intake import Intake
from workgauge.positioning.memory import GridFixes, Located, LocatorMemory, PostureMemory, Solved
from workgauge.positioning.motion import (
    Motion,
    Past,
    carried,
    largest_horizontal_sigma,
    remembered,
    settled,
    slope,
)
from workgauge.positioning.posture import PostureSolver
from workgauge.positioning.rates import antenna_velocity, gyro_rate
from workgauge.positioning.solve import EpochSolver, Given, Known
from workgauge.positioning.timing import Epoch, heading_of, whole
from workgauge.positioning.track import RailTrack
from workgauge.site.alignment import Alignment
from workgauge.values.arrays import Floats, freeze, frozen
from workgauge.values.health import HealthState, PositionHealth
from workgauge.values.measurements import MachinePose, Posture, Stamp
from workgauge.values.navigation import FixQuality, Measurement
from workgauge.values.reasons import Reason, ReasonCode

#: What a pose or posture made here names as its source.
SOURCE = "positioning"
#: A receiver's own statement of its error is waited for so long after its position [ns].
PATIENCE_NS = 60_000_000
#: Fixes of two receivers that say no time belong together if they are valid within this of each other [ns].
TOGETHER_NS = 25_000_000
#: A heading without a time of its own belongs to the fix within this [ns].
HEADING_NS = 100_000_000
#: Slower than this a course is not compared with the heading [m/s], nor while turning faster than this [rad/s].
SLOWEST_COURSE_M_S, FASTEST_TURN = 0.3, 0.03


class Locator:
    """Locates one machine on one site; immutable, everything it remembers is in `LocatorMemory`.

    Args:
        machine: with a `positioning` section. machine_id: in the stamps of what it makes; measurements of other
            machines are left out.
        crs, frame: of the site.
        track: the rails it stands on, None where it is free; of an alignment, cant turns it about its middle.
        heights: how a fix's height becomes the site's; left out, as the machine file says.

    Raises:
        ValueError: for a machine without a `positioning` section. GeodesyError: for a geoid grid that is not there.
    """

    def __init__(
        self,
        machine: MachineModel,
        machine_id: str,
        crs: ProjectedCrs,
        frame: SiteFrame,
        *,
        track: RailTrack | Alignment | None = None,
        heights: HeightModel | None = None,
    ) -> None:
        spec = machine.positioning
        if spec is None:
            raise ValueError(f"machine {machine.name} has no positioning section")
        self.machine, self.machine_id, self.spec = machine, machine_id, spec
        self._crs, self._frame = crs, frame
        self._heights = heights or HeightModel.of(spec.height, spec.geoid_separation_m, spec.geoid_grid)
        solver = PostureSolver(machine)
        self._bender = Bender(machine, solver, math.radians(spec.thresholds.link_jump_deg))
        self._intake = Intake(machine, machine_id, spec, solver.channels)
        self._on(track)

    def _on(self, track: RailTrack | Alignment | None) -> None:
        if isinstance(track, Alignment):
            track = RailTrack(track, height_m=self.machine.undercarriage.height_m)
        self.track = track
        self._solver = EpochSolver(
            self.machine, self.spec, self._crs, self._frame, self._heights, self._bender.solver, track
        )

    def on(self, track: RailTrack | Alignment | None) -> "Locator":
        """Return the same locator for a machine on another track, or on none."""
        if track is self.track:
            return self
        other = object.__new__(Locator)
        other.__dict__.update(self.__dict__)
        other._on(track)
        return other

    def start(self) -> LocatorMemory:
        """Return the memory of a locator that has seen nothing yet."""
        return self._intake.nothing()

    def step(
        self,
        measurements: Sequence[Measurement],
        now_ns: int,
        memory: LocatorMemory,
        *,
        checked: bool | None = None,
    ) -> tuple[Located, LocatorMemory]:
        """Take in what arrived since the last tick and return where the machine is now.

        Args:
            measurements: in the order they arrived. now_ns: the tick's clock.
            checked: whether the start-of-shift check holds, None if none is asked for.
        """
        if measurements:
            memory, links = self._intake.take(measurements, memory)
            if links:
                memory = replace(memory, posture=self._bender.measured(memory.samples, memory.posture))
        solved = self._newest(memory, now_ns)
        if solved is not None:
            memory = replace(memory, tried_ns=solved.valid_ns, newest=solved.fixes)
        stale = self._stale(memory, now_ns)
        now = self._now(memory, now_ns)
        seen = self._seen(memory, solved, now, now_ns, stale, checked)
        health, accept, judged = judge(seen, memory.health, self.spec.thresholds)
        frozen_ns = None
        if health.state is HealthState.CHASSIS_FROZEN:
            frozen_ns = now_ns if memory.frozen_ns is None else memory.frozen_ns
        memory = replace(memory, health=judged, frozen_ns=frozen_ns)
        if solved is not None:
            memory = self._taken(memory, solved, accept, seen)
            now = self._now(memory, now_ns)
        if memory.solved is not None and memory.solved.fixes.off_track:
            health = self._beside(health, memory.solved.fixes)
        if health.state is HealthState.STOP and memory.solved is None:
            health = replace(health, reasons=(*self._unheard(memory), *health.reasons))
        pose = self._pose(memory, now, now_ns) if health.state.usable else None
        return Located(pose, self._posture(memory.posture, now_ns, bool(stale)), health, memory.newest), memory

    def _newest(self, memory: LocatorMemory, now_ns: int) -> Solved | None:
        """Solve the newest epoch that is whole and was not tried before."""
        receivers = self._solver.receivers
        first = memory.heard[receivers[0]]
        for epoch in reversed(first.epochs):
            if memory.tried_ns is not None and epoch.valid_ns <= memory.tried_ns:
                return None
            if not whole(epoch, first, now_ns, PATIENCE_NS):
                continue
            epochs = [(receivers[0], epoch)]
            for receiver in receivers[1:]:
                heard = memory.heard[receiver]
                partner = _partner(epoch, heard.epochs)
                if partner is not None and whole(partner, heard, now_ns, PATIENCE_NS):
                    epochs.append((receiver, partner))
            if len(epochs) < len(receivers):
                continue
            heading = heading_of(epoch, memory.headings, HEADING_NS)
            if heading is None and not self._solver.two:
                continue
            within = self.spec.thresholds.link_age_s
            bent = self._bender.at(memory.samples, memory.posture, epoch.valid_ns, within)
            if bent is None:
                continue
            solved = self._solver.solve(Given(tuple(epochs), heading, *bent), self._known(memory, epoch.valid_ns))
            if solved is not None:
                return solved
        return None

    def _known(self, memory: LocatorMemory, t_ns: int) -> Known:
        """Return what is known of a moment without its fix."""
        if memory.solved is None:
            return Known()
        T, covariance = self._carried(memory.solved, memory.motion, t_ns)[:2]
        distance = math.nan
        if self.track is not None and memory.track == self.track.alignment.name:
            distance = memory.solved.distance
        sigma = math.sqrt(max(0.0, float(covariance[5, 5])))
        return Known(math.atan2(T[1, 0], T[0, 0]), sigma, distance)

    def _carried(self, solved: Solved, motion: Motion, t_ns: int) -> tuple[Floats, Floats, float]:
        return carried(solved.T, solved.covariance, motion, (t_ns - solved.valid_ns) * 1e-9, solved.along)

    def _stale(self, memory: LocatorMemory, now_ns: int) -> tuple[str, ...]:
        """Return the names of link sensors that are missing or old, or that tell nothing of their joint."""
        oldest = now_ns - round(self.spec.thresholds.link_age_s * 1e9)
        channels = self._bender.solver.channels
        stale = [
            channel.name
            for channel, samples in zip(channels, memory.samples, strict=True)
            if not samples or samples[-1].valid_ns < oldest
        ]
        recent = memory.posture.recent
        if not stale and (not recent or max(recent[-1].valid_ns) < oldest):
            return ("posture",)
        return tuple(stale)

    def _seen(
        self,
        memory: LocatorMemory,
        solved: Solved | None,
        now: tuple[Floats, Floats, float] | None,
        now_ns: int,
        stale: tuple[str, ...],
        checked: bool | None,
    ) -> HealthSeen:
        known, motion = memory.solved, memory.motion
        newest = solved or known
        if newest is None:
            return HealthSeen(
                now_ns, stale_sensors=stale, jumped_joints=self._jumped(memory.posture), checked=checked
            )
        covariance = self._carried(newest, motion, now_ns)[1] if solved is not None or now is None else now[1]
        innovation, again, difference, sigma = math.nan, math.nan, math.nan, math.nan
        if solved is not None:
            innovation = 0.0 if known is None else self._innovation(known, solved, motion)
            if memory.refused is not None:
                speed_sigma = max(motion.sigma, 0.1)
                again = agreement(memory.refused, _candidate(solved), np.array(motion.velocity), speed_sigma)
            difference, sigma = self._headings(memory, solved)
        return HealthSeen(
            now_ns=now_ns,
            fix_age_s=math.inf if known is None else (now_ns - known.valid_ns) * 1e-9,
            quality=FixQuality.NONE if solved is None else solved.quality,
            sigma_m=largest_horizontal_sigma(covariance),
            correction_age_s=newest.correction_age_s,
            innovation=innovation,
            baseline_error_m=math.nan if solved is None else solved.baseline_error_m,
            heading_difference=difference,
            swapped=solved is not None and solved.swapped,
            same_for_s=max(memory.heard[i].same_for_s for i in self._solver.receivers),
            speed_m_s=motion.speed_m_s,
            stale_sensors=stale,
            jumped_joints=self._jumped(memory.posture),
            checked=checked,
            baseline_sigma_m=math.nan if solved is None else solved.baseline_sigma_m,
            heading_sigma=sigma,
            agreement=again,
            new_age_s=math.nan if solved is None else (now_ns - solved.valid_ns) * 1e-9,
        )

    def _jumped(self, posture: PostureMemory) -> tuple[str, ...]:
        if not any(was is not None for was in posture.jumped):
            return ()
        return tuple(
            name for name, was in zip(self.machine.joint_names, posture.jumped, strict=True) if was is not None
        )

    def _innovation(self, known: Solved, solved: Solved, motion: Motion) -> float:
        """Return how far a solution lies from the pose carried on, in sigmas, over position and yaw together."""
        T, covariance, _ = self._carried(known, motion, solved.valid_ns)
        yaw = math.atan2(solved.T[1, 0], solved.T[0, 0]) - math.atan2(T[1, 0], T[0, 0])
        difference = np.append(solved.T[:3, 3] - T[:3, 3], math.remainder(yaw, 2.0 * math.pi))
        keep = np.array([0, 1, 2, 5])
        return sigmas(difference, (covariance + solved.covariance)[keep[:, None], keep])

    def _headings(self, memory: LocatorMemory, solved: Solved) -> tuple[float, float]:
        """Return (difference of headings, its sigma): to the track or a compass, else to the course over ground."""
        if math.isfinite(solved.heading_difference):
            return solved.heading_difference, solved.heading_sigma
        yaw, sigma = math.atan2(solved.T[1, 0], solved.T[0, 0]), math.sqrt(float(solved.covariance[5, 5]))
        if (memory.health.swapped or solved.swapped) and memory.solved is not None:
            known = self._known(memory, solved.valid_ns)
            return math.remainder(yaw - known.yaw, 2.0 * math.pi), math.hypot(sigma, known.yaw_sigma)
        motion = memory.motion
        if motion.standing or abs(motion.yaw_rate) > FASTEST_TURN or solved.along is not None:
            return math.nan, math.nan
        course = math.atan2(motion.velocity[1], motion.velocity[0])
        slowest = max(SLOWEST_COURSE_M_S, 5.0 * motion.sigma)
        difference = course_difference(yaw, course, motion.speed_m_s, slowest, None)
        return difference, math.hypot(sigma, course_sigma(motion.speed_m_s, motion.sigma))

    def _taken(self, memory: LocatorMemory, solved: Solved, accept: bool, seen: HealthSeen) -> LocatorMemory:
        """Return the memory with the epoch's solution in it, accepted or refused."""
        if not accept:
            return replace(memory, refused=_candidate(solved))
        x, y, z = solved.T[:3, 3].tolist()
        past = Past(
            solved.valid_ns,
            solved.quality,
            x,
            y,
            z,
            math.atan2(solved.T[1, 0], solved.T[0, 0]),
            float(max(solved.covariance[0, 0], solved.covariance[1, 1])),
            float(solved.covariance[5, 5]),
        )
        jumped = seen.innovation > self.spec.thresholds.innovation_sigmas
        history = (past,) if jumped else remembered(memory.history, past)
        track = None if solved.along is None or self.track is None else self.track.alignment.name
        memory = replace(memory, solved=solved, history=history, refused=None, track=track)
        return replace(memory, motion=self._motion(memory, solved))

    def _motion(self, memory: LocatorMemory, solved: Solved) -> Motion:
        """Return how the undercarriage moves, from its solutions, the receiver's velocity and a gyro."""
        found = slope(memory.history)
        motion = Motion(standing=False)
        if found is not None:
            (x, y, z), yaw_rate, sigma, yaw_sigma, over = found
            motion = Motion((float(x), float(y), float(z)), yaw_rate, sigma, yaw_sigma, over, False)
        index = self._solver.receivers[0]
        velocity = next((one.velocity for one in reversed(memory.heard[index].epochs) if one.key == solved.key), None)
        if velocity is not None or memory.gyro is not None:
            kin = self.machine.forward(solved.q)
            if solved.along is None:  # rails say how it turns
                motion = gyro_rate(self.machine, kin, memory.posture, solved, memory.gyro, motion)
            antenna = self._solver.wanted[0]
            motion = antenna_velocity(self.machine, kin, memory.posture, solved, velocity, self._crs, antenna, motion)
        if solved.along is not None:
            motion = _along(motion, solved)
        standing = self.spec.thresholds.standing_m_s
        return settled(motion, standing, 0.5 * self.machine.undercarriage.gauge_m)

    def _now(self, memory: LocatorMemory, now_ns: int) -> tuple[Floats, Floats, float] | None:
        """Return the pose of the newest accepted solution and its covariance now, or when the chassis was frozen."""
        if memory.solved is None:
            return None
        until = now_ns if memory.frozen_ns is None else memory.frozen_ns
        return self._carried(memory.solved, memory.motion, until)

    def _pose(
        self, memory: LocatorMemory, now: tuple[Floats, Floats, float] | None, now_ns: int
    ) -> MachinePose | None:
        if now is None or memory.solved is None:
            return None
        T, covariance, _ = now
        covariance = 0.5 * (covariance + covariance.T)
        freeze(covariance)
        return MachinePose(Stamp(self.machine_id, now_ns, SOURCE, memory.solved.epoch_ns), frozen(T), covariance)

    def _posture(self, memory: PostureMemory, now_ns: int, stale: bool) -> Posture | None:
        found = self._bender.now(memory, now_ns)
        if found is None:
            return None
        q, covariance = found
        arrived = min(memory.recent[-1].valid_ns) if stale else now_ns
        stamp = Stamp(self.machine_id, min(arrived, now_ns), SOURCE)
        return Posture(stamp, q, frozen(np.sqrt(covariance.diagonal())), covariance)

    def _unheard(self, memory: LocatorMemory) -> tuple[Reason, ...]:
        """Return a reason for each receiver needed that gave no fix yet."""
        silent = [self.spec.receivers[i] for i in self._solver.receivers if not memory.heard[i].epochs]
        return tuple(
            Reason(ReasonCode.POSITION_LOST, f"no fix heard of {one.name}, port {one.port}") for one in silent
        )

    def _beside(self, health: PositionHealth, fixes: GridFixes) -> PositionHealth:
        """Return the health of accepted fixes that contradict the track: stop, since either may be wrong."""
        limit = self.spec.thresholds.innovation_sigmas
        text = f"{fixes.off_track}, limit {limit:g} sigma: sensors and track contradict each other"
        reasons = (Reason(ReasonCode.SENSOR_DISAGREES, text), *health.reasons)
        return replace(health, state=HealthState.STOP, reasons=reasons)


def _partner(epoch: Epoch, epochs: Sequence[Epoch]) -> Epoch | None:
    """Return the other receiver's epoch of the same time."""
    for one in reversed(epochs):
        if one.key == epoch.key or (
            min(one.key, epoch.key) < 0 and abs(one.valid_ns - epoch.valid_ns) <= TOGETHER_NS
        ):
            return one
    return None


def _candidate(solved: Solved) -> Candidate:
    return Candidate.of(solved.valid_ns, solved.T[:3, 3], solved.covariance[:3, :3])


def _along(motion: Motion, solved: Solved) -> Motion:
    """Return the motion of a machine that its rails lead: along them, turning as they do."""
    assert solved.along is not None
    x, y, z = solved.along
    speed = motion.velocity[0] * x + motion.velocity[1] * y + motion.velocity[2] * z
    plan = math.hypot(x, y)
    return replace(
        motion,
        velocity=(speed * x, speed * y, speed * z),
        yaw_rate=speed * plan * solved.curvature,
        yaw_sigma=motion.sigma * abs(solved.curvature),
    )
