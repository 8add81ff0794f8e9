"""Designed against driven over time: the tool's pose, the joints, and how far apart they were, after Mäkinen."""

from collections.abc import Sequence

import numpy as np

from workgauge.rehearse.auto_series import AutoSeries
from workgauge.rehearse.result import RunResult
from workgauge.report.axes import Chart
from workgauge.report.giving_way import Held, off_path
from workgauge.values.arrays import Floats

#: Of charts that stand side by side [px].
WIDTH, HEIGHT = 480, 180
#: Least height of a scale, so that a tenth of it is not drawn large.
LEAST_M, LEAST_DEG, LEAST_MM = 0.2, 5.0, 100.0
#: Colours of the limits that held.
COLOURS = 4


def colour(number: int) -> str:
    """Return the class of a limit's shade, by its place in the list."""
    return f"h{min(number, COLOURS - 1)}"


def shade(chart: Chart, result: RunResult, held: Sequence[Held]) -> None:
    """Shade the stretches in which limits held automatic motion, with their names as tooltips."""
    for number, one in enumerate(held):
        for start, end in one.spans:
            name = f"{result.name_of(one.limit)}, {start:.2f} to {end:.2f} s"
            chart.span(start, end, f"held {colour(number)}", name)


def _time(result: RunResult) -> tuple[float, float]:
    return 0.0, max(result.simulated_s, result.tick_s)


def _range(values: Floats, least: float) -> tuple[float, float]:
    """Return a range for the finite ones of the values, with a little room, no narrower than `least`."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    room = max(0.08 * (high - low), 0.5 * (least - (high - low)))
    return low - room, high + room


def _pair(
    result: RunResult, held: Sequence[Held], words: str, unit: str, designed: Floats, driven: Floats, least: float
) -> str:
    """Return a small chart of one quantity as designed and as driven."""
    span = _range(np.concatenate([designed, driven]), least)
    title = f"{words}, designed and driven"
    chart = Chart(title, "time [s]", f"{words} [{unit}]", _time(result), span, WIDTH, HEIGHT)
    shade(chart, result, held)
    chart.line(result.series.t_s, driven, "driven", "driven")
    chart.line(result.series.t_s, designed, "designed", "designed")
    return chart.svg()


def tool_figures(result: RunResult, auto: AutoSeries, held: Sequence[Held]) -> tuple[str, ...]:
    """Return six charts of the tool in the machine's frame: x, y, z and roll, pitch, yaw, after figure 4.8.

    Turns of driven angles by whole circles are those nearest to the designed ones.
    """
    shift = np.round((auto.driven[:, 3:] - auto.designed[:, 3:]) / (2 * np.pi))
    whole = np.where(np.isfinite(shift), 2 * np.pi * shift, 2 * np.pi * _first(shift))
    driven = np.column_stack([auto.driven[:, :3], np.degrees(auto.driven[:, 3:] - whole)])
    designed = np.column_stack([auto.designed[:, :3], np.degrees(auto.designed[:, 3:])])
    names = ("x", "y", "z", "roll", "pitch", "yaw")
    return tuple(
        _pair(
            *(result, held, name, "m" if k < 3 else "°", designed[:, k], driven[:, k]),
            LEAST_M if k < 3 else LEAST_DEG,
        )
        for k, name in enumerate(names)
    )


def _first(columns: Floats) -> Floats:
    """Return the first finite value of each column (n, k), 0 for none."""
    known = np.isfinite(columns)
    return np.where(known.any(axis=0), columns[np.argmax(known, axis=0), np.arange(columns.shape[1])], 0.0)


def joint_figures(result: RunResult, auto: AutoSeries, held: Sequence[Held]) -> tuple[str, ...]:
    """Return a chart for every joint, as its trajectory has it and as it was driven, after figure 4.9."""
    found = []
    for j, (name, slides) in enumerate(zip(result.joint_names, result.prismatic, strict=True)):
        factor, unit, least = (1000.0, "mm", LEAST_MM) if slides else (float(np.degrees(1.0)), "°", LEAST_DEG)
        driven = factor * result.series.q[:, j]
        found.append(_pair(result, held, name, unit, factor * auto.designed_q[:, j], driven, least))
    return tuple(found)


def error_figure(result: RunResult, auto: AutoSeries, held: Sequence[Held]) -> str:
    """Return how far the tool was from where it was to be by then, over time; on its way to a goal, how far to go."""
    error = np.where(auto.which >= 0, auto.error_m, np.nan)
    top = 1.15 * max(float(np.nan_to_num(error).max(initial=0.0)), 0.05)
    chart = Chart("Tracking error of the tool", "time [s]", "off by [m]", _time(result), (0.0, top), height=280)
    shade(chart, result, held)
    chart.marks(_jobs(result, auto))
    chart.line(result.series.t_s, error, "driven main", "tool")
    off = off_path(auto)
    if np.isfinite(off).any():
        worst = int(np.nanargmax(off))
        chart.dot(float(result.series.t_s[worst]), float(off[worst]), f"{off[worst]:.3f} m")
    return chart.svg()


def turning_figure(result: RunResult, auto: AutoSeries, held: Sequence[Held]) -> str:
    """Return how far the tool was turned from how it was to be by then, over time."""
    error = np.degrees(np.where(auto.which >= 0, auto.error_rad, np.nan))
    top = 1.15 * max(float(np.nan_to_num(error).max(initial=0.0)), 1.0)
    chart = Chart(
        "Orientation error of the tool", "time [s]", "turned by [°]", _time(result), (0.0, top), height=HEIGHT
    )
    shade(chart, result, held)
    chart.line(result.series.t_s, error, "driven", "tool")
    return chart.svg()


def pace_figure(result: RunResult, auto: AutoSeries, held: Sequence[Held]) -> str:
    """Return how fast the plan's time ran, and how much of what was wanted limits left, over time."""
    running = np.isfinite(off_path(auto))
    chart = Chart("Pace", "time [s]", "share [%]", _time(result), (0.0, 118.0), height=HEIGHT)
    shade(chart, result, held)
    chart.line(result.series.t_s, 100.0 * np.where(auto.which >= 0, auto.left, np.nan), "left", "left by limits")
    chart.line(result.series.t_s, 100.0 * np.where(running, auto.rate, np.nan), "driven", "plan's time")
    return chart.svg()


def _jobs(result: RunResult, auto: AutoSeries) -> list[tuple[str, float]]:
    """Return (words, start [s]) of the jobs, and where nothing was left to do."""
    places = [(job.job, job.begun_s) for job in auto.jobs]
    ended = max(job.ended_s for job in auto.jobs)
    return places if ended >= result.simulated_s - 2 * result.tick_s else [*places, ("", ended)]
