"""Limits as a binary glTF 2.0 file (GLB), for looking at and for checking from outside.

One root node turns the site's east, north, up into glTF's y-up axes; below it every part of a limit is a node with a
translation in double precision, so that its single-precision vertices stay within 0.05 mm. The root's `extras` hold
the absolute origin and the EPSG code; each node's hold the limit's id, kind, name, rule, source and chainage.
"""

import json
import struct
from pathlib import Path
from typing import Any

from workgauge.gauge.build import LimitSet
from workgauge.gauge.meshes import MeshPart, mesh_parts
from workgauge.values.limits import Limit, LimitKind
from workgauge.values.solids import Surface

#: Colour (red, green, blue, opacity) of each kind.
COLOURS: dict[LimitKind, tuple[float, float, float, float]] = {
    LimitKind.TRACK: (0.85, 0.16, 0.16, 0.45),
    LimitKind.OVERHEAD_LINE: (0.95, 0.60, 0.10, 0.35),
    LimitKind.POINT: (0.35, 0.35, 0.75, 1.0),
    LimitKind.LINE: (0.15, 0.60, 0.65, 0.8),
    LimitKind.SURFACE: (0.55, 0.47, 0.35, 1.0),
    LimitKind.ZONE: (0.70, 0.20, 0.65, 0.45),
}
FLOAT, UINT32, ARRAY_BUFFER, ELEMENT_BUFFER = 5126, 5125, 34962, 34963
#: Column by column: x stays, north (y) goes to -z, up (z) goes to y.
Z_UP_TO_Y_UP = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]


def write_glb(limit_set: LimitSet, path: Path) -> None:
    """Write limits to a GLB file, replacing it.

    Every convex cell is a closed, outward-wound component; vertices are rounded to single precision about the middle
    of their part, which the solids' own pad of 0.05 mm covers.

    Raises:
        OSError: the file cannot be written.
    """
    document = _Document()
    for limit in limit_set.limits:
        for i, part in enumerate(mesh_parts(limit.solid)):
            document.add(limit, i, part)
    Path(path).write_bytes(document.finish(limit_set))


class _Document:
    """Collects nodes, meshes and their bytes."""

    def __init__(self) -> None:
        self._binary: list[bytes] = []
        self._size = 0
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []
        self._meshes: list[dict[str, Any]] = []
        self._nodes: list[dict[str, Any]] = [{}]
        self._materials = {kind: i for i, kind in enumerate(COLOURS)}

    def add(self, limit: Limit, number: int, part: MeshPart) -> None:
        """Add one part of a limit as a node with its own translation."""
        middle = (part.vertices.min(axis=0) + part.vertices.max(axis=0)) / 2
        vertices = (part.vertices - middle).astype("<f4")
        bounds = {"min": vertices.min(axis=0).tolist(), "max": vertices.max(axis=0).tolist()}
        positions = self._accessor(vertices.tobytes(), len(vertices), FLOAT, "VEC3", ARRAY_BUFFER, bounds)
        indices = part.faces.astype("<u4").ravel()
        triangles = self._accessor(indices.tobytes(), len(indices), UINT32, "SCALAR", ELEMENT_BUFFER, {})
        primitive = {
            "attributes": {"POSITION": positions},
            "indices": triangles,
            "material": self._materials[limit.kind],
            "mode": 4,
        }
        name = limit.id if number == 0 else f"{limit.id} [{number + 1}]"
        self._meshes.append({"name": name, "primitives": [primitive]})
        self._nodes.append(
            {
                "name": name,
                "mesh": len(self._meshes) - 1,
                "translation": middle.tolist(),
                "extras": _extras(limit, part),
            }
        )

    def finish(self, limit_set: LimitSet) -> bytes:
        """Return the whole file."""
        e, n, z = (float(value) for value in limit_set.frame.origin)
        crs = limit_set.frame.crs
        extras = {"origin": {"e": e, "n": n, "z": z}, "epsg": None if crs is None else crs.epsg}
        self._nodes[0] = {
            "name": "site",
            "matrix": Z_UP_TO_Y_UP,
            "extras": {**extras, "rules": limit_set.rules, "axes": "east, north, up below this node [m]"},
        }
        if len(self._nodes) > 1:
            self._nodes[0]["children"] = list(range(1, len(self._nodes)))
        document: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "workgauge"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": self._nodes,
        }
        if self._meshes:
            document |= {
                "meshes": self._meshes,
                "materials": [_material(kind) for kind in COLOURS],
                "accessors": self._accessors,
                "bufferViews": self._views,
                "buffers": [{"byteLength": self._size}],
            }
        text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        if self._meshes:
            chunks += struct.pack("<I4s", self._size, b"BIN\0") + b"".join(self._binary)
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def _accessor(self, data: bytes, count: int, kind: int, shape: str, target: int, bounds: dict[str, Any]) -> int:
        """Append bytes, a multiple of four of them, and return the index of their accessor."""
        view = {"buffer": 0, "byteOffset": self._size, "byteLength": len(data), "target": target}
        self._views.append(view)
        self._binary.append(data)
        self._size += len(data)
        self._accessors.append(
            {"bufferView": len(self._views) - 1, "componentType": kind, "count": count, "type": shape, **bounds}
        )
        return len(self._accessors) - 1


def _extras(limit: Limit, part: MeshPart) -> dict[str, Any]:
    chainage = part.chainage if limit.chainage is not None else None
    return {
        "limit": limit.id,
        "kind": str(limit.kind),
        "name": limit.name,
        "rule": limit.rule,
        "source": {"file": limit.source.file, "feature": limit.source.feature, "line": limit.source.line},
        "chainage_m": None if chainage is None else list(chainage),
        "one_sided": isinstance(limit.solid, Surface),
    }


def _material(kind: LimitKind) -> dict[str, Any]:
    colour = COLOURS[kind]
    return {
        "name": str(kind),
        "pbrMetallicRoughness": {"baseColorFactor": list(colour), "metallicFactor": 0.0, "roughnessFactor": 0.9},
        "alphaMode": "OPAQUE" if colour[3] >= 1.0 else "BLEND",
        "doubleSided": kind is LimitKind.SURFACE,
    }
