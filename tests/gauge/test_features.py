"""Which features become which limits, and that wires, poles, tubes, surfaces and zones contain what they protect."""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from workgauge.gauge.build import build_limits
from workgauge.gauge.own_track import own_track, without_own_track
from workgauge.gauge.rulebook import load_rule_book, parse_rule_book
from workgauge.gauge.solids import cylinder, wire_chain
from workgauge.site.read import read_site
from workgauge.values.errors import RuleError
from workgauge.values.limits import LimitKind
from workgauge.values.solids import Box, Convex, PrismChain, Surface, Tube

QUICK = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
HEAD = "version: 1\nname: mine\ntitle: t\n"


def rules(text, more=""):
    return parse_rule_book(f"{HEAD}{more}rules:\n{text}", "mine.yaml")


@QUICK
@given(
    steps=st.lists(
        st.tuples(st.floats(2.0, 60.0), st.floats(-1.4, 1.4), st.floats(-0.1, 0.1)), min_size=1, max_size=5
    ),
    side=st.floats(0.5, 5.0),
    seed=st.integers(0, 99),
)
def test_a_wire_limit_holds_every_place_nearer_than_the_distances(make, steps, side, seed):
    points, heading = [np.zeros(3)], 0.3
    for length, turn, slope in steps:
        heading += turn
        points.append(points[-1] + length * np.array([math.cos(heading), math.sin(heading), slope]))
    axis = np.array(points)
    chain = wire_chain(axis, 1.0, side, 10.0)
    random = np.random.default_rng(seed)
    span = random.integers(0, len(axis) - 1, 300)
    on = axis[span] + random.random((300, 1)) * (axis[span + 1] - axis[span])
    # at any place of the wire: straight to the side, below, above, and round its ends in plan
    along = (axis[span + 1] - axis[span])[:, :2]
    along /= np.linalg.norm(along, axis=1)[:, None]
    square = np.column_stack([-along[:, 1], along[:, 0]]) * side * random.uniform(-1, 1, (300, 1))
    near = np.column_stack([on[:, :2] + square, on[:, 2] + random.uniform(-1, 10, 300)])
    out = np.array([axis[0] - axis[1], axis[-1] - axis[-2]] * 50)
    turn = np.arctan2(out[:, 1], out[:, 0]) + random.uniform(-math.pi / 2, math.pi / 2, 100)
    beyond = np.column_stack([side * np.cos(turn), side * np.sin(turn), random.uniform(-1, 10, 100)])
    ends = axis[[0, -1] * 50] + beyond
    corners = np.repeat(axis, 20, axis=0)
    round_ = random.uniform(0, 2 * math.pi, len(corners))
    corners = corners + np.column_stack([side * np.cos(round_), side * np.sin(round_), np.zeros(len(corners))])
    for sample in (near, ends, corners):
        assert make.in_chain(chain, sample).all()


def test_a_wire_limit_is_one_metre_below_and_three_to_the_side(make):
    wire = make.line("Contact wire 1", [[0, 0, 6.0], [50, 0, 6.0], [100, 0, 6.0]], code="OVERHEAD_LINE_25KV")
    limits = build_limits(make.site(wire), load_rule_book("finland"))
    (limit,) = limits.limits
    assert limit.kind is LimitKind.OVERHEAD_LINE and limit.rule == "overhead-line-25kv"
    local = np.array([[50, y, z] for y, z in [(2.999, 5.001), (3.001, 6.0), (0.0, 4.999), (0.0, 5.001)]])
    local += np.array([*make.origin, 0.0]) - limits.frame.origin
    assert make.in_chain(limit.solid, local).tolist() == [True, False, False, True]


def test_a_wire_above_the_rail_follows_the_track(make):
    block = "{make: overhead_line_above_rail, height_above_rail_m: 5.5, stagger_m: 0.3, voltage: rail, above_m: 4.0}"
    book = rules(
        f"  - {{name: t, feature: alignment, limits: [{block}]}}\n",
        "voltages: {rail: {below_m: 1.0, side_m: 3.0}}\n",
    )
    alignment = make.alignment([(100.0, 0.0, 0.0), (200.0, 0.002, 0.002)], profile=[(0, 80.0), (300, 83.0)])
    limits = build_limits(make.site(alignment), book)
    (limit,) = limits.limits
    assert limit.own_track_of is None and limit.kind is LimitKind.OVERHEAD_LINE
    d = np.linspace(0, alignment.length, 201)
    state = alignment.at(d)
    for side, up, wanted in [(3.29, 4.51, True), (-3.29, 9.49, True), (0.0, 4.4, False), (3.4, 6.0, False)]:
        plan = state.offset_points(side)
        points = np.column_stack([plan, state.z + up]) - limits.frame.origin
        assert make.in_chain(limit.solid, points).all() == wanted


