"""What a session's machine measures with: perfect values, simulated receivers and sensors, or another source."""

from collections.abc import Sequence
from dataclasses import dataclass

from workgauge.rehearse.locating import SensorNavigator
from workgauge.rehearse.navigation import Navigator, PerfectNavigator, Source
from workgauge.rehearse.sensing import FaultChoice, SensorChoice, Sensors
from workgauge.rehearse.setting import Setting
from workgauge.sim.sensors.kit import SensorKit
from workgauge.values.errors import GeodesyError, MachineError, ScenarioError


@dataclass(frozen=True, slots=True, eq=False)
class Senses:
    """What a machine measures with.

    Attributes:
        navigator: from bytes to posture, pose and health. source: of the bytes, None for the plant's own.
        words: for people. assumption: what a run takes for granted of them.
    """

    navigator: Navigator
    source: Source | None
    words: str
    assumption: str


def senses(on: Setting, sensors: Sensors, faults: Sequence[FaultChoice], source: Source | None) -> Senses:
    """Return what a machine measures with.

    Raises:
        ScenarioError: for faults of perfect sensors, or of sensors the machine has not.
        MachineError: for a machine whose file does not say how it knows where it is.
        GeodesyError: for a site without a coordinate system.
    """
    if source is None and not isinstance(sensors, SensorChoice):
        if faults:
            raise ScenarioError(
                "perfect sensors have no faults", element="faults", allowed="sensors other than perfect"
            )
        words = "Sensors are perfect: posture and machine pose are exact and fresh at every tick."
        return Senses(PerfectNavigator(), None, "perfect", words)
    crs = on.site.crs
    if on.machine.positioning is None:
        raise MachineError(
            "the machine's file does not say how it knows where it is",
            element=f"machine {on.machine.name}",
            allowed="a `positioning` section, or perfect sensors",
        )
    if crs is None:
        raise GeodesyError(
            "receivers need the site's coordinate system",
            element="site",
            allowed="files that name one, or an EPSG number",
        )
    navigator = SensorNavigator(on.machine, on.machine_id, crs, on.frame, on.site, on.rules)
    if source is not None:
        words = (
            "Posture and position are those of the receivers and sensors handed in; truth is the simulated machine's."
        )
        return Senses(navigator, source, "from outside", words)
    assert isinstance(sensors, SensorChoice)
    kit = SensorKit(on.machine, crs, on.frame, sensors.settings(faults), sensors.seed, on.machine_id, on.start_utc)
    noise = sensors.noise if isinstance(sensors.noise, str) else "in numbers"
    said = f", {len(faults)} faults" if len(faults) > 1 else ", one fault" if faults else ""
    words = (
        "Receivers and link sensors are simulated down to the bytes they write: errors are Gaussian, white and slowly"
        f" changing, as large as {'the machine file says' if noise == 'datasheet' else 'the scenario says'}"
        f"{'' if not faults else ', and what the scenario has go wrong'}; their datum is the site's."
    )
    return Senses(navigator, kit, f"simulated bytes, noise {noise}, seed {sensors.seed}{said}", words)
