"""Chatter: how much of the commanded joint acceleration is faster than hands move, beyond their own."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import uniform_filter1d
from scipy.signal import butter, sosfiltfilt, welch

from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import InputError

#: Accelerations faster than this count [Hz].
ABOVE_HZ = 2.0
#: Order of the filter, which runs forwards and backwards and so acts as one of twice this.
ORDER = 4
#: The hands' own energy is taken off within windows of this length [s].
WINDOW_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Chatter:
    """What a series of commands shows above `ABOVE_HZ`; root mean squares over the whole series [rad/s^2, m/s^2].

    Attributes:
        total: of the commanded acceleration of all joints, beyond the levers' own; 1 m/s^2 of a sliding joint counts
            as 1 rad/s^2.
        by_joint: (n,) of each joint's, beyond the same joint's lever's; what a guard makes of one joint because of
            another's lever is in here and not in `total`.
        commanded, levers: (n,) of the commanded acceleration, and of the one the levers asked for.
    """

    total: float
    by_joint: Floats
    commanded: Floats
    levers: Floats

    def as_json(self, names: tuple[str, ...]) -> dict[str, Any]:
        """Return the documented object of the run command."""
        return {
            "total": round(self.total, 6),
            "by_joint": {name: round(float(one), 6) for name, one in zip(names, self.by_joint, strict=True)},
            "above_hz": ABOVE_HZ,
        }


def chatter(commanded: ArrayLike, wanted: ArrayLike, dt_s: float) -> Chatter | None:
    """Return the chatter of a series of commands, or None where its samples cannot show `ABOVE_HZ`.

    With `a = (v[k] - v[k-1]) / dt` the acceleration of commanded (c) and of wanted (w) joint velocities, which begin
    at rest, `h` the part of it above 2 Hz (Butterworth, order 4, forwards and backwards, so without a shift in time;
    half the amplitude passes at 2 Hz itself), and `<.>` the mean over 1 s around a moment,

        chatter^2 = mean over time of max(0, <|h(a_c)|^2> - <|h(a_w)|^2>)

    with `|h|^2` summed over the joints, or of one joint alone. What the hands do quickly is no chatter where and when
    they do it, and cannot make up for chatter at another time. The measure is the energy a guard adds: it does not
    tell why. Everything up to half the tick rate counts, so that a command that alternates from tick to tick counts
    fully; a jump of the velocity has the more energy the shorter the tick, and only series of the same tick are to be
    compared where commands jump.

    Args:
        commanded, wanted: (N, n) joint velocities [rad/s, m/s], one row per tick.
        dt_s: the tick's period [s].

    Raises:
        InputError: for series of different shapes, numbers that are none, or a period that is none.
    """
    c, w = np.array(commanded, dtype=np.float64), np.array(wanted, dtype=np.float64)
    if c.ndim != 2 or c.shape != w.shape:
        raise InputError("two series of joint velocities, ticks by joints", value=c.shape, allowed=str(w.shape))
    if not (np.isfinite(c).all() and np.isfinite(w).all()):
        raise InputError("a joint velocity is not a number", element="chatter")
    if not 0.0 < dt_s < float("inf"):
        raise InputError("time step is none", element="dt_s", value=dt_s, allowed="above 0")
    if not len(c) or dt_s * 2.0 * ABOVE_HZ >= 1.0:
        return None
    fast_c, fast_w = (above(accelerations(one, dt_s), dt_s) for one in (c, w))
    surplus = _local_energy(fast_c, dt_s) - _local_energy(fast_w, dt_s)
    total = float(np.sqrt(np.maximum(surplus.sum(axis=1), 0.0).sum() / len(c)))
    beyond = np.maximum(surplus, 0.0).sum(axis=0) / len(c)
    rms = (np.sqrt((one**2).mean(axis=0)) for one in (fast_c, fast_w))
    return Chatter(total, frozen(np.sqrt(beyond)), *(frozen(one) for one in rms))


def _local_energy(signal: Floats, dt_s: float) -> Floats:
    """Return the mean square within `WINDOW_S` around every sample, and around as many beside it: none is lost."""
    size = max(round(WINDOW_S / dt_s), 1)
    square = np.pad(signal**2, ((size, size), (0, 0)))
    return np.asarray(np.maximum(uniform_filter1d(square, size, axis=0, mode="constant"), 0.0))


def accelerations(velocity: Floats, dt_s: float) -> Floats:
    """Return the accelerations (N, n) of joint velocities (N, n), at rest before the first [rad/s^2, m/s^2]."""
    return np.asarray(np.diff(velocity, axis=0, prepend=0.0) / dt_s)


def above(signal: Floats, dt_s: float) -> Floats:
    """Return the part (N, n) of a signal (N, n) above `ABOVE_HZ`, without a shift in time; nothing lies beside it."""
    sos = butter(ORDER, ABOVE_HZ, "highpass", fs=1.0 / dt_s, output="sos")
    room = np.zeros((round(2.0 / ABOVE_HZ / dt_s) + 1, signal.shape[1]))  # what the filter rings for
    padded = np.concatenate([room, signal, room])
    return np.asarray(sosfiltfilt(sos, padded, axis=0, padlen=0)[len(room) : -len(room)])


def spectrum(velocity: Floats, dt_s: float) -> tuple[Floats, Floats]:
    """Return (frequencies (f,) [Hz], power density (f, n) [(rad/s^2)^2/Hz]) of the acceleration of velocities (N, n).

    One-sided, by Welch's method with windows of 2 s, which tell frequencies 0.5 Hz apart.
    """
    a = accelerations(velocity, dt_s)
    length = min(max(round(2.0 / dt_s), 8), len(a))
    frequencies, density = welch(a, 1.0 / dt_s, nperseg=length, detrend=False, axis=0)
    return np.asarray(frequencies), np.asarray(density)
