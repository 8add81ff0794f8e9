"""A session whose undercarriage stands where real receivers say, the rest of the machine simulated."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from workgauge.geodesy.crs import ProjectedCrs
from workgauge.geodesy.frame import SiteFrame
from workgauge.machine.model import MachineModel
from workgauge.motion.job import Job
from workgauge.rehearse.located_log import machine_id_of, positioning_of
from workgauge.rehearse.navigation import Known, Navigator
from workgauge.rehearse.receivers import Receivers, near_of
from workgauge.rehearse.session import Session
from workgauge.rehearse.standing import receiver_ports
from workgauge.rehearse.step_result import StepResult
from workgauge.sim.sensors.kit import SensorKit
from workgauge.sim.sensors.settings import HeadingSettings, LinkSettings, ReceiverSettings, SensorSettings
from workgauge.site.alignment import Alignment
from workgauge.site.model import SiteModel
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import GeodesyError, ScenarioError
from workgauge.values.measurements import Intent
from workgauge.values.ports import Chunk
from workgauge.wire.stream import Tally

#: A run on receivers ends after this long [s], shorter than any drive may last.
LONGEST_S = 890.0


class MixedSource:
    """Receivers' bytes from outside; link sensors' of a machine with its joints at home, tilted as the simulated one.

    The receivers' antennas did not move with the simulated joints, so the machine they stood on is not bent by them.

    Args:
        machine: with a `positioning` section. crs, frame: of the site; what the link sensors say does not depend on
            where the frame lies. receivers: on the session's clock.
    """

    def __init__(self, machine: MachineModel, crs: ProjectedCrs, frame: SiteFrame, receivers: Receivers) -> None:
        self._receivers = receivers
        self._home = machine.home
        self._outside = frozenset(receiver_ports(positioning_of(machine)))
        settings = SensorSettings(
            receivers=ReceiverSettings(rate_hz=1),
            heading=HeadingSettings(rate_hz=1),
            links=LinkSettings(scale=0.0, gyros=False),
        )
        self._kit = SensorKit(machine, crs, frame, settings, machine_id=machine_id_of(machine))

    def advance(self, now_ns: int, q: Floats, T_site_machine: Floats) -> None:
        """Let the tilt sensor see how the machine stands; its joints do not count."""
        self._kit.advance(now_ns, self._home, T_site_machine)

    def read(self, now_ns: int) -> list[Chunk]:
        """Return what arrived by now, oldest first."""
        links = [chunk for chunk in self._kit.read(now_ns) if chunk.port not in self._outside]
        return sorted((*links, *self._receivers.read(now_ns)), key=lambda chunk: chunk.received_ns)


class SimulatedJoints:
    """Pose and health as a navigator finds them, joints as the simulated machine truly has them.

    Args:
        navigator: for the pose. joints: gives the true joint positions (n,).
    """

    def __init__(self, navigator: Navigator, joints: Callable[[], Floats]) -> None:
        self._navigator, self._joints = navigator, joints

    @property
    def tallies(self) -> Mapping[str, Tally]:
        """What became of the sentences and messages of each port."""
        return self._navigator.tallies

    def take(self, chunks: Sequence[Chunk], now_ns: int, track: Alignment | None) -> Known:
        """Return what is known now; the joints' 1-sigma is that of the machine's own sensors."""
        known = self._navigator.take(chunks, now_ns, track)
        if known.posture is None:
            return known
        stamp = replace(known.posture.stamp, monotonic_ns=now_ns)
        return replace(known, posture=replace(known.posture, stamp=stamp, q=frozen(self._joints())))


class GnssSession(Session):
    """A session on receivers from outside; it begins where their first usable position is.

    There is no truth for the undercarriage but the position itself: it is put where the position says, after every
    step. Joints are the simulated machine's; the machine the receivers stood on is taken to have had them at home.

    Args:
        receivers: logs or ports. site, machine: read. arguments: of `Session`, without a place and without sensors.

    Raises:
        InputError: if receivers, machine and site do not fit together.
    """

    def __init__(self, receivers: Receivers, site: SiteModel, machine: MachineModel, **arguments: Any) -> None:
        positioning_of(machine)
        if site.crs is None:
            raise GeodesyError(
                "receivers need the site's coordinate system",
                element="site",
                allowed="files that name one, or --epsg N",
            )
        self._receivers = receivers
        self._gone: tuple[str, ...] = ()
        frame = site.frame()
        at = near_of(receivers.first_pose(machine, site.crs, frame), frame)
        source = MixedSource(machine, site.crs, frame, receivers)
        try:
            super().__init__(site=site, machine=machine, at=at, source=source, **arguments)
        except ScenarioError as error:
            raise ScenarioError(
                f"where the receivers put the machine: {error.message}",
                file=error.file,
                element=error.element,
                value=error.value,
                allowed=error.allowed,
            ) from error
        left_s = getattr(receivers, "left_s", 0.0)
        said = [*self.stand.warnings, *receivers.warnings]
        if left_s > LONGEST_S:
            said.append(f"the run ends after {LONGEST_S:g} s; the log goes on for {left_s - LONGEST_S:.0f} s more")
        self.stand = replace(self.stand, warnings=tuple(said))
        self.senses = replace(
            self.senses,
            words=f"receivers: {receivers.words}; joints simulated, free of noise",
            assumption=(
                f"Positions come from {receivers.words}; the machine there is taken to have had its joints at home. "
                "Joints and tilt are simulated, and measured without noise."
            ),
        )
        self._belief.navigator = SimulatedJoints(self._belief.navigator, lambda: self._true.plant.truth[0])
        receivers.begin()

    @property
    def standing_assumption(self) -> str:
        """What a run takes for granted of its undercarriage."""
        return (
            "The undercarriage stands where the position says: there is no other truth for it, so clearances are as "
            "true as the position is, and a wrong position does not show as an entry."
        )

    @property
    def finished(self) -> bool:
        """Whether the receivers have no more to say, or the run has lasted long enough."""
        return self._receivers.finished(self._now_ns) or self.t_s >= LONGEST_S

    def step(self, intent: Intent | None = None, job: Job | None = None) -> StepResult:
        """Advance one tick once its time has come, then stand where the position says.

        A device that was unplugged becomes a warning of the session's stand.
        """
        self._receivers.wait_until(self._now_ns)
        done = super().step(intent, job)
        gone = self._receivers.faults
        new = tuple(f"at {done.t_s:.1f} s: {fault}" for fault in gone if fault not in self._gone)
        if new:
            self.stand = replace(self.stand, warnings=(*self.stand.warnings, *new))
        self._gone = gone
        if done.known.pose is not None:
            self._true.plant.stand_at(done.known.pose.T_site_machine)
        return done
