"""A log of steps and stops as arrays, from MCAP or CSV, refused with the exact place if it cannot be relied on."""

import csv
import math
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from workgauge.record.reader import open_log
from workgauge.values.arrays import Floats, Ints
from workgauge.values.commands import VALVE_FULL
from workgauge.values.errors import InputError

#: A log is at least this long [s], and sampled at least this often [s].
SHORTEST_S, COARSEST_S = 5.0, 0.1
#: A pause between samples is a gap from so many periods, and from so long, on [s].
GAP_PERIODS, GAP_S = 8.0, 0.15
#: Largest CSV file [bytes].
LARGEST = 512 * 1024 * 1024

_UNITS = {"rad": 1.0, "deg": math.radians(1.0), "m": 1.0}
_HEADER = "t_s, then q_JOINT_deg, q_JOINT_rad or q_JOINT_m and valve_JOINT_percent for each joint"


@dataclass(frozen=True, slots=True, eq=False)
class StepLog:
    """Positions and valves over time.

    Attributes:
        file: where it comes from. lines: (m,) line of each sample in a text file, or None.
        joints: (n). prismatic: (n).
        t, q: (m,) times [s] and (m, n) positions [rad, m].
        t_valve, valve: (k,) times [s] and (k, n) valves, -1 to 1, each acting until the next.
        machine: name of the machine, if the log says.
    """

    file: Path
    joints: tuple[str, ...]
    prismatic: tuple[bool, ...]
    t: Floats
    q: Floats
    t_valve: Floats
    valve: Floats
    lines: Ints | None = None
    machine: str | None = None

    def checked(self) -> "StepLog":
        """Return the log itself.

        Raises:
            InputError: if times do not rise, a number is none, samples are missing, or it is too short.
        """
        for name, times, values in (("q", self.t, self.q), ("valve", self.t_valve, self.valve)):
            bad = np.flatnonzero(~(np.isfinite(times) & np.isfinite(values).all(axis=1)))
            if len(bad):
                raise self.refused("not a finite number", name, int(bad[0]), times)
            back = np.flatnonzero(np.diff(times) <= 0.0)
            if len(back):
                raise self.refused("time does not go forwards", name, int(back[0]) + 1, times)
        wide = np.flatnonzero((np.abs(self.valve) > 1.0).any(axis=1))
        if len(wide):
            raise self.refused("a valve is open by more than full", "valve", int(wide[0]), self.t_valve)
        length = float(self.t[-1] - self.t[0]) if len(self.t) > 1 else 0.0
        if length < SHORTEST_S or not len(self.t_valve):
            raise InputError(
                "the log is too short", file=self.file, value=f"{length:.2f} s", allowed=f"at least {SHORTEST_S:g} s"
            )
        steps = np.diff(self.t)
        period = float(np.median(steps))
        if period > COARSEST_S:
            allowed = f"at most {COARSEST_S:g} s"
            raise InputError("samples are too far apart", file=self.file, value=f"{period:.3f} s", allowed=allowed)
        gaps = np.flatnonzero(steps > max(GAP_PERIODS * period, GAP_S))
        if len(gaps):
            k = int(gaps[0])
            raise self.refused(f"a gap of {steps[k]:.3f} s", "q", k + 1, self.t)
        return self

    def refused(self, message: str, name: str, index: int, times: Floats) -> InputError:
        """Return the error for one sample, with its line, or its number and time."""
        line = None if self.lines is None else int(self.lines[index])
        element = f"{name}, sample {index + 1}" if line is None else name
        return InputError(message, file=self.file, line=line, element=f"{element} at t = {times[index]:.3f} s")


def read_step_log(path: Path) -> StepLog:
    """Return a log of steps and stops: MCAP of this program, or CSV if the name ends so.

    Raises:
        InputError: if it cannot be read or relied on, with the place.
    """
    return (_from_csv(path) if path.suffix.lower() == ".csv" else _from_mcap(path)).checked()


