"""Geometry of the shipped example site: two tracks, poles, wires, trackside and terrain, from closed forms.

Evaluated with Fresnel integrals and circles, without the package's own readers, so that reading the written files
back is a real check. Coordinates are local: x east and y north of `ORIGIN`, yaw counter-clockwise from east, offsets
positive to the left, metres and radians.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq
from scipy.special import fresnel

Floats = NDArray[np.float64]

ORIGIN = np.array([25486800.0, 6714300.0, 0.0])  # E, N of the start of Track 1; heights are absolute
START_YAW = math.radians(90.0 - 63.0)
SPACING = 4.5  # between the tracks on the straight
RAIL_BASE = 1.6  # between the rail heads' centres, gauge 1.524
BALLAST_BELOW_RAIL, BALLAST_HALF_WIDTH, FORMATION_BELOW_RAIL, FORMATION_EDGE = 0.25, 1.75, 0.80, 4.0
WIRE_HEIGHT, STAGGER = 6.15, 0.30
POLE_SPACING, FIRST_POLE = 50.0, 25.0
SECTION_STEP, SURFACE_HALF_WIDTH = 10.0, 25.0


@dataclass(frozen=True)
class Element:
    """A line, arc or clothoid from x, y, yaw with curvature from k0 to k1; clothoids begin or end straight."""

    x: float
    y: float
    yaw: float
    length: float
    k0: float
    k1: float

    def at(self, s: ArrayLike) -> Floats:
        """Return (n, 4): x, y, yaw, curvature at the distances s (n,) from the element's start."""
        s = np.atleast_1d(np.asarray(s, dtype=np.float64))
        yaw = self.yaw + s * (self.k0 + s * (self.k1 - self.k0) / (2 * self.length))
        if self.k0 == self.k1 == 0:
            forward, left = s, np.zeros_like(s)
        elif self.k0 == self.k1:
            forward, left = np.sin(self.k0 * s) / self.k0, (1 - np.cos(self.k0 * s)) / self.k0
        elif self.k0 == 0:
            forward, left = clothoid(s, self.k1 / self.length)
        else:  # walked from its straight end, backwards
            end_yaw = self.yaw + self.length * self.k0 / 2
            ahead, aside = clothoid(np.append(self.length, self.length - s), self.k0 / self.length)
            turned = rotate(np.column_stack([-ahead, aside]), end_yaw - self.yaw)
            forward, left = (turned[1:] - turned[0]).T
        xy = rotate(np.column_stack([forward, left]), self.yaw) + np.array([self.x, self.y])
        return np.column_stack([xy, yaw, self.k0 + (self.k1 - self.k0) * s / self.length])


@dataclass(frozen=True)
class Track:
    """A track: plan elements, vertical intersection points (distance, height, radius or 0), (distance, cant)."""

    name: str
    code: str
    elements: tuple[Element, ...]
    pvis: tuple[tuple[float, float, float], ...]
    cants: tuple[tuple[float, float], ...]

    @property
    def starts(self) -> Floats:
        """Distances at which the elements begin, and the whole length."""
        return np.cumsum([0.0] + [element.length for element in self.elements])

    @property
    def length(self) -> float:
        """Length in plan."""
        return float(self.starts[-1])

    def at(self, distances: ArrayLike) -> Floats:
        """Return (n, 6): x, y, yaw, curvature, height of the low rail, cant at the distances (n,)."""
        d = np.atleast_1d(np.asarray(distances, dtype=np.float64))
        which = np.clip(np.searchsorted(self.starts, d, side="right") - 1, 0, len(self.elements) - 1)
        plan = np.empty((len(d), 4))
        for index, element in enumerate(self.elements):
            here = which == index
            plan[here] = element.at(d[here] - self.starts[index])
        cant = np.interp(d, [place for place, _ in self.cants], [value for _, value in self.cants])
        return np.column_stack([plan, height(self.pvis, d), cant])

    def offset(self, distances: ArrayLike, left: ArrayLike) -> Floats:
        """Return the plan points (n, 2) that lie `left` of the track at the distances."""
        state = self.at(distances)
        aside = np.column_stack([-np.sin(state[:, 2]), np.cos(state[:, 2])])
        moved: Floats = state[:, :2] + aside * np.reshape(left, (-1, 1))
        return moved

    def opposite(self, x: float, y: float, near: float) -> float:
        """Return the distance, within 30 m of `near`, at which (x, y) lies square to the track."""

        def along(distance: float) -> float:
            state = self.at(distance)[0]
            return float((x - state[0]) * math.cos(state[2]) + (y - state[1]) * math.sin(state[2]))

        low, high = max(near - 30.0, 0.0), min(near + 30.0, self.length)
        if along(low) <= 0:
            return low
        return high if along(high) >= 0 else float(brentq(along, low, high, xtol=1e-10))


