"""The stop certificate as one self-contained HTML page, to be read, printed and signed."""

import json
import math
import re
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from pathlib import Path

from workgauge.rehearse.certify.certificate import Certificate, JointStopping
from workgauge.rehearse.certify.outcome import Row
from workgauge.report.certificate_figures import left_figure, left_spark
from workgauge.report.certificate_words import ASSUMPTIONS, BREAKS, NOT_SAFETY, details, guaranteed, headline
from workgauge.report.writing import write_files

#: Failed drives named on the page.
_NAMED = 12
#: A command within a sentence.
_COMMAND = re.compile("`([^`]+)`")


def _cell(value: str, css: str = "") -> str:
    return f'<td class="{css}">{escape(value)}</td>' if css else f"<td>{escape(value)}</td>"


def _head(*columns: tuple[str, bool]) -> str:
    cells = "".join(f"<th{' class=n' if numeric else ''}>{escape(text)}</th>" for text, numeric in columns)
    return f"<thead><tr>{cells}</tr></thead>"


def _table(head: str, rows: Sequence[str]) -> str:
    return f'<div class="scroll"><table class="counts">{head}<tbody>{"".join(rows)}</tbody></table></div>'


def _metres(value: float | None, none: str = "–") -> str:
    return none if value is None else f"{value:.3f} m".replace("-", "\N{MINUS SIGN}")


def _share(part: float, whole: float) -> str:
    return f"{100.0 * part / whole:.1f} %" if whole > 0.0 else ""


def _list(sentences: Sequence[str]) -> str:
    items = (_COMMAND.sub(r"<code>\1</code>", escape(one)) for one in sentences)
    return '<ul class="plain">' + "".join(f"<li>{one}</li>" for one in items) + "</ul>"


def _tiles(certificate: Certificate) -> str:
    row = certificate.outcome.within
    tiles = [
        (str(row.drives), "drives within the stopping model"),
        (str(row.entered), "of them entered a limit"),
        (_metres(row.worst_clearance_m, "none near"), "smallest true clearance"),
        (_metres(row.worst_less_stop_m, "none near"), "the least left of a stop distance"),
        (_share(row.motion, row.free_motion), "of the way that the same levers make without a guard"),
        (_share(row.held_s, row.levers_s), "of the time at the levers lost at limits"),
    ]
    items = "".join(f"<li><b>{escape(big)}</b><span>{escape(small)}</span></li>" for big, small in tiles)
    return f'<ul class="tiles">{items}</ul>'


def _conditions(certificate: Certificate, within: bool) -> str:
    came = certificate.outcome
    rows = []
    for one, row in zip(came.conditions, came.by_condition, strict=True):
        if one.within is within:
            rows.append(
                f"<tr>{_cell(one.words)}{_numbers(row)}{_cell(_share(row.motion, row.free_motion), 'n')}</tr>"
            )
    head = _head(
        *(("the real machine", False), ("drives", True), ("entered", True), ("below stop", True)),
        *(("smallest clearance", True), ("least left", True), ("of the way", True)),
    )
    return _table(head, rows)


def _numbers(row: Row) -> str:
    counts = (_cell(str(count), "n") for count in (row.drives, row.entered, row.below))
    lengths = (_cell(_metres(value), "n") for value in (row.worst_clearance_m, row.worst_less_stop_m))
    return "".join((*counts, *lengths))


def _places(certificate: Certificate) -> str:
    came = certificate.outcome
    rows = [
        f"<tr>{_cell('own links' if kind == 'self' else kind.replace('_', ' '))}{_cell(link)}{_numbers(row)}"
        f"<td>{left_spark(came.edges_m, row.counts)}</td>{_cell(f'{row.held_s:.1f} s', 'n')}"
        f"{_cell(_share(row.held_s, came.within.levers_s), 'n')}</tr>"
        for kind, link, row in came.by_place
    ]
    head = _head(
        *(("limit", False), ("link", False), ("drives near", True), ("entered", True), ("below stop", True)),
        *(("smallest clearance", True), ("least left", True), ("distribution", False)),
        *(("time lost", True), ("of all", True)),
    )
    return _table(head, rows)


