"""What automatic motion was to do, and what it did: designed and driven tool, joints, errors, one row per tick."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.motion.job import Job, JobFacts, JobState
from workgauge.values.arrays import Floats, Ints
from workgauge.values.transforms import inverse


@dataclass(frozen=True, slots=True)
class JobRun:
    """What became of one job.

    Attributes:
        job: its id. state: the last one it had. planned_s: of its trajectory, NaN for a goal.
        begun_s, ended_s: since the run's start.
        max_error_m, rms_error_m, max_error_rad: of the tool from where it was to be by then; of a goal, at its end.
        held_s: how long limits held or bent it. against: the limits that did, the one that did longest first.
        step: index of the drive's step it belongs to.
    """

    job: str
    state: JobState
    planned_s: float
    begun_s: float
    ended_s: float
    max_error_m: float
    rms_error_m: float
    max_error_rad: float
    held_s: float
    against: tuple[str, ...]
    step: int = 0

    def as_json(self) -> dict[str, Any]:
        """Return the documented object of the run command."""
        return {
            "job": self.job,
            "step": self.step + 1,
            "state": self.state.value,
            "planned_s": None if math.isnan(self.planned_s) else round(self.planned_s, 3),
            "begun_s": round(self.begun_s, 3),
            "driven_s": round(self.ended_s - self.begun_s, 3),
            "max_error_m": round(self.max_error_m, 5),
            "rms_error_m": round(self.rms_error_m, 5),
            "max_error_deg": round(math.degrees(self.max_error_rad), 4),
            "held_s": round(self.held_s, 3),
            "against": list(self.against),
        }


@dataclass(frozen=True, slots=True, eq=False)
class AutoSeries:
    """Automatic motion, one row per tick; NaN where there was none.

    Attributes:
        jobs: in order. which: (n,) index of the tick's job, -1 for none.
        designed, driven: (n, 6) tool position [m] and roll, pitch, yaw [rad] in the machine frame.
        designed_q: (n, joints) joints on the trajectory [rad, m].
        error_m, error_rad: (n,) between the two. rate: (n,) how fast the trajectory's time ran.
        left: (n,) share of what was wanted that motion left before limits.
        T_site_machine: (4, 4) where the machine stood at the end, in the site's local frame.
    """

    jobs: tuple[JobRun, ...]
    which: Ints
    designed: Floats
    driven: Floats
    designed_q: Floats
    error_m: Floats
    error_rad: Floats
    rate: Floats
    left: Floats
    T_site_machine: Floats

    @property
    def completed(self) -> bool:
        """Whether every step's last job was done: one that was stuck, and then a way round it done, is."""
        return all(job.state is JobState.DONE for job in self.last_of_steps)

    @property
    def last_of_steps(self) -> tuple[JobRun, ...]:
        """Each step's last job."""
        return tuple({job.step: job for job in self.jobs}.values())

    @property
    def planned_s(self) -> float:
        """Time of all trajectories together [s]."""
        return float(sum(job.planned_s for job in self.jobs if not math.isnan(job.planned_s)))

    @property
    def driven_s(self) -> float:
        """Time of all jobs together [s]."""
        return float(sum(job.ended_s - job.begun_s for job in self.jobs))

    def as_json(self) -> dict[str, Any]:
        """Return the documented object of the run command."""
        planned = self.planned_s
        return {
            "completed": self.completed,
            "planned_s": round(planned, 3),
            "driven_s": round(self.driven_s, 3),
            "driven_over_planned": round(self.driven_s / planned, 4) if planned > 0.0 else None,
            "jobs": [job.as_json() for job in self.jobs],
        }


class AutoRecorder:
    """Gathers the rows while a run goes on."""

    def __init__(self) -> None:
        self._rows: list[tuple[float, Floats, Job | None, JobFacts | None]] = []
        self._steps: dict[str, int] = {}

    def take(self, t_s: float, q: Floats, job: Job | None, facts: JobFacts | None, step: int = 0) -> None:
        """Take in one tick: time, true joints (n,) at its beginning, the job given, what became of it, the step."""
        if facts is not None:
            self._steps.setdefault(facts.job, step)
        self._rows.append((t_s, q, job if facts is not None else None, facts))

    def series(self, machine: MachineModel, T_site_machine: Floats, tick_s: float) -> AutoSeries | None:
        """Return the rows as columns, None if there never was a job."""
        if not any(facts is not None for _, _, _, facts in self._rows):
            return None
        order: dict[str, int] = {}
        for _, _, _, facts in self._rows:
            if facts is not None:
                order.setdefault(facts.job, len(order))
        n = len(self._rows)
        which = np.full(n, -1)
        designed, driven = np.full((n, 6), np.nan), np.full((n, 6), np.nan)
        designed_q, numbers = np.full((n, machine.n), np.nan), np.full((4, n), np.nan)
        for k, (_, q, job, facts) in enumerate(self._rows):
            driven[k] = _place(machine.tool_pose(machine.forward(q)))
            if job is None or facts is None:
                continue
            which[k] = order[facts.job]
            numbers[:, k] = facts.error_m, facts.error_rad, facts.rate, facts.left
            if job.trajectory is not None:
                designed_q[k] = job.trajectory.at(facts.clock_s)[0]
                designed[k] = _place(machine.tool_pose(machine.forward(designed_q[k])))
            elif job.goal is not None:
                designed[k] = _place(inverse(T_site_machine) @ job.goal.T_site_tool)
        for angles in (designed, driven):
            angles[:, 3:] = _unwrapped(angles[:, 3:])
        jobs = tuple(self._run(name, tick_s) for name in order)
        error_m, error_rad, rate, left = numbers
        return AutoSeries(
            jobs, which, designed, driven, designed_q, error_m, error_rad, rate, left, np.array(T_site_machine)
        )

    def _run(self, name: str, tick_s: float) -> JobRun:
        rows = [(t, facts) for t, _, _, facts in self._rows if facts is not None and facts.job == name]
        facts = [one for _, one in rows]
        last, goal = facts[-1], facts[0].duration_s == 0.0
        errors = np.array([one.error_m for one in (facts[-1:] if goal else facts)])
        turns = np.array([one.error_rad for one in (facts[-1:] if goal else facts)])
        against = [one.against for one in facts if one.against is not None and one.state is not JobState.MOVING]
        return JobRun(
            name,
            last.state,
            math.nan if goal else last.duration_s,
            rows[0][0],
            rows[-1][0],
            float(errors.max()),
            float(np.sqrt(np.mean(errors**2))),
            float(turns.max()),
            tick_s * sum(one.state is JobState.HELD for one in facts),
            tuple(sorted(set(against), key=lambda limit: (-against.count(limit), limit))),
            self._steps[name],
        )


def _place(T: Floats) -> Sequence[float]:
    """Return position and roll, pitch, yaw of a frame (4, 4), about the fixed axes x, y, z."""
    pitch = math.atan2(-T[2, 0], math.hypot(T[0, 0], T[1, 0]))
    return (*T[:3, 3].tolist(), math.atan2(T[2, 1], T[2, 2]), pitch, math.atan2(T[1, 0], T[0, 0]))


def _unwrapped(angles: Floats) -> Floats:
    """Return angles (n, 3) without jumps by whole turns, from tick to tick; NaN stays."""
    out = np.array(angles)
    for column in out.T:
        known = np.flatnonzero(~np.isnan(column))
        column[known] = np.unwrap(column[known])
    return out