def clothoid(s: Floats, sharpness: float) -> tuple[Floats, Floats]:
    """Return forward and left of a clothoid of curvature `sharpness * s` that leaves the origin along +x."""
    scale = math.sqrt(math.pi / abs(sharpness))
    sine, cosine = fresnel(s / scale)
    return scale * cosine, math.copysign(scale, sharpness) * sine


def rotate(points: Floats, angle: float) -> Floats:
    """Turn plan points (n, 2) counter-clockwise."""
    c, s = math.cos(angle), math.sin(angle)
    turned: Floats = points @ np.array([[c, s], [-s, c]])
    return turned


def height(pvis: tuple[tuple[float, float, float], ...], d: Floats) -> Floats:
    """Return the heights at d of straight grades with true circles at the inner points (radius > 0 is a sag)."""
    stations, levels, _ = np.array(pvis).T
    grades = np.diff(levels) / np.diff(stations)
    z = np.interp(d, stations, levels)
    for (station, level, radius), before, after in zip(pvis[1:-1], grades[:-1], grades[1:], strict=True):
        a, b = math.atan(before), math.atan(after)
        tangent = abs(radius) * math.tan(abs(b - a) / 2)
        begin = station - tangent * math.cos(a)
        centre = begin - radius * math.sin(a)
        centre_z = level - tangent * math.sin(a) + radius * math.cos(a)
        inside = (d > begin) & (d < station + tangent * math.cos(b))
        z[inside] = centre_z - np.sign(radius) * np.sqrt(radius**2 - (d[inside] - centre) ** 2)
    return z


def chain(x: float, y: float, shapes: list[tuple[float, float, float]]) -> tuple[Element, ...]:
    """Join (length, k0, k1) shapes end to end from (x, y)."""
    elements, yaw = [], START_YAW
    for length, k0, k1 in shapes:
        elements.append(Element(x, y, yaw, length, k0, k1))
        x, y, yaw, _ = elements[-1].at(length)[0]
    return tuple(elements)


def shift(radius: float, length: float) -> tuple[float, float]:
    """Return how far along and aside from the clothoid's start its arc's own straight tangent point lies."""
    ahead, aside = clothoid(np.array([length]), 1 / (radius * length))
    angle = length / (2 * radius)
    return float(ahead[0] - radius * math.sin(angle)), float(aside[0] - radius * (1 - math.cos(angle)))


def make_tracks() -> tuple[Track, Track]:
    """Return the outer track, R = 600 m, and the inner one, concentric with it in the arc.

    On both straights they lie `SPACING` apart; the inner track's longer clothoids shift it further inwards, which
    widens the spacing in the arc, as is usual.
    """
    radius, transition, straight, arc = 600.0, 100.0, 300.0, 400.0
    turn = (arc + transition) / radius
    k = 1 / radius
    outer = [(straight, 0.0, 0.0), (transition, 0.0, k), (arc, k, k), (transition, k, 0.0), (straight, 0.0, 0.0)]
    first = Track(
        "Track 1",
        "111",
        chain(0.0, 0.0, outer),
        ((0.0, 82.4, 0.0), (600.0, 80.0, 10000.0), (1050.0, 82.25, -10000.0), (1200.0, 82.1, 0.0)),
        ((300.0, 0.0), (400.0, 0.1), (800.0, 0.1), (900.0, 0.0)),
    )
    inner_transition = 110.0
    ahead, aside = shift(radius, transition)
    inner = round(
        float(brentq(lambda r: r + shift(r, inner_transition)[1] - (radius + aside - SPACING), 590, 600)), 3
    )
    k = 1 / inner
    inner_straight = straight + ahead - shift(inner, inner_transition)[0]
    shapes = [(inner_straight, 0.0, 0.0), (inner_transition, 0.0, k), (inner * turn - inner_transition, k, k)]
    start = rotate(np.array([[0.0, SPACING]]), START_YAW)[0]
    elements = chain(float(start[0]), float(start[1]), [*shapes, (inner_transition, k, 0.0), shapes[0]])
    begin, full, leave, end, length = np.cumsum([element.length for element in elements])
    pvis = ((0.0, 82.4, 0.0), (length / 2, 80.0, 10000.0), (length - 150.0, 82.25, -10000.0), (length, 82.1, 0.0))
    return first, Track("Track 2", "281", elements, pvis, ((begin, 0.0), (full, 0.1), (leave, 0.1), (end, 0.0)))


