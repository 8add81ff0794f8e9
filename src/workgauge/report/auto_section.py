"""The page's section on automatic motion: its jobs, the way it went, and designed against driven over time."""

import math
from collections.abc import Sequence
from html import escape

from workgauge.rehearse.auto_series import AutoSeries, JobRun
from workgauge.rehearse.result import RunResult
from workgauge.report.auto_figures import (
    colour,
    error_figure,
    joint_figures,
    pace_figure,
    tool_figures,
    turning_figure,
)
from workgauge.report.auto_views import way_from_above, way_from_side, ways_apart
from workgauge.report.giving_way import Held, held_by

#: Heading of the table of jobs, and whether a column holds numbers.
JOB_COLUMNS = (
    ("job", False),
    ("state", False),
    ("planned [s]", True),
    ("driven [s]", True),
    ("error up to [m]", True),
    ("rms [m]", True),
    ("turned by up to [°]", True),
    ("held [s]", True),
    ("by", False),
)


def automatic_section(result: RunResult) -> str:
    """Return the sections of the page on automatic motion, empty where there was none."""
    auto = result.automatic
    if auto is None:
        return ""
    held = held_by(result)
    legend = _legend(result, held)
    views = "" if result.travel is not None else _views(result, auto)
    return f"""<section>
<h2>Automatic motion</h2>
<p>The tool's way as designed, and as it was driven. Designed is where the plan had it by then; the plan's time runs
slower where the machine cannot follow, so that this is an error of place, not of time. It is the way of the tool's
point; the attachment reaches farther. The machine is drawn faintly, as it stood nearest to a limit, at
{result.nearest.t_s:.2f} s.</p>
{views}
{_job_table(result, auto)}
</section>
<section>
<h2>Tracking error</h2>
<p>Distance and angle between the tool and where it was to be by then; of a goal without a plan, how far to go. Shaded
is where a limit held or bent the motion.</p>
{legend}
{error_figure(result, auto, held)}
{turning_figure(result, auto, held)}
<p>How fast the plan's time ran, and how much of the motion wanted was left before limits.</p>
{pace_figure(result, auto, held)}
</section>
<section>
<h2>The tool, designed and driven</h2>
<p>In the machine's frame: x forward, y left, z up; roll, pitch and yaw about its fixed axes x, y and z.</p>
{legend}
{_grid(_in_columns(tool_figures(result, auto, held)))}
</section>
<section>
<h2>The joints, designed and driven</h2>
<p>As the trajectory has them at that time, and as they were.</p>
{legend}
{_grid(joint_figures(result, auto, held))}
</section>"""


def _views(result: RunResult, auto: AutoSeries) -> str:
    """Return the tool's way from above and from the side."""
    side = way_from_side(result, auto)
    if ways_apart(result, auto):
        words = "From the side, where it gave way; limits are cut there"
    else:
        words = "From the side; limits are cut where the machine was nearest to one"
    return (
        f'<div class="two"><figure><figcaption>From above, grid north up</figcaption>{way_from_above(result, auto)}'
        f"</figure><figure><figcaption>{words}</figcaption>{side}</figure></div>{WAYS}"
    )


#: What the lines of the drawings are.
WAYS = (
    '<ul class="legend"><li><i class="design"></i>as designed</li><li><i class="path"></i>as driven</li>'
    '<li><i class="join"></i>the same moment, every half second</li></ul>'
)


def job_row(result: RunResult, job: JobRun) -> tuple[str, ...]:
    """Return the cells of a job's row, one for each of `JOB_COLUMNS`."""
    return (
        job.job,
        job.state.value,
        "" if math.isnan(job.planned_s) else f"{job.planned_s:.2f}",
        f"{job.ended_s - job.begun_s:.2f}",
        f"{job.max_error_m:.3f}",
        f"{job.rms_error_m:.3f}",
        f"{math.degrees(job.max_error_rad):.1f}",
        f"{job.held_s:.2f}",
        ", ".join(result.name_of(limit) for limit in job.against),
    )


def _job_table(result: RunResult, auto: AutoSeries) -> str:
    heads = "".join(f'<th class="n">{escape(h)}</th>' if n else f"<th>{escape(h)}</th>" for h, n in JOB_COLUMNS)
    rows = "".join(
        "<tr>"
        + "".join(
            f'<td class="n">{escape(cell)}</td>' if number else f"<td>{escape(cell)}</td>"
            for cell, (_, number) in zip(job_row(result, job), JOB_COLUMNS, strict=True)
        )
        + "</tr>"
        for job in auto.jobs
    )
    return (
        f'<div class="scroll"><table class="jobs"><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table></div>'
    )


def _legend(result: RunResult, held: Sequence[Held]) -> str:
    """Return which shade is which limit, for how long it held, and how far off the tool then was."""
    items = []
    for number, one in enumerate(held):
        off = "" if math.isnan(one.off_m) else f", up to {one.off_m:.2f} m off at {one.at_s:.2f} s"
        words = f"{result.name_of(one.limit)}: {one.seconds:.1f} s{off}"
        items.append(f'<li><i class="{colour(number)}"></i>{escape(words)}</li>')
    return f'<ul class="legend">{"".join(items)}</ul>' if items else ""


def _in_columns(figures: Sequence[str]) -> tuple[str, ...]:
    """Return two columns of figures as they are filled in row by row: places on the left, angles on the right."""
    half = len(figures) // 2
    return tuple(figure for pair in zip(figures[:half], figures[half:], strict=True) for figure in pair)


def _grid(figures: Sequence[str]) -> str:
    return '<div class="two">' + "".join(f"<figure>{figure}</figure>" for figure in figures) + "</div>"
