"""Gathers what a run leaves behind, tick by tick, into the series of its result."""

import math
from collections.abc import Mapping

import numpy as np

from workgauge.drive.api import Drive
from workgauge.machine.model import MachineModel
from workgauge.motion.job import Job
from workgauge.rehearse.auto_series import AutoRecorder, AutoSeries
from workgauge.rehearse.result import PositionSeries, Series, TickTimes, TravelSeries
from workgauge.rehearse.step_result import StepResult
from workgauge.rehearse.truth import Reading
from workgauge.values.arrays import Floats
from workgauge.values.clearances import Clearances

#: The clearances of this many limits, those that came nearest, are kept over time.
CURVES = 4

#: A true clearance nearer than the search radius by this must have been believed as well [m].
SURELY_SEEN_M = 1.0


class Recorder:
    """Gathers the rows of `Series` while a run goes on.

    Args:
        drive: which joint velocities valves ask for.
    """

    def __init__(self, drive: Drive) -> None:
        self._drive = drive
        self.rows: list[tuple[float, Floats, Floats, Floats, tuple[int, ...], tuple[float, ...], float]] = []
        self.true_m: list[float] = []
        self.believed_m: list[float] = []
        self.self_m: list[float] = []
        self.tool: list[Floats] = []
        self.step: list[int] = []
        self.tick_ms: list[float] = []
        self.by_limit: list[Mapping[str, float]] = []
        self.pairs: list[tuple[float, float, float, float, float, float]] = []
        self.states: list[str] = []
        self.travel: list[tuple[float, float, float, float, float]] = []
        self.own: list[str | None] = []
        self._auto = AutoRecorder()

    def take(
        self, done: StepResult, q: Floats, T_site_machine: Floats, tool: Floats, step: int, job: Job | None = None
    ) -> None:
        """Take in one tick: true joints, machine pose and tool at its beginning, and the job it was given."""
        self._auto.take(done.t_s, q, job, done.trace.job, step)
        trace = done.trace
        scale = trace.scale if trace.desired.any() else 1.0  # nothing wanted, nothing held back
        sent = self._drive.velocity(trace.valves, q.tolist())
        self.rows.append((done.t_s, q, trace.desired, trace.allowed, trace.valves, sent, scale))
        self.true_m.append(_metres(done.truth, own=False))
        self.self_m.append(_metres(done.truth, own=True))
        seen = trace.clearances
        outer = seen.distances[seen.other_links < 0] if seen is not None else np.array([])
        self.believed_m.append(float(outer.min()) if len(outer) else math.nan)
        self.tool.append(tool)
        self.step.append(step)
        self.tick_ms.append(done.tick_ms)
        self.by_limit.append(done.truth.by_limit)
        made = done.travel
        x, y = T_site_machine[:2, 3].tolist()
        self.travel.append((made.wanted_m_s, made.speed_m_s, made.travelled_m, x, y))
        self.own.append(done.tracks.own)
        if done.known.health is not None:
            self._position(done, T_site_machine)

    def _position(self, done: StepResult, T_site_machine: Floats) -> None:
        pose, health = done.known.pose, done.known.health
        assert health is not None
        error = sigma = math.nan
        if pose is not None:
            error = float(np.linalg.norm(pose.T_site_machine[:3, 3] - T_site_machine[:3, 3]))
            sigma = math.sqrt(max(float(np.linalg.eigvalsh(pose.covariance[:3, :3])[-1]), 0.0))
        seen = done.trace.clearances
        compared = (math.nan,) * 4 if seen is None else compare(seen, done.before.found)
        self.pairs.append((*compared, error, sigma))
        self.states.append(str(health.state))

    def series(self) -> Series:
        """Return the rows so far as columns."""
        t_s, q, wanted, allowed, valves, sent, scale = (
            np.array(column, dtype=np.float64) for column in zip(*self.rows, strict=True)
        )
        return Series(
            t_s,
            q,
            wanted,
            allowed,
            valves,
            sent,
            scale,
            np.array(self.true_m),
            np.array(self.believed_m),
            np.array(self.self_m),
            np.array(self.tool),
            np.array(self.step, dtype=np.float64),
            self._nearest_limits(),
        )

    def positions(self) -> PositionSeries | None:
        """Return what was believed against what was true, or None where sensors were perfect."""
        if not self.states:
            return None
        columns = (np.array(column) for column in zip(*self.pairs, strict=True))
        return PositionSeries(tuple(self.states), *columns)

    def travels(self) -> TravelSeries | None:
        """Return the undercarriage's way, or None if it never was to travel."""
        wanted, speed, travelled, x, y = (np.array(column) for column in zip(*self.travel, strict=True))
        if not wanted.any():
            return None
        return TravelSeries(wanted, speed, travelled, np.column_stack([x, y]), tuple(self.own))

    def automatic(self, machine: MachineModel, T_site_machine: Floats, tick_s: float) -> AutoSeries | None:
        """Return what automatic motion was to do and did, or None if there was none."""
        return self._auto.series(machine, T_site_machine, tick_s)

    def _nearest_limits(self) -> dict[str, Floats]:
        """Return the clearance over time of the limits that came nearest."""
        least: dict[str, float] = {}
        for row in self.by_limit:
            for limit, distance in row.items():
                least[limit] = min(distance, least.get(limit, distance))
        nearest = sorted(least, key=lambda limit: (least[limit], limit))[:CURVES]
        return {limit: np.array([row.get(limit, math.nan) for row in self.by_limit]) for limit in nearest}

    def tick_times(self) -> TickTimes:
        """Return the wall-clock times of the ticks."""
        p50, p99 = np.percentile(self.tick_ms, [50, 99])
        return TickTimes(float(p50), float(p99), max(self.tick_ms))


def compare(believed: Clearances, true: Clearances) -> tuple[float, float, float, float]:
    """Return (believed clearance, its protection level, true clearance, worst share) of one moment.

    The first three are of the pair of solid and limit believed to be nearest once its protection level is taken off;
    the share is the largest |believed - true| over the protection level, of all pairs believed. It is infinite if a
    pair that is truly near was not believed at all, and NaN where nothing is in sight or nothing is unsure.
    """
    here, there = believed.other_links < 0, true.other_links < 0
    width = len(true.limit_ids)
    keys = believed.solids[here] * width + believed.limits[here]
    true_keys = true.solids[there] * width + true.limits[there]
    distances, levels = believed.distances[here], believed.protections[here]
    true_distances = true.distances[there]
    _, i, j = np.intersect1d(keys, true_keys, assume_unique=True, return_indices=True)
    unsure = levels[i] > 0.0
    shares = np.abs(distances[i] - true_distances[j])[unsure] / levels[i][unsure]
    share = float(shares.max()) if len(shares) else math.nan
    surely = believed.searched_m - float(levels.max(initial=0.0)) - SURELY_SEEN_M
    if not np.isin(true_keys[true_distances < surely], keys).all():
        share = math.inf
    if not len(keys):
        return math.nan, math.nan, math.nan, share
    k = int(np.argmin(distances - levels))
    match = np.flatnonzero(true_keys == keys[k])
    true_m = float(true_distances[match[0]]) if len(match) else math.nan
    return float(distances[k]), float(levels[k]), true_m, share


def _metres(reading: Reading, own: bool) -> float:
    found = reading.own if own else reading.limit
    return math.nan if found is None else found.distance_m
