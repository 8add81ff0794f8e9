"""Steps of a drive that automatic motion does: a goal for the tool, or a path of it."""

from itertools import pairwise
from typing import Annotated, Literal, TypeAlias

from pydantic import Field, model_validator

from workgauge.rehearse.part import Deflection, NotNegative, Part, Positive, exactly_one
from workgauge.values.tasks import Orientation

Frame: TypeAlias = Literal["machine", "site"]
Coordinate: TypeAlias = Annotated[float, Field(ge=-1e8, le=1e8, allow_inf_nan=False)]
Angle: TypeAlias = Annotated[float, Field(ge=-360, le=360, allow_inf_nan=False)]
Place: TypeAlias = tuple[Coordinate, Coordinate, Coordinate]
Angles: TypeAlias = tuple[Angle, Angle, Angle]
Speed: TypeAlias = Annotated[float, Field(gt=0, le=5, allow_inf_nan=False)]
TurnSpeed: TypeAlias = Annotated[float, Field(gt=0, le=360, allow_inf_nan=False)]
Width: TypeAlias = Annotated[float, Field(gt=0, le=20, allow_inf_nan=False)]
Lean: TypeAlias = Annotated[float, Field(ge=-80, le=80, allow_inf_nan=False)]
Little: TypeAlias = Annotated[float, Field(ge=0, le=1e4, allow_inf_nan=False)]


class PathPoint(Part):
    """One point of a path."""

    at_m: Place = Field(description="x forward, y left, z up from the undercarriage; or east, north, height")
    rpy_deg: Angles | None = Field(
        default=None, description="roll, pitch, yaw of the tool frame, about the fixed axes x, y, z of the same frame"
    )


class _Driven(Part):
    """How fast and how exactly an automatic step is driven."""

    speed_m_s: Speed = Field(default=0.5, description="of the tool")
    turn_deg_s: TurnSpeed | None = Field(default=None, description="of the tool, at most")
    share: Deflection = Field(default=0.8, description="of joint speeds and pump flow that the plan may use")
    pace: Deflection = Field(default=1.0, description="how fast the operator lets it run, 1 as planned")
    tolerance_mm: Positive = 20.0
    tolerance_deg: Positive = 1.0
    deviation_m: NotNegative = Field(
        default=0.0,
        description="so far limits may push the tool off its path; with 0 a path into a limit is refused beforehand",
    )
    at_most_s: Positive = 300.0


class _Automatic(_Driven):
    """What steps to a pose or along points share."""

    frame: Frame = Field(default="machine", description="what coordinates and angles are counted in")
    orientation: Orientation | None = Field(
        default=None, description="how much of it counts; left out, all the machine can hold, none without rpy_deg"
    )
    around: bool = Field(default=True, description="go round what blocks it")


class GoTo(_Automatic):
    """Bring the tool to a pose: on a straight line, or by the joints, round what is in the way."""

    do: Literal["go_to"]
    goal: PathPoint
    by: Literal["line", "joints", "loop"] = Field(
        default="line",
        description="a planned straight line, planned joints, or closed-loop inverse kinematics without a plan",
    )
    plan: bool = Field(default=True, description="look for a way through joint space when it is stuck")


class FollowPath(_Automatic):
    """Follow a path of the tool, its beginning reached by the joints first."""

    do: Literal["follow"]
    points: tuple[PathPoint, ...] = Field(description="two or more")
    kind: Literal["polyline", "spline"] = "polyline"
    blend_mm: NotNegative = Field(default=0.0, description="so far rounded corners may pass from their points")
    repeat: Annotated[int, Field(ge=1, le=1000)] = 1

    @model_validator(mode="after")
    def _enough(self) -> "FollowPath":
        if len(self.points) < 2:
            raise ValueError(f"a path needs two points or more, {len(self.points)} given")
        given = [point.rpy_deg is not None for point in self.points]
        if any(given) and not all(given):
            raise ValueError("rpy_deg of every point, or of none")
        for k, (one, other) in enumerate(pairwise(self.points), 1):
            if one.at_m == other.at_m:
                raise ValueError(f"point {k + 1} of the path is where point {k} is; a go_to turns on the spot")
        if self.repeat > 1 and self.points[0] != self.points[-1]:
            raise ValueError("a path that repeats must end where it begins")
        return self


Count: TypeAlias = Annotated[int, Field(ge=1, le=1000)]
PlanPlace: TypeAlias = tuple[Coordinate, Coordinate]


class SideBySide(Part):
    """Lines along the machine's x axis, from far to near."""

    count: Count = 3
    spacing_m: Positive = 1.0


class Fan(Part):
    """Lines towards the swing axis, from far to near."""

    from_deg: Angle = Field(description="of the first, seen from the machine, counter-clockwise from its x axis")
    to_deg: Angle = Field(description="of the last")
    count: Count = 3


class Along(Part):
    """A line beside an alignment, as far as it is in reach."""

    alignment: str
    offset_m: Coordinate = Field(default=0.0, description="to its left")


class GradeSurface(_Driven):
    """Draw the bucket's edge along a surface: over the way's beginning, down, the cut, up, pass by pass."""

    do: Literal["grade"]
    surface: str | None = Field(default=None, description="the design, by name; all of the site's if left out")
    ground: str | None = Field(default=None, description="the ground as it is, for passes by depth_m")
    side_by_side: SideBySide | None = None
    fan: Fan | None = None
    along: Along | None = None
    polyline_en_m: tuple[PlanPlace, ...] | None = Field(default=None, description="east, north; laid on the surface")
    near_m: NotNegative | None = Field(default=None, description="from the swing axis; clear of the undercarriage")
    far_m: Positive | None = Field(default=None, description="from the swing axis; as far as the machine reaches")
    speed_m_s: Speed = Field(default=0.3, description="of the edge along the surface")
    move_m_s: Speed = Field(default=0.5, description="of the tool on its way to and from the surface")
    tolerance_mm: Positive = 10.0
    bucket_width_m: Width = 1.0
    cutting_deg: Lean = Field(default=0.0, description="how far the wrist leans ahead, from square to the surface")
    above_mm: NotNegative = Field(default=0.0, description="so far above the surface the edge is to run")
    over_dig_mm: Little = Field(default=10.0, description="so far below the surface any of the edge may be")
    corner_mm: Little = Field(default=2.0, description="so far the way may pass from the edges it crosses")
    turn_m: Positive = Field(
        default=0.25, ge=1e-3, le=10.0, description="so far before and behind an edge the bucket turns"
    )
    depth_m: Positive | None = Field(default=None, description="of one pass, where ground is given")
    lift_m: Positive = Field(default=0.5, description="above the way's ends it comes and leaves")

    @model_validator(mode="after")
    def _one(self) -> "GradeSurface":
        exactly_one(self, ("side_by_side", "fan", "along", "polyline_en_m"))
        if (self.depth_m is None) != (self.ground is None):
            raise ValueError("depth_m and ground go together")
        if self.polyline_en_m is not None and len(self.polyline_en_m) < 2:
            raise ValueError("polyline_en_m needs two places or more")
        return self
