"""Fitting the stopping model to stops, with bounds that hold under noise, quantisation and an imperfect model."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import norm

from workgauge.rehearse.identify.model import NO_LIMIT, stop_travel, way
from workgauge.rehearse.identify.stops import Stop
from workgauge.values.arrays import Floats

#: The bounds of one joint's parameters, five in each direction, hold all together with this confidence.
CONFIDENCE = 0.99
#: So many standard deviations to each side (Bonferroni over the ten).
K = float(norm.ppf(1.0 - (1.0 - CONFIDENCE) / 20.0))
#: Fewest stops in one direction, and fewest different lever positions among them.
FEWEST_STOPS, FEWEST_LEVELS = 3, 2
#: Beyond this relative uncertainty a bound is found by refitting instead of by linearisation.
NEARLY_LINEAR = 0.04
_DRAWS = 160
_LONGEST = 5.0
DEAD, LAG, SLOW = 0, 1, 2


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value and the bounds it lies within."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, eq=False)
class DirectionFit:
    """How a joint stops out of one direction.

    Attributes:
        together_s: dead time and lag together, which a log says much better than each.
        dead_time_s, lag_s, deceleration: of the stopping model [s, s, rad/s^2 or m/s^2]; deceleration and its upper
            bound are infinite where no limit shows.
        full_speed, dead_band: joint speed at the full valve and share of the valve's travel that does nothing; None
            if the log has too few lever positions.
        speeds: of the stops, (s,). travels: ways made in them, (s,). predicted: by the model, (s,).
        noise: standard deviation of what the model leaves over. explained: share of the variance it explains.
        step: quantisation of the positions, 0 if none shows.
    """

    together_s: Estimate
    dead_time_s: Estimate
    lag_s: Estimate
    deceleration: Estimate
    full_speed: Estimate | None
    dead_band: Estimate | None
    speeds: Floats
    travels: Floats
    predicted: Floats
    noise: float
    explained: float
    step: float


class _Problem:
    """Residuals of all stops for (dead time, lag, 1 / deceleration, speeds...); each stop's start is free."""

    def __init__(self, stops: Sequence[Stop], band: float) -> None:
        self.stops = stops
        self.sizes = [len(stop.t) for stop in stops]
        self.ends = np.cumsum([0, *self.sizes])
        self.shares = [np.maximum(stop.valves - band, 0.0) / max(stop.valve - band, 1e-9) for stop in stops]
        self.x = np.concatenate([stop.x for stop in stops])
        self.rows = int(self.ends[-1])

    def centred(self, values: Floats) -> Floats:
        """Return values with every stop's mean taken off."""
        out = values.copy()
        for begin, end in zip(self.ends[:-1], self.ends[1:], strict=True):
            out[begin:end] -= out[begin:end].mean(axis=0)
        return out

    def ways(self, p: Floats) -> Floats:
        """Return the model's ways (rows,)."""
        out = np.empty(self.rows)
        for i, stop in enumerate(self.stops):
            part = out[self.ends[i] : self.ends[i + 1]]
            way(stop.t, stop.cuts, self.shares[i], p[3 + i], p[DEAD], p[LAG], p[SLOW], part)
        return out

    def residuals(self, p: Floats) -> Floats:
        """Return (rows,) model less measured."""
        return self.centred(self.ways(p) - self.x)

    def jacobian(self, p: Floats) -> Floats:
        """Return (rows, 3 + stops) by finite differences; speeds each touch their own stop alone."""
        base, J = self.ways(p), np.zeros((self.rows, len(p)))
        for k in range(3):
            step = np.zeros_like(p)
            step[k] = 1e-6 * max(p[k], 0.1)
            J[:, k] = (self.ways(p + step) - base) / step[k]
        step = 1e-6 * np.maximum(p, 0.01)
        step[:3] = 0.0
        all_speeds = self.ways(p + step) - base
        for i, (begin, end) in enumerate(zip(self.ends[:-1], self.ends[1:], strict=True)):
            J[begin:end, 3 + i] = all_speeds[begin:end] / step[3 + i]
        return self.centred(J)

    def reduced(self, p: Floats) -> tuple[Floats, Floats]:
        """Return residuals (5 stops,) and Jacobian (5 stops, 3 + stops) of the same least-squares problem.

        Each stop's samples are turned (QR of its four columns and residuals) so that all but five rows vanish.
        Lengths and products of the columns stay, and least squares looks at nothing else.
        """
        r, J = self.residuals(p), self.jacobian(p)
        f, out = np.zeros(5 * len(self.stops)), np.zeros((5 * len(self.stops), len(p)))
        for i, (begin, end) in enumerate(zip(self.ends[:-1], self.ends[1:], strict=True)):
            block = np.column_stack([J[begin:end, :3], J[begin:end, 3 + i], r[begin:end]])
            R = np.asarray(np.linalg.qr(block, mode="r"))
            rows = slice(5 * i, 5 * i + len(R))
            out[rows, :3], out[rows, 3 + i], f[rows] = R[:, :3], R[:, 3], R[:, 4]
        return f, out

    def solve(self, start: Floats, held: tuple[int, float] | None = None, steps: int = 60) -> tuple[Floats, float]:
        """Return the parameters of least squares and their cost, one of them held if asked for."""
        free = [k for k in range(len(start)) if held is None or k != held[0]]
        full = start.copy()
        if held is not None:
            full[held[0]] = held[1]

        def filled(p: Floats) -> Floats:
            out = full.copy()
            out[free] = p
            return out

        low = np.zeros(len(start))
        high = np.concatenate([[_LONGEST, _LONGEST, 1e4], np.full(len(start) - 3, np.inf)])
        begin = np.clip(full, low + 1e-9, high - 1e-9)[free]

        newest: dict[bytes, tuple[Floats, Floats]] = {}

        def reduced(p: Floats) -> tuple[Floats, Floats]:
            if p.tobytes() not in newest:
                newest.clear()
                newest[p.tobytes()] = self.reduced(filled(p))
            return newest[p.tobytes()]

        def residuals(p: Floats) -> Floats:
            return reduced(p)[0]

        def jacobian(p: Floats) -> Floats:
            return np.asarray(reduced(p)[1][:, free])

        found = least_squares(
            residuals,
            begin,
            jacobian,
            bounds=(low[free], high[free]),
            x_scale="jac",
            max_nfev=steps,
            xtol=1e-10,
            ftol=1e-12,
            gtol=1e-14,
        )
        return filled(found.x), 2.0 * float(found.cost)


