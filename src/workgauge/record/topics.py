"""What stands in a log: topics, their values, and what is derived from them for display alone."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from workgauge.motion.job import Job
from workgauge.values.arrays import Floats
from workgauge.values.clearances import Clearance
from workgauge.values.commands import ValveCommand
from workgauge.values.measurements import Intent, MachinePose, Posture
from workgauge.values.reasons import Reason


@dataclass(frozen=True, slots=True)
class Moment:
    """One tick: which inputs it had, the others being those of the newest message before it.

    Attributes:
        now_ns: the tick's clock [ns].
        posture, pose, intent, job: whether there was one.
        rest: the tick's other inputs, as JSON text.
    """

    now_ns: int
    posture: bool
    pose: bool
    intent: bool
    job: bool
    rest: str


@dataclass(frozen=True, slots=True)
class Reasons:
    """Every intervention of a tick; written whenever they change."""

    reasons: tuple[Reason, ...]
    scale: float


@dataclass(frozen=True, slots=True, eq=False)
class Velocities:
    """Joint velocities (n,) a tick wanted and what the guard left [rad/s, m/s]."""

    desired: Floats
    allowed: Floats


#: Topic to the type of its messages. A tick's messages stand in this order, inputs first.
TOPICS: dict[str, type[Any]] = {
    "/posture": Posture,
    "/pose": MachinePose,
    "/intent": Intent,
    "/job": Job,
    "/tick": Moment,
    "/velocities": Velocities,
    "/valves": ValveCommand,
    "/clearance": Clearance,
    "/reasons": Reasons,
}


@dataclass(frozen=True, slots=True)
class Derived:
    """A message for display: its schema's name and JSON Schema, and the plain message."""

    schema_name: str
    schema: dict[str, Any]
    data: dict[str, Any]


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


_NUMBER, _TEXT, _WHOLE = {"type": "number"}, {"type": "string"}, {"type": "integer"}
_TIME = _object(sec=_WHOLE, nsec=_WHOLE)
_TRANSFORM = {
    "title": "foxglove.FrameTransform",
    **_object(
        timestamp=_TIME,
        parent_frame_id=_TEXT,
        child_frame_id=_TEXT,
        translation=_object(x=_NUMBER, y=_NUMBER, z=_NUMBER),
        rotation=_object(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER),
    ),
}
_LINE = {
    "title": "foxglove.Log",
    **_object(timestamp=_TIME, level=_WHOLE, message=_TEXT, name=_TEXT, file=_TEXT, line=_WHOLE),
}
_WARNING = 3


def transform(now_ns: int, pose: MachinePose) -> Derived | None:
    """Return a pose as Foxglove's `FrameTransform` from site to machine, or None if it holds no finite numbers."""
    T = pose.T_site_machine
    if T.shape != (4, 4) or not np.isfinite(T).all():
        return None
    x, y, z = T[:3, 3].tolist()
    a, b, c, w = _quaternion(T[:3, :3])
    data = {
        "timestamp": _time(now_ns),
        "parent_frame_id": "site",
        "child_frame_id": pose.stamp.machine_id,
        "translation": {"x": x, "y": y, "z": z},
        "rotation": {"x": a, "y": b, "z": c, "w": w},
    }
    return Derived("foxglove.FrameTransform", _TRANSFORM, data)


def line(now_ns: int, reason: Reason) -> Derived:
    """Return a reason as a line of Foxglove's `Log`."""
    data = {
        "timestamp": _time(now_ns),
        "level": _WARNING,
        "message": reason.text,
        "name": reason.code.value,
        "file": reason.limit or reason.joint or "",
        "line": 0,
    }
    return Derived("foxglove.Log", _LINE, data)


def _time(now_ns: int) -> dict[str, int]:
    return {"sec": now_ns // 1_000_000_000, "nsec": now_ns % 1_000_000_000}


def _quaternion(R: Floats) -> tuple[float, float, float, float]:
    """Return (x, y, z, w) of a rotation matrix, from its largest component for accuracy."""
    xx, yy, zz = float(R[0, 0]), float(R[1, 1]), float(R[2, 2])
    squares = [1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz, 1 + xx + yy + zz]
    best = int(np.argmax(squares))
    i, j, k = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    p, q, r = R[1, 0] + R[0, 1], R[0, 2] + R[2, 0], R[2, 1] + R[1, 2]
    rows = ((squares[0], p, q, i), (p, squares[1], r, j), (q, r, squares[2], k), (i, j, k, squares[3]))
    scale = 0.5 / math.sqrt(max(squares[best], 1e-12))
    x, y, z, w = (float(value) * scale for value in rows[best])
    return x, y, z, w
