"""The chain of joints in a plain URDF file."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree

from workgauge.machine.parts import JointGeometry, LinkMesh
from workgauge.values.arrays import Floats, frozen
from workgauge.values.errors import MachineError
from workgauge.values.transforms import rpy, translation

_MOVING = {"revolute": False, "continuous": False, "prismatic": True}


@dataclass(frozen=True, slots=True, eq=False)
class UrdfJoint:
    """A moving joint of the chain, its child link, and the limits the file gives (None where it gives none)."""

    geometry: JointGeometry
    link: str
    continuous: bool
    lower: float | None
    upper: float | None
    speed: float | None


def read_urdf(path: Path) -> etree._Element:
    """Return the root of a URDF file; entities and the network stay off.

    Raises:
        MachineError: if it is missing, not XML, not a robot, declares a document type, or is unexpanded xacro.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise MachineError("cannot read the URDF", file=path, value=error.strerror) from error
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, remove_comments=True)
    try:
        root = etree.fromstring(content, parser)
    except etree.XMLSyntaxError as error:
        raise MachineError("the URDF is not XML", file=path, line=error.lineno, value=error.msg) from error
    if str(getattr(root.getroottree().docinfo, "doctype", "")):
        raise MachineError("the URDF declares a document type", file=path, allowed="plain URDF")
    if root.tag != "robot":
        raise MachineError("this is no URDF", file=path, line=_line(root), value=root.tag, allowed="<robot>")
    for element in root.iter():
        if "xacro" in str(element.tag) or any("${" in str(value) for value in element.attrib.values()):
            raise MachineError(
                "the URDF still holds xacro",
                file=path,
                line=_line(element),
                allowed="plain URDF: expand it first",
            )
    return root


def urdf_chain(path: Path, base_link: str, tip_link: str, T_machine_base: Floats) -> tuple[UrdfJoint, ...]:
    """Return the moving joints from `base_link` to `tip_link`, fixed joints folded into their neighbours.

    The last moving joint's link frame is the tip link's frame.

    Raises:
        MachineError: as `read_urdf`; if a link is missing, the two are not connected, or a joint is of another kind.
    """
    return _fold(path, _elements(path, base_link, tip_link)[1], T_machine_base)


def urdf_meshes(path: Path, base_link: str, tip_link: str, T_machine_base: Floats) -> tuple[LinkMesh, ...]:
    """Return the visual meshes of the links of `urdf_chain`, those of fixed links with the moving link they hang on.

    `package://` is looked for beside the file and in the folders above it; whether a file is there is not checked.

    Raises:
        MachineError: as `urdf_chain`; for a mesh without file name, or a scale that is none.
    """
    root, elements = _elements(path, base_link, tip_link)
    by_name = {str(link.get("name")): link for link in root.findall("link")}
    hung = [(0, T_machine_base, base_link)]  # each link on the way: the moving link it goes with, and where on it
    link, T = 0, T_machine_base
    for element in elements:
        T = T @ _origin(path, element)
        if element.get("type") in _MOVING:
            link, T = link + 1, np.eye(4)
        hung.append((link, T, _attribute(path, element, "child", "link")))
    T_tip_last = np.linalg.inv(hung[-1][1])  # the last link's frame is the tip's
    return tuple(
        mesh
        for at, T_link, name in hung
        for mesh in _visuals(path, by_name[name], at, T_tip_last @ T_link if at == link else T_link)
    )


def _visuals(path: Path, link: etree._Element, at: int, T_link: Floats) -> list[LinkMesh]:
    """Return the meshes of one URDF link that stands at `T_link` (4, 4) in link `at` of the machine."""
    found = []
    for visual in link.findall("visual"):
        mesh = visual.find("geometry/mesh")
        if mesh is None:
            continue
        name = mesh.get("filename")
        if not name:
            raise MachineError("mesh without filename", file=path, line=_line(mesh), value=link.get("name"))
        scale = _triple(path, mesh, "scale") if mesh.get("scale") else np.ones(3)
        if not scale.all():
            raise MachineError("mesh scaled to nothing", file=path, line=_line(mesh), value=mesh.get("scale"))
        found.append(LinkMesh(at, _mesh_file(path, name), frozen(T_link @ _origin(path, visual)), frozen(scale)))
    return found


def _mesh_file(path: Path, name: str) -> Path:
    """Return where a mesh of a URDF lies."""
    if not name.startswith("package://"):
        return path.parent / name.removeprefix("file://")
    inside = name.removeprefix("package://")
    folders = path.resolve().parents
    places = [folder / inside for folder in folders] + [folder / inside.partition("/")[2] for folder in folders]
    return next((place for place in places if place.is_file()), path.parent / inside)