def fit_direction(stops: Sequence[Stop], seed: int = 0) -> DirectionFit:
    """Return the stopping model of these stops, with bounds.

    Raises:
        ValueError: if they are too few, or their lever positions too much alike.
    """
    levels = len({round(stop.valve, 1) for stop in stops})
    if len(stops) < FEWEST_STOPS or levels < FEWEST_LEVELS:
        raise ValueError(f"{len(stops)} stops from {levels} lever positions")
    problem = _Problem(stops, 0.0)
    p, cost = _best(problem, _starts(stops))
    valves = _valves(stops, p[3:], np.zeros(len(stops)))
    if valves is not None and any(len(stop.cuts) > 1 for stop in stops):
        problem = _Problem(stops, valves[1].value)
        p, cost = problem.solve(p)
    free = problem.rows - len(p) - len(stops)
    noise = math.sqrt(cost / max(free, 1))
    step = _quantisation(stops)
    sd, inflation = _deviations(problem, p, noise, step, seed)
    bounds = [_bounds(problem, p, k, sd[k], cost + (K * noise * inflation) ** 2) for k in range(3)]
    valves = _valves(stops, p[3:], sd[3:-1])
    total = float(np.square(problem.centred(problem.x)).sum())
    deceleration = _inverse(p[SLOW])
    both, spread = float(p[DEAD] + p[LAG]), K * float(sd[-1])
    return DirectionFit(
        Estimate(
            both,
            max(both - spread, float(bounds[DEAD][0] + bounds[LAG][0])),
            min(both + spread, float(bounds[DEAD][1] + bounds[LAG][1])),
        ),
        Estimate(float(p[DEAD]), *bounds[DEAD]),
        Estimate(float(p[LAG]), *bounds[LAG]),
        Estimate(deceleration, _inverse(bounds[SLOW][1]), _inverse(bounds[SLOW][0])),
        None if valves is None else valves[0],
        None if valves is None else valves[1],
        p[3:].copy(),
        np.array([stop.travel for stop in stops]),
        np.array([stop_travel(v, p[DEAD], p[LAG], deceleration) for v in p[3:]]),
        noise,
        1.0 - cost / total if total else 0.0,
        step,
    )


