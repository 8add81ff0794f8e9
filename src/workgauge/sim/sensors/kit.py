"""All simulated sensors of a machine, as its file's `positioning:` section has them: truth in, bytes out."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from functools import partial

from numpy.typing import ArrayLike

from workgauge.geodesy.crs import ProjectedCrs
from workgauge.geodesy.frame import SiteFrame
from workgauge.machine.model import MachineModel
from workgauge.machine.positioning import PositioningSpec
from workgauge.sim.sensors.faults import Identity, check_targets
from workgauge.sim.sensors.gnss import GnssBank
from workgauge.sim.sensors.line import Outbox, Wiring
from workgauge.sim.sensors.linkbank import LinkBank
from workgauge.sim.sensors.motion import Motion, TrueState, motion_at
from workgauge.sim.sensors.settings import RATES_HZ, SensorSettings
from workgauge.values.arrays import frozen
from workgauge.values.errors import GeodesyError, MachineError, ScenarioError
from workgauge.values.ports import Chunk
from workgauge.wire.messages import NAME_BYTES

#: UTC of the first epoch, where nobody says another.
START_UTC = datetime(2026, 3, 2, 8, 0, 0, tzinfo=UTC)

_SECOND_NS = 10**9


class SensorKit:
    """A machine's receivers, inclinometers, encoders and gyros.

    Call `advance` with the true state after every substep of the plant, first with the state at the start; then
    `read` for what has arrived. Epochs lie on whole multiples of each sensor's period in UTC; between two states the
    truth is taken as moving at constant rates. The same seed, settings and truth give the same bytes; what one sensor
    is set to does not change the random numbers of another.

    Args:
        machine: with a `positioning` section.
        crs, frame: of the site, in whose local coordinates the truth is given. The receivers' datum is the site's.
        settings: rates, noise, faults; None for the defaults, with the noise of the machine's file.
        seed: of all random numbers, not negative.
        machine_id: whose frames they are.
        start_utc: UTC at `start_ns`, with a time zone.
        start_ns: the plant's clock at the first `advance` [ns].

    Raises:
        MachineError: the machine has no `positioning` section, or a sensor in it that does not exist.
        GeodesyError: the site says no coordinate system, or the machine names a geoid grid that cannot be used.
        ScenarioError: settings or faults for receivers or sensors the machine has not.
    """

    def __init__(
        self,
        machine: MachineModel,
        crs: ProjectedCrs | None,
        frame: SiteFrame,
        settings: SensorSettings | None = None,
        seed: int = 1,
        machine_id: str = "machine",
        start_utc: datetime = START_UTC,
        *,
        start_ns: int = 0,
    ) -> None:
        settings = settings or SensorSettings()
        positioning = _section(machine)
        if crs is None:
            raise GeodesyError(
                "simulated receivers need the site's coordinate system",
                element="site",
                allowed="a site whose files name one, or its EPSG number",
            )
        _check_each(positioning, settings)
        self._machine = machine
        self._start_ns = start_ns
        self._utc_start_ns = (start_utc - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(microseconds=1) * 1000
        self._outbox = Outbox()
        wiring = Wiring(machine_id, seed, start_ns, settings.faults, self._outbox)
        self._gnss = GnssBank(machine, positioning, settings, crs, frame, wiring)
        self._links = LinkBank(machine, positioning, settings.links, wiring)
        check_targets(settings.faults, self._identities())
        self._rounds = self._schedule(settings)
        self._state: TrueState | None = None

    @property
    def ports(self) -> tuple[str, ...]:
        """The ports it writes to, sorted."""
        return tuple(sorted({identity.port for identity in self._identities()}))

    def advance(self, now_ns: int, q: ArrayLike, T_site_machine: ArrayLike) -> None:
        """Take in the true state at `now_ns`: joint positions (n,) and the pose (4, 4) in the site's local frame.

        Raises:
            ValueError: if time does not go forwards, or the shapes are wrong.
        """
        after = TrueState(now_ns, frozen(q, (self._machine.n,)), frozen(T_site_machine, (4, 4)))
        before = self._state or after
        if now_ns < before.t_ns or now_ns < self._start_ns:
            raise ValueError(f"time goes forwards, not from {max(before.t_ns, self._start_ns)} to {now_ns} ns")
        if self._state is None:
            for one in self._rounds:
                one.skip_to(now_ns)
        self._state = after
        while (t_ns := min(one.next_ns for one in self._rounds)) <= now_ns:
            motion = motion_at(self._machine, before, after, t_ns)
            utc_ns = self._utc_start_ns + t_ns - self._start_ns
            for one in self._rounds:
                if one.next_ns == t_ns:
                    one.measure(motion, utc_ns)
                    one.next_ns += one.period_ns

    def read(self, now_ns: int) -> list[Chunk]:
        """Return what has arrived by `now_ns` since the last call, oldest first, each chunk with its own arrival."""
        return self._outbox.take(now_ns)

    def _identities(self) -> tuple[Identity, ...]:
        """Return whom a fault can befall."""
        lines = [one.line for one in self._gnss.receivers]
        lines += [one.line for one in self._links.sensors]
        if self._gnss.heading is not None:
            lines.append(self._gnss.heading.line)
        return tuple(line.identity for line in lines)

    def _schedule(self, settings: SensorSettings) -> tuple["_Round", ...]:
        """Return who measures together how often, and when first."""
        gnss = self._gnss
        rounds: list[_Round] = []
        for rate_hz in RATES_HZ:
            due = [one for one in gnss.receivers if one.settings.rate_hz == rate_hz]
            if due:
                rounds.append(_Round(rate_hz, partial(gnss.measure, due)))
        if gnss.heading is not None:
            rounds.append(_Round(settings.heading.rate_hz, gnss.measure_heading))
        rounds.append(_Round(settings.links.rate_hz, self._links.measure))
        for one in rounds:
            one.next_ns = self._start_ns + (-self._utc_start_ns) % one.period_ns
        return tuple(rounds)


class _Round:
    """Sensors that measure at the same times."""

    def __init__(self, rate_hz: int, measure: Callable[[Motion, int], None]) -> None:
        self.period_ns = _SECOND_NS // rate_hz
        self.next_ns = 0
        self.measure = measure

    def skip_to(self, now_ns: int) -> None:
        """Leave out the epochs before a time."""
        if self.next_ns < now_ns:
            self.next_ns += -(-(now_ns - self.next_ns) // self.period_ns) * self.period_ns


def _section(machine: MachineModel) -> PositioningSpec:
    """Return the machine's `positioning` section, every sensor of it there and with a name that fits a frame."""
    section = machine.positioning
    if section is None:
        raise MachineError(
            "simulated sensors need a `positioning` section in the machine's file",
            element=machine.name,
            allowed="a machine with one, or perfect sensors",
        )
    known = {sensor.name for sensor in machine.sensors}
    heading = (section.heading.master, section.heading.rover)
    joints = [name for spec in section.joints for name in (spec.sensor, spec.before)]
    named = (*(spec.antenna for spec in section.receivers), *heading, section.tilt.sensor, *joints)
    for name in named:
        if name is not None and name not in known:
            raise MachineError(
                "no such sensor", element="positioning", value=name, allowed=", ".join(sorted(known)) or "none"
            )
        if name is not None and len(name.encode()) > NAME_BYTES:
            raise MachineError(
                "a sensor's name too long to be sent",
                element="positioning",
                value=name,
                allowed=f"{NAME_BYTES} bytes",
            )
    for spec in section.joints:
        if spec.joint not in machine.joint_names:
            raise MachineError(
                "no such joint", element="positioning", value=spec.joint, allowed=", ".join(machine.joint_names)
            )
    return section


def _check_each(section: PositioningSpec, settings: SensorSettings) -> None:
    """Refuse settings for a receiver the machine has not."""
    known = [spec.name for spec in section.receivers]
    for name in settings.each:
        if name not in known:
            raise ScenarioError(
                "no such receiver", element="sensors.receivers.each", value=name, allowed=", ".join(known)
            )
