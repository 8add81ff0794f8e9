"""Limits contain what they protect, on random tracks and by an oracle of the tests' own; and not much more."""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from workgauge.gauge.build import build_limits
from workgauge.gauge.rulebook import load_rule_book, parse_rule_book
from workgauge.gauge.verify import verify_envelopes
from workgauge.site.read import read_site
from workgauge.site.transitions import Law
from workgauge.values.errors import RuleError

G1 = [(1.620, 0.0), (1.620, 0.4), (1.620, 0.5), (1.620, 1.17), (1.645, 1.17)]
G1 += [(1.645, 3.25), (1.425, 3.7), (1.12, 4.01), (0.525, 4.31)]
LAWS = [Law.CLOTHOID, Law.BLOSS, Law.COSINE, Law.SINE, Law.BIQUADRATIC]
SLOW = settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def plain(half_width=1.9, height=4.5, extra=""):
    return parse_rule_book(
        "version: 1\nname: plain\ntitle: t\nrules:\n  - name: t\n    feature: alignment\n    limits:\n"
        f"      - {{make: track, half_width_m: {half_width}, height_m: {height}{extra}}}\n",
        "plain.yaml",
    )


def inside_some_cell(chains, points, slack=0.0):
    """Whether each local point (k, 3) lies in some cell, by the cells' own corner points alone."""
    found = np.zeros(len(points), dtype=bool)
    for chain in chains:
        for cell in range(len(chain)):
            corners = chain.cell_vertices(cell)
            k = len(corners) // 2
            near = np.flatnonzero(~found & (np.abs(points - corners.mean(axis=0)).max(axis=1) < 60))
            if not len(near):
                continue
            here = np.ones(len(near), dtype=bool)
            for i in range(k):
                a, b, c = corners[i], corners[(i + 1) % k], corners[k + i]
                outward = np.cross(b - a, c - a)
                here &= (points[near] - a) @ (outward / np.linalg.norm(outward)) <= slack
            for ring in (corners[:k][::-1], corners[k:]):
                outward = np.cross(ring[1] - ring[0], ring[2] - ring[0])
                here &= (points[near] - ring[0]) @ (outward / np.linalg.norm(outward)) <= slack
            found[near[here]] = True
    return found


@st.composite
def tracks(draw, smallest=150.0):
    """Elements, cant points and a profile: straights, arcs at once, and arcs with transitions of any law."""
    elements, cant, d = [], [], 0.0
    for _ in range(draw(st.integers(1, 3))):
        radius = draw(st.sampled_from([smallest, 180.0, 249.0, 250.0, 400.0, 1000.0])) * draw(
            st.sampled_from([-1, 1])
        )
        length = draw(st.floats(8.0, 80.0))
        lift = math.copysign(draw(st.floats(0.0, 0.15)), radius) * draw(st.sampled_from([1, 1, -1]))
        kind = draw(st.sampled_from(["straight", "arc", "curve"]))
        if kind == "straight":
            elements.append((length, 0.0, 0.0))
            cant += [(d, 0.0), (d + length, 0.0)]
        elif kind == "arc":
            elements.append((length, 1 / radius, 1 / radius))
            cant += [(d, lift), (d + length, lift)]
        else:
            ramp, law = draw(st.floats(40.0, 90.0)), draw(st.sampled_from(LAWS))
            elements += [(ramp, 0.0, 1 / radius, law), (length, 1 / radius, 1 / radius), (ramp, 1 / radius, 0.0, law)]
            cant += [(d, 0.0), (d + ramp, lift), (d + ramp + length, lift), (d + 2 * ramp + length, 0.0)]
        d = cant[-1][0]
    grades = draw(st.floats(-0.02, 0.02)), draw(st.floats(-0.02, 0.02))
    round_ = min(300.0, 20.0 * d)  # the vertical curve fits
    profile = [(0.0, 80.0), (d / 2, 80 + grades[0] * d / 2, round_), (d, 80 + (grades[0] + grades[1]) * d / 2)]
    return elements, cant, profile


@SLOW
@given(
    track=tracks(), pivot=st.sampled_from([("center", "centre"), ("insideRail", "low_rail")]), seed=st.integers(0, 99)
)
def test_a_track_limit_contains_the_envelope_on_any_track(make, track, pivot, seed):
    elements, cant, profile = track
    alignment = make.alignment(elements, cant=cant, profile=profile, pivot=pivot[0])
    limits = build_limits(make.site(alignment), load_rule_book("generic"))
    oracle = make.oracle(G1, 0.2, widening=make.uic, lean=(0.4, 0.1, 5000.0), pivot=pivot[1])
    places = np.sort(np.random.default_rng(seed).uniform(0, alignment.length, 6))
    points = np.concatenate([oracle.points(alignment, float(d)) for d in [0.0, *places, alignment.length]])
    local = points - limits.frame.origin
    assert inside_some_cell([limit.solid for limit in limits.limits], local).all()


@SLOW
@given(track=tracks(), book=st.sampled_from(["finland", "germany", "generic"]))
def test_nothing_is_uncovered_and_at_most_five_centimetres_are_needless(make, track, book):
    elements, cant, profile = track
    site = make.site(make.alignment(elements, cant=cant, profile=profile))
    rules = load_rule_book(book)
    found = verify_envelopes(site, rules, build_limits(site, rules))
    assert found.worst_uncovered_m == 0.0
    assert found.worst_surplus_m <= 0.05
    assert found.points > 1000 and found.uncovered == ()


