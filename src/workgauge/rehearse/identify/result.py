"""What was found: a machine's stopping model with its tolerance, as a table of stops and as its file's blocks."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.machine.stopping import StoppingModel
from workgauge.rehearse.identify.fit import (
    CONFIDENCE,
    FEWEST_LEVELS,
    FEWEST_STOPS,
    DirectionFit,
    Estimate,
    fit_direction,
)
from workgauge.rehearse.identify.log import StepLog
from workgauge.rehearse.identify.model import stop_travel
from workgauge.rehearse.identify.stops import find_stops
from workgauge.values.arrays import Floats
from workgauge.values.errors import InputError

#: What a log taken in one state of the machine does not show: other oil, other loads [share].
UNSEEN = 0.2
#: Bounds wider than this make the model itself slower instead of its tolerance larger [share].
LARGEST = 0.5
#: A log says too little if dead time and lag together could be so many times as long, and so much more [s].
VAGUE, VAGUE_S = 2.0, 0.1
#: Times below this are not worth a tolerance of their own [s].
SHORT_S = 0.005
#: Shares of full speed in the table of stops.
SPEEDS = (0.25, 0.5, 0.75, 1.0)
_POSTURES = 2000


@dataclass(frozen=True, slots=True, eq=False)
class SideStop:
    """One direction of one joint.

    Attributes:
        direction: +1 or -1. fit: what was found.
        dead_time_s, lag_s, deceleration, tolerance: the stopping model to be used: together they cover the fit's
            bounds and every stop in the log.
        left_out: stops that could not be used, and why.
    """

    direction: int
    fit: DirectionFit
    dead_time_s: float
    lag_s: float
    deceleration: float
    tolerance: float
    left_out: tuple[str, ...] = ()

    @property
    def full_speed(self) -> float:
        """Full speed as found, or the fastest before a stop."""
        return float(self.fit.speeds.max()) if self.fit.full_speed is None else self.fit.full_speed.value

    def expected(self, speed: float) -> float:
        """Return the way a stop from `speed` takes as fitted [rad, m]."""
        fit = self.fit
        return stop_travel(speed, fit.dead_time_s.value, fit.lag_s.value, fit.deceleration.value)

    def guaranteed(self, speed: float) -> float:
        """Return the way a stop from `speed` takes at the end of the tolerance [rad, m]."""
        grown = 1.0 + self.tolerance
        return stop_travel(speed, self.dead_time_s * grown, self.lag_s * grown, self.deceleration / grown)


@dataclass(frozen=True, slots=True, eq=False)
class JointStop:
    """A joint's two directions, positive first. arm_m: how far the tool moves per radian or metre of it, at most."""

    name: str
    prismatic: bool
    sides: tuple[SideStop, SideStop]
    arm_m: float | None


def identify(
    log: StepLog,
    machine: MachineModel | None = None,
    joints: Sequence[str] | None = None,
    tolerance: float = UNSEEN,
) -> tuple[JointStop, ...]:
    """Return how each joint stops.

    Args:
        log: as read. machine: for distances at the tool. joints: those to look at; all of the log's if left out.
        tolerance: for what the log does not show, at least; grows as the bounds need it.

    Raises:
        InputError: for a joint that is not there or is not excited enough, with what is missing.
    """
    for name in joints or ():
        if name not in log.joints:
            raise InputError("no such joint in the log", file=log.file, value=name, allowed=", ".join(log.joints))
    arms = None if machine is None else _arms(log, machine)
    found = []
    for j, name in enumerate(log.joints):
        if joints is None or name in joints:
            ends = None if machine is None else (float(machine.q_min[j]), float(machine.q_max[j]))
            sides = _side(log, j, 1, tolerance, ends), _side(log, j, -1, tolerance, ends)
            found.append(JointStop(name, log.prismatic[j], sides, None if arms is None else arms[name]))
    return tuple(found)


def stopping_model(found: Sequence[JointStop]) -> StoppingModel:
    """Return the stopping model of these joints, in their order."""

    def rows(name: str) -> Floats:
        return np.array([[getattr(joint.sides[side], name) for joint in found] for side in (0, 1)])

    return StoppingModel(rows("dead_time_s"), rows("lag_s"), rows("deceleration"), rows("tolerance"))


def _side(
    log: StepLog, j: int, direction: int, tolerance: float, ends: tuple[float, float] | None = None
) -> SideStop:
    stops, left_out = find_stops(log, j, direction, ends)
    sign = "positive" if direction > 0 else "negative"
    try:
        fit = fit_direction(stops)
    except ValueError as error:
        where = f"joint {log.joints[j]}, {sign} direction"
        unused = f"; left out: {left_out[0]}" if left_out else ""
        allowed = f"{FEWEST_STOPS} stops or more, from {FEWEST_LEVELS} lever positions or more"
        raise InputError(
            f"the log does not excite it enough{unused}", file=log.file, element=where, value=error, allowed=allowed
        ) from None
    dead, lag, slow = fit.dead_time_s, fit.lag_s, fit.deceleration
    if fit.together_s.high > VAGUE * fit.together_s.value + VAGUE_S:
        raise InputError(
            "the log does not say enough about its dead time and lag",
            file=log.file,
            element=f"joint {log.joints[j]}, {sign} direction",
            value=f"{fit.together_s.value:.3f} s together, up to {fit.together_s.high:.3f} s",
        )
    needed = max(tolerance, min(max(_spread(dead), _spread(lag)), LARGEST))
    needed = math.ceil(100.0 * needed - 1e-9) / 100.0
    grown = 1.0 + needed
    side = SideStop(
        direction,
        fit,
        max(dead.value, dead.high / grown),
        max(lag.value, lag.high / grown),
        min(slow.value, slow.low * grown),
        needed,
        tuple(left_out),
    )
    short = max((way - side.guaranteed(v)) / (v * grown) for v, way in zip(fit.speeds, fit.travels, strict=True))
    # where the model falls short of a stop in the log, what it lacks counts as dead time
    return replace(side, dead_time_s=side.dead_time_s + max(short, 0.0))


