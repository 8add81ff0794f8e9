"""Random numbers that belong to one sensor each: nothing another sensor does shifts them."""

import hashlib
import math

import numpy as np
from scipy.signal import lfilter

from workgauge.values.arrays import Floats

#: Numbers drawn at a time.
BLOCK = 256

#: Correlated noise lives on this time grid, whatever the rate at which it is looked at [ns].
GRID_NS = 10_000_000


def generator(seed: int, *names: str) -> np.random.Generator:
    """Return the generator of one purpose of one sensor, a function of the seed and the names alone."""
    digest = hashlib.sha256("\0".join(names).encode()).digest()
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, int.from_bytes(digest[:16], "big")])))


class White:
    """Independent standard normal vectors of one width, one after the other."""

    def __init__(self, source: np.random.Generator, width: int) -> None:
        self._source = source
        self._width = width
        self._rows = np.empty((0, width))
        self._next = 0

    def draw(self) -> Floats:
        """Return the next vector (width,)."""
        if self._next == len(self._rows):
            self._rows = self._source.standard_normal((BLOCK, self._width))
            self._next = 0
        self._next += 1
        row: Floats = self._rows[self._next - 1]
        return row


class GaussMarkov:
    """A stationary first-order Gauss-Markov process of unit variance, three components, autocorrelation exp(-t/tau).

    It is drawn on a grid of 10 ms from `origin_ns` on, so what it is at a time does not depend on who asks how often.

    Args:
        source: where its numbers come from.
        correlation_s: tau; 0 for values independent from one grid time to the next.
        origin_ns: nothing is asked for before it.
    """

    def __init__(self, source: np.random.Generator, correlation_s: float, origin_ns: int) -> None:
        self._source = source
        self._decay = math.exp(-GRID_NS * 1e-9 / correlation_s) if correlation_s > 0.0 else 0.0
        self._origin_ns = origin_ns
        self._first = 0
        self._nodes: Floats = np.empty((0, 3))
        self._last: Floats | None = None

    def at(self, t_ns: int) -> Floats:
        """Return the value (3,) at a time; times must not go back by more than a block (2.56 s).

        Raises:
            ValueError: for a time that has been forgotten, or lies before the origin.
        """
        node = (t_ns - self._origin_ns) // GRID_NS
        while node >= self._first + len(self._nodes):
            self._grow()
        if node < self._first:
            raise ValueError(f"the noise of {t_ns} ns is no longer known")
        value: Floats = self._nodes[node - self._first]
        return value

    def _grow(self) -> None:
        """Append a block to the last one, and forget those before."""
        white = self._source.standard_normal((BLOCK, 3)) * math.sqrt(1.0 - self._decay**2)
        if self._last is None:
            white[0] = self._source.standard_normal(3)
            last = np.zeros(3)
        else:
            last = self._last
        block, _ = lfilter([1.0], [1.0, -self._decay], white, axis=0, zi=(self._decay * last)[None])
        self._first += max(len(self._nodes) - BLOCK, 0)
        self._nodes = np.concatenate([self._nodes[-BLOCK:], block])
        self._last = block[-1]