def _elements(path: Path, base_link: str, tip_link: str) -> tuple[etree._Element, list[etree._Element]]:
    """Return the URDF's root and the joints from one link to the other, the first first."""
    root = read_urdf(path)
    links = [str(link.get("name")) for link in root.findall("link")]
    for name in (base_link, tip_link):
        if name not in links:
            raise MachineError("no such link in the URDF", file=path, value=name, allowed=", ".join(links))
    by_child: dict[str, etree._Element] = {}
    for joint in root.findall("joint"):
        child = _attribute(path, joint, "child", "link")
        if child in by_child:
            raise MachineError("link has two parents", file=path, line=_line(joint), value=child)
        by_child[child] = joint
    elements: list[etree._Element] = []
    link = tip_link
    while link != base_link:
        if link not in by_child or len(elements) > len(by_child):
            raise MachineError(
                f"link {tip_link} does not hang on {base_link}", file=path, value=link, allowed="a chain of joints"
            )
        elements.append(by_child[link])
        link = _attribute(path, by_child[link], "parent", "link")
    return root, elements[::-1]


def _fold(path: Path, elements: list[etree._Element], T_before: Floats) -> tuple[UrdfJoint, ...]:
    joints: list[UrdfJoint] = []
    T = T_before  # from the last moving joint's own frame to here
    for element in elements:
        kind = str(element.get("type"))
        T = T @ _origin(path, element)
        if kind == "fixed":
            continue
        if kind not in _MOVING or element.find("mimic") is not None:
            raise MachineError(
                f"joint {element.get('name')} cannot be driven",
                file=path,
                line=_line(element),
                value="mimic" if kind in _MOVING else kind,
                allowed="fixed, revolute, continuous, prismatic, none of them mimicking",
            )
        joints.append(_moving_joint(path, element, kind, T))
        T = np.eye(4)
    if not joints:
        raise MachineError("the chain has no moving joint", file=path, allowed="at least one")
    last = joints[-1].geometry
    tail = JointGeometry(last.name, last.prismatic, last.T_parent_joint, last.axis, frozen(T))
    joints[-1] = UrdfJoint(
        tail, str(_child(elements)), joints[-1].continuous, joints[-1].lower, joints[-1].upper, joints[-1].speed
    )
    return tuple(joints)


def _child(elements: list[etree._Element]) -> str | None:
    child = elements[-1].find("child")
    return None if child is None else child.get("link")


def _moving_joint(path: Path, element: etree._Element, kind: str, T_parent_joint: Floats) -> UrdfJoint:
    axis_element = element.find("axis")
    axis = np.array([1.0, 0.0, 0.0]) if axis_element is None else _triple(path, axis_element, "xyz")
    length = float(np.linalg.norm(axis))
    if length < 1e-9:
        raise MachineError("joint axis without length", file=path, line=_line(element), value=element.get("name"))
    geometry = JointGeometry(
        name=str(element.get("name")),
        prismatic=_MOVING[kind],
        T_parent_joint=frozen(T_parent_joint),
        axis=frozen(axis / length),
        T_joint_link=frozen(np.eye(4)),
    )
    limit = element.find("limit")
    values: list[float | None] = [None, None, None]
    if limit is not None:
        for i, key in enumerate(("lower", "upper", "velocity")):
            if limit.get(key) is not None:
                values[i] = _numbers(path, limit, key, 1)[0]
    lower, upper, speed = values
    child = _attribute(path, element, "child", "link")
    return UrdfJoint(geometry, child, kind == "continuous", lower, upper, speed)


def _line(element: etree._Element) -> int | None:
    line: Any = element.sourceline
    return line if isinstance(line, int) else None


def _origin(path: Path, element: etree._Element) -> Floats:
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    position = _triple(path, origin, "xyz") if origin.get("xyz") else np.zeros(3)
    angles = _triple(path, origin, "rpy") if origin.get("rpy") else np.zeros(3)
    return translation(*position) @ rpy(*angles)


def _attribute(path: Path, joint: etree._Element, tag: str, key: str) -> str:
    element = joint.find(tag)
    value = None if element is None else element.get(key)
    if not value:
        raise MachineError(f"joint without {tag}", file=path, line=_line(joint), value=joint.get("name"))
    return value


def _triple(path: Path, element: etree._Element, key: str) -> Floats:
    return np.array(_numbers(path, element, key, 3))


def _numbers(path: Path, element: etree._Element, key: str, count: int) -> list[float]:
    text = str(element.get(key))
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(math.isfinite(number) for number in numbers):
        raise MachineError(
            f"bad {key} in <{element.tag}>",
            file=path,
            line=_line(element),
            value=text,
            allowed=f"{count} finite number{'s' if count > 1 else ''}",
        )
    return numbers