def rail_plane(cant: ArrayLike, left: ArrayLike) -> Floats:
    """Return the rail plane's height above the low (left) rail at plan offsets."""
    slope: Floats = np.tan(np.arcsin(np.asarray(cant, dtype=np.float64) / RAIL_BASE))
    return np.asarray((RAIL_BASE / 2 - np.asarray(left)) * slope, dtype=np.float64)


def natural_ground(points: Floats) -> Floats:
    """Return the height of the untouched ground at local plan points (n, 2)."""
    x, y = points.T
    hills: Floats = 1.1 * np.sin(x / 95 + 0.9) * np.cos(y / 140) + 0.22 * np.sin(x / 19 + y / 23)
    return np.asarray(hills + 80.7 - 0.0008 * x, dtype=np.float64)


def earthworks(edge: float, level: float, ground: NDArray[np.float64], offsets: Floats) -> list[tuple[float, float]]:
    """Return (outward, height) from the formation's edge: down 1:1.5 to the ditch, up 1:2, then the ground."""
    bottom = min(level - 0.6, float(np.interp(edge + 3.0, offsets, ground)) - 0.4)
    inner = edge + 1.5 * (level - bottom)
    outer = inner + 0.5
    rise = bottom + (offsets - outer) / 2 - ground
    daylight = float(offsets[np.argmax((offsets > outer) & (rise >= 0))])
    wide = np.linspace(daylight, SURFACE_HALF_WIDTH, 5)
    beyond = zip(wide.tolist(), np.interp(wide, offsets, ground).tolist(), strict=True)
    return [(edge, level), (inner, bottom), (outer, bottom), *beyond]


def cross_section(first: Track, second: Track, distance: float) -> Floats:
    """Return the surface's points (k, 3) square to Track 1, from right to left."""
    x, y, yaw, _, z1, cant1 = first.at(distance)[0]
    d2 = second.opposite(x, y, distance * second.length / first.length)
    x2, y2, _, _, z2, cant2 = second.at(d2)[0]
    gap = math.hypot(x2 - x, y2 - y)
    middle, half = (z1 + z2) / 2 - FORMATION_BELOW_RAIL, gap / 2
    out = np.arange(0.0, SURFACE_HALF_WIDTH + 0.005, 0.01)
    sides = []
    for centre, sign, z, cant in ((0.0, -1.0, z1, cant1), (gap, 1.0, z2, cant2)):
        shoulder = z - BALLAST_BELOW_RAIL + float(rail_plane(cant, sign * BALLAST_HALF_WIDTH))
        toe = (shoulder + BALLAST_HALF_WIDTH / 1.5 - middle + 0.04 * half) / (1 / 1.5 - 0.04)
        formation = [(BALLAST_HALF_WIDTH, shoulder), (toe, middle - 0.04 * (half + toe))]
        edge = middle - 0.04 * (half + FORMATION_EDGE)
        aside = (centre + sign * out)[:, None] * [-math.sin(yaw), math.cos(yaw)]
        side = formation + earthworks(FORMATION_EDGE, edge, natural_ground(aside + np.array([x, y])), out)
        sides.append([(centre + sign * outward, level) for outward, level in side])
    top1, top2 = z1 - BALLAST_BELOW_RAIL, z2 - BALLAST_BELOW_RAIL
    inside1 = (BALLAST_HALF_WIDTH, top1 + float(rail_plane(cant1, BALLAST_HALF_WIDTH)))
    inside2 = (gap - BALLAST_HALF_WIDTH, top2 + float(rail_plane(cant2, -BALLAST_HALF_WIDTH)))
    dip = (half, (inside1[1] + inside2[1]) / 2 - 0.15)
    centres = (0.0, top1 + float(rail_plane(cant1, 0.0))), (gap, top2 + float(rail_plane(cant2, 0.0)))
    left, level = np.array([*sides[0][::-1], centres[0], inside1, dip, inside2, centres[1], *sides[1]]).T
    return np.column_stack([x - left * math.sin(yaw), y + left * math.cos(yaw), level])