def _spread(one: Estimate) -> float:
    """Return how far the bounds lie from the value, relative; nothing for times too short to matter."""
    if one.high < SHORT_S:
        return 0.0
    return max(one.high - one.value, one.value - one.low) / max(one.value, SHORT_S)


def _arms(log: StepLog, machine: MachineModel) -> dict[str, float]:
    """Return how far the tool moves per unit of each joint, at most over the machine's postures [m/rad, m/m]."""
    if machine.joint_names != log.joints:
        raise InputError(
            "the log is of another machine",
            file=log.file,
            value=", ".join(log.joints),
            allowed=", ".join(machine.joint_names),
        )
    rng = np.random.default_rng(0)
    most = np.zeros(machine.n)
    for q in rng.uniform(machine.sample_min, machine.sample_max, (_POSTURES, machine.n)):
        most = np.maximum(most, np.linalg.norm(machine.tool_jacobian(machine.forward(q))[:3], axis=0))
    return dict(zip(machine.joint_names, most.tolist(), strict=True))


def as_json(found: Sequence[JointStop]) -> dict[str, Any]:
    """Return the documented object of `workgauge identify --json`."""
    return {"confidence": CONFIDENCE, "joints": [_joint_json(joint) for joint in found]}


def _joint_json(joint: JointStop) -> dict[str, Any]:
    unit, scale = ("m", 1.0) if joint.prismatic else ("deg", math.degrees(1.0))
    sides = {}
    for side in joint.sides:
        fit = side.fit
        sides["positive" if side.direction > 0 else "negative"] = {
            "dead_time_s": _estimate(fit.dead_time_s),
            "lag_s": _estimate(fit.lag_s),
            f"deceleration_{unit}_s2": _estimate(fit.deceleration, scale),
            f"full_speed_{unit}_s": None if fit.full_speed is None else _estimate(fit.full_speed, scale),
            "dead_band_percent": None if fit.dead_band is None else _estimate(fit.dead_band, 100.0),
            "stops": len(fit.speeds),
            "left_out": list(side.left_out),
            "fit": {
                f"residual_{unit}": fit.noise * scale,
                "explained": fit.explained,
                f"worst_stop_error_{unit}": float(np.abs(fit.travels - fit.predicted).max()) * scale,
                f"quantisation_{unit}": fit.step * scale,
            },
            "model": _block(joint, side),
            "table": [
                {
                    f"speed_{unit}_s": row[0] * scale,
                    f"expected_{unit}": row[1] * scale,
                    f"guaranteed_{unit}": row[2] * scale,
                    "at_tool_m": row[3],
                }
                for row in table(joint, side)
            ],
        }
    return {"joint": joint.name, **sides}


def table(joint: JointStop, side: SideStop) -> list[tuple[float, float, float, float | None]]:
    """Return (speed, expected way, guaranteed way, guaranteed way of the tool [m] or None) at `SPEEDS` of full."""
    rows = []
    for share in SPEEDS:
        speed = share * side.full_speed
        most = side.guaranteed(speed)
        rows.append((speed, side.expected(speed), most, None if joint.arm_m is None else most * joint.arm_m))
    return rows


def _estimate(one: Estimate, scale: float = 1.0) -> dict[str, float | None]:
    """Return an estimate as JSON; what is infinite is null."""
    pairs = (("value", one.value), ("low", one.low), ("high", one.high))
    return {name: value * scale if math.isfinite(value) else None for name, value in pairs}


def _block(joint: JointStop, side: SideStop) -> dict[str, Any]:
    """Return one `stopping_` block of a machine's file, rounded to the side that stops later."""
    block: dict[str, Any] = {
        "dead_time_s": _up(side.dead_time_s, 4),
        "lag_s": _up(side.lag_s, 4),
    }
    if math.isfinite(side.deceleration):
        scale = 1.0 if joint.prismatic else math.degrees(1.0)
        key = "deceleration_m_s2" if joint.prismatic else "deceleration_deg_s2"
        block[key] = math.floor(side.deceleration * scale * 1e4) / 1e4
    block["tolerance_percent"] = round(100.0 * side.tolerance)
    return block


def _up(value: float, digits: int) -> float:
    scale = 10.0**digits
    return math.ceil(value * scale - 1e-9) / scale


def blocks(found: Sequence[JointStop], source: str) -> dict[str, Any]:
    """Return the `stopping_` blocks of a machine's file, joint by joint.

    Args:
        found: the joints. source: where they come from, written into each block.
    """
    joints = []
    for joint in found:
        positive, negative = ({**_block(joint, side), "source": source} for side in joint.sides)
        joints.append({"name": joint.name, "stopping_positive": positive, "stopping_negative": negative})
    return {"joints": joints}
