"""The exported GLB read back by another program: cells closed and convex, the envelope inside, 5 cm outside."""

import itertools
import json
import struct

import numpy as np
import pytest
import trimesh
from shapely import Point, Polygon

from workgauge.gauge.build import build_limits
from workgauge.gauge.export import write_glb
from workgauge.gauge.rulebook import load_rule_book
from workgauge.site.read import read_site
from workgauge.values.limits import LimitKind

G2 = [
    (1.620, 0.0),
    (1.620, 0.4),
    (1.620, 0.5),
    (1.620, 1.17),
    (1.645, 1.17),
    (1.645, 3.53),
    (1.47, 3.835),
    (0.785, 4.68),
]
Y_UP_TO_Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


@pytest.fixture(scope="module")
def exported(make, tmp_path_factory):
    site = read_site(sorted((make.shipped / "sites" / "double_track").glob("*.xml")))
    limits = build_limits(site, load_rule_book("finland"))
    path = tmp_path_factory.mktemp("glb") / "limits.glb"
    write_glb(limits, path)
    return site, limits, path


def header(path):
    """Return the JSON part of a GLB, checking its framing."""
    data = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON" and size % 4 == 0
    return json.loads(data[20 : 20 + size])


def bodies(path, prefix):
    """Return every connected body of the nodes whose name begins so, east north up in the local frame."""
    scene = trimesh.load(path)
    found = []
    for node in scene.graph.nodes_geometry:
        if node.startswith(prefix):
            T, name = scene.graph[node]
            mesh = scene.geometry[name].copy()
            mesh.apply_transform(T)
            mesh.vertices = mesh.vertices @ Y_UP_TO_Z_UP.T
            found += list(mesh.split(only_watertight=False))
    return found


def test_the_root_places_the_site_and_every_node_names_its_limit(exported):
    site, limits, path = exported
    document = header(path)
    root = document["nodes"][document["scenes"][0]["nodes"][0]]
    e, n, z = limits.frame.origin
    assert root["extras"]["origin"] == {"e": e, "n": n, "z": z}
    assert root["extras"]["epsg"] == site.crs.epsg == 3879
    nodes = [document["nodes"][i] for i in root["children"]]
    known = {limit.id: limit for limit in limits.limits}
    assert {node["extras"]["limit"] for node in nodes} == set(known)
    for node in nodes:
        limit = known[node["extras"]["limit"]]
        assert (node["extras"]["kind"], node["extras"]["rule"]) == (limit.kind, limit.rule)
        mesh = document["meshes"][node["mesh"]]["primitives"][0]
        bounds = document["accessors"][mesh["attributes"]["POSITION"]]
        assert np.max(np.abs(bounds["max"])) < 512  # half a unit in the last place stays below 0.05 mm
        assert document["materials"][mesh["material"]]["name"] == limit.kind
    ranges = [node["extras"]["chainage_m"] for node in nodes if node["extras"]["limit"] == "track:Track 1"]
    assert ranges[0][0] == 0 and ranges[-1][1] == pytest.approx(1200, abs=0.01)
    assert all(a[1] == b[0] for a, b in itertools.pairwise(ranges))


def test_every_body_is_closed_convex_and_outward(exported):
    _, limits, path = exported
    cells = sum(
        len(limit.solid) for limit in limits.limits if limit.kind in (LimitKind.TRACK, LimitKind.OVERHEAD_LINE)
    )
    chains = bodies(path, ("track:", "overhead_line:"))
    assert len(chains) == cells
    for body in [*chains, *bodies(path, ("point:", "line:"))]:
        assert body.is_watertight and body.is_winding_consistent and body.is_convex and body.volume > 0


def depth(body, points):
    """Return how far outside a convex body each point lies (the farthest face counts)."""
    normals, origins = body.face_normals, body.triangles[:, 0]
    return np.max(points @ normals.T - np.sum(origins * normals, axis=1), axis=1)


@pytest.mark.parametrize("name", ["Track 1", "Track 2"])
def test_from_outside_the_envelope_is_inside_and_the_surface_near_it(exported, make, name):
    site, limits, path = exported
    alignment = site.alignment(name)
    oracle = make.oracle(G2, 0.2, widening=make.uic, lean=(0.4, 0.1, 5000.0), base=1.6, pivot="low_rail")
    cells = bodies(path, f"track:{name}")
    low = np.array([body.bounds[0] for body in cells])
    high = np.array([body.bounds[1] for body in cells])
    for d in np.linspace(0.0, alignment.length, 41):
        points = oracle.points(alignment, float(d)) - limits.frame.origin
        near = np.flatnonzero(np.all((low <= points.max(axis=0)) & (high >= points.min(axis=0)), axis=1))
        best = np.min([depth(cells[i], points) for i in near], axis=0)
        assert best.max() <= 0.0
    chosen = [cells[int(i)] for i in np.linspace(0, len(cells) - 1, 15)]
    for body in chosen:
        samples = np.concatenate([body.vertices, body.triangles_center])
        d, offset = alignment.project(samples[:, :2] + limits.frame.origin[:2])
        inner = (d > 0.01) & (d < alignment.length - 0.01)
        for at, left, up in zip(d[inner], offset[inner], samples[inner, 2], strict=True):
            z = up + limits.frame.origin[2] - float(alignment.at(at).z[0])
            ring = Polygon(oracle.section(alignment, float(at)))
            assert ring.distance(Point(left, z)) <= 0.05


def test_an_empty_set_is_still_a_file(make, tmp_path):
    limits = build_limits(make.site(), load_rule_book("generic"))
    write_glb(limits, tmp_path / "none.glb")
    assert header(tmp_path / "none.glb")["nodes"][0]["extras"]["epsg"] is None