def _linear(certificate: Certificate) -> str:
    compared = certificate.outcome.compared
    if compared is None:
        return ""
    words = (
        f"Every fifth drive was also driven by linear scaling (Mäkinen), which does not know how a machine stops: of "
        f"these {compared.drives} it kept every stop distance on {compared.held}. This guard's way is "
        f"{_share(compared.motion, compared.linear_motion)} of linear scaling's on all of them"
    )
    held = _share(compared.held_motion, compared.held_linear_motion)
    return f"<p>{escape(words + (f', {held} on those where linear scaling held.' if held else '.'))}</p>"


def _beyond(certificate: Certificate) -> str:
    came = certificate.outcome
    if not came.beyond.drives:
        return "<p>Nothing beyond the model was driven.</p>"
    return _conditions(certificate, False) + left_figure(
        "What was left of the stop distance beyond the model", came.edges_m, came.beyond.counts, aside=True
    )


def _stopping(joints: Sequence[JointStopping]) -> str:
    rows = []
    for one in joints:
        scale, unit = (1.0, "m") if one.prismatic else (math.degrees(1.0), "°")
        model = one.stopping
        slowing = "at once" if math.isinf(model.deceleration) else f"{model.deceleration * scale:.1f} {unit}/s²"
        source = "; ".join(("to be confirmed",) * one.assumed + ((one.source,) if one.source else ()))
        rows.append(
            "<tr>"
            + _cell(f"{one.joint} {'−' if one.way == '-' else '+'}")
            + _cell(f"{one.full_speed * scale:.1f} {unit}/s", "n")
            + _cell(f"{model.dead_time_s:.3f} s", "n")
            + _cell(f"{model.lag_s:.3f} s", "n")
            + _cell(slowing, "n")
            + _cell(f"{100.0 * model.tolerance:.0f} %", "n")
            + _cell("ideal" if model.ideal else source)
            + "</tr>"
        )
    head = _head(
        *(("joint", False), ("full speed", True), ("dead time", True), ("lag", True), ("deceleration", True)),
        *(("tolerance", True), ("source", False)),
    )
    return _table(head, rows)


def _fingerprint(certificate: Certificate, again: str) -> str:
    told, came = certificate.fingerprint, certificate.outcome
    pairs = [
        ("machine", f"{told['machine']['name']}, {told['machine']['attachment']}", told["machine"]["sha256"]),
        ("rule book", told["rule book"]["name"], told["rule book"]["sha256"]),
        *(("site file", one["name"], one["sha256"]) for one in told["site"]["files"]),
        ("program", f"workgauge {told['program']['version']}", told["program"]["sha256"]),
        ("results", f"{came.within.drives + came.beyond.drives} drives", came.sha256),
        ("certificate", "everything it says", certificate.as_json()["id"]),
    ]
    rows = [f"<tr><th>{escape(a)}</th>{_cell(b)}{_cell(c, 'sum')}</tr>" for a, b, c in pairs]
    parameters = ", ".join(f"{key} {value}" for key, value in told["guard"]["parameters"].items())
    libraries = ", ".join(f"{key} {value}" for key, value in told["libraries"].items())
    rows += [
        f"<tr><th>guard</th>{_cell(told['guard']['name'])}{_cell(parameters)}</tr>",
        f"<tr><th>seed</th>{_cell(str(told['seed']))}{_cell(libraries)}</tr>",
    ]
    return (
        f"<table>{''.join(rows)}</table><p>The same certificate, to the last digit, comes from</p>"
        f'<p><code class="long">{escape(again)}</code></p>'
        "<p>run with the files and the program above; check sums are SHA-256.</p>"
    )


