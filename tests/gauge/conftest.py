"""Alignments and sites made of numbers, and an oracle of the swept envelope that shares no code with the product."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from workgauge.site.alignment import Alignment
from workgauge.site.cant import CantPoint, CantTable
from workgauge.site.model import LineFeature, PointFeature, SiteModel, SurfaceModel
from workgauge.site.plan import PlanElement, PlanGeometry
from workgauge.site.profile import VerticalCurve, VerticalPoint, build_profile
from workgauge.site.transitions import Law
from workgauge.values.arrays import frozen, frozen_ints
from workgauge.values.limits import Source

ORIGIN = (25_487_000.0, 6_714_000.0)
REAL = Path(__file__).parents[2].parent / "shared" / "data" / "landxml"
SHIPPED = Path(__file__).parents[2] / "src" / "workgauge" / "shipped"


def alignment_of(
    elements: Sequence[tuple[Any, ...]],
    *,
    name: str = "Track 1",
    cant: Sequence[tuple[float, float]] = (),
    gauge: float | None = 1.435,
    pivot: str | None = "center",
    profile: Sequence[tuple[float, ...]] = ((0.0, 80.0), (1e4, 80.0)),
    yaw: float = 0.4,
    line: int = 1,
    codes: dict[str, str] | None = None,
) -> Alignment:
    """Return an alignment of (length, k0, k1[, law]) elements; cant is (distance, signed cant) points."""
    items, at = [], (0.0, 0.0)
    for length, k0, k1, *law in elements:
        kind = "line" if k0 == k1 == 0 else "curve" if k0 == k1 else "spiral"
        chosen = Law.CONSTANT if k0 == k1 else (law[0] if law else Law.CLOTHOID)
        item = PlanElement(kind, chosen, at, yaw, length, k0, k1)
        items.append(item)
        at, yaw = item.end(), item.end_yaw()
    heights = [VerticalPoint(d, h, *((VerticalCurve.CIRCLE, r[0]) if r else ())) for d, h, *r in profile]
    table = CantTable([CantPoint(d, c) for d, c in cant], gauge, pivot) if cant else None
    return Alignment(
        name=name,
        source=Source("made.xml", name, line),
        plan=PlanGeometry(ORIGIN, items),
        profile=build_profile(heights) if heights else None,
        cant=table,
        codes=codes,
    )


def site_of(*features: Any) -> SiteModel:
    """Return a site of alignments, points, lines and surfaces."""

    def of(kind: type) -> tuple[Any, ...]:
        return tuple(f for f in features if isinstance(f, kind))

    return SiteModel(
        None,
        {},
        {},
        alignments=of(Alignment),
        points=of(PointFeature),
        lines=of(LineFeature),
        surfaces=of(SurfaceModel),
        files=("made.xml",),
    )


def point_of(name: str, e: float, n: float, z: float, code: str | None = None, **more: Any) -> PointFeature:
    """Return a point feature near the origin."""
    position = frozen([ORIGIN[0] + e, ORIGIN[1] + n, z])
    return PointFeature(name, code, more.pop("desc", None), position, (), Source("made.xml", name, 7), **more)


def line_of(name: str, points: Any, code: str | None = None, kind: str = "plan_feature", **more: Any) -> LineFeature:
    """Return a line feature near the origin."""
    absolute = np.asarray(points, dtype=float) + np.array([*ORIGIN, 0.0])
    diameter = more.pop("diameter", None)
    return LineFeature(name, code, None, kind, frozen(absolute), diameter, {}, Source("made.xml", name, 9))


def surface_of(name: str, vertices: Any, faces: Any) -> SurfaceModel:
    """Return a surface near the origin."""
    absolute = np.asarray(vertices, dtype=float) + np.array([*ORIGIN, 0.0])
    return SurfaceModel(name, None, None, frozen(absolute), frozen_ints(faces), 0.0, {}, Source("made.xml", name, 11))


class Oracle:
    """The exact envelope straight from the page of formulas, one place at a time and slow on purpose."""

    def __init__(self, rows: Sequence[tuple[float, float]], margin: float = 0.0, **given: Any) -> None:
        self.rows = rows
        self.margin = margin
        self.widening: Callable[[float], tuple[float, float]] | None = given.get("widening")
        self.early: bool = given.get("early", True)
        self.lean: tuple[float, float, float] | None = given.get("lean")
        self.base: float = given.get("base", 1.5)
        self.pivot: str = given.get("pivot", "centre")

    def section(self, alignment: Alignment, d: float) -> list[tuple[float, float]]:
        """Return the turned section's corners (left, up), left side up and right side down."""
        state = alignment.at(d)
        curvature, cant = float(state.curvature[0]), float(state.cant[0])
        sides = []
        for sign in (1.0, -1.0):
            s = self._widening(alignment, d, sign)
            for_cant = abs(cant) if sign * cant > 0 else 0.0
            deficiency = 0.0
            if self.lean is not None and sign * curvature < 0:
                deficiency = self.lean[1] * min(abs(curvature) * self.lean[2], 1.0)
            worst = max(for_cant, deficiency)
            side = []
            for b, h in self.rows:
                qs = 0.0 if self.lean is None else self.lean[0] / 1.5 * max(worst - 0.05, 0) * max(h - 0.5, 0)
                side.append((sign * (b + s + qs + self.margin), h))
            sides.append(side)
        return [self._turned(y, h, cant) for y, h in sides[0] + sides[1][::-1]]

    def points(self, alignment: Alignment, d: float, per_edge: int = 3) -> np.ndarray:
        """Return points (k, 3) on the envelope's boundary at one place, absolute."""
        corners = np.array(self.section(alignment, d))
        following = np.roll(corners, -1, axis=0)
        ring = np.concatenate([corners + (following - corners) * i / per_edge for i in range(per_edge)])
        state = alignment.at(d)
        e, n, z, heading = (float(x[0]) for x in (state.e, state.n, state.z, state.heading))
        left = np.array([-math.cos(heading), math.sin(heading)])
        return np.column_stack([np.array([e, n]) + ring[:, :1] * left, z + ring[:, 1]])

    def _turned(self, y: float, h: float, cant: float) -> tuple[float, float]:
        sign = -1.0 if cant < 0 else 1.0
        phi = math.asin(abs(cant) / self.base)
        y0 = {"centre": 0.0, "low_rail": self.base / 2}[self.pivot]
        inside = sign * y
        turned = y0 + (inside - y0) * math.cos(phi) + h * math.sin(phi)
        return sign * turned, -(inside - y0) * math.sin(phi) + h * math.cos(phi)

    def _widening(self, alignment: Alignment, d: float, sign: float) -> float:
        if self.widening is None:
            return 0.0
        offsets = np.linspace(-26.0, 26.0, 209) if self.early else np.zeros(1)
        offsets = offsets[(d + offsets >= 0) & (d + offsets <= alignment.length)]
        curvature = sign * np.asarray(alignment.at(d + offsets).curvature)
        best = 0.0
        for offset, k in zip(offsets.tolist(), curvature.tolist(), strict=True):
            inside, outside = self.widening(abs(k))
            share = min(1.0, max(0.0, (26.0 - abs(offset)) / 20.0))
            if k > 0 and abs(offset) <= 20.0:
                best = max(best, inside)
            if k < 0:
                best = max(best, outside * share)
        return best


