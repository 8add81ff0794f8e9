"""A line in plan laid on a surface: every edge crossed, exactly (Makkonen 9 to 14, without samples)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from workgauge.site.surface.tin import Tin
from workgauge.values.arrays import Floats, Ints, frozen, frozen_ints
from workgauge.values.errors import SiteError

#: A corner nearer to a line than this lies on it [m].
ON_LINE_M = 1e-9
#: What lies closer together along a line than this touches [m].
TOUCHING_M = 1e-6
#: A surface that jumps by no more than this goes on [m].
STEP_M = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class LaidPart:
    """One stretch of a line on a surface, without a gap or a step.

    Attributes:
        points: (k, 3) absolute [m]: its ends, the line's own corners, and every edge crossed.
        faces: (k - 1,) the triangle between each two points.
        along: (k,) distance of each point from the line's beginning, in plan [m].
    """

    points: Floats
    faces: Ints
    along: Floats

    @property
    def length_m(self) -> float:
        """On the surface [m]."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())


@dataclass(frozen=True, slots=True, eq=False)
class LaidLine:
    """A line laid on a surface.

    Attributes:
        parts: the stretches where there is one. length_m: of the line in plan.
        gaps: (from, to) along the line in plan where there is none, its ends included [m].
        steps: (distance, by how much) where the surface jumps [m].
    """

    parts: tuple[LaidPart, ...]
    length_m: float
    gaps: tuple[tuple[float, float], ...]
    steps: tuple[tuple[float, float], ...]


def laid(tin: Tin, line: ArrayLike) -> LaidLine:
    """Return a line laid on a surface.

    Args:
        line: (p, 2) absolute east, north [m], corners one after the other; repeated ones count once.

    Raises:
        SiteError: fewer than two places, or what is no number.
    """
    given = np.array(line, dtype=np.float64).reshape(-1, 2)
    if not np.isfinite(given).all():
        raise SiteError("a line's places must be numbers", element="line")
    plan = given[np.concatenate([[True], np.linalg.norm(np.diff(given, axis=0), axis=1) > TOUCHING_M])[: len(given)]]
    if len(plan) < 2:
        raise SiteError("a line needs two places or more", element="line", value=f"{len(plan)} different ones")
    lengths = np.linalg.norm(np.diff(plan, axis=0), axis=1)
    starts = np.concatenate([[0.0], np.cumsum(lengths)])
    pieces: list[Floats] = []
    faces: list[Ints] = []
    for a, b, start in zip(plan[:-1], plan[1:], starts[:-1], strict=True):
        span, face = _on_leg(tin, a - tin.origin[:2], b - tin.origin[:2])
        pieces.append(span + np.array([start, start, 0.0, 0.0]))
        faces.append(face)
    return _joined(tin, plan, starts, np.concatenate(pieces), np.concatenate(faces))


def _joined(tin: Tin, plan: Floats, starts: Floats, pieces: Floats, faces: Ints) -> LaidLine:
    """Return the line of pieces (k, 4): from, to along it, height there and there, one after the other."""
    total = float(starts[-1])
    gaps, steps = [], []
    cuts = [0]
    at = 0.0
    for i, (begin, _, z, _) in enumerate(pieces.tolist()):
        if begin - at > TOUCHING_M:
            gaps.append((at, begin))
            cuts.append(i)
        elif i and abs(z - pieces[i - 1, 3]) > STEP_M:
            steps.append((begin, float(z - pieces[i - 1, 3])))
            cuts.append(i)
        at = float(pieces[i, 1])
    if total - at > TOUCHING_M:
        gaps.append((at, total))
    parts = []
    for first, last in zip(cuts, [*cuts[1:], len(pieces)], strict=True):
        if last > first:
            own = pieces[first:last]
            along = np.append(own[:, 0], own[-1, 1])
            z = np.append(own[:, 2], own[-1, 3])
            en = np.column_stack([np.interp(along, starts, plan[:, k]) for k in (0, 1)])
            points = np.column_stack([en, z + tin.origin[2]])
            parts.append(LaidPart(frozen(points), frozen_ints(faces[first:last]), frozen(along)))
    return LaidLine(tuple(parts), total, tuple(gaps), tuple(steps))


def _on_leg(tin: Tin, a: Floats, b: Floats) -> tuple[Floats, Ints]:
    """Return pieces (k, 4) and their triangles (k,) along the straight line from a to b (2,), less the origin."""
    length = float(np.linalg.norm(b - a))
    near = tin.grid.near_line(a, b)
    spans, face = _crossed(tin, near[tin.level[near]], a, (b - a) / length)
    spans, face = _within(spans, face, length)
    order = np.lexsort((face, spans[:, 0]))
    spans, face = spans[order], face[order]
    if len(spans) > 1 and (spans[1:, 0] < np.maximum.accumulate(spans[:-1, 1]) - ON_LINE_M).any():
        spans, face = _topmost(spans, face)
    return spans, face


