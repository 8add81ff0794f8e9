"""Two unknown angles in two equations, each linear in the cosine and sine of both."""

import numpy as np

from workgauge.values.arrays import Floats

_STEPS = 4
_SAMPLES = 8
_REAL = 1e-3
_LEFT_OVER = 1e-11


def crossings(A: Floats, B: Floats, e: Floats, C: Floats, D: Floats, f: Floats) -> tuple[Floats, Floats]:
    """Return all angles x, y (N, 8) with `A . x = B . y + e` and `C . x = D . y + f`, x and y by (cos, sin).

    Each angle is eliminated in turn, which leaves a quartic of the other in the tangent of its half, and both sets of
    roots are brought home by Newton's steps: where one elimination is ill-conditioned the other is not. At most four
    differ; every further slot is NaN.

    Args:
        A, C: (N, 2). B, D: (2,), neither zero. e, f: (N,).
    """
    scale = np.hypot(*A.T) + np.hypot(*B) + np.abs(e) + 1e-300
    A, e, B = A / scale[:, None], e / scale, B / scale[:, None]
    D = np.broadcast_to(D, B.shape)
    x1, y1 = _eliminated(A, B, e, C, D, f)
    y2, x2 = _eliminated(B, A, -e, D, C, -f)
    x, y = np.concatenate([x1, x2], -1), np.concatenate([y1, y2], -1)
    A, B, C, D = (row[:, None] for row in (A, B, C, D))
    for _ in range(_STEPS):
        x, y = _step(A, B, e, C, D, f, x, y)
    first, second = _residuals(A, B, e, C, D, f, x, y)
    good = np.maximum(np.abs(first), np.abs(second)) < _LEFT_OVER
    apart = np.maximum(*(np.abs(np.sin(0.5 * (angle[:, :, None] - angle[:, None]))) for angle in (x, y)))
    double = (np.tril(apart < 1e-9, -1) & good[:, None]).any(-1)
    good &= ~double
    return np.where(good, x, np.nan), np.where(good, y, np.nan)


def _unit(angle: Floats) -> Floats:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _residuals(
    A: Floats, B: Floats, e: Floats, C: Floats, D: Floats, f: Floats, x: Floats, y: Floats
) -> tuple[Floats, Floats]:
    ux, uy = _unit(x), _unit(y)
    return (A * ux).sum(-1) - (B * uy).sum(-1) - e[:, None], (C * ux).sum(-1) - (D * uy).sum(-1) - f[:, None]


def _step(
    A: Floats, B: Floats, e: Floats, C: Floats, D: Floats, f: Floats, x: Floats, y: Floats
) -> tuple[Floats, Floats]:
    first, second = _residuals(A, B, e, C, D, f, x, y)
    dx, dy = _unit(x + 0.5 * np.pi), _unit(y + 0.5 * np.pi)
    a, b, c, d = (A * dx).sum(-1), -(B * dy).sum(-1), (C * dx).sum(-1), -(D * dy).sum(-1)
    det = a * d - b * c
    with np.errstate(all="ignore"):
        step_x, step_y = (d * first - b * second) / det, (a * second - c * first) / det
    sound = np.isfinite(step_x) & np.isfinite(step_y) & (np.hypot(step_x, step_y) < 0.5)
    return np.where(sound, x - step_x, x), np.where(sound, y - step_y, y)


def _eliminated(A: Floats, B: Floats, e: Floats, C: Floats, D: Floats, f: Floats) -> tuple[Floats, Floats]:
    """Return the roots (N, 4) of x with y eliminated, and the y of each; NaN where there is none."""
    det = B[:, 0] * D[:, 1] - B[:, 1] * D[:, 0]
    # y = (first . x + i, second . x + j) / det
    first, i = D[:, 1:] * A - B[:, 1:] * C, -D[:, 1] * e + B[:, 1] * f
    second, j = B[:, :1] * C - D[:, :1] * A, -B[:, 0] * f + D[:, 0] * e
    x = _roots(first, i, second, j, det)
    ux = _unit(x)
    cosine, sine = (first[:, None] * ux).sum(-1) + i[:, None], (second[:, None] * ux).sum(-1) + j[:, None]
    sign = np.where(det < 0.0, -1.0, 1.0)[:, None]
    return x, np.arctan2(sine * sign, cosine * sign)


def _roots(a: Floats, a0: Floats, b: Floats, b0: Floats, r: Floats) -> Floats:
    """Return the real roots (N, 4) of `(a . x + a0)^2 + (b . x + b0)^2 = r^2`, x = (cos, sin) of an angle."""
    size = (a * a + b * b).sum(-1) + a0 * a0 + b0 * b0 + r * r + 1e-300
    c0 = (0.5 * (a * a + b * b).sum(-1) + a0 * a0 + b0 * b0 - r * r) / size
    c1 = 2.0 * (a * a0[:, None] + b * b0[:, None]) / size[:, None]
    c2 = 0.5 * (a[:, 0] ** 2 - a[:, 1] ** 2 + b[:, 0] ** 2 - b[:, 1] ** 2) / size
    s2 = (a[:, 0] * a[:, 1] + b[:, 0] * b[:, 1]) / size
    # The tangent of the half is infinite half a turn away from where it is measured: at no root.
    angles = 2.0 * np.pi * np.arange(_SAMPLES) / _SAMPLES
    values = c0[:, None] + c1 @ _unit(angles).T + np.outer(c2, np.cos(2 * angles)) + np.outer(s2, np.sin(2 * angles))
    start = angles[np.abs(values).argmax(-1)] + np.pi
    (cs, sn), (cs2, sn2) = _unit(start).T, _unit(2 * start).T
    p, q = c1[:, 0] * cs + c1[:, 1] * sn, c1[:, 1] * cs - c1[:, 0] * sn
    u, v = c2 * cs2 + s2 * sn2, s2 * cs2 - c2 * sn2
    lead = c0 - p + u
    some = np.abs(lead) > 1e-14
    quartic = np.stack([2 * q - 4 * v, 2 * c0 - 6 * u, 2 * q + 4 * v, c0 + p + u], axis=-1)
    companion = np.zeros((len(a), 4, 4))
    companion[:, 0] = -quartic / np.where(some, lead, 1.0)[:, None]
    companion[:, [1, 2, 3], [0, 1, 2]] = 1.0
    t = np.linalg.eigvals(companion)
    real = some[:, None] & (np.abs(t.imag) < _REAL * (1.0 + np.abs(t) ** 2))
    return np.where(real, 2.0 * np.arctan(t.real) + start[:, None], np.nan)
