"""The tool's way as designed and as driven, from above and in the plane in which it gave way."""

import numpy as np
from numpy.typing import NDArray

from workgauge.rehearse.auto_series import AutoSeries
from workgauge.rehearse.result import RunResult
from workgauge.report.axes import runs_of_finite
from workgauge.report.giving_way import held_by, off_path
from workgauge.report.sections import plan_outline, vertical_section
from workgauge.report.views import HEIGHT, NORTH, WIDTH, View, draw_machine
from workgauge.values.arrays import Floats

#: Room round what is drawn [m].
ROOM_M = 0.8
#: Designed and driven places of the same moment are joined this often [s], if they are this far apart [m].
JOINED_S, JOINED_M = 0.5, 0.03
#: Nearer than this the tool is on its path [m].
SMALL_M = 0.02


class Ways:
    """The two ways in the site's local frame.

    Attributes:
        designed, driven: (n, 3), NaN where there was no job. off_m: (n,) between them on a planned way, else NaN.
        gave_way: (n,) whether the tool was off its path because of a limit: from where it left the path to where it
            was back on it. worst: the tick at which it was farthest off, None if it never was.
    """

    def __init__(self, result: RunResult, auto: AutoSeries) -> None:
        T = auto.T_site_machine
        self.off_m = off_path(auto)
        planned = np.isfinite(self.off_m)[:, None]
        self.designed = np.where(planned, auto.designed[:, :3] @ T[:3, :3].T + T[:3, 3], np.nan)
        self.driven = np.where((auto.which >= 0)[:, None], result.series.tool, np.nan)
        self.gave_way = _gave_way(result, self.off_m)
        self.worst = int(np.argmax(np.where(self.gave_way, self.off_m, -1.0))) if self.gave_way.any() else None
        self.joined = max(1, round(JOINED_S / result.tick_s))


def _gave_way(result: RunResult, off_m: Floats) -> NDArray[np.bool_]:
    """Return the stretches (n,) off the path in which a limit held the tool at least once."""
    t = result.series.t_s + 0.5 * result.tick_s
    spans = [span for one in held_by(result) for span in one.spans]
    held = np.zeros(len(t), dtype=np.bool_)
    for start, end in spans:
        held |= (t > start) & (t < end)
    gave_way = np.zeros(len(t), dtype=np.bool_)
    for stretch in runs_of_finite(np.where(off_m >= SMALL_M, off_m, np.nan)):
        gave_way[stretch] = held[stretch].any()
    return gave_way


def ways_apart(result: RunResult, auto: AutoSeries) -> bool:
    """Return whether a limit kept the tool off its path anywhere."""
    return Ways(result, auto).worst is not None


def way_from_above(result: RunResult, auto: AutoSeries) -> str:
    """Return the plan of the tool's way as designed and as driven, grid north up, with the limits."""
    ways = Ways(result, auto)
    flatten = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    view = _view("The tool's way from above, north up", result, ways, flatten, np.zeros(3))
    reach = 0.75 * max(WIDTH, HEIGHT) / view.scale
    for limit in result.limits:
        outline = plan_outline(limit.solid, np.append(view.centre, 0.0), reach)
        view.shape(outline, f"limit {limit.kind}", f"{limit.name} ({limit.id})")
    _draw(view, result, ways, flatten, np.zeros(3))
    return view.svg(NORTH)


def way_from_side(result: RunResult, auto: AutoSeries) -> str:
    """Return the tool's way where it gave way, seen square to the upright plane in which it did so most.

    Limits are cut in that plane. Where the tool did not give way, the whole of its way is shown, and limits are cut
    where the machine came nearest to one, square to its front. The machine's left is on the left.
    """
    ways = Ways(result, auto)
    place, direction = _plane(result, ways, auto)
    flatten = np.array([[direction[0], 0.0], [direction[1], 0.0], [0.0, 1.0]])
    origin = np.array([place[0], place[1], 0.0])
    view = _view("The tool's way from the side", result, ways, flatten, origin, ways.gave_way)
    reach = 0.75 * max(WIDTH, HEIGHT) / view.scale + abs(float(view.centre[0]))
    for limit in result.limits:
        section = vertical_section(limit.solid, np.append(place[:2], view.centre[1]), direction, reach)
        view.shape(section, f"limit {limit.kind}", f"{limit.name} ({limit.id})")
    _draw(view, result, ways, flatten, origin)
    return view.svg()


def _plane(result: RunResult, ways: Ways, auto: AutoSeries) -> tuple[Floats, Floats]:
    """Return a point (3,) of the side view's plane and its unit plan direction (2,), which points right."""
    right = -auto.T_site_machine[:2, 1]
    if ways.worst is None:
        near = result.nearest.point_limit
        return np.array(auto.T_site_machine[:3, 3] if near is None else near), right / np.linalg.norm(right)
    gap = ways.driven[ways.worst] - ways.designed[ways.worst]
    way = gap[:2] if np.linalg.norm(gap[:2]) > 0.3 * np.linalg.norm(gap) else right
    way = way if way @ right >= 0.0 else -way
    return ways.driven[ways.worst], way / np.linalg.norm(way)


def _view(
    title: str, result: RunResult, ways: Ways, flatten: Floats, origin: Floats, ticks: NDArray[np.bool_] | None = None
) -> View:
    """Return an empty drawing that shows both ways at some ticks; without any, all of them and the undercarriage."""
    if ticks is None or not ticks.any():
        both = np.concatenate([ways.designed, ways.driven, result.nearest.T_site_boxes[:1, :3, 3]])
    else:
        both = np.concatenate([ways.designed[ticks], ways.driven[ticks]])
    places = both[np.isfinite(both).all(axis=1)]
    flat = (places - origin) @ flatten
    low, high = flat.min(axis=0) - ROOM_M, flat.max(axis=0) + ROOM_M
    scale = float(min(WIDTH / (high[0] - low[0]), HEIGHT / (high[1] - low[1])))
    return View(title, (low + high) / 2, scale)


def _draw(view: View, result: RunResult, ways: Ways, flatten: Floats, origin: Floats) -> None:
    draw_machine(view, result.nearest, "faint", flatten, origin)
    designed, driven = (ways.designed - origin) @ flatten, (ways.driven - origin) @ flatten
    for k in range(0, len(driven), ways.joined):
        if ways.off_m[k] > JOINED_M:
            view.path(np.stack([designed[k], driven[k]]), "joined", f"{ways.off_m[k]:.2f} m")
    for places, css, words in ((driven, "toolpath", "as driven"), (designed, "designedpath", "as designed")):
        for part in runs_of_finite(places.sum(axis=1)):
            view.path(places[part], css, f"the tool's way {words}")
    known = np.flatnonzero(np.isfinite(driven[:, 0]))
    view.dot(driven[known[0]], "tool-start", "where it began")
    if ways.worst is not None:
        view.dot(driven[ways.worst], "gap-end", "where it gave way most")
        view.text(driven[ways.worst], f"{ways.off_m[ways.worst]:.2f} m off")
