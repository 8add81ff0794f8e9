"""Plan and side view of the machine among its limits, at the start and at the nearest moment."""

from dataclasses import dataclass, field
from html import escape

import numpy as np
from shapely import MultiPoint, get_parts
from shapely.geometry import LinearRing, LineString, Polygon
from shapely.geometry.base import BaseGeometry

from workgauge.rehearse.result import RunResult, Snapshot
from workgauge.report.axes import nice_step
from workgauge.report.sections import plan_outline, vertical_section
from workgauge.values.arrays import Floats
from workgauge.values.solids import Box

WIDTH, HEIGHT = 620, 470

#: The arrow of plans.
NORTH = (
    f'<g transform="translate({WIDTH - 26} 34)"><path class="north" d="M0 -20L7 8L0 3L-7 8Z"/>'
    '<text class="tick" y="24" text-anchor="middle">N</text></g>'
)


@dataclass
class View:
    """A drawing to scale: the same metres per pixel both ways, y up.

    Attributes:
        title: for screen readers. centre: (2,) drawing coordinates in the middle. scale: pixels per metre.
    """

    title: str
    centre: Floats
    scale: float
    parts: list[str] = field(default_factory=list)

    def xy(self, points: Floats) -> Floats:
        """Return pixels (n, 2) of drawing coordinates (n, 2)."""
        middle, scale = np.array([WIDTH / 2, HEIGHT / 2]), np.array([self.scale, -self.scale])
        return np.asarray(middle + (np.atleast_2d(points) - self.centre) * scale, dtype=np.float64)

    def _path(self, points: Floats, close: bool) -> str:
        return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in self.xy(points)) + ("Z" if close else "")

    def shape(self, geometry: BaseGeometry, css: str, title: str) -> None:
        """Draw polygons and lines of a geometry."""
        steps: list[str] = []
        for part in get_parts(geometry):
            if isinstance(part, Polygon):
                rings = (part.exterior, *part.interiors)
                steps.extend(self._path(np.asarray(ring.coords)[:-1, :2], True) for ring in rings)
            elif isinstance(part, LineString | LinearRing):
                steps.append(self._path(np.asarray(part.coords)[:, :2], False))
        if steps:
            self.parts.append(
                f'<path class="{css}" fill-rule="evenodd" d="{"".join(steps)}"><title>{escape(title)}</title></path>'
            )

    def path(self, points: Floats, css: str, title: str) -> None:
        """Draw an open line through points (n, 2)."""
        if len(points) > 1:
            self.parts.append(
                f'<path class="{css}" d="{self._path(points, False)}"><title>{escape(title)}</title></path>'
            )

    def dot(self, point: Floats, css: str, title: str) -> None:
        """Draw a dot."""
        ((x, y),) = self.xy(point)
        self.parts.append(
            f'<circle class="{css}" cx="{x:.1f}" cy="{y:.1f}" r="3.5"><title>{escape(title)}</title></circle>'
        )

    def text(self, point: Floats, words: str) -> None:
        """Write words beside a point."""
        ((x, y),) = self.xy(point)
        left = x > WIDTH / 2
        anchor, shift = ("end", -9.0) if left else ("start", 9.0)
        self.parts.append(
            f'<text class="callout" text-anchor="{anchor}" x="{x + shift:.1f}" y="{y - 12:.1f}">'
            f"{escape(words)}</text>"
        )

    def _scale_bar(self) -> str:
        length = nice_step(WIDTH / self.scale, 6)
        x1, y = 18, HEIGHT - 18
        x2 = x1 + length * self.scale
        return (
            f'<path class="scalebar" d="M{x1} {y - 5}V{y}H{x2:.1f}V{y - 5}"/>'
            f'<text class="tick" x="{(x1 + x2) / 2:.1f}" y="{y - 7}" text-anchor="middle">{length:g} m</text>'
        )

    def svg(self, extra: str = "") -> str:
        """Return the finished picture, clipped to its frame."""
        return (
            f'<svg class="view" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" '
            f'aria-label="{escape(self.title, quote=True)}">\n'
            + "\n".join(self.parts)
            + self._scale_bar()
            + extra
            + "\n</svg>"
        )


def _boxes(snapshot: Snapshot) -> list[tuple[str, Floats]]:
    """Return (name, corners (8, 3)) of each link box."""
    return [
        (name, Box(T, h).vertices)
        for name, T, h in zip(snapshot.names, snapshot.T_site_boxes, snapshot.half_extents, strict=True)
    ]


