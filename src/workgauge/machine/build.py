"""From a valid description to a machine: names resolved, limits checked, self-collision pairs found."""

import dataclasses
import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from workgauge.machine.chain import dh_chain, matrix_of, pose_matrix
from workgauge.machine.cylinder import Cylinder
from workgauge.machine.description import (
    UNDERCARRIAGE,
    AttachmentSpec,
    BoxSpec,
    Joint,
    MachineDescription,
    MeshSpec,
    Pose,
    RevoluteJoint,
)
from workgauge.machine.faults import DescriptionError, Place
from workgauge.machine.located import check_positioning
from workgauge.machine.model import MachineModel
from workgauge.machine.pairs import find_self_pairs
from workgauge.machine.parts import JointGeometry, LinkMesh, LinkSolid, Pump, Sensor, Stopping, Stretch, Undercarriage
from workgauge.machine.urdf import UrdfJoint, urdf_chain, urdf_meshes
from workgauge.values.arrays import freeze, frozen

_LITRES_PER_MINUTE = 1e-3 / 60.0

#: Ends of the names of mesh files that can be drawn.
MESH_FILES = (".stl", ".obj", ".ply", ".glb", ".off")


@dataclasses.dataclass(frozen=True, slots=True)
class _Range:
    """Limits, speeds and home of one joint, in radians or metres."""

    lower: float
    upper: float
    home: float
    speed_positive: float
    speed_negative: float
    continuous: bool


def build(name: str, description: MachineDescription, folder: Path, attachment: str | None = None) -> MachineModel:
    """Return the machine with an attachment mounted (the first if None).

    Args:
        name: what the machine is called. folder: where relative file names in the description start.

    Raises:
        DescriptionError: where the description contradicts itself. MachineError: for a URDF that cannot be used.
    """
    chain, ranges, links = _joints(description, folder)
    mounted = _attachment(description, attachment)
    solids = _solids(description, mounted, links, ranges)
    joint_names = tuple(joint.name for joint in description.joints)
    continuous = np.array([r.continuous for r in ranges])
    prismatic = np.array([joint.prismatic for joint in chain])
    freeze(continuous)
    freeze(prismatic)
    machine = MachineModel(
        name=name,
        title=description.title,
        attachment=mounted.name,
        attachments=tuple(known.name for known in description.attachments),
        joint_names=joint_names,
        link_names=links,
        q_min=frozen([r.lower for r in ranges]),
        q_max=frozen([r.upper for r in ranges]),
        continuous=continuous,
        prismatic=prismatic,
        speed_positive=frozen([r.speed_positive for r in ranges]),
        speed_negative=frozen([r.speed_negative for r in ranges]),
        home=frozen([r.home for r in ranges]),
        levers=_levers(description),
        lever_signs=frozen([joint.lever_sign for joint in description.joints]),
        exclusive_groups=_exclusive_groups(description, joint_names),
        stopping_positive=tuple(_stopping(joint, 1) for joint in description.joints),
        stopping_negative=tuple(_stopping(joint, -1) for joint in description.joints),
        pump=_pump(description),
        cylinders=tuple(_cylinder(i, joint, ranges[i]) for i, joint in enumerate(description.joints)),
        solids=solids,
        meshes=_meshes(description, mounted, links, folder),
        undercarriage=Undercarriage(
            description.undercarriage.kind, description.undercarriage.gauge_m, description.undercarriage.height_m
        ),
        sensors=_sensors(description, links),
        positioning=description.positioning,
        self_stop_distance_m=description.self_stop_distance_m,
        T_link_tool=matrix_of(mounted.tool or Pose()),
        tool_tolerance_m=mounted.tolerance_m or 0.0,
        chain=chain,
    )
    check_positioning(machine)
    pairs, skipped = find_self_pairs(machine, _allowed_contacts(description))
    return dataclasses.replace(machine, self_pairs=pairs, skipped_pairs=skipped)