@SLOW
@example(rows=[(2.5, 1.0), (0.3125, 0.1015625)])  # a corner so sharp that sides moved outwards meet far beyond it
@given(rows=st.lists(st.tuples(st.floats(0.3, 2.5), st.floats(0.1, 1.0)), min_size=2, max_size=7))
def test_any_profile_is_covered_closely_if_need_be_by_several_limits(make, rows):
    heights = np.cumsum([h for _, h in rows])
    table = [[round(b, 3), round(float(h), 3)] for (b, _), h in zip(rows, heights, strict=True)]
    book = parse_rule_book(
        f"version: 1\nname: p\ntitle: t\nprofiles: {{odd: {{half_width_at_height_m: {table}}}}}\nrules:\n"
        "  - {name: t, feature: alignment, limits: [{make: track, profile: odd}]}\n",
        "p.yaml",
    )
    site = make.site(make.alignment([(30.0, 0.0, 0.0), (60.0, 0.003, 0.003)]))
    limits = build_limits(site, book)
    found = verify_envelopes(site, book, limits)
    assert found.worst_uncovered_m == 0.0 and found.worst_surplus_m <= 0.05
    assert {limit.own_track_of for limit in limits.limits} == {"Track 1"}
    assert len({limit.id for limit in limits.limits}) == len(limits.limits)


def test_verification_sees_a_gap_and_a_bulge(make):
    site = make.site(make.alignment([(100.0, 0.0, 0.0), (150.0, 0.002, 0.002)]))
    rules = plain()
    right = build_limits(site, rules)
    assert verify_envelopes(site, rules, right).worst_surplus_m < 0.02
    narrow, wide = (build_limits(site, plain(half_width=w)) for w in (1.85, 1.98))
    bad = verify_envelopes(site, rules, narrow)
    assert bad.worst_uncovered_m == pytest.approx(0.05, abs=0.001)
    assert bad.uncovered[0].alignment == "Track 1" and 0 <= bad.uncovered[0].distance_m <= 250
    assert verify_envelopes(site, rules, wide).worst_surplus_m == pytest.approx(0.08, abs=0.02)


@pytest.mark.parametrize(("book", "radius"), [("generic", 149.0), ("germany", 99.0)])
def test_too_small_a_radius_is_refused_by_name_and_place(make, book, radius):
    site = make.site(make.alignment([(50.0, 0.0, 0.0), (20.0, 1 / radius, 1 / radius)], cant=[(0.0, 0.0)]))
    with pytest.raises(RuleError) as caught:
        build_limits(site, load_rule_book(book))
    text = str(caught.value)
    assert "'Track 1' at 5" in text and f"radius {radius:.3f} m" in text and "at least" in text


def test_widening_begins_before_the_curve_inside_at_once_and_outside_on_a_ramp(make):
    """A curve of 200 m radius without transition at 100 m: S 0.065 inside, 0.075 outside."""
    book = load_rule_book("generic")
    alignment = make.alignment([(100.0, 0.0, 0.0), (80.0, 1 / 200, 1 / 200)], name="Track", cant=[(0.0, 0.0)])
    chain = build_limits(make.site(alignment), book).limits[0].solid

    def widest(d):
        cell = int(np.searchsorted(chain.chainages[:, 0], d, side="right") - 1)
        return chain.sections[cell, :, 0].max() - 1.845, -chain.sections[cell, :, 0].min() - 1.845

    assert widest(70.0) == pytest.approx((0.0, 0.0), abs=0.002)
    assert widest(79.9)[0] == pytest.approx(0.0, abs=0.002)
    assert widest(80.5)[0] == pytest.approx(0.065, abs=0.005)
    assert widest(84.0)[1] == pytest.approx(0.075 * 10 / 20, abs=0.012)
    assert widest(97.0)[1] == pytest.approx(0.075, abs=0.005)


def test_the_real_track_without_profile_says_the_height_it_used(make):
    path = make.real / "geoviite" / "testfile_clothoid_and_parabola.xml"
    if not path.exists():
        pytest.skip("the third-party data folder is absent")
    site = read_site([path])
    limits = build_limits(site, load_rule_book("finland"))
    assert [w for w in limits.warnings if "no profile" in w and "0.000 m" in w]
    assert len(limits.limits) == 1 and limits.limits[0].chainage == pytest.approx((0.0, 18901.845), abs=0.01)


@pytest.mark.prove
@pytest.mark.parametrize("book", ["finland", "germany", "generic"])
def test_the_whole_real_track_is_covered_to_the_millimetre(make, book):
    path = make.real / "geoviite" / "testfile_clothoid_and_parabola.xml"
    if not path.exists():
        pytest.skip("the third-party data folder is absent")
    site, rules = read_site([path]), load_rule_book(book)
    found = verify_envelopes(site, rules, build_limits(site, rules))
    assert found.worst_uncovered_m == 0.0 and found.worst_surplus_m <= 0.05


@pytest.mark.parametrize("book", ["finland", "germany", "generic"])
def test_the_shipped_site_is_covered(make, book):
    site, rules = read_site(sorted((make.shipped / "sites" / "double_track").glob("*.xml"))), load_rule_book(book)
    shares = []
    limits = build_limits(site, rules)
    found = verify_envelopes(site, rules, limits, shares.append)
    assert found.worst_uncovered_m == 0.0 and found.worst_surplus_m <= 0.05
    assert shares == sorted(shares) and shares[-1] == 1.0
    counts = {
        kind: sum(limit.kind == kind for limit in limits.limits) for kind in {limit.kind for limit in limits.limits}
    }
    assert (counts["track"], counts["overhead_line"], counts["point"], counts["surface"]) == (2, 2, 50, 1)
    assert counts["line"] >= 13
