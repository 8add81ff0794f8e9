"""Rule books: the shipped ones are sourced; mistakes are named with file, line, key, value and what is allowed."""

import contextlib
import copy
import json

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from workgauge.gauge.rulebook import json_schema, load_rule_book, parse_rule_book, shipped_names, sources, unsourced
from workgauge.values.errors import RuleError

GOOD = """\
version: 1
name: mine
title: Mine
rules:
  - name: track
    feature: alignment
    limits:
      - make: track
        half_width_m: 1.9
        height_m: 4.5
  - name: pole
    feature: point
    limits:
      - {make: cylinder, radius_m: 0.2, height_m: 8.0}
"""


def error_of(text: str) -> RuleError:
    with pytest.raises(RuleError) as caught:
        parse_rule_book(text, "mine.yaml")
    return caught.value


def test_shipped_books_are_three_and_every_number_names_its_source():
    assert shipped_names() == ("finland", "generic", "germany")
    for name in shipped_names():
        book = load_rule_book(name)
        assert book.name == name
        assert unsourced(book) == []
        assert {row["certainty"] for row in sources(book)} <= {"V", "S", "C", "R"}
        assert len(sources(book)) > 30


def test_facts_are_in_the_shipped_books():
    finland, germany = load_rule_book("finland"), load_rule_book("germany")
    assert finland.profiles["G2"].half_width_at_height_m[-1] == (0.785, 4.680)
    assert {k: (v.below_m, v.side_m) for k, v in finland.voltages.items()} == {
        "0.4 kV": (2, 2),
        "20 kV": (2, 3),
        "110 kV": (3, 5),
        "220 kV": (4, 5),
        "400 kV": (5, 5),
        "rail 25 kV": (1, 3),
    }
    assert [v.side_m for v in germany.voltages.values()] == [1, 3, 4, 5]


def test_a_plain_book_is_read_and_the_schema_is_json():
    book = parse_rule_book(GOOD, "mine.yaml")
    assert [rule.name for rule in book.rules] == ["track", "pole"]
    assert "rules" in json.loads(json.dumps(json_schema()))["properties"]
    assert unsourced(book) == ["rules[track].limits[0]", "rules[pole].limits[0]"]


def test_an_unknown_key_is_named_with_its_line_and_what_is_allowed():
    error = error_of(GOOD.replace("half_width_m", "halfwidth_m"))
    assert (error.file, error.line, error.element) == ("mine.yaml", 9, "rules.0.limits.0.halfwidth_m")
    assert error.value == "halfwidth_m" and "half_width_m" in (error.allowed or "")


@pytest.mark.parametrize("value", [".nan", ".inf", "-1.0", "0.0", "'1.9'", "true", "[1.9]", "null", "1e9"])
def test_sizes_that_are_none_are_refused(value):
    error = error_of(GOOD.replace("radius_m: 0.2", f"radius_m: {value}"))
    assert (error.line, error.element) == (14, "rules.1.limits.0.radius_m")
    assert error.allowed


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("make: track", "make: tracks", "tracks"),
        ("feature: point", "feature: dot", "point"),
        ("feature: point", "feature: line", "cannot make cylinder"),
        ("height_m: 4.5\n", "profile: G1\n", "either profile"),
        ("half_width_m: 1.9\n        height_m: 4.5", "profile: G9", "G9"),
        ("name: pole", "name: track", "two rules"),
        ("version: 1", "version: 2", "1"),
        ("title: Mine", "title: Mine\ntitle: Yours", "twice"),
        ("version: 1", "version: [", "YAML"),
        ("version: 1\nname: mine\n", "version: 1\n", "missing"),
    ],
)
def test_mistakes_are_told_in_one_sentence(old, new, said):
    assert old in GOOD
    assert said in str(error_of(GOOD.replace(old, new)))


def test_zones_must_be_upright_and_convex():
    zone = "zones:\n  - {{make: prism, outline_en_m: {}, bottom_z_m: 0.0, top_z_m: {}}}\n"
    assert parse_rule_book(GOOD + zone.format("[[0, 0], [4, 0], [4, 4], [0, 4]]", 2.0), "m").zones
    assert parse_rule_book(GOOD + zone.format("[[0, 4], [4, 4], [4, 0], [0, 0]]", 2.0), "m").zones
    star = "[[0, 4], [2.35, -3.24], [-3.8, 1.24], [3.8, 1.24], [-2.35, -3.24]]"
    for outline, top in [
        ("[[0, 0], [4, 0], [1, 1], [0, 4]]", 2.0),
        ("[[0, 0], [4, 0], [0, 4]]", -1.0),
        ("[[0, 0], [4, 0], [4, 0], [0, 4]]", 2.0),
        (star, 2.0),
    ]:
        error_of(GOOD + zone.format(outline, top))


def test_files_that_are_no_rule_books(tmp_path):
    with pytest.raises(RuleError, match="finland"):
        load_rule_book(tmp_path / "none.yaml")
    with pytest.raises(RuleError):
        load_rule_book(tmp_path)
    for content in (b"", b"\xff\xfe\x00", b"- 1\n", b"just words", b"a: &a [*a]\n"):
        (tmp_path / "bad.yaml").write_bytes(content)
        with pytest.raises(RuleError):
            load_rule_book(tmp_path / "bad.yaml")
    bomb = "a: &a [1,1,1,1,1,1,1,1,1,1]\n" + "".join(
        f"{name}: &{name} [{','.join(['*' + before] * 10)}]\n"
        for before, name in zip("abcdefgh", "bcdefghi", strict=True)
    )
    with pytest.raises(RuleError, match="too many"):
        parse_rule_book(bomb, "bomb.yaml")


JUNK = st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5), st.just([]), st.just({}))


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_whatever_stands_at_whatever_key_is_a_book_or_a_rule_error(data):
    book = copy.deepcopy(yaml.safe_load(GOOD))
    here = book
    while True:
        key = data.draw(st.sampled_from(sorted(here) if isinstance(here, dict) else range(len(here))))
        inner = here[key]
        if isinstance(inner, dict | list) and data.draw(st.booleans()):
            here = inner
            continue
        here[key] = data.draw(JUNK)
        break
    with contextlib.suppress(RuleError):
        assert parse_rule_book(yaml.safe_dump(book), "junk.yaml").version == 1
