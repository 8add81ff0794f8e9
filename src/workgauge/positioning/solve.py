"""One epoch's fixes, heading and tilt become a pose of the undercarriage, and what shows whether they agree."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from workgauge.geodesy.crs import ProjectedCrs
from workgauge.geodesy.frame import SiteFrame
from workgauge.geodesy.heights import HeightModel
from workgauge.machine.model import Kinematics, MachineModel
from workgauge.machine.positioning import FixSigmas, PositioningSpec
from workgauge.positioning.antennas import (
    PlacedAntenna,
    PoseSolution,
    Tilt,
    baseline,
    moving_base_pose,
    two_antenna_pose,
)
from workgauge.positioning.headings import opposite, turned_by_heights
from workgauge.positioning.memory import GridFix, GridFixes, Solved
from workgauge.positioning.posture import PostureSolution, PostureSolver, Reading
from workgauge.positioning.rails import Azimuth, RailSolution, on_rails
from workgauge.positioning.timing import Epoch, TimedHeading
from workgauge.positioning.track import RailTrack
from workgauge.values.arrays import Floats, freeze, frozen
from workgauge.values.navigation import FixQuality
from workgauge.values.transforms import heading_from_yaw

#: Qualities a position is worked with, worst first.
USED = (FixQuality.SINGLE, FixQuality.PPS, FixQuality.DIFFERENTIAL, FixQuality.FLOAT, FixQuality.FIXED)
#: A heading less sure than this shows nothing of the antennas' order or the way a machine faces [rad].
SURE_HEADING = math.radians(20.0)


class Known(NamedTuple):
    """What was known before the epoch: the yaw carried on to it, the place along the track, NaN without."""

    yaw: float = math.nan
    yaw_sigma: float = math.nan
    distance: float = math.nan


@dataclass(frozen=True, slots=True, eq=False)
class Given:
    """What one epoch gives.

    Attributes:
        epochs: receiver and epoch, the master's first. heading: of a moving base or a compass.
        posture, tilt_reading: of the link sensors, at the time of the epoch.
    """

    epochs: tuple[tuple[int, Epoch], ...]
    heading: TimedHeading | None
    posture: PostureSolution
    tilt_reading: Reading


class EpochSolver:
    """Solves epochs of one machine on one site; immutable.

    Args:
        machine: with a `positioning` section. heights: how a fix's height becomes the site's.
        track: the track it stands on, None off rails.
    """

    def __init__(
        self,
        machine: MachineModel,
        spec: PositioningSpec,
        crs: ProjectedCrs,
        frame: SiteFrame,
        heights: HeightModel,
        posture: PostureSolver,
        track: RailTrack | None,
    ) -> None:
        self.machine, self.spec, self.track = machine, spec, track
        self._crs, self._frame, self._heights, self._posture = crs, frame, heights, posture
        self._sensors = {sensor.name: (sensor.link, sensor.T_link_sensor[:3, 3]) for sensor in machine.sensors}
        antennas = [receiver.antenna for receiver in spec.receivers]
        self.two = spec.heading.kind == "two_antennas"
        first = spec.heading.master if spec.heading.master in antennas else antennas[0]
        self.wanted = (first, spec.heading.rover) if self.two else (first,)
        #: The receivers used, master first.
        self.receivers = tuple(antennas.index(name) for name in self.wanted)

    def solve(self, given: Given, known: Known) -> Solved | None:
        """Return the pose at an epoch, None if it gives none: no fix to work with, no height, no heading."""
        placed = self._placed(given.epochs)
        if placed is None:
            return None
        fixes, antennas = placed
        machine, joints = self.machine, given.posture.covariance
        kin = machine.forward(given.posture.q)
        channel = self._posture.channels[0]
        tilt = Tilt(
            channel.link,
            np.array(self._posture.up(0, given.tilt_reading)),
            self._posture.up_covariance(0, given.tilt_reading),
            given.posture.tilt_cross,
        )
        master, rover = self._sensors[self.spec.heading.master], self._sensors[self.spec.heading.rover]
        arm, arm_gain = baseline(machine, kin, master, rover)
        azimuth = None
        if self.two:
            share = self.spec.heading.shared_error
            free = two_antenna_pose(
                machine, kin, antennas[0], antennas[1], tilt, joints, common_share=share, cautious=True
            )
        else:
            azimuth = self._azimuth(given.heading, fixes[0].position, arm, arm_gain)
            if azimuth is None:
                return None
            free = moving_base_pose(
                machine, kin, antennas[0], azimuth.angle, azimuth.sigma, (arm, arm_gain), tilt, joints
            )
        if free is None or not np.isfinite(free.T_site_machine).all():
            return None
        rails = self._on_rails(kin, antennas, azimuth, tilt, joints, free, known)
        return self._checked(given, known, fixes, antennas, arm, free, rails)

    def _placed(
        self, epochs: Sequence[tuple[int, Epoch]]
    ) -> tuple[tuple[GridFix, ...], tuple[PlacedAntenna, ...]] | None:
        """Return the fixes in grid coordinates and the antennas with their places; None if one is of no use."""
        found = [epoch.fix for _, epoch in epochs if epoch.fix is not None and epoch.quality in USED]
        if len(found) < len(epochs):
            return None
        e, n = self._crs.from_geodetic([fix.latitude for fix in found], [fix.longitude for fix in found])
        fixes, antennas = [], []
        for i, ((receiver, epoch), fix) in enumerate(zip(epochs, found, strict=True)):
            spec = self.spec.receivers[receiver]
            position = np.array([e[i], n[i], self._heights.height(fix)])
            if not np.isfinite(position).all():
                return None
            covariance = believed_covariance(epoch, spec.sigmas)
            fixes.append(
                GridFix(spec.name, spec.antenna, epoch.epoch_ns, frozen(position), covariance, epoch.quality)
            )
            link, place = self._sensors[spec.antenna]
            antennas.append(PlacedAntenna(link, place, self._frame.to_local(position), covariance))
        return tuple(fixes), tuple(antennas)

    def _azimuth(self, timed: TimedHeading | None, position: Floats, arm: Floats, arm_gain: Floats) -> Azimuth | None:
        """Return a moving base's azimuth on the grid: grid heading = true heading - convergence."""
        if timed is None or not math.isfinite(timed.heading.heading):
            return None
        if timed.heading.quality is FixQuality.NONE:
            return None
        heading = timed.heading.heading - float(self._crs.convergence(position[0], position[1]))
        floor = math.radians(self.spec.heading.sigma_deg)
        stated = timed.heading.sigma
        return Azimuth(math.pi / 2 - heading, stated if stated > floor else floor, arm, arm_gain)

    def _on_rails(
        self,
        kin: Kinematics,
        antennas: tuple[PlacedAntenna, ...],
        azimuth: Azimuth | None,
        tilt: Tilt,
        joints: Floats,
        free: PoseSolution,
        known: Known,
    ) -> RailSolution | None:
        if self.track is None:
            return None
        T, origin = free.T_site_machine, self._frame.origin
        e, n = float(T[0, 3] + origin[0]), float(T[1, 3] + origin[1])
        start = self.track.nearest(e, n, known.distance)
        yaw = known.yaw if math.isfinite(known.yaw) else math.atan2(T[1, 0], T[0, 0])
        return on_rails(
            self.machine,
            kin,
            self.track,
            self.spec.rails,
            origin,
            antennas,
            azimuth,
            tilt,
            joints,
            start=start,
            forward=math.cos(self.track.yaw(start) - yaw) >= 0.0,
            common_share=self.spec.heading.shared_error,
        )

    def _checked(
        self,
        given: Given,
        known: Known,
        fixes: tuple[GridFix, ...],
        antennas: tuple[PlacedAntenna, ...],
        arm: Floats,
        free: PoseSolution,
        rails: RailSolution | None,
    ) -> Solved:
        """Return the solution with what shows whether its parts agree."""
        limits = self.spec.thresholds
        epochs = [epoch for _, epoch in given.epochs]
        T = free.T_site_machine
        yaw, yaw_sigma = math.atan2(T[1, 0], T[0, 0]), math.sqrt(max(0.0, float(free.covariance[5, 5])))
        off_track = "" if rails is None else contradiction(rails, limits.innovation_sigmas)
        beside = bool(off_track)
        used = free if rails is None or beside else rails.pose
        difference, sigma = self._compared(given, known, fixes, antennas, None if beside else rails, yaw, yaw_sigma)
        tolerance = max(math.radians(limits.heading_deg), limits.innovation_sigmas * sigma)
        swapped = sigma < SURE_HEADING and opposite(difference, tolerance)
        if math.isfinite(known.yaw) and math.hypot(known.yaw_sigma, yaw_sigma) < SURE_HEADING:
            turned = math.radians(limits.heading_deg) + 3.0 * math.hypot(known.yaw_sigma, yaw_sigma)
            swapped = swapped or opposite(yaw - known.yaw, turned)
        error, error_sigma = self._baseline(given.heading, antennas, arm)
        if self.two:
            S = antennas[0].covariance + antennas[1].covariance
            S = S + np.eye(3) * (math.hypot(*arm[:2]) * math.sqrt(float(free.covariance[3:5, 3:5].trace()))) ** 2
            measured = antennas[1].position - antennas[0].position
            shown = turned_by_heights(measured, T[:3, :3] @ arm, S, limits.innovation_sigmas)
            swapped = swapped or shown is True
        along, distance, curvature = self._rails_of(used, rails, beside)
        heading = heading_from_yaw(yaw)
        grid = GridFixes(
            epochs[0].valid_ns,
            fixes,
            heading,
            off_track,
        )
        ages = [epoch.correction_age_s for epoch in epochs if math.isfinite(epoch.correction_age_s)]
        return Solved(
            valid_ns=epochs[0].valid_ns,
            epoch_ns=epochs[0].epoch_ns,
            key=epochs[0].key,
            quality=min((epoch.quality for epoch in epochs), key=USED.index),
            correction_age_s=max(ages, default=math.nan),
            T=used.T_site_machine,
            covariance=used.covariance,
            cross=used.cross,
            fixes=grid,
            along=along,
            distance=distance,
            curvature=curvature,
            baseline_error_m=error,
            baseline_sigma_m=error_sigma,
            heading_difference=difference,
            heading_sigma=sigma,
            swapped=swapped,
            q=given.posture.q,
        )

    def _compared(
        self,
        given: Given,
        known: Known,
        fixes: tuple[GridFix, ...],
        antennas: tuple[PlacedAntenna, ...],
        rails: RailSolution | None,
        yaw: float,
        yaw_sigma: float,
    ) -> tuple[float, float]:
        """Return (heading less the track's or a compass's, its 1-sigma) [rad], NaN with nothing to compare."""
        difference, sigma = math.nan, math.nan
        if rails is not None and self.track is not None and math.isfinite(known.yaw):
            facing = self.track.yaw(rails.distance) + (0.0 if rails.forward else math.pi)
            difference = math.remainder(facing - yaw, 2.0 * math.pi)
            sigma = math.hypot(yaw_sigma, math.sqrt(float(rails.pose.covariance[5, 5])))
        elif self.two and given.heading is not None and math.isfinite(given.heading.heading.heading):
            measured = antennas[1].position - antennas[0].position
            convergence = float(self._crs.convergence(fixes[0].position[0], fixes[0].position[1]))
            other = math.pi / 2 - (given.heading.heading.heading - convergence)
            difference = math.remainder(other - math.atan2(measured[1], measured[0]), 2.0 * math.pi)
            sigma = math.hypot(yaw_sigma, max(math.radians(self.spec.heading.sigma_deg), given.heading.heading.sigma))
        return difference, sigma

    def _rails_of(
        self, used: PoseSolution, rails: RailSolution | None, beside: bool
    ) -> tuple[tuple[float, float, float] | None, float, float]:
        if rails is None or beside:
            return None, math.nan, 0.0
        x, y, z = (used.T_site_machine[:3, 0] * (1.0 if rails.forward else -1.0)).tolist()
        return (x, y, z), rails.distance, rails.curvature

    def _baseline(
        self, timed: TimedHeading | None, antennas: tuple[PlacedAntenna, ...], arm: Floats
    ) -> tuple[float, float]:
        """Return (measured less known distance of the antennas, its 1-sigma) [m]; NaN if not measured."""
        known = math.sqrt(float(arm @ arm))
        if self.two:
            way = antennas[1].position - antennas[0].position
            measured = math.sqrt(float(way @ way))
            unit = way / max(measured, 1e-9)
            return measured - known, math.sqrt(float(unit @ (antennas[0].covariance + antennas[1].covariance) @ unit))
        return (math.nan if timed is None else timed.heading.baseline_m - known), math.nan