@QUICK
@given(radius=st.floats(0.05, 3.0), height=st.floats(0.5, 20.0), turn=st.floats(0, 7))
def test_a_pole_holds_its_cylinder_and_one_percent_more(radius, height, turn):
    solid = cylinder(np.array([4.0, 5.0, 6.0]), radius, height)
    a, b, c = (solid.vertices[solid.faces[:, i]] for i in range(3))
    outward = np.cross(b - a, c - a)
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    for z in (0.0, height):
        rim = np.array([4 + radius * math.cos(turn), 5 + radius * math.sin(turn), 6 + z])
        depth = np.max(np.sum((rim - a) * outward, axis=1))
        assert -0.01 * radius - 1e-4 <= depth < 0.0
        beyond = rim + 0.011 * radius * np.array([math.cos(turn), math.sin(turn), 0.0])
        assert np.max(np.sum((beyond - a) * outward, axis=1)) > -1e-4
    assert np.all(np.sum(outward * (a - solid.vertices.mean(axis=0)), axis=1) > 0)


def test_every_kind_of_feature_becomes_its_limit(make):
    book = rules(
        """\
  - name: box
    feature: point
    match: {name: ["hut*"]}
    limits:
      - {make: box, length_m: 4.0, width_m: 2.0, height_m: 3.0, heading_deg: 90.0, name: "Hut {name}",
         active_while: "{name} there", stop_distance_m: 0.5, tolerance_m: 0.02, exempt_links: [undercarriage]}
  - {name: none, feature: point, match: {code: [ignore]}, limits: []}
  - {name: tube, feature: line, match: {kind: [pipe]}, limits: [{make: tube, clearance_m: 0.3}]}
  - {name: ceiling, feature: surface, limits: [{make: surface, keep: below}]}
""",
        "zones:\n  - {make: box, name: Shaft, centre_en_m: [25487010.0, 6714010.0], bottom_z_m: 1.0, top_z_m: 3.0,"
        " length_m: 6.0, width_m: 4.0}\n  - {make: prism, outline_en_m: [[25487000, 6714000], [25487001, 6714000],"
        " [25487000, 6714001]], bottom_z_m: 0.0, top_z_m: 5.0}\n",
    )  # fmt: skip
    site = make.site(
        make.point("HUT 1", 10, 20, 5.0),
        make.point("x", 1, 1, 1.0, code="ignore"),
        make.point("y", 1, 2, 1.0),
        make.line("P1", [[0, 0, 1], [9, 0, 1]], kind="pipe", diameter=0.4),
        make.surface("roof", [[0, 0, 9], [5, 0, 9], [0, 5, 9]], [[0, 2, 1]]),
    )
    limits = build_limits(site, book)
    hut, pipe, roof, shaft, prism = sorted(
        limits.limits, key=lambda limit: ["point", "line", "surface", "zone"].index(limit.kind)
    )
    assert hut.name == "Hut HUT 1" and hut.id == "point:HUT 1" and hut.activity.state == "HUT 1 there"
    assert (hut.stop_distance_m, hut.tolerance_m, hut.exempt_links) == (0.5, 0.02, frozenset({"undercarriage"}))
    assert isinstance(hut.solid, Box) and hut.solid.half_extents == pytest.approx((2.0, 1.0, 1.5), abs=1e-3)
    assert hut.solid.vertices[:, 0].max() - hut.solid.vertices[:, 0].min() == pytest.approx(4.0, abs=1e-3)
    assert isinstance(pipe.solid, Tube) and pipe.solid.radius == pytest.approx(0.5, abs=1e-3)
    assert isinstance(roof.solid, Surface) and not roof.solid.keep_above
    corner = roof.solid.vertices[roof.solid.faces[0]]
    assert np.cross(corner[1] - corner[0], corner[2] - corner[0])[2] > 0
    assert (shaft.name, prism.name) == ("Shaft", "zone 2") and isinstance(prism.solid, Convex)
    assert "1 point without a rule became no limit: 'y'" in limits.warnings
    assert "rule 'none' leaves out 1 feature: 'x'" in limits.warnings


