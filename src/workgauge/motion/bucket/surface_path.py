"""The edge's path on a surface: position and orientation, blended over the edges crossed, never too deep."""

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from workgauge.motion.bucket.edge import Bucket, above, edge_frames, edge_points
from workgauge.motion.paths.orientations import angles, rotation_vectors, rotations
from workgauge.motion.paths.tool_path import ToolPath
from workgauge.site.surface.laid import LaidPart
from workgauge.site.surface.tin import Tin
from workgauge.values.arrays import Floats
from workgauge.values.errors import InputError

#: Legs shorter than this are not told apart: several edges meet there [m].
SHORTEST_LEG_M = 5e-3
#: Normals or directions that differ by less go on as one [rad].
SAME_RAD = 1e-6
#: An orientation turns over no less before and behind an edge [m].
LEAST_TURN_M = 1e-3
#: The edge is held against the surface this often along its way [m].
LOOKED_M = 0.02
#: A way is lifted, and let down again, over this [m].
RAMP_M = 0.3
#: Lifted stretches are followed to this [m].
_LIFT_M = 5e-4
_ROUNDS = 4
_FEWEST_M = 1e-3


@dataclass(frozen=True, slots=True)
class Blend:
    """How an edge between two triangles is crossed.

    Attributes:
        turn_m: so far before and behind it the orientation turns, less where legs are short; 1 mm at least.
        corner_m: so far the edge's middle may pass from the corner; 0 stops there.
        over_dig_m: so far any point of the edge may be below the surface; None for any depth.
    """

    turn_m: float = 0.25
    corner_m: float = 0.002
    over_dig_m: float | None = 0.01

    def __post_init__(self) -> None:
        for name, low in (("turn_m", LEAST_TURN_M), ("corner_m", 0.0), ("over_dig_m", 0.0)):
            value = getattr(self, name)
            if value is not None and not low <= value <= 10.0:
                raise InputError("not a blend", element=name, value=f"{value:.6g}", allowed=f"{low:g} to 10 m")


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePath:
    """The edge's way on a surface, in the site's local frame.

    Attributes:
        path: of the tool. part: the line it follows, absolute.
        lift_m: the most it was lifted to keep the edge out of the ground; raised_m: so much of it all along, for what
            a machine's joints cannot turn. offset_m: above the surface on purpose.
        edge_m: largest distance of any point of the edge from the surface (and `offset_m`), upright.
        below_m: how far any point of it is below, 0 for nowhere; off_surface: share of the edge with none under it.
        turned_rad: the most the orientation is off a triangle's own, next to edges.
    """

    path: ToolPath
    part: LaidPart
    bucket: Bucket
    offset_m: float
    lift_m: float
    edge_m: float
    below_m: float
    off_surface: float
    turned_rad: float
    raised_m: float = 0.0

    def poses(self, spacing_m: float = LOOKED_M) -> tuple[Floats, Floats]:
        """Return distances (N,) along the path and tool poses (N, 4, 4) there."""
        s = np.linspace(0.0, self.path.length_m, max(2, math.ceil(self.path.length_m / spacing_m) + 1))
        return s, self.path.at(s)[0]


def surface_path(
    tin: Tin,
    part: LaidPart,
    bucket: Bucket,
    blend: Blend,
    origin: Floats,
    *,
    offset_m: float = 0.0,
    raised_m: float = 0.0,
) -> SurfacePath:
    """Return the edge's way along a line laid on a surface (Makkonen 15 to 21).

    On each triangle the edge lies in its plane, square to the way. Next to an edge crossed the orientation turns from
    one to the other; the way itself is rounded there. Where the edge's ends would be below the surface by more than
    `blend.over_dig_m`, the way is lifted.

    Args:
        origin: (3,) of the site's local frame, absolute. offset_m: how far above the surface.
        raised_m: how much farther all along, which counts as lifted.

    Raises:
        InputError: for a part too short to be a way.
    """
    points, frames = _corners(tin, part, bucket, origin)
    points[:, 2] += offset_m + raised_m
    path, turned = _blended(points, frames, blend)
    made = SurfacePath(path, part, bucket, offset_m, raised_m, 0.0, 0.0, 0.0, turned, raised_m)
    if blend.over_dig_m is not None:
        made = _lifted(tin, made, points, frames, blend, origin)
    _, T = made.poses(0.5 * LOOKED_M)
    gap = above(tin, edge_points(T, bucket.width_m), origin)
    known = np.isfinite(gap)
    off = np.abs(gap[known] - offset_m).max(initial=0.0)
    below = max(0.0, -float(gap[known].min(initial=0.0)))
    return replace(made, edge_m=float(off), below_m=below, off_surface=1.0 - float(known.mean()))


