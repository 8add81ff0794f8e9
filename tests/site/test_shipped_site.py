"""The shipped double track, read back with the package's readers and held against its generator's closed forms."""

import importlib
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import yaml

import workgauge
from workgauge.site.alignment import Alignment
from workgauge.site.model import LineFeature, SiteModel, SurfaceModel
from workgauge.site.read import read_site

ROOT = Path(__file__).resolve().parents[2]
FOLDER = Path(workgauge.__file__).resolve().parent / "shipped" / "sites" / "double_track"
FILES = ("catenary.xml", "terrain.xml", "tracks.xml", "trackside.xml")
HALF_WIDTH = 1.9


def load(name: str) -> ModuleType:
    sys.path.insert(0, str(ROOT / "examples"))
    try:
        return importlib.import_module(name)
    finally:
        sys.path.pop(0)


@pytest.fixture(scope="module")
def geometry() -> ModuleType:
    return load("double_track_geometry")


@pytest.fixture(scope="module")
def tracks(geometry: ModuleType) -> dict[str, object]:
    return {track.name: track for track in geometry.make_tracks()}


@pytest.fixture(scope="module")
def ground(geometry: ModuleType) -> object:
    return geometry.make_terrain(*geometry.make_tracks())


@pytest.fixture(scope="module")
def site() -> SiteModel:
    return read_site([FOLDER / name for name in FILES])


def lines(site: SiteModel, code: str) -> list[LineFeature]:
    return [line for line in site.lines if line.code == code]


def surface_height(surface: SurfaceModel, points: np.ndarray) -> np.ndarray:
    """Heights of plan points (k, 2) by trying every face: slow, and none of the package's own."""
    a, b, c = (surface.vertices[surface.faces[:, corner]] for corner in range(3))
    out = np.full(len(points), np.nan)
    for index, point in enumerate(points):
        sides = [
            (q[:, 0] - p[:, 0]) * (point[1] - p[:, 1]) - (q[:, 1] - p[:, 1]) * (point[0] - p[:, 0])
            for p, q in ((b, c), (c, a), (a, b))
        ]
        area = sum(sides)
        hit = np.flatnonzero(np.all([side >= -1e-6 for side in sides], axis=0))
        if len(hit):
            face = hit[0]
            weights = [side[face] / area[face] for side in sides]
            out[index] = weights[0] * a[face, 2] + weights[1] * b[face, 2] + weights[2] * c[face, 2]
    return out


def test_the_generator_writes_the_shipped_files_byte_for_byte() -> None:
    made = load("make_double_track_site").make_files()
    assert sorted(made) == sorted(FILES) == sorted(path.name for path in FOLDER.glob("*.xml"))
    for name, content in made.items():
        assert (FOLDER / name).read_bytes() == content, name
    assert sum(map(len, made.values())) < 3_000_000


def test_a_site_without_doubts(site: SiteModel) -> None:
    assert [line for line in site.warnings if "cant is read in meter" not in line] == []
    assert site.crs is not None and site.crs.epsg == 3879
    assert [alignment.name for alignment in site.alignments] == ["Track 1", "Track 2"]
    assert [alignment.codes["terrainCoding"] for alignment in site.alignments] == ["111", "281"]
    for alignment in site.alignments:
        assert alignment.element_counts == {"line": 2, "curve": 1, "spiral": 2}
        assert alignment.cant_stations == 4
        assert alignment.cant_gauge_m == 1.524
        assert alignment.cant_rotation_point == "insideRail"
        assert alignment.has_profile


@pytest.mark.parametrize("name", ["Track 1", "Track 2"])
def test_tracks_lie_where_the_generator_put_them(
    site: SiteModel, geometry: ModuleType, tracks: dict[str, object], name: str
) -> None:
    alignment, truth = site.alignment(name), tracks[name]
    assert alignment.length == pytest.approx(truth.length, abs=1e-5)
    assert alignment.declared_length == pytest.approx(truth.length, abs=1e-5)
    d = np.sort(np.concatenate([np.linspace(0, truth.length, 2401), truth.starts]))
    state, want = alignment.at(d), truth.at(d)
    np.testing.assert_allclose(state.e, want[:, 0] + geometry.ORIGIN[0], rtol=0, atol=1e-4)
    np.testing.assert_allclose(state.n, want[:, 1] + geometry.ORIGIN[1], rtol=0, atol=1e-4)
    np.testing.assert_allclose(state.z, want[:, 4], rtol=0, atol=1e-4)
    np.testing.assert_allclose(state.cant, want[:, 5], rtol=0, atol=1e-6)
    np.testing.assert_allclose(state.heading, math.pi / 2 - want[:, 2], rtol=0, atol=1e-5)
    np.testing.assert_allclose(state.curvature, want[:, 3], rtol=0, atol=1e-7)


