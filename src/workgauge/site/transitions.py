"""Curvature laws of transition curves: curvature, heading and position over the length.

With u = s/L from curvature k0 to k1 (D = k1 - k0) every law but the cubic parabola is k(u) = k0 + D f(u): clothoid,
Bloss, cosine, sine and biquadratic parabola (Helmert, Schramm). The heading is then analytic,
psi(s) = psi0 + k0 s + D L F(u) with F the integral of f, and only the position needs quadrature. The cubic parabola
is y = x^3/(6 R L) in its own axes, which start in its straight end.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from workgauge.values.arrays import Floats


class Law(IntEnum):
    """How the curvature runs over an element."""

    CONSTANT = 0  #: lines and arcs
    CLOTHOID = 1
    BLOSS = 2
    COSINE = 3
    SINE = 4
    BIQUADRATIC = 5
    CUBIC_PARABOLA = 6


def _biquadratic(u: Floats) -> Floats:
    return np.where(u <= 0.5, 2 * u**2, 1 - 2 * (1 - u) ** 2)


def _biquadratic_integral(u: Floats) -> Floats:
    return np.where(u <= 0.5, 2 * u**3 / 3, u - 0.5 + 2 * (1 - u) ** 3 / 3)


#: f(u) and its integral F(u) from 0, for u in [0, 1].
_SHAPES: dict[Law, tuple[Callable[[Floats], Floats], Callable[[Floats], Floats]]] = {
    Law.CLOTHOID: (lambda u: u, lambda u: u**2 / 2),
    Law.BLOSS: (lambda u: u**2 * (3 - 2 * u), lambda u: u**3 - u**4 / 2),
    Law.COSINE: (lambda u: (1 - np.cos(np.pi * u)) / 2, lambda u: u / 2 - np.sin(np.pi * u) / (2 * np.pi)),
    Law.SINE: (
        lambda u: u - np.sin(2 * np.pi * u) / (2 * np.pi),
        lambda u: u**2 / 2 + (np.cos(2 * np.pi * u) - 1) / (4 * np.pi**2),
    ),
    Law.BIQUADRATIC: (_biquadratic, _biquadratic_integral),
}

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)
_NODES = (_NODES + 1) / 2
_WEIGHTS = _WEIGHTS / 2


def shape(law: Law, u: Floats) -> Floats:
    """Return f(u), the share of the change that is done at u in [0, 1].

    Used for curvature and for cant alike; a cant ramp over a cubic parabola or of no named law is linear.
    """
    if law in (Law.CONSTANT, Law.CUBIC_PARABOLA):
        return u
    return _SHAPES[law][0](u)


@dataclass(frozen=True, slots=True)
class Course:
    """Along an element in its own axes (start at 0, first tangent along x), arrays of one shape.

    Attributes:
        x, y: position [m], y to the left. turn: heading change since the start, positive left [rad].
        curvature: positive left [1/m].
    """

    x: Floats
    y: Floats
    turn: Floats
    curvature: Floats


def constant_course(s: Floats, k0: Floats) -> Course:
    """Return the course of lines and arcs of curvature `k0` at arc lengths `s` (equal shapes)."""
    half = k0 * s / 2
    chord = s * np.sinc(half / np.pi)
    return Course(chord * np.cos(half), chord * np.sin(half), 2 * half, k0)


def transition_course(law: Law, s: Floats, length: Floats, k0: Floats, k1: Floats) -> Course:
    """Return the course of transitions of one law at arc lengths `s` (all arrays of equal shape).

    Position by Gauss-Legendre quadrature of the analytic heading in two panels that meet at half length, where the
    biquadratic parabola changes its branch; better than 1e-9 m for turns up to about 3 rad.
    """
    if law is Law.CUBIC_PARABOLA:
        return _cubic_course(s, length, k0, k1)
    f, F = _SHAPES[law]
    change = (k1 - k0) * length

    def turn(t: Floats, tail: tuple[None, ...] = ()) -> Floats:
        u = np.clip(t / length[(..., *tail)], 0.0, 1.0)
        return k0[(..., *tail)] * t + change[(..., *tail)] * F(u)

    middle = np.minimum(s, length / 2)
    x = np.zeros_like(s)
    y = np.zeros_like(s)
    for begin, end in ((np.zeros_like(s), middle), (middle, s)):
        span = end - begin
        angle = turn(begin[..., None] + span[..., None] * _NODES, (None,))
        x += span * (np.cos(angle) @ _WEIGHTS)
        y += span * (np.sin(angle) @ _WEIGHTS)
    u = np.clip(s / length, 0.0, 1.0)
    return Course(x, y, turn(s), k0 + (k1 - k0) * f(u))


def _cubic_arc(x: Floats, c: Floats) -> Floats:
    """Return the arc length of y = c x^3/6 from 0 to x, signed like x."""
    slope = c[..., None] / 2 * (x[..., None] * _NODES) ** 2
    return x * (np.hypot(1.0, slope) @ _WEIGHTS)


def _cubic_abscissa(arc: Floats, c: Floats) -> Floats:
    """Return x with `_cubic_arc(x) == arc`, by Newton's method; the arc length grows with |x| and is convex there."""
    x = arc.copy()
    for _ in range(30):
        step = (_cubic_arc(x, c) - arc) / np.hypot(1.0, c / 2 * x**2)
        x -= step
        if np.max(np.abs(step), initial=0.0) < 1e-13 * (1 + np.max(np.abs(x), initial=0.0)):
            break
    return x


def _cubic_course(s: Floats, length: Floats, k0: Floats, k1: Floats) -> Course:
    """Return the course of y = c x^3/6 with c = (k1 - k0)/L, starting at the x where its second derivative is k0.

    With a straight start that is x = 0; with a straight end the curve ends at x = 0 instead, so that the axes always
    lie in the straight end.
    """
    c = (k1 - k0) / length
    first = np.where(k1 == 0.0, -_cubic_abscissa(length, c), k0 / np.where(c == 0.0, 1.0, c))
    x = _cubic_abscissa(_cubic_arc(first, c) + s, c)
    turn0 = np.arctan(c / 2 * first**2)
    slope = c / 2 * x**2
    dx, dy = x - first, c / 6 * (x**3 - first**3)
    cos0, sin0 = np.cos(turn0), np.sin(turn0)
    return Course(
        dx * cos0 + dy * sin0,
        dy * cos0 - dx * sin0,
        np.arctan(slope) - turn0,
        c * x / np.hypot(1.0, slope) ** 3,
    )