def in_chain(chain: Any, points: Any) -> Any:
    """Whether each point lies in some cell of a chain, by its documented coordinates."""
    found = np.zeros(len(points), dtype=bool)
    for cell in range(len(chain)):
        lateral, span = chain.laterals[cell], chain.ends[cell] - chain.starts[cell]
        forward = np.array([lateral[1], -lateral[0], 0.0])
        gap = points - chain.starts[cell]
        share = gap @ forward / (span @ forward)
        y, z = gap @ lateral, gap[:, 2] - share * span[2]
        here = (share >= 0) & (share <= 1)
        ring = chain.sections[cell]
        for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True):
            here &= (b[0] - a[0]) * (z - a[1]) - (b[1] - a[1]) * (y - a[0]) >= 0
        found |= here
    return found


def uic(k: float) -> tuple[float, float]:
    """Return S_in, S_out at an unsigned curvature, by the page of formulas."""
    if k <= 1 / 250:
        return 3.75 * k, 3.75 * k
    return 50 * k - 0.185, 60 * k - 0.225


@pytest.fixture(scope="session")
def make() -> Any:
    """The makers above, as attributes."""

    class Make:
        alignment = staticmethod(alignment_of)
        site = staticmethod(site_of)
        point = staticmethod(point_of)
        line = staticmethod(line_of)
        surface = staticmethod(surface_of)
        oracle = Oracle
        uic = staticmethod(uic)
        in_chain = staticmethod(in_chain)
        origin = ORIGIN
        real = REAL
        shipped = SHIPPED

    return Make
