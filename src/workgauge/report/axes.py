"""A small line chart as SVG text: scales with round ticks, lines, threshold lines, shaded spans, direct labels."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np

from workgauge.values.arrays import Floats

#: Left, right, top, bottom margins round the plot area [px].
MARGIN = (64, 128, 14, 44)

#: Width of a small letter and of a label's, about [px].
LETTER_PX, LABEL_PX = 6.0, 7.0


def nice_step(span: float, wanted: int) -> float:
    """Return the round step (1, 2 or 5 times a power of ten) that cuts `span` into about `wanted` pieces."""
    raw = max(span, 1e-12) / max(wanted, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    return float(next(m * power for m in (1, 2, 5, 10) if m * power >= raw * 0.999))


def ticks(low: float, high: float, wanted: int = 6) -> list[float]:
    """Return the round values within [low, high]."""
    step = nice_step(high - low, wanted)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [i * step for i in range(first, last + 1)]


def label(value: float, step: float) -> str:
    """Return a tick label with as many decimals as the step needs."""
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    return f"{value:.{decimals}f}".replace("-", "\N{MINUS SIGN}")


def thin(x: Floats, y: Floats, buckets: int = 700) -> tuple[Floats, Floats]:
    """Return the series with only the first, smallest, largest and last row of each of `buckets` stretches.

    Extremes survive, so a thinned clearance still shows its smallest value.
    """
    if len(x) <= 4 * buckets:
        return x, y
    keep: set[int] = set()
    for part in np.array_split(np.arange(len(x)), buckets):
        finite = part[np.isfinite(y[part])]
        keep.update((int(part[0]), int(part[-1])))
        if len(finite):
            keep.update((int(finite[np.argmin(y[finite])]), int(finite[np.argmax(y[finite])])))
    rows = np.array(sorted(keep))
    return x[rows], y[rows]


def runs_of_finite(y: Floats) -> Iterator[slice]:
    """Yield the stretches of y without NaN."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.isfinite(y).astype(np.int8), [0]])))
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        yield slice(int(start), int(stop))


