"""What a scenario says about its sensors and what goes wrong with them: `sensors:` and `faults:`."""

import math
from collections.abc import Iterable
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, Tag, model_validator

from workgauge.rehearse.either import in_words
from workgauge.sim.sensors.faults import Fault, FaultKind
from workgauge.sim.sensors.settings import (
    FixNoise,
    HeadingSettings,
    LinkSettings,
    ReceiverSettings,
    SensorSettings,
)
from workgauge.values.navigation import FixQuality

Finite: TypeAlias = Annotated[float, Field(allow_inf_nan=False)]
Positive: TypeAlias = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative: TypeAlias = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Share: TypeAlias = Annotated[float, Field(ge=0, le=1)]
Metres: TypeAlias = Annotated[float, Field(ge=0, le=1000)]
Sigma: TypeAlias = tuple[Metres, Metres]
Offset: TypeAlias = Annotated[float, Field(ge=-10_000, le=10_000)]
Vector: TypeAlias = tuple[Offset, Offset, Offset]
Jitter: TypeAlias = Annotated[float, Field(ge=0, le=10_000)]
Factor: TypeAlias = Annotated[float, Field(ge=0, le=100)]
Rate: TypeAlias = Literal[1, 2, 4, 5, 10, 20, 25, 50]
LinkRate: TypeAlias = Literal[1, 2, 4, 5, 10, 20, 25, 50, 100]
ProtocolName: TypeAlias = Literal["nmea", "ubx", "both"]
QualityName: TypeAlias = Literal["fixed", "float", "differential", "single"]
FixSentence: TypeAlias = Literal["GGA", "GLL", "RMC", "VTG", "GST", "ZDA", "PTNL,GGK"]
FixMessage: TypeAlias = Literal["NAV-PVT", "NAV-HPPOSLLH", "NAV-COV"]
HeadingSentence: TypeAlias = Literal["HDT", "THS", "PTNL,AVR"]

_QUALITIES = {
    "fixed": FixQuality.FIXED,
    "float": FixQuality.FLOAT,
    "differential": FixQuality.DIFFERENTIAL,
    "single": FixQuality.SINGLE,
}


