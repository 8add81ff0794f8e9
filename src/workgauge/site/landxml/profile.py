"""The `Profile` of an alignment: PVI, CircCurve, ParaCurve and UnsymParaCurve."""

import math
from dataclasses import replace

import numpy as np

from workgauge.site.landxml.blocks import line_of
from workgauge.site.landxml.document import Document, Element, children, label, local
from workgauge.site.landxml.elements import LARGEST_M
from workgauge.site.landxml.heights import doubt_heights
from workgauge.site.landxml.numbers import LARGEST
from workgauge.site.landxml.units import FileUnits
from workgauge.site.profile import Profile, ProfileError, VerticalCurve, VerticalPoint, build_profile
from workgauge.values.errors import SiteError

_POINTS = ("PVI", "CircCurve", "ParaCurve", "UnsymParaCurve")
#: A stated arc length may differ from radius times turn by this share and this much [m] without a warning.
_ARC_SHARE, _ARC_M = 0.01, 0.05


def read_profile(
    document: Document, units: FileUnits, alignment: Element, owner: str, start: float, length: float
) -> Profile | None:
    """Return the first design profile of an alignment, or None if it has none.

    Args:
        start: station of the alignment's start [m]; profile stations count from it. length: of the alignment [m].

    Raises:
        SiteError: stations or heights that are no numbers, do not increase, or curves that overlap.
    """
    designs = [p for profile in children(alignment, "Profile") for p in children(profile, "ProfAlign")]
    filled = [d for d in designs if sum(1 for _ in children(d, *_POINTS)) >= 2]
    if len(filled) < len(designs):
        document.warn("a profile with fewer than two points is left out", owner)
    if not filled:
        return None
    if len(filled) > 1:
        document.warn(f"has {len(filled)} profiles; the first, {label(filled[0])}, is used", owner)
    points: list[VerticalPoint] = []
    for element in children(filled[0], *_POINTS):
        point = _point(document, units, element, start)
        if points and point.distance == points[-1].distance and point.height == points[-1].height:
            document.warn("repeats the point before it and is left out", f"{owner}: {local(element)}", point.line)
            continue
        points.append(point)
    heights = np.array([point.height for point in points])
    doubt_heights(document, units, heights, owner, line_of(filled[0]), lambda i: f"{points[i].distance:.3f} m")
    points = _fitted(document, points, owner)
    try:
        profile = build_profile(points)
    except ProfileError as error:
        raise SiteError(
            str(error),
            file=document.path,
            line=points[min(error.point, len(points) - 1)].line,
            element=f"{owner}: {label(filled[0])}",
        ) from error
    if profile.start > 0.01 or profile.end < length - 0.01:
        document.warn(
            f"the profile covers {profile.start:.3f} to {profile.end:.3f} m of {length:.3f} m; no height elsewhere",
            owner,
            line_of(filled[0]),
        )
    return profile


def _point(document: Document, units: FileUnits, element: Element, start: float) -> VerticalPoint:
    station, height = document.numbers(element, (2,))
    highest = LARGEST_M / units.elevation
    if abs(station) > LARGEST or abs(height) > highest:
        allowed = f"at most {LARGEST:g} and {highest:.3g} either way"
        raise document.error("station or height is too large", element, value=element.text, allowed=allowed)
    kind = local(element)
    curve = {"CircCurve": VerticalCurve.CIRCLE, "ParaCurve": VerticalCurve.PARABOLA}.get(kind, VerticalCurve.NONE)
    radius: float | None = None
    length_in = length_out = 0.0
    if kind in ("CircCurve", "ParaCurve"):
        length_in = length_out = (document.number(element, "length") or 0.0) / 2
    if kind == "CircCurve":
        stated = document.number(element, "radius")
        radius = None if not stated else abs(stated) * units.linear
    if kind == "UnsymParaCurve":
        curve = VerticalCurve.PARABOLA
        length_in = document.number(element, "lengthIn") or 0.0
        length_out = document.number(element, "lengthOut") or 0.0
    if length_in < 0 or length_out < 0:
        raise document.error("the length of a vertical curve must not be negative", element, value=length_in * 2)
    return VerticalPoint(
        station * units.linear - start,
        height * units.elevation,
        curve,
        radius,
        length_in * units.linear,
        length_out * units.linear,
        line_of(element),
    )


def _fitted(document: Document, points: list[VerticalPoint], owner: str) -> list[VerticalPoint]:
    """Return the points with every contradiction between an arc's length and its radius settled.

    The radius counts, unless its arc does not fit between the neighbouring points and one of the stated length does.
    """
    settled = list(points)
    for i, (a, b, c) in enumerate(zip(points, points[1:], points[2:], strict=False), start=1):
        stated = b.length_in + b.length_out
        if b.curve is not VerticalCurve.CIRCLE or not b.radius or not stated:
            continue
        room_in, room_out = b.distance - a.distance, c.distance - b.distance
        if room_in <= 0 or room_out <= 0:
            continue
        slopes = math.atan2(b.height - a.height, room_in), math.atan2(c.height - b.height, room_out)
        turn = abs(slopes[1] - slopes[0])
        measured = b.radius * turn
        if abs(measured - stated) <= _ARC_M + _ARC_SHARE * measured:
            continue
        shorter = measured / 2 > min(room_in, room_out) >= stated / 2
        if shorter:
            settled[i] = replace(b, radius=stated / turn)
        document.warn(
            f"length {stated:.3f} m stated, {measured:.3f} m by radius and grades; the "
            + ("length counts, as the radius leaves no room" if shorter else "radius counts"),
            f"{owner}: CircCurve",
            b.line,
        )
    return settled
