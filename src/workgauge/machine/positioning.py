"""How a machine knows where it is: receivers, tilt and joint sensors, and how far each is to be trusted, as its file
holds it. Every number is per machine; where a file says nothing, the recalled figures of the field count, and say so.
"""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from workgauge.machine.fields import Name, NotNegative, Number, Positive, Sourced, refusal
from workgauge.values.navigation import FixQuality

Port = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,31}$")]
Sigma = tuple[Positive, Positive]
#: Whatever comes later than this is of no use to a machine that moves [s].
Latency = Annotated[NotNegative, Field(le=2.0)]


class FixSigmas(Sourced):
    """1-sigma of a fix, (each horizontal component, height), by quality; used where the receiver states no error.

    What a receiver states of itself counts if it is larger, never if it is smaller.
    """

    fixed_m: Sigma = (0.015, 0.025)
    float_m: Sigma = (0.3, 0.5)
    differential_m: Sigma = (0.7, 1.2)
    single_m: Sigma = (3.0, 5.0)
    source: str | None = "recalled: fixed 0.01-0.02, float 0.1-0.5, differential 0.3-1, single 1.5-5 m"

    def of(self, quality: FixQuality) -> Sigma:
        """Return the pair of a quality; whatever is none of the three better ones is worth a single fix."""
        match quality:
            case FixQuality.FIXED:
                return self.fixed_m
            case FixQuality.FLOAT:
                return self.float_m
            case FixQuality.DIFFERENTIAL:
                return self.differential_m
            case _:
                return self.single_m


class ReceiverSpec(Sourced):
    """A satellite receiver: which antenna it serves and where its bytes arrive.

    Two receivers in one stream are told apart by their talker (`GP`, `GN`) or their place in the table of sources.
    """

    name: Name
    antenna: Name = Field(description="a sensor of kind gnss_antenna")
    port: Port = "gnss"
    talker: str | None = Field(default=None, description="only sentences of this talker, if the stream has several")
    latency_s: Latency = Field(default=0.02, description="from the epoch to the arrival of its bytes")
    sigmas: FixSigmas = FixSigmas()


class HeadingSpec(Sourced):
    """Where heading comes from: two receivers' positions, or one receiver's heading of a moving base."""

    kind: Literal["two_antennas", "moving_base"]
    master: Name = Field(description="antenna at the baseline's tail")
    rover: Name = Field(description="antenna at its head")
    port: Port = Field(default="gnss", description="of the heading sentences of a moving base")
    latency_s: Latency = 0.02
    sigma_deg: Positive = Field(default=0.15, description="of a moving base that states none; a floor where it does")
    shared_error: Annotated[Number, Field(ge=0, le=1)] = Field(
        default=0.5, description="largest share of both antennas' error variance that may be the same for both"
    )


class TiltSpec(Sourced):
    """The inclinometer or IMU that gives roll and pitch of the link it sits on."""

    sensor: Name
    port: Port = "links"
    sigma_deg: Positive = 0.05
    latency_s: Latency = 0.01


class WireCalibration(Sourced):
    """Joint position against the stroke of a wire encoder at measured points, strokes rising; a spline in between."""

    stroke_m: tuple[Number, ...] = Field(min_length=2)
    position_deg: tuple[Number, ...] | None = None
    position_m: tuple[Number, ...] | None = None

    @model_validator(mode="after")
    def _pairs(self) -> Self:
        given = [one for one in (self.position_deg, self.position_m) if one is not None]
        if len(given) != 1 or len(given[0]) != len(self.stroke_m):
            raise refusal("needs one position per stroke", key="stroke_m", allowed="position_deg or position_m")
        if any(b <= a for a, b in zip(self.stroke_m, self.stroke_m[1:], strict=False)):
            raise refusal("strokes must rise", key="stroke_m", value=list(self.stroke_m))
        steps = [b - a for a, b in zip(given[0], given[0][1:], strict=False)]
        if not (all(step > 0 for step in steps) or all(step < 0 for step in steps)):
            raise refusal("positions must rise or fall throughout", key="stroke_m", value=list(given[0]))
        return self


