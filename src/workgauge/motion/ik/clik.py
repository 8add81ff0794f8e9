"""Closed-loop inverse kinematics, one step: Lee 1-9, corrected, for any machine and any part of the orientation."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from workgauge.machine.model import Kinematics, MachineModel
from workgauge.motion.ik.task import ROWS, sample_postures, task_jacobian
from workgauge.motion.ik.weighted import least_velocity, limit_gradient, manipulability
from workgauge.motion.inverse import HYSTERESIS
from workgauge.values.arrays import Floats, freeze
from workgauge.values.errors import InputError
from workgauge.values.tasks import Orientation

_PULL = 1e-9  # a held joint is let go if the task pulls it back by more than this
_NOTHING = 1e-3  # a share of the task that is not worth a change of group
_FADE = 0.02  # the drift fades out where the weakest direction of the task is below this share of the strongest


@dataclass(frozen=True, slots=True)
class ClikGains:
    """How the loop is closed.

    Attributes:
        linear_1_s, angular_1_s: K of Lee 5, how fast an error of position and of orientation is worked off [1/s].
        length_m_rad: what one radian of orientation error weighs, in metres of position error.
        damping: lambda at the singularity itself, Lee 9's k [m/rad].
        threshold: damping begins where the manipulability falls below this share of what the same joints have in a
            middling posture, Lee 9's m_t.
        posture_1_s: how fast joints that the task leaves free drift to the middle of their ranges; their distance
            from it falls by this share per second.
    """

    linear_1_s: float = 2.0
    angular_1_s: float = 2.0
    length_m_rad: float = 1.0
    damping: float = 0.1
    threshold: float = 0.1
    posture_1_s: float = 0.1

    def __post_init__(self) -> None:
        for name in ("linear_1_s", "angular_1_s", "length_m_rad", "damping", "threshold", "posture_1_s"):
            value, above = getattr(self, name), name in ("length_m_rad", "threshold")
            if not 0.0 <= value < float("inf") or (above and value == 0.0):
                raise InputError(
                    "setting of the inverse kinematics out of range",
                    element=name,
                    value=value,
                    allowed="above 0" if above else "0 or more",
                )


@dataclass(frozen=True, slots=True)
class ClikMemory:
    """What the loop remembers: the exclusive group that moves the tool, -1 for none."""

    group: int = -1


@dataclass(frozen=True, slots=True)
class ClikFacts:
    """What one step was up against.

    Attributes:
        missed: share of the wanted task velocity that the joints cannot do, 0 to 1, apart from being slow.
        scale: what is left of the task velocity so that no joint runs faster than it can, 0 to 1.
        manipulability: weighted, of the joints that may move, as a share of the same joints' in a middling posture.
        damping: lambda [m/rad], 0 away from singularities.
        held: joints that stop at a limit while the task would have them go on.
        group: the exclusive group that moves, -1 for none.
    """

    missed: float
    scale: float
    manipulability: float
    damping: float
    held: tuple[int, ...]
    group: int


def clik_velocity(
    machine: MachineModel,
    kin: Kinematics,
    error: Floats,
    feed_forward: Floats,
    memory: ClikMemory,
    gains: ClikGains,
    orientation: Orientation,
    *,
    dt_s: float,
    joints: Sequence[int] | None = None,
    exclusive: bool = True,
) -> tuple[Floats, ClikMemory, ClikFacts]:
    """Return joint velocities (n,) [rad/s, m/s] that follow the feed-forward and work the error off (Lee 5).

    `qdot = J+ (feed_forward + K error)`, J+ weighted and damped (Lee 6, corrected), the freedom left drifting to the
    middle of the joint ranges. No joint runs faster than it can: the whole is scaled, so the tool keeps its
    direction. No joint is led past a limit within dt_s: where that would happen it goes to the limit and no further,
    and the others do what is left of the task as well as they can. Of joints that exclude each other one group moves,
    the one that misses least; the last one keeps its turn while another is not much better (`HYSTERESIS`).

    Args:
        kin: the measured posture; a joint beyond its limit may move back only.
        error, feed_forward: (m,) of `task_error` [m, rad] and in the same rows [m/s, rad/s].
        joints: those that may move, all if None.
        dt_s: how long the velocity will be held [s].
        exclusive: whether exclusive groups are heeded; not for anything that is driven.

    Raises:
        InputError: if error or feed-forward has another shape or is not finite, or dt_s is not above 0.
    """
    rows = ROWS[orientation]
    for name, value in (("error", error), ("feed_forward", feed_forward)):
        if np.shape(value) != (rows,) or not np.isfinite(value).all():
            raise InputError("not a task vector", element=name, value=value, allowed=f"{rows} finite numbers")
    if not 0.0 < dt_s < float("inf"):
        raise InputError("not a period", element="dt_s", value=dt_s, allowed="above 0")
    weigh, gain = np.ones(rows), np.full(rows, gains.linear_1_s)
    weigh[3:], gain[3:] = gains.length_m_rad, gains.angular_1_s
    wanted = weigh * (feed_forward + gain * error)
    J = weigh[:, None] * task_jacobian(kin, machine, orientation)
    steps = {}
    for number, group in movable_groups(machine, joints, exclusive):
        rank, usual = middling(machine, orientation, group, gains.length_m_rad)
        steps[number] = _bounded(machine, kin.q, J, wanted, group, gains, (rank, usual), dt_s, number)
    best = min(steps, key=lambda number: steps[number][1].missed)
    last = steps.get(memory.group)
    if last is not None and last[1].missed <= HYSTERESIS * steps[best][1].missed + _NOTHING:
        best = memory.group
    qdot, facts = steps[best]
    freeze(qdot)
    return qdot, ClikMemory(best), facts


def movable_groups(
    machine: MachineModel, joints: Sequence[int] | None = None, exclusive: bool = True
) -> tuple[tuple[int, tuple[int, ...]], ...]:
    """Return number and joints of every set that may move together, of the joints given; -1 for all of them."""
    allowed = range(machine.n) if joints is None else joints
    groups = machine.exclusive_groups
    if not (exclusive and groups):
        return ((-1, tuple(allowed)),)
    found = []
    for number, group in enumerate(groups):
        others = {j for other in groups if other is not group for j in other} - set(group)
        found.append((number, tuple(j for j in allowed if j not in others)))
    return tuple(found)


@functools.lru_cache(maxsize=1024)
def middling(
    machine: MachineModel, orientation: Orientation, joints: tuple[int, ...], length_m_rad: float
) -> tuple[int, float]:
    """Return the rank of these joints' task Jacobian, and its median unweighted manipulability, over sample postures.

    Angles are weighed by `length_m_rad`.
    """
    if not joints:
        return 0, 1.0
    weigh = np.where(np.arange(ROWS[orientation]) < 3, 1.0, length_m_rad)[:, None]
    jacobians = [task_jacobian(machine.forward(q), machine, orientation) for q in sample_postures(machine)]
    sigma = np.array([np.linalg.svd((weigh * J)[:, joints], compute_uv=False) for J in jacobians])
    rank = int((sigma > 1e-6 * sigma[:, :1]).sum(axis=1).max())
    return rank, max(float(np.median(np.prod(sigma[:, :rank], axis=1))), 1e-300)


def speed_share(qdot: Floats, machine: MachineModel) -> float:
    """Return the largest share, up to 1, of these joint velocities (n,) that no joint is too slow for."""
    speed = np.where(qdot > 0.0, machine.speed_positive, machine.speed_negative)
    return 1.0 / max(float((np.abs(qdot) / speed).max(initial=0.0)), 1.0)


def _bounded(
    machine: MachineModel,
    q: Floats,
    J: Floats,
    wanted: Floats,
    joints: Sequence[int],
    gains: ClikGains,
    usual: tuple[int, float],
    dt_s: float,
    number: int,
) -> tuple[Floats, ClikFacts]:
    """Return the velocity of one set of joints within speeds and limits.

    Lambda is judged once, for all of them: held joints have all but left it by their weight, and it stays smooth.
    """
    gradient = limit_gradient(q, machine.q_min, machine.q_max)
    low, high = np.minimum((machine.q_min - q) / dt_s, 0.0), np.maximum((machine.q_max - q) / dt_s, 0.0)
    free = list(joints)
    m = manipulability(J[:, free], gradient[free], usual[0]) / usual[1]
    damping = gains.damping * max(1.0 - m / gains.threshold, 0.0)
    qdot = np.zeros(machine.n)
    qdot[free] = least_velocity(J[:, free], wanted, gradient[free], damping)
    scale = speed_share(qdot, machine)  # limits are judged at the speed at which it will be driven
    qdot *= scale
    asked = wanted * scale
    held = _hold(J, asked, gradient, damping, qdot, free, low, high)
    size = float(np.linalg.norm(asked))
    missed = min(float(np.linalg.norm(asked - J @ qdot)) / size, 1.0) if size > 0.0 else 0.0
    slower = speed_share(qdot, machine)
    qdot *= slower
    if len(joints) > usual[0] and gains.posture_1_s > 0.0:
        qdot = _drift(machine, q, J, qdot, list(joints), usual[0], gains.posture_1_s, low, high)
    return qdot, ClikFacts(missed, scale * slower, m, damping, tuple(sorted(held)), number)


def _hold(
    J: Floats,
    asked: Floats,
    gradient: Floats,
    damping: float,
    qdot: Floats,
    free: list[int],
    low: Floats,
    high: Floats,
) -> list[int]:
    """Bring qdot (n,) within low and high, in place, and return the joints held there; the free ones solved anew.

    The worst is held first; a held joint that the rest of the task would rather have back is let go, once.
    """
    held, released = list[int](), set[int]()
    while True:
        beyond = np.maximum(low - qdot, qdot - high)
        worst = max(free, key=beyond.__getitem__, default=-1)
        if worst >= 0 and beyond[worst] > 0.0:
            free.remove(worst)
            held.append(worst)
            qdot[worst] = min(max(qdot[worst], low[worst]), high[worst])
        else:
            pull = J.T @ (asked - J @ qdot)
            back = [j for j in held if j not in released and pull[j] * (1.0 if qdot[j] >= high[j] else -1.0) < -_PULL]
            if not back:
                return held
            released.add(back[0])
            held.remove(back[0])
            free.append(back[0])
        qdot[free] = least_velocity(J[:, free], asked - J[:, held] @ qdot[held], gradient[free], damping)


def _drift(
    machine: MachineModel,
    q: Floats,
    J: Floats,
    qdot: Floats,
    joints: list[int],
    rank: int,
    rate: float,
    low: Floats,
    high: Floats,
) -> Floats:
    """Return the velocity with as much drift to mid range, unfelt by the task, as speeds and limits leave.

    The projector is undamped and cut at the rank the task has in general, so that it is none where no joint is to
    spare. It turns without bound at a singularity: there the drift fades out.
    """
    _, sigma, Vt = np.linalg.svd(J[:, joints])
    ends = np.isfinite(machine.q_min) & np.isfinite(machine.q_max)
    middle = np.where(ends, 0.5 * (np.where(ends, machine.q_min, 0.0) + np.where(ends, machine.q_max, 0.0)), q)
    fade = min(float(sigma[rank - 1]) / (_FADE * float(sigma[0])), 1.0) if rank else 1.0
    z = np.zeros(machine.n)
    z[joints] = Vt[rank:].T @ (Vt[rank:] @ (fade * rate * (middle - q))[joints])
    low, high = np.maximum(low, -machine.speed_negative), np.minimum(high, machine.speed_positive)
    room = np.where(z > 0.0, high - qdot, qdot - low)
    size = np.abs(z)
    share = float(np.min(room / np.maximum(size, 1e-12), where=size > 1e-12, initial=1.0))
    drifting: Floats = qdot + max(share, 0.0) * z
    return drifting
