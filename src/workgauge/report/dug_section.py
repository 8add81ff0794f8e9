"""The page's section on what was dug: a coloured map of the edge's sweep against the design."""

import itertools
from html import escape

import numpy as np

from workgauge.motion.bucket.dug import DugMap
from workgauge.report.axes import nice_step
from workgauge.values.arrays import Floats

WIDTH, HEIGHT = 620, 470
_LEGEND = 70
#: From below the design to above it.
COLOURS = ("#7f0000", "#c62828", "#ef6c4a", "#f6b48f", "#f2f0eb", "#a9cfe3", "#5ba3cf", "#2171b5", "#08306b")


def dug_section(dug: DugMap | None) -> str:
    """Return the section, empty where nothing was dug."""
    if dug is None:
        return ""
    if dug.allowed_m is None:
        verdict = ""
    elif dug.over_dug:
        verdict = f" <strong>Deeper than the {1e3 * dug.allowed_m:.0f} mm allowed.</strong>"
    else:
        verdict = f" Nowhere deeper than the {1e3 * dug.allowed_m:.0f} mm allowed."
    return f"""<section>
<h2>As dug</h2>
<p>The lowest the edge came, above or below the design, in cells of {1e3 * dug.cell_m:.0f} mm. RMS
{1e3 * dug.rms_m:.1f} mm, mean {1e3 * dug.mean_m:+.1f} mm on {dug.area_m2:.2f} m²; deepest below the design at any
tick {1e3 * dug.deepest_m:.1f} mm.{verdict}</p>
<figure><figcaption>From above, grid north up</figcaption>{dug_figure(dug)}</figure>
</section>"""


def colour_range(dug: DugMap) -> float:
    """Return the difference at which colours end: round, and holding nearly all cells [m]."""
    known = np.abs(dug.left_m[np.isfinite(dug.left_m)])
    return max(nice_step(float(np.quantile(known, 0.98)), 1), 0.005)


def dug_figure(dug: DugMap) -> str:
    """Return the map as SVG; a run of cells of one colour is one bar."""
    most = colour_range(dug)
    columns, rows = dug.left_m.shape
    scale = min((WIDTH - _LEGEND) / columns, HEIGHT / rows)
    x0, y0 = (WIDTH - _LEGEND - scale * columns) / 2, (HEIGHT + scale * rows) / 2
    edges = np.linspace(-most, most, len(COLOURS) + 1)[1:-1]
    bins = np.where(np.isfinite(dug.left_m), np.digitize(np.nan_to_num(dug.left_m), edges), -1)
    parts = []
    for column in range(columns):
        for first, last, number in _runs(bins[column]):
            x, y = x0 + scale * column, y0 - scale * last
            wide, high = scale + 0.05, scale * (last - first) + 0.05  # a hair more: no seams
            parts.append(
                f'<rect x="{x:.2f}" y="{y:.2f}" width="{wide:.2f}" height="{high:.2f}" fill="{COLOURS[number]}"/>'
            )
    middle = dug.low + 0.5 * dug.cell_m * np.array([columns, rows])
    title = f"Edge against design, middle at E {middle[0]:.1f}, N {middle[1]:.1f}"
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(title)}"><title>{escape(title)}</title>'
        f"{''.join(parts)}{_scale_bar(scale / dug.cell_m)}{_legend(most, edges)}</svg>"
    )


def _runs(bins: Floats) -> list[tuple[int, int, int]]:
    """Return (first, one beyond the last, colour) of runs of cells of one colour."""
    ends = np.flatnonzero(np.diff(bins)) + 1
    marks = [0, *ends.tolist(), len(bins)]
    return [(a, b, int(bins[a])) for a, b in itertools.pairwise(marks) if bins[a] >= 0]


def _scale_bar(pixels_per_m: float) -> str:
    length = nice_step(100.0 / pixels_per_m, 1)
    x, y, wide = 12.0, HEIGHT - 12.0, length * pixels_per_m
    return (
        f'<path class="scalebar" d="M{x:.1f} {y - 5:.1f}V{y:.1f}H{x + wide:.1f}V{y - 5:.1f}"/>'
        f'<text class="tick" x="{x + wide / 2:.1f}" y="{y - 6:.1f}" text-anchor="middle">{length:g} m</text>'
    )


def _legend(most: float, edges: Floats) -> str:
    """Return the colours with what they mean [mm]."""
    x, top, step = WIDTH - _LEGEND + 8, 60.0, 34.0
    count = len(COLOURS)
    boxes = [
        f'<rect x="{x}" y="{top + step * (count - 1 - k):.1f}" width="16" height="{step:.1f}" fill="{colour}"/>'
        for k, colour in enumerate(COLOURS)
    ]
    marks = [
        f'<text class="tick" x="{x + 21}" y="{top + step * (count - 1 - k) + 4:.1f}">{1e3 * edge:+.0f}</text>'
        for k, edge in enumerate(edges.tolist())
    ]
    words = f'<text class="tick" x="{WIDTH - 2}" y="{top - 22:.0f}" text-anchor="end">above [mm]</text>'
    return words + "".join(boxes) + "".join(marks)
