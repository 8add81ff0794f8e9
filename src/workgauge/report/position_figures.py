"""Believed against true position: clearance with its protection level, health over time, the way on the plan."""

import math
from html import escape

import numpy as np

from workgauge.rehearse.result import PositionSeries, RunResult, TravelSeries
from workgauge.report.axes import Chart
from workgauge.report.sections import plan_outline
from workgauge.report.views import HEIGHT, NORTH, WIDTH, View
from workgauge.values.arrays import Floats

#: What people call the states of health.
STATE_WORDS = {
    "fixed": "fixed",
    "float": "float",
    "dead_reckoning": "dead reckoning",
    "chassis_frozen": "undercarriage held",
    "stop": "stop: no position",
}

#: Clearances beyond this are not drawn [m].
TOP_M = 4.0


def position_section(result: RunResult) -> str:
    """Return the section of the page on position and travel, empty where sensors were perfect and nothing moved."""
    parts = []
    if result.position is not None:
        parts.append(_believed(result, result.position))
    if result.travel is not None:
        parts.append(_way(result, result.travel))
    return "".join(parts)


def _believed(result: RunResult, position: PositionSeries) -> str:
    facts = position.as_json(result.tick_s)
    worst, beyond = facts["worst_error_over_protection"], facts["ticks_beyond_protection"]
    share = "without bound" if worst is None else f"{100 * worst:.0f} %"
    held = "never beyond it" if not beyond else f"beyond it at {beyond} ticks"
    states = ", ".join(f"{STATE_WORDS.get(s, s)} {t:.2f} s" for s, t in position.seconds(result.tick_s).items())
    return (
        "<section><h2>Position: believed and true</h2>"
        "<p>The clearance nearest to being used up, as the program believed it, less and plus its protection level,"
        " and the true clearance of the same part of the machine to the same limit. Over all parts and limits in"
        f" sight at every tick the error came to {escape(share)} of its protection level at most, {held}.</p>"
        f"{believed_figure(result, position)}{health_figure(result, position)}"
        f'<p class="note">Health: {escape(states)}.</p></section>'
    )


def believed_figure(result: RunResult, position: PositionSeries) -> str:
    """Return believed clearance, its protection level to either side, and the truth, over time."""
    t = result.series.t_s
    low, high = position.believed_m - position.protection_m, position.believed_m + position.protection_m
    seen = np.concatenate([low, high, position.true_m])
    seen = seen[np.isfinite(seen)]
    top = min(float(seen.max(initial=0.5)), TOP_M) * 1.06
    bottom = min(0.0, float(seen.min(initial=0.0))) * 1.1
    span = 0.0, max(result.simulated_s, result.tick_s)
    chart = Chart("Believed and true clearance", "time [s]", "clearance [m]", span, (bottom, top))
    if bottom < 0:
        chart.band(bottom, 0.0, "bad")
    if result.stop_distance_m is not None:
        chart.threshold(result.stop_distance_m, f"p_l {result.stop_distance_m:.2f} m", "stop")
    chart.marks(result.steps)
    for values, css, name in (
        (low, "s0 wanted", "− protection"),
        (high, "s0 wanted", "+ protection"),
        (position.believed_m, "s0", "believed"),
        (position.true_m, "s3 main", "true"),
    ):
        chart.line(t, np.where(values <= top, values, np.nan), css, name)
    return chart.svg()


def health_figure(result: RunResult, position: PositionSeries) -> str:
    """Return the health of the position over time, and the 1-sigma of its pose."""
    t, tick_s = result.series.t_s, result.tick_s
    sigma, error = 1000.0 * position.sigma_m, 1000.0 * position.error_m
    known = np.concatenate([sigma, error])
    top = 1.15 * max(float(known[np.isfinite(known)].max(initial=0.0)), 10.0)
    span = 0.0, max(result.simulated_s, tick_s)
    chart = Chart("Health of the position", "time [s]", "position [mm]", span, (0.0, top), height=220)
    begin = 0
    for k in range(1, len(position.states) + 1):
        if k == len(position.states) or position.states[k] != position.states[begin]:
            state = position.states[begin]
            end = float(t[k - 1]) + tick_s
            chart.span(float(t[begin]), end, f"health {state}", f"{STATE_WORDS.get(state, state)} to {end:.2f} s")
            begin = k
    chart.line(t, sigma, "s0", "largest 1 sigma")
    chart.line(t, error, "s3", "true error")
    return chart.svg()


def _way(result: RunResult, travel: TravelSeries) -> str:
    tracks = "; ".join(f"{track or 'no track'} from {k * result.tick_s:.2f} s" for k, track in travel.tracks())
    return (
        "<section><h2>Travel</h2>"
        f"<p>{abs(float(travel.travelled_m[-1])):.2f} m, at {float(np.abs(travel.speed_m_s).max()):.2f} m/s at most."
        f" Believed to stand on: {escape(tracks)}.</p>"
        f'{speed_figure(result, travel)}<figure class="way">{way_view(result, travel)}</figure></section>'
    )


def speed_figure(result: RunResult, travel: TravelSeries) -> str:
    """Return the undercarriage's speed over time, what its driver wanted as a thin line."""
    span = 0.0, max(result.simulated_s, result.tick_s)
    both = np.concatenate([travel.wanted_m_s, travel.speed_m_s])
    top, low = max(float(both.max()), 0.0), min(float(both.min()), 0.0)
    room = 0.12 * max(top - low, 0.1)
    chart = Chart("Travel speed", "time [s]", "travel [m/s]", span, (low - room * (low < 0), top + room), height=200)
    chart.line(result.series.t_s, travel.wanted_m_s, "s7 wanted", "wanted")
    chart.line(result.series.t_s, travel.speed_m_s, "s0", "true")
    return chart.svg()


def way_view(result: RunResult, travel: TravelSeries) -> str:
    """Return the undercarriage's way from above, grid north up, with the limits along it."""
    low, high = travel.path.min(axis=0) - 12.0, travel.path.max(axis=0) + 12.0
    scale = float(min(WIDTH / (high[0] - low[0]), HEIGHT / (high[1] - low[1])))
    centre = (low + high) / 2
    view = View("The way, north up", centre, scale)
    reach = 0.5 * math.hypot(WIDTH, HEIGHT) / scale
    for limit in result.limits:
        outline = plan_outline(limit.solid, np.append(centre, 0.0), reach)
        view.shape(outline, f"limit {limit.kind}", f"{limit.name} ({limit.id})")
    view.path(_thinned(result.series.tool[:, :2]), "toolpath", "path of the tool centre point")
    view.path(_thinned(travel.path), "waypath", "way of the undercarriage")
    view.dot(travel.path[0], "tool-start", "undercarriage at the start")
    view.dot(travel.path[-1], "gap-end", "undercarriage at the end")
    return view.svg(NORTH)


def _thinned(points: Floats, most: int = 1500) -> Floats:
    """Return at most about so many of the points, the last among them."""
    step = max(1, len(points) // most)
    return np.concatenate([points[::step], points[-1:]])