def test_curve_of_600_m_and_its_cant(site: SiteModel) -> None:
    state = site.alignment("Track 1").at(np.linspace(400.001, 799.999, 50))
    np.testing.assert_allclose(state.curvature, 1 / 600, rtol=1e-9)
    np.testing.assert_allclose(state.cant, 0.100, atol=1e-9)
    before = site.alignment("Track 1").at([0, 299.9, 350, 900.1, 1200])
    np.testing.assert_allclose(before.cant, [0, 0, 0.05, 0, 0], atol=1e-9)


def test_spacing_of_the_tracks(site: SiteModel) -> None:
    first, second = site.alignments
    d = np.linspace(1.0, 1199.0, 600)
    state = first.at(d)
    distance, offset = second.project(np.column_stack([state.e, state.n]))
    spacing = -offset  # Track 1 lies right of Track 2
    straight, arc = (d < 299) | (d > 901), (d > 406) & (d < 794)
    np.testing.assert_allclose(spacing[straight], 4.5, atol=5e-4)
    np.testing.assert_allclose(spacing[arc], 4.652, atol=1e-3)
    assert spacing.min() > 4.499 and spacing.max() < 4.66
    np.testing.assert_allclose(second.at(distance).z, state.z, atol=5e-3)


@pytest.mark.parametrize(("name", "side"), [("Track 1", -1.0), ("Track 2", 1.0)])
def test_poles_every_50_m_and_clear_of_both_tracks(site: SiteModel, name: str, side: float) -> None:
    poles = [p for p in site.points if p.code == "CATENARY_POLE" and p.name.startswith(f"P{name[-1]}-")]
    assert [p.name for p in poles] == [f"P{name[-1]}-{k:02d}" for k in range(1, 25)]
    assert {p.desc for p in poles} == {"Catenary pole"}
    places = np.array([p.position for p in poles])
    distance, offset = site.alignment(name).project(places[:, :2])
    np.testing.assert_allclose(distance, 25 + 50 * np.arange(24), atol=2e-3)
    assert ((offset * side > 3.099) & (offset * side < 3.301)).all()
    for alignment in site.alignments:
        _, clear = alignment.project(places[:, :2])
        assert (np.abs(clear) - 0.15 > HALF_WIDTH + 0.3).all()
    (surface,) = site.surfaces
    np.testing.assert_allclose(surface_height(surface, places[:, :2]), places[:, 2], atol=2e-3)


