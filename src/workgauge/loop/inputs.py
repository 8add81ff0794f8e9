"""What enters the tick, and whether it may be believed: present, of this machine, fresh, and made of numbers."""

import math
from dataclasses import dataclass
from typing import TypeAlias

from workgauge.loop.config import TickConfig
from workgauge.motion.line import unit_direction
from workgauge.proximity.scene import Scene
from workgauge.values.arrays import Floats
from workgauge.values.measurements import DriveMode, Intent, MachinePose, Posture
from workgauge.values.reasons import Reason, ReasonCode

#: Positions beyond this are no measurement of a machine on its site [rad, m].
FAR = 1e6
_SQUARE = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class TickInputs:
    """Everything that enters one tick.

    Attributes:
        now_ns: the monotonic clock the stamps are counted on [ns].
        posture, pose, intent: the newest of each, None if there never was one.
        scene: the limits around the machine.
        off_states: work states known to be off, see `Activity`.
        let_off: tracks the undercarriage stands on, whose envelopes are no limit for it, see `gauge.own_track`.
    """

    now_ns: int
    posture: Posture | None
    pose: MachinePose | None
    intent: Intent | None
    scene: Scene
    off_states: frozenset[str] = frozenset()
    let_off: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The inputs that may be believed, None for the others, and why not."""

    q: Floats | None
    T_site_machine: Floats | None
    intent: Intent | None
    reasons: tuple[Reason, ...]


def believed(inputs: TickInputs, config: TickConfig) -> Seen:
    """Return what of the inputs is present, of this machine, fresh and made of numbers."""
    posture, pose, intent = inputs.posture, inputs.pose, inputs.intent
    about_posture = _stamp_wrong(posture, _POSTURE, config.posture_age_s, inputs.now_ns, config)
    if about_posture is None and posture is not None:
        about_posture = _reason(_POSTURE, posture_wrong(posture, config.machine.n))
    about_pose = _stamp_wrong(pose, _POSE, config.pose_age_s, inputs.now_ns, config)
    if about_pose is None and pose is not None:
        about_pose = _reason(_POSE, pose_wrong(pose))
    about_intent = _stamp_wrong(intent, _INTENT, config.intent_age_s, inputs.now_ns, config)
    if about_intent is None and intent is not None:
        about_intent = _reason(_INTENT, intent_wrong(intent))
    return Seen(
        posture.q if posture is not None and about_posture is None else None,
        pose.T_site_machine if pose is not None and about_pose is None else None,
        intent if about_intent is None else None,
        tuple(reason for reason in (about_posture, about_pose, about_intent) if reason is not None),
    )


#: What each input is called, and the reasons for one that is absent or too old.
_Named: TypeAlias = tuple[str, ReasonCode, ReasonCode]
_POSTURE: _Named = ("posture", ReasonCode.NO_POSTURE, ReasonCode.STALE_POSTURE)
_POSE: _Named = ("machine pose", ReasonCode.NO_POSE, ReasonCode.STALE_POSE)
_INTENT: _Named = ("operator's intent", ReasonCode.NO_INTENT, ReasonCode.STALE_INTENT)


def _reason(named: _Named, wrong: str | None) -> Reason | None:
    return None if wrong is None else Reason(ReasonCode.INVALID_VALUE, f"{named[0]}: {wrong}")


def _stamp_wrong(
    value: Posture | MachinePose | Intent | None, named: _Named, max_age_s: float, now_ns: int, config: TickConfig
) -> Reason | None:
    """Return what is wrong with one input's presence, machine and age, or None."""
    name, absent, stale = named
    if value is None:
        return Reason(absent, f"no {name}")
    if value.stamp.machine_id != config.machine_id:
        return Reason(ReasonCode.INVALID_VALUE, f"{name} of another machine, {value.stamp.machine_id}")
    age_s = value.stamp.age_s(now_ns)
    if age_s < 0.0:
        return Reason(ReasonCode.FROM_FUTURE, f"{name} is stamped {-age_s:.3f} s in the future")
    if age_s > max_age_s:
        return Reason(stale, f"{name} is {age_s:.3f} s old")
    return None


def posture_wrong(posture: Posture, joints: int) -> str | None:
    """Return what is wrong with a posture's numbers, or None."""
    if posture.q.shape != (joints,) or posture.sigma.shape != (joints,):
        return f"{joints} joints expected"
    if not all(abs(value) < FAR for value in posture.q.tolist()):
        return "a joint position is not a number, or out of this world"
    if not all(0.0 <= value < FAR for value in posture.sigma.tolist()):
        return "a standard deviation is not a number, or below zero"
    return None


def pose_wrong(pose: MachinePose) -> str | None:
    """Return what is wrong with a machine pose's numbers, or None."""
    T = pose.T_site_machine
    if T.shape != (4, 4) or pose.covariance.shape != (6, 6):
        return "a 4 by 4 pose and a 6 by 6 covariance expected"
    (a, b, c, x), (d, e, f, y), (g, h, i, z), bottom = T.tolist()
    if not (abs(x) < FAR and abs(y) < FAR and abs(z) < FAR):
        return "a position is not a number, or out of this world"
    first, second = a * a + d * d + g * g, b * b + e * e + h * h
    mixed = a * b + d * e + g * h
    # the third axis must be the cross product of the other two
    off = abs(d * h - g * e - c) + abs(g * b - a * h - f) + abs(a * e - d * b - i)
    if not abs(first - 1.0) + abs(second - 1.0) + abs(mixed) + off < _SQUARE or bottom != [0.0, 0.0, 0.0, 1.0]:
        return "the attitude is no rotation"
    covariance = pose.covariance.ravel().tolist()
    if not all(map(math.isfinite, covariance)) or min(covariance[::7]) < 0.0:
        return "the covariance is not a number, or a variance below zero"
    return None


def intent_wrong(intent: Intent) -> str | None:
    """Return what is wrong with an intent's numbers, or None."""
    if not all(abs(lever) <= 1.0 for lever in intent.levers.values):
        return "a lever is beyond its stop, or not a number"
    if intent.mode is DriveMode.LINE:
        direction = unit_direction(intent.line)
        if intent.line is None or direction is None:
            return "line mode needs a line with a direction"
        if not math.hypot(*intent.line.start_site.tolist()) < FAR:
            return "the line lies out of this world"
    return None
