"""Features without heights: where theirs are from, what is said of it, and that none ends up unguarded."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.gauge.build import build_limits
from workgauge.gauge.heights import BEYOND
from workgauge.gauge.rulebook import load_rule_book, parse_rule_book
from workgauge.gauge.topmost import Topmost
from workgauge.gauge.verify import verify_envelopes
from workgauge.values.errors import RuleError
from workgauge.values.solids import PrismChain, Surface, Tube

NAN = math.nan
POLE = "{name: p, feature: point, limits: [{make: cylinder, radius_m: 0.2, height_m: 10.0, base_offset_m: -0.5}]}"
HUT = "{name: p, feature: point, limits: [{make: box, length_m: 4.0, width_m: 2.0, height_m: 3.0}]}"
WIRE = "{{name: w, feature: line, limits: [{{make: overhead_line, below_m: 1.0, side_m: 3.0, above_m: 10.0{}}}]}}"
PIPE = "{{name: l, feature: line, limits: [{{make: tube, clearance_m: 0.3, diameter_m: 0.4{}}}]}}"
TRACK = "{name: t, feature: alignment, limits: [{make: track, half_width_m: 1.9, height_m: 4.0}]}"
GROUND = "{name: g, feature: surface, match: {not_name: [roof]}, limits: [{make: surface}]}"
ROOF = "{name: r, feature: surface, match: {name: [roof]}, limits: [{make: surface, keep: below}]}"


def book_of(*rules, more=""):
    lines = "".join(f"  - {rule}\n" for rule in rules)
    return parse_rule_book(f"version: 1\nname: mine\ntitle: t\n{more}rules:\n{lines}", "mine.yaml")


def square(make, name, z, half=100.0, east=0.0, slope=0.0):
    """A surface over `half` metres to each side, rising eastwards."""
    corners = [[east + x, y, z + slope * x] for x in (-half, half) for y in (-half, half)]
    return make.surface(name, corners, [[0, 2, 1], [1, 2, 3]])


def heights_of(limits, limit):
    """The lowest and highest absolute height of a solid."""
    solid = limit.solid
    if isinstance(solid, PrismChain):
        z = np.concatenate([solid.cell_vertices(i)[:, 2] for i in range(len(solid))])
    else:
        z = (solid.axis if isinstance(solid, Tube) else solid.vertices)[:, 2]
    assert np.isfinite(z).all()
    return z.min() + limits.frame.origin[2], z.max() + limits.frame.origin[2]


def one(make, book, *features):
    """The limits, the one that is no surface, and the warnings on heights."""
    limits = build_limits(make.site(*features), book)
    (limit,) = (limit for limit in limits.limits if not isinstance(limit.solid, Surface))
    return limits, limit, [w for w in limits.warnings if "height" in w]


def test_a_pole_stands_on_the_topmost_surface_there(make):
    book = book_of(POLE, GROUND, ROOF)
    surfaces = [square(make, "terrain", 80.0, slope=0.01), square(make, "rock", 79.0), square(make, "roof", 95.0)]
    aside = square(make, "mound", 85.0, half=5.0, east=60.0)
    limits, limit, (warning,) = one(make, book, make.point("P", 10.0, 20.0, NAN), *surfaces, aside)
    assert heights_of(limits, limit) == pytest.approx((80.1 - 0.5, 80.1 + 9.5), abs=1e-3)
    assert warning == "1 point has no height; heights used: the surface's there, 80.100 to 80.100 m: 'P'"


def test_a_surface_that_is_left_out_is_ground_only_where_no_other_is(make):
    left = "{name: d, feature: surface, match: {name: [design]}, limits: []}"
    book = book_of(POLE, left, GROUND)
    features = [square(make, "design", 83.0, half=300.0), square(make, "terrain", 80.0)]
    for east, z in ((0.0, 80.0), (200.0, 83.0)):
        limits, limit, _ = one(make, book, make.point("P", east, 0.0, NAN), *features)
        assert heights_of(limits, limit)[0] == pytest.approx(z - 0.5, abs=1e-3)


def test_a_pole_off_the_surfaces_takes_the_nearest_profile_within_reach(make):
    book = book_of(POLE, more="height_from_profile_within_m: 30.0\n")
    near = make.alignment([(100.0, 0, 0)], yaw=0.0, profile=[(0, 70.0), (100, 75.0)])
    site = (near, make.alignment([(100.0, 0, 0)], yaw=math.pi / 2, name="North", profile=[(0, 50.0), (100, 50.0)]))
    limits, limit, warnings = one(make, book, make.point("P", 60.0, 29.0, NAN), *site)
    assert heights_of(limits, limit)[0] == pytest.approx(73.0 - 0.5, abs=1e-3)
    assert "the nearest profile's within 30 m" in warnings[0]
    limits, limit, warnings = one(make, book, make.point("P", 60.0, 31.0, NAN), *site)
    assert heights_of(limits, limit) == pytest.approx((50.0 - BEYOND, 75.0 + BEYOND), abs=1e-3)
    assert warnings == ["1 point has no height; guarded at every height, -50 to 175 m: 'P'"]


@pytest.mark.parametrize("rule", [POLE, HUT])
def test_a_point_of_no_known_height_is_a_column_through_all(make, rule):
    far = [make.point(f"P{i}", 1000.0 + i, 0.0, NAN) for i in range(7)]
    limits = build_limits(make.site(square(make, "terrain", 80.0), *far), book_of(rule))
    for limit in limits.limits:
        low, high = heights_of(limits, limit)
        assert low <= 80.0 - BEYOND and high >= 80.0 + BEYOND
    (warning,) = (w for w in limits.warnings if "guarded at every height" in w)
    assert warning.startswith("7 points have no height; guarded at every height, -20 to 180 m: 'P0'")
    assert warning.endswith("and 2 more")


def test_a_site_without_any_heights_stands_at_the_constant(make):
    book = book_of(POLE, TRACK, PIPE.format(", height_above_ground_m: 0.0"), more="height_without_profile: 12.5\n")
    track = make.alignment([(50.0, 0, 0)], profile=())
    site = make.site(track, make.point("P", 0, 0, NAN), make.line("L", [[0, 0, NAN], [50, 0, NAN]], kind="pipe"))
    limits = build_limits(site, book)
    lows = [heights_of(limits, limit)[0] for limit in limits.limits]
    assert lows == pytest.approx([12.5, 12.5, 12.0], abs=2e-3)
    said = [w for w in limits.warnings if "height used: 12.500 m everywhere" in w and "no heights" in w]
    assert len(said) == len(limits.warnings) == 3


def test_a_wire_without_heights_hangs_over_the_ground_by_the_rule(make):
    book = book_of(WIRE.format(", height_above_ground_m: 5.6"))
    wire = make.line("W", [[-50, 0, NAN], [50, 0, NAN]])
    limits, limit, (warning,) = one(make, book, wire, square(make, "terrain", 80.0, slope=0.02))
    x = np.linspace(-50, 50, 301)
    for side, up, inside in [(2.9, 4.7, True), (-2.9, 15.4, True), (0.0, 4.4, False), (3.2, 6.0, False)]:
        local = np.column_stack([x, np.full_like(x, side), 80.0 + 0.02 * x + up])
        local += np.array([*make.origin, 0.0]) - limits.frame.origin
        assert (make.in_chain(limit.solid, local) == inside).all()
    assert warning.startswith("1 overhead line has no height") and "84.600 to 86.600 m" in warning


@pytest.mark.parametrize(("key", "east"), [("", 0.0), (", height_above_ground_m: 5.6", 1000.0)])
def test_a_wire_of_no_known_height_is_guarded_at_every_height(make, key, east):
    wire = make.line("W", [[east, 0, NAN], [east + 40, 30, NAN], [east + 90, 30, NAN]])
    limits, limit, (warning,) = one(make, book_of(WIRE.format(key)), wire, square(make, "terrain", 80.0))
    low, high = heights_of(limits, limit)
    assert low <= 80 - BEYOND and high >= 80 + BEYOND
    middle = np.array([[east + 20, 15.0, z] for z in np.linspace(-19, 179, 50)])
    assert make.in_chain(limit.solid, middle + np.array([*make.origin, 0.0]) - limits.frame.origin).all()
    assert "guarded at every height" in warning and ("height_above_ground_m" in warning) == (not key)


def test_a_pipe_without_heights_is_guarded_from_the_ground_down(make):
    pipe = make.line("L", [[-50, 0, NAN], [50, 0, NAN]], kind="pipe")
    limits, limit, (warning,) = one(make, book_of(PIPE.format("")), pipe, square(make, "terrain", 80.0, slope=0.02))
    points = np.array([[x, 0.49, z] for x in (-49, 0, 49) for z in np.linspace(-19, 80.4 + 0.02 * x, 40)])
    local = points + np.array([*make.origin, 0.0]) - limits.frame.origin
    assert make.in_chain(limit.solid, local).all()
    assert heights_of(limits, limit)[1] == pytest.approx(81.5, abs=0.1)
    assert "from there down" in warning
    limits, limit, _ = one(
        make, book_of(PIPE.format(", height_above_ground_m: -0.8")), pipe, square(make, "terrain", 80.0)
    )
    assert isinstance(limit.solid, Tube) and heights_of(limits, limit) == pytest.approx((79.2, 79.2))
    far = make.line("L", [[990, 0, NAN], [1050, 0, NAN]], kind="pipe")
    limits, limit, _ = one(make, book_of(PIPE.format("")), far, square(make, "terrain", 80.0))
    assert heights_of(limits, limit) == pytest.approx((80 - BEYOND, 80 + BEYOND), abs=1e-3)


def test_a_lines_own_heights_count_beside_them_and_not_far_off(make):
    book = book_of(PIPE.format(""))
    ground = square(make, "terrain", 80.0, half=2000.0)
    near = make.line("L", [[0, 0, 70.0], [20, 0, NAN], [40, 0, 72.0], [50, 0, NAN]], kind="pipe")
    limits, limit, (warning,) = one(make, book, near, ground)
    assert isinstance(limit.solid, Tube)
    assert limit.solid.axis[:, 2] + limits.frame.origin[2] == pytest.approx([70.0, 71.0, 72.0, 72.0])
    assert "the feature's own" in warning
    far = make.line("L", [[0, 0, 70.0], [500, 0, NAN]], kind="pipe")
    limits, limit, _ = one(make, book, far, ground)
    there = np.array([[x, 0, z] for x in (300, 499) for z in np.linspace(-19, 80, 30)])
    assert make.in_chain(limit.solid, there + np.array([*make.origin, 0.0]) - limits.frame.origin).all()


def test_a_track_without_profile_lies_on_the_surface(make):
    book = book_of(TRACK, GROUND, more="rail_above_surface_m: 0.4\n")
    track = make.alignment([(90.0, 0, 0)], profile=(), yaw=0.0)
    limits, limit, (warning,) = one(make, book, track, square(make, "terrain", 80.0, slope=0.02))
    x = np.linspace(0, 90, 181)
    for up, inside in [(0.01, True), (3.99, True), (-0.1, False), (4.1, False)]:
        local = np.column_stack([x, 0 * x, 80.4 + 0.02 * x + up]) + np.array([*make.origin, 0.0])
        assert (make.in_chain(limit.solid, local - limits.frame.origin) == inside).all()
    assert warning.startswith("1 alignment has no profile") and "80.400 to 82.200 m" in warning


def test_where_a_track_leaves_the_surface_it_is_guarded_at_every_height(make):
    book = book_of(TRACK, more="height_from_profile_within_m: 0.0\n")
    track = make.alignment([(300.0, 0, 0)], profile=(), yaw=0.0, cant=[(0, 0.1), (300, 0.1)])
    site = make.site(track, square(make, "terrain", 80.0))
    limits = build_limits(site, book)
    low, whole = limits.limits
    assert low.own_track_of == whole.own_track_of == "Track 1" and low.id != whole.id
    assert whole.chainage == pytest.approx((100.0, 300.0))
    d = np.linspace(0, 300, 601)
    for side, up in [(1.85, 0.1), (-1.85, 3.9)]:
        local = np.column_stack([d, 0 * d + side, 0 * d + 80 + up]) + np.array([*make.origin, 0.0])
        assert make.in_chain(low.solid, local - limits.frame.origin).all()
        for z in (-19.0, 30.0, 80.0, 179.0):
            local[:, 2] = z
            assert (make.in_chain(whole.solid, local - limits.frame.origin) | (d < 100.01)).all()
    before = np.array([[98.0, 0, 150]]) + np.array([*make.origin, 0]) - limits.frame.origin
    assert not make.in_chain(whole.solid, before).any()
    assert sum("guarded at every height" in w for w in limits.warnings) == 1
    assert verify_envelopes(site, book, limits).worst_uncovered_m == 0.0


@pytest.mark.parametrize("profile", [[(40.0, 80.0), (160.0, 82.0)], [(-50.0, 80.0), (120.0, 81.0)]])
def test_a_profile_shorter_than_its_alignment_leaves_no_gap(make, profile):
    track = make.alignment([(300.0, 0, 0)], profile=profile, yaw=0.0)
    site = make.site(track)
    book = book_of(TRACK)
    limits = build_limits(site, book)
    state = track.at(np.linspace(0, 300, 601))
    held = np.where(np.isnan(state.z), np.interp(state.distance, *np.array(profile).T), state.z)
    local = np.column_stack([state.e, state.n, held + 0.5]) - limits.frame.origin
    assert make.in_chain(limits.limits[0].solid, local).all()
    curtain = limits.limits[1]
    assert curtain.chainage[1] == 300.0 and curtain.chainage[0] >= profile[-1][0] + 45.0
    far = state.distance > profile[-1][0] + 50.0
    for z in (0.0, 160.0):
        local[:, 2] = z - limits.frame.origin[2]
        assert make.in_chain(curtain.solid, local[far]).all()
    assert {w.split(";")[0] for w in limits.warnings} == {"1 alignment has no profile, or one shorter than it is"}
    assert verify_envelopes(site, book, limits).worst_uncovered_m == 0.0


def test_a_profile_a_little_short_carries_on_without_a_word(make):
    track = make.alignment([(100.0, 0, 0)], profile=[(0.3, 80.03), (99.7, 89.97)], yaw=0.0)
    limits = build_limits(make.site(track), book_of(TRACK))
    assert not limits.warnings and len(limits.limits) == 1
    local = np.array([[0.0, 0.0, 80.01], [100.0, 0.0, 90.01]]) + np.array([*make.origin, 0.0]) - limits.frame.origin
    assert make.in_chain(limits.limits[0].solid, local).all()


def test_a_wire_above_rails_of_no_known_height_is_refused(make):
    block = "{make: overhead_line_above_rail, height_above_rail_m: 5.5, below_m: 1.0, side_m: 3.0, above_m: 4.0}"
    book = book_of(f"{{name: t, feature: alignment, limits: [{block}]}}")
    far = make.alignment([(100.0, 0, 0)], profile=(), yaw=0.0)
    ground = square(make, "terrain", 80.0, half=50.0)
    with pytest.raises(RuleError, match=r"'Track 1' from 50\.000 to 100\.000 m.*a profile, a surface") as caught:
        build_limits(make.site(far, ground), book)
    assert (caught.value.file, caught.value.line) == ("made.xml", 1)


def test_heights_that_are_no_numbers_are_refused(make):
    vertices = [[0, 0, NAN], [9, 0, 1], [0, 9, 1]]
    with pytest.raises(RuleError, match="no numbers"):
        build_limits(make.site(make.surface("s", vertices, [[0, 1, 2]])), book_of(GROUND))


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_nothing_ends_up_far_from_the_sites_heights(make, data):
    """Whatever has heights or not: every limit is finite and reaches the heights the site is known to have."""
    height = st.one_of(st.just(NAN), st.floats(78.0, 84.0))
    place = st.floats(-400.0, 400.0)
    points = [
        make.point("P", data.draw(place), data.draw(place), data.draw(height))
        for _ in range(data.draw(st.integers(1, 3)))
    ]
    corners = [[data.draw(place), data.draw(place), data.draw(height)] for _ in range(data.draw(st.integers(2, 4)))]
    profile = data.draw(st.sampled_from([(), ((20.0, 80.0), (90.0, 81.0)), ((0.0, 79.0), (500.0, 83.0))]))
    features = [*points, make.line("L", corners), make.alignment([(150.0, 0, 0)], profile=profile)]
    if data.draw(st.booleans()):
        features.append(square(make, "terrain", 80.0, half=data.draw(st.sampled_from([20.0, 200.0]))))
    line = data.draw(st.sampled_from([WIRE, PIPE])).format(
        data.draw(st.sampled_from(["", ", height_above_ground_m: 2.0"]))
    )
    site = make.site(*features)
    limits = build_limits(site, book_of(POLE, line, TRACK))
    known = site.bounds[:, 2] if np.isfinite(site.bounds[:, 2]).all() else (0.0, 0.0)
    assert len({limit.id for limit in limits.limits}) == len(limits.limits) >= len(points) + 2
    for limit in limits.limits:
        low, high = heights_of(limits, limit)
        assert low <= known[1] + 2.0 and high >= known[0]


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_the_topmost_height_is_that_of_a_search_over_all_triangles(make, seed):
    random = np.random.default_rng(seed)
    surfaces = [make.surface("s", random.uniform(-10, 10, (9, 3)), random.integers(0, 9, (6, 3))) for _ in range(2)]
    en = random.uniform(-10, 10, (40, 2)) + make.origin
    wanted = np.full(40, NAN)
    for surface in surfaces:
        for a, b, c in surface.vertices[surface.faces]:
            matrix = np.array([[*a[:2], 1], [*b[:2], 1], [*c[:2], 1]]) - [*make.origin, 0]
            if abs(np.linalg.det(matrix)) < 1e-9:
                continue
            weights = np.linalg.solve(matrix.T, np.column_stack([en - make.origin, np.ones(40)]).T)
            inside = (weights >= 0).all(axis=0)
            wanted[inside] = np.fmax(wanted[inside], (np.array([a[2], b[2], c[2]]) @ weights)[inside])
    np.testing.assert_allclose(Topmost(surfaces).heights(en), wanted, atol=1e-6)


def test_there_may_be_no_surface_at_all(make):
    assert np.isnan(Topmost([]).heights(np.zeros((3, 2)))).all()


def test_shipped_books_guard_two_dimensional_features_on_the_terrain(make):
    track = make.alignment([(80.0, 0, 0)], name="Track 1", profile=(), yaw=0.0)
    wire = make.line("Contact wire 1", [[0, 0, NAN], [80, 0, NAN]], code="OVERHEAD_LINE_25KV")
    pole = make.point("P1", 40, 3, NAN, code="CATENARY_POLE")
    site = make.site(track, wire, pole, square(make, "Terrain", 80.0))
    for name in ("finland", "germany", "generic"):
        limits = build_limits(site, load_rule_book(name))
        spans = {limit.kind.value: heights_of(limits, limit) for limit in limits.limits if limit.kind != "surface"}
        assert spans["track"][0] == pytest.approx(80.0, abs=0.01) and 84.3 < spans["track"][1] < 84.8
        assert spans["point"] == pytest.approx((79.5, 90.0), abs=1e-3)
        assert 80.0 < spans["overhead_line"][0] < 84.7 and spans["overhead_line"][1] > 94.0
