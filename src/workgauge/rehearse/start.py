"""Where the machine stands at the start: on rails, with gradient and cant, or on the ground as it slopes."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from workgauge.gauge.heights import ORIGINS, Origin, SiteHeights
from workgauge.gauge.match import rule_for
from workgauge.gauge.own_track import own_track
from workgauge.gauge.rules import RuleBook, TrackBlock
from workgauge.gauge.sections import CantRotation
from workgauge.gauge.trackline import FilledLine, filled_line
from workgauge.gauge.tracks import cant_rotation
from workgauge.machine.model import MachineModel
from workgauge.rehearse.ground import footprint_grid, plane_under
from workgauge.rehearse.scenario import OnGround, OnTrack
from workgauge.site.alignment import Alignment
from workgauge.site.model import SiteModel
from workgauge.values.arrays import Floats
from workgauge.values.errors import InputError, ScenarioError
from workgauge.values.transforms import apply

#: How cant turns a track that the rule book says nothing of: about its middle, rails 1.5 m apart.
PLAIN_ROTATION = CantRotation(1.5, "centre")


@dataclass(frozen=True, slots=True, eq=False)
class Stand:
    """Where the machine stands.

    Attributes:
        T_absolute_machine: (4, 4), machine coordinates into absolute east, north, height [m].
        words: where that is, for people. own_track: the alignment it stands on, or None.
        warnings: what had to be assumed.
    """

    T_absolute_machine: Floats
    words: str
    own_track: str | None
    warnings: tuple[str, ...] = ()


def stand(site: SiteModel, rules: RuleBook, machine: MachineModel, place: OnTrack | OnGround) -> Stand:
    """Return where the machine stands.

    A rail machine put on the ground within reach of a track (the rule book's `own_track`) stands on its rails.

    Raises:
        ScenarioError: if there is no such place.
    """
    if isinstance(place, OnTrack):
        try:
            alignment = site.alignment(place.alignment)
            along = place.distance_m if place.station_m is None else alignment.distance_of_station(place.station_m)
            return on_rails(site, rules, alignment, float(along or 0.0), place.facing == "forward", machine)
        except InputError as error:
            raise ScenarioError(
                error.message, element="start.on_track", value=error.value, allowed=error.allowed
            ) from error
    heading = math.radians(place.heading_deg) % (2 * math.pi)
    track = own_track(site, rules, place.east_m, place.north_m, heading)
    if track is None or machine.undercarriage.kind != "rail":
        return on_ground(SiteHeights(site, rules), machine, place.east_m, place.north_m, heading, track)
    alignment = site.alignment(track)
    along, offset = (float(value[0]) for value in alignment.project(np.array([[place.east_m, place.north_m]])))
    forward = math.cos(float(alignment.at([along]).heading[0]) - heading) >= 0
    stood = on_rails(site, rules, alignment, along, forward, machine)
    moved = f"stands on the rails of {track.strip()}, {abs(offset):.2f} m beside the place asked for"
    return stood if abs(offset) < 0.005 else replace(stood, warnings=(*stood.warnings, moved))


def on_rails(
    site: SiteModel, rules: RuleBook, alignment: Alignment, distance: float, forward: bool, machine: MachineModel
) -> Stand:
    """Return the pose on the rails of an alignment, see `Rails`.

    Raises:
        SiteError: if the alignment has no such distance.
        ScenarioError: if nothing says how high the rails are there.
    """
    rails, name = Rails(site, rules, alignment, machine), alignment.name.strip()
    T = rails.pose(distance, forward)
    warnings: tuple[str, ...] = ()
    if math.isnan(float(alignment.at([distance]).z[0])):
        z = rails.height(distance)
        warnings = (f"{name} has no height of its own at {distance:.1f} m: the machine stands at {z:.2f} m",)
    facing = "facing forward" if forward else "facing backward"
    return Stand(T, f"on the rails of {name} at {distance:.3f} m, {facing}", alignment.name, warnings)


class Rails:
    """An alignment's rails as a machine stands on them: along the tangent, tilted by gradient and cant.

    Where the alignment has no height of its own, the machine stands where its limits are made: see `gauge.heights`.
    """

    def __init__(self, site: SiteModel, rules: RuleBook, alignment: Alignment, machine: MachineModel) -> None:
        self.alignment = alignment
        self._site, self._rules = site, rules
        self._rotation = _cant_rotation(rules, alignment)
        self._height_m = machine.undercarriage.height_m

    def pose(self, distance: float, forward: bool) -> Floats:
        """Return (4, 4), machine coordinates into absolute east, north, height [m].

        Raises:
            SiteError: if the alignment has no such distance.
            ScenarioError: if nothing says how high the rails are there.
        """
        state = self.alignment.at([distance])
        heading, cant = float(state.heading[0]), float(state.cant[0])
        z, gradient = float(state.z[0]), float(state.gradient[0])
        if math.isnan(z):
            z, gradient = self._filled_height(distance)
        direction = np.array([math.sin(heading), math.cos(heading), gradient])
        direction /= np.linalg.norm(direction)
        level = np.array([-math.cos(heading), math.sin(heading), 0.0])
        up = np.cross(direction, level)
        # The middle of the track and a point 1 m to its left, as the track's cant turns them.
        ys, zs = self._rotation.turn(np.array([[0.0, 1.0]]), np.zeros((1, 2)), np.array([cant]))
        middle, beside = (level * ys[0, i] + up * zs[0, i] for i in range(2))
        position = np.array([float(state.e[0]), float(state.n[0]), z]) + middle
        left = beside - middle
        if not forward:
            direction, left = -direction, -left
        return _pose(position, direction, left, self._height_m)

    def height(self, distance: float) -> float:
        """Return the height of the rails at a place, its own or filled in [m]."""
        z = float(self.alignment.at([distance]).z[0])
        return self._filled_height(distance)[0] if math.isnan(z) else z

    @cached_property
    def _filled(self) -> FilledLine:
        heights = SiteHeights(self._site, self._rules)
        return filled_line(self.alignment, heights, np.zeros(3), float(self._rules.rail_above_surface_m))

    def _filled_height(self, distance: float) -> tuple[float, float]:
        """Return the height and gradient at which the limits of an alignment without heights are made."""
        filled = self._filled
        if any(first <= distance <= last for first, last in filled.unknown):
            raise ScenarioError(
                "nothing says how high the rails are there",
                element=f"alignment {self.alignment.name.strip()!r}",
                value=f"{distance:.3f} m",
                allowed="a place with a profile, a surface, or a profile near by",
            )
        state = filled.line.at(np.array([distance]))
        return float(state.points[0, 2]), float(state.gradient[0])


def _cant_rotation(rules: RuleBook, alignment: Alignment) -> CantRotation:
    """Return how the alignment's cant turns it, as its envelope has it."""
    rule = rule_for(rules, alignment)
    for block in () if rule is None else rule.limits:
        if isinstance(block, TrackBlock):
            return cant_rotation(block.cant, alignment) or PLAIN_ROTATION
    return PLAIN_ROTATION


def on_ground(
    heights: SiteHeights, machine: MachineModel, e: float, n: float, heading: float, track: str | None = None
) -> Stand:
    """Return the pose on the site's ground, tilted as the plane under the undercarriage.

    The ground is where limits without a height of their own are made: the topmost of the surfaces the machine is kept
    above, or else of the others. Where there is none, a profile near by or, on a site without any heights, the rule
    book's constant gives the height, and a warning says so.

    Raises:
        ScenarioError: if nothing says how high the ground is.
    """
    warnings: tuple[str, ...] = ()
    plane = plane_under(heights, e, n, footprint_grid(*_footprint(machine), e, n, heading))
    if plane is None:
        z_there, origin = heights.at(np.array([[e, n]]))
        if not math.isfinite(z_there[0]):
            raise ScenarioError(
                "no ground to stand on: no surface of the site lies there and no profile near by",
                element="start",
                value=f"E {e:.3f} N {n:.3f}",
                allowed=f"a place on a surface, or within {heights.within:g} m of an alignment with a profile",
            )
        plane = (float(z_there[0]), 0.0, 0.0)
        whose = {Origin.PROFILE: "that of the nearest profile", Origin.CONSTANT: "the rule book's"}
        words = whose.get(ORIGINS[int(origin[0])], "that of the edge of a surface")
        warnings = (f"no surface under the machine: it stands level at height {plane[0]:.2f} m, {words}",)
    z, east, north = plane
    up = np.array([-east, -north, 1.0])
    up /= np.linalg.norm(up)
    direction = np.array([math.sin(heading), math.cos(heading), 0.0])
    direction[2] = east * direction[0] + north * direction[1]
    direction /= np.linalg.norm(direction)
    left = np.cross(up, direction)
    T = _pose(np.array([e, n, z]), direction, left, machine.undercarriage.height_m)
    words = f"on the ground at E {e:.3f} N {n:.3f}, height {z:.3f} m, heading {math.degrees(heading):.1f}°"
    return Stand(T, words, track, warnings)


def _footprint(machine: MachineModel) -> tuple[float, float]:
    """Return half the length and half the width of what stands on the ground [m]."""
    corners = [
        apply(
            solid.T_link_box,
            np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * solid.half_extents,
        )
        for solid in machine.solids
        if solid.link == 0
    ]
    reach = np.abs(np.concatenate(corners)).max(axis=0) if corners else np.array([1.0, 1.0, 0.0])
    return float(reach[0]), float(reach[1])


def _pose(position: Floats, forward: Floats, left: Floats, height: float) -> Floats:
    """Return the pose with these axes, its origin `height` above `position` along its own z."""
    up = np.cross(forward, left)
    T = np.eye(4)
    T[:3, 0], T[:3, 1], T[:3, 2] = forward, left, up
    T[:3, 3] = position + height * up
    return T
