"""Joints over time: a path of the joints and how fast it is driven."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from workgauge.motion.paths.joint_curve import JointCurve
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
        """Return q (n,), qdot (n,) and the path variable at a time [s], held to the duration.

        Raises:
            InputError: if it is no number.
        """
        if math.isnan(t):
            raise InputError("not a time", element="t", value=t, allowed="seconds")
        t = min(max(t, 0.0), self.duration_s)
        i = min(max(int(self.times.searchsorted(t, side="right")) - 1, 0), len(self.times) - 2)
        (begin, end), (s_0, s_1) = self.times[i : i + 2].tolist(), self.s[i : i + 2].tolist()
        before, after = self.rate[i : i + 2].tolist()
        since, step = t - begin, end - begin
        s = min(s_0 + since * (before + 0.5 * (after - before) / step * since), s_1)
        share = since / step
        q, slope = self.curve.at_one(s, 0.5 * (s_0 + s_1))
        return q, slope * ((1.0 - share) * before + share * after), s

    def each(self, t: Floats, t_speed: Floats) -> tuple[Floats, Floats]:
        """Return the joints (n,), each at its own time t (n,) [s], and their speeds (n,) at t_speed (n,).

        Raises:
            InputError: if a time is no number.
        """
        n = len(t)
        s, rate, _, interval = self._moving(np.concatenate([t, t_speed]))
        joint = np.arange(n)
        q, slope = self.curve.at_joints(s, self._pieces(interval), np.concatenate([joint, joint]))
        return q[:n], slope[n:] * rate[n:]

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
        time = np.minimum(np.maximum(time, 0.0), self.times[-1])
        i = np.minimum(np.maximum(self.times.searchsorted(time, side="right") - 1, 0), len(self.times) - 2)
        begin, before, after = self.times[i], self.rate[i], self.rate[i + 1]
        since, step = time - begin, self.times[i + 1] - begin
        pull = (after - before) / step
        s = np.minimum(self.s[i] + since * (before + 0.5 * pull * since), self.s[i + 1])
        share = since / step
        return s, (1.0 - share) * before + share * after, pull, np.asarray(i, dtype=np.int64)

    def _pieces(self, interval: Ints) -> Ints:
        """Return the curve's pieces (k,) that the intervals (k,) lie on."""
        return self.curve.piece(0.5 * (self.s[interval] + self.s[interval + 1]))
