"""What a machine makes of the edge's way: how much of it it reaches, and how far its edge is off."""

from dataclasses import dataclass

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.motion.bucket.edge import edge_points
from workgauge.motion.bucket.surface_path import SurfacePath
from workgauge.motion.ik.closed_form import closed_form
from workgauge.motion.ik.task import orientation_of
from workgauge.motion.paths.joint_path import JointPath, joint_path
from workgauge.motion.paths.tool_path import ToolPath
from workgauge.motion.planning import inverse_of, reaching
from workgauge.site.surface.laid import LaidPart
from workgauge.values.arrays import Floats, frozen, frozen_ints
from workgauge.values.errors import InputError
from workgauge.values.tasks import Orientation
from workgauge.values.transforms import inverse

#: What can be reached is looked for this often along a way [m], and a way is no shorter than this [m].
EVERY_M, SHORTEST_M = 0.1, 0.3
#: From where joints cannot go on, so much is taken off [m].
BACK_M = 0.02
#: A bucket's way keeps joints this far from their ends: nearer the end cushion slows them, and the edge falls behind.
CLEAR_RAD, CLEAR_M = np.radians(4.0), 0.05


@dataclass(frozen=True, slots=True, eq=False)
class EdgeError:
    """How a machine's edge lies beside the edge wanted.

    Attributes:
        corner_m: farthest that an end of the edge is above or below the plane it is to lie in, along its normal.
        turned_rad: largest angle between edge and the edge wanted. middle_m: of its middle, off its way.
    """

    corner_m: float
    turned_rad: float
    middle_m: float


def held_orientation(machine: MachineModel) -> Orientation:
    """Return how much of a bucket's orientation a machine holds: all of it, or the pitch in its arm's plane."""
    return orientation_of(machine)


def edge_error(machine: MachineModel, found: JointPath, width_m: float, every_m: float = 0.02) -> EdgeError:
    """Return how far a machine's own edge is off the one wanted, along a joint path."""
    s = np.linspace(0.0, found.length_m, max(2, int(np.ceil(found.length_m / every_m)) + 1))
    wanted, _ = found.path.at(s)
    q = found.curve.at(s)[0]
    is_at = found.T_site_machine @ np.array([machine.tool_pose(machine.forward(one)) for one in q])
    return error_between(wanted, is_at, width_m)


def own_edge(machine: MachineModel, found: JointPath, width_m: float, every_m: float = 0.01) -> Floats:
    """Return the points (N, k, 3) of a machine's own edge along a joint path, in the site's local frame [m]."""
    s = np.linspace(0.0, found.length_m, max(2, int(np.ceil(found.length_m / every_m)) + 1))
    T = found.T_site_machine @ np.array([machine.tool_pose(machine.forward(q)) for q in found.curve.at(s)[0]])
    return edge_points(T, width_m)


def error_between(wanted: Floats, is_at: Floats, width_m: float) -> EdgeError:
    """Return how far edges at tool poses (N, 4, 4) are off the planes, ways and angles of those wanted (N, 4, 4)."""
    corners = edge_points(is_at, width_m)[:, [0, -1]]
    # the plane the edge is to lie in holds the wanted edge and the way; with a cutting angle z is not its normal
    off = np.einsum("nkj,nj->nk", corners - wanted[:, None, :3, 3], _plane_normals(wanted))
    along = np.einsum("ni,ni->n", wanted[:, :3, 0], is_at[:, :3, 0])
    middle = np.linalg.norm(is_at[:, :3, 3] - wanted[:, :3, 3], axis=1)
    return EdgeError(
        float(np.abs(off).max()),
        float(np.arccos(np.clip(along, -1.0, 1.0)).max()),
        float(middle.max()),
    )


