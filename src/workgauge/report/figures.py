"""The charts over time: clearance (Mäkinen's figure 4.4), joint speeds (figure 4.3), what the guard left of them."""

import numpy as np

from workgauge.rehearse.result import RunResult
from workgauge.report.axes import Chart
from workgauge.values.arrays import Floats


def _time_range(result: RunResult) -> tuple[float, float]:
    return 0.0, max(result.simulated_s, result.tick_s)


def clearance_figure(result: RunResult) -> str:
    """Return the true clearance to the nearest limits over time, with p_u and p_l, after figure 4.4.

    The limit that came nearest is drawn bold. The machine's own links are there where they held it or met.
    """
    series = result.series
    first = next(iter(series.by_limit.values()), series.true_m)
    seen = first[np.isfinite(first)]
    top = float(max(seen.max(initial=0.0), 1.2 * (result.slow_distance_m or 0.0), 0.5)) * 1.06
    own = own_links_matter(result)
    least = np.concatenate([seen, series.self_m[np.isfinite(series.self_m)]]) if own else seen
    low = float(min(0.0, least.min(initial=0.0))) * 1.1
    chart = Chart("True clearance over time", "time [s]", "clearance [m]", _time_range(result), (low, top))
    if low < 0:
        chart.band(low, 0.0, "bad")
    if result.stop_distance_m is not None:
        chart.band(0.0, result.stop_distance_m, "stop")
        chart.threshold(result.stop_distance_m, f"p_l {result.stop_distance_m:.2f} m", "stop")
    if result.slow_distance_m is not None:
        if result.stop_distance_m is not None:
            chart.band(result.stop_distance_m, result.slow_distance_m, "slow")
        chart.threshold(result.slow_distance_m, f"p_u {result.slow_distance_m:.2f} m", "slow")
    chart.marks(result.steps)
    if own:
        chart.line(series.t_s, np.where(series.self_m <= top, series.self_m, np.nan), "own", "its own links")
    for i, (limit, clearance) in reversed(list(enumerate(series.by_limit.items()))):
        shown = np.where(clearance <= top, clearance, np.nan)
        chart.line(series.t_s, shown, "s0 main" if i == 0 else f"s{i + 1} beside", result.name_of(limit))
    if result.min_clearance_m is not None:
        chart.dot(result.nearest.t_s, result.min_clearance_m, f"{result.min_clearance_m:.3f} m")
    return chart.svg()


def own_links_matter(result: RunResult) -> bool:
    """Return whether the machine's own links held it back, or entered each other."""
    held = any(cause.limit is not None and cause.limit.startswith("self:") for cause in result.interventions)
    return held or bool(result.self_entries)


def _speeds(result: RunResult, rates: Floats) -> Floats:
    """Return joint velocities for people: °/s for revolute joints, mm/s for prismatic ones."""
    factor = np.where(np.asarray(result.prismatic), 1000.0, np.degrees(1.0))
    return rates * factor


def speed_figure(result: RunResult) -> str:
    """Return every joint's speed over time, what the levers asked as a thin line, after figure 4.3."""
    wanted, allowed = _speeds(result, result.series.wanted), _speeds(result, result.series.allowed)
    reach = 1.12 * max(float(np.abs(wanted).max(initial=0.0)), float(np.abs(allowed).max(initial=0.0)), 1.0)
    unit = "joint speed [°/s]" if not any(result.prismatic) else "joint speed [°/s, mm/s]"
    chart = Chart("Joint speeds over time", "time [s]", unit, _time_range(result), (-reach, reach), height=370)
    chart.marks(result.steps)
    for j, name in enumerate(result.joint_names):
        chart.line(result.series.t_s, wanted[:, j], f"s{j % 8} wanted", f"{name}, asked for", tag=False)
    for j, name in enumerate(result.joint_names):
        chart.line(result.series.t_s, allowed[:, j], f"s{j % 8}", name)
    return chart.svg()


def scale_figure(result: RunResult) -> str:
    """Return the share of the wanted speed that the guard left, over time."""
    chart = Chart(
        "Share of the wanted speed left", "time [s]", "speed left [%]", _time_range(result), (0.0, 128.0), height=200
    )
    for cause in result.interventions:
        chart.span(cause.t_s, cause.until_s, "cause", cause.text)
    chart.marks(result.steps)
    chart.line(result.series.t_s, 100.0 * result.series.scale, "s0", "guard")
    return chart.svg()