def rail_plane_place(alignment: Alignment, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lateral and height of points (k, 3) in the turned rail plane's axes, from the low (left) rail."""
    distance, offset = alignment.project(points[:, :2])
    state = alignment.at(distance)
    angle = np.arcsin(state.cant / 1.6)
    left, up = offset - 0.8, points[:, 2] - state.z
    return left * np.cos(angle) - up * np.sin(angle) + 0.8, left * np.sin(angle) + up * np.cos(angle)


def test_contact_wires(site: SiteModel) -> None:
    wires = lines(site, "OVERHEAD_LINE_25KV")
    assert [wire.name for wire in wires] == ["Contact wire 1", "Contact wire 2"]
    for wire, alignment in zip(wires, site.alignments, strict=True):
        assert wire.desc == "Overhead line 25 kV"
        assert len(wire.points) == 26
        lateral, up = rail_plane_place(alignment, wire.points)
        np.testing.assert_allclose(up, 6.15, atol=2e-3)
        np.testing.assert_allclose(np.abs(lateral[1:-1]), 0.30, atol=2e-3)
        dense = np.concatenate(
            [
                a + (b - a) * np.linspace(0, 1, 11)[:, None]
                for a, b in zip(wire.points[:-1], wire.points[1:], strict=True)
            ]
        )
        lateral, up = rail_plane_place(alignment, dense)
        assert up.min() > 6.05 and up.max() < 6.25
        assert np.abs(lateral).max() < 0.35


def test_signals_cable_and_drain(site: SiteModel, geometry: ModuleType, tracks: dict[str, object]) -> None:
    signals = [p for p in site.points if p.code == "SIGNAL"]
    assert [p.name for p in signals] == ["S101", "S102"]
    assert len(site.points) == 74
    (cable,) = lines(site, "CABLE")
    _, offset = site.alignment("Track 2").project(cable.points[:, :2])
    np.testing.assert_allclose(offset, 3.7, atol=2e-3)
    drains = lines(site, "DRAIN_PIPE")
    assert [pipe.name for pipe in drains] == [f"D{k:02d}" for k in range(1, 24)]
    wells = geometry.make_wells(tracks["Track 1"])
    for pipe, a, b in zip(drains, wells[:-1], wells[1:], strict=True):
        assert pipe.kind == "pipe" and pipe.diameter_m == pytest.approx(0.16)
        plan = pipe.points[[0, -1], :2] - geometry.ORIGIN[:2]
        np.testing.assert_allclose(plan, [a.position[:2], b.position[:2]], atol=2e-3)
        invert = pipe.points[[0, -1], 2] - [a.position[2], b.position[2]]
        assert (np.abs(invert) < 2e-3).all() or (np.abs(invert - 0.08) < 2e-3).all()  # invert or axis
    (surface,) = site.surfaces
    for line in (cable, *drains):
        middle = (line.points[:-1] + line.points[1:]) / 2
        assert (surface_height(surface, middle[:, :2]) - middle[:, 2] > 0.4).all()


def test_ground_lies_under_the_rails_and_reaches_25_m(
    site: SiteModel, geometry: ModuleType, ground: object, tracks: dict[str, object]
) -> None:
    (surface,) = site.surfaces
    assert (surface.name, surface.code) == ("Terrain", "1")
    assert surface.vertices.shape == (3025, 3) and surface.faces.shape == (5760, 3)
    np.testing.assert_allclose(surface.vertices, ground.vertices + geometry.ORIGIN, atol=6e-4)
    triangles = ground.vertices[ground.faces]
    u, v = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    assert surface.plan_area_m2 == pytest.approx(float(np.sum(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2), abs=1e-2)
    for alignment in site.alignments:
        state = alignment.at(np.linspace(0.5, alignment.length - 0.5, 150))
        for left in (-1.3, -0.8, 0.0, 0.8, 1.3):
            under = surface_height(surface, state.offset_points(left))
            rail = state.z + geometry.rail_plane(state.cant, left)
            np.testing.assert_allclose(rail - under, 0.25, atol=0.01)
    first, second = site.alignments
    for alignment, outside in ((first, -24.9), (second, 24.9)):
        edge = alignment.at(np.linspace(1.0, alignment.length - 1.0, 60)).offset_points(outside)
        heights = surface_height(surface, edge)
        assert np.isfinite(heights).all()


def test_the_place_to_start_named_in_the_readme(site: SiteModel) -> None:
    scenario = yaml.safe_load((FOLDER.parents[1] / "scenarios" / "pole-approach.yaml").read_text())
    assert scenario["start"]["on_track"] == {"alignment": "Track 1", "distance_m": 573.0, "facing": "forward"}
    machine = site.alignment("Track 1").at(573.0)
    assert (machine.e[0], machine.n[0]) == pytest.approx((25487287.080, 6714594.936), abs=1e-3)
    assert math.degrees(machine.heading[0]) == pytest.approx(41.705, abs=1e-3)
    assert machine.z[0] == pytest.approx(80.124, abs=1e-3)
    pole = next(p for p in site.points if p.name == "P1-12").position
    away = pole[:2] - [machine.e[0], machine.n[0]]
    ahead = away @ [math.sin(machine.heading[0]), math.cos(machine.heading[0])]
    right = away @ [math.cos(machine.heading[0]), -math.sin(machine.heading[0])]
    assert (ahead, right) == pytest.approx((2.01, 3.30), abs=0.01)


@pytest.fixture(autouse=True, scope="module")
def forget_the_generator() -> Iterator[None]:
    yield
    for name in ("double_track_geometry", "make_double_track_site"):
        sys.modules.pop(name, None)
