"""The `Cant` of an alignment; metres, millimetres, feet and inches told apart, and said."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from workgauge.site.cant import CantPoint, CantTable
from workgauge.site.landxml.blocks import line_of
from workgauge.site.landxml.document import Document, Element, children, label
from workgauge.site.landxml.elements import SPIRAL_TYPES
from workgauge.site.landxml.units import FileUnits
from workgauge.site.plan import PlanGeometry
from workgauge.site.transitions import Law
from workgauge.values.arrays import Floats
from workgauge.values.errors import SiteError

#: No track is canted by more [m].
LARGEST_CANT_M = 0.35
#: Nobody builds a track whose largest cant is less; smaller figures are in another unit [m].
SMALLEST_CANT_M = 0.010
#: In a table in millimetres, figures that would be a cant between this and the largest in metres are stray [m].
_STRAY_M = 0.005
#: A largest cant below this in the small unit is none, whatever unit the gauge is in [m].
_LEAST_SMALL_M = 0.001


@dataclass(frozen=True, slots=True)
class _Unit:
    name: str
    metres: float


_METRIC = (_Unit("meter", 1.0), _Unit("millimeter", 0.001))
_IMPERIAL = (_Unit("foot", 0.3048), _Unit("inch", 0.0254))


def read_cant(
    document: Document, units: FileUnits, alignment: Element, owner: str, start: float, plan: PlanGeometry
) -> tuple[CantTable | None, str | None]:
    """Return the cant table of an alignment and its unit's name, or (None, None).

    Args:
        start: station of the alignment's start [m]. plan: decides the side where the file does not.

    Raises:
        SiteError: cant in no plausible or in mixed units, stations that are no numbers or decrease.
    """
    tables = [t for t in children(alignment, "Cant") if next(children(t, "CantStation"), None) is not None]
    if not tables:
        return None, None
    if len(tables) > 1:
        document.warn(f"has {len(tables)} cant tables; the first, {label(tables[0])}, is used", owner)
    table = tables[0]
    stations = list(children(table, "CantStation"))
    applied = np.array([_number(document, s, "appliedCant") for s in stations])
    gauge_text = document.number(table, "gauge")
    gauge, gauge_small = _gauge(document, units, table, gauge_text, owner)
    unit = _unit(document, units, stations, applied, gauge_small, gauge is not None, owner)
    where = np.array([_number(document, s, "station") * units.linear - start for s in stations])
    if (np.diff(where) < 0).any():
        first = stations[int(np.argmax(np.diff(where) < 0)) + 1]
        raise document.error("cant stations must not decrease", first, value=first.get("station"))
    curvature = plan.at(where).curvature
    points = [
        CantPoint(
            float(where[i]),
            _sign(document, s, applied[i], curvature[i], owner) * float(applied[i]) * unit.metres,
            _law(document, s, owner),
        )
        for i, s in enumerate(stations)
    ]
    _compare(document, points, plan, owner, line_of(table))
    rotation = (table.get("rotationPoint") or "").strip() or None
    if rotation is None:
        document.warn("the cant table does not say what the track is turned about", owner, line_of(table))
    if applied.any():
        document.warn(f"cant is read in {unit.name} (largest {np.max(np.abs(applied)):g})", owner, line_of(table))
    return CantTable(points, gauge, rotation), unit.name


def _number(document: Document, element: Element, key: str) -> float:
    value = document.number(element, key)
    if value is None:
        raise document.error(f"has no {key}", element, allowed="a number")
    return value


def _gauge(
    document: Document, units: FileUnits, table: Element, gauge: float | None, owner: str
) -> tuple[float | None, bool]:
    """Return the gauge [m] and whether the file gives it in its small unit, millimetres or inches."""
    if gauge is None:
        document.warn("the cant table states no gauge", owner, line_of(table))
        return None, units.linear == 0.001
    for metres, is_mm in ((units.linear, units.linear == 0.001), (0.001, True), (1.0, False), (0.0254, False)):
        if 0.3 <= gauge * metres <= 2.5:
            value = gauge * metres
            if abs(value - 1.5) < 1e-3:
                document.warn(
                    "gauge 1.5 m is likely the distance between rail centres, not the gauge", owner, line_of(table)
                )
            # 1435 in a file of metres or feet, or 56.5 in one of feet, is in the small unit, as cant then is.
            return value, is_mm or units.linear == 0.001 or (metres == 0.0254 and units.system == "Imperial")
    raise document.error("no track has this gauge", table, value=gauge, allowed="0.3 to 2.5 m")


def _unit(
    document: Document,
    units: FileUnits,
    stations: Sequence[Element],
    applied: Floats,
    gauge_small: bool,
    has_gauge: bool,
    owner: str,
) -> _Unit:
    """Return the cant's unit.

    LandXML means millimetres (inches), Inframodel files are in metres. A gauge in millimetres (inches) decides; else
    the figures do, because no track is canted by more than 0.35 m and none has less than 10 mm as its largest cant.
    """
    large, small = _IMPERIAL if units.system == "Imperial" else _METRIC
    size = np.abs(applied)
    largest = float(size.max())
    worst = stations[int(np.argmax(size))]
    limits = (
        f"{SMALLEST_CANT_M / large.metres:.3g} to {LARGEST_CANT_M / large.metres:.3g} {large.name} or "
        f"{SMALLEST_CANT_M / small.metres:.3g} to {LARGEST_CANT_M / small.metres:.3g} {small.name} as the largest"
    )

    def refused(text: str, element: Element = worst, value: object = largest, allowed: str = limits) -> SiteError:
        return document.error(f"{owner}: {text}", element, value=value, allowed=allowed)

    if largest == 0:
        return small if gauge_small else large
    if largest * small.metres > LARGEST_CANT_M:
        raise refused(f"a cant of {largest:g} {small.name} is a unit error")
    large_fits = largest * large.metres <= LARGEST_CANT_M
    if gauge_small:
        if large_fits and largest * small.metres < _LEAST_SMALL_M:
            text = f"cant in {large.name} in a file whose gauge is in {small.name}"
            raise refused(text, allowed="one unit")
        _refuse_stray(size, large, small, stations, units, refused)
        return small
    if large_fits:
        if not has_gauge and largest * small.metres >= SMALLEST_CANT_M:
            text = f"a cant of {largest:g} may be in {large.name} or in {small.name}, and there is no gauge to tell"
            raise refused(text, allowed=f"a gauge in {large.name} or in {small.name}")
        return large
    if largest * small.metres < SMALLEST_CANT_M:
        raise refused(f"a cant of {largest:g} {large.name} is a unit error")
    _refuse_stray(size, large, small, stations, units, refused)
    return small


def _refuse_stray(
    size: Floats,
    large: _Unit,
    small: _Unit,
    stations: Sequence[Element],
    units: FileUnits,
    refused: Callable[..., SiteError],
) -> None:
    """Refuse single figures that are a cant in the large unit in a table in the small one."""
    stray = (size * large.metres > _STRAY_M) & (size * large.metres < LARGEST_CANT_M)
    if units.system != "Imperial" and stray.any():
        first = stations[int(np.argmax(stray))]
        raise refused(
            f"cant in {large.name} in a file whose other cant is in {small.name}",
            first,
            first.get("appliedCant"),
            f"one unit; elsewhere it is {float(size.max()):g}",
        )


def _sign(document: Document, station: Element, applied: float, curvature: float, owner: str) -> int:
    """Return +1 where the low rail is on the left, -1 where it is on the right."""
    rot = (station.get("curvature") or "").strip().lower()
    turn = {"ccw": 1, "cw": -1}.get(rot)
    if turn is None:
        turn = 1 if curvature >= 0 else -1
        if applied:
            document.warn(
                "does not say which way the curve turns; the side of the cant follows the plan",
                f"{owner}: CantStation {station.get('station')}",
                line_of(station),
            )
    if (station.get("adverse") or "").strip().lower() in ("true", "1") and applied > 0:
        document.warn(
            "is marked adverse; the low rail is on the outside",
            f"{owner}: CantStation {station.get('station')}",
            line_of(station),
        )
        turn = -turn
    return turn


def _law(document: Document, station: Element, owner: str) -> Law:
    text = (station.get("transitionType") or "").strip()
    if not text:
        return Law.CLOTHOID
    law = SPIRAL_TYPES.get(text.lower())
    if law is None:
        document.warn(
            f"unknown transition {text!r}; cant runs straight",
            f"{owner}: CantStation {station.get('station')}",
            line_of(station),
        )
        return Law.CLOTHOID
    return law


def _compare(
    document: Document, points: Sequence[CantPoint], plan: PlanGeometry, owner: str, line: int | None
) -> None:
    """Warn of cant against the curve and of cant that lies outside the alignment."""
    where = np.array([p.distance for p in points])
    cant = np.array([p.cant for p in points])
    inside = (where >= -0.01) & (where <= plan.length + 0.01)
    if not inside.all():
        document.warn(f"{int((~inside).sum())} of {len(points)} cant stations lie outside the alignment", owner, line)
    curvature = plan.at(where).curvature
    against = inside & (np.abs(cant) > 0.005) & (np.abs(curvature) > 1e-5) & (cant * curvature < 0)
    if against.any():
        document.warn(
            f"cant against the curve at {int(against.sum())} stations, the first at {where[against][0]:.3f} m",
            owner,
            line,
        )
    for end, value in (("begins", cant[0]), ("ends", cant[-1])):
        if abs(value) > 1e-6 and not (where[0] <= 0.01 if end == "begins" else where[-1] >= plan.length - 0.01):
            document.warn(f"the cant table {end} with {1000 * value:.1f} mm, which is carried on", owner, line)
