"""The report page: one self-contained HTML file with its pictures inside and no reference to anything outside."""

import json
from html import escape
from importlib.resources import files
from pathlib import Path

from workgauge.motion.job import JobState
from workgauge.rehearse.result import RunResult
from workgauge.report.auto_section import automatic_section
from workgauge.report.chatter_figures import chatter_section
from workgauge.report.dug_section import dug_section
from workgauge.report.figures import clearance_figure, scale_figure, speed_figure
from workgauge.report.position_figures import position_section
from workgauge.report.verdict import details, headline, metres
from workgauge.report.views import plan_view, side_view
from workgauge.report.writing import write_files

PLAINLY = (
    "workgauge assists the operator and records evidence. It is <strong>not a certified safety function</strong>: "
    "software of this kind claims no performance level, and the machine's certified stop stays in charge. What is "
    "shown here is a rehearsal on a simulated machine, and it holds for the assumptions listed below only."
)

KIND_WORDS = {
    "track": "track",
    "overhead_line": "overhead line",
    "point": "pole or other point",
    "line": "pipe, cable or other line",
    "surface": "surface (cut)",
    "zone": "zone",
}


def _cell(value: str, css: str = "") -> str:
    return f'<td class="{css}">{escape(value)}</td>' if css else f"<td>{escape(value)}</td>"


def _tiles(result: RunResult) -> str:
    tiles = [
        (metres(result.min_clearance_m), "smallest true clearance to a limit"),
        (str(len(result.entries)), "entries into a limit"),
        (f"{result.simulated_s:.2f} s", f"simulated, {result.ticks} ticks of {result.tick_s * 1000:g} ms"),
        (str(len(result.interventions)), "interventions"),
        *_automatic_tiles(result),
        (f"{result.tick_ms.p99:.2f} ms", f"tick, 99th percentile (median {result.tick_ms.p50:.2f} ms)"),
    ]
    return (
        '<ul class="tiles">'
        + "".join(f"<li><b>{escape(b)}</b><span>{escape(s)}</span></li>" for b, s in tiles)
        + "</ul>"
    )


def _automatic_tiles(result: RunResult) -> list[tuple[str, str]]:
    auto = result.automatic
    if auto is None:
        return []
    done = sum(job.state is JobState.DONE for job in auto.jobs)
    tiles = [(f"{done} of {len(auto.jobs)}", "jobs done")]
    over = auto.as_json()["driven_over_planned"]
    if over is not None:
        tiles.append((f"{over:.2f}", f"of the planned time: {auto.driven_s:.2f} s for {auto.planned_s:.2f} s"))
    return tiles


