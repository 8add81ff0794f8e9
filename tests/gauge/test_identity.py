"""What limits are called and where they are from: unique and stable ids, lines of the files, what rules may set."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.gauge.build import build_limits
from workgauge.gauge.own_track import own_track, without_own_track
from workgauge.gauge.rulebook import load_rule_book, parse_rule_book
from workgauge.gauge.rules import MAKES
from workgauge.gauge.topmost import Topmost
from workgauge.site.read import read_site
from workgauge.values.errors import RuleError
from workgauge.values.limits import LimitKind

HEAD = "version: 1\nname: mine\ntitle: t\n"
POLE = "rules: [{name: p, feature: point, limits: [{make: cylinder, radius_m: 0.2, height_m: 3.0}]}]\n"


@settings(max_examples=80, deadline=None)
@given(names=st.lists(st.sampled_from(["A", "A#2", "A#2#2", "B", "", "#2"]), min_size=1, max_size=12))
def test_ids_are_unique_and_the_same_in_every_run(make, names):
    book = parse_rule_book(HEAD + POLE, "mine.yaml")
    site = make.site(*(make.point(name, i, 0, 1.0) for i, name in enumerate(names)))
    ids = [limit.id for limit in build_limits(site, book).limits]
    assert len(set(ids)) == len(names)
    assert ids == [limit.id for limit in build_limits(site, book).limits]
    first = {name: f"point:{name}" for name in names}
    for i, name in enumerate(names):
        if name not in names[:i] and not any(name.startswith(f"{other}#") for other in names):
            assert ids[i] == first[name]


def test_tracks_of_one_name_are_told_apart(make):
    """Standing on one of two tracks called the same lets the machine off that one only."""
    tracks = [make.alignment([(100.0, 0, 0)], name="A", yaw=math.radians(a)) for a in (0.0, 4.0)]
    site = make.site(*tracks)
    plain = parse_rule_book(
        HEAD + "rules: [{name: t, feature: alignment, limits: [{make: track, half_width_m: 1.0, height_m: 4.0}]}]\n",
        "m",
    )
    limits = build_limits(site, plain)
    assert [limit.id for limit in limits.limits] == ["track:A", "track:A#2"]
    e, n = make.origin
    for north, own in ((0.1, "A"), (3.4, "A#2")):
        assert own_track(site, plain, e + 50, n + north, math.pi / 2) == own
        left = without_own_track(limits, own)
        assert len(left) == 1 and left[0].own_track_of != own


def test_files_given_twice_give_unique_ids(make, tmp_path):
    source = make.shipped / "sites" / "double_track" / "trackside.xml"
    copy = tmp_path / "copy.xml"
    copy.write_text(source.read_text().replace("</LandXML>", "</LandXML><!-- another copy -->"))
    limits = build_limits(read_site([source, source, copy]), load_rule_book("finland"))
    ids = [limit.id for limit in limits.limits]
    assert len(ids) == len(set(ids)) and sum(i.endswith("#2") for i in ids) * 2 == len(ids)


def test_every_limit_of_a_file_names_its_line(make):
    folder = make.shipped / "sites" / "double_track"
    limits = build_limits(read_site(sorted(folder.glob("*.xml"))), load_rule_book("finland"))
    assert {limit.kind for limit in limits.limits} >= {LimitKind.TRACK, LimitKind.POINT, LimitKind.SURFACE}
    for limit in limits.limits:
        text = (folder / limit.source.file).read_text().splitlines()
        assert limit.source.line is not None
        assert limit.source.feature.strip() in "".join(text[limit.source.line - 1 : limit.source.line + 2])


BODY = {
    "track": "half_width_m: 1.0, height_m: 4.0",
    "overhead_line_above_rail": "below_m: 1.0, side_m: 3.0, above_m: 4.0, height_above_rail_m: 5.5",
    "cylinder": "radius_m: 0.2, height_m: 3.0",
    "box": "length_m: 2.0, width_m: 1.0, height_m: 3.0",
    "overhead_line": "below_m: 1.0, side_m: 3.0, above_m: 4.0",
    "tube": "clearance_m: 0.3, diameter_m: 0.1",
    "surface": "keep: above",
}


@pytest.mark.parametrize(("feature", "kind"), [(f, kind) for f, kinds in MAKES.items() for kind in sorted(kinds)])
def test_what_every_limit_carries_can_be_set_in_every_rule(make, feature, kind):
    more = (
        'name: "my {name}", tolerance_m: 0.03, stop_distance_m: 0.4, active_while: "{name} on", exempt_links: [boom]'
    )
    text = f"{HEAD}rules: [{{name: r, feature: {feature}, limits: [{{make: {kind}, {BODY[kind]}, {more}}}]}}]\n"
    site = make.site(
        make.alignment([(30.0, 0, 0)], name="f"),
        make.point("f", 0, 0, 80.0),
        make.line("f", [[0, 0, 80], [9, 0, 80]]),
        make.surface("f", [[0, 0, 80], [9, 0, 80], [0, 9, 80]], [[0, 1, 2]]),
    )
    (limit,) = build_limits(site, parse_rule_book(text, "m.yaml")).limits
    assert (limit.tolerance_m, limit.stop_distance_m, limit.activity.state) == (0.03, 0.4, "f on")
    assert limit.name == "my f" and limit.exempt_links == {"boom"} and limit.source.line is not None


def test_zones_carry_it_too():
    zone = "zones: [{make: box, name: Shaft, centre_en_m: [1.0, 2.0], bottom_z_m: 1.0, top_z_m: 2.0, length_m: 1.0, "
    zone += "width_m: 1.0, tolerance_m: 0.07}]\n"
    assert parse_rule_book(HEAD + zone, "m.yaml").zones[0].tolerance_m == 0.07
    with pytest.raises(RuleError, match="tolerance_m"):
        parse_rule_book(HEAD + zone.replace("0.07", "-0.07"), "m.yaml")


def flat(make, name, z, **more):
    """A level surface of 20 m by 20 m."""
    surface = make.surface(name, [[0, 0, z], [20, 0, z], [0, 20, z], [20, 20, z]], [[0, 1, 3], [0, 3, 2]])
    return type(surface)(**{field: more.get(field, getattr(surface, field)) for field in surface.__slots__})


@pytest.mark.parametrize("name", ["finland", "germany", "generic"])
def test_a_design_is_ground_only_where_there_is_no_terrain(make, name):
    book = load_rule_book(name)
    terrain, design = flat(make, "Terrain", 80.0), flat(make, "Design", 82.0)
    coded = flat(make, "top", 82.0, properties={"surfaceCoding": "201000"})
    rock, other = flat(make, "Rock", 78.0), flat(make, "Design 2", 82.5)

    def guarded(*surfaces):
        return [limit.source.feature for limit in build_limits(make.site(*surfaces), book).limits]

    assert guarded(terrain, design, coded, rock) == ["Terrain", "Rock"]
    assert guarded(design) == ["Design"] and guarded(coded) == ["top"]
    assert guarded(design, other) == ["Design", "Design 2"]
    assert guarded(design, flat(make, "Design terrain", 80.0)) == ["Design", "Design terrain"]
    warnings = build_limits(make.site(terrain, design), book).warnings
    assert "rule 'design-surface' leaves out 1 feature: 'Design'" in warnings


def test_on_the_real_site_of_three_surfaces_a_machine_on_the_terrain_stands_clear(make):
    """Terrain and rock are guarded, the design is not: nothing guarded reaches 1 m over the terrain."""
    folder = make.real / "inframodel_m3"
    if not folder.exists():
        pytest.skip("the third-party data folder is absent")
    names = ("M3_Terrain", "M3_Rockbed_survey", "M3_Highest_Comb_rev2_Highest_combination_of_surface")
    site = read_site([folder / f"{name}.mm.xml" for name in names])
    for book in ("finland", "germany", "generic"):
        limits = build_limits(site, load_rule_book(book))
        assert [limit.source.feature for limit in limits.limits] == [
            "M3_Terrain - Terrain",
            "M3_Rockbed_survey - Rockbed",
        ]
    terrain, rock, design = site.surfaces
    middles = terrain.vertices[terrain.faces].mean(axis=1)
    above = Topmost([rock]).heights(middles[:, :2]) - middles[:, 2]
    assert np.nanmax(above) < 1.0
    assert np.nanmax(Topmost([design]).heights(middles[:, :2]) - middles[:, 2]) > 1.5
