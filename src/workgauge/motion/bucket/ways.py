"""Lines in plan made into ways of the bucket: laid on the surface, cut to what is there and what is reached."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from workgauge.machine.model import MachineModel
from workgauge.motion.bucket.edge import Bucket, above
from workgauge.motion.bucket.reach import (
    BACK_M,
    SHORTEST_M,
    EdgeError,
    clear_of_ends,
    cut_to,
    edge_error,
    followed_from,
    own_edge,
    reached,
)
from workgauge.motion.bucket.surface_path import Blend, SurfacePath, surface_path
from workgauge.motion.ik.task import arm_plane, sample_postures
from workgauge.motion.paths.joint_path import JointPath
from workgauge.site.surface.laid import LaidPart, laid
from workgauge.site.surface.tin import Tin
from workgauge.values.arrays import Floats
from workgauge.values.errors import InputError
from workgauge.values.transforms import apply

#: A way is shortened, or raised, so often until the joints follow it and the edge is nowhere too deep.
_TRIES = 8
#: What the joints are off their path counts as nothing [m].
_ROUGHLY_M = 5e-4


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """One way of the bucket on the surface.

    Attributes:
        line: number of the line in plan it is of, counted from 1. part: the line on the surface.
        made: the edge's path; of one out of reach, that of the whole part.
        joints: the machine's way along it, None if it is out of reach. error: of its edge beside the one wanted.
        below_m: how far any of the edge is below the surface: the machine's own, if it is in reach.
        why: it is out of reach, else empty.
    """

    line: int
    part: LaidPart
    made: SurfacePath
    joints: JointPath | None
    error: EdgeError | None
    below_m: float
    why: str = ""


def swing_axis(machine: MachineModel, T_site_machine: Floats) -> Floats:
    """Return where the swing axis stands (2,), in the site [m]."""
    return np.asarray(apply(T_site_machine, np.append(arm_plane(machine).centre, 0.0))[:2], dtype=np.float64)


def default_reach(machine: MachineModel) -> tuple[float, float]:
    """Return from where to where lines run by default: clear of the undercarriage, as far as the tool comes [m]."""
    solids = [s for s in machine.solids if s.link == 0]
    front = max((float(s.T_link_box[0, 3] + s.half_extents[0]) for s in solids), default=1.0)
    centre = arm_plane(machine).centre
    tools = np.array([machine.tool_pose(machine.forward(q))[:2, 3] for q in _stretched(machine)])
    return front + 0.5, float(np.linalg.norm(tools - centre, axis=1).max())


def _stretched(machine: MachineModel) -> Floats:
    """Return postures (k, n) among which the farthest reaching are."""
    samples = sample_postures(machine)
    ends = np.clip(np.zeros((1, machine.n)), machine.sample_min, machine.sample_max)
    return np.concatenate([samples, ends, np.clip(ends, machine.home - 1.0, machine.home + 1.0)])


def ways(
    tin: Tin,
    lines: Sequence[Floats],
    machine: MachineModel,
    T_site_machine: Floats,
    origin: Floats,
    bucket: Bucket,
    blend: Blend,
) -> tuple[list[Way], list[str]]:
    """Return the ways of lines in plan (p, 2 each, absolute), and what is to be said of them.

    Args:
        T_site_machine: (4, 4) in the site's local frame, whose origin (3,) is absolute.
    """
    found: list[Way] = []
    said: list[str] = []
    for number, line in enumerate(lines, 1):
        try:
            on = laid(tin, line)
        except InputError as error:
            said.append(f"line {number}: {error.message}")
            continue
        if not on.parts:
            said.append(f"line {number}: no surface under it")
        else:
            inner = [gap for gap in on.gaps if gap[0] > 1e-6 and gap[1] < on.length_m - 1e-6]
            said += [f"line {number}: no surface under it from {a:.2f} to {b:.2f} m, left out" for a, b in inner]
            outer = sum(b - a for a, b in on.gaps) - sum(b - a for a, b in inner)
            if outer > 0.05:
                said.append(f"line {number}: {outer:.2f} m at its ends lie beside the surface and are left out")
            said += [
                f"line {number}: the surface jumps by {rise:+.3f} m at {at:.2f} m; the way ends there"
                for at, rise in on.steps
            ]
        for part in on.parts:
            if part.length_m >= SHORTEST_M:
                found += _of_part(tin, number, part, machine, T_site_machine, origin, bucket, blend, said)
            else:
                said.append(f"line {number}: a stretch of {part.length_m:.2f} m is too short and left out")
    return found, said


def _of_part(
    tin: Tin,
    number: int,
    part: LaidPart,
    machine: MachineModel,
    T_site_machine: Floats,
    origin: Floats,
    bucket: Bucket,
    blend: Blend,
    said: list[str],
) -> list[Way]:
    """Return the ways of one stretch that the machine reaches, or the whole one out of reach."""
    whole = surface_path(tin, part, bucket, blend, origin)
    spans = reached(machine, whole, T_site_machine)
    scale = part.length_m / max(whole.path.length_m, 1e-9)
    ways_found: list[Way] = []
    for begin, end in spans:
        way = _fitted(tin, number, part, (begin * scale, end * scale), machine, T_site_machine, origin, whole, blend)
        if way is not None:
            ways_found.append(way)
    if not ways_found:
        _, _, why = followed_from(machine, whole.path, T_site_machine, machine.home)
        said.append(f"line {number}: not reached: {why}")
        return [Way(number, part, whole, None, None, whole.below_m, why or "out of reach")]
    left = part.length_m - sum(way.part.length_m for way in ways_found)
    if left > 0.05:
        said.append(f"line {number}: {left:.2f} of {part.length_m:.2f} m are out of reach and cut off")
    for way in ways_found:
        if way.made.off_surface > 0.0:
            said.append(f"line {number}: {_percent(way.made.off_surface)} of the edge's way has no surface under it")
        if way.made.lift_m > 0.0:
            said.append(
                f"line {number}: lifted by up to {way.made.lift_m:.3f} m to keep the edge's ends out of the ground"
            )
    return ways_found


def at_height(
    tin: Tin, way: Way, machine: MachineModel, T_site_machine: Floats, origin: Floats, blend: Blend, offset_m: float
) -> tuple[list[SurfacePath], float]:
    """Return the paths above a way that is in reach, cut to what is reached so high; and what is cut off [m]."""
    if offset_m <= 0.0:
        return [way.made], 0.0
    part, made = way.part, way.made
    whole = surface_path(tin, part, made.bucket, blend, origin, offset_m=offset_m, raised_m=made.raised_m)
    if followed_from(machine, whole.path, T_site_machine, machine.home)[0] is not None:
        return [whole], 0.0
    found: list[Way] = []
    scale = part.length_m / whole.path.length_m
    for begin, end in reached(machine, whole, T_site_machine):
        span = (begin * scale, end * scale)
        fitted = _fitted(tin, way.line, part, span, machine, T_site_machine, origin, whole, blend)
        found += [] if fitted is None else [fitted]
    return [one.made for one in found], part.length_m - sum(one.part.length_m for one in found)


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share >= 0.005 else "less than 1 %"


def _fitted(
    tin: Tin,
    number: int,
    part: LaidPart,
    span: tuple[float, float],
    machine: MachineModel,
    T_site_machine: Floats,
    origin: Floats,
    whole: SurfacePath,
    blend: Blend,
) -> Way | None:
    """Return the way on a stretch (from, to) of a part, shortened until the joints follow it to its end."""
    begin, end = span
    raised = whole.raised_m
    for _ in range(_TRIES):
        if end - begin < SHORTEST_M:
            return None
        cut = part if begin <= 0.0 and end >= part.length_m - 1e-6 else cut_to(part, begin, end)
        if cut is part and raised == whole.raised_m:
            made = whole
        else:
            made = surface_path(tin, cut, whole.bucket, blend, origin, offset_m=whole.offset_m, raised_m=raised)
        joints, came, _ = followed_from(machine, made.path, T_site_machine, machine.home)
        if joints is not None:
            low, high = clear_of_ends(machine, joints)
            length = joints.length_m
            if high - low < length - 1e-6:
                scale = (end - begin) / length
                begin, end = begin + low * scale, begin + high * scale
                continue
            width = whole.bucket.width_m
            below = max(0.0, -float(np.nanmin(above(tin, own_edge(machine, joints, width), origin), initial=0.0)))
            if blend.over_dig_m is None or below <= max(blend.over_dig_m, made.below_m) + _ROUGHLY_M:
                return Way(number, cut, made, joints, edge_error(machine, joints, width), below)
            raised += below - 0.9 * blend.over_dig_m  # its ends dip where its joints cannot turn it as wanted
            continue
        if came < BACK_M:
            begin += 2.5 * BACK_M
        else:
            end = begin + came * (end - begin) / made.path.length_m - BACK_M
    return None