class JointSensorSpec(Sourced):
    """What measures one joint.

    `encoder`: joint position = sign x value + offset. `inclination`: from the inclinometers of the link the joint
    moves and of the link before it (gravity-relative). `wire_encoder`: through its calibration.
    """

    joint: Name
    kind: Literal["encoder", "inclination", "wire_encoder"]
    sensor: Name = Field(description="on the link the joint moves; for `inclination` an imu or inclinometer")
    before: Name | None = Field(
        default=None,
        description="for `inclination`: the inclinometer nearer the undercarriage; the tilt sensor if none",
    )
    port: Port = "links"
    sign: Literal[1, -1] = 1
    offset_deg: Number = 0.0
    sigma_deg: Positive | None = Field(default=None, description="1-sigma of the joint; 0.1° if left out")
    sigma_m: Positive | None = Field(default=None, description="1-sigma of a sliding joint or a wire's stroke")
    latency_s: Latency = 0.01
    calibration: WireCalibration | None = None

    @model_validator(mode="after")
    def _calibrated(self) -> Self:
        if (self.calibration is None) == (self.kind == "wire_encoder"):
            raise refusal("a wire encoder, and nothing else, has a calibration", key="calibration", value=self.kind)
        return self


class RailSpec(Sourced):
    """How surely rails hold an undercarriage to their alignment."""

    as_built_sigma_m: Positive = Field(default=0.010, description="1-sigma of the track, across and in height")
    flange_play_m: NotNegative = Field(default=0.010, description="the wheelset moves this far to either side")
    cant_sigma_m: Positive = Field(default=0.005, description="1-sigma of one rail's height over the other's")
    wheelbase_m: Positive = Field(default=4.0, description="between the outermost rail axles; play over it turns")


class Thresholds(Sourced):
    """When a position is believed less, and when not at all."""

    fix_age_s: Positive = Field(default=0.5, description="a fix older than this is no fix")
    dead_reckoning_s: NotNegative = Field(default=2.0, description="longest without a fix, while travelling or not")
    chassis_frozen_s: NotNegative = Field(default=60.0, description="longest without a fix, undercarriage held still")
    standing_m_s: Positive = Field(default=0.05, description="slower than this is standing still")
    travel_sigma_m: Positive = Field(default=0.5, description="1-sigma beyond which the position is of no use")
    innovation_sigmas: Positive = Field(default=5.0, description="a fix that differs by more has jumped")
    innovation_in_a_row: Annotated[int, Field(ge=1, le=100)] = Field(
        default=10, description="so many agreeing fixes after a jump are believed again"
    )
    frozen_s: Positive = Field(default=1.0, description="the very same coordinates for so long: the receiver hangs")
    baseline_m: Positive = Field(default=0.05, description="measured less known distance of the antennas")
    heading_deg: Positive = Field(default=3.0, description="two headings, or heading and course, that disagree")
    correction_age_s: Positive = Field(default=20.0, description="an older differential correction is a worse fix")
    link_age_s: Positive = Field(default=0.1, description="a link sensor older than this is missing")
    link_jump_deg: Positive = Field(default=5.0, description="a joint that moves more between two readings has not")
    check_tolerance_m: Positive = Field(default=0.05, description="start-of-shift check: tool against a known point")
    check_hours: Positive = Field(default=14.0, description="a check holds for so long")
    check_required: bool = Field(default=False, description="no work without a valid start-of-shift check")


class IntegritySpec(Sourced):
    """How sure a clearance's lower bound must be: protection level = k sigma + bias, k from the integrity risk."""

    risk: Annotated[Number, Field(gt=0, lt=0.5)] = Field(default=1e-7, description="two-sided Gaussian tail; k 5.33")
    bias_m: NotNegative = Field(default=0.0, description="what may be wrong without being noise")


class PositioningSpec(Sourced):
    """How the machine knows where it is. Left out, its position must come from outside as a ready pose."""

    receivers: tuple[ReceiverSpec, ...] = Field(min_length=1)
    heading: HeadingSpec
    tilt: TiltSpec
    joints: tuple[JointSensorSpec, ...]
    rails: RailSpec = RailSpec()
    thresholds: Thresholds = Thresholds()
    integrity: IntegritySpec = IntegritySpec()
    height: Literal["sentence", "constant", "grid"] = Field(
        default="sentence",
        description="how ellipsoidal height becomes the site's: the sentence's geoid separation, "
        "a constant, or a PROJ grid",
    )
    geoid_separation_m: Number | None = Field(default=None, description="for `constant`")
    geoid_grid: str | None = Field(default=None, description="for `grid`: the file's name or path")

    @model_validator(mode="after")
    def _height_known(self) -> Self:
        if (self.height == "constant") != (self.geoid_separation_m is not None):
            raise refusal("goes with `height: constant`, and only with it", key="geoid_separation_m")
        if (self.height == "grid") != (self.geoid_grid is not None):
            raise refusal("goes with `height: grid`, and only with it", key="geoid_grid")
        return self