class Part(BaseModel):
    """A part of a scenario: unknown keys refused, values fixed once read."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class NoiseChoice(Part):
    """Errors in numbers; what is left out is as `datasheet` has it."""

    fixed_m: Sigma | None = Field(default=None, description="1-sigma, each horizontal component and height")
    float_m: Sigma | None = None
    differential_m: Sigma | None = None
    single_m: Sigma | None = None
    scale: Factor = Field(default=1.0, description="multiplies every error of position, heading and link sensors")
    correlated: Share = Field(default=0.6, description="share of a position's variance that changes slowly")
    common: Share = Field(default=0.5, description="share of the slow part that all receivers have alike")
    correlation_s: NotNegative = Field(default=60.0, description="how slowly: time constant of the slow part")
    velocity_m_s: Factor = Field(default=0.02, description="1-sigma of each component of a velocity")
    gyro_deg_s: Factor = Field(default=0.1, description="1-sigma of each axis of a gyro")

    def fix_noise(self) -> FixNoise:
        """Return the noise of a receiver."""
        sigmas = {
            quality: sigma
            for name, quality in _QUALITIES.items()
            if (sigma := getattr(self, f"{name}_m")) is not None
        }
        return FixNoise(sigmas, self.scale, self.correlated, self.common, self.correlation_s, self.velocity_m_s)


Noise: TypeAlias = Annotated[
    Annotated[Literal["datasheet", "none"], Tag("<word>")] | Annotated[NoiseChoice, Tag("<mapping>")],
    in_words(("datasheet", "none"), "numbers such as `{fixed_m: [0.02, 0.03]}`"),
]


def _noise(choice: Noise) -> NoiseChoice:
    if isinstance(choice, NoiseChoice):
        return choice
    return NoiseChoice(scale=0.0 if choice == "none" else 1.0)


class ReceiverChoice(Part):
    """How a receiver behaves."""

    rate_hz: Rate = 20
    protocol: ProtocolName = Field(
        default="nmea", description="unless the machine's file tells the receiver by its talker"
    )
    sentences: tuple[FixSentence, ...] = Field(default=("RMC", "GGA", "GST"), min_length=1)
    messages: tuple[FixMessage, ...] = Field(default=("NAV-PVT", "NAV-HPPOSLLH"), min_length=1)
    quality: QualityName = Field(default="fixed", description="while no fault says otherwise")
    noise: Noise | None = Field(default=None, description="of this one alone; that of `sensors` if left out")
    stated: Annotated[float, Field(gt=0, le=100)] = Field(
        default=1.0, description="error it states over its true 1-sigma; below 1 it flatters"
    )
    jitter_ms: Jitter = Field(default=0.0, description="mean of what its bytes come later than its latency")
    correction_age_s: Annotated[float, Field(ge=0, le=1e6)] = 1.0
    satellites: Annotated[int, Field(ge=0, le=99)] = 18

    def settings(self, noise: Noise) -> ReceiverSettings:
        """Return what the simulator needs, with `noise` where this one has none of its own."""
        return ReceiverSettings(
            rate_hz=self.rate_hz,
            protocol=self.protocol,
            sentences=tuple(self.sentences),
            messages=tuple(self.messages),
            quality=_QUALITIES[self.quality],
            noise=_noise(self.noise if self.noise is not None else noise).fix_noise(),
            stated=self.stated,
            jitter_s=self.jitter_ms * 1e-3,
            correction_age_s=self.correction_age_s,
            satellites=self.satellites,
        )


class ReceiversChoice(ReceiverChoice):
    """How all receivers behave, and which behave differently."""

    each: dict[str, ReceiverChoice] = Field(
        default_factory=dict, description="by name, the keys in which it differs from all"
    )

    def named(self, name: str) -> ReceiverChoice:
        """Return how one receiver behaves: as all, but for the keys written for it."""
        own = self.each[name]
        return self.model_copy(update={key: getattr(own, key) for key in own.model_fields_set})


class HeadingChoice(Part):
    """How the heading of a moving base behaves, where the machine has one."""

    rate_hz: Rate = 20
    protocol: ProtocolName = "nmea"
    sentences: tuple[HeadingSentence, ...] = Field(default=("PTNL,AVR",), min_length=1)
    jitter_ms: Jitter = 0.0


class LinksChoice(Part):
    """How inclinometers, encoders and gyros behave."""

    rate_hz: LinkRate = 100
    gyros: bool = Field(default=True, description="whether IMUs send angular velocities")
    jitter_ms: Jitter = 0.0


class SensorChoice(Part):
    """Simulated sensors that write the bytes of real ones, from the machine's own `positioning:` section."""

    noise: Noise = Field(
        default="datasheet",
        description="`datasheet`: the 1-sigmas of the machine's file; `none`; or numbers",
    )
    receivers: ReceiversChoice = ReceiversChoice()
    heading: HeadingChoice = HeadingChoice()
    links: LinksChoice = LinksChoice()
    geoid_separation_m: Annotated[float, Field(ge=-150, le=150)] | None = Field(
        default=None, description="true ellipsoidal height less the site's; left out, the machine's constant, or 17"
    )
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1

    def settings(self, faults: Iterable["FaultPart"] = ()) -> SensorSettings:
        """Return what the simulator needs."""
        noise = _noise(self.noise)
        receivers = self.receivers
        return SensorSettings(
            receivers=receivers.settings(self.noise),
            each={name: receivers.named(name).settings(self.noise) for name in receivers.each},
            heading=HeadingSettings(
                rate_hz=self.heading.rate_hz,
                protocol=self.heading.protocol,
                sentences=tuple(self.heading.sentences),
                scale=noise.scale,
                correlated=noise.correlated,
                correlation_s=noise.correlation_s,
                jitter_s=self.heading.jitter_ms * 1e-3,
            ),
            links=LinkSettings(
                rate_hz=self.links.rate_hz,
                scale=noise.scale,
                gyro_rad_s=math.radians(noise.gyro_deg_s),
                gyros=self.links.gyros,
                jitter_s=self.links.jitter_ms * 1e-3,
            ),
            geoid_separation_m=self.geoid_separation_m,
            faults=tuple(fault.fault() for fault in faults),
        )


#: What `sensors:` takes.
Sensors: TypeAlias = Annotated[
    Annotated[Literal["perfect"], Tag("<word>")] | Annotated[SensorChoice, Tag("<mapping>")],
    in_words(("perfect",), "a mapping such as `{noise: datasheet, seed: 1}`"),
]


class FaultPart(Part):
    """Something that goes wrong: when, and with whom."""

    from_s: NotNegative = Field(default=0.0, description="simulated time")
    for_s: Positive | None = Field(default=None, description="to the end if left out")

    def fault(self) -> Fault:
        """Return what the simulator needs."""
        values = {name: getattr(self, name) for name in type(self).model_fields}
        kind, from_s, for_s = FaultKind(values.pop("do")), values.pop("from_s"), values.pop("for_s")
        until_ns = None if for_s is None else round((from_s + for_s) * 1e9)
        return Fault(kind, round(from_s * 1e9), until_ns, **self._converted(values))

    def _converted(self, values: dict[str, Any]) -> dict[str, Any]:
        """Return the fault's own values in the simulator's names and units."""
        return values


