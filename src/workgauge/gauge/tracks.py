"""A track rule settled for one alignment: profile rows, gauge base, pivot; and the convex sections to sweep."""

from dataclasses import dataclass

import numpy as np

from workgauge.gauge.blocks import CantBlock
from workgauge.gauge.envelope import QuasiStatic, Widening
from workgauge.gauge.rules import RuleBook, TrackBlock, WireAboveRailBlock
from workgauge.gauge.sections import CantRotation, EnvelopeSection, WireSection, convex_pieces
from workgauge.gauge.trackline import NUDGE, TrackLine
from workgauge.gauge.widening import Early, TrackWidening
from workgauge.site.alignment import Alignment
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import RuleError

#: A profile is swept as one convex piece if its hull adds no more than this to the half-width [m], else split.
HULL_TOLERANCE = 0.026
#: A gauge in a file may differ from the rule book's row by this much [m].
GAUGE_SLACK = 0.012


@dataclass(frozen=True, slots=True, eq=False)
class TrackShape:
    """What a track rule says about one alignment.

    Attributes:
        half_widths, heights: (p,) profile rows, bottom to top, with a row at the lean's roll centre.
        margin: [m]. widening, early, lean, cant: None where the rule has none.
    """

    half_widths: Floats
    heights: Floats
    margin: float
    widening: Widening | None
    early: Early | None
    lean: QuasiStatic | None
    cant: CantRotation | None


def track_shape(block: TrackBlock, book: RuleBook, alignment: Alignment) -> TrackShape:
    """Settle a track rule for one alignment. Raises RuleError if its gauge is not in the rule's table."""
    rows = _profile_rows(block, book)
    lean = None if block.quasi_static is None else block.quasi_static.build()
    if lean is not None and rows[0][1] < lean.height < rows[-1][1] and lean.height not in {h for _, h in rows}:
        i = next(i for i, (_, h) in enumerate(rows) if h > lean.height)
        (b0, h0), (b1, h1) = rows[i - 1], rows[i]
        rows.insert(i, (b0 + (b1 - b0) * (lean.height - h0) / (h1 - h0), lean.height))
    early = block.early_widening
    return TrackShape(
        frozen([b for b, _ in rows]),
        frozen([h for _, h in rows]),
        block.margin_m,
        None if block.widening is None else block.widening.build(),
        None if early is None else Early(early.inside_from_m, early.outside_from_m, early.outside_full_m),
        lean,
        cant_rotation(block.cant, alignment),
    )


def track_sections(shape: TrackShape, line: TrackLine, book: RuleBook) -> list[EnvelopeSection]:
    """Return the convex sections, bottom to top, whose union covers the track's section along the whole line."""
    widening = None
    if shape.widening is not None:
        widening = TrackWidening(line, shape.widening, shape.early, f"rule book {book.name}")
    kinks = np.empty(0) if shape.lean is None else _crossings(line, 1.0 / shape.lean.full_below_radius)
    return [
        EnvelopeSection(
            shape.half_widths[first : last + 1],
            shape.heights[first : last + 1],
            corners,
            shape.margin,
            widening,
            shape.lean,
            shape.cant,
            kinks,
        )
        for first, last, corners in convex_pieces(shape.half_widths, shape.heights, HULL_TOLERANCE)
    ]


def wire_section(block: WireAboveRailBlock, book: RuleBook, alignment: Alignment) -> WireSection:
    """Return the no-go section round the wire that a rule puts over an alignment."""
    below, side = clearances(block.voltage, block.below_m, block.side_m, book)
    cant = cant_rotation(block.cant, alignment)
    return WireSection(block.height_above_rail_m, below, side + block.stagger_m, block.above_m, cant)


def clearances(voltage: str | None, below: float | None, side: float | None, book: RuleBook) -> tuple[float, float]:
    """Return (below, side) [m], from the rule itself or from the book's row for the voltage."""
    if voltage is not None:
        row = book.voltages[voltage]
        return row.below_m, row.side_m
    if below is None or side is None:
        raise RuleError("an overhead line needs below_m and side_m, or a voltage")
    return below, side


def cant_rotation(block: CantBlock | None, alignment: Alignment) -> CantRotation | None:
    """Return how an alignment's cant turns a section: the file's rotation point and gauge where it states them."""
    if block is None or not alignment.has_cant:
        return None
    gauge, base = alignment.cant_gauge_m, block.base_when_missing_m
    if gauge is not None:
        found = [row for row in block.base_by_gauge_m if abs(row[0] - gauge) <= GAUGE_SLACK]
        if not found:
            raise RuleError(
                "the rule book has no base for this gauge",
                element=f"alignment {alignment.name.strip()!r}",
                value=f"{gauge:g} m",
                allowed=", ".join(f"{row[0]:g}" for row in block.base_by_gauge_m) + " m (base_by_gauge_m)",
            )
        base = min(found, key=lambda row: abs(row[0] - gauge))[1]
    pivot = block.rotation
    if pivot == "file":
        return CantRotation(base, _file_pivot(alignment.cant_rotation_point) or block.rotation_when_missing)
    return CantRotation(base, pivot)


def _crossings(line: TrackLine, curvature: float) -> Floats:
    """Return the distances where the unsigned curvature passes a value, as closely as a 2 m grid tells [m]."""
    d = np.unique(np.concatenate([np.arange(0.0, line.length, 2.0), line.breaks, line.breaks[1:] - NUDGE]))
    over = np.abs(np.asarray(line.at(d).curvature)) - curvature
    i = np.flatnonzero(over[:-1] * over[1:] < 0)
    return np.asarray(d[i] + (d[i + 1] - d[i]) * over[i] / (over[i] - over[i + 1]), dtype=np.float64)


def _file_pivot(text: str | None) -> str | None:
    """Return the pivot a file names (`insideRail`, `center`, `leftRail` …), or None if it names none we know."""
    words = (text or "").casefold()
    known = {
        "inside": "low_rail",
        "low": "low_rail",
        "outside": "high_rail",
        "high": "high_rail",
        "left": "left_rail",
        "right": "right_rail",
        "cent": "centre",
        "middle": "centre",
    }
    return next((pivot for word, pivot in known.items() if word in words), None)


def _profile_rows(block: TrackBlock, book: RuleBook) -> list[tuple[float, float]]:
    """Return the profile's (half-width, height) rows, bottom to top, carried down to its bottom."""
    if block.profile is None:
        if block.half_width_m is None or block.height_m is None:
            raise RuleError("a track needs a profile, or half_width_m and height_m")
        return [(block.half_width_m, block.bottom_m), (block.half_width_m, block.height_m)]
    profile = book.profiles[block.profile]
    rows = list(profile.half_width_at_height_m)
    bottom = block.bottom_m if "bottom_m" in block.model_fields_set else profile.bottom_m
    if bottom is not None and bottom < rows[0][1]:
        rows.insert(0, (rows[0][0], bottom))
    return [(float(b), float(h)) for b, h in np.asarray(rows, dtype=np.float64)]
