"""`workgauge limits`: what the rule book makes of the site, checked against the exact envelope, exported."""

import os
import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from workgauge.app.output import facts, input_errors_exit_2, print_json, stderr, stdout, table, warn
from workgauge.app.site_commands import Epsg, Files, Json
from workgauge.gauge.build import LimitSet, build_limits
from workgauge.gauge.export import write_glb
from workgauge.gauge.rulebook import load_rule_book
from workgauge.gauge.rules import RuleBook
from workgauge.gauge.verify import verify_envelopes
from workgauge.site.model import SiteModel
from workgauge.site.read import read_site
from workgauge.values.errors import InputError
from workgauge.values.limits import Limit, LimitKind


def limits_object(limit_set: LimitSet) -> dict[str, Any]:
    """Return the documented object of `workgauge limits --json`, without `verify` and `export`."""
    counts = Counter(limit.kind for limit in limit_set.limits)
    return {
        "rules": limit_set.rules,
        "limits": len(limit_set.limits),
        "counts": {str(kind): counts[kind] for kind in LimitKind},
        "chainages": _chainages(limit_set.limits),
        "origin": {key: float(value) for key, value in zip("enz", limit_set.frame.origin, strict=True)},
        "warnings": list(limit_set.warnings),
    }


def _chainages(limits: Sequence[Limit]) -> list[dict[str, Any]]:
    """Return the chainage range of every limit that has one, in the limits' order."""
    return [
        {
            "id": limit.id,
            "name": limit.name,
            "kind": str(limit.kind),
            "rule": limit.rule,
            "from_m": round(limit.chainage[0], 3),
            "to_m": round(limit.chainage[1], 3),
        }
        for limit in limits
        if limit.chainage is not None
    ]


def _export(limit_set: LimitSet, path: Path) -> None:
    """Write the GLB beside its place first, so that nothing half-written is ever left there."""
    path = path.resolve()
    if path.exists() and not path.is_file():
        raise InputError("is not a regular file", file=path, element="--export", allowed="a file to be written")
    try:
        handle, name = tempfile.mkstemp(prefix=".limits-", suffix=".glb", dir=path.parent)
        os.close(handle)
        work = Path(name)
        try:
            write_glb(limit_set, work)
            work.chmod(0o644)
            work.replace(path)
        finally:
            work.unlink(missing_ok=True)
    except OSError as error:
        raise InputError("the export cannot be written there", file=path, value=error.strerror) from error


def _verify(site: SiteModel, book: RuleBook, limit_set: LimitSet) -> dict[str, float]:
    """Compare the limits with the exact swept envelope, with something to look at meanwhile."""
    console = stderr()
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        progress.add_task("comparing with the exact swept envelope", total=None)
        found = verify_envelopes(site, book, limit_set)
    return {"worst_uncovered_m": float(found.worst_uncovered_m), "worst_surplus_m": float(found.worst_surplus_m)}


@input_errors_exit_2
def limits_command(
    files: Files,
    rules: Annotated[
        str, typer.Option(metavar="R", help="Rule book: a file, or finland, germany, generic.")
    ] = "generic",
    export: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the limits as a GLB file.")] = None,
    verify: Annotated[bool, typer.Option("--verify", help="Compare with the exact swept envelope.")] = False,
    epsg: Epsg = None,
    as_json: Json = False,
) -> None:
    """Turn site files into limits and say what came of it."""
    book = load_rule_book(rules)
    site = read_site(files, epsg=epsg)
    limit_set = build_limits(site, book)
    data = limits_object(limit_set)
    data["warnings"] = [*site.warnings, *data["warnings"]]
    if verify:
        data["verify"] = _verify(site, book, limit_set)
    if export is not None:
        _export(limit_set, export)
        data["export"] = str(export)
    if as_json:
        print_json(data)
        return
    _show(data)
    warn(data["warnings"])


def _show(data: dict[str, Any]) -> None:
    console = stdout()
    counted = [(kind.replace("_", " "), f"{count:,}") for kind, count in data["counts"].items() if count]
    console.print(facts(f"{data['limits']:,} limits by the rule book {data['rules']}", counted))
    if data["chainages"]:
        shown = data["chainages"][:20]
        rows = [(c["name"], c["kind"].replace("_", " "), f"{c['from_m']:,.1f}", f"{c['to_m']:,.1f}") for c in shown]
        console.print()
        console.print(
            table("Chainages", [("limit", False), ("kind", False), ("from [m]", True), ("to [m]", True)], rows)
        )
        if len(data["chainages"]) > len(shown):
            console.print(f"… and {len(data['chainages']) - len(shown):,} more (--json lists all)", style="dim")
    if "verify" in data:
        worst = data["verify"]
        console.print()
        console.print(
            facts(
                "Against the exact swept envelope",
                [
                    ("worst uncovered", f"{worst['worst_uncovered_m'] * 1000:.1f} mm"),
                    ("worst surplus", f"{worst['worst_surplus_m'] * 1000:.1f} mm"),
                ],
            )
        )
    if "export" in data:
        console.print(f"\nwritten to {data['export']}")