def contradiction(rails: RailSolution, sigmas: float) -> str:
    """Return in words where the sensors contradict the track by more than so many sigmas; empty where they do not."""
    across, above, roll, pitch = rails.across, rails.above, rails.roll, rails.pitch
    words = []
    if across.sigmas > sigmas:
        side = "left" if across.amount > 0.0 else "right"
        words.append(f"receivers lie {abs(across.amount):.2f} m {side} of the track ({across.sigmas:.1f} sigma)")
    if above is not None and above.sigmas > sigmas:
        side = "above" if above.amount > 0.0 else "below"
        words.append(f"receivers lie {abs(above.amount):.2f} m {side} the track ({above.sigmas:.1f} sigma)")
    if roll.sigmas > sigmas:
        turned = abs(math.degrees(roll.amount))
        words.append(f"the inclinometer leans {turned:.1f}° off the track's cant ({roll.sigmas:.1f} sigma)")
    if pitch is not None and pitch.sigmas > sigmas:
        turned = abs(math.degrees(pitch.amount))
        words.append(f"the inclinometer leans {turned:.1f}° off the track's gradient ({pitch.sigmas:.1f} sigma)")
    return ", ".join(words)


def believed_covariance(epoch: Epoch, sigmas: FixSigmas) -> Floats:
    """Return the covariance (3, 3) of a fix: what the receiver states, in no direction below the configured.

    With F the configured one of its quality and C the stated, the eigenvalues of F^-1/2 C F^-1/2 below one are
    raised to one.
    """
    pair = sigmas.of(epoch.quality)
    root = np.array([pair[0], pair[0], pair[1]])
    stated = epoch.covariance
    if stated is None or not np.isfinite(stated).all():
        return frozen(np.diag(root * root))
    white = stated / np.outer(root, root)
    if not white[0, 1] and not white[0, 2] and not white[1, 2]:
        return frozen(np.diag(np.maximum(white.diagonal(), 1.0) * root * root))
    values, vectors = np.linalg.eigh(white)
    out: Floats = np.outer(root, root) * ((vectors * np.maximum(values, 1.0)) @ vectors.T)
    out = 0.5 * (out + out.T)
    freeze(out)
    return out
