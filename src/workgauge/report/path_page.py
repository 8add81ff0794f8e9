"""The page of `workgauge path`: bucket paths from above and lengthwise, and the sweep they will leave."""

import json
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from workgauge.machine.model import MachineModel
from workgauge.motion.bucket.dug import DugMap
from workgauge.motion.bucket.ways import Way
from workgauge.report.axes import label, ticks
from workgauge.report.dug_section import dug_figure
from workgauge.report.views import HEIGHT, NORTH, WIDTH, View
from workgauge.report.writing import write_files
from workgauge.site.surface.tin import Tin
from workgauge.values.arrays import Floats
from workgauge.values.transforms import apply

ROOM_M = 2.0
_LEFT, _TOP, _WIDE, _HIGH = 52.0, 14.0, 1180.0, 250.0


def write_path_report(
    folder: Path,
    data: Mapping[str, Any],
    tin: Tin,
    found: Sequence[Way],
    T_site_machine: Floats,
    origin: Floats,
    machine: MachineModel,
    planned: DugMap | None,
) -> Path:
    """Write `path.html` and `path.json` into a folder; nothing half-written is ever left there.

    Raises:
        InputError: if the folder cannot be made or written.
    """
    page = _page(data, tin, found, T_site_machine, origin, machine, planned)
    write_files(folder, {"path.json": json.dumps(data, indent=2) + "\n", "path.html": page})
    return folder / "path.html"


