"""What enters the tick, and whether it may be believed: present, of this machine, fresh, and made of numbers."""

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from workgauge.loop.config import TickConfig
from workgauge.motion.job import Job
from workgauge.motion.line import unit_direction
from workgauge.proximity.scene import Scene
from workgauge.values.arrays import Floats
from workgauge.values.health import PositionHealth
from workgauge.values.measurements import DriveMode, Intent, MachinePose, Posture
from workgauge.values.reasons import STOPPING, Reason, ReasonCode

#: Positions beyond this are no measurement of a machine on its site [rad, m].
FAR = 1e6
_SQUARE = 1e-6
_ROUNDING = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class TickInputs:
    """Everything that enters one tick.

    Attributes:
        now_ns: the monotonic clock the stamps are counted on [ns].
        posture, pose, intent: the newest of each, None if there never was one.
        job: what automatic motion is to do, None for nothing.
        health: how far the pose may be trusted, None if nobody judges it. A state to stop in, or a reason that stops,
            stops every joint; other reasons are passed on.
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
    health: PositionHealth | None = None
    job: Job | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The inputs that may be believed, None for the others, and why not; what is said of the position's health."""

    posture: Posture | None
    pose: MachinePose | None
    intent: Intent | None
    reasons: tuple[Reason, ...]


def believed(inputs: TickInputs, config: TickConfig) -> Seen:
    """Return what of the inputs is present, of this machine, fresh and made of numbers."""
    posture, pose, intent = inputs.posture, inputs.pose, inputs.intent
    n = config.machine.n
    about_posture = _stamp_wrong(posture, _POSTURE, config.posture_age_s, inputs.now_ns, config)
    if about_posture is None and posture is not None:
        about_posture = _reason(_POSTURE, posture_wrong(posture, n))
    about_pose = _stamp_wrong(pose, _POSE, config.pose_age_s, inputs.now_ns, config)
    if about_pose is None and pose is not None:
        about_pose = _reason(_POSE, pose_wrong(pose, n))
    if about_posture is None and about_pose is None and posture is not None and pose is not None:
        about_pose = _reason(_POSE, together_wrong(pose, posture))
    about_intent = _stamp_wrong(intent, _INTENT, config.intent_age_s, inputs.now_ns, config)
    if about_intent is None and intent is not None:
        about_intent = _reason(_INTENT, intent_wrong(intent) or _job_wrong(intent, inputs.job, n))
    trusted, about_health = _health(inputs.health)
    return Seen(
        posture if about_posture is None else None,
        pose if about_pose is None and trusted else None,
        intent if about_intent is None else None,
        (*about_health, *(one for one in (about_posture, about_pose, about_intent) if one is not None)),
    )


def _health(health: PositionHealth | None) -> tuple[bool, tuple[Reason, ...]]:
    """Return whether the position may be used, and what is said of it: a stop never without a reason that stops."""
    if health is None:
        return True, ()
    stopping = any(reason.code in STOPPING for reason in health.reasons)
    if health.state.usable or stopping:
        return not stopping, health.reasons
    return False, (*health.reasons, Reason(ReasonCode.POSITION_LOST, "no position to work on"))


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
    if posture.covariance is not None:
        variances = posture.sigma * posture.sigma
        if posture.covariance.shape != (joints, joints):
            return f"a {joints} by {joints} covariance expected"
        if not np.allclose(posture.covariance.diagonal(), variances, rtol=1e-6, atol=0.0):
            return "the covariance does not belong to the standard deviations"
        return covariance_wrong(posture.covariance)
    return None


def pose_wrong(pose: MachinePose, joints: int) -> str | None:
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
    if pose.cross is not None and pose.cross.shape != (6, joints):
        return f"a 6 by {joints} covariance of pose and joints expected"
    return covariance_wrong(pose.covariance)


def together_wrong(pose: MachinePose, posture: Posture) -> str | None:
    """Return what is wrong with the covariance of a pose and a posture together, or None."""
    if pose.cross is None:
        return None
    joints = np.diag(posture.sigma**2) if posture.covariance is None else posture.covariance
    return covariance_wrong(np.block([[pose.covariance, pose.cross], [pose.cross.T, joints]]))


def covariance_wrong(covariance: Floats) -> str | None:
    """Return what keeps a square matrix from being a covariance, or None.

    Rounding is forgiven: 1e-6 of the standard deviations concerned.
    """
    if not np.count_nonzero(covariance):
        return None
    variances = covariance.diagonal().tolist()
    if not (float(np.maximum.reduce(np.abs(covariance), axis=None)) < FAR * FAR) or min(variances) < 0.0:
        return "the covariance is not a number, or a variance below zero"
    scale = np.array([1.0 / math.sqrt(variance) if variance > 0.0 else 0.0 for variance in variances])
    sure = scale == 0.0
    if sure.any() and (covariance[sure].any() or covariance[:, sure].any()):
        return "the covariance is not positive: an error that cannot be goes with another"
    correlation = scale[:, None] * covariance * scale
    if not np.array_equal(covariance, covariance.T) and (np.abs(correlation - correlation.T) > _ROUNDING).any():
        return "the covariance is not symmetric"
    if np.linalg.eigvalsh(correlation)[0] < -_ROUNDING:
        return "the covariance is not positive: some direction has a variance below zero"
    return None


def _job_wrong(intent: Intent, job: Job | None, joints: int) -> str | None:
    """Return what is wrong with the job of an intent that asks for one, or None."""
    if intent.mode is not DriveMode.AUTO:
        return None
    if job is None:
        return "automatic mode without anything to do"
    return job.wrong(joints)


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
