"""The elements of a `CoordGeom` as the file states them, in metres, east north; no geometry is judged here yet."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workgauge.site.landxml.blocks import line_of
from workgauge.site.landxml.document import Document, Element, child, label, local
from workgauge.site.landxml.numbers import HOW_TO_WRITE, fault, to_float
from workgauge.site.landxml.units import FileUnits
from workgauge.site.transitions import Law
from workgauge.site.units import LINEAR_UNITS
from workgauge.values.arrays import Floats

#: Laws by LandXML's `spiType`, lower case.
SPIRAL_TYPES: dict[str, Law] = {
    "clothoid": Law.CLOTHOID,
    "bloss": Law.BLOSS,
    "cosine": Law.COSINE,
    "sine": Law.SINE,
    "sinusoid": Law.SINE,
    "biquadratic": Law.BIQUADRATIC,
    "biquadraticparabola": Law.BIQUADRATIC,
    "cubic": Law.CUBIC_PARABOLA,
    "cubicparabola": Law.CUBIC_PARABOLA,
}
#: No easting, northing or height is larger, zone prefix included [m].
LARGEST_M = 1e8
#: No alignment turns more tightly [m].
SMALLEST_RADIUS_M = 0.01
_SPELLED = "bloss, biquadraticParabola, clothoid, cosine, cubic, cubicParabola, sine, sinusoid"


@dataclass(frozen=True, slots=True)
class StatedElement:
    """One element of a `CoordGeom`.

    Attributes:
        kind: `line`, `curve` or `spiral`. name: how to call it. line: in the file.
        start, end: absolute east, north, height [m]; height NaN if absent. centre, pi: likewise, or None.
        length, radius: as stated [m], or None. turn: +1 left (ccw), -1 right (cw), 0 for lines.
        law, k0, k1: of spirals, curvature signed [1/m].
    """

    kind: str
    name: str
    line: int | None
    start: Floats
    end: Floats
    centre: Floats | None = None
    pi: Floats | None = None
    length: float | None = None
    radius: float | None = None
    turn: int = 0
    law: Law = Law.CONSTANT
    k0: float = 0.0
    k1: float = 0.0


class PlaceReader:
    """Reads northing easting [height] places, by themselves or by reference to a `CgPoint`.

    Args:
        named: the `CgPoint` elements of the file by name; those that refer to others are followed when asked for.
    """

    def __init__(self, document: Document, units: FileUnits, named: Mapping[str, Sequence[Element]]) -> None:
        self._document = document
        self._units = units
        self._named = named
        self._doubted: set[str] = set()

    def place(self, element: Element) -> Floats:
        """Return (3,) absolute east, north, height [m]; the height is NaN where the file has none.

        Raises:
            SiteError: missing, not finite or too large coordinates, a reference to an unknown point or in a circle.
        """
        followed: list[str] = []
        at = element
        while not (at.text or "").strip() and (at.get("pntRef") or "").strip():
            name = str(at.get("pntRef")).strip()
            if name in followed:
                raise self._document.error("points refer to each other in a circle", element, value=name)
            followed.append(name)
            at = self._point(name, element)
        values = self._document.numbers(at, (2, 3))
        place: Floats = self.from_file(np.array([values]), at)[0]
        return place

    def _point(self, name: str, element: Element) -> Element:
        found = self._named.get(name)
        if not found:
            raise self._document.error("refers to a point that is not in the file", element, value=name)
        if name not in self._doubted and len({(e.text or "", e.get("pntRef")) for e in found}) > 1:
            self._doubted.add(name)
            self._document.warn(
                f"refers to {name!r}, as {len(found)} points are called; the first counts",
                label(element),
                line_of(element),
            )
        return found[0]

    def from_file(self, rows: Floats, element: Element) -> Floats:
        """Return rows (n, 2 or 3) northing, easting[, height] in file units as (n, 3) east, north, height [m].

        Raises:
            SiteError: coordinates that no map has; `element` is where they stand.
        """
        beyond = beyond_any_map(rows, self._units)
        if beyond.any():
            raise self._document.error(
                "coordinates beyond any map", element, value=f"{rows[beyond][0]:.9g}", allowed=map_limit(self._units)
            )
        height = rows[:, 2] * self._units.elevation if rows.shape[1] > 2 else np.full(len(rows), np.nan)
        return np.column_stack([rows[:, 1] * self._units.linear, rows[:, 0] * self._units.linear, height])

    def chain(self, element: Element) -> Floats:
        """Return the places (n, 3) of the points whose names, separated by spaces, are the text of a `Chain`.

        Raises:
            SiteError: a name that no point has.
        """
        names = (element.text or "").split()
        return np.array([self.place(self._point(name, element)) for name in names]).reshape(-1, 3)

    def child_place(self, element: Element, name: str) -> Floats | None:
        """Return the place in a child element, or None if there is no such child."""
        found = child(element, name)
        return None if found is None else self.place(found)

    def polyline(self, element: Element) -> Floats:
        """Return the places (n, 3) of a `PntList2D` or `PntList3D` element.

        Raises:
            SiteError: the count of numbers does not fit, or one is not finite.
        """
        width = 3 if local(element) == "PntList3D" else 2
        words = (element.text or "").split()
        wrong = fault(words)
        if wrong is not None or len(words) % width:
            raise self._document.error(
                "a list of points that cannot be read",
                element,
                value=f"{len(words)} numbers" if wrong is None else wrong,
                allowed=f"{width} finite numbers for each point; {HOW_TO_WRITE}",
            )
        values = np.array([to_float(word) for word in words], dtype=np.float64)
        return self.from_file(values.reshape(-1, width), element)


def beyond_any_map(rows: Floats, units: FileUnits) -> NDArray[np.bool_]:
    """Return where rows (n, 2 or 3) northing, easting[, height] in file units exceed what coordinates can be."""
    factors = np.array([units.linear, units.linear, units.elevation])[: rows.shape[1]]
    beyond: NDArray[np.bool_] = ~(np.abs(rows) <= LARGEST_M / factors)
    return beyond


def map_limit(units: FileUnits) -> str:
    """Return in words how large coordinates may be."""
    names = dict.fromkeys((units.names["linear"], units.names["elevation"]))
    limits = dict.fromkeys(f"{LARGEST_M / LINEAR_UNITS[name]:.3g} {name}" for name in names)
    return f"at most {' and heights of '.join(limits)} either way"


def read_element(document: Document, units: FileUnits, places: PlaceReader, element: Element) -> StatedElement:
    """Return a `Line`, `Curve` or `Spiral` as stated.

    Raises:
        SiteError: missing start or end, unknown rotation or spiral type, radius or length that make no sense.
    """
    kind = local(element).lower()
    ends = [places.child_place(element, name) for name in ("Start", "End")]
    for name, place in zip(("Start", "End"), ends, strict=True):
        if place is None:
            raise document.error(f"has no {name}", element, allowed="northing easting")
    start, end = ends
    assert start is not None and end is not None
    length = document.number(element, "length")
    length = None if length is None else length * units.linear
    name = label(element)
    if kind == "line":
        return StatedElement(kind, name, line_of(element), start, end, length=length)
    turn = _turn(document, element)
    if kind == "curve":
        radius = document.number(element, "radius")
        return StatedElement(
            kind,
            name,
            line_of(element),
            start,
            end,
            centre=places.child_place(element, "Center"),
            pi=places.child_place(element, "PI"),
            length=length,
            radius=None if radius is None else abs(radius) * units.linear,
            turn=turn,
        )
    if length is None or length <= 0:
        raise document.error("a spiral needs a positive length", element, value=element.get("length"))
    k0 = turn * _curvature(document, element, "radiusStart", units)
    k1 = turn * _curvature(document, element, "radiusEnd", units)
    law = _law(document, element)
    _check_constant(document, units, element, length, abs(k1 - k0), law)
    return StatedElement(
        kind,
        name,
        line_of(element),
        start,
        end,
        pi=places.child_place(element, "PI"),
        length=length,
        turn=turn,
        law=Law.CONSTANT if k0 == k1 else law,
        k0=k0,
        k1=k1,
    )


def _turn(document: Document, element: Element) -> int:
    turns = {"ccw": 1, "cw": -1}
    rot = (element.get("rot") or "").strip().lower()
    if rot not in turns:
        raise document.error("rot must say which way it turns", element, value=rot or "none", allowed="cw, ccw")
    return turns[rot]


def _law(document: Document, element: Element) -> Law:
    text = (element.get("spiType") or "").strip()
    law = SPIRAL_TYPES.get(text.lower())
    if law is None:
        raise document.error("unknown spiral type", element, value=text or "none", allowed=_SPELLED)
    return law


def _curvature(document: Document, element: Element, key: str, units: FileUnits) -> float:
    """Return 1/radius [1/m]; infinite, NaN, absent or zero radii are straight."""
    text = (element.get(key) or "").strip()
    try:
        radius = to_float(text) if text else math.inf
    except ValueError:
        raise document.error(f"{key} is no number", element, value=text, allowed="a radius or INF") from None
    if radius == 0:
        document.warn(f"{key} is 0; taken as straight", label(element), line_of(element))
    if radius == 0 or not math.isfinite(radius):
        return 0.0
    if abs(radius) * units.linear < SMALLEST_RADIUS_M:
        raise document.error(f"{key} is too small", element, value=text, allowed=f"at least {SMALLEST_RADIUS_M} m")
    return 1 / (abs(radius) * units.linear)


def _check_constant(
    document: Document, units: FileUnits, element: Element, length: float, change: float, law: Law
) -> None:
    """Compare the clothoid's parameter A with length and radii: A^2 = L / |k1 - k0|."""
    constant = document.number(element, "constant")
    if law is not Law.CLOTHOID or not constant or change == 0:
        return
    expected = math.sqrt(length / change)
    if abs(abs(constant) * units.linear / expected - 1) > 1e-3:
        document.warn(
            f"constant {constant:g} contradicts length and radii, which make it {expected / units.linear:.3f}; "
            "length and radii count",
            label(element),
            line_of(element),
        )