def _joints(
    description: MachineDescription, folder: Path
) -> tuple[tuple[JointGeometry, ...], list[_Range], tuple[str, ...]]:
    _unique([joint.name for joint in description.joints], "joints")
    given: Sequence[UrdfJoint | None] = [None] * len(description.joints)
    if description.urdf is None:
        chain = dh_chain(description)
    else:
        urdf = description.urdf
        given = read = urdf_chain(folder / urdf.file, urdf.base_link, urdf.tip_link, matrix_of(description.base))
        chain = tuple(joint.geometry for joint in read)
        listed = [joint.name for joint in description.joints]
        found = [joint.name for joint in chain]
        if listed != found:
            raise DescriptionError(("joints",), "not the URDF's joints", ", ".join(listed), ", ".join(found))
        for i, (joint, geometry) in enumerate(zip(description.joints, chain, strict=True)):
            if (joint.type == "prismatic") != geometry.prismatic:
                kind = "prismatic" if geometry.prismatic else "revolute"
                raise DescriptionError(("joints", i, "type"), "the URDF has it otherwise", joint.type, kind)
    ranges, links = [], [UNDERCARRIAGE]
    for i, (joint, found_joint) in enumerate(zip(description.joints, given, strict=True)):
        ranges.append(_range(i, joint, found_joint))
        links.append(joint.link or (found_joint.link if found_joint else joint.name))
    _unique(links, "joints", "link")
    return chain, ranges, tuple(links)


def _levers(description: MachineDescription) -> tuple[str | None, ...]:
    levers = tuple(joint.lever for joint in description.joints)
    for i, lever in enumerate(levers):
        if lever is not None and lever in levers[:i]:
            raise DescriptionError(
                ("joints", i, "lever"), "lever moves another joint already", lever, "one joint each"
            )
    return levers


def _range(i: int, joint: Joint, urdf: UrdfJoint | None) -> _Range:
    """Return limits, speeds and home of joint i in SI units: the description's own first, then the URDF's."""
    turning = isinstance(joint, RevoluteJoint)
    unit = "deg" if turning else "m"
    scale = math.radians(1.0) if turning else 1.0
    continuous = isinstance(joint, RevoluteJoint) and (
        joint.continuous if joint.continuous is not None else urdf is not None and urdf.continuous
    )

    def value(key: str, fallback: float | None) -> float:
        described = getattr(joint, key)
        if described is not None:
            return float(described) * scale
        if fallback is None:
            raise DescriptionError(("joints", i, key), "missing key", allowed="a number, here or in the URDF")
        return fallback

    speed = urdf.speed if urdf else None
    speeds = [value(f"speed_{direction}_{unit}_s", speed) for direction in ("positive", "negative")]
    if min(speeds) <= 0.0:
        raise DescriptionError(
            ("joints", i), "speed must be above 0", min(speeds), "a speed above 0, here or in the URDF"
        )
    home = value(f"home_{unit}", None)
    if continuous:
        for key in ("lower_deg", "upper_deg"):
            if getattr(joint, key) is not None:
                raise DescriptionError(
                    ("joints", i, key), "a joint that turns without end has no limits", getattr(joint, key)
                )
        return _Range(-math.inf, math.inf, home, speeds[0], speeds[1], True)
    lower = value(f"lower_{unit}", urdf.lower if urdf else None)
    upper = value(f"upper_{unit}", urdf.upper if urdf else None)
    if lower >= upper:
        message = f"limits are crossed: lower {lower / scale:g}, upper {upper / scale:g}"
        raise DescriptionError(
            ("joints", i, f"lower_{unit}"), message, f"{lower / scale:g}", f"below {upper / scale:g}"
        )
    if not lower <= home <= upper:
        allowed = f"{lower / scale:g} to {upper / scale:g}"
        raise DescriptionError(
            ("joints", i, f"home_{unit}"), "home posture outside the limits", f"{home / scale:g}", allowed
        )
    return _Range(lower, upper, home, speeds[0], speeds[1], False)


