"""The machine description as a file holds it: degrees and metres, the unit in every key, unknown keys refused."""

import math
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from workgauge.machine.fields import (
    Angles,
    Degrees,
    Lever,
    Metres,
    Name,
    NotNegative,
    Position,
    Positive,
    Size,
    Sourced,
    Strict,
    refusal,
)
from workgauge.machine.positioning import PositioningSpec

#: Name of link 0 in every machine.
UNDERCARRIAGE = "undercarriage"


class DhRow(Strict):
    """One standard Denavit-Hartenberg row: A = Rz(theta + q) Tz(d) Tx(a) Rx(alpha), q added to d if prismatic."""

    a_m: Metres
    alpha_deg: Degrees
    d_m: Metres
    theta_deg: Degrees = 0.0


class Pose(Strict):
    """A frame in another: position and roll, pitch, yaw (Rz(yaw) Ry(pitch) Rx(roll))."""

    position_m: Position = (0.0, 0.0, 0.0)
    rpy_deg: Angles = (0.0, 0.0, 0.0)


class UrdfChain(Strict):
    """A plain URDF file (no xacro) and the chain in it that is the machine; its base link is link 0."""

    file: str = Field(description="path, relative to this description")
    base_link: str
    tip_link: str


class UndercarriageSpec(Sourced):
    """What carries the machine."""

    kind: Literal["rail", "tracks", "wheels"]
    gauge_m: Positive
    height_m: Metres = Field(default=0.0, description="machine frame's origin above top of rail or ground")


class StoppingSpec(Sourced):
    """How one direction of a joint comes to rest; a key left out is ideal."""

    dead_time_s: NotNegative = 0.0
    lag_s: NotNegative = 0.0
    tolerance_percent: Annotated[NotNegative, Field(lt=100)] = 0.0


class TurningStop(StoppingSpec):
    """Stopping of a revolute joint."""

    deceleration_deg_s2: Positive | None = None

    @property
    def deceleration(self) -> float:
        """Deceleration [rad/s^2]."""
        return math.inf if self.deceleration_deg_s2 is None else math.radians(self.deceleration_deg_s2)


class SlidingStop(StoppingSpec):
    """Stopping of a prismatic joint."""

    deceleration_m_s2: Positive | None = None

    @property
    def deceleration(self) -> float:
        """Deceleration [m/s^2]."""
        return math.inf if self.deceleration_m_s2 is None else self.deceleration_m_s2


class CylinderSpec(Sourced):
    """The triangle of joint, cylinder foot and rod pin; full speed is meant where it turns the joint fastest."""

    a_m: Positive = Field(description="from the joint to the cylinder's foot")
    b_m: Positive = Field(description="from the joint to the rod's pin")
    offset_deg: Degrees = Field(description="the triangle's angle at joint position 0; it grows with the joint")


class JointSpec(Sourced):
    """What revolute and prismatic joints have in common."""

    name: Name
    link: Name | None = Field(default=None, description="the link it moves; its own name if left out")
    dh: DhRow | None = Field(default=None, description="left out if the machine has a URDF")
    lever: Lever | None = None
    lever_sign: Literal[1, -1] = Field(
        default=1, description="joint direction when the lever is pushed to its positive side"
    )
    flow_positive_l_min: Positive | None = None
    flow_negative_l_min: Positive | None = None


class RevoluteJoint(JointSpec):
    """A joint that turns. With a URDF, limits and speeds left out are taken from there."""

    type: Literal["revolute"]
    continuous: bool | None = Field(default=None, description="turns without end; then no limits")
    lower_deg: Degrees | None = None
    upper_deg: Degrees | None = None
    home_deg: Degrees
    speed_positive_deg_s: Positive | None = None
    speed_negative_deg_s: Positive | None = None
    stopping_positive: TurningStop = TurningStop()
    stopping_negative: TurningStop = TurningStop()
    cylinder: CylinderSpec | None = None


class PrismaticJoint(JointSpec):
    """A joint that slides. With a URDF, limits and speeds left out are taken from there."""

    type: Literal["prismatic"]
    lower_m: Metres | None = None
    upper_m: Metres | None = None
    home_m: Metres
    speed_positive_m_s: Positive | None = None
    speed_negative_m_s: Positive | None = None
    stopping_positive: SlidingStop = SlidingStop()
    stopping_negative: SlidingStop = SlidingStop()