def _page(
    data: Mapping[str, Any],
    tin: Tin,
    found: Sequence[Way],
    T_site_machine: Floats,
    origin: Floats,
    machine: MachineModel,
    planned: DugMap | None,
) -> str:
    style = files("workgauge").joinpath("shipped/report/style.css").read_text("utf-8")
    reached = [way for way in found if way.joints is not None]
    length = sum(way.part.length_m for way in reached)
    warnings = "".join(f"<li>{escape(text)}</li>" for text in data["warnings"])
    sweep = ""
    if planned is not None:
        sweep = f"""<section><h2>What the edge will leave</h2>
<p>The edge's way as planned, above or below the surface in cells of {1e3 * planned.cell_m:.0f} mm: RMS
{1e3 * planned.rms_m:.1f} mm, deepest {1e3 * planned.deepest_m:.1f} mm. What the joints add is not in it.</p>
<figure>{dug_figure(planned)}</figure></section>"""
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>Bucket paths on {escape(tin.name)} · workgauge</title><style>{style}</style></head>
<body><main>
<header><p class="eyebrow">workgauge</p><h1>Bucket paths on {escape(tin.name)}</h1>
<p>{len(reached)} of {len(found)} paths in reach, {length:.2f} m in all. {escape(machine.title)}.</p></header>
<section><h2>From above</h2>
<figure><figcaption>Grid north up; edges of the surface's triangles, dots where a path crosses one</figcaption>
{_plan(tin, found, T_site_machine, origin, machine)}</figure></section>
<section><h2>Lengthwise</h2>{"".join(_profile(way) for way in found)}</section>
{sweep}
<section><h2>Paths</h2>{_table(found)}</section>
{f'<section><h2>Warnings</h2><ul class="plain">{warnings}</ul></section>' if warnings else ""}
</main></body></html>
"""


def _plan(tin: Tin, found: Sequence[Way], T_site_machine: Floats, origin: Floats, machine: MachineModel) -> str:
    """Return the paths among the surface's triangles, and the machine's undercarriage."""
    here = T_site_machine[:2, 3] + origin[:2]
    places = np.concatenate([here[None], *(way.part.points[:, :2] for way in found)])
    low, high = places.min(axis=0) - ROOM_M, places.max(axis=0) + ROOM_M
    view = View(
        "Bucket paths from above", (low + high) / 2, float(min(WIDTH / (high - low)[0], HEIGHT / (high - low)[1]))
    )
    reach = np.array([WIDTH, HEIGHT]) / view.scale / 2
    corners = tin.vertices[tin.faces][..., :2]
    low, high = view.centre - reach, view.centre + reach
    seen = (corners.max(axis=1) >= low).all(axis=1) & (corners.min(axis=1) <= high).all(axis=1)
    if seen.any():
        mesh = shapely.multipolygons([shapely.Polygon(triangle) for triangle in corners[seen]])
        view.shape(shapely.boundary(mesh), "mesh", tin.name)
    for solid in machine.solids:
        if solid.link == 0:
            signs = np.array([[x, y, 0.0] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
            box = apply(T_site_machine, apply(solid.T_link_box, signs * solid.half_extents))[:, :2] + origin[:2]
            view.shape(shapely.Polygon(box), "link now", solid.name)
    for way in found:
        css = "toolpath" if way.joints is not None else "designedpath"
        view.path(way.part.points[:, :2], css, f"line {way.line}, {way.part.length_m:.2f} m")
        for point in way.part.points[1:-1]:
            view.dot(point[:2], "crossing", f"height {point[2]:.3f} m")
        view.dot(way.part.points[0, :2], "tool-start", f"line {way.line} begins")
    return view.svg(NORTH)


def _profile(way: Way) -> str:
    """Return the height of a path by distance, its crossings, stretched upwards."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way.part.points, axis=0), axis=1))])
    z = way.part.points[:, 2]
    low, high = float(z.min()) - 0.1, float(z.max()) + 0.1
    wide, tall = _WIDE - _LEFT - 12.0, _HIGH - _TOP - 34.0
    x = _LEFT + along / along[-1] * wide
    y = _TOP + (high - z) / (high - low) * tall
    parts = [
        f'<text class="tick" x="{_LEFT - 6}" y="{_TOP + (high - mark) / (high - low) * tall + 4:.1f}" '
        f'text-anchor="end">{label(mark, 0.1)}</text>'
        for mark in ticks(low, high, 4)
    ]
    parts += [
        f'<text class="tick" x="{_LEFT + mark / along[-1] * wide:.1f}" y="{_HIGH - 14}" '
        f'text-anchor="middle">{label(mark, 0.5)} m</text>'
        for mark in ticks(0.0, float(along[-1]), 8)
    ]
    line = "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x, y, strict=True))
    css = "toolpath" if way.joints is not None else "designedpath"
    dots = "".join(f'<circle class="crossing" cx="{a:.1f}" cy="{b:.1f}" r="3"/>' for a, b in zip(x, y, strict=True))
    state = "" if way.joints is not None else f", not reached: {way.why}"
    title = f"Line {way.line}, {way.part.length_m:.2f} m{state}"
    return (
        f'<figure><figcaption>{escape(title)}; height [m]</figcaption><svg viewBox="0 0 {_WIDE:.0f} {_HIGH:.0f}" '
        f'role="img" aria-label="{escape(title)}"><path class="{css}" d="{line}"/>{dots}{"".join(parts)}</svg>'
        "</figure>"
    )


def _table(found: Sequence[Way]) -> str:
    heads = (
        "line",
        "length [m]",
        "edges crossed",
        "in reach",
        "edge off the surface up to [mm]",
        "below it by up to [mm]",
        "lifted by up to [mm]",
        "ends off by what joints cannot turn [mm]",
    )
    rows = []
    for way in found:
        numbers = [
            f"{way.line}",
            f"{way.part.length_m:.3f}",
            f"{max(len(way.part.points) - 2, 0)}",
            "yes" if way.joints is not None else "no",
            f"{1e3 * way.made.edge_m:.1f}",
            f"{1e3 * way.below_m:.1f}",
            f"{1e3 * way.made.lift_m:.1f}",
            "" if way.error is None else f"{1e3 * way.error.corner_m:.2f}",
        ]
        rows.append("<tr>" + "".join(f'<td class="n">{escape(text)}</td>' for text in numbers) + "</tr>")
    top = "".join(f'<th class="n">{escape(head)}</th>' for head in heads)
    return f'<div class="scroll"><table><thead><tr>{top}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'