@dataclass(frozen=True)
class Terrain:
    """A triangle mesh in local coordinates: vertices (n, 3), faces (m, 3) counter-clockwise from above."""

    vertices: Floats
    faces: NDArray[np.int64]

    def height(self, points: Floats) -> Floats:
        """Return the heights of plan points (n, 2) by trying every face; NaN outside."""
        a, b, c = (self.vertices[self.faces[:, corner]] for corner in range(3))
        u, v = (b - a)[:, :2], (c - a)[:, :2]
        area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
        out = np.full(len(points), np.nan)
        for index, point in enumerate(points):
            w = point - a[:, :2]
            p, q = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / area, (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / area
            hit = np.flatnonzero((p >= -1e-9) & (q >= -1e-9) & (p + q <= 1 + 1e-9))
            if len(hit):
                face = hit[0]
                out[index] = a[face, 2] + p[face] * (b - a)[face, 2] + q[face] * (c - a)[face, 2]
        return out


def make_terrain(first: Track, second: Track) -> Terrain:
    """Return the surface through cross-sections every `SECTION_STEP`."""
    sections = [cross_section(first, second, d) for d in np.arange(0.0, first.length + 1e-6, SECTION_STEP)]
    count = len(sections[0])
    row, column = (grid.ravel() for grid in np.mgrid[0 : len(sections) - 1, 0 : count - 1])
    near = row * count + column
    lower = np.column_stack([near, near + count, near + count + 1])
    upper = np.column_stack([near, near + count + 1, near + 1])
    faces = np.stack([lower, upper], axis=1).reshape(-1, 3)
    return Terrain(np.concatenate(sections).astype(np.float64).round(3), faces)


@dataclass(frozen=True)
class Place:
    """A named point (3,), and where it stands: track, distance, offset to the left."""

    name: str
    position: Floats
    track: Track
    distance: float
    left: float


def outward(track: Track) -> float:
    """Return +1 if the track's outer side is on its left, -1 if on its right."""
    return -1.0 if track.name == "Track 1" else 1.0


def stand(name: str, track: Track, distance: float, left: float, terrain: Terrain) -> Place:
    """Return a place on the ground."""
    plan = track.offset(distance, left)
    return Place(name, np.append(plan[0], terrain.height(plan)[0]), track, distance, left)


def make_poles(track: Track, terrain: Terrain) -> list[Place]:
    """Return the catenary poles on the track's outer side: 3.1 m from its centre, 3.3 m where it is fully canted."""
    distances = np.arange(FIRST_POLE, track.length, POLE_SPACING)
    lefts = outward(track) * (3.1 + 2.0 * track.at(distances)[:, 5])
    named = enumerate(zip(distances, lefts, strict=True), start=1)
    return [stand(f"P{track.name[-1]}-{k:02d}", track, float(d), float(y), terrain) for k, (d, y) in named]


def make_signals(first: Track, second: Track, terrain: Terrain) -> list[Place]:
    """Return a main signal for each running direction (right-hand running)."""
    return [stand("S101", first, 180.0, -3.0, terrain), stand("S102", second, second.length - 180.0, 3.0, terrain)]


def make_wire(track: Track) -> Floats:
    """Return the contact wire (n, 3), held at each pole and straight between.

    It is `WIRE_HEIGHT` square to the rail plane, which turns about the low rail; pulled to alternate sides on the
    straight and to the outside (right) in the curve, so that the span's middle swings to the inside. At both ends of
    the site it is cut in the middle of a span.
    """
    poles = np.arange(FIRST_POLE, track.length, POLE_SPACING)
    alternate = STAGGER * (-1.0) ** np.arange(len(poles))
    pulled = np.where(np.abs(track.at(poles)[:, 3]) > 1e-4, -STAGGER, alternate)
    distances = np.concatenate([[0.0], poles, [track.length]])
    pulled = np.concatenate([[0.0], pulled, [0.0]])
    state = track.at(distances)
    angle = np.arcsin(state[:, 5] / RAIL_BASE)
    low = RAIL_BASE / 2
    left = low + (pulled - low) * np.cos(angle) + WIRE_HEIGHT * np.sin(angle)
    up = -(pulled - low) * np.sin(angle) + WIRE_HEIGHT * np.cos(angle)
    return np.column_stack([track.offset(distances, left), state[:, 4] + up])


def make_cable(second: Track, terrain: Terrain) -> Floats:
    """Return the signalling cable (n, 3): 3.7 m left of Track 2, 0.6 m under the ground."""
    plan = second.offset(np.append(np.arange(5.0, second.length - 5.0, 10.0), second.length - 5.0), 3.7)
    return np.column_stack([plan, terrain.height(plan) - 0.6])


def make_wells(first: Track) -> list[Place]:
    """Return the drain's wells between the tracks, at the pipe's invert 1.7 m under the rail, one every 50 m."""
    distances = np.arange(10.0, first.length, 50.0)
    places = zip(first.offset(distances, SPACING / 2), first.at(distances)[:, 4] - 1.7, distances, strict=True)
    return [
        Place(f"W{k:02d}", np.append(plan, z), first, float(d), SPACING / 2)
        for k, (plan, z, d) in enumerate(places, start=1)
    ]