Joint = Annotated[RevoluteJoint | PrismaticJoint, Field(discriminator="type")]


class StretchSpec(Strict):
    """The face of a box that a prismatic joint pushes outwards: it moves by the joint's position."""

    joint: str
    axis: Literal["x", "y", "z"] = Field(description="the box's own axis")
    side: Literal["positive", "negative"]


class BoxSpec(Sourced):
    """A box in its link's frame, `size_m` long along its own axes (at position 0 of its stretch)."""

    name: Name
    centre_m: Position
    size_m: Size
    rpy_deg: Angles = (0.0, 0.0, 0.0)
    stretch: StretchSpec | None = None


class LinkBoxSpec(BoxSpec):
    """A box and the link it moves with."""

    link: Name


class MeshSpec(Sourced):
    """A file that shows how something looks; nothing is measured to it."""

    file: str = Field(description="STL, OBJ, PLY, GLB or OFF; path, relative to this description")
    position_m: Position = (0.0, 0.0, 0.0)
    rpy_deg: Angles = (0.0, 0.0, 0.0)
    scale: Positive = Field(default=1.0, description="0.001 for a file in millimetres")


class LinkMeshSpec(MeshSpec):
    """A mesh and the link it moves with."""

    link: Name


class AttachmentSpec(Sourced):
    """Something the last link carries: its tool frame and boxes in that link's frame."""

    name: Name
    tool: Pose | None = Field(
        default=None,
        description="tool centre point: z along the tool, y away from the machine when it hangs down; "
        "an attachment without one is not measured up and cannot be mounted",
    )
    boxes: tuple[BoxSpec, ...] = ()
    meshes: tuple[MeshSpec, ...] = ()
    mass_kg: Positive | None = None
    tolerance_m: NotNegative | None = Field(
        default=None,
        description="1-sigma of the measured-up tool centre point; a machine with a positioning section needs it",
    )


class SensorSpec(Sourced):
    """A sensor or antenna and the link it sits on."""

    name: Name
    kind: Literal["gnss_antenna", "imu", "inclinometer", "encoder", "wire_encoder", "lidar", "camera", "prism"]
    link: Name
    position_m: Position
    rpy_deg: Angles = (0.0, 0.0, 0.0)


class PumpSpec(Sourced):
    """Flow shared by all joints that name theirs."""

    flow_l_min: Positive


class MachineDescription(Sourced):
    """A machine. Frame: undercarriage, x forward, y left, z up, origin under the swing axis on rail or ground."""

    title: str
    undercarriage: UndercarriageSpec
    base: Pose = Field(
        default=Pose(), description="frame 0 of the rows, or the URDF's base link, in the machine frame"
    )
    urdf: UrdfChain | None = None
    joints: tuple[Joint, ...] = Field(min_length=1, max_length=12)
    solids: tuple[LinkBoxSpec, ...] = Field(min_length=1)
    meshes: tuple[LinkMeshSpec, ...] = Field(
        default=(), description="how links look, in place of their boxes; with a URDF, beside its own visuals"
    )
    attachments: tuple[AttachmentSpec, ...] = Field(min_length=1, description="the first is mounted by default")
    sensors: tuple[SensorSpec, ...] = ()
    exclusive_groups: tuple[tuple[str, ...], ...] = Field(
        default=(), description="joints of different groups cannot move together; a joint in none moves with any"
    )
    pump: PumpSpec | None = None
    positioning: PositioningSpec | None = None
    allowed_contacts: tuple[tuple[str, str], ...] = Field(default=(), description="pairs of boxes never checked")
    self_stop_distance_m: Annotated[NotNegative, Field(le=1)] | None = Field(
        default=None, description="distance at which its own links stop before each other; the guard's if left out"
    )

    @model_validator(mode="after")
    def _rows_or_urdf(self) -> Self:
        for joint in self.joints:
            if (joint.dh is None) == (self.urdf is None):
                message = "has both a URDF and a row" if self.urdf else "has neither a row nor a URDF"
                raise refusal(f"joint {joint.name} {message}", key="joints", allowed="`dh` in every joint, or `urdf`")
        return self


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of a machine description."""
    return MachineDescription.model_json_schema()