def test_a_pipe_without_diameter_needs_one_in_the_rule(make):
    book = rules("  - {name: tube, feature: line, limits: [{make: tube, clearance_m: 0.3}]}\n")
    with pytest.raises(RuleError, match="diameter_m"):
        build_limits(make.site(make.line("P1", [[0, 0, 1], [9, 0, 1]], kind="pipe")), book)


def test_a_gauge_the_book_does_not_know_is_refused(make):
    site = make.site(make.alignment([(50.0, 0, 0)], cant=[(0.0, 0.05)], gauge=0.6))
    with pytest.raises(RuleError, match=r"0\.6 m"):
        build_limits(site, load_rule_book("generic"))


def test_the_own_track_goes_and_its_wire_and_its_neighbour_stay(make):
    near = make.alignment([(100.0, 0.0, 0.0)], name="Track 1", yaw=0.0)
    far = make.alignment([(100.0, 0.0, 0.0)], name="Track 2", yaw=math.radians(4))
    road = make.alignment([(100.0, 0.0, 0.0)], name="Road", yaw=0.0)
    wire = make.line("Contact wire 1", [[0, 0, 86.0], [100, 0, 86.0]])
    site, book = make.site(road, near, far, wire), load_rule_book("finland")
    limits = build_limits(site, book)
    assert [limit.id for limit in limits.limits] == ["track:Track 1", "track:Track 2", "overhead_line:Contact wire 1"]
    e, n = make.origin
    east, west = math.pi / 2, 3 * math.pi / 2
    for heading in (east, west, east + 0.2):
        assert own_track(site, book, e + 50, n + 0.4, heading) == "Track 1"
    assert own_track(site, book, e + 50, n + 3.3, east) == "Track 2"
    assert own_track(site, book, e + 50, n + 0.4, east + 0.3) is None
    assert own_track(site, book, e + 50, n - 1.1, east) is None
    left = [limit.id for limit in without_own_track(limits, "Track 1")]
    assert left == ["track:Track 2", "overhead_line:Contact wire 1"]
    assert len(without_own_track(limits, None)) == 3


def test_the_road_is_no_track_and_its_light_poles_are_poles(make):
    folder = make.real / "inframodel_m3"
    if not folder.exists():
        pytest.skip("the third-party data folder is absent")
    names = ("M3_RS-CL.tg.xml", "M3_Terrain.mm.xml", "Lightning_columns.xy.xml")
    site = read_site([folder / name for name in names])
    for book in ("finland", "germany", "generic"):
        limits = build_limits(site, load_rule_book(book))
        kinds = [limit.kind for limit in limits.limits]
        assert (kinds.count(LimitKind.TRACK), kinds.count(LimitKind.POINT), kinds.count(LimitKind.SURFACE)) == (
            0,
            37,
            1,
        )
        pole = next(limit for limit in limits.limits if limit.name == "Pole 3036")
        foot = pole.solid.vertices.mean(axis=0)[:2] + limits.frame.origin[:2]
        assert foot == pytest.approx((21530666.426, 6783020.064), abs=1e-6)
        assert any("leaves out 1 feature" in warning for warning in limits.warnings)


@pytest.mark.parametrize(
    ("desc", "rule"),
    [
        ("Power line 110 kV", "power-line-110kv"),
        ("220 kV", "power-line-220kv"),
        ("line 20kV", "power-line-20kv"),
        ("400kV line", "power-line-400kv"),
        ("power line", "power-line-unknown"),
    ],
)
def test_power_lines_go_by_their_voltage_and_the_unknown_by_the_highest(make, desc, rule):
    wire = make.line(desc, [[0, 0, 6.0], [50, 0, 6.0]])
    (limit,) = build_limits(make.site(wire), load_rule_book("finland")).limits
    assert limit.rule == rule and isinstance(limit.solid, PrismChain)