class _OfReceivers(FaultPart):
    """A fault of one receiver (or `heading`, that of a moving base), or of all of them if none is named."""

    receiver: str | None = None


class _OfOneReceiver(FaultPart):
    receiver: str


class _OfAny(FaultPart):
    """A fault of one receiver, one link sensor (or `all`) or everything on one port; of every receiver by default."""

    receiver: str | None = None
    sensor: str | None = None
    port: str | None = None

    @model_validator(mode="after")
    def _one(self) -> "_OfAny":
        given = [name for name in ("receiver", "sensor", "port") if getattr(self, name) is not None]
        if len(given) > 1:
            raise ValueError(f"at most one of receiver, sensor, port, not {' and '.join(given)}")
        return self


class Lowered(_OfReceivers):
    """A worse fix, stated as such; `outage`: messages without a fix."""

    do: Literal["float", "differential", "single", "outage"]


class Silence(_OfAny):
    """Nothing at all is sent."""

    do: Literal["silence"]


class Jump(_OfReceivers):
    """Multipath: the position is off and the receiver does not know."""

    do: Literal["jump"]
    offset_m: Vector = Field(description="east, north, up")
    ramp_s: NotNegative = Field(default=0.0, description="until it is there in full; at once by default")


class Frozen(_OfAny):
    """The same measurement again and again."""

    do: Literal["frozen"]
    clock: Literal["running", "stopped"] = Field(
        default="running", description="`stopped`: the very same bytes, time and all"
    )

    def _converted(self, values: dict[str, Any]) -> dict[str, Any]:
        stopped = values.pop("clock") == "stopped"
        return {**values, "clock_stopped": stopped}


class Swapped(FaultPart):
    """The cables of the two antennas of the heading exchanged."""

    do: Literal["swapped"]


class AntennaMoved(_OfOneReceiver):
    """The antenna is not where the machine's file says: knocked, or mounted anew."""

    do: Literal["antenna_moved"]
    offset_m: Vector = Field(description="in the axes of the link it sits on")


class CorrectionAge(_OfReceivers):
    """Corrections no longer arrive: their age grows by a second each second."""

    do: Literal["correction_age"]


class SensorJump(FaultPart):
    """A link sensor is off: a joint has jumped, as far as anyone can tell."""

    do: Literal["sensor_jump"]
    sensor: str
    offset_deg: Finite | None = Field(default=None, description="of an inclinometer or a joint encoder")
    offset_m: Finite | None = Field(default=None, description="of a wire encoder, or the encoder of a sliding joint")

    @model_validator(mode="after")
    def _one(self) -> "SensorJump":
        if (self.offset_deg is None) == (self.offset_m is None):
            raise ValueError("exactly one of offset_deg, offset_m is needed")
        return self

    def _converted(self, values: dict[str, Any]) -> dict[str, Any]:
        offset_deg, offset_m = values.pop("offset_deg"), values.pop("offset_m")
        return {**values, "offset": math.radians(offset_deg) if offset_m is None else offset_m}


class BadBytes(_OfAny):
    """Bits flipped and bytes lost on the way."""

    do: Literal["bad_bytes"]
    flipped: Share = Field(default=0.001, description="share of the bytes with one wrong bit")
    dropped: Share = Field(default=0.001, description="share of the bytes lost")


class ForeignReceiver(_OfOneReceiver):
    """Another receiver writes into the same stream."""

    do: Literal["foreign_receiver"]
    talker: Annotated[str, Field(pattern="^[A-Z]{2}$")] = "GP"
    offset_m: Vector = Field(default=(25.0, 0.0, 0.0), description="east, north, up from the one it disturbs")


class Latency(_OfAny):
    """Bytes arrive later than they should."""

    do: Literal["latency"]
    delay_s: Annotated[float, Field(gt=0, le=3600)]


class ClockStep(_OfReceivers):
    """The receiver's own time is off."""

    do: Literal["clock_step"]
    step_s: Annotated[float, Field(ge=-1e6, le=1e6)]


#: One item of `faults:`.
FaultChoice: TypeAlias = Annotated[
    Lowered
    | Silence
    | Jump
    | Frozen
    | Swapped
    | AntennaMoved
    | CorrectionAge
    | SensorJump
    | BadBytes
    | ForeignReceiver
    | Latency
    | ClockStep,
    Field(discriminator="do"),
]