def _inverse(slow: float) -> float:
    return 1.0 / slow if slow > NO_LIMIT * 10.0 else math.inf


def _starts(stops: Sequence[Stop]) -> list[Floats]:
    """Return where to begin: the ways made over the speeds give dead time and lag together, and the deceleration."""
    v = np.array([stop.speed for stop in stops])
    way_made = np.array([stop.travel for stop in stops])
    (time, slow), *_ = np.linalg.lstsq(np.column_stack([v, 0.5 * v * v]), way_made, rcond=None)
    time = max(float(time), 0.02, 0.2 * float(np.median(way_made / v)))
    slow = float(np.clip(slow, 0.05, 2.0 * np.max(way_made / v) / np.max(v)))
    total, free = time + 0.5 * slow * float(np.max(v)), 0.1 * time / float(np.max(v))
    return [
        *(np.array([share * time, (1.0 - share) * time, slow, *v]) for share in (0.5, 0.85)),
        *(np.array([share * total, (1.0 - share) * total, free, *v]) for share in (0.4, 0.7)),
    ]


def _best(problem: _Problem, starts: Sequence[Floats]) -> tuple[Floats, float]:
    """Return the parameters of least squares and their cost; the cost has more than one valley."""
    rough = sorted((problem.solve(start, steps=12) for start in starts), key=lambda found: found[1])
    found = [problem.solve(p) for p, _ in rough]
    p, _ = min(found, key=lambda one: one[1])
    # where the deceleration binds nowhere, the cost is level in it: begin again from where it does
    binds = p[LAG] / float(np.max(p[3:]))
    found += [problem.solve(np.array([p[DEAD], p[LAG], times * binds, *p[3:]])) for times in (1.5, 3.0)]
    return min(found, key=lambda one: one[1])


def _quantisation(stops: Sequence[Stop]) -> float:
    """Return the step all positions are multiples of, 0 if none shows."""
    changes = np.abs(np.concatenate([np.diff(stop.x) for stop in stops]))
    moved = changes[changes > 1e-9]
    if not len(moved):
        return 0.0
    step = float(moved.min())
    off = np.abs(moved / step - np.round(moved / step))
    several = float((moved < 1.5 * step).mean())
    return step if float(np.quantile(off, 0.99)) < 0.02 and several > 0.02 else 0.0


def _deviations(problem: _Problem, p: Floats, noise: float, step: float, seed: int) -> tuple[Floats, float]:
    """Return standard deviations, and how many times those of independent noise they are.

    There are 3 + stops of them, as the parameters, and one of dead time and lag together. They are the larger of two:
    a bootstrap of noise and quantisation, linearised at the fit; and the covariance clustered by stops, which also
    sees what the model cannot follow.
    """
    J = problem.jacobian(p)
    scale = np.linalg.norm(J, axis=0)
    scale[scale == 0.0] = np.inf
    inverse = np.linalg.pinv(J / scale, rcond=1e-9) / scale[:, None]
    inverse = np.vstack([inverse, inverse[DEAD] + inverse[LAG]])
    rng, draws = np.random.default_rng(seed), []
    white = math.sqrt(max(noise * noise - step * step / 12.0, (0.02 * noise) ** 2))
    ways, stops = problem.ways(p), len(problem.stops)
    for _ in range(_DRAWS):
        error = white * rng.standard_normal(problem.rows)
        if step:
            phase = np.repeat(rng.uniform(0.0, step, stops), problem.sizes)
            error = np.round((ways + phase + error) / step) * step - ways - phase
        draws.append(inverse @ error)
    drawn = np.sqrt(np.square(draws).mean(axis=0))
    left = problem.residuals(p)
    pieces = [
        inverse[:, begin:end] @ left[begin:end]
        for begin, end in zip(problem.ends[:-1], problem.ends[1:], strict=True)
    ]
    clustered = np.sqrt(np.square(pieces).sum(axis=0) * stops / max(stops - 2.0, 1.0))
    clustered[3:-1] = 0.0  # a speed belongs to one stop
    sd = np.maximum(drawn, clustered)
    alone = noise * np.linalg.norm(inverse[:3], axis=1)
    inflation = float(np.max(sd[:3][alone > 0.0] / alone[alone > 0.0], initial=1.0))
    return sd, min(inflation, 10.0)