def _failed(certificate: Certificate) -> str:
    failed = certificate.outcome.failed
    if not failed:
        return ""
    named = ", ".join(f"{seed} ({key})" for key, seed in failed[:_NAMED])
    more = f" and {len(failed) - _NAMED} more" if len(failed) > _NAMED else ""
    return f"<p>Drives that failed: {escape(named + more)}.</p>"


def _sign() -> str:
    lines = ("Name", "Company, role", "Machine, serial number", "Work site", "Date", "Signature")
    return '<table class="sign">' + "".join(f"<tr><th>{line}</th><td></td></tr>" for line in lines) + "</table>"


def render(certificate: Certificate, again: str) -> str:
    """Return the whole page as HTML text; `again` is the command that makes it once more."""
    came, told = certificate.outcome, certificate.fingerprint
    style = files("workgauge").joinpath("shipped/report/style.css").read_text("utf-8")
    warned = ""
    if certificate.warnings:
        warned = (
            f'<section class="plainly"><h2>What it says nothing about</h2>{_list(certificate.warnings)}</section>'
        )
    where = f"{came.on_site} on the site, {came.within.drives - came.on_site} among random limits"
    raw = escape(json.dumps(certificate.as_json(), indent=2))
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Stop certificate: {escape(certificate.title)} · workgauge</title>
<style>{style}</style>
</head>
<body>
<main>
<header>
<p class="eyebrow">workgauge · stop certificate</p>
<h1>{escape(certificate.title)}</h1>
<p>Guard {escape(told["guard"]["name"])}, rule book {escape(told["rule book"]["name"])}, seed {told["seed"]}.
Certificate {escape(certificate.as_json()["id"][:16])}.</p>
</header>
<div class="verdict{"" if came.passed else " bad"}"><strong>{escape(headline(came))}</strong>
<p>{escape(details(certificate))}</p></div>
{_tiles(certificate)}
{warned}
<section>
<h2>What was left of the stop distance</h2>
<p>Of each drive within the model, the smallest true clearance less the stop distance that applies there
({told["drives"]["stop_distance_m"]:g} m unless a limit or the machine's own links name another). Left of the line is
overshoot. {escape(where)}.</p>
{left_figure("What was left of the stop distance within the model", came.edges_m, came.within.counts)}
{_failed(certificate)}
{_conditions(certificate, True)}
</section>
<section>
<h2>By kind of limit and link</h2>
<p>Clearances up to {told["drives"]["near_m"]:g} m beyond the stop distance, within the model. Time lost is the
share of the wished speed that the guard took, times how long.</p>
{_places(certificate)}
{_linear(certificate)}
</section>
<section>
<h2>Beyond the model</h2>
<p>What happens where the machine is worse than its file says. None of this is in the verdict.</p>
{_beyond(certificate)}
</section>
<section><h2>The stopping model</h2>{_stopping(certificate.joints)}</section>
<section><h2>What is guaranteed</h2><p>{escape(guaranteed(certificate))}</p>
<h2>As long as</h2>{_list(ASSUMPTIONS)}<h2>What breaks it</h2>{_list(BREAKS)}</section>
<section class="plainly"><h2>What this is not</h2><p>{NOT_SAFETY}</p></section>
<section><h2>Fingerprint</h2>{_fingerprint(certificate, again)}</section>
<section><h2>Read and accepted</h2>{_sign()}</section>
<details><summary>The certificate as JSON</summary><pre>{raw}</pre></details>
</main>
</body>
</html>
"""


def write_certificate(certificate: Certificate, folder: Path, again: str) -> Path:
    """Write `certificate.html` and `certificate.json` into `folder`, made if needed; nothing half-written is left.

    Args:
        certificate: what. folder: where. again: the command that makes the same certificate.

    Returns:
        the path of the page.

    Raises:
        InputError: if the folder cannot be made or written.
    """
    data = json.dumps(certificate.as_json(), indent=2, allow_nan=False) + "\n"
    write_files(folder, {"certificate.json": data, "certificate.html": render(certificate, again)})
    return folder / "certificate.html"
