"""Joints over time: a path of the joints and how fast it is driven."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from workgauge.motion.joint_curve import JointCurve
from workgauge.values.arrays import Floats, Ints, frozen
from workgauge.values.errors import InputError


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """A motion of the joints that begins and ends at rest. All arrays are read-only.

    Between the times its path variable is accelerated evenly, so that the motion at any time is exact.

    Attributes:
        times: (N,) growing from 0 [s]. s: (N,) path variable then: distance [m], or the waypoints' own measure.
        rate: (N,) ds/dt. q, qdot: (N, n) joints then [rad, m] and their speeds [rad/s, m/s].
        curve: the joints by the path variable.
    """

    times: Floats
    s: Floats
    rate: Floats
    q: Floats
    qdot: Floats
    curve: JointCurve

    @classmethod
    def of(cls, curve: JointCurve, s: Floats, rate: Floats) -> "Trajectory":
        """Return the motion along a curve with rates (N,) at grid values s (N,), evenly accelerated in between."""
        steps = 2.0 * np.diff(s) / (rate[1:] + rate[:-1])
        q, slope, _ = curve.at(s)
        times = np.concatenate([[0.0], np.cumsum(steps)])
        return cls(frozen(times), frozen(s), frozen(rate), frozen(q), frozen(slope * rate[:, None]), curve)

    @property
    def duration_s(self) -> float:
        """From rest to rest [s]."""
        return float(self.times[-1])

    def at(self, t: float) -> tuple[Floats, Floats, float]:
        """Return q (n,), qdot (n,) and the path variable at a time [s], held to the duration."""
        q, qdot, s = self.many([t])
        return q[0], qdot[0], float(s[0])

    def many(self, t: ArrayLike) -> tuple[Floats, Floats, Floats]:
        """Return q (k, n), qdot (k, n) and the path variable (k,) at times t (k,) [s], held to the duration.

        Raises:
            InputError: if a time is no number.
        """
        s, rate, _, interval = self._moving(t)
        q, slope, _ = self.curve.at(s, self._pieces(interval))
        return q, slope * rate[:, None], s

    def accelerations(self, t: ArrayLike) -> Floats:
        """Return the joint accelerations (k, n) [rad/s^2, m/s^2] at times t (k,) [s]."""
        s, rate, pull, interval = self._moving(t)
        _, slope, bend = self.curve.at(s, self._pieces(interval))
        return slope * pull[:, None] + bend * (rate**2)[:, None]

    def time_of(self, s: float) -> float:
        """Return the first time [s] at which the path variable is `s`, held to its range."""
        wanted = float(np.clip(s, self.s[0], self.s[-1]))
        i = int(np.clip(np.searchsorted(self.s, wanted, side="left") - 1, 0, len(self.s) - 2))
        share = (wanted - self.s[i]) / (self.s[i + 1] - self.s[i])
        before, after = self.rate[i] ** 2, self.rate[i + 1] ** 2
        rate = float(np.sqrt(before + share * (after - before)))
        ran = rate + float(self.rate[i])
        return float(self.times[i] + (2.0 * (wanted - self.s[i]) / ran if ran > 0.0 else 0.0))

    def scaled(self, share: float) -> "Trajectory":
        """Return the same way driven at a share of the speed, above 0.

        Raises:
            InputError: if the share is not above 0.
        """
        if not (np.isfinite(share) and share > 0.0):
            raise InputError("not a share of a speed", element="share", value=share, allowed="above 0")
        return Trajectory.of(self.curve, self.s, share * self.rate)

    def plain(self) -> dict[str, Any]:
        """Return it as dicts, lists and numbers: duration [s], and at each time s, ds/dt, joints and their speeds."""
        return {
            "duration_s": self.duration_s,
            "times_s": self.times.tolist(),
            "s": self.s.tolist(),
            "rate": self.rate.tolist(),
            "q": self.q.tolist(),
            "qdot": self.qdot.tolist(),
        }

    def _moving(self, t: ArrayLike) -> tuple[Floats, Floats, Floats, Ints]:
        """Return the path variable, its rate and acceleration (k,) at times (k,), and the intervals (k,)."""
        time = np.asarray(t, dtype=np.float64)
        if np.isnan(time).any():
            raise InputError("not a time", element="t", value=float("nan"), allowed="seconds")
        time = np.clip(time, 0.0, self.times[-1])
        i = np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.times) - 2)
        since, step = time - self.times[i], self.times[i + 1] - self.times[i]
        pull = (self.rate[i + 1] - self.rate[i]) / step
        s = np.minimum(self.s[i] + since * (self.rate[i] + 0.5 * pull * since), self.s[i + 1])
        share = since / step
        return s, (1.0 - share) * self.rate[i] + share * self.rate[i + 1], pull, np.asarray(i, dtype=np.int64)

    def _pieces(self, interval: Ints) -> Ints:
        """Return the curve's pieces (k,) that the intervals (k,) lie on."""
        return self.curve.piece(0.5 * (self.s[interval] + self.s[interval + 1]))
