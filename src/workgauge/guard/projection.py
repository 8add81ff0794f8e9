"""The exact projection onto a polyhedron, hard to lead astray."""

from typing import Any

import numpy as np

from workgauge.values.arrays import Floats
from workgauge.values.compiled import njit

#: A constraint whose part outside the span of the active ones is shorter than this adds nothing to them.
DEPENDENT = 1e-13
#: An active constraint whose multiplier falls by less than this per step does not fall.
STEADY = 1e-12
#: Constraints added or dropped at most; generic programmes of ten unknowns need some twenty.
STEPS = 400


@njit(cache=True)
def project(target: Floats, normals: Floats, offsets: Floats, tolerance: Floats) -> tuple[Floats, Floats, bool]:
    """Return the point nearest to `target` (n,) with `normals @ point >= offsets - tolerance`; normals (m, n).

    The dual active-set method of Goldfarb and Idnani (1983) with unit Hessian, on an orthonormal basis of the active
    normals. A method that factorises their Gram matrix squares the sine of the angle between a constraint and the
    active ones, takes it for dependent on them below some 1e-5 rad and may then find a programme infeasible that is
    not. Here that happens below 1e-13, and a constraint that then contradicts the active ones is passed over: it does
    so by rounding alone if the polyhedron is known not to be empty. Normals are best of unit length, and tolerances
    above 1e-13 lest rounding be corrected for ever.

    Returns:
        the point (n,), the multipliers (m,), none below 0, with `point = target + multipliers @ normals`, and whether
        it ended before the steps ran out.
    """
    m, n = normals.shape
    point = target.copy()
    passed = np.zeros(m, dtype=np.bool_)
    active = np.zeros(n + 1, dtype=np.int64)
    held = np.zeros(n + 1)
    basis = np.zeros((n, n))
    upper = np.zeros((n, n))
    inside = np.zeros(n)
    change = np.zeros(n)
    along = np.zeros(n)
    count = 0
    left = STEPS
    while left > 0:
        entering = _most_broken(point, normals, offsets, tolerance, passed)
        if entering < 0:
            break
        weight = 0.0
        while left > 0:
            left -= 1
            _split(normals[entering], basis, upper, count, along, inside, change)
            leaving, until_drop = -1, np.inf
            for i in range(count):
                if change[i] > STEADY and held[i] / change[i] < until_drop:
                    leaving, until_drop = i, held[i] / change[i]
            length, missing = 0.0, offsets[entering]
            for j in range(n):
                length += along[j] * along[j]
                missing -= normals[entering, j] * point[j]
            until_met = missing / length if count < n and length > DEPENDENT * DEPENDENT else np.inf
            step = min(until_drop, until_met)
            if step == np.inf:
                passed[entering] = True
                break
            if until_met < np.inf:
                for j in range(n):
                    point[j] += step * along[j]
            for i in range(count):
                held[i] = max(held[i] - step * change[i], 0.0)
            weight += step
            if until_met <= until_drop:
                active[count], held[count] = entering, weight
                for i in range(count):
                    upper[i, count] = inside[i]
                upper[count, count] = np.sqrt(length)
                for j in range(n):
                    basis[j, count] = along[j] / upper[count, count]
                count += 1
                _meet(point, target, basis, upper, offsets, active, count, inside)
                break
            for i in range(leaving, count - 1):
                active[i], held[i] = active[i + 1], held[i + 1]
            count -= 1
            for i in range(leaving, count):
                _split(normals[active[i]], basis, upper, i, along, inside, change)
                length = np.sqrt(np.sum(along * along))
                upper[:i, i] = inside[:i]
                upper[i, i] = length
                basis[:, i] = along / length
    multipliers = np.zeros(m)
    for i in range(count):
        multipliers[active[i]] = held[i]
    return point, multipliers, left > 0


@njit(cache=True)
def _meet(
    point: Any, target: Any, basis: Any, upper: Any, offsets: Any, active: Any, count: int, inside: Any
) -> None:
    """Set `point` to the projection of `target` where the active constraints are met, free of what steps accumulated.

    The steps alone lose as many digits as the multipliers are long, and between nearly opposed constraints they are.
    """
    n = len(point)
    point[:] = target
    for i in range(count):
        inside[i] = offsets[active[i]]
        for j in range(i):
            inside[i] -= upper[j, i] * inside[j]
        inside[i] /= upper[i, i]
    for _ in range(2):
        for i in range(count):
            part = -inside[i]
            for j in range(n):
                part += basis[j, i] * point[j]
            for j in range(n):
                point[j] -= part * basis[j, i]


@njit(cache=True)
def _most_broken(point: Any, normals: Any, offsets: Any, tolerance: Any, passed: Any) -> int:
    """Return the constraint broken most, beyond its tolerance and not passed over, or -1."""
    worst, which = 0.0, -1
    for i in range(len(offsets)):
        lacks = -offsets[i]
        for j in range(len(point)):
            lacks += normals[i, j] * point[j]
        if lacks < worst and lacks < -tolerance[i] and not passed[i]:
            worst, which = lacks, i
    return which


@njit(cache=True)
def _split(normal: Any, basis: Any, upper: Any, count: int, along: Any, inside: Any, change: Any) -> None:
    """Split `normal` into `along`, outside the span of the first `count` of the basis, and its coordinates inside.

    `inside` by the basis, `change` by the active normals themselves (`active normals = basis @ upper`). Twice
    Gram-Schmidt is as good as a reflection (Kahan).
    """
    n = len(normal)
    along[:] = normal
    inside[:] = 0.0
    for _ in range(2):
        for i in range(count):
            part = 0.0
            for j in range(n):
                part += basis[j, i] * along[j]
            inside[i] += part
            for j in range(n):
                along[j] -= part * basis[j, i]
    for i in range(count - 1, -1, -1):
        left = inside[i]
        for j in range(i + 1, count):
            left -= upper[i, j] * change[j]
        change[i] = left / upper[i, i]