def _bounds(problem: _Problem, p: Floats, k: int, sd: float, most: float) -> tuple[float, float]:
    """Return the bounds of parameter k: linear where that is good enough, else where the cost has grown enough."""
    value = float(p[k])
    low = value - K * sd
    # a limit on deceleration that hardly binds says as much as none
    acts = low * float(p[3:].max()) > 1.3 * p[LAG] if k == SLOW else True
    if 0.0 < sd < NEARLY_LINEAR * value and acts:
        return low, value + K * sd
    return _edge(problem, p, k, -1, most, sd), _edge(problem, p, k, 1, most, sd)


def _edge(problem: _Problem, p: Floats, k: int, sign: int, most: float, sd: float) -> float:
    """Return how far parameter k may go, the others refitted, until the cost exceeds `most`."""
    value, inside, warm = float(p[k]), float(p[k]), p
    scale = 0.01 if k != SLOW else 0.02
    reach = max(min(K * sd, 5.0 * scale), 0.3 * value, scale)
    outside = None
    for _ in range(6):
        tried = max(value + sign * reach, 0.0)
        found, cost = problem.solve(warm, (k, tried), 12)
        if cost > most:
            outside = tried
            break
        inside, warm = tried, found
        if tried == 0.0:
            return 0.0
        reach *= 2.0
    if outside is None:
        return inside if sign < 0 else math.inf
    for _ in range(12):
        if abs(outside - inside) < 0.03 * abs(outside - value) + 1e-5:
            break
        middle = 0.5 * (inside + outside)
        found, cost = problem.solve(warm, (k, middle), 12)
        if cost > most:
            outside = middle
        else:
            inside, warm = middle, found
    return outside


def _valves(stops: Sequence[Stop], speeds: Floats, sd: Floats) -> tuple[Estimate, Estimate] | None:
    """Return full speed and dead band from the line of speeds over valves, or None with too few lever positions."""
    u = np.array([stop.valve for stop in stops])
    if len(np.unique(np.round(u, 2))) < FEWEST_LEVELS:
        return None
    A = np.column_stack([u, np.ones_like(u)])
    (slope, offset), *_ = np.linalg.lstsq(A, speeds, rcond=None)
    if slope <= 0.0:
        return None
    left = speeds - A @ (slope, offset)
    scatter = float(left @ left) / max(len(u) - 2, 1)
    variance = np.maximum(np.square(sd), scatter)
    P = np.linalg.pinv(A)
    covariance = (P * variance) @ P.T
    full, band = slope + offset, -offset / slope
    by_full, by_band = np.array([1.0, 1.0]), np.array([-band, -1.0]) / slope
    full_sd, band_sd = (math.sqrt(max(float(g @ covariance @ g), 0.0)) for g in (by_full, by_band))
    few = 1.0 + 2.0 / max(len(u) - 2, 1)  # a scatter known from few stops
    return (
        Estimate(float(full), float(full - K * few * full_sd), float(full + K * few * full_sd)),
        Estimate(max(float(band), 0.0), max(float(band - K * few * band_sd), 0.0), float(band + K * few * band_sd)),
    )