def _from_mcap(path: Path) -> StepLog:
    log = open_log(path)
    joints, prismatic = log.configuration.get("joints"), log.configuration.get("prismatic")
    if not isinstance(joints, list) or not isinstance(prismatic, list) or len(joints) != len(prismatic):
        raise InputError("its header names no joints", file=path, element="configuration.joints")
    t, q, t_valve, valve = [], [], [], []
    for topic, time_ns, value in log.entries("/posture", "/valves"):
        count = len(value.q) if topic == "/posture" else len(value.valves)
        if count != len(joints):
            place = f"{topic} at t = {time_ns * 1e-9:.3f} s"
            raise InputError(
                "another number of joints", file=path, element=place, value=count, allowed=f"{len(joints)}"
            )
        if topic == "/posture":
            t.append(value.stamp.monotonic_ns * 1e-9)
            q.append(value.q)
        else:
            t_valve.append(time_ns * 1e-9)
            valve.append(value.valves if value.enable else (0,) * count)
    n = len(joints)
    return StepLog(
        path,
        tuple(map(str, joints)),
        tuple(map(bool, prismatic)),
        np.array(t),
        np.array(q, dtype=np.float64).reshape(-1, n),
        np.array(t_valve),
        np.array(valve, dtype=np.float64).reshape(-1, n) / VALVE_FULL,
        machine=log.configuration.get("machine"),
    )


def _from_csv(path: Path) -> StepLog:
    try:
        if path.stat().st_size > LARGEST:
            raise InputError("too large for a log", file=path, allowed=f"{LARGEST // 2**20} MB")
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        raise InputError("the log cannot be read", file=path, value=str(error)) from error
    rows = csv.reader(StringIO(text, newline=""))
    try:
        return _from_rows(path, rows)
    except csv.Error as error:
        raise InputError("not a CSV file", file=path, line=rows.line_num, value=str(error)) from None


def _from_rows(path: Path, rows: Any) -> StepLog:
    header = [name.strip() for name in next(rows, [])]
    positions, valves = _columns(path, header)
    kept, numbers = [], []
    for row in rows:
        line = rows.line_num
        if not row:
            continue
        if len(row) != len(header):
            raise InputError(
                "columns are missing or too many", file=path, line=line, value=len(row), allowed=f"{len(header)}"
            )
        try:
            numbers.append([float(cell) for cell in row])
        except ValueError as error:
            raise InputError("not a number", file=path, line=line, value=str(error)) from None
        kept.append(line)
    table = np.array(numbers, dtype=np.float64).reshape(-1, len(header))
    scale = np.array([_UNITS[unit] for _, _, unit in positions])
    t = table[:, header.index("t_s")]
    return StepLog(
        path,
        tuple(joint for joint, _, _ in positions),
        tuple(unit == "m" for _, _, unit in positions),
        t,
        table[:, [column for _, column, _ in positions]] * scale,
        t,
        table[:, [valves[joint] for joint, _, _ in positions]] / 100.0,
        np.array(kept, dtype=np.int64),
    )


def _columns(path: Path, header: list[str]) -> tuple[list[tuple[str, int, str]], dict[str, int]]:
    """Return (joint, column, unit) of every position, and the valves' columns by joint."""
    positions: list[tuple[str, int, str]] = []
    valves: dict[str, int] = {}
    for i, name in enumerate(header):
        joint, _, unit = name[2:].rpartition("_")
        if name in header[:i]:
            raise InputError("column appears twice", file=path, line=1, element=name)
        if name.startswith("q_") and joint and unit in _UNITS:
            positions.append((joint, i, unit))
        elif name.startswith("valve_") and name.endswith("_percent"):
            valves[name.removeprefix("valve_").removesuffix("_percent")] = i
        elif name != "t_s":
            raise InputError("unknown column", file=path, line=1, element=name, allowed=_HEADER)
    joints = [joint for joint, _, _ in positions]
    if "t_s" not in header or not joints or sorted(joints) != sorted(valves):
        raise InputError("columns are missing", file=path, line=1, value=", ".join(header), allowed=_HEADER)
    return positions, valves