def _crossed(tin: Tin, faces: Ints, a: Floats, d: Floats) -> tuple[Floats, Ints]:
    """Return spans (k, 4) and triangles (k,) that the endless line from a (2,) along d (2,), a unit vector, crosses.

    A crossing is worked out from its edge alone, lower corner first, so that both neighbours have the same one.
    """
    corner = tin.faces[faces]
    gap = tin.local[corner][..., :2] - a
    side = gap[..., 1] * d[0] - gap[..., 0] * d[1]
    side = np.where(np.abs(side) <= ON_LINE_M, 0.0, side)
    along, z = gap @ d, tin.local[corner][..., 2]
    t, height = np.full((len(faces), 6), np.nan), np.full((len(faces), 6), np.nan)
    on = side == 0.0
    t[:, :3], height[:, :3] = np.where(on, along, np.nan), np.where(on, z, np.nan)
    rows = np.arange(len(faces))
    for k in range(3):
        i, j = np.full(len(faces), k), np.full(len(faces), (k + 1) % 3)
        swapped = corner[:, k] > corner[:, (k + 1) % 3]
        i, j = np.where(swapped, j, i), np.where(swapped, i, j)
        s_i, s_j = side[rows, i], side[rows, j]
        cut = s_i * s_j < 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(cut, s_i / (s_i - s_j), 0.0)
        t[:, 3 + k] = np.where(cut, along[rows, i] + share * (along[rows, j] - along[rows, i]), np.nan)
        height[:, 3 + k] = np.where(cut, z[rows, i] + share * (z[rows, j] - z[rows, i]), np.nan)
    touched = np.isfinite(t).sum(axis=1) >= 2
    t, height, face = t[touched], height[touched], faces[touched]
    rows = np.arange(len(face))
    first, last = np.nanargmin(t, axis=1) if len(t) else rows, np.nanargmax(t, axis=1) if len(t) else rows
    spans = np.column_stack([t[rows, first], t[rows, last], height[rows, first], height[rows, last]])
    long = spans[:, 1] - spans[:, 0] > ON_LINE_M
    return spans[long], face[long]


def _within(spans: Floats, face: Ints, length: float) -> tuple[Floats, Ints]:
    """Return the spans cut to 0 and the length."""
    inside = (spans[:, 1] > ON_LINE_M) & (spans[:, 0] < length - ON_LINE_M)
    spans, face = spans[inside], face[inside]
    begin, end, z0, z1 = spans.T
    slope = (z1 - z0) / (end - begin)
    low, high = np.maximum(begin, 0.0), np.minimum(end, length)
    cut0 = np.where(begin < 0.0, z0 + slope * (low - begin), z0)
    cut1 = np.where(end > length, z0 + slope * (high - begin), z1)
    return np.column_stack([low, high, cut0, cut1]), face


def _topmost(spans: Floats, face: Ints) -> tuple[Floats, Ints]:
    """Return spans without those below others; of equal ones the triangle of lowest index is left."""
    begin, end, z0, z1 = spans.T
    slope = (z1 - z0) / (end - begin)
    marks = [begin, end]
    for i in range(len(spans)):
        others = np.flatnonzero((begin < end[i] - ON_LINE_M) & (end > begin[i] + ON_LINE_M))
        others = others[others > i]
        turn = slope[i] - slope[others]
        with np.errstate(divide="ignore", invalid="ignore"):
            meet = begin[i] + ((z0[others] - z0[i]) + slope[others] * (begin[i] - begin[others])) / turn
        low, high = np.maximum(begin[i], begin[others]), np.minimum(end[i], end[others])
        marks.append(meet[np.isfinite(meet) & (meet > low) & (meet < high)])
    t = np.unique(np.concatenate(marks))
    t = t[np.concatenate([[True], np.diff(t) > ON_LINE_M])]
    found: list[tuple[float, float, float, float]] = []
    of: list[int] = []
    for low, high in zip(t[:-1].tolist(), t[1:].tolist(), strict=True):
        middle = 0.5 * (low + high)
        there = np.flatnonzero((begin < middle) & (end > middle))
        if not len(there):
            continue
        z = z0[there] + slope[there] * (middle - begin[there])
        best = there[z >= z.max() - ON_LINE_M]
        i = int(best[np.argmin(face[best])])
        at = [float(z0[i] + slope[i] * (place - begin[i])) for place in (low, high)]
        if of and of[-1] == face[i] and found[-1][1] == low:
            found[-1] = (found[-1][0], high, found[-1][2], at[1])
        else:
            found.append((low, high, at[0], at[1]))
            of.append(int(face[i]))
    return np.array(found).reshape(-1, 4), np.array(of, dtype=np.int64)