def draw_machine(view: View, snapshot: Snapshot, css: str, flatten: Floats, origin: Floats) -> None:
    """Draw the silhouettes of the link boxes; `flatten` (3, 2) maps site coordinates to drawing coordinates."""
    for name, corners in _boxes(snapshot):
        view.shape(
            MultiPoint((corners - origin) @ flatten).convex_hull, f"link {css}", f"{name} at {snapshot.t_s:.2f} s"
        )


def _extent(result: RunResult, flatten: Floats, origin: Floats) -> tuple[Floats, float]:
    """Return the middle and the pixels per metre that show both machines, the tool's path and the closest pair."""
    moments = (result.start, result.nearest) if result.travel is None else (result.nearest,)
    points = [corners for moment in moments for _, corners in _boxes(moment)]
    if result.travel is None:  # else only the place of the nearest moment
        points.append(result.series.tool)
    points += [point[None] for point in (result.nearest.point_limit,) if point is not None]
    flat = (np.concatenate(points) - origin) @ flatten
    low, high = flat.min(axis=0) - 1.5, flat.max(axis=0) + 1.5
    scale = float(min(WIDTH / (high[0] - low[0]), HEIGHT / (high[1] - low[1])))
    return (low + high) / 2, scale


def _draw_motion(view: View, result: RunResult, flatten: Floats, origin: Floats) -> None:
    draw_machine(view, result.nearest, "now", flatten, origin)
    draw_machine(view, result.start, "then", flatten, origin)
    tool = (result.series.tool - origin) @ flatten
    view.path(tool, "toolpath", "path of the tool centre point")
    view.dot(tool[0], "tool-start", "tool at the start")
    near = result.nearest
    if near.point_machine is not None and near.point_limit is not None and near.clearance_m is not None:
        pair = (np.stack([near.point_machine, near.point_limit]) - origin) @ flatten
        view.path(pair, "gap", f"clearance {near.clearance_m:.3f} m")
        view.dot(pair[0], "gap-end", "closest point of the machine")
        view.dot(pair[1], "gap-end", "closest point of the limit")
        view.text(pair.mean(axis=0), f"{result.name_of(near.limit)}: {near.clearance_m:.3f} m")


def plan_view(result: RunResult) -> str:
    """Return the view from above, grid north up."""
    flatten, origin = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]), np.zeros(3)
    centre, scale = _extent(result, flatten, origin)
    view = View("Plan view, north up", centre, scale)
    reach = 0.75 * max(WIDTH, HEIGHT) / scale
    for limit in result.limits:
        outline = plan_outline(limit.solid, np.append(centre, 0.0), reach)
        view.shape(outline, f"limit {limit.kind}", f"{limit.name} ({limit.id})")
    _draw_motion(view, result, flatten, origin)
    return view.svg(NORTH)


def side_direction(result: RunResult) -> Floats:
    """Return the unit plan direction (2,) of the side view, pointing at the nearest limit.

    It is the way of the smallest clearance, so that the gap is seen in its true length; where that goes up or down,
    the way from the machine to the place, and without any limit the machine's front.
    """
    near = result.nearest
    base = near.T_site_boxes[0]
    ways = [base[:2, 0]]
    if near.point_limit is not None and near.point_machine is not None and near.clearance_m is not None:
        ways.insert(0, (near.point_limit - base[:3, 3])[:2])
        gap = (near.point_limit - near.point_machine) * np.sign(near.clearance_m)
        if np.linalg.norm(gap[:2]) > 0.5 * np.linalg.norm(gap):
            ways.insert(0, gap[:2])
    way = next((way for way in ways if np.linalg.norm(way) > 1e-6), np.array([1.0, 0.0]))
    return np.asarray(way / np.linalg.norm(way), dtype=np.float64)


def side_view(result: RunResult) -> str:
    """Return the view along the horizontal, square to the upright plane in which the machine is nearest to a limit.

    Limits are cut by that plane, which stands on the closest point; the machine is drawn in silhouette.
    """
    direction = side_direction(result)
    near = result.nearest
    origin = np.array(near.T_site_boxes[0][:3, 3] if near.point_limit is None else near.point_limit)
    flatten = np.array([[direction[0], 0.0], [direction[1], 0.0], [0.0, 1.0]])
    shift = np.array([origin[0], origin[1], 0.0])
    centre, scale = _extent(result, flatten, shift)
    reach = 0.75 * max(WIDTH, HEIGHT) / scale
    middle = np.array([*(origin[:2] + centre[0] * direction), centre[1]])
    view = View("Side view", np.array([0.0, centre[1]]), scale)
    for limit in result.limits:
        section = vertical_section(limit.solid, middle, direction, reach)
        view.shape(section, f"limit {limit.kind}", f"{limit.name} ({limit.id})")
    shift = np.array([middle[0], middle[1], 0.0])
    _draw_motion(view, result, flatten, shift)
    return view.svg()