def _attachment(description: MachineDescription, attachment: str | None) -> AttachmentSpec:
    names = [known.name for known in description.attachments]
    _unique(names, "attachments")
    if attachment is not None and attachment not in names:
        raise DescriptionError(("attachments",), "unknown attachment", attachment, ", ".join(names))
    at = 0 if attachment is None else names.index(attachment)
    mounted = description.attachments[at]
    missing = [key for key in ("tool", "tolerance_m") if getattr(mounted, key) is None]
    if description.positioning is None and mounted.tool is not None:
        missing = []
    if missing:
        raise DescriptionError(
            ("attachments", at),
            f"attachment {mounted.name} is not measured up, it has no {' and no '.join(missing)}",
            allowed="what `workgauge measure-up` prints, or a declared tool and tolerance_m",
        )
    return mounted


def _solids(
    description: MachineDescription, mounted: AttachmentSpec, links: tuple[str, ...], ranges: list[_Range]
) -> tuple[LinkSolid, ...]:
    fixed = [box.name for box in description.solids]
    _unique(fixed, "solids")
    for i, attachment in enumerate(description.attachments):
        for j, box in enumerate(attachment.boxes):
            if box.name in fixed or box.name in [other.name for other in attachment.boxes[:j]]:
                raise DescriptionError(
                    ("attachments", i, "boxes", j, "name"), "name used twice", box.name, "unique names"
                )
    solids: list[LinkSolid] = []
    places: list[Place] = []
    for i, link_box in enumerate(description.solids):
        place: Place = ("solids", i)
        link = _index(links, link_box.link, (*place, "link"), "unknown link")
        solids.append(_solid(link_box, link, place, description, ranges))
        places.append(place)
    at = description.attachments.index(mounted)
    for j, box in enumerate(mounted.boxes):
        place = ("attachments", at, "boxes", j)
        solids.append(_solid(box, len(links) - 1, place, description, ranges))
        places.append(place)
    for solid, place in zip(solids, places, strict=True):
        if solid.stretch and sum(other.link == solid.link for other in solids) > 1:
            raise DescriptionError(
                (*place, "stretch"), "another box on a link that stretches", links[solid.link], "one box"
            )
    return tuple(sorted(solids, key=lambda solid: solid.link))


def _solid(box: BoxSpec, link: int, place: Place, description: MachineDescription, ranges: list[_Range]) -> LinkSolid:
    half_extents = frozen([0.5 * length for length in box.size_m])
    stretch = None
    if box.stretch is not None:
        names = tuple(joint.name for joint in description.joints)
        joint = _index(names, box.stretch.joint, (*place, "stretch", "joint"), "unknown joint")
        if description.joints[joint].type != "prismatic":
            raise DescriptionError((*place, "stretch", "joint"), "not a prismatic joint", box.stretch.joint)
        axis = "xyz".index(box.stretch.axis)
        shortest = box.size_m[axis] + ranges[joint].lower
        if shortest <= 0.0:
            raise DescriptionError(
                (*place, "size_m"), "no length left at the joint's lower limit", shortest, "above 0 m"
            )
        stretch = Stretch(joint, axis, 1 if box.stretch.side == "positive" else -1)
    return LinkSolid(link, box.name, pose_matrix(box.centre_m, box.rpy_deg), half_extents, stretch)


def _meshes(
    description: MachineDescription, mounted: AttachmentSpec, links: tuple[str, ...], folder: Path
) -> tuple[LinkMesh, ...]:
    """Return how links look: meshes of the description, and those of the URDF that are there and can be drawn."""
    found: list[LinkMesh] = []
    for i, spec in enumerate(description.meshes):
        place: Place = ("meshes", i)
        found.append(_mesh(spec, _index(links, spec.link, (*place, "link"), "unknown link"), place, folder))
    at = description.attachments.index(mounted)
    for j, worn in enumerate(mounted.meshes):
        found.append(_mesh(worn, len(links) - 1, ("attachments", at, "meshes", j), folder))
    if description.urdf is not None:
        urdf = description.urdf
        base = matrix_of(description.base)
        seen = urdf_meshes(folder / urdf.file, urdf.base_link, urdf.tip_link, base)
        found.extend(one for one in seen if one.file.suffix.lower() in MESH_FILES and one.file.is_file())
    return tuple(found)


