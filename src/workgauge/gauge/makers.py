"""From one line or point feature to its solid: at its height, or at every height where none is known."""

import math
from dataclasses import dataclass

import numpy as np

from workgauge.gauge.chain import LEAST_PAD
from workgauge.gauge.curtains import FilledPoints, filled_points, line_curtain
from workgauge.gauge.heights import ORIGINS, Origin, SiteHeights
from workgauge.gauge.madeup import MadeUpHeights
from workgauge.gauge.rules import BoxBlock, CylinderBlock, Rule, RuleBook, TubeBlock, WireBlock
from workgauge.gauge.solids import cylinder, tube, upright_box, wire_chain
from workgauge.gauge.tracks import clearances
from workgauge.site.model import LineFeature, PointFeature
from workgauge.values.arrays import Floats
from workgauge.values.errors import RuleError
from workgauge.values.solids import Solid

_NO_KEY = ", the rule having no height_above_ground_m"


@dataclass(frozen=True, slots=True, eq=False)
class SolidMaker:
    """Makes solids in a local frame and takes note of made-up heights.

    Attributes:
        book: the rule book. heights: of the site. notes: what was made up.
        origin: (3,) absolute, of the local frame [m].
    """

    book: RuleBook
    heights: SiteHeights
    origin: Floats
    notes: MadeUpHeights

    def wire(self, line: LineFeature, block: WireBlock) -> Solid:
        """Return the no-go region round a wire; guarded at every height if its own is not known."""
        below, side = clearances(block.voltage, block.below_m, block.side_m, self.book)
        filled = filled_points(line.points, self.heights)
        if filled.missing and self._unsettled(filled, line, block.height_above_ground_m):
            return line_curtain(filled.points, side, self.heights, self.origin)
        axis = self._raised(filled, block.height_above_ground_m)
        self._note("overhead line", line, filled, axis)
        return wire_chain(axis - self.origin, below, side, block.above_m)

    def pipe(self, line: LineFeature, rule: Rule, block: TubeBlock) -> Solid:
        """Return the tube round a line; from the ground down if its depth is not known. Raises RuleError."""
        radius = _tube_radius(line, rule, block) + LEAST_PAD
        filled = filled_points(line.points, self.heights)
        if np.isnan(filled.points[:, 2]).any():
            self.notes.see("line", line, Origin.UNKNOWN, ())
            return line_curtain(filled.points, radius, self.heights, self.origin)
        axis = self._raised(filled, block.height_above_ground_m)
        grounded = bool(np.any(filled.origins != ORIGINS.index(Origin.OWN)))
        if not grounded or block.height_above_ground_m is not None:
            self._note("line", line, filled, axis)
            return tube(axis - self.origin, radius)
        self._note(
            "line", line, filled, axis, " and guarded from there down, the rule having no height_above_ground_m"
        )
        return wire_chain(axis - self.origin, float(axis[:, 2].max()) - self.heights.low, radius, radius)

    def post(self, point: PointFeature, block: CylinderBlock | BoxBlock) -> Solid:
        """Return the solid at a point; a column through every height if its own is not known."""
        foot, height = np.array(point.position), block.height_m
        base = foot[2] + block.base_offset_m
        if math.isnan(foot[2]):
            z, origin = self.heights.of_point(point)
            self.notes.see("point", point, origin, [] if origin is Origin.UNKNOWN else [z])
            base = z + block.base_offset_m
            if origin is Origin.UNKNOWN:
                base, height = self.heights.low, self.heights.high - self.heights.low
        foot = np.array([foot[0], foot[1], base]) - self.origin
        if isinstance(block, CylinderBlock):
            return cylinder(foot, block.radius_m, height)
        centre = foot + np.array([0.0, 0.0, height / 2])
        size = (block.length_m + 2 * LEAST_PAD, block.width_m + 2 * LEAST_PAD, height + 2 * LEAST_PAD)
        return upright_box(centre, *size, math.radians(block.heading_deg))

    def _unsettled(self, filled: FilledPoints, line: LineFeature, above_ground: float | None) -> bool:
        """Return whether nothing says how high a wire hangs, and take note of it."""
        if np.isnan(filled.points[:, 2]).any():
            self.notes.see("overhead line", line, Origin.UNKNOWN, ())
            return True
        grounded = bool(np.any(filled.origins != ORIGINS.index(Origin.OWN)))
        if grounded and above_ground is None:
            self.notes.see("overhead line", line, Origin.UNKNOWN, (), _NO_KEY)
            return True
        return False

    def _raised(self, filled: FilledPoints, above_ground: float | None) -> Floats:
        """Return the absolute points (n, 3), those at ground height put where the line runs above or below it."""
        axis = np.array(filled.points)
        axis[filled.origins != ORIGINS.index(Origin.OWN), 2] += above_ground or 0.0
        return axis

    def _note(self, kind: str, line: LineFeature, filled: FilledPoints, axis: Floats, remark: str = "") -> None:
        if not filled.missing:
            return
        origins = set(filled.origins.tolist())
        if len(origins) > 1:
            origins.discard(ORIGINS.index(Origin.OWN))
        for i in sorted(origins):
            self.notes.see(kind, line, ORIGINS[i], axis[filled.origins == i, 2].tolist(), remark)


def _tube_radius(line: LineFeature, rule: Rule, block: TubeBlock) -> float:
    """Return half the line's diameter and the clearance [m]. Raises RuleError."""
    element = f"line {line.name!r}, rule {rule.name!r}"
    diameter = line.diameter_m if line.diameter_m is not None else block.diameter_m
    if diameter is None:
        raise RuleError(
            "the line has no diameter and the rule none for it",
            file=line.source.file,
            line=line.source.line,
            element=element,
            allowed="diameter_m in the rule",
        )
    if diameter / 2 + block.clearance_m <= 0:
        raise RuleError(
            "the tube round the line has no thickness",
            file=line.source.file,
            line=line.source.line,
            element=element,
            value=diameter,
            allowed="a diameter or a clearance above 0",
        )
    return diameter / 2 + block.clearance_m
