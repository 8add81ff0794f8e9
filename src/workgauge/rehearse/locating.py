"""From the bytes of receivers and sensors to a machine's posture, pose and health."""

from collections.abc import Mapping, Sequence

from workgauge.gauge.rules import RuleBook
from workgauge.geodesy.crs import ProjectedCrs
from workgauge.geodesy.frame import SiteFrame
from workgauge.machine.model import MachineModel
from workgauge.positioning.locate import Locator
from workgauge.positioning.track import RailTrack
from workgauge.rehearse.navigation import Known
from workgauge.site.alignment import Alignment
from workgauge.site.model import SiteModel
from workgauge.values.navigation import Measurement
from workgauge.values.ports import Chunk
from workgauge.wire.stream import StreamDecoder, Tally


class SensorNavigator:
    """Decodes streams, and finds pose, posture and health from their measurements.

    Args:
        machine: with a `positioning` section. machine_id: whose frames count.
        crs, frame: of the site. site, rules: how the rails lie a rail machine stands on.
    """

    def __init__(
        self,
        machine: MachineModel,
        machine_id: str,
        crs: ProjectedCrs,
        frame: SiteFrame,
        site: SiteModel,
        rules: RuleBook,
    ) -> None:
        self._machine_id = machine_id
        self._site, self._rules = site, rules
        self._height_m = machine.undercarriage.height_m
        self._on_rails = machine.undercarriage.kind == "rail"
        self._locator = Locator(machine, machine_id, crs, frame)
        self._track: Alignment | None = None
        self._memory = self._locator.start()
        self._decoders: dict[str, StreamDecoder] = {}

    @property
    def tallies(self) -> Mapping[str, Tally]:
        """What became of the sentences and messages of each port."""
        return {port: decoder.tally for port, decoder in sorted(self._decoders.items())}

    def take(self, chunks: Sequence[Chunk], now_ns: int, track: Alignment | None) -> Known:
        """Return what is known now; a rail machine is held to its track."""
        measurements: list[Measurement] = []
        for chunk in chunks:
            decoder = self._decoders.get(chunk.port)
            if decoder is None:
                decoder = self._decoders[chunk.port] = StreamDecoder(chunk.port, self._machine_id)
            measurements += decoder.feed(chunk)
        if self._on_rails and track is not self._track:
            self._track, self._locator = track, self._locator.on(self._rails(track))
        located, self._memory = self._locator.step(measurements, now_ns, self._memory)
        return Known(located.posture, located.pose, located.health)

    def _rails(self, track: Alignment | None) -> RailTrack | None:
        return None if track is None else RailTrack.of(self._site, self._rules, track, self._height_m)
