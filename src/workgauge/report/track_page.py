"""The page of a receiver's log: track in plan by quality, height, stated error, heading and health over time."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from workgauge.rehearse.track_log import Track
from workgauge.rehearse.track_object import QUALITY_WORDS
from workgauge.report.axes import MARGIN, Chart, label, nice_step, ticks
from workgauge.report.views import HEIGHT, WIDTH, View
from workgauge.report.writing import write_files
from workgauge.values.arrays import Floats, Ints
from workgauge.values.health import HealthState

#: A step between epochs so many times the usual one is a pause.
PAUSE = 20

#: Dots drawn in plan at most, per quality.
DOTS = 4000


def quality_css(quality: int) -> str:
    """Return the style class of a quality."""
    return f"q{quality}" if quality in (1, 2, 4, 5, 6) else "q0"


def plan(track: Track) -> str:
    """Return the track from above, grid north up, each epoch coloured by its quality."""
    placed = np.flatnonzero(track.placed)
    points = np.stack([track.e[placed], track.n[placed]], axis=1)
    low, high = points.min(axis=0), points.max(axis=0)
    span = np.maximum(high - low, 0.02)  # a receiver that stands still is shown 2 cm wide
    scale = float(min((WIDTH - 80) / span[0], (HEIGHT - 90) / span[1]))
    view = View("Track in plan, north up", (low + high) / 2, scale)
    axis = time_axis(track)
    places = np.array([place for _, place in axis.pauses])
    for source in sorted({track.sources[i] for i in placed}):
        own = np.array([i for i in placed if track.sources[i] == source])
        line = own[np.linspace(0, len(own) - 1, min(len(own), 20 * DOTS)).astype(int)]
        parts = np.cumsum(np.diff(np.searchsorted(places, axis.t[line]), prepend=0) != 0)
        for part in np.unique(parts):
            rows = line[parts == part]
            view.path(np.stack([track.e[rows], track.n[rows]], axis=1), "tracepath", source)
    for quality in (0, 1, 2, 6, 5, 4):  # the better ones on top
        css = f"q{quality}"
        own = np.array([i for i in placed if quality_css(int(track.quality[i])) == css], dtype=int)
        for i in own[np.unique(np.linspace(0, len(own) - 1, min(len(own), DOTS)).astype(int))] if len(own) else ():
            words = f"{_clock(track, float(track.t_s[i]))}, {QUALITY_WORDS.get(int(track.quality[i]), 'unknown')}"
            view.dot(np.array([track.e[i], track.n[i]]), f"fix {css}", words)
    north = (
        f'<g transform="translate({WIDTH - 26} 34)"><path class="north" d="M0 -20L7 8L0 3L-7 8Z"/>'
        '<text class="tick" y="24" text-anchor="middle">N</text></g>'
    )
    return view.svg(north)


@dataclass(frozen=True, slots=True, eq=False)
class _Axis:
    """Time as it is drawn: seconds of the log, long pauses cut out.

    Attributes:
        t: (n,) where each epoch is drawn. end: where the axis ends. pauses: (place, words) of what is cut out.
    """

    t: Floats
    end: float
    pauses: tuple[tuple[str, float], ...]
    label: str


def time_axis(track: Track) -> _Axis:
    """Return the axis of time; of numbers where no sentence has a time."""
    known = np.flatnonzero(np.isfinite(track.t_s))
    if not len(known):
        return _Axis(np.arange(len(track), dtype=np.float64), float(max(len(track) - 1, 1)), (), "epoch [number]")
    order = known[np.argsort(track.t_s[known], kind="stable")]
    t = track.t_s[order] - track.t_s[order[0]]
    steps = np.diff(t)
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
    long = np.flatnonzero(steps > max(PAUSE * usual, 2.0))
    running = float(t[-1] - steps[long].sum())
    long = long[steps[long] > 0.1 * max(running, usual)]
    left = 0.03 * max(float(t[-1] - steps[long].sum()), usual)
    cut = np.zeros(len(t))
    cut[long + 1] = steps[long] - left
    shown = t - np.cumsum(cut)
    out = np.full(len(track), np.nan)
    out[order] = shown
    pauses = tuple((f"{steps[k]:.0f} s pause", float(shown[k] + 0.5 * left)) for k in long)
    words = f"time [s] from {_clock(track, float(track.t_s[order[0]]))}"
    return _Axis(out, float(max(shown[-1], 0.1)), pauses, words + (", pauses cut short" if pauses else ""))


def _clock(track: Track, t_s: float) -> str:
    """Return a time for people."""
    if not math.isfinite(t_s):
        return "no time"
    if track.utc:
        try:
            return datetime.fromtimestamp(t_s, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
        except (OverflowError, ValueError, OSError):
            return f"{t_s:.1f} s"
    day, rest = divmod(t_s, 86400)
    clock = f"{int(rest // 3600):02d}:{int(rest % 3600 // 60):02d}:{rest % 60:04.1f} UTC"
    return clock if day < 1 else f"{clock}, day {int(day) + 1}"


def _chart(track: Track, title: str, unit: str, series: Sequence[tuple[str, Floats]], from_zero: bool) -> str:
    """Return a chart over time of named series (n,), or a sentence if nothing of it is known."""
    known = [(name, values) for name, values in series if np.isfinite(values).any()]
    if not known:
        return f"<p>{escape(title)}: the log says nothing of it.</p>"
    everything = np.concatenate([values[np.isfinite(values)] for _, values in known])
    low, high = float(everything.min()), float(everything.max())
    room = max(0.08 * (high - low), 1e-3)
    y_range = (0.0, high + room) if from_zero else (low - room, high + room)
    axis = time_axis(track)
    chart = Chart(title, axis.label, f"{title} [{unit}]", (0.0, axis.end), y_range, height=240)
    if axis.pauses:
        chart.marks(axis.pauses)
    order = np.argsort(axis.t, kind="stable")
    for i, (name, values) in enumerate(known):
        rows = order[np.isfinite(values[order]) & np.isfinite(axis.t[order])]
        x, y = _broken(axis.t[rows], values[rows], axis.pauses)
        chart.line(x, y, f"s{i}", name)
    return chart.svg()


def _broken(t: Floats, y: Floats, pauses: Sequence[tuple[str, float]]) -> tuple[Floats, Floats]:
    """Return a series with a NaN in each pause, so that no line crosses it."""
    places = np.array([place for _, place in pauses])
    before = np.searchsorted(t, places)
    return np.insert(t, before, places), np.insert(y, before, np.nan)


def _by_source(track: Track, values: Floats) -> list[tuple[str, Floats]]:
    """Return one series (n,) per receiver, NaN where another one speaks."""
    names = sorted({source for source in track.sources if source})
    sources = np.array(track.sources)
    return [(name, np.where(sources == name, values, np.nan)) for name in names]


def height_chart(track: Track) -> str:
    """Return each antenna's height in the site's system over time."""
    return _chart(track, "height of the antenna", "m", _by_source(track, track.z), from_zero=False)


def sigma_chart(track: Track) -> str:
    """Return the error, stated or typical of the quality, over time: of several receivers, the horizontal one."""
    if len({source for source in track.sources if source}) > 1:
        horizontal = np.fmax(track.sigma_m[:, 0], track.sigma_m[:, 1])
        return _chart(track, "horizontal 1σ", "m", _by_source(track, horizontal), from_zero=True)
    series = [(name, track.sigma_m[:, i]) for i, name in enumerate(("east", "north", "up"))]
    return _chart(track, "1σ", "m", series, from_zero=True)


def heading_chart(track: Track) -> str:
    """Return the grid heading over time, without jumps at north."""
    heading = np.degrees(track.heading)
    known = np.isfinite(heading)
    unwrapped = np.full(len(heading), np.nan)
    unwrapped[known] = np.unwrap(heading[known], period=360.0)
    return _chart(track, "grid heading", "°", [("heading", unwrapped)], from_zero=False)


def timeline(track: Track, health: Sequence[str | None]) -> str:
    """Return the states of health over time, one row per state, best on top."""
    axis = time_axis(track)
    x_range = (0.0, axis.end)
    states = [state.value for state in HealthState]
    width, row, top = 860, 24, 8
    bottom = top + row * len(states)
    place = Chart("", "", "", x_range, (0.0, 1.0), width=width)
    parts = []
    for i, state in enumerate(states):
        y = top + i * row
        parts.append(f'<line class="grid" x1="{MARGIN[0]}" x2="{width - MARGIN[1]}" y1="{y + row}" y2="{y + row}"/>')
        parts.append(
            f'<text class="tick" x="{width - MARGIN[1] + 8}" y="{y + row / 2 + 4}">{state.replace("_", " ")}</text>'
        )
    for state, first, last in _stretches(axis.t, health, axis.pauses):
        y = top + states.index(state) * row + 4
        left, right = place.x(first), place.x(last)
        parts.append(
            f'<rect class="state {state}" x="{left:.1f}" y="{y}" width="{max(right - left, 2):.1f}" '
            f'height="{row - 8}"><title>{state.replace("_", " ")}, {first:.1f} to {last:.1f} s</title></rect>'
        )
    step = nice_step(x_range[1] - x_range[0], 9)
    for value in ticks(*x_range, 9):
        words = label(value, step)
        parts.append(
            f'<text class="tick" x="{place.x(value):.1f}" y="{bottom + 17}" text-anchor="middle">{words}</text>'
        )
    middle = (MARGIN[0] + width - MARGIN[1]) / 2
    parts.append(
        f'<text class="axis" x="{middle}" y="{bottom + 38}" text-anchor="middle">{escape(axis.label)}</text>'
    )
    return (
        f'<svg class="chart" viewBox="0 0 {width} {bottom + 46}" role="img" aria-label="Health over time">\n'
        + "\n".join(parts)
        + "\n</svg>"
    )


def _stretches(
    t: Floats, health: Sequence[str | None], pauses: Sequence[tuple[str, float]]
) -> list[tuple[str, float, float]]:
    """Return (state, first, last time) of each stretch of one state, up to the beginning of the next or a pause."""
    places = np.array([place for _, place in pauses])
    rows = [(float(t[i]), state) for i, state in enumerate(health) if state is not None and math.isfinite(t[i])]
    rows.sort(key=lambda one: one[0])
    out: list[tuple[str, float, float]] = []
    for when, state in rows:
        paused = bool(out) and np.searchsorted(places, out[-1][2]) != np.searchsorted(places, when)
        if out and not paused:
            out[-1] = (out[-1][0], out[-1][1], when)
        if not out or paused or out[-1][0] != state:
            out.append((state, when, when))
    return out


def _tiles(track: Track, quality: Ints) -> str:
    known = track.t_s[np.isfinite(track.t_s)]
    span = float(known.max() - known.min()) if len(known) else math.nan
    tiles = [
        (str(len(track)), f"epochs of {len({*track.sources})} receiver(s)"),
        (f"{span:.1f} s" if math.isfinite(span) else "no times", "from the first to the last"),
        (f"{100 * np.mean(quality == 4):.0f} %", "of them RTK fixed"),
        (f"{track.tally['good']:,}", "good sentences"),
        (f"{track.tally['bad']:,}", f"rejected; {track.tally['unknown']:,} of unknown kinds"),
    ]
    body = "".join(f"<li><b>{escape(big)}</b><span>{escape(small)}</span></li>" for big, small in tiles)
    return f'<ul class="tiles">{body}</ul>'


def _legend(quality: Ints) -> str:
    items = [
        f'<li><i class="{quality_css(value)}"></i>{escape(QUALITY_WORDS.get(value, "unknown"))}: '
        f"{int(np.sum(quality == value))}</li>"
        for value in sorted({int(value) for value in quality})
    ]
    return f'<ul class="legend">{"".join(items)}</ul>'


def _table(rows: Sequence[tuple[str, str]]) -> str:
    return "<table>" + "".join(f"<tr><th>{escape(k)}</th><td>{escape(v)}</td></tr>" for k, v in rows) + "</table>"


def render(track: Track, health: Sequence[str | None], health_words: str) -> str:
    """Return the page as HTML text. `health` has a state per epoch, `health_words` says whose judgement it is."""
    style = files("workgauge").joinpath("shipped/report/style.css").read_text("utf-8")
    crs = track.crs
    rows = [
        ("logs", ", ".join(track.files)),
        ("coordinates", f"{crs.name} (EPSG {crs.epsg})"),
        ("heights", track.height_words),
        ("health", health_words),
        ("sentences", f"{track.tally['good']} good, {track.tally['bad']} bad, {track.tally['unknown']} unknown"),
        *((f"rejected: {reason}", str(many)) for reason, many in sorted(track.tally["reasons"].items())),
    ]
    warnings = "".join(f"<li>{escape(text)}</li>" for text in track.warnings)
    warned = f'<section><h2>Warnings</h2><ul class="plain">{warnings}</ul></section>' if warnings else ""
    title = f"Track of {Path(track.files[0]).name}" if len(track.files) == 1 else f"Track of {len(track.files)} logs"
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)} · workgauge</title>
<style>{style}</style>
</head>
<body>
<main>
<header><p class="eyebrow">workgauge · pose</p><h1>{escape(title)}</h1>
<p>Heights: {escape(track.height_words)}. Headings are clockwise from grid north.</p></header>
{_tiles(track, track.quality)}
{warned}
<section><h2>Where</h2>
<figure><figcaption>From above, grid north up, by quality of the fix</figcaption>{plan(track)}</figure>
{_legend(track.quality)}</section>
<section><h2>Health</h2><p>{escape(health_words[:1].upper() + health_words[1:])}.</p>
{timeline(track, health)}</section>
<section><h2>Height</h2>{height_chart(track)}</section>
<section><h2>Error as the receiver states it, else typical of the quality</h2>{sigma_chart(track)}</section>
<section><h2>Heading</h2>{heading_chart(track)}</section>
<section><h2>The log</h2>{_table(rows)}</section>
</main>
</body>
</html>
"""


def write_track_report(
    track: Track, health: Sequence[str | None], health_words: str, data: Mapping[str, Any], folder: Path
) -> Path:
    """Write `report.html` and `pose.json` (the object of `workgauge pose --json`) into `folder`; returns the page.

    Raises:
        InputError: if the folder cannot be made or written.
    """
    text = json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    write_files(folder, {"pose.json": text, "report.html": render(track, health, health_words)})
    return folder / "report.html"
