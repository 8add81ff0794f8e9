"""The scene: machine, limits, clearances, ghosts, tracks; one class per thing that moves."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from workgauge.cockpit import colours
from workgauge.cockpit.looks import Looks
from workgauge.cockpit.quaternions import quaternion
from workgauge.gauge.meshes import mesh_parts
from workgauge.machine.model import MachineModel
from workgauge.rehearse.session import Session
from workgauge.site.alignment import Alignment
from workgauge.values.arrays import Floats
from workgauge.values.limits import Limit
from workgauge.values.station import Foreseen, Near, Snapshot, Suspended

#: Parts of limits farther from the machine are not drawn [m].
DRAWN_M = 150.0
#: What is drawn round the machine is drawn anew once that has gone on so far [m].
REDRAWN_M = 50.0
#: Clearance lines with metres, and how long one may be [m].
LINES, LONGEST_LINE_M = 4, 8.0
#: Chainages are written this far apart [m], within this of the machine [m].
CHAINAGE_M, CHAINAGE_WITHIN_M = 20.0, 100.0
#: Halos smaller than this are not seen [m].
SMALLEST_HALO_M = 0.005


class Boxes:
    """A machine's link solids as boxes, placed by a posture.

    Args:
        scene: viser's. machine: whose. name: of the node. opacity: None for a solid machine, else a ghost.
            A solid machine's links look as their meshes do, where they have any.
    """

    def __init__(
        self, scene: Any, machine: MachineModel, name: str, rgb: colours.Rgb, opacity: float | None = None
    ) -> None:
        self._machine = machine
        poses, halves = machine.solid_poses(machine.forward(machine.home))
        self._root = scene.add_frame(name, show_axes=False, visible=opacity is None)
        self._looks = Looks(scene, machine, name) if opacity is None else None
        seen = frozenset() if self._looks is None else self._looks.links
        self._boxes: dict[int, Any] = {}
        for i, (T, half) in enumerate(zip(poses, halves, strict=True)):
            if machine.solids[i].link in seen:
                continue
            still = machine.solids[i].link == 0 and opacity is None
            self._boxes[i] = scene.add_box(
                f"{name}/{i}",
                color=colours.UNDERCARRIAGE if still else rgb,
                dimensions=tuple(2.0 * half),
                opacity=opacity,
                position=tuple(T[:3, 3]),
                wxyz=quaternion(T[:3, :3]),
            )

    def place(self, q: ArrayLike, T_site_machine: Floats) -> None:
        """Move it to a posture (n,) at a pose (4, 4)."""
        kin = self._machine.forward(q)
        poses, halves = self._machine.solid_poses(kin)
        self._root.position, self._root.wxyz = tuple(T_site_machine[:3, 3]), quaternion(T_site_machine[:3, :3])
        for i, box in self._boxes.items():
            box.position, box.wxyz = tuple(poses[i][:3, 3]), quaternion(poses[i][:3, :3])
            if self._machine.stretches.size:
                box.dimensions = tuple(2.0 * halves[i])
        if self._looks is not None:
            self._looks.place(kin.T_machine_links)

    def show(self, visible: bool) -> None:
        """Show or hide it."""
        if self._root.visible != visible:
            self._root.visible = visible


class Around(ABC):
    """Something that is drawn round the machine only, and anew when that has gone on far enough.

    Args:
        at: (3,) where the machine stands now.
    """

    def __init__(self, at: Floats) -> None:
        self._nodes: list[Any] = []
        self._at = at
        self._draw(at)

    def follow(self, at: Floats) -> bool:
        """Draw it anew if the machine has gone on since; return whether it was."""
        if float(np.linalg.norm(at[:2] - self._at[:2])) < REDRAWN_M:
            return False
        for node in self._nodes:
            node.remove()
        self._nodes, self._at = [], at
        self._draw(at)
        return True

    @abstractmethod
    def _draw(self, at: Floats) -> None:
        """Add nodes round a place."""


class Limits(Around):
    """The limits near the machine; those that are off are hidden, suspended ones red wire."""

    def __init__(self, scene: Any, limits: Sequence[Limit], at: Floats) -> None:
        self._scene = scene
        self._limits = {limit.id: limit for limit in limits}
        self._parts = {limit.id: tuple(mesh_parts(limit.solid)) for limit in limits}
        super().__init__(at)

    def _draw(self, at: Floats) -> None:
        self._of: dict[str, list[Any]] = {}
        self._shown: dict[str, str] = {}
        for number, (name, limit) in enumerate(self._limits.items()):
            self._of[name] = []
            for i, part in enumerate(self._parts[name]):
                faces = _near_faces(part.vertices, part.faces, at)
                if not len(faces):
                    continue
                used, local = np.unique(faces, return_inverse=True)
                middle = part.vertices[used].mean(axis=0)
                rgb, opacity = colours.LIMITS[limit.kind]
                self._of[name].append(
                    self._scene.add_mesh_simple(
                        f"/limits/{limit.kind}/{number}/{i}",
                        (part.vertices[used] - middle).astype(np.float32),
                        local.reshape(-1, 3).astype(np.uint32),
                        color=rgb,
                        opacity=opacity,
                        side="double",
                        flat_shading=True,
                        cast_shadow=False,
                        receive_shadow=False,
                        position=tuple(middle),
                    )
                )
            self._nodes.extend(self._of[name])

    def update(self, off_states: Sequence[str], let_off: Sequence[str], suspended: Sequence[Suspended]) -> None:
        """Show what counts now."""
        gone = {one.limit for one in suspended}
        for name, limit in self._limits.items():
            own = limit.own_track_of is not None and limit.own_track_of in let_off
            off = limit.activity.state in off_states
            look = "suspended" if name in gone else "hidden" if own or off else "on"
            if self._shown.get(name) == look:
                continue
            self._shown[name] = look
            rgb, opacity = colours.LIMITS[limit.kind]
            for node in self._of[name]:
                node.visible = look != "hidden"
                node.wireframe = look == "suspended"
                node.color = (220, 0, 0) if look == "suspended" else rgb
                node.opacity = 0.9 if look == "suspended" else opacity


def _near_faces(vertices: Floats, faces: Any, around: Floats) -> Any:
    """Return the faces whose bounding rectangle in plan comes near a place."""
    corners = vertices[:, :2][faces]
    beyond = np.maximum(corners.min(axis=1) - around[:2], around[:2] - corners.max(axis=1))
    return faces[np.linalg.norm(np.maximum(beyond, 0.0), axis=1) < DRAWN_M]


class Clearances:
    """Lines to the nearest limits with their metres, and protection levels as halos."""

    def __init__(self, scene: Any) -> None:
        zero = np.zeros((1, 2, 3), dtype=np.float32)
        self._limits = [""] * LINES  # whose each line is
        self._lines = [
            scene.add_line_segments(
                f"/near/line {i}", zero, (0, 0, 0), thickness=4.0, thickness_units="screen", visible=False
            )
            for i in range(LINES)
        ]
        self._labels = [
            scene.add_label(f"/near/metres {i}", "", anchor="bottom-center", visible=False) for i in range(LINES)
        ]
        self._halos = [
            scene.add_icosphere(
                f"/near/halo {i}", radius=1.0, color=colours.HALO, opacity=0.35, cast_shadow=False, visible=False
            )
            for i in range(LINES)
        ]

    def update(self, near: Sequence[Near], keep_m: float) -> None:
        """Draw the nearest; keep_m: what is kept where a limit names nothing itself [m]."""
        shown = [one for one in near if one.kind != "self" and one.distance_m < LONGEST_LINE_M][:LINES]
        for i, one in enumerate(self._placed(shown)):
            self._lines[i].visible = self._labels[i].visible = one is not None
            if one is None:
                self._halos[i].visible = False
                continue
            a, b = np.array(one.point_machine), np.array(one.point_limit)
            left = one.distance_m - one.protection_m - (keep_m if one.stop_m is None else one.stop_m)
            self._lines[i].points = np.array([[a, b]], dtype=np.float32)
            self._lines[i].colors = np.array(colours.near_colour(left), dtype=np.uint8)
            self._labels[i].position = tuple(0.5 * (a + b))
            self._labels[i].text = f"{one.distance_m:.2f} m {one.name}"
            halo = one.protection_m > SMALLEST_HALO_M
            self._halos[i].visible = halo
            if halo:
                self._halos[i].position, self._halos[i].scale = tuple(a), float(min(one.protection_m, 5.0))

    def _placed(self, shown: Sequence[Near]) -> list[Near | None]:
        """Return what each line shows. A limit keeps its line: a browser writes labels anew later than it moves them,
        and one limit's name would stand beside another.
        """
        by_limit = {one.limit: one for one in shown}
        stay = [by_limit.pop(name, None) for name in self._limits]
        coming = iter(by_limit.values())
        placed = [next(coming, None) if one is None else one for one in stay]
        self._limits = ["" if one is None else one.limit for one in placed]
        return placed


class Tracks(Around):
    """Rails of the alignments near the machine, their names and chainages."""

    def __init__(self, scene: Any, session: Session, at: Floats) -> None:
        self._scene, self._session = scene, session
        super().__init__(at)

    def _draw(self, at: Floats) -> None:
        origin = self._session.frame.origin
        for number, alignment in enumerate(self._session.site.alignments):
            distance, offset = alignment.project((at[:2] + origin[:2])[None])
            if abs(float(offset[0])) > CHAINAGE_WITHIN_M:
                continue
            first = max(0.0, float(distance[0]) - CHAINAGE_WITHIN_M)
            last = min(alignment.length, float(distance[0]) + CHAINAGE_WITHIN_M)
            self._track(f"/tracks/{number}", alignment, first, last, float(distance[0]))

    def _rails(self, alignment: Alignment) -> tuple[float, ...]:
        """Return how far left of an alignment its rails lie [m]: by its cant's gauge, else the machine's own if that
        runs on rails; a single line where neither is known.
        """
        own = self._session.machine.undercarriage
        gauge_m = alignment.cant_gauge_m or (own.gauge_m if own.kind == "rail" else None)
        return (0.0,) if gauge_m is None else (0.5 * gauge_m, -0.5 * gauge_m)

    def _track(self, node: str, alignment: Alignment, first: float, last: float, here: float) -> None:
        """Draw one track between two distances along it, its name where the machine is."""
        origin = self._session.frame.origin
        along = np.unique(np.concatenate([np.arange(first, last, 2.0), [last]]))
        state = alignment.at(along)
        z = np.where(np.isfinite(state.z), state.z, origin[2])
        middle = np.stack([state.e, state.n, z], axis=1) - origin
        left = np.stack([-np.cos(state.heading), np.sin(state.heading), np.zeros_like(z)], axis=1)
        name = alignment.name.strip()
        for i, aside in enumerate(self._rails(alignment)):
            rail = middle + aside * left
            segments = np.stack([rail[:-1], rail[1:]], axis=1).astype(np.float32)
            self._nodes.append(
                self._scene.add_line_segments(f"{node}/rail {i}", segments, colours.RAIL, thickness=0.07)
            )
        for at in np.arange(math.ceil(first / CHAINAGE_M) * CHAINAGE_M, last, CHAINAGE_M).tolist():
            i = int(np.argmin(np.abs(along - at)))
            station = float(np.ravel(alignment.station(at))[0])
            text = f"{int(station // 1000)}+{station % 1000:03.0f}"
            near = abs(at - here) <= 0.5 * CHAINAGE_M
            self._nodes.append(
                self._scene.add_label(
                    f"{node}/{at:.0f}",
                    f"{name} {text}" if near else text,
                    position=tuple(middle[i] + np.array([0.0, 0.0, 0.1])),
                    anchor="center-center",
                    font_screen_scale=0.8,
                )
            )


class Scene:
    """Everything that is seen.

    Args:
        scene: viser's. session: of the same scenario as the machine's.
    """

    def __init__(self, scene: Any, session: Session) -> None:
        self._scene, self._session = scene, session
        machine = session.machine
        q, T = session.true_state
        self.T_site_machine = T
        self._limits = Limits(scene, session.limit_set.limits, T[:3, 3])
        self._tracks = Tracks(scene, session, T[:3, 3])
        self._machine = Boxes(scene, machine, "/machine", colours.MACHINE)
        self._machine.place(q, T)
        self._stop = Boxes(scene, machine, "/stop", colours.STOP_GHOST, 0.35)
        self._ghost = Boxes(scene, machine, "/preview", colours.PREVIEW_GHOST, 0.4)
        self._near = Clearances(scene)
        self._way: Any = None
        self._foreseen: Foreseen | None = None
        self._frame = 0

    def update(self, now: Snapshot) -> None:
        """Show a snapshot."""
        T = np.eye(4)
        T[:3] = np.reshape(now.pose, (3, 4))
        self.T_site_machine = T
        self._machine.place(now.q, T)
        apart = float(np.abs(np.array(now.stop_q) - np.array(now.q)).max()) > 2e-3
        self._stop.show(apart)
        if apart:
            self._stop.place(now.stop_q, T)
        keep = dict(now.settings).get("stop_distance_m", 0.0)
        self._near.update(now.near, keep)
        self._tracks.follow(T[:3, 3])
        self._limits.follow(T[:3, 3])
        self._limits.update(now.off_states, now.let_off, now.suspended)
        self._preview(now)

    def foreseen(self, found: Foreseen) -> None:
        """Take in what a preview came to."""
        self._foreseen, self._frame = found, 0
        if self._way is not None:
            self._way.remove()
            self._way = None
        if len(found.tool) > 1:
            points = np.array(found.tool, dtype=np.float32)
            self._way = self._scene.add_line_segments(
                "/preview way", np.stack([points[:-1], points[1:]], axis=1), colours.PREVIEW_GHOST, thickness=0.04
            )

    def _preview(self, now: Snapshot) -> None:
        """Let the ghost of the preview that counts go along its way, again and again."""
        found = self._foreseen
        counts = found is not None and found.id == now.preview and bool(found.postures)
        self._ghost.show(counts)
        if self._way is not None and self._way.visible != counts:
            self._way.visible = counts
        if counts and found is not None:
            self._frame = (self._frame + 1) % (len(found.postures) * 2)
            at = min(self._frame, len(found.postures) - 1)
            self._ghost.place(found.postures[at], self.T_site_machine)

    def tool(self, now: Snapshot) -> Floats:
        """Return the tool's pose (4, 4) in the site."""
        machine = self._session.machine
        return np.asarray(self.T_site_machine @ machine.tool_pose(machine.forward(now.q)))

    def cab(self, now: Snapshot) -> tuple[Floats, Floats]:
        """Return where the operator's eye would be and where it looks (3,), both in the site."""
        machine = self._session.machine
        kin = machine.forward(now.q)
        T = self.T_site_machine @ kin.T_machine_links[1]
        ahead = self.tool(now)[:3, 3]
        up = self.T_site_machine[:3, 2]
        axis = T[:3, 3]
        flat = ahead - axis - up * float((ahead - axis) @ up)
        forward = flat / max(float(np.linalg.norm(flat)), 1e-6)
        eye = self.T_site_machine[:3, 3] + 2.6 * up + 0.3 * forward + 0.8 * np.cross(up, forward)
        return eye, ahead
