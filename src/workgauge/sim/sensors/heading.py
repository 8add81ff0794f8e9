"""The heading of a moving base: one receiver's measured baseline to another antenna, with its error and its bytes."""

import math

import numpy as np

from workgauge.machine.positioning import HeadingSpec
from workgauge.sim.sensors.faults import Fault, FaultKind, lowered, one
from workgauge.sim.sensors.line import Line, Wiring
from workgauge.sim.sensors.randomness import GaussMarkov, White, generator
from workgauge.sim.sensors.receiver import DAY_NS, TALKER
from workgauge.sim.sensors.settings import HeadingSettings
from workgauge.values.arrays import Floats
from workgauge.values.measurements import Stamp
from workgauge.values.navigation import FixQuality, GnssHeading
from workgauge.wire.nmea import nmea_bytes
from workgauge.wire.ubx import ubx_bytes

#: A baseline whose ambiguities are not fixed is this much worse.
FLOAT_FACTOR = 10.0

#: Pitch is this much worse than heading, as heights are than horizontal positions.
PITCH_FACTOR = 2.0


class MovingBase:
    """The heading of a moving base and its line.

    Args:
        spec: of the machine's file. settings: how it behaves. line: where its bytes go.
        wiring: shared with all sensors.
    """

    def __init__(
        self,
        spec: HeadingSpec,
        settings: HeadingSettings,
        line: Line,
        wiring: Wiring,
    ) -> None:
        self.spec = spec
        self.settings = settings
        self.line = line
        self._machine_id = wiring.machine_id
        self._sigma = math.radians(spec.sigma_deg)
        self._white = White(generator(wiring.seed, "heading", "white"), 3)
        self._slow = GaussMarkov(generator(wiring.seed, "heading", "slow"), settings.correlation_s, wiring.origin_ns)
        self._last: tuple[float, float, float, FixQuality] | None = None

    def send(self, t_ns: int, utc_ns: int, baseline: Floats, convergence: float, active: tuple[Fault, ...]) -> None:
        """Measure the baseline (3,) from master to rover, east, north, up of the grid [m], and write its bytes.

        True heading = grid heading + `convergence` [rad].
        """
        quality = lowered(FixQuality.FIXED, active)
        length = float(np.linalg.norm(baseline))
        share = self.settings.correlated
        unit = math.sqrt(1.0 - share) * self._white.draw() + math.sqrt(share) * self._slow.at(t_ns)
        sigma = self._sigma * (1.0 if quality is FixQuality.FIXED else FLOAT_FACTOR)
        error = unit * self.settings.scale * sigma
        heading = math.atan2(baseline[0], baseline[1]) + convergence + error[0]
        pitch = math.atan2(baseline[2], math.hypot(baseline[0], baseline[1])) + PITCH_FACTOR * error[1]
        found = (heading % (2.0 * math.pi), pitch, length * (1.0 + error[2]), quality)
        if one(active, FaultKind.FROZEN) is not None and self._last is not None:
            found = self._last
        self._last = found
        for fault in active:
            if fault.kind is FaultKind.CLOCK_STEP:
                utc_ns += round(fault.step_s * 1e9)
        self._write(t_ns, utc_ns, found, sigma, active)

    def _write(
        self,
        t_ns: int,
        utc_ns: int,
        found: tuple[float, float, float, FixQuality],
        sigma: float,
        active: tuple[Fault, ...],
    ) -> None:
        heading, pitch, length, quality = found
        stamp = Stamp(self._machine_id, t_ns, self.line.identity.name, utc_ns)
        time_s = utc_ns % DAY_NS * 1e-9
        if quality in (FixQuality.FIXED, FixQuality.FLOAT):
            measured = GnssHeading(stamp, "", heading, time_s, pitch, length, sigma, quality)
        else:
            measured = GnssHeading(stamp, "", math.nan, time_s, quality=FixQuality.NONE)
        data = bytearray()
        if self.settings.protocol in ("nmea", "both"):
            for sentence in self.settings.sentences:
                data += nmea_bytes(measured, sentence=sentence, talker=TALKER)
        if self.settings.protocol in ("ubx", "both"):
            for message in self.settings.messages:
                data += ubx_bytes(measured, message=message)
        self.line.send(t_ns, bytes(data), active)