@dataclass
class Chart:
    """A chart being drawn; add things to it, then ask for `svg()`.

    Attributes:
        title: what it shows, for screen readers. x_label, y_label: with units.
        x_range, y_range: data ranges.
    """

    title: str
    x_label: str
    y_label: str
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    width: int = 860
    height: int = 330
    _below: list[str] = field(default_factory=list)
    _marks: list[str] = field(default_factory=list)
    _above: list[str] = field(default_factory=list)
    _tops: list[str] = field(default_factory=list)
    _tags: list[tuple[float, str, str]] = field(default_factory=list)

    def x(self, value: float) -> float:
        """Return the pixel column of a data value."""
        low, high = self.x_range
        return MARGIN[0] + (value - low) / (high - low) * (self.width - MARGIN[0] - MARGIN[1])

    def y(self, value: float) -> float:
        """Return the pixel row of a data value."""
        low, high = self.y_range
        return self.height - MARGIN[3] - (value - low) / (high - low) * (self.height - MARGIN[2] - MARGIN[3])

    def line(self, x: Floats, y: Floats, css: str, name: str = "", tag: bool = True) -> None:
        """Draw a line (NaN breaks it); `name` is its tooltip and, with `tag`, its label at the right end."""
        x, y = thin(x, y)
        for part in runs_of_finite(y):
            points = " ".join(f"{self.x(a):.1f},{self.y(b):.1f}" for a, b in zip(x[part], y[part], strict=True))
            self._above.append(
                f'<polyline class="line {css}" points="{points}"><title>{escape(name)}</title></polyline>'
            )
        finite = np.flatnonzero(np.isfinite(y))
        if name and tag and len(finite):
            self._tags.append((self.y(float(y[finite[-1]])), name, css))

    def threshold(self, value: float, text: str, css: str) -> None:
        """Draw a horizontal line with its label at the right."""
        row = self.y(value)
        self._below.append(
            f'<line class="threshold {css}" x1="{MARGIN[0]}" x2="{self.width - MARGIN[1]}" '
            f'y1="{row:.1f}" y2="{row:.1f}"/>'
        )
        self._tags.append((row, text, css))

    def band(self, low: float, high: float, css: str) -> None:
        """Shade the stretch between two y values."""
        top, bottom = self.y(high), self.y(low)
        self._below.append(
            f'<rect class="band {css}" x="{MARGIN[0]}" width="{self.width - MARGIN[0] - MARGIN[1]}" '
            f'y="{top:.1f}" height="{max(bottom - top, 0):.1f}"/>'
        )

    def span(self, start: float, end: float, css: str, text: str) -> None:
        """Shade a stretch of x, with a tooltip."""
        left, right = self.x(start), self.x(end)
        self._below.append(
            f'<rect class="span {css}" x="{left:.1f}" width="{max(right - left, 1):.1f}" y="{MARGIN[2]}" '
            f'height="{self.height - MARGIN[2] - MARGIN[3]}"><title>{escape(text)}</title></rect>'
        )

    def bar(self, start: float, end: float, value: float, css: str, text: str) -> None:
        """Draw a bar from zero to `value` over a stretch of x, with a tooltip."""
        left, right, top = self.x(start) + 1.0, self.x(end) - 1.0, self.y(value)
        self._above.append(
            f'<rect class="bar {css}" x="{left:.1f}" width="{max(right - left, 1):.1f}" y="{top:.1f}" '
            f'height="{max(self.y(0.0) - top, 0):.1f}"><title>{escape(text)}</title></rect>'
        )

    def upright(self, value: float, text: str, css: str) -> None:
        """Draw a vertical line over the whole height with a text to its right at the top."""
        column = self.x(value)
        self._marks.append(
            f'<line class="threshold {css}" x1="{column:.1f}" x2="{column:.1f}" y1="{MARGIN[2]}" '
            f'y2="{self.height - MARGIN[3]}"/>'
        )
        self._tops.append(f'<text class="tag {css}" x="{column + 6:.1f}" y="{MARGIN[2] + 12}">{escape(text)}</text>')

    def note(self, x: float, y: float, text: str) -> None:
        """Write a small text, centred, above a place."""
        place = f'x="{self.x(x):.1f}" y="{self.y(y) - 5:.1f}" text-anchor="middle"'
        self._tops.append(f'<text class="note" {place}>{escape(text)}</text>')

    def marks(self, places: Sequence[tuple[str, float]]) -> None:
        """Draw vertical hairlines at (text, x), with the text at the top where it fits before the next one."""
        ends = [x for _, x in places[1:]] + [self.x_range[1]]
        for (text, x), end in zip(places, ends, strict=True):
            column = self.x(x)
            fits = self.x(end) - column > 4 + LETTER_PX * len(text)
            note = f'<text class="note" x="{column + 4:.1f}" y="{MARGIN[2] + 11}">{escape(text)}</text>'
            self._marks.append(
                f'<line class="mark" x1="{column:.1f}" x2="{column:.1f}" y1="{MARGIN[2]}" '
                f'y2="{self.height - MARGIN[3]}"><title>{escape(text)}</title></line>' + (note if fits else "")
            )

    def dot(self, x: float, y: float, text: str) -> None:
        """Draw a dot with a text beside it."""
        self._above.append(
            f'<circle class="dot" cx="{self.x(x):.1f}" cy="{self.y(y):.1f}" r="4"/>'
            f'<text class="callout" x="{self.x(x) + 8:.1f}" y="{self.y(y) - 8:.1f}">{escape(text)}</text>'
        )

    def _grid(self) -> Iterator[str]:
        step_x, step_y = (
            nice_step(self.x_range[1] - self.x_range[0], 9),
            nice_step(self.y_range[1] - self.y_range[0], 6),
        )
        left, right, bottom = MARGIN[0], self.width - MARGIN[1], self.height - MARGIN[3]
        for value in ticks(*self.x_range, 9):
            column = self.x(value)
            yield f'<line class="grid" x1="{column:.1f}" x2="{column:.1f}" y1="{MARGIN[2]}" y2="{bottom}"/>'
            words = label(value, step_x)
            yield f'<text class="tick" x="{column:.1f}" y="{bottom + 17}" text-anchor="middle">{words}</text>'
        for value in ticks(*self.y_range, 6):
            row = self.y(value)
            css = "zero" if value == 0 else "grid"
            yield f'<line class="{css}" x1="{left}" x2="{right}" y1="{row:.1f}" y2="{row:.1f}"/>'
            words = label(value, step_y)
            yield f'<text class="tick" x="{left - 8}" y="{row + 4:.1f}" text-anchor="end">{words}</text>'
        yield (
            f'<text class="axis" x="{(left + right) / 2}" y="{self.height - 6}" text-anchor="middle">'
            f"{escape(self.x_label)}</text>"
        )
        middle = (MARGIN[2] + bottom) / 2
        yield (
            f'<text class="axis" transform="translate(15 {middle}) rotate(-90)" text-anchor="middle">'
            f"{escape(self.y_label)}</text>"
        )

    def _labels(self) -> Iterator[str]:
        """Yield the labels at the right end, pushed apart so that none covers another."""
        rows = sorted(self._tags, key=lambda tag: round(tag[0]))
        placed: list[float] = []
        for row, _, _ in rows:
            placed.append(max(row, placed[-1] + 15 if placed else row))
        overflow = (placed[-1] - (self.height - MARGIN[3])) if placed else 0.0
        if overflow > 0:
            limit = float(self.height - MARGIN[3])
            for i in reversed(range(len(placed))):
                placed[i] = min(placed[i], limit)
                limit = placed[i] - 15
        most = int((MARGIN[1] - 10) / LABEL_PX)
        for (_, text, css), row in zip(rows, placed, strict=True):
            shown = text if len(text) <= most else text[: most - 1] + "…"
            yield (
                f'<text class="tag {css}" x="{self.width - MARGIN[1] + 8}" y="{row + 4:.1f}">{escape(shown)}'
                f"<title>{escape(text)}</title></text>"
            )

    def svg(self) -> str:
        """Return the finished picture."""
        body = "\n".join((*self._below, *self._grid(), *self._marks, *self._above, *self._tops, *self._labels()))
        return (
            f'<svg class="chart" viewBox="0 0 {self.width} {self.height}" role="img" '
            f'aria-label="{escape(self.title, quote=True)}">\n{body}\n</svg>'
        )
