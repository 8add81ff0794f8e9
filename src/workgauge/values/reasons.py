"""Why the machine is held back or stopped: always said, always with the facts."""

from dataclasses import dataclass
from enum import StrEnum


class ReasonCode(StrEnum):
    """Every cause of an intervention."""

    LIMIT_NEAR = "limit_near"  #: approaching a limit or another link, slowed
    LIMIT_REACHED = "limit_reached"  #: at the stop distance, approach refused
    PUSHED_AWAY = "pushed_away"  #: near a limit or another link, driven away from it
    INSIDE_LIMIT = "inside_limit"  #: already inside, only the way out is free
    JOINT_END = "joint_end"  #: end cushion of a joint
    JOINT_SPEED = "joint_speed"  #: faster than the joint may turn
    EXCLUSIVE_GROUP = "exclusive_group"  #: joints that cannot move together
    PUMP_FLOW = "pump_flow"  #: all joints together ask for more than the pump gives
    PINNED = "pinned"  #: inside a limit, and what else leaves no way out by the joints alone
    WAY_OUT = "way_out"  #: inside a limit, and how to get out
    SINGULAR = "singular"  #: the tool cannot go that way from here
    GIVES_WAY = "gives_way"  #: an automatic motion bends, or waits, before a limit
    STUCK = "stuck"  #: an automatic motion comes no nearer to what it is to reach, and stands
    NOT_ENABLED = "not_enabled"  #: dead-man switch open
    NOT_NEUTRAL = "not_neutral"  #: levers must be in the middle before the gate opens
    NO_POSTURE = "no_posture"
    STALE_POSTURE = "stale_posture"
    NO_POSE = "no_pose"
    STALE_POSE = "stale_pose"
    NO_INTENT = "no_intent"
    STALE_INTENT = "stale_intent"
    FROM_FUTURE = "from_future"  #: a stamp later than now
    INVALID_VALUE = "invalid_value"  #: NaN, infinite, wrong length
    OUT_OF_RANGE = "out_of_range"  #: command beyond the valve's range
    TOO_FAST_CHANGE = "too_fast_change"  #: command changes faster than allowed
    WRONG_SEQUENCE = "wrong_sequence"  #: repeated, skipped or foreign frame
    GATE_CLOSED = "gate_closed"
    POSITION_DEGRADED = "position_degraded"  #: a worse fix, an older correction: believed with a larger uncertainty
    POSITION_JUMP = "position_jump"  #: a fix that disagrees with what was known by more than it admits
    RECEIVER_FROZEN = "receiver_frozen"  #: the same fix again and again, or one that ignores that the machine moves
    HEADING_DISAGREES = "heading_disagrees"  #: baseline length, antenna order or two headings contradict each other
    CORRECTION_OLD = "correction_old"  #: the differential correction is older than allowed
    SENSOR_STALE = "sensor_stale"  #: a link sensor is missing or old
    SENSOR_DISAGREES = "sensor_disagrees"  #: two sensors of one thing contradict each other
    DEAD_RECKONING = "dead_reckoning"  #: no fix, carried on for a bounded time
    CHASSIS_FROZEN = "chassis_frozen"  #: no fix, the undercarriage must not move
    POSITION_LOST = "position_lost"  #: no position to work on
    POSITION_UNSURE = "position_unsure"  #: so uncertain that limits beyond those looked at may matter
    NOT_CHECKED = "not_checked"  #: the start-of-shift check is missing or failed


#: Reasons that stop every joint, whatever the operator wants.
STOPPING = frozenset(
    {
        ReasonCode.NOT_ENABLED,
        ReasonCode.NOT_NEUTRAL,
        ReasonCode.NO_POSTURE,
        ReasonCode.STALE_POSTURE,
        ReasonCode.NO_POSE,
        ReasonCode.STALE_POSE,
        ReasonCode.NO_INTENT,
        ReasonCode.STALE_INTENT,
        ReasonCode.FROM_FUTURE,
        ReasonCode.INVALID_VALUE,
        ReasonCode.GATE_CLOSED,
        ReasonCode.POSITION_LOST,
        ReasonCode.POSITION_UNSURE,
        ReasonCode.NOT_CHECKED,
    }
)


@dataclass(frozen=True, slots=True)
class Reason:
    """One cause of an intervention.

    Attributes:
        code: the cause.
        text: one line for the operator.
        link, limit: what is near what, if that is the cause.
        other_limit: of two limits that pin the machine, the other one.
        joint: the joint it concerns, if one.
        clearance_m: signed clearance, as the program believes [m].
        protection_m: how much of it is not sure, its protection level [m].
        stop_distance_m: what must remain of the rest [m].
        scale: what is left of the wanted speed, 0 to 1.
    """

    code: ReasonCode
    text: str
    link: str | None = None
    limit: str | None = None
    joint: str | None = None
    clearance_m: float | None = None
    scale: float | None = None
    protection_m: float | None = None
    stop_distance_m: float | None = None
    other_limit: str | None = None
