"""Distributions of a certificate: what was left of the stop distance, of all drives, and small in a table."""

from collections.abc import Sequence
from itertools import pairwise

from workgauge.report.axes import Chart

#: Size of a small distribution [px].
SPARK = (150, 26)


def left_figure(title: str, edges_m: Sequence[float], counts: Sequence[int], aside: bool = False) -> str:
    """Return a histogram of what was left of the stop distance.

    Args:
        title: for screen readers. edges_m: of the classes. counts: of drives, below the first edge, between edges,
            and from the last one on; the last is drawn as one class, and named. aside: drawn in grey.
    """
    width = edges_m[1] - edges_m[0]
    last = edges_m[-1] + 3.0 * width
    top = max(max(counts, default=0), 5) * 1.2
    first = edges_m[0] - width
    chart = Chart(title, "what was left of the stop distance [m]", "drives", (first, last), (0.0, top), height=290)
    spans = [(first, edges_m[0]), *pairwise(edges_m), (edges_m[-1], last)]
    for (start, end), count in zip(spans, counts, strict=True):
        if count:
            css = "below" if end <= 1e-9 else "far" if end == last else "aside" if aside else "kept"
            words = "farther, or nothing near" if end == last else f"{start:.3f} to {end:.3f} m"
            chart.bar(start, end, count, css, f"{count} drives: {words}")
    chart.upright(0.0, "stop distance", "stop")
    chart.note((edges_m[-1] + last) / 2.0, counts[-1], f"{counts[-1]} farther")
    return chart.svg()


def left_spark(edges_m: Sequence[float], counts: Sequence[int]) -> str:
    """Return the same small, without axes; classes as in `left_figure`, without the last."""
    width, height = SPARK
    shown = counts[:-1]
    most, step = max(max(shown, default=0), 1), width / max(len(shown), 1)
    bars = []
    for k, count in enumerate(shown):
        if count:
            tall = max(count / most * (height - 2), 1.5)
            css = "below" if edges_m[k] <= 1e-9 else "kept"
            bars.append(
                f'<rect class="bar {css}" x="{k * step + 0.4:.1f}" width="{step - 0.8:.1f}" '
                f'y="{height - tall:.1f}" height="{tall:.1f}"/>'
            )
    zero = sum(edge <= 1e-9 for edge in edges_m) * step
    line = f'<line x1="{zero:.1f}" x2="{zero:.1f}" y1="0" y2="{height}"/>'
    return f'<svg class="spark" viewBox="0 0 {width} {height}" aria-hidden="true">{line}{"".join(bars)}</svg>'
