"""How a machine looks: its links' meshes, where the description has them."""

from typing import Any

import numpy as np
import trimesh

from workgauge.cockpit import colours
from workgauge.cockpit.quaternions import quaternion
from workgauge.machine.model import MachineModel
from workgauge.machine.parts import LinkMesh
from workgauge.values.arrays import Floats
from workgauge.values.errors import MachineError


def read_mesh(mesh: LinkMesh) -> trimesh.Trimesh:
    """Return a mesh in the frame of its file, scaled to metres.

    Raises:
        MachineError: if the file is none, or has no triangle or a corner that is no number.
    """
    try:
        found = trimesh.load(mesh.file, force="mesh", process=False)
    except Exception as error:  # every format has errors of its own
        raise MachineError("cannot read the mesh", file=mesh.file, value=str(error).split("\n")[0][:200]) from None
    if not isinstance(found, trimesh.Trimesh) or not len(found.faces) or not np.isfinite(found.vertices).all():
        raise MachineError("no mesh of triangles with finite corners", file=mesh.file)
    found.apply_transform(np.diag([*mesh.scale, 1.0]))
    return found


class Looks:
    """A machine's meshes, placed by a posture below the node of its boxes.

    Args:
        scene: viser's. machine: whose. name: of the node.

    Raises:
        MachineError: as `read_mesh`.
    """

    def __init__(self, scene: Any, machine: MachineModel, name: str) -> None:
        self._meshes = machine.meshes
        self.links = frozenset(mesh.link for mesh in machine.meshes)  #: those that have one
        self._nodes = []
        for i, mesh in enumerate(machine.meshes):
            found, node = read_mesh(mesh), f"{name}/mesh {i}"
            if found.visual.kind is None:
                rgb = colours.MACHINE if mesh.link else colours.UNDERCARRIAGE
                one = scene.add_mesh_simple(node, np.float32(found.vertices), np.uint32(found.faces), color=rgb)
            else:
                one = scene.add_mesh_trimesh(node, found)
            self._nodes.append(one)

    def place(self, T_machine_links: Floats) -> None:
        """Move them to the links' frames (n + 1, 4, 4)."""
        for node, mesh in zip(self._nodes, self._meshes, strict=True):
            T = T_machine_links[mesh.link] @ mesh.T_link_mesh
            node.position, node.wxyz = tuple(T[:3, 3]), quaternion(T[:3, :3])