def _mesh(spec: MeshSpec, link: int, place: Place, folder: Path) -> LinkMesh:
    file = folder / spec.file
    if file.suffix.lower() not in MESH_FILES:
        raise DescriptionError((*place, "file"), "not a mesh that can be drawn", spec.file, ", ".join(MESH_FILES))
    if not file.is_file():
        raise DescriptionError((*place, "file"), "no such file", spec.file, f"a path relative to {folder}")
    return LinkMesh(link, file, pose_matrix(spec.position_m, spec.rpy_deg), frozen([spec.scale] * 3))


def _sensors(description: MachineDescription, links: tuple[str, ...]) -> tuple[Sensor, ...]:
    _unique([sensor.name for sensor in description.sensors], "sensors")
    return tuple(
        Sensor(
            sensor.name,
            sensor.kind,
            _index(links, sensor.link, ("sensors", i, "link"), "unknown link"),
            pose_matrix(sensor.position_m, sensor.rpy_deg),
        )
        for i, sensor in enumerate(description.sensors)
    )


def _exclusive_groups(description: MachineDescription, joints: tuple[str, ...]) -> tuple[tuple[int, ...], ...]:
    seen: set[str] = set()
    if len(description.exclusive_groups) == 1:
        raise DescriptionError(("exclusive_groups",), "a group alone excludes nothing", allowed="two groups or more")
    for g, group in enumerate(description.exclusive_groups):
        for k, name in enumerate(group):
            place = ("exclusive_groups", g, k)
            _index(joints, name, place, "unknown joint")
            if name in seen:
                raise DescriptionError(place, "joint in two groups", name, "each joint in one group at most")
            seen.add(name)
    return tuple(tuple(sorted(joints.index(name) for name in group)) for group in description.exclusive_groups)


def _stopping(joint: Joint, direction: int) -> Stopping:
    spec = joint.stopping_positive if direction > 0 else joint.stopping_negative
    return Stopping(spec.dead_time_s, spec.lag_s, spec.deceleration, spec.tolerance_percent / 100.0)


def _cylinder(i: int, joint: Joint, limits: _Range) -> Cylinder | None:
    spec = joint.cylinder if isinstance(joint, RevoluteJoint) else None
    if spec is None:
        return None
    cylinder = Cylinder(spec.a_m, spec.b_m, math.radians(spec.offset_deg), limits.lower, limits.upper)
    if limits.continuous or not cylinder.fits:
        raise DescriptionError(
            ("joints", i, "cylinder", "offset_deg"),
            "the cylinder's triangle folds or stretches out within the joint's limits",
            spec.offset_deg,
            "an angle at the joint between 1 and 179 degrees over its whole range",
        )
    return cylinder


def _pump(description: MachineDescription) -> Pump | None:
    if description.pump is None:
        return None
    flows = [
        [(flow or 0.0) * _LITRES_PER_MINUTE for flow in (joint.flow_positive_l_min, joint.flow_negative_l_min)]
        for joint in description.joints
    ]
    positive, negative = zip(*flows, strict=True)
    return Pump(description.pump.flow_l_min * _LITRES_PER_MINUTE, frozen(positive), frozen(negative))


def _allowed_contacts(description: MachineDescription) -> frozenset[frozenset[str]]:
    known = [box.name for box in description.solids]
    known += [box.name for attachment in description.attachments for box in attachment.boxes]
    for i, contact in enumerate(description.allowed_contacts):
        for k, name in enumerate(contact):
            _index(tuple(known), name, ("allowed_contacts", i, k), "unknown box")
    return frozenset(frozenset(contact) for contact in description.allowed_contacts)


def _index(known: tuple[str, ...], name: str, place: Place, message: str) -> int:
    if name not in known:
        raise DescriptionError(place, message, name, ", ".join(known))
    return known.index(name)


def _unique(names: Sequence[str], key: str, inner: str = "name") -> None:
    for name, count in Counter(names).items():
        if count > 1:
            last = len(names) - 1 - list(names)[::-1].index(name)
            at = last - 1 if inner == "link" else last  # links are counted from the undercarriage
            raise DescriptionError((key, at, inner), "name used twice", name, "unique names")