def _plane_normals(T: Floats) -> Floats:
    """Return the normals (N, 3) of the planes through edges and ways, by the ways' own differences."""
    way = np.gradient(T[:, :3, 3], axis=0)
    size = np.linalg.norm(way, axis=1)
    way = np.where(size[:, None] > 1e-9, way, -T[:, :3, 1])
    normal = np.cross(way, T[:, :3, 0])
    size = np.linalg.norm(normal, axis=1)
    return np.where(size[:, None] > 1e-9, normal / np.maximum(size, 1e-12)[:, None], -T[:, :3, 2])


def reached(machine: MachineModel, made: SurfacePath, T_site_machine: Floats) -> list[tuple[float, float]]:
    """Return the stretches (from, to) of a way that the machine reaches, joints' margins and branches aside [m]."""
    s, T = made.poses(EVERY_M)
    goals = inverse(T_site_machine) @ T
    orientation, form = held_orientation(machine), closed_form(machine)
    near, inside = np.array(machine.home), np.zeros(len(s), dtype=bool)
    for i, goal in enumerate(goals):
        found = reaching(machine, form, goal, orientation, near, restarts=0 if i and inside[i - 1] else 2)
        if isinstance(found, list):
            inside[i], near = True, found[0]
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(int)))
    spans = [(float(s[a]), float(s[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return [span for span in spans if span[1] - span[0] >= SHORTEST_M]


def followed_from(
    machine: MachineModel, path: ToolPath, T_site_machine: Floats, near: Floats
) -> tuple[JointPath | None, float, str]:
    """Return the joints' way along a path from the best branch; or None, how far the best one comes, and why.

    Args:
        near: (n,) the posture whose branch is tried first.
    """
    orientation = held_orientation(machine)
    begin = inverse(T_site_machine) @ path.at(0.0)[0]
    starts = reaching(machine, closed_form(machine), begin, orientation, near)
    if isinstance(starts, str):
        return None, 0.0, starts
    farthest, why = 0.0, "out of reach"
    for start in starts:
        found = joint_path(machine, path, T_site_machine, start, orientation, inverse_of(machine))
        if isinstance(found, JointPath):
            return found, found.length_m, ""
        if found.distance_m >= farthest:
            farthest, why = found.distance_m, str(found)
    return None, farthest, why


def clear_of_ends(machine: MachineModel, found: JointPath) -> tuple[float, float]:
    """Return a joint path without its beginning and end where joints are near their ends, (from, to) [m].

    In between they may be: there the way is slower.
    """
    margin = np.where(machine.prismatic, CLEAR_M, CLEAR_RAD)
    s = np.linspace(0.0, found.length_m, max(2, int(np.ceil(found.length_m / BACK_M)) + 1))
    q = found.curve.at(s)[0]
    clear = ((q >= machine.q_min + margin) & (q <= machine.q_max - margin)).all(axis=1)
    inside = np.flatnonzero(clear)
    return (float(s[inside[0]]), float(s[inside[-1]])) if len(inside) else (0.0, 0.0)


def cut_to(part: LaidPart, begin_m: float, end_m: float) -> LaidPart:
    """Return a stretch of a laid line, by distances on the surface from its beginning [m].

    Raises:
        InputError: nothing is left.
    """
    run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(part.points, axis=0), axis=1))])
    low, high = max(begin_m, 0.0), min(end_m, float(run[-1]))
    if high - low < 1e-3:
        raise InputError("nothing of the line is left", element="line", value=f"{high - low:.3f} m")
    inner = (run > low + 1e-6) & (run < high - 1e-6)
    at = np.concatenate([[low], run[inner], [high]])
    points = np.column_stack([np.interp(at, run, part.points[:, k]) for k in range(3)])
    along = np.interp(at, run, part.along)
    middles = 0.5 * (at[1:] + at[:-1])
    faces = part.faces[np.clip(np.searchsorted(run, middles, side="right") - 1, 0, len(part.faces) - 1)]
    return LaidPart(frozen(points), frozen_ints(faces), frozen(along))