def _interventions(result: RunResult) -> str:
    if not result.interventions:
        return "<p>None: the machine moved as it was asked to.</p>"
    rows = []
    for cause in result.interventions:
        limit = "" if cause.limit is None else f"{result.name_of(cause.limit)} ({cause.limit})"
        rows.append(
            "<tr>"
            + _cell(f"{cause.t_s:.2f}–{cause.until_s:.2f}", "n")
            + _cell(cause.reason.replace("_", " "))
            + _cell(cause.link or cause.joint or "")
            + _cell(limit)
            + _cell("" if cause.clearance_m is None else f"{cause.clearance_m:.3f}", "n")
            + _cell("" if cause.scale is None else f"{100 * cause.scale:.1f}", "n")
            + "</tr>"
        )
    return (
        '<div class="scroll"><table><thead><tr><th class="n">from–to [s]</th><th>cause</th><th>link or joint</th>'
        '<th>limit</th><th class="n">least clearance [m]</th><th class="n">least speed left [%]</th></tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def _run_table(result: RunResult) -> str:
    own = "none in sight" if result.min_self_clearance_m is None else f"{result.min_self_clearance_m:.3f} m"
    if result.min_self_pair is not None:
        own += f" ({result.min_self_pair[0]} and {result.min_self_pair[1]})"
    tick = result.tick_ms
    rows = [
        *result.facts.items(),
        ("ticks", str(result.ticks)),
        ("simulated_s", f"{result.simulated_s:.3f}"),
        ("min_clearance_m", metres(result.min_clearance_m)),
        ("entries", str(len(result.entries))),
        ("interventions", str(len(result.interventions))),
        ("tick_ms", f"p50 {tick.p50:.3f}, p99 {tick.p99:.3f}, max {tick.max:.3f} (wall clock, this computer)"),
        ("min_self_clearance_m", own),
        ("self_entries", str(len(result.self_entries))),
    ]
    return "<table>" + "".join(f"<tr><th>{escape(k)}</th>{_cell(v)}</tr>" for k, v in rows) + "</table>"


def _legend(result: RunResult) -> str:
    items = [
        ("then", "machine at the start"),
        ("now", f"machine at {result.nearest.t_s:.2f} s, nearest"),
        ("path", "path of the tool"),
    ]
    kinds = {str(limit.kind) for limit in result.limits}
    items += [(kind, words) for kind, words in KIND_WORDS.items() if kind in kinds]
    return '<ul class="legend">' + "".join(f'<li><i class="{c}"></i>{escape(t)}</li>' for c, t in items) + "</ul>"


def _rule(result: RunResult) -> str:
    """Return in words how the guard slows an approach."""
    if result.slow_distance_m is not None:
        how = "Between p_u and p_l an approach is slowed in proportion"
    elif result.stop_distance_m is not None:
        how = "An approach is slowed as late as still stops in time"
    else:
        return "The guard of this run knows no limits."
    return f"{how}; at p_l it is refused. Moving away is never slowed."


def _asking(result: RunResult) -> str:
    """Return in words who asked for joint speeds."""
    return "the levers" if result.automatic is None else "automatic motion or the levers"


def _list(sentences: tuple[str, ...]) -> str:
    return '<ul class="plain">' + "".join(f"<li>{escape(s)}</li>" for s in sentences) + "</ul>"


def render(result: RunResult) -> str:
    """Return the whole page as HTML text."""
    verdict, good = headline(result)
    style = files("workgauge").joinpath("shipped/report/style.css").read_text("utf-8")
    warnings = f"<section><h2>Warnings</h2>{_list(result.warnings)}</section>" if result.warnings else ""
    raw = escape(json.dumps(result.as_json(), indent=2))
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(result.title)} · workgauge</title>
<style>{style}</style>
</head>
<body>
<main>
<header>
<p class="eyebrow">workgauge · rehearsal</p>
<h1>{escape(result.title)}</h1>
<p>{escape(result.description)}</p>
</header>
<div class="verdict{"" if good else " bad"}"><strong>{escape(verdict)}</strong><p>{escape(details(result))}</p></div>
{_tiles(result)}
<section>
<h2>Clearance</h2>
<p>True distance between the machine and the limits that came nearest. {_rule(result)}</p>
{clearance_figure(result)}
</section>
{automatic_section(result)}
{dug_section(result.dug)}
{position_section(result)}
<section>
<h2>Joint speeds</h2>
<p>What the guard let through; thin dashed lines are what {_asking(result)} asked for.</p>
{speed_figure(result)}
{scale_figure(result)}
</section>
{chatter_section(result)}
<section>
<h2>Where it happened</h2>
<div class="two">
<figure><figcaption>From above, grid north up</figcaption>{plan_view(result)}</figure>
<figure><figcaption>From the side, limits cut in the plane of the approach</figcaption>
{side_view(result)}</figure>
</div>
{_legend(result)}
</section>
<section><h2>Interventions</h2>{_interventions(result)}</section>
<section><h2>The run</h2>{_run_table(result)}</section>
{warnings}
<section class="plainly"><h2>What this is not</h2><p>{PLAINLY}</p></section>
<section><h2>Assumptions</h2>{_list(result.assumptions)}</section>
<details><summary>The run as JSON</summary><pre>{raw}</pre></details>
</main>
</body>
</html>
"""


def write_report(result: RunResult, folder: Path) -> Path:
    """Write `report.html` and `run.json` into `folder`, made if needed; nothing half-written is ever left there.

    Returns:
        the path of the page.

    Raises:
        InputError: if the folder cannot be made or written.
    """
    data = json.dumps(result.as_json(), indent=2) + "\n"
    write_files(folder, {"run.json": data, "report.html": render(result)})
    return folder / "report.html"