def _corners(tin: Tin, part: LaidPart, bucket: Bucket, origin: Floats) -> tuple[Floats, Floats]:
    """Return the path's corners (k, 3) less the origin, and the tool's rotations (k - 1, 3, 3) between them."""
    points = part.points - origin
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    keep = [0]
    run = 0.0
    for i, step in enumerate(steps.tolist(), 1):
        run += step
        if run >= SHORTEST_LEG_M or i == len(steps):
            keep.append(i)
            run = 0.0
    if len(keep) > 2 and np.linalg.norm(points[keep[-1]] - points[keep[-2]]) < SHORTEST_LEG_M:
        del keep[-2]
    if float(np.linalg.norm(points[keep[-1]] - points[keep[0]])) < _FEWEST_M:
        raise InputError("too short for a bucket's way", element="line", value=f"{part.length_m:.4f} m")
    ends = points[keep]
    # between two corners kept, the triangle with the longest share of the leg
    owner = [a + int(np.argmax(steps[a:b])) for a, b in itertools.pairwise(keep)]
    normals = tin.normals[part.faces[owner]]
    directions = np.diff(ends, axis=0)
    frames = edge_frames(normals, directions, bucket.cutting_rad)
    straight = directions / np.linalg.norm(directions, axis=1)[:, None]
    turned = angles(np.swapaxes(frames[:-1], -1, -2) @ frames[1:])
    bent = np.linalg.norm(np.diff(straight, axis=0), axis=1)
    corner = np.concatenate([[True], (turned > SAME_RAD) | (bent > SAME_RAD), [True]])
    return ends[corner], frames[corner[:-1]]


def _blended(points: Floats, frames: Floats, blend: Blend) -> tuple[ToolPath, float]:
    """Return the path through corners (k, 3) with rotations (k - 1, 3, 3) between; the most it turns [rad]."""
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    places, turns = [points[0]], [frames[0]]
    most = 0.0
    for i in range(1, len(points) - 1):
        before, after = frames[i - 1], frames[i]
        turn = rotation_vectors((before.T @ after)[None])[0]
        ahead = (points[i + 1] - points[i]) / lengths[i]
        behind = (points[i] - points[i - 1]) / lengths[i - 1]
        reach = [min(blend.turn_m, 0.45 * float(lengths[k])) for k in (i - 1, i)]
        if np.linalg.norm(turn) > SAME_RAD and min(reach) > 1e-4:
            most = max(most, 0.5 * float(np.linalg.norm(turn)))
            middle = before @ rotations(0.5 * turn[None])[0]
            places += [points[i] - reach[0] * behind, points[i], points[i] + reach[1] * ahead]
            turns += [before, middle, after]
        else:
            places.append(points[i])
            turns.append(before)
    places.append(points[-1])
    turns.append(frames[-1])
    return ToolPath.polyline(np.array(places), np.array(turns), blend_m=blend.corner_m), most


def _lifted(tin: Tin, made: SurfacePath, points: Floats, frames: Floats, blend: Blend, origin: Floats) -> SurfacePath:
    """Return the path lifted where its edge would be below the surface by more than allowed."""
    deepest = float(blend.over_dig_m or 0.0)
    own = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    knots, raised = own.copy(), np.zeros(len(own))
    for turn in range(_ROUNDS + 1):
        s, T = made.poses(0.5 * LOOKED_M)
        gap = above(tin, edge_points(T, made.bucket.width_m), origin)
        below = -np.nan_to_num(gap, nan=np.inf).min(axis=1)
        if below.max() <= deepest:
            break
        if turn < _ROUNDS:
            s = s * own[-1] / max(float(s[-1]), 1e-9)  # a lifted way is a hair longer than the line it began as
            knots, raised = _raised(knots, raised, s, np.maximum(below - 0.8 * deepest, 0.0))
        else:
            raised = raised + float(below.max()) - 0.9 * deepest
        at = np.array([np.interp(knots, own, points[:, k]) for k in range(3)]).T
        at[:, 2] += raised
        leg = np.clip(np.searchsorted(own, 0.5 * (knots[1:] + knots[:-1]), side="right") - 1, 0, len(frames) - 1)
        path, turned = _blended(at, frames[leg], blend)
        made = replace(made, path=path, turned_rad=turned, lift_m=made.raised_m + float(raised.max()))
    return made


def _raised(knots: Floats, raised: Floats, s: Floats, need: Floats) -> tuple[Floats, Floats]:
    """Return knots and heights above the line that add what is needed (N,) at s (N,), as few as follow it closely."""
    wanted = np.interp(s, knots, raised) + need
    # a point is held up by what its neighbours need as well: the rounding between knots cuts corners
    wide = np.maximum(wanted, np.maximum(np.append(wanted[1:], 0.0), np.insert(wanted[:-1], 0, 0.0)))
    # where the lift begins and ends there are knots too, so that it does not reach along a whole leg
    needed = np.concatenate([[False], wide > np.interp(s, knots, raised) + 1e-9, [False]])
    begins = np.flatnonzero(needed[1:] & ~needed[:-1])
    ends = np.flatnonzero(needed[:-1] & ~needed[1:]) - 1
    marks = np.concatenate([s[begins] - RAMP_M, s[ends] + RAMP_M])
    marks = marks[[bool(0.0 < at < s[-1] and np.abs(knots - at).min() > SHORTEST_LEG_M) for at in marks]]
    places = np.unique(np.concatenate([knots, marks]))
    places = places[np.concatenate([[True], np.diff(places) > SHORTEST_LEG_M])]
    places[-1] = knots[-1]
    raised, knots = np.interp(places, knots, raised), places
    heights = np.maximum(np.interp(knots, s, wide), raised)
    for _ in range(len(s)):
        short = wide - np.interp(s, knots, heights)
        worst = int(np.argmax(short))
        if short[worst] <= _LIFT_M or np.abs(knots - s[worst]).min() < SHORTEST_LEG_M:
            break
        place = int(np.searchsorted(knots, s[worst]))
        knots, heights = np.insert(knots, place, s[worst]), np.insert(heights, place, wide[worst])
    return knots, heights + np.where(heights > 0.0, _LIFT_M, 0.0)
